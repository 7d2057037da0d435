"""Damaged and ambiguous variants of files: no reader gives a wrong value without reporting a doubt.

Each reader gets files whose units, columns, separators, pages and tags are exchanged at random. What comes out is the
value that the file was made with, or the file is refused, or a doubt is reported.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from radiometer.data.raw_files import read_raw_colours
from radiometer.errors import RadiometerError
from radiometer.importing.emva_listing import EmvaListing
from radiometer.importing.photograph_times import read_exif
from tests.unit.reports.readers import (
    Read,
    read_import,
    read_means,
    read_meter,
    read_nights,
    read_screen,
    read_spectrum,
    read_thresholds,
    read_times,
)

# Written down anew and not taken from the product: what each spelling means in s. None: no unit of time.
TIME_UNITS = {
    "s": 1.0, "sec": 1.0, "Seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "\u00b5s": 1e-6,
    "\u03bcs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "100ns": 1e-7, "Ms": None, "MS": None, "ticks": None,
    "m": None, "dB": None,
}  # fmt: skip
LUMINANCE_UNITS = {
    "cd/m2": 1.0, "cd/m\u00b2": 1.0, "nit": 1.0, "mcd/m2": 1e-3, "fL": 3.4262591, "lx": None, "%": None, "V": None,
}  # fmt: skip
LEVEL_UNITS = {"8bit": 255.0, "10bit": 1023.0, "%": 100.0, "percent": 100.0, "share": 1.0, "steps": None}
EXPOSURES = (0.02, 0.5, 3.0)
SAME_REL = 0.01


# The values a file is made with, what writes it into a folder and returns its path, and the reader.
Variant = tuple[dict[str, Any], Callable[[Path], Path], Callable[[Path], Read]]


def text_file(name: str, text: str) -> Callable[[Path], Path]:
    """Return what writes a text."""

    def write(folder: Path) -> Path:
        (folder / name).write_text(text, encoding="utf-8")
        return folder / name

    return write


def check(truth: dict[str, Any], read: Callable[[Path], Read], path: Path) -> None:
    """Check that a file is refused, doubted, or read as it was made; what is unknown may be missing."""
    try:
        found, doubts = read(path)
    except RadiometerError as error:
        truth, found, doubts = {"lines": 1}, {"lines": len(str(error).splitlines())}, ""
    for name, value in truth.items():
        if found.get(name) is not None and not doubts:
            assert found[name] == pytest.approx(value, rel=SAME_REL, abs=1e-9), (name, found)


@st.composite
def fits_variant(draw: st.DrawFn) -> Variant:
    """Return a FITS header whose exposure, temperature and gain have some unit, stated somewhere or nowhere."""
    seconds, celsius = draw(st.sampled_from(EXPOSURES)), -5.0
    key = draw(st.sampled_from(["XPOSURE", "EXPTIME", "EXPOSURE", "EXPOINUS", "ITIME", "IMG_EXP"]))
    own = {"EXPOINUS": 1e-6}.get(key, 1.0 if key in ("XPOSURE", "EXPTIME", "EXPOSURE") else None)
    ways = draw(st.sets(st.sampled_from(["TIMEUNIT", "[unit]", "in words"]), max_size=2))
    ascii_units = sorted(unit for unit in TIME_UNITS if unit.isascii())
    units = {way: draw(st.sampled_from(ascii_units)) for way in sorted(ways)}
    factors = {TIME_UNITS[unit] for unit in units.values()} or {own}
    # Where the file contradicts itself or has no unit, the number is anything: what matters is that it is not believed.
    factor = factors.pop() if len(factors) == 1 else None
    cards: dict[str, Any] = {"IMAGETYP": "Light", "INSTRUME": draw(st.sampled_from(["CAM", "ZWO ASI178MM", "QHY268M"]))}
    bracket = f"[{units['[unit]']}]" if "[unit]" in units else ""
    words = f"exposure in {units['in words']}" if "in words" in units else ""
    comment = f"{bracket} {words}".strip()
    number = seconds / factor if factor else draw(st.floats(0.1, 1000.0))
    cards[key] = (number, comment)
    if "TIMEUNIT" in units:
        cards["TIMEUNIT"] = units["TIMEUNIT"]
    kelvin, kelvin_comment = draw(
        st.sampled_from([(0.0, ""), (273.15, "[K] sensor"), (273.15, ""), (0.0, "degrees C")])
    )
    cards["CCD-TEMP"] = (draw(st.sampled_from([celsius + kelvin, 999.0, -999.0])), kelvin_comment)
    gain, gain_db, gain_comment = draw(
        st.sampled_from([(None, 0.0, ""), (120, 12.0, "[0.1dB]"), (12.0, 12.0, "[dB]"), (4.0, 0.0, "e-/ADU")])
    )
    if gain is not None:
        cards["GAIN"] = (gain, gain_comment)
    truth = {"exposure 0": seconds if factor else -1.0, "temperature 0": celsius, "gain 0": gain_db}

    def write(folder: Path) -> Path:
        unit = fits.PrimaryHDU(np.random.default_rng(0).integers(500, 900, (16, 16)).astype(np.uint16))
        for name, value in cards.items():
            unit.header[name] = value
        unit.writeto(folder / "a.fits")
        return folder / "a.fits"

    return truth, write, read_import


@st.composite
def tiff_variant(draw: st.DrawFn) -> Variant:
    """Return a stack whose pages, in any order, state exposure and black level in tags of some type, or not at all."""
    pages = draw(st.permutations(EXPOSURES))
    black = draw(st.sampled_from([64, 256]))
    tags = []
    for seconds in pages:
        numerator, denominator = round(seconds * 1000), 1000
        exposure = draw(
            st.sampled_from(
                [
                    (33434, "2I", 1, (numerator, denominator), True), (33434, "f", 1, seconds, True),
                    (33434, "d", 1, seconds, True), (33434, "s", 0, f"{numerator}/{denominator}", True),
                    (33434, "2I", 1, (0, 0), True), (33434, "2I", 1, (4_294_967_295, 1), True), None,
                ]
            )
        )  # fmt: skip
        level = draw(
            st.sampled_from(
                [
                    [(50714, "H", 1, black, True)], [(50714, "2I", 4, (black, 1) * 4, True)],
                    [(50713, "H", 2, (1, 2), True), (50714, "H", 2, (black, black), True)],
                    [(50714, "2I", 1, (0, 1), True), (50716, "2i", 16, (black, 1) * 16, True)],
                    [(50714, "2I", 1, (0, 0), True)], [(50714, "f", 1, float(black), True)],
                ]
            )
        )  # fmt: skip
        tags.append([*([exposure] if exposure else []), *level])
    stated = [seconds for seconds, own in zip(pages, tags, strict=True) if _states_exposure(own)]
    truth = {f"exposure {n}": seconds for n, seconds in enumerate(stated)}
    truth |= {f"black {n}": float(black) for n in range(len(pages))}

    def write(folder: Path) -> Path:
        with tifffile.TiffWriter(folder / "a.tif") as writer:
            for own in tags:
                page = np.random.default_rng(0).integers(500, 900, (16, 16)).astype(np.uint16)
                writer.write(page, photometric="minisblack", extratags=own, metadata=None, contiguous=False)
        return folder / "a.tif"

    return truth, write, read_import


def _states_exposure(tags: list[Any]) -> bool:
    return any(tag[0] == 33434 and tag[3] not in ((0, 0), (4_294_967_295, 1)) for tag in tags)


@st.composite
def ome_variant(draw: st.DrawFn) -> Variant:
    """Return an OME-TIFF whose pages have some order, stated by TiffData or by DimensionOrder, in some unit."""
    spelling = draw(st.sampled_from(sorted(TIME_UNITS)))
    factor = TIME_UNITS[spelling]
    order = draw(st.sampled_from(["XYZCT", "XYZTC", "XYTCZ", "XYCTZ"]))
    places = draw(st.permutations([(c, t) for c in range(2) for t in range(2)]))
    by_block = draw(st.booleans())
    exposures = (0.005, 0.01, 0.02, 0.04)
    if not by_block:  # the order of the pages follows from DimensionOrder alone
        first = order[2:].replace("Z", "")[0]
        places = [(n % 2, n // 2) if first == "C" else (n // 2, n % 2) for n in range(4)]
    blocks = "".join(
        f'<TiffData FirstC="{c}" FirstT="{t}" FirstZ="0" IFD="{n}" PlaneCount="1"/>' for n, (c, t) in enumerate(places)
    )
    planes = [
        f'<Plane TheZ="0" TheC="{c}" TheT="{t}" ExposureTime="{s / (factor or 1):.9g}" ExposureTimeUnit="{spelling}"/>'
        for (c, t), s in zip(places, exposures, strict=True)
    ]
    body = (blocks if by_block else "") + "".join(draw(st.permutations(planes)))
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image '
        f'ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="{order}" Type="uint16" SizeX="16" SizeY="16" SizeZ="1" '
        f'SizeC="2" SizeT="2">{body}</Pixels></Image></OME>'
    )
    truth = {f"exposure {n}": s if factor else -1.0 for n, s in enumerate(exposures)}

    def write(folder: Path) -> Path:
        pages = np.random.default_rng(0).integers(500, 900, (4, 16, 16)).astype(np.uint16)
        tifffile.imwrite(folder / "a.ome.tif", pages, description=xml.encode(), metadata=None, photometric="minisblack")
        return folder / "a.ome.tif"

    return truth, write, read_import


def _table(draw: st.DrawFn, columns: dict[str, list[str]], more: dict[str, list[str]], *, named: bool = False) -> str:
    """Return a table with its columns permuted, further ones between them, any separator and decimal mark."""
    found = columns | {name: more[name] for name in draw(st.sets(st.sampled_from(sorted(more)), max_size=2))}
    names = draw(st.permutations(sorted(found)))
    marks = [(",", False), (";", False), (";", True), ("\t", True), ("\t", False), (",", True)]
    separator, comma = draw(st.sampled_from(marks))
    rows = [separator.join(cells) for cells in zip(*(found[name] for name in names), strict=True)]
    rows = [row.replace(".", ",") for row in rows] if comma else rows
    before = draw(st.sampled_from([[], ["# a remark"], ["Export of 2026"]]))
    heading = draw(st.sampled_from([[separator.join(names)]] * 4 + ([] if named else [[]])))
    return "\n".join([*before, *heading, *rows]) + "\n"


def _heading(draw: st.DrawFn, name: str, unit: str) -> str:
    return draw(st.sampled_from([f"{name} ({unit})", f"{name} [{unit}]", f"{name}_{unit}"])) if unit else name


@st.composite
def screen_variant(draw: st.DrawFn) -> Variant:
    """Return a table of a screen with levels and luminances in some unit."""
    unit, level_unit = draw(st.sampled_from(["", *LUMINANCE_UNITS])), draw(st.sampled_from(["", *LEVEL_UNITS]))
    factor, full = LUMINANCE_UNITS.get(unit, 1.0), LEVEL_UNITS.get(level_unit, 255.0)
    levels = list(range(0, 256, 15))
    light = [0.2 + 230 * (n / 255) ** 2.2 for n in levels]
    columns = {
        _heading(draw, draw(st.sampled_from(["level", "Stufe", "grey level"])), level_unit): [
            f"{n * (full or 300.0) / 255:.6g}" for n in levels
        ],
        _heading(draw, draw(st.sampled_from(["luminance", "Lv", "Leuchtdichte"])), unit): [
            f"{v / (factor or 1.0):.6g}" for v in light
        ],
    }
    more = {"No": [str(n) for n in range(1, 19)], "x": ["0.3127"] * 18, "y_chromaticity": ["0.329"] * 18}
    text = _table(draw, columns, more)
    known = factor is not None and full is not None
    truth = {str(n): v if known else -1.0 for n, v in zip(levels, light, strict=True)}
    return truth | {"levels": 18}, text_file("s.csv", text), read_screen


@st.composite
def spectrum_variant(draw: st.DrawFn) -> Variant:
    """Return a table of a spectrum, its wavelengths in nm, µm or another unit."""
    unit, factor = draw(st.sampled_from([("nm", 1.0), ("\u00b5m", 1e3), ("um", 1e3), ("cm-1", None), ("", 1.0)]))
    grid = list(range(400, 701, 10))
    more = {"index": [str(n) for n in range(31)], "dark": ["12.5"] * 31}
    power = [float(np.exp(-0.5 * ((nm - 560) / 40) ** 2)) + 0.001 for nm in grid]
    columns = {
        _heading(draw, draw(st.sampled_from(["wavelength", "Lambda", "wl"])), unit): [
            f"{nm / (factor or 1):.6g}" for nm in grid
        ],
        draw(st.sampled_from(["power", "relative", "relativ"])): [f"{v:.6f}" for v in power],
    }
    text = _table(draw, columns, more, named=unit not in ("", "nm"))
    mean = float(np.array(grid) @ power / np.sum(power))
    return {"nm": mean if factor else -1.0, "peak": max(power)}, text_file("s.csv", text), read_spectrum


@st.composite
def statistics_variant(draw: st.DrawFn) -> Variant:
    """Return a table of means and variances over exposure in some unit."""
    unit = draw(st.sampled_from(["", *TIME_UNITS]))
    factor = TIME_UNITS.get(unit)
    columns = {
        _heading(draw, draw(st.sampled_from(["exposure", "exptime", "integration_time"])), unit): [
            f"{s / (factor or 1.0):.7g}" for s in EXPOSURES
        ],
        "mean": ["120.5", "600.25", "3100.5"],
        "variance": ["14.5", "60.125", "310.5"],
    }
    more = {"row": ["1", "2", "3"], "remark": ["a", "b", "c"], "max": ["130.5", "640.5", "3300.5"]}
    text = _table(draw, columns, more)
    truth = {f"s {n}": s if factor else -1.0 for n, s in enumerate(EXPOSURES)}
    return truth | {"mean 0": 120.5, "mean 1": 600.25, "mean 2": 3100.5}, text_file("t.csv", text), read_means


@st.composite
def list_variant(draw: st.DrawFn) -> Variant:
    """Return a list of exposure times with units behind the numbers, in the heading, or nowhere."""
    unit = draw(st.sampled_from(["", *TIME_UNITS]))
    factor = TIME_UNITS.get(unit, 1.0)
    separator = draw(st.sampled_from([" ", ",", ";", "\t", ", "]))
    comma, in_heading = draw(st.booleans()), draw(st.booleans())
    lines = [separator.join(["file", f"time ({unit})" if unit else "time"])] if in_heading else []
    for n, seconds in enumerate(EXPOSURES):
        number = f"{seconds / (factor or 1.0):.9g}"
        behind = f" {unit}" if unit and not in_heading else ""
        lines.append(f"p{n}.jpg{separator}{number.replace('.', ',') if comma else number}{behind}")
    truth = {f"p{n}.jpg": s if factor else -1.0 for n, s in enumerate(EXPOSURES)}
    return truth, text_file("exposures.txt", "\n".join(lines) + "\n"), read_times


@st.composite
def exif_variant(draw: st.DrawFn) -> Variant:
    """Return a photograph whose ISO speed is in one or more tags, 65535 and 0 among them."""
    speed = draw(st.sampled_from([400, 102_400]))
    tags = [(33434, "2I", 1, (7, 1000), True)]
    for code in draw(st.permutations([34855, 34866, 34867])):
        kind, value = draw(st.sampled_from([("I", speed), ("H", 65_535), ("H", 0), ("I", 4_294_967_295), ("", 0)]))
        if code == 34855 and kind == "I":
            kind, value = "H", min(speed, 65_535)
        if kind:
            tags.append((code, kind, 1, value, True))

    def write(folder: Path) -> Path:
        page = np.random.default_rng(0).integers(5, 200, (16, 16)).astype(np.uint8)
        tifffile.imwrite(folder / "p.tif", page, photometric="minisblack", extratags=tags, metadata=None)
        return folder / "p.tif"

    def read(path: Path) -> Read:
        found = read_exif(path)
        return ({}, "") if found is None else ({"s": found.nominal_exposure_s, "iso": found.iso}, found.iso_doubt or "")

    return {"s": 0.007, "iso": float(speed)}, write, read


@st.composite
def log_variant(draw: st.DrawFn) -> Variant:
    """Return a log whose exposure and temperature have some unit, with rows that mean "no reading"."""
    unit = draw(st.sampled_from(["", *TIME_UNITS]))
    factor = TIME_UNITS.get(unit, 1.0)
    degrees, of_celsius = draw(
        st.sampled_from([("C", lambda c: c), ("K", lambda c: c + 273.15), ("F", lambda c: 32.0 + 1.8 * c)])
    )
    lost = draw(st.sampled_from([-999.0, None]))
    times = [f"2026-03-{night:02d}T21:{10 * k:02d}:00" for night in range(1, 5) for k in range(5)]
    columns = {
        "utc": times,
        _heading(draw, "exposure", unit): [f"{0.5 / (factor or 1.0):.9g}"] * 20,
        "adu": [f"{30_000 + n}.5" for n in range(20)],
        _heading(draw, draw(st.sampled_from(["temperature", "temp"])), degrees): [
            f"{lost if lost and n == 7 else of_celsius(20.0):.6g}" for n in range(20)
        ],
        "sqm": [f"{20 + 0.01 * n:.2f}" for n in range(20)],
    }
    text = _table(draw, columns, {"humidity": ["55.5"] * 20, "remark": ["clear"] * 20}, named=True)
    truth = {"s": 0.5 if factor else -1.0} | {f"C {n}": 20.0 for n in range(20)}
    return truth, text_file("l.csv", text), partial(read_nights, of="no unit")


@st.composite
def meter_variant(draw: st.DrawFn) -> Variant:
    """Return readings of a light meter, their units in the headings."""
    light, time_unit = draw(st.sampled_from(["", *LUMINANCE_UNITS])), draw(st.sampled_from(["", *TIME_UNITS]))
    factor, seconds = LUMINANCE_UNITS.get(light, 1.0), TIME_UNITS.get(time_unit, 1.0)
    columns = {
        _heading(draw, draw(st.sampled_from(["luminance", "Lv"])), light): [
            f"{v / (factor or 1.0):.7g}" for v in (1000.0, 2000.0)
        ],
        _heading(draw, draw(st.sampled_from(["time", "shutter"])), time_unit): [
            f"{v / (seconds or 1.0):.7g}" for v in (0.008, 0.004)
        ],
        "f_number": ["8.0", "8.0"],
        "iso": ["100", "100"],
    }
    text = _table(draw, columns, {"K": ["12.5", "12.5"], "remark": ["a", "b"]}, named=True)
    known = factor is not None and seconds is not None
    truth = {"cd/m2": 1000.0 if known else -1.0, "s": 0.008 if known else -1.0}
    return truth, text_file("m.csv", text), read_meter


@st.composite
def argyll_variant(draw: st.DrawFn) -> Variant:
    """Return a .ti3 whose XYZ are absolute or relative, as its keywords state or not, its columns in any order."""
    relative, full = draw(st.booleans()), draw(st.sampled_from([100.0, 255.0]))
    stated = draw(st.booleans())
    white = 'LUMINANCE_XYZ_CDM2 "218.7 230.2 253.2"' if draw(st.booleans()) else 'DEVICE_CLASS "DISPLAY"'
    key = f'NORMALIZED_TO_Y_100 "{"YES" if relative else "NO"}"' if stated else ""
    levels = list(range(0, 256, 15))
    light = [0.2 + 230 * (n / 255) ** 2.2 for n in levels]
    columns = {name: [f"{n * full / 255:.5f}" for n in levels] for name in ("RGB_R", "RGB_G", "RGB_B")}
    columns |= {"XYZ_Y": [f"{v * (100 / 230.2 if relative else 1.0):.6f}" for v in light]}
    columns |= {"XYZ_X": ["1.0"] * 18, "SAMPLE_ID": [str(n) for n in range(18)]}
    names = draw(st.permutations(sorted(columns)))
    rows = "\n".join(" ".join(cells) for cells in zip(*(columns[name] for name in names), strict=True))
    text = (
        f"CTI3\n\n{white}\n{key}\nBEGIN_DATA_FORMAT\n{' '.join(names)}\nEND_DATA_FORMAT\nBEGIN_DATA\n{rows}\nEND_DATA\n"
    )
    return {str(n): v for n, v in zip(levels, light, strict=True)}, text_file("s.ti3", text), read_screen


@st.composite
def threshold_variant(draw: st.DrawFn) -> Variant:
    """Return thresholds over time in some unit, linear or as logarithms."""
    unit = draw(st.sampled_from([unit for unit, size in TIME_UNITS.items() if size and unit.isascii()]))
    form, write = draw(
        st.sampled_from(
            [
                ("log10_threshold", lambda v: v), ("ln threshold", lambda v: v * np.log(10.0)),
                ("threshold (cd/m2)", lambda v: 10.0**v), ("threshold (mcd/m2)", lambda v: 1e3 * 10.0**v),
                ("log threshold (mcd/m2)", lambda v: v + 3.0), ("sensitivity (dB)", lambda v: -10.0 * v),
            ]
        )
    )  # fmt: skip
    minutes, logs = (0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 20.0), (-1.0, -1.5, -2.0, -2.2, -2.6, -3.5, -4.5)
    columns = {
        f"time ({unit})": [f"{60.0 * t / float(TIME_UNITS[unit] or 1.0):.9g}" for t in minutes],
        form: [f"{write(v):.9g}" for v in logs],
    }
    text = _table(draw, columns, {"eye": ["left"] * 7, "pupil_mm": ["7.1"] * 7}, named=True)
    truth = {f"min {n}": t for n, t in enumerate(minutes)} | {f"log {n}": v for n, v in enumerate(logs)}
    return truth, text_file("t.csv", text), read_thresholds


@st.composite
def emva_variant(draw: st.DrawFn) -> Variant:
    """Return a descriptor of EMVA 1288 whose exposures have the format's unit, another, or one that is none."""
    spelling = draw(st.sampled_from(["", "ns", "us", "ms", "s", "ticks"]))
    blank = draw(st.sampled_from(["", " "]))
    factor = TIME_UNITS[spelling or "ns"]
    slash = draw(st.sampled_from(["/", "\\"]))
    lines = ["v 3.0", "n 12 16 16"]
    for n, seconds in enumerate(EXPOSURES):
        written = f"{seconds / (factor or 1.0):.9g}{blank if spelling else ''}{spelling}"
        lines += [f"b {written} {1000 * n + 1000}", f"i images{slash}{n}.tif"]

    def write(folder: Path) -> Path:
        (folder / "images").mkdir()
        for n in range(len(EXPOSURES)):
            (folder / "images" / f"{n}.tif").write_bytes(b"")
        return text_file("EMVA1288_Data.txt", "\n".join(lines) + "\n")(folder)

    def read(path: Path) -> Read:
        return {str(n): entry.exposure_s for n, entry in enumerate(EmvaListing.read(path).entries)}, ""

    return {str(n): s if factor else -1.0 for n, s in enumerate(EXPOSURES)}, write, read


