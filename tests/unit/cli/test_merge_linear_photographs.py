"""Linear photographs merged as they are: the values of a raw file, and 16-bit pictures that are stated as linear."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from radiometer.analysis.merge.bracket import merge
from radiometer.cli.main import run
from radiometer.data import Bracket, CameraDescription, Frame, FrameSettings, LensDescription
from radiometer.data.setup import Setup
from radiometer.photographs.response import in_their_own_depth, relative_calibration
from testing.edge_devices import dng_bytes
from testing.photograph_folder import eight_bits, write_photographs

BLACK, WHITE, ELECTRONS_PER_DN = 64, 4095, 2.5
TIMES = (1.0, 2.0, 4.0, 8.0, 16.0)


def _mosaic(rng, radiance, seconds, white=WHITE):
    electrons = rng.poisson(radiance * seconds * 120.0 * ELECTRONS_PER_DN)
    return np.clip(np.round(electrons / ELECTRONS_PER_DN + BLACK), 0, white).astype(np.uint16)


def _scene(rng):
    return np.exp(rng.uniform(-4.0, 2.5, (60, 80)))


def _z(picture, truth, plane=...):
    """Return by how many of its u a map is off the truth, up to one factor."""
    value, u = (tifffile.imread(picture, key=key)[plane].astype(float) for key in (0, 1))
    assert value.shape == truth.shape
    return (value / truth / np.median(value / truth) - 1.0) / (u / value)


def _waves(folder, shifts, level=2000.0):
    """Write linear photographs of waves along the rows, each displaced by so many pixels."""
    rng, column, times = np.random.default_rng(8), np.arange(96.0), TIMES[: len(shifts)]
    lights = (np.exp(0.5 * np.sin(2.0 * np.pi * (column + shift) / 12.0)) for shift in shifts)
    pictures = (
        np.clip(rng.poisson(np.broadcast_to(level * seconds * light, (72, 96))), 0, 65535).astype(np.uint16)
        for seconds, light in zip(times, lights, strict=True)
    )
    return write_photographs(folder, pictures, times)


def _reported(folder: Path, target: Path, capsys, *words):
    assert run(["merge", "--force", str(folder), "--linear", "--align", "off", "-o", str(target), *words]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("shift", [0.2, 0.0])
def test_how_far_frames_lie_apart_is_reported_with_its_uncertainty(tmp_path, capsys, shift):
    """Frames in turn 0.2 pixels to either side along the waves are reported as displaced by 0.2 within 2 u.

    Where none shows, the report says from how many pixels on it would have.
    """
    folder, target = _waves(tmp_path / "apart", (shift, -shift, shift, -shift)), tmp_path / "map.exr"
    result = json.loads(_reported(folder, target, capsys, "--json"))
    px, u_px = result["displacement_px"], result["displacement_u_px"]
    assert abs(px - shift) < 2.0 * u_px
    assert 0.01 * (shift > 0) < u_px < 0.1
    assert shift or px == 0.0
    sentence = f"displaced by {px:.3f} ± {u_px:.3f} pixels" if shift else f"one below about {u_px:.1g} pixels"
    assert sentence in _reported(folder, target, capsys)


def test_frames_that_cannot_tell_a_displacement_are_assumed_to_have_none(tmp_path, capsys):
    """Two frames of which the second clips everywhere share no pixel: that they lie in one place is an assumption."""
    folder, target = _waves(tmp_path / "apart", (0.0, 0.0), level=60_000.0), tmp_path / "map.exr"
    result = json.loads(_reported(folder, target, capsys, "--json"))
    assert result["displacement_px"] is None
    assert any("frames are assumed to be aligned" in text for text in result["assumptions"])
    assert "assumed    frames are assumed to be aligned" in _reported(folder, target, capsys)


def test_raw_files_need_no_response(tmp_path, capsys):
    """Each colour of a DNG bracket is merged in proportion to light, its noise found from the frames themselves."""
    pytest.importorskip("rawpy")
    rng = np.random.default_rng(1)
    radiance = np.kron(_scene(rng), np.ones((2, 2)))
    tint = np.tile([[0.5, 1.0], [1.0, 0.7]], (60, 80))  # of red, the greens, and blue
    files = (dng_bytes(_mosaic(rng, radiance * tint, seconds), BLACK) for seconds in TIMES)
    folder = write_photographs(tmp_path / "raw", files, TIMES, ".dng")
    assert run(["merge", "--force", str(folder), "-o", str(tmp_path / "map.tiff")]) == 0
    capsys.readouterr()
    assert not list(tmp_path.glob("*response*"))
    assert tifffile.imread(tmp_path / "map.tiff", key=0).shape == (60, 80, 3)
    truth = np.dstack([part * radiance[::2, ::2] for part in (0.5, 1.0, 0.7)])
    for plane in range(3):
        z = _z(tmp_path / "map.tiff", truth[..., plane], np.s_[..., plane])
        assert np.sqrt(np.mean(z[radiance[::2, ::2] > 1.0] ** 2)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("ending", [".tif", ".png"])
def test_sixteen_bit_pictures_are_linear_where_that_is_stated(tmp_path, capsys, ending):
    """With --linear no response is recovered; two programs' files of 16 bits are taken as they stand."""
    rng = np.random.default_rng(2)
    radiance = _scene(rng)
    pictures = (np.clip(rng.poisson(radiance * s * 300.0) * 4, 0, 65535).astype(np.uint16) for s in TIMES)
    folder = write_photographs(tmp_path / "p", pictures, TIMES, ending)
    assert run(["merge", "--force", str(folder), "--linear", "-o", str(tmp_path / "map.tiff")]) == 0
    assert "response" not in capsys.readouterr().out
    z = _z(tmp_path / "map.tiff", radiance)[radiance > np.median(radiance)]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("gamma", "grows"), [(1.0, None), (2.2, "1.37")])
