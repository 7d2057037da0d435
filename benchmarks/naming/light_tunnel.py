"""Sessions of a world by other people: the light tunnel of the package `causalchamber` (Gamella et al. 2025).

The world is their model F3, which knows leaking polarisers and LEDs that every channel sees. The description of
the frames follows their simpler models: F2, whose polarisers block all light when crossed, or F1, which sees every
LED alike. A null session is described by F3. Photons, read noise and codes are drawn here; the package has none.
"""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data import CaptureSetWriter, Frame, FrameSettings, PatchDescription
from testing.generator.rig import Rig

_SIDE: Final = 128  # pixels of a picture
_RIG: Final = Rig(rows=_SIDE, columns=_SIDE)
_WELL_E: Final = 10_000.0  # electrons at the value 1, where the models clip; less than the converter holds
_HIGHEST: Final = 0.85  # value of the brightest setting: nothing clips
_UNCLIPPED: Final = 0.25  # exposure at which no picture of the models clips
_BASE_S: Final = 1e-3  # exposure at which the models have their own
_STOP: Final = 4.0
# Parameters of the tunnel as its authors calibrated them (the package's tutorial of models F1 to F3).
_SEEN: Final = np.array([[0.2995802, 0.06920322, 0.028159], [0.04017132, 0.9209918, 0.31265],
                         [0.00217392, 0.2071558, 0.75763]])  # fmt: skip
