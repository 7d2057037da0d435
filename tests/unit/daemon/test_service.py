"""The daemon's watch over its parts, and over a clock that is set."""

import asyncio
import json
import os
import re
import resource
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, asynccontextmanager, suppress
from dataclasses import dataclass

import numpy as np
import pytest

from radiometer.bench.doctor import check_daemon
from radiometer.daemon import journal_writer
from radiometer.daemon.alarms import Alarms
from radiometer.daemon.epics import PvaOptions
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.journal import Journal, JournalError
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.journal_writer import JournalWriter
from radiometer.daemon.limits import parse_networks
from radiometer.daemon.resources import Descriptors, listen
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.service import Service, ServiceOptions
from radiometer.daemon.station import Station
from radiometer.daemon.timestamps import ClockWatch, Jump, RetentionClock, iso_time, microseconds
from radiometer.devices import Health
from radiometer.errors import CalibrationError, OutputError, RadiometerError
from testing.fake_station import QUICK, FakeBox, FakeInstrument
from testing.patience import within


class Told:
    """systemd, which wants to hear every few milliseconds that the daemon lives, and keeps what it receives."""

    watchdog_period_s = 0.005

    def __init__(self):
        self.fed, self.lines = 0, list[str]()

    def alive(self):
        self.fed += 1

    def ready(self, status):
        self.lines.append(f"ready {status}")

    def reloading(self):
        self.lines.append("reloading")

    def stopping(self):
        self.lines.append("stopping")

    def status(self, text):
        self.lines.append(f"status {text}")


@dataclass
class Daemon:
    """A service on fakes that has not begun, what it announces, and what it sends to systemd."""

    service: Service
    station: Station
    instrument: FakeInstrument
    announced: list[str]
    systemd: Told


def fresh(tmp_path, **options):
    """Return a service on free ports, with other options as given."""
    instrument, announced, systemd = FakeInstrument(), list[str](), Told()
    station = Station(instrument, Journal(tmp_path / "journal.sqlite"), box=FakeBox(), times=QUICK)
    chosen = ServiceOptions(**{"scpi_port": 0, "http_port": 0, **options})
    return Daemon(Service(station, chosen, announced.append, systemd), station, instrument, announced, systemd)


@asynccontextmanager
async def running(one, eventually):
    """Run a daemon until it is ready, and end it as systemd does."""
    task = asyncio.create_task(one.service.run())
    await eventually(lambda: one.systemd.lines or task.done())
    yield
    os.kill(os.getpid(), signal.SIGTERM)
    await task


@pytest.mark.parametrize(("stuck_s", "fed"), [(599.0, True), (600.0, False)])
async def test_the_watchdog_is_fed_unless_a_call_takes_ten_minutes(tmp_path, monkeypatch, eventually, stuck_s, fed):
    """The longest exposures and the longest patience are below; a call that takes longer never ends."""
    one = fresh(tmp_path)
    monkeypatch.setattr(type(one.station.camera), "stuck_s", stuck_s)
    async with running(one, eventually):
        if fed:
            await eventually(lambda: one.systemd.fed >= 3)
        else:
            await asyncio.sleep(0.03)
            assert one.systemd.fed == 0


async def test_start_and_stop_are_events_of_the_journal(tmp_path, monkeypatch, eventually):
    """A signal is named, and the error of a loop that ended; an alarm of descriptors ends without a client's help."""
    one = fresh(tmp_path)
    one.station.alarms.put_up("descriptors", "no file descriptor is free")
    async with running(one, eventually):
        await eventually(lambda: not one.station.alarms.active)
        one.station.annotate("lamp changed")
    other = fresh(tmp_path)
    monkeypatch.setattr(other.station, "failed_task", lambda: ValueError("the journal's disk is gone"))
    with pytest.raises(RadiometerError, match="ValueError: the journal's disk is gone"):
        await other.service.run()
    assert (other.systemd.fed, other.systemd.lines[-1], other.instrument.is_open) == (0, "stopping", False)
    own = ("start", "remark", "stop")
    events = [event for event in JournalReader(tmp_path / "journal.sqlite").events() if event["kind"] in own]
    assert [event["kind"] for event in events] == ["start", "remark", "stop", "start", "stop"]
    assert [events[number]["message"] for number in (2, 4)] == [
        "ended by SIGTERM", "the daemon ends: ValueError: the journal's disk is gone",
    ]  # fmt: skip


