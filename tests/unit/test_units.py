"""Units: exact stops behind printed settings, gains, photon energy."""

import math

import pytest

from radiometer.units import exact_exposure_s, exact_exposures_s, exact_f_number, gain_factor, photon_energy_j


@pytest.mark.parametrize(
    ("printed", "exact"),
    [(16, 16), (5.6, 2**2.5), (1.7, 2**0.75), (1.4, math.sqrt(2)), (3.5, 2 ** (11 / 6)), (1.2, 2**0.25), (8, 8)],
)
def test_a_printed_f_number_stands_for_a_third_or_half_of_a_stop(printed, exact):
    """f/1.7 is the half stop 2^(3/4), f/3.5 the third 2^(11/6)."""
    assert exact_f_number(printed) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("nonsense", [0.0, -1.0, math.inf, math.nan])
def test_no_stop_lies_behind_nonsense(nonsense):
    """Zero, negative and not finite settings are refused."""
    with pytest.raises(ValueError, match="positive finite"):
        exact_exposure_s(nonsense)


def test_twenty_decibels_are_a_factor_of_ten_and_a_green_photon_carries_its_energy():
    """Gain in dB counts amplitudes; 550 nm: h·c/λ = 3.6117e-19 J."""
    assert gain_factor(20.0) == pytest.approx(10.0)
    assert gain_factor(0.0) == 1.0
    assert photon_energy_j(550.0) == pytest.approx(3.611719e-19, rel=1e-6)


@pytest.mark.parametrize(
    ("printed", "stops"),
    [(1 / 90, -6.5), (1 / 45, -5.5), (1 / 180, -7.5), (1 / 350, -8.5), (1 / 750, -9.5), (0.7, -0.5), (1.5, 0.5),
     (3.0, 1.5), (1 / 60, -6.0), (1 / 80, -19 / 3), (1 / 100, -20 / 3), (1 / 13, -11 / 3), (1 / 640, -28 / 3),
     (0.3, -5 / 3), (1 / 6, -8 / 3), (1 / 8, -3.0), (1 / 125, -7.0), (1 / 1000, -10.0), (1 / 8000, -13.0), (13, 11 / 3),
     (30, 5.0)],
)  # fmt: skip
def test_printed_times_are_the_exact_stops_behind_them(printed, stops):
    """Thirds and halves of a stop; 1/90 s is 2^-6.5 s and no third."""
    assert exact_exposure_s(printed) == pytest.approx(2.0**stops, rel=1e-12)


@pytest.mark.parametrize(
    ("printed", "stops"),
    [
        ((1 / 4, 1 / 3, 0.4, 1 / 6), (-2, -5 / 3, -4 / 3, -8 / 3)),
        ((3.0, 1 / 80), (5 / 3, -19 / 3)),
        ((1 / 4, 1 / 3, 1 / 6, 1 / 90), (-2, -1.5, -2.5, -6.5)),
        ((1 / 4, 1 / 3, 1 / 2), (-2, -1.5, -1)),
        ((1 / 3, 1 / 80, 1 / 90), (-1.5, -19 / 3, -6.5)),
    ],
)
def test_the_other_times_of_a_camera_show_its_dial(printed, stops):
    """1/3 s is 2^(-5/3) s on a dial in thirds, 2^-1.5 s on one in halves, which is taken where no time shows either."""
    assert exact_exposures_s(printed) == pytest.approx([2.0**one for one in stops], rel=1e-12)
