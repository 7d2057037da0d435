"""The jobs that `radiometer batch` can do; a new one is one function and one line in JOBS.

A job takes a capture set and the settings and returns rows: plain mappings of numbers, words and booleans, the
same keys whatever the job, so that all rows fit one table.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.analysis.calibration.shared import channel_of
from radiometer.data import Bracket, Calibration, CaptureSet, Frame, Patch, RadianceMap
from radiometer.data.json_text import json_text
from radiometer.data.provenance import source_hash
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.errors import CaptureError, InputError, MeasurementError, OutputError, RadiometerError, required_library

Row = dict[str, Any]
COLUMNS: Final = (
    "capture", "captured", "content_hash", "fingerprint", "job", "status", "patch", "quantity",
    "value", "u", "unit", "flags", "error", "software", "instrument",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class JobSettings:
    """One job with everything that its result depends on in addition to the capture set."""

    job: str  # name in the registry of `jobs.py`
    calibration: str | None = None  # calibration file; None for relative values
    # Region X,Y,W,H; None for the patches that each capture set names, else the whole frame
    patch: tuple[int, int, int, int] | None = None
    maps: str | None = None  # folder that radiance maps are written to; None for none

    def fingerprint(self) -> str:
        """Return a hash of the settings, the calibration's content and the code: equal means the same result.

        Raises:
            InputError: If the calibration cannot be read.
        """
        digest = hashlib.sha256(json_text(asdict(self), sort_keys=True, ascii_only=True).encode())
        if self.calibration:
            try:
                digest.update(Path(self.calibration).read_bytes())
            except OSError as error:
                raise InputError(f"cannot read {self.calibration}: {error.strerror or error}") from error
        digest.update(code_hash().encode())
        return digest.hexdigest()[:16]


def code_hash() -> str:
    """Return a hash over the source of the packages that results depend on."""
    return source_hash("data", "analysis", "importing", "photographs", "reconciliation", "statistics", "archive")


def write_map(merged: RadianceMap, path: Path) -> None:
    """Write a radiance map as a Zarr group of the arrays radiance, u_radiance, mask and u_shared; whole or not at all.

    Args:
        path: Folder of the group; one that exists is replaced.

    Raises:
        MissingLibrary: If Zarr is not installed.
        OutputError: If the disk refuses it.
    """
    zarr = required_library("zarr", "Zarr is not installed; `pip install 'radiometer[cluster]'`, or leave out --maps")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.open_group(str(unfinished), mode="w")
        for name in ("radiance", "u_radiance", "mask", "u_shared"):
            values = getattr(merged, name)
            if values is None:  # pixels share nothing
                continue
            group.create_array(name, shape=values.shape, dtype=values.dtype)[:] = values
        group.attrs.update(
            unit=merged.unit,
            u_rel_common=merged.u_rel_common,
            u_rel_pattern=merged.u_rel_pattern,
            provenance=merged.provenance.to_mapping(),
        )
        shutil.rmtree(path, ignore_errors=True)
        try:
            unfinished.rename(path)
        except OSError as error:  # of copies of a capture set another worker may write the same map
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                raise
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def run_job(capture: Path, settings: JobSettings, done_hashes: frozenset[str] = frozenset()) -> list[Row]:
    """Return the rows of one capture set; a failure becomes a row, a capture already done no row.

    Args:
        capture: The capture set's folder.
        done_hashes: Content hashes of what the table holds already for these settings.
    """
    import radiometer

    common: Row = dict.fromkeys(COLUMNS)
    common.update(capture=str(capture), job=settings.job, fingerprint=settings.fingerprint(), flags="")
    common["software"] = f"radiometer {radiometer.__version__}"
    try:
        capture_set = CaptureSet.read(capture)
        taken, common["instrument"] = capture_set.header.taken, capture_set.header.camera.name
        common.update(content_hash=capture_set.content_hash(), captured=None if taken is None else taken.timestamp())
        if common["content_hash"] in done_hashes:
            return []
        return [{**common, "status": "ok", **row} for row in JOBS[settings.job](capture_set, settings)]
    except (RadiometerError, OSError) as error:
        return [{**common, "status": "failed", "error": str(error)}]


def measure(capture_set: CaptureSet, settings: JobSettings) -> list[Row]:
    """Return the radiance of every patch."""
    from radiometer.analysis.reading.reading import read_patch

    header = capture_set.header
    calibration = _calibration(settings)
    frames = _lit(capture_set, calibration)
    rows: list[Row] = []
    for name, patch in _patches(capture_set, settings, frames[0].shape):
        setup = Setup(header.camera, header.lens, calibration, header.source, None, header.taken)
        reading = read_patch(frames, patch, setup)
        shared = {"patch": name, "flags": " ".join(map(str, reading.flags))}
        rows.append({**shared, "quantity": "radiance", **reading.radiance.to_mapping()})
        if reading.luminance:
            rows.append({**shared, "quantity": "luminance", **reading.luminance.to_mapping()})
    return rows


def _calibration(settings: JobSettings) -> Calibration | None:
    return Calibration.read(Path(settings.calibration)) if settings.calibration else None


def _lit(capture_set: CaptureSet, calibration: Calibration | None) -> list[Frame]:
    """Return the frames with the source on, and dark ones, in the calibration's colour.

    Raises:
        CaptureError: If the source is never on.
        UsageError: If a mosaic has no such colour.
    """
    taken = capture_set.in_colour(channel_of(calibration) or "luminance").frames()
    frames = [one for one in taken if one.settings.is_dark or one.settings.source_level > 0]
    if all(one.settings.is_dark for one in frames):
        raise CaptureError(f"{capture_set.path}: holds no frame with the shutter open and the source on")
    return frames


def response(capture_set: CaptureSet, settings: JobSettings) -> list[Row]:
    """Return the recovered response at five levels, as ln of the exposure relative to the middle."""
    from radiometer.analysis.response.debevec1997 import recover_response_debevec1997

    curve = recover_response_debevec1997([capture_set.bracket()]).curve
    levels = np.linspace(0, curve.log_exposure.size - 1, 7).astype(int)[1:-1]
    return [
        {
            "patch": "",
            "quantity": f"log_exposure[{level}]",
            "value": float(curve.log_exposure[level]),
            "u": float(curve.u_log_exposure[level]),
            "unit": "1",
        }
        for level in levels
    ]


def merge(capture_set: CaptureSet, settings: JobSettings) -> list[Row]:
    """Return mean radiance and share of good pixels of the merged picture; write the map where maps are requested.

    Raises:
        MeasurementError: If no pixel is good.
    """
    from radiometer.analysis.merge.bracket import merge as merge_frames

    header = capture_set.header
    calibration = _calibration(settings)
    bracket = Bracket.from_frames(_lit(capture_set, calibration), origin=str(capture_set.path))
    spectrum = header.source.spectrum or AS_CALIBRATED
    setup = Setup(header.camera, header.lens, calibration, header.source, spectrum, header.taken)
    merged = merge_frames(bracket, setup)
    if settings.maps:
        # Another calibration gives another map, and the one before still belongs to its table.
        name = f"{capture_set.path.name}-{capture_set.content_hash()[:12]}-{settings.fingerprint()[:8]}.zarr"
        write_map(merged, Path(settings.maps) / name)
    good = merged.mask == 0
    count = int(good.sum())
    if not count:
        raise MeasurementError(f"{capture_set.path}: no pixel is well exposed in any frame, so there is no mean")
    mean = float(merged.radiance[good].mean(dtype=np.float64))
    own, shared = merged.parts_of_u(good)
    noise = math.hypot(float(np.sqrt(np.square(own).sum())) / count, float(shared.mean()))
    return [
        {
            "patch": "frame",
            "quantity": "radiance",
            "value": mean,
            "u": float(np.hypot(noise, merged.u_rel_common * mean)),
            "unit": merged.unit,
            "flags": "" if calibration else "uncalibrated",
        },
        {"patch": "frame", "quantity": "good_pixels", "value": float(good.mean()), "u": 0.0, "unit": "1"},
    ]


def characterise(capture_set: CaptureSet, settings: JobSettings) -> list[Row]:
    """Return the EMVA 1288 figures of the camera, one row a symbol."""
    from radiometer.analysis.characterise import characterise as characterise_subject
    from radiometer.analysis.characterise import subject_of_capture

    region = Patch(*settings.patch) if settings.patch else None
    figures = characterise_subject(subject_of_capture(capture_set, region)).figures
    return [{"patch": "frame", "quantity": symbol, **figure.to_mapping()} for symbol, figure in figures.items()]


def reconcile(capture_set: CaptureSet, settings: JobSettings) -> list[Row]:
    """Return the gap before and after, and every parameter of the effects that were found; the verdict is a flag."""
    from radiometer.reconciliation import reconcile_capture

    found = reconcile_capture(capture_set.path).result
    flags = str(found.verdict)
    rows: list[Row] = [
        {"patch": "", "quantity": name, "value": value, "u": 0.0, "unit": "reduced chi-square", "flags": flags}
        for name, value in (("gap_before", found.gap_before), ("gap_after", found.gap_after))
    ]
    for effect in found.effects:
        rows += [
            {
                "patch": effect.where,
                "quantity": f"{effect.name}.{name}",
                "value": parameter.value,
                "u": parameter.u,
                "unit": parameter.unit,
                "flags": flags,
            }
            for name, parameter in effect.parameters.items()
        ]
    return rows


def _patches(capture_set: CaptureSet, settings: JobSettings, shape: tuple[int, int]) -> list[tuple[str, Patch]]:
    if settings.patch:
        return [("patch", Patch(*settings.patch))]
    known = [(entry.name, entry.patch) for entry in capture_set.header.patches]
    return known or [("frame", Patch(0, 0, shape[1], shape[0]))]


JOBS: Final[dict[str, Callable[[CaptureSet, JobSettings], list[Row]]]] = {
    "measure": measure,
    "merge": merge,
    "response": response,
    "characterise": characterise,
    "reconcile": reconcile,
}
