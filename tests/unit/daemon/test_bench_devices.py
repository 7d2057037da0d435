"""The daemon's own camera and light: what a measurement's settings become, and what a level is to the box."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from radiometer.daemon.bench_instrument import BenchInstrument
from radiometer.daemon.bench_light import BenchLight
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.service import ServiceOptions
from radiometer.devices import ChannelMode, ChannelState, CurrentRange, DriveLevel
from radiometer.errors import DeviceError, RadiometerError
from testing.daemon_process import write_small_bench

FIXED = MeasurementSettings(patch=None, auto_exposure=False, exposure_s=1e-3, gain_db=6.0)


def test_a_measurement_is_taken_at_its_own_gain_and_exposure(tmp_path: Path) -> None:
    """6 dB and 1 ms are asked for and taken, then 0 dB again; a wavelength needs no calibration to be named."""
    instrument = BenchInstrument(write_small_bench(tmp_path), uncalibrated=True)
    with pytest.raises(DeviceError, match="not open"):
        instrument.measure(FIXED)
    instrument.open()
    for settings in (FIXED, replace(FIXED, gain_db=0.0, wavelength_nm=550.0)):
        frame = instrument.measure(settings).frame
        assert frame is not None
        assert frame.settings.gain_db == settings.gain_db
        assert frame.settings.exposure_s == pytest.approx(1e-3, rel=0.01)
    assert instrument.self_test() == []
    assert instrument.calibration_summary == {}
    assert instrument.reload_calibration() == "no calibration in use"
    instrument.close()


def test_what_the_bench_says_of_itself(tmp_path: Path) -> None:
    """Before it was open, while it is, and after: limits, identity, counters, the patch, temperature, errors."""
    instrument = BenchInstrument(write_small_bench(tmp_path), uncalibrated=True)
    with pytest.raises(DeviceError, match="has not been open yet, so its limits are not known"):
        _ = instrument.limits
    assert instrument.identity.model == "camera not seen yet"
    assert instrument.late_at is None
    instrument.open()
    limits = instrument.limits
    assert instrument.identity.model != "camera not seen yet"
    report = instrument.check()
    assert report.temperature_c is None
    assert report.counters["frames"] == 0
    measured = instrument.measure(replace(FIXED, auto_exposure=True, gain_db=0.0))
    assert len(measured.reading.exposures_s) == len(measured.frames) > 1
    assert instrument.check().counters["frames"] > 1
    assert instrument.check().temperature_c is not None
    instrument.close()
    assert instrument.limits == limits
    with pytest.raises(DeviceError, match="not open"):
        instrument.check()


def test_a_wavelength_without_meaning_is_refused_before_a_frame_is_taken() -> None:
    """Where the calibration would need it: 5 nm is no light."""
    instrument = BenchInstrument()
    instrument.open()
    assert instrument.calibration_summary["source"]
    with pytest.raises(RadiometerError, match="5"):
        instrument.measure(replace(FIXED, gain_db=0.0, wavelength_nm=5.0))
    assert instrument.check().counters["frames"] == 0
    instrument.close()


def test_a_self_test_tells_what_is_implausible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame without noise, and one whose darkest pixel lies beyond twice the black level; settings come back."""
    instrument = BenchInstrument(write_small_bench(tmp_path), uncalibrated=True)
    instrument.open()
    camera = instrument._opened()
    before = camera.settings
    black = before.black_level_dn
    assert black
    asked = []

    def capture(count: int = 1) -> list[Any]:
        asked.append(camera.settings.exposure_s)
        return [SimpleNamespace(dn=frames.pop(0))]

    monkeypatch.setattr(camera, "capture", capture)
    twice = int(2 * black)
    frames = [np.array([[5, 5]]), np.array([[twice, twice + 9]]), np.array([[twice + 1, twice + 9]])]
    assert instrument.self_test() == ["every pixel reads 5 DN at the shortest exposure: no noise, no signal"]
    assert instrument.self_test() == []
    assert instrument.self_test() == [f"the darkest pixel reads {twice + 1} DN where the black level is {black:g} DN"]
    assert asked == [camera.capabilities.exposure_s[0]] * 3
    assert camera.settings == before
    instrument.close()


class Box:
    """A box of one channel that is driven as it is told and loses two bytes."""

    channels = {"spot": SimpleNamespace(level_limit={CurrentRange.HIGH: 60_000, CurrentRange.LOW: 65_535})}  # noqa: RUF012

    def __init__(self) -> None:
        self.drive = DriveLevel(0)

    def set_level(self, channel: str, level: DriveLevel) -> ChannelState:
        self.drive = level
        return self.read_channel(channel)

    def off(self, channel: str) -> None:
        self.drive = DriveLevel(0)

    def read_channel(self, channel: str) -> ChannelState:
        return ChannelState(channel, ChannelMode.STEADY, self.drive, 8192, 1.0)

    def status(self) -> Any:
        return SimpleNamespace(damaged_lines=1, lost_bytes=2, darkened=3, temperature_celsius=31.5)


def test_a_level_of_the_daemon_is_a_part_of_the_highest_number() -> None:
    """A half of 65535 is driven at the high current and told as it is; the least is one step, and nothing is off."""
    box = Box()

    @contextmanager
    def opened() -> Any:
        yield box

    light = BenchLight(opened)
    with pytest.raises(DeviceError, match="not open"):
        light.set_level("spot", 0.5)
    light.open()
    assert light.set_level("spot", 0.5) == pytest.approx(0.5, abs=1e-5)
    assert (box.drive.level, box.drive.current_range) == (32_768, CurrentRange.HIGH)
    report = light.check()
    assert report.levels == {"spot": pytest.approx(0.5, abs=1e-5)}
    assert report.counters == {"damaged_lines": 1, "lost_bytes": 2, "darkened": 3}
    assert report.temperature_c == 31.5
    assert light.set_level("spot", 1e-9) > 0.0
    assert box.drive.level == 1
    assert light.set_level("spot", 0.0) == 0.0
    assert box.drive.level == 0


def test_the_ports_are_those_that_are_documented(project_root: Path) -> None:
    """SCPI on 5025, its registered port, and HTTP on 8080, for this machine alone; the docs say the same."""
    options = ServiceOptions()
    assert (options.scpi_port, options.http_port) == (5025, 8080)
    assert options.scpi_address == options.http_address == "127.0.0.1"
    page = (project_root / "docs" / "daemon.md").read_text(encoding="utf-8")
    assert "5025" in page
    assert "8080" in page


def test_a_device_is_looked_for_and_asked_twice_a_second() -> None:
    """By itself first after 0.2 s, then at most half a second apart; a call is late after a second."""
    times = KeeperTimes()
    assert (times.first_pause_s, times.longest_pause_s, times.check_every_s, times.overdue_s) == (0.2, 0.5, 0.5, 1.0)
