"""The grammar of laws and the effects that are written of them, against figures worked out by hand."""

import ast
import importlib.util
import itertools
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from radiometer.data import CameraDescription, FrameSettings
from radiometer.reconciliation.propose.grammar import FORMS, Term, finer, formula, terms_of
from radiometer.reconciliation.propose.law import Law, acted, effect_of, round_to
from radiometer.reconciliation.propose.search import effect_source, source_of_test
from radiometer.reconciliation.tile_model import TileContext
from simulators.chain.stages import LINKS
from simulators.effects import registry
from simulators.effects.context import ExposureContext, FrameGeometry
from simulators.effects.tile_moments import Moments, TileMoments

SIGNAL = 1000.0
# form, covariate, constants, parameters, values of the covariates, value of the form
WORKED = [
    ("ramp", "image_x", {"reference": 0.4}, {}, {"image_x": 0.9}, 0.5),
    ("line", "image_y", {}, {"zero": 0.1}, {"image_y": 0.4}, 0.3),
    ("proportion", "column_light", {}, {}, {"column_light": 370.0}, 370.0),
    ("one", "f_number", {}, {"at": 4.0}, {"f_number": 4.0}, 1.0),
    ("one", "f_number", {}, {"at": 4.0}, {"f_number": 5.6}, 0.0),
    ("two", "f_number", {}, {"at": 4.0, "other": 8.0}, {"f_number": 8.001}, 1.0),
    ("two", "f_number", {}, {"at": 4.0, "other": 8.0}, {"f_number": 4.0}, 1.0),
    ("two", "f_number", {}, {"at": 4.0, "other": 8.0}, {"f_number": 5.6}, 0.0),
    ("bow", "temperature_C", {}, {"middle": 30.0}, {"temperature_C": 26.0}, 16.0),
    ("arch", "image_y", {}, {"middle": 0.5, "width": 0.25}, {"image_y": 0.25}, 0.0),
    ("step", "exposure_s", {}, {"at": 0.1}, {"exposure_s": 0.2}, 1.0),
    ("step", "exposure_s", {}, {"at": 0.1}, {"exposure_s": 0.05}, 0.0),
    ("border", "image_y", {}, {"at": 0.5}, {"image_y": 0.6}, 1.0),
    ("every", "frame", {}, {"period": 5.0, "at": 2.0}, {"frame": [6.0, 7.0, 8.0, np.nan]}, 1.0 / 3.0),
    ("edge", "image_y", {}, {"at": 0.5, "width": 0.1}, {"image_y": 0.5}, 0.5),
    ("power", "exposure_s", {"reference": 4.0}, {"power": 0.5}, {"exposure_s": 1.0}, 0.5),
    ("decay", "since_frame_s", {}, {"tau": 3.0}, {"since_frame_s": 3.0}, math.exp(-1.0)),
    ("rise", "image_x", {"end": 1.0}, {"tau": 0.2}, {"image_x": 0.8}, math.exp(-1.0)),
    ("fall", "since_frame_s", {}, {"knee": 2.0, "steepness": 2.0}, {"since_frame_s": 4.0}, 0.2),
    ("bend", "source_level", {}, {"knee": 0.5}, {"source_level": 0.75}, 0.25),
    ("sine", "timestamp_s", {}, {"period": 8.0, "phase": 0.0}, {"timestamp_s": 2.0}, 1.0),
    ("spot", "image_x", {}, {"at_x": 0.1, "at_y": 0.2, "width": 0.5}, {"image_x": 0.4, "image_y": 0.6}, math.exp(-0.5)),
    (
        "moving_wave",
        "image_y",
        {"reference": 1.0},
        {"period": 1.0, "advance": 0.5, "phase": 0.0},
        {"image_y": 0.0, "exposure_s": math.exp(math.pi)},
        1.0,
    ),
]  # fmt: skip
# What an amplitude of 2 (0.002 for factors) makes of the signal in 0.5 s at 20 dB.
ACTS = {
    "source": 1002.0,
    "scene": 1002.0,
    "exposure": 1002.0,
    "optics": 1002.0,
    "light": 1002.0,
    "lens_light": 1008.0,  # at f/2, four times what f/4 lets through
    "shutter": 1004.0,
    "charge_rate": 1001.0,
    "charge": 1002.0,
    "well": 1002.0,
    "node": 1002.0,
    "gain": 1002.0,
    "analog": 1020.0,
    "digital": 1002.0,
    "range": 1002.0,
    "transfer": 1000.002,
    "tremble": 1000.0,
    "hiss": 1000.0,
}
KNOWN = {
    "exposure_s": np.geomspace(1e-4, 1e-2, 8)[:, None, None],
    "timestamp_s": np.stack([np.linspace(0.0, 300.0, 8)] * 2)[:, :, None, None],
    "picture_mean": np.array([0.1, 0.3, 0.8])[:, None, None],
    "column_light": np.geomspace(1e3, 1e6, 50)[:, None, None],
    "temperature_C": np.array([20.0, 30.0, 40.0])[:, None, None],
    "gain_db": np.array([0.0, 6.0, 12.0])[:, None, None],
    "f_number": np.array([2.8, 4.0, 8.0])[:, None, None],
    "source_level": np.array([0.1, 0.5, 1.0])[:, None, None],
    "since_frame_s": np.stack([np.linspace(1.0, 20.0, 8), np.full(8, 0.2)])[:, :, None, None],
    "frame": np.arange(16.0).reshape(8, 1, 1, 2),
    "image_x": np.linspace(0.0, 1.0, 30)[None, :, None],
    "image_y": np.linspace(0.0, 0.7, 30)[None, :, None],
    "signal": np.geomspace(10.0, 9000.0, 50)[:, None, None],
    "value": np.geomspace(10.0, 4000.0, 50)[:, None, None],
}


