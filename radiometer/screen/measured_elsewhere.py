"""Reads what other programs have measured of a screen: ArgyllCMS, pacsdisplay, plain tables of level and luminance.

Their luminance is turned into radiance by the screen's white; what no file says, the meter's scale above all, is stated
as assumed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.data import Provenance
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.statements import StatementMap
from radiometer.data.text_table import TextTable, finite, read_export, read_table
from radiometer.errors import InputError, UnsettledError
from radiometer.plausible import PLAUSIBLE
from radiometer.screen.calibration import AXES, LUMINANCE, ChannelCurve, ScreenCalibration
from radiometer.screen.run import Light
from radiometer.typing import Array
from radiometer.units import heading_parts

# Colorimeters of the i1Display and SpyderX kind are specified to some 4 % on displays they were not matched to.
METER_U_REL: Final = 0.04
REPEAT_U_REL: Final = 0.001  # of a reading; the SpyderX's white repeats within 0.1 to 0.3 %
SHARED_SHAPE_U_REL: Final = 0.05  # of a primary whose curve is taken from grey's
CAL_SHAPE_U_REL: Final = 0.03  # of a response inferred from a calibration curve and its target
FULL: Final = 255  # 8 bits


@dataclass(frozen=True, slots=True)
class ScreenReadings:
    """Readings of one screen."""

    name: str  # what the file calls it, or the file's name
    grey: Mapping[int, Sequence[float]]  # luminance in cd·m⁻² by 8-bit level; a level may have several readings
    # The same of "red", "green" and "blue", where they were measured
    primaries: Mapping[str, Mapping[int, Sequence[float]]] = field(default_factory=dict)
    resolution_cd_m2: float = 0.0  # last digit of the file's luminances
    taken: tuple[str, ...] = ()  # what was made of the file, in words
    shape_u_rel: float = 0.0  # relative standard uncertainty of each level beyond repeatability
    doubts: tuple[str, ...] = ()  # what the file leaves open and how it was read, in words
    # CIE 1931 (x, y) of the brightest level of each channel, where the file holds X and Z
    chromaticities: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for levels in (self.grey, *self.primaries.values()):
            for level, readings in levels.items():
                for luminance in readings:
                    PLAUSIBLE["screen"].check(f"{self.name}, level {level}", luminance)


@bounded_reader(error=InputError)
def read_screen_readings(
    path: Path, white_cd_m2: float | None = None, gamma: float = 2.2, mapped: StatementMap | None = None
) -> ScreenReadings:
    """Return the readings in a file.

    Args:
        path: ArgyllCMS .ti3 or .cal, pacsdisplay uLR, or a table of level and luminance.
        white_cd_m2: Luminance of white, which a .cal does not hold.
        gamma: Exponent that a .cal was made for.
        mapped: Where the user states that a table has level and luminance.

    Raises:
        InputError: If the file cannot be read or holds none of these.
        UnsettledError: If a table's columns or units are not known.
    """
    text = read_export(path)
    first = text.lstrip()[:4].upper()
    if first.startswith("CTI3"):
        return _ti3(path, text)
    if first.startswith("CAL"):
        return _cal(path, text, white_cd_m2, gamma)
    if re.search(r"#[0-9a-fA-F]{6}\b", text):
        return _ulr(path, text)
    return _table(path, text, mapped or StatementMap())


def imported(
    readings: ScreenReadings, lights: Mapping[str, Light], meter_u_rel: float, source: str
) -> ScreenCalibration:
    """Return a calibration by readings made elsewhere.

    Args:
        meter_u_rel: Relative standard uncertainty of the meter's scale, shared by all levels.

    Raises:
        InputError: If there are fewer than three levels of grey, or their light does not rise.
    """
    channels = {"grey": _curve("grey", readings.grey, lights["grey"], readings, meter_u_rel)}
    shared = []
    for name, levels in readings.primaries.items():
        if name not in lights:
            continue
        if len(levels) >= 3:
            channels[name] = _curve(name, levels, lights[name], readings, meter_u_rel)
        else:
            channels[name] = _like_grey(name, levels, channels["grey"], lights, meter_u_rel)
            shared.append(name)
    assumptions = [f"{name}: {lights[name].in_words()}" for name in channels]
    assumptions += [f"meter's scale: {100 * meter_u_rel:g} % (k = 1)"]
    assumptions += [f"{', '.join(shared)}: curve as grey's, to {100 * SHARED_SHAPE_U_REL:g} %"] if shared else []
    return ScreenCalibration(
        readings.name, channels, provenance=Provenance(f"imported from {source}", assumptions=tuple(assumptions)),
        chromaticities={name: xy for name, xy in readings.chromaticities.items() if name in channels},
    )  # fmt: skip


def _curve(
    name: str, levels: Mapping[int, Sequence[float]], light: Light, readings: ScreenReadings, meter_u_rel: float
) -> ChannelCurve:
    if len(levels) < 3:
        raise InputError(f"{readings.name}: {len(levels)} levels of {name} are too few; three at least are needed")
    if not np.mean(levels[max(levels)]) > np.mean(levels[min(levels)]):
        raise InputError(
            f"{readings.name}: {name} is no brighter at level {max(levels)} than at {min(levels)}; state what is level "
            "and what is luminance by --map"
        )
    ordered = sorted(levels)
    means = np.array([float(np.mean(levels[n])) for n in ordered])
    counts = np.array([len(levels[n]) for n in ordered])
    u = np.hypot(REPEAT_U_REL * means / np.sqrt(counts), readings.resolution_cd_m2 / math.sqrt(12.0))
    u = np.maximum(u, _scatter(np.array(ordered, dtype=np.float64), means))
    spread = [
        float(np.std(levels[n], ddof=1)) / math.sqrt(len(levels[n])) if len(levels[n]) > 1 else 0.0 for n in ordered
    ]
    u = np.hypot(np.maximum(u, spread), readings.shape_u_rel * means)
    return light.curve(name, ordered, (means, u), meter_u_rel, LUMINANCE)


def _like_grey(
    name: str,
    levels: Mapping[int, Sequence[float]],
    grey: ChannelCurve,
    lights: Mapping[str, Light],
    meter_u_rel: float,
) -> ChannelCurve:
    """Return a primary of which only the top was read: black and shape of grey, scaled to it in luminance."""
    light, top = lights[name], float(np.mean(levels[max(levels)]))
    luminance = np.array(grey.radiance) * grey.photopic_lm_per_w
    black, white = luminance[0], luminance[-1]
    scale = (top - black) / (white - black)
    own = black + (luminance - black) * scale
    u = np.hypot(np.array(grey.u_independent) * grey.photopic_lm_per_w * scale, SHARED_SHAPE_U_REL * (own - black))
    return light.curve(name, grey.levels, (own, np.maximum(u, REPEAT_U_REL * own)), meter_u_rel, LUMINANCE)


def _scatter(levels: Array, values: Array) -> Array:
    """Return what a level's reading differs from the line through its neighbours, as a local standard deviation.

    Steps of the panel and drift between readings show there; a smooth curve does as well, which is on the safe side.
    """
    if values.size < 5:
        return np.zeros_like(values)
    middle = np.interp(levels[1:-1], levels[::2], values[::2])
    odd = np.interp(levels[1:-1], levels[1::2], values[1::2])
    away = np.abs(middle - odd) / math.sqrt(1.5)
    padded = np.concatenate([away[:1], away, away[-1:]])
    smooth = np.array([np.sqrt(np.mean(padded[max(0, n - 3) : n + 4] ** 2)) for n in range(padded.size)])
    curved = np.abs(np.gradient(np.gradient(values, levels), levels)) * np.gradient(levels) ** 2
    return np.asarray(np.maximum(smooth - curved, 0.0))


def _ti3(path: Path, text: str) -> ScreenReadings:
    """Return greys and primaries of an ArgyllCMS .ti3; its XYZ are relative to white where it says so."""
    text = re.split(r"(?<=\bEND_DATA)\b", text, maxsplit=1)[0]  # further tables have other keywords
    keys = dict(re.findall(r'^([A-Z_0-9]+)\s+"([^"]*)"', text, re.MULTILINE))
    names, data = _block(text, "DATA_FORMAT"), _block(text, "DATA")
    if names is None or data is None:
        raise InputError(f"{path}: no table in this .ti3")
    columns = names.split()
    expected = ("RGB_R", "RGB_G", "RGB_B", "XYZ_Y")
    if any(name not in columns for name in expected):
        raise InputError(f"{path}: needs the columns {', '.join(expected)}; it has {', '.join(columns)}")
    at = [columns.index(name) for name in expected]
    rows = [line.split() for line in data.splitlines() if line.strip()]
    announced = re.search(r"^NUMBER_OF_SETS\s+(\d+)", text, re.MULTILINE)
    if announced is not None and int(announced.group(1)) != len(rows):
        raise InputError(
            f"{path}: states {announced.group(1)} sets and holds {len(rows)}; it was cut or edited: copy it again, or"
            " correct NUMBER_OF_SETS"
        )
    patches = [tuple(float(row[n]) for n in at) for row in rows]
    for number, patch in enumerate(patches, 1):
        if not all(map(math.isfinite, patch)) or patch[3] < -_LEAST_Y_REL * max(one[3] for one in patches):
            raise InputError(
                f"{path}, set {number}: XYZ_Y {patch[3]:g} is no luminance; measure it again, or delete it"
            )
    if max(max(patch[:3]) for patch in patches) > _MOST_PERCENT:
        raise InputError(f"{path}: RGB go above 100; a .ti3 has them in per cent: divide them by 2.55")
    scale, note = _ti3_scale(path, keys, max(patch[3] for patch in patches))
    grey, primaries = _by_channel([([FULL * v / 100.0 for v in patch[:3]], patch[3] * scale) for patch in patches])
    return ScreenReadings(
        path.stem,
        grey,
        primaries,
        taken=(f"ArgyllCMS .ti3, {len(patches)} patches, {note}", f"meter {keys.get('TARGET_INSTRUMENT', 'unknown')}"),
        chromaticities=_brightest_xy(columns, rows),
    )


def _brightest_xy(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, tuple[float, float]]:
    """Return the chromaticity (x, y) of each axis's brightest patches by channel; empty without X and Z."""
    if not {"XYZ_X", "XYZ_Z"} <= set(columns):
        return {}
    at = [columns.index(name) for name in ("RGB_R", "RGB_G", "RGB_B", "XYZ_X", "XYZ_Y", "XYZ_Z")]
    table = np.array([[float(row[n]) for n in at] for row in rows])
    found = {}
    for name, axis in AXES.items():
        rgb, top = table[:, :3], table[:, :3].max(axis=1)
        own = table[np.all(np.abs(rgb - top[:, None] * axis) < 1e-3, axis=1) & (top > 0.0)]
        if own.size:
            x, y, z = own[own[:, :3].max(axis=1) == own[:, :3].max()][:, 3:].mean(axis=0)
            if x + y + z > 0.0:
                found[name] = (float(x / (x + y + z)), float(y / (x + y + z)))
    return found