def test_photographs_that_are_not_linear_are_reported(tmp_path, capsys, gamma, grows):
    """Behind a gamma of 1/2.2 twice the exposure makes numbers 2^(1/2.2) as large: stated next to map and in it."""
    rng = np.random.default_rng(6)
    radiance = _scene(rng)
    bent = (255.0 * np.clip(radiance * seconds / 60.0, 0.0, 1.0) ** (1.0 / gamma) for seconds in TIMES)
    pictures = (eight_bits(dn + rng.normal(0.0, 0.3, radiance.shape)) for dn in bent)
    folder = write_photographs(tmp_path / "p", pictures, TIMES)
    assert run(["merge", "--force", str(folder), "--linear", "-o", str(tmp_path / "map.exr"), "--json"]) == 0
    printed = capsys.readouterr()
    doubts = [text for text in json.loads(printed.out)["assumptions"] if "--linear was given" in text]
    assert [f"numbers {grows} times" in text for text in doubts] == ([] if grows is None else [True])
    assert ("mono: --linear was given" in printed.err) == (grows is not None)
    assert run(["measure", "--photographs", str(folder), "--linear", "--uncalibrated", "--patch", "2,2,20,20"]) == 0
    assert ("--linear was given" in capsys.readouterr().err) == (grows is not None)


@pytest.mark.slow
def test_jpeg_files_that_cannot_tell_are_reported(tmp_path, capsys):
    """Of two JPEG files without a pixel in common no growth is known: that JPEG is not linear is still stated."""
    folder, rng = tmp_path / "p", np.random.default_rng(7)
    folder.mkdir()
    cv2.imwrite(str(folder / "a.jpg"), rng.normal(120.0, 9.0, (48, 64)).astype(np.uint8))
    cv2.imwrite(str(folder / "b.jpg"), np.full((48, 64), 255, np.uint8))
    (folder / "exposures.txt").write_text("a.jpg 1\nb.jpg 64\n")
    assert run(["merge", "--force", str(folder), "--linear", "-o", str(tmp_path / "map.exr")]) == 0
    assert "cameras write JPEG through a curve" in capsys.readouterr().err


def test_an_amplified_photograph_clips_where_the_others_do():
    """12 bits in files of 16, one of them at four times the ISO speed: all of it clips at 4095, and nothing moved."""
    rng = np.random.default_rng(31)
    light, electrons_per_dn = rng.uniform(500.0, 900.0, (60, 80)), 2.0
    frames = []
    for seconds, gain in ((0.25, 1.0), (1.0, 1.0), (4.0, 1.0), (4.0, 4.0)):
        dn = gain * rng.poisson(light * seconds * electrons_per_dn) / electrons_per_dn + rng.normal(0.0, 1.5, (60, 80))
        settings = FrameSettings(seconds, gain_db=20.0 * math.log10(gain))
        frames.append(Frame(np.clip(np.rint(dn), 0, WHITE).astype(np.uint16), 16, settings))
    (bracket,) = in_their_own_depth([Bracket.from_frames(frames)])
    camera, lens = CameraDescription(bit_depth=bracket.bit_depth), LensDescription()
    found = merge(
        bracket, Setup(camera, lens, relative_calibration(bracket, None, camera, lens)[0]), without_ghosts=True
    )
    assert not found.mask.any()
    z = (found.radiance / light / np.median(found.radiance / light) - 1.0) / (found.u_radiance / found.radiance)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("end", "highest", "depth"), [(4095, 4095, 12), (511, 511, 9), (255, 255, 16), (4000, 4000, 16), (4095, 9000, 16)]
)
def test_photographs_have_the_bits_that_their_numbers_have(end, highest, depth):
    """12 where they gather at 4095 and none is above; where they end at another number they stay as they are."""
    light = np.arange(100, 6100, dtype=np.uint16).reshape(60, 100)
    shown = [np.minimum(light // k, end) for k in (1, 2, 4)]
    shown[0][0, 0] = highest
    several = Bracket.from_frames(
        [Frame(dn, 16, FrameSettings(1.0 / k)) for k, dn in zip((1, 2, 4), shown, strict=True)]
    )
    assert in_their_own_depth([several])[0].bit_depth == depth
