"""The thresholds that decide about names: one table, which the decision record repeats."""

from __future__ import annotations

from pathlib import Path

from radiometer.reconciliation import thresholds
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.thresholds import TABLE

RECORD = Path(__file__).resolve().parents[3] / "docs" / "decisions" / "0011-how-reconcile-decides.md"


def test_decision_record_tells_every_threshold_as_it_is() -> None:
    """Each row stands there with its value, what it protects from and what measured it; none that is not in use."""
    lines = [line for line in RECORD.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    told = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    values = [f"{row.value:g} {'' if row.unit == '1' else row.unit}".strip() for row in TABLE]
    expected = zip(TABLE, values, strict=True)
    assert told == [[f"`{row.name}`", value, row.reason, row.measured] for row, value in expected]


def test_every_row_is_the_constant_of_its_name() -> None:
    """What the search reads is what the table says, and each row says why."""
    assert [getattr(thresholds, row.name) for row in TABLE] == [row.value for row in TABLE]
    assert all(row.reason and row.measured and row.unit for row in TABLE)


def test_prior_odds_that_are_not_even_have_a_reason() -> None:
    """An effect that is less likely beforehand says why, and one that is not says nothing."""
    odd = {
        name: kind for name, kind in whole_catalogue().items() if bool(kind.log_prior_odds) != bool(kind.prior_reason)
    }
    assert odd == {}
    assert all(kind.log_prior_odds <= 0.0 for kind in whole_catalogue().values())
