"""What a bleach does to the receptors of a simulated eye, and how they recover.

Independent of the code that fits adaptation curves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radiometer.data import bleaching_constants as table

# Exposure in td·s that bleaches 1 − 1/e of the pigment, and time constant of its regeneration in s.
CONE_EXPOSURE_TD_S: Final = table.CONE_HALF_BLEACH.value * table.CONE_REGENERATION.value
CONE_REGENERATION_S: Final = table.CONE_REGENERATION.value
ROD_EXPOSURE_TD_S: Final = table.ROD_EXPOSURE.value
ROD_REGENERATION_S: Final = table.ROD_REGENERATION.value
# Rate-limited regeneration (Mahroo and Lamb 2004, J Physiol 554:417; Lamb and Pugh 2004): dB/dt = −ν·B/(K + B).
SEMI_SATURATION: Final = 0.2
FULL_CONE_AMPLITUDE: Final = 3.0  # log10 units above the plateau just after all cone pigment is bleached
FULL_BLIND_MIN: Final = 5.0  # rods in saturation after a full bleach (Lamb 1981, figure 1: no rod thresholds before)
UNSEEN_FRACTION: Final = 1.6e-4  # bleached rod pigment that no longer raises the threshold: full bleach, 25 min
S3_ONSET_LOG10: Final = 1.0  # S3 takes over where the rods are so far above their final threshold (Lamb 1981)


@dataclass(frozen=True, slots=True)
class Eye:
    """The threshold of one eye over time after a bleach."""

    cone_plateau_log10: float = -2.45  # log10 of the cones' settled threshold in photopic cd·m⁻²
    cone_amplitude: float = 2.5  # what the cones start above it, log10 units
    cone_tau_min: float = 1.6  # time constant of the cones in min
    rod_final_log10: float = -3.9  # log10 of the rods' final threshold in scotopic cd·m⁻²
    s2_slope_per_min: float = -0.24  # slope of S2 in log10 units per min, below 0
    s2_zero_min: float = 23.0  # when the S2 line reaches the final threshold, in min after the bleach
    s3_slope_per_min: float = -0.06  # slope of S3, between that of S2 and 0
    rods_blind_min: float = 4.0  # how long the rods are saturated after the bleach, in min
    pupil_mm: float = 6.0  # diameter of the pupil in mm
    # When its S2 line would reach the final threshold after a full bleach, in min; None for what rate-limited
    # regeneration says of a rested eye
    full_bleach_min: float | None = None

    def cone_log10(self, time_min: float, wavelength_nm: float) -> float:
        """Return the cones' threshold for a spot of one wavelength, log10 of scotopic cd·m⁻²."""
        photopic = self.cone_plateau_log10 + self.cone_amplitude * math.exp(-time_min / self.cone_tau_min)
        return photopic + math.log10(scotopic_per_photopic(wavelength_nm))

    def rod_log10(self, time_min: float) -> float:
        """Return the rods' threshold, log10 of scotopic cd·m⁻²: the slowest of S2, S3 and the final threshold."""
        if time_min < self.rods_blind_min:
            return math.inf
        s2 = self.s2_slope_per_min * (time_min - self.s2_zero_min)
        s3 = S3_ONSET_LOG10 + self.s3_slope_per_min * (time_min - self.rod_rod_break_min)
        slowest = max(s2, s3) if time_min > self.rod_rod_break_min else s2
        return self.rod_final_log10 + max(slowest, 0.0)

    def threshold_log10(self, time_min: float, wavelength_nm: float) -> float:
        """Return the threshold, log10 of scotopic cd·m⁻²: the more sensitive receptors decide."""
        return min(self.cone_log10(time_min, wavelength_nm), self.rod_log10(time_min))

    @property
    def rod_rod_break_min(self) -> float:
        """Return when S3 takes over, in min."""
        return self.s2_zero_min + S3_ONSET_LOG10 / self.s2_slope_per_min

    def break_min(self, wavelength_nm: float) -> float | None:
        """Return when the rods become the more sensitive ones; None where they are within half a minute, or never."""
        times = np.arange(0.5, 60.0, 0.001)
        rods_lead = np.array([self.rod_log10(t) < self.cone_log10(t, wavelength_nm) for t in times[::50]])
        if rods_lead[0] or not rods_lead.any():
            return None
        near = max(int(np.argmax(rods_lead)) * 50, 50)
        fine = [t for t in times[near - 50 : near + 1] if self.rod_log10(t) < self.cone_log10(t, wavelength_nm)]
        return float(fine[0])


