"""The self-contained HTML report: one picture first, then each name with what speaks for it; tables last."""

from __future__ import annotations

import html
import inspect
from pathlib import Path
from typing import Final

from radiometer.data.storage import write_text_atomic
from radiometer.reconcile.report import pictures
from radiometer.reconcile.report.words import along, seen_in
from radiometer.reconcile.result import FoundEffect, ReconcileResult
from radiometer.reconcile.search.outcome import Reconciled
from simulators.effects.catalogue import CatalogueEffect

_LISTED_PLACES: Final = 5
_WEAK_NATS: Final = 10.0
_STYLE: Final = """
:root{color-scheme:light}
body{font:16px/1.55 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a;background:#fff}
h1{font-size:1.2rem;font-weight:500;color:#555;margin:0}h2{margin:2.2rem 0 .3rem;font-size:1.25rem}
.verdict{font-size:1.7rem;font-weight:650;line-height:1.25;margin:.2rem 0 .6rem}
figure{margin:1rem 0}img{max-width:100%;height:auto;display:block}figcaption,.small{color:#595959;font-size:.9rem}
.what{margin:.2rem 0;font-size:1.05rem}
.do{border-left:4px solid #1f618d;background:#eef4f8;padding:.5rem .9rem;
margin:.8rem 0}
.tag{font-size:.8rem;font-weight:600;
border-radius:.6rem;padding:.1rem .6rem;background:#fbe9d0;color:#6b3d00;margin-left:.5rem}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums}
td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}
details{margin:.8rem 0}summary{cursor:pointer;font-weight:600}.wide{overflow-x:auto}
"""
_SAID: Final = {
    "agrees": "Nothing is missing: simulation and measurement agree.",
    "effects_found": "Found what was missing; with it they agree.",
    "unnamed_effect": "They disagree, and no known effect explains it.",
    "incomplete": "Structure stays: the names are provisional.",
}


def write_report(path: Path, reconciled: Reconciled, title: str) -> None:
    """Write the report as one HTML file that needs nothing else.

    Args:
        path: File to write.
        reconciled: What was found.
        title: Name of the capture set.

    Raises:
        OutputError: If the file cannot be written.
    """
    write_text_atomic(path, report_html(reconciled, title))


def report_html(reconciled: Reconciled, title: str) -> str:
    """Return the report as HTML."""
    result = reconciled.result
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>reconcile {html.escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1><p class='verdict'>{_SAID[result.verdict]}</p>",
        f"<p>{html.escape(_summary(result))}</p>",
        _picture(
            pictures.story(reconciled),
            "Left: every patch of every setting, measured against simulated. Right: how far settings that the fit did "
            "not see are missed, step by step; at 1 only noise is left.",
        ),
        *[_effect(effect, reconciled) for effect in result.effects],
        _following(result),
        "<h2>Where the rest lies</h2>",
        _picture(
            pictures.rest_map(reconciled.outcome.state),
            "Patches by what the final model leaves of them; within ±4 σ is chance.",
        ),
        "<h2>Figures</h2>",
        _folded("Residuals along each setting, before and after", _residuals(reconciled)),
        _folded("Where they disagreed at first, found without any known effect", _places(result)),
        _folded("Largest trend along each covariate", _covariate_table(result)),
        _folded("What these data would have shown", _limits(result)),
        _folded("What was assumed", "".join(f"<p>{html.escape(text)}.</p>" for text in result.assumptions)),
    ]
    return "\n".join(part for part in parts if part) + "\n</body></html>\n"


def _summary(result: ReconcileResult) -> str:
    names = [effect.name for effect in result.effects if effect.name != "unnamed"]
    gap = f"The gap of settings left out of the fit went from {result.gap_before:.3g} to {result.gap_after:.3g}"
    named = f" by {', '.join(names)}" if names else ""
    return (
        f"{gap}{named} ({result.gap_unit}; 1 is noise alone). {result.captures} settings, {result.frames} frames; "
        f"{result.tests[1]} of {result.tests[0]} tests still stand out."
    )


def _picture(encoded: str, caption: str) -> str:
    said = html.escape(caption)
    return f"<figure><img alt='{said}' src='data:image/png;base64,{encoded}'><figcaption>{said}</figcaption></figure>"


def _folded(title: str, content: str) -> str:
    return f"<details><summary>{title}</summary><div class='wide'>{content}</div></details>" if content else ""


def _residuals(reconciled: Reconciled) -> str:
    if not reconciled.result.covariates:
        return ""
    caption = "Means of patches, of one setting or of neighbouring settings."
    return _picture(pictures.residual_panels(reconciled), caption)


def _places(result: ReconcileResult) -> str:
    """Return where the starting model disagrees, found without the catalogue."""
    rows = "".join(
        f"<tr><td>{html.escape(place.block)}</td><td>{html.escape(place.covariate)}</td>"
        f"<td>{html.escape(place.form)}</td><td>{place.score:.1f}</td><td>{place.p_value:.2g}</td></tr>"
        for place in result.localisation[:_LISTED_PLACES]
    )
    return f"<table><tr><th>statistic</th><th>along</th><th>form</th><th>χ²</th><th>p</th></tr>{rows}</table>"


