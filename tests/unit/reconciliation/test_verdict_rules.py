"""The verdict word by word, each rule on both sides of its threshold; and how far statistics scatter, by formula."""

from __future__ import annotations

import pytest

from radiometer.reconciliation import verdict
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.psf_blur import PsfBlur

BLUR, GAIN = PsfBlur(0.3), ConversionGainError(0.01)


@pytest.mark.parametrize(
    ("gamma", "reported"),
    [(1.0051, False), (1.0049, True), (0.9949, False), (0.9951, True), (1.0004, True), (2.2, False), (0.45, False)],
)
def test_a_gamma_nearer_to_one_than_any_setting(gamma, reported):
    """Cameras tell gamma in hundredths: what bends by less than half of one is something else, and the name a guess."""
    text = verdict.below_least((BLUR, GammaEnabled(gamma), GAIN))
    assert text == ([f"gamma_enabled with gamma = {gamma:.6g}"] if reported else [])
