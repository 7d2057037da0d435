"""A simulated subject before a simulated light box."""

from __future__ import annotations

import numpy as np

from radiometer.bench.boxes import LightBoxConfig
from simulators.light_box.box import SimulatedLightBox
from simulators.observers.behaviours import behaviour_of
from simulators.observers.observer import Observer
from simulators.observers.observer_at_box import ObserverAtBox


def places_of(preset: LightBoxConfig) -> dict[str, tuple[float, float]]:
    """Return the places of the channels with separate openings, in degrees temporal of and above the mark."""
    known = preset.channels
    return {name: (c.place.temporal_deg, -c.place.below_deg) for name, c in known.items() if c.place is not None}


def seat_subject(twin: SimulatedLightBox, behaviour: str, seed: int, filter_density: float) -> ObserverAtBox:
    """Seat a simulated subject before a simulated box and return it.

    Args:
        behaviour: Name of a behaviour of `simulators.observers.behaviours`.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    chosen, rng = behaviour_of(behaviour), np.random.default_rng(seed)
    subject = ObserverAtBox(
        Observer(chosen.eye(rng), chosen.habits, rng),
        twin,
        filter_density=filter_density,
        leaves_after_min=chosen.leaves_after_min,
        taps=chosen.taps,
    )
    subject.sit_down()
    return subject
