"""The table of commands: a new command is one module and one line here.

Each module is imported only when its command runs (or its own help is asked for), so that
`radiometer --help` stays fast. The module holds `app`, a Typer application (several commands) or
`command`, a function with Typer parameters (one command).
"""

from __future__ import annotations

from typing import Final, NamedTuple

COMPLETING: Final = "_RADIOMETER_COMPLETE"  # variable by which a shell asks for the words that may follow


class CommandEntry(NamedTuple):
    """One line of the table: module to import and the line shown in the overview."""

    module: str
    summary: str


COMMANDS: Final[dict[str, CommandEntry]] = {
    "measure": CommandEntry("radiometer.cli.capture.measure", "Read the radiance of a patch, with its uncertainty."),
    "bracket": CommandEntry("radiometer.cli.capture.bracket", "Capture a set of exposures of an unmoving scene."),
    "view": CommandEntry("radiometer.cli.capture.view", "See what the camera sees, live; draw the patch."),
    "merge": CommandEntry("radiometer.cli.analyse.merge", "Merge a bracket into a picture of radiance."),
    "response": CommandEntry("radiometer.cli.calibrate.response",
                             "Recover the camera response from brackets or photographs."),
    "calibrate": CommandEntry("radiometer.cli.calibrate.calibrate", "Give a camera its absolute scale."),
    "characterise": CommandEntry("radiometer.cli.calibrate.characterise",
                                 "Find gain, noise, dark current and linearity of a camera (EMVA 1288)."),
    "quality": CommandEntry("radiometer.cli.analyse.quality",
                            "Measure the instrument's quality indices; write its datasheet."),
    "import": CommandEntry("radiometer.cli.capture.import_",
                           "Turn FITS, raw TIFF, EMVA 1288 sets and tables into capture sets."),
    "flux": CommandEntry("radiometer.cli.analyse.flux", "Find the radiant flux of a light-emitting diode."),
    "analyse": CommandEntry("radiometer.cli.analyse.analyse", "Measure regions of a radiance map."),
    "flicker": CommandEntry(
        "radiometer.cli.analyse.flicker", "Measure flicker and the stroboscopic effect of a light (SVM, PstLM)."
    ),
    "alpha-opic": CommandEntry(
        "radiometer.cli.analyse.alpha_opic", "Convert light of a known spectrum into α-opic quantities (CIE S 026)."
    ),
    "colour": CommandEntry(
        "radiometer.cli.analyse.colour", "Measure X, Y, Z, chromaticity and colour temperature with a colour camera."
    ),
    "certificate": CommandEntry(
        "radiometer.cli.calibrate.certificate", "Make a digital calibration certificate of a reading or calibration."
    ),
    "reconcile": CommandEntry("radiometer.cli.analyse.reconcile", "Find what a simulation lacks, name it and add it."),
    "log-fit": CommandEntry("radiometer.cli.analyse.log_fit",
                            "Find what a camera's log lacks, compared with a reference meter."),
    "serve": CommandEntry("radiometer.cli.serve.serve",
                          "Measure for weeks and serve readings over SCPI, HTTP and MQTT."),
    "log": CommandEntry("radiometer.cli.serve.log", "Query, export and plot the daemon's journal."),
    "light": CommandEntry("radiometer.cli.light.light",
                          "Set, pulse, blink and calibrate the light box; watch its button."),
    "screen": CommandEntry("radiometer.cli.calibrate.screen",
                           "Calibrate a screen as a light source, and use the calibration."),
    "adapt": CommandEntry("radiometer.cli.light.adapt", "Run a dark-adaptation test and fit its curve."),
    "batch": CommandEntry("radiometer.cli.analyse.batch", "Do one job over an archive of capture sets."),
    "trend": CommandEntry("radiometer.cli.analyse.trend", "Find drift over months in a table of results."),
    "passport": CommandEntry("radiometer.cli.analyse.passport",
                             "Compare a camera's sessions over years: what changed."),
    "simulate": CommandEntry("radiometer.cli.serve.simulate", "Serve a simulated device as if it were a real one."),
    "devices": CommandEntry("radiometer.cli.admin.devices", "List the cameras and boxes that can be opened."),
    "doctor": CommandEntry("radiometer.cli.admin.doctor",
                           "Check computer and camera, and say how to cure what is wrong."),
    "new-bench": CommandEntry("radiometer.cli.admin.new_bench", "Ask five questions and write a bench file."),
    "completion": CommandEntry("radiometer.cli.admin.completion",
                               "Print what makes a shell complete commands and options."),
    "man": CommandEntry("radiometer.cli.admin.man", "Print the manual page."),
}  # fmt: skip
