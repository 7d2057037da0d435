"""Probabilities of names follow from what fitted models predict of held-out settings."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.reconciliation import thresholds
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.localise import Disagreement, departing
from radiometer.reconciliation.result import FittedParameter, FoundEffect
from radiometer.reconciliation.state import ModelFit
from radiometer.reconciliation.thresholds import TABLE
from radiometer.reconciliation.verdict import UNNAMED, posterior, pseudo_bma, uncertain, without_essential
from testing import effect_kinds as fx

CATALOGUE = ("black_level_offset", "crosstalk")
SETTINGS = 200
OFFSET, CROSSTALK = fx.BlackLevelOffset(offset_dn=1.0), fx.Crosstalk(share=0.01)


def _fit(*effects, nats=0.0, curves=0, u=None):
    """Return a model that is so many nats better than others, spread evenly over all settings."""
    density = np.full(SETTINGS, nats / SETTINGS)
    return ModelFit(effects, curves, density, len(effects) + curves, 1.0, u or {})


def test_names_share_and_pay_for_their_probability_and_uncertainty():
    """Three nats for a parameter; 1 ± 0.3 and 2 ± 0.4 make 1.5 with the choice in it."""
    found = posterior([_fit(), _fit(OFFSET, nats=100.0), _fit(CROSSTALK, nats=100.0)], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=1e-3)
    assert found.probability("crosstalk") == pytest.approx(0.5, abs=1e-3)
    assert sum(model.weight for model in found.models) == pytest.approx(1.0)
    nats = 40.0
    alone, spread = np.zeros((2, SETTINGS)), np.zeros((2, SETTINGS))
    alone[1, 0], spread[1] = nats, nats / SETTINGS
    assert pseudo_bma(alone, np.zeros(2))[0] == pytest.approx(math.log(2.0) / nats, rel=0.5)
    assert pseudo_bma(spread, np.zeros(2))[0] < 1e-6
    found = posterior([_fit(), _fit(nats=300.0, curves=3), _fit(CROSSTALK, nats=200.0)], CATALOGUE)
    assert found.models[0].names == (UNNAMED,)
    assert posterior([_fit(CROSSTALK)], ("black_level_offset",)).models[0].names == (UNNAMED,)
    found = posterior([_fit(), _fit(OFFSET, nats=3.0 + math.log(2.0))], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=0.01)
    key = ("black_level_offset", "offset_dn")
    one = _fit(OFFSET, nats=100.0, u={key: 0.3})
    both = (fx.BlackLevelOffset(offset_dn=2.0), CROSSTALK)
    other = ModelFit(both, 0, np.full(SETTINGS, (103.0 + math.log(2.0)) / SETTINGS), 2, 1.0, {key: 0.4})
    found = posterior([_fit(), one, other], CATALOGUE).averaged("black_level_offset")["offset_dn"]
    assert (found.value, found.u) == (pytest.approx(1.5, abs=0.01), pytest.approx(math.sqrt(0.125 + 0.25), rel=0.01))


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (1.0, "probability above 0.999, almost certain"),
        (0.95, "probability 0.950, almost certain"),
        (0.7, "probability 0.700, likely"),
        (0.331, "probability 0.331, possible"),
        (None, "12 nats"),
    ],
)
def test_people_read_a_probability_with_a_word(probability, words):
    """Almost certain from 0.95, likely from two thirds; photographs and logs, which compare no models, give nats.

    Beside a name that these data cannot separate from it none is certain.
    """
    found = FoundEffect("crosstalk", {}, "signal", 1.2, 1.0, gain_nats=12.0, probability=probability)
    assert found.evidence == words
    assert replace(found, alternatives=("ghost",)).evidence == words.replace("almost certain", "likely")


@given(st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=6))
def test_weights_are_probabilities_in_the_order_of_what_models_predict(nats):
    """They sum to 1; of models that differ evenly over the settings the better one never weighs less."""
    weights = pseudo_bma(np.array(nats)[:, None] * np.full(SETTINGS, 1.0 / SETTINGS), np.zeros(len(nats)))
    assert float(weights.sum()) == pytest.approx(1.0)
    assert np.all(np.diff(weights[np.argsort(nats, kind="stable")]) >= -1e-12)


# What makes names provisional though nothing structured is left next to them.


BLUR_AND_GAIN = (fx.PsfBlur(0.3), fx.ConversionGainError(0.01))


def _weighed(*models):
    """Return the posterior over models of so many nats, spread evenly over 200 settings."""
    fits = [ModelFit(effects, 0, np.full(200, nats / 200.0), len(effects), 1.0) for effects, nats in models]
    return posterior(fits, ("psf_blur", "conversion_gain_error", "crosstalk"))


def test_names_that_others_replace_are_doubted():
    """Unless the plan cannot separate them; one alternative to all doubts them all."""
    weighed = _weighed((BLUR_AND_GAIN[:1], 100.0), ((CROSSTALK,), 100.0), ((), 0.0))
    assert uncertain(["psf_blur"], weighed, {})["psf_blur"] == pytest.approx(0.5, abs=0.01)
    assert uncertain(["psf_blur"], weighed, {"psf_blur": ("crosstalk",)}) == {}
    names = [effect.name for effect in BLUR_AND_GAIN]
    alike = dict.fromkeys(names, ("crosstalk",))
    alone = _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 100.0))
    assert set(uncertain(names, alone, alike)) == set(names)
    assert uncertain(names, _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 0.0)), alike) == {}


def test_what_a_form_does_not_fit_is_missed_only_where_it_is_essential():
    """A fall-off without its oblique part; a shading without a cone."""
    lens, late = fx.NaturalVignetting(0.001, 0.02), fx.ExposureTimeOffset(2e-6)

    def fitted(strength):
        k4, offset = FittedParameter(0.02, 0.002, "1"), FittedParameter(2e-6, 1e-6, "s")
        lens_values = {"strength": FittedParameter(strength, 0.001, "1"), "k4": k4}
        return {"natural_vignetting": lens_values, "exposure_time_offset": {"offset_s": offset}}

    assert without_essential((lens, late), fitted(0.001)) == ["natural_vignetting"]
    assert without_essential((lens, late), fitted(0.01)) == []
    shading = (fx.AngleDependence(0.01, 2.1, -0.5),)

    def fitted(stop_power):
        sizes = {"strength": 0.01, "radius_power": 2.1, "stop_power": stop_power}
        values = {name: FittedParameter(size, 0.001, "1") for name, size in sizes.items()}
        return {"angle_dependence": values | {"cone": FittedParameter(0.0, None, "1")}}

    assert without_essential(shading, fitted(-0.5)) == []
    assert without_essential(shading, fitted(0.0)) == ["angle_dependence"]


def test_laws_and_scatters_without_their_essential_are_no_such_name():
    """A wing of any width may be any glare; 1 in 1000 along the exposure departs."""
    wing = (fx.StrayLightKernel(0.002, 0.7),)

    def fitted(u):
        return {
            "stray_light_kernel": {"share": FittedParameter(0.002, 0.0001, "1"), "radius": FittedParameter(0.7, u, "1")}
        }

    assert without_essential(wing, fitted(0.3)) == ["stray_light_kernel"]
    assert without_essential(wing, fitted(0.1)) == []
    darks = {"dark_frame_subtracted": {"share": FittedParameter(0.0, None, "1")}}
    assert without_essential((fx.DarkFrameSubtracted(0.0),), darks) == ["dark_frame_subtracted"]

    def test(block, where, p_value):
        return Disagreement(block, where, "multiplicative", 20.0, 4, p_value)

    late = (fx.ExposureTimeOffset(2e-6),)
    quiet = [test("mean", "exposure_s", 0.02), test("mean", "image_x", 0.001), test("variance", "exposure_s", 0.001)]
    assert departing(quiet, late) == []
    assert departing([*quiet, test("mean", "exposure_s", 0.001)], late) == ["exposure_time_offset"]


@pytest.mark.parametrize(("u_s", "doubted"), [(1e-5, True), (1e-6, False)])
def test_bands_without_a_time_from_row_to_row_are_any_flicker(u_s, doubted):
    """What comes from the rolling shutter is the wave along the rows: light that shakes whole frames has none."""
    bands = fx.RollingShutterBanding(0.02, 200.0, 2e-5)
    fitted = {"rolling_shutter_banding": {"row_time_s": FittedParameter(2e-5, u_s, "s")}}
    assert bool(without_essential((bands,), fitted)) is doubted


# The thresholds that decide about names: one table.


def test_every_row_has_its_constant_and_every_prior_its_reason():
    """What the search reads is what the table says."""
    assert [getattr(thresholds, row.name) for row in TABLE] == [row.value for row in TABLE]
    assert all(row.reason and row.measured and row.unit for row in TABLE)
    odd = {
        name: kind for name, kind in whole_catalogue().items() if bool(kind.log_prior_odds) != bool(kind.prior_reason)
    }
    assert odd == {}
    assert all(kind.log_prior_odds <= 0.0 for kind in whole_catalogue().values())
