"""Counts of the confusion matrix, each with its denominator and an exact interval."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks._reconcile_tasks import KINDS
from testing.generator.registry import OUTSIDERS

Result = dict[str, Any]


def report(results: list[Result]) -> str:
    """Return the page's section in Markdown."""
    crashed = [r for r in results if "error" in r]
    fine: dict[str, list[Result]] = defaultdict(list)
    for r in results:
        if "error" not in r:
            fine[r["kind"]].append(r)
    rows = ["| measure | required | reached | 95 % interval |", "|---|---|---|---|"]
    rows += [_row(*line) for line in _measures(fine) if line[2]]
    parts = [
        "\n".join(rows),
        _other_equations(fine),
        _fresh(fine),
        _parameters(fine),
        _calibration(fine),
        _times(results),
        _confusion(fine),
    ]
    if crashed:
        parts.append("Runs that ended in an error:\n\n" + "\n".join(f"* `{r['key']}`: {r['error']}" for r in crashed))
    return "\n\n".join(p for p in parts if p)


HONESTY = {
    "named": "right name, with alternatives or without",
    "rival": "another name, the right one among its alternatives",
    "provisional": "incomplete or unnamed: the names are provisional",
    "blind": "agrees, and the limit is null: these data cannot see it",
    "below": "agrees, at a size up to its limit",
    "near": "agrees, at a size between its limit and twice it",
    "agrees": "agrees, at a size that cannot be compared with its limit",
    "missed": "agrees, at more than twice its limit",
    "wrong": "confidently wrong",
}


def plain_report(results: list[Result]) -> str:
    """Return the table of what plain brackets can tell, in Markdown."""
    parts = [
        "Twelve exposures of one chart, twice each, and four darks. Each session hides one entry, at one to two times "
        "its smallest realistic size.",
        "| answer | radiances of patches stated | not stated |\n|---|---|---|",
    ]
    kinds = ("plain", "plain_unknown")
    fine = {k: [r for r in results if r["kind"] == k and "error" not in r] for k in kinds}
    for word, meaning in HONESTY.items():
        counts = [f"{sum(r['honesty'] == word for r in fine[k])}/{len(fine[k])}" for k in kinds]
        parts[-1] += f"\n| {meaning} | {counts[0]} | {counts[1]} |"
    for k, patches in zip(kinds, ("stated", "unknown"), strict=True):
        listed = "; ".join(_in_words(r) for r in fine[k] if r["honesty"] not in ("named", "blind", "below"))
        parts.append(f"Patches {patches}, what was neither named nor beyond these data: {listed or 'nothing'}.")
    z = np.array([abs(p["z"]) for k in kinds for r in fine[k] if r["judged"]["exact"] for p in r["parameters"]])
    if z.size:
        within = ", ".join(f"{int((z <= n).sum())}/{z.size} within {n}" for n in (1, 2, 3))
        parts.append(
            f"Parameters of exactly named effects, in reported sigmas from the truth: {within}; rms "
            f"{float(np.sqrt(np.mean(z**2))):.2f}. The sigmas know nothing of the choice of the name."
        )
    crashed = [r for r in results if "error" in r]
    parts += [f"* `{r['key']}` ended in an error: {r['error']}" for r in crashed]
    return "\n\n".join(parts)


def _in_words(result: Result) -> str:
    answer = " + ".join(e["name"] if e["name"] != "unnamed" else f"? ({e['where']})" for e in result["effects"])
    return f"{result['names'][0]} ({result['honesty']}: {answer or 'agrees'})"


def other_equation(result: Result) -> bool:
    """Tell whether something was hidden by another equation than the model's: another form, or an outsider."""
    return any(":" in name or name in OUTSIDERS for name in result["names"])


def _other_equations(fine: dict[str, list[Result]]) -> str:
    hidden = [r for kind in KINDS for r in fine[kind] if r["names"]]
    if not hidden:
        return ""
    counts = Counter(r["kind"] for r in hidden if other_equation(r))
    total = Counter(r["kind"] for r in hidden)
    listed = ", ".join(f"{kind} {counts[kind]}/{total[kind]}" for kind in KINDS if total[kind])
    share = _share(sum(counts.values()), len(hidden)).split(" | ")[0]
    return (
        "Hidden by another equation than the model's (another form of an entry, in a pair at least one of the two, or "
        f"outside the catalogue; required: at least a third of all hidden cases): {share}: {listed}."
    )


def _is(name: str) -> Callable[[Result], bool]:
    return lambda r: bool(r["judged"][name])


