"""Readings of a patch in photographs, or in other frames on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.api.files import PathLike, Stack, stack_of
from radiometer.api.meter import PatchLike
from radiometer.api.reading import reading_record, with_distribution
from radiometer.api.result import Progress
from radiometer.bench.sources import open_source
from radiometer.data import Bracket, Calibration, Patch, Provenance, Reading
from radiometer.data.setup import Setup
from radiometer.errors import UsageError
from radiometer.photographs.response import relative_calibration
from radiometer.photographs.scene import Photographs, prepared, with_shutter_doubt
from radiometer.photographs.stated import stated_camera, with_f_number, with_iso_in_reading
from radiometer.plausible import FNumber, Iso
from radiometer.progress import counted, unseen
from radiometer.reporting.reading_page import check_report_name, write_reading_page


def measure_photographs(
    photographs: Stack | PathLike,
    patch: PatchLike | None = None,
    *,
    calibration: Calibration | PathLike | None = None,
    uncalibrated: bool = False,
    channel: str = "luminance",
    pattern: str | None = None,
    align: str = "auto",
    linear: bool = False,
    measured_iso: Mapping[Iso, Iso] | None = None,
    iso: Iso | None = None,
    f_number: FNumber | None = None,
    spectrum: str | None = None,
    monte_carlo: bool = False,
    report: PathLike | None = None,
    progress: Progress | None = None,
) -> Reading:
    """Read the radiance of a patch in photographs, with its uncertainty.

    The response is the calibration's. Without a calibration it is recovered from the photographs; they are treated as
    proportional to light only where they are camera raw files, or with `linear`.

    Examples:
        >>> import radiometer as rm
        >>> rm.measure_photographs("photographs", (8, 8, 16, 16), uncalibrated=True, channel="green").radiance.unit
        'relative'

    Args:
        photographs: Folder of photographs, or a stack; a capture set is read as well.
        patch: (x, y, width, height) in pixels.
        calibration: Calibration, or its file.
        uncalibrated: Use none: a relative reading.
        channel: Of a folder of colour photographs: "luminance", "red", "green" or "blue".
        linear: Uncalibrated photographs are proportional to light above black.
        spectrum: Spectrum of the light; where it is unknown, all kinds of light count in the uncertainty.
        monte_carlo: Add the interval by the propagation of distributions to `reading.more`.
        report: Page of the reading to write, .html or .pdf.
        progress: Called as files are read.

    Returns:
        The reading; `more` holds the ISO speeds, the assumptions, how the frames lay, and notes.

    Raises:
        UsageError: If arguments exclude each other.
        RadiometerError: As `merge`, which has the other arguments.
    """
    if report is not None:
        check_report_name(Path(report))
    if calibration is None and not uncalibrated:
        raise UsageError("--photographs needs --calibration (or --uncalibrated for relative values)")
    if calibration is not None and uncalibrated:
        raise UsageError("--calibration and --uncalibrated exclude each other")
    if linear and calibration is not None:
        raise UsageError("--linear belongs to photographs without a calibration, which knows the camera's response")
    if patch is None or channel == "each":
        raise UsageError("--photographs needs --patch X,Y,W,H, and one channel: luminance, red, green or blue")
    known = calibration if isinstance(calibration, Calibration | None) else Calibration.read(Path(calibration))
    stack = photographs if isinstance(photographs, Stack) else _opened(Path(photographs), channel, progress)
    if stack.photographs:
        ready = prepared(
            stack.as_photographs(), calibration=known, linear=linear, measured_iso=measured_iso, iso=iso,
            f_number=f_number, align=align, progress=progress or unseen,
        )  # fmt: skip
        bracket = ready.without_absent()
        camera, lens = stated_camera(bracket)
        if known is None:
            curve = next(iter(ready.curves.values()), None)
            known = with_shutter_doubt(relative_calibration(bracket, curve, camera, lens)[0], ready)
    else:
        if measured_iso or iso is not None:
            raise UsageError("--measured-iso and --iso belong to photographs; frames of a capture set state their gain")
        bracket, camera, lens = with_f_number(stack.chosen(pattern), f_number), stack.camera, stack.lens
        ready = Photographs({"mono": bracket}, Path(stack.origin), notes=stack.notes)
    where = patch if isinstance(patch, Patch) else Patch(*patch)
    setup = Setup(camera, lens, known, stack.source, spectrum, stack.taken)
    reading = _reading(bracket, where, setup, ready, drawn=monte_carlo)
    stated = None
    if calibration is not None and known is not None:
        file = None if isinstance(calibration, Calibration) else str(calibration)
        stated = {"file": file, "created": known.created, "reference": known.scale.reference}
    reading = replace(reading, more={**reading.more, "calibration": stated, "budget": reading.budget_lines})
    if report is not None:
        write_reading_page(reading_record(reading, bracket, camera, lens), Path(report))
    return reading


def _opened(path: Path, channel: str, progress: Progress | None) -> Stack:
    return stack_of(open_source(path, channel, report=counted(progress, "reading")), str(path))


def _reading(bracket: Bracket, patch: Patch, setup: Setup, ready: Photographs, *, drawn: bool) -> Reading:
    reading = read_patch(bracket, patch, setup)
    reading = with_iso_in_reading(reading, bracket.light)
    origin = reading.provenance or Provenance("maximum-likelihood patch estimate")
    assumed = (*origin.assumptions, *(text for texts in ready.assumed.values() for text in texts))
    more = {
        "iso": origin.parameters.get("iso", []),
        "assumptions": list(assumed),
        "alignment": ready.alignment,
        "notes": list(ready.notes),
    }
    reading = replace(reading, provenance=replace(origin, assumptions=assumed), more=more)
    return with_distribution(reading, patch_situation(bracket, patch, setup)) if drawn else reading
