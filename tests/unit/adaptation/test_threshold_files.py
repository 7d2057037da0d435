"""Files of thresholds: tables, R and OPI."""

import bz2
import gzip
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from radiometer.adaptation.threshold_files import column_of_onsets, read_table
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.cli.main import run
from radiometer.data.statements import StatementMap
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
    "linear by name": "time_min,threshold_cd_m2\n0.5,10\n2,0.1\n10,0.001\n",
    "millicandela in logarithms": "time_min,threshold [log10 mcd/m2]\n0.5,4\n2,2\n10,0\n",
    "units in remarks": "# time: min\n# unit: mcd/m2\nt,thr\n0.5,10000\n2,100\n10,1\n",
    "natural logarithms": "time_h,ln_threshold\n0.00833333333333,2.302585093\n0.0333333333333,-2.302585093\n"
    "0.166666666667,-6.907755279\n",
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
    """0 dB is 10 000/π cd/m², 40 dB is 1/π; a u of 1 dB is 0.1 log10, one of 10 % of a linear threshold 0.0434."""
    file = tmp_path / "opi.csv"
    file.write_text("# OPI: Octopus900\ntime_s,dB\n60,0\n300,40\n600,60\n")
    rows = read_table(file).rows
    assert rows[:, 1] == pytest.approx([math.log10(1e4 / math.pi), -math.log10(math.pi), -2 - math.log10(math.pi)])
    assert rows[:, 0] == pytest.approx([1.0, 5.0, 10.0])
    file = tmp_path / "run.csv"
    file.write_text("time_min,threshold_db,u\n0.5,10,1\n2,-10,2\n")
    assert read_table(file).rows[:, 2] == pytest.approx([0.1, 0.2])
    file.write_text("time_min,threshold_cd_m2,u\n0.5,10,1\n2,0.1,0.01\n")
    assert read_table(file).rows[:, 2] == pytest.approx([0.0434294, 0.0434294], rel=1e-5)


def test_it_says_what_it_took(tmp_path):
    """Form, unit of time, unit of thresholds and rows left out are reported; facts are kept."""
    file = tmp_path / "run.csv"
    file.write_text("# protocol: rapid\nt [s];attenuation (dB)\n30;-10\n60;NA\n600;30\n")
    found = read_table(file)
    sentence = "; ".join(found.taken)
    for words in ("semicolons", "time in s", "dB attenuation", "1 rows without a number"):
        assert words in sentence
    assert found.facts == {"protocol": "rapid"}


OPEN = {
    "time": ("t,log10_threshold\n30,1\n120,-1\n600,-3\n", ["time=t:s"], "--map time=t:UNIT"),
    "threshold, linear or not": (
        "time_min,thr\n0.5,10\n2,0.1\n10,0.001\n", ["threshold=thr:linear"], "--map threshold=thr:UNIT"),
    "decibels of either sign": (
        "time_min,dB\n0.5,-10\n2,10\n10,30\n", ["threshold=dB:dB attenuation"], "of attenuation or of luminance"),
    "rising decibels": (
        "time_min,threshold_dB\n0.5,-10\n2,10\n10,30\n", ["threshold=threshold_dB:dB attenuation"], "rises"),
    "minutes of R that are seconds": ("time,thrs\n30,1\n120,-1\n600,-3\n", ["time=time:s"], "goes to 600"),
    "seconds without a heading": ("30,1\n120,-1\n600,-3\n", [], "write a heading"),
    "names of any kind": (
        "a,b,c\n7,30,2\n7,120,-2\n7,600,-6\n", ["time=b:s", "threshold=c:log10 ucd/m2"], "no column time_min"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "stated", "message"), OPEN.values(), ids=OPEN)
def test_a_unit_that_no_file_states_stops_until_the_user_states_it(text, stated, message, tmp_path, capsys):
    """The one line names the option, and with it the values are those of the file."""
    file = tmp_path / "run.csv"
    file.write_text(text)
    assert run(["adapt", "fit", str(file)]) == 1
    assert message in (refused := capsys.readouterr().err)
    assert len(refused.strip().splitlines()) == 1
    if stated:
        shift = 6.0 if "ucd" in stated[-1] else 0.0
        rows = read_table(file, StatementMap.parse(stated)).rows
        expected = np.array([[0.5, 2.0], [2.0, -2.0], [10.0, -6.0]]) - [0.0, 6.0] if shift else EXPECTED
        np.testing.assert_allclose(rows, expected, atol=1e-9)


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


def test_two_thresholds_of_one_minute_are_both_kept():
    """Both stand in the series; a time that goes back is refused."""
    assert ThresholdSeries(np.array([1.0, 2.0, 2.0]), np.array([1.0, 0.5, 0.4])).time_min.tolist() == [1.0, 2.0, 2.0]
    with pytest.raises(InputError, match="must ascend"):
        ThresholdSeries(np.array([1.0, 2.0, 1.9]), np.array([1.0, 0.5, 0.4]))


