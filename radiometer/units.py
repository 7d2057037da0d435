"""Conversions between the units of settings, and the exact values behind printed ones."""

from __future__ import annotations

import math
from typing import Final, cast

PLANCK_J_S: Final = 6.62607015e-34  # SI 2019, exact
SPEED_OF_LIGHT_M_S: Final = 299_792_458.0  # exact
BOLTZMANN_J_K: Final = 1.380649e-23  # SI 2019, exact

# Printed by half-stop dials alone, though rounded so far that a third of a stop lies as near.
_HALF_STOPS_ONLY_S: Final = (1.5, 3.0, 1.0 / 3.0)
_SAME_PRINT_REL: Final = 1e-3


def gain_factor(gain_db: float) -> float:
    """Return the amplitude factor of a gain in dB (20 dB is a factor of 10)."""
    return cast(float, 10.0 ** (gain_db / 20.0))


def photon_energy_j(wavelength_nm: float) -> float:
    """Return the energy in J of one photon of the given vacuum wavelength in nm."""
    return PLANCK_J_S * SPEED_OF_LIGHT_M_S / (wavelength_nm * 1e-9)


def exact_exposure_s(nominal_s: float) -> float:
    """Return the exact exposure time in s behind a printed one.

    Cameras print rounded times but run in thirds or halves of a stop about 1 s: a printed 1/60 s is 2^-6 s, a printed
    1/90 s is 2^-6.5 s.

    Args:
        nominal_s: Printed exposure time in s, above 0.

    Returns:
        The nearest 2^(k/3) s; 2^(k/2) s where that is nearer, or where only half-stop dials print the time.

    Raises:
        ValueError: If the time is not a positive finite number.
    """
    thirds, halves = _nearest_step(nominal_s, 3), _nearest_step(nominal_s, 2)
    if any(abs(nominal_s / printed - 1.0) < _SAME_PRINT_REL for printed in _HALF_STOPS_ONLY_S):
        return halves
    return min(thirds, halves, key=lambda exact: abs(math.log(exact / nominal_s)))


def exact_f_number(nominal: float) -> float:
    """Return the exact f-number behind a printed one (f/5.6 is 2^(5/2), f/1.7 is 2^(3/4)).

    f-numbers run in thirds or halves of a stop: N = 2^(k/6) or 2^(k/4); the nearest of both is taken.

    Args:
        nominal: Printed f-number, above 0.

    Raises:
        ValueError: If the f-number is not a positive finite number.
    """
    thirds, halves = _nearest_step(nominal, 6), _nearest_step(nominal, 4)
    return min(thirds, halves, key=lambda exact: abs(math.log(exact / nominal)))


def _nearest_step(value: float, steps_per_octave: int) -> float:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{value!r} is not a positive finite number")
    return float(2.0 ** (round(math.log2(value) * steps_per_octave) / steps_per_octave))
