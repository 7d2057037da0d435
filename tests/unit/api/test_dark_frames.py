"""What every function does with dark frames: with those of the same exposures, with others, and without any."""

import datetime as dt
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.response.limits import black_of_darks, with_stated_black
from radiometer.data import (
    Bracket,
    Calibration,
    CameraDescription,
    CaptureSetWriter,
    Frame,
    FrameSettings,
    LensDescription,
    Scale,
    SensorNoise,
    SourceDescription,
)
from radiometer.errors import MeasurementError

BLACK_DN, DARK_E_PER_S, LIGHT_E_PER_S, TIMES_S = 500.0, 9.0, 3000.0, (0.125, 0.25, 0.5)
GAIN_E_PER_DN, PITCH_UM, EFFICIENCY, WAVELENGTH_NM = 1.0, 5.0, 0.5, 550.0
CAMERA = CameraDescription(
    bit_depth=12, conversion_gain_e_per_dn=GAIN_E_PER_DN, read_noise_e=2.0, full_well_e=9000.0,
    pixel_pitch_um=PITCH_UM, quantum_efficiency=EFFICIENCY,
)  # fmt: skip
LENS = LensDescription(f_number=4.0)
PATCH = (20, 12, 16, 16)
LENS_SR = math.pi / (4.0 * 16.0)
DARKS = {"none": (), "same exposures": TIMES_S, "other exposures": (0.05, 1.0)}


@pytest.fixture(params=DARKS)
def capture(request, tmp_path) -> tuple[str, Path]:
    """Return a capture set of a lit square with an unknown dark current, and which dark frames it has."""
    rng, lit = np.random.default_rng(3), np.zeros((40, 56))
    lit[8:32, 14:42] = LIGHT_E_PER_S
    folder = tmp_path / "set"

    def frame(time_s: float, light: np.ndarray, **settings: object) -> Frame:
        electrons = rng.poisson((light + DARK_E_PER_S) * time_s) + rng.normal(0.0, 2.0, light.shape)
        dn = np.clip(np.rint(electrons / GAIN_E_PER_DN + BLACK_DN), 0, 4095).astype(np.uint16)
        return Frame(dn, 12, FrameSettings(time_s, black_level_dn=BLACK_DN, **settings))

    with CaptureSetWriter(folder, CAMERA, LENS, source=SourceDescription(wavelength_nm=WAVELENGTH_NM)) as writer:
        for time_s in DARKS[request.param]:
            writer.add(frame(time_s, 0 * lit, shutter="closed"))
        for time_s in TIMES_S:
            writer.add(frame(time_s, lit))
    return request.param, folder


def calibration() -> Calibration:
    """Return the calibration under which the square has 1 W·sr⁻¹·m⁻²."""
    scale = Scale(value=LENS_SR * GAIN_E_PER_DN / LIGHT_E_PER_S, u_rel=1e-3, method="known_radiance", f_number=4.0)
    return Calibration(CAMERA, LENS, scale, None, SensorNoise.of(CAMERA))


def measured(folder: Path) -> tuple[float, float]:
    reading = rm.measure_photographs(folder, PATCH, calibration=calibration(), spectrum="equal_energy")
    return reading.radiance.value, reading.radiance.u


def merged(folder: Path | rm.Stack) -> tuple[float, float]:
    found = rm.merge(folder, calibration=calibration())
    part = np.s_[12:28, 20:36]
    return float(np.mean(found.value[part])), float(np.hypot(found.u_rel_common, np.median(found.u[part])))


def stacked(folder: Path) -> tuple[float, float]:
    return merged(rm.read(folder))


def calibrated(folder: Path) -> tuple[float, float]:
    scale = rm.calibrate(folder, patch=PATCH, radiance=1.0, u_rel=1e-3).scale
    truth = LENS_SR * GAIN_E_PER_DN / LIGHT_E_PER_S
    return scale.value / truth, scale.u_rel


def through_sensor(folder: Path) -> tuple[float, float]:
    found = rm.flux(folder, patch=(2, 2, 52, 36)).report.on_sensor
    photon_j = 6.62607015e-34 * 299_792_458.0 / (WAVELENGTH_NM * 1e-9)
    truth = 24 * 28 * LIGHT_E_PER_S / EFFICIENCY * photon_j
    return found.value / truth, found.u / truth


