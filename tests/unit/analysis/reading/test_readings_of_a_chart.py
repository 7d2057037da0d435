"""Readings of a chart of known radiances in many situations: the truth is within what is stated."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.analysis.reading.reading import read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Flag,
    FlatField,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    Reading,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
)

NOW = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
SIZE = (24, 30)  # rows, columns
E_PER_DN, READ_E, WELL_E, DARK_E_PER_S, BLACK_DN = 2.6, 3.1, 10_500.0, 4.0, 64.0
CAMERA = CameraDescription(
    bit_depth=12, model="generated", serial="7", pixel_pitch_um=4.5, conversion_gain_e_per_dn=E_PER_DN,
    read_noise_e=READ_E, full_well_e=WELL_E, dark_current_e_per_s=DARK_E_PER_S, dark_current_reference_C=25.0,
    dark_current_doubling_K=7.0, black_level_dn=BLACK_DN, quantum_efficiency=0.62,
)  # fmt: skip
LENS = LensDescription(focal_length_mm=160.0, f_number=4.0, transmittance=0.92, transmittance_u_rel=0.01)
PER_RADIANCE = 2.1e5  # electrons per second and W·sr⁻¹·m⁻² at f/4
CHART = np.array([[0.4, 2.0, 9.0], [30.0, 120.0, 400.0]])
MIDDLE, DARKEST, BRIGHTEST = Patch(11, 13, 8, 9), Patch(1, 1, 7, 9), Patch(21, 13, 8, 9)


def scene() -> NDArray[np.float64]:
    """Return the chart's radiances in W·sr⁻¹·m⁻², SIZE."""
    rows, columns = np.indices(SIZE)
    return CHART[rows * 2 // SIZE[0], columns * 3 // SIZE[1]]


def frame(number: int, exposure_s: float, bits: int = 12, light: float = 1.0, **changes: Any) -> Frame:
    """Return one frame; its noise is drawn by `number`."""
    settings = FrameSettings(
        exposure_s, **{"f_number": 4.0, "black_level_dn": BLACK_DN, "temperature_c": 31.0, **changes}
    )
    rng = np.random.default_rng([20261126, number])
    seconds = 0.0 if settings.is_dark else exposure_s * light * (4.0 / (settings.f_number or 4.0)) ** 2
    dark_e = DARK_E_PER_S * 2.0 ** (((settings.temperature_c or 31.0) - 25.0) / 7.0) * exposure_s
    electrons = np.minimum(rng.poisson(PER_RADIANCE * scene() * seconds + dark_e), WELL_E)
    dn = (electrons + rng.normal(0.0, READ_E, SIZE)) * 10 ** (settings.gain_db / 20) / E_PER_DN + BLACK_DN
    if bits == 8:
        dn = 255.0 * np.clip((dn - BLACK_DN) / (4095.0 - BLACK_DN), 0.0, 1.0) ** (1 / 2.2)
        settings = replace(settings, black_level_dn=None)
    stored = np.clip(np.rint(dn), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Frame(stored, bits, settings)


def ladder(first: int = 0, count: int = 8, **changes: Any) -> list[Frame]:
    """Return exposures from 10 µs on, each four times the one before."""
    return [frame(first + k, 1e-5 * 4.0**k, **changes) for k in range(count)]


def calibration(**changes: Any) -> Calibration:
    """Return the calibration that is right: H = DN·e⁻/DN over electrons per J·m⁻² of this lens."""
    conditions = ScaleConditions(inverse_exposure_per_s=200.0, temperature_c=31.0, level=0.5, surround=1.0)
    exposure_per_dn = E_PER_DN / PER_RADIANCE * math.pi / 4.0 / 4.0**2 * 0.92
    scale = Scale(value=exposure_per_dn, u_rel=0.005, method="known_radiance", f_number=4.0, conditions=conditions)
    made = {
        "camera": CAMERA, "lens": LENS, "scale": scale, "response": None, "noise": SensorNoise.of(CAMERA),
        "black_level": BlackLevel(dn=BLACK_DN, u_dn=0.2, dark_u_rel=0.5), "created": "2026-02-21T12:00:00Z",
    }  # fmt: skip
    return Calibration(**{**made, **changes})


def gamma_calibration() -> Calibration:
    """Return that of the eight-bit frames: x = (M/255)^2.2 of full scale."""
    with np.errstate(divide="ignore"):
        log_exposure = 2.2 * np.log(np.arange(256.0) / 255.0)
    curve = ResponseCurve(log_exposure, np.full(256, 0.004), valid_dn=(4, 250))
    camera = CAMERA.model_copy(update={"bit_depth": 8, "black_level_dn": None, "conversion_gain_e_per_dn": None})
    full = (4095.0 - BLACK_DN) * calibration().scale.value
    scale = calibration().scale.model_copy(update={"value": full})
    return calibration(
        camera=camera, response=curve, scale=scale, black_level=BlackLevel(), noise=SensorNoise.of(camera)
    )


def read(frames: list[Frame], patch: Patch = MIDDLE, given: Calibration | None = None, **options: Any) -> Reading:
    given = given or calibration()
    lens = options.pop("lens", LENS)
    return read_patch(Bracket.from_frames(frames), patch, given, given.camera, lens, now=NOW, **options)


def lens(**changes: Any) -> LensDescription:
    return LENS.model_copy(update=changes)


# What is read, and how many times the chart's radiance the numbers then mean.
SITUATIONS: dict[str, tuple[Callable[[], Reading], float, float]] = {
    "plain": (lambda: read(ladder()), 120.0, 1.0),
    "the darkest field": (lambda: read(ladder(), DARKEST), 0.4, 1.0),
    "the brightest field": (lambda: read(ladder(), BRIGHTEST), 400.0, 1.0),
    "three by three pixels": (lambda: read(ladder(), Patch(12, 14, 3, 3)), 120.0, 1.0),
    "one frame": (lambda: read(ladder()[2:3]), 120.0, 1.0),
    "dark frames of each time": (
        lambda: read([*ladder(), *ladder(50, shutter="closed")], DARKEST), 0.4, 1.0
    ),
    "dark frames of another time": (
        lambda: read([*ladder(), *(frame(60 + k, 0.05, shutter="closed") for k in range(3))], DARKEST), 0.4, 1.0
    ),
    "18 dB": (lambda: read(ladder(20, 6, gain_db=18.0), DARKEST), 0.4, 1.0),
    "two gains": (lambda: read([*ladder(), *ladder(20, 6, gain_db=6.0)]), 120.0, 1.0),
    "f/8": (lambda: read(ladder(30, 8, f_number=8.0)), 120.0, 1.0),
    "5 °C": (lambda: read(ladder(temperature_c=5.0)), 120.0, 1.0),
    "no thermometer": (lambda: read(ladder(temperature_c=None)), 120.0, 1.0),
    "a darker lens of the same make": (lambda: read(ladder(), lens=lens(transmittance=0.8)), 120.0, 0.92 / 0.8),
    "a close-up": (lambda: read(ladder(), lens=lens(magnification=0.5, pupil_magnification=2.0)), 120.0, 1.25**2),
    "three years later": (lambda: read(ladder(), given=calibration(created="2023-03-01T12:00:00Z")), 120.0, 1.0),
    "defective pixels": (lambda: read(ladder(), given=calibration(defects=((12, 14), (13, 15), (2, 2)))), 120.0, 1.0),
    "eight bits through a curve": (lambda: read(ladder(bits=8), given=gamma_calibration()), 120.0, 1.0),
    "a flat field that falls to 0.9": (
        lambda: read(ladder(), BRIGHTEST, calibration(flat_field=FlatField(
            principal_point_px=(24.5, 17.0), radius_px=10.0, coefficients=(0.0, 0.0, 0.0), shape=SIZE, f_number=4.0
        ))), 400.0, 1.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SITUATIONS)
def test_the_truth_lies_within_what_is_stated(name: str) -> None:
    """Within 3 u; the lines of the budget add up in squares to u; nothing is called saturated, dark or uneven.

    Stray light of the bright fields is most of the u of the darkest.
    """
    make, radiance, factor = SITUATIONS[name]
    found = make()
    assert abs(found.radiance.value - factor * radiance) < 3.0 * found.radiance.u
    assert math.hypot(*(line.u_rel for line in found.budget)) == pytest.approx(found.radiance.u_rel, rel=1e-6)
    assert not {Flag.SATURATED, Flag.BELOW_NOISE, Flag.NONUNIFORM, Flag.FLICKER} & set(found.flags)
    assert found.radiance.u_rel < (0.2 if radiance > 100.0 else 2.0)


@pytest.mark.parametrize(
    ("make", "flag"),
    [
        (lambda: read(ladder()[6:], BRIGHTEST), Flag.SATURATED),
        (lambda: read(ladder(), Patch(6, 8, 9, 8)), Flag.NONUNIFORM),
        (lambda: read([frame(80 + k, 1e-3, shutter="open", light=0.0) for k in range(2)]), Flag.BELOW_NOISE),
        (lambda: read([frame(70 + k, 1.6e-4, light=1.0 + 0.03 * (k % 3)) for k in range(6)]), Flag.FLICKER),
        (lambda: read(ladder(), given=calibration(created="2020-01-01T00:00:00Z")), Flag.STALE_CALIBRATION),
    ],
)  # fmt: skip
def test_what_a_reading_cannot_stand_for_is_flagged(make: Callable[[], Reading], flag: Flag) -> None:
    """Clipped everywhere, over an edge, without light, flickering or too old."""
    assert flag in make().flags


def test_the_u_of_many_readings_is_what_they_scatter_by() -> None:
    """Without what all share, 60 readings of one patch scatter by their own u, to 30 % (√(1/120) is 9 %)."""
    values = [read(ladder(1000 + 10 * k)) for k in range(60)]
    own = [
        math.hypot(*(line.u_rel for line in one.budget if not line.correlated)) * one.radiance.value for one in values
    ]
    scatter = float(np.std([one.radiance.value for one in values], ddof=1))
    assert scatter == pytest.approx(float(np.mean(own)), rel=0.3)
