"""The grammar of SCPI messages, status registers, and what one session sees of the instrument; without a socket."""

import asyncio
import itertools
import math
import struct
from collections.abc import Coroutine
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import JournalError
from radiometer.daemon.limits import TokenBucket
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.commands import ELEMENTS, command_table
from radiometer.daemon.scpi.formats import reading_elements
from radiometer.daemon.scpi.language import (
    MESSAGES,
    Argument,
    Boolean,
    Choice,
    Kind,
    Number,
    ParameterLimits,
    ScpiError,
    Text,
    scpi_error,
    split_message,
)
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.scpi.status import QUEUE_LENGTH, Register, Status
from radiometer.data import Flag, Patch, Quantity, ResponseCurve
from radiometer.errors import (
    CalibrationError,
    DeviceLost,
    DeviceTimeout,
    MeasurementError,
    SettingOutOfRange,
    UnsafeStimulus,
    UsageError,
)

TABLE = command_table()
WIDE = ParameterLimits(-1e30, 1e30, 7.0)
# IEEE 488.2, 7.7.3, and SCPI-99, volume 1, 7.7.2: what a suffix multiplies by, in s, nm and dB.
UNITS = {
    "S": {"": "1", "S": "1", "MS": "1e-3", "US": "1e-6", "NS": "1e-9", "MIN": "60"},
    "NM": {"": "1", "NM": "1", "UM": "1e3", "M": "1e9"},
    "DB": {"": "1", "DB": "1"},
    "PCT": {"": "1", "PCT": "0.01", "%": "0.01"},
    "": {"": "1"},
}
headers = st.sampled_from(["SENS:GAIN", "*CLS", ":SYST:ERR", "EXP"])
units = st.lists(st.tuples(headers, st.booleans(), st.integers(0, 3)), min_size=1, max_size=5)
NUMBERS = st.decimals(-(10**6), 10**6, allow_nan=False, allow_infinity=False, places=6)


def read(parameter, text):
    """Return what a parameter makes of the one argument of a message."""
    ((unit,), error) = split_message(f"X {text}")
    assert error is None
    (argument,) = unit.arguments
    return parameter.read(argument, None)


def number(unit="", limits=WIDE, **more):
    return Number("value", unit, lambda station: limits, **more)


@pytest.mark.parametrize("unit", UNITS)
def test_suffixes_multiply_by_what_the_standard_says(unit):
    """Each suffix, in any case, with and without blanks; no other is taken."""
    for suffix, by in UNITS[unit].items():
        for written in (f"2.5{suffix}", f"2.5 {suffix.lower()}"):
            assert read(number(unit), written) == pytest.approx(2.5 * float(by), rel=1e-12)
    for wrong in {"KS", "HZ", "MM", "S", "NM", "DB", "PCT"} - set(UNITS[unit]):
        with pytest.raises(ScpiError) as caught:
            read(number(unit), f"1 {wrong}")
        assert caught.value.number == (-131 if unit else -138)


@settings(max_examples=150)
@given(NUMBERS, st.sampled_from(["{}", "+{}", "{}e0", "{} E +1", "{}E-2"]))
def test_every_decimal_number_is_read_as_it_is_written(value, form):
    """<NRf>: sign, point and exponent, with blanks about the E."""
    text = form.format(abs(value) if form.startswith("+") else value)
    scale = {"{} E +1": 10.0, "{}E-2": 0.01}.get(form, 1.0)
    expected = float(abs(value) if form.startswith("+") else value) * scale
    assert read(number(), text) == pytest.approx(expected, rel=1e-12, abs=1e-15)


@settings(max_examples=60)
@given(st.integers(0, 2**31))
def test_hexadecimal_octal_and_binary_are_whole_numbers(value):
    """#H, #Q and #B of the same number."""
    found = [
        read(number(fraction="rounded"), f"#{mark}{value:{form}}")
        for mark, form in ("HX", "Qo", "Bb", "hx", "qo", "bb")
    ]
    assert found == [value] * 6