@pytest.mark.parametrize("function", [measured, merged, stacked, calibrated, through_sensor])
def test_every_function_takes_the_dark_signal_off(function, capture):
    """The truth is 1: within k = 2 whatever dark frames there are, within 0.2 % with those of the same exposures.

    The dark current, which nothing states, is 0.3 % of the light.
    """
    darks, folder = capture
    value, u = function(folder)
    assert abs(value - 1.0) <= 2.0 * u
    if darks == "same exposures":
        assert value == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize("share", [0.2, 0.02])
@pytest.mark.parametrize("function", [measured, merged])
def test_dark_frames_of_one_exposure_leave_the_dark_current_of_the_others_open(tmp_path, function, share):
    """600 or 60 e⁻/s of light, 300 of dark current: right to k = 2, though 0.25 s shows less than darks of 0.5 s.

    A reading rests on the frame whose dark signal is measured.
    """
    rng, shape = np.random.default_rng(5), (40, 56)
    with CaptureSetWriter(tmp_path / "set", CAMERA, LENS, source=SourceDescription(wavelength_nm=WAVELENGTH_NM)) as one:
        lit = [(time_s, share * LIGHT_E_PER_S, "open") for time_s in TIMES_S[1:]]
        for time_s, light, shutter in ((0.5, 0.0, "closed"), *lit):
            electrons = rng.poisson((light + 300.0) * time_s, shape) + rng.normal(0.0, 2.0, shape)
            dn = np.rint(electrons / GAIN_E_PER_DN + BLACK_DN).astype(np.uint16)
            one.add(Frame(dn, 12, FrameSettings(time_s, 0.0, None, BLACK_DN, 25.0, shutter=shutter)))
    value, u = function(tmp_path / "set")
    assert abs(value - share) <= 2.0 * u
    assert function is merged or u < 0.06 * share + 0.002  # noise of one dark frame, and 2 % of 0.1 by thermometers


@pytest.mark.parametrize("times_s", [(0.5,), (1.0, 2.0), (0.05, 1.0)])
@pytest.mark.parametrize("function", [measured, merged])
def test_hot_pixels_of_longer_dark_frames_are_taken_off_by_the_ratio_of_times(tmp_path, function, times_s):
    """60 e⁻/s of light, and 1500 of dark current in every 32nd pixel of the patch: its mean would be 78 % too high."""
    rng, shape = np.random.default_rng(6), (40, 56)
    hot = np.full(shape, 3.0)
    hot[12:28:2, 20:36:16] = 1500.0
    with CaptureSetWriter(tmp_path / "set", CAMERA, LENS, source=SourceDescription(wavelength_nm=WAVELENGTH_NM)) as one:
        for time_s, light, shutter in (*((t, 0.0, "closed") for t in times_s for _ in range(4)), (0.5, 60.0, "open")):
            dn = np.rint(rng.poisson((light + hot) * time_s) + rng.normal(0.0, 2.0, shape) + BLACK_DN).astype(np.uint16)
            one.add(Frame(dn, 12, FrameSettings(time_s, 0.0, None, BLACK_DN, 25.0, shutter=shutter)))
    value, u = function(tmp_path / "set")
    assert abs(value - 0.02) <= 2.0 * u
    assert value == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("stated", [16, None])
def test_padded_codes_are_in_the_uncertainty(tmp_path, stated):
    """Darkness is anywhere within a step of 16 DN, by the capture set or by the numbers alone; bright light is not."""
    padded = CAMERA.model_copy(update={"code_step_dn": stated})
    with CaptureSetWriter(tmp_path / "set", padded, LENS, source=SourceDescription(wavelength_nm=WAVELENGTH_NM)) as one:
        for number, shutter in ((496, "closed"), (1232, "open")):
            for _ in range(2):
                dn = number + 16 * np.arange(40 * 56).reshape(40, 56) % (48 if shutter == "open" else 1)
                one.add(
                    Frame(dn.astype(np.uint16), 12, FrameSettings(TIMES_S[1], black_level_dn=BLACK_DN, shutter=shutter))
                )
    of_1_dn = GAIN_E_PER_DN / (LIGHT_E_PER_S * TIMES_S[1])
    assert measured(tmp_path / "set")[1] > 16.0 * np.sqrt(1.0 / 12.0) * of_1_dn


