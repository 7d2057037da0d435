"""What `radiometer reconcile` found of a camera, read back from its model into a calibration."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.errors import InputError

if TYPE_CHECKING:
    from radiometer.data import Calibration, FlatField, LensDescription
    from simulators.effects.base import Effect

# The gain in dB, and the warmth in K from 25 °C, at which the uncertainty of a law is stated.
_TYPICAL_GAIN_DB: Final = 24.0
_TYPICAL_WARMER_K: Final = 15.0
_BLACK: Final = "black level"  # its uncertainty has a place of its own in a calibration
_USUAL_WELL_E: Final = 10_000.0  # what the forward model takes where nobody states one


@dataclass(frozen=True, slots=True)
class _Use:
    """Which figure a parameter becomes, and whose uncertainty it replaces (by how much per unit)."""

    corrects: str
    states: str = ""
    per_unit: float = 1.0


_LAW_OF_GAIN: Final = _TYPICAL_GAIN_DB * math.log(10.0) / 20.0
_USES: Final[Mapping[str, Mapping[str, _Use]]] = {
    "exposure_time_offset": {
        "offset_s": _Use("exposure_offset_s", "exposure_u_s"),
        "further_s": _Use("exposure_further_s", "exposure_u_s"),
        "above_db": _Use("exposure_above_db"),
    },
    "veiling_glare": {"share": _Use("glare", "glare_u")},
    "black_level_offset": {"offset_dn": _Use("black_offset_dn", _BLACK)},
    "black_level_gain_slope": {
        "slope_dn": _Use("black_slope_dn", _BLACK, 10.0 ** (_TYPICAL_GAIN_DB / 20.0) - 1.0),
        "from_db": _Use("black_from_db"),
        "bend": _Use("black_bend"),
    },
    "gain_step_error": {
        "error_rel": _Use("gain_error_rel", "gain_step_u_rel", _LAW_OF_GAIN),
        "gains_db": _Use("gains_db"),
        "errors_rel": _Use("gain_errors_rel", "gain_step_u_rel"),
    },
    "quantum_efficiency_temperature": {
        "coefficient_per_K": _Use("temperature_slope_per_k", "temperature_u_rel_per_k"),
        "bend_per_K2": _Use("temperature_bend_per_k2", "temperature_u_rel_per_k", _TYPICAL_WARMER_K),
    },
    "response_nonlinearity": {"a2": _Use("well_a2", "bend_u_rel"), "a3": _Use("well_a3", "bend_u_rel")},
}
# Parts of the ideal chain, and effects that shape noise only: nothing is to be corrected for them.
_HARMLESS: Final = frozenset({"prnu", "dsnu", "hot_pixels", "row_temporal_noise", "excess_read_noise"})


def with_found_effects(
    base: Calibration, path: Path, stated: Collection[str], shape: tuple[int, int] | None = None
) -> Calibration:
    """Return the calibration with the effects of a reconciled model that readings can be corrected for.

    Args:
        base: Calibration without a scale.
        path: Model file of `radiometer reconcile`.
        stated: Names of uncertainties that the user stated and that stay as they are.
        shape: (height, width) of the frames, for a fall-off; None where there are none.

    Raises:
        InputError: If the model holds an effect that readings cannot be corrected for, or one without its u.
    """
    from simulators.chain.camera_model import CameraModel

    found: dict[str, Any] = {}
    variances: dict[str, float] = {}
    names, flat = list[str](), base.flat_field
    model = CameraModel.read(path)
    for entry in model.entries:
        notes, effect = entry.notes, entry.effect
        if not entry.enabled or notes.get("found_by") != "radiometer reconcile" or effect.name in _HARMLESS:
            continue
        where = f"{path}: {effect.name}"
        if effect.name == "natural_vignetting":
            flat = _flat_field(effect, notes, base.lens, shape, where)
        elif effect.name not in _USES:
            there = ", ".join((*_USES, "natural_vignetting"))
            raise InputError(
                f"{path}: readings cannot be corrected for {effect.name!r}, only for {there}; remove its cause, or "
                "switch it off in the model (enabled: false) and state its uncertainty with --stated"
            )
        else:
            _take(effect, notes, where, found, variances)
        names.append(effect.name)
    if "response_nonlinearity" in names:
        well = model.camera.full_well_e or _USUAL_WELL_E
        found["well_e"] = well
        variances["bend_u_rel"] *= _full_scale_share(base, well, path) ** 2
    figures = {name: math.sqrt(v) for name, v in variances.items() if name != _BLACK and name not in stated}
    black = base.black_level
    if _BLACK in variances:
        own = 0.0 if "black_level_offset" in names else black.u_dn
        black = black.model_copy(update={"u_dn": math.hypot(own, math.sqrt(variances[_BLACK]))})
    section = type(base.found)(**{**found, "names": tuple(names)})
    uncertainties = base.uncertainties.model_copy(update=figures)
    return replace(base, found=section, uncertainties=uncertainties, black_level=black, flat_field=flat)


def _take(
    effect: Effect, notes: Mapping[str, Any], where: str, found: dict[str, Any], variances: dict[str, float]
) -> None:
    """Put an effect's parameters among what was found, and the squares of what they are uncertain by."""
    uses, usual, own = _USES[effect.name], type(effect)().values(), effect.values()
    for name, value in own.items():
        if value == usual[name]:
            continue
        if name not in uses:
            raise InputError(
                f"{where}: readings cannot be corrected for its {name!r} ({value:g}): it is not the same everywhere in "
                "the picture; calibrate where you read, and switch it off in the model (enabled: false)"
            )
        use = uses[name]
        found[use.corrects] = value
        if use.states:
            u = use.per_unit * _u_of(notes, name, where)
            variances[use.states] = variances.get(use.states, 0.0) + u**2


