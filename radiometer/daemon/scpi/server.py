"""SCPI over raw TCP and a Unix socket: one message per line.

A web page may have the browser of this machine send bytes of its choice to any loopback port: the body of a POST, line
by line. The browser cannot help sending its request line and headers before them; by these it is known. No program
message of ours begins so: a mnemonic holds no hyphen, and no blank follows a root header but before its arguments.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import socket
import stat
from collections import Counter, deque
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, Final

import structlog

from radiometer.daemon.limits import Limits, Network, Places, ReplyBudget, TokenBucket, is_allowed, is_loopback
from radiometer.daemon.resources import listen
from radiometer.daemon.scpi.commands import command_table
from radiometer.daemon.scpi.language import ScpiError, block_end
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.station import Station
from radiometer.errors import OutputError, UsageError

_log = structlog.get_logger(__name__)
INTERFACE: Final = "scpi"
_IDLE_S: Final = 60.0  # a session idle for so long makes room where all places are held
_DISCARD_LIMIT: Final = 16  # times the line limit that may be thrown away before the client is dropped
# Of one client, then the others have their turn: the replies of 20 clients that send 20 lines each took 15 to 24 ms at
# 32 messages a turn, and all other clients waited for them.
_MESSAGES_AT_ONCE: Final = 2
_PIECE: Final = 262_144  # characters of a reply, of one byte each, handed to the system at a time
_LIGHTS: Final = re.compile(rb"sour", re.IGNORECASE)  # no message that lights does without this root
# Where every connection is in use by a busy client, so many more get in for a moment, to switch the lights off.
_GUESTS: Final = 8
_GUEST_S: Final = 2.0
_DARKENS: Final = re.compile(
    rb"\s*:?outp(?:ut)?:all\s+(?:off|0)\s*(?:;\s*(?::?outp(?:ut)?:)?(?:all\?|\*opc\?)\s*)*", re.IGNORECASE
)
_METHODS: Final = rb"GET|HEAD|POST|PUT|DELETE|OPTIONS|CONNECT|PRI|PROPFIND"
_METHODS_WITH_TARGET: Final = rb"(?:TRACE|PATCH)[ \t]+[/*h]"  # both are also long forms of our own mnemonics
_HEADERS: Final = rb"Host|Connection|Accept|Origin|Referer|Cookie|Upgrade|Expect|Pragma|Range|[a-z]+(?:-[a-z]+)+"
_STRANGE: Final = re.compile(
    rb"(?:\A|\n)[\x00-\x09\x0b-\x20]*"  # what the lexer passes over at the beginning of a message
    rb"(?:(?:" + _METHODS + rb")[ \t]|" + _METHODS_WITH_TARGET + rb"|(?:" + _HEADERS + rb")[ \t]*:"
    rb"|[^\n]{0,4096}[ \t]HTTP/\d)"
    rb"|(?:\A|\n)\x16\x03",  # a TLS record: handshake, version 3.x (RFC 8446, 5.1)
    re.IGNORECASE,
)


def is_other_protocol(received: bytes | bytearray) -> bool:
    """Return whether bytes that begin with a line hold the beginning of a line of HTTP or TLS.

    Args:
        received: What came, from the beginning of a line on; its last line may be unfinished.
    """
    return _STRANGE.search(received) is not None


class ScpiConnection(asyncio.Protocol):
    """One client on a socket."""

    def __init__(self, server: ScpiServer) -> None:
        self._server, self._limits = server, server.limits
        self._buffer = bytearray()
        self._messages: deque[tuple[bytes, Counter[str]]] = deque()  # each with what was dark when it came
        self._darkened, self._is_behind = Counter[str](), False
        self._bucket = TokenBucket(server.limits.messages_per_s)
        self._transport: asyncio.Transport | None = None
        self._task: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._resume: asyncio.Handle | None = None
        self._discarding = 0
        self._cannot_write = False
        self._outgoing, self._sent, self._budgeted = "", 0, 0  # a reply, how much of it went out, and what it reserved
        self._vetted_at: float | None = None
        self._idle_timer: asyncio.TimerHandle | None = None
        self._received_at = 0.0
        self._guest_for = ""  # why it has no place
        self._guest_until: asyncio.TimerHandle | None = None  # None but where every connection was in use
        self.session: Session | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take or refuse the client."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=self._limits.reply_bytes_waiting)
        raw_socket = transport.get_extra_info("socket")
        if raw_socket is not None and raw_socket.family != socket.AF_UNIX:
            raw_socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if reason := self._server.refusal(transport.get_extra_info("peername")):
            self.refuse(reason)
            return
        self.session = Session(self._server.station, self._server.table, self._limits.reply_bytes)
        host = _host(transport.get_extra_info("peername"))
        if crowded := self._server.make_room(host):
            self._server.take_guest(self, crowded)
            self._guest_for = crowded
            self._guest_until = asyncio.get_running_loop().call_later(_GUEST_S, self.refuse, crowded)
            return
        self._server.connections.add(self)
        self._server.places.enter(self, host)
        self._start_idle_timer()

    def refuse(self, reason: str) -> None:
        """End the connection of a client that gets no place."""
        peer = str(self._transport.get_extra_info("peername")) if self._transport is not None else ""
        self._server.station.metrics.refused.labels(INTERFACE, reason).inc()
        _log.warning("scpi client refused", reason=reason, peer=peer)
        if self._transport is not None:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client."""
        self._server.connections.discard(self)
        self._server.guests.pop(self, None)
        self._server.places.leave(self)
        for handle in (self._timer, self._resume, self._idle_timer, self._guest_until):
            if handle is not None:
                handle.cancel()
        if self._task is not None:
            self._task.cancel()
        if self.session is not None:
            self.session.close()
        self._messages.clear()
        self._buffer.clear()
        self._forget_reply()
        self._transport = None

    def data_received(self, data: bytes) -> None:
        """Cut what came into messages and run them."""
        if self.session is None or self._is_ending():
            return
        self._buffer += data
        if not self._is_behind:  # else it may have been sent before darkness was asked for, and waited unread
            self._darkened = self._server.station.light.darkened_by_others(self.session.asker)
        self._received_at = asyncio.get_running_loop().time()
        if not self._discarding and is_other_protocol(self._buffer):
            self._hang_up()
            return
        if self._vetted_at is None:
            self._vetted_at = asyncio.get_running_loop().time() + self._limits.vetting_s
        self._cut()
        self._watch()
        if self._task is None and self._resume is None:
            self._work()

    def pause_writing(self) -> None:
        """Stop executing for a client that does not take its replies; drop it if that lasts."""
        self._cannot_write = True
        self._start_timer("does not take its replies")

    def resume_writing(self) -> None:
        """Go on executing."""
        self._cannot_write = False
        self._stop_timer()
        self._push()
        if self._cannot_write:
            return
        self._watch()
        if self._task is None and self._resume is None:
            self._work()

    def drop(self, reason: str) -> None:
        """End the connection at once."""
        self._server.station.metrics.refused.labels(INTERFACE, "dropped").inc()
        _log.warning("scpi client dropped", reason=reason)
        if self._transport is not None:
            self._transport.abort()

    def _is_ending(self) -> bool:
        return self._transport is None or self._transport.is_closing()

    def _hang_up(self) -> None:
        """End the connection of a client that speaks HTTP or TLS; nothing that it sent and still waits is executed."""
        peer = str(self._transport.get_extra_info("peername")) if self._transport is not None else ""
        self._server.station.metrics.refused.labels(INTERFACE, "not scpi").inc()
        _log.warning("scpi client speaks http or tls and was hung up on: perhaps a web page", peer=peer)
        self._messages.clear()
        self._buffer.clear()
        if self._transport is not None:
            self._transport.abort()

    def _cut(self) -> None:
        """Cut messages off what came in, until as many wait as may; the rest stays bytes."""
        searched = 0
        while not self._is_full() and (newline := self._buffer.find(b"\n", searched)) >= 0:
            end = block_end(self._buffer, newline) if b"#" in self._buffer[:newline] else newline
            if end > newline and end <= self._limits.line_bytes and not self._discarding:
                if end >= len(self._buffer):
                    break
                searched = end
                continue
            if self._discarding:
                self._discarding = 0
            elif newline > self._limits.line_bytes:
                self._refuse_length()
            else:
                self._messages.append((bytes(self._buffer[:newline]), self._darkened))
            del self._buffer[: newline + 1]
            searched = 0
        if self._is_full():
            self._is_behind = True
            if self._transport is not None:
                self._transport.pause_reading()
        elif len(self._buffer) > self._limits.line_bytes:
            self._overrun()

    def _is_full(self) -> bool:
        return len(self._messages) > self._limits.messages_waiting

    def _overrun(self) -> None:
        if not self._discarding:
            self._refuse_length()
        self._discarding += len(self._buffer)
        self._buffer.clear()
        if self._discarding > _DISCARD_LIMIT * self._limits.line_bytes:
            self.drop("sends a message without end")

    def _refuse_length(self) -> None:
        if self.session is not None:
            self.session.status.push(ScpiError(-363, f"a message may have {self._limits.line_bytes} bytes"))

    def _work(self) -> None:
        """Run what waits; come back later where the client is fast, slow, or its command has to wait."""
        self._resume = None
        assert self.session is not None
        for _ in range(_MESSAGES_AT_ONCE):
            if self._buffer and not self._is_full():  # lines for which there was no room
                self._cut()
                self._watch()
            if not self._messages or self._cannot_write or self._is_ending():
                break
            if (pause_s := self._vetting_pause_s() or self._bucket.take()) > 0:
                self._resume = asyncio.get_running_loop().call_later(pause_s, self._work)
                break
            outcome = self._run(*self._messages.popleft())
            if isinstance(outcome, Coroutine):
                self._task = asyncio.create_task(self._wait(outcome))
                # A client may be gone before the task takes its first step.
                self._task.add_done_callback(lambda _, begun=outcome: begun.close())  # type: ignore[misc]
                break
            self._send(outcome)
        else:
            self._resume = asyncio.get_running_loop().call_soon(self._work)
        self._is_behind = self._is_behind and bool(self._messages or self._buffer)
        if len(self._messages) <= self._limits.messages_waiting // 2 and self._transport is not None:
            self._transport.resume_reading()

    def _vetting_pause_s(self) -> float:
        """Return how long the next message must wait in s: what lights waits whether lines of HTTP follow it."""
        if self._vetted_at is None or not _LIGHTS.search(self._messages[0][0]):
            return 0.0
        return max(0.0, self._vetted_at - asyncio.get_running_loop().time())

    def _run(self, message: bytes, darkened: Counter[str]) -> str | Coroutine[Any, Any, str | None] | None:
        assert self.session is not None
        if self._guest_until is not None and not _DARKENS.fullmatch(message):
            self.refuse(self._guest_for)
            return None
        self._server.served.inc()
        try:
            outcome = self.session.execute(message.rstrip(b"\r").decode("latin-1"), darkened)
            if outcome is not None:  # a reply: a client of ours, that asks what we understand
                self._server.places.note(self, busy=isinstance(outcome, Coroutine))
            return outcome
        except Exception as error:  # noqa: BLE001 (the daemon's edge: one client's message must not end the daemon)
            self._unexpected(error)
            return None

    async def _wait(self, outcome: Coroutine[Any, Any, str | None]) -> None:
        try:
            reply = await outcome
        except Exception as error:  # noqa: BLE001 (the daemon's edge, as above)
            self._unexpected(error)
            reply = None
        self._task = None
        self._server.places.note(self, busy=False)
        self._send(reply)
        self._work()

    def _unexpected(self, error: Exception) -> None:
        _log.error("unexpected error in a scpi command", error=repr(error), exc_info=error)
        if self.session is not None:
            self.session.status.push(ScpiError(-310, type(error).__name__))

    def _send(self, reply: str | None) -> None:
        if reply is None or self._transport is None or self.session is None:
            return
        if not self._server.budget.take(len(reply)):
            self.session.status.push(ScpiError(-225, "other clients have not taken their replies yet; ask again"))
            return
        self._outgoing, self._sent, self._budgeted = reply + "\n", 0, len(reply)
        self._push()

    def _push(self) -> None:
        """Hand the system as much of the reply as the client takes, a piece at a time."""
        while self._outgoing and not self._cannot_write and self._transport is not None:
            piece = self._outgoing[self._sent : self._sent + _PIECE]
            self._sent += len(piece)
            if self._sent >= len(self._outgoing):
                self._forget_reply()
            self._transport.write(piece.encode("latin-1", "replace"))

    def _forget_reply(self) -> None:
        self._server.budget.give_back(self._budgeted)
        self._outgoing, self._sent, self._budgeted = "", 0, 0

    def _watch(self) -> None:
        """A line that is begun must be finished in time."""
        if self._cannot_write or self._is_full():
            return
        if (self._buffer or self._discarding) and self._timer is None:
            self._start_timer("does not finish its message")
        elif not (self._buffer or self._discarding):
            self._stop_timer()

    def _start_idle_timer(self) -> None:
        """Look again when the session may have been idle for long: warn at nine tenths of the time, end it then."""
        loop, limit_s = asyncio.get_running_loop(), self._limits.idle_s
        self._received_at = loop.time()

        def look(warned_for: float) -> None:
            idle_s = loop.time() - self._received_at
            busy = self._task is not None
            if idle_s >= limit_s and not busy:
                self.drop(f"idle for {idle_s:.0f} s")
                return
            if idle_s >= 0.9 * limit_s and warned_for != self._received_at and self.session is not None:
                text = f"this session has sent nothing for {idle_s:.0f} s and is ended after {limit_s:.0f} s"
                self.session.status.push(ScpiError(-200, text))
                warned_for = self._received_at
            next_s = limit_s - idle_s if warned_for == self._received_at else 0.9 * limit_s - idle_s
            self._idle_timer = loop.call_later(max(next_s, 0.01 * limit_s), look, warned_for)

        self._idle_timer = loop.call_later(0.9 * limit_s, look, -1.0)

    def _start_timer(self, reason: str) -> None:
        self._stop_timer()
        self._timer = asyncio.get_running_loop().call_later(self._limits.stuck_s, self.drop, reason)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _remove_dead_socket(path: Path) -> None:
    """Remove the socket of a daemon that was killed. Raises OutputError if a program listens on it, or it is a file."""
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise OutputError(f"cannot listen for SCPI on {path}: it is no socket; name another path")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(1.0)
        try:
            line.connect(str(path))
        except ConnectionRefusedError:  # no program listens there any more
            path.unlink()
            return
        except OSError:  # such as a queue that is full: a program holds it
            pass
    raise OutputError(f"cannot listen for SCPI on {path}: another program listens there; name another path, or end it")


