"""The true rig: what the hidden camera, lens and screen are before anything is wrong with them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radiometer.data import CameraDescription, LensDescription, SourceDescription

HC_J_M = 6.62607015e-34 * 299_792_458.0


@dataclass(frozen=True)
class Rig:
    """Numbers of a small-pixel global-shutter sensor behind a 25 mm lens, in front of a bright green screen."""

    rows: int = 96
    columns: int = 144
    bit_depth: int = 12
    e_per_dn: float = 2.6
    read_noise_e: float = 2.4
    full_well_e: float = 10_500.0
    black_dn: float = 240.0
    dark_e_per_s: float = 1.0
    dark_reference_c: float = 25.0
    dark_doubling_k: float = 7.0
    quantum_efficiency: float = 0.62
    pixel_um: float = 4.5
    spacing_um: float = 45.0
    focal_mm: float = 25.0
    transmittance: float = 0.95
    wavelength_nm: float = 550.0
    peak_radiance: float = 5.0
    jitter: float = 0.001
    patch_error: float = 0.005
    claimed_patch_error: float = 0.005
    claimed_jitter: float = 0.001

    @property
    def top_dn(self) -> int:
        """Return the highest code."""
        return 2**self.bit_depth - 1

    @property
    def electrons_per_radiance_second(self) -> float:
        """Return electrons per second and W/(sr m2) at f/1, before the f-number's square."""
        photon_j = HC_J_M / (self.wavelength_nm * 1e-9)
        area_m2 = (self.pixel_um * 1e-6) ** 2
        return math.pi / 4 * self.transmittance * area_m2 * self.quantum_efficiency / photon_j

    def field_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the x and y position in mm of each pixel from the optical axis."""
        y, x = np.mgrid[: self.rows, : self.columns].astype(float)
        step = self.spacing_um * 1e-3
        return (x - (self.columns - 1) / 2) * step, (y - (self.rows - 1) / 2) * step

    def normalised_radius(self) -> np.ndarray:
        """Return the distance of each pixel from the axis, 1 in the corners."""
        x, y = self.field_mm()
        r = np.hypot(x, y)
        return r / r.max()

    def camera(self) -> CameraDescription:
        """Return the camera as its datasheet has it."""
        return CameraDescription(
            vendor="FLIR",
            model="BFS-U3-19S4M",
            serial="22500001",
            bit_depth=self.bit_depth,
            pixel_pitch_um=self.pixel_um,
            pixel_spacing_um=self.spacing_um,
            conversion_gain_e_per_dn=self.e_per_dn,
            read_noise_e=self.read_noise_e,
            full_well_e=self.full_well_e,
            dark_current_e_per_s=self.dark_e_per_s,
            dark_current_reference_C=self.dark_reference_c,
            dark_current_doubling_K=self.dark_doubling_k,
            black_level_dn=self.black_dn,
            quantum_efficiency=self.quantum_efficiency,
        )

    def lens(self) -> LensDescription:
        """Return the lens as its maker has it."""
        return LensDescription(
            focal_length_mm=self.focal_mm,
            f_number=4.0,
            transmittance=self.transmittance,
            transmittance_u_rel=0.03,
            principal_point_px=((self.columns - 1) / 2, (self.rows - 1) / 2),
        )

    def source(self) -> SourceDescription:
        """Return the screen as it is described."""
        return SourceDescription(
            kind="screen", wavelength_nm=self.wavelength_nm, reproducibility_u_rel=self.claimed_jitter
        )
