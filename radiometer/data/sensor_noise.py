"""Expected noise of a sensor at a given signal: the weight of every sample, never its truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.data.capture_header import CameraDescription
from radiometer.units import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C, ZERO_CELSIUS_K, gain_factor

# Stand in where a datasheet says nothing; chosen for a small-pixel machine-vision sensor, and printed as assumed.
_TYPICAL_FULL_WELL_E = 10_000.0
_TYPICAL_READ_NOISE_E = 3.0
# Greatest dark current of a camera that states none: 1 nA/cm² at 25 °C. Models of unpinned silicon sensors take 0.5
# (M. Konnik and J. Welsh, arXiv:1412.4031, high-level numerical simulations of noise in CCD and CMOS photosensors) to
# 1 nA/cm² at 300 K (ESA's Pyxel, charge generation). Pinned pixels have a twentieth or less (Princeton Instruments).
_MOST_DARK_A_PER_M2 = 1e-5
# That current is generated through states in the middle of the band gap: T^1.5·exp(−E_g/2kT), E_g = 1.12 eV.
# Source: J. R. Janesick, Scientific Charge-Coupled Devices, SPIE 2001, p. 622, as the models above quote it.
_HALF_GAP_K = 1.12 * ELEMENTARY_CHARGE_C / (2.0 * BOLTZMANN_J_K)
_LARGEST_PITCH_UM = 24.0  # of the pixels of scientific CCDs; counts where the pitch is not stated either
_MOST_DARK_REFERENCE_C = 25.0
# Silicon near room temperature: 9 K where states in the middle of the band gap generate the current, 4.3 K where it
# diffuses from beyond (n_i and n_i², Janesick as below). One that is stated was measured to some ±1 K.
_DARK_DOUBLING_K, _FASTEST_DOUBLING_K, _U_STATED_DOUBLING_K = 7.0, 4.3, 1.0
_U_THERMOMETER_K = 0.5 / math.sqrt(6.0)  # of the difference of two readings in steps of 0.5 K
# Up to 3 K within a session where a temperature is not stated: the fastest law is within k = 2.
U_UNKNOWN_WARMTH_REL: float = (2.0 ** (3.0 / _FASTEST_DOUBLING_K) - 1.0) / 2.0


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Linear sensor noise model: σ_y² = K²·(σ_d² + μ_e) + 1/12 in DN².

    Source: EMVA Standard 1288, release 4.0, equations (6)–(13).
    """

    conversion_gain_e_per_dn: float  # electrons per DN at gain 0 dB
    read_noise_e: float  # temporal read noise σ_d in electrons, quantisation taken out
    dark_current_e_per_s: float = 0.0  # Dark current at the reference temperature in e⁻/s
    dark_reference_c: float = _MOST_DARK_REFERENCE_C  # that temperature in °C
    dark_doubling_k: float = _DARK_DOUBLING_K  # temperature step in K that doubles the dark current
    full_well_e: float = _TYPICAL_FULL_WELL_E  # saturation capacity in electrons
    assumed: tuple[str, ...] = ()  # names of the figures that were not known and are typical values
    # Variance in DN² of noise that arises behind a response curve (grain, compression, sharpening, registration),
    # rounding left out
    post_curve_dn2: float = 0.0

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Return in words what the figures that were not known are replaced by."""
        typical = [name for name in self.assumed if name != "dark_current_e_per_s"]
        dark = (
            "the camera states no dark current: none is taken off, and u holds what the darkest pixels allow; take "
            "dark frames of the same exposures"
        )
        found = (f"typical values for {', '.join(typical)}",) if typical else ()
        return found if len(typical) == len(self.assumed) else (*found, dark)

    @property
    def code_variance_dn2(self) -> float:
        """Return the variance in DN² of rounding and of what else arises behind the response curve."""
        return 1.0 / 12.0 + self.post_curve_dn2

    @classmethod
    def of(cls, camera: CameraDescription) -> SensorNoise:
        """Return the noise model that a camera's description gives, typical figures where it is silent."""
        missing = [
            key
            for key in ("conversion_gain_e_per_dn", "read_noise_e", "full_well_e", "dark_current_e_per_s")
            if getattr(camera, key) is None
        ]
        full_well = camera.full_well_e or _TYPICAL_FULL_WELL_E
        return cls(
            conversion_gain_e_per_dn=camera.conversion_gain_e_per_dn or full_well / camera.full_scale_dn,
            read_noise_e=_TYPICAL_READ_NOISE_E if camera.read_noise_e is None else camera.read_noise_e,
            dark_current_e_per_s=camera.dark_current_e_per_s or 0.0,
            dark_reference_c=(
                _MOST_DARK_REFERENCE_C if camera.dark_current_reference_C is None else camera.dark_current_reference_C
            ),
            dark_doubling_k=camera.dark_current_doubling_K or _DARK_DOUBLING_K,
            full_well_e=full_well,
            assumed=tuple(missing),
        )

    def gain_dn_per_e(self, gain_db: float) -> float:
        """Return the system gain K in DN per electron."""
        return gain_factor(gain_db) / self.conversion_gain_e_per_dn

    def dark_e(self, exposure_s: float, temperature_c: float | None) -> float:
        """Return the expected dark signal in electrons."""
        return float(self.dark_current_e_per_s * self.warmer_factor(temperature_c) * exposure_s)

    def warmer_factor(self, temperature_c: float | None) -> float:
        """Return the dark current at a temperature over that at the reference; 1 where it is unknown."""
        warmer = 0.0 if temperature_c is None else temperature_c - self.dark_reference_c
        return float(2.0 ** (warmer / self.dark_doubling_k))

    def variance_dn2(self, signal_dn: ArrayLike, gain_db: float = 0.0, dark_e: float = 0.0) -> NDArray[np.float64]:
        """Return the expected temporal variance of one pixel in DN².

        Args:
            signal_dn: Mean signal from light above the dark signal, in DN, any shape; below 0 counts as 0.
            gain_db: Analogue gain in dB.
        """
        gain = self.gain_dn_per_e(gain_db)
        light = np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0)
        return gain * light + gain**2 * (self.read_noise_e**2 + dark_e) + self.code_variance_dn2


