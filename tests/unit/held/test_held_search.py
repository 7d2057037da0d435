"""Whole reconciliations of small sessions, each with few entries to choose from."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.data import (
    CaptureHeader,
    Frame,
    FrameEntry,
    FrameSettings,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.reconciliation import engine
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.fit.descent import first_state
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import frame_reader, reduce_frames
from radiometer.reconciliation.search.free_forms import free_forms
from radiometer.reconciliation.search.free_laws import promise
from radiometer.reconciliation.search.localise import global_p_value, localise, places, significant
from radiometer.reconciliation.search.outcome import Reconciled
from radiometer.reconciliation.search.screening import screen
from tests.unit.held.figures import FITS, digest, moved
from tests.unit.held.test_held_reconcile import CAMERA

HEIGHT, WIDTH, SIDE = 36, 48, 12  # tiles of 12 × 12
TILES = (HEIGHT // SIDE) * (WIDTH // SIDE)
LEVELS = np.geomspace(0.02, 1.0, TILES)[np.random.default_rng(5).permutation(TILES)]
Image = NDArray[np.float64]


def plan() -> list[dict[str, float]]:
    """Return settings: darks, a ladder at two levels, gains, stops, and equal frames."""
    dark = [{"t": t, "g": g, "d": -1.0} for t, g in ((1e-4, 0.0), (1e-2, 12.0), (1.0, 0.0))]
    ladder = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(5e-5, 7e-3, 6)]
    others = [{"t": 4e-4, "g": 6.0}, {"t": 4e-4, "g": 12.0}, {"t": 3e-3, "N": 2.8}, {"t": 3e-3, "N": 5.6}]
    return [*dark, *ladder, *others, *({"t": 4e-3} for _ in range(4))]


@cache
def session(hidden: str) -> tuple[CaptureHeader, list[Frame]]:
    """Return a session of four frames for each setting, whose camera or light hides something.

    What is hidden has equations of its own here, image by image; the analysis has them tile by tile.
    """
    rng = np.random.default_rng([29, len(hidden)])
    rows, columns = np.indices((HEIGHT, WIDTH))
    scene = LEVELS.reshape(HEIGHT // SIDE, -1)[rows // SIDE, columns // SIDE]
    slant2 = ((rows - 17.5) ** 2 + (columns - 23.5) ** 2) / (17.5**2 + 23.5**2)
    order = rng.permutation(len(plan()))
    entries, frames = [], []
    for s in (plan()[i] for i in order):
        warm = 35.0 + rng.normal(0.0, 0.1)
        stop, gain_db, level = s.get("N", 4.0), s.get("g", 0.0), s.get("d", 0.9)
        for _ in range(4):
            number, t = len(frames), s["t"]
            light = scene * 10_500.0 / 6e-3 * max(level, 0.0) * (4.0 / stop) ** 2 * (1 + 1e-3 * rng.standard_normal())
            if hidden.startswith("offset"):
                t = t + 3e-5
            if "quantum" in hidden:
                t = 6e-5 * max(np.rint(t / 6e-5), 1.0)
            if "veil" in hidden:
                light = 0.95 * light + 0.05 * light.mean()
            if "cone" in hidden:
                light = light * (1.0 - 0.3 / stop**2) / (1.0 + 0.1 * slant2) ** 2
            if "curved offset" in hidden:  # most of it at long exposures
                t = t + 3e-5 * (1.0 + 0.7 * np.tanh(np.log(t / 6e-4)))
            if "turns" in hidden:  # one frame in five is darker
                light = light * (1.0 - 0.03 * (number % 5 == 1))
            if "flicker" in hidden:
                light = light * (1.0 + 0.1 * np.sinc(140.0 * t) * np.sin(rng.uniform(0.0, 2.0 * np.pi)))
            if "wave" in hidden:
                wave = np.cos(2.0 * np.pi * 3.0 * rows / HEIGHT + rng.uniform(0.0, 2.0 * np.pi))
                light = light * (1.0 + 0.1 * np.sinc(100.0 * t) * wave)
            expected = np.minimum(light * t, 20_000.0)
            expected = expected + 2.0 ** ((warm - 25.0) / 7.0) * s["t"]
            charge = np.minimum(rng.poisson(expected), 10_500) + rng.normal(0.0, 2.4, scene.shape)
            if "rows" in hidden:
                charge = charge + rng.normal(0.0, 3.0, (HEIGHT, 1))
            dn = 64.5 + charge * 10 ** (gain_db / 20) / 2.6
            settings = FrameSettings(
                s["t"], gain_db, stop, 64.0, round(warm, 2), 2.5 * (number + 1), max(level, 0.0), "chart",
                "closed" if level < 0 else "open",
            )  # fmt: skip
            entries.append(FrameEntry.of(f"frames/{number:04d}.png", settings))
            frames.append(Frame(np.clip(np.floor(dn), 0, 4095).astype(np.uint16), 12, settings, number))
    patches = tuple(
        PatchDescription(
            name=f"p{k}", x=k % 4 * SIDE, y=k // 4 * SIDE, width=SIDE, height=SIDE, u_rel=5e-3,
            radiance_W_per_sr_m2=float(LEVELS[k]),
        )
        for k in range(TILES)
    )  # fmt: skip
    header = CaptureHeader(
        camera=CAMERA,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.95),
        source=SourceDescription(kind="screen", wavelength_nm=550.0, reproducibility_u_rel=1e-3),
        patterns=("chart",),
        patches=() if "without patches" in hidden else patches,
        frames=tuple(entries),
    )
    return header, frames


# What is hidden, and the entries that a search may name.
SEARCHES = {
    "nothing": ("exposure_time_offset", "veiling_glare", "excess_read_noise"),
    "offset without patches": ("exposure_time_offset", "veiling_glare"),
    "curved offset": ("exposure_time_offset", "shutter_dead_time"),
    "offset and veil": ("exposure_time_offset", "veiling_glare", "black_level_offset"),
    "quantum": ("exposure_quantisation", "exposure_time_offset"),
    "cone": ("natural_vignetting", "fnumber_tstop_error", "angle_dependence"),
    "turns": ("exposure_time_offset",),
    "flicker": ("mains_ripple", "pwm_flicker"),
    "wave": ("rolling_shutter_banding", "row_temporal_noise"),
    "rows": ("row_temporal_noise", "excess_read_noise"),
}

# Dear ones whose every line (of the last, all but 14 of 3,547) the others take as well, by the record of coverage, run
# with the whole suite only.
WHOLE_SUITE = {"offset and veil", "offset without patches", "cone"}


@cache
def reconciled(hidden: str) -> tuple[Reconciled, tuple[str, ...]]:
    header, frames = session(hidden)
    entries = {name: whole_catalogue()[name] for name in SEARCHES[hidden]}
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patched:  # laws of no entry are another search, and three quarters of the time
        patched.setattr(engine, "held_to_laws", lambda *_: None)
        patched.setattr(sys.modules[localise.__module__], "_DRAWS", 100)  # the chance that they count is not held here
        found = engine.examine(header, frame_reader(frames), frames[0].dn.shape, catalogue=entries, say=said.append)
    return found, tuple(said)


@pytest.mark.parametrize(
    "hidden", [pytest.param(hidden, marks=[pytest.mark.slow] * (hidden in WHOLE_SUITE)) for hidden in SEARCHES]
)
def test_a_search_is_as_it_was(hidden):
    """Verdict, names, parameters, gaps, limits, tests, advice and every sentence of a whole reconciliation."""
    found, said = reconciled(hidden)
    told: dict[str, Any] = found.result.to_mapping()
    for passing in ("provenance", "seconds", "global_p"):  # the last is counted in draws, which rounding turns
        told.pop(passing, None)
    assert not moved(f"search/{hidden.replace(' ', '_')}", told | {"said": list(said)}, rel=100 * FITS)


@cache
def started(hidden: str) -> FitState:
    header, frames = session(hidden)
    design = Design.of(header, frames[0].dn.shape)
    return first_state(design, *reduce_frames(design, frame_reader(frames)))


FREED = (
    "exposure_time_offset",
    "response_nonlinearity",
    "natural_vignetting",
    "veiling_glare",
    "dark_current",
    "reciprocity_failure",
    "fnumber_tstop_error",
)


SEEN = (
    "exposure_time_offset",
    "reciprocity_failure",
    "black_level_offset",
    "prnu",
    "excess_read_noise",
    "gamma_enabled",
)


@pytest.mark.parametrize("name", FREED)
def test_laws_are_freed_as_they_were(name):
    """Along which covariates, with which knots; what each form does to a signal, its slope, draws and statistics."""
    state = started("offset")
    context, kind = state.model.context, whole_catalogue()[name]
    own = kind.starts(context)[0]
    captures, tiles = state.prediction.mean.shape
    signal = np.linspace(5.0, 9000.0, captures * tiles).reshape(captures, tiles, 1)
    told: dict[str, Any] = {}
    for number, form in enumerate(free_forms(state, own)):
        size = len(form.law_names())
        bent = form.with_parameters(law=tuple(0.7 + 0.6 * k / size for k in range(size)))
        told[f"{number} along {', '.join(form.axes)}"] = {
            "values": form.values(), "free": list(bent.free()), "promises": promise(state, form),
            "weight": digest(bent.weight(signal, context) + 0.0 * signal),
            "mean": digest(bent.mean(signal, context)),
            "left": digest(state.comparison.residual(state.predicted_with((bent,)))),
            "slope": digest(bent.slope(signal, context) + 0.0 * signal),
            "sample": digest(bent.sample(signal, context, np.random.default_rng(3))),
        }  # fmt: skip
    assert not moved(f"search/freed_{name}", told, rel=10 * FITS)


def test_what_a_search_looks_at_is_as_it_was():
    """What each entry of the catalogue would explain at first sight, the tests, the places, the global chance."""
    state = started("offset")
    tests = localise(state)
    told: dict[str, Any] = {
        "screened": [
            [one.effect.name, one.gain, one.parameters, one.flexible, one.tries, len(one.others)]
            for one in screen(state, {name: whole_catalogue()[name] for name in SEEN})
        ],
        "places": [[one.block, one.where, one.form, one.chi2, one.rank] for one in places(state, 5)],
        "global p": global_p_value(state, tests),
        "tests": len(tests),
        "significant": len(significant(tests)),
    }
    assert not moved("search/first_sight", told, rel=10 * FITS)
