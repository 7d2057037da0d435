"""Tables of thresholds as people have them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiometer.adaptation.threshold_files import read_table
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.cli.main import run
from radiometer.errors import InputError

MINUTES, LEVELS = [0.5, 2.0, 10.0], [1.0, -1.0, -3.0]
EXPECTED = np.column_stack([MINUTES, LEVELS])

SAME = {
    "comma": "time_min,log10_threshold\n0.5,1\n2,-1\n10,-3\n",
    "no header": "0.5,1\n2,-1\n10,-3\n",
    "header lines": "# subject: A7\n# measured on a Tuesday\ntime_min,log10_threshold\n0.5,1\n2,-1\n10,-3\n",
    "header in a comment": "# time_min,log10_threshold\n0.5,1\n2,-1\n10,-3\n",
    "semicolons, decimal commas": "Time (min);log threshold\n0,5;1,0\n2,0;-1,0\n10,0;-3,0\n",
    "tabs, seconds": "Time [s]\tlog10 threshold\n30\t1\n120\t-1\n600\t-3\n",
    "seconds by a suffix": "time_s,log_threshold\n30,1\n120,-1\n600,-3\n",
    "milliseconds": "time (ms),log threshold\n30000,1\n120000,-1\n600000,-3\n",
    "seconds without a unit": "t,thrs\n30,1\n120,-1\n600,-3\n",
    "linear by name": "time_min,threshold_cd_m2\n0.5,10\n2,0.1\n10,0.001\n",
    "linear by span": "time,threshold\n0.5,10\n2,0.1\n10,0.001\n",
    "dB that fall": "time_min,threshold (dB)\n0.5,10\n2,-10\n10,-30\n",
    "dB of attenuation": "time_min,sensitivity_dB\n0.5,-10\n2,10\n10,30\n",
    "dB below a stated maximum": "# max_cd_m2: 100\ntime_min,dB\n0.5,10\n2,30\n10,50\n",
    "any order of rows": "log10_threshold,time_min\n-3,10\n1,0.5\n-1,2\n",
    "gaps": "time_min,log10_threshold\n0.5,1\n1,NA\n2,-1\n10,-3\n",
    "write.csv of R": '"","time","thrs"\n"1",0.5,1\n"2",2,-1\n"3",10,-3\n',
    "write.table of R": '"time" "thrs"\n"1" 0.5 1\n"2" 2 -1\n"3" 10 -3\n',
    "dput of R": 'structure(list(time = c(0.5, 2, 10), thrs = c(1, -1, -3), fit = c(1, 2, 3)), class = "dark")\n',
    "blanks": "   0.5    1.0\n   2.0   -1.0\n  10.0   -3.0\n",
    "more columns": "subject,time_min,eye,log10_threshold,note\nA,0.5,L,1,x\nA,2,L,-1,\nA,10,L,-3,y\n",
    "byte-order mark and CR": "\ufefftime_min,log10_threshold\r\n0.5,1\r\n2,-1\r\n10,-3\r\n",
}


@pytest.mark.parametrize("form", SAME)
def test_every_form_gives_the_same_minutes_and_log10(form, tmp_path):
    """Times in min and log10 thresholds are the same three whatever form and unit they were written in."""
    file = tmp_path / "run.csv"
    file.write_text(SAME[form], encoding="utf-8")
    np.testing.assert_allclose(read_table(file).rows[:, :2], EXPECTED, atol=1e-9)


def test_opi_decibels_are_below_its_brightest_stimulus(tmp_path):
    """OPI's dbTocd: 0 dB is 10 000/π cd/m², 40 dB is 1/π."""
    file = tmp_path / "opi.csv"
    file.write_text("# OPI: Octopus900\ntime,dB\n60,0\n300,40\n600,60\n")
    rows = read_table(file).rows
    assert rows[:, 1] == pytest.approx([math.log10(1e4 / math.pi), -math.log10(math.pi), -2 - math.log10(math.pi)])
    assert rows[:, 0] == pytest.approx([1.0, 5.0, 10.0])


def test_sigma_follows_the_unit(tmp_path):
    """A u of 1 dB is 0.1 log10; a u of 10 % of a linear threshold is 0.0434."""
    file = tmp_path / "run.csv"
    file.write_text("time_min,threshold_db,u\n0.5,10,1\n2,-10,2\n")
    assert read_table(file).rows[:, 2] == pytest.approx([0.1, 0.2])
    file.write_text("time_min,threshold_cd_m2,u\n0.5,10,1\n2,0.1,0.01\n")
    assert read_table(file).rows[:, 2] == pytest.approx([0.0434294, 0.0434294], rel=1e-5)


def test_it_says_what_it_took(tmp_path):
    """Form, unit of time, unit of thresholds and rows left out are reported; facts are kept."""
    file = tmp_path / "run.csv"
    file.write_text("# protocol: rapid\nt;threshold (dB)\n30;-10\n60;NA\n600;30\n")
    found = read_table(file)
    sentence = "; ".join(found.taken)
    for words in ("semicolons", "seconds, for it goes to 600", "dB of attenuation", "1 rows without a number"):
        assert words in sentence
    assert found.facts == {"protocol": "rapid"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("a,b\n1,2\n", "no column time_min"),
        ("# a Tuesday\n1\n" + 50 * "2;1\n", "line 2: cells: 1; most lines have 2"),
        ("time_min,log10_threshold\n1,x\n", "line 2"),
        ("time_min,threshold_cd_m2\n1,5\n2,-1\n", "must be above 0"),
        ("time_min,log10_threshold\n1,NA\n", "no thresholds"),
        ("RDX2\nX\n", "write.csv"),
        ("list(time = c(1, 2), thrs = c(1))", "2 times and 1 thresholds"),
    ],
)
def test_what_cannot_be_taken_is_named(text, message, tmp_path):
    """File, line and the way out."""
    file = tmp_path / "run.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"run\.csv") as refused:
        read_table(file)
    assert message in str(refused.value)


@pytest.mark.slow
def test_fit_reads_seconds_and_decibels_and_finds_the_break(tmp_path, capsys):
    """An attenuation table in seconds gives break and S2 of the curve: 9 min, −0.24."""
    times = np.arange(0.5, 22.0, 0.5)
    curve = -1 + 2 * np.exp(-np.minimum(times, 9) / 1.6) - 0.24 * np.maximum(times - 9, 0)
    curve += np.random.default_rng(3).normal(0, 0.03, times.size)
    file = tmp_path / "people.csv"
    rows = [f"{60 * t:.1f};{str(round(40 - 10 * y, 3)).replace('.', ',')}" for t, y in zip(times, curve, strict=True)]
    file.write_text("# from a perimeter\nTime (s);Attenuation (dB)\n" + "\n".join(rows) + "\n")
    assert run(["adapt", "fit", str(file), "--bootstrap", "0"]) == 0
    printed = capsys.readouterr()
    assert "rod–cone break at 9." in printed.out or "rod–cone break at 8.9" in printed.out
    assert "S2 slope -0.24" in printed.out or "S2 slope -0.23" in printed.out
    assert "dB of attenuation" in printed.err


def test_two_thresholds_of_one_minute_are_both_kept():
    """Both stand in the series; a time that goes back is refused."""
    assert ThresholdSeries(np.array([1.0, 2.0, 2.0]), np.array([1.0, 0.5, 0.4])).time_min.tolist() == [1.0, 2.0, 2.0]
    with pytest.raises(InputError, match="must ascend"):
        ThresholdSeries(np.array([1.0, 2.0, 1.9]), np.array([1.0, 0.5, 0.4]))
