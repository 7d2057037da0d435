"""The commands over archives as a user meets them: tables, sentences, what failed, and the ways out."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from radiometer.cli.main import run
from radiometer.daemon.journal import Journal

HEAD = "captured,quantity,patch,value,u,unit,status\n"


@pytest.fixture
def table(tmp_path):
    """Return a table of a patch that falls by 1 % per month and one that stays, half a year of every other day."""
    rng = np.random.default_rng(1)
    path = tmp_path / "results.csv"
    rows = []
    for day in range(0, 180, 2):
        for patch, per_month in (("lamp", -0.01), ("wall", 0.0)):
            value = 0.8 * (1 + per_month * day / 30.436875 + 0.002 * rng.standard_normal())
            rows.append(f"{1.7e9 + 86400.0 * day},radiance,{patch},{value:.6f},0.004,W sr-1 m-2,ok\n")
    path.write_text(HEAD + "".join(rows), encoding="utf-8")
    return path


def test_trend_says_what_drifts_and_what_does_not(table, capsys):
    """One sentence for each patch, with the drift in per cent per month and its U."""
    assert run(["trend", str(table)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    found = re.search(
        r"lamp: radiance drifts: \((-[\d.]+) ± ([\d.]+)\) % per month of the mean \(k = 2\) over 90 readings", printed
    )
    assert found, printed
    # Relative to the level in the middle of the record, which is 3 % lower than the first.
    assert abs(float(found[1]) + 1.0 / 0.97) < 1.5 * float(found[2])
    assert "wall: radiance no drift shown: (" in printed


@pytest.mark.usefixtures("unrendered")
def test_trend_gives_json_and_a_report(table, tmp_path, capsys):
    """--json holds what the sentences say; --report writes a page that opens with the outcome."""
    page = tmp_path / "trend.html"
    assert run(["trend", str(table), "--json", "--report", str(page)]) == 0
    trends = json.loads(capsys.readouterr().out)["trends"]
    assert {trend["patch"]: trend["drifts"] for trend in trends} == {"lamp": True, "wall": False}
    (sentence,) = re.findall(r"<p class='outcome'>(.*?)</p>", page.read_text(encoding="utf-8"))
    assert re.match(r"1 of 2 patches drift.* lamp", sentence)
    assert run(["trend", str(table), "--report", str(page), "--force"]) == 0
    assert f"wrote {page}" in capsys.readouterr().err.replace("\n", "")


def test_trend_of_a_quantity_that_is_not_there(table, capsys):
    """One line with the file, the quantity and what to do; the daemon's readings are no table of results."""
    with Journal(table.with_name("week.sqlite")):
        pass
    assert run(["trend", str(table.with_name("week.sqlite"))]) == 1
    assert "the table of `radiometer batch`" in capsys.readouterr().err
    assert run(["trend", str(table), "--quantity", "luminance"]) == 1
    printed = " ".join(capsys.readouterr().err.split())
    assert "holds no dated 'luminance' rows that succeeded; run `radiometer batch` first" in printed
    assert "Traceback" not in printed


def test_batch_names_what_failed_and_what_was_left_out(make_archive, tmp_path, capsys):
    """A damaged capture set is a row and a line; frames without a header are left out by name; the rest is done."""
    root = make_archive(3)
    os.truncate(root / "day-0001" / "frames" / "0001.png", 40)
    shutil.copytree(root / "day-0000" / "frames", root / "broken-off" / "frames")
    left_out = {"broken-off": "frames/0000.png", "raw": "d0.DNG", "sky": "night/f0.fits.gz", "shots": "a.jpg"}
    for folder, file in left_out.items():
        (root / folder / file).parent.mkdir(parents=True, exist_ok=True)
        (root / folder / file).touch()
    (root / "pipe").mkdir()
    os.mkfifo(root / "pipe" / "a.fits")  # is no frame
    assert run(["batch", str(root), "-o", str(tmp_path / "results.csv"), "--json"]) == 1
    printed = capsys.readouterr()
    summary = json.loads(printed.out)
    assert (summary["done"], summary["rows_in_table"], len(summary["failures"])) == (3, 3, 1)
    named = [str(Path(path).relative_to(root)) for path in summary["unfinished"]]
    assert named == ["broken-off", "raw", "shots", "sky/night"]
    text = printed.err.replace("\n", "")
    assert re.search(r"left out: \S*broken-off holds frames but no capture.yaml", text)
    assert re.search(r"failed: \S*day-0001: .*truncated", text)
    assert list(pd.read_csv(tmp_path / "results.csv")["status"]) == ["ok", "failed", "ok"]


def test_batch_measures_the_region_that_is_asked_for_once(make_archive, tmp_path, capsys):
    """--patch reads that region; the same words again do nothing, other words do all anew."""
    root, table = make_archive(2), tmp_path / "results.csv"
    words = ["batch", str(root), "-o", str(table), "--patch", "0,0,8,8"]
    assert run(words) == 0
    assert "2 rows; 2 done, 0 as before" in " ".join(capsys.readouterr().err.split())
    assert run(words) == 0
    assert "2 rows; 0 done, 2 as before" in " ".join(capsys.readouterr().err.split())
    assert run([*words[:-1], "4,4,8,8"]) == 0
    assert "2 done, 0 as before" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--do", "guess"], "--do 'guess': there is no such job; there are "),
        (["--patch", "1,2"], "X,Y,W,H"),
        (["--do", "measure", "--calibration", "none.yaml"], "none.yaml"),
    ],
)
def test_batch_refuses_what_it_cannot_do(make_archive, tmp_path, capsys, words, message):
    """A job, a region or a calibration that is none: a clear line, and no table of successes."""
    table = tmp_path / "results.csv"
    assert run(["batch", str(make_archive(1)), "-o", str(table), *words]) != 0
    printed = " ".join(capsys.readouterr().err.split())
    assert message in printed
    assert "Traceback" not in printed
    assert not table.exists() or "ok" not in list(pd.read_csv(table)["status"])
