"""The angular pattern of a diode."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.analysis.flux.estimate import (
    captured_fraction,
    flux_of_radiance,
    intensity_exponent,
    mean_to_axial_radiance,
    pupil_half_angle_rad,
    spread_by_pedestal,
)


def test_half_angle_of_sixty_degrees_is_lambertian() -> None:
    """cos 60° = 1/2, so the exponent is 1 and Φ = π·A·L."""
    assert intensity_exponent(60.0) == pytest.approx(1.0, rel=1e-12)
    assert flux_of_radiance(10.0, 2e-6, 1.0) == pytest.approx(math.pi * 2e-6 * 10.0, rel=1e-12)


@pytest.mark.parametrize("half_angle", [8.0, 15.0, 60.0])
def test_intensity_is_one_half_at_the_half_angle(half_angle: float) -> None:
    """cosᵐθ½ is 1/2 by definition."""
    assert math.cos(math.radians(half_angle)) ** intensity_exponent(half_angle) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 20.0, 80.0])
@pytest.mark.parametrize("angle", [0.02, 0.1, 0.5])
def test_fraction_is_the_integral_of_the_pattern(exponent: float, angle: float) -> None:
    """Numerical integration of (m + 1)/(2π)·cosᵐθ over the cone gives the same fraction."""
    theta = np.linspace(0.0, angle, 20_001)
    pattern = (exponent + 1) / (2 * np.pi) * np.cos(theta) ** exponent
    integral = np.trapezoid(pattern * 2 * np.pi * np.sin(theta), theta)
    assert captured_fraction(exponent, angle) == pytest.approx(integral, rel=1e-6)


def test_small_pupil_sees_the_axial_radiance() -> None:
    """The correction from mean to axial radiance goes to 1 with the pupil's angle."""
    assert mean_to_axial_radiance(80.0, 1e-4) == pytest.approx(1.0, abs=1e-5)
    assert mean_to_axial_radiance(80.0, 0.1) > 1.1


def test_pupil_angle_is_that_of_a_right_triangle() -> None:
    """A pupil of 20 mm at 10 mm subtends 45° to each side."""
    assert pupil_half_angle_rad(20.0, 10.0) == pytest.approx(math.pi / 4)


@pytest.mark.parametrize("half_angle", [0.0, 90.0, -5.0])
def test_impossible_half_angles_are_refused(half_angle: float) -> None:
    """The message gives the value and the limits."""
    with pytest.raises(ValueError, match=r"half angle .* is out of range"):
        intensity_exponent(half_angle)


@pytest.mark.parametrize("pedestal", [0.0, 0.05, 0.1])
def test_a_lambertian_pedestal_spreads_flux_that_the_axis_does_not_show(pedestal: float) -> None:
    """Against the integral of (1 − p)·cosᵐθ + p·cosθ over the half space, m = 12; none for a Lambertian emitter."""
    theta = np.linspace(0.0, np.pi / 2.0, 20_001)
    beam = np.cos(theta) ** 12
    whole, alone = (
        np.trapezoid(intensity * np.sin(theta), theta)
        for intensity in ((1 - pedestal) * beam + pedestal * np.cos(theta), beam)
    )
    assert spread_by_pedestal(12.0, pedestal) == pytest.approx(whole / alone, rel=1e-6)
    assert spread_by_pedestal(1.0, pedestal) == pytest.approx(1.0)
