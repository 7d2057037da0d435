"""Every effect of the table by the name of its class, such as `LampStep`, for tests of many of them."""

from simulators.effects.registry import EFFECTS

globals().update({kind.__name__: kind for kind in EFFECTS.values()})
