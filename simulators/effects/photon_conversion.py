"""From energy on the sensor to photons on a pixel."""

from __future__ import annotations

from dataclasses import dataclass

from radiometer.errors import ConfigurationError
from radiometer.units import photon_energy_j
from simulators.effects.base import EXPOSURE, PHOTONS, Proportional, Stage, parameter
from simulators.effects.context import ExposureContext, Signal


@dataclass(frozen=True)
class PhotonConversion(Proportional):
    """Counts photons on the pixel's area: μ_p = H·A·λ/(h·c).

    Source: EMVA Standard 1288, release 4.0, equation (3).
    """

    name = "photon_conversion"
    stage = Stage.PHOTONS
    unit_in = EXPOSURE
    unit_out = PHOTONS
    fill_factor: float = parameter(1.0, "1", 0.01, 1.0, source="EMVA 1288 counts photons on the whole pixel area")

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        """Return photons per J·m⁻². Raises ConfigurationError where the pixel size is unknown."""
        if context.camera.pixel_pitch_um is None:
            raise ConfigurationError("camera.pixel_pitch_um is missing, so the pixel's area is unknown")
        side_m = context.camera.pixel_pitch_um * 1e-6 * context.geometry.binning
        return self.fill_factor * side_m**2 / photon_energy_j(context.wavelength_nm)