async def asked(path, message):
    """Return the line that a Unix socket replies."""
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(message + b"\n")
    reply = await reader.readline()
    writer.close()
    return reply


async def test_a_service_listens_reloads_and_ends_as_signals_say(tmp_path, eventually):
    """Where it listens, reloads by SIGHUP for better or worse, its state; a socket that was left is no obstacle."""
    place = tmp_path / "scpi"
    left = await asyncio.start_unix_server(lambda reader, writer: None, place)
    left.close()
    one = fresh(tmp_path, scpi_socket=place)
    instrument, announced, systemd = one.instrument, one.announced, one.systemd
    async with running(one, eventually):
        assert systemd.lines == ["ready ready"]
        assert announced[0].endswith("(no authentication: this machine may connect)")
        assert announced[1] == f"SCPI on {place}"
        assert announced[2].startswith("HTTP on http://127.0.0.1:")
        assert announced[2].endswith("(no token: this machine only)")
        assert announced[3:] == [f"journal {tmp_path / 'journal.sqlite'}"]
        assert stat.S_IMODE(place.stat().st_mode) == 0o660
        await eventually(lambda: instrument.is_open)
        assert (await asked(place, b"*IDN?")).startswith(b"Fake,F-1,4711,")
        os.kill(os.getpid(), signal.SIGHUP)
        await eventually(lambda: len(announced) == 5)
        assert announced[4] == "calibration reloaded: calibration.yaml, made 2026-11-20"
        await eventually(lambda: systemd.lines[-1] == "ready ready")
        assert "reloading" in systemd.lines

        def broken():
            raise CalibrationError("calibration.yaml: no scale")

        instrument.reload_calibration = broken
        os.kill(os.getpid(), signal.SIGHUP)
        await eventually(lambda: len(announced) == 6)
        assert announced[5] == "calibration not reloaded: calibration.yaml: no scale"
        await eventually(
            lambda: systemd.lines[-1].startswith("ready alarm: calibration not reloaded, the old one stays")
        )
        instrument.reload_calibration = lambda: "again"
        await one.station.reload_calibration()
        one.station.set_every(50.0)
        await eventually(lambda: systemd.lines[-1] == "status measuring")
    assert systemd.lines[-1] == "stopping"
    assert not place.exists()
    assert not instrument.is_open
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


async def test_a_storm_of_hangups_is_one_reload_and_one_more(tmp_path, eventually):
    """Each reload stops the camera: 100 signals within a moment stop it twice, for the last one must count."""
    one = fresh(tmp_path)
    async with running(one, eventually):
        for _ in range(100):
            os.kill(os.getpid(), signal.SIGHUP)
            await asyncio.sleep(0.001)
        await eventually(lambda: one.instrument.reloads == 2)
        await asyncio.sleep(0.05)
    assert one.instrument.reloads == 2


async def test_who_may_connect_is_announced(tmp_path, eventually):
    """Networks that are let in, that a token is needed, how pvAccess is served; nothing that was not asked for."""
    bare = fresh(tmp_path, scpi_address=None, http_address=None)
    async with running(bare, eventually):
        assert bare.announced == [f"journal {tmp_path / 'journal.sqlite'}"]
    options = {"scpi_address": "0.0.0.0", "scpi_allow": parse_networks(["10.0.0.0/8", "192.0.2.0/24"])}
    one = fresh(tmp_path, **options, token="a-secret-of-sixteen", pva=PvaOptions("lab", isolated=True))
    async with running(one, eventually):
        scpi, web, pva, journal = one.announced
    assert re.fullmatch(
        r"SCPI on 0\.0\.0\.0:\d+ \(no authentication: 10\.0\.0\.0/8, 192\.0\.2\.0/24 may connect\)", scpi
    )
    assert re.fullmatch(r"HTTP on http://127\.0\.0\.1:\d+/ \(token needed\)", web)
    assert pva.startswith("pvAccess: ")
    assert pva.endswith("(no authentication; read only)")
    assert journal == f"journal {tmp_path / 'journal.sqlite'}"


