"""Retinal exposure limits of IEC 62471 for the light of LEDs: blue-light and thermal hazard.

Source: IEC 62471:2006, 4.3.3 to 4.3.5 and table 4.2 (the same figures as ICNIRP 1997 and 2013).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.errors import UnsafeStimulus

# B(λ) of table 4.2 from 380 nm on; below it B is 0.01.
_TABLE_NM: Final = np.arange(380.0, 501.0, 5.0)
# fmt: off
_BLUE: Final = np.array([
    0.01, 0.013, 0.025, 0.05, 0.10, 0.20, 0.40, 0.80, 0.90, 0.95, 0.98, 1.00,
    1.00, 0.97, 0.94, 0.90, 0.80, 0.70, 0.62, 0.55, 0.45, 0.40, 0.22, 0.16, 0.10,
])
# fmt: on
BLUE_DOSE_LIMIT_J_SR_M2: Final = 1e6  # 4.3.3: L_B·t, for t up to 10⁴ s
BLUE_WINDOW_S: Final = 1e4  # IEC 62471:2006, 4.3.3: blue light is summed over 10⁴ s
SMALL_SOURCE_RAD: Final = 0.011  # 4.3.4: below it the limits are set on irradiance
SMALL_SOURCE_DOSE_J_M2: Final = 100.0  # 4.3.4: E_B·t, for t up to 100 s
SMALL_SOURCE_IRRADIANCE_W_M2: Final = 1.0  # 4.3.4: E_B, beyond 100 s
THERMAL_CONSTANT: Final = 50_000.0  # 4.3.5: L_R ≤ 50 000/(α·t^0.25), 10 µs to 10 s
DEFAULT_FRACTION: Final = 0.1  # engineering choice: a tenth of the limit, for bounds may be off


@dataclass(frozen=True, slots=True)
class ChannelOptics:
    """What the eye meets when a channel is on."""

    peak_nm: float | None  # peak wavelength in nm; None for a white LED (450 nm pump and yellow phosphor)
    fwhm_nm: float  # full width of the line at half maximum in nm; not used for white
    subtense_deg: float  # angle that the lit area subtends at the eye, in degrees
    radiance_bound_w_sr_m2: float  # radiance at full level and high current that it certainly stays below
    low_range_ratio_bound: float = 1 / 100  # fraction of that which the low current certainly stays below


@dataclass(frozen=True, slots=True)
class FlashLight:
    """What the eye meets when the photographic flash is fired."""

    exposure_j_sr_m2: float  # radiant exposure of one flash, in J·sr⁻¹·m⁻²
    exposure_bound_j_sr_m2: float  # what it certainly stays below
    duration_s: float  # time in which it is given; the shortest that it may have, for a shorter one is worse
    subtense_deg: float  # angle that the diffuser subtends at the eye, in degrees

    @property
    def optics(self) -> ChannelOptics:
        """Return it as a white channel that is as bright as the flash is on average."""
        return ChannelOptics(None, 0.0, self.subtense_deg, self.exposure_bound_j_sr_m2 / self.duration_s)


@dataclass(frozen=True, slots=True)
class HazardFractions:
    """Fractions of the exposure limits that a stimulus would use up; 1 is the limit itself."""

    blue_light: float  # of the photochemical (blue-light) limit
    thermal: float  # of the thermal limit


def blue_light_weight(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the blue-light hazard function B(λ) (dimensionless) at wavelengths in nm.

    B = 10^((450 − λ)/50) from 500 to 600 nm, 0.001 from there to 700 nm, none beyond.
    Source: IEC 62471:2006, table 4.2.
    """
    wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
    table = np.exp(np.interp(wavelength_nm, _TABLE_NM, np.log(_BLUE)))
    slope = np.maximum(10.0 ** ((450.0 - wavelength_nm) / 50.0), 0.001)
    weight = np.where(wavelength_nm < 500.0, table, slope)
    return np.where((wavelength_nm < 300.0) | (wavelength_nm > 700.0), 0.0, weight)