def _named_exactly(result: Result) -> bool:
    """Tell whether the names given are the hidden ones and no other, whatever the verdict."""
    return bool(result["judged"]["named"] and not result["judged"]["wrong_names"])


def _measures(fine: dict[str, list[Result]]) -> list[tuple[str, str, list[Result], Callable[[Result], bool]]]:
    alarm: Callable[[Result], bool] = lambda r: r["judged"]["verdict"] != "agrees"  # noqa: E731
    other = {kind: [r for r in fine[kind] if other_equation(r)] for kind in ("weak", "pair")}
    own = {kind: [r for r in fine[kind] if not other_equation(r)] for kind in ("weak", "pair")}
    own["pair"] += fine["own_pair"]
    shown = [r for r in own["weak"] if r["honesty"] not in ("below", "blind")]
    return [
        ("nothing hidden: false alarm", "≤ 2 %", fine["null"], alarm),
        ("nothing hidden: false name", "≤ 1 %", fine["null"], lambda r: bool(r["judged"]["names"])),
        ("one hidden: right name first", "≥ 98 %", fine["single"], _is("first")),
        ("one hidden: exactly named", "≥ 95 %", fine["single"], _named_exactly),
        ("– and sure of it: effects_found, nothing unnamed", "", fine["single"], _is("exact")),
        ("one hidden: confidently wrong", "≤ 1 %", fine["single"], _is("confident_wrong")),
        ("one hidden: missed", "", fine["single"], _is("missed")),
        ("0.3 of the size: right name first", "≥ 95 %", fine["weak"], _is("first")),
        ("– of these by the catalogue's equation", "", own["weak"], _is("first")),
        ("– of these, without missed ones that the data cannot show", "≥ 95 %", shown, _is("first")),
        ("two hidden, of all equations: both named", "≥ 95 %", fine["pair"], _is("named")),
        ("two hidden, both by the catalogue's equation: both named", "≥ 95 %", own["pair"], _is("named")),
        ("two hidden, of all equations: exactly named", "≥ 85 %", fine["pair"], _named_exactly),
        ("– and sure of it: effects_found, nothing unnamed", "", fine["pair"], _is("exact")),
        ("two hidden, both by the catalogue's equation: exactly named", "≥ 85 %", own["pair"], _named_exactly),
        ("– and sure of it: effects_found, nothing unnamed", "", own["pair"], _is("exact")),
        ("two hidden, all pairs: confidently wrong", "≤ 1 %", fine["pair"] + fine["own_pair"], _is("confident_wrong")),
        (
            "another equation: right name first, or a curve without a name along the right covariate",
            "≥ 95 %", fine["variant"], _is("family_or_place"),
        ),
        ("another equation, 0.3 of the size: the same", "", other["weak"], _is("family_or_place")),
        ("another equation in a pair: both named", "", other["pair"], _is("named")),
        ("another equation: confidently wrong", "", fine["variant"], _is("confident_wrong")),
        ("entry removed: confidently wrong", "≤ 3 %", fine["removed"], _is("confident_wrong")),
        ("entry removed: right covariate in the first three", "≥ 95 %", fine["removed"], _is("place3")),
        ("outside the catalogue: confidently wrong", "≤ 3 %", fine["outsider"], _is("confident_wrong")),
        ("outside the catalogue: right covariate in the first three", "≥ 95 %", fine["outsider"], _is("place3")),
        ("outside the catalogue: missed", "", fine["outsider"], _is("missed")),
        ("radiances of patches not stated: right name first", "", fine["unknown"], _is("first")),
        ("radiances of patches not stated: confidently wrong", "", fine["unknown"], _is("confident_wrong")),
    ]  # fmt: skip


def _row(name: str, required: str, results: list[Result], holds: Callable[[Result], bool]) -> str:
    hits = sum(map(holds, results))
    return f"| {name} | {required} | {_share(hits, len(results))} |"


def _share(hits: int, total: int) -> str:
    """Return hits/total, percent and the Clopper–Pearson interval, as two cells."""
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, total - hits + 1))
    high = 1.0 if hits == total else float(beta.ppf(0.975, hits + 1, total - hits))
    return f"{hits}/{total} ({100 * hits / total:.1f} %) | {100 * low:.1f} to {100 * high:.1f} %"


