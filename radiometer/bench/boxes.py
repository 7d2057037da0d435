"""Light boxes: found by identity, opened by serial number or port, simulated as "sim".

USB devices that answered as light boxes are remembered: no other device is asked without being named.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Self

from pydantic import Field, model_validator

from drivers.light_box.box import FLASH, SerialLightBox
from drivers.light_box.link import BoxLink
from drivers.light_box.serial_line import SerialLine, SerialPort, list_serial_ports
from radiometer.bench.box_holder import account_folder, ask_for_darkness, held_boxes, holder_of, holding, is_ours
from radiometer.data.guards import safe_file_name
from radiometer.data.light_calibration import LightCalibration
from radiometer.data.storage import read_yaml, shipped_config, state_folder, write_yaml_atomic
from radiometer.data.validation import ConfigSection, validate
from radiometer.devices.exposure_account import ANY_EYE, NO_HISTORY, AccountStore, FileStore, MemoryStore
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.light_box import CurrentRange, LightBoxIdentity
from radiometer.devices.retinal_safety import BLUE_WINDOW_S, DEFAULT_FRACTION, ChannelOptics, FlashLight
from radiometer.errors import (
    CalibrationError,
    ConfigurationError,
    DeviceError,
    DeviceInUse,
    DeviceNotFound,
    InputError,
    OutputError,
    UsageError,
)
from radiometer.plausible import PLAUSIBLE
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import VirtualLine

SIMULATED: Final = "sim"
SIMULATED_SERIAL: Final = "SIM00001"
DEFAULT_PRESET: Final = "light_boxes/reference.yaml"
PORT_VARIABLE: Final = "RADIOMETER_LIGHT_BOX_PORTS"
TEND_SLICE_S: Final = 0.2  # a fifth of the box's dead-man time
_SILENT: Final[
    dict[str, float]
] = {}  # ports that were asked and did not answer as a box, and when they were plugged in
_DIMMEST_REL: Final = 1e-4  # of the preset's bound: neutral filters before a spot have a density of 3
_DIM_REL: Final = 0.01  # of the preset's bound: no box is so dim in all of its channels
_LINKED_WITHIN_S: Final = 0.1  # a box links its terminal at once; the clock of file times ticks in 4 ms
SIMULATED_PORTS: Final = "simulated-boxes"
_FORMAT: Final = "radiometer-known-boxes/1"


def is_known(port: SerialPort) -> bool:
    """Return whether a device with this vendor, product and serial number has answered as a light box before.

    A USB device without a serial number is never known: it cannot be distinguished from another of its kind.
    """
    return bool(port.usb_serial) and _identity(port) in _known()


def remember(port: str, plugged: Sequence[SerialPort]) -> None:
    """Remember the USB device behind a port, which has just answered as a light box.

    Where it cannot be stored, the port has to be named next time as well.
    """
    real = os.path.realpath(port)
    device = next((one for one in plugged if os.path.realpath(one.device) == real), None)
    if device is None or not device.usb_serial or is_known(device):
        return
    try:
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_yaml_atomic(_file(), {"format": _FORMAT, "devices": sorted({*_known(), _identity(device)})})
    except (OSError, OutputError):
        return


def _identity(port: SerialPort) -> str:
    return f"{port.vendor_id or 0:04x}:{port.product_id or 0:04x}:{port.usb_serial}"


def _known() -> frozenset[str]:
    try:
        devices = read_yaml(_file()).get("devices")
    except InputError:
        return frozenset()  # none is known: the way out is to name the port once
    return frozenset(map(str, devices)) if isinstance(devices, list) else frozenset()


def _file() -> Path:
    return state_folder() / "known-boxes.yaml"


class PlaceConfig(ConfigSection):
    """Place of a channel with a separate opening, seen from the eye: temporal of and below the red mark."""

    temporal_deg: float = Field(ge=-60, le=90)
    below_deg: float = Field(0.0, ge=-60, le=60)


class ChannelConfig(ConfigSection):
    """What the eye meets when a channel is on; see ChannelOptics.

    A channel without a place stands where the test spot does, or fills the field.
    """

    peak_nm: float | None = Field(None, gt=300, lt=1100)
    fwhm_nm: float = Field(20.0, ge=0)  # of a peak; a white channel has none
    subtense_deg: float = Field(gt=0, le=180)
    # Below the absolute threshold of the eye (about 1e-6 scotopic cd·m⁻²) a bound is in a wrong unit.
    radiance_bound_W_per_sr_m2: float = Field(ge=1e-9)  # noqa: N815 (the file's key)
    low_range_ratio_bound: float = Field(0.01, ge=1e-6, le=1)
    place: PlaceConfig | None = None

    @model_validator(mode="after")
    def _has_a_width(self) -> Self:
        if self.peak_nm is not None and not PLAUSIBLE["width"].holds(self.fwhm_nm):
            raise ValueError(f"fwhm_nm of a peak: {PLAUSIBLE['width'].refusal(self.fwhm_nm)}")
        return self

    @property
    def optics(self) -> ChannelOptics:
        """Return the optics for the safety account."""
        bound, ratio = self.radiance_bound_W_per_sr_m2, self.low_range_ratio_bound
        return ChannelOptics(self.peak_nm, self.fwhm_nm, self.subtense_deg, bound, ratio)


class FlashConfig(ConfigSection):
    """The photographic flash at the trigger output; see FlashLight."""

    exposure_J_per_sr_m2: float = Field(gt=0)  # noqa: N815 (the file's key)
    exposure_bound_J_per_sr_m2: float = Field(gt=0)  # noqa: N815
    duration_s: float = Field(gt=1e-5, le=0.25)
    subtense_deg: float = Field(gt=0, le=180)

    @property
    def light(self) -> FlashLight:
        """Return the flash for driver and safety account."""
        return FlashLight(
            self.exposure_J_per_sr_m2, self.exposure_bound_J_per_sr_m2, self.duration_s, self.subtense_deg
        )


class LightBoxConfig(ConfigSection):
    """A light-box preset file."""

    format: Literal["radiometer-light-box/1"] = "radiometer-light-box/1"
    name: str = "light box"
    allowed_fraction: float = Field(DEFAULT_FRACTION, gt=0, le=DEFAULT_FRACTION)  # a preset may only allow less
    channels: dict[str, ChannelConfig]
    flash: FlashConfig | None = None

    @property
    def optics(self) -> dict[str, ChannelOptics]:
        """Return the optics of each channel, and of the flash where there is one."""
        known = {name: channel.optics for name, channel in self.channels.items()}
        return known if self.flash is None else {**known, FLASH: self.flash.light.optics}


@dataclass(frozen=True, slots=True)
class OpenedBox:
    """An open light box with what belongs to it."""

    box: SerialLightBox  # the box
    config: LightBoxConfig  # its preset
    calibration: LightCalibration | None  # its calibration; None where there is none
    wait: Callable[[float], None]  # lets a time in s pass while the box is kept lit
    twin: SimulatedLightBox | None = None  # the simulated box behind it; None for a real one


def read_preset(path: Path | None = None) -> LightBoxConfig:
    """Return a light-box preset; the reference box's where none is named. Raises ConfigurationError."""
    file = path or shipped_config(DEFAULT_PRESET)
    try:
        mapping = read_yaml(file)
    except InputError as error:
        raise ConfigurationError(str(error)) from error
    return validate(LightBoxConfig, mapping, str(file), ConfigurationError)


