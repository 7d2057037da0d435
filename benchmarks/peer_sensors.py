"""`radiometer reconcile` on sessions that other people's simulators develop: ESA's Pyxel and GalSim.

    python -m benchmarks peer_sensors --python OTHER/bin/python --sets 42 --first-seed 100
    python -m benchmarks peer_sensors --python OTHER/bin/python --sets 24 --first-seed 300 --figures

OTHER is an environment with pyxel-sim, galsim, opencv-python-headless and pyyaml, of which this project needs no part;
without it the benchmark says so and stops. Cases come in random order, each as often. Every run is one line of the
results file; what stands there is not run again. A blind set is one whose seeds were never looked at in development.
With --figures the EMVA 1288 figures of `radiometer characterise` are held against what the peers were given.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._sections import write_section
from radiometer.reconciliation import reconcile_capture

MAKER = Path(__file__).parent / "_peers" / "make.py"
RESULTS = Path("out") / "peer_sensors.jsonl"
FIGURES = {  # of characterise, with what they ought to be by header and truth, and the cases that show them
    "K": (lambda camera, drawn: 1.0 / camera["conversion_gain_e_per_dn"], ("null", "prnu", "dark_simple")),
    "sigma_d": (lambda camera, drawn: camera["read_noise_e"], ("null", "prnu", "dark_simple")),
    "mu_y_dark": (lambda camera, drawn: camera["black_level_dn"], ("null", "prnu", "dark_simple")),
    "eta": (lambda camera, drawn: 100.0 * camera["quantum_efficiency"], ("null", "prnu", "dark_simple")),
    "PRNU_pixel": (lambda camera, drawn: 100.0 * drawn["sigma_rel"], ("prnu",)),
    "mu_I_mean": (lambda camera, drawn: drawn["rate_e_per_s"], ("dark_simple",)),
}


def cases_of(python: str) -> list[str]:
    """Return the names of the cases. Raises OSError or CalledProcessError where the peers are not installed."""
    listed = subprocess.run([python, str(MAKER), "--cases"], check=True, capture_output=True, text=True)
    return listed.stdout.split()


def run(python: str, case: str, seed: int) -> dict[str, Any]:
    """Return what is reported of one session and whether it is right; a crash is an answer too."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session"
        subprocess.run([python, str(MAKER), case, str(seed), str(path)], check=True, capture_output=True, text=True)
        truth = yaml.safe_load(path.with_name("session.truth.yaml").read_text(encoding="utf-8"))
        kept = {"seed": seed, **truth}
        begun = time.process_time()
        try:
            reported = reconcile_capture(path).result.to_mapping()
        except Exception as error:  # noqa: BLE001 (a crash of the finder is a failed run, not the end of the benchmark)
            return kept | {"error": f"{type(error).__name__}: {error}"}
    effects = [
        {key: effect[key] for key in ("name", "where", "alternatives", "parameters")} for effect in reported["effects"]
    ]
    return kept | {
        "verdict": reported["verdict"],
        "reported": effects,
        "gap": [reported["gap"]["before"], reported["gap"]["after"]],
        "cpu_s": round(time.process_time() - begun, 1),
    }


