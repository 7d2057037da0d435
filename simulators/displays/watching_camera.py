"""A simulated camera that looks at a simulated display: each frame sees what is on it during its exposure."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radiometer.data import Frame, PatchDescription, SourceDescription
from radiometer.devices import DisplayPatch
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.displays.base import SimulatedDisplay
from simulators.scenes.base import SceneImage

# Brighter than any dimming cycle's mean: the source level of a frame is relative to it.
_HEADROOM = 4.0


@dataclass(frozen=True)
class _Shown:
    """What is on the display at one moment, as a scene that fills the picture."""

    display: SimulatedDisplay
    wavelength_nm: float
    patch: DisplayPatch
    angle_deg: float

    @property
    def source(self) -> SourceDescription:
        return SourceDescription(kind="screen", wavelength_nm=self.wavelength_nm)

    @property
    def patterns(self) -> tuple[str, ...]:
        return ("default",)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the radiance at the backlight's highest output."""
        light = self.display.picture(width, height)
        return SceneImage((_HEADROOM * light).astype(np.float32), peak_radiance=_HEADROOM)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return ()


class WatchingCamera(SimulatedCamera):
    """A SimulatedCamera in front of a SimulatedDisplay, on the display's clock.

    Args:
        wavelength_nm: Wavelength that represents the display's light in nm.
    """

    def __init__(
        self, model: CameraModel, display: SimulatedDisplay, *, wavelength_nm: float = 550.0, **options: Any
    ) -> None:
        self._display, self._wavelength_nm = display, wavelength_nm
        super().__init__(model, self._look(), clock=display.clock, **options)

    def capture(self, count: int = 1) -> list[Frame]:
        """Return `count` frames of what is on the display while each is exposed."""
        return [self._frame() for _ in range(count)]

    def stream(self) -> Generator[Frame, None, None]:
        while True:
            yield self._frame()

    def _frame(self) -> Frame:
        scene = self._look()
        if scene != self.scene:
            self.set_scene(scene)
        self.set_source(self._display.backlight(self.clock.now_s(), self.settings.exposure_s) / _HEADROOM)
        frame = super().capture(1)[0]
        return replace(frame, settings=replace(frame.settings, source_level=1.0))

    def _look(self) -> _Shown:
        return _Shown(self._display, self._wavelength_nm, self._display.shown, self._display.angle_deg)
