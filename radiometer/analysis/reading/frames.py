"""Statistics of each frame of a bracket in a patch, and which frames may be used."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.signal.model import SignalModel
from radiometer.data import Bracket, Frame, FrameSettings, Patch
from radiometer.data.frame import DigitalNumbers
from radiometer.errors import MeasurementError
from radiometer.statistics.scale import TWENTIETH_TO_SIGMA, neighbour_sigma
from radiometer.units import gain_factor

# A patch counts as unclipped where its mean stays this many standard deviations of its pixels below clipping.
_CLEAR_OF_CLIPPING_SIGMA = 4.0
# More clipped pixels than this are part of the scene, fewer are defects.
_DEFECT_FRACTION = 0.01
# So many pixels of the whole picture give its mean.
_PIXELS_OF_THE_WHOLE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class PatchFrame:
    """The patch in one frame.

    Attributes:
        settings: Of the frame.
        dn: Digital numbers, shape of the patch.
        signal: Linear signal x at 0 dB, same shape, dark level not yet taken off.
        usable: Whether no part of the patch clips or leaves the data of the response curve at the bright end.
        unclipped: Whether no part of the patch clips.
        clipped: Pixels at or above clipping, same shape.
        whole: Mean signal x of the whole picture, dark level not yet taken off.
        whole_clipped: Part of the whole picture that clips; the mean is too low then.
        masked_dn: What the sensor's masked pixels read, in DN; None where it is not stated.
    """

    settings: FrameSettings
    dn: DigitalNumbers
    signal: NDArray[np.float64]
    usable: bool
    unclipped: bool
    clipped: NDArray[np.bool_]
    whole: float
    whole_clipped: float
    masked_dn: float | None = None


def crop_frames(
    frames: Bracket | Iterable[Frame], patch: Patch, model: SignalModel
) -> tuple[list[PatchFrame], list[Frame], tuple[int, int]]:
    """Return the patch in every light frame, the dark frames cut to the patch, and the frames' (height, width).

    Args:
        frames: Frames in any order; each is released after its patch is cut out.
        patch: Where to read.
        model: Signal model of the camera.

    Raises:
        MeasurementError: If there is no light frame, the patch is outside the frame, or the frames do not belong
            together.
    """
    light: list[PatchFrame] = []
    dark: list[Frame] = []
    shape: tuple[int, int] | None = None
    for frame in frames.every_frame if isinstance(frames, Bracket) else frames:
        shape = shape or frame.shape
        _refuse_misfit(frame, patch, shape, model)
        if frame.settings.is_dark:
            dark.append(replace(frame, dn=frame.dn[patch.slices].copy()))
        else:
            light.append(_crop(frame, patch, model))
    if not light or shape is None:
        raise MeasurementError("there is no frame with the shutter open; capture at least one")
    levels = {one.settings.source_level for one in light}
    if len(levels) > 1:
        raise MeasurementError(
            f"the frames were taken at {len(levels)} different source levels; read those of one level at a time"
        )
    return sorted(light, key=lambda one: one.settings.effective_exposure_s), dark, shape


def _refuse_misfit(frame: Frame, patch: Patch, shape: tuple[int, int], model: SignalModel) -> None:
    if not patch.fits(frame.shape):
        raise MeasurementError(
            f"the patch {patch.x},{patch.y},{patch.width},{patch.height} is not inside the frame of "
            f"{frame.shape[1]} × {frame.shape[0]} pixels; give X,Y,W,H within it"
        )
    if frame.shape != shape:
        raise MeasurementError(
            f"frames differ in size ({frame.shape[1]} × {frame.shape[0]} and {shape[1]} × {shape[0]} pixels)"
        )
    if frame.full_scale_dn != model.full_scale_dn:
        raise MeasurementError(
            f"a frame has {frame.bit_depth} bits per pixel, the camera's description says full scale "
            f"{model.full_scale_dn}; use the description of this pixel format"
        )


def _crop(frame: Frame, patch: Patch, model: SignalModel) -> PatchFrame:
    dn = frame.dn[patch.slices].copy()
    limit = model.saturation_dn(frame.settings)
    end = model.saturation_dn(frame.settings, within_data=False)
    clipped = dn >= limit
    few = clipped.sum() <= _DEFECT_FRACTION * dn.size
    brightest = _brightest_part(dn) if few else float(dn.max())
    expected = model.table(frame.settings)
    signal = expected[dn]
    sigma = max(_neighbour_noise(dn), _noise_dn(model, frame.settings, brightest))
    usable = bool(few and brightest + _CLEAR_OF_CLIPPING_SIGMA * sigma < limit)
    unclipped = usable or bool(dn.max() < end and brightest + _CLEAR_OF_CLIPPING_SIGMA * sigma < end)
    step = max(1, math.isqrt(frame.dn.size // _PIXELS_OF_THE_WHOLE))
    few_of_all = frame.dn[::step, ::step]
    whole, whole_clipped = float(expected[few_of_all].mean()), float(np.mean(few_of_all >= end))
    return PatchFrame(frame.settings, dn, signal, usable, unclipped, clipped, whole, whole_clipped, frame.masked_dn)


def _brightest_part(dn: DigitalNumbers) -> float:
    """Return the level of the brightest part of a patch that is more than a defect, its noise taken off.

    A patch may cross an edge: then it is the bright half that must not clip. In an even patch the 95th percentile is
    1.645 standard deviations of the noise above the level.
    """
    high = float(np.percentile(dn, 95.0))
    return max(float(np.median(dn)), high - TWENTIETH_TO_SIGMA * _neighbour_noise(dn))


def _neighbour_noise(dn: DigitalNumbers) -> float:
    """Return the noise in DN from the middle of the differences between neighbours, which edges do not move."""
    values = dn.astype(np.float64)
    differences = np.concatenate([np.diff(values, axis=axis).ravel() for axis in (0, 1)])
    return neighbour_sigma(differences) if differences.size else 0.0


def _noise_dn(model: SignalModel, settings: FrameSettings, dn: float) -> float:
    gain_slope = float(model.at_dn(model.slope, dn)) / gain_factor(settings.gain_db)
    signal = float(model.at_dn(model.table(settings), dn))
    sigma = float(np.sqrt(model.variance(signal, settings)))
    return sigma / max(gain_slope, 1e-300)
