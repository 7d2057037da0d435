"""`radiometer screen import`: a calibration by what other programs have measured."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated

import typer

from radiometer.cli.console import console, note, significant
from radiometer.cli.outputs import writes


def register(app: typer.Typer) -> None:
    """Add the command to `radiometer screen`."""
    app.command("import")(import_command)


@writes("out")
def import_command(
    file: Annotated[Path, typer.Argument(help="ArgyllCMS .ti3 or .cal, pacsdisplay uLR, or a table: level, cd/m².")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write.")] = Path("screen.yaml"),
    name: Annotated[str | None, typer.Option(help="What the screen is called; as the file says by default.")] = None,
    white: Annotated[str, typer.Option(help="Spectrum assumed for grey: white_led, cie_d65, a CSV …")] = "white_led",
    primaries: Annotated[
        str | None, typer.Option(help="Spectra of red, green, blue: led_lcd, ccfl_lcd, oled, crt, or a CSV of them.")
    ] = None,
    meter_u_rel: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Relative standard uncertainty of the meter's scale.")
    ] = 0.04,
    white_luminance: Annotated[
        float | None, typer.Option(min=1e-6, help="Luminance of white in cd/m², which a .cal does not hold.")
    ] = None,
    gamma: Annotated[float, typer.Option(min=0.1, max=10.0, help="Exponent that a .cal was made for.")] = 2.2,
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map", help="Column of a table and its unit: level=drive:8bit, luminance=Y:cd/m2; or a YAML file."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Report as one JSON object on standard output.")] = False,
) -> None:
    """Make a screen calibration of measurements made elsewhere, with their uncertainty."""
    from dataclasses import replace

    from radiometer.bench.screen import lights
    from radiometer.data.statements import StatementMap
    from radiometer.screen.calibration import LUMINANCE
    from radiometer.screen.measured_elsewhere import imported, read_screen_readings

    readings = read_screen_readings(file, white_luminance, gamma, StatementMap.parse(mapped or ()))
    if name is not None:
        readings = replace(readings, name=name)
    found = imported(readings, lights(white, primaries), meter_u_rel, file.name)
    found.write(out)
    if json:
        report = {"taken": list(readings.taken), "doubts": list(readings.doubts)}
        print(json_module.dumps({"file": str(out), **report, **found.to_mapping()}, allow_nan=False))
        return
    for line in readings.taken:
        note(f"taken: {line}")
    for line in readings.doubts:
        note(f"doubt: {line}")
    left_out = sorted(set(readings.primaries) - set(found.channels))
    if left_out:
        note(f"{', '.join(left_out)} left out: their spectra are not known; --primaries names a display type or a CSV")
    for curve in found.channels.values():
        white_cd, black_cd = (curve.at(curve.levels[i], LUMINANCE) for i in (-1, 0))
        console().print(
            f"{curve.name}: {len(curve.levels)} levels, {significant(black_cd.value, black_cd.u)} to "
            f"{significant(white_cd.value, white_cd.u)} ± {2 * white_cd.u:.2g} cd·m⁻² (k = 2)"
        )
    for assumption in found.provenance.assumptions:
        console().print(f"assumed    {assumption}")
    console().print(f"wrote {out}")
