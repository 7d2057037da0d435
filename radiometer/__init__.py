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

# Where each public name is defined; a new one stands here and in the list below for type checkers. The daemon's are not
# in that list: the daemon builds on what this package lists, and a type checker would go round in a circle.
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
    "radiometer.daemon.serving": ("serve",),
    "radiometer.errors": (
        "CalibrationError", "CaptureError", "ConfigurationError", "DamagedFileError", "DeviceError", "DeviceInUse",
        "DeviceLost", "DeviceNotFound", "DeviceTimeout", "InputError", "LightEnded", "MeasurementError",
        "MissingLibrary", "OutputError", "RadiometerError", "SettingOutOfRange", "UnsafeStimulus", "UnsettledError",
        "UsageError",
    ),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)

if TYPE_CHECKING:
    from radiometer.api.adapt import AdaptationCurve as AdaptationCurve
    from radiometer.api.adapt import AdaptationRun as AdaptationRun
    from radiometer.api.adapt import Bleach as Bleach
    from radiometer.api.adapt import Instructions as Instructions
    from radiometer.api.adapt import Protocols as Protocols
    from radiometer.api.adapt import Retest as Retest
    from radiometer.api.adapt import Visits as Visits
    from radiometer.api.adapt import adapt_bleach as adapt_bleach
    from radiometer.api.adapt import adapt_fit as adapt_fit
    from radiometer.api.adapt import adapt_instructions as adapt_instructions
    from radiometer.api.adapt import adapt_protocols as adapt_protocols
    from radiometer.api.adapt import adapt_retest as adapt_retest
    from radiometer.api.adapt import adapt_run as adapt_run
    from radiometer.api.adapt import adapt_visits as adapt_visits
    from radiometer.api.alpha_opic import AlphaOpicQuantities as AlphaOpicQuantities
    from radiometer.api.alpha_opic import alpha_opic as alpha_opic
    from radiometer.api.analyse import MapAnalysis as MapAnalysis
    from radiometer.api.analyse import analyse as analyse
    from radiometer.api.archive import Batch as Batch
    from radiometer.api.archive import Passports as Passports
    from radiometer.api.archive import Trends as Trends
    from radiometer.api.archive import batch as batch
    from radiometer.api.archive import passport as passport
    from radiometer.api.archive import trend as trend
    from radiometer.api.calibration import Calibrated as Calibrated
    from radiometer.api.calibration import calibrate as calibrate
    from radiometer.api.capture import BracketReport as BracketReport
    from radiometer.api.capture import bracket as bracket
    from radiometer.api.certificate import Certificate as Certificate
    from radiometer.api.certificate import certificate as certificate
    from radiometer.api.colour import CalibratedColour as CalibratedColour
    from radiometer.api.colour import ColourReading as ColourReading
    from radiometer.api.colour import colour_calibrate as colour_calibrate
    from radiometer.api.colour import colour_measure as colour_measure
    from radiometer.api.devices import Devices as Devices
    from radiometer.api.devices import Diagnosis as Diagnosis
    from radiometer.api.devices import doctor as doctor
    from radiometer.api.devices import list_devices as list_devices
    from radiometer.api.devices import new_bench as new_bench
    from radiometer.api.devices import simulate_box as simulate_box
    from radiometer.api.devices import simulate_camera as simulate_camera
    from radiometer.api.files import Stack as Stack
    from radiometer.api.files import read as read
    from radiometer.api.files import read_photographs as read_photographs
    from radiometer.api.flicker import FlickerReport as FlickerReport
    from radiometer.api.flicker import flicker as flicker
    from radiometer.api.importing import Imported as Imported
    from radiometer.api.importing import import_capture as import_capture
    from radiometer.api.led_flux import Flux as Flux
    from radiometer.api.led_flux import flux as flux
    from radiometer.api.light import BoxStatus as BoxStatus
    from radiometer.api.light import ButtonPress as ButtonPress
    from radiometer.api.light import CalibratedBox as CalibratedBox
    from radiometer.api.light import Darkness as Darkness
    from radiometer.api.light import EngineLaws as EngineLaws
    from radiometer.api.light import ExposureAccount as ExposureAccount
    from radiometer.api.light import LitChannel as LitChannel
    from radiometer.api.light import light_account as light_account
    from radiometer.api.light import light_blink as light_blink
    from radiometer.api.light import light_calibrate as light_calibrate
    from radiometer.api.light import light_law as light_law
    from radiometer.api.light import light_off as light_off
    from radiometer.api.light import light_pulse as light_pulse
    from radiometer.api.light import light_set as light_set
    from radiometer.api.light import light_status as light_status
    from radiometer.api.light import light_watch_buttons as light_watch_buttons
    from radiometer.api.logs import LogFinding as LogFinding
    from radiometer.api.logs import log_fit as log_fit
    from radiometer.api.meter import Meter as Meter
    from radiometer.api.meter import open as open
    from radiometer.api.photographs import measure_photographs as measure_photographs
    from radiometer.api.quality import QualityPlan as QualityPlan
    from radiometer.api.quality import QualityReport as QualityReport
    from radiometer.api.quality import quality_plan as quality_plan
    from radiometer.api.quality import quality_report as quality_report
    from radiometer.api.quality import quality_take as quality_take
    from radiometer.api.radiance import Radiance as Radiance
    from radiometer.api.radiance import merge as merge
    from radiometer.api.reading import measure as measure
    from radiometer.api.reading import readings as readings
    from radiometer.api.response import Response as Response
    from radiometer.api.response import recover_response as recover_response
    from radiometer.api.results import Reconciliation as Reconciliation
    from radiometer.api.results import Separability as Separability
    from radiometer.api.results import reconcile as reconcile
    from radiometer.api.results import reconcile_plan as reconcile_plan
    from radiometer.api.screen import CalibratedScreen as CalibratedScreen
    from radiometer.api.screen import ScreenLevel as ScreenLevel
    from radiometer.api.screen import VerifiedScreen as VerifiedScreen
    from radiometer.api.screen import screen_calibrate as screen_calibrate
    from radiometer.api.screen import screen_export as screen_export
    from radiometer.api.screen import screen_import as screen_import
    from radiometer.api.screen import screen_level as screen_level
    from radiometer.api.screen import screen_verify as screen_verify
    from radiometer.api.screen_report import DisplayReport as DisplayReport
    from radiometer.api.screen_report import screen_report as screen_report
    from radiometer.api.sensor import Sensor as Sensor
    from radiometer.api.sensor import characterise as characterise
    from radiometer.api.view import view as view
    from radiometer.data.reading import Patch as Patch
    from radiometer.data.reading import Reading as Reading
    from radiometer.errors import CalibrationError as CalibrationError
    from radiometer.errors import CaptureError as CaptureError
    from radiometer.errors import ConfigurationError as ConfigurationError
    from radiometer.errors import DamagedFileError as DamagedFileError
    from radiometer.errors import DeviceError as DeviceError
    from radiometer.errors import DeviceInUse as DeviceInUse
    from radiometer.errors import DeviceLost as DeviceLost
    from radiometer.errors import DeviceNotFound as DeviceNotFound
    from radiometer.errors import DeviceTimeout as DeviceTimeout
    from radiometer.errors import InputError as InputError
    from radiometer.errors import LightEnded as LightEnded
    from radiometer.errors import MeasurementError as MeasurementError
    from radiometer.errors import MissingLibrary as MissingLibrary
    from radiometer.errors import OutputError as OutputError
    from radiometer.errors import RadiometerError as RadiometerError
    from radiometer.errors import SettingOutOfRange as SettingOutOfRange
    from radiometer.errors import UnsafeStimulus as UnsafeStimulus
    from radiometer.errors import UnsettledError as UnsettledError
    from radiometer.errors import UsageError as UsageError


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
