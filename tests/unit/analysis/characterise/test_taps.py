"""Sensors with several output amplifiers: figures of each, borders found in frames, and sections of FITS headers."""

import numpy as np
import pytest

import radiometer as rm
from radiometer.errors import MeasurementError, UsageError
from testing.tap_camera import EXPOSURES_S, Taps

fits = pytest.importorskip("astropy.io.fits")


def write_frames(folder, seed, taps, shape=(128, 192)):
    """Write pairs of flats and of darks as FITS files."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for kind, exposure_s, copy, data in taps.frames(rng, shape):
        header = {"EXPTIME": exposure_s, "IMAGETYP": kind, "INSTRUME": "four taps"}
        write(folder / f"{kind}{exposure_s}{copy}.fits", data, header)
    return folder


def write(path, data, header):
    """Write one picture with its header."""
    unit = fits.PrimaryHDU(data)
    unit.header.update(header)
    unit.writeto(path)


@pytest.mark.parametrize(("rows", "columns", "seed"), [(2, 2, 9101), (2, 8, 9102)])
def test_each_tap_has_the_gain_black_level_and_noise_it_was_made_with(tmp_path, rows, columns, seed):
    """Of 4 and of 16 taps gains, black levels and read noises are within 4 u of the truth, most within 2 u."""
    truth = Taps.drawn(np.random.default_rng(seed), rows, columns)
    found = rm.characterise(write_frames(tmp_path / "set", seed, truth), taps=f"{columns}x{rows}")
    errors_u = []
    for one, gain, black, noise in zip(found.taps, truth.gain.flat, truth.black.flat, truth.noise.flat, strict=True):
        figures = one.characterisation.figures
        for symbol, true in (("K", gain), ("mu_y_dark", black), ("sigma_d", noise)):
            errors_u.append(abs(figures[symbol].value - true) / figures[symbol].u)
    assert max(errors_u) < 4.0
    assert np.mean(np.array(errors_u) <= 2.0) >= 0.8
    assert any("K differs between taps" in note for note in found.characterisation.notes)


@pytest.mark.parametrize("which", ["gain", "black", "noise"])
def test_borders_are_found_where_one_figure_alone_differs(tmp_path, which):
    """A step of 3 % of gain, of 4 DN of black level, or of twice the noise shows the border of taps."""
    same = {"gain": np.full((2, 2), 0.5), "black": np.full((2, 2), 200.0), "noise": np.full((2, 2), 6.0)}
    other = {"gain": 0.515, "black": 204.0, "noise": 12.0}[which]
    same[which][0, 1] = same[which][1, 0] = other
    found = rm.characterise(write_frames(tmp_path / "set", 9103, Taps(**same)), taps="find")
    assert [(t.tap.x, t.tap.y, t.tap.width, t.tap.height) for t in found.taps] == [
        (0, 0, 96, 64), (96, 0, 96, 64), (0, 64, 96, 64), (96, 64, 96, 64)
    ]  # fmt: skip


def test_borders_of_sixteen_taps_are_found_and_of_one_none(tmp_path):
    """Where each amplifier's columns end."""
    truth = Taps.drawn(np.random.default_rng(9109), 2, 8)
    found = rm.characterise(write_frames(tmp_path / "set", 9109, truth), taps="find")
    assert [(t.tap.x, t.tap.y, t.tap.width, t.tap.height) for t in found.taps] == truth.rectangles((128, 192))
    alike = Taps(np.full((1, 1), 0.5), np.full((1, 1), 200.0), np.full((1, 1), 6.0))
    with pytest.raises(MeasurementError, match="COLUMNSxROWS"):
        rm.characterise(write_frames(tmp_path / "one", 9104, alike), taps="find")


def test_units_of_amplifiers_make_one_frame_of_taps(tmp_path):
    """Four units placed by DETSEC, two of them read from the other end, are one picture with four taps."""
    truth = Taps.drawn(np.random.default_rng(9105), 2, 2)
    rng = np.random.default_rng(9106)
    folder = tmp_path / "set"
    folder.mkdir()
    for kind, exposure_s, copy, whole in truth.frames(rng, (64, 96)):
        truth.write_units(folder / f"{kind}{exposure_s}{copy}.fits", rng, whole, exposure_s, kind)
    found = rm.characterise(folder)
    assert [one.tap.name for one in found.taps] == ["A", "B", "C", "D"]
    assert {one.tap.first_pixel for one in found.taps} == {"upper left", "upper right"}
    for one, gain, black in zip(found.taps, truth.gain.flat, truth.black.flat, strict=True):
        assert abs(one.characterisation.figures["K"].value - gain) < 4 * one.characterisation.figures["K"].u
        assert one.overscan.value == pytest.approx(black, abs=0.5)


def test_cross_talk_is_the_share_of_a_spot_that_an_even_tap_repeats(tmp_path):
    """A spot in one tap of which another reads 0.5 % at the same time is found within 3 u; the others read nothing."""
    rng, folder = np.random.default_rng(9107), tmp_path / "set"
    folder.mkdir()
    for number, exposure_s in enumerate(EXPOSURES_S):
        for copy in range(2):
            for kind in ("flat", "dark"):
                light = np.full((64, 96), 0.0 if kind == "dark" else 2000.0 * exposure_s)
                light[10:20, 10:30] *= 8.0
                light[10:20, 66:86] += 0.005 * 7.0 / 8.0 * light[10:20, 10:30]
                electrons = rng.poisson(light) + rng.normal(0.0, 5.0, light.shape)
                data = np.rint(200 + 0.5 * electrons).astype(np.uint16)
                write(folder / f"{kind}{number}{copy}.fits", data, {"EXPTIME": exposure_s, "IMAGETYP": kind})
    shares = {(one.of, one.into): one.share for one in rm.characterise(folder, taps="2x2").crosstalk}
    assert abs(shares["1", "2"].value - 0.005) < 3 * shares["1", "2"].u
    assert abs(shares["1", "3"].value) < 3 * shares["1", "3"].u


@pytest.mark.parametrize(
    ("how", "says"), [("3x0", "no such equal parts"), ("5x2", "no such"), ("four", "COLUMNSxROWS")]
)
def test_taps_that_cannot_be_are_refused(tmp_path, how, says):
    """A frame of 192 columns has no five equal taps, and a word is no number of them."""
    truth = Taps.drawn(np.random.default_rng(9108), 2, 2)
    with pytest.raises(UsageError, match=says):
        rm.characterise(write_frames(tmp_path / "set", 9108, truth), taps=how)
