"""Options of `radiometer measure` that look behind the interval."""

from __future__ import annotations

import json

import pytest

from radiometer.cli.main import run


@pytest.mark.slow
def test_the_drawn_interval_is_next_to_the_budget_s(capsys):
    """On the simulated bench both agree: the ends lie within the tolerance that is stated."""
    assert run(["measure", "--json", "--monte-carlo"]) == 0
    printed = json.loads(capsys.readouterr().out)
    drawn, radiance = printed["monte_carlo"], printed["radiance"]
    assert drawn["validates"]
    assert abs(drawn["u"] / radiance["u"] - 1.0) < 0.02
    assert drawn["low"] < radiance["value"] < drawn["high"]
