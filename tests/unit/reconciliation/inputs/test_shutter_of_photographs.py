"""Photographs whose shutter exposes longer by one time: reported, written and drawn; labels are held against both."""

import numpy as np
import pytest

from radiometer.reconciliation.inputs.photographs import outcome, reconcile_photographs
from radiometer.reconciliation.result import Verdict
from testing.brackets_of_a_shutter import LABELS_S, photographed

OFFSET_S = 25e-6


@pytest.fixture(scope="module")
def done():
    return reconcile_photographs(photographed(OFFSET_S).light)


@pytest.mark.slow
def test_the_offset_is_an_effect_with_its_u(done):
    """Named as in the catalogue, in s, with sentences for people that say how much."""
    assert done.result.verdict is Verdict.EFFECTS_FOUND
    (effect,) = done.result.effects
    assert (effect.name, effect.where) == ("exposure_time_offset", "exposure_s")
    found = effect.parameters["offset_s"]
    assert found.unit == "s"
    assert found.value == pytest.approx(OFFSET_S, abs=1e-6)
    assert effect.gain_nats == pytest.approx(0.5 * (found.value / found.u) ** 2)
    assert effect.gap_before > 1.2
    text = outcome(done.result, done.findings)
    assert done.result.extra["remarks"][0].startswith(f"{text} Left-out parts")
    assert text.startswith("All exposures are 2")
    assert text.endswith("µs (k = 2) longer than printed (the shutter's offset); with that offset all agree.")


@pytest.mark.slow
def test_exposures_are_label_and_offset(done):
    """As they are written, and by how much they are known; every photograph agrees with that."""
    (effect,) = done.result.effects
    found = effect.parameters["offset_s"]
    assert list(done.exposures_s.values()) == pytest.approx(LABELS_S + found.value)
    assert list(done.u_rel.values()) == pytest.approx((found.u or 0.0) / (LABELS_S + found.value))
    for one, label in zip(done.findings, LABELS_S, strict=True):
        assert one.stated_s == label
        assert one.taken_s == pytest.approx(label + found.value)
        assert one.expected == pytest.approx(1.0 + found.value / label)
        assert one.ratio == pytest.approx(1.0 + OFFSET_S / label, rel=0.01 + 4.0 * one.u_ratio)
        assert not one.wrong
    first = done.findings[0]
    before, after = (float(np.nanmean(np.abs(e))) for e in (first.error_as_printed_dn, first.error_dn))
    assert before > 3.0 * after


@pytest.mark.slow
def test_the_report_says_it_and_what_to_do(done, tmp_path):
    """With the line that photographs lie about, and how the exposures come to other commands."""
    page = (tmp_path / "report.html", done.write_report(tmp_path / "report.html"))[0].read_text()
    assert "(the shutter&#x27;s offset)" in page or "(the shutter's offset)" in page
    assert "all are about what label and shutter" in page
    assert "-o exposures.txt writes the exposures that agree" in page


@pytest.mark.slow
def test_exposures_as_labelled_have_none():
    """They agree, exactly as printed."""
    found = reconcile_photographs(photographed(0.0).light)
    assert found.result.verdict is Verdict.AGREES
    assert list(found.exposures_s.values()) == list(LABELS_S)
    assert set(found.u_rel.values()) == {0.0}
    assert {one.expected for one in found.findings} == {1.0}