@settings(max_examples=60)
@given(st.floats(-1e3, 1e3), st.floats(0.001, 1e3), st.floats(-2e3, 3e3))
def test_limits_hold_on_both_sides(low, span, value):
    """Inside is taken, outside refused (−222); MIN, MAX and DEF are the limits and the default."""
    low, high = abs(low), abs(low) + span
    bounded = number(limits=ParameterLimits(low, high, low))
    if low * (1 + 1e-6) < value < high * (1 - 1e-6):
        assert read(bounded, repr(value)) == value
    elif value < low * (1 - 1e-6) - 1e-12 or value > high * (1 + 1e-6):
        with pytest.raises(ScpiError) as caught:
            read(bounded, repr(value))
        assert caught.value.number == -222
    assert [read(bounded, word) for word in ("MIN", "maximum", "Def")] == [low, high, low]


def test_words_choices_texts_and_switches():
    """Short and long forms are taken and nothing between; 0 is off, all else on; quotes are doubled."""
    also = number(also=("NONE", "CENTer"))
    assert [read(also, word) for word in ("none", "CENT", "center")] == ["NONE", "CENTer", "CENTer"]
    for wrong in ("CENTE", "MINI", "NON"):
        with pytest.raises(ScpiError, match="-141"):
            read(also, wrong)
    choice = Choice("element", ("READing", "UNCertainty"))
    assert [read(choice, word) for word in ("read", "READING", "unc")] == ["READing", "READing", "UNCertainty"]
    with pytest.raises(ScpiError, match="-224"):
        read(choice, "READI")
    assert [read(Boolean(), word) for word in ("ON", "off", "1", "0", "0.4", "-2", "1e400")] == [
        True, False, True, False, False, True, True,
    ]  # fmt: skip
    for wrong in ("MAYBE", "1 S", "'ON'"):
        with pytest.raises(ScpiError):
            read(Boolean(), wrong)
    assert [read(Text("name"), text) for text in ('"a""b"', "'a''b'", '"a\'b"', '""')] == ['a"b', "a'b", "a'b", ""]
    for wrong in ("abc", "1", "#11a"):
        with pytest.raises(ScpiError, match="-104"):
            read(Text("name"), wrong)
    assert read(number(fraction="rounded"), "2.6") == 3
    assert math.isclose(read(number("PCT", ParameterLimits(0.0, 1.0, 0.0)), "100 PCT"), 1.0)


@settings(max_examples=80)
@given(units, st.sampled_from([";", " ; ", ";\t"]))
def test_a_message_comes_apart_as_it_was_put_together(parts, between):
    """Headers, question marks and arguments of every unit, in order."""
    texts = [header + "?" * query + (" " + ",".join("123"[:count]) if count else "") for header, query, count in parts]
    units, error = split_message(between.join(texts))
    assert error is None
    assert [(unit.header, unit.is_query, len(unit.arguments)) for unit in units] == parts
    assert all(
        unit.arguments == tuple(Argument(Kind.NUMBER, n) for n in "123"[: len(unit.arguments)]) for unit in units
    )


@settings(max_examples=60)
@given(st.text(st.characters(max_codepoint=255), max_size=30))
def test_a_block_and_a_string_hold_any_text(content):
    """#<digits><length><bytes>, #0 to the end, and quotes give back what was put in."""
    length = str(len(content))
    ((one, two), error) = split_message(f"A #{len(length)}{length}{content};B 1")
    assert (error, one.arguments[0].text, one.arguments[0].kind, two.header) == (None, content, Kind.BLOCK, "B")
    ((last,), error) = split_message(f"A #0{content}")
    assert (error, last.arguments[0].text) == (None, content)
    quoted = content.replace('"', '""')
    ((unit,), error) = split_message(f'A "{quoted}"')
    assert (error, unit.arguments[0].text) == (None, content)
    assert formats.block(content.encode("latin-1")) == f"#{len(length)}{length}{content}"


def test_the_error_queue_keeps_the_oldest():
    """First in, first out; of too many the last says so; each sets the event bit of its hundred."""
    status = Status()
    assert status.take_event_status() == 128
    numbers = [-113, -222, -310, -440]
    for error in numbers:
        status.push(ScpiError(error))
    assert status.take_event_status() == 32 + 16 + 8 + 4
    assert [int(status.next_error().split(",")[0]) for _ in range(5)] == [*numbers, 0]
    for _ in range(QUEUE_LENGTH + 3):
        status.push(ScpiError(-113))
    assert (QUEUE_LENGTH, status.error_count) == (32, 32)
    entries = [status.next_error() for _ in range(32)]
    assert [int(entry.split(",")[0]) for entry in entries] == [-113] * 31 + [-350]


