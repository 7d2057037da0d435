"""The instrument: frames in, radiance with an uncertainty out.

    import radiometer as rm

    with rm.open() as meter:
        print(meter.measure(patch=(840, 240, 120, 120)))

What stands in `__all__` is public and stays as it is within a major version; everything else may change. Nothing is
loaded before it is used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = [
    "Meter",
    "Patch",
    "Radiance",
    "Reading",
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

if TYPE_CHECKING:
    from radiometer.data import Patch, Reading
    from radiometer.interface import (
        Meter,
        Radiance,
        Reconciliation,
        Response,
        Sensor,
        Stack,
        characterise,
        merge,
        open,
        read,
        read_photographs,
        reconcile,
        recover_response,
    )


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'radiometer' has no attribute {name!r}; it has {', '.join(__all__)}")
    home = "radiometer.data" if name in ("Patch", "Reading") else "radiometer.interface"
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


class _Package(ModuleType):
    """This package; `reconcile` is its function though a folder of the same name lies in it."""

    @property
    def reconcile(self) -> Any:
        return __getattr__("reconcile")

    @reconcile.setter
    def reconcile(self, room: ModuleType) -> None:
        """Leave the function in place when the folder is imported: `from radiometer.reconcile import …` finds it."""


sys.modules[__name__].__class__ = _Package
