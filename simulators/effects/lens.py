"""The lens: radiance to irradiance, its fall-off and its stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from radiometer.errors import ConfigurationError
from simulators.effects.base import IRRADIANCE, RADIANCE, Effect, Stage, parameter
from simulators.effects.catalogue import Scaling
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class Lens(Effect):
    """Images a scene onto the sensor: E = π·τ·L·cos⁴α / (4·N²·(1 + m/p)²).

    N is the frame's f-number. With `cos4` 0 the fall-off is left out (a lens corrected for it, or a base model
    that does not hold it).

    Source: camera equation for a lens of pupil magnification p and image magnification m; cos⁴ law.
    """

    name = "lens"
    stage = Stage.OPTICS
    unit_in = RADIANCE
    unit_out = IRRADIANCE
    transmittance: float = parameter(1.0, "1", 0.01, 1.0, source="1 is a lossless lens; uncoated singlets 0.92")
    magnification: float = parameter(0.0, "1", 0.0, 10.0, source="0 is a far object")
    pupil_magnification: float = parameter(1.0, "1", 0.1, 10.0, source="1 is a symmetric lens")
    focal_length_mm: float = parameter(16.0, "mm", 0.5, 5000.0, source="engraved on the lens; sets the field angle")
    cos4: float = parameter(0.0, "1", 0.0, 1.0, source="1 for the natural fall-off, 0 for none")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        """Return irradiance in W·m⁻² for radiance in W·sr⁻¹·m⁻²."""
        return signal * self.slope(signal, context)

    def slope(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return irradiance per radiance in sr. Raises ConfigurationError where the f-number is unknown."""
        if context.f_number is None:
            raise ConfigurationError("the f-number is unknown: give lens.f_number or the frame's f_number")
        closeness = 1.0 + self.magnification / self.pupil_magnification
        on_axis = math.pi * self.transmittance / (4.0 * (context.f_number * closeness) ** 2)
        return on_axis * self._falloff(context).astype(signal.dtype) if self.cos4 else on_axis

    def _falloff(self, context: ExposureContext) -> Signal:
        """Return cos⁴α from tan α = r/(f·(1 + m/p)); 1 where `cos4` is 0."""
        closeness = 1.0 + self.magnification / self.pupil_magnification
        tangent = context.geometry.radius_um() / (1000.0 * self.focal_length_mm * closeness)
        cos4: Signal = np.square(1.0 / (1.0 + np.square(tangent)))
        return 1.0 + self.cos4 * (cos4 - 1.0)


_BENT: Final = 0.01  # k₄ from which a fit begins


