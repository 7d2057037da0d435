"""The light box by hand: lit, pulsed, blinked, darkened, watched and calibrated."""

from __future__ import annotations

import contextlib
import datetime as dt
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radiometer.analysis.flux.drive_law import LEAST_DRIVE, DriveLaw, fit_drive_law
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Drawn, Notice, Progress, Result, unheard
from radiometer.bench.boxes import (
    ExposureReport,
    OpenedBox,
    calibration_file,
    darken,
    exposure_reports,
    exposure_store,
    nothing_answers,
    open_light_box,
    require_known_box,
)
from radiometer.bench.light_bench import SurveyRequest, asked_of, open_light_camera, survey_box
from radiometer.data import Quantity
from radiometer.data.drawing import new_axes
from radiometer.data.event_journal import kept_until_written
from radiometer.data.json_text import json_text
from radiometer.data.light_calibration import LevelChoice, LightCalibration
from radiometer.data.storage import check_outputs
from radiometer.devices import ChannelMode, ChannelState, CurrentRange, DriveLevel, Radiance
from radiometer.devices.exposure_account import name_of_eye
from radiometer.devices.light_box import Level
from radiometer.errors import DeviceError, DeviceNotFound, UsageError
from radiometer.importing.light_tables import DriveTable, read_drive_table
from radiometer.plausible import (
    BlinkCount,
    BoxLevel,
    Count,
    Duration,
    NotNegative,
    PointsPerDecade,
    RelativeUncertainty,
    Seed,
)
from radiometer.reporting.pictures import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RUN_FORMAT: Final = "radiometer-light-run/1"  # of the journal of an unfinished calibration
_LOOK_S: Final = 0.25  # how often the light is looked at: half of the time in which a lost box must be reported
_BUDGET_USED_UP: Final = 0.02  # of the full budget: it refills from the moment the light went out
_FOREVER_S: Final = 1e9  # 32 years


@dataclass(frozen=True, repr=False)
class LitChannel(Result):
    """What a channel does now.

    Attributes:
        box: Serial number of the box.
        state: The channel as it was read back.
        choice: Radiance that it really gives where one was asked for; None where a raw level was.
        asked: Radiance that was asked for in W·sr⁻¹·m⁻².
    """

    box: str
    state: ChannelState
    choice: LevelChoice | None = None
    asked: float | None = None

    def to_mapping(self) -> dict[str, Any]:
        report: dict[str, Any] = {
            "box": self.box,
            "channel": self.state.channel,
            "mode": str(self.state.mode),
            "level": self.state.drive.level,
            "current_range": str(self.state.drive.current_range),
        }
        if self.choice is not None:
            one = self.choice
            report["radiance"] = {
                "value": one.radiance_w_sr_m2, "u": one.u_w_sr_m2, "unit": "W sr-1 m-2", "asked": self.asked
            }  # fmt: skip
            report["start_rel"], report["settle_s"] = one.start_rel, one.settle_s
        return report

    def __str__(self) -> str:
        state = self.state
        return f"{state.channel}  {state.mode}  level {state.drive.level} of 65535, {state.drive.current_range} current"


Lit = Callable[[LitChannel], None]


def _unwatched(lit: LitChannel) -> None:
    """Drop a report."""


