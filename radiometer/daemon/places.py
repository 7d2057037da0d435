"""Shares the places for connections out, so that slow or idle clients cannot lock the others out."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

_C = TypeVar("_C")
_CROWD: Final = 8  # so many that have sent nothing are a crowd, and make room at once


@dataclass(slots=True)
class _Place:
    """What is known of a connection: from where, since when, and whether it has ever made sense."""

    peer: str
    since: float
    known: bool = False
    busy: bool = False


class Places(Generic[_C]):
    """Who holds a place, and who must go when there is none left.

    A connection that has made sense once is known. One that has not must do so in time, and is the first to go; then
    goes a known one that is idle, the longest idle first. One that is busy never goes. An address beyond loopback may
    hold a quarter of the places; on loopback all clients have one address.

    Args:
        patience_s: A connection not yet known may be put out for another one after this time in s.
        idle_s: A known one that has been idle for this time in s may be put out for another one.
        clock: Steady time in s.
    """

    def __init__(
        self, limit: int, *, patience_s: float = 1.0, idle_s: float = 2.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._limit, self._patience_s, self._idle_s, self._clock = limit, patience_s, idle_s, clock
        self._places: dict[_C, _Place] = {}

    def __len__(self) -> int:
        return len(self._places)

    def connections(self) -> set[_C]:
        """Return who holds a place."""
        return set(self._places)

    def refusal(self, peer: str) -> str:
        """Return why a peer gets no place even if there is one; "" where it may have one."""
        if _is_loopback(peer):
            return ""
        held = sum(place.peer == peer for place in self._places.values())
        return "too many connections of one address" if held >= max(1, self._limit // 4) else ""

    def make_room(self, peer: str) -> _C | None:
        """Return who must go for the next one of a peer; None where there is room or none may be dropped.

        Where the peer has its part of the places, one of its connections goes.
        """
        own = bool(self.refusal(peer))
        if not own and not self.is_full:
            return None
        now = self._clock()
        places = {c: place for c, place in self._places.items() if not own or place.peer == peer}
        unidentified = [connection for connection, place in places.items() if not place.known]
        crowd = len(unidentified) >= max(_CROWD, self._limit // 2)
        waited = [c for c in unidentified if crowd or now - self._places[c].since >= self._patience_s]
        idle = [
            connection
            for connection, place in places.items()
            if place.known and not place.busy and now - place.since >= self._idle_s
        ]
        return min(waited or idle, key=lambda connection: self._places[connection].since, default=None)

    @property
    def is_full(self) -> bool:
        """Return whether every place is held."""
        return len(self._places) >= self._limit

    def enter(self, connection: _C, peer: str) -> None:
        """Give a connection a place."""
        self._places[connection] = _Place(peer, self._clock())

    def leave(self, connection: _C) -> None:
        """Take a place back; a connection without one is left alone."""
        self._places.pop(connection, None)

    def is_known(self, connection: _C) -> bool:
        """Return whether a connection has made sense at least once."""
        place = self._places.get(connection)
        return place is not None and place.known

    def note(self, connection: _C, *, busy: bool) -> None:
        """Note that a connection makes sense, and whether it is served just now."""
        if place := self._places.get(connection):
            place.known, place.busy, place.since = True, busy, self._clock()


def _is_loopback(peer: str) -> bool:
    try:
        return ipaddress.ip_address(peer.partition("%")[0]).is_loopback
    except ValueError:
        return True  # a Unix socket has no address
