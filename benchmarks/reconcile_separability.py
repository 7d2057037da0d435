"""Does the plan know which names stand together? Each entry is fitted to noiseless data of each other.

    nice python -m benchmarks.reconcile_separability [--plans plain,levels,stops] [--most 12]

An entry at twenty sigma gives the statistics that the model expects with it, without noise; every other one is then
fitted to them from its starts as the search would (where it explains half of it at first sight), nuisances following.
Where less than 10 of χ² is left, each further parameter paid for, the two cannot be separated. `reconcile --plan-only`
fits only what derivatives at a few starts show to be near. What only a varied setting would mark is not tried.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks._sections import write_section
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.screening import StartPool, screen
from radiometer.reconciliation.separability import (
    Separability,
    asked_sizes,
    left_by_fit,
    noiseless,
    separability,
)
from radiometer.reconciliation.state import FitState
from radiometer.reconciliation.thresholds import RIVAL_NATS
from simulators.effects.catalogue import CatalogueEffect
from testing.generator.plan import Setting
from testing.generator.session import make_session

_SEED: Final = 88_000
_WORTH_A_FIT: Final = 0.5  # of what is to be explained


def _plain(rng: np.random.Generator) -> list[Setting]:
    """One scene, one level, and darks."""
    lit = [Setting(float(t)) for t in np.geomspace(41e-6, 1.35e-3, 8)] * 2
    return _shuffled(rng, lit + [Setting(t, closed=True) for t in (41e-6, 1e-2, 1.0)])


def _levels(rng: np.random.Generator) -> list[Setting]:
    """The same with a ladder of the source's levels and of gains."""
    lit = [Setting(0.9e-3, level=d) for d in (0.8, 0.5, 0.3, 0.1)] + [Setting(0.2e-3, g) for g in (6.0, 12.0)]
    return _shuffled(rng, _plain(rng) + lit * 2 + [Setting(0.1, level=0.0)])


def _stops(rng: np.random.Generator) -> list[Setting]:
    """The same with stops, another surround and two temperatures."""
    lit = [Setting(0.3e-3, f_number=n) for n in (2.8, 5.6, 8.0)]
    lit += [Setting(0.3e-3, pattern=p) for p in ("bright_surround", "inverted")]
    warm = [Setting(t, temperature_c=T, closed=c) for T in (25.0, 45.0) for t, c in ((0.9e-3, False), (1.0, True))]
    return _shuffled(rng, _levels(rng) + lit * 2 + warm)


def _shuffled(rng: np.random.Generator, settings: list[Setting]) -> list[Setting]:
    return [settings[i] for i in rng.permutation(len(settings))]


PLANS: Final[dict[str, Callable[[np.random.Generator], list[Setting]]]] = {
    "plain": _plain,
    "levels": _levels,
    "stops": _stops,
}


def start_of(plan: str) -> FitState:
    """Return the ideal camera fitted to a session of a plan in which nothing is hidden."""
    session = make_session(camera_seed=_SEED, plan=PLANS[plan])
    frames = list(session.frames())
    design = Design.of(session.header, frames[0].shape)
    return first_state(design, *reduce_frames(design, frames.__getitem__))


def like(state: FitState, truth: CatalogueEffect, pool: StartPool) -> dict[str, float]:
    """Return the χ² that each other entry leaves of the noiseless data of one, further parameters paid for; few alone.

    Args:
        state: The ideal camera.
        truth: The entry at its size.
        pool: The starts of all entries.
    """
    exact = noiseless(state, truth)
    whole = float(np.sum(exact.fit.projected[: exact.comparison.size] ** 2))
    found: dict[str, float] = {}
    for candidate in screen(exact, whole_catalogue(), pool):
        if candidate.gain < _WORTH_A_FIT * whole or candidate.flexible:
            continue
        left, fitted = left_by_fit(exact, truth, candidate)
        found[fitted.name] = min(left, found.get(fitted.name, np.inf))
    return {name: left for name, left in found.items() if left < 2.0 * RIVAL_NATS and name != truth.name}


def reported_by(found: Separability) -> dict[str, set[str]]:
    """Return with which others each entry is reported to be inseparable."""
    reported: dict[str, set[str]] = {}
    for entry in found.together:
        reported.setdefault(entry.name, set()).update(entry.others)
    return reported


def row_of(name: str, fitted: dict[str, float], reported: set[str]) -> str:
    """Return one line of the table: what fits, what is reported, what is missed."""
    alike = ", ".join(f"{other} ({left:.1f})" for other, left in sorted(fitted.items(), key=lambda item: item[1]))
    missed = ", ".join(sorted(set(fitted) - reported)) or "–"
    more = ", ".join(sorted(reported - set(fitted))) or "–"
    return f"| {name} | {alike or '–'} | {missed} | {more} |"


def of_plan(plan: str, most: int) -> tuple[str, int, int, int]:
    """Return the table of a plan, and how many pairs fit, are missed, and are reported beyond those."""
    begun, state, pool = time.perf_counter(), start_of(plan), StartPool()
    reported = reported_by(separability(state, whole_catalogue(), every=True))
    sizes = asked_sizes(state, whole_catalogue())
    chosen = list(sizes)[:: max(1, -(-len(sizes) // most))] if most else list(sizes)
    lines, pairs, missed, more = [], 0, 0, 0
    for name in chosen:
        fitted, also_reported = like(state, sizes[name], pool), reported.get(name, set())
        pairs, missed, more = (
            pairs + len(fitted),
            missed + len(set(fitted) - also_reported),
            more + len(also_reported - set(fitted)),
        )
        print(plan, name, fitted, "reported:", also_reported, flush=True)
        if fitted or also_reported:
            lines.append(row_of(name, fitted, also_reported))
    silent = len(chosen) - len(lines)
    seconds = time.perf_counter() - begun
    head = f"**{plan}** ({PLANS[plan].__doc__}): {len(chosen)} of the {len(sizes)} entries that it shows, each against"
    head += f" all {len(whole_catalogue())} ({seconds:.0f} s); {silent} stand alone by both counts.\n\n"
    table = ["| data of | fitted as well by (χ² left) | not reported | also reported |", "|---|---|---|---|", *lines]
    return head + "\n".join(table), pairs, missed, more


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", default=",".join(PLANS))
    parser.add_argument("--most", type=int, default=0, help="entries of each plan, spread over all; 0 for all")
    options = parser.parse_args()
    tables, pairs, missed, more = [], 0, 0, 0
    for plan in options.plans.split(","):
        table, *counts = of_plan(plan, options.most)
        tables.append(table)
        pairs, missed, more = pairs + counts[0], missed + counts[1], more + counts[2]
    head = f"Of {pairs} pairs that fit each other's noiseless data {pairs - missed} are reported together; "
    head += f"{more} more are reported: fitted from other starts, or marked by a setting that does not vary.\n\n"
    command = f"python -m benchmarks.reconcile_separability --plans {options.plans} --most {options.most}"
    title = "Reconcile: which names a plan cannot separate"
    write_section("reconcile_separability", title, command, head + "\n\n".join(tables))


if __name__ == "__main__":
    main()
