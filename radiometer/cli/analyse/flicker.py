"""`radiometer flicker`: modulation depth, flicker index, SVM and PstLM of a light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from radiometer.cli.console import show_remarks, show_table
from radiometer.cli.function import command_of
from radiometer.cli.options import BenchOption, CameraOption, time_option

if TYPE_CHECKING:
    from radiometer import FlickerReport


def _show(found: FlickerReport) -> None:
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


command = command_of(
    "flicker", _show, results=("plot",), source=typer.Argument(), camera=CameraOption, bench=BenchOption,
    row_time=time_option("--row-time"),
)  # fmt: skip
