"""The box as a stage: what is lit, for how long, and whose presses count."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from radiometer.adaptation.box_setup import BoxLights, BoxStage
from radiometer.adaptation.protocol import read_protocol
from radiometer.devices.light_box import ButtonEvent, Radiance
from radiometer.errors import UsageError


class RecordingBox:
    """A box that notes what it is asked and hands out presses that were laid down."""

    def __init__(self) -> None:
        self.asked: list[tuple[object, ...]] = []
        self.presses: list[float] = []
        self.held: list[tuple[float, float]] = []
        self.time = 100.0

    def pulse(self, channel: str, level: Radiance, duration_s: float) -> None:
        self.asked.append((channel, level.radiance_w_sr_m2, duration_s))

    def set_level(self, channel: str, level: Radiance) -> None:
        self.asked.append((channel, level.radiance_w_sr_m2))

    def buttons(self, timeout_s: float) -> Iterator[ButtonEvent]:
        self.time += timeout_s
        for number, time_s in enumerate(self.presses):
            yield ButtonEvent(True, time_s, 1e-4, time_s, number)
            yield ButtonEvent(False, time_s + 0.1, 1e-4, time_s + 0.1, number + 1)
        for begun_s, ended_s in self.held:
            yield ButtonEvent(True, begun_s, 1e-4, begun_s, 0)
            if ended_s <= self.time:
                yield ButtonEvent(False, ended_s, 1e-4, ended_s, 1)


@pytest.fixture
def box() -> RecordingBox:
    return RecordingBox()


@pytest.fixture
def stage(box: RecordingBox) -> BoxStage:
    def sleep(seconds: float) -> None:
        box.time += seconds

    lights = BoxLights(read_protocol("led-only"), 300.0, 600.0, 900.0, fixation_w_sr_m2=1e-4)
    return BoxStage(box, lights, lambda: box.time, sleep)  # type: ignore[arg-type]


def test_bleach_is_the_protocols_light_and_then_the_mark(stage: BoxStage, box: RecordingBox) -> None:
    """300 cd/m² at 300 lm/W are 1 W/sr/m² for 120 s; the red mark follows."""
    stage.bleach(stage.lights.protocol)
    assert box.asked == [("bleach", pytest.approx(2.5), 150.0), ("fixation", 1e-4)]
    assert stage.now_s() == pytest.approx(150.0)


def test_blink_is_one_pulse_of_the_levels_radiance(stage: BoxStage, box: RecordingBox) -> None:
    """-3 log scotopic cd/m² behind a filter of density 3 at 900 lm/W, for the protocol's 0.3 s, in a cycle of 1 s."""
    stage.blink(-3.0, 0, 0)
    assert box.asked == [("spot", pytest.approx(1.0 / 900), 0.3)]
    assert stage.now_s() == pytest.approx(1.0)


def test_presses_count_from_the_onset_and_releases_do_not(stage: BoxStage, box: RecordingBox) -> None:
    """A press before the onset is not an answer."""
    box.presses = [99.9, 100.4]
    assert stage.blink(-3.0, 0, 0) == [pytest.approx(0.4)]


def test_catch_lights_nothing(stage: BoxStage, box: RecordingBox) -> None:
    """No level, no pulse."""
    stage.blink(None, 0, 0)
    assert box.asked == []


def test_flash_gives_its_scotopic_troland_seconds(stage: BoxStage, box: RecordingBox) -> None:
    """4e5 td·s in 15 s through 6 mm (28.27 mm²) are 943 scotopic cd/m², at 600 lm/W 1.572 W/sr/m²."""
    stage.lights = BoxLights(read_protocol("quick"), 300.0, 600.0, 900.0)
    stage.bleach(stage.lights.protocol)
    assert box.asked == [("bleach", pytest.approx(4e5 / 15 / 28.274 / 600, rel=1e-4), 15.0)]


def test_resuming_counts_on_with_the_mark_lit(stage: BoxStage, box: RecordingBox) -> None:
    """After a crash the time goes on, and the subject has something to look at again."""
    stage.resume_at(500.0)
    assert stage.now_s() == pytest.approx(500.0)
    assert box.asked == [("fixation", 1e-4)]


def test_long_press_is_reported_once_and_a_short_one_never(stage: BoxStage, box: RecordingBox) -> None:
    """Presses of 0.1 s are answers; one that is held is reported with its beginning, on the stage's clock."""
    box.presses = [100.4]
    stage.blink(-3.0, 0, 0)
    assert stage.long_press(2.0) is None
    box.held = [(101.5, 104.0)]
    assert stage.rest(5.0) == 2
    assert stage.long_press(2.0) == pytest.approx(1.5)
    assert stage.long_press(2.0) is None


def test_button_that_is_still_held_is_a_long_press(stage: BoxStage, box: RecordingBox) -> None:
    """No one has to let go first."""
    box.held = [(100.5, 999.0)]
    stage.rest(4.0)
    assert stage.long_press(2.0) == pytest.approx(0.5)


def test_light_in_the_blind_spot_is_one_pulse_of_its_own_channel(stage: BoxStage, box: RecordingBox) -> None:
    """No filter stands before it; presses count as for the spot."""
    stage.lights = BoxLights(read_protocol("led-only"), 300.0, 600.0, 900.0, blind_spot_w_sr_m2=8e-4)
    box.presses = [100.5]
    assert stage.checks_fixation
    assert stage.blink_blind_spot(0, 0) == [pytest.approx(0.5)]
    assert box.asked == [("spot_red", 8e-4, 0.3)]


def test_box_without_a_light_there_checks_no_fixation(stage: BoxStage, box: RecordingBox) -> None:
    """And refuses to pretend."""
    assert not stage.checks_fixation
    with pytest.raises(UsageError, match="blind spot"):
        stage.blink_blind_spot(0, 0)
    assert box.asked == []