def test_our_errors_have_the_standard_s_numbers():
    """Each kind of error by its number; what no one foresaw is −310."""
    expected = {
        SettingOutOfRange("camera", "gain", 1.0, 0.0, 0.5, "dB"): -222,
        UnsafeStimulus("too bright"): -222,
        UsageError("wrong"): -222,
        JournalError("full"): -250,
        CalibrationError("stale"): -340,
        MeasurementError("dark"): -200,
        DeviceTimeout("slow"): -365,
        DeviceLost("gone"): -240,
        TimeoutError("slow"): -365,
        ValueError("what"): -310,
    }
    assert {error: scpi_error(error).number for error in expected} == expected
    assert scpi_error(DeviceLost('camera "1" × °')).entry == '-240,"Hardware error;camera ""1"" x "'


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.1, "1.000000000E-01"), (-1234.5678901, "-1.234567890E+03"), (math.nan, "9.91E+37"), (math.inf, "9.9E+37"),
     (-math.inf, "-9.9E+37"), (0.0, "0.000000000E+00")],
)  # fmt: skip
def test_numbers_are_written_as_the_standard_says(value, text):
    """<NR3> with ten digits; not a number and infinity as SCPI-99, 7.2.1.5, has them."""
    assert formats.number(value) == text


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


@settings(max_examples=60)
@given(st.floats(1.0, 1000.0), st.lists(st.floats(0.0, 0.5), min_size=1, max_size=40))
def test_no_more_than_rate_and_burst_is_let_through(per_s, pauses):
    """In any time at most a burst of one second and the rate; whoever waits as reported is let through next."""
    clock = Clock()
    bucket, taken, start = TokenBucket(per_s, clock), int(per_s), clock.now_s
    assert bucket.is_full
    assert [bucket.take() for _ in range(taken)] == [0.0] * taken  # the burst: the next one has to wait
    for pause in [0.0, *pauses]:
        clock.now_s += pause
        wait_s = bucket.take()
        taken += wait_s == 0.0
        assert taken <= per_s * (1.0 + clock.now_s - start) + 1e-6
        if wait_s:
            assert 0.0 < wait_s <= 1.0 / per_s + 1e-9
            assert not bucket.is_full
            clock.now_s += wait_s * (1.0 + 1e-9) + 1e-9
            assert bucket.take() == 0.0
            taken += 1
    clock.now_s += 1.1
    assert bucket.is_full
    clock.now_s += 1000.0  # more than full never
    assert [bucket.take() for _ in range(int(per_s))] == [0.0] * int(per_s)
    assert bucket.take() > 0.0


async def test_a_setting_is_that_of_the_next_measurement(session, station):
    """In s, dB, pixels and nm, one by one; what is not set stays; MIN, MAX and DEF are of what the camera can do."""
    for message, name, value in (
        ("SENS:EXP 4 MS", "exposure_s", 0.004), ("SENS:EXP:TIME 20 US", "exposure_s", 2e-5),
        ("SENS:EXP MIN", "exposure_s", 1e-5), ("SENS:EXP MAX", "exposure_s", 30.0),
        ("SENS:EXP DEF", "exposure_s", 0.01),
        ("SENS:EXP 1;EXP:AUTO ON", "auto_exposure", True), ("SENS:EXP 1", "auto_exposure", False),
        ("SENS:GAIN 6", "gain_db", 6.0), ("SENS:GAIN 12DB", "gain_db", 12.0), ("SENS:GAIN MAX", "gain_db", 48.0),
        ("SENS:GAIN 3;GAIN DEF", "gain_db", 0.0), ("SENS:GAIN 3;GAIN MIN", "gain_db", 0.0),
        ("SENS:PATC 7,8,9,10", "patch", Patch(7, 8, 9, 10)), ("SENS:PATC 1,2,3,4;PATC CENT", "patch", None),
        ("SENS:CORR:WAV 0.55 UM", "wavelength_nm", 550.0), ("SENS:CORR:WAV 5e-7 M", "wavelength_nm", 500.0),
        ("SENS:CORR:WAV 550;WAV NONE", "wavelength_nm", None), ("SENS:CORR:WAV DEF", "wavelength_nm", 550.0),
    ):  # fmt: skip
        assert session.execute(message) is None
        found = getattr(station.settings, name)
        assert found == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value), message
        untouched = replace(station.settings, **{name: getattr(MeasurementSettings(), name)})
        assert name in ("exposure_s", "auto_exposure") or untouched == MeasurementSettings(), message
        session.execute("*RST")
        assert station.settings == MeasurementSettings()
    assert session.status.error_count == 0
    for query, ends in (("EXP", (1e-5, 30.0, 0.01)), ("GAIN", (0.0, 48.0, 0.0))):
        found = [float(session.execute(f"SENS:{query}? {word}")) for word in ("MIN", "MAX", "DEF")]
        assert found == pytest.approx(ends)
    low, high = (float(session.execute(f"SENS:CORR:WAV? {word}")) for word in ("MIN", "MAX"))
    assert low < 400.0 < 700.0 < high


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mask=st.integers(0, 255))
async def test_masks_are_given_back(session, mask):
    """*ESE and the enable registers whole, *SRE without its own bit 6."""
    assert session.execute(f"*ESE {mask};*ESE?") == str(mask)
    assert session.execute(f"*SRE {mask};*SRE?") == str(mask & ~64)
    for name in ("OPER", "QUES"):
        assert session.execute(f"STAT:{name}:ENAB {mask};ENAB?") == str(mask)
    assert session.execute("STAT:PRES;:STAT:OPER:ENAB?;:STAT:QUES:ENAB?") == "0;0"
    assert session.execute("*ESE 256;*ESE?") == str(mask)


