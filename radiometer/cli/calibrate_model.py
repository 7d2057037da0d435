"""`radiometer calibrate --model`: what `radiometer reconcile` found goes into the calibration."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.errors import InputError

if TYPE_CHECKING:
    from radiometer.data import Calibration

# The gain in dB at which the uncertainty of a law over gains is stated.
_TYPICAL_GAIN_DB: Final = 24.0


@dataclass(frozen=True, slots=True)
class _Use:
    """Which parameter of an effect corrects what, and whose uncertainty it replaces (by how much per unit)."""

    parameter: str
    corrects: str
    states: str
    per_unit: float = 1.0


_USES: Final = {
    "exposure_time_offset": _Use("offset_s", "exposure_offset_s", "exposure_u_s"),
    "veiling_glare": _Use("share", "glare", "glare_u"),
    "black_level_offset": _Use("offset_dn", "black_offset_dn", ""),
    "gain_step_error": _Use("error_rel", "gain_error_rel", "gain_step_u_rel", _TYPICAL_GAIN_DB * math.log(10.0) / 20.0),
    "quantum_efficiency_temperature": _Use("coefficient_per_K", "temperature_slope_per_k", "temperature_u_rel_per_k"),
}
# Parts of the ideal chain, and effects that shape noise only: nothing is to be corrected for them.
_HARMLESS: Final = frozenset({"prnu", "dsnu", "hot_pixels", "row_temporal_noise", "excess_read_noise"})


def with_found_effects(base: Calibration, path: Path, stated: Collection[str]) -> Calibration:
    """Return the calibration with the effects of a reconciled model that readings can be corrected for.

    Args:
        base: Calibration without a scale.
        path: Model file of `radiometer reconcile`.
        stated: Names of uncertainties that the user stated and that stay as they are.

    Raises:
        InputError: If the model holds an effect that readings cannot be corrected for, or one without its u.
    """
    from simulators.camera_model import CameraModel

    found: dict[str, Any] = {}
    figures: dict[str, float] = {}
    black, lens = base.black_level, base.lens
    for entry in CameraModel.read(path).entries:
        notes, name = entry.notes, entry.effect.name
        if not entry.enabled or notes.get("found_by") != "radiometer reconcile" or name in _HARMLESS:
            continue
        if name == "natural_vignetting":
            lens = lens.model_copy(update={"vignetting": "cos4"})
            continue
        use = _USES.get(name)
        if use is None:
            there = ", ".join((*_USES, "natural_vignetting"))
            raise InputError(
                f"{path}: readings cannot be corrected for {name!r}, only for {there}; mend its cause, or switch it "
                "off in the model (enabled: false) and state its uncertainty with --stated"
            )
        _refuse_table(entry.effect.values(), f"{path}: {name}")
        value, u = entry.effect.values()[use.parameter], _u_of(notes, use.parameter, f"{path}: {name}")
        found[use.corrects] = float(value)
        found.setdefault("names", []).append(name)
        if use.states and use.states not in stated:
            figures[use.states] = u * use.per_unit
        elif not use.states:
            black = black.model_copy(update={"u_dn": u})
    uncertainties = base.uncertainties.model_copy(update=figures)
    section = type(base.found)(**{**found, "names": tuple(found.get("names", ()))})
    return replace(base, found=section, uncertainties=uncertainties, black_level=black, lens=lens)


def _refuse_table(values: Mapping[str, Any], where: str) -> None:
    """Refuse an effect whose law is a table: its one parameter says nothing of the table's entries."""
    tables = [name for name, value in values.items() if isinstance(value, tuple) and value]
    if tables:
        raise InputError(
            f"{where}: is a table ({', '.join(tables)}), and readings are corrected for one figure only; calibrate at "
            "the gain of the readings, and switch it off in the model (enabled: false)"
        )


def _u_of(notes: Mapping[str, Any], parameter: str, where: str) -> float:
    u = notes.get("u", {}).get(parameter)
    if not isinstance(u, int | float) or not (math.isfinite(u) and u >= 0):
        raise InputError(f"{where}: states no uncertainty of {parameter}; reconcile again, or add notes.u.{parameter}")
    return float(u)
