"""Devices that can be opened, their health, new bench files, and simulated devices served to other programs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Result
from radiometer.bench.boxes import find_boxes
from radiometer.bench.cameras import OWN_KINDS, SIMULATED, list_cameras
from radiometer.bench.config import BenchConfig, read_bench
from radiometer.bench.doctor import check_daemon, examine
from radiometer.bench.served import Faults, serve, served_box, served_camera, tend
from radiometer.data.capture_header import other_notation, serial_shown
from radiometer.data.storage import write_yaml_atomic
from radiometer.data.validation import validate
from radiometer.devices import CameraIdentity, Finding, Health, LightBoxIdentity
from radiometer.errors import ConfigurationError, UsageError
from radiometer.plausible import AnyCount, Duration, FilterDensity, FNumber, PerMille, Positive, Seed, Share

_PRESET: Final = {"kind": "simulated", "preset": "BFS-U3-19S4M"}
_EVEN_FIELD: Final = {"kind": "uniform", "radiance_W_per_sr_m2": 0.3}
_SIMULATED_LENS: Final = {"focal_length_mm": 16.0, "f_number": 4.0}


@dataclass(frozen=True, repr=False)
class Devices(Result):
    """Cameras and light boxes that can be opened.

    Attributes:
        cameras: The cameras.
        light_boxes: The boxes.
        ports_in_use: Ports that another program holds.
        note: Which library is missing; "" where none is.
    """

    cameras: tuple[CameraIdentity, ...]
    light_boxes: tuple[LightBoxIdentity, ...]
    ports_in_use: tuple[str, ...]
    note: str | None

    def to_mapping(self) -> dict[str, Any]:
        cameras = [{**asdict(one), "serial_also": other_notation(one.serial)} for one in self.cameras]
        boxes = [asdict(one) for one in self.light_boxes]
        return self.plain("ports_in_use", "note", cameras=cameras, light_boxes=boxes)

    def lines(self) -> list[str]:
        """Return a line for every device, with the option that names it."""
        return [
            *(_camera_line(one) for one in self.cameras),
            *(
                f"light box  serial {box.serial}  firmware {box.firmware}  {box.port}  --box {box.serial}"
                for box in self.light_boxes
            ),
        ]

    def __str__(self) -> str:
        return f"{len(self.cameras)} cameras, {len(self.light_boxes)} light boxes"


def _camera_line(entry: CameraIdentity) -> str:
    name = SIMULATED if entry.interface == "simulated" else entry.serial or entry.device_id
    if entry.device_id.partition(":")[0] in OWN_KINDS:
        name = entry.device_id
    serial = f"  serial {serial_shown(entry.serial)}" if entry.serial else ""
    return f"{entry.vendor} {entry.model}{serial}  {entry.interface}  --camera {name}".strip()


def list_devices(bench: PathLike | None = None) -> Devices:
    """List the cameras and boxes that can be opened.

    Examples:
        >>> import radiometer as rm
        >>> rm.list_devices("bench.yaml").cameras[0].serial
        '22500001'

    Args:
        bench: Bench file; the simulated bench by default.

    Raises:
        ConfigurationError: If the bench file is wrong.
    """
    cameras, missing = list_cameras(*read_bench(Path(bench) if bench else None))
    boxes, held = find_boxes()
    return Devices(tuple(cameras), tuple(boxes), tuple(held), missing)


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """What was found of computer and camera.

    Attributes:
        findings: Each with its health and cure.
    """

    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Return whether nothing keeps one from measuring."""
        return not any(one.health is Health.FAULT for one in self.findings)

    def to_mapping(self) -> dict[str, Any]:
        return self.plain("sound", "findings")

    def __str__(self) -> str:
        wrong = ", ".join(one.check for one in self.findings if one.health is Health.FAULT)
        return f"not sound: {wrong}" if wrong else f"sound: {len(self.findings)} checks"


def doctor(camera: str | None = None, bench: PathLike | None = None) -> Diagnosis:
    """Check the whole chain from library to light, each finding with its cure.

    Looks at the library, USB permissions, network, socket buffers and the daemon; with a camera also at features that
    falsify radiometry, the frame rate achieved, temperature, dark level, and linearity by two exposures. The command
    ends with exit code 1 if anything keeps one from measuring.

    Examples:
        >>> import radiometer as rm
        >>> "daemon" in [finding.check for finding in rm.doctor().findings]
        True

    Args:
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:; the computer alone by default.
        bench: Bench file; the simulated bench by default.

    Raises:
        ConfigurationError: If the bench file is wrong.
    """
    found = check_daemon(), *examine(Path(bench) if bench else None, camera)
    alone = Finding("camera", Health.NOTE, "the camera itself was not looked at", "name one with --camera")
    return Diagnosis(found if camera is not None else (*found, alone))


