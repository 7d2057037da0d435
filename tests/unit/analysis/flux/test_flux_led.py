"""Flux of LEDs, steady and patterned."""

import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.flux.estimate import (
    captured_fraction,
    flux_of_radiance,
    intensity_exponent,
    led_flux,
    mean_to_axial_radiance,
    pupil_half_angle_rad,
    spread_by_pedestal,
)
from radiometer.analysis.flux.report import Emitter, FluxReport
from radiometer.analysis.flux.sensor import flux_scale, sensor_flux
from radiometer.data import CameraDescription, Frame, FrameSettings, LensDescription, Patch, Quantity
from radiometer.data import setup as measuring
from radiometer.errors import CalibrationError, MeasurementError, UsageError
from simulators.chain.camera_model import CameraModel, VirtualSensor
from simulators.scenes import LedScene

CAMERA = CameraDescription(
    bit_depth=12,
    pixel_pitch_um=18.0,
    conversion_gain_e_per_dn=20.0,
    read_noise_e=10.0,
    full_well_e=90_000,
    dark_current_e_per_s=1.0,
    black_level_dn=64,
    quantum_efficiency=0.6,
)

SIDE = 96


@dataclass(frozen=True)
class Setup:
    """A diode in front of a lens, everything in true values."""

    flux_mW: float = 5.0  # noqa: N815
    half_angle_deg: float = 15.0
    diameter_mm: float = 3.0
    distance_mm: float = 80.0
    focal_length_mm: float = 20.0
    f_number: float = 4.0
    transmittance: float = 0.9
    background: float = 0.0
    blur_px: float = 0.0
    seed: int = 0

    @property
    def magnification(self) -> float:
        return self.focal_length_mm / (self.distance_mm - self.focal_length_mm)

    @property
    def lens(self) -> LensDescription:
        return LensDescription(
            focal_length_mm=self.focal_length_mm,
            f_number=self.f_number,
            transmittance=self.transmittance,
            transmittance_u_rel=0.02,
            magnification=self.magnification,
        )

    def scene(self) -> LedScene:
        pupil_mm = self.focal_length_mm / self.f_number
        return LedScene(
            flux_mW=self.flux_mW,
            emitter_diameter_mm=self.diameter_mm,
            half_angle_deg=self.half_angle_deg,
            pupil_half_angle_deg=math.degrees(math.atan(pupil_mm / 2 / self.distance_mm)),
            diameter_px=self.diameter_mm * self.magnification / 18e-3,
            blur_px=self.blur_px,
            background_W_per_sr_m2=self.background,
            wavelength_nm=590.0,
        )

    def frames(self, saturations: tuple[float, ...] = (0.1, 0.4, 1.6, 6.0), off: bool = False) -> list[Frame]:
        """Return frames whose plateau comes to the given multiples of full scale."""
        model, scene = CameraModel.ideal(CAMERA, self.lens, 590.0), self.scene()
        sensor = VirtualSensor(model, scene, SIDE, SIDE, seed=self.seed)
        irradiance = math.pi * self.transmittance * (scene.seen_radiance + self.background)
        irradiance /= 4 * (self.f_number * (1 + self.magnification)) ** 2
        photon_j = 6.62607015e-34 * 299_792_458.0 / 590e-9
        full_s = 4031 * 20.0 / (0.6 * irradiance * (18e-6) ** 2 / photon_j)
        levels = (1.0, 0.0) if off else (1.0,)
        settings = [
            FrameSettings(share * full_s, 0.0, self.f_number, 64.0, 25.0, source_level=level)
            for share in saturations
            for level in levels
        ]
        return [Frame(sensor.expose(one), 12, one) for one in settings]


def _report(setup: Setup, emitter: Emitter, frames: list[Frame], lens: LensDescription | None = None) -> FluxReport:
    scale = replace(flux_scale(measuring.Setup(CAMERA, lens or setup.lens, None, setup.scene().source)), u_rel=0.0)
    return led_flux(frames, scale, emitter, f_number_u_rel=0.0)


