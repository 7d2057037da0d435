"""Radiance maps and alignments in many situations: every pixel by its digest, masks by how many there are and where."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiometer.analysis.merge.alignment import aligned, find_alignment
from radiometer.analysis.merge.bracket import merge
from radiometer.data import BlackLevel, Bracket, Calibration, Frame, FrameSettings, PixelMask, RadianceMap, SensorNoise
from tests.unit.held import world
from tests.unit.held.figures import digest, moved

STRIP = slice(5, 9), slice(8, 14)  # pixels told one by one: an edge between two fields of the chart


def figures(found: RadianceMap) -> dict[str, Any]:
    """Return the figures of a map."""
    return {
        "unit": found.unit,
        "radiance": digest(found.radiance),
        "u": digest(found.u_radiance),
        "strip": [[float(x) for x in row] for row in found.radiance[STRIP]],
        "u of the strip": [[float(x) for x in row] for row in found.u_radiance[STRIP]],
        "mask": {str(bit.name): digest((found.mask & bit) != 0) for bit in PixelMask if bit},
        "u_rel_common": found.u_rel_common,
        "exposures_s": list(found.exposures_s),
        "not in u": list(found.not_in_u),
        "parameters": found.provenance.parameters,
    }


def aged(**changes: Any) -> Calibration:
    """Return the calibration as it is a hundred days after it was made, whenever that is."""
    made = dt.datetime.now(dt.UTC) - dt.timedelta(days=100)
    return world.calibration(**{"created": made.isoformat(), **changes})


def of(frames: list[Frame], calibration: Calibration | None, **options: Any) -> RadianceMap:
    lens = options.pop("lens", world.LENS)
    camera = calibration.camera if calibration else world.CAMERA
    return merge(Bracket.from_frames(frames), camera, lens, calibration, **options)


def darks() -> list[Frame]:
    return [world.frame(50 + k, t, shutter="closed") for k, t in enumerate((1e-4, 1e-2, 0.16, 0.16))]


def eight_bits(**changes: Any) -> Calibration:
    camera = world.CAMERA.model_copy(update={"bit_depth": 8, "black_level_dn": None, "conversion_gain_e_per_dn": None})
    made = {"camera": camera, "response": world.gamma_curve(), "black_level": BlackLevel()}
    return aged(**{**made, **changes})


DOUBTS = world.doubts(
    exposure_u_rel=3e-3, exposure_u_s=2e-5, f_number_u_rel=0.04, spectral_u_rel=0.05, linearity_u_rel=0.01
)


def at_gains() -> list[Frame]:
    return [world.frame(90 + k, 1e-5 * 4.0**k, gain_db=6.0 * (k % 3)) for k in range(7)]


def unsteady() -> list[Frame]:
    return [world.frame(130 + k, 1e-4, radiance=world.scene() * (1 + 0.2 * (k % 2))) for k in range(6)]


def visited(frames: list[Frame], value: int) -> list[Frame]:
    """Return frames of which the fourth shows a bright square that the others do not have."""
    dn = np.array(frames[3].dn)
    dn[3:8, 4:9] = value
    return [*frames[:3], replace(frames[3], dn=dn), *frames[4:]]


def with_a_visitor() -> list[Frame]:
    return visited([world.frame(200 + k, 1e-4 * 2.0**k) for k in range(6)], 2600)


def grainy() -> SensorNoise:
    """Return the noise of a photograph: little light in a step of a code, and half a code of grain behind the curve."""
    return SensorNoise(4.0, 5.0, full_well_e=3000.0, post_curve_dn2=0.3)


def gone(number: int) -> list[NDArray[np.bool_]]:
    """Return where each of eight frames shows nothing: columns that grow from frame to frame."""
    columns = np.indices(world.SIZE)[1]
    return [columns < k * number for k in range(8)]


SITUATIONS = {
    "plain": lambda: of(world.bracket(), aged()),
    "streamed": lambda: merge(iter([*darks(), *world.bracket()]), world.CAMERA, world.LENS, aged()),
    "relative": lambda: of(world.bracket(), None),
    "with_darks": lambda: of([*darks(), *world.bracket()], aged()),
    "two_stops": lambda: of([*world.bracket(), *world.bracket(f_number=8.0)], aged()),
    "gain": lambda: of(at_gains(), aged()),
    "all_found": lambda: of(world.bracket(gain_db=9.0), aged(found=world.found())),
    "warm": lambda: of(world.bracket(temperature_c=48.0), aged(found=world.found())),
    "flat_field": lambda: of(world.bracket(), aged(flat_field=world.flat_field())),
    "cos4": lambda: of(world.bracket(), aged(), lens=world.LENS.model_copy(update={"vignetting": "cos4"})),
    "defects": lambda: of(world.bracket(), aged(defects=((9, 6), (10, 6), (9, 7), (0, 0), (29, 23)))),
    "visitor_left": lambda: of(with_a_visitor(), aged()),
    "visitor_taken_out": lambda: of(with_a_visitor(), aged(), without_ghosts=True),
    "displaced": lambda: of(world.bracket(), aged(), displacement_px=0.3),
    "displaced_curve": lambda: of(world.bracket(bits=8), eight_bits(), displacement_px=0.2),
    "absent": lambda: of(world.bracket(), aged(), absent=gone(2)),
    "curve": lambda: of(world.bracket(bits=8), eight_bits()),
    "curve_with_grain": lambda: of(
        [*world.bracket(bits=8), *world.bracket(bits=8, gain_db=6.0)[:5]],
        eight_bits(noise=grainy()),
        displacement_px=0.1,
    ),
    "curve_with_a_visitor": lambda: of(
        visited(world.bracket(bits=8), 180), eight_bits(noise=grainy()), without_ghosts=True
    ),
    "curve_with_a_visitor_left": lambda: of(visited(world.bracket(bits=8), 180), eight_bits(noise=grainy())),
    "curve_with_one_in_the_short": lambda: of(
        visited([world.frame(k, 3e-5 * 3.0**k, bits=8) for k in range(5, -1, -1)], 245), eight_bits()
    ),
    "curve_of_darkness": lambda: of(
        [world.frame(300 + k, 2e-6 * 2.0**k, bits=8) for k in range(4)], eight_bits(), displacement_px=0.4
    ),
    "unsteady_curve": lambda: of(
        [
            world.frame(310 + k, 1e-4 * 2.0 ** (k // 2), bits=8, radiance=world.scene() * (1 + 0.15 * (k % 2)))
            for k in range(6)
        ],
        eight_bits(),
        displacement_px=0.5,
    ),
    "displaced_visitor": lambda: of(with_a_visitor(), aged(), without_ghosts=True, displacement_px=0.6),
    "curve_two_frames": lambda: of(world.bracket(bits=8)[3:5], eight_bits()),
    "long_only": lambda: of(world.bracket()[5:], aged()),
    "short_only": lambda: of(world.bracket()[:2], aged()),
    "one_frame": lambda: of(world.bracket()[3:4], aged()),
    "nine_frames": lambda: of([world.frame(110 + k, 2e-5 * 2.0**k) for k in range(9)], aged()),
    "unsteady": lambda: of(unsteady(), aged()),
    "doubts": lambda: of(world.bracket(), aged(uncertainties=DOUBTS)),
    "response": lambda: of(world.bracket(), aged(spectral_response=world.bell(540.0, 60.0))),
}


@pytest.mark.parametrize("name", SITUATIONS)
def test_a_map_is_as_it_was(name):
    """Radiance, u and mask of every pixel."""
    assert not moved(f"maps/{name}", figures(SITUATIONS[name]()), rel=1e-5)


def test_the_plain_map_is_the_chart():
    """What is held is worth holding: nine pixels in ten lie within three u of the radiances they were made from."""
    found = SITUATIONS["plain"]()
    uneven = 0.01 * found.radiance  # the pattern is no part of u
    z = (found.radiance - world.scene()) / np.hypot(found.u_radiance, uneven)
    assert np.mean(np.abs(z[found.mask == 0]) < 3.0) > 0.9


WAVES = np.random.default_rng(41)
LENGTH, ANGLE, PHASE = (
    WAVES.uniform(7.0, 40.0, 40),
    WAVES.uniform(0.0, 2 * math.pi, 40),
    WAVES.uniform(0, 2 * math.pi, 40),
)


def photograph(seconds: float, degrees: float, x: float, y: float, number: int, size: tuple[int, int]) -> Frame:
    """Return a textured scene seen from a place that is turned and shifted."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    u, v = columns - size[1] / 2 - x, rows - size[0] / 2 - y
    u, v = c * u + s * v, c * v - s * u
    waves = np.sin(
        2 * math.pi / LENGTH[:, None, None] * (np.cos(ANGLE)[:, None, None] * u + np.sin(ANGLE)[:, None, None] * v)
        + PHASE[:, None, None]
    )
    light = np.exp(0.3 * waves.sum(0)) * seconds * 25.0
    dn = 255.0 * (light / 1500.0) ** 0.45 + np.random.default_rng(number).normal(0.0, 0.5, light.shape)
    return Frame(np.clip(np.rint(dn), 0, 255).astype(np.uint8), 8, FrameSettings(seconds))


