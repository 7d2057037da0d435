"""Request for a run of the test: who, by which protocol, before which devices."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.errors import UsageError

EYES: Final = ("right", "left")


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

    def __post_init__(self) -> None:
        if self.eye not in EYES:
            raise UsageError(f"--eye {self.eye}: {' or '.join(EYES)}")

    @property
    def whose(self) -> str | None:
        """Return whose eye looks, such as "S07 right", for the account of its exposure; None of no known subject."""
        return f"{self.subject} {self.eye}" if self.subject else None