def candidate_ports() -> list[str]:
    """Return the ports on which a light box may answer, by what USB says of them: none of them is opened for it.

    They are those that the user names, those of simulated boxes that run, and those of USB devices that have answered
    as a light box before, when their port was named. Whatever else is plugged in never gets a byte, for opening the
    port of an Arduino resets it.
    """
    named = [port for port in os.environ.get(PORT_VARIABLE, "").split(os.pathsep) if port]
    folder = simulated_port_folder()
    simulated = sorted(str(link) for link in folder.glob("*") if _is_of_a_running_box(link)) if is_ours(folder) else []
    known = [port.device for port in list_serial_ports() if is_known(port)]
    by_device: dict[str, str] = {}
    for port in [*named, *simulated, *known]:  # a device counts once, by the first of its names
        by_device.setdefault(os.path.realpath(port), port)
    return list(by_device.values())


def _is_of_a_running_box(link: Path) -> bool:
    """Return whether a simulated box's link leads to its own pseudo-terminal, not to another program's.

    A box that was killed leaves its link; its terminal's number is given to the next program. That terminal is younger
    than the link.
    """
    try:
        return link.stat().st_ctime <= link.lstat().st_ctime + _LINKED_WITHIN_S
    except OSError:
        return False


def _is_named_or_simulated(port: str) -> bool:
    return port in os.environ.get(PORT_VARIABLE, "").split(os.pathsep) or Path(port).parent == simulated_port_folder()


