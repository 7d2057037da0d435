from __future__ import annotations

import ctypes
from pathlib import Path

import pytest

from radiometer.errors import MissingLibrary
from simulators.cameras import aravis_fake_device


def test_without_aravis_the_message_names_the_package(monkeypatch):
    """Where the library is missing, the error says what to install."""

    def absent(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    aravis_fake_device._libraries.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", absent)
    try:
        with pytest.raises(MissingLibrary, match=r"gir1\.2-aravis-0\.8"):
            aravis_fake_device.FakeGigeDevice("127.0.0.1", "1", Path("none.xml"))
    finally:
        aravis_fake_device._libraries.cache_clear()
