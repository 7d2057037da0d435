"""The functions and results behind `import radiometer as rm`, a module for each group of commands.

Nothing is loaded before it is used: `radiometer.api.merge` is `radiometer.merge`.
"""

from __future__ import annotations

from typing import Any

import radiometer

__all__ = radiometer.__all__


def __getattr__(name: str) -> Any:
    return getattr(radiometer, name)
