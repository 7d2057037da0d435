"""What HTTP makes of queries, bodies, events and pictures: each piece by itself, without a server."""

import asyncio
import io
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from radiometer.daemon.http.picture import (
    PictureCache,
    ServedPicture,
    bar_labels,
    coloured,
    composite,
    next_to_bar,
    render,
)
from radiometer.daemon.http.requests import MeasureBody, SettingsBody
from radiometer.daemon.http.server import HttpServer
from radiometer.daemon.instrument import Measurement
from radiometer.data import Frame, FrameSettings, Patch, Quantity, Reading, ResponseCurve


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        ({}, {}),
        ({"exposure_s": 0.02}, {"exposure_s": 0.02, "auto_exposure": False}),
        ({"exposure_s": 0.02, "auto_exposure": True}, {"exposure_s": 0.02, "auto_exposure": True}),
        ({"gain_db": 6.0}, {"gain_db": 6.0}),
        ({"patch": None}, {"patch": None}),
        ({"patch": {"x": 1, "y": 2, "width": 3, "height": 4}}, {"patch": Patch(1, 2, 3, 4)}),
        ({"wavelength_nm": None}, {"wavelength_nm": None}),
    ],
)
def test_only_what_a_body_names_is_changed(body, changes):
    """Defaults change nothing; a stated exposure switches the automatic one off, unless both are stated."""
    assert MeasureBody.model_validate(body).changes() == changes
    assert SettingsBody.model_validate({**body, "every_s": 0.5}).changes() == changes


def measured(*frames, dn=None):
    """Return a measurement of frames of (number, exposure in s, gain in dB), its patch read as 2."""
    pictures = tuple(
        Frame(
            (np.full((8, 8), number) if dn is None else dn).astype(np.uint16),
            12,
            FrameSettings(exposure_s, gain_db, black_level_dn=64.0),
        )
        for number, exposure_s, gain_db in frames
    )
    return Measurement(Reading(Quantity(2.0, 0.1, "1"), Patch(0, 0, 4, 4), "1"), pictures)


def test_a_picture_is_in_the_unit_of_the_reading():
    """The patch shows the reading's value; half the light above black shows half; gain is no light."""
    dn = np.full((8, 8), 64 + 1000)
    dn[6, 6] = 64 + 500
    picture = composite(measured((0, 0.01, 0.0), dn=dn), None, 3)
    assert (picture.radiance[0, 0], picture.radiance[6, 6]) == (pytest.approx(2.0), pytest.approx(1.0))
    frames = measured((64 + 400, 0.01, 0.0), (64 + 1600, 0.02, 20 * math.log10(2.0)))
    assert composite(frames, None, 3).radiance[7, 7] == pytest.approx(2.0)
    clipping = measured((64 + 400, 0.01, 0.0), (4095, 0.02, 0.0))
    assert composite(clipping, None, 3).radiance[0, 0] == pytest.approx(2.0)
    assert composite(measured((4095, 0.01, 0.0)), None, 3).clipped.all()
    assert composite(measured((64 + 50, 100.0, 0.0)), None, 3).radiance[0, 0] == pytest.approx(2.0)  # below 1 DN/s


def test_a_picture_goes_through_the_curve_in_use():
    """Of a square law half the number is a quarter of the light; numbers at or below black are a thousandth of a DN."""
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(2.0 * np.log(np.arange(4096) / 2048.0), np.zeros(4096))
    dn = np.full((8, 8), 2000)
    dn[6, 6] = 1000
    picture = composite(measured((0, 0.01, 0.0), dn=dn), curve, 3)
    assert picture.radiance[6, 6] / picture.radiance[0, 0] == pytest.approx(0.25, rel=1e-5)
    dn = np.full((8, 8), 64 + 1000)
    dn[6, 6] = 40
    assert composite(measured((0, 0.01, 0.0), dn=dn), None, 3).radiance[6, 6] == pytest.approx(2e-6)
    dark = replace(measured((64, 0.01, 0.0)), reading=Reading(Quantity(0.0, 0.1, "1"), Patch(0, 0, 4, 4), "1"))
    assert composite(dark, None, 3).radiance[0, 0] == pytest.approx(1e-3 / 0.01)


