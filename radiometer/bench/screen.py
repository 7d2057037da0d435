"""Screens and what measures them: a browser page or a simulated display before a camera."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.photometry.displays import GRID_NM, display_primaries, display_whites
from radiometer.analysis.photometry.photometry import (
    CRT,
    DISPLAY_TYPES,
    Observer,
    Spectrum,
    luminous_efficacy,
    luminous_efficacy_lm_per_w,
    spectral_columns,
    spectrum,
)
from radiometer.bench.assembly import calibration_path, open_bench_camera, require_absolute
from radiometer.bench.box_holder import darken_held
from radiometer.bench.cameras import SIMULATED, simulated_parts
from radiometer.bench.config import BenchConfig, SimulatedCameraConfig, read_bench
from radiometer.bench.instrument import Instrument, central_patch
from radiometer.data import Calibration, Patch, RadianceMap, Reading
from radiometer.devices import Camera, CameraSettings, Display
from radiometer.errors import ConfigurationError, InputError, UsageError
from radiometer.reporting.origin import moment
from radiometer.screen.report import derived
from radiometer.screen.run import Flicker, Light, ScreenReading, Uniformity, judge_flicker
from radiometer.typing import Array

SIMULATED_DISPLAYS: Final = ("lcd", "pwm_lcd", "oled")
BROWSER: Final = "browser"
START_TIMEOUT_S: Final = 600.0  # from the page's opening until somebody presses its Start
# The whole of a simulated screen fills the picture; a small sensor shows as much and is quick.
SIMULATED_SIZE: Final = (96, 64)
_SHORT_S: Final = 1e-3  # short against the periods of dimmed backlights, 2 to 5 ms
_FLICKER_FRAMES: Final = 16  # a scatter from 16 is known to 18 %
PRIMARIES: Final = ("red", "green", "blue")
_OBSERVERS: Final[tuple[Observer, ...]] = ("photopic", "scotopic")


@dataclass(frozen=True)
class ScreenBench:
    """An open display, and the instrument that looks at it."""

    display: Display  # the display
    instrument: Instrument  # the instrument
    sleep: Callable[[float], None]  # waits for a number of seconds on the clock of both
    clock: Callable[[], float]  # that clock in s
    # Turns the display to an angle in degrees from its normal; None where a person has to
    turn: Callable[[float], None] | None = None

    @property
    def measured_with(self) -> dict[str, str]:
        """Return camera, lens and calibration in words."""
        known, camera = self.instrument.calibration, self.instrument.camera
        calibration = "none: values are relative"
        if known is not None:
            calibration = f"{self.instrument.calibration_file or 'in memory'}, {moment(known.created)}"
        lens = self.instrument.lens.in_words()
        return {"camera": camera.description.name, "lens": lens, "calibration": calibration}

    def read(self) -> ScreenReading:
        return screen_reading(self.instrument.measure(), self.clock())

    def readings(self, places: Sequence[Patch]) -> list[Reading]:
        bracket = self.instrument.at(_around(places)).take_bracket()
        return [self.instrument.at(place).read(bracket) for place in places]

    def map_of(self, area: Patch) -> RadianceMap:
        whole = merge(self.instrument.at(area).take_bracket(), self.instrument.setup)
        planes = {name: getattr(whole, name) for name in ("radiance", "u_radiance", "mask", "u_shared")}
        return replace(whole, **{name: plane[area.slices] for name, plane in planes.items() if plane is not None})

    def check_flicker(self) -> Flicker:
        """Return whether the display's light changes from one short frame to the next. Raises DeviceError."""
        camera, patch = self.instrument.camera, self.instrument.patch
        low, high = camera.capabilities.exposure_s
        settings = camera.configure(replace(camera.settings, exposure_s=float(np.clip(_SHORT_S, low, high))))
        frames = camera.capture(_FLICKER_FRAMES)
        black = camera.description.black_level_dn or 0.0
        pixels = np.array([frame.dn[patch.slices] for frame in frames], dtype=np.float64) - black
        # What all pixels of a frame share is the flicker; the residual is noise.
        own = pixels - pixels.mean(axis=(1, 2), keepdims=True)
        noise_dn = float(np.sqrt(own.var(axis=0, ddof=1).mean() / own[0].size))
        means = pixels.mean(axis=(1, 2))
        return judge_flicker(means.tolist(), noise_dn / float(means.mean()), settings.exposure_s)

    def check_uniformity(self) -> Uniformity:
        """Return white over three by three places in the camera's picture. Raises DeviceError, MeasurementError."""
        limits, patch = self.instrument.camera.capabilities, self.instrument.patch
        xs = np.linspace(0, limits.width - patch.width, 3).astype(int)
        ys = np.linspace(0, limits.height - patch.height, 3).astype(int)
        places = [[Patch(int(x), int(y), patch.width, patch.height) for x in xs] for y in ys]
        found = [[self.instrument.at(place).measure() for place in row] for row in places]
        u_rel = max(derived([one, found[1][1]], lambda v: float(v[0] / v[1])).u for row in found for one in row)
        return Uniformity.of([[one.radiance.value for one in row] for row in found], u_rel)


