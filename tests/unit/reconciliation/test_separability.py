"""Which names a plan cannot tell apart, asked of the captures alone and held against fits."""

import json
from dataclasses import replace

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import CaptureSetWriter
from radiometer.reconciliation import engine
from radiometer.reconciliation.descent import Candidate, refit
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.separability import (
    ConfusablePair,
    Directions,
    asked_sizes,
    left_by_fit,
    noiseless,
    separability,
)
from radiometer.reconciliation.state import with_effects
from testing import effect_kinds as fx
from testing.reduced import start_of

BRACKET = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 8) for _ in range(2)]
DARKS = [{"t": t, "shutter": "closed"} for t in (1e-4, 1e-2, 1.0)]
OTHERS = [{"t": 3e-3, "pattern": "bright"}, {"t": 3e-3, "d": 0.3}, {"t": 0.1, "d": 0.0}, {"t": 1.0, "d": 0.0}]
STRAY = {"veiling_glare", "ambient_light_leak", "display_black_leak"}


def _state(make_capture, plan):
    captured = make_capture(seed=61, plan=plan)
    return start_of(captured)


@pytest.fixture(scope="module")
def plain(make_capture):
    """Return the starting camera for a bracket of one chart at one level, and its darks."""
    return _state(make_capture, [*BRACKET, *DARKS])


@pytest.fixture(scope="module")
def separated(plain):
    """Return what that bracket can tell apart of stray light, flicker, what it is blind to, and others next to them."""
    others = ("polarisation", "mains_ripple", "pwm_flicker", "exposure_time_offset", "gamma_enabled", "psf_blur")
    return separability(plain, {name: whole_catalogue()[name] for name in (*sorted(STRAY), *others)})


def _sets(found):
    return [{entry.name, *entry.others} for entry in found.together]


@pytest.mark.slow
def test_stray_lights_are_separated_by_another_surround_alone(separated, make_capture):
    """One chart leaves them and flickers together; stated radiances count."""
    entry = next(entry for entry in separated.together if {entry.name, *entry.others} >= STRAY)
    assert entry.capture["frames"][0]["shutter"] == "open"
    assert "polarisation" in separated.blind
    assert any(names >= {"mains_ripple", "pwm_flicker"} for names in _sets(separated))
    state, veil = _state(make_capture, [*BRACKET, *DARKS, OTHERS[0]]), fx.VeilingGlare(0.02)
    left, _ = left_by_fit(noiseless(state, veil), veil, Candidate(fx.AmbientLightLeak(0.01), 0.0, 1))
    assert left > 100.0
    state = _state(make_capture, [*BRACKET, *DARKS, *OTHERS])
    found = separability(state, {name: whole_catalogue()[name] for name in STRAY})
    assert all(len(names & STRAY) < 2 for names in _sets(found))
    assert not STRAY & set(found.blind)


@pytest.mark.parametrize(
    ("truth", "other", "alike"),
    [
        (fx.VeilingGlare(0.004), fx.AmbientLightLeak(0.002), True),
        (fx.ExposureTimeOffset(8e-6), fx.AmbientLightLeak(0.002), False),
    ],
)
def test_names_that_stand_together_fit_each_other_without_noise(plain, truth, other, alike):
    """Fitted to what a model with the one expects, without noise, the other leaves less than 10 of χ², or hundreds."""
    expected = plain.predicted_with((truth,))
    seen = replace(plain.seen, mean=expected.mean, variance=expected.variance, spatial=expected.spatial)
    exact = replace(plain, seen=seen, comparison=replace(plain.comparison, seen=seen))
    own, foreign = (refit(with_effects(exact, [effect])).cost for effect in (truth, other))
    assert (foreign - own < 10.0) is alike
    assert alike or foreign - own > 100.0


@pytest.mark.parametrize(("other", "alike"), [(fx.AmbientLightLeak(0.1), True), (fx.ExposureTimeOffset(8e-6), False)])
def test_large_effect_is_held_against_fits_to_its_noiseless_data(plain, other, alike):
    """A veil of 30 % is fitted by light from the room to less than 10 of χ², not by a longer exposure."""
    truth = fx.VeilingGlare(0.3)
    exact = noiseless(plain, truth)
    assert exact.comparison.residual(plain.predicted_with((truth,))) == pytest.approx(0.0)
    left, fitted = left_by_fit(exact, truth, Candidate(other, 0.0, 1))
    assert (left < 10.0) is alike
    assert fitted.name == other.name


