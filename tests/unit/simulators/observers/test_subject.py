"""The simulated subject: its curve and its answers follow what it is told to be."""

from __future__ import annotations

import math

import pytest

from simulators.observers.subject import SimulatedSubject, SubjectCurve


def test_curve_has_two_branches_and_a_break() -> None:
    """Before the break the cones lead, after it the rods fall by S2, in the end the floor holds."""
    curve = SubjectCurve()
    assert curve.threshold(0.0) == pytest.approx(1.0)
    assert curve.threshold(8.9) == pytest.approx(-1.0, abs=0.01)
    assert curve.threshold(12) - curve.threshold(13) == pytest.approx(0.24)
    assert curve.threshold(25) - curve.threshold(26) == pytest.approx(0.05)
    assert curve.threshold(500) == -4.2


@pytest.mark.parametrize(("above", "share"), [(0.0, 0.5 * 0.97 + 0.01), (0.5, 0.98), (-0.5, 0.01)])
def test_share_seen_follows_the_psychometric_function(above: float, share: float) -> None:
    """Of 2000 blinks at, well above and well below threshold the share pressed is the predicted one (4 sigmas)."""
    subject = SimulatedSubject(seed=4)
    level = subject.curve.threshold(5.0) + above
    pressed = sum(bool(subject.presses(level, 5.0, n, 0)) for n in range(2000)) / 2000
    assert pressed == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 2000))


def test_answers_follow_from_seed_trial_and_blink_alone() -> None:
    """The same blink is answered the same however often it is asked."""
    subject = SimulatedSubject(seed=4)
    assert subject.presses(0.0, 5.0, 3, 1) == subject.presses(0.0, 5.0, 3, 1)


def test_reaction_time_has_the_stated_median() -> None:
    """Half of the presses come before 0.35 s (4 sigmas of the median of a log-normal)."""
    subject = SimulatedSubject(seed=2, lapse=0.0)
    times = sorted(t for n in range(1000) for t in subject.presses(3.0, 5.0, n, 0))
    sigma = 0.35 * 0.2 * 1.2533 / math.sqrt(len(times))
    assert times[len(times) // 2] == pytest.approx(0.35, abs=4 * sigma)


def test_subject_leaves_when_told() -> None:
    """After that minute nothing is pressed."""
    subject = SimulatedSubject(leaves_after_min=10)
    assert not any(subject.presses(3.0, 10.1, n, 0) for n in range(50))
