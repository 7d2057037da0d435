"""What a notebook or another program uses: the names of `import radiometer as rm`."""

from radiometer.interface.files import Stack, read, read_photographs
from radiometer.interface.meter import Meter, open
from radiometer.interface.radiance import Radiance, merge
from radiometer.interface.response import Response, recover_response
from radiometer.interface.results import Reconciliation, Sensor, characterise, reconcile

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
