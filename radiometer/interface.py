"""The former name of `radiometer.api`; it goes away in version 0.3."""

import warnings

from radiometer.api import *  # noqa: F403

warnings.warn("radiometer.interface is now radiometer.api", DeprecationWarning, stacklevel=2)