# What *RST leaves alone: status registers (IEEE 488.2, 10.32), and by the manual all but settings of a measurement.
_NOT_RESET = ("*", "STATus", "INITiate", "TRIGger", "SOURce", "OUTPut", "SENSe:PATCh:LIMits")


async def test_reset_gives_back_every_setting_that_can_be_asked(session):
    """Each setting is changed; after *RST every query answers as it did at the start."""
    both = [c for c in TABLE.commands if c.do and c.ask and not c.pattern.startswith(_NOT_RESET)]
    queries = [c.spellings()[-1].replace("<n>", "1") + "?" for c in both]
    at_start, changed = [session.execute(query) for query in queries], set()
    others = ["SENS:GAIN 6", "SENS:PATC 1,2,3,4", "SENS:CORR:WAV 600"]
    for message in [*(command.example for command in both), *others]:
        session.execute(message)
        changed |= {query for query, answer in zip(queries, at_start, strict=True) if session.execute(query) != answer}
    session.execute("*RST")
    assert session.status.error_count == 0
    assert [session.execute(query) for query in queries] == at_start
    assert len(changed) == len(queries)


_PLACES_BETWEEN_PIXELS = ("1.5,2,3,4", "1,1.5,3,4", "1,2,1.5,4", "1,2,3,15E-1", "1,2,3,1.5")


