"""The page of a reading for the laboratory's book: value, picture with the patch, budget, calibration, assumptions."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.reading import Flag, Reading
from radiometer.data.storage import write_bytes_atomic, write_text_atomic
from radiometer.errors import UsageError
from radiometer.numbers import below, upper_limit, with_u
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import folded, listed, page, paragraph, section, table
from radiometer.reporting.pictures import BEFORE, MODEL, label, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES: Final = (".html", ".htm", ".pdf")
FLAG_MEANINGS: Final[Mapping[Flag, str]] = {
    Flag.SATURATED: "pixels clip even in the shortest exposure: the value is a lower bound",
    Flag.BELOW_NOISE: "the signal does not exceed the noise: a limit is given in place of a value",
    Flag.EXTRAPOLATED: "uses digital numbers for which the response curve had no data",
    Flag.FLICKER: "exposures disagree beyond their noise: the light flickers or moves",
    Flag.STALE_CALIBRATION: "the calibration is older than its stated validity: calibrate again",
    Flag.UNCALIBRATED: "no calibration: the value is relative, not a radiance",
    Flag.NONUNIFORM: "the patch is not uniform: its spread exceeds the noise",
    Flag.FEW_FRAMES: (
        "fewer than three frames, or fewer than five where all are shorter than 10 ms: they cannot show whether the "
        "light is steady"
    ),
    Flag.STRAY_LIGHT: ("light from around the patch may make up much of the reading: shade or mask the surround"),
    Flag.SHORT_EXPOSURE: (
        "the offset of so short an exposure dominates the uncertainty: close the iris, expose longer"
    ),
    Flag.DARK_ASSUMED: "dark current and black level dominate the uncertainty: take dark frames (--darks)",
    Flag.FALLOFF_ASSUMED: "no flat field: the natural fall-off of the lens was assumed; calibrate with --flat",
    Flag.SPECTRUM_ASSUMED: (
        "the light's spectrum is not stated (--spectrum), or it differs from the calibration's and dominates the "
        "uncertainty: calibrate under such light, or with the camera's --spectral-response"
    ),
    Flag.SMALL_PATCH: ("the patch is so small that pixels' differences dominate the uncertainty: read a larger one"),
    Flag.TEMPERATURE: "the difference from the calibration's temperature dominates the uncertainty",
    Flag.GAIN: "the gain differs from that at calibration and dominates the uncertainty",
    Flag.DRIFT: "the calibration's age dominates the uncertainty: calibrate again",
    Flag.LENS_CHANGED: "changes of the lens since calibration dominate the uncertainty",
    Flag.POLARISATION: "the light's polarisation dominates the uncertainty",
    Flag.EXPOSURE_UNCONFIRMED: (
        "the camera states another exposure time than was set: the value may be wrong by their ratio"
    ),
    Flag.REPEATED_FRAME: "the camera delivered the same frame again: the value may be an old one",
    Flag.OTHER_TAP: "read by another tap than calibrated, whose gain is not known: characterise the camera's taps",
    Flag.LINEARITY: ("the signal is far from the calibration's level, and the sensor was assumed to be linear"),
}
_LEAST_SHARE: Final = 1e-3  # of the variance; smaller contributions are no bar that can be seen
_DARKEST_SHARE: Final = 0.001  # of the pixels that the grey scale leaves out at either end
_MOST_PIXELS: Final = 800  # of the picture's longer side: more makes the page large, and shows no more
_A4_IN: Final = (8.27, 11.69)


@dataclass(frozen=True, slots=True, eq=False)
class ReadingRecord:
    """A reading with the facts that a laboratory's book needs."""

    reading: Reading  # the reading
    frame_dn: NDArray[Any]  # the frame of longest exposure without clipping in the patch, shape (height, width), in DN
    camera: str = ""  # maker, model and serial number; "" where they are not stated
    lens: str = ""  # focal length and f-number; "" where they are not stated
    facts: Sequence[tuple[str, str]] = ()  # settings as names and values, in the order to print them

    @property
    def origin(self) -> Origin:
        """Return what the reading was made with."""
        known = self.reading.more.get("calibration")
        calibration = "none: the value is relative"
        if known:
            calibration = f"{known['file'] or 'in memory'}, {moment(str(known['created']))}"
        return Origin(moment(self.reading.time), self.camera, self.lens, calibration)

    @property
    def value(self) -> str:
        """Return the radiance with its uncertainty and k, or its limit below the noise."""
        one, limit = self.reading, self.reading.upper_limit
        if limit is not None:
            return below(limit.value, limit.unit)
        return with_u(one.radiance.value, one.coverage_factor * one.radiance.u, one.radiance.unit, one.coverage_factor)

    @property
    def luminance(self) -> str:
        """Return the luminance in the same way; "" where there is none."""
        one = self.reading
        if one.luminance is None:
            return ""
        if one.upper_limit is not None:
            return below(upper_limit(one.luminance.value, one.luminance.u), one.luminance.unit)
        expanded = one.coverage_factor * one.luminance.u
        return with_u(one.luminance.value, expanded, one.luminance.unit, one.coverage_factor)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return all facts of the reading as names and values."""
        one = self.reading
        patch = one.patch
        rows = [("radiance", self.value), ("luminance", self.luminance)]
        if one.band_nm:
            rows.append(("band", f"{one.band_nm[0]:g} to {one.band_nm[1]:g} nm"))
        rows += [
            ("patch", f"{patch.width} × {patch.height} pixels at x {patch.x}, y {patch.y}"),
            ("exposure times", ", ".join(f"{time_s:.4g} s" for time_s in sorted(set(one.exposures_s)))),
            *self.facts,
        ]
        known = one.more.get("calibration")
        rows.append(("reference", str(known["reference"]) if known else ""))
        return [row for row in rows if row[1]]

    @property
    def assumptions(self) -> list[str]:
        """Return what was assumed."""
        return [str(text) for text in self.reading.more.get("assumptions", ())]


def check_report_name(path: Path) -> None:
    """Refuse a name whose ending is no form of a reading's page. Raises UsageError."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"cannot write {path}: a reading's page ends in .html or .pdf")


