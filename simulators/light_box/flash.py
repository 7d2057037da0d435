"""The photographic flash at the simulated light box: when it may fire, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

GAP_MS: Final = 5000  # as the firmware
IN_A_ROW: Final = 8  # as the firmware
REFILL_MS: Final = 75_000  # as the firmware


@dataclass(slots=True)
class Flash:
    """A flash behind a diffuser, fired by the box's trigger."""

    exposure_j_sr_m2: float = 100.0  # radiant exposure of one flash at the eye, in J·sr⁻¹·m⁻²
    fired_ms: list[int] = field(default_factory=list)  # box times of the flashes since the start
    _left: int = IN_A_ROW
    _refilled_ms: int = 0
    _gap_ms: int = 0  # after a restart

    def reset(self, now_ms: int) -> None:
        """Restart with the flashes that the box's memory holds; where some are missing, the least gap begins anew."""
        self.state(now_ms)
        self.fired_ms.clear()
        self._refilled_ms, self._gap_ms = 0, GAP_MS if self._left < IN_A_ROW else 0

    def state(self, now_ms: int) -> tuple[int, int]:
        """Return how many flashes are left and after how many ms one may be fired."""
        while self._left < IN_A_ROW and now_ms - self._refilled_ms >= REFILL_MS:
            self._left, self._refilled_ms = self._left + 1, self._refilled_ms + REFILL_MS
        wait_ms = max(0, (self.fired_ms[-1] + GAP_MS if self.fired_ms else self._gap_ms) - now_ms)
        return self._left, wait_ms

    def fire(self, now_ms: int) -> bool:
        """Fire, and return whether the box's limits let it."""
        left, wait_ms = self.state(now_ms)
        if left == 0 or wait_ms:
            return False
        if left == IN_A_ROW:
            self._refilled_ms = now_ms
        self._left -= 1
        self.fired_ms.append(now_ms)
        return True