def _when_plugged(port: str) -> float:
    """Return when a port's device file was made, in s since 1970: another time is another device."""
    try:
        return Path(port).stat().st_ctime
    except OSError:
        return 0.0


def simulated_port_folder() -> Path:
    """Return the folder in which `radiometer simulate box` keeps links to its ports."""
    return account_folder() / SIMULATED_PORTS


def find_boxes() -> tuple[list[LightBoxIdentity], list[str]]:
    """Return the light boxes that answer, and ports that another program holds.

    Opening a port resets an Arduino on it. One that was neither named nor simulated is asked with one line; if that is
    not answered, it is left alone until replugged.
    """
    found, held = [], []
    for port in candidate_ports():
        mild = not _is_named_or_simulated(port)
        if mild and _SILENT.get(port) == _when_plugged(port):
            continue
        box = _asked_box(port, mild=mild)
        try:
            with box:
                found.append(box.identity)
            remember(port, list_serial_ports())
        except DeviceInUse:
            held.append(port)
        except DeviceNotFound:
            _SILENT[port] = _when_plugged(port)
    return found, held


def _asked_box(port: str, *, mild: bool) -> SerialLightBox:
    """Return the box on a port as it is opened to be asked and darkened, not to give light."""
    box = _serial_box(port, read_preset(), MemoryStore(time.monotonic))
    box.keep_alive, box.mild = False, mild
    return box


@dataclass(frozen=True, slots=True)
class DarkBox:
    """A light box that was darkened."""

    serial: str  # its serial number
    dark: Mapping[str, bool]  # whether each channel is dark, as read back; empty where another process holds the box
    darkened_by: int | None = None  # the process that holds it; None where none does


def darken(name: str | None = None, channel: str | None = None) -> tuple[list[DarkBox], list[DeviceError]]:
    """Darken every light box that can be reached, also those that another program holds, and say which failed.

    No box that fails, is simulated or is dead keeps another one lit. Neither calibration nor preset is needed.

    Args:
        name: A serial number or port, by any of its names, where only one is meant.
        channel: One channel; all where None. A program that holds a box darkens all of it.

    Returns:
        The boxes that are dark, and what went wrong with others.
    """
    if name == SIMULATED:
        with _simulated(read_preset()).box as simulated:
            return [_darkened(simulated, channel)], []
    dark, failures = list[DarkBox](), list[DeviceError]()
    all_held = held_boxes()
    port = None if name is None else os.path.realpath(name)
    held = [e for e in all_held if name in (None, e.serial) or os.path.realpath(e.port) == port or not e.serial]
    for entry in held:
        try:
            ask_for_darkness(entry)
            dark.append(DarkBox(entry.serial, {}, entry.pid))
        except DeviceInUse as error:
            failures.append(error)
    is_port = name is not None and ("/" in name or Path(name).exists())
    taken = {os.path.realpath(entry.port) for entry in all_held}
    ports = [name] if name is not None and is_port else [] if held and name is not None else candidate_ports()
    for port in ports:
        if os.path.realpath(port) in taken:
            continue
        try:
            with _asked_box(port, mild=not is_port and not _is_named_or_simulated(port)) as box:
                if name is not None and not is_port and box.identity.serial != name:
                    continue
                dark.append(_darkened(box, channel))
        except DeviceInUse as error:
            try:
                dark.append(_darkened_by_holder(port, error))
            except DeviceInUse as still:
                failures.append(still)
        except DeviceNotFound as error:
            if is_port:
                failures.append(error)
        except DeviceError as error:
            failures.append(error)
    return dark, failures


def _darkened_by_holder(port: str, error: DeviceInUse) -> DarkBox:
    """Have whoever locks a port darken its box, wherever that program keeps its account. Raises DeviceInUse."""
    held = holder_of(port)
    if held is None:
        raise error
    ask_for_darkness(held)
    return DarkBox(held.serial, {}, held.pid)


