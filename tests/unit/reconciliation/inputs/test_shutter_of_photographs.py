"""Photographs whose shutter exposes longer by one time: told, written and drawn; labels are held against both."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from radiometer.analysis.response.shutter_offset import Exposures, ShutterOffset
from radiometer.analysis.response.wrong_labels import WrongLabel
from radiometer.reconciliation.inputs import photographs
from radiometer.reconciliation.inputs.photograph_report import FrameFinding, _draw_ratios, outcome
from radiometer.reconciliation.inputs.photographs import PhotographsReconciled, reconcile_photographs
from radiometer.reconciliation.result import Verdict
from testing.brackets_of_a_shutter import LABELS_S, photographed

OFFSET_S = 25e-6


@pytest.fixture(scope="module")
def done() -> PhotographsReconciled:
    return reconcile_photographs(list(photographed(OFFSET_S)))


@pytest.mark.slow
def test_the_offset_is_an_effect_with_its_u(done: PhotographsReconciled) -> None:
    """Named as in the catalogue, in s, with sentences for people that say how much."""
    assert done.result.verdict is Verdict.EFFECTS_FOUND
    (effect,) = done.result.effects
    assert (effect.name, effect.where) == ("exposure_time_offset", "exposure_s")
    found = effect.parameters["offset_s"]
    assert found.unit == "s"
    assert found.u is not None
    assert found.value == pytest.approx(OFFSET_S, abs=1e-6)
    assert effect.gain_nats == pytest.approx(0.5 * (found.value / found.u) ** 2)
    assert effect.gap_before > 1.2
    told = f"{1e6 * found.value:.1f} ± {1e6 * found.u:.1f} µs longer than printed (the shutter's offset, k = 1)"
    assert f"all exposures are {told}. Left-out parts" in done.result.extra["remarks"][0]
    said = outcome(done.result, done.findings)
    assert said.startswith("All exposures are 2")
    assert said.endswith("µs (k = 2) longer than printed (the shutter's offset); with that all agree.")


@pytest.mark.slow
def test_exposures_are_label_and_offset(done: PhotographsReconciled) -> None:
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
def test_the_report_says_it_and_what_to_do(done: PhotographsReconciled, tmp_path: Any) -> None:
    """With the line that photographs lie about, and how the exposures come to other commands."""
    page = (tmp_path / "report.html", done.write_report(tmp_path / "report.html"))[0].read_text()
    assert "(the shutter&#x27;s offset)" in page or "(the shutter's offset)" in page
    assert "all are about what label and shutter" in page
    assert "-o exposures.txt writes the exposures that agree" in page


@pytest.mark.slow
def test_exposures_as_labelled_have_none() -> None:
    """They agree, exactly as printed."""
    found = reconcile_photographs(list(photographed(0.0)))
    assert found.result.verdict is Verdict.AGREES
    assert list(found.exposures_s.values()) == list(LABELS_S)
    assert set(found.u_rel.values()) == {0.0}
    assert {one.expected for one in found.findings} == {1.0}


def _judged(offset: ShutterOffset | None) -> photographs._Judged:
    """Return what came of three photographs of which the second has a wrong label."""
    seconds = 0.0 if offset is None else offset.seconds
    label = WrongLabel(1, 0.5, 0.01, 0.9, ((2, 1.5),))
    samples = SimpleNamespace(exposures_s=np.array([1e-4, 2e-4, 4e-4]) + seconds)
    told = [(0.0, 0.01), (0.0, 0.02), (0.0, math.inf)]
    return photographs._Judged(
        samples,  # type: ignore[arg-type]
        None,  # type: ignore[arg-type]
        np.log(samples.exposures_s),
        False,
        Exposures(offset, (label,)),
        (1.0, 1.0, 1.0),
        told,
    )


def test_labels_are_named_beside_the_offset_from_what_it_may_still_be() -> None:
    """Where it was taken three of its u are allowed of exposure and offset together, else 30 us of the label."""
    assert photographs._limits(_judged(None)) == pytest.approx([0.08 + 0.3 + 0.05, 0.08 + 0.15 + 0.1, math.inf])
    known = photographs._limits(_judged(ShutterOffset(2e-5, 1e-6, 0.5)))
    assert known == pytest.approx([0.08 + 3e-6 / 1.2e-4 + 0.05, 0.08 + 3e-6 / 2.2e-4 + 0.1, math.inf])


def test_every_exposure_has_the_u_of_the_offset_but_those_that_were_freed() -> None:
    """Relative to the exposure with the offset; 0 where none was taken and the label is believed."""
    assert _judged(None).u_rel == [0.0, pytest.approx(0.02), 0.0]
    known = _judged(ShutterOffset(2e-5, 1.2e-6, 0.5)).u_rel
    assert known == [pytest.approx(0.01), pytest.approx(0.02), pytest.approx(1.2e-6 / 4.2e-4)]


def test_rivals_are_told_of_what_is_printed() -> None:
    """Beside the offset, which makes 1.05 of the third label."""
    judged = _judged(ShutterOffset(2e-5, 1e-6, 0.5))
    names = ("a", "b", "c")
    assert judged.expected == pytest.approx([1.2, 1.1, 1.05])
    assert photographs._rivals(judged.labels[0], judged, names) == ("exposure_label_error of c (ratio 1.575)",)
    assert photographs._rivals(_judged(None).labels[0], _judged(None), names)[0].endswith("(ratio 1.500)")


def test_the_band_of_right_labels_lies_about_label_and_offset() -> None:
    """Within a ninth of a stop of what they make together, frame by frame."""
    nothing = np.empty(0)
    frames = [FrameFinding("a", 1e-4, 1.2e-4, 1.2, 0.01, 1.1, False, nothing, nothing, nothing, 1.2)]
    frames += [FrameFinding("b", 2e-4, 2.2e-4, 1.1, 0.01, 1.1, False, nothing, nothing, nothing, 1.1)]
    figure = Figure()
    _draw_ratios(figure, False, frames)
    (axes,) = figure.axes
    (line,) = [one for one in axes.lines if len(one.get_xdata()) == 4]  # type: ignore[arg-type]
    assert list(line.get_xdata()) == [-0.5, 0.5, 0.5, 1.5]  # type: ignore[call-overload]
    assert list(line.get_ydata()) == pytest.approx([1.2, 1.2, 1.1, 1.1])  # type: ignore[call-overload]
    band = axes.collections[-1].get_paths()[0].vertices
    assert float(np.min(band[:, 1])) == pytest.approx(1.1 * math.exp(-0.08))  # type: ignore[index]
    assert float(np.max(band[:, 1])) == pytest.approx(1.2 * math.exp(0.08))  # type: ignore[index]