class _FromNothing(fx.AmbientLightLeak):
    """Light from the room whose first start is far below what any frame shows."""

    @classmethod
    def starts(cls, context):
        """Return a hopeless start and a fair one."""
        return cls(1e-13), cls(0.002)


def test_entries_are_asked_about_where_they_show_and_likeness_is_fitted(plain):
    """A limit as it is; derivatives are held to a fit."""
    asked = asked_sizes(plain, {"ambient_light_leak": _FromNothing})
    assert asked["ambient_light_leak"].values()["irradiance_w_m2"] > 1e-9
    effect = asked_sizes(plain, {"adc_saturation": fx.AdcSaturation})["adc_saturation"]
    assert effect in fx.AdcSaturation.starts(plain.model.context)
    assert _brought(plain, effect) > 400.0
    shaken = asked_sizes(plain, {"mains_ripple": fx.MainsRipple})["mains_ripple"]
    settling = fx.SeriesSettling.starts(plain.model.context)
    directions = Directions.of(plain, {"mains_ripple": (shaken,), "series_settling": settling})
    (target,) = directions.forms["mains_ripple"]
    assert min(directions.left(target, form)[0] for form in directions.forms["series_settling"]) < 10.0
    assert ConfusablePair(directions, target).fitted("series_settling") is None


def _brought(state, effect):
    """Return the χ² by which an effect stands out of its own noiseless data, all nuisances refitted without it."""
    exact = noiseless(state, effect)
    return refit(exact).cost - refit(with_effects(exact, [effect])).cost


@pytest.mark.parametrize("kind", [fx.ExposureTimeOffset, fx.PsfBlur, fx.VeilingGlare])
def test_entry_is_asked_about_at_twenty_sigma(plain, kind):
    """What is asked about leaves 400 of χ² where it is not fitted, whether it grows in proportion or as a square."""
    effect = asked_sizes(plain, {kind.name: kind})[kind.name]
    assert _brought(plain, effect) == pytest.approx(400.0, rel=0.15)  # looked for to a tenth of ln χ²


def test_limit_is_followed_by_another_whole_and_not_in_part(plain):
    """Half of what a limit ends is no limit: a lower well than another leaves the square of what it takes away more."""
    own = fx.FullWellSaturation(6000.0)
    lower = fx.FullWellSaturation(4500.0)
    directions = Directions.of(plain, {"own": (own,), "lower": (lower,)})
    (target,), (other,) = directions.forms["own"], directions.forms["lower"]
    assert directions.left(target, target) == pytest.approx((0.0, 1.0), abs=1e-6 * directions.shown(target))
    alone = replace(other, columns=slice(other.columns.start, other.columns.start + 1))
    changed, less = (plain.predicted_with((effect,)) for effect in (own, lower))
    apart = plain.comparison.residual(changed) - plain.comparison.residual(less)
    followed = plain.pad(apart[:, None])
    moved, part = plain.fit.followed_with_half(followed)
    expected = float(np.sum(moved**2) - np.sum(part**2))
    assert directions.left(target, alone) == pytest.approx((expected, 1.0), rel=1e-6)


@pytest.mark.slow
def test_plan_is_reported_on_the_command_line(make_capture, plain, separated, tmp_path, capsys, monkeypatch):
    """`--plan-only` asks of the captures alone, gives the sets and what they are blind to, and names nothing."""
    asked = []

    def found(state, catalogue):
        asked.append((state.seen.mean.size, len(catalogue)))
        return separated

    monkeypatch.setattr(engine, "separability", found)
    captured = make_capture(seed=61, plan=[*BRACKET, *DARKS])
    header = captured.header
    parts = (header.camera, header.lens, header.source, header.patches, header.patterns)
    with CaptureSetWriter(tmp_path / "set", *parts) as writer:
        for frame in captured.frames:
            writer.add(frame)
    assert run(["reconcile", str(tmp_path / "set"), "--plan-only", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == {"inseparable", "blind"}
    assert any({entry["name"], *entry["others"]} >= STRAY for entry in printed["inseparable"])
    assert run(["reconcile", str(tmp_path / "set"), "--plan-only"]) == 0
    assert "these captures cannot separate" in capsys.readouterr().out
    assert asked == [(plain.seen.mean.size, len(whole_catalogue()))] * 2
