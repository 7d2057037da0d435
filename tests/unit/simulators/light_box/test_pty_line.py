"""A simulated box behind a pseudo-terminal on a machine that does not let it run."""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivers.light_box.frames import request_line
from simulators.light_box.box import SimulatedLightBox
from simulators.light_box.pty_line import LAG_S, PtyServer, WiredLightBox


class _Clock:
    """Real time as the test sets it."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def _greeted() -> tuple[_Clock, PtyServer, SimulatedLightBox]:
    """Return a served box with a session that was begun at 0.2 s, its clock and the server."""
    clock, twin = _Clock(), SimulatedLightBox()
    server = PtyServer(WiredLightBox(twin), clock=clock)
    for clock.now_s, sent in ((0.1, request_line(1, "HI 2")), (0.2, b"")):
        server.device.exchange(sent, server.time_s())
    assert twin.session
    return clock, server, twin


def _pass(clock: _Clock, server: PtyServer, until_s: float, step_s: float) -> None:
    while clock.now_s < until_s - 1e-9:
        clock.now_s += step_s
        server.device.exchange(b"", server.time_s())


def test_a_box_kept_from_running_does_not_take_that_for_its_host_s_silence() -> None:
    """Five seconds without a processor end no session; a second of true silence after them does."""
    clock, server, twin = _greeted()
    clock.now_s = 5.2
    server.device.exchange(b"", server.time_s())
    assert twin.session
    _pass(clock, server, 6.2, 0.1)
    assert not twin.session


@pytest.mark.parametrize("step_s", [0.002, 0.3])
def test_a_box_that_runs_goes_dark_for_a_silent_host(step_s: float) -> None:
    """Short steps of time are all true time: after 1 s of silence the session is over, before it is not."""
    clock, server, twin = _greeted()
    _pass(clock, server, 0.8, step_s)
    assert twin.session
    _pass(clock, server, 1.6, step_s)
    assert not twin.session


def test_device_time_is_real_time_in_steps_no_longer_than_the_lag() -> None:
    """What is given up never comes back, and nothing else is lost."""
    clock, server, _ = _greeted()
    times_s = []
    for clock.now_s in (0.3, 0.7, 3.0, 3.1, 3.4, 9.0, 9.001):
        times_s.append(server.time_s())
    steps_s = [later - earlier for earlier, later in pairwise([0.2, *times_s])]
    assert steps_s == pytest.approx([0.1, 0.4, LAG_S, 0.1, 0.3, LAG_S, 0.001])