@dataclass(frozen=True)
class NaturalVignetting(Scaling):
    """Weakens light off the axis: E' = E·(1 + s·ρ²)^−2·(1 − k₄·ρ⁴), ρ the field radius (1 in the corner).

    s is (half diagonal / focal length)² for the cos⁴ law; k₄ takes up what a real lens adds. The radius ρ counts from
    the stated principal point, or from the lens's real axis, (x, y) away from it in half diagonals.

    Source: cos⁴ law; ρ⁴ term after Goldman (2010).
    """

    name = "natural_vignetting"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "field_radius"
    block = "slope"
    trials = ({"strength": 0.02, "k4": 0.0}, {"strength": 0.1, "k4": 0.0}, {"strength": 0.0, "k4": 0.03})
    fitted = ("strength", "k4")
    settles = "the screen turned or shifted against the camera"
    essential = ("strength",)  # every lens has it; a fall-off towards the corners alone is cut off, not oblique
    strength: float = parameter(0.0, "1", -0.3, 3.0, source="engineering prior; refined on a real rig")
    k4: float = parameter(0.0, "1", -1.0, 1.0, source="engineering prior; refined on a real rig")

    axis_x: float = parameter(0.0, "1", -0.5, 0.5, source="lenses sit off the sensor's middle by up to a tenth")
    axis_y: float = parameter(0.0, "1", -0.5, 0.5, source="the same downwards")

    def factor(self, context: ExposureContext) -> Any:
        x, y = context.geometry.field_xy()
        rho2 = np.square(x - self.axis_x) + np.square(y - self.axis_y)
        return (1.0 + self.strength * rho2) ** -2.0 * (1.0 - self.k4 * rho2**2)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the plain law about a separate axis."""
        return (cls(0.02, 0.0, 0.01, 0.01),)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law about a separate axis, plain and with k₄."""
        if not (self.axis_x or self.axis_y):
            (plain,) = self.covers(context)
            return tuple(plain.with_parameters(strength=self.strength, k4=k4) for k4 in (0.0, self.k4 or _BENT))
        return () if self.k4 else (self.with_parameters(k4=_BENT),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: of an axis that is not the stated one its place too, and k₄ where it is not 0.

        A k₄ that was fitted is free there as well: else the parameter would cost nothing.
        """
        if not (self.axis_x or self.axis_y):
            return self.fitted
        return ("strength", *(("k4",) if self.k4 else ()), "axis_x", "axis_y")


@dataclass(frozen=True)
class MechanicalVignetting(Scaling):
    """Weakens corners at small f-numbers: E' = E·(1 − m·ρ^p·(2/N)^q), or by the pupil that the barrel leaves free.

    p is 4, or 2 where the loss begins nearer to the middle.

    With a barrel E' = E·A(2/N, b, s·ρ·(2/N)^w)·(N/2)²/π, where A is the area common to the pupil (a circle of radius
    2/N), and the barrel's opening. The opening has radius b and, seen from ρ, is displaced by s·ρ. Lengths are in
    radii of the pupil at f/2. w is 0 where the barrel stands still before the iris, above 0 where the pupil takes it
    along. Nothing is lost within a circle that grows with N.

    Source: lens barrels; vanishes one to two stops above the smallest f-number.
    """

    name = "mechanical_vignetting"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    law_along = ("field_radius", "f_number")
    trials = (
        {"strength": 0.05, "exponent": 2.0},
        {"strength": 0.05, "exponent": 4.0},
        {"strength": 0.2, "exponent": 2.0},
        {"strength": 0.05, "exponent": 2.0, "radius_power": 2.0},
    )
    fitted = ("strength", "exponent")
    varies = "f_number"
    settles = "an even field at several f-numbers"
    strength: float = parameter(0.0, "1", -1.0, 1.0, source="at f/2 in the corner")
    exponent: float = parameter(2.0, "1", 1.5, 8.0, source="how fast it vanishes when stopping down")
    radius_power: float = parameter(4.0, "1", 2.0, 6.0, source="how late it sets in towards the corner")
    barrel: float = parameter(0.0, "1", 0.0, 20.0, source="radius of the barrel's opening; 0 for the law alone")
    shift: float = parameter(0.0, "1", 0.0, 20.0, source="its displacement as seen from the corner")
    wander: float = parameter(0.0, "1", -5.0, 5.0, source="how far the displacement scales with the pupil's size")

    def factor(self, context: ExposureContext) -> Any:
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        pupil, rho = 2.0 / np.asarray(stopped), context.geometry.field_radius()
        law = np.maximum(1.0 - self.strength * rho**self.radius_power * pupil**self.exponent, 0.01)
        if not self.barrel:
            return law
        free = common_area(pupil, self.barrel, self.shift * rho * pupil**self.wander) / (math.pi * pupil**2)
        return law * np.maximum(free, 0.01)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return barrels a little wider than the widest pupil."""
        if context.f_number is None:
            return ()
        pupil = 2.0 / float(np.min(np.asarray(context.f_number)))
        forms = ((1.1, 0.4, 0.0), (1.25, 0.7, 0.0), (1.25, 0.7, 1.0))
        return tuple(cls(0.0, 2.0, 4.0, b * pupil, s * pupil ** (1.0 - w), w) for b, s, w in forms)

    def loosened(self, context: ExposureContext) -> tuple[Self, ...]:
        return () if self.barrel else self.covers(context)

    def free(self) -> tuple[str, ...]:
        return ("barrel", "shift", "wander") if self.barrel else self.fitted


def common_area(first: Any, second: Any, distance: Any) -> Any:
    """Return the area that two circles have in common.

    Args:
        distance: Distance of their centres, in the same unit.

    Source: circular segments of half-angle α, r²·(α − sin α·cos α), on either side of the common chord.
    """
    apart = np.maximum(distance, 1e-9)
    total: Any = 0.0
    for own, other in ((first, second), (second, first)):
        cosine = np.clip((apart**2 + np.square(own) - np.square(other)) / (2.0 * apart * own), -1.0, 1.0)
        total = total + np.square(own) * (np.arccos(cosine) - cosine * np.sqrt(1.0 - cosine**2))
    return total


