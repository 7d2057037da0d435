"""What a characterisation found, under the symbols of EMVA 1288."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from radiometer.analysis.characterise.linearity import Linearity
from radiometer.analysis.characterise.photon_transfer import PhotonTransfer
from radiometer.analysis.characterise.steps import SignalStep
from radiometer.data import CameraDescription, Provenance, Quantity
from radiometer.data.json_text import finite_or_null
from radiometer.numbers import below, rounded
from radiometer.numbers import upper_limit as upper_limit_95
from radiometer.units import gain_factor

# Quantum efficiency: no electron without a photon, and any sensor sold sees one in twenty.
PLAUSIBLE_ETA_PERCENT = (5.0, 100.0)

FORMAT: Final = "radiometer-camera/1"


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
    """Return the value that a figure is below with 95 %; None where it is determined.

    A figure whose U (k = 2) exceeds 100 % is not determined.

    Args:
        name: Key of the figure in `SYMBOLS`.
    """
    if name in _SIGNED or not math.isfinite(figure.u) or abs(figure.value) > 2 * figure.u:
        return None
    return upper_limit_95(figure.value, figure.u)


def as_printed(name: str, figure: Quantity) -> tuple[str, str]:
    """Return a figure and its U (k = 2) as texts; "not determined" with the upper limit where U exceeds 100 %."""
    limit = upper_limit(name, figure)
    return rounded(figure.value, 2 * figure.u) if limit is None else ("not determined", below(limit))


@dataclass(frozen=True, slots=True)
class Characterisation:
    """What frames say about a camera, in EMVA 1288 symbols."""

    believed: CameraDescription  # the camera as it was described beforehand
    gain_db: float  # gain that the figures hold at
    figures: Mapping[str, Quantity]  # quantities by EMVA 1288 symbol
    gains: Mapping[float, Quantity]  # overall system gain by gain in dB
    transfer: PhotonTransfer | None  # photon transfer at `gain_db`; None where there is none
    steps: tuple[SignalStep, ...]  # bright steps of the main region
    # (exposure in s, mean in DN, variance in DN², temperature in °C) of the dark groups
    dark_points: tuple[tuple[float, float, float, float | None], ...]
    linearity: Linearity | None  # linearity; None where too few steps are in its range
    notes: tuple[str, ...]  # what a user must know
    provenance: Provenance  # what it was made from
    reference_temperature_c: float | None = None
    limited_by: str = "converter"
    extra: Mapping[str, Any] = field(default_factory=dict)

    def description(self) -> CameraDescription:
        """Return the camera's description with what was measured put in place of what was believed."""
        figures, update = self.figures, dict[str, Any]()
        gain = figures.get("K", figures.get("K_dark"))
        if gain is not None:
            update["conversion_gain_e_per_dn"] = gain_factor(self.gain_db) / gain.value
        for key, symbol in (("read_noise_e", "sigma_d"), ("black_level_dn", "mu_y_dark")):
            if symbol in figures:
                update[key] = figures[symbol].value
        # Where all pixels are full or at full scale is where samples end; the standard's saturation lies below it.
        full = figures.get("mu_e_plateau", figures.get("mu_e_sat"))
        if full is not None:
            update["full_well_e"] = full.value
        if "eta" in figures and 0 < figures["eta"].value <= 100:
            update["quantum_efficiency"] = figures["eta"].value / 100
        if "mu_I_mean" in figures:
            update["dark_current_e_per_s"] = max(figures["mu_I_mean"].value, 0.0)
            update["dark_current_reference_C"] = self.reference_temperature_c
        if "T_d" in figures:
            update["dark_current_doubling_K"] = figures["T_d"].value
        return self.believed.model_copy(update=update)

    def to_mapping(self, limits: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the camera file (`configs/cameras/` form) with the EMVA 1288 figures.

        Args:
            limits: Limits of the camera, where one was at hand.
        """
        camera = self.description().model_dump(mode="json", exclude_none=True)
        mapping: dict[str, Any] = {"format": FORMAT, "camera": camera}
        if limits:
            mapping["limits"] = dict(limits)
        return mapping | {
            "sources": self._sources(camera, limits or {}),
            "emva1288": {
                "standard": "4.0 (linear)",
                "gain_db": self.gain_db,
                "figures": {name: _figure(name, q) for name, q in self.figures.items()},
                "K_by_gain": [{"gain_db": g, "K": finite_or_null(q)} for g, q in self.gains.items()],
                "saturation_limited_by": self.limited_by,
                "notes": list(self.notes),
                "steps": [_step(step, self.figures.get("K")) for step in self.steps],
            },
            "provenance": self.provenance.to_mapping(),
        }

    def _sources(self, camera: Mapping[str, Any], limits: Mapping[str, Any]) -> dict[str, str]:
        measured = {
            "conversion_gain_e_per_dn": "K" if "K" in self.figures else "K_dark",
            "read_noise_e": "sigma_d",
            "full_well_e": "mu_e_plateau" if "mu_e_plateau" in self.figures else "mu_e_sat",
            "dark_current_e_per_s": "mu_I_mean",
            "dark_current_doubling_K": "T_d",
            "black_level_dn": "mu_y_dark",
            "quantum_efficiency": "eta",
        }
        sources = dict.fromkeys(camera, "as described before the characterisation")
        sources |= {"channel": "colour whose pixels were read"} if "channel" in camera else {}
        for key, symbol in measured.items():
            if symbol in self.figures and key in camera:
                u_rel = self.figures[symbol].u_rel
                known = f"{100 * u_rel:.2g} %" if math.isfinite(u_rel) else "unbounded"
                sources[key] = f"measured: {symbol}, relative standard uncertainty {known}"
        if "mu_I_mean" in self.figures and "dark_current_reference_C" in camera:
            sources["dark_current_reference_C"] = "mean sensor temperature of the dark frames"
        return sources | {key: "as the camera states" for key in limits if key not in sources}


def _figure(name: str, quantity: Quantity) -> dict[str, Any]:
    """Return a figure as a mapping; `below` is its upper limit where its U (k = 2) exceeds 100 %."""
    limit = upper_limit(name, quantity)
    return {**finite_or_null(quantity), **({} if limit is None else {"below": limit})}


def _step(step: SignalStep, K: Quantity | None) -> dict[str, float | None]:
    """Return one bright step: settings, signal, variance and signal-to-noise ratio."""
    variance = step.bright.variance_dn2
    return {
        "exposure_s": step.bright.settings.exposure_s,
        "source_level": step.bright.settings.source_level,
        "photons": step.bright.photons,
        "mu_y_dn": step.bright.mean_dn,
        "mu_y_dark_dn": step.dark_mean_dn,
        "sigma2_y_dn2": variance,
        "sigma2_y_dark_dn2": step.dark_variance_dn2,
        "signal_e": None if K is None else step.signal_dn / K.value,
        "SNR": step.signal_dn / math.sqrt(variance) if variance > 0 else None,
    }
