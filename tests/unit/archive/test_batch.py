"""Batches: every capture once, failures reported and passed by, resumable, the same on any number of workers."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import yaml

from radiometer.archive.jobs import COLUMNS, JOBS, JobSettings
from radiometer.archive.run import ResultJournal, run_batch
from radiometer.archive.sessions import find_captures
from radiometer.data import Calibration, CaptureSet, LensDescription, Scale, SensorNoise, StatedUncertainties
from radiometer.errors import DeviceNotFound, InputError, OutputRefused, UsageError
from testing.patience import within

pd = pytest.importorskip("pandas", reason="the extra `cluster` is not installed")
distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
# Dask's own clean-up leaves sockets and event loops to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::UserWarning")

MEASURE = JobSettings("measure")


def batch(root, table, **more):
    """Run the measure job over an archive."""
    return run_batch(find_captures(str(root))[0], MEASURE, table, **more)


def test_every_capture_becomes_a_row(make_archive, tmp_path):
    """One row per capture and patch with value, u, flags and provenance."""
    summary = batch(make_archive(5), tmp_path / "results.csv")
    table = pd.read_csv(tmp_path / "results.csv")
    assert list(table.columns) == list(COLUMNS)
    assert (summary.done, summary.rows_in_table, len(table)) == (5, 5, 5)
    assert (table["value"] > 0).all()
    assert (table["u"] > 0).all()
    assert all("uncalibrated" in flags.split() for flags in table["flags"])


def calibration_of(root, folder):
    """Write a calibration of the archive's camera, 1e-3 J·m⁻² per DN at f/4, and return its path."""
    scale = Scale(value=1e-3, u_rel=0.005, method="known_radiance", f_number=4.0)
    noise = SensorNoise(conversion_gain_e_per_dn=2.6, read_noise_e=2.4)
    camera = CaptureSet.read(root / "day-0000").header.camera
    exact = StatedUncertainties(drift_u_rel_per_year=0.0)
    Calibration(camera, LensDescription(f_number=4.0), scale, None, noise, uncertainties=exact).write(
        folder / "cal.yaml"
    )
    return str(folder / "cal.yaml")


@pytest.mark.parametrize("calibrated", [True, False])
def test_a_merged_picture_is_relative_and_flagged_unless_it_is_calibrated(make_archive, tmp_path, calibrated):
    """200 000 e⁻/s of 2.6 e⁻/DN; 1e-3 J·m⁻² of each DN on the sensor are 4·4²/π times as much before the lens."""
    root = make_archive(1)
    settings = JobSettings("merge", calibration=calibration_of(root, tmp_path) if calibrated else None)
    run_batch(find_captures(str(root))[0], settings, tmp_path / "results.csv")
    rows = pd.read_csv(tmp_path / "results.csv", keep_default_na=False).set_index("quantity")
    found, share = rows.loc["radiance"], rows.loc["good_pixels"]
    expected = 200_000 / 2.6 * (1e-3 * 64.0 / np.pi if calibrated else 1.0)
    assert found["value"] == pytest.approx(expected, rel=0.005)
    assert found["u"] / found["value"] == pytest.approx(0.005, rel=0.3) or not calibrated
    assert (found["unit"], found["flags"]) == (("W sr-1 m-2", "") if calibrated else ("relative", "uncalibrated"))
    assert (share["value"], share["unit"], share["flags"]) == (1.0, "1", "")


def test_light_of_unknown_kind_is_flagged_in_the_table(make_archive, tmp_path):
    """A capture that names no wavelength is read with the doubt of its kind, one that does without."""
    root = make_archive(2)
    settings = JobSettings("measure", calibration=calibration_of(root, tmp_path))
    header = root / "day-0001" / "capture.yaml"
    header.write_text(header.read_text() + "source: {kind: led, wavelength_nm: 550}\n")
    run_batch(find_captures(str(root))[0], settings, tmp_path / "results.csv")
    table = pd.read_csv(tmp_path / "results.csv").query("quantity == 'radiance'").set_index("capture").sort_index()
    assert ["spectrum_assumed" in flags for flags in table["flags"]] == [True, False]
    assert table["u"].iloc[0] > 2 * table["u"].iloc[1]