def light_set(
    channel: str,
    radiance: NotNegative | None = None,
    *,
    level: BoxLevel | None = None,
    low: bool = False,
    hold_s: Duration | None = None,
    box: str | None = None,
    subject: str | None = None,
    eye: str | None = None,
    no_eye: bool = False,
    calibration: PathLike | None = None,
    preset: PathLike | None = None,
    lit: Lit = _unwatched,
    notice: Notice = unheard,
) -> LitChannel:
    """Light a channel steadily until a time is over: the box goes dark without its host.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_set("spot", level=20000, hold_s=0.5, box="sim")
        <LitChannel spot  steady  level 20000 of 65535, high current>

    Args:
        channel: "bleach", "field", "spot", "spot_green", "spot_red" or "fixation".
        radiance: Radiance in W·sr⁻¹·m⁻²; needs a calibrated channel.
        level: Raw level instead of a radiance, 0 to 65535.
        low: Raw level on the low current range.
        hold_s: Time in s; until an interrupt by default.
        box: "sim", a serial number or a port; the only one by default.
        subject: Pseudonym of who looks into the box. Where no eye is named, the light counts for every eye.
        eye: That eye, "right" or "left".
        no_eye: State that no eye looks: the light counts in the account of the box alone.
        calibration: Light calibration; the box's own by default.
        preset: Light-box preset with safety bounds.
        lit: Called once the channel is lit.
        notice: Gets what the user must know meanwhile.

    Raises:
        UsageError: If not exactly one of radiance and level is given, or one of subject and eye alone.
        UnsafeStimulus: If it is too much for the eye or the box.
        DeviceError: If the box fails or ends the light early.
    """
    expected, looks = _level(radiance, level, low=low), name_of_eye(subject, eye, no_eye=no_eye)
    with _opened(box, calibration, preset, looks, notice) as opened:
        found = _found(opened, opened.box.set_level(channel, expected), radiance)
        lit(found)
        _stay(opened, hold_s, channel if found.state.drive.level else None, notice)
    return found


def light_pulse(
    channel: str,
    duration_s: Duration,
    radiance: NotNegative | None = None,
    *,
    level: BoxLevel | None = None,
    low: bool = False,
    box: str | None = None,
    subject: str | None = None,
    eye: str | None = None,
    no_eye: bool = False,
    calibration: PathLike | None = None,
    preset: PathLike | None = None,
    lit: Lit = _unwatched,
    notice: Notice = unheard,
) -> LitChannel:
    """Give one pulse, timed by the box.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_pulse("spot", 0.2, level=20000, box="sim").state.channel
        'spot'

    Args:
        duration_s: Length in s, at most 600.

    Raises:
        RadiometerError: As `light_set`, which has the other arguments.
    """
    drive, looks = _level(radiance, level, low=low), name_of_eye(subject, eye, no_eye=no_eye)
    with _opened(box, calibration, preset, looks, notice) as opened:
        found = _found(opened, opened.box.pulse(channel, drive, duration_s), radiance)
        lit(found)
        _stay(opened, duration_s, None, notice)
    return found


def light_blink(
    channel: str,
    on_s: NotNegative = 0.2,
    off_s: NotNegative = 0.8,
    count: BlinkCount = 0,
    radiance: NotNegative | None = None,
    *,
    level: BoxLevel | None = None,
    low: bool = False,
    hold_s: Duration | None = None,
    box: str | None = None,
    subject: str | None = None,
    eye: str | None = None,
    no_eye: bool = False,
    calibration: PathLike | None = None,
    preset: PathLike | None = None,
    lit: Lit = _unwatched,
    notice: Notice = unheard,
) -> LitChannel:
    """Blink a channel, timed by the box.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_blink("spot", 0.1, 0.1, 2, level=20000, box="sim").state.channel
        'spot'

    Args:
        on_s: Bright time in s.
        off_s: Dark time in s.
        count: Number of blinks; 0 without end.
        hold_s: Stop after this time in s.

    Raises:
        RadiometerError: As `light_set`, which has the other arguments.
    """
    drive, looks = _level(radiance, level, low=low), name_of_eye(subject, eye, no_eye=no_eye)
    lit_s = hold_s if hold_s is not None else (on_s + off_s) * count if count else None
    with _opened(box, calibration, preset, looks, notice) as opened:
        found = _found(opened, opened.box.blink(channel, drive, on_s, off_s, count), radiance)
        lit(found)
        _stay(opened, lit_s, channel if count == 0 else None, notice)
    return found


