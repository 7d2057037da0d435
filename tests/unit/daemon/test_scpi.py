"""The SCPI server: parsing, errors, status, and every example of the manual."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import sqlite3
import struct
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from radiometer.daemon.limits import Limits
from radiometer.daemon.scpi.document import manual
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.lexer import Argument, Kind, block_end, split_message
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.scpi.table import command_table
from radiometer.daemon.station import Station
from radiometer.errors import OutputError, UsageError
from testing.patience import within

Eventually = Callable[..., Awaitable[None]]
TABLE = command_table()


@pytest.mark.parametrize("command", TABLE.commands, ids=lambda command: command.pattern)
async def test_the_example_of_every_command_runs(client: Any, command: Any) -> None:
    """Each example gives as many replies as it has queries and leaves no error."""
    queries = command.example.count("?")
    if queries:
        reply = await client.ask(command.example)
        assert reply
        assert reply.count(";") >= queries - 1
    else:
        await client.send(command.example)
    assert await client.ask("SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize("command", TABLE.commands, ids=lambda command: command.pattern)
def test_every_spelling_is_understood(command: Any) -> None:
    """Short and long forms of every node, in small letters too, are all found."""
    for spelling in command.spellings():
        for header in (spelling.replace("<n>", "2"), spelling.replace("<n>", "").lower()):
            assert TABLE.find(header, "")[0] is command


def test_the_manual_is_up_to_date(project_root: Path) -> None:
    """docs/reference/scpi.md is what the command table says."""
    assert (project_root / "docs/reference/scpi.md").read_text(encoding="utf-8") == manual()


def test_no_default_limit_differs_from_the_manual() -> None:
    """The limits that the manual states are those in force."""
    limits = Limits()
    assert (limits.scpi_connections, limits.line_bytes, limits.messages_per_s, limits.stuck_s) == (
        256,
        4096,
        1000.0,
        30.0,
    )


@pytest.mark.parametrize(
    ("message", "number"),
    [
        ("NO:SUCH?", -113),
        ("SENS:EXP:TIME", -109),
        ("SENS:EXP 1,2", -108),
        ("SENS:EXP 100", -222),
        ("SENS:EXP 1 KG", -131),
        ("SENS:PATC 1 MM,2,3,4", -138),
        ("SENS:EXP ABC", -141),
        ("SENS:EXP 'abc'", -104),
        ("SENS:EXP #15hello", -104),
        ("SENS:EXP 'abc", -151),
        ("SENS:EXP #Z", -161),
        ("SENS:EXP 1e400", -222),
        ("TRAC:DATA? NONSENSE", -224),
        ("SENS:PATC 60,40,20,20", -222),
        ("SENS:PATC 1,2", -109),
        ("*IDN", -113),
        ("SENS:EXP4", -113),
        ("SOUR:LED9:LEV?", -114),
        ("@", -101),
        ("4", -102),
        ("*IDN?SYST:VERS?", -103),
        ("SENS:EXP 1 2", -103),
        ("SENSITIVITYOFX:EXP 1", -113),
        ("SENSITIVITYOFXYZ:EXP 1", -112),
        ("FETC?", -230),
    ],
)
async def test_each_mistake_has_its_error_number(client: Any, message: str, number: int) -> None:
    """A wrong message gives exactly one entry with the standard's number and no reply."""
    await client.send(message)
    assert (await client.ask("SYST:ERR?")).startswith(f"{number},")
    assert await client.ask("SYST:ERR?") == '0,"No error"'


async def test_value_and_uncertainty_come_together(client: Any) -> None:
    """MEAS:RAD? replies value,u; UNC? of the same message is that u."""
    value, u, again = (await client.ask("MEAS:RAD? 5,6,7,8;:FETC:UNC?")).replace(";", ",").split(",")
    assert (float(value), float(u), float(again)) == (6.0, 0.01, 0.01)


async def test_a_patch_is_given_shared_or_the_middle(client: Any, instrument: Any) -> None:
    """Four numbers are this measurement's own, CENT is the middle, none is the shared patch."""
    await client.send("SENS:PATC 7,8,9,10")
    for arguments, x in ((" 5,6,7,8", 5), ("", 7), (" CENT", 16)):
        assert float((await client.ask(f"MEAS:RAD?{arguments}")).split(",")[0]) == 1.0 + x
    assert await client.ask("SENS:PATC?") == "7,8,9,10"


