"""Tables of statistics per setting (mean, variance, frames) without pictures: CSV and JSON lines."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from radiometer.data import CameraDescription, CaptureHeader, SettingStatistics, SourceDescription
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import CaptureError
from radiometer.importing.file_bytes import read_bytes
from radiometer.importing.record import ImportRecord

TABLE_SUFFIXES: Final = (".csv", ".tsv", ".jsonl", ".ndjson", ".json")
_ASSUMED_PIXELS: Final = 10_000
_UNIT_S: Final = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0}
_EXPOSURE: Final = re.compile(
    r"^(?:exposure|exposure_time|exptime|exp|t_exp|texp|integration_time|integration|t_int|shutter_time)"
    r"(?:_in_file_units)?(?:_(s|sec|ms|us|µs|ns|min))?$"
)
_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "mean": ("mean_dn", "mean", "mu", "mu_y", "mean_adu", "avg", "average", "mean_counts", "mean_signal", "signal_dn"),
    "variance": (
        "variance_dn2", "variance", "var", "temporal_var", "temporal_variance", "temporal_variance_dn2", "sigma2",
        "sigma2_y", "var_dn2", "noise_variance",
    ),
    "sigma": ("std", "std_dn", "sigma", "sigma_dn", "noise", "noise_dn", "rms", "rms_dn", "temporal_std", "stddev"),
    "frames": ("frames", "n_frames", "nframes", "frame_count", "count", "n", "repeats"),
    "pixels": ("pixels", "n_pixels", "npix", "npixels", "pixel_count"),
    "gain_db": ("gain_db",),
    "temperature": ("temperature_c", "temp_c", "temperature", "temp", "ccd_temp", "sensor_temperature"),
    "timestamp": ("timestamp_s", "timestamp", "time_s", "unix_time"),
    "kind": ("shutter", "type", "kind", "frame_type", "imagetyp"),
    "dark": ("dark", "is_dark"),
    "photons": ("photons", "photons_per_pixel", "mu_p"),
    "level": ("source_level", "level", "led_level", "light_level"),
    "spatial": ("spatial_variance_dn2", "spatial_variance", "spatial_var"),
    "clipped": ("clipped_share", "sat_frac", "saturated_share", "share_saturated", "share_at_full_scale"),
    "floor": ("floor_share", "share_at_0", "share_at_zero"),
    "bits": ("bit_depth", "bits"),
    "top": ("full_scale_dn", "full_scale"),
}  # fmt: skip
_SHARE_AT: Final = re.compile(r"^share_at_(\d+)$")
_DARK_WORDS: Final = ("closed", "dark", "d", "bias", "zero", "off")
_PAIR_COLUMNS: Final = (("taken_a", "taken_b"), ("mean_a", "mean_b"), ("file_a", "file_b"))

Row = Mapping[str, Any]


def is_statistics_table(path: Path) -> bool:
    """Tell whether a file is a table with a mean and a variance (or standard deviation) per row."""
    if _suffix(path) not in TABLE_SUFFIXES:
        return False
    try:
        heading = _heading(path)
    except CaptureError:
        return False
    return _has(heading, "mean") and (_has(heading, "variance") or _has(heading, "sigma"))


def _heading(path: Path) -> list[Row]:
    """Return the keys of a table's first row, with its values where it is JSON; what follows may be damaged."""
    text = read_bytes(path).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return []
    if _suffix(path) in (".csv", ".tsv"):
        return [dict.fromkeys(map(_key, lines[0].split(_delimiter(lines[0]))))]
    return _json_rows(text if text.lstrip().startswith("[") else lines[0], path)[:1]


def _delimiter(heading: str) -> str:
    return max(",;\t", key=heading.count)


