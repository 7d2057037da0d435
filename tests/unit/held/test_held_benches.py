"""Plans of exposures and levels, what may shine for how long, protocols, runs and fits of dark adaptation, defaults."""

from __future__ import annotations

import itertools
import os
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.acquire.bracketing import BracketRequest, plan_for_scene, take_plan
from radiometer.acquire.characterisation_ladder import LadderRequest, saturating_exposure_s, take_ladder
from radiometer.acquire.exposure_plan import (
    ExposurePlan,
    ExposureWindow,
    exposure_ladder,
    plan_exposures,
    repeats_for,
    steadied,
)
from radiometer.acquire.light_levels import Measured, SpectralCorrection, assemble, plan_levels
from radiometer.acquire.metering import meter
from radiometer.acquire.reach import assess_reach
from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.bleach import bleached_fraction, bleached_range, pupil_diameter_mm, retinal_exposure_for
from radiometer.adaptation.checks import judge_room
from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.method_bias import method_bias
from radiometer.adaptation.methods import begin
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.reliability import Count, Reliability
from radiometer.adaptation.report import meaning, outcome, to_mapping
from radiometer.adaptation.retest import limits_of_agreement
from radiometer.adaptation.rod_intercept import InterceptRule
from radiometer.adaptation.run import run_test
from radiometer.adaptation.screen_levels import SpotLevels, field_code, mark_code, within_reach
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.bench.config import read_bench
from radiometer.daemon.keeper import KeeperTimes
from radiometer.daemon.service import ServiceOptions
from radiometer.data import CameraDescription, LensDescription, Patch
from radiometer.data.light_calibration import LightCalibration
from radiometer.devices import CameraCapabilities, CameraPreset, CameraSettings
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.light_box import ChannelCapabilities, CurrentRange, DriveLevel
from radiometer.devices.retinal_safety import (
    ChannelOptics,
    FlashLight,
    blue_light_weight,
    hazard_fractions,
    thermal_weight,
)
from radiometer.errors import RadiometerError, UnsafeStimulus
from radiometer.screen.calibration import ChannelCurve, ScreenCalibration
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import scene_from_mapping
from testing.scripted_adaptation import ScriptedStage, eye, threshold
from tests.unit.held.figures import FITS, digest, moved

ROOT = Path(__file__).resolve().parents[3]
CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10_500.0)
LIMITS_S = (11e-6, 30.0)


def of_plan(plan: ExposurePlan) -> dict[str, Any]:
    return {
        "exposures_s": list(plan.exposures_s), "bright": plan.too_bright, "dark": plan.too_dark, "cut": plan.cut_short,
        "total_s": plan.total_s,
    }  # fmt: skip


def test_plans_of_exposures_are_as_they_were():
    """Scenes of many ranges at several gains, ladders, flicker and repeats."""
    told: dict[str, Any] = {}
    for decades, gain_db in itertools.product((0.5, 2.0, 5.0), (0.0, 18.0)):
        rates = np.geomspace(300.0, 300.0 * 10**decades, 900)
        rates[:3] = (np.inf, 0.0, 1e-9)
        window = ExposureWindow.of(CAMERA, gain_db, 64.0)
        plan = plan_exposures(rates, window, gain_db, LIMITS_S)
        limited = plan_exposures(rates, window, gain_db, LIMITS_S, minimum_cover=3, time_limit_s=0.5)
        told[f"{decades:g} decades, {gain_db:g} dB"] = {
            "window": [window.lowest_dn, window.highest_dn, window.clipping_dn],
            "plan": of_plan(plan),
            "limited": of_plan(limited),
            "steadied": of_plan(steadied(plan, None, 20.0)),
            "steadied at 60 Hz": of_plan(steadied(limited, 60.0, 2.0)),
            "repeats": [repeats_for(plan, rates[5:], CAMERA, gain_db, u) for u in (0.01, 1e-4, 1e-5)],
        }
    told["ladders"] = [
        of_plan(exposure_ladder(*ladder)) for ladder in ((1e-4, 0.1, 1.0, LIMITS_S), (1e-3, 0.05, 1.5, LIMITS_S, 2))
    ]
    assert not moved("benches/exposures", told)


def camera_before(scene: dict[str, Any]) -> SimulatedCamera:
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    model = CameraModel.ideal(preset, LensDescription(focal_length_mm=16, f_number=4.0))
    limits = CameraCapabilities((11e-6, 30.0), (0.0, 47.9), (0.0, 511.0), ("Mono12",), 60, 40, True, True)
    camera = SimulatedCamera(model, scene_from_mapping(scene), seed=3, limits=limits)
    camera.open()
    camera.configure(CameraSettings(0.01, black_level_dn=64.0))
    return camera


