"""One SCPI connection on a socket that is none, in virtual time: framing, patience, rates, order, and who must go."""

import asyncio
import socket
import tracemalloc
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.daemon.journal import Journal
from radiometer.daemon.light import Asker
from radiometer.daemon.limits import Limits, Places, TokenBucket, parse_networks
from radiometer.daemon.scpi import server as module
from radiometer.daemon.scpi.server import ScpiConnection, ScpiServer
from radiometer.daemon.scpi.status import Status
from radiometer.daemon.station import Station
from testing.fake_station import FakeInstrument
from testing.virtual_time import in_virtual_time

LIMITS = Limits(
    scpi_connections=3,
    line_bytes=64,
    messages_waiting=4,
    messages_per_s=1000.0,
    reply_bytes_waiting=100,
    stuck_s=30.0,
    idle_s=1000.0,
    vetting_s=0.5,
)
LONG_LINES = replace(LIMITS, line_bytes=4096)


class Wire(asyncio.Transport):
    """A transport that keeps what is done to it."""

    def __init__(self, peer=("127.0.0.1", 5), family=socket.AF_INET):
        super().__init__()
        self.peer, self.family = peer, family
        self.sent = []
        self.options = []
        self.aborted = self.closed = self.paused = False
        self.high = None

    def get_extra_info(self, name, default=None):
        return {"peername": self.peer, "socket": self}.get(name, default)

    def setsockopt(self, *option):
        self.options.append(option)

    def set_write_buffer_limits(self, high=None, low=None):
        self.high = high

    def write(self, data):
        self.sent.append(bytes(data))

    def abort(self):
        self.aborted = True

    def close(self):
        self.closed = True

    def is_closing(self):
        return self.aborted or self.closed

    def pause_reading(self):
        self.paused = True

    def resume_reading(self):
        self.paused = False


class Scripted:
    """A session that keeps its messages: `?x` replies x, `wait` waits for an event, `bug` has one."""

    def __init__(self, station, table, reply_bytes):
        self.heard = []
        self.at = []
        self.status = Status()
        self.event = asyncio.Event()
        self.closed = self.notified = 0
        self.asker = Asker(Counter())

    def execute(self, message, darkened):
        self.heard.append(message)
        self.at.append(asyncio.get_running_loop().time())
        if message.startswith("bug"):
            raise ValueError("no such thing")
        if message.startswith("wait"):
            return self._wait(message)
        reply = message[1:] if message.startswith("?") else None
        return "€" if reply == "euro" else reply

    async def _wait(self, message):
        await self.event.wait()
        if "bug" in message:
            raise KeyError("gone")
        return "waited"

    def state_changed(self):
        self.notified += 1

    def close(self):
        self.closed += 1


@pytest.fixture(autouse=True)
def _scripted(monkeypatch):
    monkeypatch.setattr(module, "Session", Scripted)
    monkeypatch.setattr(module, "TokenBucket", lambda rate: TokenBucket(rate, clock=asyncio.get_running_loop().time))


def server(limits=LIMITS, allow=()):
    """Return a server that listens nowhere, its clocks those of the loop."""
    station = Station(FakeInstrument(), Journal(Path("never-opened.sqlite")))
    made = ScpiServer(station, limits=limits, allow=allow)
    made.places = Places(limits.scpi_connections, idle_s=60.0, clock=asyncio.get_running_loop().time)
    return made


def client(of, peer=("127.0.0.1", 5), **changes):
    """Return a connection that was just made, its wire and its session."""
    wire, connection = Wire(peer, **changes), ScpiConnection(of)
    connection.connection_made(wire)
    return connection, wire, connection.session


def refused(of, reason):
    """Return how many were refused for a reason."""
    return figure(of, f'radiometer_refused_total{{interface="scpi",reason="{reason}"}}')


def figure(of, name):
    """Return a figure of the page that a monitor reads; 0 where it is not there."""
    lines = [line.rpartition(" ") for line in of.station.metrics.render().decode().splitlines()]
    return next((float(value) for key, _, value in lines if key == name), 0.0)


def errors(session):
    """Return the entries of a session's error queue."""
    return [session.status.next_error() for _ in range(session.status.error_count)]


