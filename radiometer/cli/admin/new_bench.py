"""`radiometer new-bench`: five questions, and a bench file that the other commands take."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Final

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_f_number, parse_patch
from radiometer.cli.console import note
from radiometer.cli.outputs import writes

_QUESTIONS: Final = {
    "camera": "Camera: serial number, id or address; sim for a simulated one",
    "focal_length": "Focal length of the lens in mm; empty if there is none, or nothing is known of it",
    "f_number": "f-number that the lens is set to",
    "calibration": "Calibration file; empty if there is none yet",
    "patch": "Region to measure, X,Y,W,H in pixels; empty for the middle",
}


@writes("output")
def command(
    output: Annotated[Path, typer.Argument(metavar="FILE", help="Bench file to write (.yaml).")],
    camera: Annotated[str | None, typer.Option(help=f"{_QUESTIONS['camera']}.")] = None,
    focal_length: Annotated[str | None, typer.Option(help=f"{_QUESTIONS['focal_length']}.")] = None,
    f_number: Annotated[str | None, typer.Option(help=f"{_QUESTIONS['f_number']}.")] = None,
    calibration: Annotated[str | None, typer.Option(help=f"{_QUESTIONS['calibration']}.")] = None,
    patch: Annotated[str | None, typer.Option(help=f"{_QUESTIONS['patch']}.")] = None,
) -> None:
    """Ask five questions and write a bench file: which camera, lens and calibration belong together.

    What an option answers is not asked. Without a terminal, questions without an answer count as empty.
    """
    which = _answer("camera", camera)
    length = _number("--focal-length", _answer("focal_length", focal_length))
    number = _answer("f_number", f_number) if length else ""
    chosen, region = _answer("calibration", calibration), _answer("patch", patch)
    rm.new_bench(
        output, which, focal_length_mm=length, f_number=parse_f_number(number, "--f-number") if number else None,
        calibration=chosen or None, patch=parse_patch(region) if region else None,
    )  # fmt: skip
    note(f"written: {output}")
    note(f"next: radiometer doctor --bench {output} --camera {which}")


def _answer(name: str, given: str | None) -> str:
    if given is not None or not sys.stdin.isatty():
        return (given or "").strip()
    return str(typer.prompt(_QUESTIONS[name], default="", show_default=False, err=True)).strip()


def _number(option: str, text: str) -> float | None:
    if not text:
        return None
    try:
        return float(text)
    except ValueError as error:
        raise rm.UsageError(f"{option} {text!r}: expected a number above 0") from error
