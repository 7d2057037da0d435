"""Nothing is hidden: how often `radiometer reconcile` cries wolf, and whether every one of its tests is calibrated.

    nice python -m benchmarks.reconcile_null [--sets 200] [--first-seed 20000] [--report-only] [--write]

One process; every session is one line of the results file, so that the benchmark can be stopped and taken up.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks._sections import write_section
from radiometer.reconciliation.engine import examine
from testing.generator.session import make_session

RESULTS = Path("out") / "reconcile_null.jsonl"

Record = dict[str, Any]


def run_set(seed: int) -> Record:
    """Return verdict, names and all tests of the starting model for one session."""
    session = make_session(camera_seed=seed)
    frames = list(session.frames())
    begun = time.process_time()
    done = examine(session.header, frames.__getitem__, frames[0].shape, with_limits=False)
    return {
        "seed": seed,
        "verdict": str(done.result.verdict),
        "effects": [(effect.name, effect.where, effect.block) for effect in done.result.effects],
        "gap": done.result.gap_before,
        "cpu_s": round(time.process_time() - begun, 2),
        "tests": [(t.block, t.where, t.form, t.p_value) for t in done.outcome.first_tests],
    }


def read(results: Path) -> list[Record]:
    """Return the records kept so far."""
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()] if results.exists() else []


def run_all(seeds: Iterable[int], results: Path) -> None:
    """Run what is not in the results file yet and append it."""
    done = {record["seed"] for record in read(results)}
    results.parent.mkdir(parents=True, exist_ok=True)
    with results.open("a", encoding="utf-8") as out:
        for seed in seeds:
            if seed not in done:
                record = run_set(seed)
                out.write(json.dumps(record) + "\n")
                out.flush()
                print(f"{seed}: {record['verdict']} {record['effects']} {record['cpu_s']} s", flush=True)


def page(records: list[Record]) -> str:
    """Return the section's body in Markdown."""
    alarms = [r for r in records if r["verdict"] != "agrees"]
    named = [r for r in alarms if any(name != "unnamed" for name, *_ in r["effects"])]
    rows = ["| measure | required | reached | 95 % interval |", "|---|---|---|---|"]
    rows += [
        f"| {what} | {required} | {_share(len(hits), len(records))} |"
        for what, required, hits in (("false alarm", "≤ 2 %", alarms), ("false name", "≤ 1 %", named))
    ]
    gaps = np.array([r["gap"] for r in records])
    alarms_text = [
        f"seed {r['seed']}: {r['verdict']}, {', '.join(' | '.join(e) for e in r['effects'])}" for r in alarms
    ]
    listed = "Alarms: " + "; ".join(alarms_text) + "." if alarms_text else "No alarm."
    low, high = np.percentile(gaps, [2.5, 97.5])
    middle = f"Gap of the ideal camera: mean {gaps.mean():.4f}, 95 % of the sets {low:.3f} to {high:.3f}."
    cpu = f"Processor time of the finder: median {np.median([r['cpu_s'] for r in records]):.1f} s."
    return "\n\n".join(["\n".join(rows), listed, f"{middle} {cpu}", _calibration(records)])


def _share(hits: int, total: int) -> str:
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, total - hits + 1))
    high = 1.0 if hits == total else float(beta.ppf(0.975, hits + 1, total - hits))
    return f"{hits}/{total} ({100 * hits / total:.1f} %) | {100 * low:.1f} to {100 * high:.1f} %"


def _calibration(records: list[Record]) -> str:
    p_values = np.array([p for r in records for *_, p in r["tests"]])
    share = f"{int((p_values < 0.01).sum())} of {p_values.size}"
    return f"Of all tests for a trend {share} have p < 0.01; {0.01 * p_values.size:.0f} are expected."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=20_000)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/reconcile.md")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.sets)
    if not options.report_only:
        run_all(seeds, options.results)
    records = [record for record in read(options.results) if record["seed"] in seeds]
    body = page(records)
    print(body)
    if options.write:
        command = f"python -m benchmarks.reconcile_null --sets {options.sets} --first-seed {options.first_seed}"
        write_section("reconcile_null", "Reconcile: nothing hidden", command, f"{len(records)} sessions.\n\n{body}")


if __name__ == "__main__":
    main()
