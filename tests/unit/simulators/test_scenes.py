"""Scenes: the radiance of pixels and what the scene says of its patches agree."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiometer.errors import ConfigurationError
from simulators.scenes import SCENES, LedScene, StepChartScene, scene_from_mapping

EXAMPLES: dict[str, dict[str, Any]] = {
    "uniform": {"kind": "uniform", "radiance_W_per_sr_m2": 0.7},
    "step_chart": {
        "kind": "step_chart",
        "steps": {"count": 20, "lowest": 1e-4, "highest": 10.0},
        "inverted": True,
        "scramble_seed": 3,
    },
    "screen": {
        "kind": "screen",
        "background": {"chart": 0.1, "bright": 0.9},
        "patches": [
            {"name": "a", "x": 2, "y": 3, "width": 10, "height": 8, "drive": {"chart": 0.5, "bright": 0.25}},
            {"name": "b", "x": 30, "y": 3, "width": 10, "height": 8, "radiance_W_per_sr_m2": 0.123},
        ],
    },
    "colour_chart": {
        "kind": "colour_chart",
        "lights": [
            {"name": "red", "bands": [[620.0, 30.0, 0.3]]},
            {"name": "white", "bands": [[450.0, 20.0, 0.1], [560.0, 90.0, 0.4]]},
        ],
    },
    "led": {"kind": "led", "diameter_px": 40, "blur_px": 9},
}


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_patches_hold_the_radiance_that_they_state(kind: str) -> None:
    """In every pattern each pixel of each patch has the patch's stated radiance."""
    scene = scene_from_mapping(EXAMPLES[kind])
    patches = scene.patches(160, 120)
    assert patches
    for pattern in scene.patterns:
        image = scene.render(160, 120, pattern)
        assert image.radiance.dtype == np.float32
        for patch in patches:
            stated = patch.radiance(pattern) if isinstance(patch.radiance_W_per_sr_m2, dict) else patch.radiance()
            if stated is None:
                stated = patch.radiance_W_per_sr_m2
            assert image.radiance[patch.patch.slices] == pytest.approx(stated, rel=1e-6)


def test_charts_span_their_decades_and_reverse() -> None:
    """Every kind has an example; neighbours differ by 10^(5/19); each patch is seen at two radiances."""
    assert set(SCENES) == {*EXAMPLES, "image"}
    chart = StepChartScene.model_validate(EXAMPLES["step_chart"] | {"scramble_seed": None})
    steps = chart.radiances()[1:] / chart.radiances()[:-1]
    assert steps == pytest.approx(np.full(19, 10 ** (5 / 19)), rel=1e-12)
    chart = StepChartScene.model_validate(EXAMPLES["step_chart"])
    assert np.array_equal(chart.radiances("inverted"), chart.radiances()[::-1])


@pytest.mark.parametrize("blur", [0.0, 7.0, 40.0])
def test_defocus_keeps_the_led_total(blur: float) -> None:
    """The sum over pixels is the disc's area times its axial radiance, whatever the blur (grid error below 0.2 %)."""
    led = LedScene(diameter_px=40, blur_px=blur)
    total = float(led.render(200, 160).radiance.sum(dtype=np.float64))
    assert total == pytest.approx(math.pi * 20**2 * led.axial_radiance, rel=2e-3)


def test_leds_and_pictures_have_the_stated_radiance(tmp_path: Path) -> None:
    """A·cosᵐ over the hemisphere is the flux; half of full scale half the peak."""
    led = LedScene(flux_mW=5.0, half_angle_deg=30.0)
    theta = np.linspace(0, np.pi / 2, 20001)
    intensity = led.axial_radiance * led.emitting_area_m2 * np.cos(theta) ** led.intensity_exponent
    assert np.trapezoid(2 * np.pi * intensity * np.sin(theta), theta) == pytest.approx(5e-3, rel=1e-6)
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((40, 60), 32768, np.uint16))
    mapping = {"kind": "image", "file": "grey.png", "peak_radiance_W_per_sr_m2": 3.0}
    image = scene_from_mapping(mapping, folder=tmp_path).render(30, 20, "default")
    assert image.radiance == pytest.approx(np.full((20, 30), 3.0 * 32768 / 65535), rel=1e-5)


FAR = {"name": "far", "x": 155, "y": 0, "width": 10, "height": 4, "drive": 1.0}


@pytest.mark.parametrize(
    ("mapping", "pattern", "message"),
    [
        ({"kind": "screen", "patches": [FAR]}, "default", r"'far' .* is not on the sensor of 160 × 120 px"),
        ({"kind": "image", "file": "none.png"}, "default", r"cannot read .*none\.png"),
        (EXAMPLES["step_chart"], "x", r"no pattern 'x'; it shows default, inverted"),
    ],
)
def test_what_cannot_be_rendered_is_refused(
    tmp_path: Path, mapping: dict[str, Any], pattern: str, message: str
) -> None:
    """A patch partly outside with the sensor's size, a file that is not there, a pattern with those that there are."""
    with pytest.raises(ConfigurationError, match=message):
        scene_from_mapping(mapping, folder=tmp_path).render(160, 120, pattern)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"kind": "moon"}, r"kind = 'moon': there is no such scene; allowed are colour_chart, image"),
        ({"kind": "led", "colour": 1}, r"unknown key 'colour'; allowed here: .*flux_mW"),
        ({"kind": "step_chart"}, r"give either radiances_W_per_sr_m2 or steps"),
        ({"kind": "led", "flux_mW": -1}, r"flux_mW = -1: input should be greater than 0"),
        (
            {"kind": "screen", "patches": [{"name": "a", "x": 0, "y": 0, "width": 1, "height": 1, "drive": 2}]},
            r"patch 'a': a drive is between 0 and 1",
        ),
    ],
)
def test_wrong_mappings_are_refused_by_key(mapping: dict[str, Any], message: str) -> None:
    """The message names the key, its value and what is allowed."""
    with pytest.raises(ConfigurationError, match=message):
        scene_from_mapping(mapping, "bench.yaml: scene")
