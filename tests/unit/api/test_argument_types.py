"""Wrong types in calls of the public functions: refused as a RadiometerError, before any work."""

import functools
import inspect
import math
import pickle
import re
import typing
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import radiometer as rm
from radiometer.argument_types import range_of

FUNCTIONS = [name for name in rm.__all__ if inspect.isfunction(getattr(rm, name))]
WRONG = (["text", {}], [], {"text": []}, math.nan)
OFTEN_RIGHT = (None, "text")
# What the desk has for arguments that are not varied.
BENCH = "bench.yaml"
GIVEN = {
    "luminance": 1.0, "duration": 1.0, "duration_s": 1.0, "target": 1.0, "sequence": 1, "patch": (0, 0, 8, 8),
    "capture": "out/chart", "source": "out/chart", "sources": "out/chart", "path": "out/chart", "bench": BENCH,
    "channel": "white", "visits": ["thresholds.csv"], "kinds": ["csv"], "data": "thresholds.csv", "table": "engine.csv",
    "journal": "journal.sqlite", "results": "history.csv", "laboratory": "laboratory.yaml", "camera": None,
}  # fmt: skip


# A search of a capture set takes seconds; types are checked before it begins.
SEARCHED = {"reconcile": "meter.csv", "reconcile_plan": "missing"}


def arguments() -> list[tuple[str, str]]:
    """Return every argument of every public function."""
    return [(name, argument) for name in FUNCTIONS for argument in inspect.signature(getattr(rm, name)).parameters]


def others(name: str, varied: str) -> dict[str, object]:
    """Return the other arguments of a call: required ones, the bench, and what ends those that serve for ever."""
    known = inspect.signature(getattr(rm, name)).parameters
    given = {one: GIVEN.get(one, "missing") for one, p in known.items() if p.default is p.empty}
    given |= {one: SEARCHED[name] for one in {"source", "capture"} & set(known) if name in SEARCHED}
    if "bench" in known and varied != "camera":
        given["bench"] = BENCH
    given |= dict.fromkeys({"announce", "ready"} & set(known), _end)
    return {one: value for one, value in given.items() if one != varied}


MAKERS = {
    "Meter": lambda: rm.open(BENCH, uncalibrated=True),
    "Reading": lambda: rm.measure(bench=BENCH),
    "Stack": lambda: rm.read("out/chart"),
    "Radiance": lambda: rm.merge("out/chart"),
    "LoggedReadings": lambda: rm.log("journal.sqlite"),
    "CalibratedScreen": lambda: rm.screen_import("luminances.csv"),
}


def _end(_: str) -> None:
    raise rm.UsageError("it works")


@pytest.mark.parametrize("values", [WRONG, pytest.param(OFTEN_RIGHT, marks=pytest.mark.slow)], ids=["wrong", "often"])
@pytest.mark.parametrize(("name", "argument"), arguments())
def test_a_wrong_type_is_a_radiometer_error(name, argument, values, desk, tmp_path, monkeypatch):
    """Lists, a mapping, NaN, None and a text as each argument: it works, or one line says what does not."""
    monkeypatch.chdir(desk)
    monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path / "state"))
    for value in values:
        assert_works_or_says(lambda value=value: getattr(rm, name)(**others(name, argument), **{argument: value}))


def test_numbers_of_numpy_are_numbers_and_uncertainties_bounded(tmp_path, monkeypatch):
    """A time step of NumPy is none; no u below 0, no relative one above 1."""
    monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path / "state"))
    assert rm.light_pulse("spot", np.float32(0.1), level=np.uint16(2000), box="sim").state.channel == "spot"
    with pytest.raises(rm.UsageError, match="duration_s"):
        rm.light_pulse("spot", np.timedelta64(1, "s"), level=2000, box="sim")
    plain, other = rm.adapt_bleach(1000.0, 60.0), rm.adapt_bleach(np.float32(1000), np.int64(60))
    assert other.rods_bleached == pytest.approx(plain.rods_bleached, rel=1e-5)  # 24 bits
    with pytest.raises(rm.RadiometerError, match="missing"):
        rm.merge("missing", scale=np.array([1.0, 0.1]))
    bounds = {}
    for name, argument, hint in numbers():
        allowed = range_of(hint)
        if "u" in argument.split("_"):
            low, high = (None, None) if allowed is None else (allowed.low, allowed.high)
            bounds[name, argument] = (low, high if "u_rel" in argument else None)
    assert {one: found for one, found in bounds.items() if found not in ((0.0, 1.0), (0.0, None))} == {}
    assert len(bounds) > 10


