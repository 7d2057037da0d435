"""Whoever listens is notified of every change at once, and what is at a limit is still allowed."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import Journal
from radiometer.daemon.patches import PatchLimits
from radiometer.daemon.station import Station
from radiometer.data import Patch
from radiometer.errors import DeviceError, DeviceLost, SettingOutOfRange

LAMP = Patch(1, 2, 3, 4)

CHANGES: dict[str, tuple[Callable[[Station], Any], Callable[[dict[str, Any]], Any], Any]] = {
    "settings": (lambda s: s.configure(gain_db=6.0), lambda status: status["settings"]["gain_db"], 6.0),
    "a patch": (
        lambda s: s.patches.define("lamp", LAMP),
        lambda status: status["patches"]["lamp"]["patch"]["width"],
        3,
    ),
    "no patch": (lambda s: s.patches.delete("old"), lambda status: "old" in status["patches"], False),
    "limits": (
        lambda s: s.patches.set_limits("old", PatchLimits(high=2.0)),
        lambda status: status["patches"]["old"]["limits"]["high"],
        2.0,
    ),
    "a remark": (lambda s: s.annotate("a cloud"), lambda status: status["alarms"], []),
    "the period": (lambda s: s.set_every(3600.0), lambda status: status["every_s"], 3600.0),
    "settings as at first": (lambda s: s.reset(), lambda status: status["settings"]["gain_db"], 0.0),
    "an alarm": (lambda s: s.alarms.put_up("lens", "dusty"), lambda status: status["alarms"][0]["name"], "lens"),
}


@pytest.mark.parametrize("what", CHANGES)
async def test_every_change_is_reported_once_with_the_state_after_it(station: Station, what: str) -> None:
    """Each listener within the program is called, and each subscriber has one line of the new state."""
    change, look, expected = CHANGES[what]
    station.patches.define("old", LAMP)
    subscription, called = station.hub.subscribe(), []
    station.on_change.append(lambda: called.append(1))
    change(station)
    assert called == [1]
    event = await subscription.next()
    station.hub.close()
    assert event is not None
    assert (event.kind, event.sequence, look(json.loads(event.line))) == ("status", None, expected)
    assert look(station.status()) == expected


async def test_light_that_is_set_is_reported(station: Station) -> None:
    """The new level is in the state that the subscriber gets."""
    subscription = station.hub.subscribe()
    assert await station.light.set_level("red", 0.25) == 0.25
    event = await subscription.next()
    assert event is not None
    assert json.loads(event.line)["light"] == {"white": 0.0, "red": 0.25}


@pytest.mark.parametrize(
    ("field", "low", "high", "further"),
    [("gain_db", 0.0, 48.0, {}), ("exposure_s", 1e-5, 30.0, {"auto_exposure": False})],
)
async def test_what_is_at_a_limit_is_allowed_and_what_is_beyond_is_not(
    station: Station, field: str, low: float, high: float, further: dict[str, Any]
) -> None:
    """Both ends of a range belong to it; an exposure is looked at only where the daemon does not choose it."""
    for value in (low, high):
        assert getattr(station.configure(**further, **{field: value}), field) == value
    for value in (low - 0.001 * high, high * 1.001):
        with pytest.raises(SettingOutOfRange):
            station.configure(**further, **{field: value})
    if further:
        assert station.configure(exposure_s=2 * high, auto_exposure=True).auto_exposure


async def test_levels_are_0_to_1(station: Station, box: Any) -> None:
    """Full and dark are levels; what is beyond is refused before it reaches the box."""
    assert [await station.light.set_level("red", level) for level in (1.0, 0.0)] == [1.0, 0.0]
    for level in (-0.01, 1.01):
        with pytest.raises(SettingOutOfRange):
            await station.light.set_level("red", level)
    assert box.levels["red"] == 0.0


async def test_settings_as_at_first_forget_a_reading_of_another_patch_only(station: Station) -> None:
    """A reset that measures the same keeps what was measured; one that moves the patch has no reading yet."""
    station.configure(gain_db=6.0)
    reading = await station.acquisition.measure()
    station.reset()
    assert (station.shown.latest, station.settings) == (reading, MeasurementSettings())
    station.configure(patch=LAMP)
    moved = await station.acquisition.measure()
    assert station.shown.latest == moved
    station.reset()
    assert (station.shown.latest, station.shown.line, station.shown.measurement) == (None, "", None)


async def test_without_a_box_no_light_is_believed(instrument: Any, tmp_path: Any) -> None:
    """A station that has none says so, of one channel and of all, and shows none in its state."""
    alone = Station(instrument, Journal(tmp_path / "journal.sqlite"))
    for call in (alone.light.set_level("red", 0.0), alone.light.off()):
        with pytest.raises(DeviceLost, match="no light box"):
            await call
    assert (alone.light.is_confirmed, alone.status()["light"], list(alone.status()["devices"])) == (
        False,
        {},
        ["camera"],
    )
    with pytest.raises(DeviceError, match="never open"):
        alone.configure(gain_db=1.0)


async def test_gauges_show_the_devices_as_they_are(station: Station, instrument: Any) -> None:
    """Up, how often lost, how warm, how many alarms: as the camera and its keeper say."""
    station.camera.losses = 3
    station.alarms.put_up("lens", "dusty")
    station.refresh_metrics()
    shown = station.metrics.render().decode()
    for line in (
        'radiometer_device_up{device="camera"} 1.0',
        'radiometer_device_up{device="light box"} 1.0',
        'radiometer_temperature_celsius{device="camera"} 41.5',
        'radiometer_temperature_celsius{device="light box"} 30.0',
        "radiometer_alarms 1.0",
    ):
        assert line in shown
