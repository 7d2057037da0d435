"""Damages files of every kind that is read, thousands of each, in a process that may take 1 GB and no more."""

from __future__ import annotations

import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._sections import write_section

ROOT = Path(__file__).resolve().parents[1]
FILES = 3000
_MOST_BYTES = 2**30
_SCRIPT = ROOT / "tests" / "unit" / "data" / "reader_fuzz.py"


def run(files: int) -> list[tuple[str, int, int, int]]:
    """Return kind, files, refused, and peak memory in MB so far, for each kind. Raises RuntimeError where one fails."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (_MOST_BYTES, _MOST_BYTES))

    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(_SCRIPT), folder, str(files), "--random"]
        done = subprocess.run(command, preexec_fn=limit, capture_output=True, text=True, cwd=ROOT, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stdout[-2000:] + done.stderr[-4000:])
    lines = re.findall(r"(\d+) files of (\S+): (\d+) refused; peak (\d+) MB", done.stdout)
    return [(kind, int(count), int(refused), int(peak)) for count, kind, refused, peak in lines]


def main() -> None:
    begun = time.monotonic()
    found = run(FILES)
    shares = [100 * refused / count for _, count, refused, _ in found]
    peak = max(peak for *_, peak in found)
    row = f"| {', '.join(kind for kind, *_ in found)} | {sum(count for _, count, *_ in found)} "
    row += f"| {min(shares):.0f} to {max(shares):.0f} % | {peak} MB |\n"
    body = (
        "Good files with one to four damages chosen by hypothesis, read in one process that may take 1 GB. Refused"
        f" means with one of our own messages; anything else would have ended it. {time.monotonic() - begun:.0f} s.\n\n"
        f"| kinds | files | refused, by kind | peak memory of the process |\n|---|---|---|---|\n{row}"
    )
    print(body)
    write_section("reader-fuzz", "Readers fuzzed", "python -m benchmarks reader_fuzz", body)


if __name__ == "__main__":
    main()
