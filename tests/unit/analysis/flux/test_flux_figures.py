"""The flux of a few pixels, worked out by hand: merging, noise, background, scale, steps to the emitted flux."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.flux.estimate import led_flux
from radiometer.analysis.flux.report import Emitter
from radiometer.analysis.flux.sensor import SensorFlux, flux_scale, sensor_flux
from radiometer.data import CameraDescription, Frame, FrameSettings, LensDescription, Patch, Quantity, SourceDescription
from radiometer.data.calibration import StatedUncertainties
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError, UsageError
from testing.relatively import relatively

# 2 electrons per DN, of 0.5 electrons per photon of 500 nm on (10 µm)²: 4 photons stand behind a DN above black.
CAMERA = CameraDescription(
    bit_depth=12, pixel_pitch_um=10.0, conversion_gain_e_per_dn=2.0, quantum_efficiency=0.5, read_noise_e=3.0,
    full_well_e=9000.0, dark_current_e_per_s=0.0, black_level_dn=100.0,
)  # fmt: skip
SOURCE = SourceDescription(kind="led", wavelength_nm=500.0)
JOULE = 4.0 * 6.62607015e-34 * 299_792_458.0 / 500e-9  # per DN and pixel
SHAPE = (100, 40)


def frame(dn: np.ndarray | float, exposure_s: float, *, level: float = 1.0) -> Frame:
    numbers = np.broadcast_to(np.asarray(dn), SHAPE).astype(np.uint16)
    return Frame(numbers, 12, FrameSettings(exposure_s, black_level_dn=100.0, source_level=level, f_number=4.0))


def flux_of(*frames: Frame, region: Patch | None = None) -> SensorFlux:
    return sensor_flux(frames, flux_scale(Setup(CAMERA, source=SOURCE)), region)


def test_the_flux_is_that_of_all_light_by_all_time() -> None:
    """200 DN in 1 ms and 400 DN in 2 ms on 4000 pixels: 600 DN in 3 ms each, whatever the order of the frames."""
    off = frame(100, 1e-3, level=0.0)
    measured = flux_of(frame(500, 2e-3), frame(300, 1e-3), off)
    assert measured.merged_w == relatively(4000 * 600 * JOULE / 3e-3, rel=1e-9)
    # Of each frame shot noise of its electrons, reading and rounding, in DN².
    variance = (200 / 2 + (3 / 2) ** 2 + 1 / 12) + (400 / 2 + (3 / 2) ** 2 + 1 / 12)
    assert measured.u_noise_w == relatively(math.sqrt(4000 * variance) * JOULE / 3e-3, rel=1e-6)
    assert measured.background_w == pytest.approx(0.0, abs=1e-20)
    assert measured.background_source == "frames with the source off"
    dark_noise = math.sqrt(4000 * ((3 / 2) ** 2 + 1 / 12)) * JOULE / 1e-3
    assert measured.u_background_w == relatively(dark_noise, rel=1e-6)
    assert measured.clipped_everywhere == 0


def test_a_pixel_counts_the_frames_in_which_it_does_not_clip() -> None:
    """One that clips at 2 ms has the light of 1 ms alone; one that clips in both is at least full scale in 1 ms."""
    short, long = np.full(SHAPE, 300), np.full(SHAPE, 500)
    long[50, 20] = 4095
    short[60, 20] = long[60, 20] = 4095
    measured = flux_of(frame(short, 1e-3), frame(long, 2e-3), frame(100, 1e-3, level=0.0))
    irradiance = measured.irradiance * 1e-10 / JOULE  # DN per s
    assert irradiance[0, 0] == relatively(600 / 3e-3)
    assert irradiance[50, 20] == relatively(200 / 1e-3)
    assert irradiance[60, 20] == relatively(3995 / 1e-3)
    assert measured.clipped_everywhere == 1
    rest = (3 / 2) ** 2 + 1 / 12
    variance = 3998 * (600 / 2 + 2 * rest) / 3e-3**2 + (200 / 2 + rest) / 1e-3**2  # nothing is known of the third
    assert measured.u_noise_w == relatively(math.sqrt(variance) * JOULE, rel=1e-6)


def test_the_background_of_a_room_is_that_of_frames_with_the_source_off() -> None:
    """10 DN in 1 ms without the source are taken off, whatever the rim of the lit picture shows."""
    measured = flux_of(frame(300, 1e-3), frame(110, 1e-3, level=0.0), frame(130, 3e-3, level=0.0))
    assert measured.background_w == relatively(4000 * 40 * JOULE / 4e-3, rel=1e-9)
    region = Patch(4, 10, 5, 8)
    of_region = flux_of(frame(300, 1e-3), frame(110, 1e-3, level=0.0), region=region)
    assert of_region.merged_w == relatively(40 * 200 * JOULE / 1e-3, rel=1e-9)
    assert of_region.background_w == relatively(40 * 10 * JOULE / 1e-3, rel=1e-9)
    variance = 10 / 2 + (3 / 2) ** 2 + 1 / 12
    assert of_region.u_background_w == relatively(math.sqrt(40 * variance) * JOULE / 1e-3, rel=1e-6)


def test_hot_pixels_are_no_light_of_the_diode() -> None:
    """Dark frames of the exposure are taken off pixel by pixel; the noise of one that two frames share counts twice."""
    hot = np.full(SHAPE, 100.0)
    hot[20:24] = 900.0
    hot[::2] += 2.0  # the noise that rounding needs
    dark = replace(frame(hot, 1e-3), settings=replace(frame(hot, 1e-3).settings, shutter="closed"))
    lit, off = (frame(hot + more, 1e-3, level=level) for more, level in ((200, 1.0), (0, 0.0)))
    measured = flux_of(lit, dark)
    assert measured.merged_w == relatively(4000 * 200 * JOULE / 1e-3, rel=1e-6)
    most_e = 1e-5 * 100e-12 / 1.602176634e-19 * 1e-3  # 1 nA/cm² of 100 µm² for 1 ms: no dark current is above it
    twice, rest = flux_of(lit, lit, off, dark), (3 / 2) ** 2 + 1 / 12 + most_e / 2**2
    # Of 160 hot pixels 768 DN above the mean and 799 above the others, at 2 e⁻/DN: in each light frame, in the dark.
    light, of_dark = 768 / 2, 799 / 2
    hot_pixels = 160 * (light / 2 + of_dark)
    expected = math.sqrt(4000 * ((200 / 2 + rest) / 2 + rest) + hot_pixels)
    assert twice.u_noise_w == relatively(expected * JOULE / 1e-3, rel=2e-3)


def rimmed(top: float, bottom: float, left: float, right: float) -> np.ndarray:
    """Return a picture of 300 DN with a rim of two pixels (a twentieth of its 40 columns) of other values."""
    dn = np.full(SHAPE, 300.0)
    dn[:, :2], dn[:, -2:] = left, right
    dn[:2], dn[-2:] = top, bottom
    return dn


def test_without_such_frames_the_rim_is_the_background() -> None:
    """Its median counts; half the spread of its sides' medians and what its mean is above are every pixel's doubt."""
    dn = rimmed(110, 130, 112, 114)
    dn[99, 5] = 4000  # a defect moves no median
    measured = flux_of(frame(dn, 1e-3))
    assert measured.background_source == "outermost twentieth of the frame"
    assert measured.background_w == relatively(4000 * 13 * JOULE / 1e-3, rel=1e-9)  # between 112 and 114 DN
    mean = (80 * (10 + 30) + 192 * (12 + 14) + 3900 - 30) / 544
    spread = math.hypot((30 - 10) / 2, mean - 13)
    assert measured.u_background_w == relatively(4000 * spread * JOULE / 1e-3, rel=1e-9)
    region = Patch(4, 10, 5, 8)
    assert flux_of(frame(dn, 1e-3), region=region).background_w == relatively(40 * 13 * JOULE / 1e-3, rel=1e-9)


def test_an_even_rim_is_known_by_the_scatter_of_its_pixels() -> None:
    """Sides alike, 110 and 114 DN in turn: σ = 2 DN of 544 pixels is 0.086 DN for every pixel of the sum."""
    checks = np.where(np.indices(SHAPE).sum(axis=0) % 2 == 0, 110.0, 114.0)
    dn = np.where(rimmed(0, 0, 0, 0) == 0, checks, 300.0)
    measured = flux_of(frame(dn, 1e-3))
    assert measured.u_background_w == relatively(4000 * 2.0 / math.sqrt(544) * JOULE / 1e-3, rel=1e-9)


def test_one_photograph_stands_for_all_by_the_thesis() -> None:
    """Of four frames the second smallest figure is taken; values at 0 and full scale are left out and counted."""
    exposures = {2e-3: 500, 1e-3: 300, 4e-3: 1300, 8e-3: 3300}  # 200, 200, 300 and 400 DN per ms
    frames = [frame(np.where(np.indices(SHAPE)[0] < 10, 4095, dn), t) for t, dn in exposures.items()]
    frames[1] = frame(np.where(np.indices(SHAPE)[0] < 25, 0, 290), 1e-3)
    report = led_flux(frames, flux_scale(Setup(CAMERA, source=SOURCE)))
    assert report.thesis_exposure_s == 2e-3
    assert report.thesis.value == relatively(3600 * 200 * JOULE / 1e-3, rel=1e-9)
    assert report.thesis_left_out == relatively(0.1)
    by_exposure = {one[0]: one for one in flux_of(*frames).thesis}
    assert by_exposure[1e-3][1] == relatively(3000 * 190 * JOULE / 1e-3, rel=1e-9)
    assert by_exposure[1e-3][2] == relatively(0.25)


def test_noise_and_background_stay_in_the_light_before_the_lens() -> None:
    """Behind the lens 90 ± 2 %: both noises, the scale's doubt and the lens's add in squares, all grown by 1/0.9."""
    frames = [frame(rimmed(110, 130, 112, 114), 1e-3)]
    lens = LensDescription(focal_length_mm=20.0, f_number=4.0, transmittance=0.9, transmittance_u_rel=0.02)
    emitter = Emitter(Quantity(20.0, 0.0, "°"), None, Quantity(80.0, 0.0, "mm"))
    scale = flux_scale(Setup(CAMERA, lens, None, SOURCE))
    report = led_flux(frames, scale, emitter)
    steps = {step.name: step.flux for step in report.corrections}
    measured = flux_of(*frames)
    on_sensor = measured.merged_w - measured.background_w
    of_scale = math.hypot(0.03, 1e-4)  # the description's, and that of exposure times
    assert steps["clipped pixels from shorter exposures"].u == relatively(
        math.hypot(measured.merged_w * of_scale, measured.u_noise_w), rel=1e-6
    )
    assert report.on_sensor.value == relatively(on_sensor, rel=1e-12)
    noise = math.hypot(measured.u_noise_w, measured.u_background_w)
    assert report.on_sensor.u == relatively(math.hypot(on_sensor * of_scale, noise), rel=1e-6)
    behind = steps["light lost in the lens"]
    assert behind.value == relatively(on_sensor / 0.9, rel=1e-12)
    assert behind.u == relatively(math.hypot(on_sensor * of_scale, noise, on_sensor * 0.02) / 0.9, rel=1e-6)


def bright(rows: int, columns: int = SHAPE[1]) -> np.ndarray:
    """Return where a picture is bright: so many rows from 25 on, so many columns from 0 or, of a spot, from 20 on."""
    row, column = np.indices(SHAPE)
    first = 0 if columns == SHAPE[1] else 20
    return (row >= 25) & (row < 25 + rows) & (column >= first) & (column < first + columns)


@pytest.mark.parametrize(
    ("dn", "seen"),
    [
        (np.where(bright(40), 900.0, np.where(bright(50), 500.0, 100.0)), True),
        (np.where(bright(20), 900.0, np.where(bright(50), 500.0, 100.0)), False),
        (np.where(bright(3, 3), 900.0, 100.0), True),
        (np.where(bright(2, 2), 900.0, 100.0), False),
    ],
    ids=["plateau", "blur", "three by three", "two by two"],
)
def test_a_diode_with_a_plateau_has_a_radiance(dn: np.ndarray, seen: bool) -> None:
    """40 of 50 lit rows are one, 20 a blur; of 3 × 3 pixels one is lit all around, of 2 × 2 each may be the rim's."""
    lens = LensDescription(focal_length_mm=20.0, f_number=4.0, magnification=0.3)
    emitter = Emitter(Quantity(20.0, 0.0, "°"), Quantity(3.0, 0.0, "mm"), Quantity(80.0, 0.0, "mm"))
    frames = [frame(dn, 1e-3), frame(100, 1e-3, level=0.0)]
    emitted = led_flux(frames, flux_scale(Setup(CAMERA, lens, None, SOURCE)), emitter).emitted
    assert ("radiance_times_area" in emitted) is seen


