"""`radiometer adapt bleach` and `protocols`."""

from __future__ import annotations

import json

import pytest

from radiometer.adaptation.protocol import SHIPPED
from radiometer.cli.main import run


def test_bleach_calculator_gives_trolands_and_fractions(capsys: pytest.CaptureFixture[str]) -> None:
    """300 cd/m² for 120 s through 4 mm: 3770 td; rods by Rushton's kinetics at twice the trolands."""
    assert run(["adapt", "bleach", "300", "120", "--pupil", "4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["retinal_td"] == pytest.approx(3769.9, rel=1e-4)
    assert found["rods_bleached"] == pytest.approx(0.0749, abs=0.0005)
    assert 0 < found["cones_bleached"] < 0.2


def test_protocols_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """All of them, each with what it is for."""
    assert run(["adapt", "protocols"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(SHIPPED)


@pytest.mark.parametrize(
    "words",
    [
        ["nothing", "--subject", "A", "--simulate", "steady"],
        ["classic", "--subject", "A", "--simulate", "asleep"],
        ["classic", "--subject", "A", "--simulate", "steady", "--box", "LB000001"],
    ],
)
def test_misuse_is_exit_code_two(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Unknown protocol, unknown subject, and a simulated subject before a real box."""
    assert run(["adapt", "run", *words]) == 2
    assert capsys.readouterr().err.startswith("error:")