def in_blind_spot(temporal_deg: float, above_deg: float) -> bool:
    """Tell whether a direction from the line of sight falls on the optic disc, where no receptors are.

    An ellipse of 5.5° by 7.5°, its middle 15.5° temporal and 1.5° below (Armaly 1969, not verified).
    """
    return ((temporal_deg - 15.5) / 2.75) ** 2 + ((above_deg + 1.5) / 3.75) ** 2 < 1.0


def eye_after_bleach(eye: Eye, luminance_cd_m2: float, duration_s: float, scotopic_ratio: float = 2.0) -> Eye:
    """Return an eye as a bleach leaves it.

    Args:
        eye: The eye; its pupil decides what reaches the retina.
        luminance_cd_m2: Photopic luminance of the bleach.
        duration_s: Its duration in s.
        scotopic_ratio: Scotopic over photopic luminance of its light; about 2 for a white LED.
    """
    photopic_td = luminance_cd_m2 * math.pi * (eye.pupil_mm / 2) ** 2
    cones = bleached(photopic_td, duration_s, CONE_EXPOSURE_TD_S, CONE_REGENERATION_S)
    rods = bleached(scotopic_ratio * photopic_td, duration_s, ROD_EXPOSURE_TD_S, ROD_REGENERATION_S)
    return eye_of_pigments(eye, rods, cones)


def eye_of_pigments(eye: Eye, rods: float, cones: float) -> Eye:
    """Return an eye whose pigments are bleached by given fractions at the beginning of the dark.

    `full_bleach_min` of the eye, where it has one, is when its S2 line reaches the final threshold after a full bleach;
    a lesser bleach has by so much less to recover as rate-limited regeneration says.
    """
    slope = -eye.s2_slope_per_min
    zero_min = recovery_min(rods, slope)
    if eye.full_bleach_min is not None:
        zero_min = max(eye.full_bleach_min - recovery_min(1.0, slope) + zero_min, 0.0)
    blind_min = (
        FULL_BLIND_MIN * rods * min(1.0, zero_min / recovery_min(rods, slope)) if rods > UNSEEN_FRACTION else 0.0
    )
    return replace(eye, cone_amplitude=FULL_CONE_AMPLITUDE * cones, s2_zero_min=zero_min, rods_blind_min=blind_min)


def pigments_after_flash(rods: float, cones: float, since_s: float, photopic_td_s: float) -> tuple[float, float]:
    """Return the bleached fractions of rods and cones after a flash too short for regeneration.

    Args:
        rods: Fraction of the rods' pigment that was bleached.
        since_s: Time in s since then, in which it regenerated.
        photopic_td_s: Retinal exposure of the flash; scotopic is twice that, as of white LEDs.
    """
    rods, cones = rods * math.exp(-since_s / ROD_REGENERATION_S), cones * math.exp(-since_s / CONE_REGENERATION_S)
    left_rods = (1 - rods) * math.exp(-2.0 * photopic_td_s / ROD_EXPOSURE_TD_S)
    return 1 - left_rods, 1 - (1 - cones) * math.exp(-photopic_td_s / CONE_EXPOSURE_TD_S)


def bleached(illuminance_td: float, duration_s: float, exposure_td_s: float, regeneration_s: float) -> float:
    """Return the bleached fraction of a pigment after a steady light: dp/dt = (1 − p)/t₀ − I·p/Q (Rushton)."""
    bleaching = illuminance_td / exposure_td_s
    rate = bleaching + 1 / regeneration_s
    return bleaching / rate * (1 - math.exp(-rate * duration_s))