def _fresh(fine: dict[str, list[Result]]) -> str:
    """Return how well the found effects meet a fresh session: those of the model's equation, then of another."""
    lines = [
        "Where the right name was first, the found effects were tried in a new session of the same simulated camera "
        "and scene. They were fixed there, and only nuisance parameters were fitted. The excess is the reduced χ² less "
        "1. Wrong exposure labels, which no second session repeats, are left out.",
        "",
        "| measure | required | reached | 95 % interval |",
        "|---|---|---|---|",
    ]
    text = []
    for kind, what in (("single", "one hidden"), ("variant", "another equation")):
        named = [r for r in fine[kind] if r.get("fresh") and r["judged"]["first"]]
        if named:
            before, after = (np.array([r["fresh"][k] for r in named]) for k in ("before", "after"))
            lines += _fresh_rows(what, before, after)
            text.append(_fresh_text(what, named, before, after))
    return "\n".join([*lines, "", *text]) if text else ""


def _fresh_rows(what: str, before: np.ndarray, after: np.ndarray) -> list[str]:
    rows = [f"| {what}: reduced χ² ≤ 1.05 after | ≥ 95 % | {_share(int((after <= 1.05).sum()), after.size)} |"]
    large = before > 1.05
    if large.any():
        closed = (before[large] - after[large]) / (before[large] - 1.0)
        share = _share(int((closed >= 0.9).sum()), closed.size)
        rows.append(f"| {what}: ≥ 90 % of the excess closed, where the reduced χ² was above 1.05 | ≥ 95 % | {share} |")
    return rows


def _fresh_text(what: str, named: list[Result], before: np.ndarray, after: np.ndarray) -> str:
    high = np.percentile(after, 95)
    worst = sorted(zip(after, before, named, strict=True), key=lambda t: -t[0])[:5]
    listed = ", ".join(f"{r['names'][0]} {b:.2f} → {a:.3f}" for a, b, r in worst)
    middle = f"median {np.median(before):.3f} before, {np.median(after):.3f} after; 95th percentile after {high:.3f}"
    return f"{what.capitalize()}: {middle}; worst {listed}."


def _parameters(fine: dict[str, list[Result]]) -> str:
    found = [p for r in fine["single"] if r["judged"]["exact"] for p in r["parameters"]]
    if not found:
        return ""
    z = np.abs([p["z"] for p in found])
    by_name: dict[str, list[float]] = defaultdict(list)
    for p in found:
        by_name[p["parameter"]].append(abs(p["z"]))
    bad = {n: v for n, v in by_name.items() if max(v) > 3}
    share = _share(int((z <= 3).sum()), z.size).replace(" | ", ", ")
    text = f"Parameters of exactly named effects within three of their reported sigmas (required: ≥ 95 %): {share}."
    listed = ", ".join(f"{n} ({', '.join(f'{x:.1f}' for x in v)})" for n, v in bad.items())
    return f"{text} Outside, with all deviations in sigmas: {listed}." if bad else text


def _calibration(fine: dict[str, list[Result]]) -> str:
    tests = [r["null_tests"] for r in fine["null"]]
    if not tests:
        return ""
    below, number = (sum(t[i] for t in tests) for i in (0, 1))
    share = f"{below}/{number} = {below / number:.4f}"
    return f"Calibration of all tests under the null (required: between 0.005 and 0.02): p < 0.01 in {share}."


def _times(results: list[Result]) -> str:
    seconds = [r["finder_s"] for r in results if "finder_s" in r]
    if not seconds:
        return ""
    middle, high = np.percentile(seconds, [50, 95])
    return (
        "Time of the finder per session of 131 captures × 4 frames of 96 × 144 pixels: "
        f"median {middle:.1f} s, 95th percentile {high:.1f} s, longest {max(seconds):.1f} s."
    )


def _confusion(fine: dict[str, list[Result]]) -> str:
    lines = [
        "Sure answers that were not exact, except where an entry was removed (`effect:form` is a variant):",
        "",
        "| hidden | kind | answer | runs |",
        "|---|---|---|---|",
    ]
    count: Counter[tuple[str, str, str]] = Counter()
    total: Counter[tuple[str, str]] = Counter()
    for kind in ("single", "variant", "outsider", "null"):
        for r in fine[kind]:
            hidden = "+".join(r["names"]) or "nothing"
            total[hidden, kind] += 1
            good = r["judged"]["exact"] if kind != "null" else r["judged"]["verdict"] == "agrees"
            if not good and r["judged"]["verdict"] == "effects_found":
                answer = " + ".join(e["name"] if e["name"] != "unnamed" else f"? ({e['where']})" for e in r["effects"])
                count[hidden, kind, f"{r['judged']['verdict']}: {answer or '-'}"] += 1
    lines += [f"| {h} | {k} | {answer} | {n}/{total[h, k]} |" for (h, k, answer), n in sorted(count.items())]
    return "\n".join(lines) if count else "Every answer to one hidden effect was exact."
