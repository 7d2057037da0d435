"""The catalogue, what its effects do to a session's statistics, and each step of a reconciliation."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.data import (
    CameraDescription,
    CaptureHeader,
    Frame,
    FrameEntry,
    FrameSettings,
    LensDescription,
    PatchDescription,
    SourceDescription,
)
from radiometer.reconciliation.engine import examine, whole_catalogue
from radiometer.reconciliation.fit.candidate_fit import Candidate, fit_candidate
from radiometer.reconciliation.fit.covariance import fitted_parameters
from radiometer.reconciliation.fit.covariates import covariates
from radiometer.reconciliation.fit.descent import first_state, refit
from radiometer.reconciliation.fit.full_fit import accepted
from radiometer.reconciliation.fit.linear import RowBlock
from radiometer.reconciliation.fit.state import FitState, reweighted, with_effects
from radiometer.reconciliation.measure.design import Design
from radiometer.reconciliation.measure.reduce import frame_reader, reduce_frames
from radiometer.reconciliation.noise.shared_errors import chances_of_rows
from radiometer.reconciliation.search.localise import localise
from radiometer.reconciliation.statistics import STATISTICS
from simulators.chain.camera_model import CameraModel
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import FrameGeometry
from tests.unit.held.figures import FITS, digest, moved

HEIGHT, WIDTH, ROWS, COLUMNS = 48, 72, 4, 6
PATCHES = [(r * 12, c * 12) for r in range(ROWS) for c in range(COLUMNS)]
LEVELS = np.geomspace(0.01, 1.0, 24)[np.random.default_rng(17).permutation(24)]
PATTERNS = {"chart": LEVELS, "turned": LEVELS[::-1]}

CAMERA = CameraDescription(
    bit_depth=12,
    pixel_pitch_um=4.5,
    conversion_gain_e_per_dn=2.6,
    read_noise_e=2.4,
    full_well_e=10_500.0,
    dark_current_e_per_s=1.0,
    dark_current_reference_C=25.0,
    black_level_dn=64.0,
    quantum_efficiency=0.62,
)


def plan() -> list[dict[str, Any]]:
    """Return settings of all kinds, few of each."""
    dark = [
        {"t": t, "g": g, "closed": True, "T": T}
        for t, g, T in ((1e-4, 0, 35), (1e-2, 12, 35), (1.0, 0, 35), (1.0, 24, 45))
    ]
    ladder = [{"t": float(t), "d": d} for d in (0.9, 0.3) for t in np.geomspace(4e-5, 8e-3, 6)]
    gains = [{"t": 4e-4, "g": g} for g in (0.0, 6.0, 12.0, 18.0)]
    stops = [{"t": 3e-3, "N": n} for n in (2.8, 5.6, 8.0)]
    warm = [{"t": 3e-3, "T": T} for T in (25.0, 45.0)]
    others = [{"t": 3e-3, "pattern": "turned"}, {"t": 0.5, "d": 0.0}]
    return [*dark, *ladder, *gains, *stops, *warm, *others, *({"t": 4e-3} for _ in range(4))]


@cache
def session(hidden: str = "") -> tuple[CaptureHeader, list[Frame]]:
    """Return a session of three frames each; the camera may hide something, and patches be unknown or none."""
    rng = np.random.default_rng([23, len(hidden)])
    rows, columns = np.indices((HEIGHT, WIDTH))
    entries, frames = [], []
    for number, s in enumerate(plan()[i] for i in rng.permutation(len(plan()))):
        temperature = s.get("T", 35.0) + rng.normal(0.0, 0.1)
        levels = PATTERNS[s.get("pattern", "chart")].reshape(ROWS, COLUMNS)
        scene = levels[rows // 12, columns // 12] if hidden != "flats" else 0.5 + 0.001 * columns
        light = s.get("d", 0.9) * (4.0 / s.get("N", 4.0)) ** 2 * (1 + 1e-3 * rng.standard_normal())
        for repeat in range(3):
            seconds = s["t"] + (2e-5 if hidden == "offset" else 0.0)
            expected = scene * 10_500.0 * light * seconds / 6e-3 * (not s.get("closed"))
            expected = expected + 2.0 ** ((temperature - 25.0) / 7.0) * s["t"]
            charge = np.minimum(rng.poisson(expected), 10_500) + rng.normal(0.0, 2.4, expected.shape)
            if hidden == "spots":  # pixels of their own, more of them where it is dark for long; a dead one, a column
                charge[::11, ::13] += 900.0 + 4000.0 * s["t"]
                charge[7, 30] = 0.0
                charge[:, 50] += 40.0
            dn = np.clip(np.floor(64.5 + charge * 10 ** (s.get("g", 0.0) / 20) / 2.6), 0, 4095).astype(np.uint16)
            settings = FrameSettings(
                s["t"], s.get("g", 0.0), s.get("N", 4.0), 64.0, round(temperature, 2), 2.5 * (3 * number + repeat + 1),
                s.get("d", 0.9), s.get("pattern", "chart"), "closed" if s.get("closed") else "open",
            )  # fmt: skip
            entries.append(FrameEntry.of(f"frames/{len(entries):04d}.png", settings))
            frames.append(Frame(dn, 12, settings, len(frames)))
    patches = tuple(
        PatchDescription(
            name=f"p{k}", x=x, y=y, width=12, height=12, u_rel=5e-3,
            radiance_W_per_sr_m2=None if hidden == "unknown" else {name: float(v[k]) for name, v in PATTERNS.items()},
        )
        for k, (y, x) in enumerate(PATCHES)
    )  # fmt: skip
    header = CaptureHeader(
        camera=CAMERA,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.95),
        source=SourceDescription(kind="screen", wavelength_nm=550.0, reproducibility_u_rel=1e-3),
        patterns=tuple(PATTERNS),
        patches=() if hidden == "flats" else patches,
        frames=tuple(entries),
    )
    return header, frames


@cache
def start(hidden: str = "") -> FitState:
    header, frames = session(hidden)
    design = Design.of(header, frames[0].dn.shape)
    return first_state(design, *reduce_frames(design, frame_reader(frames)))


def fields(thing: Any) -> dict[str, Any]:
    """Return the digests of a dataclass's arrays, and its numbers."""
    found = {}
    for field in dataclasses.fields(thing):
        value = getattr(thing, field.name)
        if isinstance(value, np.ndarray):
            found[field.name] = digest(value)
        elif isinstance(value, bool | int | float):
            found[field.name] = value
    return found