@pytest.mark.parametrize("job", ["measure", "merge"])
def test_frames_without_the_source_are_no_reading(make_archive, tmp_path, job):
    """A capture whose source was off in every frame fails; off in one of two, that one is left out."""
    root = make_archive(2)
    for name, count in (("day-0000", 2), ("day-0001", 1)):
        header = root / name / "capture.yaml"
        content = yaml.safe_load(header.read_text())
        for entry in content["frames"][:count]:
            entry["source_level"] = 0.0
        header.write_text(yaml.safe_dump(content))
    summary = run_batch(find_captures(str(root))[0], JobSettings(job), tmp_path / "results.csv")
    assert [row["capture"].endswith("day-0000") for row in summary.failures] == [True]
    assert "source on" in summary.failures[0]["error"]


def test_what_is_done_is_not_done_again(make_archive, tmp_path):
    """A second run skips all; a changed capture is done anew and replaces its row. A name need not be UTF-8."""
    root = make_archive(3)
    (root / "day-0002").rename(root / "by\udcff")
    batch(root, tmp_path / "results.csv")
    assert batch(root, tmp_path / "results.csv").skipped == 3
    shutil.copy(root / "day-0000" / "frames" / "0000.png", root / "day-0001" / "frames" / "0000.png")
    again = batch(root, tmp_path / "results.csv")
    assert (again.done, again.skipped, again.rows_in_table) == (1, 2, 3)
    assert str(root / r"by\udcff") in set(pd.read_csv(tmp_path / "results.csv")["capture"])


def test_an_interrupted_run_leaves_a_usable_table_and_goes_on(make_archive, tmp_path):
    """Ctrl-C after two captures: their rows stand; the next run does the rest only."""
    root = make_archive(5)

    def stop(done, _total, _rows):
        if done == 2:
            raise KeyboardInterrupt

    first = batch(root, tmp_path / "results.csv", progress=stop)
    assert (first.interrupted, len(pd.read_csv(tmp_path / "results.csv"))) == (True, 2)
    second = batch(root, tmp_path / "results.csv")
    assert (second.done, second.skipped, second.rows_in_table) == (3, 2, 5)


def test_a_journal_cut_in_the_middle_of_a_line_loses_that_capture_only(make_archive, tmp_path):
    """After a kill in the middle of writing, the half line is done again; lines that are no rows count for nothing."""
    root = make_archive(3)
    batch(root, tmp_path / "results.csv")
    journal = tmp_path / "results.csv.journal"
    os.truncate(journal, journal.stat().st_size - 30)
    row = dict.fromkeys(COLUMNS) | {"value": "bright"}
    with journal.open("a") as file:
        file.write('\n{"format":"x"}\n[{"capture":1}]\n[3]\n' + json.dumps([row]) + "\n")
    again = batch(root, tmp_path / "results.csv")
    assert (again.done, again.skipped, again.rows_in_table) == (1, 2, 3)


def test_captures_behind_a_link_are_found_once(make_archive, tmp_path):
    """One whose folder is elsewhere is found; a link back to the archive is no second one."""
    root = make_archive(2)
    find_captures(str(root))[0][0].rename(tmp_path / "elsewhere")
    (root / "link").symlink_to(tmp_path / "elsewhere")
    (root / "loop").symlink_to(root)
    assert len(find_captures(str(root))[0]) == 2


def test_a_journal_of_something_else_is_kept(make_archive, tmp_path):
    """No line is added to it, and no second program adds to a table at the same time."""
    table = tmp_path / "t.csv"
    journal = tmp_path / "t.csv.journal"
    journal.write_text("precious")
    with pytest.raises(OutputRefused, match="no journal of a table"):
        batch(make_archive(1), table)
    assert journal.read_text() == "precious"
    journal.unlink()
    with ResultJournal(table), pytest.raises(OutputRefused, match="another program adds to"), ResultJournal(table):
        pass


