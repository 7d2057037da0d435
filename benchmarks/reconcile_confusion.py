"""The confusion matrix of `radiometer reconcile` on sessions of an independent generator, and its page.

    python -m benchmarks.reconcile_confusion --seeds 4 [--kinds null,single,...] [--report-only] [--write]

Every run is one line of the results file; what is there is not run again, so that the benchmark can be stopped and
taken up. `--first-seed` moves all seeds: a blind set is one whose seeds were never used in development.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _reconcile_adapter as finder
from benchmarks._reconcile_judge import honesty, judge, parameters
from benchmarks._reconcile_report import plain_report, report
from benchmarks._reconcile_tasks import KINDS, Task, tasks
from benchmarks._sections import write_section
from testing.generator.registry import everything
from testing.generator.session import make_session

RESULTS = Path("out") / "reconcile_confusion.jsonl"
PLAIN_SECTION = ("reconcile_plain", "Reconcile: every entry in a plain bracket")
FRESH = 500_000  # added to the seed of the fresh session


def run_task(task: Task) -> dict[str, Any]:
    """Return the judged result of one run; an error is a result too."""
    begun = time.perf_counter()
    kept = {"key": task.key, **task.to_mapping()}
    try:
        kept |= _run(task)
    except Exception as error:  # noqa: BLE001 (a crash of the finder is a failed run, not the end of the benchmark)
        where = traceback.extract_tb(error.__traceback__)[-1]
        kept["error"] = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
    kept["seconds"] = round(time.perf_counter() - begun, 2)
    return kept


def _run(task: Task) -> dict[str, Any]:
    options = {"camera_seed": task.seed, "known_patches": task.known_patches, "plan": task.plan, "factor": task.scale}
    session = make_session(*task.names, **options)
    limited = task.kind.startswith("plain") or (task.kind == "weak" and ":" not in task.names[0])
    answer, found = finder.ask(session, task.without, with_limits=limited)
    result = {
        "judged": judge(answer, task.names, task.without),
        "parameters": parameters(answer, session.truth),
        "gap": answer["gap"]["before"], "gap_after": answer["gap"]["after"],
        "effects": [{k: e.get(k) for k in ("name", "where", "gain_nats", "alternatives")} for e in answer["effects"]],
        "localisation": answer["localisation"][:3],
        "null_tests": answer["null_tests"],
        "finder_s": answer["seconds"],
    }  # fmt: skip
    if limited:
        result["honesty"] = honesty(answer, task.names[0], session.truth[task.names[0]])
    if task.kind in ("single", "variant") and result["judged"]["names"] and _repeats(task):
        fresh = make_session(*task.names, session_seed=task.seed + FRESH, **options)
        result["fresh"] = dict(zip(("before", "after"), finder.gaps_of(found, fresh), strict=True))
    return result


def _repeats(task: Task) -> bool:
    """Tell whether what was hidden is a property of the rig, there again in another session."""
    return all(everything()[n].entry != "exposure_label_error" for n in task.names)


def run_all(pending: list[Task], results: Path, jobs: int) -> None:
    """Run what is not in the results file yet and append it."""
    done = {r["key"] for r in read(results)}
    left = [t for t in pending if t.key not in done]
    results.parent.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(jobs) as pool, results.open("a", encoding="utf-8") as out:
        for number, result in enumerate(pool.imap_unordered(run_task, left), 1):
            out.write(json.dumps(result) + "\n")
            out.flush()
            answer = result.get("error") or f"{result['judged']['verdict']} {result['judged']['names']}"
            print(f"{number}/{len(left)} {time.perf_counter() - begun:.0f} s  {result['key']}: {answer}", flush=True)


def read(results: Path) -> Iterator[dict[str, Any]]:
    """Yield the results kept so far."""
    if results.exists():
        for line in results.read_text(encoding="utf-8").splitlines():
            yield json.loads(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="sessions of every entry")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--sample", type=int, default=0, help="only so many of the runs, drawn at random")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument(
        "--only", default="", help="names that must be hidden (`entry` stands for all its forms), by comma"
    )
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/reconcile.md")
    options = parser.parse_args()
    kinds = tuple(options.kinds.split(","))
    plain = all(kind.startswith("plain") for kind in kinds)
    pending = list(tasks(kinds, options.seeds, first_seed=options.first_seed))
    if options.sample:
        order = np.random.default_rng(options.first_seed).permutation(len(pending))
        pending = [pending[i] for i in order[: options.sample]]
    only = set(filter(None, options.only.split(",")))
    pending = [t for t in pending if not only or only & {*t.names, *(n.partition(":")[0] for n in t.names)}]
    if not options.report_only:
        run_all(pending, options.results, options.jobs)
    keys = {t.key for t in pending}
    kept = [r for r in read(options.results) if r["key"] in keys]
    page = f"{len(kept)} of {len(pending)} runs are done.\n\n{plain_report(kept) if plain else report(kept)}"
    print(page)
    if options.write:
        command = f"python -m benchmarks.reconcile_confusion --seeds {options.seeds} --first-seed {options.first_seed}"
        command += f" --kinds {options.kinds}" if kinds != KINDS else ""
        command += f" --sample {options.sample}" if options.sample else ""
        name, title = (
            PLAIN_SECTION if plain else ("reconcile_confusion", "Reconcile: confusion matrix on hidden effects")
        )
        write_section(name, title, command, page)


if __name__ == "__main__":
    main()
