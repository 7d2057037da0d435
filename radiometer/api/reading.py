"""Readings of a patch: one, several, or without end."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from radiometer.analysis.reading.budget import PatchSituation
from radiometer.analysis.reading.monte_carlo import propagate_distributions
from radiometer.analysis.signal.situation import situation_of
from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Ask, Notice, Progress, unheard
from radiometer.bench.assembly import open_instrument
from radiometer.bench.capturing import shutter_by_hand
from radiometer.bench.instrument import Instrument
from radiometer.bench.reopening import reopen
from radiometer.data import Bracket, CameraDescription, LensDescription, Reading
from radiometer.data.capture_header import serial_shown
from radiometer.errors import DeviceLost, DeviceTimeout, UsageError
from radiometer.plausible import FNumber, Limit, Period, RelativeUncertainty
from radiometer.progress import counted
from radiometer.reporting.reading_page import ReadingRecord, check_report_name, write_reading_page


def measure(
    camera: str | None = None,
    patch: PatchLike | None = None,
    *,
    bench: PathLike | None = None,
    calibration: PathLike | None = None,
    uncalibrated: bool = False,
    f_number: FNumber | None = None,
    spectrum: str | None = None,
    u_rel: RelativeUncertainty | None = None,
    darks: bool = False,
    monte_carlo: bool = False,
    report: PathLike | None = None,
    ask: Ask | None = None,
    notice: Notice = unheard,
    progress: Progress | None = None,
) -> Reading:
    """Read the radiance of a patch once, with its uncertainty.

    Examples:
        >>> import radiometer as rm
        >>> reading = rm.measure(patch=(40, 24, 16, 16), bench="bench.yaml")
        >>> reading.radiance.unit, abs(reading.radiance.value - 0.3) < 3 * reading.radiance.u
        ('W sr-1 m-2', True)

    Args:
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:; the bench's own by default.
        patch: (x, y, width, height) in pixels; the bench's by default.
        bench: Bench file; the simulated bench by default.
        calibration: Calibration file; the bench's by default.
        uncalibrated: Use none: a relative reading.
        f_number: f-number that the lens is set to where the bench does not state it.
        spectrum: Spectrum assumed for the luminance.
        u_rel: Repeat exposures until noise is below this relative standard uncertainty.
        darks: Take dark frames with the reading; `ask` has the lens covered where there is no shutter.
        monte_carlo: Add the interval by the propagation of distributions (JCGM 101), in `reading.more`.
        report: Page of the reading to write, .html or .pdf: picture with the patch, budget, calibration, assumptions.
        ask: Has something done by hand.
        notice: Gets what must be known before the first reading, a line each.
        progress: Called after every frame.

    Raises:
        UsageError: If arguments exclude each other, or the patch leaves the frame.
        CalibrationError: If the calibration does not fit the camera.
        DeviceError: If the camera fails.
    """
    return next(
        readings(
            camera, patch, bench=bench, calibration=calibration, uncalibrated=uncalibrated, f_number=f_number,
            spectrum=spectrum, u_rel=u_rel, darks=darks, monte_carlo=monte_carlo, report=report, ask=ask,
            notice=notice, progress=progress,
        )
    )  # fmt: skip


def readings(
    camera: str | None = None,
    patch: PatchLike | None = None,
    *,
    bench: PathLike | None = None,
    calibration: PathLike | None = None,
    uncalibrated: bool = False,
    f_number: FNumber | None = None,
    spectrum: str | None = None,
    u_rel: RelativeUncertainty | None = None,
    darks: bool = False,
    monte_carlo: bool = False,
    report: PathLike | None = None,
    repeat: Limit = 1,
    watch: bool = False,
    every_s: Period = 0.0,
    ask: Ask | None = None,
    notice: Notice = unheard,
    progress: Progress | None = None,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Reading]:
    """Yield readings of a patch, numbered from 1; the camera is open in between.

    Examples:
        >>> import radiometer as rm
        >>> [one.sequence for one in rm.readings(bench="bench.yaml", repeat=2)]
        [1, 2]

    Args:
        repeat: Number of readings.
        watch: Read without end; a camera that is lost is waited for.
        every_s: Time from one reading's start to the next's in s.
        sleep: Waits for a number of seconds.
        clock: Steady clock in s.

    Raises:
        UsageError: If a calibration is named and none is to be used.
        RadiometerError: As `measure`, which has the other arguments.
    """
    if calibration is not None and uncalibrated:
        raise UsageError("--calibration and --uncalibrated exclude each other")
    if report is not None:
        check_report_name(Path(report))
    with open_instrument(
        Path(bench) if bench else None,
        camera,
        as_patch(patch),
        Path(calibration) if calibration else None,
        uncalibrated=uncalibrated,
        spectrum=spectrum,
        f_number=f_number,
    ) as instrument:
        _introduce(instrument, notice)
        if darks:
            instrument = replace(instrument, cover=_cover(instrument, ask))
        for number in itertools.count(1) if watch else range(1, repeat + 1):
            begun_s = clock()
            reading, frames = _one(instrument, number, u_rel, notice if watch else None, progress)
            if monte_carlo:
                reading = with_distribution(reading, instrument.situation(frames))
            if report is not None:
                known = instrument.camera
                write_reading_page(reading_record(reading, frames, known.description, known.lens), Path(report))
            yield reading
            if watch or number < repeat:
                sleep(max(0.0, every_s - (clock() - begun_s)))


def _introduce(instrument: Instrument, notice: Notice) -> None:
    who, patch = instrument.camera.identity, instrument.patch
    name = f"{who.vendor} {who.model} {serial_shown(who.serial)}"
    notice(f"{name}, patch {patch.x},{patch.y} {patch.width} × {patch.height} pixels")
    of_calibration: tuple[str, ...] = ()
    if instrument.calibration is not None:
        notice(f"calibrated {instrument.calibration.created[:10]} by {instrument.calibration.scale.reference}")
        of_calibration = instrument.calibration.provenance.assumptions
    for assumption in dict.fromkeys((*of_calibration, *situation_of(instrument.setup).assumptions)):
        notice(f"assumed: {assumption}")


def _cover(instrument: Instrument, ask: Ask | None) -> Callable[[bool], None]:
    """Return what covers the lens: the camera's own shutter, else a hand."""
    camera = instrument.camera
    if camera.capabilities.has_shutter:
        return lambda closed: camera.set_shutter(closed=closed)
    return shutter_by_hand(camera, ask)