def at(column=0.0, row=0.0, **more):
    """Return the circumstances of a pixel of a 200 × 100 sensor in half a second at 20 dB."""
    settings = FrameSettings(
        exposure_s=0.5, gain_db=20.0, f_number=2.0, temperature_c=30.0, timestamp_s=2.0, source_level=0.75
    )
    geometry = FrameGeometry(np.array([column]), np.array([row]), 200, 100)
    return ExposureContext(settings, geometry, CameraDescription(bit_depth=12), **more)


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    """Keep what a test registers to itself."""
    monkeypatch.setattr(registry, "EFFECTS", dict(registry.EFFECTS))


@pytest.mark.parametrize(("form", "covariate", "constants", "values", "known", "expected"), WORKED)
def test_a_form_has_the_value_worked_out_by_hand(form, covariate, constants, values, known, expected):
    """Each line of the grammar is the function that its name says."""
    found = Term(form, covariate, constants, values).evaluated({name: np.array(v) for name, v in known.items()})
    assert float(found) == pytest.approx(expected, abs=1e-12)


def test_the_grammar_is_data_and_its_forms_are_known():
    """A thousand laws load no module; each form has a figure, each constant a unit, a spot its place."""
    assert {row[0] for row in WORKED} == set(FORMS)
    law = Law("charge", (Term("power", "exposure_s", {"reference": 1.0}, {"power": 0.5}),
                         Term("decay", "since_frame_s", {}, {"tau": 3.0})))  # fmt: skip
    units = {entry.name: entry.unit for entry in type(effect_of(law, 1.0)).parameters()}
    assert units == {"amplitude_e": "e-", "power_exposure": "1", "tau_rest_s": "s"}
    spot = Law("charge_rate", (Term("spot", "image_x", {}, {"at_x": 0.5, "at_y": 0.25, "width": 0.1}),))
    effect = effect_of(spot, 8.0)
    assert effect.mean(np.array([0.0]), at(100.0, 50.0))[0] == pytest.approx(4.0)
    assert effect.mean(np.array([0.0]), at(120.0, 50.0))[0] == pytest.approx(4.0 * math.exp(-0.5))
    modules = set(sys.modules)
    for k in range(1000):
        effect_of(Law("digital", (Term("step", "exposure_s", {}, {"at": 0.1 + k}),)), 2.0)
    assert set(sys.modules) == modules


