"""The steps behind a response: samples, fits, labels, predictions, ends of curves, files, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.response.basis import ValueBasis, hat_weight
from radiometer.analysis.response.curves import finished_curve, rising, u_with_extrapolation
from radiometer.analysis.response.debevec1997 import curve_debevec1997, without_noise_shift
from radiometer.analysis.response.dynamic_range import RangePoint, dynamic_range, with_dynamic_range
from radiometer.analysis.response.effective import places_as_one, tones_as_one
from radiometer.analysis.response.labels import refuse_lying_labels
from radiometer.analysis.response.left_out import prediction_error_dn
from radiometer.analysis.response.limits import find_limits
from radiometer.analysis.response.normal import eliminate_groups, solve_penalised
from radiometer.analysis.response.planes import JointFit, Plane, settle_planes
from radiometer.analysis.response.predicting import frame_folds, judge_by_prediction, without_frames
from radiometer.analysis.response.samples import ResponseSamples, gather_samples
from radiometer.analysis.response.settle import Choices, FittedResponse, error_of_quadrants, fit_with, settle
from radiometer.analysis.response.weights import group_residual
from radiometer.analysis.response.wrong_labels import find_wrong_labels, thinned
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve
from radiometer.errors import RadiometerError
from tests.unit.held.figures import FITS, digest, moved


@cache
def stack(kind: str) -> Bracket:
    """Return frames of 48 × 60 pixels behind a square root, of a scene over five e-folds with edges and a window."""
    rng = np.random.default_rng([7, len(kind)])
    rows, columns = np.mgrid[:48, :60]
    log_radiance = -5.0 * columns / 60 + 0.5 * np.sin(9 * rows / 48) + 0.8 * ((rows // 8 + columns // 10) % 2)
    log_radiance = log_radiance + 0.05 * rng.standard_normal((48, 60))
    times = 2.0 ** np.arange(-1, 2 if kind == "three frames" else 5)
    frames = []
    for k, t in enumerate(times):
        seen = np.roll(log_radiance, k % 2, axis=1) if kind == "moved" else log_radiance
        real = t * (1.3 if kind == "wrong label" and k == 3 else 1.0)
        light = np.minimum(np.exp(seen) * real, 20.0)
        electrons = rng.poisson(light * 6000.0) + 4.0 * rng.standard_normal(light.shape)
        value = np.clip(electrons / 6000.0, 0.0, 1.0) ** 0.5
        floor = 12 if kind == "fog" else 0
        dn = np.clip(np.rint(floor + value * (255 - floor)), 0, 255).astype(np.uint8)
        frames.append(Frame(dn, 8, FrameSettings(1e-2 * t), extra={"file": f"{k}.png"}))
    return Bracket.from_frames(frames)


KINDS = ("plain", "moved", "fog", "wrong label", "three frames")


@cache
def samples(kind: str) -> ResponseSamples:
    if kind == "two brackets":
        return gather_samples([stack("plain"), stack("three frames")])
    return gather_samples(stack(kind))


@cache
def start(kind: str) -> np.ndarray:
    return curve_debevec1997(samples(kind)).log_exposure


def of_samples(one: ResponseSamples) -> dict[str, Any]:
    """Return the figures of samples, and in short of their parts."""
    told: dict[str, Any] = {}
    for field in fields(one):
        value = getattr(one, field.name)
        if isinstance(value, np.ndarray):
            told[field.name] = digest(value)
        elif isinstance(value, int | float | str):
            told[field.name] = value
    for name in ("without_quadrant", "quadrants"):
        told[name] = [[digest(part.dn), digest(part.pixels), part.group_count] for part in getattr(one, name)]
    told["limits"] = {field.name: getattr(one.limits, field.name) for field in fields(one.limits)}
    return told


def of_fit(found: FittedResponse) -> dict[str, Any]:
    """Return the figures of a fit."""
    fit, known = found.fit, found.choices
    return {
        "g": digest(found.log_exposure), "relative": digest(found.relative), "dn": digest(found.dn),
        "u": digest(found.u_of(fit.covariance())), "rms": found.residual_rms_log, "size": fit.basis_size,
        "inflation": known.inflation, "smoothing": known.smoothing, "spread": known.time_spread,
        "times": digest(fit.time_modes), "leverage": digest(fit.leverage()), "errors": digest(fit.log_time_errors),
        "noise": {field.name: getattr(found.noise, field.name) for field in fields(found.noise)},
    }  # fmt: skip


def test_samples_are_as_they_were():
    """Groups of pixels of every kind of stack, of two brackets, their thirds, thinned ones, and cut ones."""
    told = {kind: of_samples(samples(kind)) for kind in (*KINDS, "two brackets")}
    one = samples("plain")
    told["a third"] = of_samples(one.third(1))
    told["thinned"] = of_samples(thinned(one))
    told["without a frame"] = of_samples(one.kept(one.frame != 2))
    told["shifted"] = digest(without_noise_shift(one, curve_debevec1997(one)).dn)
    told["limits"] = {
        str(floor): [getattr(found, field.name) for field in fields(found)]
        for floor in (0, 12)
        for found in [find_limits([stack("fog" if floor else "plain")])]
    }
    told["hat"] = digest(hat_weight(np.linspace(0, 255, 40), one.limits))
    assert not moved("response_parts/samples", told)


def test_the_algebra_of_a_fit_is_as_it_was():
    """Basis, normal equations, the penalised solution, residuals within groups, and what counts as one."""
    one = samples("plain")
    basis = ValueBasis(8, one.limits)
    design = basis.design(one.dn)
    normal = eliminate_groups(design, one.log_time, one.pixels, one.group)
    middle = basis.design(np.array([128.0])).toarray()[0]
    told: dict[str, Any] = {
        "design": digest(design.toarray()), "every": digest(basis.all_values().toarray()),
        "rough": digest(basis.roughness() @ np.linspace(-1.0, 2.0, basis.roughness().shape[0]) ** 3),
        "matrix": digest(normal.matrix), "freedom": normal.freedom,
    }  # fmt: skip
    for smoothing in (None, 1e-2, 10.0):
        solved = solve_penalised(normal, basis.roughness(), middle, smoothing)
        told[f"smoothing {smoothing}"] = {
            field.name: digest(value) if isinstance(value, np.ndarray) else value
            for field in fields(solved)
            if isinstance(value := getattr(solved, field.name), np.ndarray | float | int)
        }
        told[f"meat {smoothing}"] = digest(normal.robust_meat(solved.coefficients))
    residual, share = group_residual(one, np.log(one.dn + 1.0), one.pixels)
    told["residual"], told["share"] = digest(residual), digest(share)
    told["tones"] = [
        tones_as_one(residual / np.std(residual), one.group, one.frame),
        tones_as_one(np.sin(0.02 * one.group) + 0.1 * one.frame, one.group, one.frame),
    ]
    places = np.linspace(0.5, 4.0, 30)
    told["places"] = [places_as_one(places, np.ones(30)), places_as_one(np.zeros(30), np.ones(30))]
    assert not moved("response_parts/algebra", told, rel=FITS)


@pytest.mark.slow
def test_fits_and_what_they_predict_are_as_they_were():
    """A settled fit of each kind of stack, the same without frames and quadrants, freed labels, and rivals."""
    told: dict[str, Any] = {}
    for kind in KINDS:
        one, near = samples(kind), start(kind)
        found = settle(one, near)
        told[kind] = {
            "settled": of_fit(found),
            "folds": frame_folds(one),
            "frames": [[fold, digest(part.log_exposure)] for fold, part in list(without_frames(one, found))[:3]],
            "error": digest(prediction_error_dn(one, found.log_exposure)),
            "of quadrants": error_of_quadrants(one, found).tolist(),
        }
    one, near = samples("wrong label"), start("wrong label")
    told["freed"] = of_fit(settle(one, near, (3,)))
    told["known"] = of_fit(fit_with(one, near, Choices(free=(3,), known=((0.2, 0.01),), inflation=2.0)))
    told["spread"] = of_fit(fit_with(one, near, Choices(time_spread=None)))
    told["frame 3"] = error_of_quadrants(one, settle(one, near), 3).tolist()
    assert not moved("response_parts/fits", told, rel=10 * FITS)


def test_wrong_labels_and_rivals_are_found_as_they_were():
    """A label 30 % off, in one plane and in two; none where all are right; too few frames; what predicts as well."""
    planes = {kind: Plane(samples(kind), start(kind)) for kind in ("plain", "wrong label", "three frames")}
    told: dict[str, Any] = {
        name: [{field.name: getattr(label, field.name) for field in fields(label)} for label in labels]
        for name, labels in {
            "one plane": find_wrong_labels([planes["wrong label"]]),
            "two planes": find_wrong_labels([planes["wrong label"], planes["plain"]]),
            "right": find_wrong_labels([planes["plain"]]),
            "three frames": find_wrong_labels([planes["three frames"]]),
        }.items()
    }
    joint: JointFit = settle_planes([planes["wrong label"], planes["plain"]], (3,))
    told["joint"] = {
        "ratios": joint.log_ratios, "u": joint.u_log_ratios, "g": [digest(one.log_exposure) for one in joint.fits],
    }  # fmt: skip
    one, near = samples("three frames"), start("three frames")
    judged = judge_by_prediction(one, near, settle(one, near))
    told["judged"] = {
        "best": of_fit(judged.best), "others": [part.choices.smoothing for part in judged.other_smoothness],
        "u": digest(judged.u_among(judged.other_smoothness)),
    }  # fmt: skip
    assert not moved("response_parts/labels", told, rel=10 * FITS)


def curve(power: float = 2.2, u: float = 0.01) -> ResponseCurve:
    codes = np.arange(256.0)
    with np.errstate(divide="ignore"):
        g = power * np.log(codes / 128.0)
    known = u * (1.0 + ((codes - 128.0) / 64.0) ** 2)
    known[[0, 255]] = np.inf
    return ResponseCurve(g, known, valid_dn=(6, 249))


def outcome_of(work: Callable[[], Any]) -> Any:
    """Return what work gives, or the kind and words of the error that it ends in."""
    try:
        return work()
    except RadiometerError as error:
        return f"{type(error).__name__}: {error}"


def test_ends_of_curves_are_as_they_were():
    """Made rising and continued, with the whole step as uncertain outside the data; cut where hardly known."""
    rng = np.random.default_rng(4)
    ragged = curve().log_exposure + 0.05 * rng.standard_normal(256)
    ragged[0] = ragged[1] - 1.0
    u = np.full(256, 0.02)
    u[:10], u[200:] = 5.0, np.linspace(0.02, 9.0, 56)
    told: dict[str, Any] = {
        f"rising {low} {high} {black}": rising(ragged, u, (low, high), black)[[0, 1, low, 60, 128, high, 254, 255]]
        for low, high, black in ((6, 249, 0.0), (20, 199, 12.0), (1, 254, 0.5))
    }
    told["extrapolated u"] = u_with_extrapolation(curve())[[0, 1, 5, 6, 128, 249, 250, 255]]
    told["extrapolated u without a range"] = digest(u_with_extrapolation(replace(curve(), valid_dn=None))[1:255])
    finished = finished_curve(ragged, u, (8, 240), black_dn=3.0, method="made", channel="green")
    told["finished"] = [digest(finished.log_exposure), digest(finished.u_log_exposure), list(finished.valid_dn or ())]
    assert not moved("response_parts/ends", told)


def test_dynamic_ranges_are_as_they_were():
    """Exponents of one, two and landed regions, curves that run to them, and words for what cannot be."""
    sets: dict[str, tuple[list[RangePoint], float, float]] = {
        "one": ([RangePoint(30.0, 8e-3)], 4e-4, 128.0),
        "two that disagree": ([RangePoint(30.0, 8e-3), RangePoint(230.0, 5e-4)], 1e-3, 128.0),
        "landed": ([RangePoint(2.0, 6e-3, 120.0), RangePoint(253.0, 1e-4, 140.0)], 1e-3, 128.0),
        "none": ([], 1e-3, 128.0),
        "no time": ([RangePoint(30.0, 0.0)], 1e-3, 128.0),
        "no reference time": ([RangePoint(30.0, 1e-3)], -1.0, 128.0),
        "at white": ([RangePoint(255.0, 1e-3)], 2e-3, 128.0),
        "too near": ([RangePoint(120.0, 1.1e-3)], 1e-3, 128.0),
        "dark and shorter": ([RangePoint(30.0, 5e-4)], 1e-3, 128.0),
        "bright and longer": ([RangePoint(230.0, 5e-3)], 1e-3, 128.0),
    }
    told: dict[str, Any] = {}
    for name, (points, reference_s, reference_dn) in sets.items():

        def made(points=points, reference_s=reference_s, reference_dn=reference_dn) -> Any:
            found = dynamic_range(curve(), points, reference_s, reference_dn)
            bent = with_dynamic_range(curve(), found)
            places = [1, 2, 5, 6, 30, 128, 230, 249, 250, 254]
            return found.to_mapping() | {"g": bent.log_exposure[places], "u": bent.u_log_exposure[places]}

        told[name] = outcome_of(made)
    assert not moved("response_parts/ranges", told)


def test_lying_labels_are_refused_in_the_words_they_were():
    """Pairs of frames, whole lists, equal frames; nothing where brightness rises as it should."""
    frames = list(stack("plain").light)

    def labelled(*times: float, of: tuple[int, ...] = (0, 1, 2, 3, 4, 5), named: bool = True) -> Any:
        made = []
        for k, t in zip(of, times, strict=True):
            settings = replace(frames[k].settings, exposure_s=t)
            made.append(replace(frames[k], settings=settings, extra={"file": f"{k}.png"} if named else {}))
        return outcome_of(lambda: refuse_lying_labels(Bracket.from_frames(made)))

    told = {
        "right": labelled(1, 2, 4, 8, 16, 32),
        "one too long": labelled(1, 2, 64, 8, 16, 32),
        "one too short": labelled(1, 2, 4, 8, 0.5, 32),
        "without names": labelled(1, 2, 64, 8, 16, 32, named=False),
        "two": labelled(1, 40, 4, 8, 0.3, 32),
        "reciprocal": labelled(1, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32),
        "equal frames": labelled(1, 2, 4, of=(2, 2, 3)),
        "nearly equal labels": labelled(1, 1.1, 4, of=(2, 2, 3)),
    }
    assert not moved("response_parts/lies", told)


def test_files_of_curves_are_read_as_they_were(tmp_path, monkeypatch):
    """What a CSV or a YAML file must be: each wrong one is refused in words; a right one comes back bit by bit."""
    monkeypatch.chdir(tmp_path)
    whole = curve()
    for name in ("a.csv", "a.yaml"):
        whole.write(Path(name))
        again = ResponseCurve.read(Path(name))
        assert np.array_equal(again.log_exposure, whole.log_exposure)
        assert np.array_equal(again.u_log_exposure, whole.u_log_exposure)
    texts = {
        "other header": "x,y,z\n0,1,1\n", "gap": "dn,log_exposure,u_log_exposure\n0,-1,1\n2,0,1\n",
        "two columns": "dn,log_exposure,u_log_exposure\n0,1\n", "words": "dn,log_exposure,u_log_exposure\n0,a,1\n",
        "three rows": "dn,log_exposure,u_log_exposure\n0,-1,1\n1,0,1\n2,1,1\n",
        "falls": "dn,log_exposure,u_log_exposure\n0,1,1\n1,0,1\n", "empty": "",
        "absolute": "dn,log_exposure,u_log_exposure\n0,-9,1\n1,-8.5,1\n",
        "relative": "dn,log_exposure,u_log_exposure\n0,-1,0.5\n1,0,0.25\n",
    }  # fmt: skip
    told: dict[str, Any] = {"bits": whole.bit_depth, "middle": whole.mid_dn}

    def read() -> dict[str, Any]:
        return ResponseCurve.read(Path("b.csv")).to_mapping()

    for name, text in texts.items():
        Path("b.csv").write_text(text, encoding="utf-8")
        told[name] = outcome_of(read)
        if isinstance(told[name], dict):
            told[name].pop("provenance")
    mapping = whole.to_mapping()
    for name, changes in {
        "another form": {"format": "x"}, "no numbers": {"log_exposure": ["a"] * 256},
        "an uncertainty too few": {"u_log_exposure": mapping["u_log_exposure"][1:]},
        "one value": {"log_exposure": [0.0], "u_log_exposure": [0.0]},
    }.items():  # fmt: skip
        told[name] = outcome_of(
            lambda changes=changes: ResponseCurve.from_mapping(mapping | changes, "b.yaml").bit_depth
        )
    short = {key: value for key, value in mapping.items() if key != "log_exposure"}
    told["a key is missing"] = outcome_of(lambda: ResponseCurve.from_mapping(short, "b.yaml").bit_depth)
    told["absent"] = outcome_of(lambda: ResponseCurve.read(Path("none.csv")).bit_depth)
    assert not moved("response_parts/files", told)
