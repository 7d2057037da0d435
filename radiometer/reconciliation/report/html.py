"""The self-contained HTML report: one picture first, then each name with its evidence; tables last."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Final

from radiometer.data.storage import write_text_atomic
from radiometer.numbers import unit_text, with_u
from radiometer.reconciliation.report import pictures
from radiometer.reconciliation.report.words import along, axis_label, seen_in
from radiometer.reconciliation.result import FoundEffect, ReconcileResult, Verdict
from radiometer.reconciliation.search.outcome import Reconciled
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import folded, heading, listed, page, paragraph, section, table
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.registry import all_effects

_LISTED_PLACES: Final = 5
_WEAK_NATS: Final = 10.0


def write_report(path: Path, reconciled: Reconciled, title: str, origin: Origin) -> None:
    """Write the report as one HTML file that needs nothing else.

    Args:
        reconciled: What was found.
        title: Name of the capture set.
        origin: Camera, lens, date and whatever else is known of the data.

    Raises:
        OutputError: If the file cannot be written.
    """
    write_text_atomic(path, report_html(reconciled, title, origin))


def report_html(reconciled: Reconciled, title: str, origin: Origin) -> str:
    """Return the report as HTML."""
    result = reconciled.result
    return page(
        title,
        outcome(result),
        [
            paragraph(_summary(result)),
            pictures.story(reconciled),
            *[_effect(effect, reconciled) for effect in result.effects],
            _following(result),
            _repeats(result),
            section("Where the residual is", pictures.rest_map(reconciled.outcome.state)),
            heading("Figures"),
            folded("Equal frames, each less the others of its series", _frames(result)),
            folded(
                "Residuals along each setting, before and after",
                pictures.residual_panels(reconciled) if result.covariates else "",
            ),
            folded(
                "Where simulation and measurement disagreed at first, found without any known effect", _places(result)
            ),
            folded("Largest trend along each covariate", _covariate_table(result)),
            folded("What these data would have detected", _limits(result)),
            folded("What was assumed", listed([f"{text}." for text in result.assumptions])),
        ],
        kind="reconcile",
        origin=origin,
    )


def outcome(result: ReconcileResult) -> str:
    """Return in one sentence what was missing, with the size of each and its U (k = 2), or that nothing was."""
    named = [f"{effect.name}{_size(effect)}" for effect in result.effects if effect.name != "unnamed"]
    names = " and ".join(part for part in (", ".join(named[:-1]), *named[-1:]) if part)
    if result.verdict is Verdict.AGREES:
        return f"Nothing is missing: simulation and measurement agree (gap {result.gap_after:.3g}; 1 is noise alone)."
    if result.verdict is Verdict.EFFECTS_FOUND:
        return f"The missing effect was found: {names}. With {'it' if len(named) == 1 else 'them'} they agree."
    if result.verdict is Verdict.UNNAMED:
        where = next((along(effect.where) for effect in result.effects if effect.name == "unnamed"), "")
        return f"Simulation and measurement differ {where}, and no known effect explains it.".replace("  ", " ")
    return f"Structure remains{'; these names are provisional: ' + names if names else ', and no name is certain'}."


def _size(effect: FoundEffect) -> str:
    """Return the first parameter of an effect with its U (k = 2), in brackets; nothing where it has none."""
    for name, entry in effect.parameters.items():
        if entry.u is not None:
            unit = unit_text(entry.unit)
            return f" ({_plain(name, entry.unit)} {with_u(entry.value, 2.0 * entry.u, unit)})"
    return ""


def _plain(name: str, unit: str) -> str:
    """Return a parameter's name without its unit, which is shown with the value."""
    stem, _, last = name.rpartition("_")
    return (stem if stem and last.casefold() == unit.casefold().rstrip("-") else name).replace("_", " ")