def chromaticities_in(path: Path) -> Mapping[str, tuple[float, float]]:
    """Return the chromaticities (x, y) by channel in a .ti3 or in a screen calibration.

    Raises:
        InputError: If the file holds none.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        found = ScreenCalibration.read(path).chromaticities
    else:
        found = read_screen_readings(path).chromaticities
    if not found:
        raise InputError(
            f"{path}: holds no chromaticities; name an ArgyllCMS .ti3 with XYZ, or a calibration imported from one"
        )
    return found


_MOST_PERCENT: Final = 100.5
_SAME_DRIVE: Final = 2.5e-3  # of 255: files round percentages to five digits
_LEAST_Y_REL: Final = 1e-3  # of white, by which noise may bring the black of a meter below 0
_SAME_WHITE_REL: Final = 0.02  # rows repeat white; LUMINANCE_XYZ_CDM2 is one reading of it


def _ti3_scale(path: Path, keys: Mapping[str, str], brightest: float) -> tuple[float, str]:
    """Return the factor of a .ti3's Y into cd·m⁻², and how it was found.

    Files of older programs lack NORMALIZED_TO_Y_100. Their Y are then relative to white where white is 100, and
    absolute where it is what LUMINANCE_XYZ_CDM2 states.

    Raises:
        InputError: If nothing states which of both it is.
    """
    words = keys.get("LUMINANCE_XYZ_CDM2", "").split()
    white = float(words[1]) if len(words) > 1 else None
    relative = keys.get("NORMALIZED_TO_Y_100", "").upper()
    if relative not in ("YES", "NO") and white is not None:
        nearer = {"YES": 100.0, "NO": white}
        fits = [word for word, top in nearer.items() if math.isclose(brightest, top, rel_tol=_SAME_WHITE_REL)]
        relative = fits[0] if len(fits) == 1 else "NO" if len(fits) == 2 else ""
    if relative == "NO":
        return 1.0, "absolute XYZ"
    if relative == "YES" and white is not None:
        return white / 100.0, f"XYZ relative to a white of {white:.4g} cd·m⁻²"
    if relative == "YES":
        raise InputError(f"{path}: XYZ relative to white, and no LUMINANCE_XYZ_CDM2 that says how bright that is")
    raise InputError(
        f'{path}: nothing states whether its XYZ are absolute; add the line NORMALIZED_TO_Y_100 "NO" where they are '
        'in cd·m⁻², else "YES" and LUMINANCE_XYZ_CDM2'
    )


def _block(text: str, name: str) -> str | None:
    """Return what stands between BEGIN_ and END_ of a name (CGATS.17); None where there is no such block."""
    begin = re.search(rf"\bBEGIN_{name}\s", text)
    end = re.compile(rf"\sEND_{name}\b").search(text, begin.end()) if begin else None
    return text[begin.end() : end.start()] if begin and end else None


def _by_channel(
    rows: Iterable[tuple[Sequence[float], float]],
) -> tuple[dict[int, list[float]], dict[str, dict[int, list[float]]]]:
    """Return luminances by level of grey, and of the primaries with more than one level.

    Args:
        rows: Drive of red, green and blue, 0 to 255, and luminance in cd·m⁻².
    """
    found: dict[str, dict[int, list[float]]] = {name: {} for name in AXES}
    for drive, luminance in rows:
        top = max(drive)
        for name, axis in AXES.items():
            if all(abs(v - top * on) < _SAME_DRIVE for v, on in zip(drive, axis, strict=True)):
                found[name].setdefault(round(top), []).append(luminance)
    return found.pop("grey"), {name: levels for name, levels in found.items() if len(levels) > 1}


def _ulr(path: Path, text: str) -> ScreenReadings:
    """Return greys and the primaries' tops of a pacsdisplay uLR file; steps between greys are left out."""
    reading = re.compile(r"(?<![0-9.])([0-9]++(?:\.[0-9]++)?|\.[0-9]++)\s++#([0-9a-fA-F]{6})\b")
    grey: dict[int, list[float]] = {}
    primaries: dict[str, dict[int, list[float]]] = {}
    digits = 0
    for line in text.splitlines():
        match = reading.search(line)
        if match is None:
            continue
        digits = max(digits, len(match.group(1).partition(".")[2]))
        rgb = tuple(int(match.group(2)[n : n + 2], 16) for n in (0, 2, 4))
        if rgb[0] == rgb[1] == rgb[2]:
            grey.setdefault(rgb[0], []).append(float(match.group(1)))
        for name, axis in list(AXES.items())[1:]:
            if rgb == tuple(FULL * on for on in axis):
                primaries.setdefault(name, {})[FULL] = [float(match.group(1))]
    if len(grey) < 3:
        raise InputError(f"{path}: {len(grey)} greys in this uLR file; three at least are needed")
    meter = re.search(r"Meter=(\S+)", text)
    named = re.search(r"Display ID:\s*(\S+)", text)
    return ScreenReadings(
        named.group(1) if named else path.stem,
        dict(sorted(grey.items())),
        {name: {0: [grey[min(grey)][0]], **levels} for name, levels in primaries.items()},
        resolution_cd_m2=10.0**-digits,
        taken=(f"pacsdisplay uLR, {len(grey)} greys", f"meter {meter.group(1) if meter else 'not named'}"),
    )