def warmer(here_c: float | None, there_c: float | None, doubling_k: float = _DARK_DOUBLING_K) -> float:
    """Return the dark current at one temperature over that at another; 1 where either is unknown.

    Args:
        here_c: The one in °C.
        there_c: The other in °C.
        doubling_k: Temperature step in K that doubles the dark current.
    """
    return 1.0 if here_c is None or there_c is None else float(2.0 ** ((here_c - there_c) / doubling_k))


def u_warmth_rel(here_c: float | None, there_c: Sequence[float | None], doubling_k: float = _DARK_DOUBLING_K) -> float:
    """Return the relative standard uncertainty that temperatures give the dark signal of a frame by dark frames.

    Args:
        here_c: Temperature of the frame in °C; None where unknown.
        there_c: Those of the dark frames in °C.
        doubling_k: Temperature step in K that doubles the dark current.
    """
    known = [one for one in there_c if one is not None]
    if here_c is None or len(known) < len(there_c):
        return U_UNKNOWN_WARMTH_REL
    fastest_k = _FASTEST_DOUBLING_K if doubling_k == _DARK_DOUBLING_K else doubling_k - _U_STATED_DOUBLING_K
    kelvin = here_c - float(np.mean(known))
    of_law = abs(2.0 ** (kelvin / fastest_k - kelvin / doubling_k) - 1.0) / 2.0
    return math.hypot(of_law, math.log(2.0) * _U_THERMOMETER_K / doubling_k)


def most_dark_e_per_s(camera: CameraDescription, temperature_c: float | None) -> float:
    """Return the greatest dark current in e⁻/s that a camera may have which states none: the one prior for it.

    Args:
        camera: The camera; its pixel pitch gives the area.
        temperature_c: Temperature of the sensor in °C; None counts as 25 °C.
    """
    area_m2 = ((camera.pixel_pitch_um or _LARGEST_PITCH_UM) * 1e-6) ** 2
    reference_k = _MOST_DARK_REFERENCE_C + ZERO_CELSIUS_K
    kelvin = reference_k if temperature_c is None else temperature_c + ZERO_CELSIUS_K
    warmer = (kelvin / reference_k) ** 1.5 * math.exp(_HALF_GAP_K * (1.0 / reference_k - 1.0 / kelvin))
    return float(_MOST_DARK_A_PER_M2 * area_m2 / ELEMENTARY_CHARGE_C * warmer)
