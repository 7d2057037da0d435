"""Nights of an all-sky camera under auto exposure next to a sky meter, made electron by electron from other equations.

The camera looks at a sky that darkens from twilight, with clouds and a moon; it chooses exposure and gain in its own
steps. The meter counts in hundredths of a magnitude per square arcsecond. Nothing here is taken from the program.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

GAINS_DB = (0.0, 6.1, 12.2, 18.3)
BOLTZMANN_EV_PER_K = 8.617e-5


@dataclass(frozen=True)
class Camera:
    """What may be wrong with the camera, or what it does in addition to the reading that is made of it."""

    black_dn: float = 0.0
    magnitude_per_colour: float = 0.0
    wrong_db: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    share_per_kelvin: float = 0.0
    dark_e_per_s_at_25: float = 0.0
    shutter_late_s: float = 0.0
    bends_at_dn: float = 0.0
    lamp_share_of_21_mag: float = 0.0
    hidden_period_s: float = 0.0
    share_per_day: float = 0.0
    electrons_per_dn: float = 4.0


def sky_log(seed: int, camera: Camera | None = None, nights: int = 8, readings: int = 45) -> list[dict[str, float]]:
    """Return the rows of a log."""
    wrong, rng = camera or Camera(), np.random.default_rng(seed)
    rows = []
    for night in range(nights):
        haze = rng.normal(0.0, 0.006)
        warm = 12.0 + rng.normal(0.0, 6.0)
        moon = rng.uniform(0.0, 1.6)
        cloud = 0.0
        for k in range(readings):
            hour = 10.0 * k / readings
            edge = min(hour, 10.0 - hour)
            cloud = 0.8 * cloud + rng.normal(0.0, 0.006)
            magnitude = 21.6 - 9.0 * np.exp(-edge / 0.9) - moon * np.sin(0.3 * hour) ** 2 - abs(rng.normal(0.0, 0.15))
            colour = 0.9 - 0.5 * np.exp(-edge / 0.9) + 0.12 * rng.standard_normal()
            kelvin = 273.15 + warm - 0.9 * hour + 0.2 * rng.standard_normal()
            seconds = 1.7e9 + 86400.0 * night + 3600.0 * hour
            rows.append(_reading(wrong, rng, magnitude, colour, kelvin, seconds, haze + cloud))
    return rows


def _reading(wrong, rng, magnitude, colour, kelvin, seconds, haze):
    light = 10.0 ** (-0.4 * (magnitude - 21.0))
    flux = (
        20.0 * light * 10.0 ** (-0.4 * wrong.magnitude_per_colour * (colour - 0.9)) + 20.0 * wrong.lamp_share_of_21_mag
    )
    flux *= (1.0 + wrong.share_per_kelvin) ** (kelvin - 285.0) * np.exp(haze + rng.normal(0.0, 0.004))
    flux *= (1.0 + wrong.share_per_day) ** ((seconds - 1.7e9) / 86400.0)
    if wrong.hidden_period_s:
        flux *= 1.0 + 0.08 * np.sin(2 * np.pi * seconds / wrong.hidden_period_s)
    exposure, gain = _chosen(4800.0 / max(flux, 1e-9))
    dark = wrong.dark_e_per_s_at_25 * np.exp(0.62 / BOLTZMANN_EV_PER_K * (1 / 298.15 - 1 / kelvin)) * exposure
    electrons = (
        rng.poisson(400 * (flux * max(exposure + wrong.shutter_late_s, 0.0) + dark)) / 400
    )  # a mean of many pixels
    decibel = gain + wrong.wrong_db[GAINS_DB.index(gain)]
    dn = electrons / wrong.electrons_per_dn * 10.0 ** (decibel / 20.0)
    dn = dn / (1.0 + dn / wrong.bends_at_dn) if wrong.bends_at_dn else dn
    return {
        "utc": seconds,
        "adu": round(dn + wrong.black_dn, 2),
        "exposure_s": exposure,
        "gain_db": gain,
        "temp_c": round(kelvin - 273.15, 2),
        "sqm_mag": round(magnitude + rng.normal(0.0, 0.006), 2),
        "b_v": round(colour, 3),
    }


def _chosen(exposure_at_0db_s):
    """Return exposure (in thirds of a stop, at most 15 s) and gain: the gain rises once the exposure is at its end."""
    for gain in GAINS_DB:
        exposure = exposure_at_0db_s / 10.0 ** (gain / 20.0)
        if exposure <= 15.0:
            break
    return float(round(min(15.0, 2.0 ** (np.floor(3 * np.log2(exposure)) / 3)), 5)), gain


def write(rows: list[dict[str, float]], path: Path, *without: str) -> Path:
    """Write rows as CSV, columns left out by name."""
    names = [name for name in rows[0] if name not in without]
    lines = [",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
