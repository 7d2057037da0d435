"""Facts that a table of thresholds states of its run, so that its fit reports what belongs to that protocol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import radiometer
from radiometer.adaptation.method_bias import method_bias
from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.adaptation.reliability import Reliability
from radiometer.adaptation.rod_intercept import InterceptRule

LEVEL_UNIT: Final = "scotopic cd·m⁻²"  # of which a run's levels and thresholds are log₁₀


def facts_of(
    protocol: AdaptationProtocol,
    u_scale_log10: float | None = None,
    reliability: Reliability | None = None,
    visit: Mapping[str, str | float] | None = None,
) -> dict[str, str]:
    """Return the lines that stand before the thresholds of a run, by name.

    Args:
        protocol: What was done.
        u_scale_log10: Standard uncertainty that all levels share, log10 units; None where it is not known.
        reliability: Counts of false alarms, lapses and looks away; None where they are not known.
        visit: What is known of subject and visit, by name.
    """
    facts = {name: str(value) for name, value in (visit or {}).items()}
    facts |= {"protocol": protocol.name, "program": f"radiometer {radiometer.__version__}"}
    facts["level_unit"] = LEVEL_UNIT
    if protocol.shows != "break":
        facts["shows"] = protocol.shows
    bias = method_bias(protocol.method)
    if bias is not None:
        facts |= {"method_bias_log10": f"{bias.log10:.4f}", "u_method_bias_log10": f"{bias.u_log10:.4f}"}
    if u_scale_log10:
        facts["u_scale_log10"] = f"{u_scale_log10:.4f}"
    if protocol.intercept is not None:
        rule = protocol.intercept
        facts |= {
            "intercept_criterion_log10": f"{rule.criterion_log10:.4f}",
            "intercept_limit_min": f"{rule.limit_min:g}",
            "intercept_source": rule.source,
            "intercept_bleach_s": f"{protocol.bleach.duration_s:g}",
        }
    return facts if reliability is None else facts | reliability.facts()


def intercept_of(facts: Mapping[str, str]) -> InterceptRule | None:
    """Return the rod intercept that belongs to a run by its facts; None where its protocol reports none."""
    criterion = number_of(facts, "intercept_criterion_log10")
    if criterion is None:
        return None
    return InterceptRule(
        criterion,
        number_of(facts, "intercept_limit_min"),
        number_of(facts, "method_bias_log10") or 0.0,
        number_of(facts, "u_method_bias_log10") or 0.0,
        facts.get("intercept_source", ""),
        number_of(facts, "intercept_bleach_s"),
    )


def number_of(facts: Mapping[str, str], name: str) -> float | None:
    """Return a fact as a number; None where it is missing or none."""
    try:
        return float(facts[name])
    except (KeyError, ValueError):
        return None
