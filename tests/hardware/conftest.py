"""A real camera, named by RADIOMETER_CAMERA (serial number, device id or address)."""

import os
from collections.abc import Iterator

import pytest

from drivers.cameras.aravis_camera import AravisCamera, open_camera


@pytest.fixture(scope="session")
def camera() -> Iterator[AravisCamera]:
    """Return the opened camera, or skip where none is named."""
    name = os.environ.get("RADIOMETER_CAMERA")
    if not name:
        pytest.skip("no real camera: set RADIOMETER_CAMERA to a serial number, device id or address")
    with open_camera(name) as opened:
        yield opened
