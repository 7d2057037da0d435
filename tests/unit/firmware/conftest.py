"""The firmware as a library, built once."""

import itertools
import shutil

import pytest

from testing.firmware_board import FirmwareBox, build

# Buckets of five ms of the bleach at its highest level, so that they are used up in a moment.
DIVISOR = 40_000


@pytest.fixture(scope="session")
def libraries(project_root, tmp_path_factory):
    """Return the firmware as it is, and with small buckets."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no C compiler (apt install gcc)")
    folder, firmware = tmp_path_factory.mktemp("firmware"), project_root / "drivers/firmware/light_box"
    return {
        "whole": build(firmware, folder / "whole.so"),
        "small": build(firmware, folder / "small.so", f"BUCKET_DIVISOR={DIVISOR}UL"),
    }


@pytest.fixture
def power(libraries, tmp_path):
    """Return a function that powers a box: `whole` or `small`, the cause of the reset, and its memory."""
    boxes = []
    numbers = itertools.count()

    def powered(kind="whole", reset_flags=1, serial="LB000007", memory=None):
        boxes.append(FirmwareBox(libraries[kind], tmp_path / f"{next(numbers)}.so", reset_flags, serial, memory))
        return boxes[-1]

    yield powered
    for box in boxes:
        box.close()
