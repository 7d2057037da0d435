"""A camera response: the exposure behind every digital number, with its uncertainty."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.capture_header import CameraDescription
from radiometer.data.provenance import Provenance
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import dump_yaml, read_text, read_yaml, write_text_atomic
from radiometer.data.validation import refuse_unknown, validate
from radiometer.errors import InputError

FORMAT = "radiometer-response/1"
_LARGEST_LOG: Final = 100.0  # of an exposure: e¹⁰⁰ and e⁻¹⁰⁰ J·m⁻² are beyond all light
_KEYS: Final = (
    "format", "bit_depth", "channel", "camera", "absolute", "unit", "valid_dn", "provenance", "log_exposure",
    "u_log_exposure",
)  # fmt: skip
_OF_CAMERA: Final = (
    "vendor",
    "model",
    "serial",
    "mode",
)  # what a file keeps of the camera: which one, how it developed
_CSV_HEADER = ["dn", "log_exposure", "u_log_exposure"]


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCurve:
    """The inverse response g(M) = ln f⁻¹(M): natural logarithm of the exposure that gives digital number M.

    Relative curves have the gauge g(M_mid) = 0, M_mid = 2**bit_depth // 2 (128 at 8 bit); absolute ones are
    in ln(J·m⁻²).
    """

    # g, shape (2**bit_depth,), ascending; not finite where the curve says nothing (black, clipped)
    log_exposure: NDArray[np.float64]
    u_log_exposure: NDArray[np.float64]  # standard uncertainty of g relative to the gauge point, same shape
    absolute: bool = False  # whether g is in ln(J·m⁻²)
    # Lowest and highest digital number that data supported; outside it the curve is extrapolated
    valid_dn: tuple[int, int] | None = None
    channel: str = "mono"  # "mono", "luminance", "red", "green" or "blue"
    provenance: Provenance = field(default_factory=lambda: Provenance("unknown"))  # method, inputs, assumptions
    camera: CameraDescription | None = None  # the camera; None where nothing says of which the curve is

    def __post_init__(self) -> None:
        size = self.log_exposure.size
        if self.log_exposure.ndim != 1 or size < 2 or size & (size - 1) or size > 65536:
            raise InputError(f"a response curve needs 2, 4, … 65536 values, one per digital number, not {size}")
        if self.u_log_exposure.shape != self.log_exposure.shape:
            raise InputError("a response curve needs one uncertainty per value")
        finite = self.log_exposure[np.isfinite(self.log_exposure)]
        if finite.size < 2 or np.any(np.diff(finite) < 0):
            raise InputError("a response curve must not fall: more light never gives a lower digital number")
        for name in ("log_exposure", "u_log_exposure"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @property
    def bit_depth(self) -> int:
        """Return the bits per digital number."""
        return int(math.log2(self.log_exposure.size))

    @property
    def mid_dn(self) -> int:
        """Return the digital number at which a relative curve is zero."""
        return int(self.log_exposure.size // 2)

    def to_csv(self) -> str:
        """Return the CSV text `dn,log_exposure,u_log_exposure`."""
        rows = [",".join(_CSV_HEADER)]
        rows += [
            f"{dn},{float(g)!r},{float(u)!r}"
            for dn, (g, u) in enumerate(zip(self.log_exposure, self.u_log_exposure, strict=True))
        ]
        return "\n".join(rows) + "\n"

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that is written to YAML files."""
        return {
            "format": FORMAT,
            "bit_depth": self.bit_depth,
            "channel": self.channel,
            "camera": self.camera.model_dump(include=set(_OF_CAMERA), exclude_none=True) if self.camera else None,
            "absolute": self.absolute,
            "unit": "ln(J m-2)" if self.absolute else "ln(relative exposure)",
            "valid_dn": list(self.valid_dn) if self.valid_dn else None,
            "provenance": self.provenance.to_mapping(),
            "log_exposure": [float(v) for v in self.log_exposure],
            "u_log_exposure": [float(v) for v in self.u_log_exposure],
        }

    @classmethod
    def from_mapping(cls, mapping: dict[str, Any], where: str) -> ResponseCurve:
        """Return the curve that a mapping describes.

        Raises:
            InputError: If a key is missing or the values are no curve.
        """
        if mapping.get("format") != FORMAT:
            raise InputError(f"{where}: format is {mapping.get('format')!r}; expected {FORMAT!r}")
        refuse_unknown(mapping, _KEYS, where, InputError)
        provenance = Provenance.from_mapping(mapping.get("provenance"), where)
        try:
            valid = mapping.get("valid_dn")
            return cls(
                _of_light(np.array(mapping["log_exposure"], dtype=np.float64)),
                np.array(mapping["u_log_exposure"], dtype=np.float64),
                absolute=bool(mapping.get("absolute", False)),
                valid_dn=(int(valid[0]), int(valid[1])) if valid else None,
                channel=str(mapping.get("channel", "mono")),
                provenance=provenance,
                camera=_camera(mapping, where),
            )
        except KeyError as error:
            raise InputError(f"{where}: key {error} is missing") from error
        except (TypeError, ValueError, InputError) as error:
            raise InputError(f"{where}: {error}") from error

    def write(self, path: Path) -> None:
        """Write the curve as CSV or YAML, by the ending of the name.

        Raises:
            OutputError: If the file cannot be written.
        """
        write_text_atomic(path, self.to_csv() if path.suffix.lower() == ".csv" else dump_yaml(self.to_mapping()))

    @classmethod
    @bounded_reader(error=InputError)
    def read(cls, path: Path) -> ResponseCurve:
        """Return the curve in a CSV or YAML file.

        Raises:
            InputError: If the file is missing or holds no curve.
        """
        if path.suffix.lower() != ".csv":
            return cls.from_mapping(read_yaml(path), str(path))
        return _from_csv(read_text(path), path)


def _camera(mapping: dict[str, Any], where: str) -> CameraDescription | None:
    """Return the camera that a file states; None in files of versions before there was such a key."""
    if (stated := mapping.get("camera")) is None:
        return None
    refuse_unknown(stated, _OF_CAMERA, f"{where}: camera", InputError)
    bit_depth = len(mapping["log_exposure"]).bit_length() - 1
    return validate(CameraDescription, {"bit_depth": bit_depth, **stated}, f"{where}: camera", InputError)


def _of_light(log_exposure: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values of a file. Raises InputError if one is beyond all light."""
    if np.any(np.abs(log_exposure[np.isfinite(log_exposure)]) > _LARGEST_LOG):
        raise InputError(f"a response curve holds a log exposure beyond ± {_LARGEST_LOG:g}; correct the number")
    return log_exposure


def _from_csv(text: str, path: Path) -> ResponseCurve:
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or [cell.strip() for cell in rows[0]] != _CSV_HEADER:
        raise InputError(f"{path}: the first line must read {','.join(_CSV_HEADER)}")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:] if row])
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if table.ndim != 2 or table.shape[1] != 3 or not np.array_equal(table[:, 0], np.arange(len(table))):
        raise InputError(f"{path}: needs one row per digital number, counted from 0 without gaps")
    curve_is_relative = abs(float(table[len(table) // 2, 1])) < 1e-9
    provenance = Provenance("file", (path.name,))
    try:
        log_exposure = _of_light(table[:, 1])
        return ResponseCurve(log_exposure, table[:, 2], absolute=not curve_is_relative, provenance=provenance)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
