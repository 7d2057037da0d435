"""UGR and DGP: evalglare's own figures, whatever the projection; a missing extra is named with its remedy."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from radiometer.analysis.regions.glare import glare_of
from radiometer.data import RadianceMap
from radiometer.errors import InputError, MeasurementError, MissingLibrary

SIDE = 200
# Angle from the axis over 90° at the radius r of the circle.
PROJECTIONS = {
    "equidistant": lambda r: r * np.pi / 2,
    "equisolid": lambda r: 2 * np.arcsin(np.clip(r * np.sin(np.pi / 4), 0, 1)),
    "stereographic": lambda r: 2 * np.arctan(r * np.tan(np.pi / 4)),
    "orthographic": lambda r: np.arcsin(np.clip(r, 0, 1)),
}


def _room(projection: str, lamp_cd_m2: float = 20000.0, u: float = 0.0, common: float = 0.0) -> RadianceMap:
    """Return a room of 100 cd·m⁻² with a round lamp of 6° half angle, 30° above the axis."""
    y, x = (np.indices((SIDE, SIDE)) - (SIDE - 1) / 2) / (SIDE / 2)
    r = np.hypot(x, y)
    theta, phi = PROJECTIONS[projection](r), np.arctan2(y, x)
    lamp = np.radians(30)
    away = np.arccos(np.clip(-np.sin(theta) * np.sin(phi) * np.sin(lamp) + np.cos(theta) * np.cos(lamp), -1, 1))
    light = np.where(r <= 1, np.where(away < np.radians(6), lamp_cd_m2, 100.0), 0.0).astype(np.float32)
    return RadianceMap(light, np.full_like(light, u), np.zeros(light.shape, np.uint8), "cd m-2", common)


@pytest.mark.parametrize("projection", list(PROJECTIONS))
def test_ugr_is_that_by_hand_in_every_projection(projection: str) -> None:
    """UGR of one lamp, 8·lg(0.25/L_b·L²·ω/p²), with the position index of Guth (CIE 117, Kim's fit as evalglare)."""
    pytest.importorskip("pyradiance")
    ugr, dgp = glare_of(_room(projection), projection, 180.0)
    tau, sigma = 0.0, 30.0  # in the vertical plane, above the line of sight
    position = np.exp((35.2 - 0.31889 * tau - 1.22 * np.exp(-2 * tau / 9)) * 1e-3 * sigma
                      + (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2)  # fmt: skip
    omega = 2 * np.pi * (1 - np.cos(np.radians(6)))
    by_hand = 8 * np.log10(0.25 / 100.0 * 20000.0**2 * omega / position**2)
    assert ugr.value == pytest.approx(by_hand, abs=0.3)
    assert 0.2 < dgp.value < 1.0


def test_it_is_evalglares_own_figure() -> None:
    """Equal to evalglare called by hand on the same picture written as Radiance's."""
    library = pytest.importorskip("pyradiance")
    room = _room("equidistant")
    light = room.radiance / 179.0
    mantissa, exponent = np.frexp(np.maximum(light, 1e-30))
    one = np.where(light > 0, np.rint(mantissa * 256), 0).astype(np.uint8)
    last = np.where(light > 0, exponent + 128, 0).astype(np.uint8)
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nVIEW= -vta -vv 180 -vh 180\n\n-Y {SIDE} +X {SIDE}\n"
    printed = library.evalglare(header.encode() + np.stack([one, one, one, last], -1).tobytes()).decode()
    dgp, _, expected = (float(text) for text in printed.partition(":")[2].split()[:3])
    ugr, found = glare_of(room, "equidistant", 180.0)
    assert ugr.value == pytest.approx(expected, abs=1e-4)
    assert found.value == pytest.approx(dgp, abs=1e-4)


@pytest.mark.slow
def test_uncertainty_holds_scale_and_noise() -> None:
    """Moving a room's light by 10 % moves UGR by 8·lg(1.1) = 0.33; of 12 maps off by such scales 10 or more hold."""
    pytest.importorskip("pyradiance")
    truth = glare_of(_room("equidistant"), "equidistant", 180.0)
    rng, inside = np.random.default_rng(46_811), 0
    for _ in range(12):
        scale = 1.0 + 0.1 * rng.standard_normal()
        room = _room("equidistant", u=2.0, common=0.1)
        light = (scale * room.radiance + rng.normal(0.0, 2.0, room.shape) * (room.radiance > 0)).astype(np.float32)
        moved = RadianceMap(light, room.u_radiance, room.mask, "cd m-2", 0.1)
        found = glare_of(moved, "equidistant", 180.0)
        inside += all(abs(one.value - true.value) <= 2 * one.u for one, true in zip(found, truth, strict=True))
    assert inside >= 10


def test_without_the_extra_the_message_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing library names the extra."""
    monkeypatch.setitem(sys.modules, "pyradiance", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'radiometer\[glare\]'"):
        glare_of(_room("equidistant"), "equidistant", 180.0)


def test_what_evalglare_cannot_judge_is_refused() -> None:
    """A map in W·sr⁻¹·m⁻², less than a hemisphere, and a saturated lamp."""
    pytest.importorskip("pyradiance")
    room = _room("equidistant")
    with pytest.raises(InputError, match="--spectrum"):
        glare_of(RadianceMap(room.radiance, room.u_radiance, room.mask, "W sr-1 m-2"), "equidistant", 180.0)
    with pytest.raises(InputError, match="hemisphere"):
        glare_of(room, "equidistant", 120.0)
    mask = np.where(room.radiance > 1000, 1, 0).astype(np.uint8)
    with pytest.raises(MeasurementError, match="saturated"):
        glare_of(RadianceMap(room.radiance, room.u_radiance, mask, "cd m-2"), "equidistant", 180.0)
