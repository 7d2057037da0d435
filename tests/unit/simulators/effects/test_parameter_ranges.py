"""Ranges of parameters in digital numbers go with the camera's bit depth."""

from __future__ import annotations

import pytest

from simulators.effects.adc_saturation import AdcSaturation
from simulators.effects.base import Parameter
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.registry import EFFECTS


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=lambda kind: kind.name)
def test_no_range_is_a_number_of_codes_of_one_bit_depth(kind: type) -> None:
    """Every parameter in digital numbers has a range that is a share of the camera's full scale."""
    for known in kind.parameters():
        assert known.of_full_scale == known.unit.startswith("DN")


def test_a_deeper_converter_has_a_wider_range() -> None:
    """A black level of 16 bits may be off by up to 65535, one of 8 bits by up to 255."""
    offset = _known(BlackLevelOffset, "offset_dn")
    assert offset.bounds(65535.0) == pytest.approx((-65535.0, 65535.0))
    assert offset.bounds(255.0) == pytest.approx((-255.0, 255.0))


def test_ranges_in_other_units_stay() -> None:
    """What is no digital number has one range for all cameras."""
    exposure = _known(EFFECTS["exposure_time_offset"], "offset_s")
    assert exposure.bounds(65535.0) == (exposure.low, exposure.high)


def test_an_effect_may_be_tried_beyond_the_camera_s_own_codes() -> None:
    """A search steps a little beyond the highest code of 16 bits without being refused."""
    assert AdcSaturation(65535.0).with_parameters(clip_dn=70646.4).clip_dn == 70646.4


def _known(kind: type, name: str) -> Parameter:
    return next(entry for entry in kind.parameters() if entry.name == name)
