"""The soaks with losses: a piece of the simulated day, and that their judge sees what is false, missing or unheard."""

import sqlite3

import pytest

from benchmarks import daemon_day_soak
from radiometer.daemon.journal import Journal
from radiometer.data import Patch, Quantity, Reading
from testing.soak_world import PATCHES, Witness, judge


@pytest.mark.long
def test_losses_cost_no_reading_and_make_no_value_false(monkeypatch):
    """Ten simulated minutes with all four losses: journal, streams and every answer agree with the scene."""
    monkeypatch.setattr(daemon_day_soak, "LOSS_EVERY_S", 120.0)
    result = daemon_day_soak.run(1 / 6)
    verdict = result.verdict
    assert (verdict.missing, verdict.holes, verdict.unheard, verdict.false_rows) == (0, 0, 0, 0)
    assert result.witness.false == []
    assert set(result.losses) == {"camera", "light box", "broker", "disk"}
    assert set(verdict.alarms) >= {"camera", "light box", "mqtt"}
    assert verdict.readings > 100
    assert result.witness.counts["FETC?"] > 20


def _reading(patch, value, **changes):
    quantity = Quantity(value, 0.005 * value, "W sr-1 m-2")
    return Reading(quantity, Patch(**PATCHES[patch][0]), "22500001", **changes)  # type: ignore[arg-type]


@pytest.fixture
def kept(tmp_path):
    """Return a maker of journals with given readings."""

    def make(readings):
        path = tmp_path / "j.sqlite"
        with Journal(path) as journal:
            return path, journal.append(readings)

    return make


def test_the_judge_finds_what_is_wrong(kept):
    """Another patch's value, a patch in a foreign stream, a reading that is gone, one that was never heard."""
    bright, dim = PATCHES["bright"][1], PATCHES["dim"][1]
    good = [_reading("bright", bright) for _ in range(4)]
    path, readings = kept([*good, _reading("bright", dim), _reading("dim", dim), _reading("dim", dim, name="dim")])
    witness = Witness()
    for reading in (readings[0], readings[3]):
        witness.saw("stream", reading.to_mapping(), "bright")
        witness.main.add(reading.sequence or 0)
    assert witness.false == []
    connection = sqlite3.connect(path)
    connection.execute("DELETE FROM readings WHERE sequence = ?", (readings[3].sequence,))
    connection.commit()
    connection.close()
    verdict = judge(path, witness)
    assert (verdict.missing, verdict.holes, verdict.unheard, verdict.false_rows) == (1, 1, 2, 2)
    witness.saw_value("FETC?", dim, 0.001, "bright")
    assert witness.counts["false"] == 1
