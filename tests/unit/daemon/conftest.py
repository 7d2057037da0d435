"""A running station on a fake instrument and light box, its servers and clients."""

import asyncio
from dataclasses import replace

import pytest

from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.journal import Journal
from radiometer.daemon.scpi.server import ScpiServer
from radiometer.daemon.station import Station
from radiometer.data import Patch, Quantity, Reading
from testing.fake_station import PORTS, QUICK, FakeBox, FakeInstrument, HttpClient, LineClient
from testing.patience import within
from testing.watched_sqlite import watch


@pytest.fixture
def instrument():
    """Return a fake instrument, not yet open."""
    return FakeInstrument()


@pytest.fixture
def box():
    """Return a fake light box, not yet open."""
    return FakeBox()


@pytest.fixture
async def station(instrument, box, tmp_path):
    """Return a running station on the fakes."""
    running = Station(instrument, Journal(tmp_path / "journal.sqlite"), box=box, times=QUICK)
    await running.start()
    yield running
    await running.stop()


@pytest.fixture
def connections(monkeypatch):
    """Return the connections to SQLite that are opened from now on."""
    return watch(monkeypatch)


@pytest.fixture
def make_reading():
    """Return a maker of readings."""
    template = Reading(Quantity(1.0, 0.01, "W sr-1 m-2"), Patch(0, 0, 10, 10), "4711")
    return lambda **changes: replace(template, **changes)


@pytest.fixture
def eventually():
    """Return a wait for a condition, 20 s unless stated otherwise."""

    async def wait(condition, deadline_s=20.0):
        async with asyncio.timeout(within(deadline_s)):
            while not condition():
                await asyncio.sleep(0.005)

    return wait


@pytest.fixture
async def scpi(station):
    """Return an SCPI server on a free loopback port."""
    server = ScpiServer(station)
    PORTS[server] = await server.listen_tcp("127.0.0.1", 0)
    yield server
    await server.close()


@pytest.fixture
async def connect(scpi):
    """Return a maker of clients of that server."""
    clients = []

    async def make():
        clients.append(LineClient(*await asyncio.open_connection("127.0.0.1", PORTS[scpi], limit=2**22)))
        return clients[-1]

    yield make
    for client in clients:
        client.writer.close()


@pytest.fixture
async def client(connect):
    """Return one client whose error queue is empty."""
    line_client = await connect()
    await line_client.send("*CLS")
    return line_client


@pytest.fixture
async def serve(station):
    """Return a starter of HTTP servers, each with options of its own, that gives a client."""
    servers = []

    async def start(**options):
        server = HttpServer(station, **options)
        servers.append((server, HttpClient(await server.listen("127.0.0.1", 0))))
        return servers[-1][1]

    yield start
    for server, client in servers:
        await client.session.close()
        await server.close()


@pytest.fixture
async def http(serve):
    """Return a client of a server with default limits."""
    return await serve()
