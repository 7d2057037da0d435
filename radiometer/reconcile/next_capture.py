"""The capture that tells rival explanations apart, chosen from a pool of settings by what each would predict.

Source: Box & Hill (1967), discrimination among mechanistic models, in the form of Buzzi-Ferraris & Forzatti (1983).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.data import CaptureHeader, FrameEntry
from radiometer.data.storage import write_yaml_atomic
from radiometer.reconcile.design import Array, Design
from radiometer.reconcile.pattern_images import PatternImages
from radiometer.reconcile.result import ReconcileResult
from radiometer.reconcile.state import FitState, refit, with_effects
from radiometer.reconcile.tile_model import Prediction, TileModel
from simulators.effects.catalogue import CatalogueEffect

FORMAT: Final = "radiometer-plan/1"
BRIGHT: Final = "bright_surround"
DARK: Final = "dark_surround"
_FRAMES: Final = 4
_PATCH_U_REL: Final = 3e-3  # how well a patch's radiance is known after a fit


@dataclass(frozen=True, slots=True)
class _Proposal:
    frame: FrameEntry
    chi2: float


def propose(state: FitState, chosen: CatalogueEffect, rivals: Sequence[CatalogueEffect]) -> dict[str, Any] | None:
    """Return the capture under which an effect and its rivals would differ most.

    Args:
        state: The fitted model that holds the chosen effect.
        chosen: That effect.
        rivals: Other effects at parameters that fit about as well.

    Returns:
        Settings, what they separate and the χ² expected of it; None where there is no rival.
    """
    if not rivals:
        return None
    header, images = _pool(state)
    design = Design.of(header, state.design.shape)
    first = _predicted(state, design, images)
    best: list[_Proposal] = []
    for rival in rivals:
        others = [e for e in state.effects if e.name != chosen.name]
        second = _predicted(refit(with_effects(state, [*others, rival]), iterations=4), design, images)
        best.append(_largest(header, _separation(state, design, first, second)))
    proposal = min(best, key=lambda entry: entry.chi2)  # the pair that is hardest to tell apart decides
    settings = proposal.frame.model_dump(mode="json", exclude_none=True, exclude={"file"})
    return {
        "description": _said(proposal.frame, chosen.name, [rival.name for rival in rivals]),
        "frames": [settings | {"repeat": _FRAMES}],
        "separates": [chosen.name, *[rival.name for rival in rivals]],
        "expected_chi2": round(proposal.chi2, 1),
    }


def write_plan(path: Path, result: ReconcileResult) -> None:
    """Write the next captures as a plan.

    Raises:
        OutputError: If the file cannot be written.
    """
    wanted = [effect.next_capture for effect in result.effects if effect.next_capture]
    frames = [frame for capture in wanted for frame in capture.get("frames", [])]
    reasons = [str(capture.get("description", "")) for capture in wanted]
    write_yaml_atomic(path, {"format": FORMAT, "reasons": reasons, "frames": frames})


def _said(frame: FrameEntry, name: str, rivals: Sequence[str]) -> str:
    if frame.shutter == "closed":
        what = f"dark frames (cap on) of {frame.exposure_s:.3g} s at {frame.gain_db:g} dB"
    elif frame.source_level == 0:
        what = f"frames with the source off of {frame.exposure_s:.3g} s at {frame.gain_db:g} dB"
    else:
        stop = f" at f/{frame.f_number:.3g}" if frame.f_number else ""
        what = (
            f"{frame.exposure_s:.3g} s, {frame.gain_db:g} dB{stop}, source level {frame.source_level:g}, "
            f"pattern {frame.pattern}"
        )
    return f"{what}: tells {name} from {', '.join(rivals)}"


def _pool(state: FitState) -> tuple[CaptureHeader, PatternImages]:
    """Return a header of settings to choose from, and the pictures of their patterns."""
    design = state.design
    images = _with_surrounds(design, state.model.images)
    patterns = (*design.patterns, BRIGHT, DARK)
    base = design.captures[int(np.argmax(_lit_score(design)))].settings
    times = np.unique(np.quantile(design.exposure_s, [0.0, 0.25, 0.5, 0.75, 1.0]))
    stops = np.unique(design.f_number)
    frames = []
    for t in times:
        for gain in (0.0, 12.0):
            frames.append(_frame(base, exposure_s=t, gain_db=gain, shutter="closed"))
            frames.append(_frame(base, exposure_s=t, gain_db=gain, source_level=0.0))
            for level in (1.0, 0.25):
                frames.append(_frame(base, exposure_s=t, gain_db=gain, source_level=level))
        for stop in (*stops, 2.0 * stops[-1]):
            frames.append(_frame(base, exposure_s=t, f_number=float(stop)))
        for pattern in patterns:
            frames.append(_frame(base, exposure_s=t, pattern=pattern))
    patches = tuple(_extended(patch, design.patterns[0]) for patch in design.header.patches)
    return (
        design.header.model_copy(update={"frames": tuple(frames), "patterns": patterns, "patches": patches}),
        images,
    )


def _extended(patch: Any, first: str) -> Any:
    known = patch.radiance_W_per_sr_m2
    if not isinstance(known, Mapping) or first not in known:
        return patch
    extra = {BRIGHT: known[first], DARK: known[first]}
    return patch.model_copy(update={"radiance_W_per_sr_m2": dict(known) | extra})


def _lit_score(design: Design) -> Array:
    return np.where(design.closed, -1.0, design.source_level)


def _frame(base: Any, **changed: Any) -> FrameEntry:
    return FrameEntry.of("", replace(base, **{"gain_db": 0.0, "timestamp_s": None, **changed}))


def _with_surrounds(design: Design, images: PatternImages) -> PatternImages:
    """Return the pictures with two more: the first pattern's patches in a bright and in a dark surround."""
    picture = images.picture(0)
    inside = np.zeros(picture.shape, dtype=np.bool_)
    cell = images.cell_px
    for number, tile in enumerate(design.tiles):
        if number % 2 == 0:  # every other patch turns into surround where patches fill the picture
            rows = slice(tile.y // cell, -(-(tile.y + tile.height) // cell))
            inside[rows, tile.x // cell : -(-(tile.x + tile.width) // cell)] = True
    pictures = [images.picture(p) for p in range(images.total.shape[0])]
    pictures += [np.where(inside, picture, picture.max()), np.where(inside, picture, 0.0)]
    total = np.stack(pictures)
    return replace(images, total=total, weight=np.ones_like(total))


def _predicted(state: FitState, design: Design, images: PatternImages) -> Prediction:
    model = replace(TileModel.of(design, images), effects=state.effects, given=state.model.given)
    old = state.nuisance
    rows = np.concatenate([np.arange(old.log_radiance.shape[0]), [0, 0]])
    return model.predict(replace(old, log_radiance=old.log_radiance[rows], slope=old.slope[rows]))


def _separation(state: FitState, design: Design, first: Prediction, second: Prediction) -> Array:
    """Return for each capture of the pool the χ² by which two predictions would differ."""
    pixels = np.array([tile.width * tile.height for tile in design.tiles])
    light = np.maximum(first.mean - np.nan_to_num(design.black_level_dn)[:, None], 0.0)
    noise2 = first.variance / (pixels * _FRAMES) + (_PATCH_U_REL**2 + state.tau**2) * light**2
    clipped = (first.mean > 0.95 * design.header.camera.full_scale_dn).any(axis=1)
    means = np.sum((first.mean - second.mean) ** 2 / noise2, axis=1)
    spreads = np.sum(np.log(first.variance / second.variance) ** 2 * pixels * (_FRAMES - 1) / 4.0, axis=1)
    return np.where(clipped, 0.0, means + spreads)


def _largest(header: CaptureHeader, chi2: Array) -> _Proposal:
    index = int(np.argmax(chi2))
    return _Proposal(header.frames[index], float(chi2[index]))
