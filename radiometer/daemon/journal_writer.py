"""Commits readings in the background; while the journal cannot be written they wait, and an alarm is up."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar

import structlog

from radiometer.daemon.alarms import Alarms
from radiometer.daemon.instrument import Origin
from radiometer.daemon.journal import Journal, JournalError, JournalSizeError
from radiometer.daemon.timestamps import Jump, RetentionClock
from radiometer.data import Reading
from radiometer.errors import OutputError

_log = structlog.get_logger(__name__)
_T = TypeVar("_T")
ALARM: Final = "journal"
_RETENTION_PERIOD_S: Final = 3600.0  # readings stay up to an hour longer than asked
_LOOK_S: Final = 1.0  # a damaged file that was moved away ends its alarm so soon


class JournalWriter:
    """Owns the journal and the one thread that writes it.

    Args:
        journal: The journal, not yet open.
        alarms: Where trouble is reported.
        on_commit: Called in the event loop with every reading once it is on disk, with what was given with it and the
            time in s that the commit took; the only way to a client.
        capacity: Readings that may wait; when as many wait, `wait_for_room` blocks, so measuring pauses. It also does
            while the journal has the size that it may have.
        keep_days: Age at which readings are deleted; None keeps all.
        retry_s: Pause in s between two tries while the journal cannot be written.
        closing_s: Time in s in which waiting readings are still committed at the end. A blocked disk is given up then,
            long before systemd kills after 90 s.
        look_at_clock: Calls `note_jump` where the clock was set and that was not noted yet.
        sleep: Waits for a number of seconds.

    Attributes:
        trouble: Why the journal cannot be written just now; "" where it can.
    """

    def __init__(
        self,
        journal: Journal,
        alarms: Alarms,
        on_commit: Callable[[Reading, Origin | None, float], None],
        *,
        capacity: int = 1000,
        keep_days: float | None = None,
        retry_s: float = 0.5,
        closing_s: float = 5.0,
        look_at_clock: Callable[[], None] = lambda: None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._journal, self._alarms, self._on_commit = journal, alarms, on_commit
        self._capacity, self._keep_days, self._retry_s, self._sleep = capacity, keep_days, retry_s, sleep
        self._closing_s, self._look_at_clock, self.trouble = closing_s, look_at_clock, ""
        self._damaged: dict[Path, str] = {}  # files of readings that waited which stay, and what is wrong with them
        self._waiting: deque[tuple[Reading, asyncio.Future[Reading], Origin | None]] = deque()
        self._events: deque[tuple[str, str]] = deque(maxlen=capacity)
        self._jumps_us = 0
        self._may_be_waiting = True  # readings of an earlier daemon, until they are taken in
        self._kept_patches: dict[str, str | None] = {}
        self._retention = RetentionClock()
        self._committing = asyncio.Lock()
        self._work = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="journal")

    @property
    def depth(self) -> int:
        """Return how many readings wait to be committed."""
        return len(self._waiting)

    async def open(self) -> None:
        """Open the journal; one that is merely locked or full puts up an alarm and is tried again.

        Raises:
            OutputError: If the file is no journal, damaged, or written by another daemon.
        """
        try:
            await self._in_thread(self._journal.open)
        except JournalError as error:
            self._report(str(error))

    def submit(self, reading: Reading, origin: Origin | None = None) -> asyncio.Future[Reading]:
        """Queue a reading and return the future of its committed, numbered form."""
        future: asyncio.Future[Reading] = asyncio.get_running_loop().create_future()
        self._waiting.append((reading, future, origin))
        if len(self._waiting) >= self._capacity:
            self._room.clear()
        self._work.set()
        return future

    def note(self, kind: str, message: str) -> None:
        """Queue an event for the journal."""
        self._events.append((kind, message))
        self._work.set()

    def note_jump(self, jump: Jump) -> None:
        """Queue for the journal that the clock was set."""
        self._jumps_us += jump.by_us
        self.note("clock", str(jump))

    async def patches(self) -> dict[str, str]:
        """Return the patches that the journal keeps; none where it cannot be read just now."""
        try:
            return await self._in_thread(self._journal.patches)
        except OutputError:
            return {}

    def keep_patch(self, name: str, line: str | None) -> None:
        """Queue what is to be kept of a patch; None forgets it."""
        self._kept_patches[name] = line
        self._work.set()

    @property
    def has_room(self) -> bool:
        """Return whether fewer than `capacity` readings wait, and the journal may still grow."""
        return self._room.is_set()

    async def wait_for_room(self) -> None:
        """Return once fewer than `capacity` readings wait, and the journal may still grow."""
        await self._room.wait()

    async def run(self) -> None:
        """Commit what is queued, for ever."""
        next_retention = 0.0
        while True:
            self._work.clear()
            committed = not self._is_pending or await self._try_to_commit()
            if self._keep_days is not None and time.monotonic() >= next_retention:
                await self._drop_old(self._keep_days)
                next_retention = time.monotonic() + _RETENTION_PERIOD_S
            if committed and not self._is_pending:
                await self._wait_for_work()

    async def close(self) -> None:
        """Commit what waits, save elsewhere what cannot be committed within a deadline, and close the journal.

        Raises:
            OutputError: If readings were not committed; the message names the file that they are in.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(self._closing_s):
                await self._commit_until_empty()
        async with self._committing:
            await self._in_thread(self._journal.close)
        self._thread.shutdown(wait=False)
        left = [reading for reading, _, _ in self._waiting]
        for _, future, _ in self._waiting:
            future.cancel()
        if left:
            place = self._journal.save_waiting(left)
            raise OutputError(
                f"{len(left)} readings are not in the journal {self._journal.path}: they are in {place}; the next start"
                " takes them in"
            )

    async def _wait_for_work(self) -> None:
        try:
            async with asyncio.timeout(_LOOK_S if self._damaged else _RETENTION_PERIOD_S):
                await self._work.wait()
        except TimeoutError:
            self._report("")

    async def _commit_until_empty(self) -> None:
        while self._is_pending:
            await self._try_to_commit()

    @property
    def _is_pending(self) -> bool:
        return bool(self._waiting or self._events or self._kept_patches or self._jumps_us or self._may_be_waiting)

    async def _try_to_commit(self) -> bool:
        """Commit what is queued; where that cannot be, put up the alarm, pause, and return False."""
        try:
            # What the thread has begun ends, though this task is cancelled: else it would be committed again. What it
            # raises then is raised again by the commit at the stop.
            commit = asyncio.ensure_future(self._commit_batch())
            commit.add_done_callback(lambda done: done.cancelled() or done.exception())
            await asyncio.shield(commit)
        except OutputError as error:
            if isinstance(error, JournalSizeError):  # it will not pass by itself, as a lock or a full disk may
                self._room.clear()
            paused = "" if self._room.is_set() else "; measuring is paused until it can be written"
            self._report(f"{error}; {len(self._waiting)} readings wait{paused}")
            await self._sleep(self._retry_s)
            return False
        self._report("")
        if len(self._waiting) < self._capacity:
            self._room.set()
        return True

    def _report(self, trouble: str) -> None:
        """Put the alarm up, or take it down, by whether the journal is written and no damaged file is there."""
        became_worse = bool(trouble and not self.trouble)
        self.trouble = trouble
        self._damaged = {path: text for path, text in self._damaged.items() if path.exists()}
        if message := trouble or next(iter(self._damaged.values()), ""):
            self._alarms.put_up(ALARM, message, worse=became_worse)
        else:
            self._alarms.clear(ALARM, "the journal is written again")

    async def _commit_batch(self) -> None:
        async with self._committing:
            await self._commit_all_kinds()

    async def _commit_all_kinds(self) -> None:
        if self._may_be_waiting:  # before any reading of this daemon, so that numbers and times rise together
            for text, left in await self._in_thread(self._journal.take_in_waiting):
                self.note("journal", text)
                if left is not None:
                    self._damaged[left] = text
            self._look_at_clock()  # a jump since the start is in what the opening notes, and is not counted again
            self._retention, self._jumps_us = RetentionClock(), 0
            await self._in_thread(self._journal.note_opening, self._retention.now_us())
            self._may_be_waiting = False
        while self._events:
            await self._in_thread(self._journal.note, *self._events[0])
            self._events.popleft()
        while self._kept_patches:
            name, line = next(iter(self._kept_patches.items()))
            await self._in_thread(self._journal.keep_patch, name, line)
            if self._kept_patches.get(name) == line:
                del self._kept_patches[name]
        if jumped_us := self._jumps_us:
            await self._in_thread(self._journal.note_jump, jumped_us)
            self._jumps_us -= jumped_us
            self._retention.follow(jumped_us)
        batch = [reading for reading, _, _ in self._waiting]
        if not batch:
            return
        started = time.perf_counter()
        committed = await self._in_thread(self._journal.append, batch)
        self._hand_out(committed, time.perf_counter() - started)

    def _hand_out(self, committed: Sequence[Reading], seconds: float) -> None:
        for reading in committed:
            _, future, origin = self._waiting.popleft()
            self._on_commit(reading, origin, seconds)
            if not future.done():
                future.set_result(reading)

    async def _drop_old(self, keep_days: float) -> None:
        try:
            before_us = self._retention.now_us() - int(keep_days * 86400e6)
            dropped = await self._in_thread(self._journal.drop_older, before_us)
            if dropped:
                _log.info("old readings deleted", count=dropped, keep_days=keep_days)
        except OutputError as error:
            self._alarms.put_up(ALARM, f"old readings could not be deleted: {error}")

    async def _in_thread(self, call: Callable[..., _T], *arguments: object) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, call, *arguments)
