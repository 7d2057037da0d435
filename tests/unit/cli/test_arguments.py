"""Relative quantities, times and f-numbers on the command line: what is implausible is refused with the way out."""

from __future__ import annotations

import pytest

from radiometer.cli.arguments import (
    parse_bounds,
    parse_exposure,
    parse_f_number,
    parse_known_ratios,
    parse_measured_iso,
    parse_patch,
    parse_relative,
    parse_seconds,
)
from radiometer.cli.main import run
from radiometer.errors import UsageError


@pytest.mark.parametrize(("text", "value"), [("0.05", 0.05), ("5%", 0.05), ("5 %", 0.05), ("0", 0.0), (None, None)])
def test_a_relative_quantity_is_a_fraction_or_per_cent(text, value):
    """Both forms give the same number."""
    assert parse_relative(text, "--u-rel") == pytest.approx(value)


@pytest.mark.parametrize(("text", "seconds"), [("1/125", 0.008), ("8ms", 0.008), ("125s", 125.0), ("30", 30.0)])
def test_an_exposure_time_with_its_unit_or_a_plausible_number(text, seconds):
    """Times that mean one thing alone are taken."""
    assert parse_exposure(text, "--from") == pytest.approx(seconds)
    assert parse_seconds("600", "--for") == 600.0  # a light may well be on for ten minutes


@pytest.mark.parametrize(("text", "number"), [("4", 4.0), ("f/2.8", 2.8), ("F/16", 16.0)])
def test_an_f_number_as_it_is_written(text, number):
    """The number alone, or with f/ before it."""
    assert parse_f_number(text, "--f-number") == number


@pytest.mark.parametrize(
    ("parse", "taken", "refused"),
    [
        (parse_f_number, ["0.5", "256"], ["0.49", "256.1", "0", "f/"]),
        (parse_relative, ["0", "0.999", "99.9%"], ["-1e-9", "1", "100%", "nan", "inf%"]),
        (parse_exposure, ["30", "30.1s", "1e-9"], ["30.1", "0", "-1ms", "8 kg"]),
        (parse_bounds, ["1e-9,2e-9"], ["0,1", "1,1", "2,1", "1,inf", "1"]),
        (parse_patch, ["0,0,1,1"], ["-1,0,1,1", "0,-1,1,1", "0,0,0,1", "0,0,1,0", "0,0,1"]),
        (parse_measured_iso, [["200=1e-9", "0=1"]], [["200=0"], ["-1=5"], ["1=inf"], ["inf=1"], ["2=1", "2=3"]]),
        (parse_known_ratios, [["0=1.001", "1=2"]], [["0=1"], ["0.5=2"], ["-1=2"], ["1=2", "1=3"], ["a=2"]]),
    ],
)
def test_each_bound_is_taken_and_one_step_beyond_is_misuse(parse, taken, refused):
    """What a lens, a share, a time, a range, a patch, a speed and a ratio can be."""
    option = () if parse in (parse_patch, parse_measured_iso, parse_known_ratios) else ("--option",)
    for text in taken:
        assert parse(text, *option) is not None
    for text in refused:
        with pytest.raises(UsageError):
            parse(text, *option)


@pytest.mark.parametrize(
    ("words", "way_out"),
    [
        ("measure --u-rel 5", "is 500 %; write 5%, or a fraction below 1"),
        ("measure --u-rel 120%", "must be below 100 %"),
        ("measure --u-rel -0.01", "must be 0 or more"),
        ("quality report s --source-u-rel 2", "write 2%"),
        ("screen import s.csv --meter-u-rel 4", "write 4%"),
        ("light calibrate --box sim --spectral-u-rel 3", "write 3%"),
        ("characterise c --radiance 1 --radiance-u-rel 1", "write 1%"),
        ("bracket out --from 1/1000 --to 125", "is 125 s meant, or 1/125 s? Write 125s or 1/125"),
        ("measure --f-number 0.008", "f-numbers go from 0.5 to 256; is it the exposure time?"),
        ("new-bench b.yaml --camera sim --focal-length 16 --f-number 1/125", "expected an f-number such as 4 or f/4"),
    ],
)
def test_what_is_implausible_is_misuse(words, way_out, capsys, tmp_path, monkeypatch):
    """Nothing is measured; the message names the option and says what to write."""
    monkeypatch.chdir(tmp_path)
    assert run(words.split()) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert words.split()[-2] in printed
    assert way_out in printed
    assert not list(tmp_path.iterdir())