def _summary(result: ReconcileResult) -> str:
    names = [effect.name for effect in result.effects if effect.name != "unnamed"]
    gap = f"The gap of settings left out of the fit went from {result.gap_before:.3g} to {result.gap_after:.3g}"
    if not result.effects:
        gap = f"The gap of settings left out of the fit is {result.gap_after:.3g}"
    named = f" by {', '.join(names)}" if names else ""
    return (
        f"{gap}{named} ({result.gap_unit}; 1 is noise alone). {result.captures} settings, {result.frames} frames; "
        f"{result.tests[1]} of {result.tests[0]} tests still stand out."
    )


def _places(result: ReconcileResult) -> str:
    """Return where the starting model disagrees, found without the catalogue."""
    rows = [
        (seen_in(place.block), along(place.covariate), place.form, f"{place.score:.1f}", f"{place.p_value:.2g}")
        for place in result.localisation[:_LISTED_PLACES]
    ]
    return table(("what", "along", "form", "χ²", "p"), rows, words=(1, 2))


def _repeats(result: ReconcileResult) -> str:
    """Return in words what equal frames differ by."""
    message = [f"{text[0].upper()}{text[1:]}." for one in result.repeats for text in one.sentences()]
    return section("How equal frames differ", listed(message)) if message else ""


def _frames(result: ReconcileResult) -> str:
    """Return each frame less the others of its series."""
    rows = []
    for part in result.repeats:
        scale, unit = (100.0, "%") if part.scatter.unit == "1" else (1.0, part.scatter.unit)
        for one in part.series:
            apart = (with_u(scale * value, 2.0 * scale * u, unit) for value, u in zip(one.apart, one.u, strict=True))
            rows += [(str(n), f"{one.exposure_s:.4g} s", shown) for n, shown in zip(one.frames, apart, strict=True)]
    return table(("frame", "exposure", "apart (k = 2)"), rows)


def _following(result: ReconcileResult) -> str:
    if not result.next_capture:
        return ""
    return paragraph(f"Next capture: {result.next_capture['description']}", "do")


def _effect(effect: FoundEffect, reconciled: Reconciled) -> str:
    present = {one.name: one for one in reconciled.outcome.state.effects}
    entry = present.get(effect.name)
    title = "Not explained by any known effect" if effect.name == "unnamed" else effect.name
    tags = [text for text, holds in (("provisional", effect.provisional), ("weak", _is_weak(effect))) if holds]
    return "\n".join(
        (
            heading(title, tags),
            paragraph(_physics(type(entry)), "what") if entry else "",
            paragraph(_evidence(effect)),
            _effect_picture(effect, entry, reconciled),
            _parameters(effect),
            _law(effect),
            _rivals(effect),
            _advice(effect, entry),
        )
    )


def _is_weak(effect: FoundEffect) -> bool:
    return effect.name != "unnamed" and effect.gain_nats < _WEAK_NATS


