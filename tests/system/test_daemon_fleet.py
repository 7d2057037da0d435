"""Many daemons report into one MQTT broker: Debian's mosquitto on loopback."""

import asyncio
import contextlib
import json
import shutil
import socket
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest

from radiometer.daemon.bench_instrument import BenchInstrument
from radiometer.daemon.journal import Journal
from radiometer.daemon.mqtt import MqttPublisher, MqttTarget
from radiometer.daemon.station import Station
from testing.daemon_process import DaemonProcess, write_small_bench
from testing.patience import within

INSTRUMENTS = 20


@pytest.fixture
def broker(tmp_path):
    """Return the port of a mosquitto of our own."""
    program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
    if not Path(program).exists():
        pytest.skip("mosquitto is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    settings = tmp_path / "mosquitto.conf"
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n", encoding="ascii")
    process = subprocess.Popen([program, "-c", str(settings)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    give_up = time.monotonic() + within(10.0)
    while time.monotonic() < give_up:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            break
        time.sleep(0.05)
    yield port
    process.terminate()
    process.wait()


class Subscriber:
    """Collects what is published below radiometer/."""

    def __init__(self, port):
        mqtt = pytest.importorskip("paho.mqtt.client")
        self.messages: list[tuple[str, str, bool]] = []
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe("radiometer/#", qos=1)
        self._client.on_message = lambda _c, _u, m: self.messages.append((m.topic, m.payload.decode(), bool(m.retain)))
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()

    def last(self, ending):
        """Return the newest payload per serial number of a topic."""
        return {topic.split("/")[1]: text for topic, text, _ in list(self.messages) if topic.endswith(ending)}


async def _until(condition, deadline_s=60.0):
    async with asyncio.timeout(within(deadline_s)):
        while not condition():
            await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def _stations(folder, port, count):
    stations, publishers = [], []
    for number in range(count):
        home = folder / str(number)
        home.mkdir()
        instrument = BenchInstrument(write_small_bench(home, serial=str(22500001 + number)), uncalibrated=True)
        station = Station(instrument, Journal(home / "journal.sqlite"))
        station.acquisition.settings = replace(station.settings, patch=instrument.default_patch())
        publisher = MqttPublisher(station, MqttTarget("127.0.0.1", port))
        await station.start()
        publisher.start()
        stations.append(station)
        publishers.append(publisher)
    try:
        yield stations
    finally:
        for station, publisher in zip(stations, publishers, strict=True):
            await publisher.stop()
            await station.stop()


async def test_many_instruments_report_into_one_broker(broker, tmp_path):
    """One subscriber gets three readings of each of twenty simulated instruments, each under its own topic."""
    subscriber = Subscriber(broker)
    async with _stations(tmp_path, broker, INSTRUMENTS) as stations:
        await _until(lambda: sum(text == "online" for text in subscriber.last("/state").values()) == INSTRUMENTS)
        for station in stations:
            for _ in range(3):
                await station.acquisition.measure()
        await _until(lambda: _readings_per_instrument(subscriber) == dict.fromkeys(_serials(), 3))
    await _until(lambda: set(subscriber.last("/state").values()) == {"offline"})
    subscriber.close()


def _serials():
    return [str(22500001 + number) for number in range(INSTRUMENTS)]


def _readings_per_instrument(subscriber):
    numbers: dict[str, set[int]] = {}
    for topic, text, _ in list(subscriber.messages):
        if topic.endswith("/reading") and text:  # an empty one clears what was retained
            reading = json.loads(text)
            assert reading["instrument"] == topic.split("/")[1]
            numbers.setdefault(reading["instrument"], set()).add(reading["sequence"])
    return {serial: len(found) for serial, found in numbers.items()}


async def test_the_last_reading_is_retained_and_the_will_says_offline(broker, tmp_path):
    """Who subscribes later gets the last reading at once; a limit's alarm and a daemon's end reach the broker."""
    daemon = DaemonProcess(tmp_path, "--every", "0.2", "--mqtt", f"127.0.0.1:{broker}").start()
    daemon.wait_for_reading()
    early = Subscriber(broker)
    await _until(lambda: early.last("/reading"))
    daemon.ask('SENS:PATC:LIM "main",NONE,0.001;*OPC?')
    await _until(lambda: "above its high limit 0.001" in early.last("/status").get("22500001", ""))
    daemon.kill()
    await _until(lambda: early.last("/state") == {"22500001": "offline"}, 30)
    early.close()
    late = Subscriber(broker)
    await _until(lambda: late.last("/reading") and late.last("/state"))
    assert late.last("/state") == {"22500001": "offline"}
    assert all(retained for _, _, retained in late.messages)
    late.close()


async def test_a_broker_that_is_away_is_an_alarm_not_an_end(tmp_path):
    """Measuring goes on, and the state says what is wrong."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    with DaemonProcess(tmp_path, "--every", "0.1", "--mqtt", f"127.0.0.1:{port}") as daemon:
        daemon.wait_for_reading()
        await _until(lambda: [alarm["name"] for alarm in daemon.get("/status")["alarms"]] == ["mqtt"], 20)
        assert daemon.stop() == 0
