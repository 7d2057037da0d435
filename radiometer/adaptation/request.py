"""Request for a run of the test: who, by which protocol, before which devices; how to pause, resume and stop it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.devices.exposure_account import EYES, name_of_eye
from radiometer.errors import UsageError


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


SIMULATED_BOX: Final = "sim"


@dataclass(frozen=True, slots=True)
class RunRequest:
    """All that is known of a run before any device is open."""

    protocol: AdaptationProtocol  # what is done
    subject: str = ""  # pseudonym of the subject
    eye: str = "right"  # "right" or "left": spot and blind spot are on its temporal side
    seed: int = 0  # seed of the catches and of a simulated subject's answers
    # "sim", a serial number or a port; None for the only one that answers, where the protocol needs a box
    box: str | None = None
    calibration: Path | None = None  # light calibration; the box's own where None
    preset: Path | None = None  # light-box preset; the reference box's where None
    white: str = "white_led"  # spectrum of the bleaching light; what light there is in the room counts as of the same
    fixation_w_sr_m2: float | None = None  # radiance of the red mark; the protocol's luminance where None, 0 for none
    accept_stale: bool = False  # go on with a calibration that is older than the protocol allows
    measure_room: bool = False  # measure the dark room with a camera
    camera: str | None = None  # camera for that, by name; the bench's own where None
    bench: Path | None = None  # bench file of that camera
    room_cd_m2: float = 0.0  # luminance of the simulated room
    simulate: str | None = None  # simulated subject; None for a person
    screen: Path | None = None  # calibration of the screen that shows the spot
    display: str = "browser"  # that screen: "browser", or a simulated one
    port: int = 0  # port of the subject's page; 0 for any free one
    age_years: float | None = None  # age of the subject; None where it is not stated
    pupil_mm: float | None = None  # diameter of the pupil as measured at this visit; None where it is not
    visit: str | None = None  # when the visit began, ISO 8601 in UTC; None where it is not known
    practice: bool = False  # a few minutes without a bleach, to learn the task; nothing of it is fitted

    def __post_init__(self) -> None:
        if self.eye not in EYES:
            raise UsageError(f"--eye {self.eye}: {' or '.join(EYES)}")

    @property
    def simulated(self) -> str | None:
        """Return what of the run is simulated, such as "steady, light box"; None before real devices."""
        if self.simulate is None:
            return None
        before = "light box" if self.box == SIMULATED_BOX else "screen" if self.screen is not None else "no device"
        return f"{self.simulate}, {before}"

    def header(self) -> dict[str, str | float]:
        """Return what the head of journal and table states of the visit; what is not known is left out."""
        known = {
            "subject": self.subject, "eye": self.eye, "visit": self.visit, "age_years": self.age_years,
            "pupil_mm": self.pupil_mm, "simulated": self.simulated,
        }  # fmt: skip
        return {name: value for name, value in known.items() if value is not None}

    def smaller_pupil(self) -> str | None:
        """Return what a pupil below the protocol's does to its bleach; None where it makes no difference."""
        asked = self.protocol.bleach.pupil_mm
        if asked is None or self.pupil_mm is None or self.pupil_mm >= asked:
            return None
        share = (self.pupil_mm / asked) ** 2
        return (
            f"the pupil of {self.pupil_mm:g} mm passes {100 * share:.0f} % of the bleach that {self.protocol.name} "
            f"gives through {asked:g} mm: break and rod intercept come earlier; dilate it, or change bleach.pupil_mm"
        )

    @property
    def whose(self) -> str | None:
        """Return whose eye looks, such as "s07 right", for the account of its exposure; None of no known subject."""
        return name_of_eye(self.subject, self.eye) if self.subject.strip() else None