@bounded_reader()
def read_statistics_table(path: Path) -> CaptureHeader:
    """Return a table's rows as the header of a capture set without pictures.

    Exposures are in s unless the column's name ends in ms, us, ns or min. Without a column of frames, two columns
    that end in _a and _b tell of pairs.

    Raises:
        CaptureError: If a row lacks exposure, mean or variance, or a value is no number; the message names the row.
    """
    rows = _rows(path)
    if not rows:
        raise CaptureError(f"{path}: the table has no rows")
    missing, doubts = list[str](), list[str]()
    exposure, unit_s = _exposure_column(rows, path, doubts)
    pixels = _pixels(rows, missing, doubts)
    entries = []
    for number, row in enumerate(rows, start=1):
        entries.append(_entry(row, exposure, unit_s, pixels, f"{path}, row {number}"))
    bits = _bit_depth(rows, entries, missing)
    if not _has(rows, "kind") and not _has(rows, "dark"):
        missing.append("no column says which rows are dark: all are taken with light (but exposures of 0)")
    record = ImportRecord(_taken(rows, exposure), tuple(missing), tuple(doubts))
    return CaptureHeader.model_validate(
        {
            "camera": CameraDescription(bit_depth=bits),
            "source": SourceDescription(),
            "statistics": entries,
            "imported": record.to_mapping(),
        }
    )


def _suffix(path: Path) -> str:
    name = path.name.lower().removesuffix(".gz")
    return Path(name).suffix


def _rows(path: Path) -> list[Row]:
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path} is not a text file (byte {error.start} is not UTF-8)") from error
    if _suffix(path) in (".csv", ".tsv"):
        return _csv_rows(text, path)
    return _json_rows(text, path)


def _csv_rows(text: str, path: Path) -> list[Row]:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return []
    try:
        table = csv.DictReader(io.StringIO("\n".join(lines)), delimiter=_delimiter(lines[0]))
        rows = list(table)
    except csv.Error as error:
        raise CaptureError(f"{path}: not a readable table: {error}") from error
    short = next((n for n, row in enumerate(rows, 1) if None in row or None in row.values()), None)
    if short is not None:
        raise CaptureError(f"{path}, row {short}: has not as many cells as the heading (a truncated file?)")
    return [{_key(k): v for k, v in row.items()} for row in rows]


def _json_rows(text: str, path: Path) -> list[Row]:
    if text.lstrip().startswith("["):
        return [_flat(entry, path, n) for n, entry in enumerate(_json(text, path, 1), 1)]
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    return [_flat(_json(line, path, n), path, n) for n, line in lines]


def _json(text: str, path: Path, line: int) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise CaptureError(f"{path}, line {line}: not valid JSON ({error.msg}); a truncated file?") from error


def _flat(entry: Any, path: Path, number: int) -> Row:
    """Return an object's values by key, those of nested objects by their own keys."""
    if not isinstance(entry, dict):
        raise CaptureError(f"{path}, line {number}: expected an object with keys and values")
    flat: dict[str, Any] = {}
    for key, value in entry.items():
        if isinstance(value, dict):
            flat |= {_key(k): v for k, v in value.items() if not isinstance(v, (dict, list))}
        elif not isinstance(value, list):
            flat[_key(key)] = value
    return flat


def _key(heading: str) -> str:
    words = re.sub(r"[\s\-/()\[\]]+", "_", heading.strip().lower().replace("²", "2")).strip("_")
    return words.replace("dn_2", "dn2").replace("dn^2", "dn2")


def _column(rows: Sequence[Row], fact: str) -> str | None:
    return next((name for name in _NAMES[fact] if any(name in row for row in rows)), None)


def _has(rows: Sequence[Row], fact: str) -> bool:
    return _column(rows, fact) is not None


def _exposure_column(rows: Sequence[Row], path: Path, doubts: list[str]) -> tuple[str, float]:
    for name in rows[0]:
        found = _EXPOSURE.match(name)
        if found:
            if found[1] is None:
                doubts.append(f"the column {name!r} has no unit: seconds are assumed")
            return name, _UNIT_S[found[1] or "s"]
    raise CaptureError(f"{path}: no column of exposures (such as exposure_s or exposure_ms)")


