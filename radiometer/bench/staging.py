"""Brings a bench to what a capture plan asks for: by itself where it is simulated, by the user's hand elsewhere."""

from __future__ import annotations

from collections.abc import Callable

from radiometer.acquire.capture_plan import PlannedFrames, Stage
from radiometer.devices import Camera


def stage_of(camera: Camera, ask: Callable[[str], None]) -> Stage:
    """Return what sets source level, pattern, f-number and shutter before each setting of a plan.

    Args:
        ask: Asks the user to do something and returns when it is done; used for hardware, and only for what changes.
    """
    from simulators.cameras.simulated_camera import SimulatedCamera

    if isinstance(camera, SimulatedCamera):
        return lambda planned: _stage_simulated(camera, planned)
    return _ByHand(camera, ask)


def _stage_simulated(camera: object, planned: PlannedFrames) -> None:
    from simulators.cameras.simulated_camera import SimulatedCamera

    assert isinstance(camera, SimulatedCamera)
    camera.set_source(planned.source_level, planned.pattern)
    camera.set_shutter(closed=planned.shutter == "closed")
    if planned.f_number:
        camera.set_f_number(planned.f_number)


class _ByHand:
    def __init__(self, camera: Camera, ask: Callable[[str], None]) -> None:
        self._ask = ask
        self._now = PlannedFrames(exposure_s=1.0, f_number=camera.lens.f_number)

    def __call__(self, planned: PlannedFrames) -> None:
        """Ask for what differs from how the bench stands."""
        wishes = (
            (planned.f_number, self._now.f_number, f"set the lens to f/{planned.f_number or 0:.3g}"),
            (planned.source_level, self._now.source_level, f"set the source to {100 * planned.source_level:g} %"),
            (planned.pattern, self._now.pattern, f"show the pattern {planned.pattern!r}"),
            (
                planned.shutter,
                self._now.shutter,
                "cover the lens" if planned.shutter == "closed" else "uncover the lens",
            ),
        )
        todo = [words for requested, now, words in wishes if requested is not None and requested != now]
        if todo:
            self._ask(", ".join(todo))
        self._now = planned.model_copy(update={"f_number": planned.f_number or self._now.f_number})