def _following(result: ReconcileResult) -> str:
    if not result.next_capture:
        return ""
    return f"<p class='do'>Next capture: {html.escape(str(result.next_capture['description']))}</p>"


def _effect(effect: FoundEffect, reconciled: Reconciled) -> str:
    present = {one.name: one for one in reconciled.outcome.state.effects}
    entry = present.get(effect.name)
    title = "Not explained by any known effect" if effect.name == "unnamed" else effect.name
    tags = [text for text, holds in (("provisional", effect.provisional), ("weak", _is_weak(effect))) if holds]
    marks = "".join(f"<span class='tag'>{text}</span>" for text in tags)
    return "".join(
        (
            f"<h2>{html.escape(title)}{marks}</h2>",
            f"<p class='what'>{html.escape(_physics(entry))}</p>" if entry else "",
            f"<p>{html.escape(_evidence(effect))}</p>",
            _effect_picture(effect, entry, reconciled),
            _parameters(effect),
            _rivals(effect),
            _advice(effect, entry),
        )
    )


def _is_weak(effect: FoundEffect) -> bool:
    return effect.name != "unnamed" and effect.gain_nats < _WEAK_NATS


def _physics(entry: CatalogueEffect) -> str:
    """Return what an effect does, in the words of its own file."""
    return (inspect.getdoc(type(entry)) or "").partition("\n\n")[0].replace("\n", " ")


def _evidence(effect: FoundEffect) -> str:
    said = f"It shows in {seen_in(effect.block)}, {along(effect.where)}."
    if effect.name == "unnamed":
        return said
    closed = f" With it the gap falls from {effect.gap_before:.3g} to {effect.gap_after:.3g}"
    weak = "; that is little: repeat the captures" if _is_weak(effect) else ""
    return f"{said}{closed}, and settings left out are predicted better by {effect.gain_nats:.0f} nats{weak}."


def _effect_picture(effect: FoundEffect, entry: CatalogueEffect | None, reconciled: Reconciled) -> str:
    if entry is None:
        return ""
    first = next(iter(effect.parameters.values()), None)
    known = first is not None and first.u is not None and first.value != 0
    u_rel = abs(first.u / first.value) if known and first is not None and first.u is not None else None
    encoded = pictures.effect_plot(reconciled.outcome.state, entry, u_rel)
    caption = "Points: what is left without it, with k = 1 bars. Line: what it predicts, with its k = 2 band."
    return _picture(encoded, caption) if encoded else ""


def _parameters(effect: FoundEffect) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{entry.value:.6g}</td>"
        f"<td>{'' if entry.u is None else f'± {entry.u:.2g}'}</td><td>{html.escape(entry.unit)}</td></tr>"
        for name, entry in effect.parameters.items()
    )
    return f"<table>{rows}</table>" if rows else ""


def _rivals(effect: FoundEffect) -> str:
    closest = (
        f"<p>Closest known effect: {html.escape(effect.closest[0])}, which explains {100 * effect.closest[1]:.0f} % "
        "of it.</p>"
        if effect.closest
        else ""
    )
    if not effect.alternatives:
        return closest
    others = html.escape(", ".join(effect.alternatives))
    only = "Each ± holds only if it is this one: it knows nothing of the choice among them."
    return f"{closest}<p>These data cannot tell it from {others}. {only}</p>"


def _advice(effect: FoundEffect, entry: CatalogueEffect | None) -> str:
    """Return what to do at the bench: the capture that settles the choice, else what would show the effect best."""
    following = str(effect.next_capture.get("description", "")) if effect.next_capture else ""
    if following:
        return f"<p class='do'>To settle it, take: {html.escape(following)}</p>"
    return f"<p class='small'>To see it alone: {html.escape(entry.settles)}.</p>" if entry and entry.settles else ""


def _covariate_table(result: ReconcileResult) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{gap.before:.1f}</td><td>{gap.after:.1f}</td></tr>"
        for name, gap in sorted(result.covariates.items(), key=lambda item: -item[1].before)
    )
    head = "<tr><th>covariate</th><th>before</th><th>after</th></tr>"
    note = "<p class='small'>Largest trend's χ² per degree of freedom; 1 is chance.</p>"
    return f"<table>{head}{rows}</table>{note}"


def _limits(result: ReconcileResult) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{'blind' if v.amplitude is None else f'{v.amplitude:.3g}'}</td>"
        f"<td>{html.escape('' if v.unit == '1' else v.unit)}</td><td>{html.escape(v.parameter)}</td></tr>"
        for name, v in result.limits.items()
    )
    note = "<p class='small'>Sizes that would stand out by 5 sigma; “nothing is missing” holds above these only.</p>"
    head = "<tr><th>effect</th><th>from</th><th>unit</th><th>parameter</th></tr>"
    return f"{note}<table>{head}{rows}</table>" if rows else ""