@pytest.mark.parametrize("link", LINKS)
def test_a_link_scales_what_it_adds_as_its_stage_does(link):
    """A factor goes with the signal, a rate with the exposure, a voltage with the gain, a shift with nothing."""
    amplitude = 0.002 if LINKS[link].unit in ("1", "s") else 2.0
    found = effect_of(Law(link), amplitude).mean(np.array([SIGNAL]), at())
    assert found[0] == pytest.approx(ACTS[link])


def test_the_first_frame_counts_by_its_share():
    """Of four frames one waited long: the mean holds a quarter of what that does."""
    law = Law("digital", (Term("decay", "since_frame_s", {}, {"tau": 1.0}),))
    effect = effect_of(law, 4.0)
    first, later = at(since_frame_s=math.inf), at(since_frame_s=1.0)
    series = TileContext(
        first.settings, first.geometry, first.camera, first_frame=first, later_frames=later, frames=4.0
    )
    lift = 4.0 * math.exp(-1.0)
    assert effect.mean(np.array([10.0]), first)[0] == pytest.approx(10.0)
    assert effect.mean(np.array([10.0]), later)[0] == pytest.approx(10.0 + lift)
    assert effect.mean(np.array([10.0]), series)[0] == pytest.approx(10.0 + 0.75 * lift)
    assert effect.drifts
    assert float(effect.ordered_variance(np.array([10.0]), series)) == 0.0  # three others alike: the first is not asked


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_a_series_goes_on_with_the_time(frames):
    """Frames 2 s apart under a black level that rises by 0.5 DN/s: their mean, and how those scatter that count."""
    effect = effect_of(Law("digital", (Term("ramp", "timestamp_s", {"reference": 0.0}, {}),)), 0.5)
    times = 10.0 + 2.0 * np.arange(frames)

    def taken(time_s):
        there = at()
        return replace(there, settings=replace(there.settings, timestamp_s=time_s))

    first, later = taken(times[0]), taken(float(times[1:].mean()))
    series = TileContext(
        first.settings, first.geometry, first.camera, first_frame=first, later_frames=later, frames=float(frames)
    )
    levels = 100.0 + 0.5 * times
    assert effect.mean(np.array([100.0]), series)[0] == pytest.approx(levels.mean())
    scatter = levels[1:].var(ddof=1) if frames > 2 else 0.0
    assert float(effect.ordered_variance(np.array([100.0]), series)) == pytest.approx(scatter)
    assert effect.drifts


def test_a_noise_goes_with_the_signal_or_beyond_a_temperature():
    """16 DN² at 1000 DN, drawn as it says; 3 DN where it is warmer than 25 °C."""
    effect = effect_of(Law("tremble"), 0.004)
    signal = np.full(200_000, 1000.0)
    assert effect.variance(signal, at())[0] == pytest.approx(16.0)
    drawn = effect.sample(signal, at(), np.random.default_rng(7))
    assert np.std(drawn) == pytest.approx(4.0, rel=0.01)
    assert np.mean(drawn) == pytest.approx(1000.0, abs=0.03)
    before = Moments(np.array([1000.0]), np.array([9.0]), np.array([0.0]), np.array([0.0]))
    after = effect.moments(before, at())
    assert (after.mean[0], after.variance[0]) == (1000.0, pytest.approx(25.0))
    assert (effect.block, effect.acts_by_square, effect.where) == ("variance", True, "signal")
    effect = effect_of(Law("hiss", (Term("step", "temperature_C", {}, {"at": 25.0}),)), 3.0)
    assert np.ravel(effect.variance(np.array([50.0]), at()))[0] == pytest.approx(9.0)
    cold = replace(at(), settings=replace(at().settings, temperature_c=20.0))
    assert np.ravel(effect.variance(np.array([50.0]), cold))[0] == 0.0
    assert acted(Law("hiss", (Term("step", "temperature_C", {}, {"at": 25.0}),)), 3.0, 50.0, at()) == pytest.approx(9.0)


