"""A simulated subject before a simulated light box."""

from __future__ import annotations

import numpy as np

from radiometer.bench.boxes import LightBoxConfig
from radiometer.errors import UsageError
from simulators.light_box.box import LightBoxTwin
from simulators.observers.eye_kinetics import Eye, drawn_amd_eye, drawn_clinical_eye
from simulators.observers.observer import Habits, Observer
from simulators.observers.observer_at_box import ObserverAtBox


def places_of(preset: LightBoxConfig) -> dict[str, tuple[float, float]]:
    """Return the places of the channels with separate openings, in degrees temporal of and above the mark."""
    known = preset.channels
    return {name: (c.place.temporal_deg, -c.place.below_deg) for name, c in known.items() if c.place is not None}


def seat_subject(twin: LightBoxTwin, behaviour: str, seed: int, filter_density: float) -> ObserverAtBox:
    """Seat a simulated subject before a simulated box and return it.

    Args:
        behaviour: "steady", "never" (presses), "always" (presses), "leaves" (after 10 min), "wanders" (looks away in
            two blinks of five); "healthy" and "amd" have eyes drawn from published rod intercepts.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    habits = {
        "steady": Habits(),
        "never": Habits(lapses=1.0, false_alarms=0.0),
        "always": Habits(),
        "leaves": Habits(),
        "wanders": Habits(fixation_losses=0.4),
        "healthy": Habits(),
        "amd": Habits(),
    }
    if behaviour not in habits:
        raise UsageError(f"simulated subject {behaviour!r}: choose {', '.join(habits)}")
    rng = np.random.default_rng(seed)
    drawn = {"healthy": drawn_clinical_eye, "amd": drawn_amd_eye}.get(behaviour)
    subject = ObserverAtBox(
        Observer(drawn(rng) if drawn else Eye(), habits[behaviour], rng),
        twin,
        filter_density=filter_density,
        leaves_after_min=10.0 if behaviour == "leaves" else float("inf"),
        taps=behaviour == "always",
    )
    subject.sit_down()
    return subject