def test_a_lens_that_states_nothing_takes_nothing() -> None:
    """Without a stated transmittance all the light that reaches the lens reaches the sensor."""
    frames = [frame(rimmed(100, 100, 100, 100), 1e-3)]
    emitter = Emitter(Quantity(20.0, 0.0, "°"), None, Quantity(80.0, 0.0, "mm"))
    open_lens = LensDescription(focal_length_mm=20.0, f_number=4.0)
    half = open_lens.model_copy(update={"transmittance": 0.5})
    plain, darkened = (
        led_flux(frames, flux_scale(Setup(CAMERA, one, None, SOURCE)), emitter) for one in (open_lens, half)
    )
    steps = {step.name: step.flux for step in plain.corrections}
    assert steps["light lost in the lens"].value == relatively(plain.on_sensor.value, rel=1e-12)
    assert darkened.emitted["fraction_through_pupil"].value == relatively(
        2.0 * plain.emitted["fraction_through_pupil"].value, rel=1e-12
    )


def test_the_scale_of_a_calibration_is_its_own(rig) -> None:
    """J·m⁻² per DN and its uncertainty, the spectrum's next to it, are the calibration's, and its spectrum is named."""
    calibration = rig.calibration(
        u_rel=0.003, uncertainties=StatedUncertainties(spectral_u_rel=0.004, temperature_u_rel_per_k=0.0)
    )
    camera = calibration.camera.model_copy(update={"pixel_pitch_um": 4.5})
    calibration = replace(calibration, camera=camera)
    settings = [FrameSettings(0.01, f_number=calibration.scale.f_number)]
    scale = flux_scale(Setup(camera, calibration.lens, calibration), settings)
    assert scale.joule_per_m2 == relatively(rig.true_scale, rel=1e-12)
    assert scale.u_rel == relatively(0.005, rel=1e-12)
    assert scale.pixel_area_m2 == relatively(4.5e-6**2)
    assert scale.assumptions == ("spectrum equal_energy",)
    with pytest.raises(CalibrationError, match="serial"):
        flux_scale(Setup(camera.model_copy(update={"serial": "2"}), calibration.lens, calibration))
    relative = calibration.scale.model_copy(update={"method": "relative"})
    for lacking in (relative, calibration.scale.model_copy(update={"f_number": None})):
        with pytest.raises(CalibrationError, match="no exposure on the sensor"):
            flux_scale(Setup(camera, calibration.lens, replace(calibration, scale=lacking)))


