"""What a reset leaves of the box's energy budgets: never more than there was, and little less."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

FULL = {0: 47_000_000, 1: 846_000_000, 2: 846_000_000, 3: 846_000_000, 4: 846_000_000, 5: 70_500_000}
CELLS_BEAR = 100_000  # writes of an EEPROM cell, data sheet of the ATmega328P
RECORDS = 100


def buckets(box):
    box.ask("HI 2")
    return [int(box.ask(f"RB {channel}").split()[-1]) for channel in range(6)]


def live(box, seconds):
    for _ in range(int(seconds * 2)):
        box.run(500)
        box.ask("TM")


def test_a_box_with_an_empty_memory_starts_with_nothing_and_fills_in_ten_minutes(power):
    """New firmware knows nothing of the past: no light and no flash at first; after ten dark minutes all of it."""
    box = power(memory=b"LB000007" + b"\xff" * 1016)
    assert buckets(box) == [0] * 6
    assert box.ask("PU 5 H 60000 1000") == "ER 06"
    assert box.ask("FL") == "ER 06"
    live(box, 605.0)
    assert buckets(box) == list(FULL.values())
    assert box.ask("FS") == "OK 8 0"


light = st.one_of(
    st.builds("SL {} H {}".format, st.integers(0, 5), st.sampled_from([300, 20_000])),
    st.builds("PU {} H {} {}".format, st.integers(0, 5), st.just(20_000), st.sampled_from([5, 900, 40_000])),
    st.builds("RA {} H {} {}".format, st.integers(0, 5), st.sampled_from([0, 20_000]), st.sampled_from([5, 4_000])),
    st.builds("BL {} H 20000 {} {} 0".format, st.integers(0, 5), st.integers(1, 900), st.integers(1, 900)),
    st.sampled_from(["FL", "OF *"]),
)
steps = st.lists(st.one_of(light, st.sampled_from([0.5, 4.0, 30.0, 90.0])), min_size=1, max_size=12)


@pytest.mark.parametrize("kind", ["whole", "small"])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
# Power that fails before the first byte fails before the light: the record is written ahead of it.
@given(lives=st.lists(st.tuples(steps, st.none() | st.integers(1, 40)), min_size=1, max_size=4))
def test_no_reset_gives_energy_or_flashes_back(power, kind, lives):
    """Whatever is lit, whenever the reset comes, wherever power fails in a record: no bucket holds more afterwards."""
    memory = None
    for one, cut in lives:
        box = power(kind, memory=memory)
        buckets(box)
        if cut is not None:
            box.cut_memory_after(cut)
        for step in one:
            box.ask(step) if isinstance(step, str) else live(box, step)
            if cut is not None:
                break  # power failed
        before, flashes = buckets(box), int(box.ask("FS").split()[1])
        memory = box.memory
        after = power(kind, reset_flags=2, memory=memory)
        assert all(now <= then for now, then in zip(buckets(after), before, strict=True))
        assert int(after.ask("FS").split()[1]) <= flashes


def test_a_reset_costs_little(power):
    """A bleach of 40 s leaves 260 of 300 s; after a reset there are 5 of 64 parts less at most, a minute later none."""
    box = power()
    box.ask("HI 2")
    box.ask("PU 5 H 60000 40000")
    live(box, 40.0)
    before = buckets(box)[5]
    after = power(reset_flags=2, memory=box.memory)
    assert before - 5 * FULL[5] / 64 <= buckets(after)[5] <= before
    live(after, 60.0)
    assert buckets(after)[5] >= before


def test_twelve_openings_give_no_more_than_one(power):
    """Twelve pulses of 40 s at the highest level, each after a reset: 300 s and what refills meanwhile, no more."""
    memory, given_s = None, 0
    for _ in range(12):
        box = power(reset_flags=2, memory=memory)
        box.ask("HI 2")
        if box.ask("PU 5 H 60000 40000").startswith("OK"):
            given_s += 40
            live(box, 40.0)
        live(box, 2.0)
        memory = box.memory
    assert given_s <= 300 + 12 * 42 * 118 / 235


def test_the_memory_lasts_for_years(power):
    """A bleach of three minutes and its refilling, each day ten times: the cells bear it for twenty years."""
    box = power()
    buckets(box)
    box.ask("PU 5 H 60000 180000")
    live(box, 600.0)
    assert buckets(box)[5] == FULL[5]
    records = box.memory_writes / 10  # into cells that were blank: all ten bytes of each record
    assert 30 < records < 100
    assert records * 10 * 365 * 20 < CELLS_BEAR * RECORDS


def test_a_blinking_spot_writes_nothing(power):
    """A test of forty minutes with blinks of 200 ms each 4 s stays within one part: one record at its begin."""
    box = power()
    buckets(box)
    for _ in range(600):
        box.ask("PU 1 H 60000 200")
        live(box, 4.0)
    assert box.memory_writes <= 10