def test_light_on_its_way_and_a_dimming_screen_go_by_the_picture():
    """2 and 6 e- of columns; 6 % per unit beyond 0.2 are 1.2 %."""
    settings = FrameSettings(exposure_s=0.5)
    image = ExposureContext(settings, FrameGeometry.of_image(2, 3), CameraDescription(bit_depth=12))
    light = np.array([[500.0, 1500.0], [0.0, 3000.0], [1000.0, 0.0]])
    effect = effect_of(Law("transfer", (Term("proportion", "column_light", {}, {}),)), 2e-3)
    assert effect.mean(light, image) == pytest.approx(light + np.array([[2.0, 6.0]]))
    settings = FrameSettings(exposure_s=0.5, source_level=0.5)
    image = ExposureContext(settings, FrameGeometry.of_image(2, 1), CameraDescription(bit_depth=12), peak_radiance=10.0)
    shown = np.array([[1.0, 3.0]])  # of 5 at this level
    effect = effect_of(Law("scene", (Term("ramp", "picture_mean", {"reference": 0.2}, {}),)), -0.06)
    assert effect.mean(shown, image) == pytest.approx(shown * (1.0 - 0.06 * 0.2))


@pytest.mark.parametrize(
    ("link", "scale"),
    [("analog", 10.0), ("lens_light", 4.0), ("digital", 1.0), ("source", 1000.0), ("shutter", 2000.0)],
)
def test_frames_of_a_series_differ_by_what_the_law_changes_at_its_stage(link, scale):
    """The second of two frames waited short: a voltage ten times at 20 dB, light four times at f/2, a delay by 1/t."""
    effect = effect_of(Law(link, (Term("decay", "since_frame_s", {}, {"tau": 3.0}),)), 0.02)
    first, later = at(since_frame_s=6.0), at(since_frame_s=0.3)
    two = TileContext(
        first.settings,
        first.geometry,
        first.camera,
        first_frame=first,
        later_frames=later,
        frames=2.0,
        since_frame_s=6.0,
    )
    apart = 0.02 * (math.exp(-2.0) - math.exp(-0.1)) * scale
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 1000.0)), two)
    assert np.ravel(after.first_excess)[0] == pytest.approx(apart)


@pytest.mark.parametrize(("frames", "counted"), [((5, 6, 7, 8), (0, 1, 0)), ((6, 7, 9, 12), (1, 0, 1))])
def test_one_frame_of_five_counts_by_how_many_of_a_series_it_is(frames, counted):
    """The mean holds its share of all frames; of three and more the first is not asked how they scatter."""
    effect = effect_of(Law("source", (Term("every", "frame", {}, {"period": 5.0, "at": 2.0}),)), 0.04)
    numbers = np.array(frames, dtype=float)
    first, later = at(frame_numbers=numbers[:1]), at(frame_numbers=numbers[1:])
    series = TileContext(
        first.settings,
        first.geometry,
        first.camera,
        frame_numbers=numbers,
        first_frame=first,
        later_frames=later,
        frames=float(len(frames)),
    )
    light = np.array([1000.0])
    assert effect.mean(light, series)[0] == pytest.approx(np.mean([1040.0 if n % 5 == 2 else 1000.0 for n in frames]))
    scatter = np.var([1000.0 * (1.0 + 0.04 * hit) for hit in counted], ddof=1)
    assert float(effect.ordered_variance(light, series)[0]) == pytest.approx(scatter)
    assert effect.mean(light, at(frame_numbers=(7,)))[0] == pytest.approx(1040.0)
    shift = effect_of(Law("digital", (Term("every", "frame", {}, {"period": 5.0, "at": 2.0}),)), 3.0)
    apart = np.var([3.0 * hit for hit in counted], ddof=1)
    assert float(shift.ordered_variance(light, series)) == pytest.approx(apart)
    assert effect.drifts