def _emitter(setup: Setup, reference: bool = True) -> Emitter:
    return Emitter(
        Quantity(setup.half_angle_deg, 0.0, "°"),
        Quantity(setup.diameter_mm, 0.0, "mm"),
        Quantity(setup.distance_mm, 0.0, "mm"),
        setup.flux_mW * 1e-3 if reference else None,
    )


@pytest.mark.parametrize("half_angle", [8.0, 20.0, 60.0])
def test_both_ways_find_the_emitted_flux(half_angle: float) -> None:
    """With everything known, flux through the pupil and radiance × area are right within 0.5 % (pixel grid)."""
    setup = Setup(half_angle_deg=half_angle)
    report = _report(setup, _emitter(setup), setup.frames())
    assert set(report.emitted) == {"fraction_through_pupil", "radiance_times_area"}
    for flux in report.emitted.values():
        assert flux.value == pytest.approx(5e-3, rel=5e-3)


def test_the_pattern_s_shape_is_in_the_uncertainty() -> None:
    """At 20° (m = 11.1) a Lambertian part of 5 % spreads 25 % more flux; a Lambertian emitter has nothing to doubt."""
    narrow, wide = (Setup(half_angle_deg=angle) for angle in (20.0, 60.0))
    beam, lambertian = (_report(one, _emitter(one), one.frames()).emitted for one in (narrow, wide))
    exponent = math.log(0.5) / math.log(math.cos(math.radians(20.0)))
    shape = 0.05 * (0.5 * (exponent + 1.0) - 1.0)
    for name, flux in beam.items():
        rest = lambertian[name].u / lambertian[name].value
        assert math.sqrt((flux.u / flux.value) ** 2 - shape**2) == pytest.approx(rest, rel=0.15)


def test_defocused_diode_is_measured_through_the_pupil() -> None:
    """Defocus spreads the light but keeps its sum; the picture has no plateau, so its radiance is not used."""
    setup = Setup(blur_px=30.0)
    report = _report(setup, _emitter(setup), setup.frames())
    assert set(report.emitted) == {"fraction_through_pupil"}
    assert report.result.value == pytest.approx(5e-3, rel=5e-3)


def test_thesis_formula_loses_the_clipped_pixels_and_the_gap_closes() -> None:
    """On a set-up like the thesis's (5 mW, narrow beam, clipped centre) one photograph finds about a fifth of 5 mW.

    Clipped pixels, lens losses and light that missed the lens then close the whole gap within 2 %.
    """
    setup = Setup(half_angle_deg=7.5, f_number=1.7, distance_mm=40.0, diameter_mm=0.5, blur_px=25.0)
    report = _report(setup, _emitter(setup), setup.frames((0.5, 1.2, 1.8, 2.4, 4.0)))
    assert report.thesis_left_out > 0.02
    assert 0.1 < report.thesis.value / 5e-3 < 0.4
    shares = {step.name: step.share for step in report.corrections}
    assert shares["clipped pixels from shorter exposures"] > 0.2
    assert shares["light that missed the lens"] > 0.2
    assert sum(shares.values()) == pytest.approx(1.0, abs=0.02)


def test_distance_follows_from_the_magnification_where_it_is_not_given() -> None:
    """A thin lens at magnification m lies f·(1 + 1/m) from the diode; the report says that it was assumed."""
    setup = Setup(half_angle_deg=60.0)
    emitter = replace(_emitter(setup), distance_mm=None)
    report = _report(setup, emitter, setup.frames())
    assert report.result.value == pytest.approx(5e-3, rel=5e-3)
    assert any("80 mm from focal length and magnification" in note for note in report.assumptions)


def test_flux_of_a_bracket_that_always_clips_is_flagged_as_a_lower_bound() -> None:
    """Where the plateau clips in every frame the report carries `saturated` and falls short of the truth."""
    setup = Setup(half_angle_deg=60.0)
    report = _report(setup, _emitter(setup), setup.frames((1.5, 6.0)))
    assert report.clipped_everywhere > 100
    assert report.to_mapping()["flags"] == ["saturated"]
    assert report.result.value < 5e-3
    assert _report(setup, _emitter(setup), setup.frames()).to_mapping()["flags"] == []


