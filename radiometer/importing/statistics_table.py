"""Tables of statistics per setting (mean, variance, frames) without pictures: CSV and JSON lines."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from radiometer.data import CameraDescription, CaptureHeader, SettingStatistics, SourceDescription
from radiometer.data.json_text import RepeatedKey, parsed_json
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import Statement, StatementMap, is_unknown, value_of
from radiometer.data.text_table import decode_export, read_table
from radiometer.data.validation import validate
from radiometer.errors import CaptureError, InputError, UnsettledError
from radiometer.importing.file_names import read_bytes
from radiometer.importing.found import ImportRecord
from radiometer.moments import UNIX_S
from radiometer.units import heading_parts

TABLE_SUFFIXES: Final = (".csv", ".tsv", ".jsonl", ".ndjson", ".json")
_ASSUMED_PIXELS: Final = 10_000  # a region of 100 × 100
# Names of columns without their unit (`heading_parts`), the best first.
_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "exposure": (
        "exposure", "exposure_time", "exptime", "exp", "t_exp", "texp", "integration_time", "integration", "t_int",
        "shutter_time", "exposure_in_file_units",
    ),
    "mean": ("mean_dn", "mean", "mu", "mu_y", "mean_adu", "avg", "average", "mean_counts", "mean_signal", "signal_dn"),
    "variance": (
        "variance_dn2", "variance", "var", "temporal_var", "temporal_variance", "temporal_variance_dn2", "sigma2",
        "sigma2_y", "var_dn2", "noise_variance",
    ),
    "sigma": ("std", "std_dn", "sigma", "sigma_dn", "noise", "noise_dn", "rms", "rms_dn", "temporal_std", "stddev"),
    "frames": ("frames", "n_frames", "nframes", "frame_count", "count", "n", "repeats"),
    "pixels": ("pixels", "n_pixels", "npix", "npixels", "pixel_count"),
    "gain": ("gain",),
    "temperature": ("temperature", "temp", "ccd_temp", "sensor_temperature"),
    "timestamp": ("timestamp_s", "timestamp", "time_s", "unix_time"),
    "kind": ("shutter", "type", "kind", "frame_type", "imagetyp"),
    "dark": ("dark", "is_dark"),
    "photons": ("photons", "photons_per_pixel", "mu_p"),
    "source_level": ("source_level", "level", "led_level", "light_level"),
    "spatial": ("spatial_variance_dn2", "spatial_variance", "spatial_var"),
    "clipped": ("clipped_share", "sat_frac", "saturated_share", "share_saturated", "share_at_full_scale"),
    "floor": ("floor_share", "share_at_0", "share_at_zero"),
    "bits": ("bit_depth", "bits"),
    "top": ("full_scale_dn", "full_scale"),
}  # fmt: skip
_WITH_UNIT: Final = ("exposure", "gain", "temperature")
_SHARE_AT: Final = re.compile(r"^share_at_(\d+)$")
_DARK_WORDS: Final = ("closed", "dark", "d", "bias", "zero", "off")
_PAIR_COLUMNS: Final = (("taken_a", "taken_b"), ("mean_a", "mean_b"), ("file_a", "file_b"))

Row = Mapping[str, Any]


def is_statistics_table(path: Path, mapped: StatementMap | None = None) -> bool:
    """Return whether a file is a table with a mean and a variance (or standard deviation) per row."""
    if _suffix(path) not in TABLE_SUFFIXES:
        return False
    try:
        keys = _heading(path)
    except InputError:
        return False
    places = mapped.places if mapped else {}
    has = {fact: fact in places or not keys.isdisjoint(_NAMES[fact]) for fact in ("mean", "variance", "sigma")}
    return has["mean"] and (has["variance"] or has["sigma"])


def _heading(path: Path) -> frozenset[str]:
    """Return the keys of a table's first row; what follows may be damaged."""
    text = read_bytes(path).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if _suffix(path) in (".csv", ".tsv"):
        # Of a first line alone any separator may be meant: under one of them it names a mean and a variance.
        return frozenset(_key(cell) for line in lines[:1] for mark in ",;\t" for cell in line.split(mark))
    rows = _json_rows(text if text.lstrip().startswith("[") else lines[0], path) if lines else []
    return frozenset(rows[0] if rows else ())