def _cal(path: Path, text: str, white_cd_m2: float | None, gamma: float) -> ScreenReadings:
    """Return the response that a calibration curve implies: drive CAL(i) gives white·i^γ."""
    if white_cd_m2 is None:
        raise InputError(
            f"{path}: a .cal holds curves and no luminance; give that of white by --white-luminance, or import the .ti3"
        )
    data = _block(text, "DATA") or ""
    rows = [[float(v) for v in line.split()] for line in data.splitlines() if line.strip()]
    if len(rows) < 3 or any(len(row) < 4 for row in rows):
        raise InputError(f"{path}: no table of RGB_I, RGB_R, RGB_G, RGB_B in this .cal")
    table = np.array(rows)
    drive, level = table[:, 1:4].mean(axis=1), table[:, 0]
    rising = np.concatenate([[True], np.diff(drive) > 0])
    levels = np.arange(0, FULL + 1, 5)
    inside = levels[(levels >= drive[0] * FULL) & (levels <= drive[-1] * FULL)]
    value = white_cd_m2 * np.interp(inside / FULL, drive[rising], level[rising]) ** gamma
    return ScreenReadings(
        path.stem,
        {int(n): [float(v)] for n, v in zip(inside, value, strict=True)},
        taken=(f"ArgyllCMS .cal for a gamma of {gamma:g}: the response is inferred, black counts as 0",),
        shape_u_rel=CAL_SHAPE_U_REL,
    )