@dataclass(frozen=True, repr=False)
class Darkness(Result):
    """A box that is dark.

    Attributes:
        box: Its serial number.
        dark: Whether each channel is, by name; empty where another program did it.
        darkened_by: Process that holds the box and darkened it; None where none does.
    """

    box: str
    dark: dict[str, bool]
    darkened_by: int | None = None

    def to_mapping(self) -> dict[str, Any]:
        if self.darkened_by is not None:
            return {"box": self.box, "darkened_by": self.darkened_by}
        return {"box": self.box, "dark": self.dark}

    def __str__(self) -> str:
        by = "" if self.darkened_by is None else f", by process {self.darkened_by}, which holds it"
        return f"light box {self.box}: dark{by}"


def light_off(
    channel: str | None = None, *, box: str | None = None, darkened: Callable[[Darkness], None] = lambda one: None
) -> list[Darkness]:
    """Darken every box that can be reached, or one of them, or one channel; also while another program holds it.

    A program that holds a box, such as the daemon, darkens all of it. The button of the box does so too, held for 3 s.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_off(box="sim")
        [<Darkness light box SIM00001: dark>]

    Args:
        channel: One channel; all by default.
        box: "sim", a serial number or a port; all by default.
        darkened: Called with every box that is dark, also where another one fails.

    Raises:
        DeviceNotFound: If no box answers.
        DeviceError: If a box fails, or the program that holds it does not answer.
    """
    found, failures = darken(box, channel)
    dark = [Darkness(one.serial, dict(one.dark), one.darkened_by) for one in found]
    for entry in dark:
        darkened(entry)
    if failures:
        raise DeviceError("; ".join(map(str, failures)))
    if not dark:
        raise DeviceNotFound(nothing_answers(box))
    return dark


@dataclass(frozen=True, repr=False)
class BoxStatus(Result):
    """Identity, supply, temperature, clock, channels and limits of a box.

    Attributes:
        report: All of it as plain values.
    """

    report: dict[str, Any]

    def to_mapping(self) -> dict[str, Any]:
        return self.report

    def __str__(self) -> str:
        return f"light box {self.report['serial']}, firmware {self.report['firmware']}, on {self.report['port']}"


def light_status(*, box: str | None = None) -> BoxStatus:
    """Show identity, supply, temperature, clock, channels and limits of a box.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_status(box="sim").report["serial"]
        'SIM00001'

    Args:
        box: "sim", a serial number or a port; the only one by default.

    Raises:
        DeviceError: If the box does not answer.
    """
    with open_light_box(box) as opened:
        return BoxStatus(_status(opened))


@dataclass(frozen=True, repr=False)
class ButtonPress(Result):
    """The button of a box pressed or let go.

    Attributes:
        pressed: Whether it was pressed.
        time_s: When, in s from the opening of the box.
        u_s: Standard uncertainty of that time.
    """

    pressed: bool
    time_s: float
    u_s: float

    def __str__(self) -> str:
        what = "pressed" if self.pressed else "released"
        return f"{self.time_s:10.4f} s ± {2e3 * self.u_s:.2f} ms (k = 2)  {what}"


def light_watch_buttons(
    hold_s: Duration | None = None, count: Count | None = None, *, box: str | None = None
) -> Iterator[ButtonPress]:
    """Yield presses and releases as they come, with the uncertainty of their times.

    Examples:
        >>> import radiometer as rm
        >>> list(rm.light_watch_buttons(0.2, box="sim"))
        []

    Args:
        hold_s: Stop after this time in s; never by default.
        count: Stop after so many presses.
        box: "sim", a serial number or a port; the only one by default.

    Raises:
        DeviceError: If the box fails.
    """
    presses = 0
    with open_light_box(box) as opened, contextlib.suppress(KeyboardInterrupt):  # the usual end
        start_s = opened.box.link.line.now()
        for event in opened.box.buttons(_FOREVER_S if hold_s is None else hold_s):
            presses += event.pressed
            yield ButtonPress(event.pressed, event.time_s - start_s, event.u_time_s)
            if count is not None and presses >= count:
                return