async def test_what_is_wrong_is_named_by_the_standard_s_number(session):
    """SCPI-99, 21.8: separators, missing and unknown parameters, a suffix of a header beyond the channels, no data."""
    for message, number, text in (
        ("NO:SUCH?", -113, ""), ("*IDN", -113, ""), ("SENS:EXP4", -113, ""), ("SENSITIVITYOFX:EXP 1", -113, ""),
        ("SENSITIVITYOFXYZ:EXP 1", -112, ""), ("SENS:EXP:TIME", -109, ""), ("SENS:PATC 1,2", -109, ""),
        ("SENS:EXP 1,2", -108, ""), ("SENS:EXP 100", -222, ""), ("SENS:EXP 1e400", -222, ""),
        *((f"SENS:PATC {place}", -224, "1.5 is no whole number") for place in _PLACES_BETWEEN_PIXELS),
        ("MEAS:RAD? 1.5,2,3,4", -224, "x 1.5"), ('SENS:PATC:DEF "lamp",1,2,3,1.5', -224, "height 1.5"),
        ("TRAC:DATA? HIST,1.5", -224, "count 1.5"),
        ("SENS:PATC 60,40,20,20", -222, ""), ("SENS:EXP 1 KG", -131, ""), ("SENS:PATC 1 MM,2,3,4", -138, ""),
        ("SENS:EXP ABC", -141, ""), ("SENS:EXP 'abc'", -104, ""), ("SENS:EXP #15hello", -104, ""),
        ("SENS:EXP 'abc", -151, ""), ("SENS:EXP #Z", -161, ""), ("TRAC:DATA? NONSENSE", -224, ""),
        ("SOUR:LED9:LEV?", -114, ""), ("@", -101, ""), ("4", -102, ""), ("*IDN?SYST:VERS?", -103, ""),
        ('SYST:ERR"x"', -103, ""), ("A:B#11x", -103, ""), ("*CLS(1)", -103, ""), ("*IDN?,1", -103, ""),
        *((f"SENS:EXP #{mark}", -161, "") for mark in ("\u00b2ab", "1\u00b2ab", "\u00b912")),
        ("SENS:GAIN 1 2", -103, "expected at character 13"),
        ('SYST:ERR? "a" "b"', -103, "expected at character 15"),
        ("SENS:PATC 1,2,3,", -109, "after ','"),
        ("SENS:GAIN &", -101, "at character 11"),
        ("FORM:BORD 5", -104, "one of"),
        ("FORM:BORD LEFT", -224, "NORMal"),
        ("SOUR:LED0:LEV 0.1", -114, "LED0; there are 1 to 2"),
        ("SOUR:LED3:LEV 0.1", -114, "LED3; there are 1 to 2"),
        ("SOUR:LED12345:LEV 0.1", -113, ""),
        ('SENS:PATC:DEF "lamp",CENT,1,2,3', -224, "x,y,width,height"),
        ('SENS:PATC:LIM? "lamp"', -224, "no patch lamp"),
        ('FETC:PATC? "lamp"', -222, "there is no patch 'lamp'; there are: main"),
        ('FETC:PATC? "main"', -230, "no reading of patch main yet"),
        ("FETC?", -230, "READ? makes one"),
    ):  # fmt: skip
        reply = session.execute(message)
        assert (await reply if asyncio.iscoroutine(reply) else reply) is None, message
        entry = session.status.next_error()
        assert (int(entry.split(",")[0]), text in entry) == (number, True), entry
        assert session.status.error_count == 0, message


@pytest.mark.parametrize(
    ("function", "value", "u"), [("RADiance", 2.0, 0.05), ("LUMinance", 300.0, 9.0), ("LUMinance", math.nan, math.nan)]
)
def test_expanded_is_k_times_u(make_reading, function, value, u):
    """Value, u, U and k of two frames that disagree: k = 13.97; in near-infrared no luminance; in any order."""
    luminance = None if math.isnan(value) else Quantity(300.0, 9.0, "cd m-2")
    reading = make_reading(
        radiance=Quantity(2.0, 0.05, "W sr-1 m-2"), luminance=luminance, coverage_factor=13.97,
        flags=(Flag.FLICKER, Flag.SATURATED), sequence=7, time="2026-01-02T03:04:05Z",
    )  # fmt: skip
    elements = dict(zip(ELEMENTS, reading_elements(reading, function, ELEMENTS).split(","), strict=True))
    turned = zip(ELEMENTS[::-1], reading_elements(reading, function, ELEMENTS[::-1]).split(","), strict=True)
    assert elements == dict(turned)
    expected = [9.91e37] * 3 if luminance is None else [value, u, 13.97 * u]
    assert [float(elements[name]) for name in ("READing", "UNCertainty", "EXPanded")] == pytest.approx(expected)
    assert float(elements["COVerage"]) == 13.97
    assert (elements["SEQuence"], elements["FLAGs"]) == ("7", '"flicker saturated"')
    assert elements["TIME"] == '"2026-01-02T03:04:05Z"'


# Status registers. Golden numbers: IEEE 488.2-1992, 11.2.1 (status byte) and 11.5.1 (standard event status register);
# SCPI-99, volume 1, figure 9-1, and volume 2, 21.8 (which error sets which event).


WORDS = st.integers(0, 0x7FFF)
OPERATION_COMPLETE, QUERY, DEVICE, EXECUTION, COMMAND, POWER_ON = 1, 4, 8, 16, 32, 128


@pytest.mark.parametrize(
    ("first", "last", "bit"),
    [(-199, -100, COMMAND), (-299, -200, EXECUTION), (-399, -300, DEVICE), (-499, -400, QUERY)],
)
def test_each_hundred_of_errors_sets_its_event(first, last, bit, monkeypatch):
    """Both ends of a class belong to it, whatever numbers are in use; no error and our own numbers set none."""
    for number in (first, last, first + 37):
        monkeypatch.setitem(MESSAGES, number, "any")
        status = Status()
        assert status.take_event_status() == POWER_ON
        status.push(ScpiError(number))
        assert status.event_status == bit
        assert ScpiError(number).is_command_error == (bit == COMMAND)
    for number in (0, -99, -500, 7):
        monkeypatch.setitem(MESSAGES, number, "any")
        assert ScpiError(number).event_bit == 0
        assert not ScpiError(number).is_command_error


