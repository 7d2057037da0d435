"""Where the pictures of the simulated Blackfly come from: the forward model, or a pool of its frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from radiometer.data import FrameSettings
from radiometer.data.frame import DigitalNumbers
from simulators.chain.virtual_sensor import VirtualSensor


@dataclass(frozen=True, slots=True)
class PictureRequest:
    """The registers that a picture is made under."""

    exposure_s: float  # exposure time in s
    gain_db: float  # analogue gain in dB
    black_level_dn: float  # black level in DN of the given bit depth
    bit_depth: int  # bits of a digital number
    temperature_c: float  # sensor temperature in °C
    source_level: float  # relative drive of the source
    is_shutter_closed: bool  # cap on the lens
    binning: int  # pixels averaged in each direction
    x: int  # left edge of the region in pixels after binning
    y: int  # top edge of the region
    width: int  # width of the region
    height: int  # height of the region


PictureSource = Callable[[PictureRequest], DigitalNumbers]


class ForwardModelSource:
    """Exposes the virtual sensor anew for every picture."""

    def __init__(self, sensor: VirtualSensor) -> None:
        self._sensor, self._pattern = sensor, sensor.scene.patterns[0]
        self._last: FrameSettings | None = None
        self._since_change = 0

    def show(self, pattern: str) -> None:
        """Show another pattern of the scene, as a person at the bench does."""
        self._pattern = pattern

    def __call__(self, request: PictureRequest) -> DigitalNumbers:
        """Return the picture of a request, shape (height, width).

        Raises:
            MeasurementError: If an effect of the model fails; the message names it.
        """
        settings = FrameSettings(
            exposure_s=request.exposure_s,
            gain_db=request.gain_db,
            f_number=self._sensor.model.lens.f_number,
            black_level_dn=request.black_level_dn,
            temperature_c=request.temperature_c,
            source_level=request.source_level,
            pattern=self._pattern,
            shutter="closed" if request.is_shutter_closed else "open",
        )
        self._since_change = self._since_change + 1 if settings == self._last else 0
        self._last = settings
        dn = self._sensor.expose(
            settings, output_bit_depth=request.bit_depth, binning=request.binning, frame_index=self._since_change
        )
        return dn[request.y : request.y + request.height, request.x : request.x + request.width]


class PooledSource:
    """Draws a few frames under each setting and serves them in turn: for measuring the link, not the light.

    Args:
        size: Frames drawn under each setting, at least 1.
    """

    def __init__(self, source: PictureSource, size: int) -> None:
        self._source, self._size = source, size
        self._request: PictureRequest | None = None
        self._pool: list[DigitalNumbers] = []
        self._served = 0

    def __call__(self, request: PictureRequest) -> DigitalNumbers:
        """Return the next frame of the pool for a request."""
        if request != self._request:
            self._request, self._pool, self._served = request, [], 0
        if len(self._pool) < self._size:
            self._pool.append(self._source(request))
        frame = self._pool[self._served % self._size]
        self._served += 1
        return frame
