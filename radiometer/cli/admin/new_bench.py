"""`radiometer new-bench`: five questions, and a bench file that the other commands take."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note
from radiometer.cli.outputs import writes
from radiometer.errors import UsageError

_QUESTIONS: Final = {
    "camera": "Camera: serial number, id or address; sim for a simulated one",
    "focal_length": "Focal length of the lens in mm; empty if there is none, or nothing is known of it",
    "f_number": "f-number that the lens is set to",
    "calibration": "Calibration file; empty if there is none yet",
    "patch": "Region to measure, X,Y,W,H in pixels; empty for the middle",
}
_SIMULATED: Final = {"kind": "simulated", "preset": "BFS-U3-19S4M"}
_EVEN_FIELD: Final = {"kind": "uniform", "radiance_W_per_sr_m2": 0.3}


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
    if output.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{output}: a bench file's name must end in .yaml")
    which = _answer("camera", camera)
    if not which:
        raise UsageError("a bench needs a camera: --camera sim, or the serial number that `radiometer devices` lists")
    length = _positive("--focal-length", _answer("focal_length", focal_length))
    number = _positive("--f-number", _answer("f_number", f_number)) if length else None
    if length and not number:
        raise UsageError("a lens of known focal length needs its f-number: --f-number 4")
    chosen = {"calibration": _answer("calibration", calibration), "patch": _answer("patch", patch)}
    mapping = _mapping(which, length, number, **chosen)
    _write(output, mapping)
    note(f"written: {output}")
    note(f"next: radiometer doctor --bench {output} --camera {which}")


def _answer(name: str, given: str | None) -> str:
    if given is not None or not sys.stdin.isatty():
        return (given or "").strip()
    return str(typer.prompt(_QUESTIONS[name], default="", show_default=False, err=True)).strip()


def _positive(option: str, text: str) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError as error:
        raise UsageError(f"{option} {text!r}: expected a number above 0") from error
    if not 0 < value < float("inf"):
        raise UsageError(f"{option} {text}: expected a number above 0")
    return value


def _mapping(
    camera: str, focal_length_mm: float | None, f_number: float | None, *, calibration: str, patch: str
) -> dict[str, Any]:
    simulated = camera == "sim"
    mapping: dict[str, Any] = {
        "format": "radiometer-bench/1",
        "camera": dict(_SIMULATED) if simulated else {"kind": "genicam", "id": camera},
        "lens": {"focal_length_mm": focal_length_mm, "f_number": f_number} if focal_length_mm else None,
    }
    if simulated:
        mapping["lens"] = mapping["lens"] or {"focal_length_mm": 16.0, "f_number": 4.0}
        mapping["scene"] = dict(_EVEN_FIELD)
    if calibration:
        mapping["calibration"] = calibration
    if patch:
        region = parse_patch(patch)
        mapping["patch"] = {"x": region.x, "y": region.y, "width": region.width, "height": region.height}
    return mapping


def _write(path: Path, mapping: dict[str, Any]) -> None:
    """Write the file once the words of the bench file's form have been checked. Raises ConfigurationError."""
    from radiometer.bench.config import BenchConfig
    from radiometer.data.storage import write_yaml_atomic
    from radiometer.data.validation import validate
    from radiometer.errors import ConfigurationError

    validate(BenchConfig, mapping, str(path), ConfigurationError)
    write_yaml_atomic(path, mapping)
