"""Request for a run of the test: who, by which protocol, before which devices."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.devices.exposure_account import EYES, name_of_eye
from radiometer.errors import UsageError


@dataclass(frozen=True, slots=True)
class RunRequest:
    """All that is known of a run before any device is open.

    Attributes:
        protocol: What is done.
        subject: Pseudonym of the subject.
        eye: "right" or "left": spot and blind spot are on its temporal side.
        seed: Seed of the catches and of a simulated subject's answers.
        box: "sim", a serial number or a port; None for the only one that answers, where the protocol needs a box.
        calibration: Light calibration; the box's own where None.
        preset: Light-box preset; the reference box's where None.
        white: Spectrum of the bleaching light; what light there is in the room counts as of the same.
        fixation_w_sr_m2: Radiance of the red mark; the protocol's luminance where None, 0 for none.
        accept_stale: Go on with a calibration that is older than the protocol allows.
        measure_room: Measure the dark room with a camera.
        camera: Camera for that, by name; the bench's own where None.
        bench: Bench file of that camera.
        room_cd_m2: Luminance of the simulated room.
        simulate: Simulated subject; None for a person.
        screen: Calibration of the screen that shows the spot.
        display: That screen: "browser", or a simulated one.
        port: Port of the subject's page; 0 for any free one.
    """

    protocol: AdaptationProtocol
    subject: str = ""
    eye: str = "right"
    seed: int = 0
    box: str | None = None
    calibration: Path | None = None
    preset: Path | None = None
    white: str = "white_led"
    fixation_w_sr_m2: float | None = None
    accept_stale: bool = False
    measure_room: bool = False
    camera: str | None = None
    bench: Path | None = None
    room_cd_m2: float = 0.0
    simulate: str | None = None
    screen: Path | None = None
    display: str = "browser"
    port: int = 0

    def __post_init__(self) -> None:
        if self.eye not in EYES:
            raise UsageError(f"--eye {self.eye}: {' or '.join(EYES)}")

    @property
    def whose(self) -> str | None:
        """Return whose eye looks, such as "s07 right", for the account of its exposure; None of no known subject."""
        return name_of_eye(self.subject, self.eye) if self.subject.strip() else None
