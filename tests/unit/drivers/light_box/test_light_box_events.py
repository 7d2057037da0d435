"""Numbered events in order."""

from __future__ import annotations

from drivers.light_box.events import EventInbox
from drivers.light_box.frames import Event


def event(number: int) -> Event:
    """Return an event of that number."""
    return Event(number, "BT", "D", float(number))


def test_gap_holds_later_events_back_until_it_is_filled():
    """Event 6 waits for event 5."""
    inbox = EventInbox()
    inbox.start_after(4)
    inbox.put(event(6))
    assert inbox.release() == []
    assert inbox.missing(6) == [5]
    inbox.put(event(5))
    assert [e.number for e in inbox.release()] == [5, 6]


def test_numbers_wrap_at_256():
    """After 255 comes 0."""
    inbox = EventInbox()
    inbox.start_after(254)
    for number in (0, 255):
        inbox.put(event(number))
    assert [e.number for e in inbox.release()] == [255, 0]


def test_event_that_came_twice_is_released_once():
    """A repetition is left out."""
    inbox = EventInbox()
    inbox.start_after(0)
    inbox.put(event(1))
    assert len(inbox.release()) == 1
    inbox.put(event(1))
    assert inbox.release() == []


def test_event_that_the_box_dropped_does_not_block():
    """Of 20 missing events the oldest four are given up, and counted."""
    inbox = EventInbox()
    inbox.start_after(0)
    assert inbox.missing(20) == list(range(5, 21))
    assert inbox.lost == 4
    for number in range(5, 21):
        inbox.put(event(number))
    assert [e.number for e in inbox.release()] == list(range(5, 21))
