"""Light-meter tables, photograph stacks and EMVA 1288 sets."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiometer.analysis.response.shutter_offset import Exposures
from radiometer.analysis.response.wrong_labels import WrongLabel
from radiometer.cli.main import run
from radiometer.data import Frame, FrameSettings
from radiometer.errors import CaptureError, InputError
from radiometer.importing import open_capture
from radiometer.importing.light_tables import read_meter_table
from radiometer.reconciliation import photographs
from radiometer.reconciliation.photographs import FrameFinding, outcome, reconcile_photographs, report_html
from radiometer.reconciliation.result import Limit, ReconcileResult, Verdict
from radiometer.reconciliation.tables import reconcile_meter_table
from radiometer.reporting.origin import Origin
from testing.brackets_of_a_shutter import LABELS_S, photographed

THESIS = """\
screen,luminance,f_number,time,iso
Lenovo,250,16,1/8,136
Lenovo,250,5.6,1/60,136
Lenovo,250,1.7,1/640,136
AOC,350,16,1/13,136
AOC,350,5.6,1/100,136
AOC,350,1.7,1/1000,136
"""


def _table(folder, text):
    path = folder / "meter.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_thesis_constants_scatter_by_rounding(tmp_path):
    """K at f/16 and f/5.6 agrees once exact stops are used; the printed values are those of the thesis."""
    done = reconcile_meter_table(_table(tmp_path, THESIS))
    assert [effect.name for effect in done.result.effects] == ["nominal_settings"]
    (effect,) = done.result.effects
    assert effect.gap_after < 1e-9
    assert effect.gain_nats == pytest.approx(10.0 * math.log(effect.gap_before / 1e-6))  # K is read to 1e-6 at best
    assert [round(row.k_printed, 4) for row in done.rows] == [16.6016, 18.0697, 18.3824, 14.3029, 15.1786, 16.4706]


def test_a_time_of_two_dials_is_that_of_the_dial_of_the_other_rows(tmp_path):
    """1/3 s is on dials of thirds and of halves; 1/25 s and 1/50 s show the dial of thirds: K is one number."""
    rows = "source,luminance,f_number,time,iso\na,25,8,1/3,100\na,25,4,1/13,100\na,25,2.8,1/25,100\na,50,2.8,1/50,100\n"
    (effect,) = reconcile_meter_table(_table(tmp_path, rows)).result.effects
    assert (effect.name, effect.gap_after < 1e-9) == ("nominal_settings", True)


def test_rest_at_full_aperture_is_not_guessed(tmp_path, capsys):
    """The sixth of a stop at f/1.7 is reported, with both causes that these data cannot tell apart."""
    assert run(["reconcile", str(_table(tmp_path, THESIS)), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["rest"]["stops"] == pytest.approx(1 / 6, abs=1e-6)
    assert "fnumber_tstop_error" in printed["rest"]["alternatives"]
    assert "cannot be separated from light lost at full aperture" in " ".join(printed["remarks"])


def test_times_on_no_dial_are_as_written(tmp_path):
    """A time of 8 % more, 85.769 ms, is no printed stop: no row is rounded to a stop, and K is that of the rows."""
    times = (0.010006, 0.019969, 0.039950, 0.085769)
    rows = "".join(f"A,100,{n},{t},100\n" for n, t in zip((2.8, 4, 5.6, 8), times, strict=True))
    done = reconcile_meter_table(_table(tmp_path, "source,luminance,f_number,time,iso\n" + rows))
    assert done.result.verdict is Verdict.UNNAMED
    assert [row.k_exact * 2 ** round(2 * np.log2(row.f_number)) / 1e4 for row in done.rows] == pytest.approx(times)
    assert "times are as written" in done.result.assumptions[0]


@pytest.mark.parametrize(("rise", "verdict", "names"), [(1.0, Verdict.AGREES, []), (1.2, Verdict.UNNAMED, ["unnamed"])])
def test_constant_meter_agrees_and_drift_that_is_no_rounding_gets_no_name(tmp_path, rise, verdict, names):
    """Exact stops of one constant: nothing is missing. K that changes by a fifth from row to row is `unnamed`."""
    rows = "".join(f"A,{100 * rise**i},{n},{t},100\n" for i, (n, t) in enumerate(((4, 0.0625), (8, 0.25), (16, 1))))
    done = reconcile_meter_table(_table(tmp_path, "source,luminance,f_number,time,iso\n" + rows))
    assert done.result.verdict is verdict
    assert [effect.name for effect in done.result.effects] == names


@pytest.mark.parametrize("stop", [2.8, 8])
def test_stop_that_differs_from_its_dial_is_named_with_its_size(tmp_path, stop):
    """Three screens at three stops: the one that lets through an eighth less is told, the others are not."""
    rows = "".join(
        f"{name},{100 * 4**i / (1 - 0.125 * (n == stop))},{n},{t / 4**i},100\n"
        for i, name in enumerate("abc")
        for n, t in ((2.8, 2**-5), (4, 2**-4), (8, 2**-2))
    )
    result = reconcile_meter_table(_table(tmp_path, "source,luminance,f_number,time,iso\n" + rows)).result
    (effect,) = result.effects
    assert (effect.name, effect.alternatives) == ("fnumber_tstop_error", ("meter_resolution",))
    assert {name: error.value for name, error in effect.parameters.items()} == {
        f"errors_rel at f/{stop}": pytest.approx(-0.125, abs=1e-6)
    }


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "luminance,f_number,time,iso\n1,2,x,4\n5,6,7,8\n"])
def test_unusable_table_is_refused(tmp_path, text):
    """An empty file, missing columns, or a value that is no number."""
    with pytest.raises(InputError):
        read_meter_table(_table(tmp_path, text))


def _photographs(printed, real):
    rng = np.random.default_rng(4)
    scene = 10 ** cv2.resize(rng.uniform(-1.5, 1.2, (6, 9)), (144, 96), interpolation=cv2.INTER_CUBIC)
    frames = []
    for label, seconds in zip(printed, real, strict=True):
        exposure = rng.poisson(np.minimum(0.2 * scene * seconds / real[len(real) // 2], 4) * 20_000) / 20_000
        tone = (exposure / (1 + 0.3 * exposure) * 1.3) ** (1 / 2.2)
        dn = np.clip(np.rint(255 * tone), 0, 255).astype(np.uint8)
        frames.append(Frame(dn, 8, FrameSettings(label)))
    return frames


EXACT = [2.0**-k for k in range(4, 13)]
PRINTED = [1 / d for d in (15, 30, 60, 125, 250, 500, 1000, 2000, 4000)]


@pytest.mark.slow
def test_rounded_stops_of_photographs_are_named():
    """Printed 1/60 s exposed for 1/64 s and so on, through an unknown tone curve."""
    done = reconcile_photographs(_photographs(PRINTED, EXACT))
    assert [effect.name for effect in done.result.effects] == ["nominal_settings"]


@pytest.mark.slow
def test_truthful_labels_agree():
    """Exposures that are what they say: nothing is missing, and a wrong one would be named from some tenths on."""
    done = reconcile_photographs(_photographs(EXACT, EXACT))
    result = done.result
    assert result.verdict is Verdict.AGREES
    assert (list(done.exposures_s.values()), set(done.u_rel.values())) == (sorted(EXACT), {0.0})
    assert {one.expected for one in done.findings} == {1.0}
    limit = result.limits["exposure_label_error"].amplitude
    assert math.expm1(0.08) < limit < 0.5


@pytest.mark.slow
def test_light_that_fell_on_one_photograph_is_no_wrong_label():
    """A corner glows in the shortest exposures but one; the rest of the picture is in order, and so is the label."""
    frames = _photographs(EXACT, EXACT)
    dn = frames[7].dn.copy()
    dn[60:, :70] = np.maximum(dn[60:, :70], 90)
    done = reconcile_photographs([*frames[:7], Frame(dn, 8, FrameSettings(EXACT[7])), frames[8]])
    assert done.result.verdict is Verdict.AGREES


@pytest.mark.slow
def test_a_photograph_of_another_scene_is_no_agreement():
    """One of five photographs upside down: no tone curve joins them, so that nothing can be stated of their labels."""
    frames = _photographs(EXACT[3:8], EXACT[3:8])
    frames[2] = replace(frames[2], dn=np.ascontiguousarray(frames[2].dn[::-1, ::-1]), extra={"file": "turned.jpg"})
    done = reconcile_photographs(frames)
    assert done.result.verdict is Verdict.UNNAMED
    assert not done.result.effects
    (text,) = done.result.extra["remarks"]
    assert "follow no single tone curve" in text
    assert "turned.jpg by far worst" in text


@pytest.mark.slow
def test_three_photographs_do_not_agree_with_a_wrong_label_and_cannot_say_which():
    """Right, three labels agree; one 1.5 times too long is no agreement. Of a wrong label three say nothing by name."""
    right = reconcile_photographs(_photographs(EXACT[3:8:2], EXACT[3:8:2])).result
    assert right.verdict is Verdict.AGREES
    assert right.limits["exposure_label_error"].amplitude is None
    assert right.extra["remarks"][0].endswith("; with so few, the tone curve may hide a wrong one.")
    four = reconcile_photographs(_photographs(EXACT[3:7], EXACT[3:7])).result
    assert four.extra["remarks"][0].endswith("DN on average.")
    wrong = reconcile_photographs(_photographs([EXACT[3], 1.5 * EXACT[5], EXACT[7]], EXACT[3:8:2])).result
    assert wrong.verdict is Verdict.UNNAMED
    assert not wrong.effects
    assert "so few photographs cannot show which" in wrong.extra["remarks"][0]


def test_a_picture_with_all_its_light_in_one_quadrant_is_refused_in_words():
    """Quadrants cannot be left out where three hold nothing: stated so, not "predicted to nan DN"."""
    frames = _photographs(EXACT[3:7], EXACT[3:7])
    corner = [np.pad(frame.dn[:40, :60], ((0, 60), (0, 90))) for frame in frames]
    with pytest.raises(CaptureError, match="is in one quadrant"):
        reconcile_photographs([replace(frame, dn=dn) for frame, dn in zip(frames, corner, strict=True)])


@pytest.mark.slow
def test_one_of_four_labels_may_lie():
    """Of four photographs the last was exposed 1.6 times as long, not twice: only its label is called wrong."""
    real = [EXACT[6], EXACT[5], EXACT[4], EXACT[4] * 1.6]
    done = reconcile_photographs(_photographs([*real[:3], EXACT[3]], real))
    (effect,) = done.result.effects
    assert effect.name == "exposure_label_error"
    assert effect.parameters["ratio"].value == pytest.approx(0.8, abs=0.03)


@pytest.mark.slow
def test_report_of_photographs_reports_the_story(tmp_path):
    """One sentence with the factor and its U, both plots, what to do, and the others' exposures with their labels."""
    real = [EXACT[6], EXACT[5], EXACT[4], EXACT[4] * 1.6, EXACT[3] * 2.0]
    done = reconcile_photographs(_photographs([*real[:3], EXACT[3], real[4]], real))
    page = Path(done.write_report(tmp_path / "report.html")).read_text(encoding="utf-8")
    found = re.search(r"<p class='outcome'>(.+?) had ([\d.]+)\u00a0±\u00a0([\d.]+) of its printed exposure", page)
    (wrong,) = [one for one in done.findings if one.wrong]
    assert found[1] == wrong.name
    assert float(found[2]) == pytest.approx(0.8, abs=0.03)
    assert float(found[3]) == pytest.approx(2.0 * wrong.u_ratio, rel=0.06)
    assert page.count("<picture>") == 2
    assert "class='do'" in page
    assert "<script" not in page
    for one in done.findings:
        assert one.ratio == pytest.approx(0.8 if one.wrong else 1.0, abs=max(0.02, 4.0 * one.u_ratio))
        assert 0.0 < one.u_ratio < 0.05
    assert wrong.taken_s == pytest.approx(EXACT[4] * 1.6, rel=0.03)
    assert wrong.error_as_printed_dn > 5.0 * wrong.error_dn