@pytest.mark.parametrize("size", [(96, 128), (150, 110)])
def test_an_alignment_is_as_it_was(size):
    """Movements, what is left of the frames, and where a moved frame shows nothing."""
    places = [(0.4, 2.3, -1.2), (0.0, 0.0, 0.0), (-0.3, -1.6, 3.4), (0.0, 0.1, 0.0)]
    frames = [photograph(2.0**k, *place, k, size) for k, place in enumerate(places)]
    frames.append(Frame(np.full(size, 255, np.uint8), 8, FrameSettings(64.0)))
    bracket = Bracket.from_frames(frames)
    alignment = find_alignment(bracket)
    brought, absent = aligned(bracket, alignment)
    told = {
        "reference": alignment.reference,
        "largest_px": alignment.largest_px,
        "needed": alignment.needed,
        "rotation_deg": [one.rotation_deg for one in alignment.movements],
        "places": [one.to_frame.tolist() for one in alignment.movements],
        "known": [one.known for one in alignment.movements],
        "words": alignment.sentence(["a", "b", "c", "d", "e"]),
        "dn": [digest(one.dn) for one in brought.light],
        "absent": [digest(one) for one in absent],
        "trimmed": list(alignment.trimmed(brought).shape),
    }
    assert not moved(f"maps/alignment_{size[0]}", told, rel=2e-3)