def write_reading_page(record: ReadingRecord, path: Path) -> None:
    """Write the page of a reading, as HTML that loads nothing or as PDF.

    Raises:
        OutputError: If it cannot be written.
        UsageError: If its ending is of neither form.
    """
    check_report_name(path)
    if path.suffix.lower() == ".pdf":
        write_bytes_atomic(path, _pdf(record))
    else:
        write_text_atomic(path, reading_html(record))


def reading_html(record: ReadingRecord) -> str:
    """Return the page of a reading as HTML."""
    one = record.reading
    outcome = f"Radiance {record.value}"
    shown = record.frame_dn.shape
    aspect = shown[0] / shown[1]  # the picture takes some three quarters of the width

    def draw_scene(figure: Figure, narrow: bool) -> None:
        figure.set_layout_engine("compressed")  # axes of a fixed aspect: "constrained" cuts their labels
        _scene(figure.subplots(), record)

    def draw_budget(figure: Figure, narrow: bool) -> None:
        _budget(figure.subplots(), one)

    bars = len(_contributions(one))
    return page(
        f"Reading of {one.instrument}",
        outcome,
        [
            paragraph(f"Luminance {record.luminance}." if record.luminance else ""),
            picture(
                draw_scene,
                "The frame with the patch that was read; grey is logarithmic.",
                (7.0, 5.2 * aspect + 0.7),
                (4.0, 2.9 * aspect + 0.8),
            ),
            *(paragraph(f"{flag}: {FLAG_MEANINGS[flag]}.", "flag") for flag in one.flags),
            section("The reading", table((), record.rows, words=(1,))),
            section(
                "Where its uncertainty comes from",
                picture(draw_budget, "Contributions to the relative standard uncertainty (k = 1).",
                        (9.0, 1.0 + 0.42 * bars), (4.0, 1.2 + 0.5 * bars)) if bars else "",
                folded("All contributions", table(("", "u in %", "type", "from"), _budget_rows(one), words=(2, 3))),
            ),
            section("What was assumed", listed([f"{text}." for text in record.assumptions])),
        ],
        kind="Reading",
        origin=record.origin,
    )  # fmt: skip


