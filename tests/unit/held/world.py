"""A camera before a chart, of a fixed seed: small frames in which most of the analysis has something to do."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.data import (
    BlackLevel,
    Calibration,
    CameraDescription,
    FlatField,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
    SpectralResponse,
    StatedUncertainties,
)

NOW = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
SIZE = (24, 30)  # rows, columns
CAMERA = CameraDescription(
    bit_depth=12,
    vendor="Nobody",
    model="generated",
    serial="7",
    pixel_pitch_um=4.5,
    conversion_gain_e_per_dn=2.6,
    read_noise_e=3.1,
    full_well_e=10_500.0,
    dark_current_e_per_s=4.0,
    dark_current_reference_C=25.0,
    dark_current_doubling_K=7.0,
    black_level_dn=64.0,
    quantum_efficiency=0.62,
)
LENS = LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.92, transmittance_u_rel=0.01)
PER_RADIANCE = 2.1e5  # electrons per second and W·sr⁻¹·m⁻² at f/4
CHART = np.array([[0.4, 2.0, 9.0], [30.0, 120.0, 400.0]])


def scene() -> NDArray[np.float64]:
    """Return the chart's radiances in W·sr⁻¹·m⁻², SIZE, with a slow slope over each field."""
    rows, columns = np.indices(SIZE)
    fields = CHART[rows * 2 // SIZE[0], columns * 3 // SIZE[1]]
    return fields * (1.0 + 0.002 * (columns % 10) - 0.001 * (rows % 12))


def electrons(settings: FrameSettings, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the expected electrons of a frame, SIZE."""
    rows, columns = np.indices(radiance.shape)
    uneven = 1.0 + 0.01 * np.sin(0.9 * rows + 1.7 * columns)
    light = PER_RADIANCE * radiance * (4.0 / (settings.f_number or 4.0)) ** 2 * settings.exposure_s
    dark = 4.0 * 2.0 ** (((settings.temperature_c or 25.0) - 25.0) / 7.0) * settings.exposure_s
    return (0.0 if settings.is_dark else 1.0) * light * settings.source_level * uneven + dark


def frame(
    number: int, exposure_s: float, *, radiance: NDArray[np.float64] | None = None, bits: int = 12, **changes: Any
) -> Frame:
    """Return one frame; its noise is drawn by `number`."""
    settings = FrameSettings(exposure_s, **{"f_number": 4.0, "black_level_dn": 64.0, "temperature_c": 31.0, **changes})
    rng = np.random.default_rng([20261123, number])
    expected = electrons(settings, scene() if radiance is None else radiance)
    charge = np.minimum(rng.poisson(expected), 10_500.0) + rng.normal(0.0, 3.1, expected.shape)
    dn = charge * 10 ** (settings.gain_db / 20) / 2.6 + 64.0
    if bits == 8:
        dn = 255.0 * np.clip((dn - 64.0) / 4031.0, 0.0, 1.0) ** (1 / 2.2)
        settings = replace(settings, black_level_dn=None)
    stored = np.clip(np.rint(dn), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Frame(stored, bits, settings)


def bracket(**changes: Any) -> list[Frame]:
    """Return eight exposures from 10 µs to 160 ms, the last clipped in most fields."""
    return [frame(k, 1e-5 * 4.0**k, **changes) for k in range(8)]


def gamma_curve() -> ResponseCurve:
    """Return the response of the eight-bit frames: a power, uncertain towards both ends, silent at black and white."""
    codes = np.arange(256.0)
    with np.errstate(divide="ignore"):
        log_exposure = 2.2 * np.log(codes / 128.0)
    u = 0.004 + 0.02 * ((codes - 128.0) / 128.0) ** 2
    log_exposure[255], u[[0, 255]] = np.inf, np.inf
    return ResponseCurve(log_exposure, u, valid_dn=(4, 250))


def calibration(**changes: Any) -> Calibration:
    """Return a calibration with conditions, a budget of its scale and an age of a hundred days."""
    exposure_per_dn = 2.6 / PER_RADIANCE * math.pi / 4.0 / 4.0**2 * LENS.transmittance
    scale = Scale(
        value=exposure_per_dn,
        u_rel=0.021,
        method="known_radiance",
        degrees_of_freedom=40.0,
        f_number=4.0,
        reference="a sphere",
        budget={"exposure time": 1e-4, "response curve": 0.002},
        conditions=ScaleConditions(
            inverse_exposure_per_s=200.0, gain_db=0.0, temperature_c=27.0, level=0.7, field=0.1, surround=0.3
        ),
    )
    made = {
        "camera": CAMERA,
        "lens": LENS,
        "scale": scale,
        "response": None,
        "noise": SensorNoise.of(CAMERA),
        "black_level": BlackLevel(dn=64.0, u_dn=0.4, dark_u_rel=0.5),
        "created": "2025-11-21T12:00:00Z",
    }
    return Calibration(**{**made, **changes})


def flat_field() -> FlatField:
    """Return a fall-off of 7 % in the corners about an axis that is not the middle."""
    return FlatField(
        principal_point_px=(13.0, 12.5),
        focal_length_px=90.0,
        radius_px=19.0,
        coefficients=(-0.05, 0.01, -0.002),
        u_rel=0.003,
        shape=SIZE,
        f_number=4.0,
    )


def found() -> FoundEffects:
    """Return something of everything that readings are corrected for."""
    return FoundEffects(
        exposure_offset_s=3e-6,
        exposure_further_s=2e-6,
        exposure_above_db=6.0,
        black_offset_dn=1.7,
        black_slope_dn=0.6,
        black_from_db=3.0,
        black_bend=0.05,
        gain_error_rel=0.01,
        gains_db=(0.0, 12.0, 24.0),
        gain_errors_rel=(0.0, 0.02, 0.03),
        temperature_slope_per_k=0.002,
        temperature_bend_per_k2=1e-5,
        well_a2=0.03,
        well_a3=0.01,
        well_e=10_500.0,
        glare=0.02,
        names=("exposure_time_offset",),
    )


def bell(middle_nm: float, width_nm: float, u_rel: float = 0.02) -> SpectralResponse:
    """Return a responsivity that falls off to both sides of its maximum."""
    wavelength = np.arange(380.0, 781.0, 10.0)
    relative = np.exp(-0.5 * ((wavelength - middle_nm) / width_nm) ** 2)
    return SpectralResponse(wavelength_nm=tuple(wavelength), relative=tuple(relative), u_rel=u_rel)


def doubts(**changes: float) -> StatedUncertainties:
    """Return stated uncertainties."""
    return StatedUncertainties(**changes)


def turned(radiance: NDArray[np.float64], degrees: float, shift: tuple[float, float]) -> NDArray[np.float64]:
    """Return a scene seen by a camera that moved: nearest neighbours, for whole and half pixels alike."""
    rows, columns = np.indices(radiance.shape, dtype=float)
    y, x = rows - radiance.shape[0] / 2 + shift[1], columns - radiance.shape[1] / 2 + shift[0]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    at_y = np.clip(np.rint(c * y - s * x + radiance.shape[0] / 2), 0, radiance.shape[0] - 1).astype(int)
    at_x = np.clip(np.rint(s * y + c * x + radiance.shape[1] / 2), 0, radiance.shape[1] - 1).astype(int)
    return radiance[at_y, at_x]