def _darkened(box: SerialLightBox, channel: str | None) -> DarkBox:
    for one in box.channels if channel is None else (channel,):
        box.off(one)
    levels = {one: box.read_channel(one).drive.level for one in box.channels}
    return DarkBox(box.identity.serial, {one: level == 0 for one, level in levels.items()})


def calibration_file(serial: str) -> Path:
    """Return where the calibration of a box is kept: the user's data folder."""
    base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "radiometer" / "light_boxes" / f"{safe_file_name(serial)}.yaml"


def exposure_store() -> FileStore:
    """Return the account of retinal exposure of this user."""
    return FileStore(account_folder())


def require_known_box(serial: str | None) -> str:
    """Return a serial number that the account knows.

    Raises:
        UsageError: If none is named, or the account does not know it: a box is known once it was opened.
        UnsafeStimulus: If the account cannot be read.
    """
    known = sorted(key.removeprefix("box ") for key in exposure_store().look().given if key.startswith("box "))
    if serial is None or serial not in known:
        named = (
            "name a light box by its serial number" if serial is None else f"the account knows no light box {serial}"
        )
        there = f"it knows {', '.join(known)}" if known else "it knows none"
        raise UsageError(f"{named}: --box SERIAL; {there}. A box is known once a command has opened it")
    return serial


@dataclass(frozen=True, slots=True)
class ExposureReport:
    """What the account of retinal exposure holds of a box or an eye."""

    name: str  # "box SERIAL", "eye SUBJECT right", or "any eye" for light that no eye was named for
    # Fraction of the blue-light limit used up within 10⁴ s, with all that is planned; every eye's holds any eye's too
    blue_light: float
    frees_in_s: float  # time in s after which all of it has left the window
    # Time in s for which the limit counts as used up, for the history is unknown; 0 where it is known
    unknown_for_s: float


def exposure_reports() -> tuple[list[ExposureReport], str]:
    """Return what the account holds of every box and eye, and what is wrong with its file: "" for nothing.

    Raises:
        UnsafeStimulus: If the account cannot be read.
    """
    account = exposure_store().look()
    names = {*account.given, *(key for planned in account.planned.values() for key in planned.keys)}
    reports = []
    for name in sorted(names):
        keys = {name, ANY_EYE} if name.startswith("eye ") else {name}
        open_blue = sum(planned.blue() for planned in account.planned.values() if keys & set(planned.keys))
        ends_s = (end_s for key in keys for end_s in account.given.get(key, {}))
        frees_s = max(ends_s, default=-math.inf) + BLUE_WINDOW_S - account.now_s
        unknown_s = account.assumed.get(name, (account.now_s, ""))[0] - account.now_s
        frees_in_s = BLUE_WINDOW_S if open_blue else max(frees_s, 0.0)
        reports.append(ExposureReport(name, sum(map(account.blue, keys)) + open_blue, frees_in_s, unknown_s))
    return reports, "" if account.reason == NO_HISTORY else account.reason


@contextmanager
def open_light_box(
    name: str | None = None, *, calibration: Path | None = None, preset: Path | None = None, eye: str | None = None
) -> Iterator[OpenedBox]:
    """Open a light box for the block; it is dark afterwards.

    Args:
        name: "sim", a serial number or a port; None for the only one that answers.
        calibration: Calibration file; the one kept for its serial number where None.
        preset: Light-box preset; the reference box's where None.
        eye: Whose eye looks into it, as `name_of_eye` returns it: its exposure is counted over all boxes. Where it is
            not known (None), the light counts for every eye.

    Raises:
        DeviceNotFound: If it does not answer, or several do and none is named.
        DeviceInUse: If another program holds it.
        CalibrationError: If the calibration is of another box.
    """
    config = read_preset(preset)
    opened = _simulated(config) if name == SIMULATED else _real(name, config)
    opened.box.ledger.eye = eye
    with opened.box as box:
        file = calibration or calibration_file(box.identity.serial)
        known = read_box_calibration(file, box.identity.serial) if calibration or file.is_file() else None
        if known is not None:
            _require_plausible(known, file, box, config)
        box.calibration = known
        if opened.twin is None:
            remember(box.link.line.name, list_serial_ports())
        with nullcontext() if opened.twin else holding(box.identity.serial, box.link.line.name, box.switch_off):
            yield OpenedBox(box, config, known, opened.wait, opened.twin)
        box.darken()  # what does not go dark is an error of whoever lit it