def recovery_min(fraction: float, s2_per_min: float) -> float:
    """Return how long rate-limited regeneration takes from a bleached fraction to one that is not seen, in min.

    ∫dB·(K + B)/(ν·B) = ((B₀ − B) + K·ln(B₀/B))/ν; ν is scaled so that the final decline has the slope asked for.
    """
    if fraction <= UNSEEN_FRACTION:
        return 0.0
    rate = s2_per_min * math.log(10) * SEMI_SATURATION
    return (fraction - UNSEEN_FRACTION + SEMI_SATURATION * math.log(fraction / UNSEEN_FRACTION)) / rate


def scotopic_per_photopic(wavelength_nm: float) -> float:
    """Return scotopic over photopic luminance of monochromatic light.

    V and V′ as Gaussians (V: 1.019·exp(−285.4(λ − 0.559)²), V′: 0.992·exp(−321.0(λ − 0.503)²), λ in µm), 683 and
    1700 lm·W⁻¹.
    """
    x = wavelength_nm / 1000.0
    photopic = 683.0 * 1.019 * math.exp(-285.4 * (x - 0.559) ** 2)
    scotopic = 1700.0 * 0.992 * math.exp(-321.0 * (x - 0.503) ** 2)
    return scotopic / photopic


def scotopic_lm_per_w(wavelength_nm: float) -> float:
    """Return the scotopic luminous efficacy of monochromatic light in lm·W⁻¹."""
    return 1700.0 * 0.992 * math.exp(-321.0 * (wavelength_nm / 1000.0 - 0.503) ** 2)


# Published rod intercepts at 5·10⁻³ scotopic cd·m⁻² and 5°: 22 young healthy eyes 4.6 ± 0.7 min (abstract of the
# University of Ulster), limit 6.5 min (Jackson et al. 2014); AMD 12 min and more, often beyond 20 min.
INTERCEPT_LOG10: Final = math.log10(5e-3)
HEALTHY_INTERCEPT_MIN: Final = (4.6, 0.7)
CLINICAL_BLEACH: Final = 0.83
AMD_INTERCEPT_MIN: Final = (12.5, 18.0)


def drawn_clinical_eye(rng: np.random.Generator) -> Eye:
    """Return a healthy eye whose rod intercept after the rapid test's bleach is as published, 3 to 6.4 min."""
    intercept_min = float(np.clip(rng.normal(*HEALTHY_INTERCEPT_MIN), 3.0, 6.4))
    return _eye_of_intercept(rng, intercept_min, float(rng.normal(-0.24, 0.02)))


def drawn_amd_eye(rng: np.random.Generator) -> Eye:
    """Return an AMD-like eye: S2 slowed to −0.10 to −0.18 log10 per min, rod intercept 12.5 to 18 min.

    Source: Owsley et al. 2007 and Jackson et al. 2014 for delayed intercepts; slopes after Jackson and Edwards 2008
    (not verified).
    """
    return _eye_of_intercept(rng, float(rng.uniform(*AMD_INTERCEPT_MIN)), float(rng.uniform(-0.18, -0.10)))


def _eye_of_intercept(rng: np.random.Generator, intercept_min: float, slope: float) -> Eye:
    eye = Eye(
        cone_plateau_log10=float(rng.normal(-2.3, 0.1)),
        cone_tau_min=float(rng.uniform(1.2, 1.9)),
        rod_final_log10=float(rng.normal(-4.3, 0.15)),
        s2_slope_per_min=slope,
        s3_slope_per_min=float(rng.uniform(-0.05, -0.03)),
    )
    zero_min = intercept_min + (INTERCEPT_LOG10 - eye.rod_final_log10) / -slope
    return replace(eye, full_bleach_min=zero_min + recovery_min(1.0, -slope) - recovery_min(CLINICAL_BLEACH, -slope))