def test_an_entry_is_one_line_of_ascii_of_255_characters_at_most():
    """Quotes are doubled, what is no ASCII is a question mark, signs of times and degrees are spelled or left out."""
    assert ScpiError(-222, 'a "b" 2 × 3 °C\n€').entry == '-222,"Data out of range;a ""b"" 2 x 3 C??"'
    assert ScpiError(0).entry == '0,"No error"'
    assert len(ScpiError(-222, "x" * 400).entry) == len('-222,""') + 255


@given(st.lists(st.tuples(st.sampled_from(["update", "take", "enable"]), WORDS), max_size=30))
@settings(max_examples=60, deadline=None, database=None, derandomize=True)
def test_an_event_is_a_condition_that_rose_since_it_was_read(steps):
    """Bit by bit, against a set: reading clears events alone, a falling condition clears nothing."""
    register, condition, event, enable = Register(), set[int](), set[int](), set[int]()
    for what, word in steps:
        bits = {bit for bit in range(15) if word >> bit & 1}
        if what == "update":
            event |= bits - condition
            condition = bits
            register.update(word)
        elif what == "take":
            assert register.take_event() == sum(1 << bit for bit in event)
            event = set()
        else:
            enable, register.enable = bits, word
        assert register.condition == sum(1 << bit for bit in condition)
        assert register.event == sum(1 << bit for bit in event)
        assert register.summary is bool(event & enable)


@pytest.mark.parametrize("service_enable", [0, 4, 8, 16, 32, 64, 128, 255])
def test_the_status_byte_sums_up(service_enable):
    """Bits 2 to 5 and 7 say what is queued, questionable, available, an event, operating; bit 6 any that is enabled."""
    for queued, questionable, available, event, operation in itertools.product((False, True), repeat=5):
        status = Status()
        status.take_event_status()
        status.service_enable, status.event_enable = service_enable, COMMAND | OPERATION_COMPLETE
        for register, there in ((status.questionable, questionable), (status.operation, operation)):
            register.enable = 2
            register.update(2 if there else 1)
        if queued:
            status.push(ScpiError(-222))  # an execution error: an event that is not enabled
        if event:
            status.complete()
        byte = 4 * queued + 8 * questionable + 16 * available + 32 * event + 128 * operation
        master = 64 * bool(byte & service_enable & ~64)
        assert status.status_byte(message_available=available) == byte + master
        assert available or status.status_byte() == byte + master


def test_clearing_spares_what_is_enabled_and_presetting_what_has_happened():
    """*CLS empties queue and events, not enables (IEEE 488.2, 10.3); STATus:PRESet the enables of SCPI's part alone."""
    status = Status()
    status.event_enable, status.service_enable = 60, 36
    for register in (status.operation, status.questionable):
        register.enable = 5
        register.update(3)
    status.push(ScpiError(-113))
    status.preset()
    assert (status.operation.enable, status.questionable.enable) == (0, 0)
    assert (status.event_enable, status.service_enable) == (60, 36)
    assert (status.operation.event, status.questionable.event, status.error_count) == (3, 3, 1)
    status.operation.enable = 5
    status.clear()
    assert (status.operation.event, status.questionable.event, status.event_status, status.error_count) == (0, 0, 0, 0)
    assert (status.operation.condition, status.operation.enable, status.event_enable) == (3, 5, 60)


# What one SCPI session sees of the instrument: whose reading, which bits, in which order; without a socket.


CALIBRATION, BOX_LOST, FLAGGED, ALARM = 1 << 8, 1 << 10, 1 << 11, 1 << 12


@pytest.fixture
def session(station):
    return Session(station, TABLE)


async def ask(session, message):
    """Return the reply to a message, waiting where it has to."""
    reply = session.execute(message)
    return await reply if isinstance(reply, Coroutine) else reply


async def errors(session):
    return [entry.partition(",")[0] for entry in (await ask(session, "SYST:ERR:ALL?")).split('",')]


