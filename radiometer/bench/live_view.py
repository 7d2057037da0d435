"""Live view of a camera on a page: picture, histogram, clipping, and a patch that is drawn with the mouse."""

from __future__ import annotations

import base64
import io
import queue
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

from radiometer.acquire.metering import meter
from radiometer.bench.config import read_bench
from radiometer.bench.instrument import refuse_outside
from radiometer.data import Frame, Patch
from radiometer.data.storage import write_text_atomic
from radiometer.devices import Camera
from radiometer.errors import ConfigurationError, InputError, UsageError
from radiometer.screen.loopback import LoopbackServer, Message, page_text

_BINS: Final = 64
_MOST_PIXELS: Final = 900  # of the picture's longer side on the page
_CLIPPED_RGB: Final = (64, 224, 255)
_CLIPS: Final = 0.98  # of saturation: as in the daemon's picture
_METERED_SHARE: Final = 0.5  # of full scale to which the patch is metered: far from clipping and from noise
_PATCH_LINES: Final = re.compile(r"^patch:[^\n]*\n(?:[ \t]+[^\n]*\n)*", re.MULTILINE)


class LiveView:
    """Shows what an open camera sees to any number of browsers.

    Args:
        patch: Patch to begin with.
        bench: Bench file that a patch may be written into; None where there is none.
        port: Port on 127.0.0.1; 0 for any free one.
        notice: Gets a line for every patch that is drawn.
    """

    def __init__(
        self, camera: Camera, patch: Patch, bench: Path | None, port: int = 0, *, notice: Callable[[str], None]
    ) -> None:
        self._camera, self._patch, self._bench, self._notice = camera, patch, bench, notice
        self._server = LoopbackServer(page_text("view.html"), self, port, what="live view")
        self._asked: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._latest: Message | None = None

    @property
    def url(self) -> str:
        """Return the address of the page. Raises DeviceError unless open."""
        return self._server.url

    @property
    def patch(self) -> Patch:
        """Return the patch that was drawn last."""
        return self._patch

    def open(self) -> None:
        """Serve the page. Raises DeviceInUse where the port is taken."""
        self._server.start()

    def close(self) -> None:
        """Tell the browsers that it is over, and stop serving."""
        self._server.stop({"kind": "end"})

    def step(self) -> None:
        """Do what the page asked for, take a frame and show it. Raises DeviceError if the camera fails."""
        while not self._asked.empty():
            self._do(self._asked.get())
        message = self._seen(self._camera.capture(1)[0])
        self._latest = message
        self._server.run(self._server.send_all(message))

    def greeting(self) -> Message | None:
        return self._latest

    def received(self, message: Message) -> None:
        """Keep what a browser asks for until the camera is free."""
        self._asked.put(message)

    def left(self) -> None:
        """Do nothing: the others go on looking."""

    def _do(self, message: Message) -> None:
        match message.get("kind"):
            case "patch":
                self._take_patch(message.get("patch"))
            case "exposure" if message.get("factor") in (0.5, 2):
                self._expose(self._camera.settings.exposure_s * float(message["factor"]))
            case "meter":
                self.meter_patch()
            case "save":
                self._save()

    def meter_patch(self) -> None:
        """Expose so that the brightest pixels of the patch reach half of full scale. Raises DeviceError."""
        rates = meter(self._camera, self._patch).rates_dn_per_s
        brightest = float(np.max(rates[np.isfinite(rates)], initial=0.0))
        full_scale_dn = self._camera.description.full_scale_dn
        limits = self._camera.capabilities.exposure_s
        self._expose(_METERED_SHARE * full_scale_dn / brightest if brightest > 0 else limits[1])

    def _expose(self, exposure_s: float) -> None:
        low, high = self._camera.capabilities.exposure_s
        self._camera.configure(replace(self._camera.settings, exposure_s=float(np.clip(exposure_s, low, high))))

    def _take_patch(self, numbers: object) -> None:
        if not (isinstance(numbers, list) and len(numbers) == 4 and all(isinstance(one, int) for one in numbers)):
            return
        try:
            refuse_outside(Patch(*numbers), self._camera)
        except UsageError as error:
            self._say(str(error), failed=True)
            return
        self._patch = Patch(*numbers)
        self._notice(f"--patch {','.join(map(str, numbers))}")

    def _save(self) -> None:
        if self._bench is None:
            return
        try:
            write_patch(self._bench, self._patch)
        except (ConfigurationError, InputError) as error:
            self._say(str(error), failed=True)
            return
        one = self._patch
        written = f"{self._bench}: patch {one.x},{one.y},{one.width},{one.height} written"
        self._say(written)
        self._notice(written)

    def _say(self, text: str, *, failed: bool = False) -> None:
        self._server.run(self._server.send_all({"kind": "notice", "text": text, "failed": failed}))

    def _seen(self, frame: Frame) -> Message:
        """Return what the page shows of a frame."""
        top, dn = frame.full_scale_dn, frame.dn
        clipped = dn >= _CLIPS * frame.saturated_dn
        inside, part = dn[self._patch.slices].astype(np.float64), float(np.mean(clipped[self._patch.slices]))
        who, one = self._camera.identity, self._patch
        shown = _picture(frame, clipped)
        content = io.BytesIO()
        shown.save(content, "PNG", compress_level=1)
        return {
            "kind": "frame",
            "camera": f"{who.vendor} {who.model} {who.serial}",
            "size": [dn.shape[1], dn.shape[0]],
            "shown": list(shown.size),
            "png": base64.b64encode(content.getvalue()).decode("ascii"),
            "patch": [one.x, one.y, one.width, one.height],
            "exposure": f"{frame.settings.exposure_s:.4g} s",
            "clipped": f"{100 * float(np.mean(clipped)):.2f} %",
            "clips": bool(clipped.any()),
            "mean": f"{inside.mean():.1f} DN",
            "scatter": f"{inside.std(ddof=1) if inside.size > 1 else 0.0:.1f} DN",
            "patchclipped": f"{100 * part:.2f} %",
            "patchclips": part > 0,
            "histogram": np.histogram(dn, _BINS, (0, top + 1))[0].tolist(),
            "top": int(top),
            "black": frame.settings.black_level_dn,
            "bench": None if self._bench is None else self._bench.name,
        }