_LEVEL_NAMES: Final = (
    "level", "levels", "grey_level", "gray_level", "grey", "gray", "grey_value", "gray_value", "digital_level", "dac",
    "drive", "input", "code", "dn", "stufe", "graustufe", "grauwert", "niveau",
)  # fmt: skip
# Of the first three names the unit is cd·m⁻² unless the heading has another; the others are nothing without one.
_PLAIN_LUMINANCE: Final = ("luminance", "lv", "leuchtdichte")
_LUMINANCE_NAMES: Final = (*_PLAIN_LUMINANCE, "l", "y", "luminosite", "brightness", "reading", "measured")
_CHANNEL_NAMES: Final = ("channel", "primary", "colour", "color")
_RGB: Final = ({"r", "red", "rgb_r"}, {"g", "green", "rgb_g"}, {"b", "blue", "rgb_b"})


def _table(path: Path, text: str, mapped: StatementMap) -> ScreenReadings:
    """Return the readings of a table of level (0–255, 0–1 or %) or R, G, B and of luminance in cd·m⁻².

    Columns are found by their names. Without a heading the first is the level and the second the luminance.
    """
    table = read_table(path, "columns of level and luminance", text)
    if len(table.rows) < 3:
        raise InputError(f"{path}: {len(table.rows)} rows of level and luminance; three at least are needed")
    doubts = list[str]()
    table = _without_chromaticity(table)
    light_at = table.find_fact("luminance", _LUMINANCE_NAMES, mapped)
    level_at = table.find_fact("level", _LEVEL_NAMES, mapped)
    channels = _rgb_columns(table) if level_at is None else None
    if not table.header:
        if table.width != 2:
            raise InputError(
                f"{path}: {table.width} columns without a heading; write one, such as level,luminance_cd_m2"
            )
        level_at, light_at = 0, 1
        doubts.append("no heading: the first column is read as the level, the second as the luminance in cd·m⁻²")
    if light_at is None or (level_at is None and channels is None):
        lacking = "luminance" if light_at is None else "level"
        raise UnsettledError(
            f"{path}: no column is known as the {lacking}; it has {', '.join(table.header)}. Name it: "
            f"--map {lacking}=COLUMN"
        )
    name, unit = heading_parts(table.header[light_at], "luminance")[:2] if table.header else ("", None)
    plain = not table.header or name in _PLAIN_LUMINANCE
    if table.header and plain and unit is None and "luminance" not in mapped.places:
        doubts.append(f"{table.header[light_at]!r} has no unit: read in cd·m⁻²; --map luminance=COLUMN:UNIT states it")
    luminance = finite(table.values(light_at, "luminance", doubts, mapped, "cd/m2" if plain else ""), table, light_at)
    drives = [_drives(table, at, doubts, mapped) for at in (channels or (level_at,) * 3)]
    rows = list[tuple[Sequence[float], float]]()
    named_at = None if channels else next((n for n, name in enumerate(table.plain) if name in _CHANNEL_NAMES), None)
    for (number, cells), red, green, blue, value in zip(table.rows, *drives, luminance, strict=True):
        top = max(red, green, blue)
        drive = (red, green, blue) if named_at is None else _drive_of(path, number, cells[named_at], top)
        rows.append((drive, value))
    table.refuse_mixed([light_at, *(channels or (level_at,)), named_at])
    left = table.not_used([light_at, *(channels or (level_at,)), *([] if named_at is None else [named_at])])
    grey, primaries = _by_channel(rows)
    return ScreenReadings(
        path.stem,
        grey,
        primaries,
        resolution_cd_m2=10.0 ** -max(len(cells[light_at].partition(".")[2]) for _, cells in table.rows),
        taken=(
            f"a table, {table.how}",
            f"level from {_heading(table, *(channels or (level_at,)))}, luminance from {_heading(table, light_at)}",
            *(f"not used: {line}" for line in (*left, *table.preamble)),
        ),
        doubts=tuple(dict.fromkeys(doubts)),
    )


