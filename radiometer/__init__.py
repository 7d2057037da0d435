"""The instrument: frames in, radiance with an uncertainty out.

    import radiometer as rm

    with rm.open() as meter:
        print(meter.measure(patch=(840, 240, 120, 120)))

What stands in `__all__` is public and stays as it is within a major version; everything else may change. Nothing is
loaded before it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Calibrated",
    "Flux",
    "Meter",
    "Patch",
    "Radiance",
    "Reading",
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

if TYPE_CHECKING:
    from radiometer.api import (
        Calibrated,
        Flux,
        Meter,
        Radiance,
        Reconciliation,
        Response,
        Sensor,
        Separability,
        Stack,
        calibrate,
        characterise,
        flux,
        measure_photographs,
        merge,
        open,
        read,
        read_photographs,
        reconcile,
        reconcile_plan,
        recover_response,
    )
    from radiometer.data import Patch, Reading


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'radiometer' has no attribute {name!r}; it has {', '.join(__all__)}")
    home = "radiometer.data" if name in ("Patch", "Reading") else "radiometer.api"
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
