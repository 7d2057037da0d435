"""Devices that come and go: the camera on the wire, and the light box on a pseudo-terminal."""

import pytest

from benchmarks import daemon_loss
from radiometer.daemon.keeper import KeeperTimes
from radiometer.errors import DeviceError, SettingOutOfRange
from testing.box_station import OPTICS, box_station, seconds_until
from testing.daemon_process import DaemonProcess

# How often an idle box is asked and a lost one looked for: what twenty losses show does not depend on it.
QUICK = KeeperTimes(first_pause_s=0.02, longest_pause_s=0.1, check_every_s=0.1)


@pytest.mark.long
def test_a_camera_on_the_wire_is_lost_and_found():
    """One cycle here, twenty and their times in the benchmark: every client is notified, and readings come again."""
    pytest.importorskip("gi")
    result = daemon_loss.run(1)
    assert len(result.reported_s) == len(result.recovered_s) == 1


async def test_the_light_box_is_set_through_its_driver(tmp_path):
    """A level reaches the LED; above the channel's range it is refused; stopping leaves the box dark."""
    async with box_station(tmp_path) as (station, _, twin):
        assert set(station.light.levels) >= set(OPTICS)
        level = await station.light.set_level("spot", 0.25)
        assert level == pytest.approx(0.25, abs=1e-4)
        await seconds_until(lambda: abs(twin.duty("spot") - 0.25) < 0.01)
        with pytest.raises(SettingOutOfRange):
            await station.light.set_level("spot", 1.5)
    assert twin.duty("spot") == 0.0


@pytest.mark.long
async def test_a_light_box_is_unplugged_and_replugged_twenty_times(tmp_path):
    """Each loss is reported and refuses levels; after each return the levels are dark, and that is an alarm."""
    async with box_station(tmp_path, QUICK) as (station, server, _):
        for _ in range(20):
            await station.light.set_level("fixation", 0.1)
            server.unplug()
            await seconds_until(lambda: [alarm.name for alarm in station.alarms.active] == ["light box"])
            with pytest.raises(DeviceError):
                await station.light.set_level("fixation", 0.2)
            server.plug()
            await seconds_until(lambda: [alarm.name for alarm in station.alarms.active] == ["light fixation"])
            assert set(station.light.levels.values()) == {0.0}
        assert station.light.keeper is not None
        assert station.light.keeper.losses == 20


def test_serve_drives_the_simulated_box(tmp_path):
    """`--box sim`: channels by name and number, levels read back, dark on request."""
    with DaemonProcess(tmp_path, "--box", "sim") as daemon:
        assert daemon.ask("SOUR:LED:CAT?") == '"bleach","spot","spot_red","fixation","spot_green","field"'
        assert float(daemon.ask("SOUR:LED2:LEV 0.01;LEV?")) == pytest.approx(0.01, abs=1e-4)
        assert daemon.get("/status")["light"]["spot"] == pytest.approx(0.01, abs=1e-4)
        assert daemon.post("/light", {"channel": "spot", "level": 0})["level"] == 0
        assert daemon.ask("SOUR:LED9:LEV?\nSYST:ERR?").startswith("-114")