def _without_chromaticity(table: TextTable) -> TextTable:
    """Return a table whose columns x and y, next to each other, are named as the chromaticity that they are."""
    pairs = [n for n in range(len(table.header) - 1) if table.header[n : n + 2] == ("x", "y")]
    if not pairs:
        return table
    names = list(table.header)
    for n in pairs:
        names[n : n + 2] = "chromaticity x", "chromaticity y"
    return replace(table, header=tuple(names))


def _drive_of(path: Path, line: int, channel: str, level: float) -> tuple[float, ...]:
    """Return the drive of red, green and blue of a row that names its channel. Raises InputError for another name."""
    axis = AXES.get(channel.strip().lower().replace("gray", "grey"))
    if axis is None:
        raise InputError(f"{path}, line {line}: channel {channel!r} is unknown; rows are of {', '.join(AXES)}")
    return tuple(level * on for on in axis)


def _heading(table: TextTable, *columns: int | None) -> str:
    return ", ".join(repr(table.header[n]) if table.header else f"column {n + 1}" for n in columns if n is not None)


def _rgb_columns(table: TextTable) -> tuple[int, ...] | None:
    found = [next((n for n, name in enumerate(table.plain) if name in names), None) for names in _RGB]
    return None if None in found else tuple(n for n in found if n is not None)


