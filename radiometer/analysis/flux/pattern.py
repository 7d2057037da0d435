"""The angular pattern of a light-emitting diode, and what part of it a lens takes in."""

from __future__ import annotations

import math
from typing import Final

# Lambertian part of the axial intensity of lensed diodes: 0 to some 10 %; a data sheet's half angle says nothing of it.
PEDESTAL_U: Final = 0.05


def intensity_exponent(half_angle_deg: float) -> float:
    """Return m of the intensity I = I₀·cosᵐθ that falls to one half at the datasheet's half angle.

    Args:
        half_angle_deg: Angle from the axis in degrees at which the intensity is one half (half of the "viewing
            angle" 2θ½); above 0, below 90. 60° is a Lambertian emitter, m = 1.

    Raises:
        ValueError: If the angle is outside that range.

    Source: Moreno and Sun (2008), equation (1).
    """
    if not 0 < half_angle_deg < 90:
        raise ValueError(f"half angle {half_angle_deg:g}° is out of range; allowed is above 0° and below 90°")
    return -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))


def flux_of_radiance(radiance: float, area_m2: float, exponent: float) -> float:
    """Return the flux in W of a flat emitter of axial radiance L₀: Φ = 2π·A·L₀/(m + 1); π·A·L₀ where Lambertian.

    Args:
        radiance: L₀ in W·sr⁻¹·m⁻².
        area_m2: Emitting area A in m².
        exponent: m of the intensity.
    """
    return 2.0 * math.pi * area_m2 * radiance / (exponent + 1.0)


def spread_by_pedestal(exponent: float, pedestal: float) -> float:
    """Return by what the emitted flux grows where a part of the axial intensity is Lambertian rather than beamed.

    I = I₀·[(1 − p)·cosᵐθ + p·cosθ] emits 2π·I₀·[(1 − p)/(m + 1) + p/2]: light that housing and chip scatter sideways
    fills the half space and is seen by no lens on the axis. The axial intensity is taken as the same.

    Args:
        exponent: m of the beam.
        pedestal: p, below 1; 0 is the beam alone.
    """
    return (1.0 - pedestal) + pedestal * (exponent + 1.0) / 2.0


def pupil_half_angle_rad(pupil_diameter_mm: float, distance_mm: float) -> float:
    """Return the half angle in rad that a pupil subtends at the emitter."""
    return math.atan(0.5 * pupil_diameter_mm / distance_mm)


def captured_fraction(exponent: float, half_angle_rad: float) -> float:
    """Return the part of the emitted flux that enters a coaxial round pupil: 1 − cosᵐ⁺¹θ_p.

    It is the integral of (m + 1)/(2π)·cosᵐθ over the cone of half angle θ_p.

    Args:
        exponent: m of the intensity.
        half_angle_rad: θ_p in rad.
    """
    return -math.expm1((exponent + 1.0) * math.log(math.cos(half_angle_rad)))


def mean_to_axial_radiance(exponent: float, half_angle_rad: float) -> float:
    """Return L₀ over the radiance that a lens sees averaged over its pupil; above 1 for a narrow beam.

    The lens equation takes the radiance as the same over the pupil: π·A·L·tan²θ_p enters. The pattern lets in
    2π·A·L₀/(m + 1)·(1 − cosᵐ⁺¹θ_p).

    Args:
        exponent: m of the intensity.
        half_angle_rad: θ_p in rad, above 0.
    """
    return 0.5 * (exponent + 1.0) * math.tan(half_angle_rad) ** 2 / captured_fraction(exponent, half_angle_rad)
