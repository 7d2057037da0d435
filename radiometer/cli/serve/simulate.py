"""`radiometer simulate`: simulated devices, served as if they were real."""

from __future__ import annotations

import typer

from radiometer.cli.serve import simulate_box, simulate_camera

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Serve a simulated device.",
)
app.command("camera")(simulate_camera.command)
app.command("box")(simulate_box.command)
