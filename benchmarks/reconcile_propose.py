"""Are the laws right that `radiometer reconcile --propose` proposes for what no catalogue holds?

    python -m benchmarks reconcile_propose --sets 24 --first-seed 1000 [--find 4]

The outsiders of generators 2 and 3, or with --own those of the tests, are hidden one by one, in random order. Shown
are: whether the stage is right (or stands among those that the law's rivals have), whether a true covariate is there,
and what share of the excess the written effect file closes in another session of the rig, its parameters as written.
The excess is what the gap lies above that of the same session with nothing hidden. With --find the effect file is given
to a reconciliation of a third session, the first so many times. With --files effect, test and plan of each law are
kept as `radiometer reconcile --propose` writes them. A stopped run reports its part.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _own_outsiders as own_generator
from benchmarks._sections import write_section
from benchmarks.reconcile_outsiders import GENERATORS
from radiometer.data import CaptureSet
from radiometer.reconciliation.descent import first_state
from radiometer.reconciliation.design import Design
from radiometer.reconciliation.engine import reconcile_capture, whole_catalogue
from radiometer.reconciliation.propose import Proposal, propose_law
from radiometer.reconciliation.propose.law import effect_class, effect_of, round_to
from radiometer.reconciliation.propose.search import write_files
from radiometer.reconciliation.reduce import reduce_frames
from radiometer.reconciliation.state import FitState
from simulators.effects.catalogue import CatalogueEffect
from testing.outside.judge import PLACES
from testing.outside.session import Hidden, Secret, Session

RESULTS = Path("out") / "reconcile_propose.jsonl"
OWN: dict[int, tuple[Any, dict[str, Hidden]]] = {1: (own_generator, own_generator.HIDDEN)}
MAKERS = OWN | GENERATORS
FRESH = (1, 3, 4, 5)  # further sessions: a gap's chance is some hundredths, and so is the excess of a faint outsider
OTHER = {"idle_s": "since_frame_s", "signal": "value"}


def hiding(generator: int, name: str | None, seed: int, plan: str | None = None, again: int = 0) -> Session:
    """Return a session of a rig in which an outsider is hidden, or nothing for None."""
    module, hidden = MAKERS[generator]
    session: Session = module.make(seed, None if name is None else hidden[name], plan, again=again)
    return session


def state_of(session: Session, given: tuple[CatalogueEffect, ...] = ()) -> FitState:
    """Return the starting camera fitted to a session, with effects that are held as they are."""
    with tempfile.TemporaryDirectory() as folder:
        captured = CaptureSet.read(session.write(Path(folder) / "set"))
        design = Design.of(captured.header, captured.read_frame(0).shape)
        return first_state(design, *reduce_frames(design, captured.read_frame), given)


def run(generator: int, name: str, seed: int, *, find: bool, files: Path | None = None) -> dict[str, Any]:
    """Return what was proposed for one outsider and how it did in other sessions; write its files into a folder."""
    begun = time.process_time()
    plan = hiding(generator, name, seed).secret.plan
    session = hiding(generator, name, seed, plan)  # a plan that is drawn moves the rig, which further sessions share
    secret = session.secret
    proposal = propose_law(state_of(session))
    record = {"generator": generator, "name": name, "seed": seed, "plan": plan, "stage": secret.stage}
    record |= {"covariates": list(secret.covariates), "drawn": {k: float(v) for k, v in secret.drawn.items()}}
    if proposal is None:
        return record | {"proposed": None, "cpu_s": round(time.process_time() - begun, 1)}
    if files is not None:
        write_files(proposal, files / f"{name}_{seed}", f"a session that hides {name}")
    effect = effect_of(proposal.law, round_to(proposal.amplitude))
    floor, before, after = np.mean([gaps_in(n, generator, name, seed, plan, effect) for n in FRESH], axis=0).tolist()
    record |= {
        "proposed": proposal.name,
        "their_stages": [proposal.stage, *proposal.stages_alike],
        "their_covariates": list(proposal.covariates),
        "parameters": proposal.law.size,
        "gaps": [floor, before, after],
        "closed": (before - after) / (before - floor) if before > floor else None,
        "stage_first": proposal.stage == secret.stage,
        "stage_right": secret.stage in (proposal.stage, *proposal.stages_alike),
        "covariate_right": is_along(proposal, secret),
        "nats": round(proposal.nats, 1),
        "law": proposal.law.parameters | {proposal.law.amplitude: proposal.amplitude},
        "rivals": [(rival.name, rival.behind_nats) for rival in proposal.rivals],
        "cpu_s": round(time.process_time() - begun, 1),
    }
    return record | ({"found": found_again(generator, name, seed, plan, proposal)} if find else {})


def gaps_in(
    again: int, generator: int, name: str, seed: int, plan: str, effect: CatalogueEffect
) -> tuple[float, float, float]:
    """Return the gaps of another session of a rig: with nothing hidden, as it is, and with the effect as written."""
    fresh = hiding(generator, name, seed, plan, again)
    bare = hiding(generator, None, seed, plan, again)
    return state_of(bare).gap, state_of(fresh).gap, state_of(fresh, (effect,)).gap


def is_along(proposal: Proposal, secret: Secret) -> bool:
    """Tell whether the law goes with a true covariate and, where the truth has two, with no stranger alone."""
    own = [{c, OTHER.get(c, c)} | PLACES.get(c, set()) for c in secret.covariates]
    return all(any(name in names for names in own) for name in proposal.covariates) and bool(proposal.covariates)


def found_again(generator: int, name: str, seed: int, plan: str, proposal: Proposal) -> list[str]:
    """Return the names that a reconciliation of a third session gives when it knows the proposed effect too."""
    kind = effect_class(proposal.law, proposal.amplitude)
    third = hiding(generator, name, seed, plan, again=2)
    with tempfile.TemporaryDirectory() as folder:
        path = third.write(Path(folder) / "set")
        done = reconcile_capture(path, catalogue={**whole_catalogue(), kind.name: kind})
    return [str(done.result.verdict), *(effect.name for effect in done.result.effects)]


def page(results: list[dict[str, Any]]) -> str:
    """Return the figures reached in Markdown."""
    proposed = [r for r in results if r["proposed"]]
    shown = [r for r in proposed if r["closed"] is not None]
    closed = [r for r in shown if r["closed"] >= 0.9 and r["parameters"] <= 4]
    looked = [r for r in proposed if "found" in r]
    again = [r for r in looked if r["found"][1:2] == [r["proposed"]]]
    lines = [
        "| of the outsiders | reached | required |",
        "|---|---|---|",
        f"| a law is proposed | {len(proposed)}/{len(results)} | |",
        f"| the stage is right, alone or among those that the data leave open | "
        f"{sum(r['stage_right'] for r in proposed)}/{len(results)} | 85 % |",
        f"| the stage is named first | {sum(r['stage_first'] for r in proposed)}/{len(results)} | |",
        f"| the law has the true covariates and no other | "
        f"{sum(r['covariate_right'] for r in proposed)}/{len(results)} | 95 % |",
        f"| it closes 90 % of the excess in new sessions, with four parameters at most | "
        f"{len(closed)}/{len(results)} | 80 % |",
    ]
    if looked:
        third = "`reconcile` with the law in its catalogue names it first in a third session"
        lines.append(f"| {third} | {len(again)}/{len(looked)} | |")
    open_ones = [f"{r['name']} ({100 * r['closed']:.0f} %)" for r in shown if r["closed"] < 0.9]
    return "\n".join([*lines, "", f"Closed by less than 90 %: {', '.join(open_ones) or 'none'}."])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks reconcile_propose", description=__doc__)
    parser.add_argument("--sets", type=int, default=23, help="sessions in all; each outsider comes as often")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--find", type=int, default=0, help="so many of them are looked for in a third session too")
    parser.add_argument("--own", action="store_true", help="the outsiders of the tests' own generator instead")
    parser.add_argument("--without", action="append", default=[], help="outsiders to leave out")
    parser.add_argument("--files", type=Path, help="folder for the files of each proposal")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/reconcile.md")
    options = parser.parse_args()
    makers = OWN if options.own else GENERATORS
    names = [(g, n) for g, (_, table) in makers.items() for n, h in table.items() if h.kind == "outsider"]
    names = [entry for entry in names if entry[1] not in options.without]
    order = np.random.default_rng(options.first_seed).permutation(max(options.sets, len(names)))[: options.sets]
    lines = options.results.read_text(encoding="utf-8").splitlines() if options.results.exists() else []
    done = {(r["generator"], r["name"], r["seed"]): r for r in map(json.loads, lines)}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    results: list[dict[str, Any]] = []
    options.results.parent.mkdir(parents=True, exist_ok=True)
    try:
        for count, number in enumerate(order.tolist()):
            generator, name = names[number % len(names)]
            seed = options.first_seed + number
            if (generator, name, seed) not in done:
                done[generator, name, seed] = run(generator, name, seed, find=count < options.find, files=options.files)
                with options.results.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(done[generator, name, seed]) + "\n")
            results.append(done[generator, name, seed])
            shown = {k: v for k, v in results[-1].items() if k not in ("generator", "covariates", "drawn")}
            print(f"{count + 1}/{options.sets} {shown}", flush=True)
    except KeyboardInterrupt:
        print(f"stopped after {len(results)} of {options.sets}", file=sys.stderr)
    body = page(results)
    print(f"\n{body}")
    if options.write and results:
        asked = f"python -m benchmarks reconcile_propose --sets {options.sets} --first-seed {options.first_seed}"
        place, title = "reconcile_propose", "Reconcile: laws proposed for what no entry explains"
        if options.own:
            asked, place, title = f"{asked} --own", f"{place}_own", f"{title}, of the own generator"
        write_section(place, title, asked, body)


if __name__ == "__main__":
    main()
