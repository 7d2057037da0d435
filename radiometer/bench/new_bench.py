"""Writes a new bench file: which camera, lens and calibration belong together."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from radiometer.bench.cameras import SIMULATED
from radiometer.bench.config import BenchConfig
from radiometer.data import Patch
from radiometer.data.storage import write_yaml_atomic
from radiometer.data.validation import validate
from radiometer.errors import ConfigurationError, UsageError

_PRESET: Final = {"kind": "simulated", "preset": "BFS-U3-19S4M"}
_EVEN_FIELD: Final = {"kind": "uniform", "radiance_W_per_sr_m2": 0.3}
_SIMULATED_LENS: Final = {"focal_length_mm": 16.0, "f_number": 4.0}


def require_name(path: Path) -> None:
    """Raise UsageError where the name is no bench file's."""
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{path}: a bench file's name must end in .yaml")


def write_bench(
    path: Path,
    camera: str,
    focal_length_mm: float | None,
    f_number: float | None,
    calibration: str | None,
    patch: Patch | None,
) -> Path:
    """Write a bench file once its content has been checked, and return its path.

    Args:
        path: File to write (.yaml).
        camera: Serial number, id or address; "sim" for a simulated one.
        focal_length_mm: Focal length in mm; None where there is no lens or it is not known.
        f_number: f-number that the lens is set to.
        calibration: Calibration file; None where there is none yet.
        patch: Region to measure; None for the middle.

    Raises:
        UsageError: If the camera, or the f-number of a known lens, is missing.
        ConfigurationError: If the form of bench files does not allow a value.
        OutputError: If the file cannot be written.
    """
    require_name(path)
    if not camera:
        raise UsageError("a bench needs a camera: --camera sim, or the serial number that `radiometer devices` lists")
    if focal_length_mm and not f_number:
        raise UsageError("a lens of known focal length needs its f-number: --f-number 4")
    lens = {"focal_length_mm": focal_length_mm, "f_number": f_number} if focal_length_mm else None
    mapping: dict[str, Any] = {"format": "radiometer-bench/1", "camera": {"kind": "genicam", "id": camera}}
    mapping["lens"] = lens
    if camera == SIMULATED:
        mapping |= {"camera": dict(_PRESET), "lens": lens or dict(_SIMULATED_LENS), "scene": dict(_EVEN_FIELD)}
    if calibration:
        mapping["calibration"] = calibration
    if patch:
        mapping["patch"] = asdict(patch)
    validate(BenchConfig, mapping, str(path), ConfigurationError)
    write_yaml_atomic(path, mapping)
    return path
