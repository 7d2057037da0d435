from __future__ import annotations

import json
import sys

import pytest

from drivers.cameras.aravis_camera import load_library
from radiometer.cli.main import run


@pytest.fixture
def hidden_library(monkeypatch):
    """Hide PyGObject, as on a computer without it."""
    load_library.cache_clear()
    monkeypatch.setitem(sys.modules, "gi", None)
    yield
    load_library.cache_clear()


def test_a_missing_library_is_a_fault_with_exit_code_1(hidden_library, capsys):
    """Without the library the doctor still runs, says so with the packages, and leaves with 1."""
    assert run(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "FAULT" in out
    assert "apt install" in out


def test_json_holds_every_finding_with_its_cure(hidden_library, capsys):
    """Programs get one object: sound or not, and the findings."""
    assert run(["doctor", "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["sound"] is False
    assert {"check", "health", "message", "cure"} == set(printed["findings"][0])


def test_a_camera_that_is_not_there_is_a_fault(hidden_library, capsys):
    """A camera that cannot be opened is reported among the findings."""
    assert run(["doctor", "--camera", "4711", "--json"]) == 1
    last = json.loads(capsys.readouterr().out)["findings"][-1]
    assert (last["check"], last["health"]) == ("camera", "fault")