def blocks(state: FitState, residual: NDArray[np.float64]) -> dict[str, list[float]]:
    """Return the digest of a vector of whitened differences, statistic by statistic."""
    return {name: digest(residual[cut]) for name, cut in state.comparison.cuts.items()}


def with_all_terms(kind: type[CatalogueEffect]) -> CatalogueEffect:
    """Return an effect none of whose parameters is at its default: each a thirtieth of its range above it, or below."""
    values = {}
    for one in kind.parameters():
        if isinstance(one.default, float):
            low, high = one.bounds(CAMERA.full_scale_dn)
            step = (high - low) / 30.0
            values[one.name] = one.default + (step if one.default + step <= high else -step)
    return kind().with_parameters(**values)


def sampled(effect: CatalogueEffect, seed: int) -> list[Any]:
    """Return the digest of a frame that a camera with an effect takes of a wedge on a display; the second is dark."""
    model = CameraModel.ideal(CAMERA, LensDescription(focal_length_mm=16.0, f_number=4.0)).with_effect(effect)
    rows, columns = np.indices((24, 36))
    wedge = 0.02 * 10 ** (2.0 * columns / 36) * (1.0 + 0.1 * (rows > 12))
    shutter = "closed" if seed == 2 else "open"
    settings = FrameSettings(
        0.02 * seed, 6.0 * (seed - 1), 4.0, 64.0, 25.0 + 4 * seed, 3.0 * seed, 0.8, "default", shutter
    )
    geometry = FrameGeometry.of_image(36, 24, sensor_width=72, sensor_height=60, x=10, y=8, pixel_spacing_um=4.5)
    context = model.context(
        settings, geometry, frame_index=seed, code=wedge / 3.0, peak_radiance=3.0, previous_e=400.0 * wedge,
        since_light_s=2.0, since_frame_s=0.5, device_seed=4,
    )  # fmt: skip
    exposed = model.sample(wedge, context, (5, seed))
    return [digest(exposed.dn), digest(exposed.electrons)]


def whole(block: RowBlock, size: int) -> np.ndarray:
    """Return a block as the matrix of all rows."""
    return block.times(np.eye(block.columns), size)


def weighed(state: FitState, effect: CatalogueEffect) -> dict[str, Any]:
    """Return what is left of each statistic, and how it is weighted, where an effect is part of the model."""
    there = reweighted(with_effects(state, (effect,)))
    return {
        "tau": there.tau,
        "terms": [term.size for term in there.terms],
        "columns": of_terms(there),
        "left": digest(there.plain_residual),
        "by statistic": {n: d for n, d in blocks(there, there.plain_residual).items() if d[2]},
        "shared": {n: digest(w) for n, w in there.comparison.whiteners.items()},
    }


