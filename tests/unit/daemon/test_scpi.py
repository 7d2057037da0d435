"""The SCPI server: parsing, errors, status, and every example of the manual."""

import json
import logging
import socket
import threading

import pytest
import structlog
from hypothesis.stateful import run_state_machine_as_test

from radiometer.daemon.limits import Limits
from radiometer.daemon.scpi.commands import command_table
from radiometer.daemon.scpi.document import manual
from radiometer.daemon.scpi.server import ScpiServer, is_other_protocol
from radiometer.errors import OutputError
from testing.scpi_machine import ScpiMachine, machine_settings

TABLE = command_table()


async def test_the_example_of_every_command_runs(client):
    """Each example gives as many replies as it has queries and leaves no error."""
    for command in TABLE.commands:
        await client.send("*RST;*CLS")
        if queries := command.example.count("?"):
            assert (await client.ask(command.example)).count(";") >= queries - 1, command
        else:
            await client.send(command.example)
        assert await client.ask(":SYST:ERR?") == '0,"No error"', command


def test_every_spelling_is_understood_and_looks_like_no_http():
    """Short and long forms of every node, in small letters too, are found; no spelling is taken for a stranger's."""
    for command in TABLE.commands:
        assert not is_other_protocol(command.example.encode() + b"\n"), command
        for spelling in command.spellings():
            for header in (spelling.replace("<n>", "2"), spelling.replace("<n>", "").lower()):
                assert TABLE.find(header, "")[0] is command
                sent = f"{header} 1,2,3,4\n:{header}? MAX\n".encode()
                assert not is_other_protocol(sent), spelling


def test_the_manual_is_up_to_date(project_root):
    """docs/reference/scpi.md is what the command table says, and the limits that it states are those in force."""
    page, limits = (project_root / "docs/reference/scpi.md").read_text(encoding="utf-8"), Limits()
    assert page == manual()
    assert f"{limits.scpi_connections} connections, {limits.line_bytes} bytes per message" in page
    assert f"{limits.messages_per_s:g} messages per second" in page
    assert f"{limits.stuck_s:g} s" in page


async def test_value_and_uncertainty_come_together(client, station):
    """MEAS:RAD? replies value,u, UNC? the same u; FETC:JSON? is the journal's line in a block."""
    reply = await client.ask("READ?;:FETC:JSON?")
    line = reply[reply.index("{") :]
    assert json.loads(line) == station.shown.latest.to_mapping()
    value, u, again = (await client.ask("MEAS:RAD? 5,6,7,8;:FETC:UNC?")).replace(";", ",").split(",")
    assert (float(value), float(u), float(again)) == (6.0, 0.01, 0.01)


async def test_a_patch_is_given_shared_or_the_middle(client, instrument):
    """Four numbers are this measurement's own, CENT is the middle, none is the shared patch."""
    await client.send("SENS:PATC 7,8,9,10")
    for arguments, x in ((" 5,6,7,8", 5), ("", 7), (" CENT", 16)):
        assert float((await client.ask(f"MEAS:RAD?{arguments}")).split(",")[0]) == 1.0 + x
    assert await client.ask("SENS:PATC?") == "7,8,9,10"


async def test_what_precedes_an_error_is_executed_and_what_follows_is_not(client):
    """A command error throws the rest of a message away, an execution error does not; paths go on without a colon."""
    assert await client.ask("SENS:GAIN 3;GAIN?;NONSENSE;GAIN 9") == "3.000000000E+00"
    assert await client.ask(":SENS:GAIN?") == "3.000000000E+00"
    assert await client.ask("SENS:GAIN 99;GAIN 12;GAIN?") == "1.200000000E+01"
    assert await client.ask("SENS:GAIN 6;*OPC?;GAIN?;EXP:AUTO?;AUTO?;:SYST:VERS?") == "1;6.000000000E+00;1;1;1999.0"


async def test_init_overlaps_and_opc_reports_when_it_is_over(client, instrument):
    """INIT returns at once, a second one is ignored (-213), *OPC? waits, FETC? replies."""
    instrument.let_go = threading.Event()
    await client.send("INIT;INIT")
    assert int(await client.ask("STAT:OPER:COND?")) & 16
    assert (await client.ask("SYST:ERR?")).startswith("-213")
    instrument.let_go.set()
    assert await client.ask("*OPC?") == "1"
    assert int(await client.ask("STAT:OPER:COND?")) & 16 == 0
    assert len((await client.ask("FETC?")).split(",")) == 2


async def test_a_lost_camera_reaches_the_error_queue_and_the_status(connect, instrument, eventually, station):
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
    station.refresh_metrics()
    assert b'radiometer_device_up{device="camera"} 0.0' in station.metrics.render()


async def test_light_levels_are_set_by_number(client, box):
    """SOUR:LED2 is the second channel; 50 PCT is 0.5, MAX full light, MIN and DEF darkness; 1.01 is refused."""
    assert float(await client.ask("SOUR:LED2:LEV 50 PCT;LEV?")) == 0.5
    assert float(await client.ask("SOUR:LED:LEV?")) == 0.0
    assert box.levels == {"white": 0.0, "red": 0.5}
    await client.send("SOUR:LED:LEV 0.1;:SOUR:LED:OFF")
    assert await client.ask("SOUR:LED:CAT?") == '"white","red"'
    assert box.levels == {"white": 0.0, "red": 0.0}
    assert float(await client.ask("SOUR:LED1:LEV MAX;LEV?")) == box.levels["white"] == 1.0
    await client.send("SOUR:LED1:LEV DEF;:SOUR:LED2:LEV MIN;:SOUR:LED1:LEV 1.01")
    assert (await client.ask("SYST:ERR?")).endswith('outside 0 to 1"')
    assert box.levels == {"white": 0.0, "red": 0.0}


async def test_settings_are_shared_and_status_is_not(connect):
    """One client's gain is the other's; its errors are its own."""
    one, other = await connect(), await connect()
    await one.send("NONSENSE")
    assert await one.ask("SENS:GAIN 5;*OPC?") == "1"
    assert float(await other.ask("SENS:GAIN?")) == 5.0
    assert await other.ask("SYST:ERR?") == '0,"No error"'


async def test_self_test_counts_faults(client, instrument):
    """0 is passed; a fault is counted and queued."""
    assert await client.ask("*TST?") == "0"
    instrument.failing = True
    assert await client.ask("*TST?") == "1"
    assert "dark level" in await client.ask("SYST:ERR?")


async def test_what_another_program_uses_is_never_removed(station, tmp_path):
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


# Random sequences of SCPI messages: the daemon lives through all of them.


@pytest.fixture
def quiet():
    """Keep a thousand warnings about lost devices out of the report."""
    before = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    yield
    structlog.configure(**before)


@pytest.mark.slow
@pytest.mark.usefixtures("quiet")
def test_no_sequence_of_messages_ends_the_daemon():
    """All commands, right and wrong, of three sessions, while camera and light box fail and come back."""
    run_state_machine_as_test(ScpiMachine, settings=machine_settings(15))
