"""Compares the verdict with the posterior alone over all models, on the same sessions of three generators.

    nice python -m benchmarks reconcile_posterior --sets 112 --first-seed 131000 --folder ../fits

Each session is run once. The folder keeps what every fitted model predicts, so that a changed decider is compared
without fitting again (--report-only). A blind set is one whose seeds were never used in development.
"""

from __future__ import annotations

import argparse
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks._posterior_sessions import Record, collect, sessions
from benchmarks._sections import write_section
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.result import SURE
from radiometer.reconciliation.state import ModelFit
from radiometer.reconciliation.verdict import UNNAMED, posterior

FOLDER = Path("out") / "reconcile_posterior"
BINS = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)
CLOSED_GAP = 1.05
_COUNTED = ("exact", "inseparable", "missed", "wrong", "sure_right", "sure_wrong")


@dataclass(frozen=True)
class Said:
    """What a decider says of one session: probability by name, and whether the names are sure."""

    names: dict[str, float]
    alternatives: frozenset[str]
    is_sure: bool
    is_silent: bool


@dataclass(frozen=True)
class _Named:
    name: str
    log_prior_odds: float


def by_verdict(record: Record) -> Said:
    """Return what reconcile reports: names with the probability that they or their alternatives are present."""
    answer = record["answer"]
    named = [effect for effect in answer["effects"] if effect["name"] != UNNAMED]
    alike = frozenset(name for effect in named for name in effect["alternatives"])
    names = {effect["name"]: effect["probability_of_any"] for effect in named}
    return Said(names, alike, answer["verdict"] == "effects_found", answer["verdict"] == "agrees")


def by_posterior(record: Record) -> Said:
    """Return what the posterior alone says: the names of the most probable model, sure where all are beyond doubt."""
    found = posterior(fits_of(record), whole_catalogue(), _dispersion(record))
    best = found.models[0]
    names = {name: found.probability(name) for name in best.names if name != UNNAMED}
    quiet = record["final"]["left"] == 0 and _dispersion(record) == 1.0 and UNNAMED not in best.names
    return Said(names, frozenset(), bool(names) and quiet and min(names.values()) >= SURE, not best.names)


DECIDERS: dict[str, Callable[[Record], Said]] = {"reconcile": by_verdict, "posterior alone": by_posterior}


def fits_of(record: Record) -> list[ModelFit]:
    """Return the models of a record; of their effects names and odds are kept."""
    found = []
    for entry in record["models"]:
        named = [_Named(name, entry["odds"] if not at else 0.0) for at, name in enumerate(entry["names"])]
        gap = entry["gap"] if entry["gap"] is not None else np.nan
        density = np.array(entry["log_density"])
        found.append(ModelFit(cast("Any", tuple(named)), entry["curves"], density, entry["parameters"], gap))
    return found


def _dispersion(record: Record) -> float:
    gap = float(record["final"]["gap"])
    return gap if gap > CLOSED_GAP else 1.0


def judged(record: Record, answer: Said) -> dict[str, bool]:
    """Return what is right and wrong about what was reported; of an outsider and a removed entry no name is right."""
    truth, names = [set(right) for right in record["truth"]], set(answer.names)
    wrong = {name for name in names if not any(name in right for right in truth)}
    named = all(right & names for right in truth if right)
    rival = bool(wrong) and covered_by(answer, truth)
    return {
        "exact": named and not wrong and answer.is_silent is not bool(truth),
        "inseparable": rival,
        "missed": bool(truth) and answer.is_silent,
        "wrong": bool(wrong) and not rival,
        "sure_right": answer.is_sure and bool(names) and not (wrong and not rival),
        "sure_wrong": answer.is_sure and bool(wrong) and not rival,
    }


def covered_by(answer: Said, truth: Sequence[set[str]]) -> bool:
    """Return whether every name is right, or not separated from a right one."""
    return all(any(right & {name, *answer.alternatives} for right in truth) for name in answer.names)


def table(records: Iterable[Record]) -> str:
    """Return a row for each decider in Markdown."""
    groups: dict[str, list[dict[str, bool]]] = defaultdict(list)
    for record in records:
        for name, decide in DECIDERS.items():
            groups[name].append(judged(record, decide(record)))
    heads = (
        "decider",
        "sessions",
        "exact",
        "inseparable",
        "missed",
        "wrong name",
        "sure, right",
        "sure, wrong",
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, entries in groups.items():
        counts = [sum(entry[key] for entry in entries) for key in _COUNTED]
        lines.append(f"| {name} | {len(entries)} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def reliability(records: Iterable[Record], decide: Callable[[Record], Said]) -> str:
    """Return how often names of each probability are right, and the expected calibration error, in Markdown."""
    pairs = []
    for record in records:
        answer = decide(record)
        for name, probability in answer.names.items():
            alike = {name, *answer.alternatives}
            pairs.append((probability, any(alike & set(right) for right in record["truth"])))
    if not pairs:
        return "No name was given."
    chance, right = (np.array(values, dtype=np.float64) for values in zip(*pairs, strict=True))
    lines, error = ["| probability | names | mean probability | right | 95 % interval |", "|---" * 5 + "|"], 0.0
    for low, high in itertools.pairwise(BINS):
        mine = (chance >= low) & ((chance < high) | (high == BINS[-1]))
        if mine.any():
            count, hits = int(mine.sum()), int(right[mine].sum())
            error += count / chance.size * abs(float(chance[mine].mean() - right[mine].mean()))
            first, last = wilson(hits, count)
            cells = (f"{low:g} to {high:g}", count, f"{chance[mine].mean():.3f}", f"{hits}/{count}")
            lines.append(f"| {' | '.join(map(str, cells))} | {first:.2f} to {last:.2f} |")
    return "\n".join(lines) + f"\n\nExpected calibration error {error:.3f} over {chance.size} names."


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    z, share = 1.96, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return float(middle - half), float(middle + half)


def page(records: Sequence[Record]) -> str:
    """Return the section's body in Markdown."""
    done = [record for record in records if "answer" in record]
    failed = [f"{record['key']}: {record['error']}" for record in records if "error" in record]
    cpu = [record["cpu_s"] for record in done]
    parts = [
        f"{len(done)} sessions; processor time median {np.median(cpu):.1f} s, "
        f"95th percentile {np.percentile(cpu, 95):.1f} s, longest {max(cpu):.1f} s.",
        table(done),
        "Names as they are reported, by the probability that they or their alternatives are present:",
        reliability(done, by_verdict),
        "Names of the most probable model, by the posterior alone:",
        reliability(done, by_posterior),
    ]
    return "\n\n".join([*parts, *failed])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks reconcile_posterior", description=__doc__)
    parser.add_argument("--sets", type=int, default=112)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the fitted models of each session are kept")
    parser.add_argument("--report-only", action="store_true", help="compare what the folder holds of it")
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks.md")
    options = parser.parse_args()
    asked = sessions(options.sets, options.first_seed)
    if options.report_only:
        asked = [one for one in asked if (options.folder / f"{one.key}.json.gz").exists()]
    records = []
    for record in collect(asked, options.folder):
        records.append(record)
        print(f"{len(records)}/{len(asked)} {record['key']}: {record.get('error', record.get('cpu_s'))}", flush=True)
    body = page(records)
    print(f"\n{body}")
    if options.write:
        command = f"python -m benchmarks reconcile_posterior --sets {options.sets} --first-seed {options.first_seed}"
        write_section("reconcile_posterior", "Reconcile: probabilities of names", command, body)


if __name__ == "__main__":
    main()
