"""Pausing, resuming and stopping a run from another thread: a key, a page, a program."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field


@dataclass(slots=True)
class Controls:
    """Requests to a run from outside; safe to call from any thread.

    The run looks at it after every blink: it goes dark, journals the pause, and waits. The eye adapts on.
    """

    paused_by: str | None = None  # who asked for the pause that is asked for now; None where none is
    stopped_by: str | None = None  # who asked for the end; None while there is no request
    # Real time that each look at a pause takes besides; for runs in simulated time, where a pause would be over before
    # anybody could end it
    linger_s: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def pause(self, by: str = "operator") -> None:
        """Ask for a pause; one that is asked for already stays as it is."""
        with self._lock:
            self.paused_by = self.paused_by or by

    def resume(self) -> None:
        """Take the pause back."""
        with self._lock:
            self.paused_by = None

    def toggle(self) -> None:
        """Ask for a pause, or take it back where there is one."""
        with self._lock:
            self.paused_by = None if self.paused_by else "operator"

    def stop(self, by: str = "operator") -> None:
        """Ask for the end of the run; it cannot be taken back."""
        with self._lock:
            self.stopped_by = self.stopped_by or by

    def linger(self) -> None:
        """Let real time pass between two looks at a pause."""
        if self.linger_s:
            time.sleep(self.linger_s)
