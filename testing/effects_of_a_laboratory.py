"""What is known of the bench in the cellar."""

from dataclasses import dataclass

import numpy as np

from simulators.effects.base import DIGITAL_NUMBER, RADIANCE, Stage, parameter
from simulators.effects.catalogue import CatalogueEffect, Scaling


@dataclass(frozen=True)
class LampDriverNoise(CatalogueEffect):
    """Adds noise that goes with the lamp's drive d: σ'² = σ² + (a·d)²."""

    name = "lamp_driver_noise"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = "source_level"
    block = "variance"
    acts_by_square = True
    trials = ({"amplitude_dn": 1.0},)
    fitted = ("amplitude_dn",)
    settles = "the same signal at two drives"
    amplitude_dn: float = parameter(0.0, "DN", 0.0, 100.0, source="the cellar's logbook")

    def mean(self, signal, context):
        return signal

    def slope(self, signal, context):
        return 1.0

    def variance(self, signal, context):
        return np.square(self.amplitude_dn * np.asarray(context.settings.source_level))

    def sample(self, signal, context, rng):
        noise = self.amplitude_dn * context.settings.source_level * rng.standard_normal(signal.shape)
        return (signal + noise).astype(signal.dtype)


@dataclass(frozen=True)
class DisplayCeiling(CatalogueEffect):
    """Limits what the screen can show: L' = min(L, c)."""

    name = "display_ceiling"
    stage = Stage.SCENE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "patch_level"
    saturates = "sharply"
    trials = tuple({"ceiling": c} for c in (0.8, 0.65, 0.5, 0.35))
    fitted = ("ceiling",)
    settles = "the brightest patch at half the drive"
    ceiling: float = parameter(10.0, "W sr-1 m-2", 0.01, 10.0, source="the screen's data sheet")

    def mean(self, signal, context):
        return np.minimum(signal, self.ceiling)

    def slope(self, signal, context):
        return (signal < self.ceiling).astype(signal.dtype)


@dataclass(frozen=True)
class DriverSteps(Scaling):
    """Rounds the lamp's drive down to whole steps: d' = q·⌊d/q⌋."""

    name = "driver_steps"
    stage = Stage.SOURCE
    unit_in = RADIANCE
    unit_out = RADIANCE
    where = "source_level"
    is_stepwise = True
    trials = tuple({"step": q} for q in (0.04, 0.05, 0.0625, 0.08, 0.0909))
    fitted = ()
    settles = "two drives within one step"
    step: float = parameter(1e-6, "1", 1e-6, 0.5, source="bits of the driver")

    def factor(self, context):
        drive = np.maximum(np.asarray(context.settings.source_level), 1e-9)
        return np.maximum(self.step * np.floor(drive / self.step + 1e-9), 1e-6) / drive
