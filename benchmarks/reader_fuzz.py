"""Damages files of every kind that is read, 3,000 of each, in a process that may take 1 GB and no more."""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks._sections import write_section

ROOT = Path(__file__).resolve().parents[1]
FILES, SEED = 3000, 48
_MOST_BYTES = 2**30
_SCRIPT = ROOT / "testing" / "reader_fuzz.py"
_LINE = re.compile(r"(\d+) files of (\S+): (\d+) refused; (\d+) faults; longest ([\d.]+) s; peak (\d+) MB")


def run(files: int, seed: int) -> list[tuple[str, ...]]:
    """Return kind, files, refused, faults, longest time in s and peak memory in MB. Prints the faults."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (_MOST_BYTES, _MOST_BYTES))

    found = list[tuple[str, ...]]()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(_SCRIPT), folder, str(files), str(seed)]
        with subprocess.Popen(command, preexec_fn=limit, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stdout is not None
            for line in process.stdout:
                print(line, end="", flush=True)
                if (entry := _LINE.match(line)) is not None:
                    count, kind, refused, faults, longest_s, peak_mb = entry.groups()
                    found.append((kind, count, refused, faults, longest_s, peak_mb))
    return found


def table(found: list[tuple[str, ...]]) -> str:
    """Return the figures of all kinds in a row, for the page."""
    shares = [100 * int(refused) / int(count) for _, count, refused, *_ in found]
    row = [
        ", ".join(kind for kind, *_ in found),
        str(sum(int(count) for _, count, *_ in found)),
        f"{min(shares):.0f} to {max(shares):.0f} %",
        str(sum(int(faults) for *_, faults, _, _ in found)),
        f"{max(float(longest_s) for *_, longest_s, _ in found):.1f} s",
        f"{max(int(peak_mb) for *_, peak_mb in found)} MB",
    ]
    return (
        "Each reader gets files that none may stumble over (unpacking bombs, loops, nesting, noise), then good files"
        " with one to four damages. Refused means with one line of our own. A fault is anything else: a traceback, a"
        " crash, two lines. One process reads them all and may take 1 GB; so may the second process, in which some"
        " formats are read. The time is processor time of both.\n\n"
        "| kinds | files | refused, by kind | faults | longest | peak memory |\n"
        f"|---|---|---|---|---|---|\n| {' | '.join(row)} |\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    body = table(run(options.files, options.seed))
    print(body)
    write_section("reader-fuzz", "Readers fuzzed", "python -m benchmarks reader_fuzz", body)


if __name__ == "__main__":
    main()