def test_the_scale_of_a_description_is_four_photons_a_pixel() -> None:
    """c·h·ν/(η·A) with A by the pitch; the flux sums over the spacing of the pixels that are read."""
    scale = flux_scale(Setup(CAMERA, source=SOURCE))
    assert scale.joule_per_m2 == relatively(JOULE / 1e-10, rel=1e-12)
    assert scale.u_rel == 0.03
    binned = flux_scale(
        Setup(CAMERA.model_copy(update={"pixel_spacing_um": 20.0}), source=SOURCE), responsivity_u_rel=0.01
    )
    assert binned.joule_per_m2 == scale.joule_per_m2
    assert binned.pixel_area_m2 == relatively(4e-10)
    assert (binned.u_rel, binned.assumptions) == (0.01, ())


def test_what_misses_a_small_pupil_is_as_doubtful_as_twice_its_f_number():
    """A pupil of 5 mm at 80 mm takes in a part that goes as 1/N²: 2 % of N, taken unless told, are 4 % of the flux."""
    frames = [frame(rimmed(100, 100, 100, 100), 1e-3)]
    lens = LensDescription(focal_length_mm=20.0, f_number=4.0)
    emitter = Emitter(Quantity(60.0, 0.0, "°"), None, Quantity(80.0, 0.0, "mm"))
    found = [
        led_flux(frames, flux_scale(Setup(CAMERA, lens, None, SOURCE)), emitter, **stated).emitted
        for stated in ({"f_number_u_rel": 0.0}, {"f_number_u_rel": 0.01}, {})
    ]
    sharp, doubtful, untold = (one["fraction_through_pupil"] for one in found)
    assert doubtful.value == relatively(sharp.value, rel=1e-12)
    added = math.sqrt(doubtful.u**2 - sharp.u**2) / doubtful.value
    assert added == relatively(0.02, rel=0.01)
    assert math.sqrt(untold.u**2 - sharp.u**2) / untold.value == relatively(0.04, rel=0.01)


