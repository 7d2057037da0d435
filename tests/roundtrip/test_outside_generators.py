"""The generators by other equations: they know nothing of the instrument, their physics holds, and they are judged."""

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconcile_outsiders import session_of
from radiometer.data import CaptureSet
from testing.outside import three, three_hidden, two, two_hidden
from testing.outside.judge import judge, tally
from testing.outside.session import Secret

FOLDER = Path(two.__file__).parent
GENERATORS = {"two": (two, two_hidden.HIDDEN), "three": (three, three_hidden.HIDDEN)}
HIDDEN = [(module, hidden) for module, table in GENERATORS.values() for hidden in table.values()]
ALLOWED = {"__future__", "testing", "collections", "cv2", "dataclasses", "math", "numpy", "pathlib", "typing", "yaml"}
VEIL = Secret("law", "bracket", "veil", ("veiling_glare",), covariates=("patch_level",))


@cache
def nothing_hidden(module, plan):
    """Return the session of the same seed without a secret."""
    return module.make(7, None, plan)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.name)
def test_a_generator_imports_nothing_of_what_it_tests(path):
    """What makes the light shares no code with the instrument, its forward model or the other generator."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) else []
    roots = {name.split(".")[0] for name in names}
    assert roots <= ALLOWED
    assert all(name.startswith("testing.outside") for name in names if name.startswith("testing"))


@pytest.mark.parametrize("module", [two, three], ids=["two", "three"])
def test_noise_is_that_of_the_stated_electrons(module):
    """The variance of a pixel rises with its mean by one over the stated conversion gain."""
    session = module.make(5, None, "flats")
    shots = np.array([entry["exposure_s"] for entry in session.header["frames"]])
    means, variances = [], []
    for exposure in np.unique(shots):
        frames = np.array([session.frames[i] for i in np.flatnonzero(shots == exposure)[:3]], dtype=float)
        means.append(frames.mean())
        variances.append((frames - frames.mean(axis=(1, 2), keepdims=True)).var(axis=0, ddof=1).mean())
    slope = np.polyfit(means, variances, 1)[0]
    assert slope * session.header["camera"]["conversion_gain_e_per_dn"] == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(("module", "hidden"), HIDDEN, ids=lambda value: getattr(value, "name", ""))
def test_what_is_hidden_changes_the_session(module, hidden):
    """The same seed with and without the hidden thing differs in its pictures, or in what the header claims."""
    with_it, without = module.make(7, hidden, hidden.plans[0]), nothing_hidden(module, hidden.plans[0])
    differs = any((a != b).any() for a, b in zip(with_it.frames, without.frames, strict=True))
    assert differs or with_it.header["camera"] != without.header["camera"]
    assert with_it.secret.name == hidden.name


@pytest.mark.parametrize("generator", [2, 3])
def test_a_written_session_is_a_capture_set(generator, tmp_path):
    """The folder is read back with the very codes and settings that were drawn."""
    session = session_of(generator, "null", 4)
    captured = CaptureSet.read(session.write(tmp_path / "set"))
    assert len(captured) == len(session.frames)
    assert (captured.read_frame(3).dn == session.frames[3]).all()
    assert captured.header.frames[3].exposure_s == session.header["frames"][3]["exposure_s"]


def effect(name, *alternatives):
    """Return an effect as it stands in a result."""
    return {"name": name, "alternatives": list(alternatives), "where": "signal"}


def answer(verdict, *effects, places=("signal",)):
    """Return a result as JSON says it."""
    return {"verdict": verdict, "effects": list(effects), "localisation": [{"covariate": p} for p in places]}


@pytest.mark.parametrize(
    ("found", "first", "exact", "confident_wrong", "junk"),
    [
        # A plan that cannot tell two names gives both: that is the right answer.
        (answer("effects_found", effect("ambient_light_leak", "veiling_glare")), True, True, False, False),
        # What is sure and wrong counts; the same name as provisional is junk only.
        (answer("effects_found", effect("ambient_light_leak")), False, False, True, True),
        (answer("incomplete", effect("ambient_light_leak")), False, False, False, True),
        # An unnamed rest next to the right name is first, and not exact.
        (answer("incomplete", effect("veiling_glare"), effect("unnamed")), True, False, False, False),
    ],
)
def test_names_are_judged(found, first, exact, confident_wrong, junk):
    """A right name, alone or among alternatives, a wrong one that is sure or provisional, a rest."""
    reported = judge(found, VEIL)
    expected = {"first": first, "exact": exact, "confident_wrong": confident_wrong, "junk": junk}
    assert {name: bool(reported[name]) for name in expected} == expected


def test_places_and_errors_are_counted_apart():
    """The true covariate among the first three; a crash is no wrong name."""
    outsider = Secret("outsider", "flats", "dust", stage="optics", covariates=("image_xy",))
    assert judge(answer("unnamed_effect", places=("a", "b", "screen_x")), outsider)["place"]
    assert not judge(answer("unnamed_effect", places=("a", "b", "c", "screen_x")), outsider)["place"]
    right = judge(answer("effects_found", effect("veiling_glare")), VEIL)
    table = tally([{"kind": "law", "judged": right}, {"kind": "law", "error": "x"}])
    assert table.splitlines()[-1] == "| variant | 2 | 1/1 | 1/1 | 1/1 | 0/1 | 0/1 | – | 1 |"
