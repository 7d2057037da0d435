"""Is the table of limits true? Each entry is hidden at half its limit, at the limit and at twice it.

    nice python -m benchmarks.reconcile_limits [--seeds 4] [--plan bracket] [--entries psf_blur,image_lag]

The limit is what a set without anything hidden states; sizes are those of the independent generator.
"""

from __future__ import annotations

import argparse
from typing import Any

from benchmarks._reconcile_judge import PARAMETERS
from benchmarks._sections import write_section
from radiometer.reconciliation.result import ReconcileResult
from testing.generator.session import Session, make_session
from testing.reconciled import reconcile

# Entries of every statistic: means, variances, patterns, lines, neighbours, first frames, whole frames, edges.
ENTRIES = (
    "black_level_offset",
    "exposure_time_offset",
    "veiling_glare",
    "conversion_gain_error",
    "excess_read_noise",
    "prnu",
    "dsnu",
    "column_pattern",
    "row_temporal_noise",
    "crosstalk",
    "image_lag",
    "mains_ripple",
    "psf_blur",
)
FACTORS = (0.5, 1.0, 2.0)
FIRST_SEED = 60_000


def answer_at(name: str, size: float, seed: int, plan: str) -> ReconcileResult:
    """Return the answer to a set in which an entry is hidden at a size, in the unit of its limit."""
    mine, _, factor = PARAMETERS[name][0]
    unit = make_session(name, camera_seed=seed, plan=plan, scale=1.0).truth[name][mine]
    return _asked(make_session(name, camera_seed=seed, plan=plan, scale=size / abs(float(unit) * factor)))


def _asked(session: Session, *, with_limits: bool = False) -> ReconcileResult:
    return reconcile(session.header, list(session.frames()), with_limits=with_limits)


def is_named(name: str, answer: ReconcileResult) -> bool:
    """Tell whether an answer names an entry, or gives it as an alternative of what it names."""
    return any(name in (effect.name, *effect.alternatives) for effect in answer.effects)


def page(rows: list[dict[str, Any]], factors: tuple[float, ...] = FACTORS) -> str:
    """Return the table in Markdown."""
    lines = [
        "| entry | limit (first seed) | " + " | ".join(f"named at {factor:g} ×" for factor in factors) + " |",
        "|---|---|" + "---|" * len(factors),
    ]
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        shares = [[row["named"] for row in own if row["factor"] == factor] for factor in factors]
        cells = " | ".join(f"{sum(share)}/{len(share)}" for share in shares)
        unit = "" if own[0]["unit"] == "1" else f" {own[0]['unit']}"
        lines.append(f"| {name} | {own[0]['limit']:.3g}{unit} | {cells} |")
    whole = [[row["named"] for row in rows if row["factor"] == factor] for factor in factors]
    lines.append("| all | | " + " | ".join(f"{sum(share)}/{len(share)}" for share in whole) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--plan", default="bracket")
    parser.add_argument("--entries", default=",".join(ENTRIES))
    options = parser.parse_args()
    rows = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        stated = _asked(make_session(camera_seed=seed, plan=options.plan), with_limits=True).limits
        for name in options.entries.split(","):
            limit = stated[name]
            for factor in FACTORS if limit.amplitude else ():
                answer = answer_at(name, factor * float(limit.amplitude or 0.0), seed, options.plan)
                row = {"name": name, "factor": factor, "limit": limit.amplitude, "unit": limit.unit, "seed": seed}
                row |= {"named": is_named(name, answer), "reported": [e.name for e in answer.effects]}
                rows.append(row)
                print(row, flush=True)
    body = (
        f"Plan `{options.plan}`, {options.seeds} simulated cameras. A limit is the size that would stand out by five "
        f"sigma; a name asks for about four (eight nats), so that half the limit should pass, and twice it "
        f"never.\n\n{page(rows)}"
    )
    print(body)
    command = (
        f"python -m benchmarks.reconcile_limits --seeds {options.seeds} --first-seed {options.first_seed} "
        f"--plan {options.plan}"
    )
    write_section("reconcile_limits", "Reconcile: are the limits true?", command, body)


if __name__ == "__main__":
    main()
