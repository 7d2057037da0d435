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
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.dark_frame_subtracted import DarkFrameSubtracted
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.stray_light_kernel import StrayLightKernel

CATALOGUE = ("black_level_offset", "crosstalk")
SETTINGS = 200
OFFSET, CROSSTALK = BlackLevelOffset(offset_dn=1.0), Crosstalk(share=0.01)


def _fit(*effects, nats=0.0, curves=0, u=None):
    """Return a model that is so many nats better than others, spread evenly over all settings."""
    density = np.full(SETTINGS, nats / SETTINGS)
    return ModelFit(effects, curves, density, len(effects) + curves, 1.0, u or {})


def test_two_names_that_predict_alike_share_the_probability():
    """Neither is more than possible, and one of the two is almost certain."""
    found = posterior([_fit(), _fit(OFFSET, nats=100.0), _fit(CROSSTALK, nats=100.0)], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=1e-3)
    assert found.probability("crosstalk") == pytest.approx(0.5, abs=1e-3)
    assert sum(model.weight for model in found.models) == pytest.approx(1.0)


def test_one_setting_gives_no_certainty_and_many_do():
    """Where one setting holds all Δ nats, the other model keeps ∫ e^−x/(1 + e^Δx) dx, near ln 2/Δ; else nothing."""
    nats = 40.0
    alone, spread = np.zeros((2, SETTINGS)), np.zeros((2, SETTINGS))
    alone[1, 0], spread[1] = nats, nats / SETTINGS
    assert pseudo_bma(alone, np.zeros(2))[0] == pytest.approx(math.log(2.0) / nats, rel=0.5)
    assert pseudo_bma(spread, np.zeros(2))[0] < 1e-6


def test_what_no_entry_explains_has_no_name():
    """A curve, or an effect that is no entry of the catalogue, counts as unnamed."""
    found = posterior([_fit(), _fit(nats=300.0, curves=3), _fit(CROSSTALK, nats=200.0)], CATALOGUE)
    assert found.models[0].names == (UNNAMED,)
    assert posterior([_fit(CROSSTALK)], ("black_level_offset",)).models[0].names == (UNNAMED,)


def test_a_name_must_pay_for_its_parameter_and_the_entries_that_might_have_fitted():
    """Three nats for a parameter and ln 2 for two entries: at 3 + ln 2 nats it is as likely as nothing."""
    found = posterior([_fit(), _fit(OFFSET, nats=3.0 + math.log(2.0))], CATALOGUE)
    assert found.probability("black_level_offset") == pytest.approx(0.5, abs=0.01)


def test_uncertainties_contain_the_choice_among_models():
    """Two models of equal weight with 1 ± 0.3 and 2 ± 0.4: 1.5 ± √((0.09 + 0.16)/2 + 0.25)."""
    key = ("black_level_offset", "offset_dn")
    one = _fit(OFFSET, nats=100.0, u={key: 0.3})
    both = (BlackLevelOffset(offset_dn=2.0), CROSSTALK)
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


BLUR_AND_GAIN = (PsfBlur(0.3), ConversionGainError(0.01))


def _weighed(*models):
    """Return the posterior over models of so many nats, spread evenly over 200 settings."""
    fits = [ModelFit(effects, 0, np.full(200, nats / 200.0), len(effects), 1.0) for effects, nats in models]
    return posterior(fits, ("psf_blur", "conversion_gain_error", "crosstalk"))


def test_a_name_that_another_replaces_is_doubted_unless_the_plan_cannot_separate_them():
    """Of two that predict alike neither is certain; that it is one of the two is, where both are reported."""
    weighed = _weighed((BLUR_AND_GAIN[:1], 100.0), ((CROSSTALK,), 100.0), ((), 0.0))
    assert uncertain(["psf_blur"], weighed, {})["psf_blur"] == pytest.approx(0.5, abs=0.01)
    assert uncertain(["psf_blur"], weighed, {"psf_blur": ("crosstalk",)}) == {}


def test_one_alternative_to_all_names_doubts_them():
    """Crosstalk blurs and takes noise away: a blur and a gain error may both be it, unless it predicts far worse."""
    names = [effect.name for effect in BLUR_AND_GAIN]
    alike = dict.fromkeys(names, ("crosstalk",))
    alone = _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 100.0))
    assert set(uncertain(names, alone, alike)) == set(names)
    assert uncertain(names, _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 0.0)), alike) == {}


