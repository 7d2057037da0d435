"""The former name of `radiometer.adapters`; it goes away in version 0.3."""

import warnings

from radiometer import adapters

warnings.warn("radiometer.interop is now radiometer.adapters", DeprecationWarning, stacklevel=2)
__path__ = adapters.__path__