@pytest.mark.parametrize("cut", [True, False])
def test_a_diode_that_the_region_or_the_picture_cuts_is_a_lower_bound(cut: bool) -> None:
    """Half of the diode alone is in the region: what lies beyond is missing, and the report says so."""
    setup = Setup()
    region = Patch(0, 0, SIDE // 2 if cut else SIDE, SIDE)
    scale = flux_scale(measuring.Setup(CAMERA, setup.lens, None, setup.scene().source))
    warnings = led_flux(setup.frames(), scale, region=region).warnings
    assert any("beyond the edge" in one for one in warnings) == cut


def test_without_an_emitter_only_the_flux_on_the_sensor_is_given() -> None:
    """Nothing is claimed of what the diode emits."""
    setup = Setup()
    scale = flux_scale(measuring.Setup(CAMERA, setup.lens, None, setup.scene().source))
    report = led_flux(setup.frames(), scale)
    assert report.emitted == {}
    assert report.result == report.on_sensor
    assert any("taken as known to 3 %" in note for note in report.assumptions)


def test_stated_intervals_hold_the_true_flux_in_random_set_ups() -> None:
    """In 30 random set-ups, all figures off by their stated u, k = 2 holds the flux in 28; half of it in some 20."""
    rng = np.random.default_rng(515)
    hits = 0
    for number in range(30):
        true = Setup(
            flux_mW=float(rng.uniform(1, 20)),
            half_angle_deg=float(rng.uniform(10, 60)),
            diameter_mm=float(rng.uniform(2, 4)),
            distance_mm=float(rng.uniform(70, 150)),
            f_number=float(rng.uniform(2, 8)),
            transmittance=float(rng.uniform(0.85, 0.95)),
            blur_px=float(rng.choice([0.0, 12.0])),
            seed=number,
        )
        scatter = rng.standard_normal(5)
        believed = CAMERA.model_copy(update={"quantum_efficiency": 0.6 * (1 + 0.03 * scatter[0])})
        f_number = true.f_number * (1 + 0.02 * scatter[1])
        lens = true.lens.model_copy(update={"transmittance": min(1.0, true.transmittance * (1 + 0.02 * scatter[2]))})
        emitter = Emitter(
            Quantity(true.half_angle_deg + 1.0 * scatter[3], 1.0, "°"),
            None,
            Quantity(true.distance_mm + 0.5 * scatter[4], 0.5, "mm"),
        )
        frames = [replace(f, settings=replace(f.settings, f_number=f_number)) for f in true.frames()]
        scale = flux_scale(measuring.Setup(believed, lens, None, true.scene().source))
        result = led_flux(frames, scale, emitter, f_number_u_rel=0.02).result
        hits += abs(result.value - true.flux_mW * 1e-3) <= 2 * result.u
    assert hits >= 28


def test_saturated_brackets_and_missing_figures_are_refused() -> None:
    """Each lack is named: all clipped, no lit frame, no quantum efficiency, an impossible half angle."""
    setup = Setup(half_angle_deg=60.0)
    scale = flux_scale(measuring.Setup(CAMERA, setup.lens, None, setup.scene().source))
    frames = setup.frames((50.0,))
    dark = [replace(f, settings=replace(f.settings, shutter="closed")) for f in frames]
    with pytest.raises(MeasurementError, match=r"clips in every frame"):
        sensor_flux(frames, scale, Patch(44, 44, 8, 8))
    with pytest.raises(MeasurementError, match="no frame of the lit source"):
        sensor_flux(dark, scale)
    with pytest.raises(MeasurementError, match="is not on the frame"):
        sensor_flux(frames, scale, Patch(90, 0, 20, 8))
    with pytest.raises(CalibrationError, match=r"give --calibration"):
        flux_scale(measuring.Setup(CameraDescription(bit_depth=12, pixel_pitch_um=18.0), source=setup.scene().source))


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"distance": 0.5}, r"--distance 0\.5 mm: known to ± 0\.5 mm"),
        ({"distance": 1e300}, r"distance .*from 0\.001 to 1e\+09 mm"),
        ({"half_angle": 1e-9}, "half_angle .*from 0.1 to 180 °"),
    ],
)
def test_lengths_and_angles_that_cannot_be_are_refused(how: dict[str, float], message: str) -> None:
    """Metres typed in place of mm, before any frame is read: a distance of its own u is no distance."""
    with pytest.raises(UsageError, match=message):
        rm.flux("nowhere", **({"half_angle": 60.0, "distance": 336.0, "diameter": 3.0} | how))