async def is_cut_off_after(wire, seconds):
    """Wait for the end of a connection that lasts for so long, and no longer."""
    await asyncio.sleep(seconds - 0.1)
    assert not wire.aborted
    await asyncio.sleep(0.2)
    assert wire.aborted


@in_virtual_time
async def test_messages_are_cut_at_line_feeds_and_answered_in_order():
    """A carriage return before the line feed is no part of a message; what is not ended waits; Latin-1 both ways."""
    of = server()
    connection, wire, session = client(of)
    connection.data_received(b"?a\n\xb5\r\n?b")
    assert session.heard == ["?a", "µ"]
    connection.data_received(b"c\xe9\n")
    await asyncio.sleep(0)  # two messages are a turn
    assert session.heard == ["?a", "µ", "?bcé"]
    assert wire.sent == [b"a\n", b"bc\xe9\n"]
    assert figure(of, 'radiometer_requests_total{interface="scpi"}') == 3
    connection.data_received(b"?euro\n")  # its sign is not in Latin-1
    assert wire.sent[-1] == b"?\n"


@settings(max_examples=40, deadline=None)
@given(lines=st.lists(st.sampled_from(["", "?a", "*RST", "?bc"]), max_size=4), cuts=st.lists(st.integers(1, 6)))
@in_virtual_time
async def test_lines_are_heard_as_they_stand_however_they_come(lines, cuts):
    """Empty ones too, whole or in pieces of any size."""
    connection, _, session = client(server())
    sent = "".join(f"{line}\n" for line in lines).encode()
    for size in cuts:
        if sent[:size]:
            connection.data_received(sent[:size])
        sent = sent[size:]
    connection.data_received(sent + b"?end\n")
    await asyncio.sleep(1.0)
    assert session.heard == [*lines, "?end"]
    assert errors(session) == []


@in_virtual_time
async def test_a_line_feed_inside_a_block_is_data_however_it_comes():
    """The message runs once block and line feed are there; a length that no message may have is not waited for."""
    connection, _, session = client(server())
    for part in (b"X #15", b"a\nb", b"\nc\n?2\n"):
        connection.data_received(part)
    assert session.heard == ["X #15a\nb\nc", "?2"]
    connection.data_received(b"X #19abc\ndefgh\n'#19' \n")
    await asyncio.sleep(0)
    assert session.heard[2:] == ["X #19abc\ndefgh", "'#19' "]
    connection, _, session = client(server())
    connection.data_received(b"X #3900abc\n?next\n")
    assert session.heard == ["X #3900abc", "?next"]


@pytest.mark.parametrize(("length", "taken"), [(64, True), (65, False)])
@in_virtual_time
async def test_a_line_may_have_just_so_many_bytes(length, taken):
    """One byte beyond the limit is an overrun (-363) that shows the limit; the next message is fine."""
    connection, wire, session = client(server())
    connection.data_received(b"X" * length + b"\n?next\n")
    assert session.heard == (["X" * length] if taken else []) + ["?next"]
    assert errors(session) == ([] if taken else ['-363,"Input buffer overrun;a message may have 64 bytes"'])
    assert not wire.aborted


@in_virtual_time
async def test_a_line_without_end_is_one_error_and_sixteen_times_the_limit_at_most():
    """What comes after the limit is thrown away up to the line feed; beyond 16 times it the client goes."""
    of = server()
    connection, wire, session = client(of)
    for _ in range(5):
        connection.data_received(b"Y" * 65)
    connection.data_received(b"Y\n?next\n")
    assert session.heard == ["?next"]
    assert len(errors(session)) == 1
    connection.data_received(b"Z" * 65)
    connection.data_received(b"Z" * (16 * 64 - 65))
    assert not wire.aborted
    connection.data_received(b"Z" * 65)
    assert wire.aborted
    assert refused(of, "dropped") == 1
    assert len(errors(session)) == 1
    connection.data_received(b"\n?late\n")
    assert session.heard == ["?next"]


@in_virtual_time
async def test_reading_pauses_while_too_many_messages_wait_and_goes_on_at_half():
    """Four may wait next to the one that is served; a command that waits holds up those behind it, not their order."""
    of = server()
    connection, wire, session = client(of)
    connection.data_received(b"wait\n")
    for number in range(4):
        connection.data_received(b"?%d\n" % number)
    assert not wire.paused
    connection.data_received(b"?4\n")
    assert wire.paused
    assert session.heard == ["wait"]
    session.event.set()
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert of.places.is_known(connection)
    assert wire.sent == [b"waited\n", *(b"%d\n" % n for n in range(5))]
    assert not wire.paused