async def test_a_service_that_cannot_listen_ends_with_all_that_it_began(tmp_path):
    """A taken port is named, an address beyond loopback needs a list; what was begun is stopped, systemd notified."""
    with pytest.raises(RadiometerError, match=r"--scpi-allow \(addresses or networks\), or stay on 127\.0\.0\.1"):
        await fresh(tmp_path, scpi_address="0.0.0.0").service.run()
    taken = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    port = taken.sockets[0].getsockname()[1]
    one = fresh(tmp_path, http_address=None, scpi_port=port)
    with pytest.raises(OutputError, match=f"cannot listen for SCPI on 127.0.0.1:{port}: "):
        await one.service.run()
    assert (one.announced, one.systemd.lines) == ([], ["stopping"])
    assert not one.instrument.is_open
    taken.close()


@pytest.mark.slow
def test_the_daemon_starts_without_what_it_does_not_need():
    """scipy.stats takes longer to load than all the daemon's own modules; nothing of the daemon asks for it."""
    words = "import radiometer.daemon.service"
    code = f"import sys; {words}; print(sorted({{'scipy.stats', 'pandas', 'matplotlib', 'numba'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=within(60))
    assert done.stdout == "[]\n"


async def test_no_descriptors_are_one_alarm_and_a_few_tries_a_second():
    """Fifty clients knock while none can be taken: nothing floods, and all are served afterwards."""
    changes = []
    descriptors = Descriptors(Alarms(lambda kind, name, message: changes.append(f"{kind} {name}")))
    loop, tries, served = asyncio.get_running_loop(), 0, 0

    def take(failed, context):
        nonlocal tries
        tries += 1
        descriptors.take_error(failed, context)

    class Client(asyncio.Protocol):
        def connection_made(self, transport):
            nonlocal served
            served += 1

    loop.set_exception_handler(take)
    server = await listen(Client, "127.0.0.1", 0)
    address = server.sockets[0].getsockname()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as clients:
        try:
            waiting = [clients.enter_context(socket.socket()) for _ in range(50)]
            for one in waiting:
                one.setblocking(False)
                one.connect_ex(address)
            lowest_free = os.dup(0)
            os.close(lowest_free)
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, limits[1]))
            await asyncio.sleep(1.0)
            assert 1 <= tries <= 4
            descriptors.look()
            assert changes == ["alarm descriptors"]
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        async with asyncio.timeout(20):
            while served < 50:
                await asyncio.sleep(0.05)
        descriptors.look()
        assert changes == ["alarm descriptors", "cleared descriptors"]
    server.close()


# A clock that is set is noticed, and deletes nothing.


DAY_US, HOUR_US = 86_400_000_000, 3_600_000_000
START_US = microseconds("2026-06-01T00:00:00Z")


class Clocks:
    """A wall clock that can be set and a steady one that cannot."""

    def __init__(self, wall_us=START_US):
        self.wall, self.steady = wall_us, 0

    def go(self, us):
        self.wall += us
        self.steady += us

    @property
    def both(self):
        return lambda: self.wall, lambda: self.steady


@pytest.mark.parametrize(
    ("by_us", "message"),
    [(-45_600_000, "back by 46 s"), (119_400_000, "forward by 119 s"), (119_600_000, "forward by 2 min"),
     (7_199_000_000, "forward by 120 min"), (-9_000_000_000, "back by 2.5 h"), (172_800_000_000, "forward by 2 d")],
)  # fmt: skip
def test_a_jump_is_reported_in_the_largest_unit_it_holds_twice(by_us, message):
    """In whole seconds; minutes, hours and days from two of them on."""
    assert f"{message}, from 2026-06-01T00:00:00Z" in str(Jump(START_US, START_US + by_us))


