"""Ten thousand sequences on the simulated desk, two hundred of them by the firmware: no eye gets more than a tenth."""

import shutil

import pytest

from testing.eye_world import PROMISED, firmware_maker, live_through

PART = 500


@pytest.mark.parametrize("part", range(20))
def test_no_sequence_gives_an_eye_more_than_the_promised_share(tmp_path, part):
    """Commands, kills at any step, cables, clocks, restarts, damaged accounts, several programs and boxes."""
    desks = live_through(tmp_path, range(1000 + part * PART, 1000 + (part + 1) * PART))
    assert max(desks.shares) <= PROMISED


@pytest.mark.parametrize("part", range(4))
def test_no_sequence_with_the_firmware_gives_an_eye_more(tmp_path, project_root, part):
    """The same with the code that runs in the box, and its EEPROM."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no C compiler (apt install gcc)")
    make = firmware_maker(project_root / "drivers" / "firmware" / "light_box", tmp_path)
    desks = live_through(tmp_path, range(1000 + part * 50, 1050 + part * 50), make)
    assert max(desks.shares) <= PROMISED
