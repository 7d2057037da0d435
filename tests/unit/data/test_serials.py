from __future__ import annotations

import pytest

from radiometer.data.serials import other_notation, same_serial, serial_shown


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("0138C343", "20497219", True),
        ("20497219", "0138c343", True),
        ("0138C343", "0138c343", True),
        ("22500001", "22500001", True),
        ("0138C343", "20497220", False),
        ("138C343", "20497219", False),
        ("GV77", "GV78", False),
    ],
)
def test_both_notations_mean_one_number(one, other, same):
    """0138C343 is 20497219 in hexadecimal; seven digits are no USB serial number."""
    assert same_serial(one, other) is same


@pytest.mark.parametrize(
    ("serial", "other"), [("0138C343", "20497219"), ("22500001", ""), ("01575361", "22500193"), ("GV77", "")]
)
def test_a_plainly_hexadecimal_number_is_shown_in_decimal_too(serial, other):
    """Zeros in front or letters show that it is hexadecimal; a decimal number stands alone."""
    assert other_notation(serial) == other
    assert serial_shown(serial) == (f"{serial} ({other})" if other else serial)
