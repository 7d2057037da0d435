"""Cameras of 4 and 16 output amplifiers: figures of every tap, borders, and effects of taps that are hidden.

    python -m benchmarks taps --cameras 20 --sessions 6 --first-seed 1301001

Gains, black levels and read noises of every tap are drawn, with pairs of flats and of dark frames. `characterise` has
them with the taps stated, and without. Effects of taps are hidden by the tests' generator, one at a time, in
cameras whose taps are described; 16 taps are hidden here, in two rows of eight. Nulls hide nothing.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import radiometer as rm
from benchmarks._sections import write_section
from benchmarks.naming.score import SURE
from radiometer.data import CameraDescription, CaptureSetWriter, Frame, FrameSettings, TapDescription
from radiometer.errors import MeasurementError
from testing.generator.rig import Rig
from testing.generator.session import Session, make_session, session_of_taps
from testing.reconciled import reconcile
from testing.tap_camera import Taps

RESULTS: Final = Path("out") / "taps.jsonl"
GRIDS: Final = {"4 taps": (2, 2), "16 taps": (2, 8)}  # rows and columns of taps
NAMES: Final = ("tap_offset", "tap_gain", "tap_noise", "tap_nonlinearity")
_SHAPE: Final = (128, 192)
_FIGURES: Final = {"K": "gain", "mu_y_dark": "black", "sigma_d": "noise"}  # of characterise, by the truth


def write_camera(folder: Path, taps: Taps, seed: int) -> Path:
    """Write the capture set of a camera that says nothing of its taps."""
    with CaptureSetWriter(folder, CameraDescription(bit_depth=14)) as writer:
        for kind, exposure_s, _, dn in taps.frames(np.random.default_rng([seed, 2]), _SHAPE):
            shutter = "closed" if kind == "dark" else "open"
            writer.add(Frame(dn, 14, FrameSettings(exposure_s, gain_db=0.0, shutter=shutter)))
        writer.finish()
    return folder


def figures(kind: str, seed: int) -> dict[str, Any]:
    """Return errors over u of every tap's figures, and whether the borders are found without a declaration."""
    rows, columns = GRIDS[kind]
    taps = Taps.drawn(np.random.default_rng([seed, 1]), rows, columns)
    with tempfile.TemporaryDirectory() as folder:
        path = write_camera(Path(folder) / "set", taps, seed)
        stated = rm.characterise(path, taps=f"{columns}x{rows}")
        errors = {
            symbol: [
                (found.figures[symbol].value - true) / found.figures[symbol].u
                for one, true in zip(stated.taps, getattr(taps, truth).flat, strict=True)
                if (found := one.characterisation) is not None
            ]
            for symbol, truth in _FIGURES.items()
        }
        try:
            borders = [(t.tap.x, t.tap.y, t.tap.width, t.tap.height) for t in rm.characterise(path, taps="find").taps]
        except MeasurementError:
            borders = []
    return {"errors_u": errors, "borders": borders == taps.rectangles(_SHAPE)}


def alone(seed: int) -> dict[str, Any]:
    """Return whether frames of one amplifier are parted."""
    one = Taps(np.full((1, 1), 0.5), np.full((1, 1), 200.0), np.full((1, 1), 6.0))
    with tempfile.TemporaryDirectory() as folder:
        try:
            parted = len(rm.characterise(write_camera(Path(folder) / "set", one, seed), taps="find").taps) > 1
        except MeasurementError:
            parted = False
    return {"parted": parted}


def with_taps(session: Session, grid: tuple[int, int], shape: tuple[int, int]) -> dict[str, Any]:
    """Return what reconcile answers for a session whose camera is described with its taps."""
    places = Taps(*[np.zeros(grid)] * 3).rectangles(shape)
    described = tuple(
        TapDescription(name=str(n), x=x, y=y, width=w, height=h) for n, (x, y, w, h) in enumerate(places, 1)
    )
    camera = session.header.camera.model_copy(update={"taps": described})
    header = session.header.model_copy(update={"camera": camera})
    begun = time.process_time()
    found = reconcile(header, list(session.frames()), with_limits=False)
    effects = [{"name": e.name, "alternatives": list(e.alternatives), "probability": e.probability or 0.0}
               for e in found.effects]  # fmt: skip
    return {"verdict": str(found.verdict), "effects": effects, "cpu_s": round(time.process_time() - begun, 1)}


