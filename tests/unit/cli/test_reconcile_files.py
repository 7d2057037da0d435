"""Files of reconcile, and a response that says nothing."""

import json
from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.response.estimate import ResponseEstimate, telling
from radiometer.api import results
from radiometer.cli.main import run
from radiometer.data import ResponseCurve
from radiometer.errors import MeasurementError, OutputError
from radiometer.reconciliation.result import ReconcileResult, Verdict
from testing.photograph_folder import eight_bits, write_photographs


class _Answered:
    """An answer of which any file is refused."""

    result = ReconcileResult(Verdict.AGREES, (), gap_before=1.25, gap_after=1.25)

    def __init__(self, refusal: Exception) -> None:
        self._refusal = refusal

    def _refuse(self, path: Path, **_: object) -> str:
        raise self._refusal

    write_model = write_report = write_plan = _refuse


def _words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusal: Exception) -> list[str]:
    """Return the command for a source of which the answer is known and no file can be written."""
    monkeypatch.setattr(results, "reconcile_source", lambda *_, **__: _Answered(refusal))
    return ["reconcile", str(tmp_path / "session")]


@pytest.mark.parametrize("option", ["--report", "-o", "--plan"])
def test_an_unwritable_file_costs_no_answer(option, monkeypatch, tmp_path, capsys):
    """The verdict is printed, then one line shows what was not written; exit code 1, and nothing "wrote"."""
    words = _words(monkeypatch, tmp_path, OutputError("file: no space left on the disk"))
    assert run([*words, option, str(tmp_path / "file")]) == 1
    out, err = capsys.readouterr()
    assert "simulation and measurement agree" in out
    assert "file: no space left on the disk" in err
    assert "wrote" not in out + err
    assert "no further capture" not in out + err


def test_a_defect_of_the_report_costs_no_answer(monkeypatch, tmp_path, capsys):
    """What no one foresaw while a picture is drawn is reported after the verdict, too.

    `--json` gives the object with no report in it, the error goes to the other stream.
    """
    words = _words(monkeypatch, tmp_path, ValueError("nothing to draw"))
    with pytest.raises(ValueError, match="nothing to draw"):
        run([*words, "--report", str(tmp_path / "report.html")])
    assert "simulation and measurement agree" in capsys.readouterr().out
    words = _words(monkeypatch, tmp_path, OutputError("report.html: no space left on the disk"))
    assert run([*words, "--json", "--report", str(tmp_path / "report.html")]) == 1
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert (answer["verdict"], answer["gap"]["before"], answer["report"]) == ("agrees", 1.25, None)
    assert "no space left" in err


@pytest.mark.parametrize("method", ["auto", "mitsunaga1999"])
def test_frames_that_all_look_alike_give_no_curve(tmp_path, capsys, method):
    """The same ramp at four times a stop apart: refused in one line, exit code 1, and nothing is written."""
    rng = np.random.default_rng(1)
    ramp = np.linspace(10.0, 240.0, 96)[None, :].repeat(72, axis=0)

    pictures = (eight_bits(ramp + rng.normal(0.0, 0.5, ramp.shape)) for _ in range(4))
    folder = write_photographs(tmp_path / "alike", pictures, (0.01, 0.02, 0.04, 0.08))
    assert run(["response", str(folder), "--method", method, "-o", str(tmp_path / "curve.yaml")]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert "Traceback" not in printed
    assert not (tmp_path / "curve.yaml").exists()


def estimate(stops, u):
    """Return an estimate whose curve spans so many stops, ln H known to u."""
    curve = ResponseCurve(np.linspace(0.0, stops * np.log(2.0), 256), np.full(256, u), valid_dn=(0, 255))
    return ResponseEstimate(curve, "auto", 1, 1, 1, 0.0, 0.0, None, np.ones(1), np.zeros(1), "a gauge")


@pytest.mark.parametrize(("stops", "u", "refused"), [(0.05, 0.01, True), (5.0, 1.2, True), (5.0, 0.9, False)])
def test_no_range_or_no_factor_of_e_is_refused(stops, u, refused):
    """A twentieth of a stop is no curve; neither is one known to a factor of 3; the message says both figures."""
    if not refused:
        assert telling(estimate(stops, u), "photos").curve.log_exposure[-1] > 0.0
        return
    with pytest.raises(
        MeasurementError, match=rf"photos: no response .* {stops:.3g} stops of exposure, ln H known to {u:.2g}"
    ):
        telling(estimate(stops, u), "photos")


@pytest.mark.slow
def test_no_map_is_made_with_a_curve_that_says_nothing(tmp_path, capsys):
    """Plain walls that grow by 1.5 DN a stop: `merge` refuses as `response` does, and writes neither curve nor map."""
    rng = np.random.default_rng(0)

    pictures = (eight_bits(rng.normal(100.0 + 1.5 * k, 1.0, (60, 80))) for k in range(4))
    folder = write_photographs(tmp_path / "walls", pictures, (1, 2, 4, 8))
    assert run(["response", str(folder)]) == 1
    by_itself = capsys.readouterr().err.splitlines()[-1]
    assert run(["merge", str(folder), "-o", str(tmp_path / "map.exr")]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == by_itself
    assert "no response follows from these frames" in by_itself
    assert run(["measure", "--photographs", str(folder), "--uncalibrated", "--patch", "4,4,9,9"]) == 1
    assert not list(tmp_path.glob("map*"))
