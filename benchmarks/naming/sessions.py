"""Makes the sealed sessions: capture sets by other equations than the catalogue's, and apart from them the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks._reconcile_tasks import INSEPARABLE, Task, tasks
from testing.generator.registry import everything
from testing.generator.session import make_session

KINDS: Final = ("null", "single", "pair", "variant", "outsider", "weak", "plain")


def make(folder: Path, count: int, first_seed: int) -> None:
    """Write sessions of every kind, `count` of each, and `truth.json` next to them.

    Args:
        folder: Empty or new; gets `sessions/<number>/` and `truth.json`.
        count: Sessions of each kind.
        first_seed: Of all seeds; one that was never used in development makes a blind set.
    """
    dice, truth = np.random.default_rng([first_seed, 47]), dict[str, Any]()
    chosen: list[Task] = []
    for kind in KINDS:
        offered = list(tasks((kind,), 1, first_seed=first_seed))
        chosen += [offered[n] for n in dice.permutation(len(offered))[:count]]
    for number, n in enumerate(dice.permutation(len(chosen))):
        task = chosen[n]
        session = make_session(*task.names, camera_seed=task.seed, plan=task.plan, factor=task.scale)
        session.write(folder / "sessions" / f"{number:04d}")
        (folder / "sessions" / f"{number:04d}.truth.yaml").unlink()
        truth[f"{number:04d}"] = {
            "kind": task.kind, "hidden": list(task.names), "seed": task.seed,
            "right": [_right(name) for name in task.names],
        }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")


def _right(name: str) -> list[str]:
    """Return the names that are right for what is hidden: none where it is outside the catalogue."""
    hidden = everything()[name]
    if not hidden.entry:
        return list(hidden.accepted)
    twins = [other for pair in INSEPARABLE if hidden.entry in pair for other in pair if other != hidden.entry]
    return [hidden.entry, *hidden.accepted, *twins]