@pytest.mark.slow
def test_a_cluster_gives_the_same_table_bit_for_bit_though_a_worker_dies(make_archive, tmp_path):
    """Two worker processes, one killed in the middle: no row lost or doubled, every value as in one process."""
    root = make_archive(60)
    batch(root, tmp_path / "one.parquet")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        victims = [worker.process.pid for worker in cluster.workers.values()]
        begun = threading.Event()

        def kill():
            begun.wait(within(60.0))
            os.kill(victims[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        summary = batch(
            root,
            tmp_path / "two.parquet",
            scheduler=cluster.scheduler_address,
            progress=lambda done, *_: begun.set() if done >= 10 else None,
        )
        killer.join()
        time.sleep(0.1)
    assert summary.done == 60
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "one.parquet"), pd.read_parquet(tmp_path / "two.parquet"))


def test_an_empty_archive_a_strange_table_and_no_scheduler_are_refused(make_archive, tmp_path, monkeypatch):
    """The messages say what was expected; a tenth of a second of patience is as good as ten."""
    monkeypatch.setattr("radiometer.archive.run.SCHEDULER_PATIENCE_S", 0.1)
    with pytest.raises(InputError, match="holds no capture set"):
        find_captures(str(tmp_path))
    with pytest.raises(UsageError, match=r"must end in \.parquet or \.csv"):
        batch(make_archive(1), tmp_path / "results.xlsx")
    with pytest.raises(DeviceNotFound, match="no Dask scheduler answers at tcp://127"):
        batch(tmp_path / "archive", tmp_path / "r.csv", scheduler="tcp://127.0.0.1:9")


@pytest.mark.slow
@pytest.mark.parametrize("job", sorted(JOBS))
def test_every_job_gives_rows_of_one_table(make_archive, tmp_path, job):
    """Whatever the job, its rows have the table's columns; a failure is a row too."""
    summary = run_batch(find_captures(str(make_archive(1)))[0], JobSettings(job), tmp_path / "r.csv")
    assert summary.rows_in_table >= 1
    assert list(pd.read_csv(tmp_path / "r.csv").columns) == list(COLUMNS)


@pytest.mark.slow
def test_maps_are_written_whole_on_request(make_archive, tmp_path):
    """Each merged capture leaves a Zarr group with radiance, uncertainty and mask that reads back."""
    zarr = pytest.importorskip("zarr", reason="the extra `cluster` is not installed")
    settings = JobSettings("merge", maps=str(tmp_path / "maps"))
    summary = run_batch(find_captures(str(make_archive(2)))[0], settings, tmp_path / "r.csv")
    assert summary.failures == ()
    groups = sorted((tmp_path / "maps").iterdir())
    assert len(groups) == 2
    group = zarr.open_group(str(groups[0]), mode="r")
    assert group["radiance"].shape == group["u_radiance"].shape == group["mask"].shape == (16, 16)
    table = pd.read_csv(tmp_path / "r.csv")
    mean = table.query("quantity == 'radiance'")["value"].iloc[0]
    assert group["radiance"][:].mean() == pytest.approx(mean, rel=1e-5)
    other = JobSettings("merge", calibration=calibration_of(tmp_path / "archive", tmp_path), maps=settings.maps)
    run_batch(find_captures(str(tmp_path / "archive"))[0], other, tmp_path / "other.csv")
    assert len(list((tmp_path / "maps").iterdir())) == 4  # the first table's maps are still its own


# Memory that a worker keeps.


_FAULTS = """
import resource, sys
import numpy as np
from radiometer.archive.run import keep_freed_memory
if sys.argv[1] == "keep" and not keep_freed_memory():
    sys.exit(3)
def work():
    for _ in range(40):
        np.ones((640, 640)) * 2.0
work()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.slow
def test_freed_arrays_are_used_again_without_new_pages(project_root):
    """In a process set as a Dask worker is, arrays of 3 MB cost page faults each time; kept, they cost next to none."""
    faults = {}
    for kind in ("give", "keep"):
        done = subprocess.run(
            [sys.executable, "-c", _FAULTS, kind],
            cwd=project_root, capture_output=True, text=True, check=False, env={"MALLOC_TRIM_THRESHOLD_": "65536"},
        )  # fmt: skip
        if done.returncode == 3:
            pytest.skip("this C library has no mallopt")
        faults[kind] = int(done.stdout)
    assert faults["give"] > 40 * 640 * 640 * 8 / resource.getpagesize()
    assert faults["keep"] < faults["give"] / 20