def pulls_of(python: str, case: str, seed: int) -> dict[str, list[float]]:
    """Return value, standard uncertainty and truth of each figure that a session shows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session"
        subprocess.run([python, str(MAKER), case, str(seed), str(path)], check=True, capture_output=True, text=True)
        drawn = yaml.safe_load(path.with_name("session.truth.yaml").read_text(encoding="utf-8"))["drawn"]
        camera = yaml.safe_load((path / "capture.yaml").read_text(encoding="utf-8"))["camera"]
        asked = [sys.executable, "-m", "radiometer", "characterise", str(path), "--json"]
        figures = json.loads(subprocess.run(asked, check=True, capture_output=True, text=True).stdout)["emva1288"][
            "figures"
        ]
    return {
        name: [figures[name]["value"], figures[name]["u"], truth(camera, drawn)]
        for name, (truth, cases) in FIGURES.items()
        if case in cases
    }


def page_of_figures(results: Sequence[dict[str, list[float]]]) -> str:
    """Return how far the figures lie from the truth, in Markdown."""
    lines = [
        "| figure | sessions | rms of (value - truth)/u | within 2 u | value over truth, mean |",
        "|---|---|---|---|---|",
    ]
    for name in FIGURES:
        own = np.array([result[name] for result in results if name in result])
        if own.size:
            pulls = (own[:, 0] - own[:, 2]) / own[:, 1]
            rms, ratio = float(np.sqrt(np.mean(pulls**2))), float(np.mean(own[:, 0] / own[:, 2]))
            lines.append(f"| {name} | {pulls.size} | {rms:.2f} | {np.sum(np.abs(pulls) <= 2)} | {ratio:.4f} |")
    return "\n".join(lines)


def judged(result: dict[str, Any]) -> str:
    """Return one word.

    silent: nothing hidden, nothing named. missed: something hidden, nothing named. exact: right names and nothing else,
    and sure; provisional: the same with a doubt. rival: a right name is only among alternatives. partly: a right
    name with others, not sure. unsure: no name that is right, none sure. wrong: a name that is
    not right, and sure of it.
    """
    right, reported, sure = set(result["right"]), result["reported"], result["verdict"] == "effects_found"
    if not reported:
        return "silent" if result["kind"] == "null" else "missed"
    names = {entry["name"] for entry in reported}
    strange = [e for e in reported if e["name"] != "unnamed" and not right & {e["name"], *e["alternatives"]}]
    if strange:
        return "wrong" if sure else "partly" if right & names else "unsure"
    if names <= right:
        return "exact" if sure else "provisional"
    return "partly" if right & names else "unsure" if names == {"unnamed"} else "rival"


def page(results: Sequence[dict[str, Any]]) -> str:
    """Return what was reported case by case, in Markdown."""
    lines = ["| case | sessions | judged | reported |", "|---|---|---|---|"]
    for case in sorted({result["case"] for result in results}):
        own = [result for result in results if result["case"] == case]
        words = [judged(result) if "reported" in result else "error" for result in own]
        counts = ", ".join(f"{word} {words.count(word)}" for word in dict.fromkeys(words))
        reported = dict.fromkeys(
            " + ".join(entry["name"] for entry in result["reported"]) or "nothing"
            for result in own
            if "reported" in result
        )
        lines.append(f"| {case} ({own[0]['kind']}) | {len(own)} | {counts} | {'; '.join(reported)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks peer_sensors", description=__doc__)
    parser.add_argument("--python", default="", help="interpreter that has pyxel-sim and galsim")
    parser.add_argument("--sets", type=int, default=21, help="sessions in all; each case comes as often")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--figures", action="store_true", help="the figures of characterise instead")
    parser.add_argument("--only", default="", help="cases, by comma")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/reconcile.md")
    options = parser.parse_args()
    try:
        names = cases_of(options.python or sys.executable)
    except (OSError, subprocess.CalledProcessError):
        print("skipped: no interpreter with pyxel-sim and galsim (--python); see benchmarks/_peers/make.py")
        return
    if options.figures:
        seeds = range(options.first_seed, options.first_seed + options.sets)
        cases = ("null", "prnu", "dark_simple")
        print(page_of_figures([pulls_of(options.python, cases[seed % len(cases)], seed) for seed in seeds]))
        return
    names = [name for name in names if not options.only or name in options.only.split(",")]
    order = np.random.default_rng(options.first_seed).permutation(max(options.sets, len(names)))[: options.sets]
    lines = options.results.read_text(encoding="utf-8").splitlines() if options.results.exists() else []
    done = {(r["case"], r["seed"]): r for r in map(json.loads, lines)}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    options.results.parent.mkdir(parents=True, exist_ok=True)
    results: list[dict[str, Any]] = []
    try:
        for number in order.tolist():
            case, seed = names[number % len(names)], options.first_seed + number
            if (case, seed) not in done:
                done[case, seed] = run(options.python or sys.executable, case, seed)
                with options.results.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(done[case, seed]) + "\n")
            results.append(done[case, seed])
            last = results[-1]
            word = judged(last) if "reported" in last else last["error"]
            shown = [e["name"] for e in last.get("reported", ())]
            print(
                f"{len(results)}/{len(order)} {case} {seed}: {word}; {last.get('verdict')} {shown} {last['drawn']}",
                flush=True,
            )
    except KeyboardInterrupt:
        print(f"stopped after {len(results)} of {len(order)}", file=sys.stderr)
    body = page(results)
    print(f"\n{body}")
    if options.write and results:
        asked = f"python -m benchmarks peer_sensors --sets {options.sets} --first-seed {options.first_seed}"
        write_section("peer_sensors", "Reconcile: sessions developed by Pyxel and GalSim", asked, body)


if __name__ == "__main__":
    main()