def of_terms(state: FitState) -> list[float]:
    """Return the digest of the terms' squares, summed: patterns of equal variance turn freely among themselves."""
    return digest(np.square(whole(state.term_block, state.comparison.size)).sum(axis=1))


@pytest.mark.parametrize("name", sorted(whole_catalogue()))
def test_an_entry_is_as_it_was(name):
    """What an entry says of itself, and what each of its starts does to every predicted statistic."""
    kind = whole_catalogue()[name]
    state = start()
    context = state.model.context
    said = {
        key: getattr(kind, key)
        for key in CatalogueEffect.__annotations__
        if key not in ("settles", "prior_reason")
        if hasattr(kind, key) and getattr(kind, key) != getattr(CatalogueEffect, key, None)
    }
    said["stage"] = str(kind.stage)
    said["trials"] = [len(kind.trials), *kind.trials[:3], *kind.trials[-1:]]
    told: dict[str, Any] = {"says": said}
    told["parameters"] = {
        one.name: [one.unit, one.low, one.high, one.default, one.of_full_scale] for one in kind.parameters()
    }
    base = fields(state.prediction)
    starts = kind.starts(context)
    told["starts"] = [len(starts), *(one.values() for one in starts[:6])]
    tried = {f"start {k}": one for k, one in enumerate(starts[:2])}
    tried["all terms"] = starts[-1] if kind.is_stepwise else with_all_terms(kind)
    tried |= {f"looser {k}": one for k, one in enumerate(tried["all terms"].loosened(context)[:3])}
    tried |= {f"cover {k}": one for k, one in enumerate(kind.covers(context)[:2])}
    tried |= {
        f"nearby {k}": one for k, one in enumerate([*starts[0].nearby(HEIGHT, 0)[:1], *starts[0].nearby(HEIGHT, 1)[:1]])
    }
    told["does"] = {}
    for title, effect in tried.items():
        found = fields(state.predicted_with((effect,)))
        does = {key: found[key] for key in found if not np.allclose(found[key], base[key], rtol=1e-9)}
        told["does"][title] = {"values": effect.values(), "free": list(effect.free()), **does}
    told["samples"] = [sampled(tried["start 0"], seed) for seed in (1, 2)] + [sampled(tried["all terms"], 3)]
    told["weighs"] = {title: weighed(state, tried[title]) for title in ("start 0", "all terms") if title in tried}
    assert not moved(f"effects/{name}", told, rel=1e-6)


def plain_plan() -> list[dict[str, Any]]:
    """Return settings that differ in exposure alone."""
    return [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 5)] + [{"t": 1e-2, "closed": True}]


def rich_plan() -> list[dict[str, Any]]:
    """Return settings of more values of each kind than entries ask for before they have a table or a further term."""
    levels = [{"t": 2e-3, "d": float(d)} for d in np.geomspace(0.1, 0.9, 6)]
    gains = [{"t": 3e-4, "g": float(g)} for g in (0, 6, 10, 12, 20)]
    stops = [{"t": 2e-3, "N": float(n)} for n in (2.0, 2.8, 5.6, 8.0)]
    warm = [{"t": 2e-3, "T": float(t)} for t in (15, 25, 45, 55)]
    dark = [{"t": t, "T": T, "closed": True} for t in (1e-4, 0.1, 1.0) for T in (20, 45)]
    return [*plan(), *levels, *gains, *stops, *warm, *dark]


