"""Right or wrong: the finder's answer held against what was hidden."""

from __future__ import annotations

import math
from typing import Any

from testing.generator.registry import Hidden, everything

# Covariates by what they are called in results, where the truth's own word differs.
SAME = {
    "image_x": {"image_x", "screen_x", "field_radius", "image_y", "screen_y"},
    "image_y": {"image_y", "screen_y", "field_radius", "image_x", "screen_x"},
    "screen_x": {"screen_x", "image_x", "screen_y", "image_y"},
    "screen_y": {"screen_y", "image_y", "screen_x", "image_x"},
    "field_radius": {"field_radius", "image_x", "image_y", "screen_x", "screen_y"},
    "temperature_C": {"temperature_C", "sensor_temperature", "temperature"},
    "source_level": {"source_level", "drive", "drive_level"},
    "timestamp_s": {"timestamp_s", "time", "timestamp"},
    "exposure_s": {"exposure_s", "exposure_time"},
    "gain_db": {"gain_db", "gain"},
    "patch_level": {"patch_level", "pattern", "signal"},
    "frame": {"frame", "previous_frame", "first"},
    "code": {"code", "signal"},
    "edge": {"edge", "image_x", "image_y", "f_number", "none", "signal"},
}

# Parameter of the truth, parameter of the finder's entry, factor between them.
PARAMETERS: dict[str, tuple[tuple[str, str, float], ...]] = {
    "black_level_offset": (("offset_dn", "offset_dn", 1.0),),
    "black_level_drift": (("slope_dn_per_K", "drift_dn_per_K", 1.0),),
    "black_level_gain_slope": (("offset_e", "slope_dn", 1 / 2.6),),
    "exposure_time_offset": (("offset_s", "offset_s", 1.0),),
    "conversion_gain_error": (("relative_error", "error_rel", 1.0),),
    "excess_read_noise": (("sigma_e", "excess_e", 1.0),),
    "rolling_shutter_banding": (("depth", "modulation", 1.0), ("row_s", "row_time_s", 1.0)),
    "row_temporal_noise": (("sigma_e", "sigma_e", 1.0),),
    "column_pattern": (("sigma_e", "sigma_e", 1.0),),
    "row_pattern": (("sigma_e", "sigma_e", 1.0),),
    "dsnu": (("sigma_e", "sigma_e", 1.0),),
    "prnu": (("sigma_rel", "sigma_rel", 1.0),),
    "brighter_fatter": (("b", "share", 1.0),),
    "crosstalk": (("fraction", "share", 1.0),),
    "image_lag": (("fraction", "share", 1.0),),
    "veiling_glare": (("fraction", "share", 1.0),),
    "ghost": (("fraction", "share", 1.0),),
    "display_black_leak": (("fraction", "share", 1.0),),
    "led_thermal_droop": (("k", "droop_rel", 1.0),),
    "response_nonlinearity": (("a2", "a2", 1.0), ("a3", "a3", 1.0)),
    "source_warmup_drift": (("tau_s", "tau_s", 1.0),),
    "psf_blur": (("sigma_px", "sigma_px", 1.0),),
    "defocus": (("sigma_px_at_f2.8", "sigma_f1_px", 2.8),),
    "fnumber_tstop_error": (("relative_error_per_stop", "error_per_stop", 1.0),),
    "quantum_efficiency_temperature": (("slope_per_K", "coefficient_per_K", 1.0),),
    "full_well_saturation": (("full_well_e", "full_well_e", 1.0),),
    "mains_ripple": (("depth", "modulation", 1.0),),
    "gamma_enabled": (("gamma", "gamma", 1.0),),
    "dark_current": (("rate_e_per_s", "rate_e_per_s", 1.0), ("doubling_K", "doubling_K", 1.0)),
    "dark_current_clamped": (("rate_e_per_s", "rate_e_per_s", 1.0), ("doubling_K", "doubling_K", 1.0)),
    "display_gamma_error": (("exponent_error", "exponent", 1.0),),
    "reciprocity_failure": (("p", "exponent", 1.0),),
    "shutter_dead_time": (("dead_s", "dead_time_s", 1.0),),
    "source_not_proportional_to_exposure": (("settle_s", "tau_s", 1.0),),
    "pwm_flicker": (("depth", "modulation", 1.0), ("frequency_Hz", "frequency_hz", 1.0)),
    "gain_step_error": (("relative_error", "error_rel", 1.0),),
    "mechanical_vignetting": (("depth", "strength", 1.4**2),),  # at f/2 what holds at f/2.8
    "natural_vignetting": (("k4", "k4", 1.0),),
    "parasitic_light_sensitivity": (("leak", "leak_s", 0.02 * 95 / 96),),  # times the read-out, up to the last row
    "row_dependent_exposure": (("added_s", "added_s", 1.0), ("lost_share", "lost_share", 1.0)),
    "adc_saturation": (("clip_dn", "clip_dn", 1.0),),
    "dark_frame_subtracted": (("share", "share", 1.0), ("pedestal_dn", "pedestal_dn", 1.0)),
}


# What a limit is the size of: parameter of the truth and factor, next to the first of PARAMETERS.
SIZES: dict[str, tuple[str, float]] = {name: (pairs[0][0], pairs[0][2]) for name, pairs in PARAMETERS.items()} | {
    "dark_current": ("rate_e_per_s", 1.0),
    "dark_current_clamped": ("rate_e_per_s", 1.0),
    "dark_current_nonuniformity": ("sigma_e_per_s", 1.0),
    "source_warmup_drift": ("amplitude", 1.0),
    "reciprocity_failure": ("p", 1.0),
    "shutter_dead_time": ("dead_s", 1.0),
    "display_gamma_error": ("exponent_error", 1.0),
    "pwm_flicker": ("depth", 1.0),
    "rolling_shutter_banding": ("depth", 1.0),
    "source_not_proportional_to_exposure": ("excess", 1.0),
    "stray_light_kernel": ("fraction", 1.0),
    "ambient_light_leak": ("fraction", 15.708),  # of 5 W·sr⁻¹·m⁻², as irradiance: π·L
}
for _name in ("gamma_enabled", "full_well_saturation", "adc_saturation", "natural_vignetting", "dark_frame_subtracted"):
    del SIZES[_name]  # what is compared does nothing at another value than 0, or is not the size