def _u_of(notes: Mapping[str, Any], parameter: str, where: str) -> float:
    """Return the uncertainty of a parameter; the largest of a table's entries."""
    stated = notes.get("u", {})
    figures = [u for name, u in stated.items() if name == parameter or name.startswith(f"{parameter}[")]
    if not figures or not all(isinstance(u, int | float) and math.isfinite(u) and u >= 0 for u in figures):
        raise InputError(f"{where}: states no uncertainty of {parameter}; reconcile again, or add notes.u.{parameter}")
    return float(max(figures))


def _full_scale_share(base: Calibration, well_e: float, path: Path) -> float:
    """Return full scale over the well; refuse a nonlinearity together with a response curve, which includes it."""
    if base.response is not None:
        raise InputError(
            f"{path}: response_nonlinearity and --response both bend the response. Give one of them, or switch the "
            "effect off in the model (enabled: false)"
        )
    return base.camera.full_scale_dn * base.noise.conversion_gain_e_per_dn / well_e


def _flat_field(
    effect: Effect, notes: Mapping[str, Any], lens: LensDescription, shape: tuple[int, int] | None, where: str
) -> FlatField:
    """Return the fall-off (1 + s·ρ²)⁻²·(1 − k₄·ρ⁴) as a flat field, with its uncertainty in the corners."""
    from radiometer.data import FlatField

    if shape is None:
        raise InputError(f"{where}: a fall-off needs frames of the known source, to know the picture's size")
    height, width = shape
    own, radius = effect.values(), 0.5 * math.hypot(width, height)
    s, k4 = own["strength"], own["k4"]
    x, y = lens.principal_point_px or ((width - 1) / 2.0, (height - 1) / 2.0)
    # Brighter towards the corners is no cosine: the first terms of the series stand for it.
    series = (-2.0 * s, 3.0 * s**2 - k4, -4.0 * s**3 + 2.0 * s * k4)
    law: dict[str, Any] = {"coefficients": (0.0, -k4, 0.0) if s > 0.0 else series}
    law["focal_length_px"] = radius / math.sqrt(s) if s > 0.0 else None
    of_k4 = _u_of(notes, "k4", where) if k4 else 0.0
    return FlatField(
        principal_point_px=(x + own["axis_x"] * radius, y + own["axis_y"] * radius),
        radius_px=radius,
        u_rel=math.hypot(2.0 * _u_of(notes, "strength", where) / (1.0 + s), of_k4),
        shape=shape,
        f_number=lens.f_number,
        **law,
    )