@pytest.mark.parametrize("kind", ["Meter", "Reading", "Stack", "Radiance", "LoggedReadings", "CalibratedScreen"])
def test_a_wrong_type_to_a_method_is_a_radiometer_error(kind, desk, monkeypatch):
    """The same as every argument of every method of what the functions return."""
    monkeypatch.chdir(desk)
    one = MAKERS[kind]()
    methods = [getattr(one, name) for name, known in vars(type(one)).items() if inspect.isfunction(known)]
    for method in (method for method in methods if not method.__name__.startswith("_")):
        for argument in inspect.signature(method).parameters:
            for value in (*WRONG, *OFTEN_RIGHT):
                assert_works_or_says(lambda method=method, given={argument: value}: method(**given))
    assert methods


def numbers() -> list[tuple[str, str, object]]:
    """Return (function, argument, type) of every number that a public function takes, alone or in a list."""
    of_all = {name: typing.get_type_hints(getattr(rm, name), include_extras=True) for name in FUNCTIONS}
    found = [(name, argument, hint) for name, hints in of_all.items() for argument, hint in hints.items()]
    return [one for one in found if one[1] != "return" and {float, int} & set(parts(one[2]))]


def parts(hint: object) -> list[object]:
    """Return the plain types of which one is put together; of functions that are handed in none."""
    inside = typing.get_args(hint)
    if typing.get_origin(hint) is typing.Annotated:
        return parts(inside[0])
    if typing.get_origin(hint) is Callable:
        return []
    return [hint, *(one for part in inside for one in parts(part))]


@pytest.mark.parametrize(("name", "argument", "hint"), numbers())
def test_a_number_outside_its_range_is_refused_with_its_bound(name, argument, hint):
    """NaN, infinity, 10³⁰⁰, and what is below or above the stated range: one line names argument and range."""
    allowed = range_of(hint)
    outside = [math.nan, math.inf, -math.inf, 1e300, -1e300]
    if allowed is not None:
        outside += [allowed.low - 1, allowed.high * 2, *([allowed.low] if allowed.above else [])]
    given_else = {one: "sim" if one == "camera" else value for one, value in others(name, argument).items()}
    call = functools.partial(getattr(rm, name), **given_else)
    contained = ([math.nan], [math.nan, math.nan, 1.0, 1.0], {1.0: math.nan})
    for given in (*outside, *contained, [outside[-1]], {1.0: outside[-1]}):
        with pytest.raises(rm.UsageError, match=rf"^{name}: {argument} is .*; give .*(number|Patch)"):
            call(**{argument: given})
    if allowed is not None:
        with pytest.raises(rm.UsageError, match=f"(of|from|above) {re.escape(format(allowed.low, 'g'))}"):
            call(**{argument: math.nan})


def assert_works_or_says(call: Callable[[], object]) -> None:
    """Assert that a call returns, or raises a RadiometerError of some words."""
    said = "works"
    try:
        result = call()
        if isinstance(result, Iterator):
            next(result)
    except rm.RadiometerError as error:
        said = str(error)
    assert said


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: rm.merge("x", channel=[]), r"^merge: channel is \[\] \(list\); give text or None$"),
        (lambda: rm.adapt_bleach(math.nan, 1.0), r"luminance is nan \(float\); give number from 0 to 1e\+15 cd·m⁻²$"),
        (lambda: rm.adapt_bleach(True, 1.0), r"luminance is True \(bool\); give number from 0 .*$"),
        (
            lambda: rm.measure(patch=(0, 0, 8)),
            r"patch is \(0, 0, 8\) \(tuple\); give Patch or \(whole number, .* or None$",
        ),
        (
            lambda: rm.merge("x", measured_iso={100.0: math.nan}),
            r"a mapping of number from 1 to 1e\+09 to number .*None$",
        ),
        (lambda: rm.screen_export("x", "csv"), r"kinds is 'csv' \(str\); give a list of text$"),
        (lambda: rm.log("a" * 300), r"^log: journal is 'a+… \(str\); give text or path or None$"),
        (lambda: rm.merge("a\0b"), r"^merge: source is .*; give Stack or text or path$"),
        (lambda: rm.Patch(40, 30, 20, 1.5), "a patch is of whole pixels; 1.5 is no whole number"),
        (lambda: rm.colour_calibrate("x", train_on="lights"), r"'lights' \(str\); give 'chart' or 'responsivities'$"),
        (lambda: rm.log_fit(["x" * 500]), r"table is \['x{40,60}… \(list\); give text or path$"),
    ],
)
def test_the_error_names_the_argument_and_what_it_takes(call, says):
    """Function, argument, the value in a few characters, and the kinds that it takes."""
    with pytest.raises(rm.UsageError, match=says):
        call()


def test_public_functions_keep_signatures_and_pythons_own_errors():
    """Each argument has a default or a type; a missing one is named."""
    for name in FUNCTIONS:
        function = getattr(rm, name)
        assert set(typing.get_type_hints(function)) == {*inspect.signature(function).parameters, "return"}, name
        assert pickle.loads(pickle.dumps(function)) is function
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'source'"):
        rm.merge()