@pytest.mark.parametrize(
    ("by_us", "reported"), [(4_900_000, False), (5_000_000, True), (-4_900_000, False), (-5_000_000, True)]
)
def test_five_seconds_are_a_jump_and_less_is_not(by_us, reported):
    """Time services move a clock in smaller steps; what was followed is not added up to a jump."""
    clocks, jumps = Clocks(), list[Jump]()
    watch = ClockWatch(jumps.append, *clocks.both)
    for _ in range(2):
        clocks.wall += by_us
        watch.look()
    assert [jump.by_us for jump in jumps] == ([by_us, by_us] if reported else [])


async def test_the_clock_is_looked_at_every_second():
    """A jump is reported at the next look, after a second at most; a day without one shows nothing."""
    clocks, reported, pauses = Clocks(), list[Jump](), list[float]()
    watch = ClockWatch(reported.append, *clocks.both)

    async def sleep(seconds):
        pauses.append(seconds)
        clocks.go(round(seconds * 1e6))
        if len(pauses) == 3:
            assert reported == []
            clocks.wall += HOUR_US
        if len(pauses) == 5:
            raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        await watch.run(sleep)
    assert (set(pauses), [jump.by_us for jump in reported]) == ({1.0}, [HOUR_US])


@pytest.mark.parametrize(
    ("off_us", "by_us"), [(0, 0), (DAY_US, 0), (DAY_US + 1, DAY_US + 1), (-1, -1), (-400 * DAY_US, -400 * DAY_US)]
)
def test_a_day_without_a_daemon_is_believed_and_no_more(off_us, by_us, tmp_path, make_reading):
    """Off for longer, or with a newest reading in the future, the pause does not count in ages."""
    newest_us = START_US - off_us
    for before_us, left in ((newest_us + by_us, 2), (newest_us + by_us + 1, 1)):
        path = tmp_path / f"{left}.sqlite"
        with Journal(path) as journal:
            journal.append([make_reading(time=iso_time(newest_us))] * 2)
            for _ in range(3):  # starts without a reading count once
                journal.note_opening(START_US)
            journal.drop_older(before_us)
        assert len(list(JournalReader(path).lines(ReadingFilter()))) == left


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_clock_did_what_is_young_stays_and_what_is_old_goes(seed, tmp_path, make_reading):
    """The clock is set, daemons come and go: what is truly younger than 30 days stays, and nothing for ever."""
    random, path = np.random.default_rng(seed), tmp_path / "j.sqlite"
    true_us, off_us, stamps = START_US, 0, list[int]()
    keep_us = 30 * DAY_US

    def drop(journal):
        journal.drop_older(true_us + off_us - keep_us)
        left = [json.loads(line)["sequence"] for line in JournalReader(path).lines(ReadingFilter())]
        assert set(left) >= {n + 1 for n, made_us in enumerate(stamps) if true_us - made_us <= keep_us}

    for _ in range(30):
        if random.random() < 0.5:
            off_us = int(random.choice([0, 400, -400, 20, -20, 3])) * DAY_US
        with Journal(path) as journal:
            journal.note_opening(true_us + off_us)
            drop(journal)
            for _ in range(int(random.integers(0, 4))):
                if random.random() < 0.2:
                    set_us = int(random.choice([0, 400, -400, 20, -20])) * DAY_US
                    journal.note_jump(set_us - off_us)
                    off_us = set_us
                true_us += int(random.integers(1, DAY_US))
                stamps.append(true_us)
                journal.append([make_reading(time=iso_time(true_us + off_us))])
                drop(journal)
        true_us += int(random.integers(1, 5 * DAY_US))
    with Journal(path) as journal:
        journal.note_opening(true_us + off_us)
        for _ in range(62):
            true_us += DAY_US // 2
            journal.append([make_reading(time=iso_time(true_us + off_us))])
        drop(journal)
    assert len(list(JournalReader(path).lines(ReadingFilter()))) == 61


