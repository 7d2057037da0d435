"""What else the analysis makes of frames: fluxes, a camera's figures, scales, flat fields, quality, photometry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.calibration.absolute import MeterSettings
from radiometer.analysis.calibration.calibrate import (
    KnownSource,
    MeterReading,
    scale_by_meter,
    scale_by_source,
    scaled_calibration,
    scales_ratio,
    unscaled_calibration,
)
from radiometer.analysis.calibration.flat_field import fit_flat_field
from radiometer.analysis.characterise.characterise import characterise
from radiometer.analysis.characterise.frame_groups import FrameGroup
from radiometer.analysis.characterise.photon_flux import PhotonFlux
from radiometer.analysis.characterise.report import meaning, outcome
from radiometer.analysis.characterise.subject import Subject
from radiometer.analysis.flux.estimate import led_flux
from radiometer.analysis.flux.report import Emitter
from radiometer.analysis.flux.sensor import flux_scale
from radiometer.analysis.photometry.photometry import (
    luminance_cd_m2,
    luminous_efficacy_lm_per_w,
    radiance_thesis_w_sr_m2_um,
    retinal_illuminance_td,
    spectral_mismatch_factor,
)
from radiometer.analysis.photometry.spectra import SPECTRUM_NAMES, spectrum
from radiometer.analysis.photometry.unstated_light import unstated_light_u_rel
from radiometer.analysis.quality import indices, spatial
from radiometer.analysis.quality.signals import StepSignal
from radiometer.analysis.quality.spectral import v_lambda_mismatch
from radiometer.analysis.uncertainty.budget import Term
from radiometer.data import (
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    Quantity,
    RadianceMap,
    SourceDescription,
)
from radiometer.errors import UsageError
from tests.unit.held import world
from tests.unit.held.figures import digest, moved

LED = SourceDescription(kind="led", wavelength_nm=627.0)


def disc(number: int, exposure_s: float, level: float = 1.0) -> Frame:
    """Return a frame of a bright disc in a weak glow."""
    rows, columns = np.indices((64, 48))
    inside = (rows - 30.0) ** 2 + (columns - 22.0) ** 2 < 100.0
    rng = np.random.default_rng([7, number])
    electrons = rng.poisson((level * (3e6 * inside + 4e4) + 900.0) * exposure_s) + rng.normal(0, 3.1, rows.shape)
    dn = np.clip(np.rint(np.minimum(electrons, 10_500.0) / 2.6 + 64.0), 0, 4095).astype(np.uint16)
    return Frame(dn, 12, FrameSettings(exposure_s, f_number=4.0, black_level_dn=64.0, source_level=level))


def described(flux: Any) -> dict[str, Any]:
    return dict(flux.to_mapping())


EMITTERS = {
    "none": None,
    "half_angle": Emitter(Quantity(20.0, 1.0, "deg")),
    "area": Emitter(Quantity(20.0, 1.0, "deg"), Quantity(3.0, 0.05, "mm"), None, 2e-4),
    "whole": Emitter(Quantity(35.0, 2.0, "deg"), Quantity(3.0, 0.05, "mm"), Quantity(150.0, 1.0, "mm"), 2e-4),
    "distance": Emitter(Quantity(35.0, 2.0, "deg"), None, Quantity(150.0, 1.0, "mm")),
}


@pytest.mark.parametrize("emitter", EMITTERS)
def test_a_flux_is_as_it_was(emitter):
    """A disc in three exposures, with and without frames of the dark source, by camera and by calibration."""
    frames = [disc(k, t) for k, t in enumerate((2e-4, 1e-3, 3e-3, 8e-3))]
    off = [disc(10 + k, t, 0.0) for k, t in enumerate((1e-3, 8e-3))]
    lens = world.LENS.model_copy(update={"magnification": 0.1})
    camera = world.CAMERA.model_copy(update={"pixel_spacing_um": 9.0})
    scales = {
        "described": flux_scale(camera, LED, None),
        "measured": flux_scale(camera, LED, None, 0.012),
        "without_black": flux_scale(camera.model_copy(update={"black_level_dn": None}), LED, None),
        "calibrated": flux_scale(
            camera, LED, world.calibration(camera=camera, uncertainties=world.doubts(spectral_u_rel=0.03))
        ),
    }
    told = {
        name: described(led_flux([*frames, *(off if name == "measured" else [])], scale, lens, EMITTERS[emitter]))
        for name, scale in scales.items()
    }
    told["part"] = described(led_flux(frames, scales["described"], lens, EMITTERS[emitter], Patch(8, 14, 30, 34), 0.05))
    assert not moved(f"fluxes/{emitter}", told, rel=1e-7)


def warm_darks() -> Subject:
    """Return the whole camera with its bright frames taken warmer than most of its darks."""
    plain = subject()
    warmer = tuple(
        one if one.settings.is_dark else replace(one, settings=replace(one.settings, temperature_c=33.0))
        for one in plain.groups
    )
    return replace(plain, groups=warmer)


def without_temperatures(whole: Subject) -> Subject:
    groups = tuple(replace(one, settings=replace(one.settings, temperature_c=None)) for one in whole.groups)
    return replace(whole, groups=groups)


def of_kind(whole: Subject, *, dark: bool) -> Subject:
    return replace(whole, groups=tuple(one for one in whole.groups if one.settings.is_dark is dark))


def subject(*, darks: bool = True, gains: tuple[float, ...] = (0.0,), photons: bool = True, step: int = 1) -> Subject:
    """Return frames of a camera for its characterisation: twelve levels up to saturation, darks of three times."""
    rows, columns = np.indices((40, 50))
    rng = np.random.default_rng([11, len(gains), step, darks])
    uneven = 1.0 + 0.01 * rng.standard_normal(rows.shape) + 0.004 * np.sin(0.7 * columns) + 0.003 * np.cos(rows)
    offset = 1.5 * rng.standard_normal(rows.shape) + 0.8 * np.cos(1.3 * columns)
    files: dict[Path, Any] = {}
    groups = []

    def add(settings: FrameSettings, electrons_per_s: float, count: int) -> None:
        names = []
        for _ in range(count):
            rate = electrons_per_s * uneven * (not settings.is_dark) + 40.0 * 2 ** ((settings.temperature_c - 25) / 7)
            charge = np.minimum(rng.poisson(rate * settings.exposure_s), 10_000) + rng.normal(0.0, 6.0, rows.shape)
            dn = charge * 10 ** (settings.gain_db / 20) / 2.6 + 64.0 + offset
            path = Path(f"{len(files)}.png")
            files[path] = np.clip(step * np.rint(dn / step), 0, 4095).astype(np.uint16)
            names.append(path)
        groups.append(FrameGroup(settings, tuple(names), None, files.__getitem__))

    for gain in gains:
        for k in range(12):
            add(FrameSettings(1e-3 * (k + 1) / 10 ** (gain / 20), gain, 4.0, temperature_c=25.0), 9e5, 2 + 4 * (k == 5))
        for t, temperature in ((1e-3, 25.0), (0.05, 25.0), (0.4, 25.0), (0.4, 34.0)) if darks else ():
            add(FrameSettings(t, gain, 4.0, temperature_c=temperature, shutter="closed"), 0.0, 3)
    camera = CameraDescription(bit_depth=12, model="generated", pixel_pitch_um=4.5, code_step_dn=step)
    flux = PhotonFlux(9e5 / 0.62, 0.02) if photons else None
    return Subject("held", camera, LensDescription(), tuple(groups), (None,), (flux,))


CAMERAS = {
    "whole": subject,
    "without_darks": lambda: subject(darks=False),
    "without_photons": lambda: subject(photons=False),
    "two_gains": lambda: subject(gains=(0.0, 6.0)),
    "warm": warm_darks,
    "unknown_temperature": lambda: without_temperatures(subject()),
    "only_darks": lambda: of_kind(subject(), dark=True),
    "only_light": lambda: of_kind(subject(), dark=False),
    "coarse_codes": lambda: subject(step=16),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_figures_of_a_camera_are_as_they_were(name):
    """All figures of EMVA 1288 with u, the steps behind them, and what is said of them."""
    result = characterise(CAMERAS[name]())
    found = result.to_mapping()
    told = {"camera": found["camera"], "sources": found["sources"], **found["emva1288"]}
    told["says"] = [outcome(result), *meaning(result)]
    assert not moved(f"cameras/{name}", told, rel=1e-7)


def test_scales_are_as_they_were():
    """By a known source and by a meter, with their budgets, and what a calibration says of them."""
    base = unscaled_calibration(world.CAMERA, world.LENS, None, "cie_a", flat_field=world.flat_field())
    source = SourceDescription(kind="sphere", polarised=False)
    patch = Patch(11, 13, 8, 9)
    by_source = scale_by_source(base, world.bracket(), patch, KnownSource(120.0, 0.015), source)
    by_luminance = scale_by_source(base, world.bracket(), patch, KnownSource(120.0, 0.015, "luminance"), source)
    meter = MeterReading(12.4, MeterSettings(1 / 60, 5.6, 100.0), 1900.0, 0.05)
    by_meter = scale_by_meter(base, meter)
    unknown = scale_by_meter(base, MeterReading(12.4, MeterSettings(1 / 60, 5.6, 100.0).exact(), 1900.0))
    ratio = scales_ratio(by_meter, by_source)
    made = scaled_calibration(base, by_source, ("a",), by_meter)
    told = {
        "source": by_source.model_dump(mode="json"),
        "luminance": by_luminance.model_dump(mode="json"),
        "meter": by_meter.model_dump(mode="json"),
        "meter of unknown constant": unknown.model_dump(mode="json"),
        "ratio": [ratio.value, ratio.u],
        "assumptions": list(made.provenance.assumptions),
        "parameters": made.provenance.parameters,
    }
    curved = unscaled_calibration(
        world.CAMERA.model_copy(update={"bit_depth": 8, "black_level_dn": None, "read_noise_e": None}),
        world.LENS.model_copy(update={"transmittance": None, "transmittance_u_rel": None}),
        world.gamma_curve(),
        "led_b4",
        validity_days=30.0,
    )
    curved = replace(curved, found=world.found(), uncertainties=world.doubts(efficacy_u_rel=0.07))
    read = MeterReading(12.4, MeterSettings(1 / 60, 5.6, 100.0), 120.0)
    unread = scaled_calibration(curved, scale_by_meter(curved, read), ("a", "b"))
    told["by a meter, through a curve"] = {
        "scale": unread.scale.model_dump(mode="json"),
        "black": unread.black_level.dn,
        "days": unread.validity_days,
        "method": unread.provenance.method,
        "inputs": list(unread.provenance.inputs),
        "assumptions": list(unread.provenance.assumptions),
        "parameters": unread.provenance.parameters,
    }
    assert not moved("analyses/scales", told, rel=1e-7)


@pytest.mark.parametrize("dn", [64.0, 4095.0, 63.0, 5000.0])
def test_a_meter_s_pixel_value_lies_between_black_and_full_scale(dn):
    """Neither end is a level that light can be told by."""
    base = unscaled_calibration(world.CAMERA, world.LENS, None, "cie_a")
    settings = MeterSettings(1 / 60, 5.6, 100.0)
    with pytest.raises(UsageError, match="above 64 and below 4095 DN"):
        scale_by_meter(base, MeterReading(12.4, settings, dn))
    inside = [scale_by_meter(base, MeterReading(12.4, settings, at)).value for at in (64.5, 65.0, 2080.0, 4094.5)]
    assert [one * (at - 64.0) for one, at in zip(inside, (64.5, 65.0, 2080.0, 4094.5), strict=True)] == pytest.approx(
        [inside[1]] * 4, rel=2e-3
    )


@pytest.mark.parametrize("fit_centre", [True, False])
def test_a_flat_field_is_as_it_was(fit_centre):
    """A fall-off about a point beside the middle, with a few pixels that clip."""
    rows, columns = np.indices((90, 120), dtype=float)
    r2 = (columns - 66.0) ** 2 + (rows - 41.0) ** 2
    truth = (1.0 - 0.2 * r2 / 75.0**2 - 0.03 * (r2 / 75.0**2) ** 2) / (1.0 + r2 / 400.0**2) ** 2
    value = truth * (1.0 + 0.004 * np.random.default_rng(3).standard_normal(truth.shape))
    mask = np.zeros(truth.shape, np.uint8)
    mask[10:14, 20:30] = 1
    even = RadianceMap(value.astype(np.float32), np.full(truth.shape, 0.004, np.float32), mask, "relative")
    lens = world.LENS.model_copy(update={"focal_length_mm": 400 * 4.5e-3})
    found = fit_flat_field(even, world.CAMERA, lens, source_u_rel=0.002, fit_centre=fit_centre)
    told = found.model_dump(mode="json") | {"at": digest(found.at(columns, rows))}
    assert not moved(f"analyses/flat_field_{fit_centre}", told, rel=1e-4)


def falling(shape: tuple[int, int], k2: float, k4: float, k6: float, focal_px: float) -> RadianceMap:
    """Return an even source behind a lens whose axis lies a little up and to the left, with dust and dead pixels."""
    rows, columns = np.indices(shape, dtype=float)
    rho2 = ((columns - 0.45 * shape[1]) ** 2 + (rows - 0.53 * shape[0]) ** 2) / (0.25 * (shape[0] ** 2 + shape[1] ** 2))
    truth = 3.0 * (1.0 + k2 * rho2 + k4 * rho2**2 + k6 * rho2**3)
    truth = truth / (1.0 + rho2 * 0.25 * (shape[0] ** 2 + shape[1] ** 2) / focal_px**2) ** 2
    value = truth * (1.0 + 0.003 * np.random.default_rng([9, *shape]).standard_normal(shape))
    value[shape[0] // 5 : shape[0] // 5 + 8, shape[1] // 3 : shape[1] // 3 + 8] *= 0.8  # dust
    mask = np.zeros(shape, np.uint8)
    mask[::9, ::7], mask[-6:, :9], mask[:5, -5:] = 8, 1, 16
    value[40:44, 40:44] = -0.1  # dark
    return RadianceMap(value.astype(np.float32), np.full(shape, 0.008, np.float32), mask, "relative")


FLATS: dict[str, Any] = {
    "wide": ((70, 130), -0.15, 0.02, -0.01, 300.0, {}),
    "high": ((170, 66), -0.1, 0.0, 0.0, 400.0, {}),
    "none": ((100, 100), 0.0, 0.0, 0.0, 250.0, {}),
    "unknown focal length": ((96, 128), -0.12, -0.05, 0.0, 1e9, {"focal_length_mm": None}),
    "stated point": ((96, 128), -0.12, 0.05, 0.0, 500.0, {"principal_point_px": (58.0, 51.0)}),
}


def test_flat_fields_of_other_pictures_are_as_they_were():
    """Wide and high, with and without a polynomial, a focal length and a point that is stated."""
    told: dict[str, Any] = {}
    for name, (shape, k2, k4, k6, focal_px, lens) in FLATS.items():
        even = falling(shape, k2, k4, k6, focal_px)
        glass = world.LENS.model_copy(update={"focal_length_mm": focal_px * 4.5e-3, **lens})
        for centred in (True, False):
            found = fit_flat_field(even, world.CAMERA, glass, fit_centre=centred)
            told[f"{name}, {'fitted' if centred else 'given'} point"] = found.model_dump(mode="json") | {
                "corners": [float(found.at(np.array(x), np.array(y))) for x in (0.0, shape[1]) for y in (0.0, shape[0])]
            }
    assert not moved("analyses/flat_fields", told, rel=1e-4)


def step(name: str, value: float, *, u: float = 0.004, temperature_c: float | None = 25.0) -> StepSignal:
    terms = (Term("repeatability", u * value, "A", 12), Term("dark frames", 0.001))
    return StepSignal(name, value, terms, 0.002, 1e-4 * value, temperature_c, 6)


def of_figure(figure: indices.Figure) -> dict[str, Any]:
    return {
        "value": figure.value, "u": figure.u, "freedom": figure.degrees_of_freedom, "remarks": list(figure.remarks),
        "details": [[one.label, one.value, one.u, one.degrees_of_freedom, one.expanded] for one in figure.details],
    }  # fmt: skip


def test_quality_indices_are_as_they_were():
    """Linearity, temperature, polarisation, glare, size of source, evenness, edges, smear and spectral mismatch."""
    steps = {1e-3 * 2.0**k: step(str(k), 3.0 + 0.02 * k) for k in range(5)}
    angles = {float(a): step(str(a), 2.0 + 0.1 * np.cos(np.radians(2 * a - 50))) for a in (0, 30, 60, 90, 120, 150)}
    warm = [
        step("a", 2.0, temperature_c=18.0),
        step("b", 2.03, temperature_c=31.0),
        step("c", 2.01, temperature_c=25.0),
    ]
    rng = np.random.default_rng(5)
    rows, columns = np.indices((60, 80), dtype=float)
    even = (
        10.0 * (1 - 0.05 * ((columns - 30) / 80) ** 2 - 0.02 * rows / 60) * (1 + 0.01 * rng.standard_normal(rows.shape))
    )
    edge = (
        1.0 / (1.0 + np.exp(-(columns - 40.0 - 0.1 * rows) / 1.4)) * 8.0 + 0.2 + 0.01 * rng.standard_normal(rows.shape)
    )
    bright = 50.0 * ((np.abs(rows - 30) < 4) & (np.abs(columns - 40) < 4)) + 0.1 * (np.abs(columns - 40) < 4)
    bright = bright + 0.01 * rng.standard_normal(rows.shape)

    def of_map(values: Any) -> RadianceMap:
        u = np.full(values.shape, 0.01, np.float32)
        return RadianceMap(values.astype(np.float32), u, np.zeros(values.shape, np.uint8), "relative")

    told = {
        "linearity": indices.linearity(steps, 2e-4, 0.001),
        "temperature": indices.temperature(warm, 0.001),
        "polarisation": indices.polarisation(angles, 0.001),
        "glare": indices.glare_index(step("w", 5.0), step("k", 0.04), 0.001),
        "size": indices.size_of_source({10.0: step("a", 4.9), 30.0: step("b", 4.96), 90.0: step("c", 5.0)}, 0.001),
        "worst": indices.worst_deviation([step("a", 4.9), step("b", 5.02)], step("c", 5.0), 0.001, signed=True),
        "uniformity": spatial.uniformity(of_map(even)),
        "edge": spatial.edge_width(of_map(edge), Patch(20, 10, 40, 40)),
        "smear": spatial.smear(of_map(bright), Patch(30, 20, 20, 20)),
        "mismatch": v_lambda_mismatch(world.bell(552.0, 45.0)),
    }
    assert not moved("analyses/quality", {name: of_figure(one) for name, one in told.items()}, rel=1e-5)


def test_photometry_is_as_it_was():
    """Every kind of light that has a name, by every observer."""
    names = [
        *(name for name in SPECTRUM_NAMES if name.islower() and ":" not in name),
        "planck:3200",
        "line:555",
        "band:500,30",
    ]
    told: dict[str, Any] = {}
    for name in names:
        light = spectrum(name)
        told[name] = {
            "nm": digest(light.wavelength_nm),
            "power": digest(light.power),
            "band": light.band_nm,
            "photopic": luminous_efficacy_lm_per_w(light),
            "scotopic": luminous_efficacy_lm_per_w(light, "scotopic"),
            "luminance": luminance_cd_m2(2.0, light),
            "unstated": unstated_light_u_rel(name, None) if name in ("cie_a", "equal_energy") else None,
        }
    told["unstated, by a response"] = unstated_light_u_rel("white_led", world.bell(560.0, 70.0), "photopic")
    bell = world.bell(560.0, 70.0)
    response = (np.array(bell.wavelength_nm), np.array(bell.relative))
    told["mismatch"] = spectral_mismatch_factor(spectrum("cie_fl2"), spectrum("cie_a"), *response)
    told["thesis"] = radiance_thesis_w_sr_m2_um(100.0)
    told["trolands"] = [retinal_illuminance_td(100.0, d) for d in (2.0, 7.0)]
    assert not moved("analyses/photometry", told)