@dataclass(frozen=True)
class AngleDependence(Scaling):
    """Weakens steep rays: E' = E·(1 − a·ρ^p·N^−q)·(1 − c·N^−2), by default with p = 2, q = 1 and c = 0.

    Source: chief-ray angle shading of microlenses; linear in the cone 1/N. Where the microlenses reject a narrow
    slanting cone that they would take in part of, if it were wide, q is negative. Where they lose the rim of a wide
    cone everywhere (pixel vignetting), c is above zero; with q = 0 slant and cone act each by itself.
    """

    name = "angle_dependence"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "slope"
    law_along = ("field_radius", "f_number")
    log_prior_odds = -2.0
    prior_reason = "bends like the fall-off of any lens"
    trials = ({"strength": 0.05}, {"strength": -0.05})
    fitted = ("strength",)
    varies = "f_number"
    settles = "an even field with the camera tilted"
    # A fall-off that no stop changes is the lens, a loss at wide stops that is the same all over is its transmission.
    essential = ("strength", "stop_power", "cone")
    strength: float = parameter(0.0, "1", -3.0, 3.0, source="engineering prior; refined on a real rig")
    radius_power: float = parameter(2.0, "1", 1.0, 6.0, source="microlenses are shifted for the inner field")
    stop_power: float = parameter(
        1.0, "1", -2.0, 1.0, source="cone and chief ray weigh differently from pixel to pixel"
    )

    cone: float = parameter(0.0, "1", -1.0, 1.0, source="pixel vignetting at f/1.4 takes up to a third")

    def factor(self, context: ExposureContext) -> Any:
        stopped: Any = 8.0 if context.f_number is None else context.f_number
        loss = self.strength * context.geometry.field_radius() ** self.radius_power
        slant = 1.0 - loss * np.asarray(stopped) ** -self.stop_power
        return np.maximum(slant * (1.0 - self.cone * np.asarray(stopped) ** -2.0), 0.01)

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the form with separate powers."""
        return (cls(0.01, 2.5, -0.5),)

    def free(self) -> tuple[str, ...]:
        """Return the parameters to fit: the cone where it acts apart, the powers where they are not the plain ones."""
        if self.stop_power == 0.0:
            return ("strength", "cone")
        plain = self.radius_power == 2.0 and self.stop_power == 1.0
        return ("strength",) if plain else ("strength", "radius_power", "stop_power")


@dataclass(frozen=True)
class FnumberTstopError(Scaling):
    """Scales light per stop: E' = E·(1 + e)^s·(1 + c·s²)·(1 + table(N)), s = 2·log₂(N/4) stops from f/4.

    The law serves a constant error per stop; the table (linear in log N between its stops) any other.

    Source: iris scales are good to 1 to 5 % per stop.
    """

    name = "fnumber_tstop_error"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "f_number"
    block = "mean"
    trials = ({"error_per_stop": 0.01}, {"error_per_stop": -0.01}, {"error_per_stop": 0.05})
    fitted = ("error_per_stop",)
    varies = "f_number"
    settles = "pairs of f-numbers at one exposure"
    error_per_stop: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    curvature: float = parameter(0.0, "1", -0.2, 0.2, source="change of the error from stop to stop")
    f_numbers: tuple[float, ...] = parameter((), "1", 0.1, 1000.0, source="f-numbers at which the table holds an error")
    errors_rel: tuple[float, ...] = parameter((), "1", -0.9, 3.0, source="relative error at these f-numbers")

    def factor(self, context: ExposureContext) -> Any:
        """Return the factor of irradiance; 1 at f/4 by the law."""
        known: Any = 4.0 if context.f_number is None else context.f_number
        stops = 2.0 * np.log2(np.asarray(known) / 4.0)
        law = (1.0 + self.error_per_stop) ** stops * (1.0 + self.curvature * stops**2)
        if not self.f_numbers:
            return law
        return law * (1.0 + np.interp(np.log(known), np.log(self.f_numbers), self.errors_rel))

    @classmethod
    def covers(cls, context: ExposureContext) -> tuple[Self, ...]:
        """Return the law with curvature, and the table over the stops in use, which covers every law."""
        used = np.unique(np.asarray(context.f_number))
        if used.size < 3:
            return ()
        return (cls(f_numbers=tuple(used.tolist()), errors_rel=(0.0,) * used.size),)

    def free(self) -> tuple[str, ...]:
        if not self.f_numbers:
            return ("error_per_stop",)
        reference = min(range(len(self.f_numbers)), key=lambda i: abs(math.log(self.f_numbers[i] / 4.0)))
        return tuple(f"errors_rel[{i}]" for i in range(len(self.f_numbers)) if i != reference)


@dataclass(frozen=True)
class Polarisation(Scaling):
    """Weakens polarised light by angle: E' = E·(1 + p·cos 2(φ − φ₀)), φ the angle of camera to screen.

    Source: LCD screens are polarised; lens coatings and beam splitters are not neutral.
    """

    name = "polarisation"
    stage = Stage.OPTICS
    unit_in = unit_out = IRRADIANCE
    where = "screen_x"
    block = "mean"
    trials = ({"strength": 0.02, "axis_rad": 0.0}, {"strength": 0.02, "axis_rad": 0.8})
    fitted = ("strength", "axis_rad")
    settles = "the camera turned by 45 and by 90 degrees"
    strength: float = parameter(0.0, "1", -0.5, 0.5, source="engineering prior; refined on a real rig")
    axis_rad: float = parameter(0.0, "rad", -3.2, 3.2, source="angle of the largest response")

    def factor(self, context: ExposureContext) -> Any:
        return 1.0 + self.strength * np.cos(2.0 * (context.geometry.screen_rotation_rad - self.axis_rad))

    @classmethod
    def usable(cls, context: ExposureContext) -> bool:
        return bool(np.ptp(np.asarray(context.geometry.screen_rotation_rad)) > 0)
