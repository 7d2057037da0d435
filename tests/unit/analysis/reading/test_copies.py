"""A frame that was copied counts once: in a patch, in a map, in memory or as it arrives, by whatever name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

import radiometer as rm
from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import Bracket, CameraDescription, Frame, FrameSettings, Patch
from radiometer.data.setup import Setup

CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.0, read_noise_e=4.0, black_level_dn=64.0)
WHERE = Patch(4, 4, 16, 16)


def exposure(seed: int, level_dn: float = 800.0, shutter: str = "open") -> Frame:
    """Return a frame with noise of its own."""
    dn = np.random.default_rng(seed).normal(64.0 + level_dn, np.sqrt(4.0 + level_dn / 2.0), (40, 40))
    settings = FrameSettings(0.01, black_level_dn=64.0, shutter=shutter)  # type: ignore[arg-type]
    return Frame(np.clip(np.round(dn), 0, 4095).astype(np.uint16), 12, settings)


def u_of(frames: list[Frame]) -> list[float]:
    """Return the standard uncertainties of one patch and of a pixel of maps."""
    bracket = Bracket.from_frames(frames)
    maps = merge(bracket, Setup(CAMERA)), merge(iter(frames), Setup(CAMERA))
    return [read_patch(frames, WHERE, Setup(CAMERA)).radiance.u, *(float(np.median(one.u_radiance)) for one in maps)]


@pytest.mark.parametrize("copies", [1, 2, 5])
def test_copies_of_light_and_dark_frames_change_nothing(copies: int) -> None:
    """Frames that differ in their noise lower u of a pixel; copies of them lower none."""
    dark, light = [exposure(n, 0.0, "closed") for n in range(2)], [exposure(10 + n) for n in range(2)]
    once = u_of([*dark, *light])
    assert u_of([*dark * (copies + 1), *light * (copies + 1)]) == pytest.approx(once, rel=1e-12)
    more = [exposure(20 + n) for n in range(2 * copies)]
    assert np.all(np.array(u_of([*dark, *light, *more]))[1:] < np.array(once)[1:])
    found = read_patch([*dark, *light, light[0]], WHERE, Setup(CAMERA))
    assert found.provenance is not None
    assert "1 frame is a copy of another to the last pixel: no exposure counts twice" in found.provenance.assumptions


def test_copied_files_of_a_folder_count_once(tmp_path: Path) -> None:
    """By other names and other times of writing."""
    header = fits.Header({"EXPTIME": 0.01, "INSTRUME": "A", "BITPIX": 16})
    for folder, seeds in (("three", (1, 2, 3)), ("copied", (1, 2, 3, 1, 2, 2))):
        (tmp_path / folder).mkdir()
        for n, seed in enumerate(seeds):
            fits.PrimaryHDU(exposure(seed).dn, header).writeto(tmp_path / folder / f"{n}.fits")
    three, copied = (rm.merge(tmp_path / folder).map for folder in ("three", "copied"))
    assert np.array_equal(three.u_radiance, copied.u_radiance)
    assert np.allclose(three.radiance, copied.radiance, rtol=1e-6)