def test_a_bracket_is_taken_as_it_was():
    """Metering, plan, frames and reach before a chart of five decades, and a ladder before an even field."""
    camera = camera_before({"kind": "step_chart", "steps": {"count": 10, "lowest": 1e-4, "highest": 10.0}})
    told: dict[str, Any] = {}
    for name, request in {
        "plain": BracketRequest(dark_frames=2),
        "part": BracketRequest(Patch(0, 0, 24, 40), 1e-3, 5.0),
        "hurried": BracketRequest(time_limit_s=0.3),
    }.items():
        plan = plan_for_scene(camera, request)
        frames = list(take_plan(camera, plan, request))
        reach = assess_reach(frames, camera.description, request.region)
        told[name] = of_plan(plan) | {
            "taken": [[f.settings.exposure_s, f.settings.is_dark] for f in frames],
            "dn": [digest(f.dn) for f in frames],
            "cover": digest(reach.cover),
            "saturated": digest(reach.saturated),
            "below": digest(reach.below_noise),
            "sentences": reach.sentences(),
        }
    rates = meter(camera, None, longest_s=0.5)
    told["rates"] = digest(rates.rates_dn_per_s)
    told["trials"] = [f.settings.exposure_s for f in rates.trials]
    even = camera_before({"kind": "uniform", "radiance_W_per_sr_m2": 0.3})
    region = Patch(8, 8, 32, 24)
    told["saturating"] = saturating_exposure_s(even, region)
    ladder = take_ladder(even, LadderRequest(region, steps=7, stack=3, dark_exposures_s=(0.5,)))
    told["ladder"] = [[f.settings.exposure_s, f.settings.is_dark] for f in ladder]
    assert not moved("benches/bracket", told)


CHANNEL = ChannelCapabilities("spot", 460.0, 4096, 1000.0, {CurrentRange.LOW: 65535, CurrentRange.HIGH: 30000})


def test_levels_of_light_are_as_they_were():
    """The levels that are measured, what becomes of them, and what a calibrated box chooses for a radiance."""
    planned = [[d.level, str(d.current_range)] for d in plan_levels(CHANNEL, 4.0)]
    points = [
        Measured(DriveLevel(level, rng), radiance, 0.001, 0.01, 1.02, 20.0 + k, float(k))
        for k, (level, rng, radiance) in enumerate(
            [(400, CurrentRange.LOW, 2e-5), (6_000, CurrentRange.LOW, 3.1e-4), (60_000, CurrentRange.LOW, 3e-3),
             (4_000, CurrentRange.HIGH, 0.02), (15_000, CurrentRange.HIGH, 0.074), (30_000, CurrentRange.HIGH, 0.14)]
        )
    ]  # fmt: skip
    references = [
        Measured(DriveLevel(7500), r, 0.001, 0.01, 1.0, 20.0, o)
        for r, o in ((0.0371, -0.5), (0.0369, 2.5), (0.036, 5.5))
    ]
    made = assemble(CHANNEL, points, references, SpectralCorrection(1.1, 0.02))
    box = LightCalibration("1", {"spot": made}, created="2026-01-01T00:00:00Z")
    chosen = {}
    for radiance in (1e-5, 3e-5, 4e-4, 2.2e-3, 0.01, 0.05, 0.12, 0.5):
        try:
            choice = box.choose("spot", radiance)
            chosen[f"{radiance:g}"] = asdict(choice)
        except RadiometerError as error:
            chosen[f"{radiance:g}"] = type(error).__name__
    told = {
        "planned": planned, "made": made.model_dump(mode="json"), "chosen": chosen, "limits": list(box.limits("spot")),
        "highest": [box.highest_radiance("spot", level, high) for level in (500, 20_000) for high in (False, True)],
        "drive": [list(box.drive_for("spot", r)) for r in (1e-3, 0.1)],
    }  # fmt: skip
    assert not moved("benches/levels", told)


