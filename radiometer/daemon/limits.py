"""Limits of what one client, and all together, may use."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from radiometer.errors import UsageError

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

_SHORTEST_TOKEN: Final = 16  # characters: 64 bits even where they are hexadecimal digits


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the interfaces."""

    scpi_connections: int = 256  # open SCPI connections
    line_bytes: int = 4096  # length of an SCPI message
    messages_waiting: int = 64  # messages of one client that wait to be executed; reading pauses at more
    messages_per_s: float = 1000.0  # SCPI messages per second of one client, sustained; more are delayed
    # Replies of one SCPI message together, without the largest of them; more are refused (-225)
    reply_bytes: int = 4_000_000
    reply_bytes_waiting: int = 262_144  # reply bytes handed to the system that a client has not taken; the rest waits
    # Large replies that all clients of an interface have not taken yet; more are refused
    large_replies_bytes: int = 256_000_000
    # A client that does not take its replies, or does not finish a line, is dropped after this time in s
    stuck_s: float = 30.0
    # An SCPI session that sends nothing for this time in s is ended, with an entry in its error queue before
    idle_s: float = 14_400.0
    head_s: float = 5.0  # an HTTP connection must have sent its first request head within this time in s
    # A message that lights is held back for this time in s after the first bytes of a connection: if lines of HTTP
    # follow, it is never executed
    vetting_s: float = 0.1
    http_connections: int = 128  # open HTTP connections
    http_requests_per_s: float = 100.0  # HTTP requests per second of one address, sustained; more are refused (429)
    body_bytes: int = 16_384  # size of an HTTP request body
    # Open streams of readings. With all of them open, a new one ends the one that is furthest behind, else the oldest:
    # it reconnects and misses nothing.
    listeners: int = 64
    listening_s: float = 5.0  # a stream is not ended for another one within this time in s
    rows: int = 20_000  # readings in one HTTP reply
    queries: int = 2  # queries of the journal that HTTP clients run at the same time; others wait


class TokenBucket:
    """Counts what is used against a steady rate with a burst of one second's worth.

    Args:
        per_s: Tokens that come back per second.
        clock: Steady time in s.
    """

    __slots__ = ("_clock", "_filled_at", "_per_s", "_tokens")

    def __init__(self, per_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._clock = per_s, clock
        self._tokens, self._filled_at = per_s, clock()

    def take(self) -> float:
        """Take a token and return 0, or the time in s after which one will be there."""
        now = self._clock()
        self._tokens = min(self._per_s, self._tokens + (now - self._filled_at) * self._per_s)
        self._filled_at = now
        if self._tokens >= 1.0:
            self._tokens -= 1.0
            return 0.0
        return (1.0 - self._tokens) / self._per_s

    @property
    def is_full(self) -> bool:
        """Return whether nothing was used of late."""
        return self._tokens + (self._clock() - self._filled_at) * self._per_s >= self._per_s


SMALL_REPLY_BYTES: Final = 1_000_000  # 256 clients that take none of their replies then hold 256 MB


class ReplyBudget:
    """Bounds the memory of large replies that clients have not taken yet, over all clients of an interface.

    A reply of at most `SMALL_REPLY_BYTES` needs no budget. A single one of any size is let through, as a picture may be
    larger than the limit.

    Args:
        limit_bytes: Most bytes together.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit, self._held = limit_bytes, 0

    @property
    def held_bytes(self) -> int:
        """Return the bytes that are reserved now."""
        return self._held

    def take(self, size: int) -> bool:
        """Reserve the bytes of a reply and return True; False where there is no room for it now."""
        if size <= SMALL_REPLY_BYTES:
            return True
        if self._held and self._held + size > self._limit:
            return False
        self._held += size
        return True

    def give_back(self, size: int) -> None:
        """Return the bytes of a reply that was taken by its client, or thrown away."""
        if size > SMALL_REPLY_BYTES:
            self._held -= size


def check_token(token: str) -> str:
    """Return a token for HTTP that is long enough not to be guessed and can be sent. Raises UsageError."""
    if not all(sign.isprintable() and not sign.isspace() for sign in token):  # a file of zero bytes is no secret
        raise UsageError("the token for HTTP holds blanks or invisible characters; make another: openssl rand -hex 24")
    if len(token) < _SHORTEST_TOKEN:
        raise UsageError(
            f"the token for HTTP has {len(token)} characters; use {_SHORTEST_TOKEN} or more: openssl rand -hex 24"
        )
    return token


def parse_networks(texts: Sequence[str]) -> tuple[Network, ...]:
    """Return the networks of an allow-list such as 192.168.1.0/24 or 10.0.0.7. Raises UsageError."""
    networks: list[Network] = []
    for text in texts:
        try:
            networks.append(ipaddress.ip_network(text, strict=False))
        except ValueError as error:
            raise UsageError(f"{text!r} is no network; give an address or CIDR such as 192.168.1.0/24") from error
    return tuple(networks)


def is_loopback(address: str) -> bool:
    """Return whether an address to listen on is reachable from this machine only."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def is_allowed(peer: str, networks: Sequence[Network]) -> bool:
    """Return whether a peer may connect: loopback always, others if a network of the allow-list holds them."""
    try:
        address = ipaddress.ip_address(peer.partition("%")[0])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    address = mapped or address
    return address.is_loopback or any(address in network for network in networks)


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