def hidden(kind: str, name: str, seed: int) -> dict[str, Any]:
    """Return what reconcile answers for an effect of taps, or for none."""
    rig, grid = Rig(), GRIDS[kind]
    if kind == "4 taps":
        session = make_session(*([name] if name else []), camera_seed=seed)
    else:
        session = session_of_taps(name, grid, seed)
    return with_taps(session, grid, (rig.rows, rig.columns))


def judged(name: str, answer: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether an answer is exact, abstains, or is sure of a wrong name."""
    effects = answer["effects"]
    named = [e for e in effects if e["name"] != "unnamed"]
    wrong = [e for e in named if e["name"] != name and name not in e["alternatives"]]
    exact = [e["name"] for e in effects] == ([name] if name else [])
    return {"exact": exact, "unnamed": bool(effects) and not named, "wrong": bool(wrong),
            "sure and wrong": any(e["probability"] >= SURE for e in wrong)}  # fmt: skip


def page(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the figures reached in Markdown."""
    lines = ["| camera | figure | taps | within 2 u | rms of error / u |", "|---|---|---|---|---|"]
    for kind in GRIDS:
        own = [r["errors_u"] for r in results if r["what"] == "figures" and r["kind"] == kind]
        for symbol in _FIGURES if own else ():
            errors = np.concatenate([one[symbol] for one in own])
            inside = int(np.sum(np.abs(errors) <= 2))
            rms = float(np.sqrt(np.mean(errors**2)))
            lines.append(
                f"| {kind} | {symbol} | {errors.size} | {inside} ({100 * inside / errors.size:.1f} %) | {rms:.2f} |"
            )
    lines += ["", "| frames | cameras | all borders found without a declaration |", "|---|---|---|"]
    for kind in GRIDS:
        own = [r["borders"] for r in results if r["what"] == "figures" and r["kind"] == kind]
        lines += [f"| {kind} | {len(own)} | {sum(own)} |"] if own else []
    parted = [r["parted"] for r in results if r["what"] == "alone"]
    lines += [f"| one amplifier: parted falsely | {len(parted)} | {sum(parted)} |"] if parted else []
    lines += ["", "| camera | hidden | sessions | exact | unnamed | a wrong name | sure and wrong | median s |",
              "|---" * 8 + "|"]  # fmt: skip
    for kind in GRIDS:
        for name in ("", *NAMES):
            own = [r for r in results if r["what"] == "hidden" and r["kind"] == kind and r["name"] == name]
            verdicts = [judged(name, r) for r in own]
            counts = " | ".join(
                str(sum(v[k] for v in verdicts)) for k in ("exact", "unnamed", "wrong", "sure and wrong")
            )
            seconds = f"{np.median([r['cpu_s'] for r in own]):.0f}" if own else ""
            lines += [f"| {kind} | {name or 'nothing'} | {len(own)} | {counts} | {seconds} |"] if own else []
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks taps", description=__doc__)
    parser.add_argument("--cameras", type=int, default=20, help="cameras of each number of taps")
    parser.add_argument("--sessions", type=int, default=6, help="sessions of each hidden effect and of nulls")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/sensors.md")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.cameras)
    tasks: list[tuple[str, str, str, int]] = [("figures", kind, "", seed) for kind in GRIDS for seed in seeds]
    tasks += [("alone", "one", "", seed) for seed in seeds]
    tasks += [("hidden", kind, name, options.first_seed + n) for n in range(options.sessions) for kind in GRIDS
              for name in ("", *NAMES)]  # fmt: skip
    lines = options.results.read_text(encoding="utf-8").splitlines() if options.results.exists() else []
    done = {(r["what"], r["kind"], r["name"], r["seed"]): r for r in map(json.loads, lines)}
    options.results.parent.mkdir(parents=True, exist_ok=True)
    for task in tasks:
        if task not in done:
            what, kind, name, seed = task
            found = (
                figures(kind, seed)
                if what == "figures"
                else alone(seed)
                if what == "alone"
                else hidden(kind, name, seed)
            )
            done[task] = {"what": what, "kind": kind, "name": name, "seed": seed, **found}
            with options.results.open("a", encoding="utf-8") as out:
                out.write(json.dumps(done[task]) + "\n")
            shown = {k: v for k, v in done[task].items() if k != "errors_u"}
            print(shown, flush=True)
    body = page([done[task] for task in tasks])
    print(body)
    if options.write:
        asked = f"python -m benchmarks taps --cameras {options.cameras} --sessions {options.sessions}"
        write_section("taps", "Cameras of several amplifiers", f"{asked} --first-seed {options.first_seed}", body)


if __name__ == "__main__":
    main()