NIL = "254"


def _symbol(name):
    return ["1", "262153", str(len(name)), name]


def _reals(values):
    return ["14", str(len(values)), *map(repr, values)]


def _strings(values):
    return ["16", str(len(values)), *(word for value in values for word in ("262153", str(len(value)), value))]


def _dark(time, thrs, names=("time", "thrs")):
    """Return a list of class "dark" as R serialises it: R Internals, section 1.8 (a list with attributes: 787)."""
    attributes = ["1026", *_symbol("names"), *_strings([*names])]
    attributes += ["1026", *_symbol("class"), *_strings(["dark"]), NIL]
    return ["787", "2", *_reals(time), *_reals(thrs), *attributes]


def _rds(words):
    """Return what `saveRDS(ascii = TRUE, version = 2)` writes."""
    return "\n".join(["A", "2", "197888", "131840", *words, ""]).encode()


def _rda(named):
    """Return what `save(ascii = TRUE, version = 2)` writes: a pairlist of named objects."""
    pairs = [word for name, words in named.items() for word in ("1026", *_symbol(name), *words)]
    return b"RDA2\n" + _rds([*pairs, NIL])


PACKED = {"plain": lambda raw: raw, "gzip": gzip.compress, "bzip2": bz2.compress}


@pytest.mark.parametrize("packed", PACKED)
@pytest.mark.parametrize("form", ["rds", "rda"])
def test_dark_object_that_r_saved_is_read(tmp_path, form, packed):
    """`saveRDS` and `save`, in the packings that R uses: minutes, log10 thresholds, and the object's name."""
    raw = _rds(_dark(MINUTES, LEVELS)) if form == "rds" else _rda({"subject7": _dark(MINUTES, LEVELS)})
    file = tmp_path / f"curve.{form}"
    file.write_bytes(PACKED[packed](raw))
    found = read_table(file)
    np.testing.assert_allclose(found.rows, np.column_stack([MINUTES, LEVELS]))
    assert any("a file of R" in text for text in found.taken)
    assert form == "rds" or any("subject7" in text for text in found.taken)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (_rda({"a": _dark(MINUTES, LEVELS), "b": _dark(MINUTES, LEVELS)}), "several objects: a, b"),
        (_rda({"a": _reals(LEVELS)}), "no object with time or Time or t and thrs"),
        (_rds(_dark(MINUTES, LEVELS[:2])), "3 times and 2 thresholds"),
        (b"RDX3\nX\n\x00\x00", "cannot be read"),
        (gzip.compress(b"no R at all", mtime=0), "cannot be read"),
    ],
)
def test_r_file_without_one_curve_is_refused_with_the_way_out(tmp_path, raw, message):
    """Named, with the line that writes text in R where that helps."""
    (tmp_path / "x.rda").write_bytes(raw)
    with pytest.raises(InputError, match=r"x\.rda") as refused:
        read_table(tmp_path / "x.rda")
    assert message in str(refused.value)


@pytest.mark.parametrize("names", [("time", "thrs"), ("when", "lum")])
def test_columns_and_units_of_an_r_object_are_those_that_the_user_states(tmp_path, names):
    """Seconds and natural logarithms, under any names, as of any other table; a name that is not there is refused."""
    file = tmp_path / "x.rds"
    file.write_bytes(_rds(_dark([60.0 * one for one in MINUTES], [math.log(10.0) * one for one in LEVELS], names)))
    stated = StatementMap.parse([f"time={names[0]}:s", f"threshold={names[1]}:ln cd/m2"])
    np.testing.assert_allclose(read_table(file, stated).rows, np.column_stack([MINUTES, LEVELS]))
    with pytest.raises(InputError, match="nowhere"):
        read_table(file, StatementMap.parse(["time=nowhere:s"]))


def test_without_its_reader_the_line_for_r_is_reported(tmp_path, monkeypatch):
    """The extra, or `write.csv`."""
    monkeypatch.setitem(sys.modules, "rdata", None)
    (tmp_path / "x.rds").write_bytes(_rds(_dark(MINUTES, LEVELS)))
    with pytest.raises(InputError, match=r"radiometer\[r\].*write\.csv"):
        read_table(tmp_path / "x.rds")


def _trials(threshold_db, *, reaction=True):
    """Return three ascents of an OPI session: 2 dB brighter per trial until seen, from 6 dB dimmer."""
    head = '"onset_s","level","seen",' + ('"time"' if reaction else '"x"')
    rows, onset_s = [], 30.0
    for start in (8.0, 6.0, 4.0):
        level = threshold_db + start
        while True:
            seen = level <= threshold_db
            rows.append(f"{onset_s},{level},{'TRUE' if seen else 'FALSE'},{400 if seen else -1}")
            onset_s += 2.0
            if seen:
                break
            level -= 2.0
    return head + "\n" + "\n".join(rows) + "\n"