def _drives(table: TextTable, at: int | None, doubts: list[str], mapped: StatementMap) -> list[float]:
    """Return a column of levels from 0 to 255, by the unit that is stated; whole ones up to 255 need none."""
    if at is None:
        raise InputError(f"{table.path}: no column of levels")
    heading = table.header[at] if table.header else ""
    stated = mapped.places.get("level")
    if (stated and stated[0].unit) or heading_parts(heading, "level")[2]:
        known = finite(table.values(at, "level", doubts, mapped), table, at)
        if min(known) < 0.0 or max(known) > 1.0 + 1e-9:
            raise InputError(
                f"{table.path}: levels from {FULL * min(known):g} to {FULL * max(known):g} of 255 in the"
                " column of levels; a display has 0 to 255. Correct the table, or name another unit by --map level="
            )
        return [round(FULL * share, 6) for share in known]
    raw = finite(table.values(at, "number", doubts), table, at)
    if min(raw) < 0 or max(raw) != FULL or not all(v.is_integer() for v in raw):
        settled = f"--map level={heading}:UNIT" if heading else "a heading such as `level [UNIT],luminance`"
        raise UnsettledError(
            f"{table.path}: levels from {min(raw):g} to {max(raw):g} without a unit in "
            f"{heading or 'the first column'}; only whole ones up to 255 need none. State it by {settled} (UNIT: 8bit, "
            "10bit, % or share)"
        )
    return raw
