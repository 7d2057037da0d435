"""The capture that settles what these data cannot, as a plan that `radiometer bracket` takes."""

import numpy as np
import pytest

from radiometer.acquire.capture_plan import read_capture_plan
from radiometer.reconciliation.engine import examine, whole_catalogue
from radiometer.reconciliation.separability import write_plan
from simulators.scenes.kinds import ScreenPatch, ScreenScene
from testing.reduced import start_of

pytestmark = pytest.mark.slow  # each runs a search among these entries: what may look alike, and some that do not

STRAY = {"veiling_glare", "display_black_leak", "ambient_light_leak"}
SHADING = ("mechanical_vignetting", "angle_dependence", "natural_vignetting", "display_nonuniformity")
OTHERS = ("exposure_time_offset", "gamma_enabled", "black_level_offset", "psf_blur", "stray_light_kernel")
ENTRIES = {name: whole_catalogue()[name] for name in (*sorted(STRAY), *SHADING, *OTHERS)}
BRACKET = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 8) for _ in range(2)]
DARKS = [{"t": t, "shutter": "closed"} for t in (1e-4, 1e-2, 1.0)]


def _veiled(make_capture, *more, known=True):
    captured = make_capture(
        seed=21, plan=[*BRACKET, *DARKS, *more], known=known,
        picture=lambda image, s: 0.99 * image + 0.01 * image.mean(),
    )  # fmt: skip
    return examine(captured.header, captured.frames.__getitem__, captured.frames[0].shape, catalogue=ENTRIES)


@pytest.fixture(scope="module")
def veiled(make_capture):
    """Return the result for a veil of 1 % in a plain bracket."""
    return _veiled(make_capture)


def test_plans_hold_what_is_captured_and_what_would_settle_it(veiled, tmp_path, make_capture):
    """`bracket` reads them; a shading at one f-number asks for a second."""
    design = veiled.outcome.state.design
    assert write_plan(tmp_path / "plan.yaml", veiled.result, design)
    plan = read_capture_plan(tmp_path / "plan.yaml")
    assert plan.total == 4 * (len(design.captures) + 1)
    assert sum(frames.shutter == "closed" for frames in plan.frames) == len(DARKS)
    (effect,) = _shaded(make_capture).result.effects
    assert {"mechanical_vignetting", "angle_dependence"} & {effect.name, *effect.alternatives}
    assert effect.next_capture["frames"][0]["f_number"] != 4.0


def test_an_unknown_scene_is_fitted_and_blind_to_a_veil(make_capture):
    """Still the least χ² is reached to 0.01; its limit lies above it."""
    result = _veiled(make_capture, known=False).result
    assert [effect.name for effect in result.effects if effect.name != "unnamed"] == []
    assert (result.limits["veiling_glare"].amplitude or np.inf) > 0.01
    assert result.limits["ambient_light_leak"].amplitude is None, "without any radiance W/m² has no scale"
    assert result.next_capture["opens"]
    captured = make_capture(seed=22, plan=[*BRACKET, *DARKS], known=False)
    state = start_of(captured)
    assert state.cost == pytest.approx(float(np.sum(state.fit.projected**2)), abs=0.01)


def test_screen_shows_its_patches_in_other_surrounds():
    """Patches stay as they are under the first pattern; only what lies between them changes."""
    patch = ScreenPatch(name="a", x=2, y=2, width=4, height=4, drive={"chart": 0.5, "other": 0.25})
    scene = ScreenScene(background=0.2, patches=(patch,), gamma=1.0, peak_radiance_W_per_sr_m2=1.0)
    for pattern, surround in (("chart", 0.2), ("bright_surround", 1.0), ("dark_surround", 0.0)):
        radiance = scene.render(10, 10, pattern).radiance
        assert radiance[3, 3] == pytest.approx(0.5)
        assert radiance[0, 0] == pytest.approx(surround)
    (described,) = scene.patches(10, 10)
    assert described.radiance("dark_surround") == pytest.approx(0.5)


def _shaded(make_capture):
    y, x = np.mgrid[:64, :96]
    shade = 1.0 - 0.04 * (((x - 47.5) / 47.5) ** 2 + ((y - 31.5) / 47.5) ** 2)
    captured = make_capture(seed=23, plan=[*BRACKET, *DARKS], picture=lambda image, s: image * shade)
    return examine(captured.header, captured.frames.__getitem__, captured.frames[0].shape, catalogue=ENTRIES)
