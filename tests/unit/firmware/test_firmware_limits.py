"""What the firmware must not let through, in numbers of docs/reference/light-box-protocol.md and of the circuit."""

from zlib import crc32

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

TABLE = {
    0: "bleach 0 1024 1953 65535 60000 47000000 78",
    1: "spot 453 8192 1953 65535 60000 846000000 1410",
    2: "spot_red 640 8192 1953 65535 60000 846000000 1410",
    3: "fixation 640 1024 1953 65535 20000 846000000 1410",
    4: "spot_green 505 8192 1953 65535 60000 846000000 1410",
    5: "field 0 1024 1953 65535 60000 70500000 118",
}

LINE_BYTES = 64  # of a request without its line end, as docs/reference/light-box-protocol.md says


@pytest.fixture
def box(power):
    """Return a box that speaks version 2 to a host."""
    box = power()
    box.ask("HI 2")
    return box


def bucket(box, channel):
    return int(box.ask(f"RB {channel}").split()[-1])


@pytest.mark.parametrize("channel", TABLE)
def test_limits_are_those_of_the_document(box, channel):
    """Name, peak, steps, PWM, highest levels and budget of each channel; one level more is refused in every verb."""
    assert box.ask(f"CH {channel}") == f"OK {TABLE[channel]}"
    highest = int(TABLE[channel].split()[5])
    for words in ("SL {} H {}", "RA {} H {} 5", "PU {} H {} 5", "BL {} H {} 5 5 1"):
        assert box.ask(words.format(channel, highest + 1)) == "ER 05"
    assert box.duties() == [0.0] * 4
    assert box.ask(f"SL {channel} H {highest}").startswith(f"OK H {highest} ")
    assert sum(box.duties()) == pytest.approx(highest / 65536, abs=1.1 / 1024)