@st.composite
def raw_variant(draw: st.DrawFn) -> Variant:
    """Return a DNG of any mosaic, its black level and exposure in tags of some type."""
    filters = draw(st.sampled_from([(0, 1, 1, 2), (2, 1, 1, 0), (1, 0, 2, 1), (1, 2, 0, 1)]))
    black, white = draw(st.sampled_from([64, 256])), draw(st.sampled_from([1023, 4095, 16_383]))
    seconds = draw(st.sampled_from(EXPOSURES))
    level = draw(
        st.sampled_from(
            [
                [(50714, "H", 1, black, True)], [(50714, "2I", 1, (black, 1), True)],
                [(50713, "H", 2, (2, 2), True), (50714, "2I", 4, (black, 1) * 4, True)],
                [(50713, "H", 2, (2, 2), True), (50714, "I", 4, (black,) * 4, True)],
            ]
        )
    )  # fmt: skip
    exposure = draw(
        st.sampled_from(
            [(33434, "2I", 1, (round(seconds * 1000), 1000), True), (33434, "d", 1, seconds, True),
             (37377, "2i", 1, (round(-1e6 * np.log2(seconds)), 1_000_000), True), (33434, "2I", 1, (0, 0), True), None]
        )
    )  # fmt: skip
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True), (50708, "s", 0, "Test Camera", True), (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, filters, True), (50717, draw(st.sampled_from(["H", "I"])), 1, white, True), *level,
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50728, "2I", 3, (1, 1) * 3, True), (50778, "H", 1, 21, True), *([exposure] if exposure else []),
    ]  # fmt: skip
    colours = (700.0, 900.0, 500.0)
    truth = {"R": colours[0], "G": colours[1], "B": colours[2], "white": float(white), "s": seconds}
    truth |= {f"black {n}": float(black) for n in range(3)}

    def write(folder: Path) -> Path:
        cell = np.array([colours[n] for n in filters]).reshape(2, 2)
        with tifffile.TiffWriter(folder / "p.dng") as writer:
            writer.write(
                np.tile(cell, (16, 16)).astype(np.uint16), photometric=32803, extratags=sorted(tags), metadata=None
            )
        return folder / "p.dng"

    def read(path: Path) -> Read:
        found, exif = read_raw_colours(path), read_exif(path)
        values = dict(zip("RGB", (float(plane.mean()) for plane in np.moveaxis(found.values, 2, 0)), strict=True))
        values |= {f"black {n}": value for n, value in enumerate(found.black_levels_dn)}
        return values | {"white": float(found.white_level_dn), "s": exif and exif.nominal_exposure_s}, ""

    return truth, write, read


