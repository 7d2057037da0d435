"""The thresholds that decide about names: one table."""

from radiometer.reconciliation import thresholds
from radiometer.reconciliation.engine import whole_catalogue
from radiometer.reconciliation.thresholds import TABLE


def test_every_row_is_the_constant_of_its_name():
    """What the search reads is what the table says, and each row says why."""
    assert [getattr(thresholds, row.name) for row in TABLE] == [row.value for row in TABLE]
    assert all(row.reason and row.measured and row.unit for row in TABLE)


def test_prior_odds_that_are_not_even_have_a_reason():
    """An effect that is less likely beforehand says why, and one that is not says nothing."""
    odd = {
        name: kind for name, kind in whole_catalogue().items() if bool(kind.log_prior_odds) != bool(kind.prior_reason)
    }
    assert odd == {}
    assert all(kind.log_prior_odds <= 0.0 for kind in whole_catalogue().values())