def test_a_border_within_a_tile_moves_its_mean_and_slope_and_spreads_its_pixels():
    """A gain that steps in the tenth of twelve rows: what its pixels would say, but for a quadratic surface."""
    rows, columns = np.meshgrid(np.arange(12.0), np.arange(12.0), indexing="ij")
    made = np.where(rows > 8.5, 1050.0, 1000.0)
    u, v = (columns - 5.5) / 6.0, (rows - 5.5) / 6.0
    surface = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    left = made.ravel() - surface @ np.linalg.lstsq(surface, made.ravel(), rcond=None)[0]
    points = np.array([(x, y) for y in (-1, 1) for x in (-1, 1)]) * 6.0 / np.sqrt(3.0) + 5.5
    middle, grid = at(), FrameGeometry(columns.reshape(1, 1, -1), rows.reshape(1, 1, -1), 200, 100)
    tile = TileContext(
        middle.settings,
        FrameGeometry(points[:, 0].reshape(1, 1, 4), points[:, 1].reshape(1, 1, 4), 200, 100),
        middle.camera,
        grid=grid,
    )
    effect = effect_of(Law("gain", (Term("border", "image_y", {}, {"at": 8.5 / 200.0}),)), 0.05)
    after = effect.moments(TileMoments.exactly(np.full((1, 1, 4), 1000.0)), tile)
    assert after.mean.mean() == pytest.approx(made.mean())
    assert (after.mean[0, 0, 2] - after.mean[0, 0, 0]) * np.sqrt(3.0) / 2.0 == pytest.approx(
        np.polyfit(v.ravel(), made.ravel(), 1)[0]
    )
    assert float(after.spatial_variance[0, 0, 0]) == pytest.approx(np.mean(left**2))


@pytest.mark.parametrize("beyond", [-3.0, -0.7, 0.0, 1.2])
def test_noise_decides_on_which_side_of_a_jump_a_pixel_lies(beyond):
    """Of pixels that scatter by 20 DN about a limit so many lie beyond it as a normal distribution has there."""
    effect = effect_of(Law("range", (Term("step", "value", {}, {"at": 500.0}),)), -30.0)
    level = 500.0 + 20.0 * beyond
    before = replace(TileMoments.exactly(np.full((1, 1, 4), level)), variance=np.full((1, 1, 4), 400.0))
    middle = at()
    after = effect.moments(before, TileContext(middle.settings, middle.geometry, middle.camera))
    share = 0.5 * (1.0 + math.erf(beyond / math.sqrt(2.0)))
    drawn = np.random.default_rng(5).normal(level, 20.0, 400_000)
    drawn = drawn - 30.0 * (drawn > 500.0)
    assert after.mean[0, 0, 0] == pytest.approx(level - 30.0 * share, abs=30.0 / 64)  # 64 pixels stand for all
    assert after.variance[0, 0, 0] == pytest.approx(drawn.var(), rel=0.05)


