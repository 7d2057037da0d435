"""Known properties of a light-emitting diode, and the report on its flux."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from radiometer.data import Flag, Quantity


@dataclass(frozen=True, slots=True)
class Emitter:
    """What the datasheet and a ruler say of the diode; all but the half angle may be unknown.

    Attributes:
        half_angle: Angle in ° at which its intensity is one half, with standard uncertainty.
        diameter_mm: Diameter of its emitting area.
        distance_mm: From the emitting area to the lens's entrance pupil.
        reference_w: Flux that the datasheet states.
    """

    half_angle: Quantity
    diameter_mm: Quantity | None = None
    distance_mm: Quantity | None = None
    reference_w: float | None = None


@dataclass(frozen=True, slots=True)
class Correction:
    """One step from the thesis's figure to the emitted flux.

    Attributes:
        name: What is put right.
        flux: Flux after it in W.
        share: Part of the gap between the first figure and the reference that it closes.
        note: Where its figures come from.
    """

    name: str
    flux: Quantity
    share: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class FluxReport:
    """Flux by the thesis's formula, and the emitted flux.

    Attributes:
        thesis: Formula (2.13) on one frame, in W.
        thesis_exposure_s: Exposure of that frame.
        thesis_left_out: Share of its pixels that the formula leaves out.
        on_sensor: Flux of the source through the sensor, background taken off.
        corrections: The steps, in order.
        emitted: Emitted flux by each way that the given figures allow, by name.
        reference_w: What the datasheet states; None where unknown.
        assumptions: What was assumed.
        clipped_everywhere: Pixels that clip even in the shortest exposure; above 0 every flux is a lower bound.
    """

    thesis: Quantity
    thesis_exposure_s: float
    thesis_left_out: float
    on_sensor: Quantity
    corrections: tuple[Correction, ...]
    emitted: dict[str, Quantity]
    reference_w: float | None
    assumptions: tuple[str, ...]
    clipped_everywhere: int = 0

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Return `saturated` where the figures are lower bounds."""
        return (Flag.SATURATED,) if self.clipped_everywhere else ()

    @property
    def result(self) -> Quantity:
        """Return the emitted flux by the best way at hand, else the flux on the sensor."""
        for name in ("fraction_through_pupil", "radiance_times_area"):
            if name in self.emitted:
                return self.emitted[name]
        return self.on_sensor

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Return what to say of two ways whose fluxes differ by more than k = 2 of both together, a sentence each."""
        if len(self.emitted) < 2:
            return ()
        (first, one), (second, other) = self.emitted.items()
        if abs(one.value - other.value) <= 2.0 * math.hypot(one.u, other.u):
            return ()
        names = [name.replace("_", " ") for name in (first, second)]
        return (
            f"the two ways contradict each other: {names[0]} gives {1e3 * one.value:.3g} mW, {names[1]} "
            f"{1e3 * other.value:.3g} mW, further apart than their uncertainties allow; at most one is right: check "
            "--half-angle, --distance and --diameter, and that the picture of the diode is sharp",
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the report as plain JSON."""
        return {
            "thesis_2_13": self.thesis.to_mapping()
            | {"exposure_s": self.thesis_exposure_s, "left_out": self.thesis_left_out},
            "on_sensor": self.on_sensor.to_mapping(),
            "corrections": [
                {"name": c.name, "flux": c.flux.to_mapping(), "share_of_gap": c.share, "note": c.note}
                for c in self.corrections
            ],
            "emitted": {name: q.to_mapping() for name, q in self.emitted.items()},
            "result": self.result.to_mapping(),
            "reference_W": self.reference_w,
            "flags": [str(flag) for flag in self.flags],
            "clipped_everywhere": self.clipped_everywhere,
            "assumptions": list(self.assumptions),
        }
