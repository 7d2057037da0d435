"""Known properties of a light-emitting diode, and the report on its flux."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from radiometer.data import Flag, Quantity


@dataclass(frozen=True, slots=True)
class Emitter:
    """What the datasheet and a ruler say of the diode; all but the half angle may be unknown."""

    half_angle: Quantity  # angle in ° at which its intensity is one half, with standard uncertainty
    diameter_mm: Quantity | None = None  # diameter of its emitting area
    distance_mm: Quantity | None = None  # from the emitting area to the lens's entrance pupil
    reference_w: float | None = None  # flux that the datasheet states


@dataclass(frozen=True, slots=True)
class Correction:
    """One step from the thesis's figure to the emitted flux."""

    name: str  # what is put right
    flux: Quantity  # flux after it in W
    share: float  # part of the gap between the first figure and the reference that it closes
    note: str = ""  # where its figures come from


@dataclass(frozen=True, slots=True)
class FluxReport:
    """Flux by the thesis's formula, and the emitted flux."""

    thesis: Quantity  # formula (2.13) on one frame, in W
    thesis_exposure_s: float  # exposure of that frame
    thesis_left_out: float  # share of its pixels that the formula leaves out
    on_sensor: Quantity  # flux of the source through the sensor, background taken off
    corrections: tuple[Correction, ...]  # the steps, in order
    emitted: dict[str, Quantity]  # emitted flux by each way that the given figures allow, by name
    reference_w: float | None  # what the datasheet states; None where unknown
    assumptions: tuple[str, ...]  # what was assumed
    clipped_everywhere: int = 0  # pixels that clip even in the shortest exposure; above 0 every flux is a lower bound
    is_cut: bool = False  # whether the source goes on beyond the edge of the picture, or of the region

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
    def warnings(self) -> tuple[str, ...]:
        """Return what to say of a source that is cut, and of two ways that differ by more than k = 2."""
        cut = "the source goes on beyond the edge of the picture, or of --region: its flux is larger; show all of it"
        return (*((cut,) if self.is_cut else ()), *self._contradictions())

    def _contradictions(self) -> tuple[str, ...]:
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