def test_alarms_and_trend_stay_as_long_as_the_readings_of_their_time(tmp_path, make_reading, monkeypatch):
    """Stamped while the clock was 30 days behind: right again, an alarm and a reading go together."""
    path = tmp_path / "j.sqlite"
    behind_us = START_US - 30 * DAY_US
    monkeypatch.setattr(time, "time_ns", lambda: 1000 * (behind_us + HOUR_US))
    with Journal(path) as journal:
        journal.append([make_reading(time=iso_time(START_US))])
        journal.note_jump(-30 * DAY_US)
        journal.note("alarm", "camera lost")
        journal.append([make_reading(time=iso_time(behind_us + HOUR_US))])
        journal.note_jump(30 * DAY_US)
        journal.append([make_reading(time=iso_time(START_US + 2 * HOUR_US))] * 2)
        reader = JournalReader(path)
        for before_us, left in ((START_US + HOUR_US, 1), (START_US + HOUR_US + 1, 0)):
            assert journal.drop_older(before_us) == 1
            assert len(reader.events()) == left
            assert len(reader.trend("", behind_us, behind_us + DAY_US)) == left


async def test_a_jump_is_in_journal_and_state(station, eventually, monkeypatch):
    """An event of kind clock, and the jump in the state that the page shows."""
    assert station.status()["clock_jump"] is None
    right = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: right() - 1000 * HOUR_US)
    station.clock.look()
    assert station.status()["clock_jump"]["by_s"] == pytest.approx(-3600, abs=1)
    reader = JournalReader(station.journal_path)
    await eventually(lambda: [event["kind"] for event in reader.events()] == ["clock"])
    assert "set back by 60 min" in reader.events()[0]["message"]