@pytest.mark.parametrize("function", [measured, merged])
@pytest.mark.parametrize("width", [16, 8])
def test_padded_codes_show_over_the_whole_picture_though_a_patch_holds_one_or_two(tmp_path, width, function):
    """A dim patch reads 1008, or 1008 and 1024 DN, darkness 992 DN: u is that of a stated step of 16 DN."""
    dn = 992 + 16 * (np.arange(40 * 56).reshape(40, 56) % 5 + 40)
    dn[PATCH[1] : PATCH[1] + 16, PATCH[0] : PATCH[0] + 16] = 1024
    dn[PATCH[1] : PATCH[1] + 16, PATCH[0] : PATCH[0] + width] = 1008
    found = {}
    for step_dn in (None, 16, 4):
        camera = CAMERA.model_copy(update={"code_step_dn": step_dn})
        folder = tmp_path / f"step-{step_dn}"
        with CaptureSetWriter(folder, camera, LENS, source=SourceDescription(wavelength_nm=WAVELENGTH_NM)) as one:
            for frame, shutter in ((np.full((40, 56), 992), "closed"), (dn, "open")):
                settings = FrameSettings(TIMES_S[1], black_level_dn=BLACK_DN, shutter=shutter)
                one.add(Frame(frame.astype(np.uint16), 12, settings))
        found[step_dn] = function(folder)[1]
    assert found[None] == pytest.approx(found[16], rel=1e-6)
    assert found[4] == pytest.approx(found[16], rel=1e-6)  # contradicted


def test_a_response_says_that_it_uses_none(capture):
    """Its lowest value is black; dark frames that lie with the bracket are named as not used."""
    darks, folder = capture
    found = rm.recover_response(folder, "linear_spline")
    assert any("dark frames are not used" in text for text in found.notes) == (darks != "none")


def test_an_unstated_black_level_is_that_of_the_dark_frames(tmp_path):
    """Nothing states 500 DN: dark frames give it to 0.2 DN, from a line over time; without any the scale says so."""
    rng = np.random.default_rng(4)
    scales = {}
    for name, times in (("with", (0.1, 0.5, 2.0)), ("without", ())):
        folder = tmp_path / name
        with CaptureSetWriter(folder, CameraDescription(bit_depth=12), LENS) as writer:
            for time_s in times:
                dn = np.rint(rng.normal(BLACK_DN + 40.0 * time_s, 2.0, (24, 32))).astype(np.uint16)
                writer.add(Frame(dn, 12, FrameSettings(time_s, shutter="closed")))
            for time_s in (0.001, 0.005):
                dn = np.rint(rng.normal(BLACK_DN + 3e5 * time_s, 2.0, (24, 32))).astype(np.uint16)
                writer.add(Frame(dn, 12, FrameSettings(time_s)))
        scales[name] = rm.calibrate(folder, patch=(4, 4, 16, 16), radiance=1.0, u_rel=0.01).calibration
    assert scales["with"].black_level.dn == pytest.approx(BLACK_DN, abs=0.2)
    assert "black level by 3 dark frames" in scales["with"].provenance.assumptions
    unknown = scales["without"]
    unstated = "black level 0 DN, which nothing states: it may be up to 512 DN, which u holds"
    assert any(line.startswith(unstated) for line in unknown.provenance.assumptions)
    scene = tmp_path / "scene"
    with CaptureSetWriter(scene, CameraDescription(bit_depth=12), LENS) as writer:
        for time_s in (0.001, 0.002):
            dn = np.rint(rng.normal(BLACK_DN + 3e5 * time_s, 2.0, (24, 32))).astype(np.uint16)
            writer.add(Frame(dn, 12, FrameSettings(time_s)))
    read = rm.merge(scene, calibration=unknown)
    assert np.all(np.abs(read.value - 1.0) <= 2.0 * read.u)  # black is an eighth of full scale, as high as any