def test_what_may_shine_is_as_it_was():
    """Weights, fractions of both limits over radiance and time, and a ledger's yes and no over three hours."""
    wavelength = np.arange(300.0, 1100.0, 5.0)
    optics = {
        "white": ChannelOptics(None, 0.0, 4.0, 2e4),
        "blue": ChannelOptics(460.0, 25.0, 1.5, 3e3, 0.02),
        "red": ChannelOptics(630.0, 18.0, 0.3, 5e2),
    }
    told: dict[str, Any] = {
        "blue-light weight": digest(blue_light_weight(wavelength)),
        "thermal weight": digest(thermal_weight(wavelength)),
        "flash": [
            getattr(FlashLight(8.0, 12.0, 2e-3, 20.0).optics, name)
            for name in ("subtense_deg", "radiance_bound_w_sr_m2")
        ],
        "fractions": {
            f"{name} {radiance:g} {seconds:g} s": [
                hazard_fractions(one, radiance, seconds).blue_light,
                hazard_fractions(one, radiance, seconds).thermal,
            ]
            for name, one in optics.items()
            for radiance in (1.0, 300.0)
            for seconds in (1e-3, 2.0, 60.0, 3e3, 2e4)
        },
    }
    now = [0.0]
    ledger = ExposureLedger(optics, lambda: now[0])
    answers = []
    for k in range(60):
        now[0] = 190.0 * k
        channel, radiance, seconds = (("white", 20.0, 120.0), ("blue", 30.0, 40.0), ("red", 400.0, 600.0))[k % 3]
        try:
            ledger.refuse_unsafe(channel, radiance * (1 + k % 5), seconds)
            ledger.shine(channel, radiance * (1 + k % 5), seconds)
            answers.append("yes")
        except UnsafeStimulus as refused:
            answers.append(str(refused))
        if k % 7 == 3:
            ledger.darken(channel)
    told["ledger"] = answers
    assert not moved("benches/safety", told)


PROTOCOLS = sorted(path.stem for path in (ROOT / "configs" / "protocols").glob("*.yaml"))


def test_protocols_and_defaults_are_as_they_were():
    """Every shipped protocol with what it leaves open, shipped benches, and what the daemon does unasked."""
    protocols = {}
    for name in PROTOCOLS:
        protocol = read_protocol(name)
        bias = method_bias(protocol.method)
        protocols[name] = protocol.model_dump(mode="json") | {
            "bias": None if bias is None else [getattr(bias, key) for key in bias.__dataclass_fields__],
            "rods bleached": protocol.bleach.rods_bleached,
        }
    benches = {
        path.stem: read_bench(path)[0].model_dump(mode="json")
        for path in sorted((ROOT / "configs").glob("bench-*.yaml"))
    }
    options = {one.name: str(one.default) for one in fields(ServiceOptions) if one.default is not MISSING}
    times = {name: getattr(KeeperTimes(), name) for name in KeeperTimes.__dataclass_fields__}
    assert not moved(
        "benches/defaults", {"protocols": protocols, "benches": benches, "service": options, "keeper": times}
    )


def answers_of(method: Any) -> list[Any]:
    """Return the levels that a method asks for of an eye whose threshold is at −2, and what it comes to."""
    asked = []
    for _ in range(200):
        if method.threshold is not None or method.exhausted:
            break
        asked.append(method.level)
        method.answer(seen=method.level >= -2.0)
    return [asked, method.threshold, method.exhausted]


def test_methods_are_as_they_were():
    """The levels that every protocol's method asks for, at first and after a threshold."""
    told = {}
    for name in PROTOCOLS:
        protocol = read_protocol(name)
        told[name] = [answers_of(begin(protocol.spot, protocol.method, last, 0.03)) for last in (None, -1.4)]
    assert not moved("benches/methods", told)


