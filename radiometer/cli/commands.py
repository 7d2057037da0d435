"""The table of commands: a new command is one module and one line here.

Each module is imported only when its command runs (or its own help is asked for), so that
`radiometer --help` stays fast. The module holds `app`, a Typer application (several commands) or
`command`, a function with Typer parameters (one command).
"""

from __future__ import annotations

from typing import Final, NamedTuple


class CommandEntry(NamedTuple):
    """One line of the table: module to import and the line shown in the overview."""

    module: str
    summary: str


COMMANDS: Final[dict[str, CommandEntry]] = {
    "measure": CommandEntry("radiometer.cli.measure", "Read the radiance of a patch, with its uncertainty."),
    "bracket": CommandEntry("radiometer.cli.bracket", "Capture a set of exposures of an unmoving scene."),
    "merge": CommandEntry("radiometer.cli.merge", "Merge a bracket into a picture of radiance."),
    "response": CommandEntry("radiometer.cli.response", "Recover the camera response from brackets or photographs."),
    "calibrate": CommandEntry("radiometer.cli.calibrate", "Give a camera its absolute scale."),
    "characterise": CommandEntry(
        "radiometer.cli.characterise", "Find gain, noise, dark current and linearity of a camera (EMVA 1288)."
    ),
    "quality": CommandEntry("radiometer.cli.quality", "Measure the instrument's quality indices; write its datasheet."),
    "import": CommandEntry(
        "radiometer.cli.import_", "Turn FITS, raw TIFF, EMVA 1288 sets and tables into capture sets."
    ),
    "flux": CommandEntry("radiometer.cli.flux", "Find the radiant flux of a light-emitting diode."),
    "reconcile": CommandEntry("radiometer.cli.reconcile", "Find what a simulation lacks, name it and add it."),
    "log-fit": CommandEntry("radiometer.cli.log_fit", "Find what a camera's log lacks beside a reference meter."),
    "serve": CommandEntry("radiometer.cli.serve", "Measure for weeks and serve readings over SCPI, HTTP and MQTT."),
    "log": CommandEntry("radiometer.cli.log", "Query, export and plot the daemon's journal."),
    "light": CommandEntry("radiometer.cli.light", "Set, pulse, blink and calibrate the light box; watch its button."),
    "screen": CommandEntry("radiometer.cli.screen", "Calibrate a screen as a light source, and use the calibration."),
    "adapt": CommandEntry("radiometer.cli.adapt", "Run a dark-adaptation test and fit its curve."),
    "batch": CommandEntry("radiometer.cli.batch", "Do one job over an archive of capture sets."),
    "trend": CommandEntry("radiometer.cli.trend", "Find drift over months in a table of results."),
    "passport": CommandEntry("radiometer.cli.passport", "Compare a camera's sessions over years: what changed."),
    "simulate": CommandEntry("radiometer.cli.simulate", "Serve a simulated device as if it were a real one."),
    "devices": CommandEntry("radiometer.cli.devices", "List the cameras and boxes that can be opened."),
    "doctor": CommandEntry("radiometer.cli.doctor", "Check computer and camera, and say how to cure what is wrong."),
    "new-bench": CommandEntry("radiometer.cli.new_bench", "Ask five questions and write a bench file."),
    "completion": CommandEntry("radiometer.cli.completion", "Print what makes a shell complete commands and options."),
    "man": CommandEntry("radiometer.cli.man", "Print the manual page."),
}