@pytest.mark.parametrize(("scale", "message"), [("auto", "log"), ("linear", "linear"), ("log", "log")])
def test_the_scale_of_a_picture_is_reported(scale, message):
    """From the half-per-cent dimmest to the 0.2 % brightest; a factor of 100 is drawn in logarithms by itself."""
    radiance = np.geomspace(1.0, 100.0, 64 * 64).reshape(64, 64).astype(np.float32)
    picture = ServedPicture(radiance, np.zeros((64, 64), bool), "W", 5)
    image, headers = render(picture, width=64, scale=scale, colours="grey", bar=False)
    kind, low, high = headers["Radiometer-Scale"].split(",")
    assert kind == message
    assert [float(low), float(high)] == pytest.approx([100.0**0.005, 100.0**0.998], rel=0.01)
    grey = np.asarray(Image.open(io.BytesIO(image)))[..., 0]
    middle = 0.5 if message == "log" else (10.0 - float(low)) / (float(high) - float(low))
    assert grey[31, 63] / 255 == pytest.approx(middle, abs=0.01)
    assert (headers["Radiometer-Unit"], headers["Radiometer-Sequence"]) == ("W", "5")


def test_clipped_pixels_stand_out_in_every_map():
    """In a colour that no map has; in the red map, for a dark room, as a hatching of red and black."""
    clipped = np.zeros((64, 64), bool)
    clipped[:32] = True
    picture = ServedPicture(np.full((64, 64), 5.0, np.float32), clipped, "W", 5)
    for colours, expected in (
        ("grey", {(64, 224, 255)}),
        ("inferno", {(64, 224, 255)}),
        ("red", {(0, 0, 0), (255, 0, 0)}),
    ):
        image, _ = render(picture, width=64, scale="linear", colours=colours, bar=False)
        pixels = np.asarray(Image.open(io.BytesIO(image)))
        assert set(map(tuple, pixels[:30].reshape(-1, 3).tolist())) == expected
        assert set(map(tuple, pixels[34:].reshape(-1, 3).tolist())).isdisjoint({(64, 224, 255)})
        assert colours != "red" or not pixels[..., 1:].any(), "rods stay adapted"
    assert coloured(np.array([[-1.0, 0.5, 2.0]]), "grey")[0, :, 0].tolist() == [0, 127, 255]


def test_a_picture_is_made_once_for_a_measurement():
    """Asked again it is the same; of the next measurement another."""
    cache, one, other = PictureCache(), measured((500, 0.01, 0.0)), measured((600, 0.01, 0.0))
    first = cache.get(one, None, 1)
    assert cache.get(one, None, 1) is first
    assert cache.get(other, None, 2).sequence == 2


@pytest.mark.parametrize(("clipped", "shown"), [(0, 0.04), (4, 0.04), (5, 0.02), (4096, 0.02)])
def test_the_frame_shown_is_the_longest_in_which_less_than_a_thousandth_clips(clipped, shown):
    """Of 4096 pixels four may clip; where all frames clip, the shortest is shown."""
    dn = np.full(4096, 900)
    dn[:clipped] = 4095
    pictures = [
        Frame(dn.reshape(64, 64).astype(np.uint16), 12, FrameSettings(0.04)),
        Frame(np.full((64, 64), 450, np.uint16), 12, FrameSettings(0.02)),
        Frame(np.full((64, 64), 225, np.uint16), 12, FrameSettings(0.01)),
    ]
    reading = Reading(Quantity(2.0, 0.1, "1"), Patch(0, 0, 4, 4), "1")
    assert Measurement(reading, tuple(pictures)).frame.settings.exposure_s == shown
    white = tuple(replace(one, dn=np.full((64, 64), 4095, np.uint16)) for one in pictures)
    assert Measurement(reading, white).frame.settings.exposure_s == 0.01
    assert Measurement(reading).frame is None


def test_the_numbers_next_to_the_bar_are_those_of_its_scale():
    """Half way up stands the geometric mean of a logarithmic bar's ends, of a linear one's the arithmetic mean."""
    places = np.array([0.0, 0.5, 1.0])
    assert next_to_bar(1.0, 100.0, places, logarithmic=True) == pytest.approx([1.0, 10.0, 100.0])
    assert next_to_bar(1.0, 100.0, places, logarithmic=False) == pytest.approx([1.0, 50.5, 100.0])


@given(st.floats(1e-6, 1e6), st.floats(1.001, 1e4), st.booleans())
def test_no_two_numbers_next_to_the_bar_are_one(low, ratio, logarithmic):
    """Whatever the scale: it spans 0.1 % at least."""
    values = next_to_bar(low, low * ratio, np.linspace(0.0, 1.0, 6), logarithmic=logarithmic)
    texts = bar_labels(values, 2)
    assert len(set(texts)) == 6
    assert [float(text) for text in texts] == pytest.approx(list(values), rel=0.05)