def _entry(row: Row, exposure: str, unit_s: float, pixels: int, where: str) -> SettingStatistics:
    def value(fact: str) -> float | None:
        name = next((n for n in _NAMES[fact] if n in row), None)
        return None if name is None or row[name] in ("", None) else _number(row[name], where, name)

    exposure_s = _number(row.get(exposure), where, exposure) * unit_s
    mean, variance, sigma = value("mean"), value("variance"), value("sigma")
    if mean is None:
        raise CaptureError(f"{where}: has no mean")
    if variance is None and sigma is not None:
        variance = sigma**2
    if exposure_s < 0 or (variance is not None and variance < 0):
        raise CaptureError(f"{where}: exposure and variance must be 0 or above")
    frames = int(value("frames") or 2)
    return SettingStatistics.model_validate(
        {
            "exposure_s": exposure_s,
            "mean_dn": mean,
            "variance_dn2": variance if frames > 1 else None,
            "frames": frames,
            "pixels": int(value("pixels") or pixels),
            "gain_db": value("gain_db") or 0.0,
            "temperature_C": value("temperature"),
            "timestamp_s": value("timestamp"),
            "source_level": 1.0 if (level := value("level")) is None else level,
            "shutter": "closed" if _is_dark(row, exposure_s, value("photons")) else "open",
            "photons": value("photons"),
            "spatial_variance_dn2": value("spatial"),
            "clipped_share": _clipped(row, value, where),
            "floor_share": value("floor") or 0.0,
        }
    )


def _clipped(row: Row, value: Callable[[str], float | None], where: str) -> float:
    share = value("clipped")
    if share is not None:
        return share
    name = _top_share(row)
    return _number(row[name], where, name) if name else 0.0


def _top_share(row: Row) -> str | None:
    """Return the column that counts pixels at the highest code, such as share_at_255."""
    found = [name for name in row if (m := _SHARE_AT.match(name)) and int(m[1]) > 0]
    return max(found, key=lambda name: int(name.rpartition("_")[2]), default=None)


def _is_dark(row: Row, exposure_s: float, photons: float | None) -> bool:
    for name in _NAMES["dark"]:
        if name in row:
            return str(row[name]).strip().lower() in ("1", "true", "yes", "dark")
    for name in _NAMES["kind"]:
        if name in row:
            return str(row[name]).strip().lower() in _DARK_WORDS
    return exposure_s == 0 or photons == 0


def _number(value: Any, where: str, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise CaptureError(f"{where}: {name} = {value!r} is no number") from error
    if not math.isfinite(number):
        raise CaptureError(f"{where}: {name} = {value!r} is not finite")
    return number


def _pixels(rows: Sequence[Row], missing: list[str], doubts: list[str]) -> int:
    """Return the number of pixels: stated, or from the shares (multiples of one over pixels × frames), or assumed."""
    if _has(rows, "pixels"):
        return 1
    names = [name for name in rows[0] if _SHARE_AT.match(name)]
    shares = [float(row[name]) for row in rows for name in names if _is_positive(row.get(name))]
    least = min(shares, default=0.0)
    if least and all(math.isclose(s / least, round(s / least), abs_tol=1e-3) for s in shares):
        count = round(1.0 / least / 2)
        doubts.append(f"pixels are not stated: the shares are multiples of one in {2 * count}, so pairs of {count}")
        return count
    missing.append(f"pixels per mean are not stated: {_ASSUMED_PIXELS} are assumed (they set the uncertainties)")
    return _ASSUMED_PIXELS


def _is_positive(value: Any) -> bool:
    try:
        return float(value) > 0
    except (TypeError, ValueError):
        return False


def _bit_depth(rows: Sequence[Row], entries: Sequence[SettingStatistics], missing: list[str]) -> int:
    for fact in ("bits", "top"):
        name = _column(rows, fact)
        if name is not None and _is_positive(rows[0].get(name)):
            top = float(rows[0][name])
            return min(16, max(1, round(top) if fact == "bits" else math.ceil(math.log2(top + 1))))
    counted = _top_share(rows[0])
    if counted:
        return min(16, max(1, int(counted.rpartition("_")[2]).bit_length()))
    highest = max(e.mean_dn for e in entries)
    bits = next((b for b in (8, 10, 12, 14) if highest < (1 << b) - 1), 16)
    missing.append(f"the full scale is not stated: {bits} bits are assumed")
    return bits


def _taken(rows: Sequence[Row], exposure: str) -> tuple[str, ...]:
    found = {fact: _column(rows, fact) for fact in _NAMES}
    lines = [f"exposure_s from column {exposure}", *(f"{f} from column {name}" for f, name in found.items() if name)]
    if not found["frames"]:
        pairs = any(all(name in rows[0] for name in pair) for pair in _PAIR_COLUMNS)
        lines.append("frames: 2 of each setting" + (" (columns _a and _b)" if pairs else " assumed"))
    return tuple(lines)