async def test_continuous_measurement_is_switched_off_and_keeps_its_period_when_on(session, station):
    """OFF stops; ON while it runs is no new start with another period."""
    await ask(session, "TRIG:TIM 0.5;:INIT:CONT ON")
    assert (float(await ask(session, "TRIG:TIM?")), await ask(session, "INIT:CONT?")) == (0.5, "1")
    await ask(session, "INIT:CONT OFF")
    assert (station.acquisition.every_s, await ask(session, "INIT:CONT?")) == (None, "0")


async def test_a_reading_of_the_patch_before_is_not_fetched(session):
    """After another patch was chosen there is none (−230) until it is measured."""
    assert float((await ask(session, "MEAS:RAD? 5,6,7,8")).split(",")[0]) == 6.0
    await ask(session, "CONF:RAD 9,6,7,8")
    assert await ask(session, "FETC?") is None
    assert await errors(session) == ["-230"]
    assert float((await ask(session, "READ?")).split(",")[0]) == 10.0
    await ask(session, "CONF:RAD 5,6,7,8;:CONF:RAD 9,6,7,8")  # there and back again
    assert await ask(session, "FETC?") is None


async def test_what_is_questionable_has_a_bit_each(session, station, instrument, box, monkeypatch, eventually):
    """Flags of the latest reading, of its calibration by a bit of their own; one alarm or more; a lost light box."""
    exact = instrument.measure

    async def bits():
        return int(await ask(session, "STAT:QUES:COND?"))

    def flagged(settings, *flags):
        measurement = exact(settings)
        return replace(measurement, reading=replace(measurement.reading, flags=flags))

    for flags, expected in (
        ((Flag.SATURATED,), FLAGGED),
        ((Flag.UNCALIBRATED,), CALIBRATION),
        ((Flag.STALE_CALIBRATION, Flag.FLICKER), CALIBRATION | FLAGGED),
        ((), 0),
    ):
        monkeypatch.setattr(instrument, "measure", lambda settings, flags=flags: flagged(settings, *flags))
        await station.acquisition.measure()
        assert await bits() == expected, flags
    for name in ("limit lamp", "journal"):
        station.alarms.put_up(name, "something is wrong")
        assert await bits() == ALARM
    for name in ("limit lamp", "journal"):
        station.alarms.clear(name, "it is well")
    box.unplugged = True
    await eventually(lambda: station.alarms.active)
    assert await bits() & BOX_LOST
    box.unplugged = False
    await eventually(lambda: not station.alarms.active)
    assert await bits() == 0


async def test_pictures_come_in_the_order_of_bytes_that_was_chosen(session):
    """NORMal is the big end first, as IEEE 488.2 has it, and the state at start; SWAPped the small one."""
    await ask(session, "READ?")
    for chosen, form in (("", ">"), ("FORM:BORD SWAP;:", "<"), ("FORM:BORD NORM;:", ">")):
        block = (await ask(session, f"{chosen}TRAC:DATA? IMAG")).encode("latin-1")
        assert block[:6] == b"#46144"
        assert struct.unpack(f"{form}3072H", block[6:]) == tuple(range(3072))


async def test_history_runs_forward(session, station, make_reading):
    """The newest comes last, and no more than asked for; of 103 readings the newest hundred unless stated otherwise."""
    for x in (3, 5, 7):
        await ask(session, f"SENS:PATC {x},2,4,4;:READ?")
    for chosen, form in (("", ">"), ("FORM:BORD SWAP;:", "<")):
        block = (await ask(session, f"{chosen}TRAC:DATA? HIST,2")).encode("latin-1")
        assert struct.unpack(f"{form}6d", block[4:]) == (2.0, 6.0, 0.01, 3.0, 8.0, 0.01)
    for committed in [station.writer.submit(make_reading()) for _ in range(100)]:
        await committed
    block = (await ask(session, "TRAC:DATA? HIST")).encode("latin-1")
    values = struct.unpack("<300d", block[2 + int(block[1:2]) :])
    assert values[::3] == tuple(range(4, 104))


