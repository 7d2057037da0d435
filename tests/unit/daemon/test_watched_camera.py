"""The watch on a camera knows by when a call should be over."""

from dataclasses import replace
from unittest.mock import MagicMock

import pytest

from radiometer.daemon import bench_instrument
from radiometer.daemon.bench_instrument import BenchInstrument, WatchedCamera
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.service import ServiceOptions
from radiometer.data import Calibration, CameraDescription, Flag, LensDescription, Scale, SensorNoise
from radiometer.devices import Camera, CameraSettings
from radiometer.errors import CalibrationError, DeviceError, RadiometerError
from testing.daemon_process import write_small_bench


class _Camera:
    """Notes what the watch says while a call runs."""

    def __init__(self):
        self.settings = CameraSettings(0.5)
        self.seen = []
        self.watch = None

    def capture(self, count=1):
        self.seen.append(self.watch.late_at)
        return []

    def configure(self, settings):
        self.seen.append(self.watch.late_at)
        raise ValueError("refused")


def test_a_capture_is_late_after_twice_its_exposures_and_a_grace():
    """1.4 s, counted from the call's begin; after the call nothing is late, though it was refused."""
    camera = _Camera()
    camera.watch = watched = WatchedCamera(camera, clock=lambda: 100.0)
    watched.capture(3)
    assert camera.seen == [100.0 + 1.4 + 3.0]
    assert watched.late_at is None
    with pytest.raises(ValueError, match="refused"):
        watched.configure(CameraSettings(0.1))
    assert camera.seen[1:] == [100.0 + 1.4]
    assert watched.late_at is None


def test_every_call_reaches_the_camera_and_what_it_returns_comes_back():
    """Nothing is held back, exchanged or made up: each member is the camera's own, with the arguments given."""
    camera = MagicMock()
    camera.capture.return_value, camera.stream.return_value = [], iter([])
    watched = WatchedCamera(camera)
    assert [name for name in dir(Camera) if not name.startswith("_") and not hasattr(WatchedCamera, name)] == []
    for name in ("identity", "capabilities", "settings", "description", "lens", "counts"):
        assert getattr(watched, name) is getattr(camera, name)
    requested = CameraSettings(0.1)
    camera.settings = requested
    assert watched.configure(requested) is camera.configure.return_value
    assert watched.capture(2) is camera.capture.return_value
    assert list(watched.stream()) == []
    watched.set_shutter(closed=True)
    with watched as entered:
        assert entered is watched
        camera.open.assert_called_once_with()
        camera.close.assert_not_called()
    camera.close.assert_called_once_with()
    camera.configure.assert_called_once_with(requested)
    camera.capture.assert_called_once_with(2)
    camera.set_shutter.assert_called_once_with(closed=True)


def _instrument(folder, monkeypatch, tamper):
    """Return the simulated bench whose camera's frames come tampered with, open."""
    genuine = bench_instrument.open_camera

    def open_camera(*arguments):
        camera = genuine(*arguments)
        capture = camera.capture
        camera.capture = lambda count=1: [tamper(frame) for frame in capture(count)]
        return camera

    monkeypatch.setattr(bench_instrument, "open_camera", open_camera)
    instrument = BenchInstrument(write_small_bench(folder))
    instrument.open()
    return instrument


def _repeating():
    first = []

    def tamper(frame):
        first.append(frame)
        return replace(frame, dn=first[0].dn)

    return tamper


def _stating(factor):
    return lambda f: replace(f, settings=replace(f.settings, exposure_s=factor * f.settings.exposure_s))


@pytest.mark.parametrize(
    ("auto", "tamper", "flags"),
    [
        (True, _stating(1.01), set()),
        (False, _stating(1.01), set()),
        (True, _stating(0.5), {Flag.EXPOSURE_UNCONFIRMED}),
        (False, _stating(2.0), {Flag.EXPOSURE_UNCONFIRMED}),
        (True, _repeating(), {Flag.REPEATED_FRAME}),
        (False, _repeating(), {Flag.REPEATED_FRAME}),
    ],
)
def test_a_camera_that_cannot_be_believed_flags_the_reading(tmp_path, monkeypatch, auto, tamper, flags):
    """Another exposure time than was set, one frame for ever: each reading says so; an honest one never does."""
    instrument = _instrument(tmp_path, monkeypatch, tamper)
    settings = MeasurementSettings(instrument.default_patch(), auto_exposure=auto, exposure_s=0.01)
    for _ in range(2):
        found = set(instrument.measure(settings).reading.flags)
        assert found & {Flag.EXPOSURE_UNCONFIRMED, Flag.REPEATED_FRAME} == flags
    instrument.close()


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_exposure_time_is_reported(tmp_path, monkeypatch, factor):
    """It is no reading without a word: the error names the exposure time."""
    instrument = _instrument(tmp_path, monkeypatch, _stating(factor))
    with pytest.raises(DeviceError, match="exposure time"):
        instrument.measure(MeasurementSettings(instrument.default_patch()))
    instrument.close()


