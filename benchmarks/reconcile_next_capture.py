"""Does the capture that `radiometer reconcile` asks for settle the matter, and sooner than a random one?

    nice python -m benchmarks.reconcile_next_capture [--seeds 3] [--most 4] [--first-seed 40000]

The start is a plain bracket: twelve exposures of one chart, twice each, and darks. What it asks for is added and the
set is taken anew by the independent generator, until the hidden effect is named alone and nothing rivals it; next to
it the same with captures drawn at random from those that it chose from.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks._sections import write_section
from radiometer.reconciliation.engine import examine
from radiometer.reconciliation.search import Reconciled
from radiometer.reconciliation.separability import CapturePool
from testing.generator.plan import Setting, bracket
from testing.generator.session import make_session

HIDDEN = ("veiling_glare", "display_black_leak", "ambient_light_leak", "gain_step_error", "fnumber_tstop_error")
FIRST_SEED = 40_000

Choice = Callable[[Reconciled], list[dict[str, Any]]]


def asked(done: Reconciled) -> list[dict[str, Any]]:
    """Return the capture that the result asks for; none where it asks for none."""
    proposed = [e.next_capture for e in done.result.effects if e.next_capture] + [done.result.next_capture]
    return [frame for capture in proposed if capture for frame in capture["frames"]][:1]


def drawn(rng: np.random.Generator) -> Choice:
    """Return a choice at random from the same captures."""

    def choose(done: Reconciled) -> list[dict[str, Any]]:
        pool = CapturePool.of(done.outcome.state)
        frame = pool.frame(int(rng.integers(len(pool.design.captures))))
        return [frame.model_dump(mode="json", exclude_none=True)]

    return choose


def captures_needed(name: str, seed: int, choose: Choice, most: int, *, known: bool = True) -> tuple[int | None, str]:
    """Return how many captures more settle it (None: not within `most`) and the last answer."""
    added: list[Setting] = []
    answer = ""
    for number in range(most + 1):
        session = make_session(name, camera_seed=seed, plan=_bracket_and(tuple(added)), known_patches=known)
        frames = list(session.frames())
        done = examine(session.header, frames.__getitem__, frames[0].shape)
        result = done.result
        answer = " + ".join([str(result.verdict), *(effect.name for effect in result.effects)])
        named = [effect.name for effect in result.effects] == [name]
        if named and str(result.verdict) == "effects_found" and not result.effects[0].alternatives:
            return number, answer
        added += [as_setting(frame) for frame in choose(done)]
    return None, answer


def _bracket_and(added: tuple[Setting, ...]) -> Callable[[np.random.Generator], list[Setting]]:
    return lambda rng: [*bracket(rng), *added]


def as_setting(frame: dict[str, Any]) -> Setting:
    """Return a planned capture in the generator's words."""
    return Setting(
        frame["exposure_s"],
        frame.get("gain_db", 0.0),
        frame.get("f_number", 4.0),
        level=frame.get("source_level", 1.0),
        pattern=frame.get("pattern", "chart"),
        closed=frame.get("shutter") == "closed",
    )


def page(rows: list[dict[str, Any]]) -> str:
    """Return the table in Markdown."""
    lines = ["| hidden | radiances of patches | proposed | at random |", "|---|---|---|---|"]
    for (name, known), group in _grouped(rows).items():
        asked_for, random = (", ".join("–" if r[k] is None else str(r[k]) for r in group) for k in ("asked", "random"))
        lines.append(f"| {name} | {'stated' if known else 'not stated'} | {asked_for} | {random} |")
    counts = {k: [r[k] for r in rows] for k in ("asked", "random")}
    lines.append("")
    for key, words in (("asked", "What is asked for"), ("random", "A random choice")):
        settled = [n for n in counts[key] if n is not None]
        mean = f"{np.mean(settled):.2f}" if settled else "–"
        lines.append(f"* {words} settles {len(settled)} of {len(rows)} runs, with {mean} captures in the mean.")
    return "\n".join(lines)


def _grouped(rows: list[dict[str, Any]]) -> dict[tuple[str, bool], list[dict[str, Any]]]:
    found: dict[tuple[str, bool], list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["hidden"], row["known"]), []).append(row)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--most", type=int, default=4, help="further captures at most")
    parser.add_argument("--hidden", default=",".join(HIDDEN))
    options = parser.parse_args()
    rows = []
    for known in (True, False):
        for name in options.hidden.split(","):
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                row: dict[str, Any] = {"hidden": name, "known": known, "seed": seed}
                row["asked"], row["answer"] = captures_needed(name, seed, asked, options.most, known=known)
                chance = drawn(np.random.default_rng([seed, 9]))
                row["random"], row["answer_random"] = captures_needed(name, seed, chance, options.most, known=known)
                rows.append(row)
                print(row, flush=True)
    body = (
        "The number of captures beyond a plain bracket until the hidden effect is named alone and without "
        f"alternatives, for {options.seeds} seeds; – means not within {options.most}.\n\n{page(rows)}"
    )
    print(body)
    command = (
        f"python -m benchmarks.reconcile_next_capture --seeds {options.seeds} --most {options.most} "
        f"--first-seed {options.first_seed}"
    )
    write_section("reconcile_next_capture", "Reconcile: the next capture", command, body)


if __name__ == "__main__":
    main()
