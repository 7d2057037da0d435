"""`python -m benchmarks naming`: make sealed sessions, have the tools name what is missing, score them, write the page.

Another tool takes part by its own program: `--only make` writes the sessions, the program writes
`answers/<tool>.json` (session number to answer), and `--only score` scores every file of answers.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks._sections import write_section
from benchmarks.naming import light_tunnel, sessions
from benchmarks.naming.score import report
from benchmarks.naming.tools import TOOLS

_STEPS = ("make", "solve", "score")
_WORLDS = {  # who makes the sessions, and the section of the page
    "generator": (sessions.make, "naming", "Naming what is missing"),
    "light-tunnel": (light_tunnel.make, "naming-light-tunnel", "A world by other people: the light tunnel"),
}


def solve(folder: Path, tool: str) -> None:
    """Write the answers of a tool; sessions that it has answered already are left alone."""
    file = folder / "answers" / f"{tool}.json"
    file.parent.mkdir(exist_ok=True)
    answers = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for session in sorted((folder / "sessions").iterdir()):
        if session.name not in answers:
            answers[session.name] = TOOLS[tool](session)
            file.write_text(json.dumps(answers), encoding="utf-8")


def main() -> None:
    """Run the benchmark, or one step of it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks naming", description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("naming"), help="sessions, truth and answers; kept")
    parser.add_argument("--count", type=int, default=2, help="sessions of each kind")
    parser.add_argument("--first-seed", type=int, default=961_000)
    parser.add_argument("--world", choices=_WORLDS, default="generator", help="who makes the sessions")
    parser.add_argument("--only", choices=_STEPS)
    chosen = parser.parse_args()
    steps = (chosen.only,) if chosen.only else _STEPS
    make, place, title = _WORLDS[chosen.world]
    if "make" in steps and not (chosen.folder / "truth.json").exists():
        try:
            make(chosen.folder, chosen.count, chosen.first_seed)
        except ImportError as missing:
            print(f"skipped: {missing}; `pip install causalchamber` into another folder and put it on PYTHONPATH")
            return
    if "solve" in steps:
        for tool in TOOLS:
            solve(chosen.folder, tool)
    if "score" in steps:
        truth = json.loads((chosen.folder / "truth.json").read_text(encoding="utf-8"))
        files = sorted((chosen.folder / "answers").glob("*.json"))
        answers = {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}
        body = report(answers, truth)
        print(body)
        world = "" if chosen.world == "generator" else f" --world {chosen.world}"
        command = f"python -m benchmarks naming{world} --count {chosen.count} --first-seed {chosen.first_seed}"
        write_section(place, title, command, body)
