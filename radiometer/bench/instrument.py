"""The instrument: a camera, its calibration and a patch, asked for readings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiometer.acquire.bracketing import (
    DEFAULT_TIME_LIMIT_S,
    BracketRequest,
    Progress,
    own_shutter,
    plan_for_scene,
    take_dark_frames,
    take_plan,
)
from radiometer.acquire.exposure_plan import STEADY_SHORT_FRAMES, ExposurePlan, steadied
from radiometer.analysis.calibration.shared import require_camera
from radiometer.analysis.reading.budget import PatchSituation
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.data import Bracket, Calibration, Frame, LensDescription, Patch, Reading, SourceDescription
from radiometer.data.pile_up import with_white_levels
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.devices import Camera
from radiometer.errors import UsageError

# A surround of which more than this clips is looked at in a shorter frame, each by this factor.
_SURROUND_CLIPS = 0.002
_SURROUND_STEP = 16.0  # 4 stops: what clips around a patch is rarely brighter by more
# A patch of which as much clips is bright; frames that flicker so are taken again, each time shorter by the factor.
_CLIPS = 0.5
_UNCLIPPED_STEP = 4.0  # 2 stops at a time: few tries, and no more noise than needed
_MOST_TRIES = 12  # 24 stops: the whole range of any camera
# Dark frames at each exposure, taken where the dark level's uncertainty is more than this part of the light.
_DARK_FRAMES = 2
_DARK_MATTERS_REL = 0.003  # a third of the 1 % that a reading is good for


def clipped_part(frame: Frame) -> float:
    """Return the part of a frame's pixels that stand within 2 % of the white level."""
    return float(np.mean(frame.dn >= 0.98 * frame.saturated_dn))