def new_bench(
    output: PathLike,
    camera: str,
    *,
    focal_length_mm: Positive | None = None,
    f_number: FNumber | None = None,
    calibration: str | None = None,
    patch: PatchLike | None = None,
) -> Path:
    """Write a bench file: which camera, lens and calibration belong together.

    Examples:
        >>> import radiometer as rm
        >>> file = rm.new_bench("new.yaml", "sim", focal_length_mm=16, f_number=4)
        >>> with rm.open(file, uncalibrated=True) as meter:
        ...     meter.instrument.lens.f_number
        4.0

    Args:
        output: File to write (.yaml).
        camera: Serial number, id or address; "sim" for a simulated one.
        focal_length_mm: Focal length of the lens in mm; None where there is none or it is not known.
        f_number: f-number that it is set to.
        calibration: Calibration file; none by default.
        patch: Region to measure; the middle by default.

    Raises:
        UsageError: If an answer is missing or wrong.
        ConfigurationError: If the form of bench files does not allow a value.
        OutputError: If the file cannot be written.
    """
    path = Path(output)
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{path}: a bench file's name must end in .yaml")
    if not camera:
        raise UsageError("a bench needs a camera: --camera sim, or the serial number that `radiometer devices` lists")
    if focal_length_mm and not f_number:
        raise UsageError("a lens of known focal length needs its f-number: --f-number 4")
    lens = {"focal_length_mm": focal_length_mm, "f_number": f_number} if focal_length_mm else None
    mapping: dict[str, Any] = {"format": "radiometer-bench/1", "camera": {"kind": "genicam", "id": camera}}
    mapping["lens"] = lens
    if camera == SIMULATED:
        mapping |= {"camera": dict(_PRESET), "lens": lens or dict(_SIMULATED_LENS), "scene": dict(_EVEN_FIELD)}
    if calibration:
        mapping["calibration"] = calibration
    if region := as_patch(patch):
        mapping["patch"] = asdict(region)
    validate(BenchConfig, mapping, str(path), ConfigurationError)
    write_yaml_atomic(path, mapping)
    return path


def simulate_camera(
    scene: str | None = None,
    *,
    serial: str | None = None,
    bench: PathLike | None = None,
    address: str = "127.0.0.1",
    seed: Seed | None = None,
    real_time: bool = True,
    lose_per_mille: PerMille = 0,
    answer_delay_s: Duration = 0.0,
    stall_after: AnyCount | None = None,
    drop_after: AnyCount | None = None,
    frame_pool: AnyCount = 0,
    awkward: bool = False,
    ready: Callable[[str], None] = print,
) -> None:
    """Serve a simulated Blackfly S that any GenICam program can open, until Ctrl-C or a termination signal.

    Its pictures come from the forward model: the bench's camera, lens and scene. As shipped, automatic exposure, gamma
    and sharpening are on. Faults can also be set over the wire, by the features SimPacketLossPerMille, SimStall,
    SimAnswerDelay and SimDisconnect.

    Args:
        scene: YAML file of a scene, a picture, or a kind of scene; the bench's by default.
        serial: Serial number; the bench's by default.
        bench: Bench file; the simulated bench by default.
        address: Address of a network interface of this computer.
        seed: Makes the noise; the bench's by default.
        real_time: Frames take their exposure time, or come as they are made.
        lose_per_mille: Packets lost of a thousand.
        answer_delay_s: Time in s by which frames and answers are late.
        stall_after: Stop sending after so many frames.
        drop_after: Fall silent after so many frames.
        frame_pool: Serve so many frames again and again; 0 makes every frame anew.
        awkward: As awkward as a real one: no Mono12, chunks, stale frames, locked features.
        ready: Called with one line once it is served.

    Raises:
        ConfigurationError: If the bench has no simulated camera, or a file holds something not allowed.
    """
    camera = served_camera(
        Path(bench) if bench else None, scene, serial=serial, address=address, seed=seed, real_time=real_time,
        pool=frame_pool, awkward=awkward,
    )  # fmt: skip
    with camera:
        ready(f"{camera.label} is served at {address}; stop with Ctrl-C")
        serve(camera, Faults(lose_per_mille, answer_delay_s, stall_after, drop_after))


def simulate_box(
    serial: str = "TWIN0001",
    link: PathLike | None = None,
    *,
    firmware: PathLike | None = None,
    clock_ppm: float = 0.0,
    corrupt: Share = 0.0,
    drop: Share = 0.0,
    reset_every_s: Positive | None = None,
    press_every_s: Positive | None = None,
    seed: Seed = 0,
    subject: str | None = None,
    filter_density: FilterDensity = 3.0,
    ready: Callable[[str], None] = print,
    entered: Callable[[float], bool] | None = None,
) -> None:
    """Serve a simulated light box that any serial program can open, until stopped by Ctrl-C.

    It is on a pseudo-terminal. The command's first line on standard output is the name of its port; on a terminal,
    Enter presses the button for 0.2 s.

    Args:
        serial: Serial number: eight letters or digits.
        link: Name of its port; where boxes are looked for by default.
        firmware: Run this firmware (light_box.hex) in simavr instead of the simulated box.
        clock_ppm: Rate of its clock above true time in ppm.
        corrupt: Share of bytes that the line damages.
        drop: Share of bytes that the line loses.
        reset_every_s: Restart the box this often.
        press_every_s: Press the button this often for 0.2 s.
        seed: Makes the line's faults and the subject's answers.
        subject: Simulated subject before it: "steady", "never", "always", "leaves".
        filter_density: Density of the neutral filter between spot and subject.
        ready: Called with the name of its port once it is served.
        entered: Waits so many seconds and returns whether the button is to be pressed.

    Raises:
        UsageError: If the serial number or the subject is not possible, or firmware runs with another clock or resets.
        OutputError: If the link cannot be made.
        MissingLibrary: If simavr is asked for and not installed.
    """
    if firmware is not None and (clock_ppm or reset_every_s):
        raise UsageError("--clock-ppm and --reset-every are of the simulated box, not of its firmware: leave them out")
    known_link, known_firmware = (Path(one) if one else None for one in (link, firmware))
    made = served_box(
        serial, known_link, firmware=known_firmware, clock_ppm=clock_ppm, corrupt=corrupt, drop=drop, seed=seed,
        subject=subject, filter_density=filter_density,
    )  # fmt: skip
    with made.server as server:
        ready(server.port)
        with contextlib.suppress(KeyboardInterrupt):
            tend(made, reset_every_s, press_every_s, entered)
