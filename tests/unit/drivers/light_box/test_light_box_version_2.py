"""Protocol version 2 by the driver: version 1 understood, over-bright light and flashes refused, doses counted."""

from __future__ import annotations

import math

import pytest

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from radiometer.devices import CurrentRange, DriveLevel
from radiometer.devices.exposure_account import MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.retinal_safety import ChannelOptics, FlashLight
from radiometer.errors import SettingOutOfRange, UnsafeStimulus, UsageError
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.virtual_line import VirtualLine

FIELD = ChannelOptics(None, 0.0, 40.0, 40.0)
WHITE_BLUE, WHITE_RED = 0.40629, 4.5181  # of the stated white: worked out in test_exposure_limits_twice.py
FLASH = FlashLight(exposure_j_sr_m2=100.0, exposure_bound_j_sr_m2=120.0, duration_s=0.003, subtense_deg=40.0)


def bench(version: int = 2, flash: FlashLight | None = FLASH) -> tuple[SimulatedLightBox, VirtualLine, SerialLightBox]:
    """Return a twin, its line and an opened driver."""
    twin = SimulatedLightBox(SimulatedBoxSettings(newest_version=version))
    line = VirtualLine(twin, latency_s=0.0003)
    optics = dict.fromkeys(("bleach", "field"), FIELD) | {"spot": ChannelOptics(453.0, 22.0, 1.5, 4.0)}
    if flash is not None:
        optics["flash"] = flash.optics
    box = SerialLightBox(
        BoxLink(line), ExposureLedger(optics, MemoryStore(line.now, ("TWIN0001",))), keep_alive=False, flash=flash
    )
    box.open()
    return twin, line, box


def pass_time(line: VirtualLine, box: SerialLightBox, seconds: float) -> None:
    """Let time pass with the box tended."""
    end_s = line.now() + seconds
    while (left_s := end_s - line.now()) > 0:
        line.wait(min(left_s, 0.2))
        box.tend_if_due()


def test_new_box_has_six_channels_and_an_old_one_its_four() -> None:
    """The driver asks for version 2 first and takes version 1 where that is refused."""
    _, _, new = bench()
    assert (new.identity.protocol_version, list(new.channels)[4:]) == (2, ["spot_green", "field"])
    _, _, old = bench(version=1)
    assert (old.identity.protocol_version, len(old.channels)) == (1, 4)
    old.pulse("spot", DriveLevel(500, CurrentRange.LOW), 0.1)
    with pytest.raises(UsageError, match="version 1, which has no flash"):
        old.fire_flash()
    with pytest.raises(UsageError, match="no channel 'field'"):
        old.set_level("field", DriveLevel(1))


def test_over_bright_requests_are_refused_before_a_byte_is_sent() -> None:
    """Above the level limit, beyond a tenth of the blue-light limit, beyond the energy budget: no light each time."""
    twin, _, box = bench()
    with pytest.raises(SettingOutOfRange):
        box.pulse("field", DriveLevel(60001), 1.0)
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        box.set_level("field", DriveLevel(60000))  # 36.6 W/sr/m², 0.406 of it blue, for 10⁴ s: 15 %
    with pytest.raises(UnsafeStimulus, match="energy budget"):
        box.foresee("field", DriveLevel(60000), 301.0)
    assert all(channel.bucket == channel.limits.bucket for channel in twin.channels)
    box.pulse("field", DriveLevel(60000), 299.0)


def test_flash_is_judged_as_a_pulse_and_counted() -> None:
    """One flash of 120 J/sr/m² in 3 ms is 8.5 % of the thermal limit and adds 4.9·10⁻⁵ of the blue-light limit."""
    twin, line, box = bench()
    one = box.foresee_flashes(1)
    assert one.thermal == pytest.approx(WHITE_RED * 120 / 0.003 * 0.1 * 0.003**0.25 / 50_000, rel=1e-3)
    assert 0.08 < one.thermal < 0.1
    assert box.foresee_flashes(8).blue_light == pytest.approx(8 * WHITE_BLUE * 120 / 1e6, rel=1e-3)
    assert box.fire_flash().left == 7
    with pytest.raises(UnsafeStimulus):
        box.fire_flash()  # the box wants 5 s between two
    pass_time(line, box, 5.1)
    box.fire_flash()
    assert len(twin.flash.fired_ms) == 2
    pass_time(line, box, 1.0)
    spent = 2 * WHITE_BLUE * 120 / 1e6
    limit_s = (0.1 / 1.01 - spent) * 1e6 / (WHITE_BLUE * 36.0)  # the box's clock may be 1 % slow
    box.ledger.refuse_unsafe("field", 36.0, limit_s * 0.9995)
    with pytest.raises(UnsafeStimulus):
        box.ledger.refuse_unsafe("field", 36.0, limit_s * 1.0005)


def test_too_strong_a_flash_is_refused_by_the_driver() -> None:
    """840 J/sr/m² in 1 ms, what bleaches 76 % of the rods at once, is beyond a tenth of the thermal limit."""
    twin, _, box = bench(flash=FlashLight(840.0, 840.0, 0.001, 40.0))
    with pytest.raises(UnsafeStimulus, match="thermal"):
        box.fire_flash()
    assert not twin.flash.fired_ms


def test_button_that_turns_the_lights_off_ends_them_in_the_account() -> None:
    """Held for 3 s it ends the field's light; from then on nothing more is counted, and the session goes on."""
    twin, line, box = bench()
    left = box.highest_level("field")
    box.pulse("field", DriveLevel(30000), 100.0)
    twin.press(line.now() + 1.0)
    twin.press(line.now() + 4.5, pressed=False)
    pass_time(line, box, 6.0)
    assert twin.duty("field") == 0
    assert 0 < left - box.highest_level("field") < 30000 * 5 / 1e4 + 64  # 4 s of light, a look, and a duty step
    assert math.isfinite(box.status().supply_v)