def _physics(kind: type[CatalogueEffect]) -> str:
    """Return the description of an effect from its file."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def _evidence(effect: FoundEffect) -> str:
    sentence = f"It shows in {seen_in(effect.block)}, {along(effect.where)}."
    if effect.name == "unnamed":
        return sentence
    closed = f" With it the gap falls from {effect.gap_before:.3g} to {effect.gap_after:.3g}"
    weak = "; that is little: repeat the captures" if _is_weak(effect) else ""
    known = f" {effect.evidence.capitalize()}." if effect.probability is not None else ""
    return (
        f"{sentence}{closed}, and settings left out are predicted better by {effect.gain_nats:.0f} nats{weak}.{known}"
    )


def _effect_picture(effect: FoundEffect, entry: CatalogueEffect | None, reconciled: Reconciled) -> str:
    state = reconciled.outcome.state
    if entry is None:
        return pictures.unnamed_plot(state, effect.where, effect.block) or ""
    first = next(iter(effect.parameters.values()), None)
    known = first is not None and first.u is not None and first.value != 0
    u_rel = abs(first.u / first.value) if known and first is not None and first.u is not None else None
    return pictures.effect_plot(state, entry, u_rel) or ""


def _parameters(effect: FoundEffect) -> str:
    rows = []
    for name, entry in effect.parameters.items():
        shown = with_u(entry.value, 2.0 * entry.u if entry.u is not None else 0.0, entry.unit)
        rows.append((_plain(name, entry.unit), shown, "not fitted" if entry.u is None else ""))
    return table(("parameter", "value (k = 2)", ""), rows, words=(2,))


def _law(effect: FoundEffect) -> str:
    """Return the curve of another law than the catalogue's; of a table a row for each knot of the first covariate."""
    if effect.curve is None:
        return ""
    (first, knots), *second = effect.curve.along.items()
    columns = second[0][1] if second else (None,)
    shown = [_with_band(value, u) for value, u in zip(effect.curve.factor, effect.curve.u, strict=True)]
    width = len(columns)
    rows = [(f"{at:.3g}", *shown[n * width : (n + 1) * width]) for n, at in enumerate(knots)]
    heads = ("factor",) if not second else tuple(f"{axis_label(second[0][0])[0]} {at:.3g}" for at in columns)
    sentence = "It follows another functional form: the factors below multiply the catalogue's equation, ± U (k = 2)."
    return paragraph(sentence) + table((axis_label(first)[0], *heads), rows)


def _with_band(value: float, u: float | None) -> str:
    return f"{value:.3g}" if u is None else with_u(value, 2.0 * u, "")


def _rivals(effect: FoundEffect) -> str:
    closest = (
        paragraph(
            f"Closest known effect: {effect.closest[0]}, which explains {100 * effect.closest[1]:.0f} % of it."
            f"{_in_words(effect.closest[0])}"
        )
        if effect.closest
        else ""
    )
    if not effect.alternatives:
        return closest
    others = listed([f"{name}.{_in_words(name)}" for name in effect.alternatives])
    together = f" ({effect.evidence_of_any})" if effect.evidence_of_any else ""
    only = "Each ± is conditional on this effect being the right one."
    return f"{closest}{paragraph(f'These data cannot separate it from{together}:')}{others}{paragraph(only, 'small')}"


def _in_words(name: str) -> str:
    """Return what the effect of a name is, as a further sentence; nothing where it is in no catalogue."""
    kind = all_effects().get(name)
    return f" {_physics(kind)}" if kind is not None and issubclass(kind, CatalogueEffect) else ""


def _advice(effect: FoundEffect, entry: CatalogueEffect | None) -> str:
    """Return what to do at the bench: the capture that settles the choice, else what would show the effect best."""
    following = str(effect.next_capture.get("description", "")) if effect.next_capture else ""
    if following:
        return paragraph(f"To settle it, take: {following}", "do")
    if effect.name == "unnamed":
        what = axis_label(effect.where)[0]
        return paragraph(f"To learn more, vary nothing but this, in more steps and in another order: {what}.", "do")
    return paragraph(f"To see it alone: {entry.settles}.", "do") if entry and entry.settles else ""


def _covariate_table(result: ReconcileResult) -> str:
    rows = [
        (along(name), f"{gap.before:.1f}", f"{gap.after:.1f}")
        for name, gap in sorted(result.covariates.items(), key=lambda item: -item[1].before)
    ]
    note = "Largest trend's χ² per degree of freedom; a single trend has 1 by chance."
    return table(("covariate", "before", "after"), rows) + paragraph(note, "small")


def _limits(result: ReconcileResult) -> str:
    rows = [
        (
            name,
            "blind" if v.amplitude is None else f"{v.amplitude:.3g}",
            unit_text(v.unit),
            v.parameter.replace("_", " "),
        )
        for name, v in result.limits.items()
    ]
    note = "Sizes that would stand out by 5 sigma; “nothing is missing” holds only for larger effects."
    shown = table(("effect", "from", "unit", "parameter"), rows, words=(2, 3))
    return f"{paragraph(note, 'small')}{shown}" if shown else ""