@pytest.mark.parametrize(("stated", "added"), [(None, 0.0), (0.0, 0.0), (0.03, 0.03)])
def test_a_radiance_is_as_doubtful_as_the_lens(stated: float | None, added: float) -> None:
    """What is stated of the transmittance adds in squares to the rest; nothing stated adds nothing."""
    rows = np.indices(SHAPE)[0]
    frames = [frame(np.where((rows > 20) & (rows < 80), 900.0, 100.0), 1e-3), frame(100, 1e-3, level=0.0)]
    emitter = Emitter(Quantity(20.0, 0.0, "°"), Quantity(3.0, 0.0, "mm"), Quantity(80.0, 0.0, "mm"))
    lens = LensDescription(focal_length_mm=20.0, f_number=4.0, magnification=0.3, transmittance=0.9)

    def found(u_rel: float | None) -> Quantity:
        one = lens.model_copy(update={"transmittance_u_rel": u_rel})
        return led_flux(frames, flux_scale(Setup(CAMERA, one, None, SOURCE)), emitter).emitted["radiance_times_area"]

    assert found(stated).u_rel == relatively(math.hypot(found(0.0).u_rel, added), rel=1e-3)


@pytest.mark.parametrize(("side", "rim"), [(39, 1), (40, 2), (59, 2), (60, 3), (12, 1)])
def test_the_rim_is_a_twentieth_of_the_shorter_side(side: int, rim: int) -> None:
    """One pixel at least: what lies within it is the background, what lies inside is not."""
    for shape in ((side, 80), (80, side)):
        dn = np.full(shape, 500, np.uint16)
        for k in range(rim):
            dn[k], dn[-1 - k], dn[:, k], dn[:, -1 - k] = 110, 110, 110, 110
        picture = Frame(dn, 12, FrameSettings(1e-3, black_level_dn=100.0, source_level=1.0))
        measured = flux_of(picture)
        assert measured.background_w == relatively(dn.size * 10 * JOULE / 1e-3, rel=1e-9)
        assert measured.u_background_w == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("magnification", [0.01, 0.05, 0.2, 1.0])
@pytest.mark.parametrize(("factor", "taken"), [(1.0, True), (1.2, True), (0.1, False), (0.001, False), (10.0, False)])
def test_a_distance_that_the_lens_excludes_is_refused(magnification: float, factor: float, taken: bool) -> None:
    """One in cm or m, or of another set-up; a thick lens is not at exactly f·(1 + 1/m)."""
    lens = LensDescription(focal_length_mm=16.0, f_number=4.0, magnification=magnification)
    away = Quantity(factor * 16.0 * (1.0 + 1.0 / magnification), 0.01 * factor, "mm")
    emitter = Emitter(Quantity(60.0, 0.0, "°"), None, away)
    frames, scale = [frame(500, 1e-3), frame(100, 1e-3, level=0.0)], flux_scale(Setup(CAMERA, lens, None, SOURCE))
    if taken:
        assert led_flux(frames, scale, emitter).emitted
        return
    with pytest.raises(UsageError, match=r"lens\.magnification"):
        led_flux(frames, scale, emitter)
