"""What makes names provisional though nothing structured is left next to them."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.reconciliation.fit.state import ModelFit
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.search.localise import Disagreement, departing
from radiometer.reconciliation.verdict import Posterior, posterior, uncertain, without_essential
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.dark_frame_subtracted import DarkFrameSubtracted
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.stray_light_kernel import StrayLightKernel

BLUR_AND_GAIN = (PsfBlur(0.3), ConversionGainError(0.01))
CROSSTALK = Crosstalk(0.01)


def _weighed(*models: tuple[tuple[CatalogueEffect, ...], float]) -> Posterior:
    """Return the posterior over models of so many nats, spread evenly over 200 settings."""
    fits = [ModelFit(effects, 0, np.full(200, nats / 200.0), len(effects), 1.0) for effects, nats in models]
    return posterior(fits, ("psf_blur", "conversion_gain_error", "crosstalk"))


def test_a_name_that_another_replaces_is_doubted_unless_the_plan_cannot_separate_them() -> None:
    """Of two that predict alike neither is certain; that it is one of the two is, where both are reported."""
    weighed = _weighed((BLUR_AND_GAIN[:1], 100.0), ((CROSSTALK,), 100.0), ((), 0.0))
    assert uncertain(["psf_blur"], weighed, {})["psf_blur"] == pytest.approx(0.5, abs=0.01)
    assert uncertain(["psf_blur"], weighed, {"psf_blur": ("crosstalk",)}) == {}


def test_one_alternative_to_all_names_doubts_them() -> None:
    """Crosstalk blurs and takes noise away: a blur and a gain error may both be it, unless it predicts far worse."""
    names = [effect.name for effect in BLUR_AND_GAIN]
    alike = dict.fromkeys(names, ("crosstalk",))
    alone = _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 100.0))
    assert set(uncertain(names, alone, alike)) == set(names)
    assert uncertain(names, _weighed((BLUR_AND_GAIN, 100.0), ((CROSSTALK,), 0.0)), alike) == {}


def test_fall_off_without_its_oblique_part_lacks_its_essential() -> None:
    """A fall-off that only the term beyond the cos⁴ law carries is no natural vignetting; an offset has none."""
    lens, late = NaturalVignetting(0.001, 0.02), ExposureTimeOffset(2e-6)

    def fitted(strength: float) -> dict[str, dict[str, FittedParameter]]:
        k4, offset = FittedParameter(0.02, 0.002, "1"), FittedParameter(2e-6, 1e-6, "s")
        lens_values = {"strength": FittedParameter(strength, 0.001, "1"), "k4": k4}
        return {"natural_vignetting": lens_values, "exposure_time_offset": {"offset_s": offset}}

    assert without_essential((lens, late), fitted(0.001)) == ["natural_vignetting"]
    assert without_essential((lens, late), fitted(0.01)) == []


def test_what_a_form_does_not_fit_is_not_missed() -> None:
    """Shading by slant with powers of its own has no cone to fit; a power of the stop that is nothing is missed."""
    shading = (AngleDependence(0.01, 2.1, -0.5),)

    def fitted(stop_power: float) -> dict[str, dict[str, FittedParameter]]:
        sizes = {"strength": 0.01, "radius_power": 2.1, "stop_power": stop_power}
        values = {name: FittedParameter(size, 0.001, "1") for name, size in sizes.items()}
        return {"angle_dependence": values | {"cone": FittedParameter(0.0, None, "1")}}

    assert without_essential(shading, fitted(-0.5)) == []
    assert without_essential(shading, fitted(0.0)) == ["angle_dependence"]


def test_scatter_of_any_width_lacks_its_essential() -> None:
    """A wing whose width the data do not tell may be any glare; darks without noise, at the end of it, are none."""
    wing = (StrayLightKernel(0.002, 0.7),)

    def fitted(u: float) -> dict[str, dict[str, FittedParameter]]:
        return {
            "stray_light_kernel": {
                "share": FittedParameter(0.002, 0.0001, "1"),
                "radius": FittedParameter(0.7, u, "1"),
            }
        }

    assert without_essential(wing, fitted(0.3)) == ["stray_light_kernel"]
    assert without_essential(wing, fitted(0.1)) == []
    darks = {"dark_frame_subtracted": {"share": FittedParameter(0.0, None, "1")}}
    assert without_essential((DarkFrameSubtracted(0.0),), darks) == ["dark_frame_subtracted"]


@pytest.mark.parametrize(("u_s", "doubted"), [(1e-5, True), (1e-6, False)])
def test_bands_without_a_time_from_row_to_row_are_any_flicker(u_s: float, doubted: bool) -> None:
    """What comes from the rolling shutter is the wave along the rows: light that shakes whole frames has none."""
    bands = RollingShutterBanding(0.02, 200.0, 2e-5)
    fitted = {"rolling_shutter_banding": {"row_time_s": FittedParameter(2e-5, u_s, "s")}}
    assert bool(without_essential((bands,), fitted)) is doubted


def test_law_that_leaves_structure_in_its_own_place_departs() -> None:
    """A chance of 1 in 1000 counts along the exposure for what acts there, and nothing elsewhere."""

    def test(block: str, where: str, p_value: float) -> Disagreement:
        return Disagreement(block, where, "multiplicative", 20.0, 4, p_value)

    late = (ExposureTimeOffset(2e-6),)
    quiet = [test("mean", "exposure_s", 0.02), test("mean", "image_x", 0.001), test("variance", "exposure_s", 0.001)]
    assert departing(quiet, late) == []
    assert departing([*quiet, test("mean", "exposure_s", 0.001)], late) == ["exposure_time_offset"]
