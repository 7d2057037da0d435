"""A simulated camera that looks at a simulated light box: each frame sees what the LEDs emit at that moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from radiometer.data import Frame
from radiometer.devices import CameraCapabilities
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.clock import SimulatedClock
from simulators.light_box.box import SimulatedLightBox
from simulators.scenes.kinds import UniformScene

WHITE_EFFECTIVE_NM: Final = 555.0  # peak of V(λ)


@dataclass(slots=True)
class BoxView:
    """What of a box the camera sees: all lit channels on one diffuser."""

    twin: SimulatedLightBox  # the box
    ambient_w_sr_m2: float = 0.0  # radiance of the room on it, in W·sr⁻¹·m⁻²

    def look(self, time_s: float) -> tuple[float, float]:
        """Return radiance in W·sr⁻¹·m⁻² and effective wavelength in nm at a time."""
        total, weighted = self.ambient_w_sr_m2, self.ambient_w_sr_m2 * WHITE_EFFECTIVE_NM
        for limits in self.twin.settings.channels:
            emission = self.twin.emission(limits.name, max(time_s, self.twin.time_s))
            total += emission.radiance_w_sr_m2
            weighted += emission.radiance_w_sr_m2 * (emission.peak_nm or WHITE_EFFECTIVE_NM)
        return total, weighted / total if total > 0 else WHITE_EFFECTIVE_NM


class LightBoxCamera(SimulatedCamera):
    """A simulated camera in front of a simulated light box.

    Args:
        clock: Time that the box shares.
    """

    def __init__(
        self,
        model: CameraModel,
        view: BoxView,
        *,
        limits: CameraCapabilities,
        clock: SimulatedClock,
        seed: int = 0,
        serial: str = "22500001",
    ) -> None:
        super().__init__(model, UniformScene(), limits=limits, clock=clock, seed=seed, serial=serial)
        self._view = view

    def _expose(self) -> Frame:
        radiance, wavelength_nm = self._view.look(self.clock.now_s())
        self.set_scene(UniformScene(radiance_W_per_sr_m2=radiance, wavelength_nm=wavelength_nm))
        self.sensor.model = replace(self.model, wavelength_nm=wavelength_nm)
        return super()._expose()


class HookedClock(SimulatedClock):
    """Simulated time that something else keeps: advancing it lets that pass.

    Args:
        now: Returns the time in s.
        wait: Lets a time in s pass.
    """

    def __init__(self, now: Callable[[], float], wait: Callable[[float], None]) -> None:
        super().__init__()
        self._now, self._wait = now, wait

    def now_s(self) -> float:
        return self._now()

    def advance(self, duration_s: float) -> None:
        if duration_s < 0:
            raise ValueError(f"cannot advance the clock by {duration_s} s; durations are 0 or more")
        self._wait(duration_s)