def thermal_weight(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the retinal burn hazard function R(λ) (dimensionless) at wavelengths in nm, 380 to 1150 nm.

    Ten times B up to 495 nm, 1 from 500 to 700 nm, 10^((700 − λ)/500) to 1050 nm, 0.2 to 1150 nm.
    Source: IEC 62471:2006, table 4.2.
    """
    wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
    table = 10.0 * np.exp(np.interp(wavelength_nm, _TABLE_NM, np.log(_BLUE)))
    infrared = np.maximum(10.0 ** ((700.0 - wavelength_nm) / 500.0), 0.2)
    weight = np.where(wavelength_nm < 500.0, table, np.where(wavelength_nm <= 700.0, 1.0, infrared))
    return np.where((wavelength_nm < 380.0) | (wavelength_nm > 1150.0), 0.0, weight)


def relative_spectrum(optics: ChannelOptics) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return wavelengths in nm and the relative spectral radiance of a channel, of sum 1.

    A coloured LED is a Gaussian line. White is a 450 nm pump (20 nm wide) with 40 % of the power and a phosphor at
    560 nm (120 nm wide) with 60 %. This is bluer than most warm or neutral LEDs, hence on the safe side.
    """
    wavelength_nm = np.arange(380.0, 781.0, 1.0)
    if optics.peak_nm is None:
        spectrum = 0.4 * _line(wavelength_nm, 450.0, 20.0) + 0.6 * _line(wavelength_nm, 560.0, 120.0)
    else:
        spectrum = _line(wavelength_nm, optics.peak_nm, optics.fwhm_nm)
    return wavelength_nm, spectrum


@lru_cache(maxsize=64)
def weighted_fractions(optics: ChannelOptics) -> tuple[float, float]:
    """Return ∫B·S dλ / ∫S dλ and ∫R·S dλ / ∫S dλ for a channel's spectrum S."""
    wavelength_nm, spectrum = relative_spectrum(optics)
    return float(blue_light_weight(wavelength_nm) @ spectrum), float(thermal_weight(wavelength_nm) @ spectrum)


def hazard_fractions(optics: ChannelOptics, radiance_w_sr_m2: float, bright_s: float) -> HazardFractions:
    """Return which fractions of the limits an exposure uses up.

    Blue light: L_B·t ≤ 10⁶ J·m⁻²·sr⁻¹ for t ≤ 10⁴ s, L_B ≤ 100 W·m⁻²·sr⁻¹ beyond. For a source that subtends less
    than 11 mrad, E_B·t ≤ 100 J·m⁻² for t ≤ 100 s, E_B ≤ 1 W·m⁻² beyond. Here E_B = L_B·π·α²/4.
    Thermal: L_R ≤ 50 000/(α·t^0.25) W·m⁻²·sr⁻¹, t from 10 µs to 10 s (longer ones count as 10 s), α from
    1.7 mrad (0.25 s), 1.7 mrad·√(t/0.25 s) or 11 mrad (10 s) to 100 mrad.

    Args:
        radiance_w_sr_m2: Radiance while it is bright, in W·sr⁻¹·m⁻², averaged over its PWM.
        bright_s: Time in s for which it is bright, in sum; `math.inf` where no end is planned.

    Source: IEC 62471:2006, 4.3.3 to 4.3.5.
    """
    blue, thermal = weighted_fractions(optics)
    alpha_rad = math.radians(optics.subtense_deg)
    return HazardFractions(
        _blue_light_fraction(blue * radiance_w_sr_m2, alpha_rad, bright_s),
        _thermal_fraction(thermal * radiance_w_sr_m2, alpha_rad, bright_s),
    )


def refuse_unsafe(
    where: str, used: HazardFractions, allowed_fraction: float = DEFAULT_FRACTION, *, endless: bool = False
) -> None:
    """Raise UnsafeStimulus where more than a stated fraction of a limit would be used up.

    Args:
        used: Fractions of the limits, with everything that adds to them.
        allowed_fraction: Largest fraction of either limit, 0 to 1.
        endless: Whether the box does not end the light, so that no shorter time helps.
    """
    remedy = "Lower the radiance or shorten the exposure"
    if endless:
        remedy = (
            f"The box does not end this light, so it counts for {BLUE_WINDOW_S:g} s. Lower the radiance, or take light"
            " that the box ends: `light pulse`, or `light blink` with a count"
        )
    for name, fraction in (("blue-light", used.blue_light), ("retinal thermal", used.thermal)):
        if not fraction <= allowed_fraction:
            raise UnsafeStimulus(
                f"{where}: {100 * fraction:.3g} % of the {name} exposure limit of IEC 62471 would be used up; "
                f"{100 * allowed_fraction:g} % is allowed here. {remedy}"
            )


def _line(wavelength_nm: NDArray[np.float64], peak_nm: float, fwhm_nm: float) -> NDArray[np.float64]:
    line = np.exp(-4.0 * math.log(2.0) * ((wavelength_nm - peak_nm) / fwhm_nm) ** 2)
    return np.asarray(line / line.sum(), dtype=np.float64)


def _blue_light_fraction(radiance: float, alpha_rad: float, bright_s: float) -> float:
    dose = radiance * min(bright_s, BLUE_WINDOW_S) / BLUE_DOSE_LIMIT_J_SR_M2
    if alpha_rad >= SMALL_SOURCE_RAD:
        return dose
    irradiance = radiance * math.pi * alpha_rad**2 / 4
    return irradiance * min(bright_s / SMALL_SOURCE_DOSE_J_M2, 1 / SMALL_SOURCE_IRRADIANCE_W_M2)


def _thermal_fraction(radiance: float, alpha_rad: float, bright_s: float) -> float:
    time_s = min(max(bright_s, 1e-5), 10.0)
    smallest = 0.011 if time_s >= 10.0 else 1.7e-3 * math.sqrt(max(time_s, 0.25) / 0.25)
    alpha = min(max(alpha_rad, smallest), 0.1)
    return radiance * alpha * math.pow(time_s, 0.25) / THERMAL_CONSTANT