def _picture(frame: Frame, clipped: Any) -> Image.Image:
    """Return a frame as grey of the square root of the signal, clipped pixels in colour."""
    step = max(1, -(-max(frame.dn.shape) // _MOST_PIXELS))
    signal = np.maximum(frame.dn[::step, ::step] - float(frame.settings.black_level_dn or 0.0), 0.0)
    level = np.sqrt(signal / max(frame.full_scale_dn - float(frame.settings.black_level_dn or 0.0), 1.0))
    rgb = np.repeat((255 * np.clip(level, 0.0, 1.0)).astype(np.uint8)[..., None], 3, axis=2)
    rgb[clipped[::step, ::step]] = _CLIPPED_RGB
    return Image.fromarray(rgb)


def write_patch(bench: Path, patch: Patch) -> None:
    """Write a patch into a bench file; all other lines stay as they are.

    Raises:
        ConfigurationError: If the file would not be a valid bench any more; it is left as it was.
        InputError: If it cannot be read.
    """
    try:
        text = bench.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {bench}: {error}") from error
    line = f"patch: {{x: {patch.x}, y: {patch.y}, width: {patch.width}, height: {patch.height}}}\n"
    text = text if text.endswith("\n") else text + "\n"
    changed = _PATCH_LINES.sub(line, text, count=1) if _PATCH_LINES.search(text) else text + line
    trial = bench.with_name(f".{bench.name}.trial.yaml")
    write_text_atomic(trial, changed)
    try:
        config, _ = read_bench(trial)
        if config.patch is None or config.patch.patch != patch:
            raise ConfigurationError(
                f"{bench}: its patch cannot be changed by itself; write it by hand: {line.strip()}"
            )
    finally:
        trial.unlink(missing_ok=True)
    write_text_atomic(bench, changed)