async def test_compounds_follow_the_path_of_the_header_before(client: Any) -> None:
    """A header without leading colon continues in the subsystem; common commands do not change it."""
    assert await client.ask("SENS:GAIN 6;*OPC?;GAIN?;EXP:AUTO?;AUTO?;:SYST:VERS?") == "1;6.000000000E+00;1;1;1999.0"


async def test_units_scale_and_limits_can_be_asked_for(client: Any) -> None:
    """4 MS is 0.004 s; MIN and MAX are the camera's."""
    assert float(await client.ask("SENS:EXP 4 MS;EXP?")) == 0.004
    assert await client.ask("SENS:EXP:AUTO?") == "0"
    assert float(await client.ask("SENS:EXP? MAX")) == 30.0
    await client.send("SENS:CORR:WAV 0.55 UM")
    assert float(await client.ask("SENS:CORR:WAV?")) == pytest.approx(550.0)


async def test_what_precedes_an_error_is_executed_and_what_follows_is_not(client: Any) -> None:
    """A command error throws the rest of the message away; an execution error does not."""
    assert await client.ask("SENS:GAIN 3;GAIN?;NONSENSE;GAIN 9") == "3.000000000E+00"
    assert await client.ask(":SENS:GAIN?") == "3.000000000E+00"
    assert await client.ask("SENS:GAIN 99;GAIN 12;GAIN?") == "1.200000000E+01"


async def test_init_overlaps_and_opc_reports_when_it_is_over(client: Any, instrument: Any) -> None:
    """INIT returns at once, a second one is ignored (-213), *OPC? waits, FETC? replies."""
    instrument.let_go = threading.Event()
    await client.send("INIT;INIT")
    assert int(await client.ask("STAT:OPER:COND?")) & 16
    assert (await client.ask("SYST:ERR?")).startswith("-213")
    instrument.let_go.set()
    assert await client.ask("*OPC?") == "1"
    assert int(await client.ask("STAT:OPER:COND?")) & 16 == 0
    assert len((await client.ask("FETC?")).split(",")) == 2


async def test_opc_sets_its_bit_and_esr_clears_itself(client: Any) -> None:
    """*OPC sets bit 0 when nothing is pending; reading the register clears it."""
    await client.send("*ESR?;*OPC")
    await client.reader.readline()
    assert await client.ask("*ESR?") == "1"
    assert await client.ask("*ESR?") == "0"


async def test_status_byte_sums_up_errors_and_events(client: Any) -> None:
    """An error sets bit 2, through *ESE bit 5, through *SRE bit 6."""
    await client.send("*ESE 32;*SRE 32;NO:SUCH")
    assert int(await client.ask("*STB?")) == 4 + 32 + 64


async def test_the_error_queue_overflows_as_the_standard_says(client: Any) -> None:
    """The last entry becomes -350 and the oldest are kept."""
    for _ in range(40):
        await client.send("NO:SUCH")
    entries = (await client.ask("SYST:ERR:ALL?")).split('",')
    assert len(entries) == 32
    assert entries[-1].startswith("-350")


async def test_a_lost_camera_reaches_the_error_queue_and_the_status(
    connect: Any, instrument: Any, eventually: Eventually, station: Station
) -> None:
    """Every client finds -240 and the questionable bit."""
    clients = [await connect() for _ in range(3)]
    for one in clients:
        assert await one.ask("*CLS;*OPC?") == "1"
    instrument.unplugged = True
    await eventually(lambda: station.alarms.active)
    for one in clients:
        assert (await one.ask("SYST:ERR?")).startswith("-240")
        assert int(await one.ask("STAT:QUES:COND?")) & 512
        assert await one.ask("READ?;*OPC?") == "1"
        assert (await one.ask("SYST:ERR?")).startswith("-240")