@st.composite
def micro_manager_variant(draw: st.DrawFn) -> Variant:
    """Return a picture with Micro-Manager's file of metadata: numbers, text, another unit, numbers for "unknown"."""
    milliseconds = draw(st.sampled_from([20.0, 500.0, 3000.0]))
    written = draw(
        st.sampled_from(
            [milliseconds, f"{milliseconds}", f"{milliseconds:.4f}".replace(".", ","), f"{milliseconds / 1e3} s",
             f"{milliseconds} ms", f"{milliseconds} ticks", -1, 65_535, None, "NaN", ""]
        )
    )  # fmt: skip
    celsius = draw(st.sampled_from([-5.0, "-5.0", "-5,0", "268.15 K", 999, "n/a"]))
    entry = {
        "FileName": "a.tif", "Camera": "Cam", draw(st.sampled_from(["Exposure-ms", "Cam-Exposure"])): written,
        "Cam-CCDTemperature": celsius, "Cam-Gain": draw(st.sampled_from([1, "4", "High"])), "Slice": 3,
    }  # fmt: skip
    keys = draw(st.permutations(sorted(entry)))
    content = {"Summary": {"Slices": 1}, "Metadata-Default/a.tif": {key: entry[key] for key in keys}}

    def write(folder: Path) -> Path:
        tifffile.imwrite(folder / "a.tif", np.random.default_rng(0).integers(500, 900, (16, 16)).astype(np.uint16))
        (folder / "metadata.txt").write_text(json.dumps(content), encoding="utf-8")
        return folder / "a.tif"

    return {"exposure 0": milliseconds / 1e3, "temperature 0": -5.0}, write, read_import


READERS = {
    "FITS": fits_variant(), "TIFF": tiff_variant(), "OME-TIFF": ome_variant(), "screen table": screen_variant(),
    "spectrum table": spectrum_variant(), "table of statistics": statistics_variant(),
    "list of exposures": list_variant(), "EXIF": exif_variant(), "log of nights": log_variant(),
    "light meter": meter_variant(), ".ti3": argyll_variant(), "dark adaptation": threshold_variant(),
    "EMVA 1288": emva_variant(), "raw": raw_variant(), "Micro-Manager": micro_manager_variant(),
}  # fmt: skip


@pytest.mark.parametrize("examples", [12, pytest.param(300, marks=pytest.mark.long)])
@pytest.mark.parametrize("variants", READERS.values(), ids=READERS)
def test_no_variant_gives_a_wrong_value_in_silence(variants, examples):
    """The value the file was made with, a refusal in one line, or a doubt."""

    @settings(max_examples=examples, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(variants)
    def hold(variant: Any) -> None:
        truth, write, read = variant
        with tempfile.TemporaryDirectory() as folder:
            check(truth, read, write(Path(folder)))

    hold()