def _contributions(reading: Reading) -> list[tuple[str, float]]:
    """Return names and relative standard uncertainties of what can be seen as a bar, the smallest first."""
    total = sum(entry.u_rel**2 for entry in reading.budget)
    seen = [(entry.name, entry.u_rel) for entry in reading.budget if entry.u_rel**2 > _LEAST_SHARE * total]
    return sorted(seen, key=lambda entry: entry[1])


def _budget_rows(reading: Reading) -> list[tuple[str, str, str, str]]:
    ordered = sorted(reading.budget, key=lambda entry: -entry.u_rel)
    return [(entry.name, f"{100 * entry.u_rel:.3f}", entry.kind, entry.note) for entry in ordered]


def _budget(axes: Axes, reading: Reading) -> None:
    entries = _contributions(reading)
    axes.barh([label(name) for name, _ in entries], [100 * u_rel for _, u_rel in entries], color=MODEL, height=0.6)
    axes.set_xlabel("relative standard uncertainty in % (k = 1)")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True, axis="x", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)


def _scene(axes: Axes, record: ReadingRecord) -> None:
    """Draw the frame in logarithmic grey, with the patch."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    height, width = record.frame_dn.shape
    step = max(1, -(-max(height, width) // _MOST_PIXELS))
    shown = np.maximum(np.asarray(record.frame_dn[::step, ::step], dtype=np.float64), 1.0)
    low, high = np.quantile(shown, [_DARKEST_SHARE, 1.0 - _DARKEST_SHARE])
    drawn = axes.imshow(
        shown, cmap="gray", norm=LogNorm(max(low, 1.0), max(high, 1.01 * low)), extent=(0, width, height, 0)
    )
    patch = record.reading.patch
    axes.add_patch(Rectangle((patch.x, patch.y), patch.width, patch.height, fill=False, ec=BEFORE, lw=1.8))
    axes.set_xlabel("x in pixels")
    axes.set_ylabel("y in pixels")
    bar = axes.figure.colorbar(drawn, ax=axes, label="digital number (DN)", fraction=0.046, pad=0.02)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())


def _pdf(record: ReadingRecord) -> bytes:
    """Return the page as one sheet of A4."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure

    one = record.reading
    with rc_context({"font.size": 8.5}):
        figure = Figure(figsize=_A4_IN)
        FigureCanvasPdf(figure)
        figure.text(0.08, 0.955, label(f"Reading of {one.instrument}"), fontsize=10, color="#555555")
        figure.text(0.08, 0.928, label(f"Radiance {record.value}"), fontsize=15, fontweight="bold")
        _scene(figure.add_axes((0.12, 0.66, 0.76, 0.24)), record)
        lines = [f"{name:<16} {value}" for name, value in (*record.origin.rows, *record.rows)]
        lines += ["", *(f"flag {flag}: {FLAG_MEANINGS[flag]}" for flag in one.flags)]
        lines += ["", "assumed:", *(f"  {text}" for text in record.assumptions or ["nothing"])]
        figure.text(
            0.08, 0.61, label("\n".join(part for line in lines for part in _wrapped(line))), va="top", linespacing=1.35,
            family="monospace", fontsize=7,
        )  # fmt: skip
        bars = len(_contributions(one))
        if bars:
            _budget(figure.add_axes((0.30, 0.08, 0.62, min(0.03 + 0.025 * bars, 0.22))), one)
        content = io.BytesIO()
        figure.savefig(content, format="pdf", metadata={"Title": f"Reading of {one.instrument}", "CreationDate": None})
    return content.getvalue()


def _wrapped(line: str) -> list[str]:
    import textwrap

    return textwrap.wrap(line, 110, subsequent_indent="  ", drop_whitespace=False) or [""]