def test_the_step_through_the_pupil_says_what_share_it_takes_in() -> None:
    """The share in words is the flux behind the pupil over the emitted one."""
    setup = Setup()
    report = _report(setup, _emitter(setup), setup.frames())
    flux = {one.name: one.flux.value for one in report.corrections}
    (note,) = [one.note for one in report.corrections if one.name == "light that missed the lens"]
    share = float(re.search(r"takes in ([\d.e-]+) %", note)[1])
    assert share == pytest.approx(100.0 * flux["light lost in the lens"] / flux["light that missed the lens"], rel=0.01)


@pytest.mark.parametrize("half_angle", [8.0, 15.0, 60.0])
def test_intensity_is_one_half_at_the_half_angle(half_angle: float) -> None:
    """cosᵐθ½ is 1/2 by definition; of 60° m is 1, which is Lambertian: Φ = π·A·L."""
    exponent = intensity_exponent(half_angle)
    assert math.cos(math.radians(half_angle)) ** exponent == pytest.approx(0.5, rel=1e-12)
    if half_angle == 60.0:
        assert exponent == pytest.approx(1.0, rel=1e-12)
        assert flux_of_radiance(10.0, 2e-6, exponent) == pytest.approx(math.pi * 2e-6 * 10.0, rel=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 20.0, 80.0])
@pytest.mark.parametrize("angle", [0.02, 0.1, 0.5])
def test_fraction_is_the_integral_of_the_pattern(exponent: float, angle: float) -> None:
    """Numerical integration of (m + 1)/(2π)·cosᵐθ over the cone gives the same fraction."""
    theta = np.linspace(0.0, angle, 20_001)
    pattern = (exponent + 1) / (2 * np.pi) * np.cos(theta) ** exponent
    integral = np.trapezoid(pattern * 2 * np.pi * np.sin(theta), theta)
    assert captured_fraction(exponent, angle) == pytest.approx(integral, rel=1e-6)


def test_small_pupil_sees_the_axial_radiance() -> None:
    """The correction from mean to axial radiance goes to 1 with the pupil's angle."""
    assert mean_to_axial_radiance(80.0, 1e-4) == pytest.approx(1.0, abs=1e-5)
    assert mean_to_axial_radiance(80.0, 0.1) > 1.1


def test_pupil_angle_is_that_of_a_right_triangle() -> None:
    """A pupil of 20 mm at 10 mm subtends 45° to each side."""
    assert pupil_half_angle_rad(20.0, 10.0) == pytest.approx(math.pi / 4)


@pytest.mark.parametrize("half_angle", [0.0, 90.0, -5.0])
def test_impossible_half_angles_are_refused(half_angle: float) -> None:
    """The message gives the value and the limits."""
    with pytest.raises(UsageError, match=r"half angle .* is out of range"):
        intensity_exponent(half_angle)


@pytest.mark.parametrize("pedestal", [0.0, 0.05, 0.1])
def test_a_lambertian_pedestal_spreads_flux_that_the_axis_does_not_show(pedestal: float) -> None:
    """Against the integral of (1 − p)·cosᵐθ + p·cosθ over the half space, m = 12; none for a Lambertian emitter."""
    theta = np.linspace(0.0, np.pi / 2.0, 20_001)
    beam = np.cos(theta) ** 12
    whole, alone = (
        np.trapezoid(intensity * np.sin(theta), theta)
        for intensity in ((1 - pedestal) * beam + pedestal * np.cos(theta), beam)
    )
    assert spread_by_pedestal(12.0, pedestal) == pytest.approx(whole / alone, rel=1e-6)
    assert spread_by_pedestal(1.0, pedestal) == pytest.approx(1.0)
