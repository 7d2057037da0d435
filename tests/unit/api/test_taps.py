"""Sensors with several output amplifiers in merge, readings and calibrations."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.data import CameraDescription, CaptureSetWriter, Frame, FrameSettings, LensDescription, TapDescription
from radiometer.data.radiance_map import PixelMask
from radiometer.errors import MeasurementError, UsageError

TIMES_S = (0.05, 0.1, 0.2, 0.4)
E_PER_S, NOISE_E = 20_000.0, 5.0
BLACK_DN = np.array([[300.0, 340.0], [280.0, 320.0]])
GAIN_DN_PER_E = 0.5 * np.array([[1.0, 1.06], [0.95, 1.03]])
# Two taps side by side: 48 columns of light, 8 + 8 of overscan, 48 of light; 32 rows each.
PLACES = [(0, 0), (64, 0), (0, 32), (64, 32)]
OVERSCAN = [(48, 0), (56, 0), (48, 32), (56, 32)]
PATCHES = [(x + 8, y + 4, 24, 24) for x, y in PLACES]


def described(*, overscan=True):
    """Return the taps as a capture set describes them."""
    return tuple(
        TapDescription(
            name=str(n), x=x, y=y, width=48, height=32, overscan=((*over, 8, 32),) if overscan else ()
        )
        for n, ((x, y), over) in enumerate(zip(PLACES, OVERSCAN, strict=True), 1)
    )  # fmt: skip


def frame(rng, time_s, light_e, *, ramp_dn=0.0, dark=False):
    """Return a frame whose black level rises by a ramp along the rows of every tap."""
    x = np.arange(112)
    right, lit = x >= 56, (x < 48) | (x >= 64)
    electrons = rng.poisson(light_e * lit * np.ones((64, 112))) + rng.normal(0.0, NOISE_E, (64, 112))
    rows = np.repeat([0, 1], 32)[:, None]
    black = BLACK_DN[rows, right.astype(int)] + ramp_dn * np.linspace(0.0, 1.0, 64)[:, None]
    dn = np.rint(black + GAIN_DN_PER_E[rows, right.astype(int)] * electrons).astype(np.uint16)
    return Frame(dn, 14, FrameSettings(time_s, shutter="closed" if dark else "open"))


def write(
    folder: Path, taps: Sequence[TapDescription] | None, frames: Sequence[Frame], **facts: float | None
) -> Path:  # fmt: skip
    """Write a capture set of the camera."""
    known = {"conversion_gain_e_per_dn": 2.0, "read_noise_e": NOISE_E, "dark_current_e_per_s": 0.0, **facts}
    camera = CameraDescription(bit_depth=14, serial="4711", taps=tuple(taps) if taps else None, **known)
    with CaptureSetWriter(folder, camera, LensDescription(f_number=4.0)) as writer:
        for one in frames:
            writer.add(one)
    return folder


def bracket(seed, dark_times_s, **ramp):
    """Return pairs of even light of every exposure, and of dark frames."""
    rng = np.random.default_rng(seed)
    darks = [frame(rng, t, 0.0, dark=True, **ramp) for t in dark_times_s for _ in range(2)]
    return darks + [frame(rng, t, E_PER_S * t, **ramp) for t in TIMES_S for _ in range(2)]


def camera_file(tmp_path, *, overscan):
    """Return the camera file of a characterisation of the camera with its taps."""
    flats = write(tmp_path / "flats", described(overscan=overscan), bracket(4701, TIMES_S))
    found = rm.characterise(flats)
    found.write(tmp_path / "camera.yaml")
    return tmp_path / "camera.yaml"


@pytest.mark.parametrize(
    ("overscan", "dark_times_s", "ramp_dn", "says"),
    [(True, (), 25.0, "overscan"), (True, TIMES_S, 25.0, "overscan"), (False, (0.05,), 0.0, "dark frames"),
     (False, TIMES_S, 0.0, "dark frames")],
)  # fmt: skip
def test_every_tap_has_the_radiance_of_the_even_source(tmp_path, overscan, dark_times_s, ramp_dn, says):
    """Taps of other gains and black levels show one radiance within 2 u: in maps, and in readings of patches."""
    known, folder = camera_file(tmp_path, overscan=overscan), tmp_path / "set"
    write(folder, described(overscan=overscan), bracket(4702, dark_times_s, ramp_dn=ramp_dn))
    made = rm.calibrate(folder, patch=PATCHES[0], radiance=1.0, u_rel=1e-3, spectrum="equal_energy", camera_file=known)
    found = rm.merge(folder, calibration=made.calibration)
    assert any(says in text for text in found.assumptions)
    plain = rm.calibrate(folder, patch=PATCHES[0], radiance=1.0, u_rel=1e-3, spectrum="equal_energy")
    assert plain.scale.u_rel < 0.01  # the black levels are known
    assert any("gain per tap" in text for text in found.assumptions)
    gain_u = max(one.conversion_gain_u_rel for one in made.calibration.camera.taps)
    for patch in PATCHES:
        here = rm.Patch(*patch).slices
        assert abs(found.value[here].mean() - 1.0) < 2.0 * np.hypot(found.u_rel_common, np.sqrt(2.0) * gain_u)
        reading = rm.measure_photographs(folder, patch, calibration=made.calibration, spectrum="equal_energy")
        assert abs(reading.radiance.value - 1.0) < 2.0 * reading.radiance.u
        assert (reading.radiance.u > 0.7 * gain_u) == (patch != PATCHES[0])  # of the tap of the scale it drops out
    overscan_of_map = found.mask & PixelMask.UNLIT > 0
    assert overscan_of_map.sum() == 64 * 16
    assert (found.value[overscan_of_map] == 0.0).all()


@pytest.mark.parametrize("how", ["2x2", "find"])
def test_steps_between_taps_are_doubted_until_their_gains_are_known(tmp_path, how):
    """Undescribed taps are reported by their step, described ones without gains by a note and a flag of readings."""
    frames = [one for one in bracket(4703, ()) if not one.settings.is_dark]
    lit = np.r_[0:48, 64:112]
    frames = [Frame(np.ascontiguousarray(one.dn[:, lit]), 14, one.settings) for one in frames]
    folder = write(tmp_path / "set", None, frames, black_level_dn=310.0)
    patches = [(8, 4, 24, 24), (56, 36, 24, 24)]
    unknown = rm.merge(folder)
    assert any("step along column 48" in text for text in unknown.map.not_in_u)
    plain = rm.calibrate(folder, patch=patches[0], radiance=1.0, u_rel=1e-3, spectrum="equal_energy")
    assert any("step along column 48" in text for text in plain.calibration.provenance.assumptions)
    stated = rm.merge(folder, taps=how)
    assert not any("step along" in text for text in stated.assumptions)
    assert any("gain of taps not determined" in text for text in stated.assumptions)
    assert any("black level per tap not determined" in text for text in stated.assumptions)
    made = rm.calibrate(folder, patch=patches[0], radiance=1.0, u_rel=1e-3, spectrum="equal_energy", taps=how)
    own, other = (
        rm.measure_photographs(folder, one, calibration=made.calibration, spectrum="equal_energy") for one in patches
    )
    assert "other_tap" not in own.flags
    assert "other_tap" in other.flags
    assert abs(other.radiance.value - 1.0) < 2.0 * other.radiance.u


def test_only_dark_frames_show_black_levels_of_undescribed_taps(tmp_path):
    """A busy scene hides the border; bars that meet at the middle are a scene."""
    rng = np.random.default_rng(4707)
    light = np.kron(rng.uniform(0.1, 1.0, (8, 14)), np.ones((8, 8))) * E_PER_S * 0.1
    frames = [frame(rng, 0.1, 0.0, dark=True), frame(rng, 0.1, light)]
    folder = write(tmp_path / "set", None, frames, black_level_dn=310.0)
    assert any("dark frames step along" in text for text in rm.merge(folder).assumptions)
    light = np.repeat([1.0, 0.5, 0.7, 0.3], 24)[None, :] * np.ones((64, 1))
    rng = np.random.default_rng(4704)
    shots = [np.rint(300 + rng.poisson(light * E_PER_S * t) * 0.5).astype(np.uint16) for t in TIMES_S]
    frames = [Frame(dn, 14, FrameSettings(t)) for dn, t in zip(shots, TIMES_S, strict=True)]
    folder = write(tmp_path / "bars", None, frames, black_level_dn=300.0)
    assert not any("step along" in text for text in rm.merge(folder).assumptions)


def test_overscan_does_not_bound_the_dark_current(tmp_path):
    """A dark current that nothing states is bounded by the darkest pixels that gather light: u holds it."""
    rng, dark_e_per_s = np.random.default_rng(4705), 15.0
    frames = [frame(rng, t, (100.0 + dark_e_per_s) * t) for t in (8.0, 16.0, 32.0)]
    folder = write(tmp_path / "set", described(), frames, dark_current_e_per_s=None)
    reading = rm.measure_photographs(folder, PATCHES[0], uncalibrated=True)
    true = 100.0 * GAIN_DN_PER_E[0, 0]
    assert true < reading.radiance.value < true + 2.0 * reading.radiance.u
    found = rm.merge(folder)
    here = rm.Patch(*PATCHES[0]).slices
    assert abs(found.value[here].mean() / true - 1.0) < 2.0 * float(np.median(found.u[here])) / true


@pytest.mark.parametrize(("patch", "taps", "says"), [
    ((40, 4, 24, 24), None, "overscan"),
    (PATCHES[0], "5x2", "no such equal parts"),
])  # fmt: skip
def test_patches_in_overscan_and_impossible_taps_are_refused(tmp_path, patch, taps, says):
    """A patch that reaches into overscan is refused with the places that gather light; so are taps that cannot be."""
    folder = write(tmp_path / "set", described(), bracket(4706, ()))
    with pytest.raises((MeasurementError, UsageError), match=says):
        rm.calibrate(folder, patch=patch, radiance=1.0, u_rel=1e-3, taps=taps)


@pytest.mark.parametrize(("full_e", "says"), [(1e9, False), (3000.0, True)])
def test_taps_are_looked_at_singly_for_their_white_level(tmp_path, full_e, says):
    """Even light: other black levels and gains bring the numbers of two taps together as it grows, as a full well does.

    After 20 ms they are 83 DN apart, after 80 ms 33; a well of 3000 e⁻ is full after 150 ms.
    """
    rng, x = np.random.default_rng(4704), np.arange(176)  # the last 16 are overscan of the first tap
    right, frames = (x >= 80) & (x < 160), []
    for time_s in (0.02, 0.08, 0.32):
        electrons = np.minimum(rng.poisson(20_000.0 * time_s * (x < 160), (100, 176)), full_e)
        electrons = (electrons + rng.normal(0.0, NOISE_E, electrons.shape)) / np.where(right, 1.6, 1.5)
        dn = np.rint(np.where(right, 1100.0, 1000.0) + electrons).astype(np.uint16)
        frames.append(Frame(dn, 14, FrameSettings(time_s)))
    taps = [TapDescription(name=name, x=x, y=0, width=80, height=100) for name, x in (("A", 0), ("B", 80))]
    found = rm.merge(write(tmp_path / "set", taps, frames))
    assert any("white level" in text for text in found.assumptions) is says
