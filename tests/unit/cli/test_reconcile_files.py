"""`radiometer reconcile` gives its answer even where a file that was asked for next to it cannot be written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radiometer.api import results
from radiometer.cli.main import run
from radiometer.errors import OutputError
from radiometer.reconciliation.result import ReconcileResult, Verdict


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
    """What no one foresaw while a picture is drawn is reported after the verdict, too."""
    words = _words(monkeypatch, tmp_path, ValueError("nothing to draw"))
    with pytest.raises(ValueError, match="nothing to draw"):
        run([*words, "--report", str(tmp_path / "report.html")])
    assert "simulation and measurement agree" in capsys.readouterr().out


def test_a_program_gets_the_answer_without_the_file(monkeypatch, tmp_path, capsys):
    """`--json` gives the object with no report in it, the error goes to the other stream."""
    words = _words(monkeypatch, tmp_path, OutputError("report.html: no space left on the disk"))
    assert run([*words, "--json", "--report", str(tmp_path / "report.html")]) == 1
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert answer["verdict"] == "agrees"
    assert answer["gap"]["before"] == 1.25
    assert answer["report"] is None
    assert "no space left" in err