def _around(places: Sequence[Patch]) -> Patch:
    """Return the smallest patch that holds all."""
    left, top = min(one.x for one in places), min(one.y for one in places)
    right, bottom = max(one.x + one.width for one in places), max(one.y + one.height for one in places)
    return Patch(left, top, right - left, bottom - top)


def screen_reading(reading: Reading, time_s: float) -> ScreenReading:
    """Return a reading with its uncertainty split into what is its own and what all share."""
    value = reading.radiance.value
    common2 = sum(c.u_rel**2 for c in reading.budget if c.correlated)
    own2 = sum(c.u_rel**2 for c in reading.budget if not c.correlated)
    if not reading.budget or not np.isfinite(common2 + own2):
        common2, own2 = 0.0, (reading.radiance.u / value) ** 2 if value else float("inf")
    own = float(np.sqrt(own2)) * abs(value) if np.isfinite(own2) else reading.radiance.u
    return ScreenReading(value, own, float(np.sqrt(common2)), time_s, tuple(str(flag) for flag in reading.flags))


def lights(white: str = "white_led", primaries: str | None = None) -> dict[str, Light]:
    """Return the light of every channel whose spectrum is known or chosen.

    Args:
        primaries: Display type (`DISPLAY_TYPES`), or a CSV with the columns wavelength in nm, red, green, blue; None
            where the primaries are not known: then they have no light.

    Raises:
        InputError: If a spectrum or type is unknown, or the file cannot be used.
    """
    found = {"grey": _light(white, () if _is_measured(white) else tuple(display_whites().values()))}
    if primaries is None:
        return found
    if primaries.lower().endswith(".csv"):
        return found | _measured_primaries(Path(primaries))
    if primaries not in DISPLAY_TYPES:
        raise InputError(f"primaries {primaries!r}: choose a display type ({', '.join(DISPLAY_TYPES)}) or name a CSV")
    names = {one: f"display_{one}" if primaries == CRT else f"display:{primaries}:{one}" for one in PRIMARIES}
    displays = np.stack(display_primaries(primaries), axis=1)  # (primaries, displays, wavelengths)
    return found | {one: _light(names[one], (displays[i],)) for i, one in enumerate(PRIMARIES)}


def primaries_of(display: str, channels: Sequence[str], primaries: str | None) -> str | None:
    """Return the display type or file that colours are to be taken by.

    Simulated displays are made with the primaries of a CRT; of a real one nothing is taken by silence.

    Raises:
        UsageError: If colours are requested of a real display and their spectra are not stated.
    """
    if primaries is not None or not set(channels) & set(PRIMARIES):
        return primaries
    if display in SIMULATED_DISPLAYS:
        return CRT
    raise UsageError(
        f"colours are turned into luminance by their spectra: say --primaries with a display type "
        f"({', '.join(DISPLAY_TYPES)}) or a CSV of wavelength_nm,red,green,blue"
    )


def _measured_primaries(path: Path) -> dict[str, Light]:
    wavelength, columns = spectral_columns(path, {one: (one, one[0], f"rgb_{one[0]}") for one in PRIMARIES})
    return {
        one: _light_of(Spectrum(f"{path.name}:{one}", wavelength, np.maximum(columns[one], 0.0), is_sampled=True))
        for one in PRIMARIES
    }


def _is_measured(name: str) -> bool:
    """Return whether a spectrum is not that of a typical display: one of a file, or a line."""
    return name.lower().endswith(".csv") or name.startswith("line:")


def _light(name: str, displays: Sequence[Array] = ()) -> Light:
    """Return a light that displays of each type may have instead, shape (displays, wavelengths) by type."""
    light = _light_of(spectrum(name))
    if not displays:
        return light
    photopic, scotopic = (
        [[luminous_efficacy_lm_per_w(Spectrum("", GRID_NM, one), observer) for one in kind] for kind in displays]
        for observer in _OBSERVERS
    )
    off = [
        [(p / light.photopic_lm_per_w, s / light.scotopic_lm_per_w) for p, s in zip(*kind, strict=True)]
        for kind in zip(photopic, scotopic, strict=True)
    ]

    def u_rel(of: Callable[[float, float], float]) -> float:
        """Return the root mean square of a ratio's distance from 1; all types of display count alike."""
        return math.sqrt(np.mean([np.mean([(of(p, s) - 1.0) ** 2 for p, s in kind]) for kind in off]))

    return replace(
        light,
        u_photopic_rel=u_rel(lambda p, s: p),
        u_scotopic_rel=u_rel(lambda p, s: s),
        u_ratio_rel=u_rel(lambda p, s: s / p),
    )


