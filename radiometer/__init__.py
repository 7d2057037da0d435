"""The instrument: frames in, radiance with an uncertainty out.

    import radiometer as rm

    with rm.open() as meter:
        print(meter.measure(patch=(840, 240, 120, 120)))

Every name in `__all__` is public and stays as it is within a major version; everything else may change. Every command
of the command line is one function here, with the same arguments. Nothing is loaded before it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

# Where each public name is defined; a new module stands in the list below for type checkers, too. The daemon's do not:
# the daemon builds on what this package lists, and a type checker would go round in a circle.
_HOMES = {
    "radiometer.api.adapt": (
        "AdaptationCurve", "AdaptationRun", "Bleach", "Instructions", "Protocols", "Retest", "Visits", "adapt_bleach",
        "adapt_fit", "adapt_instructions", "adapt_protocols", "adapt_retest", "adapt_run", "adapt_visits",
    ),
    "radiometer.api.alpha_opic": ("AlphaOpicQuantities", "alpha_opic"),
    "radiometer.api.analyse": ("MapAnalysis", "analyse"),
    "radiometer.api.archive": ("Batch", "Passports", "Trends", "batch", "passport", "trend"),
    "radiometer.api.capture": ("BracketReport", "bracket"),
    "radiometer.api.colour": ("CalibratedColour", "ColourReading", "colour_calibrate", "colour_measure"),
    "radiometer.api.devices": (
        "Devices", "Diagnosis", "list_devices", "doctor", "new_bench", "simulate_box", "simulate_camera",
    ),
    "radiometer.api.certificate": ("Certificate", "certificate"),
    "radiometer.api.files": ("Stack", "read", "read_photographs"),
    "radiometer.api.flicker": ("FlickerReport", "flicker"),
    "radiometer.api.importing": ("Imported", "import_capture"),
    "radiometer.api.light": (
        "BoxStatus", "ButtonPress", "CalibratedBox", "Darkness", "EngineLaws", "ExposureAccount", "LitChannel",
        "light_account", "light_blink", "light_calibrate", "light_law", "light_off", "light_pulse", "light_set",
        "light_status", "light_watch_buttons",
    ),
    "radiometer.api.logs": ("LogFinding", "log_fit"),
    "radiometer.api.reading": ("measure", "readings"),
    "radiometer.api.meter": ("Meter", "open"),
    "radiometer.api.quality": ("QualityPlan", "QualityReport", "quality_plan", "quality_report", "quality_take"),
    "radiometer.api.radiance": ("Radiance", "merge"),
    "radiometer.api.response": ("Response", "recover_response"),
    "radiometer.api.results": ("Reconciliation", "Separability", "reconcile", "reconcile_plan"),
    "radiometer.api.calibration": ("Calibrated", "calibrate"),
    "radiometer.api.led_flux": ("Flux", "flux"),
    "radiometer.api.photographs": ("measure_photographs",),
    "radiometer.api.screen": (
        "CalibratedScreen", "ScreenLevel", "VerifiedScreen", "screen_calibrate", "screen_export", "screen_import",
        "screen_level", "screen_verify",
    ),
    "radiometer.api.screen_report": ("DisplayReport", "screen_report"),
    "radiometer.api.view": ("view",),
    "radiometer.api.sensor": ("Sensor", "characterise"),
    "radiometer.data.reading": ("Patch", "Reading"),
    "radiometer.daemon.log": ("LoggedReadings", "log", "log_budget", "log_events"),
    "radiometer.daemon.service": ("serve",),
    "radiometer.errors": (
        "CalibrationError", "CaptureError", "ConfigurationError", "DamagedFileError", "DeviceError", "DeviceInUse",
        "DeviceLost", "DeviceNotFound", "DeviceTimeout", "InputError", "LightEnded", "MeasurementError",
        "MissingLibrary", "OutputError", "RadiometerError", "SettingOutOfRange", "UnsafeStimulus", "UnsettledError",
        "UsageError",
    ),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)

if TYPE_CHECKING:  # a type checker takes of each module what it defines
    from radiometer.api.adapt import *  # noqa: F403
    from radiometer.api.alpha_opic import *  # noqa: F403
    from radiometer.api.analyse import *  # noqa: F403
    from radiometer.api.archive import *  # noqa: F403
    from radiometer.api.calibration import *  # noqa: F403
    from radiometer.api.capture import *  # noqa: F403
    from radiometer.api.certificate import *  # noqa: F403
    from radiometer.api.colour import *  # noqa: F403
    from radiometer.api.devices import *  # noqa: F403
    from radiometer.api.files import *  # noqa: F403
    from radiometer.api.flicker import *  # noqa: F403
    from radiometer.api.importing import *  # noqa: F403
    from radiometer.api.led_flux import *  # noqa: F403
    from radiometer.api.light import *  # noqa: F403
    from radiometer.api.logs import *  # noqa: F403
    from radiometer.api.meter import *  # noqa: F403
    from radiometer.api.photographs import *  # noqa: F403
    from radiometer.api.quality import *  # noqa: F403
    from radiometer.api.radiance import *  # noqa: F403
    from radiometer.api.reading import *  # noqa: F403
    from radiometer.api.response import *  # noqa: F403
    from radiometer.api.results import *  # noqa: F403
    from radiometer.api.screen import *  # noqa: F403
    from radiometer.api.screen_report import *  # noqa: F403
    from radiometer.api.sensor import *  # noqa: F403
    from radiometer.api.view import *  # noqa: F403
    from radiometer.data.reading import *  # noqa: F403
    from radiometer.errors import *  # noqa: F403


def home_of(name: str) -> str:
    """Return the module in which a public name is defined."""
    return _HOME_OF[name]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        import difflib

        close = difflib.get_close_matches(name.lower(), __all__, 1)
        hint = f"did you mean {close[0]!r}?" if close else "dir(radiometer) lists the names"
        raise AttributeError(f"module 'radiometer' has no attribute {name!r}; {hint}")
    found = getattr(importlib.import_module(_HOME_OF[name]), name)
    if not isinstance(found, type):
        from radiometer.argument_types import checked

        found = checked(found)
        found.__module__ = __name__  # where another process finds it by its name
    return globals().setdefault(name, found)  # the same object each time


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