@dataclass(frozen=True, slots=True)
class Instrument:
    """Reads the radiance of patches with an open camera."""

    camera: Camera  # an open camera
    patch: Patch  # where to read by default
    # Absolute calibration of this camera; None gives relative readings flagged so
    calibration: Calibration | None = None
    time_limit_s: float = DEFAULT_TIME_LIMIT_S  # bound on the sum of the exposure times of one reading in s
    f_number: float | None = None  # f-number that the lens is set to where the camera's description does not hold
    source: SourceDescription | None = None  # what is known of the light
    # Whether the light's spectrum is known to be the one that the calibration names for it
    spectrum_stated: bool = True
    # Called with True to have the lens covered for dark frames, and False after them; None for none by hand
    cover: Callable[[bool], None] | None = None
    clock: Callable[[], float] = time.monotonic  # steady clock in s
    calibration_file: Path | None = None  # where the calibration was read from, for the record of a reading

    def __post_init__(self) -> None:
        if mosaic := self.camera.description.mosaic:
            raise UsageError(
                f"camera {self.camera.identity.device_id}: its frames are a mosaic of colours ({mosaic}), which has no "
                "one radiance; capture it with `radiometer bracket`, then `radiometer colour measure`"
            )
        self._require_fit()

    def _require_fit(self) -> None:
        """Refuse a calibration or a patch that the camera, as it is set now, does not fit."""
        if self.calibration is not None:
            require_camera(self.calibration, self.camera.description)
        refuse_outside(self.patch, self.camera)

    def at(self, patch: Patch) -> Instrument:
        """Return the same instrument looking at another patch. Raises UsageError where it leaves the frame."""
        return replace(self, patch=patch)

    def measure(
        self, *, target_u_rel: float | None = None, sequence: int = 0, progress: Progress | None = None
    ) -> Reading:
        """Meter the patch, take the bracket it needs and return its radiance.

        Args:
            target_u_rel: Wanted relative standard uncertainty from noise; None for a single pass.
            sequence: Running number to give the reading.
            progress: Called after every frame.

        Raises:
            DeviceError: If the camera fails.
            CalibrationError: If the calibration does not fit.
        """
        return self.read(self.take_bracket(target_u_rel=target_u_rel, progress=progress), sequence=sequence)

    def take_bracket(self, *, target_u_rel: float | None = None, progress: Progress | None = None) -> Bracket:
        """Meter the patch and return the frames that cover it.

        Raises:
            DeviceError: If the camera fails.
            CalibrationError: If the camera is set otherwise than the calibration holds for.
            UsageError: If the patch leaves the frame.
        """
        self._require_fit()
        request = BracketRequest(region=self.patch, target_u_rel=target_u_rel, time_limit_s=self.time_limit_s)
        plan = plan_for_scene(self.camera, request)
        plan = steadied(plan, self.source.flicker_hz if self.source else None, self.time_limit_s)
        frames: list[Frame] = list(take_plan(self.camera, plan, request, progress=progress, clock=self.clock))
        frames = self._unclipped(frames, request, progress)
        darks = self._of_dark(frames)
        frames += [*self._of_surround(frames), *darks]
        return Bracket.from_frames(with_white_levels(frames), origin=self.camera.identity.device_id)

    def _unclipped(self, frames: list[Frame], request: BracketRequest, progress: Progress | None) -> list[Frame]:
        """Return the frames, or shorter ones where the light was another than metered: all clip, or some as short.

        To leave out only those that clip would be to leave out the bright part of a flicker.
        """
        lowest = self.camera.capabilities.exposure_s[0]
        for _ in range(_MOST_TRIES):
            shortest = min(frame.settings.exposure_s for frame in frames)
            if not self._clips_unforeseen(frames) or shortest <= lowest * (1 + 1e-9):
                break
            times = (max(shortest / _UNCLIPPED_STEP, lowest),) * STEADY_SHORT_FRAMES
            frames = list(take_plan(self.camera, ExposurePlan(times), request, progress=progress, clock=self.clock))
        return frames

    def _clips_unforeseen(self, frames: list[Frame]) -> bool:
        """Return whether the patch clips in all frames, or in one exposed no longer than one in which it does not."""
        shown = with_white_levels(frames)
        parts = [(float(np.mean(f.dn[self.patch.slices] >= 0.98 * f.saturated_dn)), f.settings) for f in shown]
        clear = [settings.exposure_s for part, settings in parts if part < _CLIPS]
        clipped = [settings.exposure_s for part, settings in parts if part >= _CLIPS]
        return bool(clipped) and min(clipped) <= max(clear, default=math.inf) * (1 + 1e-9)

    def _of_dark(self, frames: list[Frame]) -> list[Frame]:
        """Return dark frames: with a cap where asked for, by the camera's own shutter where the dark level matters."""
        own = own_shutter(self.camera) if self.camera.capabilities.has_shutter else None
        close = self.cover or own
        if close is None or not (self.cover or self._dark_matters(frames)):
            return []
        exposures = sorted({frame.settings.exposure_s for frame in frames})
        return list(take_dark_frames(self.camera, exposures, _DARK_FRAMES, close))

    def _dark_matters(self, frames: list[Frame]) -> bool:
        """Return whether what is not known of the black level and the dark current weighs against the light."""
        if self.calibration is None or not frames:
            return False
        longest = max(frames, key=lambda frame: frame.settings.effective_exposure_s)
        black, noise, settings = self.calibration.black_level, self.calibration.noise, longest.settings
        dark_dn = noise.dark_e(settings.exposure_s, settings.temperature_c) * noise.gain_dn_per_e(settings.gain_db)
        level = black.dn if settings.black_level_dn is None else settings.black_level_dn
        light_dn = float(longest.dn[self.patch.slices].mean()) - level - dark_dn
        return math.hypot(black.u_dn, black.dark_u_rel * dark_dn) > _DARK_MATTERS_REL * max(light_dn, 0.0)

    def _of_surround(self, frames: list[Frame]) -> list[Frame]:
        """Return shorter frames until the surround no longer clips: what it spreads over the patch depends on it."""
        if self.calibration is None or not frames:
            return []
        shortest, added = min(frames, key=lambda frame: frame.settings.exposure_s), list[Frame]()
        exposure_s, lowest = shortest.settings.exposure_s, self.camera.capabilities.exposure_s[0]
        while clipped_part(shortest) > _SURROUND_CLIPS and exposure_s > lowest:
            exposure_s = max(exposure_s / _SURROUND_STEP, lowest)
            self.camera.configure(replace(self.camera.settings, exposure_s=exposure_s))
            shortest = self.camera.capture(1)[0]
            added.append(shortest)
        return added

    def read(self, bracket: Bracket, *, sequence: int = 0) -> Reading:
        """Return the radiance of the patch in frames already taken. Raises CalibrationError if it does not fit."""
        return read_patch(bracket, self.patch, self.setup, sequence=sequence)

    def with_origin(self, reading: Reading) -> Reading:
        """Return a reading with its assumptions, its calibration (file, date, reference) and its budget in `more`."""
        known = self.calibration
        assumed = () if reading.provenance is None else reading.provenance.assumptions
        of_calibration = () if known is None or known.provenance is None else known.provenance.assumptions
        calibration = None
        if known is not None:
            file = None if self.calibration_file is None else str(self.calibration_file)
            calibration = {"file": file, "created": known.created, "reference": known.scale.reference}
        origin = {"assumptions": list(dict.fromkeys((*of_calibration, *assumed))), "calibration": calibration}
        return replace(reading, more={**reading.more, **origin, "budget": reading.budget_lines})

    def situation(self, bracket: Bracket) -> PatchSituation:
        """Return what a reading of frames is made from. Raises CalibrationError if the calibration does not fit."""
        return patch_situation(bracket, self.patch, self.setup)

    @property
    def setup(self) -> Setup:
        """Return camera, lens and calibration in use, and the light."""
        spectrum = AS_CALIBRATED if self.spectrum_stated else None
        return Setup(self.camera.description, self.lens, self.calibration, self.source, spectrum)

    @property
    def lens(self) -> LensDescription:
        """Return the lens in front of the camera, with the f-number stated by hand where there is one."""
        lens = self.camera.lens
        return lens if self.f_number is None else lens.model_copy(update={"f_number": self.f_number})


def refuse_outside(patch: Patch, camera: Camera) -> None:
    """Raise UsageError for a patch that leaves the camera's frame."""
    height, width = _frame_shape(camera)
    if not patch.fits((height, width)):
        raise UsageError(f"patch {patch} leaves the frame of {width} × {height} pixels")


def central_patch(camera: Camera) -> Patch:
    """Return a patch in the middle of the frame, a tenth of it in each direction."""
    height, width = _frame_shape(camera)
    across, down = max(1, width // 10), max(1, height // 10)
    return Patch((width - across) // 2, (height - down) // 2, across, down)


def _frame_shape(camera: Camera) -> tuple[int, int]:
    """Return height and width of a camera's frames as it is set; its region is in pixels after binning."""
    limits, roi, binning = camera.capabilities, camera.settings.roi, camera.settings.binning
    return (roi.height, roi.width) if roi else (limits.height // binning, limits.width // binning)
