"""What HTTP takes at each of its bounds and refuses one beyond, and what stays the same on either side."""

from __future__ import annotations

import asyncio
import io

import numpy as np
import pytest
from PIL import Image

from radiometer.daemon.http.picture import ServedPicture, render
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.station import Station


@pytest.mark.parametrize(("spread", "message"), [(19.0, "linear"), (20.0, "linear"), (21.0, "log")])
def test_a_scene_of_more_than_twenty_to_one_is_drawn_in_logarithms(spread: float, message: str) -> None:
    """A factor between the half-per-cent dimmest and the 0.2 % brightest; 0 in it is a ten-thousandth at least."""
    radiance = np.repeat(np.array([1.0, spread], np.float32), 2048).reshape(64, 64)
    shown = ServedPicture(radiance, np.zeros((64, 64), bool), "W", 5)
    assert render(shown, width=64, scale="auto", colours="grey", bar=False)[1]["Radiometer-Scale"].startswith(message)
    dark = ServedPicture(np.where(radiance > 1.0, radiance, 0.0), shown.clipped, "W", 5)
    kind, low, high = render(dark, width=64, scale="auto", colours="grey", bar=False)[1]["Radiometer-Scale"].split(",")
    assert (kind, float(low) / float(high)) == ("log", pytest.approx(1e-4, rel=1e-4))


def test_an_even_picture_and_a_black_one_have_a_scale() -> None:
    """A thousandth of what is shown, or 1e-12 where nothing is: no division by nothing, and both ends in order."""
    for level, ends in ((5.0, (5.0, 5.005)), (0.0, (0.0, 1e-12))):
        even = ServedPicture(np.full((64, 64), level, np.float32), np.zeros((64, 64), bool), "W", 5)
        _, headers = render(even, width=64, scale="linear", colours="grey", bar=False)
        assert [float(end) for end in headers["Radiometer-Scale"].split(",")[1:]] == pytest.approx(list(ends))


def test_the_hatching_of_a_dark_room_has_stripes_of_four_pixels() -> None:
    """Diagonals, black first in the upper left corner: along a row and along a column four by four."""
    white = ServedPicture(np.full((64, 64), 5.0, np.float32), np.ones((64, 64), bool), "W", 5)
    page, _ = render(white, width=64, scale="linear", colours="red", bar=False)
    red = np.asarray(Image.open(io.BytesIO(page)))[..., 0]
    stripes = np.tile(np.repeat([0, 255], 4), 8)
    assert red[0].tolist() == stripes.tolist() == red[:, 0].tolist()
    assert red[1, :63].tolist() == stripes[1:].tolist()


@pytest.mark.parametrize(("part", "marked"), [(2, False), (3, True)])
def test_a_shown_pixel_is_clipped_where_more_than_half_of_its_own_are(part: int, marked: bool) -> None:
    """Of blocks of 2 × 2 pixels two do not count, three do; the colour is one that no map has."""
    clipped = np.zeros((128, 128), bool)
    clipped[::2, ::2] = clipped[1::2, ::2] = True
    clipped[::2, 1::2] = part > 2
    partly = ServedPicture(np.full((128, 128), 5.0, np.float32), clipped, "W", 5)
    page, headers = render(partly, width=64, scale="linear", colours="grey", bar=False)
    pixels = np.asarray(Image.open(io.BytesIO(page)))
    assert bool((pixels == (64, 224, 255)).all()) is marked
    assert headers["Radiometer-Frame"] == "128,128"


async def test_connections_are_counted_while_there_is_a_server(station: Station) -> None:
    """None before it listens, each that is open, none once it is closed."""

    def shown() -> str:
        return next(line for line in station.metrics.render().decode().splitlines() if 'interface="http"' in line)

    server = HttpServer(station)
    assert shown() == 'radiometer_connections{interface="http"} 0.0'
    port = await server.listen("127.0.0.1", 0)
    lines = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
    for reader, writer in lines:
        writer.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await reader.readuntil(b"\r\n")
    assert shown() == 'radiometer_connections{interface="http"} 2.0'
    await server.close()
    for _, writer in lines:
        writer.close()
    assert shown() == 'radiometer_connections{interface="http"} 0.0'


@pytest.mark.parametrize("height", [64, 200])
def test_the_bar_leaves_the_picture_as_it_is(height: int) -> None:
    """With the bar the picture stands left of it, pixel by pixel as without."""
    rng = np.random.default_rng(2)
    shown = ServedPicture(
        rng.uniform(1.0, 9.0, (height, 100)).astype(np.float32), np.zeros((height, 100), bool), "W", 5
    )
    alone, neighbour = (
        np.asarray(Image.open(io.BytesIO(render(shown, width=100, scale="linear", colours="inferno", bar=bar)[0])))
        for bar in (False, True)
    )
    assert neighbour.shape[1] > alone.shape[1] == 100
    assert (neighbour[:, :100, :3] == alone[..., :3]).all()
