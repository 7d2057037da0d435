"""Fields of the box's answers become physical values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.light_box.answers import read_capabilities, read_flash, read_identity, read_state, read_status
from radiometer.devices.light_box import (
    ChannelCapabilities,
    ChannelMode,
    ChannelState,
    CurrentRange,
    DriveLevel,
    FlashState,
    LightBoxIdentity,
    LightBoxStatus,
)
from radiometer.errors import DeviceError

STATUS = ("12015", "-253", "3", "4", "5", "B", "1", "0")


def test_answers_in_physical_units() -> None:
    """mV, tenths of a degree, ms and units of the bucket become V, °C, s and a share."""
    assert read_identity("p", ("radiometer-light-box", "2", "1.4", "LB-7", "6")) == (
        LightBoxIdentity("LB-7", "1.4", 2, "p"), 6
    )  # fmt: skip
    limits = {CurrentRange.LOW: 65535, CurrentRange.HIGH: 30000}
    fields = ("spot", "505", "8000", "2000", "65535", "30000", "900", "0")
    assert read_capabilities("p", fields) == (ChannelCapabilities("spot", 505.0, 8000, 2000.0, limits), 900)
    white = read_capabilities("p", ("bleach", "0", *fields[2:]))[0]
    assert white.peak_nm is None
    assert read_state("p", "spot", 900, ("R", "H", "1234", "151", "300")) == ChannelState(
        "spot", ChannelMode.RAMP, DriveLevel(1234, CurrentRange.HIGH), 151, pytest.approx(1 / 3)
    )
    assert read_status("p", STATUS) == LightBoxStatus(12.015, -25.3, 3, 4, 5, "brown-out", True)
    assert read_flash("p", ("4", "1250")) == FlashState(4, 1.25)


@pytest.mark.parametrize(
    "read",
    [
        lambda: read_status("p", STATUS[:-1]),
        lambda: read_status("p", ("x", *STATUS[1:])),
        lambda: read_status("p", (*STATUS[:5], "Q", *STATUS[6:])),
        lambda: read_state("p", "spot", 900, ("X", "H", "1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "M", "1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "L", "-1", "1", "1")),
        lambda: read_state("p", "spot", 900, ("S", "L", "1", "1")),
        lambda: read_flash("p", ("4",)),
        lambda: read_flash("p", ("4", "soon")),
        lambda: read_capabilities("p", ("spot", "505", "8000", "2000", "65535", "30000", "900")),
        lambda: read_identity("p", ("radiometer-light-box", "2", "1.4", "LB-7", "six")),
        lambda: read_identity("p", ("radiometer-light-box", "99", "1.4", "LB-7", "6")),
        lambda: read_identity("p", ("kettle", "2", "1.4", "LB-7", "6")),
    ],
)
def test_an_answer_without_sense_is_refused(read: Callable[[], Any]) -> None:
    """Too few fields, no number, an unknown letter, another device."""
    with pytest.raises(DeviceError, match="on p"):
        read()
