"""An open instrument: readings and brackets."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from radiometer.acquire.bracketing import DEFAULT_TIME_LIMIT_S, BracketRequest, plan_for_scene, take_plan
from radiometer.api.files import PathLike, Stack
from radiometer.argument_types import with_checked_methods
from radiometer.bench.assembly import open_instrument
from radiometer.bench.instrument import Instrument, refuse_outside
from radiometer.data import Bracket, Calibration, Patch, Reading
from radiometer.data.pile_up import with_white_levels
from radiometer.plausible import AnyCount, FNumber, NotNegative, RelativeUncertainty

PatchLike = Patch | tuple[int, int, int, int]


@with_checked_methods
class Meter:
    """A camera with its calibration, asked for radiance.

    Made by `radiometer.open`; use it as a context manager, or close it when done. Several threads may use one: each
    call waits for the one before.

    Examples:
        >>> import radiometer as rm
        >>> with rm.open("bench.yaml", uncalibrated=True) as meter:
        ...     relative = meter.measure((8, 8, 32, 32))
        ...     stack = meter.bracket(darks=1)
        ...     meter
        <Meter FLIR BFS-U3-19S4M 22500001, patch 40,24 16 × 16, uncalibrated>

        >>> relative.radiance.unit, relative.patch.width, len(stack.bracket.dark) > 0
        ('relative', 32, True)

    Attributes:
        instrument: What it is made of.
    """

    def __init__(self, instrument: Instrument, held: ExitStack) -> None:
        self.instrument = instrument
        self._held = held
        self._one_call = threading.Lock()

    def __enter__(self) -> Self:
        """Return the meter itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the camera."""
        self.close()

    def close(self) -> None:
        """Close the camera; again does nothing."""
        with self._one_call:
            self._held.close()

    def measure(self, patch: PatchLike | None = None, *, u_rel: RelativeUncertainty | None = None) -> Reading:
        """Return the radiance of a patch in W·sr⁻¹·m⁻² with its uncertainty.

        Args:
            patch: (x, y, width, height) in pixels; the bench's patch by default.
            u_rel: Repeat exposures until noise alone is below this relative standard uncertainty.

        Raises:
            DeviceError: If the camera fails.
            UsageError: If the patch leaves the frame.
        """
        where = as_patch(patch)
        instrument = self.instrument if where is None else self.instrument.at(where)
        with self._one_call:
            return instrument.with_origin(instrument.measure(target_u_rel=u_rel))

    def bracket(
        self, patch: PatchLike | None = None, *, darks: AnyCount = 0, time_limit_s: NotNegative = DEFAULT_TIME_LIMIT_S
    ) -> Stack:
        """Take the exposures that cover the scene.

        Args:
            patch: Cover only this patch; the whole frame by default.
            darks: Dark frames per exposure time, where the camera has a shutter.
            time_limit_s: Bound on the sum of the exposure times in s.

        Raises:
            DeviceError: If the camera fails, or darks are requested and it has no shutter.
            UsageError: If the patch leaves the frame.
        """
        camera = self.instrument.camera
        request = BracketRequest(as_patch(patch), None, time_limit_s, darks)
        if request.region is not None:
            refuse_outside(request.region, camera)
        with self._one_call:
            frames = with_white_levels(list(take_plan(camera, plan_for_scene(camera, request), request)))
        origin = camera.identity.device_id
        bracket = Bracket.from_frames(frames, origin)
        return Stack({frames[0].settings.pattern: bracket}, camera.description, self.instrument.lens, origin)

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration in use; None where readings are relative."""
        return self.instrument.calibration

    def __repr__(self) -> str:
        who, patch = self.instrument.camera.identity, self.instrument.patch
        known = self.calibration
        scale = f"calibrated {known.created[:10]} by {known.scale.reference}" if known else "uncalibrated"
        return (
            f"<Meter {who.vendor} {who.model} {who.serial}, "
            f"patch {patch.x},{patch.y} {patch.width} × {patch.height}, {scale}>"
        )


def open(
    source: PathLike | None = None,
    *,
    patch: PatchLike | None = None,
    calibration: PathLike | None = None,
    uncalibrated: bool = False,
    f_number: FNumber | None = None,
) -> Meter:
    """Open a camera as a radiance meter.

    Examples:
        >>> import radiometer as rm
        >>> with rm.open("bench.yaml") as meter:
        ...     reading = meter.measure()
        >>> abs(reading.radiance.value - 0.3) < 3 * reading.radiance.u
        True
        >>> with rm.open("sim", uncalibrated=True) as meter:
        ...     meter.calibration is None
        True

    Args:
        source: A bench file (.yaml), or a camera as for `measure`; the simulated bench by default.
        patch: (x, y, width, height) to read by default.
        calibration: Calibration file; the bench's own by default.
        uncalibrated: Use none: relative readings.
        f_number: f-number that the lens is set to.

    Raises:
        ConfigurationError: If the bench file is wrong.
        DeviceError: If the camera cannot be opened.
    """
    bench = Path(source) if source is not None and str(source).endswith((".yaml", ".yml")) else None
    held = ExitStack()
    instrument = held.enter_context(
        open_instrument(
            bench,
            None if source is None or bench else str(source),
            as_patch(patch),
            Path(calibration) if calibration else None,
            uncalibrated=uncalibrated,
            f_number=f_number,
        )
    )
    return Meter(instrument, held)


def as_patch(patch: PatchLike | None) -> Patch | None:
    """Return a patch from its four numbers; None stays None."""
    return patch if isinstance(patch, Patch | None) else Patch(*patch)
