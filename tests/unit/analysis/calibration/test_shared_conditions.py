"""What a calibration and a reading must share: every state of every quantity is handled as the table says."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.calibration.calibrate import MeterReading, MeterSettings, scale_by_meter
from radiometer.analysis.calibration.shared import TABLE, Handling, State, require_flat_field
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    ResponseCurve,
    Scale,
    ScaleConditions,
    SensorNoise,
    SpectralResponse,
)
from radiometer.data.setup import AS_CALIBRATED, Setup
from radiometer.errors import RadiometerError
from radiometer.photographs.scene import Photographs, prepared

CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10_500)
# Two values of every quantity that may differ; a reading of either is of the same light.
VALUES = {
    "model": ("A", "B"),
    "serial": ("1", "2"),
    "bit depth": (12, 10),
    "pixel pitch": (4.5, 9.0),
    "mosaic": ("RGGB", "BGGR"),
    "mode": ("GAIN 0", "GAIN 300"),
    "filter": ("V", "R"),
    "band": ("Red", "Green"),
    "binning": ("1", "2"),
    "white_balance": ("set to daylight", "set to shade"),
    "conversion gain": (2.6, 1.3),
    "focal length": (16.0, 25.0),
    "f-number": (4.0, 5.6),
    "ISO speed": (100.0, 200.0),
    "gain": (0.0, 6.0),
    "channel": ("green", "red"),
    "spectrum": ("equal_energy", "cie_a"),
    "temperature": (25.0, 40.0),
    "response support": (128.0, 2.0),
    "focus of a flat field": (0.0, 1.0),
    "place of a flat field": ((10.0, 20.0), (12.0, 20.0)),
}
STATES = [(name, state) for name, rules in TABLE.items() for state in rules]


def test_every_quantity_of_the_table_is_tried():
    """A new line of the table needs its two values here."""
    assert set(VALUES) == set(TABLE)


# What a camera's description states, by its name in the table.
MARKS = {name: name for name in ("model", "serial", "mosaic", *CameraDescription.SETTINGS)} | {
    "pixel pitch": "pixel_pitch_um",
    "conversion gain": "conversion_gain_e_per_dn",
}


def calibration(quantity: str, there: object) -> Calibration:
    """Return a calibration by which 2000 DN above black, at f/4, 1 ms, 0 dB, ISO 100, are 1 W·sr⁻¹·m⁻²."""
    stated = {quantity: there}
    camera = CAMERA.model_copy(update={MARKS[k]: stated[k] for k in MARKS if k in stated})
    conditions = ScaleConditions(
        inverse_exposure_per_s=1000.0,
        level=0.5,
        temperature_c=stated.get("temperature", 25.0),
        channel=stated.get("channel", "green"),
    )
    f_number = stated.get("f-number", 4.0)
    scale = Scale(
        value=math.pi / 64.0 * 1e-3 / 2000.0,
        u_rel=0.01,
        method="known_radiance",
        f_number=f_number,
        iso=stated.get("ISO speed", 100.0),
        spectrum="equal_energy",
        conditions=conditions,
    )
    wavelength = tuple(float(nm) for nm in range(380, 781, 10))
    silicon = SpectralResponse(wavelength_nm=wavelength, relative=wavelength)
    lens = LensDescription(focal_length_mm=stated.get("focal length"))
    black = BlackLevel(dn=64.0)
    noise = SensorNoise.of(CAMERA)
    return Calibration(camera, lens, scale, None, noise, black, spectral_response=silicon)


def reading(quantity: str, there: object, here: object) -> tuple[float, dict[str, float]]:
    """Return a reading of 1 W·sr⁻¹·m⁻², and the relative uncertainties of its budget."""
    stated = {quantity: here}
    known = calibration(quantity, there)
    camera = CAMERA.model_copy(update={MARKS[k]: stated[k] for k in MARKS if k in stated})
    depth = int(stated.get("bit depth", 12))
    camera = camera.model_copy(update={"bit_depth": depth})
    f_number, gain_db = stated.get("f-number", 4.0), stated.get("gain", 0.0)
    iso, spectrum = stated.get("ISO speed", 100.0), stated.get("spectrum", "equal_energy")
    level = 2000.0 * (4.0 / (f_number or 4.0)) ** 2 * 10 ** (gain_db / 20.0) * (iso or 100.0) / 100.0
    settings = FrameSettings(1e-3, gain_db, f_number, 64.0, stated.get("temperature", 25.0), iso=iso)
    rng = np.random.default_rng(5)
    top = (1 << depth) - 1
    frames = [
        Frame(
            np.clip(np.rint(rng.normal(64.0 + 0.5 * level, 3.0, (40, 40))), 0, top).astype(np.uint16),
            depth,
            replace(settings, exposure_s=5e-4),
            extra={"channel": stated.get("channel", "green")} if stated.get("channel", "green") else {},
        )
        for _ in range(5)
    ]
    taken = Photographs({"green": Bracket.from_frames(frames)}, Path("here"))
    if quantity in ("ISO speed", "channel"):
        taken = prepared(taken, calibration=known, align="off")
    if spectrum is not None:
        known = replace(known, spectrum=spectrum)
    lens = LensDescription(focal_length_mm=stated.get("focal length"))
    found = read_patch(
        taken.only,
        Patch(0, 0, 40, 40),
        Setup(camera, lens, known, spectrum=AS_CALIBRATED if spectrum is not None else None),
    )
    return found.radiance.value, {line.name: line.u_rel for line in found.budget}


def sides(quantity: str, state: State) -> tuple[object, object]:
    """Return what the calibration and what the reading state."""
    one, other = VALUES[quantity]
    return {
        State.EQUAL: (one, one),
        State.DIFFERENT: (one, other),
        State.READING_SILENT: (one, None),
        State.CALIBRATION_SILENT: (None, one),
        State.BOTH_SILENT: (None, None),
    }[state]


def of_response_support(here: float) -> float:
    """Return the scale of a meter reading at a pixel value, by a curve with data from 4 to 252 DN."""
    g = np.log(np.maximum(np.arange(256.0), 0.25) / 128.0)
    curve = ResponseCurve(g, np.full(256, 1e-3), valid_dn=(4, 252))
    camera = CameraDescription(bit_depth=8)
    base = replace(calibration("", None), camera=camera, response=curve, black_level=BlackLevel(dn=0.0))
    return scale_by_meter(base, MeterReading(12.5, MeterSettings(1 / 128, 8.0, 100.0), here)).value


def accepted(quantity: str, there: object, here: object) -> bool:
    """Return that a scale by a meter, or a flat field, was taken where the calibration differs from it."""
    if quantity == "response support":
        return of_response_support(here) > 0.0
    key = "magnification" if quantity.startswith("focus") else "principal_point_px"
    lenses = [LensDescription(**{key: value}) for value in (there, here)]
    require_flat_field(replace(calibration("", None), lens=lenses[0]), CAMERA, lenses[1])
    return True


@pytest.mark.parametrize(("quantity", "state"), STATES)
def test_every_state_is_handled_as_the_table_says(quantity, state):
    """Kept: right as it is. Corrected: right, with a doubt in the budget. Widened: with a doubt. Refused: an error."""
    rule, (there, here) = TABLE[quantity][state], sides(quantity, state)
    of_itself = quantity == "response support" or quantity.endswith("flat field")
    if rule.handling is Handling.REFUSED:
        with pytest.raises(RadiometerError) as refusal:
            accepted(quantity, there, here) if of_itself else reading(quantity, there, here)
        assert refusal.type is rule.error
        return
    if of_itself:
        assert accepted(quantity, there, here)
        return
    value, budget = reading(quantity, there, here)
    _, same = reading(quantity, *sides(quantity, State.EQUAL))
    if quantity != "spectrum" or state is State.EQUAL:
        assert value == pytest.approx(1.0, rel=2e-3)
    if rule.term:
        assert budget[rule.term] > same[rule.term] + 1e-4
    else:
        dark = "dark and black level"  # of a camera without an ISO speed an unstated dark current may be larger
        assert budget.pop(dark) >= same.pop(dark) * 0.95
        assert budget == pytest.approx(same, rel=0.05, abs=1e-4)
