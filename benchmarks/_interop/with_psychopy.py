"""PsychoPy's own calibration routines, read through our photometer; only the window is a stand-in.

`psychopy.hardware.monitor.calibrateGamma` is what Monitor Center's button calls, `psychopy.monitors.getLumSeries` what
scripts call. Both draw into a PsychoPy window, for which a graphics card is needed: here it stands on the simulated
LCD, which the simulated camera looks at.
"""

from __future__ import annotations

import sys
import types
from contextlib import ExitStack
from typing import Any

import numpy as np

from radiometer.adapters.psychopy import RadiometerPhotometer
from radiometer.adapters.readings import MeterSource
from radiometer.api.meter import Meter
from radiometer.bench.screen import open_screen_bench
from radiometer.devices.display import DisplayPatch

LEVELS = 8
WARM_S = 4 * 3600.0


class _Window:
    """Draws what a patch's colour says on the display when it is flipped."""

    def __init__(self, display: Any) -> None:
        self.display, self.rgb = display, (0.0, 0.0, 0.0)

    def flip(self) -> None:
        self.display.show(DisplayPatch(self.rgb))

    def close(self) -> None:
        pass


class _Patch:
    """The stimulus of the middle: colours from 0 to 255, or from −1 to 1."""

    def __init__(self, window: _Window, **options: Any) -> None:
        self._window, self._bytes = window, options.get("colorSpace") == "rgb255"

    @property
    def color(self) -> Any:
        return self._window.rgb

    @color.setter
    def color(self, value: Any) -> None:
        rgb = np.broadcast_to(np.asarray(value, dtype=np.float64), 3)
        drive = rgb / 255.0 if self._bytes else (rgb + 1.0) / 2.0
        red, green, blue = (float(v) for v in np.clip(drive, 0.0, 1.0))
        self._window.rgb = (red, green, blue)

    def setColor(self, value: Any) -> None:  # noqa: N802 (PsychoPy's name)
        self.color = value

    def draw(self) -> None:
        pass


class _Text:
    """A text that is not shown."""

    text = ""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def setText(self, *_: Any, **__: Any) -> None:  # noqa: N802 (PsychoPy's name)
        pass

    def draw(self) -> None:
        pass


class _Background(_Text):
    """The noise around the patch."""


def _stand_in(window: _Window) -> None:
    """Put modules in place of those of PsychoPy that need a graphics card or a keyboard."""
    visual: Any = types.ModuleType("psychopy.visual")

    def patch_stim(win: _Window, *_: Any, **options: Any) -> Any:
        return _Background() if options.get("size") == 2 else _Patch(win, **options)

    visual.Window = lambda **_: window
    visual.GratingStim, visual.PatchStim, visual.TextStim, visual.TextBox2 = _Patch, patch_stim, _Text, _Text
    event: Any = types.ModuleType("psychopy.event")
    event.getKeys = lambda: ["space"]
    keyboard: Any = types.ModuleType("psychopy.hardware.keyboard")
    keyboard.Keyboard = lambda: types.SimpleNamespace(waitKeys=lambda **_: ["space"])
    import psychopy
    import psychopy.hardware

    for parent, name, module in (
        (psychopy, "visual", visual), (psychopy, "event", event), (psychopy.hardware, "keyboard", keyboard),
    ):  # fmt: skip
        sys.modules[module.__name__] = module
        setattr(parent, name, module)


def main() -> list[str]:
    """Return what PsychoPy fits, next to what it fits to the simulated display's true luminances."""
    import psychopy
    from psychopy.hardware.photometer import BasePhotometerDevice
    from psychopy.monitors import DACrange, GammaCalculator

    lines = [f"PsychoPy {psychopy.__version__}, {LEVELS} levels, simulated LCD (sRGB transfer, black 0.1 cd/m²):"]
    with open_screen_bench("lcd") as bench:
        bench.sleep(WARM_S)  # of the display's own clock
        photometer = RadiometerPhotometer(source=MeterSource(Meter(bench.instrument, ExitStack())))
        assert isinstance(photometer, BasePhotometerDevice)
        _stand_in(_Window(bench.display))
        from psychopy.hardware.manager import DeviceManager
        from psychopy.hardware.monitor import calibrateGamma
        from psychopy.monitors import getLumSeries

        grid = np.array(calibrateGamma(_Window(bench.display), photometer, nPoints=LEVELS))
        reading = photometer.lastReading
        series = getLumSeries(lumLevels=LEVELS, photometer=photometer, allGuns=False)
        assert reading is not None
        assert reading.luminance is not None
        lm_per_w = reading.luminance.value / reading.radiance.value
        levels = DACrange(LEVELS)
        true = np.array([_grey_radiance(bench.display, float(v) / 255.0) for v in levels]) * lm_per_w
        fitted = GammaCalculator(inputs=levels, lums=true)
        profiles = DeviceManager.getAvailableDevices("radiometer.adapters.psychopy.RadiometerPhotometer")
    for name, (low, high, gamma) in zip(("grey", "red", "green", "blue"), grid, strict=True):
        lines.append(f"  calibrateGamma, {name:5}: {low:8.3f} to {high:8.2f} cd/m², gamma {gamma:.3f}")
    lines.append(
        f"  the same fit to the display's true luminances, grey: {true[0]:.3f} to {true[-1]:.2f}, gamma "
        f"{fitted.gammaModel[0]:.3f}"
    )
    worst = float(np.max(np.abs(series[0] / true - 1.0)))
    lines.append(f"  getLumSeries, grey: {', '.join(f'{v:.2f}' for v in series[0])} cd/m²")
    lines.append(f"  largest deviation of the series from the truth: {100 * worst:.2f} %")
    lines.append(f"  U of the last reading: {100 * reading.expanded_u_rel:.2f} % (k = {reading.coverage_factor:.2f})")
    lines.append(f"  device manager: {profiles[0]['deviceClass']} at {profiles[0]['address']}")
    return lines


def _grey_radiance(display: Any, drive: float) -> float:
    """Return the display's own radiance of a grey in W·sr⁻¹·m⁻²."""
    return float(display.radiance((drive, drive, drive)))
