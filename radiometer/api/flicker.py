"""How light is modulated in time: from a waveform, or from the rows of a rolling-shutter frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiometer.acquire.light_series import take_series
from radiometer.analysis.flicker import Flicker, Waveform, find_period, measure_flicker, read_waveform, waveform_of_rows
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Drawn, Notice, unheard
from radiometer.bench.assembly import open_bench_camera
from radiometer.bench.instrument import central_patch, refuse_outside
from radiometer.data import Patch, Quantity
from radiometer.data.drawing import new_axes
from radiometer.data.statements import StatementMap
from radiometer.errors import InputError, UsageError
from radiometer.importing.photograph_pixels import read_photograph
from radiometer.plausible import Exposure, NotNegative, Positive, RelativeUncertainty, Uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TABLES = (".csv", ".txt", ".tsv", ".dat")
_CODED = (".jpg", ".jpeg")
_MOST_DRAWN = 4000
_LONGEST_S = 600.0  # of a camera's series: PstLM is defined over 180 s


@dataclass(frozen=True, eq=False, repr=False)
class FlickerReport(Drawn):
    """The modulation of a light in time.

    Attributes:
        waveform: What was measured.
        measures: Frequency, modulation depth, flicker index, SVM and PstLM.
        row_time: Time from row to row in s, of a rolling-shutter frame.
    """

    waveform: Waveform
    measures: Flicker
    row_time: Quantity | None = None

    def to_mapping(self) -> dict[str, Any]:
        measures = {one.name: getattr(self.measures, one.name) for one in fields(self.measures)}
        source, rate_hz, duration_s = self.waveform.origin, self.waveform.rate_hz, self.waveform.duration_s
        return self.plain("row_time", source=source, rate_Hz=rate_hz, duration_s=duration_s, **measures)

    def plot(self, axes: Axes | None = None) -> Axes:
        where = axes if axes is not None else new_axes()
        frequency = self.measures.frequency
        shown_s = self.waveform.duration_s if frequency is None else 4.0 / frequency.value
        count = max(2, min(self.waveform.light.size, math.ceil(shown_s * self.waveform.rate_hz)))
        step = max(1, count // _MOST_DRAWN)
        relative = self.waveform.light[:count:step] / self.waveform.light.mean()
        where.plot(1e3 * np.arange(count)[::step] / self.waveform.rate_hz, relative, linewidth=1.0)
        where.set(xlabel="time in ms", ylabel="light over its mean")
        where.set_ylim(bottom=min(0.0, float(relative.min())))
        return where

    def __str__(self) -> str:
        found, k = self.measures, self.measures.coverage_factor
        depth = found.modulation_depth.scaled(100.0, "%").text(k)
        at = "no repetition" if found.frequency is None else f"{found.frequency.value:.5g} Hz"
        svm = "" if found.svm is None else f", SVM {found.svm.text(k)}"
        return f"{at}, modulation depth {depth}{svm} (k = {k:.3g})"


def flicker(
    source: PathLike | None = None,
    *,
    camera: str | None = None,
    bench: PathLike | None = None,
    duration: Positive = 1.0,
    dark: float | None = None,
    u_dark: Uncertainty = 0.0,
    mapped: StatementMap | Sequence[str] = (),
    row_time: Positive | None = None,
    known_frequency: Positive | None = None,
    exposure: Exposure | None = None,
    black_level: NotNegative | None = None,
    flat: PathLike | None = None,
    patch: PatchLike | None = None,
    u_clock: RelativeUncertainty | None = None,
    notice: Notice = unheard,
) -> FlickerReport:
    """Measure flicker and the stroboscopic effect of a light, each figure with its uncertainty.

    Gives the dominant frequency, modulation depth, flicker index, SVM (IEC TR 63158) and PstLM (IEC TR 61547-1).

    Examples:
        >>> import radiometer as rm
        >>> found = rm.flicker("lamp.csv", dark=0.0)
        >>> round(found.measures.frequency.value), found.measures.svm.unit
        (100, '1')
        >>> found
        <FlickerReport 100 Hz, modulation depth (30.0... ± ...) %, SVM 1.17... (k = ...)>

    Args:
        source: Table of time and light, or a frame of a rolling-shutter camera in a linear form (TIFF, PNG, raw).
        camera: Camera that takes a fast series of the light, instead of a file: "sim", id, serial number or address.
        bench: Bench file of that camera; enough by itself where it names one.
        duration: Length of that series in s.
        dark: Of a table: value of the light's column in darkness; 0 is assumed where it is not given.
        u_dark: Standard uncertainty of `dark`, or of the black level.
        mapped: Of a table: where time and light are, such as "timestamp=T:ms" and "number=CH1".
        row_time: Of a frame: time between the starts of two rows in s.
        known_frequency: Of a frame: frequency of the light in Hz, from which the row time is found.
        exposure: Exposure time of a frame in s, or the time over which each sample of a table averages. Of a series: by
            itself where it is not given.
        black_level: Of a frame: black level in DN.
        flat: Of a frame: frame of the same field under steady light, which takes the fall-off away.
        patch: Of a frame: region of an even field, all by default. Of a series: the bench's by default.
        u_clock: Relative standard uncertainty of what times samples or rows, such as 5e-5; in no u where not given.
        notice: Gets what a user should know, a line each.

    Raises:
        UsageError: If options are missing or exclude each other.
        InputError: If the file holds no waveform.
        MeasurementError: If its mean light is not above 0.
    """
    if camera is not None or bench is not None:
        others = (source, dark, row_time, known_frequency, black_level, flat)
        if any(one is not None for one in others) or mapped:
            raise UsageError("a camera's series needs no file: give --exposure, --patch and --duration alone")
        series = _of_camera(camera, bench, duration, exposure, patch)
        return FlickerReport(series, measure_flicker(series, u_clock))
    if source is None:
        raise UsageError("give a table or a frame, or --camera for a series of readings")
    path = Path(source)
    of_frame = {
        "--row-time": row_time, "--known-frequency": known_frequency, "--black-level": black_level,
        "--flat": flat, "--patch": patch,
    }  # fmt: skip
    if path.suffix.lower() in _TABLES:
        given = [name for name, value in of_frame.items() if value is not None]
        if given:
            raise UsageError(f"{', '.join(given)}: of a frame only; {path} is a table")
        waveform, reported = read_waveform(path, dark, u_dark, StatementMap.of(mapped), exposure or 0.0)
        for line in reported:
            notice(f"{path.name}: {line}")
        return FlickerReport(waveform, measure_flicker(waveform, u_clock))
    if dark is not None or mapped:
        raise UsageError(f"--dark and --map: of a table only; {path} is a frame: state --black-level")
    if exposure is None or black_level is None or (row_time is None) == (known_frequency is None):
        needs = "--exposure, --black-level, and one of --row-time and --known-frequency"
        raise UsageError(f"{path}: a frame needs {needs}")
    reference = None if flat is None else _plane(Path(flat), patch)
    rows = waveform_of_rows(_plane(path, patch), row_time or 1.0, exposure, str(path), black_level, reference, u_dark)
    if known_frequency is None:
        found_time = Quantity(row_time or 1.0, (row_time or 1.0) * (u_clock or 0.0), "s")
    else:
        if (period := find_period(rows)) is None:
            raise InputError(f"{path}: no repetition in the rows, so no row time can be found; state --row-time")
        found_time = Quantity(period.frequency_hz / known_frequency, period.u_hz / known_frequency, "s")
        rows, u_clock = rows.at_rate(1.0 / found_time.value), 0.0  # timed by the light itself
    return FlickerReport(rows, measure_flicker(rows, u_clock), found_time)


def _of_camera(
    name: str | None, bench: PathLike | None, duration_s: float, exposure_s: float | None, patch: PatchLike | None
) -> Waveform:
    if not 0.0 < duration_s <= _LONGEST_S:
        raise UsageError(f"--duration {duration_s:g}: must be above 0 and at most {_LONGEST_S:g} s")
    with open_bench_camera(None if bench is None else Path(bench), name) as (config, camera):
        where = as_patch(patch) or (config.patch.patch if config.patch else central_patch(camera))
        refuse_outside(where, camera)
        return take_series(camera, where, duration_s, exposure_s)


def _plane(path: Path, patch: PatchLike | None) -> Any:
    """Return the digital numbers of a frame within a patch; of colours, green."""
    if path.suffix.lower() in _CODED:
        raise InputError(f"{path}: values of a JPEG are not proportional to light; give the raw file or a linear TIFF")
    values = read_photograph(path).values
    plane = values if values.ndim == 2 else values[..., 1]
    region = as_patch(patch) or Patch(0, 0, *plane.shape[::-1])
    if not region.fits(plane.shape):
        raise UsageError(f"--patch: leaves the frame of {plane.shape[1]} × {plane.shape[0]} pixels")
    return plane[region.slices].astype(np.float64)