def test_places_of_a_step_are_tried_between_those_that_did_well():
    """Dim light and bright have as many places, and a few levels that lie far apart have one each."""
    values = np.concatenate([[0.0], np.geomspace(1.0, 500.0, 150), np.linspace(600.0, 900.0, 4)])
    places = sorted(term.values["at"] for term in terms_of("value", {"value": values}) if term.form == "step")
    assert np.max(np.diff(np.log(places))) < 0.5
    assert all(np.any((places > low) & (places < high)) for low, high in itertools.pairwise(values[-4:]))
    further = [term.values["at"] for term in finer(Term("step", "value", {}, {"at": places[7]}), values, places)]
    assert places[6] < min(further) < places[7] < max(further) < places[8]
    levels = np.array([0.1, 0.25, 0.5, 1.0])
    tried = [term.values["at"] for term in terms_of("source_level", {"source_level": levels}) if term.form == "step"]
    assert list(finer(Term("step", "source_level", {}, {"at": tried[1]}), levels, tried)) == []  # all alike


def laws():
    """Yield a law of each stage and form that the grammar allows, and a product."""
    for link in LINKS.values():
        for name in link.covariates:
            firsts = {}
            for term in terms_of(name, KNOWN):
                firsts.setdefault(term.form, term)
            yield from (Law(link.key, (term,)) for term in firsts.values())
    tilt = next(term for term in terms_of("image_x", KNOWN) if term.form == "ramp")
    yield Law("scene", (tilt, next(term for term in terms_of("source_level", KNOWN) if term.form == "power")))


def test_every_law_makes_a_readable_file():
    """No line is longer than 120 signs, the file defines the effect under its name, and no folder's name is code."""
    sentence = (
        "Adds charge in proportion to exposure, falling off as a Gaussian from the lower left corner: like a glow."
    )
    for law in laws():
        text = effect_source(law, 0.5, sentence=sentence)
        assert max(map(len, text.splitlines())) <= 120, law.name
        assert f"class {law.class_name}(effect_class(LAW, 0.5)):" in text
        assert effect_of(law, 0.5).name == law.name
    named = ast.parse(effect_source(law, 0.5, source='from \'a"""\\x22 + b\\\'\n\0""" + str(1) + """'))
    assert [type(one) for one in named.body] == [ast.Expr, ast.ImportFrom, ast.ImportFrom, ast.Assign, ast.ClassDef]


def test_the_written_test_passes_and_dies_with_the_law(tmp_path):
    """The test next to an effect file holds for it, and fails once a constant of the formula is another."""
    law = Law("optics", (Term("power", "image_x", {"reference": 0.4}, {"power": 2.0}),))
    keys = {"exposure_s": 0.5, "gain_db": 20.0, "temperature_c": 30.0, "timestamp_s": 2.0, "source_level": 0.75}
    keys |= {"f_number": 4.0}
    after = float(effect_of(law, round_to(0.02)).mean(np.array([SIGNAL]), at(30.0, 4.0))[0])
    text = source_of_test(law, 0.02, f"{law.name}.py", keys, (100, 200), [(30.0, 4.0, SIGNAL, after)])
    good, bad = tmp_path / "good", tmp_path / "bad"
    for folder, source in ((good, effect_source(law, 0.02)), (bad, wrong(law))):
        folder.mkdir()
        (folder / f"{law.name}.py").write_text(source)
        (folder / f"test_{law.name}.py").write_text(text)
    run(good / f"test_{law.name}.py")
    registry.EFFECTS.pop(law.name)
    with pytest.raises(AssertionError):
        run(bad / f"test_{law.name}.py")


def wrong(law):
    """Return the effect file of a law with another constant."""
    return effect_source(law, 0.02).replace("0.4", "0.5")


def run(path):
    """Run the tests of a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for row in module.VALUES:
        module.test_the_law_gives_what_was_found(*row)
        module.test_without_its_amplitude_it_does_nothing(*row)


@pytest.mark.parametrize("text", ["__import__('os')", "np.load('a')", "signal.__class__", "[signal]", "(lambda: 1)()"])
def test_a_formula_holds_nothing_but_the_grammar(text):
    """What is no operator or function of the grammar is refused; it is not run."""
    with pytest.raises((ValueError, KeyError)):
        formula(text)({"signal": np.array([1.0])})
