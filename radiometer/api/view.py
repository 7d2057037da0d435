"""The live view of a camera on a page."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from radiometer.api.files import PathLike
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.result import Notice, unheard
from radiometer.bench.assembly import open_bench_camera
from radiometer.bench.instrument import central_patch, refuse_outside
from radiometer.bench.live_view import LiveView
from radiometer.data import Patch
from radiometer.plausible import Count, Period, Port


def view(
    camera: str | None = None,
    patch: PatchLike | None = None,
    *,
    bench: PathLike | None = None,
    port: Port = 0,
    every_s: Period = 0.3,
    frames: Count | None = None,
    announce: Callable[[str], None] = lambda url: None,
    notice: Notice = unheard,
    sleep: Callable[[float], None] = time.sleep,
) -> Patch:
    """Show what a camera sees on a page of this machine, and return the patch that was drawn last.

    Nothing is measured or kept: the page shows picture, histogram and clipping, and a rectangle drawn in the picture
    becomes the patch.

    Examples:
        >>> import radiometer as rm
        >>> rm.view(bench="bench.yaml", frames=1)
        Patch(x=40, y=24, width=16, height=16)

    Args:
        camera: "sim", an id, serial number or address, or v4l2:, picamera:, gphoto2:; the bench's own by default.
        patch: (x, y, width, height) in pixels to begin with; the bench's by default.
        bench: Bench file, into which the page may write the patch; the simulated bench by default.
        port: Port of the page; 0 for any free one.
        every_s: Pause between two frames in s.
        frames: Number of frames after which it ends; without end by default.
        announce: Called with the page's address.
        notice: Gets a line for every patch that is drawn.
        sleep: Waits for a number of seconds.

    Raises:
        UsageError: If the patch leaves the frame.
        DeviceError: If the camera fails, or the port is taken.
    """
    file = None if bench is None else Path(bench)
    with open_bench_camera(file, camera) as (config, opened):
        where = as_patch(patch) or (config.patch.patch if config.patch else central_patch(opened))
        refuse_outside(where, opened)
        shown = LiveView(opened, where, file, port, notice=notice)
        shown.open()
        try:
            announce(shown.url)
            shown.meter_patch()
            done = 0
            while frames is None or done < frames:
                shown.step()
                done += 1
                sleep(every_s)
        except KeyboardInterrupt:
            pass
        finally:
            shown.close()
        return shown.patch
