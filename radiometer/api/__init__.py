"""What a notebook or another program uses: the names of `import radiometer as rm`."""

from radiometer.api.calibration import Calibrated, calibrate
from radiometer.api.files import Stack, read, read_photographs
from radiometer.api.led_flux import Flux, flux
from radiometer.api.meter import Meter, open
from radiometer.api.photographs import measure_photographs
from radiometer.api.radiance import Radiance, merge
from radiometer.api.response import Response, recover_response
from radiometer.api.results import Reconciliation, Sensor, Separability, characterise, reconcile, reconcile_plan

__all__ = [
    "Calibrated",
    "Flux",
    "Meter",
    "Radiance",
    "Reconciliation",
    "Response",
    "Sensor",
    "Separability",
    "Stack",
    "calibrate",
    "characterise",
    "flux",
    "measure_photographs",
    "merge",
    "open",
    "read",
    "read_photographs",
    "reconcile",
    "reconcile_plan",
    "recover_response",
]