def _host(peer: Any) -> str:
    return str(peer[0]) if isinstance(peer, tuple) else ""


class ScpiServer:
    """Listens for SCPI clients.

    Args:
        limits: What clients may use.
        allow: Networks that may connect in addition to loopback.
    """

    def __init__(self, station: Station, *, limits: Limits | None = None, allow: Sequence[Network] = ()) -> None:
        self.station, self.limits, self.table = station, limits or Limits(), command_table()
        self.budget = ReplyBudget(self.limits.large_replies_bytes)
        self.connections: set[ScpiConnection] = set()
        self.guests: dict[ScpiConnection, None] = {}  # in the order in which they came
        self.places: Places[ScpiConnection] = Places(self.limits.scpi_connections, idle_s=_IDLE_S)
        self.served = station.metrics.requests.labels(INTERFACE)
        self._allow = tuple(allow)
        self._servers: list[asyncio.Server] = []
        self._socket: tuple[Path, int] | None = None
        station.on_change.append(self._state_changed)
        station.metrics.connections.labels(INTERFACE).set_function(lambda: len(self.connections))

    async def listen_tcp(self, address: str, port: int) -> int:
        """Listen on a TCP port and return it (0 chooses a free one).

        Raises:
            UsageError: If the address is not loopback and there is no allow-list.
            OutputError: If the port is taken.
        """
        if not is_loopback(address) and not self._allow:
            raise UsageError(
                f"SCPI has no authentication: to listen on {address}, list who may connect with --scpi-allow"
                " (addresses or networks), or stay on 127.0.0.1"
            )
        try:
            server = await listen(lambda: ScpiConnection(self), address, port)
        except OSError as error:
            raise OutputError(f"cannot listen for SCPI on {address}:{port}: {error.strerror or error}") from error
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def listen_unix(self, path: Path) -> None:
        """Listen on a Unix socket that only this user and group may open. Raises OutputError."""
        try:
            _remove_dead_socket(path)
            before = os.umask(0o117)  # never open to others, not even between its making and a chmod
            try:
                server = await asyncio.get_running_loop().create_unix_server(lambda: ScpiConnection(self), path)
            finally:
                os.umask(before)
        except OSError as error:
            raise OutputError(f"cannot listen for SCPI on {path}: {error.strerror or error}") from error
        self._servers.append(server)
        self._socket = path, path.lstat().st_ino

    async def close(self) -> None:
        """Stop listening and end every connection."""
        for server in self._servers:
            server.close()
        for connection in (*self.connections, *self.guests):
            if connection._transport is not None:
                connection._transport.close()
        for server in self._servers:
            await server.wait_closed()
        if self._socket is not None:
            path, inode = self._socket
            with contextlib.suppress(FileNotFoundError):
                if path.lstat().st_ino == inode:  # another program may have replaced it
                    path.unlink()

    def refusal(self, peer: Any) -> str:
        """Return why a client is refused; "" where it is taken."""
        if isinstance(peer, tuple) and not is_allowed(peer[0], self._allow):
            return "not on the allow-list"
        return ""

    def take_guest(self, guest: ScpiConnection, reason: str) -> None:
        """Let one more in that may only switch the lights off; the one that has waited longest goes for it."""
        if len(self.guests) >= _GUESTS:
            oldest = next(iter(self.guests))
            del self.guests[oldest]
            oldest.refuse(reason)
        self.guests[guest] = None

    def make_room(self, host: str) -> str:
        """Put the connection out that has the least claim to its place; return why the next one gets none."""
        if (displaced := self.places.make_room(host)) is not None:
            displaced.drop("makes room for another client")
            self.connections.discard(displaced)
            self.places.leave(displaced)
        return self.places.refusal(host) or ("too many connections" if self.places.is_full else "")

    def _state_changed(self) -> None:
        for connection in self.connections:
            if connection.session is not None:
                connection.session.state_changed()