@bounded_reader()
def read_statistics_table(path: Path, mapped: StatementMap | None = None) -> CaptureHeader:
    """Return a table's rows as the header of a capture set without pictures.

    Units are in the names of the columns, such as exposure_ms. Without a column of frames, two columns that end in
    _a and _b mean pairs.

    Args:
        path: CSV, TSV, JSON or JSON lines.
        mapped: Where the user states that facts stand.

    Raises:
        CaptureError: If a row lacks exposure, mean or variance, or a value is no number; the message names the row.
        UnsettledError: If a column has no unit that is known.
    """
    map_of = mapped or StatementMap()
    missing, doubts = list[str](), list[str]()
    rows, spelled, how = _rows(path)
    if not rows:
        raise CaptureError(f"{path}: the table has no rows")
    columns = _columns(rows, path, map_of)
    pixels = 1 if "pixels" in columns else _pixels(rows, missing, doubts)
    entries = [
        _entry(row, columns, spelled, pixels, f"{path}, row {number}", map_of, doubts)
        for number, row in enumerate(rows, start=1)
    ]
    if max(entry.mean_dn for entry in entries) <= 1.0 and "mean" not in map_of.places:
        raise UnsettledError(
            f"{path}: all means are at most 1 and may be DN or shares of full scale: multiply shares by full scale, or "
            "state by --map mean=COLUMN that they are DN"
        )
    bits = _bit_depth(rows[0], columns, entries, missing)
    if "kind" not in columns and "dark" not in columns:
        missing.append("no column states which rows are dark: all are taken with light (but exposures of 0)")
    used = {*columns.values(), *(name for name in rows[0] if _SHARE_AT.match(name) or _is_of_pair(name))}
    left = [name for name in rows[0] if name not in used]
    record = ImportRecord(
        (*how, *_taken(rows, columns)),
        tuple(missing),
        tuple(dict.fromkeys(doubts)),
        not_used=(f"{path.name}: columns {', '.join(left)}",) if left else (),
        mapped=map_of.words(),
    )
    return validate(
        CaptureHeader,
        {
            "camera": CameraDescription(bit_depth=bits),
            "source": SourceDescription(),
            "statistics": entries,
            "imported": record.to_mapping(),
        },
        str(path),
        CaptureError,
    )


def _columns(rows: Sequence[Row], path: Path, mapped: StatementMap) -> dict[str, str]:
    """Return the column of each fact: the user's, else the one of a known name, the same in all rows."""
    found = {}
    for fact in _NAMES:
        stated = mapped.places.get(fact, ())
        place = next((p for p in stated if p.constant is not None or _key(p.name) in rows[0]), None)
        if place is not None:
            found[fact] = place.name if place.constant is not None else _key(place.name)
        elif fact in mapped.demanded:
            raise UnsettledError(f"{path}: has no column that --map {fact} names; it has {', '.join(rows[0])}")
        elif (name := _column(rows[0], fact)) is not None:
            found[fact] = name
    if "exposure" not in found:
        raise CaptureError(
            f"{path}: no column of exposures (such as exposure_s or exposure_ms); name it: --map exposure=COLUMN:UNIT"
        )
    return found


def _suffix(path: Path) -> str:
    name = path.name.lower().removesuffix(".gz")
    return Path(name).suffix


def _rows(path: Path) -> tuple[list[Row], dict[str, str], tuple[str, ...]]:
    """Return the rows by key, the keys as they are spelled (units depend on case), and how the table was read."""
    text = decode_export(read_bytes(path))
    if _suffix(path) not in (".csv", ".tsv"):
        rows = _json_rows(text, path)
        spelled = re.findall(r'"((?:[^"\\]|\\.)*)"\s*:', text)
        return rows, {_key(name): name for name in reversed(spelled)}, ()
    try:
        table = read_table(path, "columns of exposure, mean and variance", text, named=True)
        table.refuse_mixed()
    except InputError as error:
        raise CaptureError(str(error)) from error
    keys = [_key(name) for name in table.header]
    if len(set(keys)) < len(keys):
        twice = next(name for name in keys if keys.count(name) > 1)
        raise CaptureError(f"{path}: two columns are called {twice!r}; rename one")
    rows = [dict(zip(keys, cells, strict=True)) for _, cells in table.rows]
    return rows, dict(zip(keys, table.header, strict=True)), (table.how,)


def _json_rows(text: str, path: Path) -> list[Row]:
    if text.lstrip().startswith("["):
        return [_flat(entry, path, n) for n, entry in enumerate(_json(text, path, 1), 1)]
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    return [_flat(_json(line, path, n), path, n) for n, line in lines]


def _json(text: str, path: Path, line: int) -> Any:
    try:
        return parsed_json(text)
    except RepeatedKey as error:
        raise CaptureError(f"{path}, line {line}: {error}") from error
    except ValueError as error:
        raise CaptureError(f"{path}, line {line}: not valid JSON ({error}); a truncated file?") from error


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


def _column(row: Row, fact: str) -> str | None:
    """Return the first column of a fact, its unit apart."""

    def is_of(name: str, known: str) -> bool:
        return name == known or (fact in _WITH_UNIT and heading_parts(name, fact)[0] == known)

    return next((name for known in _NAMES[fact] for name in row if is_of(name, known)), None)


