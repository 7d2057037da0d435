"""Writes the files of a proposed law: effect, test, and the captures that would refute it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data import CameraDescription, FrameSettings
from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.errors import OutputError
from radiometer.reconciliation.advice.next_capture import FORMAT as PLAN_FORMAT
from radiometer.reconciliation.advice.next_capture import FRAMES, CapturePool
from radiometer.reconciliation.fit.state import FitState
from radiometer.reconciliation.propose.effect_file import SETTINGS, source_of_test
from radiometer.reconciliation.propose.law import acted, round_to
from radiometer.reconciliation.propose.proposal import Proposal
from simulators.chain.law_stages import LINKS
from simulators.effects.context import ExposureContext, FrameGeometry

_CAPTURES: Final = 3
_SHOWS_CHI2: Final = 9.0


def refuting_frames(proposal: Proposal) -> tuple[list[dict[str, Any]], list[str]]:
    """Return frames for `radiometer bracket --plan`, and for each what the law predicts there.

    New settings come first, those where the camera with the law and the one without it differ most. Where the rig has
    no new settings, those in use are repeated.
    """
    pool = CapturePool.of(proposal.after)
    with_law, without = pool.predicted(proposal.after), pool.predicted(proposal.before)
    worth = np.nan_to_num(pool.separation(with_law, without))
    worth = np.where(pool.is_new, worth, 0.5 * worth)
    is_noise = LINKS[proposal.law.link].is_noise
    apart = np.sqrt(with_law.variance) - np.sqrt(without.variance) if is_noise else with_law.mean - without.mean
    does = "scatters by" if is_noise else "differs by"
    frames, reasons = list[dict[str, Any]](), list[str]()
    for index in np.argsort(-worth)[:_CAPTURES].tolist():
        if worth[index] < _SHOWS_CHI2 and frames:
            break
        tile = int(np.argmax(np.abs(apart[index])))
        frame = pool.frame(index)
        shown = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
        frames.append(shown | {"repeat": FRAMES})
        reasons.append(
            f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB, source level {frame.source_level:g}, shutter "
            f"{frame.shutter}: with {proposal.name} patch {pool.design.tiles[tile].name} {does} "
            f"{apart[index, tile]:+.3g} DN relative to the camera without it; the law is refuted where that is not seen"
        )
    return frames, reasons


def write_files(proposal: Proposal, folder: Path, origin: str) -> tuple[Path, ...]:
    """Write effect file, test and the plan that would refute a law, and return their paths.

    Args:
        proposal: The law with its evidence.
        folder: Made where it is missing.
        origin: What the law was found in.

    Raises:
        OutputError: If a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {folder}: {error.strerror or error}; name another") from error
    name = proposal.name
    effect, test, plan = folder / f"{name}.py", folder / f"test_{name}.py", folder / "plan.yaml"
    write_text_atomic(effect, proposal.source(origin))
    write_text_atomic(test, _test(proposal, effect.name))
    write_yaml_atomic(plan, _plan(proposal))
    return effect, test, plan


def _test(proposal: Proposal, file_name: str) -> str:
    height, width = proposal.before.design.shape
    context = _test_context(proposal.before, width, height)
    rows = []
    for column, row, signal in (
        (0.0, 0.0, 100.0),
        (0.5 * width, 0.3 * height, 1000.0),
        (width - 1.0, height - 1.0, 50.0),
    ):
        at = _exposure_context(context, column, row)
        rows.append((column, row, signal, acted(proposal.law, round_to(proposal.amplitude), signal, at)))
    return source_of_test(proposal.law, proposal.amplitude, file_name, context, rows)


def _plan(proposal: Proposal) -> dict[str, Any]:
    """Return captures beyond the ranges of the first ones, where the law predicts the largest change, and a repeat."""
    frames, reasons = refuting_frames(proposal)
    return {"format": PLAN_FORMAT, "reasons": reasons, "frames": frames}


def _test_context(state: FitState, width: int, height: int) -> dict[str, Any]:
    design = state.design
    warm = design.temperature_c
    return {
        "exposure_s": float(np.max(design.exposure_s)),
        "gain_db": float(np.max(design.gain_db)),
        "f_number": float(np.min(design.f_number)),
        "temperature_c": float(np.nanmax(warm)) if np.isfinite(warm).any() else 25.0,
        "timestamp_s": float(np.median(design.timestamp_s)),
        "source_level": 1.0,
        "since_frame_s": 1.0,
        "width": width,
        "height": height,
    }


def _exposure_context(known: Mapping[str, Any], column: float, row: float) -> ExposureContext:
    settings = FrameSettings(**{key: known[key] for key in SETTINGS})
    geometry = FrameGeometry(np.array([column]), np.array([row]), known["width"], known["height"])
    return ExposureContext(settings, geometry, CameraDescription(bit_depth=16), since_frame_s=known["since_frame_s"])
