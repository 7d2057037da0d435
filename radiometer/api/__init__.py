"""What a notebook or another program uses: the names of `import radiometer as rm`."""

from radiometer.api.files import Stack, read, read_photographs
from radiometer.api.meter import Meter, open
from radiometer.api.radiance import Radiance, merge
from radiometer.api.response import Response, recover_response
from radiometer.api.results import Reconciliation, Sensor, characterise, reconcile

__all__ = [
    "Meter",
    "Radiance",
    "Reconciliation",
    "Response",
    "Sensor",
    "Stack",
    "characterise",
    "merge",
    "open",
    "read",
    "read_photographs",
    "reconcile",
    "recover_response",
]
