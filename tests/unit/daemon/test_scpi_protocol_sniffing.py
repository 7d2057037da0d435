"""What speaks HTTP or TLS to the SCPI port is hung up on before anything is executed."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

import pytest

from radiometer.daemon.scpi.server import is_other_protocol
from radiometer.daemon.scpi.table import command_table
from testing.fake_station import PORTS
from testing.patience import within

Eventually = Callable[..., Awaitable[None]]
LIGHTING = b"SOUR:LED1:LEV 0.9\nSENS:EXP 0.002\nSENS:PATC 1,2,3,4\nINIT:CONT ON\n"


async def _throw(server, *parts):
    """Send parts one after the other and return what comes back until the server hangs up."""
    reader, writer = await asyncio.open_connection("127.0.0.1", PORTS[server])
    try:
        for part in parts:
            writer.write(part)
            await writer.drain()
            await asyncio.sleep(0.01)
        async with asyncio.timeout(within(20)):
            return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def _unchanged(station, box):
    settings = station.settings
    dark = set(box.levels.values()) == {0.0}
    return dark and settings.auto_exposure and settings.patch is None and station.acquisition.every_s is None


@pytest.mark.parametrize(
    "beginning",
    [
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n",
        b"OPTIONS / HTTP/1.1\r\n",
        b"QUERY / HTTP/1.1\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"\r\n\r\nPOST / HTTP/1.1\r\n",
        b"\x00\x01garbage\n \tPOST / HTTP/1.1\r\n",
        b"\xff\xfe\n\nget / http/1.1\n",
        b"*IDN?\nHost: 127.0.0.1:5025\n",
        b"*CLS\nContent-Length: 20\n",
        b"*CLS\nsec-fetch-mode:no-cors\n",
        b"\x16\x03\x01\x02\x00\x01\n",
        b"*CLS\n\x16\x03\x01\n",
    ],
)
async def test_http_and_tls_light_nothing(scpi, station, box, eventually, beginning):
    """Whatever comes before the request, what follows it in the same connection is never executed."""
    await _throw(scpi, beginning + LIGHTING)
    await eventually(lambda: not scpi.connections)
    assert _unchanged(station, box)


async def test_a_request_in_pieces_lights_nothing(scpi, station, box):
    """The request line is known by its first word, before its end has come."""
    assert await _throw(scpi, b"PO", b"ST / HT", b"TP/1.1\r\n", LIGHTING) == b""
    assert _unchanged(station, box)


async def test_a_first_line_that_lights_waits_for_what_follows(scpi, box):
    """A lighting line sent ahead of HTTP, even in a packet of its own, is never executed."""
    await _throw(scpi, b"SOUR:LED1:LEV 0.9\n", b"POST / HTTP/1.1\r\n", b"\r\n")
    await _throw(scpi, b"*CLS\nSOUR:LED1:LEV 0.9\nHost: x\n")
    await asyncio.sleep(2 * scpi.limits.vetting_s)
    assert set(box.levels.values()) == {0.0}


async def test_a_client_of_ours_lights_after_the_pause(client, box):
    """The pause ends by itself, and lines keep their order across it."""
    assert float(await client.ask("SOUR:LED2:LEV 0.5\nSOUR:LED2:LEV?")) == 0.5
    assert box.levels["red"] == 0.5


@pytest.mark.parametrize("command", command_table().commands, ids=lambda command: command.pattern)
def test_no_command_of_ours_looks_like_http(command):
    """No example, and no spelling with arguments or as a query, is taken for a stranger's."""
    assert not is_other_protocol(command.example.encode() + b"\n")
    for spelling in command.spellings():
        header = spelling.replace("<n>", "1").encode()
        assert not is_other_protocol(header + b" 1,2,3,4\n" + b":" + header.lower() + b"? MAX\n")
