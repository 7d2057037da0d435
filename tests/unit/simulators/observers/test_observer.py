"""The simulated subject and its eye."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.light_box.box import SimulatedLightBox
from simulators.observers.eye_kinetics import (
    Eye,
    bleached,
    eye_after_bleach,
    in_blind_spot,
    recovery_min,
    scotopic_per_photopic,
)
from simulators.observers.observer import Habits, Observer, ObserverAtBox
from testing.drawn_eyes import drawn_eye


def test_pigment_settles_where_bleaching_and_regeneration_balance():
    """Half is bleached at I = Q/t₀; a tenth of the bleach recovers 1/0.24 min sooner."""
    assert bleached(2.4e6 / 120, 1e5, 2.4e6, 120.0) == pytest.approx(0.5, rel=1e-9)
    assert bleached(1000.0, 0.01, 2.4e6, 120.0) == pytest.approx(1000.0 * 0.01 / 2.4e6, rel=1e-4)
    assert recovery_min(0.01, 0.24) - recovery_min(0.001, 0.24) == pytest.approx(
        1 / 0.24 + 0.009 / (0.24 * math.log(10) * 0.2), rel=1e-6
    )


def test_rods_show_in_the_blue_and_after_long_bleaches():
    """A break at 453 nm, none at 640 nm; 2 s leave the rods alone; longer takes longer."""
    eye = Eye()
    assert eye.break_min(453.0) == pytest.approx(11.3, abs=1.5)
    late = [eye.threshold_log10(time, 640.0) for time in (15.0, 45.0)]
    assert late[0] - late[1] < 0.15
    blue = [eye.threshold_log10(time, 453.0) for time in (10.0, 45.0)]
    assert blue[0] - blue[1] > 2.5
    eye = eye_after_bleach(Eye(), 300.0, 2.0)
    assert eye.break_min(453.0) is None
    assert eye.rod_log10(1.0) < eye.cone_log10(1.0, 453.0)
    short, long = (eye_after_bleach(replace(Eye(), pupil_mm=8.0), 3000.0, time) for time in (20.0, 300.0))
    assert short.cone_amplitude < long.cone_amplitude
    assert short.s2_zero_min < long.s2_zero_min
    assert scotopic_per_photopic(453.0) > 10
    assert scotopic_per_photopic(640.0) < 0.1


def test_drawn_eyes_have_their_break_where_it_was_requested():
    """The crossing of the drawn branches lies in the requested range."""
    rng = np.random.default_rng(1)
    breaks = [drawn_eye(rng).break_min(453.0) for _ in range(10)]
    assert all(value is not None and 5.9 < value < 12.1 for value in breaks)


def test_answers_come_as_often_as_they_should():
    """1 − 1/e at threshold, lapses above, false alarms below; 4000 blinks within three deviations."""
    observer = Observer(Eye(), Habits(lapses=0.02, false_alarms=0.03))
    threshold = observer.eye.threshold_log10(5.0, 453.0)
    at = [observer.seen_probability(threshold + step, 300.0, 453.0) for step in (-1.0, 0.0, 1.0)]
    assert at == pytest.approx([0.03, 0.03 + 0.95 * (1 - math.exp(-1)), 0.98], abs=1e-3)
    observer = Observer(Eye(), Habits(lapses=0.0, false_alarms=0.0), np.random.default_rng(2))
    threshold = observer.eye.threshold_log10(5.0, 453.0)
    answers = [observer.answer(threshold, 300.0, 453.0) for _ in range(4000)]
    reactions = [answer for answer in answers if answer is not None]
    expected = 1 - math.exp(-1)
    assert abs(len(reactions) / 4000 - expected) < 3 * math.sqrt(expected * (1 - expected) / 4000)
    assert np.median(reactions) == pytest.approx(0.35, rel=0.02)


def test_subject_presses_the_simulated_box_after_its_reaction_time():
    """A bright spot on the box is answered by a press on its button."""
    twin = SimulatedLightBox()
    seat = ObserverAtBox(Observer(Eye(), Habits(lapses=0.0, false_alarms=0.0)), twin)
    seat.sit_down()
    twin.advance(1.0)
    twin.channels[1].start("P", 60000, True, 200)
    twin.lit()
    twin.advance(1.1)
    assert not twin.button
    twin.advance(1.45)
    assert seat.answered == 1
    assert any(" D " in event for event in twin.events.values() if event.startswith("BT"))


def test_false_alarms_and_the_blind_spot_come_as_often_as_they_should() -> None:
    """Poisson of mean 30 in darkness; 30 % of glances see the spot."""
    twin = SimulatedLightBox()
    seat = ObserverAtBox(Observer(Eye(), Habits(false_alarms=0.01), np.random.default_rng(5)), twin)
    seat.sit_down()
    twin.advance(3000.0)
    lines = [line.line for line in twin.emitted]
    assert sum(b" BT D " in line for line in lines) == pytest.approx(30, abs=4 * math.sqrt(30))
    assert seat.answered == 0
    bright, place, count = 2.0, (15.5, -1.5), 2000
    for losses in (0.0, 0.3):
        habits = Habits(lapses=0.0, false_alarms=0.0, fixation_losses=losses)
        subject = Observer(Eye(), habits, np.random.default_rng(5))
        seen = sum(subject.answer(bright, 1200.0, 640.0, place) is not None for _ in range(count))
        assert abs(seen - losses * count) <= 4 * math.sqrt(losses * (1 - losses) * count)


@pytest.mark.parametrize(
    ("place", "blind"),
    [((15.5, -1.5), True), ((17.9, -1.5), True), ((15.5, 2.0), True), ((18.4, -1.5), False), ((5.0, 0.0), False)],
)
def test_blind_spot_is_where_the_optic_disc_is(place: tuple[float, float], blind: bool) -> None:
    """An ellipse of 5.5° by 7.5° around 15.5° temporal and 1.5° below."""
    assert in_blind_spot(*place) is blind