def _light_of(source: Spectrum) -> Light:
    photopic, scotopic = (luminous_efficacy(source, observer) for observer in _OBSERVERS)
    of_table = photopic.u_rel, scotopic.u_rel, math.hypot(photopic.u_rel, scotopic.u_rel)
    return Light(photopic.value, scotopic.value, source.name, *of_table)


@contextmanager
def open_screen_bench(
    display: str,
    *,
    bench: Path | None = None,
    camera: str | None = None,
    calibration: Path | None = None,
    patch: Patch | None = None,
    port: int = 0,
    announce: Callable[[str], None] = lambda url: None,
    seed: int = 1,
    simulated_size: tuple[int, int] = SIMULATED_SIZE,
) -> Iterator[ScreenBench]:
    """Open a display and the camera before it for the block.

    Args:
        display: "browser", or "lcd", "pwm_lcd", "oled" for a simulated one (with the simulated camera).
        bench: Bench file; the simulated bench where None.
        camera: Camera before a browser, by name.
        calibration: Calibration file; the bench's own where None.
        patch: Where the camera sees the middle of the screen; the middle of its frame where None.
        announce: Called with the page's address.
        seed: Seed of a simulated camera's noise.
        simulated_size: Width and height in pixels of a simulated camera's picture.

    Raises:
        UsageError: If the display is unknown.
        RadiometerError: If anything named cannot be used.
    """
    if display == BROWSER:
        with _browser_bench(bench, camera, calibration, patch, port, announce) as opened:
            yield opened
    elif display in SIMULATED_DISPLAYS:
        with _simulated_bench(display, bench, calibration, seed, simulated_size) as opened:
            yield opened
    else:
        raise UsageError(f"display {display!r} is unknown; choose {BROWSER}, {', '.join(SIMULATED_DISPLAYS)}")


@contextmanager
def _browser_bench(
    bench: Path | None,
    name: str | None,
    calibration: Path | None,
    patch: Patch | None,
    port: int,
    announce: Callable[[str], None],
) -> Iterator[ScreenBench]:
    from radiometer.screen.browser_page import BrowserDisplay

    with open_bench_camera(bench, name) as (config, camera):
        where = patch or (config.patch.patch if config.patch else central_patch(camera))
        instrument = _instrument(camera, where, calibration or calibration_path(config, bench), config)
        with BrowserDisplay(port, announce=announce, start_timeout_s=START_TIMEOUT_S, darken=darken_held) as display:
            yield ScreenBench(display, instrument, time.sleep, time.monotonic)


@contextmanager
def _simulated_bench(
    name: str, bench: Path | None, calibration: Path | None, seed: int, size: tuple[int, int]
) -> Iterator[ScreenBench]:
    from simulators.chain.camera_model import CameraModel
    from simulators.displays import DISPLAYS, SimulatedDisplay, WatchingCamera

    config, where = read_bench(bench)
    camera_config = config.camera
    if not isinstance(camera_config, SimulatedCameraConfig):
        raise ConfigurationError(
            f"{where}: its camera is {camera_config.kind}; a simulated display needs a simulated camera"
        )
    datasheet, limits = simulated_parts(camera_config, where)
    width, height = size
    display = SimulatedDisplay(DISPLAYS[name])
    camera = WatchingCamera(
        CameraModel.ideal(datasheet, config.lens_description),
        display,
        seed=seed,
        serial=camera_config.serial,
        device_id=SIMULATED,
        limits=replace(limits, width=width, height=height),
        temperature_c=camera_config.temperature_C,
    )
    with camera, display:
        camera.configure(
            CameraSettings(exposure_s=0.01, gain_db=camera_config.gain_db, black_level_dn=camera_config.black_level_dn)
        )
        patch = Patch(width // 2 - 12, height // 2 - 12, 24, 24)
        instrument = _instrument(camera, patch, calibration or calibration_path(config, bench), config)
        clock = display.clock
        yield ScreenBench(display, replace(instrument, clock=clock.now_s), clock.sleep, clock.now_s, display.turn)


def _instrument(camera: Camera, patch: Patch, calibration: Path | None, config: BenchConfig) -> Instrument:
    known = require_absolute(Calibration.read(calibration) if calibration else None)
    return Instrument(camera, patch, calibration=known, time_limit_s=config.time_limit_s, calibration_file=calibration)
