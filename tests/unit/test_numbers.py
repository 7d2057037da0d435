"""Numbers as every face writes them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.numbers import below, lower_limit, rounded, unit_text, upper_limit, with_u

LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


@pytest.mark.parametrize(
    ("value", "expanded", "shown"),
    [
        (0.281652, 0.00246, ("0.2817", "0.0025")),
        (13945.2, 48.0, ("13945", "48")),
        (9870.3, 1207.0, ("9900", "1200")),
        (-0.61536, 0.0131, ("-0.615", "0.013")),
        (3.2166e-9, 4.4e-11, ("3.217e-09", "0.044e-09")),
        (103.44, 0.997, ("103.4", "1.0")),
        (-0.00001, 0.0028, ("0.0000", "0.0028")),
        (5.123456, float("nan"), ("5.1235", "–")),
        (5.123456, 0.0, ("5.1235", "–")),
    ],
)
def test_rounding_gives_two_digits_of_the_expanded_uncertainty(value, expanded, shown):
    """Value and U end at the same digit; a U that says nothing is a dash."""
    assert rounded(value, expanded) == shown


def test_a_value_stands_with_its_uncertainty_and_unit():
    """Per cent stand behind brackets; without an uncertainty there is no ±."""
    assert with_u(0.281652, 0.00246, "DN/e⁻") == "0.2817 ± 0.0025 DN/e⁻"
    assert with_u(-0.61536, 0.0131, "% per month") == "(-0.615 ± 0.013) % per month"
    assert with_u(2.5, float("inf"), "e⁻") == "2.5 e⁻"
    assert with_u(-7.7949e-6, 5.31e-8, "s") == "(-7.795 ± 0.053)·10⁻⁶ s"
    assert with_u(103.4, 1.0, "cd m-2", k=2) == "103.4 ± 1.0 cd·m⁻² (k = 2)"
    assert with_u(4099.0, 782.0, "e-") == "(4.10 ± 0.78)·10³ e⁻"
    assert with_u(12345.0, 148.0) == "(1.234 ± 0.015)·10⁴"
    assert with_u(-3.0, 10_000.0, "ppm") == "(0.0 ± 1.0)·10⁴ ppm"
    assert with_u(0.0, 1.7e-4, "cd m-2", k=2.03) == "0.00000 ± 0.00017 cd·m⁻² (k = 2.03)"


@given(st.floats(1e-9, 1e9), st.floats(1e-6, 10.0))
def test_what_is_printed_has_two_digits_of_u_and_lies_within_half_of_the_last(value: float, u_rel: float) -> None:
    """Read back, value and U are those given to half of the last digit shown, a 5 % of U at most."""
    shown = with_u(value, u_rel * value)
    power = 10.0 ** int(shown.split("·10")[1].translate(LOWERED)) if "·10" in shown else 1.0
    number, _, u = shown.split("·10")[0].strip("()").partition(" ± ")
    assert len(u.replace(".", "").lstrip("0")) == 2
    assert float(u) * power == pytest.approx(u_rel * value, rel=0.051)
    assert abs(float(number) * power - value) <= 0.051 * u_rel * value


def test_limits_are_never_negative() -> None:
    """What is at least 3 ± 1 (k = 1) is above 1.355 with 95 %; what is at least 1 ± 1 is above 0.

    A reading of −3 ± 1 gives the same limit as one of 0 ± 1: below 1.645 with 95 %.
    """
    assert lower_limit(3.0, 1.0) == pytest.approx(1.355)
    assert lower_limit(1.0, 1.0) == 0.0
    assert upper_limit(-3.0, 1.0) == upper_limit(0.0, 1.0) == pytest.approx(1.645)
    assert upper_limit(2.0, 1.0) == pytest.approx(3.645)
    assert below(0.00104, "W sr-1 m-2") == "< 0.0010 W·sr⁻¹·m⁻², 95 %"
    assert below(643.0) == "< 6.4·10², 95 %"
    assert below(0.0214, "cd m-2", bare=True) == "< 0.021"


def test_values_that_share_their_uncertainty_show_their_difference() -> None:
    """Of two values with ± 160 that differ by 10 or by 0.31, the two digits of the difference; of 500, those of U."""
    assert [with_u(one, 160.0, apart=10.0) for one in (681.0, 671.0)] == ["(6.81 ± 1.60)·10²", "(6.71 ± 1.60)·10²"]
    assert [with_u(one, 1.6, apart=0.31) for one in (68.13, 67.82)] == ["68.13 ± 1.60", "67.82 ± 1.60"]
    assert with_u(681.0, 160.0, apart=500.0) == "(6.8 ± 1.6)·10²"


def test_units_are_printed_as_the_field_does():
    """Powers are raised, the unit one is nothing, the electron has its charge."""
    assert unit_text("W sr-1 m-2") == "W·sr⁻¹·m⁻²"
    assert unit_text("scotopic cd m-2") == "scotopic cd·m⁻²"
    assert (unit_text("1"), unit_text("e-/s"), unit_text("DN/e-")) == ("", "e⁻/s", "DN/e⁻")
    assert unit_text("W sr-1 m-2 um-1") == "W·sr⁻¹·m⁻²·µm⁻¹"
    for one, other in (("e- s-1", "e-/s"), ("DN s-1", "DN/s"), ("log10 min-1", "log10/min")):
        assert unit_text(one) == unit_text(other)  # a rate, whichever way the file writes it
