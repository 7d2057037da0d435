"""Readings of patches in many situations: every figure of value, budget, flags and luminance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.reading.reading import read_patch
from radiometer.analysis.uncertainty.budget import covariance, difference, mean, ratio, shares
from radiometer.data import BlackLevel, Bracket, Calibration, Frame, Patch, Reading, SourceDescription
from tests.unit.held import world
from tests.unit.held.figures import moved

MIDDLE = Patch(11, 13, 8, 9)  # 120 W·sr⁻¹·m⁻²


def figures(reading: Reading) -> dict[str, Any]:
    """Return the numbers, flags and words of a reading."""
    budget = {
        one.name: [one.u_rel, one.kind, one.degrees_of_freedom, one.correlated, one.note] for one in reading.budget
    }
    provenance = reading.provenance
    assumed = {"parameters": provenance.parameters, "assumptions": list(provenance.assumptions)}
    return reading.to_mapping() | {"budget": budget} | assumed


def read(frames: list[Frame], calibration: Calibration | None, patch: Patch = MIDDLE, **options: Any) -> Reading:
    lens = options.pop("lens", world.LENS)
    return read_patch(Bracket.from_frames(frames), patch, calibration, world.CAMERA, lens, now=world.NOW, **options)


def darks() -> list[Frame]:
    return [world.frame(50 + k, t, shutter="closed") for k, t in enumerate((1e-4, 1e-2, 0.16, 0.16))]


def at_gain(gain_db: float, first: int = 20) -> list[Frame]:
    return [world.frame(first + k, 1e-5 * 4.0**k, gain_db=gain_db) for k in range(6)]


def repeats() -> list[Frame]:
    return [world.frame(60 + k, 1.6e-4, radiance=world.scene() * (1 + 0.01 * (k % 3))) for k in range(6)]


def unlit() -> list[Frame]:
    """Return frames whose black level is stated 2 DN too high: their estimate lies below 0."""
    return [
        world.frame(80 + k, t, radiance=0.0 * world.scene(), black_level_dn=66.0) for k, t in enumerate((1e-4, 1e-3))
    ]


def stopped_down() -> list[Frame]:
    return [world.frame(30 + k, 4e-5 * 4.0**k, f_number=8.0) for k in range(6)]


def changed_lens(**changes: Any) -> Any:
    return world.LENS.model_copy(update=changes)


SITUATIONS = {
    "plain": lambda: read(world.bracket(), world.calibration()),
    "relative": lambda: read(world.bracket(), None),
    "relative_stops": lambda: read([*world.bracket(), *stopped_down()], None),
    "with_darks": lambda: read([*world.bracket(), *darks()], world.calibration()),
    "darkest_field": lambda: read(world.bracket(), world.calibration(), Patch(1, 1, 7, 9)),
    "brightest_field": lambda: read(world.bracket(), world.calibration(), Patch(21, 13, 8, 9)),
    "no_light": lambda: read(unlit(), world.calibration()),
    "unlit_small_patch": lambda: read(unlit(), world.calibration(flat_field=world.flat_field()), Patch(3, 3, 2, 3)),
    "small_patch": lambda: read(world.bracket(), world.calibration(), Patch(12, 14, 3, 3)),
    "over_an_edge": lambda: read(world.bracket(), world.calibration(), Patch(6, 8, 9, 8)),
    "clipped": lambda: read(world.bracket()[6:], world.calibration(), Patch(21, 13, 8, 9)),
    "one_frame": lambda: read(world.bracket()[2:3], world.calibration()),
    "repeats": lambda: read(repeats(), world.calibration()),
    "high_gain": lambda: read(at_gain(18.0), world.calibration()),
    "two_gains": lambda: read([*world.bracket(), *at_gain(6.0)], world.calibration()),
    "stopped_down": lambda: read(stopped_down(), world.calibration()),
    "cold": lambda: read(world.bracket(temperature_c=5.0), world.calibration()),
    "no_temperature": lambda: read(world.bracket(temperature_c=None), world.calibration()),
    "all_found": lambda: read([*world.bracket(), *at_gain(12.0)], world.calibration(found=world.found())),
    "flat_field": lambda: read(world.bracket(), world.calibration(flat_field=world.flat_field()), Patch(21, 13, 8, 9)),
    "flat_field_of_another_stop": lambda: read(stopped_down(), world.calibration(flat_field=world.flat_field())),
    "cos4": lambda: read(world.bracket(), world.calibration(), lens=changed_lens(vignetting="cos4")),
    "close_up": lambda: read(
        world.bracket(),
        world.calibration(uncertainties=world.doubts(magnification_u_rel=0.2)),
        lens=changed_lens(magnification=0.3, pupil_magnification=1.2),
    ),
    "handled_lens": lambda: read(
        world.bracket(),
        world.calibration(),
        lens=changed_lens(since_calibration=("reseated", "refocused", "iris_reset")),
    ),
    "darker_lens": lambda: read(world.bracket(), world.calibration(), lens=changed_lens(transmittance=0.8)),
    "screen": lambda: read(world.bracket(), world.calibration(), source=SourceDescription(kind="screen")),
    "flickering_led": lambda: read(
        world.bracket(),
        world.calibration(),
        source=SourceDescription(kind="led", wavelength_nm=627.0, flicker_hz=240.0, reproducibility_u_rel=0.01),
    ),
    "old": lambda: read(world.bracket(), world.calibration(created="2023-01-01T00:00:00Z")),
    "defects": lambda: read(world.bracket(), world.calibration(defects=((12, 14), (13, 15), (2, 2)))),
    "unstated_light": lambda: read(world.bracket(), world.calibration(), spectrum_stated=False),
    "unstated_light_and_response": lambda: read(
        world.bracket(), world.calibration(spectral_response=world.bell(560.0, 90.0)), spectrum_stated=False
    ),
    "luminance_of_another_light": lambda: read(world.bracket(), world.calibration(), spectrum="line:627"),
    "of_a_luminance": lambda: read(
        world.bracket(),
        world.calibration(
            scale=world.calibration().scale.model_copy(update={"quantity": "luminance", "method": "light_meter_k"}),
            uncertainties=world.doubts(efficacy_u_rel=0.05, spectral_u_rel=0.1),
        ),
    ),
    "all_doubts": lambda: read(
        world.bracket(),
        world.calibration(
            uncertainties=world.doubts(
                exposure_u_rel=2e-3,
                exposure_u_s=1e-5,
                f_number_u_rel=0.03,
                linearity_u_rel=0.004,
                bend_u_rel=0.006,
                temperature_u_rel_per_k=2e-3,
                drift_u_rel_per_year=0.03,
                glare_u=0.01,
                prnu_u_rel=0.02,
                falloff_u_rel=0.4,
            )
        ),
    ),
}


def eight_bits(**changes: Any) -> Calibration:
    camera = world.CAMERA.model_copy(update={"bit_depth": 8, "black_level_dn": None, "conversion_gain_e_per_dn": None})
    scale = world.calibration().scale.model_copy(update={"value": 3e-5})
    return world.calibration(
        camera=camera, response=world.gamma_curve(), scale=scale, black_level=BlackLevel(), **changes
    )


@pytest.mark.parametrize("name", SITUATIONS)
def test_a_reading_is_as_it_was(name):
    """Value, u, coverage, budget, flags and luminance of one situation."""
    assert not moved(f"readings/{name}", figures(SITUATIONS[name]()), rel=1e-7)


@pytest.mark.parametrize("exposures", [slice(0, 8), slice(2, 4)])
def test_a_reading_behind_a_curve_is_as_it_was(exposures):
    """Eight bits with a response curve: what is extrapolated, and what the curve's own doubt does."""
    calibration = eight_bits()
    frames = world.bracket(bits=8)[exposures]
    read_by = read_patch(
        Bracket.from_frames(frames), MIDDLE, calibration, calibration.camera, world.LENS, now=world.NOW
    )
    assert not moved(f"readings/curve_{exposures.start}", figures(read_by), rel=1e-7)


def test_what_two_readings_share_is_as_it_was():
    """Covariance, ratio, difference and mean of readings by one calibration, and shares of a budget."""
    one, two = SITUATIONS["plain"](), SITUATIONS["brightest_field"]()
    three = SITUATIONS["stopped_down"]()
    told = {
        "covariance": [covariance(one, two), covariance(one, three), covariance(three, three)],
        "ratio": ratio(one, two).to_mapping(),
        "difference": difference(two, three).to_mapping(),
        "mean": mean([one, two, three]).to_mapping(),
        "shares": [[line.name, share] for line, share in shares(two.budget)],
    }
    assert not moved("readings/two", told, rel=1e-7)


def test_a_reading_of_drifting_frames_is_as_it_was():
    """Temperature, source and time differ from frame to frame."""
    frames = [
        world.frame(
            70 + k, 1e-4 * 2.0 ** (k % 4), temperature_c=20.0 + 3 * k, radiance=world.scene() * (1.0 - 0.01 * k)
        )
        for k in range(8)
    ]
    reading = read([replace(f) for f in frames], world.calibration(found=world.found()))
    assert not moved("readings/drifting", figures(reading), rel=1e-7)
    assert np.isfinite(reading.radiance.u)
