"""A small generator of frames, written apart from the forward model and from the analysis."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.data import Calibration, CameraDescription, Frame, FrameSettings, LensDescription, Scale, SensorNoise

WAVELENGTH_M = 550e-9
PHOTON_J = 6.62607015e-34 * 299_792_458.0 / WAVELENGTH_M
EXPOSURES_S = tuple(20e-6 * 4.0**k for k in range(11))


@dataclass(frozen=True)
class Rig:
    """A linear 12-bit camera behind a lens: what is true, and what is believed of it."""

    gain_e_per_dn: float = 2.6
    read_e: float = 2.4
    black_dn: float = 64.0
    quantum_efficiency: float = 0.62
    pitch_m: float = 4.5e-6
    f_number: float = 4.0
    full_well_e: float = 10_500.0
    exposure_error_s: float = 0.0

    def electrons_per_s(self, radiance: NDArray[np.float64] | float) -> NDArray[np.float64]:
        irradiance = np.asarray(radiance, float) * math.pi / (4.0 * self.f_number**2)
        return irradiance * self.pitch_m**2 / PHOTON_J * self.quantum_efficiency

    def radiance_of_full_scale(self, exposure_s: float) -> float:
        return (4095 - self.black_dn) * self.gain_e_per_dn / float(self.electrons_per_s(1.0)) / exposure_s

    def frame(
        self,
        radiance: NDArray[np.float64],
        exposure_s: float,
        rng: np.random.Generator,
        gain_db: float = 0.0,
        **settings,
    ) -> Frame:
        expected = self.electrons_per_s(radiance) * (exposure_s + self.exposure_error_s)
        if settings.get("shutter") == "closed":
            expected = np.zeros_like(expected)
        electrons = np.minimum(rng.poisson(expected).astype(float), self.full_well_e)
        electrons += rng.normal(0.0, self.read_e, expected.shape)
        dn = electrons * 10 ** (gain_db / 20) / self.gain_e_per_dn + self.black_dn
        stored = np.clip(np.rint(dn), 0, 4095).astype(np.uint16)
        return Frame(
            stored, 12, FrameSettings(exposure_s, gain_db, self.f_number, self.black_dn, temperature_c=25.0, **settings)
        )

    def frames(self, radiance: NDArray[np.float64], rng: np.random.Generator, exposures=EXPOSURES_S) -> list[Frame]:
        return [self.frame(radiance, t, rng) for t in exposures]

    @property
    def description(self) -> CameraDescription:
        return CameraDescription(
            bit_depth=12,
            model="generated",
            serial="1",
            conversion_gain_e_per_dn=self.gain_e_per_dn,
            read_noise_e=self.read_e,
            full_well_e=self.full_well_e,
            dark_current_e_per_s=0.0,
            black_level_dn=self.black_dn,
        )

    @property
    def lens(self) -> LensDescription:
        return LensDescription(focal_length_mm=16.0, f_number=self.f_number)

    @property
    def true_scale(self) -> float:
        """J·m⁻² on the sensor per DN above black."""
        return self.gain_e_per_dn / self.quantum_efficiency * PHOTON_J / self.pitch_m**2

    def calibration(self, scale_error_rel: float = 0.0, u_rel: float = 0.0, **changes) -> Calibration:
        return Calibration(
            camera=self.description,
            lens=self.lens,
            scale=Scale(
                value=self.true_scale * (1 + scale_error_rel),
                u_rel=u_rel,
                method="known_radiance",
                f_number=self.f_number,
            ),
            response=None,
            noise=SensorNoise.of(self.description),
            **changes,
        )

    def but(self, **changes) -> Rig:
        return replace(self, **changes)


@pytest.fixture
def rig() -> Rig:
    """Return the ordinary rig."""
    return Rig()