_CSS = (Path(__file__).parents[3] / "radiometer/daemon/http/page/page.css").read_text(encoding="utf-8")
_THEMES = {"light": r":root \{", "dark": r':root\[data-theme="dark"\] \{', "red": r':root\[data-theme="red"\] \{'}
# 4.5 for text (WCAG 2.1, 1.4.3); 3 for what marks a control or is a graph (1.4.11).
_NEEDED = {"ink": 4.5, "quiet": 4.5, "accent": 4.5, "good": 4.5, "bad": 4.5, "edge": 3.0}


def _palette(theme):
    block = re.split(_THEMES[theme], _CSS)[1].partition("}")[0]
    found = {}
    for name, digits in re.findall(r"--([\w-]+): #([0-9a-f]{3,6})\b", block):
        wide = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
        found[name] = tuple(int(wide[i : i + 2], 16) for i in (0, 2, 4))
    return found


def _luminance(colour):
    linear = [c / 255 / 12.92 if c / 255 <= 0.04045 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one, other):
    bright, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", _THEMES)
def test_every_colour_of_a_theme_can_be_distinguished_from_what_it_lies_on(theme):
    """Text, lines of plots, rims of fields and sliders; the red theme lights nothing but red: rods stay adapted."""
    palette = _palette(theme)
    for name, needed in _NEEDED.items():
        assert _contrast(palette[name], palette["card"]) >= needed, (theme, name)
    for one, other in (("ink", "ground"), ("quiet", "ground"), ("on-accent", "accent"), ("bad", "alarm")):
        assert _contrast(palette[one], palette[other]) >= 4.5, (theme, one)
    assert theme != "red" or all(colour[1:] == (0, 0) for colour in palette.values())


@pytest.mark.parametrize(("spread", "message"), [(20.0, "linear"), (21.0, "log")])
def test_a_scene_of_more_than_twenty_to_one_is_drawn_in_logarithms(spread, message):
    """A factor between the half-per-cent dimmest and the 0.2 % brightest; 0 in it is a ten-thousandth at least."""
    radiance = np.repeat(np.array([1.0, spread], np.float32), 2048).reshape(64, 64)
    shown = ServedPicture(radiance, np.zeros((64, 64), bool), "W", 5)
    assert render(shown, width=64, scale="auto", colours="grey", bar=False)[1]["Radiometer-Scale"].startswith(message)
    dark = ServedPicture(np.where(radiance > 1.0, radiance, 0.0), shown.clipped, "W", 5)
    kind, low, high = render(dark, width=64, scale="auto", colours="grey", bar=False)[1]["Radiometer-Scale"].split(",")
    assert (kind, float(low) / float(high)) == ("log", pytest.approx(1e-4, rel=1e-4))


def test_an_even_picture_and_a_black_one_have_a_scale():
    """A thousandth of what is shown, or 1e-12 where nothing is: no division by nothing, and both ends in order."""
    for level, ends in ((5.0, (5.0, 5.005)), (0.0, (0.0, 1e-12))):
        even = ServedPicture(np.full((64, 64), level, np.float32), np.zeros((64, 64), bool), "W", 5)
        _, headers = render(even, width=64, scale="linear", colours="grey", bar=False)
        assert [float(end) for end in headers["Radiometer-Scale"].split(",")[1:]] == pytest.approx(
            ends, rel=1e-6, abs=0.0
        )


@pytest.mark.parametrize(("part", "marked"), [(2, False), (3, True)])
def test_a_shown_pixel_is_clipped_where_more_than_half_of_its_own_are(part, marked):
    """Of blocks of 2 × 2 pixels two do not count, three do; the colour is one that no map has."""
    clipped = np.zeros((128, 128), bool)
    clipped[::2, ::2] = clipped[1::2, ::2] = True
    clipped[::2, 1::2] = part > 2
    partly = ServedPicture(np.full((128, 128), 5.0, np.float32), clipped, "W", 5)
    page, headers = render(partly, width=64, scale="linear", colours="grey", bar=False)
    pixels = np.asarray(Image.open(io.BytesIO(page)))
    assert bool((pixels == (64, 224, 255)).all()) is marked
    assert headers["Radiometer-Frame"] == "128,128"


async def test_connections_are_counted_while_there_is_a_server(station):
    """None before it listens, each that is open, none once it is closed."""

    def shown():
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
