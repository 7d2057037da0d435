"""The EMVA 1288 symbols of the figures: how they are written and what they mean."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from radiometer.data import Quantity
from radiometer.numbers import rounded


class Symbol(NamedTuple):
    """One figure: its sign in print and its meaning."""

    sign: str
    meaning: str


SYMBOLS: Final[dict[str, Symbol]] = {
    "eta": Symbol("η", "quantum efficiency"),
    "K": Symbol("K", "overall system gain"),
    "R": Symbol("R", "responsivity"),
    "sigma_d": Symbol("σ_d", "temporal dark noise, rounding taken out"),
    "sigma_y_dark": Symbol("σ_y.dark", "temporal dark noise, rounding included"),
    "mu_y_dark": Symbol("μ_y.dark", "dark signal at exposure zero (black level)"),
    "mu_I_mean": Symbol("μ_I.mean", "dark current from the mean"),
    "mu_I_var": Symbol("μ_I.var", "dark current from the variance"),
    "T_d": Symbol("T_d", "temperature step that doubles the dark current"),
    "mu_e_min": Symbol("μ_e.min", "absolute sensitivity threshold"),
    "mu_p_min": Symbol("μ_p.min", "absolute sensitivity threshold"),
    "mu_e_sat": Symbol("μ_e.sat", "saturation capacity"),
    "mu_p_sat": Symbol("μ_p.sat", "saturation capacity"),
    "mu_e_plateau": Symbol("μ_e.plateau", "electrons where every pixel is saturated"),
    "SNR_max": Symbol("SNR_max", "highest signal-to-noise ratio"),
    "SNR_max_dB": Symbol("SNR_max", "highest signal-to-noise ratio"),
    "DR": Symbol("DR", "dynamic range"),
    "DR_dB": Symbol("DR", "dynamic range"),
    "LE_min": Symbol("LE_min", "linearity error, most negative"),
    "LE_max": Symbol("LE_max", "linearity error, most positive"),
    "mu_I_typical": Symbol("μ_I.typ", "dark current of the typical pixel, hot ones left out"),
    "mu_I_dn": Symbol("μ_I.DN", "dark current of the typical pixel, where no gain is known"),
    "K_dark": Symbol("K_dark", "overall system gain from the shot noise of dark frames"),
    "DSNU_1288": Symbol("DSNU_1288", "dark signal non-uniformity"),
    "PRNU_1288": Symbol("PRNU_1288", "photo response non-uniformity"),
    "DSNU_row": Symbol("DSNU_row", "of it, between rows"),
    "DSNU_column": Symbol("DSNU_col", "of it, between columns"),
    "DSNU_pixel": Symbol("DSNU_pix", "of it, between pixels"),
    "PRNU_row": Symbol("PRNU_row", "photo response non-uniformity between rows"),
    "PRNU_column": Symbol("PRNU_col", "photo response non-uniformity between columns"),
    "PRNU_pixel": Symbol("PRNU_pix", "photo response non-uniformity between pixels"),
}

_SIGNED: Final = {"LE_min", "LE_max", "mu_y_dark"}  # zero is a value like any other


def upper_limit(name: str, figure: Quantity) -> float | None:
    """Return the value that a figure is below (95 %), where its U (k = 2) exceeds 100 %; None where it is determined.

    Args:
        name: Key of the figure in `SYMBOLS`.
        figure: Its value and standard uncertainty.
    """
    if name in _SIGNED or not math.isfinite(figure.u) or abs(figure.value) > 2 * figure.u:
        return None
    return max(figure.value, 0.0) + 2 * figure.u


def as_printed(name: str, figure: Quantity) -> tuple[str, str]:
    """Return a figure and its U (k = 2) as texts; "not determined" with the upper limit where U exceeds 100 %."""
    limit = upper_limit(name, figure)
    return rounded(figure.value, 2 * figure.u) if limit is None else ("not determined", f"below {limit:.2g}")
