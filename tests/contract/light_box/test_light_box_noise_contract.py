"""The contract on a bad line, for the twin and for the firmware."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.devices import CurrentRange, DriveLevel
from radiometer.errors import DeviceError


@pytest.mark.slow
def test_bad_line_sets_no_wrong_level(rig):
    """With 1 % of the bytes wrong both ways, every level read back as set is the one at the pin."""
    rig.server.faults_in.corrupt = rig.server.faults_out.corrupt = 0.01
    rng = np.random.default_rng(21)
    for _ in range(60):
        level = int(rng.integers(1000, 60000))
        assert _set_in_the_end(rig, level).drive.level == level
    assert rig.server.faults_in.touched + rig.server.faults_out.touched > 60
    rig.server.faults_in.corrupt = rig.server.faults_out.corrupt = 0.0
    expected = _set_in_the_end(rig, level).duty_steps / rig.box.channels["spot"].duty_steps
    assert rig.wait_until(lambda: abs(rig.duty("spot") - expected) < 0.004)


def _set_in_the_end(rig, level: int):
    """Set a level; a box that has gone dark meanwhile, as on a computer too busy to run it, is opened again."""
    for _ in range(5):
        try:
            return rig.box.set_level("spot", DriveLevel(level, CurrentRange.LOW))
        except DeviceError:
            rig.box.close()
            rig.box.open()
    raise AssertionError(f"level {level} could not be set")


def test_garbage_at_start_up_is_survived(rig):
    """Bytes that lie in the line before the host speaks, half lines among them, do not keep it from opening."""
    rig.box.close()
    rig.server.say(b"\x00\xff\x80boot loader\r\n=05 OK radio\n!01 BT D 5.000*00000000\n=07 O")
    rig.box.open()
    assert rig.box.identity.protocol_version == 2