_ALIGNED: Final = np.array([[0.29, 0.35, 0.33]]).T
_CROSSED: Final = np.array([[0.02, 0.08, 0.18]]).T
_HEXAGON: Final = {"center_x": 0.5, "center_y": 0.5, "radius": 0.22, "offset": 0, "image_size": _SIDE}
_PLACES: Final = ((49, 49), (65, 49), (49, 65), (65, 65))  # of four patches in the hexagon
_PATCH_PX: Final = 14
_ANGLES: Final = (0, 20, 40, 60, 75)  # degrees between the polarisers
_LEDS: Final = {"white": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
# What each task shows, its kind, and which names are right. The leak is light that adds to every pattern with the LEDs'
# level; who knows only the aligned polarisers also has the light between them too strong, and no entry does both.
_LEAK: Final = ("display_black_leak", "veiling_glare")
TASKS: Final = {
    "null": ("angles", "null", ()),
    "null colours": ("colours", "null", ()),
    "leaking polarisers": ("angles", "leaking polarisers", _LEAK),
    "leaking polarisers, known aligned": ("angles", "outsider", _LEAK),
    "LEDs seen unlike": ("colours", "LEDs seen unlike", ("spectral_mismatch",)),
}


def simulators() -> Any:
    """Return the package's models of the light tunnel. Raises ImportError where it is not installed."""
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a citation and what it lacks
        from causalchamber.simulators import lt
    return lt


def make(folder: Path, count: int, first_seed: int) -> None:
    """Write sessions of every task, `count` of each in each channel or of the whole, and `truth.json` next to them.

    Raises:
        ImportError: Where the package is not installed.
    """
    lt, truth, number = simulators(), dict[str, Any](), 0
    for task, (plan, kind, right) in TASKS.items():
        for seed in range(first_seed, first_seed + count):
            for channel in (0, 1, 2) if plan == "angles" else (None,):
                name = f"{number:04d}"
                _write(lt, folder / "sessions" / name, task, channel, seed)
                truth[name] = {"kind": kind, "hidden": [] if kind == "null" else [task], "seed": seed,
                               "right": [list(right)] if right else []}  # fmt: skip
                number += 1
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")


def _write(lt: Any, folder: Path, task: str, channel: int | None, seed: int) -> None:
    dice = np.random.default_rng([seed, sum(map(ord, task)), 3 if channel is None else channel])
    patterns = tuple(f"pol_{angle:02d}" for angle in _ANGLES) if TASKS[task][0] == "angles" else tuple(_LEDS)
    channels = (0, 1, 2) if channel is None else (channel,)  # each clips by itself
    exposure = _HIGHEST / max(_value(lt, "F3", pattern, one) for pattern in patterns for one in channels)
    stated = {pattern: _stated(lt, task, pattern, channel) * exposure for pattern in patterns}
    per_value = _WELL_E * _STOP**2 / (_RIG.electrons_per_radiance_second * _BASE_S)
    errors = {pattern: 1 + _RIG.patch_error * dice.standard_normal(len(_PLACES)) for pattern in patterns}
    patches = tuple(
        PatchDescription(
            name=f"p{n}", x=x, y=y, width=_PATCH_PX, height=_PATCH_PX, u_rel=_RIG.claimed_patch_error,
            radiance_W_per_sr_m2={p: float(stated[p] * per_value * errors[p][n]) for p in patterns},
        )
        for n, (x, y) in enumerate(_PLACES)
    )  # fmt: skip
    with CaptureSetWriter(folder, _RIG.camera(), _RIG.lens(), _RIG.source(), patches, patterns) as writer:
        time_s = 0.0
        for settings in _plan(patterns, dice):
            time_s += float(dice.uniform(20.0, 28.0))
            wander = 1 + _RIG.jitter * dice.standard_normal()
            for _ in range(4):
                time_s += 0.4 + settings.exposure_s
                value = _picture(lt, settings, channel, exposure * wander)
                frame = _developed(value, settings, dice)
                writer.add(Frame(frame, _RIG.bit_depth, replace(settings, timestamp_s=round(time_s, 6))))
        writer.finish()


def _plan(patterns: tuple[str, ...], dice: np.random.Generator) -> list[FrameSettings]:
    """Return a ladder of exposures and one of levels for every pattern, and dark frames, in random order."""
    first = FrameSettings(
        _BASE_S, gain_db=0.0, f_number=_STOP, black_level_dn=_RIG.black_dn, temperature_c=25.0, source_level=1.0,
        pattern=patterns[0], shutter="open",
    )  # fmt: skip
    lit = [replace(first, exposure_s=_BASE_S * share, pattern=p) for p in patterns for share in (0.12, 0.25, 0.5, 1.0)]
    lit += [replace(first, source_level=level, pattern=p) for p in patterns for level in (0.1, 0.3, 0.6)]
    dark = [replace(first, exposure_s=t, shutter="closed") for t in (1e-4, 1e-3, 1e-2, 0.1)]
    both = [*lit, *dark]
    return [both[n] for n in dice.permutation(len(both))]


def _model(lt: Any, name: str, exposure: float) -> Any:
    """Return one of their models with white balance off: a camera that measures has none."""
    even = {"S": _SEEN, "w_r": 1.0, "w_g": 1.0, "w_b": 1.0, "exposure": exposure}
    if name == "F1":
        return lt.ModelF1(**_HEXAGON)
    if name == "F2":
        return lt.ModelF2(**even, **_HEXAGON)
    return lt.ModelF3(**even, Tp=_ALIGNED, Tc=_CROSSED, **_HEXAGON)


def _image(lt: Any, name: str, pattern: str, channel: int | None, level: float, exposure: float) -> np.ndarray:
    """Return a picture of one channel, or of all three as a camera without colours has them."""
    import pandas as pd

    angle, leds = (float(pattern[4:]), (1, 1, 1)) if pattern.startswith("pol_") else (0.0, _LEDS[pattern])
    inputs = dict(zip(("red", "green", "blue"), (255.0 * level * one for one in leds), strict=True))
    asked = pd.DataFrame({**{name: [value] for name, value in inputs.items()}, "pol_1": [angle], "pol_2": [0.0]})
    image = _model(lt, name, exposure).simulate_from_inputs(asked)[0]
    return np.asarray(image.mean(axis=-1) if channel is None else image[:, :, channel])


def _value(lt: Any, name: str, pattern: str, channel: int | None) -> float:
    """Return the value in the hexagon at full level per unit of exposure, unclipped; F1 has one exposure alone."""
    exposure = 1.0 if name == "F1" else _UNCLIPPED
    return float(_image(lt, name, pattern, channel, 1.0, exposure)[_SIDE // 2, _SIDE // 2]) / exposure


def _stated(lt: Any, task: str, pattern: str, channel: int | None) -> float:
    """Return the value in the hexagon as the description has it, per unit of exposure."""
    if task.startswith("leaking polarisers") and channel is not None:
        leak = 0.0 if task.endswith("aligned") else float(_CROSSED[channel, 0])
        return (float(_ALIGNED[channel, 0]) - leak) * _value(lt, "F2", pattern, channel)
    if task == "LEDs seen unlike":
        bright = _value(lt, "F3", "white", channel) / _value(lt, "F1", "white", channel)
        return bright * _value(lt, "F1", pattern, channel)
    return _value(lt, "F3", pattern, channel)


def _picture(lt: Any, settings: FrameSettings, channel: int | None, exposure: float) -> np.ndarray:
    if settings.is_dark:
        return np.zeros((_SIDE, _SIDE))
    level = settings.source_level if settings.source_level is not None else 1.0
    return _image(lt, "F3", settings.pattern, channel, level, exposure * settings.exposure_s / _BASE_S)


def _developed(value: np.ndarray, settings: FrameSettings, dice: np.random.Generator) -> np.ndarray:
    """Return the codes of a picture: photons, read noise, rounding."""
    electrons = dice.poisson(value * _WELL_E + _RIG.dark_e_per_s * settings.exposure_s)
    signal = electrons + _RIG.read_noise_e * dice.standard_normal(value.shape)
    codes = np.rint(_RIG.black_dn + signal / _RIG.e_per_dn)
    return np.clip(codes, 0, _RIG.top_dn).astype(np.uint16)
