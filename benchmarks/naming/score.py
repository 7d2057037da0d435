"""Scores answers: exact, inseparable, confidently wrong, calibration of the probabilities, and time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

SURE: Final = 0.95  # probability from which a wrong name counts as confidently wrong
_BINS: Final = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0000001)


def judged(answer: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is right and wrong about one answer.

    Args:
        answer: As a tool wrote it.
        truth: Kind, and for each hidden thing the names that are right.
    """
    names, right = answer["names"], truth["right"]
    expected = [set(one) for one in right if one]
    hits = [any(name["name"] in one for one in right) for name in names]
    near = [bool({*name["alternatives"]} & {r for one in right for r in one}) for name in names]
    found = {next(n for n, one in enumerate(right) if name["name"] in one)
             for name, hit in zip(names, hits, strict=True) if hit}  # fmt: skip
    complete = len(found) == len(right) and len(names) == len(right)
    if truth["kind"] == "null":
        exact = not answer["something_missing"]
    elif truth["kind"] == "outsider":
        exact = answer["something_missing"] and (not names or all(hits))
    else:
        exact = bool(expected) and complete and all(hits)
    wrong = [name for name, hit, close in zip(names, hits, near, strict=True) if not hit and not close]
    return {
        "exact": exact,
        "inseparable": not exact and bool(names) and all(h or n for h, n in zip(hits, near, strict=True)),
        "confidently_wrong": any(name["probability"] >= SURE for name in wrong),
        "stated": [(name["probability"], hit) for name, hit in zip(names, hits, strict=True)],
        "seconds": answer["seconds"],
    }


def report(answers: Mapping[str, Mapping[str, Any]], truth: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table of tasks by tools, and how the tools' probabilities are calibrated, in Markdown.

    Args:
        answers: By tool, of each session; a session that a tool did not answer counts as neither right nor wrong.
        truth: Of each session.
    """
    columns = ("exact", "inseparable", "confidently_wrong")
    named = [f"{tool}: {column.replace('_', ' ')}" for tool in answers for column in (*columns, "median s")]
    rows = [f"| task | sessions | {' | '.join(named)} |", "|---" * (len(named) + 2) + "|"]
    kinds = [*dict.fromkeys(one["kind"] for one in truth.values()), "all"]
    for kind in kinds:
        own = [key for key in truth if kind in (truth[key]["kind"], "all")]
        cells = []
        for tool in answers.values():
            results = [judged(tool[key], truth[key]) for key in own if key in tool]
            cells += [f"{sum(bool(r[c]) for r in results)}/{len(results)}" for c in columns]
            cells.append(f"{np.median([r['seconds'] for r in results]):.1f}" if results else "")
        rows.append(f"| {kind} | {len(own)} | {' | '.join(cells)} |")
    parts = ["\n".join(rows)]
    for name, tool in answers.items():
        stated = [pair for key in truth if key in tool for pair in judged(tool[key], truth[key])["stated"]]
        parts.append(f"Probabilities of {name}:\n\n{calibration(stated)}")
    return "\n\n".join(parts)


def calibration(stated: list[tuple[float, bool]]) -> str:
    """Return how often names of each range of probability are right, and the expected calibration error."""
    if not stated:
        return "No name was given."
    probability, right = (np.array(column, dtype=float) for column in zip(*stated, strict=True))
    lines, error = ["| probability | names | mean of it | right |", "|---|---|---|---|"], 0.0
    for n in range(len(_BINS) - 1):
        inside = (probability >= _BINS[n]) & (probability < _BINS[n + 1])
        if inside.any():
            error += inside.mean() * abs(probability[inside].mean() - right[inside].mean())
            shown = f"{_BINS[n]:g} to {min(_BINS[n + 1], 1):g}"
            lines.append(
                f"| {shown} | {inside.sum()} | {probability[inside].mean():.3f} | {right[inside].mean():.3f} |"
            )
    return "\n".join([*lines, "", f"Expected calibration error {error:.3f} over {len(stated)} names."])
