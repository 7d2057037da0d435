"""What HTTP makes of queries, bodies, events and pictures: each piece by itself, without a server."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from radiometer.daemon.http.picture import (
    PictureCache,
    ServedPicture,
    coloured,
    composite,
    next_to_bar,
    render,
)
from radiometer.daemon.http.requests import MeasureBody, SettingsBody
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
def test_only_what_a_body_names_is_changed(body: dict[str, Any], changes: dict[str, Any]) -> None:
    """Defaults change nothing; a stated exposure switches the automatic one off, unless both are stated."""
    assert MeasureBody.model_validate(body).changes() == changes
    assert SettingsBody.model_validate({**body, "every_s": 0.5}).changes() == changes


def measured(*frames: tuple[float, float, float], dn: np.ndarray[Any, Any] | None = None) -> Measurement:
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


def test_a_picture_is_in_the_unit_of_the_reading() -> None:
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


def test_a_picture_goes_through_the_curve_in_use() -> None:
    """Of a square law, half the number is a quarter of the light."""
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(2.0 * np.log(np.arange(4096) / 2048.0), np.zeros(4096))
    dn = np.full((8, 8), 2000)
    dn[6, 6] = 1000
    picture = composite(measured((0, 0.01, 0.0), dn=dn), curve, 3)
    assert picture.radiance[6, 6] / picture.radiance[0, 0] == pytest.approx(0.25, rel=1e-5)


@pytest.mark.parametrize(("scale", "message"), [("auto", "log"), ("linear", "linear"), ("log", "log")])
def test_the_scale_of_a_picture_is_reported(scale: str, message: str) -> None:
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


def test_clipped_pixels_stand_out_in_every_map() -> None:
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


def test_a_picture_is_made_once_for_a_measurement() -> None:
    """Asked again it is the same; of the next measurement another."""
    cache, one, other = PictureCache(), measured((500, 0.01, 0.0)), measured((600, 0.01, 0.0))
    first = cache.get(one, None, 1)
    assert cache.get(one, None, 1) is first
    assert cache.get(other, None, 2).sequence == 2


@pytest.mark.parametrize(("clipped", "shown"), [(0, 0.04), (4, 0.04), (5, 0.02), (4096, 0.02)])
def test_the_frame_shown_is_the_longest_in_which_less_than_a_thousandth_clips(clipped: int, shown: float) -> None:
    """Of 4096 pixels four may clip; where all frames clip, the shortest is shown."""
    dn = np.full(4096, 900)
    dn[:clipped] = 4095
    pictures = [
        Frame(dn.reshape(64, 64).astype(np.uint16), 12, FrameSettings(0.04)),
        Frame(np.full((64, 64), 450, np.uint16), 12, FrameSettings(0.02)),
        Frame(np.full((64, 64), 225, np.uint16), 12, FrameSettings(0.01)),
    ]
    reading = Reading(Quantity(2.0, 0.1, "1"), Patch(0, 0, 4, 4), "1")
    frame = Measurement(reading, tuple(pictures)).frame
    assert frame is not None
    assert frame.settings.exposure_s == shown
    white = [replace(one, dn=np.full((64, 64), 4095, np.uint16)) for one in pictures]
    last = Measurement(reading, tuple(white)).frame
    assert last is not None
    assert last.settings.exposure_s == 0.01
    assert Measurement(reading).frame is None


@pytest.mark.parametrize("height", [60, 200])
def test_the_bar_runs_from_its_brightest_at_the_top_to_its_end(height: int) -> None:
    """34 pixels, or a quarter, from the top, and 14, or half, from the bottom; beyond it there is background."""
    picture = ServedPicture(np.linspace(1.0, 2.0, height * 100, dtype=np.float32).reshape(height, 100),
                      np.zeros((height, 100), bool), "W sr-1 m-2", 3)  # fmt: skip
    page, _ = render(picture, width=100, scale="linear", colours="grey", bar=True)
    pixels = np.asarray(Image.open(io.BytesIO(page)).convert("L")).astype(int)
    assert pixels.shape[0] == height
    bar = pixels[:, 100 + 20]
    top, bottom = min(34, height // 4), max(height - 14, height // 2)
    assert bar[top] == bar.max() > 200
    assert np.all(np.diff(bar[top:bottom]) <= 0)
    assert bar[bottom - 1] < 20
    assert len(set(bar[bottom:].tolist())) == 1


def test_the_numbers_next_to_the_bar_are_those_of_its_scale() -> None:
    """Half way up stands the geometric mean of a logarithmic bar's ends, of a linear one's the arithmetic mean."""
    places = np.array([0.0, 0.5, 1.0])
    assert next_to_bar(1.0, 100.0, places, logarithmic=True) == pytest.approx([1.0, 10.0, 100.0])
    assert next_to_bar(1.0, 100.0, places, logarithmic=False) == pytest.approx([1.0, 50.5, 100.0])


def test_what_lies_at_black_is_dim_and_not_a_thousand() -> None:
    """Numbers at or below black are a thousandth of a DN, the patch is what was read, and a patch in the dark is 1."""
    dn = np.full((8, 8), 64 + 1000)
    dn[6, 6] = 40
    assert composite(measured((0, 0.01, 0.0), dn=dn), None, 3).radiance[6, 6] == pytest.approx(2e-6)
    dark = replace(measured((64, 0.01, 0.0)), reading=Reading(Quantity(0.0, 0.1, "1"), Patch(0, 0, 4, 4), "1"))
    assert composite(dark, None, 3).radiance[0, 0] == pytest.approx(1e-3 / 0.01)