@pytest.mark.parametrize(
    ("current", "level", "cost"), [("H", 60_000, 235), ("H", 255, 1), ("H", 256, 2), ("L", 65_535, 1)]
)
def test_bright_time_costs_and_darkness_gives_back(box, current, level, cost):
    """level/256 + 1 units per ms at the high current, one at the low; 78 per dark ms up to the full bucket."""
    box.ask(f"SL 0 {current} {level}")
    box.run(500)
    assert bucket(box, 0) == 47_000_000 - 500 * cost
    box.ask("OF 0")
    dark_ms = min(500 * cost // 78, 900)
    box.run(dark_ms)
    assert bucket(box, 0) == 47_000_000 - 500 * cost + 78 * dark_ms
    box.ask("TM")
    box.run(900)
    if 500 * cost < 78 * 900:
        assert bucket(box, 0) == 47_000_000


@pytest.mark.parametrize("words", ["SL 5 H 60000", "RA 5 H 60000 1", "BL 5 H 60000 60000 1 0", "BL 5 H 60000 3 3 0"])
def test_light_without_an_end_is_ended_by_its_budget(power, words):
    """1762 units at 235 per ms: dark after 7 bright ms, with an event; and a longer pulse is refused (06)."""
    box = power("small")
    box.ask("HI 2")
    assert box.ask("PU 5 H 60000 8") == "ER 06"
    assert box.ask("BL 5 H 60000 4 1 2") == "ER 06"
    assert box.ask(words).startswith("OK")
    box.take()
    box.run(7 if words.startswith("BL 5 H 60000 3") else 6)
    assert b"DK" not in box.take()
    box.run(100)
    assert box.take().count(b" DK 5 ") == 1
    assert box.duties() == [0.0] * 4
    assert box.ask("RB 5").startswith("OK O L 0 0 ")
    assert box.ask("ST").split()[5] == "1"


def test_silence_of_a_second_makes_dark_and_ends_the_session(box):
    """999 ms are borne, 1000 are not; what is refused counts as being heard, what arrives damaged does not."""
    box.ask("SL 1 L 60000")
    box.run(999)
    assert box.duties()[1] > 0.9
    assert box.ask("XX") == "ER 02"
    box.run(500)
    box.send(b"#01 TM*00000000\n")
    box.run(499)
    assert box.duties()[1] > 0.9
    box.take()
    box.run(1)
    assert box.duties() == [0.0] * 4
    assert b" DK D 1999.000*" in box.take()
    assert box.ask("SL 1 L 1") == "ER 07"
    assert box.ask("ST").split()[-1] == "0"


def test_button_held_three_seconds_keeps_every_light_off(box):
    """Dark after 3000 ms; no light, no flash until the contact has been open for 8 ms; bounces do not end the hold."""
    box.ask("SL 1 L 60000")
    box.contact(closed=True)
    for _ in range(5):
        box.run(599)
        box.ask("TM")
    assert box.duties()[1] > 0.9
    box.take()
    box.run(5)
    assert b" DK B 3000.000*" in box.take()
    assert box.duties() == [0.0] * 4
    assert box.ask("SL 1 L 1") == "ER 12"
    assert box.ask("FL") == "ER 12"
    box.contact(closed=False)
    box.run(7)
    assert box.ask("SL 1 L 1") == "ER 12"
    box.run(1)
    assert box.ask("SL 1 L 1") == "OK L 1 0"


def test_flash_gap_number_and_refill(box):
    """Trigger for 10 ms; 5 s between two; eight in a row; one more after 75 s."""

    def wait(ms):
        for _ in range(ms // 500):
            box.run(500)
            box.ask("TM")
        box.run(ms % 500)

    assert box.ask("FL") == "OK 7 5000"
    assert box.pins("B") & 1
    box.run(9)
    assert box.pins("B") & 1
    box.run(1)
    assert not box.pins("B") & 1
    wait(4989)
    assert box.ask("FL") == "ER 06"
    box.run(1)
    for left in range(6, -1, -1):
        assert box.ask("FL") == f"OK {left} 5000"
        wait(5000)
    assert box.ask("FS") == "OK 0 0"
    assert box.ask("FL") == "ER 06"
    wait(75_000 - 40_000 - 1)
    assert box.ask("FS") == "OK 0 0"
    box.run(1)
    assert box.ask("FS") == "OK 1 0"


@pytest.mark.parametrize("end", ["OF *", "HI 2", None])
def test_whatever_ends_the_light_ends_the_trigger(box, end):
    """Lights off, a new session and silence pull the trigger down."""
    box.ask("FL")
    if end:
        box.ask(end)
    else:
        box.run(1000)
    assert not box.pins("B") & 1


@pytest.mark.parametrize(
    ("channel", "range_pin", "select_pin"),
    [*((channel, ("D", 4 + channel), None) for channel in range(4)), (4, ("C", 4), 2), (5, ("C", 5), 3)],
)
def test_pins_of_each_channel(box, channel, range_pin, select_pin):
    """The high-current switch of the channel alone is on, the select line says whose light it is, and all rest low."""
    outputs = {"B": 0b1110, "C": 0b111100, "D": 0b11111000}
    box.ask(f"SL {channel} H 5000")
    expected = {"C": 0, "D": 0}
    expected[range_pin[0]] |= 1 << range_pin[1]
    if select_pin is not None:
        expected["C"] |= 1 << select_pin
    assert {port: box.pins(port) & outputs[port] for port in "CD"} == expected
    box.ask(f"SL {channel} L 5000")
    expected[range_pin[0]] &= ~(1 << range_pin[1])
    assert {port: box.pins(port) & outputs[port] for port in "CD"} == expected
    box.ask("OF *")
    assert [box.pins(port) for port in "BCD"] == [0, 0, 0]
    assert box.duties() == [0.0] * 4


def test_partners_never_shine_together(box):
    """Bleach and field, red and green share an output: the second is refused (11) until the first is off."""
    for one, other in ((0, 5), (5, 0), (2, 4), (4, 2)):
        box.ask(f"SL {one} L 5000")
        for words in (f"SL {other} L 1", f"RA {other} L 1 5", f"PU {other} L 1 5", f"BL {other} L 1 5 5 1"):
            assert box.ask(words) == "ER 11"
        assert box.ask(f"SL {other} L 0") == "OK L 0 0"
        assert box.duties()[{0: 0, 5: 0, 2: 2, 4: 2}[one]] == pytest.approx(5000 / 65536, abs=6e-4)
        box.ask("OF *")
    assert box.ask("SL 1 L 5000").startswith("OK")
    assert box.ask("SL 3 L 5000").startswith("OK")


@pytest.mark.parametrize("level", [8, 9, 17, 33, 100, 1000, 12345, 32767, 32768, 60000])
def test_dithering_gives_every_step(box, level):
    """Over eight periods of the timers a spot is on for its steps of 8192, an area channel for its of 1024."""
    box.ask(f"SL 1 L {level}")
    box.ask(f"SL 0 L {level}")
    scaled = level + (level >= 32768)
    assert box.duties()[1] * 8192 == pytest.approx((scaled * 8192 + 32768) // 65536)
    assert box.duties()[0] * 1024 == pytest.approx((scaled * 1024 + 32768) // 65536)


def test_a_ramp_is_a_straight_line(box):
    """At each ms the level that a ruler gives, to one; from 0 to 500 in 1 s half the time in ms, rounded down."""
    box.ask("SL 1 L 1000")
    for start, end, ms in ((1000, 2003, 100), (2003, 1000, 50)):
        box.ask(f"RA 1 L {end} {ms}")
        for passed in range(1, ms + 1):
            box.run(1)
            level = int(box.ask("RB 1").split()[3])
            assert level == pytest.approx(start + (end - start) * passed / ms, abs=1.0)
        assert box.ask("RB 1").split()[1] == "S"
    box.ask("OF 1")
    box.ask("RA 1 L 500 1000")
    for ms in range(1, 6):
        box.run(1)
        assert box.ask("RB 1").split()[3] == str(ms // 2)


def test_a_repeated_request_is_answered_alike_and_done_once(box):
    """The host that missed an answer asks again with the same bytes: no second flash, no light anew."""
    line = b"#77 FL"
    line += f"*{crc32(line):08X}\n".encode()
    box.send(line)
    first = box.take()
    box.run(10)
    box.send(line)
    assert box.take() == first
    assert not box.pins("B") & 1
    assert box.ask("FS").split()[1] == "7"


def test_sensors_in_their_units(power):
    """0.75 V are 25.0 °C, 3.0 V behind 30k/10k 12 V; a framing error counts once, of 200 bytes at once 73 are lost."""
    box = power()
    box.analog(154, 614)  # counts of 5 V/1024
    supply_mv, tenths = map(int, box.ask("ST").split()[1:3])
    assert supply_mv == pytest.approx(4 * 614 * 5000 / 1024, abs=2)
    assert tenths == pytest.approx(154 * 5000 / 1024 - 500, abs=1)
    box.analog(82, 0)
    supply_mv, tenths = map(int, box.ask("ST").split()[1:3])
    assert (supply_mv, tenths) == (0, pytest.approx(82 * 5000 / 1024 - 500, abs=1))
    box = power()
    box.send(b"x", damaged=True)
    box.send_at_once(b"y" * 200)
    box.send(b"\n")
    assert box.ask("ST").split()[3:5] == ["1", "74"]


@pytest.mark.parametrize(("flags", "cause"), [(1, "P"), (2, "E"), (4, "B"), (8, "W"), (15, "W"), (6, "B")])
def test_the_cause_of_a_reset_is_reported(power, flags, cause):
    """Watchdog before brown-out before the reset line before power, in the first event and in the status."""
    box = power(reset_flags=flags)
    assert box.take().startswith(f"!01 BO {cause} 0.008*".encode())
    assert box.ask("ST").split()[6] == cause


def test_a_serial_number_of_other_characters_is_shown_as_noughts(power):
    """What stands in an empty memory does not reach the host."""
    assert power(serial="AB 9z*~7").ask("HI 2").split()[4] == "AB09z007"


def test_events_are_kept_and_stamped(box):
    """Sixteen are kept; each has the tick of its edge; older ones are refused (10)."""
    for press in range(20):
        box.ticks(100)
        box.contact(closed=press % 2 == 0)
        box.ticks(0)
        box.run(20)
    assert box.ask("EV 15") == "OK BT U 380.400"
    assert box.ask("EV 14") == "OK BT D 360.400"
    assert box.ask("EV 06") == "OK BT D 80.400"
    assert box.ask("EV 05") == "ER 10"
    assert box.ask("EV 16") == "ER 10"


def test_bounces_are_one_press_and_a_late_change_is_seen(power):
    """Edges within 8 ms are bounce; where the contact then rests otherwise, that is reported, late."""
    box = power()
    box.take()
    for _ in range(5):
        box.contact(closed=True)
        box.contact(closed=False)
        box.run(1)
    box.run(2)
    assert box.take().count(b"BT") == 1
    box.run(1)
    assert b" BT U 8.000*" in box.take()
    box.contact(closed=True)
    box.run(8)
    box.contact(closed=False)
    box.run(8)
    assert [line.split()[2] for line in box.take().splitlines()] == [b"D", b"U"]


@pytest.mark.parametrize("bright_ms", [1, 2, 250])
def test_a_pulse_is_as_long_as_asked_to_the_millisecond(box, bright_ms):
    """Bright until the last of its milliseconds, dark with it; blinks likewise, bright and dark."""
    for words, dark_ms in ((f"PU 1 L 60000 {bright_ms}", 0), (f"BL 1 L 60000 {bright_ms} 3 2", 3)):
        box.ask(words)
        for wait_ms in [bright_ms] if not dark_ms else [bright_ms, dark_ms, bright_ms]:
            before = box.duties()[1]
            box.run(wait_ms - 1)
            assert box.duties()[1] == before
            box.run(1)
            assert (box.duties()[1] == 0.0) is (before > 0.0)
        for _ in range(dark_ms + bright_ms + 1):  # and it was the last: as many blinks as asked for
            box.run(1)
            assert box.duties()[1] == 0.0


def test_a_line_that_is_too_long_is_none_though_its_beginning_is_whole(box):
    """64 characters are read, and refused for what they say; with one more they are no request at all."""
    body = "#01 SL 1 L " + "7".rjust(LINE_BYTES - 9 - 11, "0")
    line = f"{body}*{crc32(body.encode()):08X}".encode()
    assert len(line) == LINE_BYTES
    for more, answer in ((b"", b"=01 ER 03*"), (b"x", b"=-- ER 01*")):
        box.take()
        box.send(line + more + b"\n")
        assert box.take().startswith(answer)


def test_line_and_timers_run_at_their_speeds(power):
    """By the ATmega328P's data sheet: 115,200 Bd to 2.5 %, a tick each ms, light at 1953 Hz, conversions at 125 kHz."""
    box, crystal_hz = power(), 16e6
    assert box.register("UCSR0A") & 0b10, "double speed"
    assert crystal_hz / (8 * (box.register("UBRR0") + 1)) == pytest.approx(115_200, rel=0.025)
    assert box.register("UCSR0C") == 0b110, "eight bits, no parity, one stop bit"
    assert (box.register("TCCR0A"), box.register("TCCR0B")) == (0b10, 0b011), "begins again at OCR0A; every 64th cycle"
    assert crystal_hz / 64 / (box.register("OCR0A") + 1) == 1000.0
    assert (box.register("TCCR1A") & 0b11, box.register("TCCR1B")) == (0b11, 0b01001), "to 1023, every cycle"
    assert (box.register("TCCR2A") & 0b11, box.register("TCCR2B")) == (0b11, 0b010), "to 255, every eighth cycle"
    stated_hz = int(TABLE[0].split()[3])
    assert (int(crystal_hz / 1024 / 8), int(crystal_hz / 8 / 256 / 4)) == (stated_hz, stated_hz)
    assert box.register("ADCSRA") & 0b10000111 == 0b10000111, "converts, every 128th cycle"


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


def test_a_reset_costs_little(box, power):
    """A bleach of 40 s leaves 260 of 300 s; after a reset there are 5 of 64 parts less at most, a minute later none."""
    box.ask("PU 5 H 60000 40000")
    live(box, 40.0)
    before = buckets(box)[5]
    after = power(reset_flags=2, memory=box.memory)
    assert before - 5 * FULL[5] / 64 <= buckets(after)[5] <= before
    live(after, 60.0)
    assert buckets(after)[5] >= before


def test_the_memory_lasts_for_years(power):
    """Ten bleaches of three minutes a day for twenty years; a test of forty minutes with blinks is one record."""
    box = power()
    buckets(box)
    box.ask("PU 5 H 60000 180000")
    live(box, 600.0)
    assert buckets(box)[5] == FULL[5]
    records = box.memory_writes / 10  # into cells that were blank: all ten bytes of each record
    assert 30 < records < 100
    assert records * 10 * 365 * 20 < CELLS_BEAR * RECORDS
    box = power()
    buckets(box)
    for _ in range(600):
        box.ask("PU 1 H 60000 200")
        live(box, 4.0)
    assert box.memory_writes <= 10
