"""Limits of what one client, and all together, may use."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

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