def _named(monkeypatch, *rivals):
    """Return a stack whose third label is found 0.8 ± 0.016 of the truth, with rivals."""
    label = WrongLabel(2, 0.8, 0.016, 0.5, rivals)
    monkeypatch.setattr(photographs, "find_exposures", lambda _planes: Exposures(None, (label,)))
    return reconcile_photographs(_photographs([EXACT[3], EXACT[2], EXACT[1] / 0.8, EXACT[0]], EXACT[3::-1]))


def test_a_label_has_one_size_wherever_it_is_reported(monkeypatch):
    """What all colours found, 0.8 ± 0.016, is in entry, sentence, finding and exposure; its nats are of that width."""
    done = _named(monkeypatch)
    (effect,) = done.result.effects
    ratio = effect.parameters["ratio"]
    assert (ratio.value, ratio.u) == (pytest.approx(0.8), pytest.approx(0.016))
    assert effect.gain_nats == pytest.approx(0.5 * (math.log(0.8) / 0.02) ** 2)
    assert effect.alternatives == ()
    assert "of its printed exposure (k = 2); the others agree. Left-out" in done.result.extra["remarks"][0]
    (wrong,) = [one for one in done.findings if one.wrong]
    assert (wrong.ratio, wrong.u_ratio) == (pytest.approx(0.8), pytest.approx(0.016))
    assert wrong.taken_s == pytest.approx(EXACT[1])
    assert outcome(done.result, done.findings).endswith("of its printed exposure (k = 2); the others agree.")


