"""How much light an eye receives, whatever happens: 10,000 sequences on the simulated desk, 200 with the firmware.

python -m benchmarks eye_exposure
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks._sections import write_section
from testing.eye_world import PROMISED, Desks, firmware_maker, live_through

ROOT = Path(__file__).resolve().parents[1]
FIRMWARE = ROOT / "drivers" / "firmware" / "light_box"
FIRST_SEED = 700_000
PART = 250
ABOUT = (
    "Each sequence is 30 events at a desk with two boxes and two eyes. Programs name an eye, state that none looks, or"
    " name none, and then any eye may look. They give light, are killed at any step on the line or the disk, and take"
    " the longest pulse that is not refused. Cables are pulled, answers get lost, boxes"
    " and computer restart, the clock is set wrong, the account is deleted or damaged. What an eye receives is"
    " integrated from the outputs of the boxes, for the brightest box that the preset allows. A tenth of the limit is"
    " promised. The second table counts requests for light (asked; not all get an answer) and events. Killed in the"
    " midst is a program that was ended inside a request; confirmed is an account that a person declared free."
)
SHOWN = (
    "asked", "given", "refused", "programs", "killed", "killed in the midst", "rebooted", "clock set", "replugged",
    "box restarted", "lines lost", "stalled", "account harmed", "confirmed",
)  # fmt: skip


def main() -> None:
    """Run the sequences."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--twin", type=int, default=10_000, help="sequences with the simulated twin")
    parser.add_argument("--firmware", type=int, default=200, help="sequences with the firmware's code")
    options = parser.parse_args()
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=memory) as name:
        folder = Path(name)
        found = {
            "simulated twin": sequences(folder, options.twin),
            "firmware's code": sequences(folder, options.firmware, firmware=True),
        }
    report(found)


def report(found: dict[str, Desks]) -> None:
    """Print the tables and write them into docs/benchmarks/light-box.md."""
    body = [
        "| box | sequences | largest share of the limit in any 10⁴ s | median | above 9 % | above 10 % |",
        "|---|---|---|---|---|---|",
    ]
    for box, desks in found.items():
        shares = np.array(desks.shares)
        body.append(
            f"| {box} | {len(shares):,} | {shares.max():.2%} | {np.median(shares):.2%} | {np.mean(shares > 0.09):.1%} "
            f"| {np.count_nonzero(shares > PROMISED)} |"
        )
    body += ["", "| what happened | " + " | ".join(found) + " |", "|---" * (1 + len(found)) + "|"]
    body += [f"| {what} | " + " | ".join(f"{desks.count[what]:,}" for desks in found.values()) + " |" for what in SHOWN]
    body = [ABOUT, "", *body]
    print("\n".join(body), flush=True)
    write_section(
        "eye_exposure",
        "How much an eye receives, whatever happens",
        "python -m benchmarks eye_exposure",
        "\n".join(body),
    )


def sequences(folder: Path, count: int, *, firmware: bool = False) -> Desks:
    """Return what came of so many sequences."""
    whole = Desks()
    for first in range(FIRST_SEED, FIRST_SEED + count, PART):
        seeds = range(first, min(first + PART, FIRST_SEED + count))
        found = (
            live_through(folder, seeds, firmware_maker(FIRMWARE, folder)) if firmware else live_through(folder, seeds)
        )
        whole.count += found.count
        whole.shares += found.shares
        print(f"{len(whole.shares)} sequences, largest share {max(whole.shares):.2%}", flush=True)
    return whole


if __name__ == "__main__":
    main()
