"""What an effect of the catalogue is asked with: a frame of an ordinary camera, and sizes to begin with."""

from __future__ import annotations

import numpy as np

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.registry import EFFECTS

CATALOGUE = {name: kind for name, kind in EFFECTS.items() if issubclass(kind, CatalogueEffect)}
HEIGHT, WIDTH = 24, 32


def effect_context(frame: int = 0) -> ExposureContext:
    """Return the circumstances of one frame of HEIGHT × WIDTH pixels."""
    camera = CameraDescription(
        bit_depth=12,
        pixel_pitch_um=4.5,
        conversion_gain_e_per_dn=2.6,
        read_noise_e=2.4,
        full_well_e=10_500,
        dark_current_e_per_s=1.0,
        quantum_efficiency=0.6,
    )
    geometry = FrameGeometry.of_image(WIDTH, HEIGHT)
    settings = FrameSettings(1 / 60, 6.0, 5.6, 64.0, 40.0, 60.0, 0.8, pattern="red")
    lens = LensDescription(focal_length_mm=16.0, f_number=5.6)
    return ExposureContext(
        settings,
        geometry,
        camera,
        lens,
        code=np.full((HEIGHT, WIDTH), 0.5),
        peak_radiance=1.0,
        previous_e=np.full((HEIGHT, WIDTH), 4000.0),
        frame_index=frame,
        device_seed=5,
    )


def starts_of(kind: type[CatalogueEffect], context: ExposureContext) -> tuple[CatalogueEffect, ...]:
    """Return the sizes that a kind of effect is tried with; its plain form where it has none."""
    return kind.starts(context) or (kind(),)
