"""What a broker is given: each patch as long as it is measured; and what happens where it acknowledges nothing."""

import asyncio
import json
from dataclasses import replace

import pytest

from radiometer.daemon.mqtt import MqttPublisher, MqttTarget
from radiometer.data import Patch
from testing.mqtt_broker import Broker

pytest.importorskip("paho.mqtt.client")
LAMP = Patch(5, 6, 7, 8)


@pytest.fixture
async def broker():
    """Return a broker and its port."""
    made = Broker()
    server = await asyncio.start_server(made.serve, "127.0.0.1", 0)
    yield made, server.sockets[0].getsockname()[1]
    server.close()


@pytest.fixture
async def published(station, broker):
    """Return a broker that held readings of an earlier daemon, and a publisher that has reached it."""
    made, port = broker
    made.retained["radiometer/4711/patch/gone/reading"] = b"{}"
    publisher = MqttPublisher(station, MqttTarget("127.0.0.1", port))
    publisher.start()
    yield made, publisher
    await publisher.stop()


async def test_each_patch_is_retained_as_long_as_it_is_measured(station, published, eventually):
    """What an earlier daemon left, what was deleted, moved or ended is cleared; a client's own is never published."""
    broker, publisher = published
    station.patches.define("a b", LAMP)
    station.patches.define("a_b", replace(LAMP, x=6))
    station.set_every(0.01)
    base = "radiometer/4711/"
    topics = {base + name for name in ("reading", "patch/a%20b/reading", "patch/a_b/reading", "state", "status")}
    await eventually(lambda: set(broker.retained) == topics)
    await station.acquisition.measure(replace(station.settings, patch=Patch(40, 1, 2, 3)), session="b")
    assert json.loads(broker.retained[base + "patch/a%20b/reading"])["patch"]["x"] == LAMP.x
    station.patches.delete("a b")
    cleared = topics - {base + "patch/a%20b/reading"}
    await eventually(lambda: set(broker.retained) == cleared)
    broker.announce(base + "patch/a%20b/reading", b"{}")  # a broker that hung gives on what waited
    await eventually(lambda: set(broker.retained) == cleared)
    station.set_every(None)
    await eventually(lambda: not station.acquisition.busy)
    station.configure(patch=LAMP)
    await eventually(lambda: set(broker.retained) == {base + name for name in ("patch/a_b/reading", "state", "status")})
    await publisher.stop()
    await eventually(lambda: broker.retained == {base + "state": b"offline"})
    read = [json.loads(line) for topic, line in broker.published if topic.endswith("/reading") and line]
    assert 40 not in {reading["patch"]["x"] for reading in read}


async def test_the_last_will_of_an_earlier_daemon_comes_late(published, eventually):
    """Its connection ended by a power cut, say: a daemon that runs is online again at once, one that ended is not."""
    broker, publisher = published
    await eventually(lambda: broker.retained.get("radiometer/4711/state") == b"online")
    broker.announce("radiometer/4711/state", b"offline")
    await eventually(lambda: broker.retained["radiometer/4711/state"] == b"online")
    await publisher.stop()
    await eventually(lambda: broker.retained["radiometer/4711/state"] == b"offline")


async def test_a_broker_that_acknowledges_nothing_is_an_alarm_until_it_has(station, published, eventually):
    """Connected is not enough: what waits, and what was dropped for want of room, is in the alarm."""
    broker, publisher = published
    publisher.acknowledged_within_s = 0.3
    await eventually(lambda: broker.retained.get("radiometer/4711/state") == b"online")
    broker.deaf = True
    await station.acquisition.measure()

    def message():
        return next((alarm.message for alarm in station.alarms.active if alarm.name == "mqtt"), "")

    await eventually(lambda: "has not acknowledged" in message())
    for number in range(1200):
        station.annotate(f"remark {number}")
        if number % 100 == 0:
            await asyncio.sleep(0.01)
    await eventually(lambda: "were dropped" in message())
    broker.hear()
    await eventually(lambda: not message())


async def test_another_daemon_of_the_same_instrument_is_an_alarm(station, published, eventually):
    """Each says who it is; the readings of two would be mixed under one topic. What it says itself is no other one."""
    broker, publisher = published
    await eventually(lambda: [payload for topic, payload in broker.published if topic.endswith("/daemon")])
    own = next(payload for topic, payload in broker.published if topic.endswith("/daemon"))
    broker.announce(f"{publisher.topic}/daemon", own)
    broker.announce("radiometer/4712/daemon", b"another")
    assert station.alarms.active == ()
    broker.announce(f"{publisher.topic}/daemon", b"another")
    await eventually(lambda: "another daemon publishes under radiometer/4711" in station.alarms.message_of("mqtt"))
    assert "mqtt" in station.troubles()