def test_the_response_of_frames_that_state_no_black_level_starts_at_that_of_their_dark_frames(tmp_path):
    """A linear camera with 500 DN of black: the curve is ln(M − 500) within k = 2 and 3 %; dim light merges with it."""
    rng, scene = np.random.default_rng(6), np.geomspace(0.05, 1.0, 32) * np.ones((24, 1))
    with CaptureSetWriter(tmp_path / "set", CameraDescription(bit_depth=12), LENS) as writer:
        for time_s in 0.0005 * 2.0 ** np.arange(7):
            for light, shutter in ((3e5 * scene, "open"), (0.0 * scene, "closed")):
                electrons = rng.poisson(light * time_s * GAIN_E_PER_DN) + rng.normal(0.0, 2.0, scene.shape)
                dn = np.clip(np.rint(BLACK_DN + electrons / GAIN_E_PER_DN), 0, 4095).astype(np.uint16)
                writer.add(Frame(dn, 12, FrameSettings(time_s, shutter=shutter)))
    found = rm.recover_response(tmp_path / "set")
    low, high = found.curve.valid_dn
    at = np.arange(max(low, int(BLACK_DN) + 20), high + 1)
    error = found.curve.log_exposure[at] - np.log((at - BLACK_DN) / (found.curve.mid_dn - BLACK_DN))
    assert np.abs(error).max() < 0.03
    assert np.mean(np.abs(error) < 2.0 * found.curve.u_log_exposure[at]) > 0.95
    assert any("black level is that of 7 dark frames" in text for text in found.notes)
    column = rm.merge(tmp_path / "set", found).value.mean(axis=0)
    assert column[0] / column[-1] == pytest.approx(0.05, rel=0.03)


def test_dark_frames_that_are_cut_off_or_fill_show_no_black_level_of_their_own():
    """Half of the noise is gone; hot pixels bend no line."""
    rng = np.random.default_rng(3)
    frames = {}
    for level in (0.0, 20.0):
        dn = np.clip(np.rint(level + rng.normal(0.0, 2.0, (24, 32))), 0, 4095).astype(np.uint16)
        settings = FrameSettings(0.01, shutter="closed")
        light = Frame(np.full((24, 32), 500, np.uint16), 12, FrameSettings(0.01))
        frames[level] = black_of_darks(Bracket.from_frames([Frame(dn, 12, settings), light]))
    assert frames[0.0] is None
    assert frames[20.0] == pytest.approx(20.0, abs=0.3)
    rate = np.where(np.arange(480) % 20 == 0, 900.0, 10.0)
    darks = [
        Frame(np.minimum(64.0 + rate * t, 4095.0).astype(np.uint16)[None], 12, FrameSettings(t, shutter="closed"))
        for t in (1.0, 4.0, 8.0, 32.0)
    ]
    light = Frame(np.full((1, 480), 500, np.uint16), 12, FrameSettings(0.01))
    several, one = Bracket.from_frames([*darks, light]), Bracket.from_frames([darks[-1], light])
    assert black_of_darks(several) == pytest.approx(64.0)
    # Of one exposure the dark current is not known apart: there a stated level counts.
    assert with_stated_black(several, 60.0) is several
    assert [f.settings.black_level_dn for f in with_stated_black(one, 60.0).light] == [60.0]


def test_light_that_may_all_be_dark_current_carries_no_scale(tmp_path):
    """Nothing states the dark current: after half a second 36,000 e⁻/s may be all of an even picture."""
    with CaptureSetWriter(tmp_path / "set", CameraDescription(bit_depth=12, black_level_dn=BLACK_DN), LENS) as writer:
        dn = np.rint(np.random.default_rng(4).normal(BLACK_DN + 1500.0, 2.0, (24, 32))).astype(np.uint16)
        for _ in range(3):
            writer.add(Frame(dn, 12, FrameSettings(0.5)))
    with pytest.raises(MeasurementError, match="dark frames of the same exposures"):
        rm.calibrate(tmp_path / "set", patch=(4, 4, 16, 16), radiance=1.0, u_rel=0.01)


def test_a_capture_is_dated_and_aged_by_when_it_was_taken(capture):
    """Ten years from its calibration, before or after: ten years of drift, and a flag; the reading has its date."""
    folder, text = capture[1], (capture[1] / "capture.yaml").read_text()
    base = calibration()
    known = replace(base, uncertainties=base.uncertainties.model_copy(update={"drift_u_rel_per_year": 0.01}))
    for year in (-10, 10):
        day = dt.datetime.fromisoformat(known.created) + dt.timedelta(days=365.25 * year)
        (folder / "capture.yaml").write_text(f"created: '{day.isoformat()}'\n{text}")
        reading = rm.measure_photographs(folder, PATCH, calibration=known, spectrum="equal_energy")
        assert dt.datetime.fromisoformat(reading.time).date() == day.date()
        assert {line.name: line.u_rel for line in reading.budget}["drift"] == pytest.approx(0.1, rel=0.01)
        assert "stale_calibration" in reading.flags
