"""Runs sessions of three generators once and keeps every model that `reconcile` fitted, for deciders to be compared."""

from __future__ import annotations

import gzip
import json
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._reconcile_tasks import Task, tasks
from benchmarks.reconcile_outsiders import session_of
from radiometer.importing import open_capture
from radiometer.reconciliation.engine import examine, whole_catalogue
from radiometer.reconciliation.search import Reconciled
from testing.generator.registry import everything
from testing.generator.session import make_session

Record = dict[str, Any]

_KEPT = ("name", "where", "gain_nats", "alternatives", "probability", "probability_of_any", "provisional")
OWN = ("null", "single", "own_pair", "outsider", "removed")
OTHERS = ("null", "single", "law", "outsider")


@dataclass(frozen=True)
class Asked:
    """One session: its generator (1 is the tests' own), its kind and its seed, or the task of the own generator."""

    generator: int
    kind: str
    seed: int
    task: Task | None = None

    @property
    def key(self) -> str:
        """Return the name of its record."""
        return f"{self.generator}-{(self.task.key if self.task else f'{self.kind}/{self.seed}').replace('/', '-')}"


def sessions(count: int, first_seed: int, plan: str | None = "bracket") -> list[Asked]:
    """Return so many sessions, all kinds of all generators alike often, in random order.

    Args:
        count: How many.
        first_seed: Of all that is drawn.
        plan: Of the tests' own generator; None for the plan that each effect needs, which takes four times as long.
    """
    rng = np.random.default_rng(first_seed)
    kinds = [(1, kind) for kind in OWN] + [(number, kind) for number in (2, 3) for kind in OTHERS]
    own = {kind: _shuffled(kind, first_seed, plan, rng) for kind in OWN}
    found = []
    for number in range(-(-count // len(kinds))):
        for generator, kind in rng.permutation(np.array(kinds, dtype=object)).tolist():
            task = next(own[kind]) if generator == 1 else None
            found.append(Asked(generator, kind, task.seed if task else first_seed + number, task))
    return found[:count]


def _shuffled(kind: str, first_seed: int, plan: str | None, rng: np.random.Generator) -> Iterator[Task]:
    listed = list(tasks((kind,), 4, first_seed=first_seed))
    if plan is not None:
        listed = [
            replace(task, plan=plan) for task in listed if all(everything()[n].plan == "rich" for n in task.names)
        ]
    return (listed[i] for i in rng.permutation(len(listed)))


def record_of(asked: Asked) -> Record:
    """Return answer, truth and fitted models of one session; a crash is a record too."""
    kept: Record = {"key": asked.key, "generator": asked.generator, "kind": asked.kind, "seed": asked.seed}
    begun = time.process_time()
    try:
        done, truth, kept["hidden"] = _run(asked)
    except Exception as error:  # noqa: BLE001 (a crash of the finder is a failed run, not the end of the benchmark)
        where = traceback.extract_tb(error.__traceback__)[-1]
        return kept | {"error": f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"}
    return kept | {"cpu_s": round(time.process_time() - begun, 2), "truth": truth} | _answer(done)


def _run(asked: Asked) -> tuple[Reconciled, list[list[str]], list[str]]:
    catalogue = whole_catalogue()
    if asked.task is None:
        session = session_of(asked.generator, asked.kind, asked.seed)
        secret = session.secret
        with tempfile.TemporaryDirectory() as folder:
            captured = open_capture(session.write(Path(folder) / "set"))
            shape = captured.read_frame(0).shape
            done = examine(captured.header, captured.read_frame, shape, with_limits=False)
        return done, [] if secret.kind == "null" else [sorted(secret.right)], [secret.name or "-", secret.plan]
    task = asked.task
    options = {"camera_seed": task.seed, "known_patches": task.known_patches, "plan": task.plan, "factor": task.scale}
    own = make_session(*task.names, **options)
    frames = list(own.frames())
    entries = {name: kind for name, kind in catalogue.items() if name not in task.without}
    done = examine(own.header, frames.__getitem__, frames[0].shape, catalogue=entries, with_limits=False)
    hidden = [everything()[name] for name in task.names]
    right = [sorted(({h.entry} if h.entry else set()) | set(h.accepted) - set(task.without)) for h in hidden]
    right = [[name for name in names if name not in task.without] for names in right]
    return done, right, [*task.names, task.plan or hidden[0].plan if hidden else "rich"]


def _answer(done: Reconciled) -> Record:
    answer, outcome = done.result.to_mapping(), done.outcome
    return {
        "answer": {
            "verdict": answer["verdict"],
            "effects": [{key: effect.get(key) for key in _KEPT} for effect in answer["effects"]],
            "assumptions": answer["assumptions"],
            "models": answer["models"],
            "global_p": answer["global_p"],
        },
        "final": {
            "names": [effect.name for effect in outcome.state.effects],
            "gap": outcome.state.gap,
            "left": len(outcome.left),
            "evidence": outcome.state.evidence,
        },
        "models": [
            {
                "names": [effect.name for effect in fit.effects],
                "odds": sum(effect.log_prior_odds for effect in fit.effects),
                "curves": fit.curves,
                "parameters": fit.parameters,
                "gap": fit.gap if fit.is_full else None,
                "log_density": np.round(fit.log_density, 2).tolist(),
            }
            for fit in outcome.start.models
        ],
    }


def collect(asked: list[Asked], folder: Path) -> Iterator[Record]:
    """Yield the record of each session; what the folder holds already is not run again."""
    folder.mkdir(parents=True, exist_ok=True)
    for one in asked:
        place = folder / f"{one.key}.json.gz"
        if not place.exists():
            text = json.dumps(record_of(one)).encode()
            place.write_bytes(gzip.compress(text))
        yield json.loads(gzip.decompress(place.read_bytes()))