def _one(
    instrument: Instrument, number: int, u_rel: float | None, waiting: Notice | None, progress: Progress | None
) -> tuple[Reading, Bracket]:
    """Return a reading; with somebody to hear of it, a camera that was lost is waited for and read anew."""
    camera, settings = instrument.camera, instrument.camera.settings
    report = counted(progress, "measuring")
    while True:
        try:
            frames = instrument.take_bracket(
                target_u_rel=u_rel, progress=lambda done, total, _frame: report(done, total)
            )
            return instrument.with_origin(instrument.read(frames, sequence=number)), frames
        except (DeviceLost, DeviceTimeout) as error:
            if waiting is None:
                raise
            waiting(f"{error}; waiting for it")
        reopen(camera, settings, waiting)
        waiting(f"{camera.identity.model} {camera.identity.serial} is back")


def with_distribution(reading: Reading, situation: PatchSituation) -> Reading:
    """Return the reading with its distribution from draws of all its inputs."""
    drawn = propagate_distributions(situation, np.random.default_rng(reading.sequence))
    return replace(reading, more={**reading.more, "monte_carlo": drawn.to_mapping(reading)})


def reading_record(
    reading: Reading, bracket: Bracket, camera: CameraDescription, lens: LensDescription
) -> ReadingRecord:
    """Return a reading with the frame that shows its patch best, and what is known of camera and lens.

    Args:
        reading: The reading.
        bracket: The frames that it was made from.
        camera: The camera as it is described.
        lens: The lens as the bench or the capture set states it.
    """
    patch = reading.patch.slices
    clear = [one for one in bracket.light if float(np.max(one.dn[patch])) < one.saturated_dn]
    best = max(clear or bracket.light[:1], key=lambda one: one.settings.effective_exposure_s)
    facts = [
        ("gain", "" if best.settings.gain_db is None else f"{best.settings.gain_db:g} dB"),
        ("sensor temperature", "" if best.settings.temperature_c is None else f"{best.settings.temperature_c:.1f} °C"),
    ]
    known = [fact for fact in facts if fact[1]]
    return ReadingRecord(reading, best.dn, camera.name, lens.in_words([best.settings.f_number]), known)