def test_report_explains_a_wrong_label_and_what_would_have_been_detected():
    """A section per wrong label, a picture of the predictions' errors, and the folded table of detectable effects."""
    dn = np.arange(256.0)
    right = FrameFinding("a.jpg", 0.1, 0.1, 1.0, 0.01, 1.2, False, 0.4, 0.5, 1.0, dn, (0.5 + 0.0 * dn, 0.4 + 0.0 * dn))
    wrong = replace(
        right, name="b.jpg", stated_s=0.05, taken_s=0.04, ratio=0.8, u_ratio=0.016, wrong=True, error_as_printed_dn=9.6
    )
    limits = {"exposure_label_error": Limit(0.34, "ratio", "1"), "gamma_enabled": Limit(None, "gamma", "1")}
    result = ReconcileResult(Verdict.EFFECTS_FOUND, (), 4.0, 1.0, limits=limits, captures=2, frames=2)
    page = report_html(result, (right, wrong), "", "photographs", Origin())
    expected = (
        "<h2>Label of b.jpg</h2>",
        "Printed 1/20\u00a0s, exposed for 0.0400\u00a0±\u00a00.0016\u00a0s (k\u00a0=\u00a02), 0.32 stops less.",
        "predicted by the others to 0.4 DN on average, 9.6 DN as printed.",
        "<h2>Each photograph against its prediction</h2>",
        "What these photographs would have detected",
        "× or ÷ 1.34",
        "cannot be detected",
    )
    assert [part for part in expected if part not in page] == []
    assert page.count("<picture>") == 2