def _require_plausible(known: LightCalibration, file: Path, box: SerialLightBox, config: LightBoxConfig) -> None:
    """Refuse a calibration that is not of this box's channels: the account of the exposure would count too little."""
    shares = []
    for name, channel in known.channels.items():
        own, preset = box.channels.get(name), config.channels.get(name)
        if own is None or channel.duty_steps != own.duty_steps:
            steps = "no such channel" if own is None else f"{own.duty_steps}"
            raise CalibrationError(
                f"{file}: {name} has {channel.duty_steps} duty steps, the box states {steps}; it is of other firmware: "
                "make one with `radiometer light calibrate`"
            )
        brightest = known.highest_radiance(name, own.level_limit[CurrentRange.HIGH], high=True)
        if preset is not None and brightest is not None:
            bound = preset.radiance_bound_W_per_sr_m2
            shares.append(brightest / bound)
            if brightest < _DIMMEST_REL * bound:
                raise CalibrationError(
                    f"{file}: {name} has {brightest:.3g} W·sr⁻¹·m⁻² at its highest level, the preset's bound is "
                    f"{bound:g}. Was a cap or filter before the camera? Calibrate again, or state the bound by --preset"
                )
    if shares and max(shares) < _DIM_REL:
        raise CalibrationError(
            f"{file}: no channel reaches more than {max(shares):.2g} of the preset's bound. Was a filter before the"
            " camera? Calibrate again without it, or state the bounds behind a filter of the box by --preset"
        )


def read_box_calibration(path: Path, serial: str) -> LightCalibration:
    """Return the calibration of a box. Raises CalibrationError if it is of another one, InputError if it is damaged."""
    calibration = LightCalibration.read(path)
    if calibration.box_serial != serial:
        raise CalibrationError(
            f"{path} is the calibration of light box {calibration.box_serial}, this is {serial}; "
            "give its own, or make one with `radiometer light calibrate`"
        )
    return calibration


def _serial_box(port: str, config: LightBoxConfig, store: AccountStore) -> SerialLightBox:
    return SerialLightBox(
        BoxLink(SerialLine(port)),
        ExposureLedger(config.optics, store, config.allowed_fraction),
        flash=config.flash.light if config.flash else None,
    )


def _real(name: str | None, config: LightBoxConfig) -> OpenedBox:
    port = name if name is not None and ("/" in name or Path(name).exists()) else _port_of(name)
    return OpenedBox(_serial_box(port, config, exposure_store()), config, None, time.sleep)


def _port_of(serial: str | None) -> str:
    boxes, held = find_boxes()
    fitting = [box for box in boxes if serial is None or box.serial == serial]
    if len(fitting) == 1:
        return fitting[0].port
    if len(fitting) > 1:
        raise DeviceNotFound(
            "several light boxes answer; name one with --box: " + ", ".join(box.serial for box in fitting)
        )
    raise DeviceNotFound(nothing_answers(serial, held))


def nothing_answers(serial: str | None, held: Sequence[str] = ()) -> str:
    """Return the message where no light box answers, with the ports that were not asked."""
    reason = "no light box answers" if serial is None else f"no light box {serial} answers"
    busy = f" (held by another program: {', '.join(held)})" if held else ""
    others = sorted({port.device for port in list_serial_ports()} - set(candidate_ports()))
    left_out = f" (not asked, for none has answered as a light box before: {', '.join(others)})" if others else ""
    return f"{reason}{busy}{left_out}; plug it in, name its port with --box once, or use --box {SIMULATED}"


def _simulated(config: LightBoxConfig) -> OpenedBox:
    twin = SimulatedLightBox(SimulatedBoxSettings(serial=SIMULATED_SERIAL))
    line = VirtualLine(twin, latency_s=0.0003)
    ledger = ExposureLedger(config.optics, MemoryStore(line.now, (SIMULATED_SERIAL,)), config.allowed_fraction)
    flash = config.flash.light if config.flash else None
    box = SerialLightBox(BoxLink(line), ledger, keep_alive=False, flash=flash)

    def wait(duration_s: float) -> None:
        end_s = line.now() + duration_s
        while (left_s := end_s - line.now()) > 0:
            line.wait(min(left_s, TEND_SLICE_S))
            box.tend_if_due()

    return OpenedBox(box, config, None, wait, twin)