@cache
def small(rich: bool) -> FitState:
    """Return the start of a fit to two frames of six patches for each setting of a plan."""
    rng = np.random.default_rng([31, rich])
    rows, columns = np.indices((24, 36))
    levels = {"chart": np.geomspace(0.03, 1.0, 6), "turned": np.geomspace(0.05, 0.9, 6)[::-1]}
    entries, frames = [], []
    for number, s in enumerate(rich_plan() if rich else plain_plan()):
        scene = levels[s.get("pattern", "chart")].reshape(2, 3)[rows // 12, columns // 12]
        for repeat in range(2):
            light = scene * 10_500.0 * s.get("d", 0.9) * (4.0 / s.get("N", 4.0)) ** 2 * s["t"] / 6e-3
            charge = rng.poisson(light * (not s.get("closed")) + 3.0 * s["t"]) + rng.normal(0.0, 2.4, scene.shape)
            dn = np.clip(np.floor(64.5 + charge * 10 ** (s.get("g", 0.0) / 20) / 2.6), 0, 4095).astype(np.uint16)
            settings = FrameSettings(
                s["t"], s.get("g", 0.0), s.get("N", 4.0), 64.0, s.get("T", 35.0), 40.0 * number + 3.0 * repeat,
                s.get("d", 0.9), s.get("pattern", "chart"), "closed" if s.get("closed") else "open",
            )  # fmt: skip
            entries.append(FrameEntry.of(f"frames/{len(entries):04d}.png", settings))
            frames.append(Frame(dn, 12, settings, len(frames)))
    patches = tuple(
        PatchDescription(
            name=f"p{k}", x=12 * (k % 3), y=12 * (k // 3), width=12, height=12, u_rel=5e-3,
            radiance_W_per_sr_m2={name: float(v[k]) for name, v in levels.items()},
        )
        for k in range(6)
    )  # fmt: skip
    header = CaptureHeader(
        camera=CAMERA,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.95),
        source=SourceDescription(kind="screen", wavelength_nm=550.0, reproducibility_u_rel=1e-3),
        patterns=tuple(levels),
        patches=patches,
        frames=tuple(entries),
    )
    design = Design.of(header, frames[0].dn.shape)
    return first_state(design, *reduce_frames(design, frame_reader(frames)))


def said_of(effect: CatalogueEffect) -> list[Any]:
    return [effect.name, {k: v for k, v in effect.values().items() if v}, list(effect.free())]


@pytest.mark.parametrize("rich", [False, True], ids=["plain", "rich"])
def test_which_forms_entries_have_in_a_session_is_as_it_was(rich):
    """Which entries can be told by its settings at all; what their starts, covers and looser forms begin with."""
    context = small(rich).model.context
    told: dict[str, Any] = {}
    for name, kind in sorted(whole_catalogue().items()):
        starts = kind.starts(context)
        told[name] = {
            "usable": bool(kind.usable(context)),
            "starts": [len(starts), *(said_of(one) for one in (*starts[:1], *starts[-1:]))],
            "covers": [len(kind.covers(context)), *(said_of(one) for one in kind.covers(context)[:2])],
            "looser": [
                [said_of(form), *(said_of(one) for one in form.loosened(context))]
                for form in (starts[0].loosened(context)[:3] if starts else ())
            ],
        }
    assert not moved(f"reconcile/forms_{'rich' if rich else 'plain'}", told, rel=1e-6)


# What meets in one statistic: lines that stay and lines that come and go, waves, trends, patterns and noise of pixels.
TOGETHER = (
    ("row_temporal_noise", "row_pattern"),
    ("row_temporal_noise", "rolling_shutter_banding"),
    ("row_temporal_noise", "row_pattern", "column_pattern", "rolling_shutter_banding"),
    ("row_pattern", "column_pattern", "prnu", "dsnu"),
    ("mains_ripple", "source_warmup_drift"),
    ("correlated_read_noise", "crosstalk", "brighter_fatter"),
    ("image_lag", "hot_pixels", "dark_current_nonuniformity"),
    ("exposure_time_offset", "response_nonlinearity", "veiling_glare", "gain_step_error"),
)


@pytest.mark.parametrize("kind", ["", "flats"])
@pytest.mark.parametrize("names", TOGETHER, ids=" + ".join)
def test_entries_together_are_as_they_were(names, kind):
    """What several of them do to every predicted statistic, how it is weighted, and what they share."""
    state = start(kind)
    context = state.model.context
    effects = tuple(with_all_terms(whole_catalogue()[name]) for name in names)
    effects = tuple(
        one if one.free() else whole_catalogue()[name].starts(context)[-1]
        for one, name in zip(effects, names, strict=True)
    )
    there = reweighted(with_effects(state, effects))
    told = {
        "predicted": fields(state.predicted_with(effects)),
        "tau": there.tau,
        "misfit": there.misfit,
        "values": [one.values() for one in effects],
        "left": digest(there.plain_residual),
        "by statistic": {n: d for n, d in blocks(there, there.plain_residual).items() if d[2]},
        "deviation": {n: digest(v) for n, v in there.comparison.deviation.items()},
        "shared": {n: digest(w) for n, w in there.comparison.whiteners.items()},
        "columns": of_terms(there),
    }
    if "row_temporal_noise" in names and not kind:  # what their rows' chance variance does to what is fitted
        found = fitted_parameters(there)
        compared = there.comparison
        told["rows"] = {
            error.name: {"by bin": digest(error.variance)} | {n: fields(part) for n, part in error.parts.items()}
            for error in chances_of_rows(compared.design, compared.seen, there.prediction, compared.band_freedom)
        }
        told["u"] = {k: {n: fields(one) for n, one in group.items()} for k, group in found.items()}
    assert not moved(f"reconcile/together_{'_'.join(names)}_{kind or 'known'}", told, rel=1e-5)


# Patches of known radiance, none at all, patches of unknown radiance, pixels that stand out.
KINDS = ("", "flats", "unknown", "spots")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_measured_is_as_it_was(kind):
    """The design of a session and every statistic of its frames."""
    state = start(kind)
    design = state.design
    told = {
        "design": {
            name: digest(getattr(design, name))
            for name in sorted(vars(type(design)))
            if isinstance(getattr(design, name, None), np.ndarray)
        },
        "seen": fields(state.seen),
    }
    assert not moved(f"reconcile/measured_{kind or 'known'}", told, rel=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_fit_is_as_it_was(kind):
    """Nuisances, predicted statistics, what counts, weights and what is left of each statistic."""
    state = start(kind)
    comparison = state.comparison
    told = {
        "values": state.values,
        "tau": state.tau,
        "gap": state.gap,
        "misfit": state.misfit,
        "predicted": fields(state.prediction),
        "usable": {name: digest(mask) for name, mask in comparison.usable.items()},
        "deviation": {name: digest(comparison.deviation[name][comparison.usable[name]]) for name in comparison.usable},
        "whiteners": {name: digest(value) for name, value in comparison.whiteners.items()},
        "comparison": fields(comparison),
        "left": blocks(state, state.plain_residual),
        "sensitivity": digest(state.sensitivity),
        "covariates": {name: digest(one.basis()) for name, one in covariates(state.model, state.prediction).items()},
        "tests": [[t.block, t.where, t.form, t.chi2, t.rank, t.p_value] for t in localise(state)],
    }
    assert set(comparison.usable) == set(STATISTICS)
    assert not moved(f"reconcile/first_fit_{kind or 'known'}", told, rel=10 * FITS)


TRIED = (
    "exposure_time_offset",
    "veiling_glare",
    "dark_current",
    "prnu",
    "gain_step_error",
    "excess_read_noise",
    "image_lag",
)


@pytest.mark.parametrize("name", TRIED)
def test_a_candidate_is_fitted_as_it_was(name):
    """Gain, evidence and values of entries that are not there, in a session that hides another."""
    state = start("offset")
    starts = whole_catalogue()[name].starts(state.model.context)
    found = fit_candidate(state, Candidate(starts[0], 0.0, len(starts[0].free()) or 1, others=starts[1:3]))
    nats = {name: round(getattr(found, name), 9) for name in ("gain", "evidence", "stated")}  # nothing but for rounding
    told = (
        fields(found)
        | nats
        | {
            "values": found.effect.values(),
            "left": blocks(state, found.residual[: state.comparison.size]),
        }
    )
    assert not moved(f"reconcile/candidate_{name}", told, rel=100 * FITS)


def test_an_accepted_effect_is_fitted_as_it_was():
    """Its parameters with u, and the gap that is left."""
    state = start("offset")
    kind = whole_catalogue()["exposure_time_offset"]
    state = accepted(state, kind.starts(state.model.context)[0])
    state = refit(reweighted(state))
    fitted = fitted_parameters(state)
    told = {
        "gap": state.gap,
        "values": state.values,
        "parameters": {k: {n: fields(one) for n, one in group.items()} for k, group in fitted.items()},
        "left": blocks(state, state.plain_residual),
    }
    offset_s = fitted["exposure_time_offset"]
    assert any(abs(one.value - 2e-5) < 4.0 * one.u for one in offset_s.values())  # what the session hides
    assert not moved("reconcile/accepted", told, rel=100 * FITS)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["", "offset"])
def test_a_whole_reconciliation_is_as_it_was(hidden):
    """Verdict, effects, parameters, gaps, tests, limits: the result as it is written, but for counted draws."""
    header, frames = session(hidden)
    found = examine(header, frame_reader(frames), frames[0].dn.shape).result.to_mapping()
    for words in ("provenance", "remarks", "next_capture", "seconds", "global_p"):
        found.pop(words, None)
    assert not moved(f"reconcile/whole_{hidden or 'nothing'}", found, rel=1000 * FITS)