def test_labels_that_may_be_meant_instead_are_reported(monkeypatch):
    """Where other labels predict left-out parts nearly as well, entry, sentence and report name them next to it."""
    done = _named(monkeypatch, (0, 0.9), (3, 1.1))
    (effect,) = done.result.effects
    names = [one.name for one in done.findings]
    reported = (
        f"exposure_label_error of {names[0]} (ratio 0.900)",
        f"exposure_label_error of {names[3]} (ratio 1.100)",
    )
    assert effect.alternatives == reported
    assert f"cannot decide, {' or '.join(reported)} instead. Left-out" in done.result.extra["remarks"][0]
    assert outcome(done.result, done.findings).endswith(f"cannot decide, {' or '.join(reported)} instead.")


def test_emva_descriptor_becomes_a_capture_set(shared_data):
    """Bright and dark pairs of the real set: times in s, levels in shares of the brightest flux, size of the frames."""
    capture = open_capture(shared_data / "emva" / "ref001_ccd_12bit")
    assert capture.header.frames[0].exposure_s == pytest.approx(40e-6)
    assert {entry.shutter for entry in capture.header.frames} == {"open", "closed"}
    assert capture.read_frame(0).dn.shape == (480, 640)


def test_pictures_that_are_all_alike_are_refused_by_name():
    """Labels of 0.5 to 4 s on four equal pictures: none of them shows which are wrong."""
    picture = np.random.default_rng(4).uniform(60.0, 180.0, (40, 60))
    frames = [
        Frame(
            np.rint(picture + np.random.default_rng(k).normal(0.0, 1.0, picture.shape)).astype(np.uint8),
            8,
            FrameSettings(0.5 * 2.0**k),
            extra={"file": f"{k}.jpg"},
        )
        for k in range(4)
    ]
    with pytest.raises(CaptureError, match=r"equally bright.*0\.jpg \(0\.5 s\) and 1\.jpg \(1 s\)"):
        reconcile_photographs(frames)


# Photographs whose shutter exposes longer by one time; labels are held against both.


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
    assert first.error_as_printed_dn > 3.0 * first.error_dn


@pytest.mark.slow
def test_the_report_says_it_and_what_to_do(done, tmp_path):
    """With the line that photographs lie about, and how the exposures come to other commands."""
    page = (tmp_path / "report.html", done.write_report(tmp_path / "report.html"))[0].read_text()
    assert "(the shutter&#x27;s offset)" in page or "(the shutter's offset)" in page
    assert "all are about what label and shutter" in page
    assert "-o exposures.txt writes the exposures that agree" in page
