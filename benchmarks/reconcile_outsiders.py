"""`radiometer reconcile` on sessions by other hands' equations (generators 2 and 3), and what is right about it.

    python -m benchmarks reconcile_outsiders --generator 2 --kind single --sets 50 --first-seed 1000

Each session is written as a capture set and read from disk like anybody's. Every run is one line of the results file;
what stands there is not run again, so that a stopped run reports its part (also with --report-only). Seeds are drawn in
random order. A blind set is one whose seeds were never looked at in development.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks._sections import write_section
from radiometer.reconciliation import reconcile_capture
from testing.outside import three, three_hidden, two, two_hidden
from testing.outside.judge import judge, tally
from testing.outside.session import Hidden, Session, plain

RESULTS = Path("out") / "reconcile_outsiders.jsonl"
TOLD = ("name", "where", "statistic", "gain_nats", "alternatives")
KINDS = ("null", "single", "law", "outsider")
GENERATORS: dict[int, tuple[ModuleType, dict[str, Hidden]]] = {
    2: (two, two_hidden.HIDDEN),
    3: (three, three_hidden.HIDDEN),
}


def session_of(
    generator: int, kind: str, seed: int, name: str | None = None, plan: str | None = None, again: int = 0
) -> Session:
    """Return a session; what is hidden goes through the list with the seed, so that each comes as often.

    Args:
        generator: 2 or 3.
        kind: One of `KINDS`.
        seed: Of everything drawn.
        name: What is hidden, in place of the list.
        plan: Name of the plan; drawn among those that can show it by default.
        again: Number of a further session of the same rig; 0 for the first.
    """
    module, hidden = GENERATORS[generator]
    names = sorted(n for n, entry in hidden.items() if entry.kind == kind)
    if kind == "null":
        return module.make(seed, None, plan or module.PLANS[seed % len(module.PLANS)], again=again)
    return module.make(seed, hidden[name or names[seed % len(names)]], plan, again=again)


def run(generator: int, kind: str, seed: int, name: str | None = None) -> dict[str, Any]:
    """Return the judged answer to one session; a crash is an answer too."""
    begun = time.perf_counter()
    session = session_of(generator, kind, seed, name)
    reported = plain(asdict(session.secret))
    kept = {
        "key": f"{generator}/{kind}/{name or '-'}/{seed}",
        "generator": generator,
        "kind": kind,
        "seed": seed,
    } | reported
    try:
        with tempfile.TemporaryDirectory() as folder:
            answer = reconcile_capture(session.write(Path(folder) / "set")).result.to_mapping()
        kept |= {
            "judged": judge(answer, session.secret),
            "gap": [answer["gap"]["before"], answer["gap"]["after"]],
            "effects": [{key: effect[key] for key in TOLD} for effect in answer["effects"]],
            "places": [f"{p['block']}|{p['covariate']}" for p in answer["localisation"][:3]],
        }  # fmt: skip
    except Exception as error:  # noqa: BLE001 (a crash of the finder is a failed run, not the end of the benchmark)
        where = traceback.extract_tb(error.__traceback__)[-1]
        kept["error"] = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
    return kept | {"seconds": round(time.perf_counter() - begun, 1)}


def read(results: Path) -> list[dict[str, Any]]:
    """Return the results kept so far."""
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()] if results.exists() else []


def run_all(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Run what is not in the results file yet, in random order, and return all that was asked for."""
    seeds = range(options.first_seed, options.first_seed + options.sets)
    pending = [(g, k, s) for g in options.generator for k in options.kind for s in seeds]
    order = np.random.default_rng(options.first_seed).permutation(len(pending))
    done = {result["key"]: result for result in read(options.results)}
    judged = []
    options.results.parent.mkdir(parents=True, exist_ok=True)
    with options.results.open("a", encoding="utf-8") as out:
        try:
            for number, i in enumerate(order, 1):
                generator, kind, seed = pending[i]
                key = f"{generator}/{kind}/{options.name or '-'}/{seed}"
                if key not in done and not options.report_only:
                    done[key] = run(generator, kind, seed, options.name)
                    out.write(json.dumps(done[key], ensure_ascii=False) + "\n")
                    out.flush()
                if key in done:
                    judged.append(done[key])
                    print(f"{number}/{len(order)} {line_of(done[key])}", flush=True)
        except KeyboardInterrupt:
            print(f"stopped after {len(judged)} of {len(order)}", file=sys.stderr)
    return judged


def line_of(result: dict[str, Any]) -> str:
    """Return one run in one line."""
    if "error" in result:
        return f"{result['key']} {result['name'] or '(nothing)'} in {result['plan']}: {result['error']}"
    judged = result["judged"]
    fault = " WRONG" if judged["confident_wrong"] else " junk" if judged["junk"] else ""
    names = ", ".join(f"{e['name']}({e['statistic']}|{e['where']})" for e in result["effects"]) or "nothing"
    alternatives = ", ".join(a for e in result["effects"] for a in e["alternatives"])
    return (
        f"{result['key']} {result['name'] or '(nothing)'} in {result['plan']}: {judged['verdict']}: {names}"
        f"{f' [{alternatives}]' if alternatives else ''}{fault} ({result['seconds']} s)"
    )


def page(results: list[dict[str, Any]]) -> str:
    """Return what was reached, generator by generator, in Markdown."""
    parts = []
    for generator in sorted({result["generator"] for result in results}):
        own = sorted((r for r in results if r["generator"] == generator), key=lambda r: KINDS.index(r["kind"]))
        parts.append(f"Generator {generator}:\n\n{tally(own)}")
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks reconcile_outsiders", description=__doc__)
    parser.add_argument(
        "--generator", type=int, choices=sorted(GENERATORS), action="append", help="2 or 3; both by default"
    )
    parser.add_argument("--kind", choices=KINDS, action="append", help="what is hidden; all by default")
    parser.add_argument("--name", help="hide this one in every session")
    parser.add_argument("--sets", type=int, default=15, help="sessions of each kind and generator")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true", help="tell what the results file holds of it")
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/reconcile.md")
    options = parser.parse_args()
    options.generator = options.generator or sorted(GENERATORS)
    options.kind = options.kind or list(KINDS)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    results = run_all(options)
    body = page(results)
    print(f"\n{body}")
    if options.write and results:
        asked = f"python -m benchmarks reconcile_outsiders --sets {options.sets} --first-seed {options.first_seed}"
        write_section("reconcile_outsiders", "Reconcile: sessions by other equations", asked, body)


if __name__ == "__main__":
    main()
