"""The link to the light box by scripted answers: whose answer is taken, what a refusal and an event mean."""

from __future__ import annotations

import zlib
from collections import deque

import pytest

from drivers.light_box.clock import BoxClock, ClockSample
from drivers.light_box.frames import parse_times
from drivers.light_box.link import BoxLink, BoxRefusal
from drivers.light_box.serial_line import ReceivedLine
from radiometer.errors import DeviceLost, DeviceTimeout, UnsafeStimulus


def sealed(body):
    return body.encode() + f"*{zlib.crc32(body.encode()):08X}".encode()


class ScriptedLine:
    """A line that answers each request by what a script says; its clock runs by waiting."""

    name = "scripted"

    def __init__(self, script):
        self.script, self.time_s, self.sent, self.waiting = deque(script), 0.0, [], deque()

    def now(self):
        return self.time_s

    def write(self, data):
        self.sent.append(data.decode())
        number = data[1:3].decode()
        answers = self.script.popleft() if self.script else ()
        self.waiting += [sealed(text.replace("SS", number)) for text in answers]
        return self.time_s

    def read_line(self, timeout_s):
        if self.waiting:
            self.time_s += 0.001
            return ReceivedLine(self.waiting.popleft(), self.time_s)
        self.time_s += timeout_s
        return None


def link_of(*script):
    line = ScriptedLine(script)
    return line, BoxLink(line)


def test_an_answer_is_that_of_its_own_request():
    """A late answer to an earlier request is passed over, and the right one taken."""
    line, link = link_of(("=00 OK late",), ("=SS OK mine",))
    with pytest.raises(DeviceTimeout):
        link.request("ST", attempts=1)
    line.waiting.append(sealed("=01 OK late"))
    assert link.request("ST") == ("mine",)


def test_a_request_is_repeated_under_its_number():
    """Lost twice, it is sent three times with one number, which the box answers without doing it again."""
    line, link = link_of((), (), ("=SS OK done",))
    assert link.request("PU 1 L 5 10") == ("done",)
    assert len(line.sent) == 3
    assert len(set(line.sent)) == 1
    assert link.retries == 2


@pytest.mark.parametrize(("code", "kind"), [(5, BoxRefusal), (6, UnsafeStimulus), (7, DeviceLost)])
def test_what_a_refusal_means(code, kind):
    """The energy budget is the eye's safety; a dark session is lost, and stays so until it is opened again."""
    _, link = link_of((f"=SS ER {code:02d}",), ("=SS OK",))
    with pytest.raises(kind):
        link.request("SL 1 H 60000")
    if kind is DeviceLost:
        with pytest.raises(DeviceLost):
            link.request("ST")
    else:
        link.request("ST")


def test_a_box_that_went_dark_by_itself_is_lost():
    """The event of its dead-man timer ends the session; the one of the button is reported and ends nothing."""
    for argument, ends in (("D", True), ("B", False)):
        line, link = link_of(("=SS OK",))
        link.inbox.start_after(4)
        line.waiting.append(sealed(f"!05 DK {argument} 12.345"))
        link.listen(0.1)
        assert link.take_turned_off() is not ends
        if ends:
            with pytest.raises(DeviceLost, match="gone dark because this program was silent"):
                link.request("ST")
        else:
            link.request("ST")


@pytest.mark.parametrize(("text", "number"), [("0F", 15), ("10", 16), ("FF", 255)])
def test_the_latest_event_s_number_is_hexadecimal(text, number):
    """Times in ms become s; a number of two hexadecimal digits."""
    assert parse_times(("1500.000", "1500.250", text)) == pytest.approx((1.5, 1.50025, number))
    assert parse_times(("1500.000", "1500.250", "F")) is None


def test_a_press_long_after_the_last_comparison_follows_the_drift():
    """A clock that gains a thousandth, compared for 100 s: 50 s later the offset has gone on by 50 ms."""
    clock = BoxClock()
    for step in range(401):
        host_s = 0.25 * step
        box_s = host_s * 1.001
        clock.add(ClockSample(host_s, box_s, box_s, host_s))
    time_s, u_s = clock.host_time_s(150.0 * 1.001)
    assert time_s == pytest.approx(150.0, abs=4 * u_s)
    assert u_s < 0.005
    assert clock.estimate().drift_ppm == pytest.approx(1000.0, rel=0.01)


def test_right_after_one_comparison_only_the_resonator_is_known():
    """0.5 % of 100 s are 0.5 s, of 1000 s 5 s: the doubt of the rate grows with the time since."""
    clock = BoxClock()
    clock.add(ClockSample(1.0, 1.0, 1.0, 1.0))
    assert [clock.host_time_s(1.0 + away_s)[1] for away_s in (100.0, 1000.0)] == pytest.approx([0.5, 5.0], rel=1e-4)


def test_a_box_that_boots_again_has_ended_the_session():
    """Its numbers start again: before the first comparison that is how it greets, after it the light is gone."""
    for known, ends in ((False, False), (True, True)):
        line, link = link_of(("=SS OK",))
        if known:
            link.inbox.start_after(4)
        line.waiting.append(sealed("!00 BO P 0.004"))
        link.listen(0.1)
        if ends:
            with pytest.raises(DeviceLost, match="has restarted; every channel is dark, reopen it"):
                link.request("ST")
        else:
            assert link.request("ST") == ()


def test_an_event_that_the_box_no_longer_has_holds_back_none_after_it():
    """Of events 5 and 6 the box has forgotten the first: the second is handed out, one is counted as lost."""
    line, link = link_of(("=SS OK 1.000 1.100 06",), ("=SS ER 11",), ("=SS OK BT D 12.345",))
    link.inbox.start_after(4)
    link.compare_clocks()
    assert [(event.number, event.kind, event.argument) for event in link.take_events()] == [(6, "BT", "D")]
    assert link.inbox.lost == 1
    assert [words.split("*")[0][4:] for words in line.sent] == ["TM", "EV 05", "EV 06"]