async def test_pictures_and_history_come_as_blocks(client: Any) -> None:
    """Lengths and bytes are those of the frame and the journal, in the byte order asked for."""
    await client.send("READ?;:FORM:BORD SWAP;:TRAC:DATA? IMAG")
    await client.reader.readuntil(b";")
    header = await client.reader.readexactly(2 + 4)
    assert header == b"#46144"
    picture = await client.reader.readexactly(6144)
    assert await client.reader.readexactly(1) == b"\n"
    assert struct.unpack("<3072H", picture) == tuple(range(3072))
    await client.send("TRAC:DATA? HIST,5")
    assert await client.reader.readexactly(4) == b"#224"
    assert struct.unpack("<3d", await client.reader.readexactly(24)) == (1.0, 17.0, 0.01)
    await client.reader.readline()


async def test_the_json_of_a_reading_is_the_documented_line(client: Any, station: Station) -> None:
    """FETC:JSON? is the journal's line in a block."""
    reply = await client.ask("READ?;:FETC:JSON?")
    line = reply[reply.index("{") :]
    assert station.shown.latest is not None
    assert json.loads(line) == station.shown.latest.to_mapping()


async def test_light_levels_are_set_by_number(client: Any, box: Any) -> None:
    """SOUR:LED2 is the second channel; a fraction may be given in per cent."""
    assert float(await client.ask("SOUR:LED2:LEV 50 PCT;LEV?")) == 0.5
    assert float(await client.ask("SOUR:LED:LEV?")) == 0.0
    assert box.levels == {"white": 0.0, "red": 0.5}
    await client.send("SOUR:LED:LEV 0.1;:SOUR:LED:OFF")
    assert await client.ask("SOUR:LED:CAT?") == '"white","red"'
    assert box.levels == {"white": 0.0, "red": 0.0}


async def test_settings_are_shared_and_status_is_not(connect: Any) -> None:
    """One client's gain is the other's; its errors are its own."""
    one, other = await connect(), await connect()
    await one.send("NONSENSE")
    assert await one.ask("SENS:GAIN 5;*OPC?") == "1"
    assert float(await other.ask("SENS:GAIN?")) == 5.0
    assert await other.ask("SYST:ERR?") == '0,"No error"'


@pytest.mark.slow
async def test_a_blocked_journal_is_a_mass_storage_error(client: Any, station: Station, eventually: Eventually) -> None:
    """A reading that cannot be committed is not shown: -250 in its stead."""
    station.acquisition.journal_patience_s = 0.2
    other = sqlite3.connect(station.journal_path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    await client.send("INIT")
    await eventually(lambda: station.alarms.active)
    assert (await client.ask("SYST:ERR?")).startswith("-250")
    assert int(await client.ask("STAT:QUES:COND?")) & 4096
    await client.send("ABOR;:READ?")
    await eventually(lambda: True)
    assert (await client.ask("SYST:ERR?")).startswith("-250")
    other.execute("ROLLBACK")
    other.close()


async def test_self_test_counts_faults(client: Any, instrument: Any) -> None:
    """0 is passed; a fault is counted and queued."""
    assert await client.ask("*TST?") == "0"
    instrument.failing = True
    assert await client.ask("*TST?") == "1"
    assert "dark level" in await client.ask("SYST:ERR?")


def test_a_newline_inside_a_block_is_data() -> None:
    """Framing looks past a block, but not past a '#' in a string."""
    assert block_end(b"SENS:EXP #14a\nbc\n", 13) == 16
    assert block_end(b'SENS:EXP "#14a\nbc"\n', 14) == 14
    assert block_end(b"SENS:EXP #1x\nbc\n", 12) == 12
    units, error = split_message("A:B #14a\nbc;*IDN?")
    assert error is None
    assert units[0].arguments == (Argument(Kind.BLOCK, "a\nbc"),)
    assert units[1].header == "*IDN"


async def test_a_line_without_end_is_refused_and_then_dropped(client: Any) -> None:
    """Beyond the limit an overrun (-363) is queued; the next line is fine; an endless one ends the connection."""
    await client.send("X" * 9000)
    assert (await client.ask("SYST:ERR?")).startswith("-363")
    client.writer.write(b"Y" * 200_000)
    with contextlib.suppress(ConnectionResetError):
        assert await client.reader.read() == b""


async def test_a_client_that_does_not_finish_its_line_is_dropped(station: Station) -> None:
    """Half a message may not hold a connection for ever."""
    server = ScpiServer(station, limits=Limits(stuck_s=0.2))
    port = await server.listen_tcp("127.0.0.1", 0)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"*IDN")
    async with asyncio.timeout(within(20.0)):
        with contextlib.suppress(ConnectionResetError):
            assert await reader.read() == b""
    writer.close()
    await server.close()


