"""Flats that fluctuate as two sensors of the LSST camera do: noise drawn with their measured covariances.

The table (C. Lage, Poisson_CCD: slopes of covariance over mean² to lag 8, in 1/e⁻) is all that is known of how pixels
push each other here; nothing of this project's equations is in the frames. Its slopes are taken for those at no charge:
how covariances bend as charge gathers follows from them alone (Astier et al. 2019, A&A 629 A36, with b = 0), wave by
wave: (e^{2aμ} − 1)/(2aμ) times shot noise. There are as many frames as tell the ratio of the nearest neighbours to some
3 %: four of 256 × 256 at each of nine levels gave it to 16 % only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from testing.outside.session import Secret, Session

SENSORS: Final = ("e2v", "itl")
LAGS: Final = 8
WELL_E: Final = 150_000.0
_SIDE_PX, _DARKS, _E_PER_DN, _NOISE_E, _BLACK_DN = 1024, 4, 2.5, 5.0, 1000
_FRAMES_AT_E: Final = {1000.0: 4, 10_000.0: 4, 30_000.0: 4, 60_000.0: 16, 80_000.0: 24, 100_000.0: 32}
_E_PER_S: Final = 10_000.0


def covariances(folder: Path, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of covariance over mean² and their scatter in 1/e⁻, (lags, lags).

    Args:
        folder: Folder of the shared data.
        sensor: One of `SENSORS`.
    """
    slope, scatter = np.zeros((LAGS + 1, LAGS + 1)), np.zeros((LAGS + 1, LAGS + 1))
    path = folder / "sensors" / "lsst_brighter_fatter" / f"{sensor}_covariances_21oct19.txt"
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        if len(cells := line.split()) == 4:
            at = int(cells[0]), int(cells[1])
            slope[at], scatter[at] = float(cells[2]), float(cells[3])
    return slope, scatter


def u_of_slope() -> float:
    """Return the standard uncertainty in 1/e⁻ with which frames as drawn tell the slope of a covariance."""
    square = sum(level**2 * (number - 1) for level, number in _FRAMES_AT_E.items())
    return 1.0 / (_SIDE_PX * float(np.sqrt(square)))


def flats(folder: Path, sensor: str, seed: int) -> Session:
    """Return a photon-transfer session of even fields and darks of a sensor, its lag (i, j) along rows and columns."""
    dice, (slope, _) = np.random.default_rng([seed, SENSORS.index(sensor)]), covariances(folder, sensor)
    wrapped = np.zeros((_SIDE_PX, _SIDE_PX))
    for (i, j), value in np.ndenumerate(slope):
        for down in {i, -i}:
            for across in {j, -j}:
                wrapped[down, across] = value
    spectrum = np.fft.rfft2(wrapped).real  # of relative covariance per electron of mean
    frames, entries, time_s = list[np.ndarray](), list[dict[str, Any]](), 0.0
    levels = sorted(_FRAMES_AT_E)
    settings = [(level, True) for level in levels] + [(level, False) for level in (levels[0], levels[-1])]
    for level_e, lit in settings:
        bent = 2.0 * level_e * spectrum
        power = level_e * np.expm1(bent) / bent
        for _ in range(_FRAMES_AT_E[level_e] if lit else _DARKS):
            white = np.fft.rfft2(dice.standard_normal((_SIDE_PX, _SIDE_PX)))
            charge = level_e + np.fft.irfft2(white * np.sqrt(power), s=wrapped.shape) if lit else 0.0
            value = (charge + _NOISE_E * dice.standard_normal(wrapped.shape)) / _E_PER_DN + _BLACK_DN
            frames.append(np.clip(np.rint(value), 0, 65535).astype(np.uint16))
            entries.append(_entry(len(entries), level_e / _E_PER_S, lit=lit, time_s=time_s))
            time_s += 10.0
    return Session(_header(sensor, entries), frames, Secret("real", "flats", "brighter_fatter", ("brighter_fatter",)))


def _entry(number: int, exposure_s: float, *, lit: bool, time_s: float) -> dict[str, Any]:
    return {
        "file": f"frames/{number:04d}.png", "exposure_s": exposure_s, "gain_db": 0.0, "f_number": 4.0,
        "black_level_dn": _BLACK_DN, "temperature_C": -100.0, "timestamp_s": time_s, "source_level": 1.0,
        "pattern": "even", "shutter": "open" if lit else "closed",
    }  # fmt: skip


def _header(sensor: str, entries: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "format": "radiometer-capture/1",
        "camera": {
            "vendor": "LSST", "model": sensor, "bit_depth": 16, "pixel_pitch_um": 10.0, "full_well_e": WELL_E,
            "conversion_gain_e_per_dn": _E_PER_DN, "read_noise_e": _NOISE_E, "dark_current_e_per_s": 0.0,
            "black_level_dn": _BLACK_DN, "quantum_efficiency": 0.8,
        },
        "lens": {"focal_length_mm": 50.0, "f_number": 4.0, "transmittance": 0.9, "transmittance_u_rel": 0.03,
                 "vignetting": "none"},
        "source": {"kind": "sphere", "wavelength_nm": 550.0, "reproducibility_u_rel": 0.001},
        "patterns": ["even"],
        "patches": [{"name": "all", "x": 0, "y": 0, "width": _SIDE_PX, "height": _SIDE_PX}],
        "frames": entries,
    }  # fmt: skip