def test_opi_trials_give_a_threshold_wherever_the_answer_changes(tmp_path):
    """Between 20 dB, seen, and 22, at the mean of the onsets; a dim level seen and a brighter one not gives none."""
    (tmp_path / "t.csv").write_text("# OPI: Octopus900\n# level: dB\n" + _trials(20.0).replace("level", "level_dB"))
    found = read_table(tmp_path / "t.csv")
    assert found.rows[:, 1] == pytest.approx([math.log10(1e4 / math.pi) - 2.1] * 3)
    assert found.rows[:, 0] * 60 == pytest.approx([37.0, 45.0, 51.0])
    assert any("a list of 12 trials: 3 thresholds" in text for text in found.taken)
    text = "onset_s,log10_level,seen\n0,-1.0,no\n2,-0.9,no\n4,-1.4,yes\n6,-0.9,no\n8,-0.8,yes\n"
    (tmp_path / "t.csv").write_text(text)
    assert read_table(tmp_path / "t.csv").rows[:, 1] == pytest.approx([-0.85])


def test_the_steps_of_a_search_say_how_far_apart_two_levels_may_be(tmp_path):
    """Steps up of 0.1 count and new beginnings 0.4 lower do not, though there are as many; of steps down alone, all."""
    ascents = [(0, -1.0, "no"), (2, -0.9, "yes"), (4, -1.3, "no"), (6, -1.2, "yes"), (8, -1.6, "no"), (10, -1.5, "yes")]
    descents = [(0, -1.0, "yes"), (2, -1.4, "no"), (4, -0.6, "yes"), (6, -1.0, "no")]
    for name, trials, found in (("up", ascents, [-0.95, -1.25, -1.55]), ("down", descents[:2], [-1.2])):
        rows = "".join(f"{onset},{level},{seen}\n" for onset, level, seen in trials)
        (tmp_path / name).write_text("onset_s,log10_level,seen\n" + rows)
        assert read_table(tmp_path / name).rows[:, 1] == pytest.approx(found)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("level,seen,time\n1,TRUE,400\n0.9,FALSE,-1\n0.8,TRUE,350\n", "reaction time"),
        ("onset_s,log10_level,seen\n0,1,maybe\n2,2,TRUE\n", "neither TRUE nor FALSE"),
        ("onset_s,log10_level,seen\n0,1,TRUE\n2,2,TRUE\n", "never changes"),
        ("onset_s,colour,seen\n0,1,TRUE\n2,2,FALSE\n", "without a column `level`"),
    ],
)
def test_trials_that_give_no_thresholds_are_refused(tmp_path, text, message):
    """What is missing is named; reaction times are not taken for times in the dark."""
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError) as refused:
        read_table(tmp_path / "t.csv")
    assert message in str(refused.value)


ASCENDING, REACTIONS, LEVELS_SHOWN = ("0", "2", "2", "5.5"), ("400", "-1", "350", "-1"), ("8", "6", "7", "9")


@pytest.mark.parametrize(
    ("columns", "when"),
    [
        ({"trial": ASCENDING, "level": LEVELS_SHOWN, "onset_s": ASCENDING}, 2),
        ({"time": ASCENDING, "level": LEVELS_SHOWN, "onset": ASCENDING}, 2),
        ({"onset": REACTIONS, "level": LEVELS_SHOWN, "time": ASCENDING}, 2),
        ({"Elapsed [ms]": ASCENDING, "level": LEVELS_SHOWN}, 0),
        ({"level": LEVELS_SHOWN, "start of blink": ASCENDING}, 1),
        ({"level": LEVELS_SHOWN, "wall clock": ASCENDING}, 1),
        ({"trial": ASCENDING, "level": LEVELS_SHOWN, "time": REACTIONS}, None),
        ({"onset": ("3", "3", "3", "3"), "level": LEVELS_SHOWN}, None),
        ({"onset": ("a", "b", "c", "d"), "level": LEVELS_SHOWN}, None),
        ({"downtime": ASCENDING, "timer": ASCENDING, "level": LEVELS_SHOWN}, None),
    ],
)
def test_the_time_of_a_trial_is_a_column_by_its_name_and_its_numbers(columns, when):
    """The best known of the names, alone or as the first or last word, of a column that ascends; a count is no time."""
    header = [*columns, "seen"]
    rows = [[*row, "TRUE"] for row in zip(*columns.values(), strict=True)]
    if when is None:
        with pytest.raises(InputError, match="without the time at which each was shown"):
            column_of_onsets(Path("t.csv"), header, rows, without=len(columns))
    else:
        assert column_of_onsets(Path("t.csv"), header, rows, without=len(columns)) == when
