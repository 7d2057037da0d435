"""Status registers and error queue of one session (IEEE 488.2, chapter 11; SCPI-99, volume 1, chapter 9)."""

from __future__ import annotations

from collections import deque
from typing import Final

from radiometer.daemon.scpi.language import OPERATION_COMPLETE, POWER_ON, ScpiError

QUEUE_LENGTH: Final = 32  # errors kept; of a full queue the last becomes −350 (SCPI-99)

# Status byte
ERROR_AVAILABLE: Final = 1 << 2
QUESTIONABLE: Final = 1 << 3
MESSAGE_AVAILABLE: Final = 1 << 4
EVENT: Final = 1 << 5
MASTER: Final = 1 << 6
OPERATION: Final = 1 << 7

# Operation status
MEASURING: Final = 1 << 4
CONTINUOUS: Final = 1 << 8
# Questionable status; bit 8 is the standard's, 9 to 12 are the designer's
CALIBRATION: Final = 1 << 8
CAMERA_LOST: Final = 1 << 9
BOX_LOST: Final = 1 << 10
READING_FLAGGED: Final = 1 << 11
ALARM: Final = 1 << 12

OPERATION_BITS: Final = {4: "measuring", 8: "continuous measurement is on"}
QUESTIONABLE_BITS: Final = {
    8: "latest reading is `uncalibrated` or `stale_calibration` (calibration too old)",
    9: "camera lost, overdue or failing",
    10: "light box lost or overdue",
    11: "latest reading carries another flag (`FETCh:FLAGs?` names it)",
    12: "an alarm is active, such as a limit, the period or the journal (`SYSTem:ALARm?` names it)",
}


class Register:
    """Condition, event and enable register; an event is latched where a condition bit rises."""

    def __init__(self) -> None:
        self.condition = 0
        self.event = 0
        self.enable = 0

    def update(self, condition: int) -> None:
        """Take a new condition and latch what rose."""
        self.event |= condition & ~self.condition
        self.condition = condition

    def take_event(self) -> int:
        """Return the event register and clear it."""
        event, self.event = self.event, 0
        return event

    @property
    def summary(self) -> bool:
        """Return whether an enabled event is latched."""
        return bool(self.event & self.enable)


class Status:
    """All status of one session."""

    def __init__(self) -> None:
        self.operation, self.questionable = Register(), Register()
        self.event_status = POWER_ON
        self.event_enable = 0
        self.service_enable = 0
        self._errors: deque[ScpiError] = deque()

    def push(self, error: ScpiError) -> None:
        """Queue an error; when the queue is full its last entry turns into -350."""
        self.event_status |= error.event_bit
        if len(self._errors) >= QUEUE_LENGTH:
            self._errors[-1] = ScpiError(-350)
        else:
            self._errors.append(error)

    def next_error(self) -> str:
        """Return the oldest error and forget it; `0,"No error"` when there is none."""
        return (self._errors.popleft() if self._errors else ScpiError(0)).entry

    @property
    def error_count(self) -> int:
        """Return how many errors are queued."""
        return len(self._errors)

    def complete(self) -> None:
        """Set the operation-complete bit."""
        self.event_status |= OPERATION_COMPLETE

    def take_event_status(self) -> int:
        """Return the standard event status register and clear it."""
        event, self.event_status = self.event_status, 0
        return event

    def clear(self) -> None:
        """Clear events and errors (*CLS); enable registers stay."""
        self._errors.clear()
        self.event_status = self.operation.event = self.questionable.event = 0

    def preset(self) -> None:
        """Set the enable registers of the SCPI part to their preset (STATus:PRESet)."""
        self.operation.enable = self.questionable.enable = 0

    def status_byte(self, *, message_available: bool = False) -> int:
        """Return the status byte."""
        byte = ERROR_AVAILABLE * bool(self._errors)
        byte |= QUESTIONABLE * self.questionable.summary
        byte |= MESSAGE_AVAILABLE * message_available
        byte |= EVENT * bool(self.event_status & self.event_enable)
        byte |= OPERATION * self.operation.summary
        return byte | MASTER * bool(byte & self.service_enable & ~MASTER)
