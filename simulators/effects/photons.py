"""From energy on the sensor to electrons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from radiometer.errors import ConfigurationError
from radiometer.units import photon_energy_j
from simulators.effects.base import ELECTRONS, EXPOSURE, PHOTONS, Effect, Stage, parameter
from simulators.effects.catalogue import Scaling, warmer_k
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class PhotonConversion(Effect):
    """Counts photons on the pixel's area: μ_p = H·A·λ/(h·c).

    Source: EMVA Standard 1288, release 4.0, equation (3).
    """

    name = "photon_conversion"
    stage = Stage.PHOTONS
    unit_in = EXPOSURE
    unit_out = PHOTONS
    fill_factor: float = parameter(1.0, "1", 0.01, 1.0, source="EMVA 1288 counts photons on the whole pixel area")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.slope(signal, context)

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return photons per J·m⁻². Raises ConfigurationError where the pixel size is unknown."""
        if context.camera.pixel_pitch_um is None:
            raise ConfigurationError("camera.pixel_pitch_um is missing, so the pixel's area is unknown")
        side_m = context.camera.pixel_pitch_um * 1e-6 * context.geometry.binning
        return self.fill_factor * side_m**2 / photon_energy_j(context.wavelength_nm)


@dataclass(frozen=True)
class QuantumEfficiency(Effect):
    """Turns photons into electrons: μ_e = η·μ_p.

    The random part is in `shot_noise`: a binomial choice among Poisson photons is again Poisson.

    Source: EMVA Standard 1288, release 4.0, equation (2).
    """

    name = "quantum_efficiency"
    stage = Stage.ELECTRONS
    unit_in = PHOTONS
    unit_out = ELECTRONS
    quantum_efficiency: float = parameter(0.6, "1", 0.001, 1.0, source="datasheet, at the effective wavelength")

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.quantum_efficiency

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return self.quantum_efficiency


@dataclass(frozen=True)
class QuantumEfficiencyTemperature(Scaling):
    """Scales the response to light: S' = S·(1 + c·(T − 25 °C) + q·(T − 25 °C)²); q is 0 for a straight line.

    Source: silicon photodiodes; 0.05 to 0.2 %/K, more in the near infrared.
    """

    name = "quantum_efficiency_temperature"
    stage = Stage.PHOTONS
    unit_in = unit_out = PHOTONS
    before = "quantum_efficiency"
    where = "temperature_C"
    block = "mean"
    trials = ({"coefficient_per_K": 0.001}, {"coefficient_per_K": -0.001})
    fitted = ("coefficient_per_K",)
    varies = "temperature_C"
    further = ({"bend_per_K2": 1e-5},)
    settles = "lit captures at three temperatures in random order"
    coefficient_per_K: float = parameter(0.0, "1/K", -0.02, 0.02, source="engineering prior; refined on a real rig")  # noqa: N815

    bend_per_K2: float = parameter(0.0, "1/K²", -1e-3, 1e-3, source="the band edge moves with temperature")  # noqa: N815

    def factor(self, context: ExposureContext) -> Any:
        warmer = warmer_k(context, 25.0)
        return 1.0 + self.coefficient_per_K * warmer + self.bend_per_K2 * warmer**2