async def test_the_response_is_a_pair_of_numbers_for_every_code(session, station, monkeypatch):
    """ln H and its u, code by code, in the order of bytes chosen; −230 where digital numbers are taken as linear."""
    monkeypatch.setattr(type(station.instrument), "response", None)
    assert await ask(session, "TRAC:DATA? RESP") is None
    assert await errors(session) == ["-230"]
    curve = ResponseCurve(np.linspace(-3.0, 2.0, 256), 0.01 + 1e-4 * np.arange(256.0))
    monkeypatch.setattr(type(station.instrument), "response", curve)
    for chosen, form in (("", ">"), ("FORM:BORD SWAP;:", "<")):
        block = (await ask(session, f"{chosen}TRAC:DATA? RESP")).encode("latin-1")
        assert block[:6] == b"#44096"
        values = struct.unpack(f"{form}512d", block[6:])
        assert values[::2] == pytest.approx(np.linspace(-3.0, 2.0, 256))
        assert values[1::2] == pytest.approx(0.01 + 1e-4 * np.arange(256.0))


async def test_a_measurement_that_fails_in_the_background_is_in_the_error_queue(session, station):
    """INITiate replies nothing; what it could not measure is reported when it is asked for, once."""
    station.instrument.failing = True
    await ask(session, "INIT")
    await ask(session, "*OPC?")
    found = await errors(session)
    assert len(found) == 1
    assert found[0] != "0"
    station.instrument.failing = False
    await ask(session, "INIT")
    await ask(session, "*OPC?")
    assert await errors(session) == ["0"]


async def test_limits_of_a_patch_are_those_that_were_set(session):
    """Low, high and hysteresis in their order; NONE is no bound; the hysteresis is 1 % unless stated otherwise."""
    await ask(session, 'SENS:PATC:LIM "main",2,10,5 PCT')
    assert [float(v) for v in (await ask(session, 'SENS:PATC:LIM? "main"')).split(",")] == [2.0, 10.0, 0.05]
    await ask(session, 'SENS:PATC:LIM "main",NONE,10')
    assert (await ask(session, 'SENS:PATC:LIM? "main"')).split(",")[0] == "NONE"
    assert float((await ask(session, 'SENS:PATC:LIM? "main"')).split(",")[2]) == 0.01


async def test_units_and_signs_are_legible_in_ascii(session, station):
    """An alarm's value keeps its sign and its unit."""
    station.alarms.put_up("limit light", "0.9 ± 0.1 W·sr⁻¹·m⁻²")
    assert await ask(session, "SYST:ALAR?") == '"limit light: 0.9 +- 0.1 W sr-1 m-2"'


@pytest.mark.parametrize("command", ["ABOR", "*CLS", "*RST"])
async def test_what_is_aborted_does_not_go_on(session, command):
    """ABORt, *CLS and *RST end the measurement itself, not only the waiting for it."""
    task = session.start()
    await ask(session, command)
    assert session.pending is None
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_patch_beyond_the_picture_is_refused_when_it_is_chosen(session, instrument):
    """64 by 48 pixels: one over the edge, or of no size, is −222 at once; CONFigure alone takes the patch for all."""
    for place in ("60,0,5,5", "0,44,5,5", "0,0,0,5"):
        await ask(session, f"CONF:RAD {place}")
        assert await errors(session) == ["-222"], place
        assert session.own_patch is None, place
        assert not instrument.measured, place
    for quantity in ("RAD", "LUM"):
        await ask(session, f"CONF:{quantity} 5,6,7,8")
        await ask(session, f"CONF:{quantity}")
        assert (session.own_patch, await ask(session, "CONF?")) == (None, f'"{quantity}"'), quantity
        assert await errors(session) == ["0"], quantity


async def test_who_waits_for_a_measurement_that_is_given_up_is_reported(session):
    """READ? ends with −230 when its measurement is aborted, and the session goes on."""
    waiting = asyncio.ensure_future(ask(session, "READ?"))
    while session.pending is None:
        await asyncio.sleep(0)
    session.abort()
    assert await waiting is None
    assert (await ask(session, "SYST:ERR?")).endswith('the measurement was aborted"')
    assert await errors(session) == ["0"]
    assert float((await ask(session, "READ?")).split(",")[0]) > 0.0


async def test_a_measurement_has_two_minutes(session, station, monkeypatch):
    """READ? gives it no less and no more: a camera that is silent for longer is a trouble that is reported."""
    given_s = []
    measure = station.acquisition.measure

    async def timed(settings, deadline_s, name):
        given_s.append(deadline_s)
        return await measure(settings, deadline_s, name)

    monkeypatch.setattr(station.acquisition, "measure", timed)
    await ask(session, "READ?")
    assert given_s == [120.0]