async def test_a_jump_before_the_first_look_is_counted_once(instrument, tmp_path, make_reading, monkeypatch):
    """Set forward by 400 d as the daemon starts: an event, and what was measured before is a day old a day later."""
    journal, right = Journal(tmp_path / "j.sqlite"), time.time_ns
    with journal:
        journal.append([make_reading(time=iso_time(right() // 1000))] * 2)
    station = Station(instrument, journal)
    monkeypatch.setattr(time, "time_ns", lambda: right() + 400 * 1000 * DAY_US)
    await station.start()
    await station.acquisition.measure()
    station.clock.look()
    await station.stop("test")
    events = [event["kind"] for event in JournalReader(journal.path).events()]
    with journal:
        assert (events.count("clock"), journal.drop_older(time.time_ns() // 1000 + DAY_US)) == (1, 2)


def test_the_age_is_counted_by_a_clock_that_cannot_be_set():
    """A forward jump moves it once the journal has noted it, and not before; a clock set back holds it back."""
    clocks = Clocks()
    retention = RetentionClock(*clocks.both)
    clocks.go(HOUR_US)
    assert retention.now_us() == START_US + HOUR_US
    clocks.wall += 10 * DAY_US
    assert retention.now_us() == START_US + HOUR_US
    retention.follow(10 * DAY_US)
    assert retention.now_us() == START_US + HOUR_US + 10 * DAY_US
    clocks.wall = START_US - DAY_US
    assert retention.now_us() == START_US - DAY_US


@pytest.mark.parametrize(("keep_days", "expected_s"), [(30.0, [0.0, 3600.0, 7300.0]), (None, [])])
async def test_old_readings_go_at_the_start_and_every_hour(tmp_path, monkeypatch, make_reading, keep_days, expected_s):
    """Whatever wakes the writer between deletes nothing; where all are kept, nothing ever does."""

    class Steady:
        s = 0.0
        perf_counter = staticmethod(time.perf_counter)

        @classmethod
        def monotonic(cls):
            return cls.s + 500.0

    monkeypatch.setattr(journal_writer, "time", Steady)
    journal = Journal(tmp_path / "j.sqlite")
    writer = JournalWriter(journal, Alarms(lambda *_: None), lambda *_: None, keep_days=keep_days)
    dropped = []

    monkeypatch.setattr(journal, "drop_older", lambda before_us: dropped.append(Steady.s) or 0)
    await writer.open()
    running = asyncio.create_task(writer.run())
    for Steady.s in (0.0, 10.0, 3599.0, 3600.0, 5000.0, 7300.0, 7310.0):
        for _ in range(2):  # what is old goes between the first commit and the second
            await writer.submit(make_reading())
    running.cancel()
    await writer.close()
    assert dropped == expected_s


async def test_a_journal_error_is_told_not_swallowed(tmp_path, make_reading, eventually):
    """While appending fails nothing is handed out and the alarm is up; afterwards each reading comes exactly once."""
    given = []
    alarms = Alarms(lambda *_: None)
    journal = Journal(tmp_path / "j.sqlite")
    writer = JournalWriter(journal, alarms, lambda reading, *_: given.append(reading.sequence), retry_s=0.01)
    await writer.open()
    whole = journal.append

    def broken(readings):
        raise JournalError("disk full")

    journal.append = broken
    running = asyncio.create_task(writer.run())
    waiting = [writer.submit(make_reading()) for _ in range(3)]
    await eventually(lambda: alarms.active)
    assert ([alarm.name for alarm in alarms.active], given, writer.depth) == (["journal"], [], 3)
    assert "disk full" in alarms.active[0].message
    assert not any(future.done() for future in waiting)
    journal.append = whole
    assert [reading.sequence for reading in await asyncio.gather(*waiting)] == [1, 2, 3]
    await eventually(lambda: not alarms.active)
    assert given == [1, 2, 3]
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    await writer.close()


def test_pauses_do_not_add_up(tmp_path, make_reading):
    """Off for two days each week: after a year nothing is kept that was measured over 30 days of running before."""
    true_us = START_US
    with Journal(tmp_path / "j.sqlite") as journal:
        for day in range(364):
            true_us += 3 * DAY_US if day % 5 == 0 else DAY_US
            journal.note_opening(true_us)
            journal.append([make_reading(time=iso_time(true_us))])
            journal.drop_older(true_us - 30 * DAY_US)
    left = [json.loads(line)["sequence"] for line in JournalReader(tmp_path / "j.sqlite").lines(ReadingFilter())]
    assert len(left) == 1 + 30 + 30 // 4  # the pause itself is not counted: four days of every five


# The line of the health report that shows whether a daemon runs.


async def test_a_running_daemon_is_named(station):
    """Its identity is shown and all is well; in trouble it is a warning that names the alarm."""
    scpi, http = ScpiServer(station), HttpServer(station)
    ports = await scpi.listen_tcp("127.0.0.1", 0), await http.listen("127.0.0.1", 0)
    well = await asyncio.to_thread(check_daemon, *ports)
    station.alarms.put_up("calibration", "of another camera")
    troubled = await asyncio.to_thread(check_daemon, *ports)
    await http.close()
    await scpi.close()
    assert (well.check, well.health, troubled.health) == ("daemon", Health.OK, Health.WARNING)
    assert "Fake,F-1,4711" in well.message
    assert "calibration" in troubled.message


def test_no_daemon_is_a_note_with_the_way_to_start_one():
    """Not a fault: one can measure without."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    finding = check_daemon(port, port)
    assert finding.health is Health.NOTE
    assert "radiometer serve" in finding.cure


@pytest.mark.parametrize("reply", [b"Keysight,34465A,MY1,A.02\n", b""])
def test_a_stranger_on_the_port_is_named(reply):
    """Another program there, or one that says nothing, is a warning with what it stated and the way round."""
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        port = int(stranger.getsockname()[1])

        def answer():
            line, _ = stranger.accept()
            with line:
                assert line.recv(100) == b"*IDN?\n"
                line.sendall(reply)

        thread = threading.Thread(target=answer)
        thread.start()
        finding = check_daemon(port, port)
        thread.join()
    assert finding.health is Health.WARNING
    assert finding.message.endswith(f"another program: {reply.decode().strip()}")
    assert "--scpi-port" in finding.cure


@pytest.mark.slow  # waits in real time
def test_one_that_says_nothing_is_not_waited_for_long():
    """A program that takes the call and is silent is a stranger, not no one."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = int(silent.getsockname()[1])
        assert check_daemon(port, port).health is Health.WARNING
