"""A sensor in front of a scene: one frame after the other, with what one leaves behind for the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiometer.data import FrameSettings
from radiometer.data.frame import DigitalNumbers
from simulators.chain.camera_model import CameraModel
from simulators.effects.context import FrameGeometry, Signal
from simulators.scenes.base import Scene, SceneImage


class VirtualSensor:
    """Exposes frames of a scene through a camera model.

    The whole sensor is simulated whatever region is asked for, so that glare, neighbours and fixed patterns stay
    what they are.

    Args:
        width: Sensor width in pixels.
        height: Sensor height in pixels.
        seed: Makes the noise; the same seed gives the same frames in the same order.
        device_seed: Makes this camera's fixed patterns.
    """

    def __init__(
        self, model: CameraModel, scene: Scene, width: int, height: int, *, seed: int = 0, device_seed: int = 0
    ) -> None:
        self.model, self.scene = model, scene
        self.width, self.height = width, height
        self.seed, self.device_seed = seed, device_seed
        self.frames_exposed = 0
        self._previous_e: Signal | None = None
        self._past = FadingPast()
        self._last_light_s: float | None = None
        self._last_frame_s: float | None = None
        self._rendered: tuple[Scene, str, SceneImage] | None = None

    def expose(
        self, settings: FrameSettings, *, output_bit_depth: int | None = None, binning: int = 1, frame_index: int = 0
    ) -> DigitalNumbers:
        """Return the digital numbers of the next frame, shape (height // binning, width // binning).

        Args:
            settings: Settings of the frame; the black level in DN of the output.
            output_bit_depth: Bits per pixel; None for the model's own.
            binning: Pixels summed in each direction.

        Raises:
            ConfigurationError: If the scene has no such pattern or the model lacks a figure.
            MeasurementError: If an effect fails; the message names it.
        """
        image = self._image(settings.pattern)
        geometry = self._geometry(binning)
        context = self.model.context(
            self._native(settings, output_bit_depth),
            geometry,
            wavelength_nm=self.scene.source.wavelength_nm or self.model.wavelength_nm,
            code=None if image.code is None else _binned(np.asarray(image.code), binning),
            peak_radiance=image.peak_radiance,
            previous_e=self._fitting_previous(geometry),
            past=self._past.at(settings.timestamp_s, geometry.shape),
            since_light_s=self._since(self._last_light_s, settings),
            since_frame_s=self._since(self._last_frame_s, settings),
            frame_index=frame_index,
            frame_numbers=(self.frames_exposed,),
            device_seed=self.device_seed,
            output_bit_depth=output_bit_depth,
        )
        exposed = self.model.sample(_binned(image.radiance, binning), context, (self.seed, self.frames_exposed))
        self._previous_e = exposed.electrons
        self._past.add(exposed.electrons, settings.timestamp_s)
        self.frames_exposed += 1
        self._last_frame_s = settings.timestamp_s
        if not settings.is_dark and settings.source_level > 0:
            self._last_light_s = settings.timestamp_s
        return exposed.dn

    @staticmethod
    def _since(last_s: float | None, settings: FrameSettings) -> float | None:
        return None if last_s is None or settings.timestamp_s is None else settings.timestamp_s - last_s

    def _image(self, pattern: str) -> SceneImage:
        if self._rendered is None or self._rendered[0] is not self.scene or self._rendered[1] != pattern:
            self._rendered = (self.scene, pattern, self.scene.render(self.width, self.height, pattern))
        return self._rendered[2]

    def _geometry(self, binning: int) -> FrameGeometry:
        camera = self.model.camera
        return FrameGeometry.of_image(
            self.width // binning,
            self.height // binning,
            binning=binning,
            sensor_width=self.width,
            sensor_height=self.height,
            principal_point_px=self.model.lens.principal_point_px,
            pixel_spacing_um=camera.pixel_spacing_um or camera.pixel_pitch_um or 1.0,
        )

    def _native(self, settings: FrameSettings, output_bit_depth: int | None) -> FrameSettings:
        if settings.black_level_dn is None or output_bit_depth is None:
            return settings
        scale = 2.0 ** (self.model.camera.bit_depth - output_bit_depth)
        return replace(settings, black_level_dn=settings.black_level_dn * scale)

    def _fitting_previous(self, geometry: FrameGeometry) -> Signal | None:
        previous = self._previous_e
        return previous if previous is not None and previous.shape == geometry.shape else None


class FadingPast:
    """What earlier frames held, added up for each time constant that was asked for: one picture for each of them.

    It counts from the first frame on for which an effect asks.
    """

    def __init__(self) -> None:
        self._now_s, self._last_s, self._shape = 0.0, 0.0, tuple[int, ...]()
        self._faded: dict[float, Signal] = {}

    def at(self, now_s: float | None, shape: tuple[int, ...]) -> FadingPast | None:
        """Return the past as a frame of this time and shape sees it; None without a time. Another shape forgets it."""
        if shape != self._shape:
            self._shape, self._faded = shape, {}
        self._now_s = self._now_s if now_s is None else now_s
        return None if now_s is None else self

    def faded(self, tau_s: float) -> Signal:
        """Return the sum of what earlier frames held, each times exp(−age/τ)."""
        known = self._faded.setdefault(tau_s, np.zeros(self._shape))
        return np.asarray(known * np.exp(-(self._now_s - self._last_s) / tau_s))

    def add(self, held_e: Signal, now_s: float | None) -> None:
        """Take up the frame that was exposed; one without a time is forgotten."""
        if now_s is None or held_e.shape != self._shape:
            return
        self._faded = {tau_s: self.faded(tau_s) + held_e for tau_s in self._faded}
        self._last_s = now_s


def _binned(image: Signal, binning: int) -> Signal:
    """Return the mean over blocks of binning × binning pixels; what does not fill a block is left out."""
    if binning == 1:
        return image
    height, width = image.shape[0] // binning, image.shape[1] // binning
    blocks = image[: height * binning, : width * binning].reshape(height, binning, width, binning)
    return np.asarray(blocks.mean(axis=(1, 3)))