def test_fall_off_without_its_oblique_part_lacks_its_essential():
    """A fall-off that only the term beyond the cos⁴ law carries is no natural vignetting; an offset has none."""
    lens, late = NaturalVignetting(0.001, 0.02), ExposureTimeOffset(2e-6)

    def fitted(strength):
        k4, offset = FittedParameter(0.02, 0.002, "1"), FittedParameter(2e-6, 1e-6, "s")
        lens_values = {"strength": FittedParameter(strength, 0.001, "1"), "k4": k4}
        return {"natural_vignetting": lens_values, "exposure_time_offset": {"offset_s": offset}}

    assert without_essential((lens, late), fitted(0.001)) == ["natural_vignetting"]
    assert without_essential((lens, late), fitted(0.01)) == []


def test_what_a_form_does_not_fit_is_not_missed():
    """Shading by slant with powers of its own has no cone to fit; a power of the stop that is nothing is missed."""
    shading = (AngleDependence(0.01, 2.1, -0.5),)

    def fitted(stop_power):
        sizes = {"strength": 0.01, "radius_power": 2.1, "stop_power": stop_power}
        values = {name: FittedParameter(size, 0.001, "1") for name, size in sizes.items()}
        return {"angle_dependence": values | {"cone": FittedParameter(0.0, None, "1")}}

    assert without_essential(shading, fitted(-0.5)) == []
    assert without_essential(shading, fitted(0.0)) == ["angle_dependence"]


def test_scatter_of_any_width_lacks_its_essential():
    """A wing whose width the data do not tell may be any glare; darks without noise, at the end of it, are none."""
    wing = (StrayLightKernel(0.002, 0.7),)

    def fitted(u):
        return {
            "stray_light_kernel": {"share": FittedParameter(0.002, 0.0001, "1"), "radius": FittedParameter(0.7, u, "1")}
        }

    assert without_essential(wing, fitted(0.3)) == ["stray_light_kernel"]
    assert without_essential(wing, fitted(0.1)) == []
    darks = {"dark_frame_subtracted": {"share": FittedParameter(0.0, None, "1")}}
    assert without_essential((DarkFrameSubtracted(0.0),), darks) == ["dark_frame_subtracted"]


@pytest.mark.parametrize(("u_s", "doubted"), [(1e-5, True), (1e-6, False)])
def test_bands_without_a_time_from_row_to_row_are_any_flicker(u_s, doubted):
    """What comes from the rolling shutter is the wave along the rows: light that shakes whole frames has none."""
    bands = RollingShutterBanding(0.02, 200.0, 2e-5)
    fitted = {"rolling_shutter_banding": {"row_time_s": FittedParameter(2e-5, u_s, "s")}}
    assert bool(without_essential((bands,), fitted)) is doubted


def test_law_that_leaves_structure_in_its_own_place_departs():
    """A chance of 1 in 1000 counts along the exposure for what acts there, and nothing elsewhere."""

    def test(block, where, p_value):
        return Disagreement(block, where, "multiplicative", 20.0, 4, p_value)

    late = (ExposureTimeOffset(2e-6),)
    quiet = [test("mean", "exposure_s", 0.02), test("mean", "image_x", 0.001), test("variance", "exposure_s", 0.001)]
    assert departing(quiet, late) == []
    assert departing([*quiet, test("mean", "exposure_s", 0.001)], late) == ["exposure_time_offset"]


# The thresholds that decide about names: one table.


def test_every_row_is_the_constant_of_its_name():
    """What the search reads is what the table says, and each row says why."""
    assert [getattr(thresholds, row.name) for row in TABLE] == [row.value for row in TABLE]
    assert all(row.reason and row.measured and row.unit for row in TABLE)


def test_prior_odds_that_are_not_even_have_a_reason():
    """An effect that is less likely beforehand says why, and one that is not says nothing."""
    odd = {
        name: kind for name, kind in whole_catalogue().items() if bool(kind.log_prior_odds) != bool(kind.prior_reason)
    }
    assert odd == {}
    assert all(kind.log_prior_odds <= 0.0 for kind in whole_catalogue().values())