def test_another_camera_in_the_place_of_the_one_that_was_lost_is_refused(tmp_path, monkeypatch):
    """Its readings would pass for those of the first, which is taken again once it is back."""
    genuine, serial = bench_instrument.open_camera, ["22500001"]

    def open_camera(config, *arguments):
        there = config.camera.model_copy(update={"serial": serial[0]})
        return genuine(config.model_copy(update={"camera": there}), *arguments)

    monkeypatch.setattr(bench_instrument, "open_camera", open_camera)
    instrument = BenchInstrument(write_small_bench(tmp_path))
    instrument.open()
    serial[0] = "OTHER002"
    with pytest.raises(DeviceError, match=r"another device answers, .*OTHER002, in place of .*22500001; connect that"):
        instrument.open()
    serial[0] = "22500001"
    instrument.open()
    assert instrument.identity.serial == serial[0]
    instrument.close()


FIXED = MeasurementSettings(patch=None, auto_exposure=False, exposure_s=1e-3, gain_db=6.0)


def test_a_measurement_is_taken_at_its_own_gain_and_exposure(tmp_path):
    """6 dB and 1 ms are asked for and taken, then 0 dB again; a wavelength needs no calibration to be named."""
    instrument = BenchInstrument(write_small_bench(tmp_path), uncalibrated=True)
    with pytest.raises(DeviceError, match="not open"):
        instrument.measure(FIXED)
    instrument.open()
    for settings in (FIXED, replace(FIXED, gain_db=0.0, wavelength_nm=550.0)):
        frame = instrument.measure(settings).frame
        assert frame.settings.gain_db == settings.gain_db
        assert frame.settings.exposure_s == pytest.approx(1e-3, rel=0.01)
    assert instrument.self_test() == []
    assert instrument.calibration_summary == {}
    assert instrument.reload_calibration() == "no calibration in use"
    instrument.close()


@pytest.mark.parametrize(
    ("of_camera", "of_lens"),
    [({"model": "other"}, {}), ({"binning": "2"}, {}), ({}, {"focal_length_mm": 35.0}), ({}, {"transmittance": None})],
    ids=["camera", "binning", "lens", "transmittance"],
)
def test_a_calibration_that_no_reading_could_use_is_refused_at_once(of_camera, of_lens, tmp_path):
    """Read again, one of another camera or lens is refused, and the old one goes on."""
    camera = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=5.95, read_noise_e=2.4, black_level_dn=64.0)
    lens = LensDescription(f_number=4.0, transmittance=0.95)
    scale = Scale(value=1e-6, u_rel=0.01, method="known_radiance", f_number=4.0)
    path = tmp_path / "cal.yaml"
    right = Calibration(camera, lens, scale, None, SensorNoise.of(camera))
    right.write(path)
    instrument = BenchInstrument(write_small_bench(tmp_path), calibration=path)
    instrument.open()
    before = instrument.calibration_summary
    wrong = replace(right, camera=camera.model_copy(update=of_camera), lens=lens.model_copy(update=of_lens))
    replace(wrong, created="2026-01-01T00:00:00Z").write(path)
    with pytest.raises(
        CalibrationError, match=r"another camera|for binning 2, .* with 1|with a lens of 35 mm|states none"
    ):
        instrument.reload_calibration()
    assert instrument.calibration_summary == before
    assert instrument.measure(FIXED).reading.radiance.value > 0
    instrument.close()


def test_what_the_bench_says_of_itself(tmp_path):
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


def test_a_wavelength_without_meaning_is_refused_before_a_frame_is_taken():
    """Where the calibration would need it: 5 nm is no light."""
    instrument = BenchInstrument()
    instrument.open()
    assert instrument.calibration_summary["source"]
    with pytest.raises(RadiometerError, match="5"):
        instrument.measure(replace(FIXED, gain_db=0.0, wavelength_nm=5.0))
    assert instrument.check().counters["frames"] == 0
    instrument.close()


def test_the_ports_are_those_that_are_documented(project_root):
    """SCPI on 5025, its registered port, and HTTP on 8080, for this machine alone; the docs say the same."""
    options = ServiceOptions()
    assert (options.scpi_port, options.http_port) == (5025, 8080)
    assert options.scpi_address == options.http_address == "127.0.0.1"
    page = (project_root / "docs" / "reference" / "daemon.md").read_text(encoding="utf-8")
    assert "5025" in page
    assert "8080" in page
