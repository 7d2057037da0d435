"""The daemon's own camera and light: what a measurement's settings become, and what a level is to the box."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from radiometer.daemon.bench_instrument import BenchInstrument
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.service import ServiceOptions
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


def test_the_ports_are_those_that_are_documented(project_root: Path) -> None:
    """SCPI on 5025, its registered port, and HTTP on 8080, for this machine alone; the docs say the same."""
    options = ServiceOptions()
    assert (options.scpi_port, options.http_port) == (5025, 8080)
    assert options.scpi_address == options.http_address == "127.0.0.1"
    page = (project_root / "docs" / "reference" / "daemon.md").read_text(encoding="utf-8")
    assert "5025" in page
    assert "8080" in page


def test_a_device_is_looked_for_and_asked_twice_a_second() -> None:
    """By itself first after 0.2 s, then at most half a second apart; a call is late after a second."""
    times = KeeperTimes()
    assert (times.first_pause_s, times.longest_pause_s, times.check_every_s, times.overdue_s) == (0.2, 0.5, 0.5, 1.0)
