"""The noise of single pixels, as a stack's own frames show it, and what the merge makes of it."""

import cv2
import numpy as np
import pytest

from radiometer.analysis.response.displacement import find_displacement
from radiometer.analysis.response.pixel_noise import sensor_noise
from radiometer.cli.main import run
from radiometer.data import Bracket, Frame, FrameSettings, ResponseCurve

POWER, TIMES = 1.0 / 2.2, 2.0 ** np.arange(6)


def _curve():
    g = np.log(np.maximum(np.arange(256), 0.5) / 128.0) / POWER
    return ResponseCurve(g, np.full(256, 1e-3), valid_dn=(5, 250))


def _bracket(rng, *, electrons=None, dn_noise=0.0, read=0.0, shape=(120, 160)):
    """Return frames through M = 255·H^(1/2.2), noise before (electrons at H = 1, read at H = 1) or behind it."""
    radiance = np.exp(rng.uniform(-7.0, 0.0, shape))
    frames = []
    for time in TIMES:
        light = radiance * time / 8.0
        if electrons:
            light = rng.poisson(light * electrons) / electrons
        light = np.clip(light + read * rng.standard_normal(shape), 0, None)
        dn = 255.0 * np.minimum(light, 1.2) ** POWER + dn_noise * rng.standard_normal(shape)
        frames.append(Frame(np.clip(np.round(dn), 0, 255).astype(np.uint8), 8, FrameSettings(float(time))))
    return Bracket.from_frames(frames)


@pytest.mark.slow
@pytest.mark.parametrize(("electrons", "read"), [(500, 0.0), (4000, 0.001)])
def test_noise_before_the_curve_comes_back(electrons, read):
    """The variance of ln H at mid-tones is that of the electrons and the read noise, within 25 %.

    Behind a gamma shot noise is nearly even in digital numbers: what of it is called which may differ.
    """
    found = find_displacement(_bracket(np.random.default_rng(1), electrons=electrons, read=read), _curve()).noise
    for dn in (80.0, 128.0, 200.0):
        exposure = (dn / 255.0) ** (1.0 / POWER)
        expected = (1.0 / (electrons * exposure) if electrons else 0.0) + (read / exposure) ** 2
        slope = 1.0 / (dn * POWER)
        log_h = np.array([np.log(dn / 128.0) / POWER])
        seen = found.variance(log_h, np.array([slope]), np.ones(1))[0]
        assert seen == pytest.approx(expected + slope**2 / 12.0, rel=0.25)


@pytest.mark.parametrize("dn_noise", [1.0, 3.0])
def test_noise_behind_the_curve_comes_back(dn_noise):
    """Its variance in DN² within 15 %, nothing of it taken for electrons' noise."""
    found = find_displacement(_bracket(np.random.default_rng(2), dn_noise=dn_noise), _curve()).noise
    assert found.digital == pytest.approx(dn_noise**2, rel=0.15)
    middle = found.shot + found.read  # variance of ln H at H of the middle value
    slope = 1.0 / (128.0 * POWER)
    assert middle < 0.2 * (dn_noise * slope) ** 2


def test_electrons_of_the_sensor_are_those_of_the_noise():
    """x = exp g has the variance a·x + b: full well and gain are in units of 1/a, read noise √b/a."""
    from radiometer.analysis.response.noise import LogNoise

    curve = _curve()
    noise = sensor_noise(LogNoise(1e-3, 4e-6, 2.0, 0.0), curve, black_dn=10.0)
    top = float(np.exp(curve.log_exposure[250]))
    assert noise.full_well_e == pytest.approx(1000.0 * top)
    assert noise.conversion_gain_e_per_dn == pytest.approx(1000.0 * top / 240.0)
    assert noise.read_noise_e == pytest.approx(2.0)
    assert noise.post_curve_dn2 == 2.0
    assert noise.code_variance_dn2 == pytest.approx(2.0 + 1.0 / 12.0)
    assert not noise.assumed


def _photographs(folder, rng, *, dn_noise=2.0):
    folder.mkdir()
    lines = []
    radiance = np.exp(rng.uniform(-6.0, 0.5, (72, 96)))
    for index, time in enumerate(2.0 ** np.arange(8)):
        planes = [
            255.0 * np.minimum(tint * radiance * time / 16.0, 1.3) ** POWER + dn_noise * rng.standard_normal((72, 96))
            for tint in (0.7, 1.0, 0.5)  # blue, green, red
        ]
        image = np.clip(np.round(np.dstack(planes)), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"p{index}.png"), image)
        lines.append(f"p{index}.png {time:g}")
    (folder / "exposures.txt").write_text("\n".join(lines) + "\n")
    return folder, radiance


@pytest.mark.slow
def test_one_command_from_photographs_to_a_colour_map(tmp_path):
    """`merge PHOTOS -o map.tiff` finds the response: radiance in proportion to the truth, errors as u says."""
    import tifffile

    folder, radiance = _photographs(tmp_path / "p", np.random.default_rng(4))
    assert run(["merge", str(folder), "-o", str(tmp_path / "map.tiff")]) == 0
    value = tifffile.imread(tmp_path / "map.tiff", key=0).astype(float)
    assert value.shape == (72, 96, 3)
    u = tifffile.imread(tmp_path / "map.tiff", key=1).astype(float)
    for plane in range(3):
        ratio = value[..., plane] / radiance
        inside = (radiance > 0.01) & (radiance < 1.2)
        scatter = ratio[inside] / np.median(ratio[inside]) - 1.0
        z = scatter / (u[..., plane] / value[..., plane])[inside]
        assert 0.6 < np.sqrt(np.mean(np.clip(z, -5, 5) ** 2)) < 1.5
        assert np.std(scatter) < 0.1
