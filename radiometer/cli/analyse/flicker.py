"""`radiometer flicker`: modulation depth, flicker index, SVM and PstLM of a light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_exposure, parse_patch, parse_seconds
from radiometer.cli.console import note, show_remarks, show_table
from radiometer.cli.options import BenchOption, CameraOption, JsonOption
from radiometer.cli.outputs import writes


@writes("plot")
def command(
    source: Annotated[
        Path | None,
        typer.Argument(help="Table of time and light (CSV), or a frame of a rolling-shutter camera (TIFF, raw)."),
    ] = None,
    camera: CameraOption = None,
    bench: BenchOption = None,
    duration: Annotated[float, typer.Option(help="Of a camera: length of the series in s.")] = 1.0,
    dark: Annotated[float | None, typer.Option(help="Of a table: value of the light in darkness.")] = None,
    u_dark: Annotated[float, typer.Option(min=0.0, help="Standard uncertainty of --dark or --black-level.")] = 0.0,
    mapped: Annotated[
        list[str] | None, typer.Option("--map", help="Of a table: its columns, such as timestamp=T:ms and number=CH1.")
    ] = None,
    row_time: Annotated[
        str | None, typer.Option(metavar="S", help="Of a frame: time between the starts of two rows, such as 18.9us.")
    ] = None,
    known_frequency: Annotated[
        float | None, typer.Option(min=0.0, help="Of a frame: frequency of the light in Hz, to find the row time.")
    ] = None,
    exposure: Annotated[
        str | None, typer.Option(metavar="S", help="Exposure time of a frame, a sample, or a camera, such as 1/5000.")
    ] = None,
    black_level: Annotated[float | None, typer.Option(min=0.0, help="Of a frame: black level in DN.")] = None,
    flat: Annotated[
        Path | None, typer.Option(help="Of a frame: frame of the same field under steady light, for the fall-off.")
    ] = None,
    patch: Annotated[str | None, typer.Option(help="Of a frame or a camera: region X,Y,W,H of an even field.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw some periods into this PNG, PDF or SVG file.")] = None,
    json: JsonOption = False,
) -> None:
    """Measure flicker and the stroboscopic effect of a light, each figure with its uncertainty.

    Gives the dominant frequency, modulation depth, flicker index, SVM (IEC TR 63158) and PstLM (IEC TR 61547-1).
    """
    found = rm.flicker(
        source, camera=camera, bench=bench, duration=duration, dark=dark, u_dark=u_dark, mapped=mapped or (),
        row_time=parse_seconds(row_time, "--row-time"), known_frequency=known_frequency,
        exposure=parse_exposure(exposure, "--exposure"), black_level=black_level, flat=flat, patch=parse_patch(patch),
        notice=note,
    )  # fmt: skip
    if plot is not None:
        found.write_plot(plot)
        note(f"drawn into {plot}")
    if json:
        print(found.to_json())
        return
    measures, k = found.measures, found.measures.coverage_factor
    rows = {
        "dominant frequency": measures.frequency,
        "modulation depth": measures.modulation_depth.scaled(100.0, "%"),
        "flicker index": measures.flicker_index,
        "SVM": measures.svm,
        "PstLM": measures.pst_lm,
    }
    if found.row_time is not None:
        rows["row time"] = found.row_time.scaled(1e6, "us")
    show_table(
        f"{found.waveform.origin}: {1e3 * found.waveform.duration_s:.4g} ms",
        ("measure", f"value (k = {k:.3g})"),
        [(name, "not determined" if one is None else one.text(k)) for name, one in rows.items()],
    )
    show_remarks(measures.assumptions, warnings=measures.warnings)