@pytest.mark.parametrize("line", [b"\n", b"?1\n"])
@in_virtual_time
async def test_what_one_client_sends_at_once_takes_little_more_than_its_bytes(line):
    """64 kB of short lines behind a command that waits: nothing is lost, and nothing is multiplied."""
    connection, wire, session = client(server(Limits(messages_per_s=1e9)))
    connection.data_received(b"wait\n")
    content = line * (65_536 // len(line))
    tracemalloc.start()
    try:
        connection.data_received(content)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert wire.paused
    assert held < 1.2 * len(content)
    await asyncio.sleep(40.0)
    assert not wire.aborted
    session.event.set()
    await asyncio.sleep(1.0)
    assert len(session.heard) == 1 + len(content) // len(line)


@in_virtual_time
async def test_a_fast_client_is_slowed_to_its_rate_and_loses_nothing():
    """Eight at once, then one every eighth of a second; after two messages of a busy client others have a turn."""
    connection, _, session = client(server(Limits(messages_per_s=8.0)))
    begun = asyncio.get_running_loop().time()
    connection.data_received(b"x\n" * 12)
    await asyncio.sleep(10.0)
    assert [at - begun for at in session.at] == [*[0.0] * 8, 0.125, 0.25, 0.375, 0.5]
    of = server(Limits(vetting_s=0.0))
    (one, _, busy), (other, _, quick) = client(of), client(of)
    one.data_received(b"x\n" * 100)
    assert len(busy.heard) == 2
    other.data_received(b"y\n")
    assert quick.heard == ["y"]
    await asyncio.sleep(0)
    assert len(busy.heard) == 4
    await asyncio.sleep(0.001)
    assert len(busy.heard) == 100


@in_virtual_time
async def test_what_lights_waits_until_lines_of_http_would_have_come():
    """Half a second after the first bytes, not after the connection; what follows it waits behind it; then no more."""
    connection, _, session = client(server())
    await asyncio.sleep(2.0)
    begun = asyncio.get_running_loop().time()
    connection.data_received(b"OUTP:ALL OFF\nSoUr:LED1:LEV 1\n?x\n")
    assert session.heard == ["OUTP:ALL OFF"]
    await asyncio.sleep(0.3)
    connection.data_received(b"?y\n")
    await asyncio.sleep(0.7)
    assert session.heard[1:] == ["SoUr:LED1:LEV 1", "?x", "?y"]
    assert [round(at - begun, 6) for at in session.at] == [0.0, 0.5, 0.5, 0.5]
    connection.data_received(b"SOUR:LED1:LEV 0\n")
    assert len(session.heard) == 5


LIGHTING = ("SOUR:LED1:LEV 0.9", "SENS:EXP 0.002", "SENS:PATC 1,2,3,4", "INIT:CONT ON")


@pytest.mark.parametrize(
    "beginning",
    [
        (b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",), (b"GET / HTTP/1.1\r\n",), (b"OPTIONS / HTTP/1.1\r\n",),
        (b"QUERY / HTTP/1.1\r\n",), (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",), (b"\r\n\r\nPOST / HTTP/1.1\r\n",),
        (b"\x00\x01garbage\n \tPOST / HTTP/1.1\r\n",), (b"\xff\xfe\n\nget / http/1.1\n",),
        (b"*IDN?\nHost: 127.0.0.1:5025\n",), (b"*CLS\nContent-Length: 20\n",), (b"*CLS\nsec-fetch-mode:no-cors\n",),
        (b"\x16\x03\x01\x02\x00\x01\n",), (b"*CLS\n\x16\x03\x01\n",), (b"PO", b"ST / HT", b"TP/1.1\r\n"),
    ],
)  # fmt: skip
@in_virtual_time
async def test_http_and_tls_light_nothing(beginning):
    """Whatever comes before the request, in one packet or in pieces, what follows in the connection is not executed."""
    connection, wire, session = client(server(LONG_LINES))
    *first, last = beginning
    for part in (*first, last + "\n".join([*LIGHTING, ""]).encode()):
        connection.data_received(part)
        await asyncio.sleep(0.01)
    await asyncio.sleep(5.0)
    assert wire.aborted
    assert not {*session.heard} & {*LIGHTING}


@in_virtual_time
async def test_a_web_page_is_hung_up_on_before_anything_lights():
    """Its light waits when the line of HTTP comes: neither that nor what waits is executed, and it is counted."""
    of = server()
    connection, wire, session = client(of)
    connection.data_received(b"SOUR:LED1:LEV 1\n")
    connection.data_received(b"Host: x\n*RST\n")
    assert wire.aborted
    assert refused(of, "not scpi") == 1
    await asyncio.sleep(5.0)
    assert session.heard == []
    connection.data_received(b"*RST\n")
    assert session.heard == []


@in_virtual_time
async def test_a_line_that_was_begun_must_be_ended_in_time():
    """Thirty seconds from its first byte, however many follow, also of one thrown away; the next has its own."""
    of = server()
    connection, wire, _ = client(of)
    connection.data_received(b"*I")
    await asyncio.sleep(29.0)
    connection.data_received(b"DN\n")
    await asyncio.sleep(100.0)
    assert not wire.aborted
    connection.data_received(b"*I")
    await asyncio.sleep(20.0)
    connection.data_received(b"D")
    await is_cut_off_after(wire, 10.0)
    assert refused(of, "dropped") == 1
    connection, wire, _ = client(server())
    connection.data_received(b"Y" * 65)
    await is_cut_off_after(wire, 30.0)


@in_virtual_time
async def test_who_takes_no_replies_is_served_no_more_and_dropped_in_the_end():
    """While its replies wait nothing is executed; once they are taken all goes on, and an unended line has its time."""
    connection, wire, session = client(server())
    assert wire.high == 100
    connection.pause_writing()
    connection.data_received(b"?a\n?b\n*I")
    assert session.heard == []
    await asyncio.sleep(29.0)
    connection.resume_writing()
    assert session.heard == ["?a", "?b"]
    await is_cut_off_after(wire, 30.0)
    other, cut, _ = client(server())
    other.pause_writing()
    await is_cut_off_after(cut, 30.0)


@in_virtual_time
async def test_an_idle_session_is_warned_once_and_ended():
    """At nine tenths one entry with both times, then the end; a word begins it anew; who waits is not idle."""
    of = server()
    connection, wire, session = client(of)
    await asyncio.sleep(500.0)
    connection.data_received(b"x\n")
    await asyncio.sleep(899.0)
    assert session.status.error_count == 0
    await asyncio.sleep(2.0)
    notified = "this session has sent nothing for 900 s and is ended after 1000 s"
    assert errors(session) == [f'-200,"Execution error;{notified}"']
    connection.data_received(b"x\n")
    await asyncio.sleep(950.0)
    assert len(errors(session)) == 1
    await is_cut_off_after(wire, 50.0)
    assert errors(session) == []
    assert refused(of, "dropped") == 1
    connection, wire, session = client(server())
    connection.data_received(b"wait\n")
    await asyncio.sleep(5000.0)
    assert not wire.aborted
    session.event.set()
    await asyncio.sleep(20.0)
    assert wire.aborted


@in_virtual_time
async def test_a_client_that_is_gone_leaves_nothing(monkeypatch):
    """Its place, timers, task and session end; what waited is not executed, what had not begun is closed."""
    of = server()
    connection, wire, session = client(of)
    connection.data_received(b"wait\n?a\n*I")
    await asyncio.sleep(0)
    connection.connection_lost(None)
    await asyncio.sleep(5000.0)
    assert len(asyncio.all_tasks()) == 1, "only this story goes on"
    assert session.closed == 1
    assert (len(of.connections), len(of.places)) == (0, 0)
    assert session.heard == ["wait"]
    assert not wire.aborted
    assert session.status.error_count == 0
    begun = []
    execute = Scripted.execute

    def kept(session, message, darkened):
        begun.append(execute(session, message, darkened))
        return begun[-1]

    monkeypatch.setattr(Scripted, "execute", kept)
    connection, _, _ = client(server())
    connection.data_received(b"wait\n")
    connection.connection_lost(None)
    await asyncio.sleep(0.1)
    assert [coroutine.cr_frame for coroutine in begun] == [None]


@in_virtual_time
async def test_a_bug_in_a_command_is_that_client_s_error_alone():
    """Raised at once or later, it is entered as -310 by its kind; the next message runs."""
    connection, wire, session = client(server())
    session.event.set()
    connection.data_received(b"bug\nwait bug\n?after\n")
    await asyncio.sleep(0.01)
    assert errors(session) == ['-310,"System error;ValueError"', '-310,"System error;KeyError"']
    assert wire.sent == [b"after\n"]


@in_virtual_time
async def test_who_may_not_connect_is_cut_off_and_counted():
    """Who is not listed, and who has a quarter of the places; loopback and Unix sockets are always taken."""
    of = server(allow=parse_networks(["10.1.0.0/16"]))
    _, wire, session = client(of, ("10.2.0.1", 9))
    assert wire.aborted
    assert session is None
    assert refused(of, "not on the allow-list") == 1
    for peer in (("10.1.2.3", 9), ("127.0.0.1", 9)):
        assert client(of, peer)[2] is not None
    assert len(of.connections) == 2
    connection, wire, _ = client(server(), "", family=socket.AF_UNIX)
    assert connection.session is not None
    assert wire.options == []
    assert client(server())[1].options == [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)]
    of = server(allow=parse_networks(["10.0.0.0/8"]))
    assert client(of, ("10.0.0.1", 1))[2] is not None
    late, wire, heard = client(of, ("10.0.0.1", 2))
    late.data_received(b"OUTP:ALL OFF\n?x\n")
    await asyncio.sleep(0.1)
    assert (wire.aborted, heard.heard) == (True, ["OUTP:ALL OFF"])
    assert refused(of, "too many connections of one address") == 1
    assert client(of, ("10.0.0.2", 3))[2] is not None


@in_virtual_time
async def test_who_never_made_sense_makes_room():
    """With all places held, one that was silent for a second goes; a busy or known one stays; else none is let in."""
    of = server()
    first, known, silent = client(of), client(of), client(of)
    first[0].data_received(b"?x\n")
    known[0].data_received(b"wait\n")
    late, wire, heard = client(of)
    late.data_received(b"?x\n")
    assert (wire.aborted, heard.heard) == (True, [])
    assert refused(of, "too many connections") == 1
    await asyncio.sleep(1.5)
    assert not client(of)[1].aborted
    assert silent[1].aborted
    assert refused(of, "dropped") == 1
    assert silent[0] not in of.connections
    assert not first[1].aborted
    assert not known[1].aborted


@in_virtual_time
@pytest.mark.parametrize("message", [b"OUTP:ALL OFF\r\n", b":output:all 0;all?\n", b"OUTP:ALL OFF;*OPC?\n"])
async def test_lights_go_off_though_every_connection_is_in_use(message):
    """Busy clients hold all places: one more is heard if it darkens, however many wait in silence; for nothing else."""
    of = server()
    for _ in range(3):
        client(of)[0].data_received(b"wait\n")
    silent = [client(of)[1] for _ in range(20)]
    late, wire, session = client(of)
    late.data_received(message + b"SOUR:LED1:LEV 1\n")
    await asyncio.sleep(1.0)
    assert [heard.rstrip("\r") for heard in session.heard] == [message.decode().strip()]
    assert wire.aborted  # for its second message
    assert sum(not each.aborted for each in silent) < 8
    for light in (b"OUTP:ALL ON\n", b"OUTP:ALL OFF;:SOUR:LED1:LEV 1\n", b"MEAS:RAD?\n"):
        other, _, its = client(of)
        other.data_received(light)
        await asyncio.sleep(1.0)
        assert its.heard == []


@in_virtual_time
async def test_every_session_hears_of_a_change():
    """The station notifies the server, the server each session; one that left gets nothing; connections are counted."""
    of = server()
    (one, _, hears), (_, wire, too) = client(of), client(of)
    assert b'radiometer_connections{interface="scpi"} 2.0' in of.station.metrics.render()
    of.station.on_change[0]()
    one.connection_lost(None)
    of.station.on_change[0]()
    assert (hears.notified, too.notified) == (1, 2)
    await of.close()
    assert wire.closed
