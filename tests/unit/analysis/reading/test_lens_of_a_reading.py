"""What the lens does to a reading: an f-number is never assumed, filters and focus count with their uncertainty."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import Bracket, Frame, LensDescription, Patch
from radiometer.data.setup import Setup
from radiometer.errors import CalibrationError

PATCH = Patch(1, 1, 10, 10)


@pytest.fixture
def seen(rig):
    """Return frames of a radiance, and that radiance."""
    truth = 0.5 * rig.radiance_of_full_scale(1e-3)
    return Bracket.from_frames(rig.frames(np.full((12, 12), truth), np.random.default_rng(3), (1e-3,) * 3)), truth


def without_f_number(bracket):
    return Bracket.from_frames(Frame(f.dn, 12, replace(f.settings, f_number=None)) for f in bracket.light)


def lensed(rig, **lens):
    """Return a calibration made through a lens, and that lens."""
    made = LensDescription(focal_length_mm=16.0, f_number=4.0, **lens)
    return replace(rig.calibration(), lens=made)


def line(reading, name):
    return next(one for one in reading.budget if one.name == name)


def test_an_unknown_f_number_is_refused_and_asked_for(rig, seen):
    """Frames that do not state it are not read or merged as if they had the calibration's."""
    frames, setup = without_f_number(seen[0]), Setup(rig.description, LensDescription(), rig.calibration())
    for use in (lambda: read_patch(frames, PATCH, setup), lambda: merge(frames, setup)):
        with pytest.raises(CalibrationError, match="--f-number"):
            use()


def test_a_lens_that_states_its_f_number_speaks_for_frames_that_do_not(rig, seen):
    """At f/8 behind a calibration at f/4 the same frames mean four times the radiance."""
    frames, truth = without_f_number(seen[0]), seen[1]
    found = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=8.0), rig.calibration()))
    assert found.radiance.value == pytest.approx(4.0 * truth, rel=5e-3)


def test_a_scale_without_an_f_number_is_refused(rig, seen):
    """A calibration that does not say at which aperture it holds serves at none."""
    base = rig.calibration()
    unknown = replace(base, scale=base.scale.model_copy(update={"f_number": None}))
    with pytest.raises(CalibrationError, match=r"scale\.f_number"):
        read_patch(seen[0], PATCH, Setup(rig.description, rig.lens, unknown))


def test_relative_values_need_no_f_number(rig, seen):
    """Without a scale nothing rests on it."""
    found = read_patch(without_f_number(seen[0]), PATCH, Setup(rig.description, LensDescription()))
    assert found.radiance.unit == "relative"


def test_a_neutral_filter_in_front_counts_with_both_uncertainties(rig, seen):
    """Transmittance 0.09 in use and 0.9 at calibration: ten times the radiance, u the root of 2 %² + 1 %²."""
    frames, calibration = seen[0], lensed(rig, transmittance=0.9, transmittance_u_rel=0.01)
    lens = LensDescription(f_number=4.0, transmittance=0.09, transmittance_u_rel=0.02)
    plain = read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=4.0), calibration))
    found = read_patch(frames, PATCH, Setup(rig.description, lens, calibration))
    assert found.radiance.value == pytest.approx(10.0 * plain.radiance.value, rel=1e-12)
    assert line(plain, "lens transmittance").u_rel == 0.0
    assert line(found, "lens transmittance").u_rel == pytest.approx(math.hypot(0.01, 0.02))


def test_a_filter_without_a_stated_uncertainty_has_the_trade_s(rig, seen):
    """Filters are sold to ±10 %: a rectangle, 5.8 %; the calibration's own stated figure is not borrowed."""
    calibration = lensed(rig, transmittance=0.9, transmittance_u_rel=0.0)
    found = read_patch(
        seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), calibration)
    )
    assert line(found, "lens transmittance").u_rel == pytest.approx(0.1 / math.sqrt(3.0))


def test_a_transmittance_that_the_calibration_does_not_state_is_refused(rig, seen):
    """The ratio is not known."""
    with pytest.raises(CalibrationError, match=r"transmittance of 0\.09"):
        read_patch(
            seen[0], PATCH, Setup(rig.description, LensDescription(f_number=4.0, transmittance=0.09), rig.calibration())
        )


def test_a_nearer_focus_counts_with_its_uncertainty(rig, seen):
    """At magnification 0.1 the lens takes in 1/1.1² of the light: the radiance is 1.21 times what it would seem."""
    frames, calibration = seen[0], rig.calibration()
    far, near = (
        read_patch(frames, PATCH, Setup(rig.description, LensDescription(f_number=4.0, magnification=m), calibration))
        for m in (0.0, 0.1)
    )
    assert near.radiance.value / far.radiance.value == pytest.approx(1.21)
    assert line(far, "focus").u_rel == 0.0
    assert line(near, "focus").u_rel == pytest.approx(2 * 0.1 * 0.1 / 1.1)


def test_a_map_counts_filter_and_focus_too(rig, seen):
    """The same factors in every pixel, and their uncertainty in what all pixels share."""
    calibration = lensed(rig, transmittance=0.9, transmittance_u_rel=0.0)
    plain = merge(seen[0], Setup(rig.description, LensDescription(f_number=4.0), calibration))
    lens = LensDescription(f_number=4.0, transmittance=0.45, transmittance_u_rel=0.03, magnification=0.1)
    found = merge(seen[0], Setup(rig.description, lens, calibration))
    assert found.radiance.mean() / plain.radiance.mean() == pytest.approx(2.0 * 1.21, rel=1e-5)
    extra = math.sqrt(found.u_rel_common**2 - plain.u_rel_common**2)
    assert extra == pytest.approx(math.hypot(0.03, 2 * 0.1 * 0.1 / 1.1))
