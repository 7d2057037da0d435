"""GET /frame.png: the latest picture in false colour with a scale bar."""

from __future__ import annotations

import asyncio
import io
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from aiohttp import web
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from pydantic import Field

from radiometer.daemon.http.requests import STATION, Asked, Route, Switch, read_query
from radiometer.daemon.instrument import Measurement
from radiometer.data import Frame, ResponseCurve

_TICKS: Final = np.linspace(0.0, 1.0, 5)  # places of the page's labels next to its bar
_MOST_DIGITS: Final = 7  # a scale spans 0.1 % at least: five labels differ in the sixth digit
_BAR_WIDTH: Final = 132  # pixels: the bar and its longest number
_CLIPPED_RGB: Final = (64, 224, 255)  # cyan, which inferno and grey do not hold
_HATCH_PX: Final = 4  # wide enough to be seen, in the red view, on a page at half size
_PERCENTILES: Final = (0.5, 99.8)  # a few hot pixels or glints do not set the scale


class PictureQuery(Asked):
    """How the picture is drawn."""

    width: int = Field(808, ge=64, le=2048, description="Width of the picture in pixels; 808 by default.")
    scale: Literal["log", "linear", "auto"] = Field(
        "auto", description="log, linear, or auto (log where the scene spans more than a factor of 20)."
    )
    map: Literal["inferno", "grey", "red"] = Field("inferno", description="inferno, grey, or red (for a dark room).")
    bar: Switch = Field(True, description="Draw the scale bar; on by default.")


@dataclass(frozen=True, slots=True, eq=False)
class ServedPicture:
    """Radiance of every pixel as far as the frames determine it."""

    radiance: NDArray[np.float32]  # radiance, shape (height, width), above 0 where defined
    clipped: NDArray[np.bool_]  # pixels that clip even in the shortest frame
    unit: str  # unit of the radiance
    sequence: int  # sequence number of the reading it belongs to


def composite(measurement: Measurement, response: ResponseCurve | None, sequence: int) -> ServedPicture:
    """Return the picture of a measurement, scaled so that the patch has the radiance that was read there.

    Every pixel is taken from the longest exposure in which it does not clip. Only the patch is measured; elsewhere lens
    shading is not corrected, so the picture is for looking, not for reading.
    """
    frames = sorted(measurement.frames, key=lambda frame: frame.settings.effective_exposure_s)
    signal, clipped = _signal(frames[0], response)
    for frame in frames[1:]:
        longer, saturated = _signal(frame, response)
        signal = np.where(saturated, signal, longer)
    reading = measurement.reading
    level = float(np.mean(signal[reading.patch.slices]))
    scale = reading.radiance.value / level if level > 0 and reading.radiance.value > 0 else 1.0
    return ServedPicture(np.asarray(signal * scale, dtype=np.float32), clipped, reading.radiance.unit, sequence)