def judge(answer: dict[str, Any], hidden: tuple[str, ...], without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return what is right and wrong about an answer.

    Args:
        answer: The documented JSON object, with "localisation" where the finder gives it.
        hidden: Names of what was hidden.
        without: Entries that were taken out of the catalogue.

    Returns:
        first: the first name is right; exact: all names right, none extra; named: every hidden one is named;
        wrong_names: names that nothing hidden justifies; confident_wrong: the verdict is effects_found and there is
        such a name; family_or_place: right name first, or unnamed in the right place; place3: a right place among
        the first three; missed: the verdict is agrees.
    """
    truths = [everything()[n] for n in hidden]
    names = [e["name"] for e in answer["effects"] if e["name"] != "unnamed"]
    expected = [_names(h) - set(without) for h in truths]
    right = [n for n in names if any(n in w for w in expected)]
    wrong = [n for n in names if n not in right]
    covered = [any(n in w for n in names) for w in expected]
    first = bool(names) and bool(right) and names[0] == right[0] and answer["effects"][0]["name"] == names[0]
    places = _places(answer)
    in_place = any(_same_place(p, truths) for p in places[:3])
    unnamed_first = bool(answer["effects"]) and answer["effects"][0]["name"] == "unnamed"
    return {
        "verdict": answer["verdict"],
        "names": names,
        "wrong_names": wrong,
        "first": first,
        "named": bool(covered) and all(covered),
        "exact": bool(covered)
        and all(covered)
        and not wrong
        and len(names) == len(answer["effects"])
        and answer["verdict"] == "effects_found",
        "confident_wrong": answer["verdict"] == "effects_found" and bool(wrong),
        "family_or_place": first or (unnamed_first and _same_place(answer["effects"][0].get("where", ""), truths)),
        "place3": in_place,
        "missed": answer["verdict"] == "agrees",
    }


def honesty(answer: dict[str, Any], hidden: str, truth: dict[str, Any]) -> str:
    """Return in one word how an answer to data that may not tell is to be judged.

    Args:
        answer: The documented JSON object, limits included.
        hidden: Name of what was hidden.
        truth: Its true parameters.

    Returns:
        named; rival: the truth stands among the alternatives of the one name given; provisional: incomplete or
        unnamed; blind: agrees, with a limit of null; below: agrees, at a size up to the limit; near: agrees, up to
        twice the limit; missed: agrees beyond that; agrees: agrees, at a size that cannot be compared; wrong.
    """
    effects, verdict = answer["effects"], answer["verdict"]
    if verdict == "agrees":
        stated_c = answer["limit_parameters"].get(hidden, {}).get("temperature_C", 25.0)
        return _below(answer["limits"].get(hidden), hidden, truth, stated_c)
    if verdict != "effects_found":
        return "provisional"
    right = _names(everything()[hidden])
    if all(effect["name"] in right for effect in effects):
        return "named"
    reported = all(right & {effect["name"], *effect["alternatives"]} for effect in effects)
    return "rival" if reported and len(effects) == 1 else "wrong"


def _below(limit: float | None, hidden: str, truth: dict[str, Any], stated_c: float) -> str:
    if limit is None:
        return "blind"
    if hidden not in SIZES:
        return "agrees"
    mine, factor = SIZES[hidden]
    if "per_s" in mine:
        factor *= _at(stated_c, truth)
    ratio = abs(float(truth[mine])) * factor / limit
    return "below" if ratio <= 1.0 else "near" if ratio <= 2.0 else "missed"


def _at(stated_c: float, truth: dict[str, Any]) -> float:
    """Return what share of a hidden dark current is left at the temperature that an entry or limit is stated at."""
    warmer = float(truth.get("reference_C", 25.0)) - stated_c
    return float(2.0 ** (-warmer / truth.get("doubling_K", 7.0)))


def _names(hidden: Hidden) -> set[str]:
    return ({hidden.entry} if hidden.entry else set()) | set(hidden.accepted)


def _places(answer: dict[str, Any]) -> list[str]:
    listed = list(dict.fromkeys(t["covariate"] for t in answer.get("localisation", ())))
    return listed or [e.get("where", "") for e in answer["effects"]]


def _same_place(place: str, truths: list[Hidden]) -> bool:
    return any(place == c or place in SAME.get(c, ()) for h in truths for c in h.covariates)


def parameters(answer: dict[str, Any], truth: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return every parameter that truth and answer share, with its deviation in reported sigmas."""
    found = []
    for effect in answer["effects"]:
        pairs = PARAMETERS.get(effect["name"], ()) if effect["name"] in truth else ()
        for mine, theirs, factor in pairs:
            entry = effect["parameters"].get(theirs)
            if entry is None or not entry.get("u"):
                continue
            hidden = truth[effect["name"]]
            stated_c = effect["parameters"].get("reference_C", {"value": 25.0})["value"]
            true = float(hidden[mine]) * factor * (_at(stated_c, hidden) if "per_s" in mine else 1.0)
            z = (entry["value"] - true) / entry["u"]
            found.append({"parameter": f"{effect['name']}.{theirs}", "true": true, "found": entry["value"], "z": z})
    return [p for p in found if math.isfinite(p["z"])]