@pytest.mark.parametrize("name", ["quick", "rapid"])
def test_a_run_is_as_it_was(name, tmp_path, monkeypatch):
    """Thresholds, catches and verdict of a whole run with an eye of fixed habits."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    with RunJournal(tmp_path / "j") as journal:
        ended = run_test(read_protocol(name), ScriptedStage(eye, read_protocol(name)), journal, subject="A1", seed=3)
        kinds: dict[str, int] = {}
        for event in journal.of_kind("trial") + journal.of_kind("blink") + journal.of_kind("threshold"):
            kinds[event["kind"]] = kinds.get(event["kind"], 0) + 1
    told = {
        "verdict": ended.verdict,
        "times": digest(ended.times_min),
        "thresholds": digest(ended.thresholds_log10),
        "first": list(ended.thresholds_log10[:5]),
        "events": kinds,
    }
    assert not moved(f"benches/run_{name}", told)


def series(kind: str) -> ThresholdSeries:
    rng = np.random.default_rng([3, len(kind)])
    minutes = np.sort(rng.uniform(0.3, 35.0, 60))
    true = np.array([threshold(60.0 * t) for t in minutes])
    if kind == "one branch":
        true = -1.0 + 1.6 * np.exp(-minutes / 2.0)
    noise = 0.1 * rng.standard_normal(60)
    sigma = np.where(minutes < 10.0, 0.1, 0.2) if kind == "weighted" else None
    return ThresholdSeries(minutes, true + noise, sigma, {"false_alarms": "2/40", "lapses": "1/30"})


@pytest.mark.parametrize("kind", ["two branches", "one branch", pytest.param("weighted", marks=pytest.mark.slow)])
def test_a_fit_of_adaptation_is_as_it_was(kind):
    """Models, parameters with intervals, break and its evidence, criterion, rod intercept."""
    request = FitRequest(-3.0, 0.05, 0, 0.95, InterceptRule(-2.8, 12.0, 0.05, 0.02))
    fit = fit_adaptation(series(kind), request, np.random.default_rng(1))
    told = to_mapping(fit) | {"says": [outcome(fit), *meaning(fit)]}
    if kind == "one branch":  # what there is none of has any parameters
        told["models"] = [{**one, "parameters": None} if number else one for number, one in enumerate(told["models"])]
    assert not moved(f"benches/fit_{kind.replace(' ', '_')}", told, rel=100 * FITS)


def test_figures_about_eyes_are_as_they_were():
    """Pupils, bleaches, catches, agreement of visits, and a room's light."""
    told: dict[str, Any] = {
        "pupil": [pupil_diameter_mm(*one) for one in itertools.product((0.01, 10.0, 3e3), (100.0, 4.0), (28.58, 70.0))],
        "bleached": [bleached_fraction(td, s) for td in (1e3, 1e5, 1e7) for s in (0.01, 10.0, 300.0)],
        "range": [list(bleached_range(td, 120.0, receptor)) for td in (1e4, 1e6) for receptor in ("rods", "cones")],
        "exposure for": [retinal_exposure_for(f, 30.0) for f in (0.1, 0.5, 0.98)],
        "reliability": Reliability(Count(3, 40), Count(2, 25), Count(4, 30)).to_mapping(),
        "without lapses": Reliability(Count(0, 40), Count(), Count(1, 30)).to_mapping(),
        "agreement": limits_of_agreement(np.array([0.1, -0.3, 0.25, 0.4, -0.1, 0.05])).to_mapping(),
    }
    rooms = [judge_room(cd, u, read_protocol("classic")) for cd, u in ((1e-6, 1e-7), (3e-3, 1e-4), (1.0, 0.1))]
    told["rooms"] = [one.facts | {"refused": one.refusal is not None} for one in rooms]
    assert not moved("benches/eyes", told)


def test_a_screen_s_levels_are_as_they_were():
    """The spots that a screen can show, their u and codes, its field and mark, and a protocol cut to its reach."""
    levels = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 160, 192, 224, 255)
    curves = {}
    for name, share, efficacies in (
        ("grey", 1.0, (320.0, 750.0)),
        ("red", 0.25, (200.0, 60.0)),
        ("blue", 0.3, (90.0, 1000.0)),
    ):
        values = tuple(3e-4 + 0.7 * share * (n / 255) ** 2.2 for n in levels)
        curves[name] = ChannelCurve(name, levels, values, tuple(1e-3 * v for v in values), 0.01, *efficacies, "assumed")
    screen = ScreenCalibration("desk", curves, created="2026-11-21T12:00:00.000000Z", pixel_mm=0.27)
    told: dict[str, Any] = {}
    for name, density in (("blue", 0.0), ("grey", 2.0)):
        spots = SpotLevels.of(screen, name, density)
        protocol = within_reach(read_protocol("screen-only"), spots)
        told[name] = {
            "levels": {key: plain_field(getattr(spots, key)) for key in spots.__dataclass_fields__},
            "reach": list(spots.reach),
            "coarsest": [spots.coarsest_step(low) for low in (-4.0, -2.0)],
            "rgb": [list(spots.rgb(spots.nearest(level))) for level in (-4.0, -2.0, 0.0)],
            "spot": protocol.spot.model_dump(mode="json"),
        }
    told["field"] = [list(field_code(screen, cd, "red")) for cd in (0.1, 5.0)]
    told["mark"] = [[list(mark_code(screen, cd)[0]), mark_code(screen, cd)[1]] for cd in (0.05, 1.0)]
    assert not moved("benches/screen", told, rel=1e-7)


def plain_field(value: Any) -> Any:
    return digest(value) if isinstance(value, np.ndarray) else value
