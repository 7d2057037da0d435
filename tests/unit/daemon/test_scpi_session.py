"""What one SCPI session sees of the instrument: whose reading, which bits, in which order; without a socket."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Coroutine
from dataclasses import replace

import numpy as np
import pytest

from radiometer.daemon.scpi.session import Session
from radiometer.daemon.scpi.table import command_table
from radiometer.data import Flag, ResponseCurve

TABLE = command_table()
CALIBRATION, BOX_LOST, FLAGGED = 1 << 8, 1 << 10, 1 << 11


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


@pytest.mark.parametrize(
    ("flags", "bits"),
    [
        ((), 0),
        ((Flag.SATURATED,), FLAGGED),
        ((Flag.UNCALIBRATED,), CALIBRATION),
        ((Flag.STALE_CALIBRATION, Flag.FLICKER), CALIBRATION | FLAGGED),
    ],
)
async def test_flags_of_the_latest_reading_are_bits(session, station, instrument, monkeypatch, flags, bits):
    """What a reading is warned of is questionable: the calibration by one bit, all else by another."""
    exact = instrument.measure

    def flagged(settings):
        measurement = exact(settings)
        return replace(measurement, reading=replace(measurement.reading, flags=flags))

    monkeypatch.setattr(instrument, "measure", flagged)
    await station.acquisition.measure()
    found = int(await ask(session, "STAT:QUES:COND?"))
    assert found & (CALIBRATION | FLAGGED) == bits
    assert found & BOX_LOST == 0


async def test_a_lost_light_box_is_questionable(session, station, box, eventually):
    """Its bit is up while it is gone, and down when it is back."""
    box.unplugged = True
    await eventually(lambda: station.alarms.active)
    assert int(await ask(session, "STAT:QUES:COND?")) & BOX_LOST
    box.unplugged = False
    await eventually(lambda: not station.alarms.active)
    assert int(await ask(session, "STAT:QUES:COND?")) & BOX_LOST == 0


async def test_clearing_takes_errors_and_events_and_leaves_what_is_enabled(session):
    """*CLS: the queue is empty, *ESR? is 0, *ESE stays."""
    await ask(session, "*ESE 32;NO:SUCH")
    await ask(session, "*CLS")
    assert await ask(session, "SYST:ERR:COUN?;*ESR?;*ESE?") == "0;0;32"
    assert await errors(session) == ["0"]


async def test_pictures_come_in_the_order_of_bytes_that_was_chosen(session):
    """NORMal is the big end first, as IEEE 488.2 has it, and the state at start; SWAPped the small one."""
    await ask(session, "READ?")
    for chosen, form in (("", ">"), ("FORM:BORD SWAP;:", "<"), ("FORM:BORD NORM;:", ">")):
        block = (await ask(session, f"{chosen}TRAC:DATA? IMAG")).encode("latin-1")
        assert block[:6] == b"#46144"
        assert struct.unpack(f"{form}3072H", block[6:]) == tuple(range(3072))


async def test_history_runs_forward(session):
    """The newest comes last, and no more than asked for."""
    for x in (3, 5, 7):
        await ask(session, f"SENS:PATC {x},2,4,4;:READ?")
    for chosen, form in (("", ">"), ("FORM:BORD SWAP;:", "<")):
        block = (await ask(session, f"{chosen}TRAC:DATA? HIST,2")).encode("latin-1")
        assert struct.unpack(f"{form}6d", block[4:]) == (2.0, 6.0, 0.01, 3.0, 8.0, 0.01)


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


async def test_history_without_a_number_is_the_newest_hundred(session, station, make_reading):
    """Of 103 readings the numbers 4 to 103."""
    for committed in [station.writer.submit(make_reading()) for _ in range(103)]:
        await committed
    block = (await ask(session, "TRAC:DATA? HIST")).encode("latin-1")
    values = struct.unpack(">300d", block[2 + int(block[1:2]) :])
    assert values[::3] == tuple(range(4, 104))


async def test_limits_of_a_patch_are_those_that_were_set(session):
    """Low, high and hysteresis in their order; NONE is no bound; the hysteresis is 1 % unless stated otherwise."""
    await ask(session, 'SENS:PATC:LIM "main",2,10,5 PCT')
    assert [float(v) for v in (await ask(session, 'SENS:PATC:LIM? "main"')).split(",")] == [2.0, 10.0, 0.05]
    await ask(session, 'SENS:PATC:LIM "main",NONE,10')
    assert (await ask(session, 'SENS:PATC:LIM? "main"')).split(",")[0] == "NONE"
    assert float((await ask(session, 'SENS:PATC:LIM? "main"')).split(",")[2]) == 0.01


@pytest.mark.parametrize(("up", "bit"), [((), 0), (("camera",), 0), (("camera", "journal"), 1 << 12)])
async def test_a_blocked_journal_is_one_alarm_among_others(session, station, up, bit):
    """Its bit is up with its own alarm and with no other; bits of devices that are there are down."""
    for name in up:
        station.alarms.put_up(name, "something is wrong")
    assert int(await ask(session, "STAT:QUES:COND?")) & (0b111 << 9 | 1 << 12) == bit


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


@pytest.mark.parametrize("place", ["60,0,5,5", "0,44,5,5", "0,0,0,5"])
async def test_a_patch_beyond_the_picture_is_refused_when_it_is_chosen(session, instrument, place):
    """64 by 48 pixels: a patch over the edge, or of no size, is −222 at once and nothing is measured with it."""
    await ask(session, f"CONF:RAD {place}")
    assert await errors(session) == ["-222"]
    assert session.own_patch is None
    assert not instrument.measured


async def test_full_light_is_one(session, box):
    """MAX is a level of 1, MIN and DEF darkness; 1.01 is refused by what the command takes."""
    await ask(session, "SOUR:LED1:LEV MAX;:SOUR:LED2:LEV 0.5")
    assert box.levels == {"white": 1.0, "red": 0.5}
    await ask(session, "SOUR:LED1:LEV DEF;:SOUR:LED2:LEV MIN;:SOUR:LED1:LEV 1.01")
    assert box.levels == {"white": 0.0, "red": 0.0}
    assert (await ask(session, "SYST:ERR?")).endswith('outside 0 to 1"')


@pytest.mark.parametrize("quantity", ["RAD", "LUM"])
async def test_a_quantity_is_chosen_with_its_patch_or_without(session, quantity):
    """CONFigure alone takes the patch that is measured for all."""
    await ask(session, f"CONF:{quantity} 5,6,7,8")
    await ask(session, f"CONF:{quantity}")
    assert (session.own_patch, await ask(session, "CONF?")) == (None, f'"{quantity}"')
    assert await errors(session) == ["0"]


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
