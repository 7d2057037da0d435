"""Printed stops and the exact ones behind them."""

from __future__ import annotations

import pytest

from radiometer.units import exact_exposure_s


@pytest.mark.parametrize(
    ("printed", "stops"),
    [(1 / 90, -6.5), (1 / 45, -5.5), (1 / 180, -7.5), (1 / 350, -8.5), (1 / 750, -9.5), (0.7, -0.5), (1.5, 0.5),
     (3.0, 1.5), (1 / 60, -6.0), (1 / 80, -19 / 3), (1 / 100, -20 / 3), (1 / 13, -11 / 3), (1 / 640, -28 / 3),
     (0.3, -5 / 3), (1 / 6, -8 / 3)],
)  # fmt: skip
def test_printed_times_are_the_exact_stops_behind_them(printed, stops):
    """Thirds and halves of a stop; 1/90 s is 2^-6.5 s and no third."""
    assert exact_exposure_s(printed) == pytest.approx(2.0**stops, rel=1e-12)