async def test_a_client_that_takes_no_replies_is_dropped(station: Station, eventually: Eventually) -> None:
    """Replies that are not read stop the execution, then end the connection; memory stays bounded."""
    server = ScpiServer(station, limits=Limits(stuck_s=0.3, reply_bytes_waiting=10_000))
    port = await server.listen_tcp("127.0.0.1", 0)
    await station.acquisition.measure()
    _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
    writer.write(b"TRAC:DATA? IMAG\n" * 5000)
    await eventually(lambda: len(server.connections) == 1)
    await eventually(lambda: len(server.connections) == 0)
    writer.close()
    await server.close()


async def test_connections_are_limited(station: Station, eventually: Eventually) -> None:
    """One too many is closed at once; those that are there go on."""
    server = ScpiServer(station, limits=Limits(scpi_connections=2))
    port = await server.listen_tcp("127.0.0.1", 0)
    streams = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
    await eventually(lambda: len(server.connections) == 2)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    with contextlib.suppress(ConnectionResetError):
        assert await reader.read() == b""
    streams[0][1].write(b"*OPC?\n")
    assert await streams[0][0].readline() == b"1\n"
    for _, one in [*streams, (reader, writer)]:
        one.close()
    await server.close()


@pytest.mark.slow
async def test_a_rate_above_the_limit_is_delayed_not_refused(station: Station) -> None:
    """At 50 messages/s allowed, 100 take about a second beyond the burst, and all are answered."""
    server = ScpiServer(station, limits=Limits(messages_per_s=50.0))
    port = await server.listen_tcp("127.0.0.1", 0)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    started = asyncio.get_running_loop().time()
    writer.write(b"*OPC?\n" * 100)
    for _ in range(100):
        assert await reader.readline() == b"1\n"
    assert 0.9 < asyncio.get_running_loop().time() - started < within(3.0)
    writer.close()
    await server.close()


async def test_other_addresses_need_an_allow_list(station: Station) -> None:
    """SCPI has no authentication, so an open address without a list is refused."""
    server = ScpiServer(station)
    with pytest.raises(UsageError, match="--scpi-allow"):
        await server.listen_tcp("0.0.0.0", 0)
    await server.close()


async def test_a_unix_socket_serves_too(scpi: ScpiServer, tmp_path: Path) -> None:
    """The same table behind a socket file; one that a killed daemon left behind is replaced."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as killed:
        killed.bind(str(tmp_path / "scpi.sock"))
    await scpi.listen_unix(tmp_path / "scpi.sock")
    reader, writer = await asyncio.open_unix_connection(tmp_path / "scpi.sock")
    writer.write(b"*IDN?\r\n")
    assert (await reader.readline()).startswith(b"Fake,F-1,4711,radiometer ")
    assert (tmp_path / "scpi.sock").stat().st_mode & 0o777 == 0o660
    writer.close()


async def test_what_another_program_uses_is_never_removed(station: Station, tmp_path: Path) -> None:
    """A socket that is listened on and a file stay at the start; at the end, what another put in our place stays."""
    file, busy, ours = tmp_path / "file", tmp_path / "busy.sock", tmp_path / "ours.sock"
    file.write_text("precious")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listening:
        listening.bind(str(busy))
        listening.listen()
        for path in (file, busy):
            with pytest.raises(OutputError, match="name another path"):
                await ScpiServer(station).listen_unix(path)
        assert busy.is_socket()
    server = ScpiServer(station)
    await server.listen_unix(ours)
    ours.rename(tmp_path / "kept")
    ours.write_text("another's")
    await server.close()
    assert (file.read_text(), ours.read_text()) == ("precious", "another's")


def test_error_entries_are_ascii_and_short() -> None:
    """A message of ours fits the standard's form."""
    entry = ScpiError(-240, 'camera "x" lost: 5 × µ' + "y" * 500).entry
    assert entry.isascii()
    assert len(entry) < 270
