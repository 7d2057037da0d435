"""pymmcore-plus records a stack and a sequence from a camera written in Python; both are imported and merged.

The files kept in tests/unit/importing/recorded are of this kind.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import radiometer as rm
from radiometer.importing import open_capture

EXPOSURES_MS = (5.0, 10.0, 20.0)
SHAPE = (12, 16)
BLACK_DN, DN_PER_MS = 100.0, 20.0


def _core() -> Any:
    from pymmcore_plus.experimental.unicore import SimpleCameraDevice, UniMMCore

    class Camera(SimpleCameraDevice):
        def __init__(self) -> None:
            super().__init__()
            self.exposure_ms, self.gain = 10.0, 0.0
            self.register_property(
                "Gain", default_value=6.0, getter=lambda device: device.gain, setter=lambda d, v: setattr(d, "gain", v)
            )

        def get_exposure(self) -> float:
            return self.exposure_ms

        def set_exposure(self, exposure: float) -> None:
            self.exposure_ms = exposure

        def shape(self) -> tuple[int, int]:
            return SHAPE

        def sensor_shape(self) -> tuple[int, int]:
            return SHAPE

        def dtype(self) -> type[np.uint16]:
            return np.uint16

        def snap(self, buffer: Any) -> dict[str, Any]:
            noise = np.random.default_rng(1).normal(0.0, 5.0, SHAPE)
            buffer[:] = np.clip(BLACK_DN + DN_PER_MS * self.exposure_ms + noise, 0, 4095).astype(np.uint16)
            return {}

    core = UniMMCore()
    core.loadPyDevice("Camera", Camera())
    core.initializeDevice("Camera")
    core.setCameraDevice("Camera")
    core.setProperty("Camera", "Gain", 6.0)
    core.setAutoShutter(False)
    core.definePixelSizeConfig("pixel")
    core.setPixelSizeUm("pixel", 0.5)
    core.setPixelSizeConfig("pixel")
    return core


def main() -> list[str]:
    """Return what was recorded and what was read of it."""
    import pymmcore_plus
    import useq
    from pymmcore_plus.mda.handlers import ImageSequenceWriter

    events = [useq.MDAEvent(index={"t": n}, exposure=ms, min_start_time=0.0) for n, ms in enumerate(EXPOSURES_MS)]
    lines = [f"pymmcore-plus {pymmcore_plus.__version__}, camera of {BLACK_DN:g} DN + {DN_PER_MS:g} DN per ms:"]
    with tempfile.TemporaryDirectory() as folder:
        stack, sequence = Path(folder) / "stack.ome.tiff", Path(folder) / "sequence"
        core = _core()
        core.mda.run(events, output=stack)
        core.mda.run(events, output=ImageSequenceWriter(sequence))
        for path in (stack, sequence):
            capture = open_capture(path)
            read = [(f"{1e3 * e.exposure_s:g} ms", f"{capture.read_frame(n).dn.mean():.1f} DN")
                    for n, e in enumerate(capture.header.frames)]  # fmt: skip
            lines.append(f"  {path.name}: {', '.join(f'{ms} {dn}' for ms, dn in read)}")
        merged = rm.merge(rm.read(stack))
        lines.append(f"  radiance of the stack: {merged!r}")
    return lines