def _entry(
    row: Row,
    columns: Mapping[str, str],
    spelled: Mapping[str, str],
    pixels: int,
    where: str,
    mapped: StatementMap,
    doubts: list[str],
) -> SettingStatistics:
    def value(fact: str) -> float | None:
        name = columns.get(fact)
        return None if name is None or name not in row or is_unknown(row[name]) else _number(row[name], where, name)

    def stated(fact: str, defined: str = "") -> float | None:
        return _stated(fact, row, columns, spelled, mapped, doubts, where, defined)

    exposure_s = stated("exposure")
    mean, variance, sigma = value("mean"), value("variance"), value("sigma")
    if exposure_s is None:
        raise CaptureError(f"{where}: has no exposure ({row.get(columns['exposure'])!r})")
    if mean is None:
        raise CaptureError(f"{where}: has no mean")
    if variance is None and sigma is not None:
        variance = sigma**2
    if variance is not None and variance < 0:
        raise CaptureError(f"{where}: exposure and variance must be 0 or above")
    frames = int(value("frames") or 2)
    return validate(
        SettingStatistics,
        {
            "exposure_s": exposure_s,
            "mean_dn": mean,
            "variance_dn2": variance if frames > 1 else None,
            "frames": frames,
            "pixels": int(value("pixels") or pixels),
            "gain_db": stated("gain") or 0.0,
            "temperature_C": stated("temperature"),
            "timestamp_s": stated("timestamp", _unit_of_stamp(value("timestamp"))),
            "source_level": 1.0 if (level := value("source_level")) is None else level,
            "shutter": "closed" if _is_dark(row, exposure_s, value("photons")) else "open",
            "photons": value("photons"),
            "spatial_variance_dn2": value("spatial"),
            "clipped_share": _clipped(row, value, where),
            "floor_share": value("floor") or 0.0,
        },
        where,
        CaptureError,
    )


def _stated(
    fact: str,
    row: Row,
    columns: Mapping[str, str],
    spelled: Mapping[str, str],
    mapped: StatementMap,
    doubts: list[str],
    where: str,
    defined: str,
) -> float | None:
    """Return a fact in its base unit, by the unit that the user, the cell or the name of the column states."""
    name = columns.get(fact)
    if name is None:
        return None
    place = next((p for p in mapped.places.get(fact, ()) if name in (p.name, _key(p.name))), None)
    if place is not None and place.constant is not None:
        statement = Statement(place.constant, place.unit)
    else:
        _, _, spelling = heading_parts(spelled.get(name, name), fact)
        statement = Statement(row.get(name), place.unit if place and place.unit else spelling)
    try:
        return value_of(statement, fact, name, doubts, defined=defined, where=where)
    except OverflowError as error:
        raise CaptureError(f"{where}: {name} = {row.get(name)!r} is too large") from error


def _unit_of_stamp(written: float | None) -> str:
    """Return s where a number can be nothing but s since 1970; "" for another, whose unit must be stated."""
    return "s" if written is not None and UNIX_S[0] < written < UNIX_S[1] else ""


def _is_of_pair(name: str) -> bool:
    return any(name in pair for pair in _PAIR_COLUMNS)


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
    for fact, words in (("dark", ("1", "true", "yes", "dark")), ("kind", _DARK_WORDS)):
        for name in _NAMES[fact]:
            if name in row:  # an object of JSON may state it in its own line alone
                return str(row[name]).strip().lower() in words
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
    """Return the number of pixels: from the shares (multiples of one over pixels × frames), or assumed."""
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


def _bit_depth(row: Row, columns: Mapping[str, str], entries: Sequence[SettingStatistics], missing: list[str]) -> int:
    for fact in ("bits", "top"):
        name = columns.get(fact)
        if name is not None and _is_positive(row.get(name)):
            top = float(row[name])
            return min(16, max(1, round(top) if fact == "bits" else math.ceil(math.log2(top + 1))))
    counted = _top_share(row)
    if counted:
        return min(16, max(1, int(counted.rpartition("_")[2]).bit_length()))
    highest = max(e.mean_dn for e in entries)
    bits = next((b for b in (8, 10, 12, 14) if highest < (1 << b) - 1), 16)
    missing.append(f"the full scale is not stated: {bits} bits are assumed")
    return bits


def _taken(rows: Sequence[Row], columns: Mapping[str, str]) -> tuple[str, ...]:
    lines = [f"{'exposure_s' if fact == 'exposure' else fact} from column {name}" for fact, name in columns.items()]
    if "frames" not in columns:
        pairs = any(all(name in rows[0] for name in pair) for pair in _PAIR_COLUMNS)
        lines.append("frames: 2 of each setting" + (" (columns _a and _b)" if pairs else " assumed"))
    return tuple(lines)