@dataclass(frozen=True, repr=False)
class ExposureAccount(Result):
    """What boxes and eyes have used up of the blue-light limit within 10⁴ s.

    Attributes:
        reports: One per box and eye.
        notes: What is wrong with the account's file, and what follows.
    """

    reports: tuple[ExposureReport, ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> str:
        return json_text([asdict(one) for one in self.reports])

    def to_mapping(self) -> dict[str, Any]:
        """Return the reports by name."""
        return {one.name: asdict(one) for one in self.reports}

    def lines(self) -> list[str]:
        """Return a line for every box and eye."""
        return [_account_line(one) for one in self.reports]

    def __str__(self) -> str:
        return f"{len(self.reports)} boxes and eyes"


def _account_line(one: ExposureReport) -> str:
    if one.unknown_for_s > 0:
        minutes = -(-one.unknown_for_s // 60)
        return f"{one.name}: its history is unknown; it counts as used up for {minutes:.0f} min"
    free = f"; free again in {-(-one.frees_in_s // 60):.0f} min" if one.blue_light > 0 else ""
    return f"{one.name}: {100 * one.blue_light:.3g} % of the blue-light limit within 10⁴ s{free}"


def light_account(box: str | None = None, *, confirm_no_exposure: bool = False) -> ExposureAccount:
    """Return how much of the blue-light limit boxes and eyes have used up within 10⁴ s.

    A box without a history on this computer counts as used up, and so does every box where the account was lost,
    damaged or from the future. That ends after 10⁴ s, or with `confirm_no_exposure`.

    Examples:
        >>> import radiometer as rm
        >>> isinstance(rm.light_account().lines(), list)
        True

    Args:
        box: Serial number of a light box; all by default.
        confirm_no_exposure: State that no eye that will look into the box saw its light, or another light as bright, in
            the last 10⁴ s.

    Raises:
        UsageError: If the account does not know the box, or none is named to confirm.
        UnsafeStimulus: If the account cannot be read or stored.
    """
    if box is not None or confirm_no_exposure:
        box = require_known_box(box)
    if confirm_no_exposure and box is not None:  # what the account knows to be given stays
        with exposure_store().change() as account:
            account.confirm(box)
    reports, wrong = exposure_reports()
    consequence = "what it held is lost; each box counts as used up for 10⁴ s from its next opening"
    notes = (f"{wrong}; {consequence}: radiometer light status",) if wrong else ()
    return ExposureAccount(tuple(one for one in reports if box is None or one.name == f"box {box}"), notes)


@dataclass(frozen=True, repr=False)
class CalibratedBox(Result):
    """A light box whose channels were measured.

    Attributes:
        calibration: Its calibration.
        channels: Channels that were measured now.
        file: Where it was written.
    """

    calibration: LightCalibration
    channels: tuple[str, ...]
    file: Path

    def to_mapping(self) -> dict[str, Any]:
        report = {}
        for name in self.channels:
            known = self.calibration.channels[name]
            figures = {key: getattr(known, key) for key in ("common_u_rel", "drift_u_rel", "settle_s")}
            points = {"limits_W_per_sr_m2": self.calibration.limits(name), "points": len(known.points)}
            report[name] = {**points, **figures, "drive_law": self.drive_laws(name)}
        return self.plain("file", box=self.calibration.box_serial, channels=report)

    def drive_laws(self, channel: str) -> dict[str, DriveLaw]:
        """Return the law of a channel over its duty on each current range that has points enough."""
        known, laws = self.calibration.channels[channel], {}
        for name in dict.fromkeys(point.current_range for point in known.points):
            own = [point for point in known.points if point.current_range == name]
            duty = np.array([point.duty_step / known.duty_steps for point in own])
            law = fit_drive_law(duty / duty.max(), np.array([point.radiance_W_per_sr_m2 for point in own]))
            if law is not None:
                laws[str(name)] = law
        return laws

    def __str__(self) -> str:
        return f"light box {self.calibration.box_serial}: {', '.join(self.channels)}; {self.file}"


def light_calibrate(
    channel: Sequence[str] | None = None,
    *,
    box: str | None = None,
    camera: str | None = None,
    bench: PathLike | None = None,
    patch: PatchLike | None = None,
    camera_calibration: PathLike | None = None,
    points_per_decade: PointsPerDecade = 4.0,
    responsivity: PathLike | None = None,
    spectral_u_rel: RelativeUncertainty | None = None,
    seed: Seed | None = None,
    preset: PathLike | None = None,
    out: PathLike | None = None,
    force: bool = False,
    notice: Notice = unheard,
    progress: Progress | None = None,
) -> CalibratedBox:
    """Measure the radiance of a box's channels over their levels with the camera, on both current ranges.

    Levels come in random order, each after it has settled. The dark reading is subtracted; a reference level measured
    in between determines the drift. With the file written, `radiometer light set spot --radiance 0.01` works.

    A journal next to the file keeps every level until it is written. After an interruption the same call goes on there.

    Examples:
        >>> import radiometer as rm
        >>> done = rm.light_calibrate(["fixation"], box="sim", points_per_decade=1, seed=1, out="box.yaml")
        >>> done.channels
        ('fixation',)

    Args:
        channel: Channels to calibrate; all by default.
        box: "sim", a serial number or a port; the only one by default.
        camera: Camera that looks at the box.
        bench: Bench file of the camera.
        patch: Lit area in the frame; the bench's by default.
        camera_calibration: Calibration of the camera; the bench's by default.
        points_per_decade: Density of the levels.
        responsivity: CSV of the camera's relative responsivity per W; flat quantum efficiency without.
        spectral_u_rel: Relative standard uncertainty of the spectral correction.
        seed: Makes the random order of the levels.
        preset: Light-box preset with safety bounds.
        out: File to write; the box's own by default.
        force: Calibrate channels anew that the box's own file holds already.
        notice: Gets where levels are kept after an interruption.
        progress: Called after every level.

    Raises:
        UsageError: If the box has no such channel, or a journal of another calibration is next to the file.
        MeasurementError: If a channel does not rise above the noise.
        DeviceError: If box or camera fails.
        OutputError: If the file cannot be written.
    """
    known = Path(camera_calibration) if camera_calibration else None
    with (
        open_light_box(box, preset=Path(preset) if preset else None) as opened,
        open_light_camera(opened, camera, Path(bench) if bench else None, as_patch(patch), known) as instrument,
    ):
        channels = tuple(channel or opened.box.channels)
        for name in channels:
            if name not in opened.box.channels:
                raise UsageError(f"the box has no channel {name!r}; it has {', '.join(opened.box.channels)}")
        file = Path(out) if out else calibration_file(opened.box.identity.serial)
        if out is None:
            file.parent.mkdir(parents=True, exist_ok=True)
            known_channels = opened.calibration.channels if opened.calibration else {}
            # The other channels of the file stay.
            check_outputs(file, force=force or not set(channels) & set(known_channels))
        request = SurveyRequest(
            channels, points_per_decade, seed, Path(responsivity) if responsivity else None, spectral_u_rel
        )
        with kept_until_written(file, RUN_FORMAT, asked_of(opened, instrument, request), notice) as journal:
            found = survey_box(opened, instrument, request, progress, journal)
            found.write(file)
    return CalibratedBox(found, channels, file)


@dataclass(frozen=True, repr=False)
class EngineLaws(Drawn):
    """Drive laws of a light engine's channels, and how its twin differs.

    Attributes:
        table: What was read, and how.
        laws: Law by channel; None where too few drives are lit.
        twin: The twin's laws by channel; empty where none was given.
    """

    table: DriveTable
    laws: dict[str, DriveLaw | None]
    twin: dict[str, DriveLaw | None]

    @property
    def differences(self) -> dict[str, Quantity]:
        """Return how far the twin's light at half drive over that at full drive is off, relative, by channel."""
        found = {}
        for name, law in self.laws.items():
            other = self.twin.get(name)
            if law is not None and other is not None:
                own, its = (one.light_over(0.5, 1.0) for one in (law, other))
                ratio = its.value / own.value
                found[name] = Quantity(ratio - 1.0, ratio * math.hypot(own.u_rel, its.u_rel), "1")
        return found

    def to_mapping(self) -> dict[str, Any]:
        differences = self.differences
        channels = {
            name: {"drive_law": law, "twin_at_half_drive": differences.get(name)} for name, law in self.laws.items()
        }
        return self.plain(taken=self.table.taken, channels=channels)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw each channel's light over its drive, as a share of that at full drive, and its law."""
        where = axes if axes is not None else new_axes()
        for one in self.table.channels:
            per_drive = one.light / one.drive
            (points,) = where.plot(one.drive, per_drive / per_drive[-1], ".", label=label(one.name))
            if (law := self.laws[one.name]) is not None:
                at = np.linspace(max(LEAST_DRIVE, 1.01 * law.onset), one.drive[-1], 100)
                shown = [law.light_over(each, one.drive[-1]).value * one.drive[-1] / each for each in at.tolist()]
                where.plot(at, shown, color=points.get_color(), linewidth=1.0)
        where.set(xlabel="drive over full drive", ylabel="light over drive, over that at full drive")
        where.legend(fontsize="small")
        return where

    def lines(self) -> list[str]:
        """Return each channel's law in a line."""
        return [f"{name}: {'too few lit drives' if law is None else law}" for name, law in self.laws.items()] + [
            f"{name}: the twin gives {one.scaled(100.0, '%').text()} more at half drive"
            for name, one in self.differences.items()
        ]

    def __str__(self) -> str:
        known = {name: law for name, law in self.laws.items() if law is not None}
        if not known:
            return "too few lit drives"
        worst = max(known, key=lambda name: abs(known[name].parameters["deviation_at_half_drive"].value))
        return f"{len(self.laws)} channels; {worst}: {known[worst]}"


def light_law(table: PathLike, twin: PathLike | None = None) -> EngineLaws:
    """Fit the law of light over drive to a table of a light engine, channel by channel.

    Examples:
        >>> import radiometer as rm
        >>> rm.light_law("engine.csv")
        <EngineLaws 2 channels; blue: exponent ..., droop ..., half drive ... off proportional (k = 2), misfit ...>

    Args:
        table: CSV of channel, drive and light, or of a spectrum at each drive.
        twin: Table of another engine of its type, to compare.

    Raises:
        InputError: If a table cannot be read, or a channel has too few drives.
    """
    known = read_drive_table(Path(table))
    other = read_drive_table(Path(twin)) if twin is not None else None
    return EngineLaws(known, _laws(known), {} if other is None else _laws(other))


def _laws(table: DriveTable) -> dict[str, DriveLaw | None]:
    return {one.name: fit_drive_law(one.drive, one.light) for one in table.channels}


@contextlib.contextmanager
def _opened(
    box: str | None, calibration: PathLike | None, preset: PathLike | None, eye: str | None, notice: Notice
) -> Iterator[OpenedBox]:
    known, bounds = (Path(one) if one else None for one in (calibration, preset))
    with open_light_box(box, calibration=known, preset=bounds, eye=eye) as opened:
        made = opened.calibration
        if made is not None and made.is_stale(dt.datetime.now(dt.UTC)):
            notice(
                f"warning: the calibration of light box {made.box_serial} of {made.created[:10]} is not within its "
                f"{made.validity_days:g} days: radiances may be off; calibrate again"
            )
        yield opened


def _level(radiance: float | None, level: int | None, *, low: bool) -> Level:
    if (radiance is None) == (level is None):
        raise UsageError("give either --radiance or --level")
    if radiance is not None:
        if low:
            raise UsageError("--low belongs to --level; a radiance chooses its range by itself")
        return Radiance(radiance)
    if not isinstance(level, int) or isinstance(level, bool):
        raise UsageError(f"level {level!r}: a raw level is a whole number from 0 to 65535")
    return DriveLevel(level, CurrentRange.LOW if low else CurrentRange.HIGH)


def _found(opened: OpenedBox, state: ChannelState, asked: float | None) -> LitChannel:
    known = opened.calibration
    choice = known.choose(state.channel, asked) if known and asked is not None else None
    return LitChannel(opened.box.identity.serial, state, choice, asked)


def _stay(opened: OpenedBox, lit_s: float | None, channel: str | None, notice: Notice) -> None:
    """Keep the box lit for a time, or until an interrupt, and watch it; a simulated box needs no watching.

    Args:
        opened: The box.
        lit_s: How long in s; None until an interrupt.
        channel: The channel that must stay lit for that time; None where it ends by itself.
        notice: Gets how to stop.

    Raises:
        DeviceError: If the box was lost, or ended the light before its time.
    """
    if lit_s is None and opened.twin is not None:
        return
    if lit_s is None:
        notice("stop with Ctrl-C")
    now_s = opened.box.link.line.now
    start_s = now_s()
    end_s = start_s + (_FOREVER_S if lit_s is None else lit_s)
    with contextlib.suppress(KeyboardInterrupt):
        while (left_s := end_s - now_s()) > 0:
            opened.wait(min(left_s, _LOOK_S))
            if channel is None:
                opened.box.status()  # raises where the box was lost
            elif opened.box.read_channel(channel).mode is ChannelMode.OFF and now_s() < end_s - _LOOK_S:
                raise _ended_early(opened, channel, now_s() - start_s, lit_s)


def _ended_early(opened: OpenedBox, channel: str, after_s: float, lit_s: float | None) -> DeviceError:
    left = opened.box.read_channel(channel).energy_left
    reason = (
        "its energy budget is used up; use a lower level or a shorter time"
        if left < _BUDGET_USED_UP
        else "another program asked for darkness, or the button of the box was held"
    )
    duration_text = "" if lit_s is None else f" of {lit_s:g} s"
    return DeviceError(
        f"the light box ended the light of {channel} by itself after {after_s:.1f} s{duration_text}"
        f" (known to {_LOOK_S:g} s): {reason}"
    )


def _status(opened: OpenedBox) -> dict[str, Any]:
    box, calibration = opened.box, opened.calibration
    found, clock = box.status(), box.synchronise()
    return {
        "serial": box.identity.serial,
        "firmware": box.identity.firmware,
        "protocol": box.identity.protocol_version,
        "port": box.identity.port,
        "supply_v": found.supply_v,
        "temperature_C": found.temperature_celsius,
        "damaged_lines": found.damaged_lines,
        "darkened": found.darkened,
        "reset_cause": found.reset_cause,
        "button_pressed": found.button_pressed,
        "clock": {"drift_ppm": clock.drift_ppm, "u_drift_ppm": clock.u_drift_ppm, "u_offset_s": clock.u_offset_s},
        "calibrated": calibration.created if calibration else None,
        "channels": {
            name: {
                "peak_nm": limits.peak_nm,
                "duty_steps": limits.duty_steps,
                "pwm_hz": limits.pwm_hz,
                "level_limit": {str(current): limit for current, limit in limits.level_limit.items()},
                "radiance_limits_W_per_sr_m2": calibration.limits(name)
                if calibration and name in calibration.channels
                else None,
            }
            for name, limits in box.channels.items()
        },
    }