def _signal(frame: Frame, response: ResponseCurve | None) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the exposure per s (up to a constant) and where the frame clips."""
    clipped = frame.dn >= frame.saturated_dn * 0.98
    if response is not None and response.log_exposure.size > frame.full_scale_dn:
        linear = np.exp(np.nan_to_num(response.log_exposure, nan=-30.0, neginf=-30.0, posinf=30.0))
        signal = linear.astype(np.float32)[frame.dn]
    else:
        signal = frame.dn.astype(np.float32) - np.float32(frame.settings.black_level_dn or 0.0)
    per_s = np.maximum(signal, np.float32(1e-3)) / np.float32(frame.settings.effective_exposure_s)
    return per_s.astype(np.float32, copy=False), clipped


def render(picture: ServedPicture, *, width: int, scale: str, colours: str, bar: bool) -> tuple[bytes, dict[str, str]]:
    """Return the PNG and headers that state its scale.

    Args:
        width: Width of the picture without its bar in pixels.
        scale: "log", "linear" or "auto".
    """
    rows, columns = picture.radiance.shape
    height = max(1, round(rows * width / columns))
    shown = cv2.resize(picture.radiance, (width, height), interpolation=cv2.INTER_AREA)
    clipped = cv2.resize(picture.clipped.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.5
    low, high = (float(v) for v in np.percentile(shown, _PERCENTILES))
    high = max(high, low * 1.001, 1e-12)
    logarithmic = scale == "log" or (scale == "auto" and high / max(low, high * 1e-4) > 20)
    low = max(low, high * 1e-4) if logarithmic else min(low, high)
    level = np.log(np.maximum(shown, low) / low) / np.log(high / low) if logarithmic else (shown - low) / (high - low)
    image = coloured(level, colours)
    _mark_clipped(image, clipped, colours)
    canvas = Image.fromarray(image)
    if bar:
        canvas = _with_bar(canvas, low, high, logarithmic=logarithmic, unit=picture.unit, colours=colours)
    target = io.BytesIO()
    canvas.save(target, "PNG", compress_level=1)
    return target.getvalue(), {
        "Radiometer-Frame": f"{columns},{rows}",
        "Radiometer-Scale": f"{'log' if logarithmic else 'linear'},{low:.6g},{high:.6g}",
        "Radiometer-Ticks": ",".join(bar_labels(next_to_bar(low, high, _TICKS, logarithmic=logarithmic), 2)),
        "Radiometer-Unit": picture.unit,
        "Radiometer-Sequence": str(picture.sequence),
    }


def coloured(level: NDArray[np.floating], colours: str) -> NDArray[np.uint8]:
    """Return RGB pixels for levels 0 to 1."""
    grey = (np.clip(level, 0.0, 1.0) * 255).astype(np.uint8)
    if colours == "inferno":
        return np.ascontiguousarray(cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO)[..., ::-1])
    if colours == "red":
        return np.stack([grey, np.zeros_like(grey), np.zeros_like(grey)], axis=-1)
    return np.stack([grey] * 3, axis=-1)


def _mark_clipped(image: NDArray[np.uint8], clipped: NDArray[np.bool_], colours: str) -> None:
    """Make clipped pixels stand out: in a colour that the map lacks, or hatched where only red may be lit."""
    if colours != "red":
        image[clipped] = _CLIPPED_RGB
        return
    rows, columns = np.indices(clipped.shape)
    image[clipped & ((rows + columns) // _HATCH_PX % 2 == 0)] = 0
    image[clipped & ((rows + columns) // _HATCH_PX % 2 == 1)] = (255, 0, 0)


def _with_bar(
    canvas: Image.Image, low: float, high: float, *, logarithmic: bool, unit: str, colours: str
) -> Image.Image:
    width, height = canvas.size
    whole = Image.new("RGB", (width + _BAR_WIDTH, height), (16, 0, 0) if colours == "red" else (17, 19, 24))
    whole.paste(canvas, (0, 0))
    top, bottom = min(34, height // 4), max(height - 14, height // 2)
    ramp = np.linspace(1, 0, max(bottom - top, 2))[:, None] * np.ones((1, 18))
    whole.paste(Image.fromarray(coloured(ramp, colours)), (width + 14, top))
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(12)
    ink = (255, 96, 96) if colours == "red" else (226, 228, 233)
    draw.text((width + 14, 8), unit, fill=ink, font=font)
    positions = np.linspace(0, 1, 6 if height >= 200 else 3)
    values = next_to_bar(low, high, positions, logarithmic=logarithmic)
    for position, text in zip(positions, bar_labels(values, 3), strict=True):
        y = bottom - position * (bottom - top)
        draw.line((width + 32, y, width + 37, y), fill=ink)
        draw.text((width + 42, y), text, fill=ink, font=font, anchor="lm")
    return whole


def bar_labels(values: NDArray[np.floating], digits: int) -> list[str]:
    """Return the values next to the bar as texts that differ, of at least so many digits."""
    for count in range(digits, _MOST_DIGITS + 1):
        texts = [f"{value:#.{count}g}".rstrip(".") for value in values]
        if len(set(texts)) == len(texts):
            break
    return texts


def next_to_bar(low: float, high: float, positions: NDArray[np.floating], *, logarithmic: bool) -> NDArray[np.floating]:
    """Return the values next to the bar at parts of its length, 0 at its lower end and 1 at its upper."""
    return np.asarray(low * (high / low) ** positions if logarithmic else low + (high - low) * positions)


class PictureCache:
    """Remembers the composite of the latest measurement, so that several viewers cost little more than one."""

    def __init__(self) -> None:
        self._source: Measurement | None = None
        self._picture: ServedPicture | None = None

    def get(self, measurement: Measurement, response: ResponseCurve | None, sequence: int) -> ServedPicture:
        """Return the picture of a measurement."""
        if self._picture is None or self._source is not measurement:
            self._picture, self._source = composite(measurement, response, sequence), measurement
        return self._picture


CACHE: Final = web.AppKey("pictures", PictureCache)
ONE_AT_A_TIME: Final = web.AppKey("one picture at a time", asyncio.Lock)


async def show_frame(request: web.Request) -> web.Response:
    """Serve the latest picture. Raises UsageError, or HTTPNotFound where there is none yet."""
    query = read_query(request, PictureQuery)
    station = request.app[STATION]
    if station.shown.pictured is None or not station.shown.pictured[0].frames:
        raise web.HTTPNotFound(text="there is no picture yet; POST /measure makes one")
    measurement, reading = station.shown.pictured
    response = station.instrument.response

    def work() -> tuple[bytes, dict[str, str]]:
        picture = request.app[CACHE].get(measurement, response, reading.sequence)
        return render(picture, width=query.width, scale=query.scale, colours=query.map, bar=query.bar)

    async with request.app[ONE_AT_A_TIME]:
        content, headers = await asyncio.to_thread(work)
    return web.Response(body=content, content_type="image/png", headers=headers)


ROUTES: Final = (
    Route(
        "GET",
        "/frame.png",
        show_frame,
        "Latest picture in false colour with a scale bar; clipped pixels stand out.",
        reply="image/png",
        query=PictureQuery,
    ),
)
