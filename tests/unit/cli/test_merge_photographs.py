"""Merging photographs, and the report of a merge."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from radiometer import Radiance
from radiometer.analysis.response import auto
from radiometer.analysis.response.debevec1997 import recover_response_debevec1997
from radiometer.cli.analyse.merge import displacement_in_words, show_map_report
from radiometer.cli.main import run
from radiometer.data import PixelMask, Provenance, RadianceMap, ResponseCurve, provenance
from testing.photograph_folder import eight_bits, write_photographs

TIMES = (1.0, 2.0, 4.0, 8.0)

SHIFTS = ((0.0, 0.0), (3.0, -2.0), (0.0, 0.0), (-4.0, 1.0))


def _light(x, y):
    """Return a scene of smooth blobs at any places of a grid of rows and columns: each is a product of the two."""
    cx, cy, size, height = np.random.default_rng(12).uniform((0, 0, 3, 0.1), (160, 120, 12, 1.5), (90, 4)).T
    of_rows = height * np.exp(-((y[:, :1] - cy) ** 2) / (2.0 * size**2))
    return 0.05 + of_rows @ np.exp(-((x[0][:, None] - cx) ** 2) / (2.0 * size**2)).T


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of four linear photographs of 16 bits, shifted, with a bright ball that rolls through."""
    rng, pictures = np.random.default_rng(13), []
    y, x = np.mgrid[:120, :160].astype(float)
    for k, (seconds, (dx, dy)) in enumerate(zip(TIMES, SHIFTS, strict=True)):
        light = _light(x - dx, y - dy)
        if k != 2:
            light[(x - 30 - 30 * k) ** 2 + (y - 60) ** 2 < 36] = 4.0
        pictures.append(np.clip(rng.poisson(light * seconds * 900.0) * 2.0, 0, 65535).astype(np.uint16))
    return write_photographs(tmp_path_factory.mktemp("hand"), pictures, TIMES)


def _merged(folder, target, *words):
    assert run(["merge", "--force", str(folder), "--linear", "-o", str(target), *words]) == 0


@pytest.mark.slow
def test_shifted_photographs_give_the_scene(folder, tmp_path, capsys):
    """Through alignment and without what moved the map is the scene from the reference's place, within its noise."""
    _merged(folder, tmp_path / "map.tiff", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["alignment"].startswith("aligned to p")
    assert "unknown for" not in printed["alignment"]
    assert printed["pixels"]["moved"] > 100
    assert printed["median_u_rel"] < 0.025
    dx, dy = SHIFTS[int(printed["alignment"].split("aligned to p")[1][0])]
    value, u = (tifffile.imread(tmp_path / "map.tiff", key=key).astype(float) for key in (0, 1))
    mask = tifffile.imread(tmp_path / "map.tiff", key=2)
    y, x = np.mgrid[:120, :160].astype(float)
    ratio = value / _light(x - dx, y - dy)
    ratio /= np.median(ratio)
    moved = mask & 32 > 0
    assert np.median(np.abs(ratio - 1.0)[moved]) < 0.03
    good = mask == 0
    assert good.mean() > 0.9
    z = (ratio - 1.0) * value / u
    assert np.sqrt(np.mean(z[good] ** 2)) < 1.6


@pytest.mark.slow
def test_alignment_off_leaves_them_where_they_are(folder, tmp_path, capsys):
    """Without alignment nothing is stated of it, and the frames tell that they agree less with each other.

    The summary for people holds how far the frames lay apart, and the share of what moved.
    """
    _merged(folder, tmp_path / "map.tiff")
    out = capsys.readouterr().out
    assert all(text in out for text in ("frames     aligned to p", "pixels (", "moved"))
    _merged(folder, tmp_path / "on.tiff", "--json")
    on = json.loads(capsys.readouterr().out)
    _merged(folder, tmp_path / "off.tiff", "--align", "off", "--keep-ghosts", "--json")
    off = json.loads(capsys.readouterr().out)
    assert off["alignment"] is None
    assert off["pixels"]["moved"] == 0
    assert off["median_u_rel"] > 2.0 * on["median_u_rel"]


@pytest.mark.slow
def test_a_patch_of_photographs_from_the_hand_is_read_where_it_is(folder, tmp_path, capsys):
    """A patch on a steep flank reads the same as the scene there, relative to another patch; unaligned it does not."""

    def read(patch, *words):
        arguments = ["--photographs", str(folder), "--uncalibrated", "--linear", "--patch", patch, "--json", *words]
        assert run(["measure", *arguments]) == 0
        return json.loads(capsys.readouterr().out)

    _merged(folder, tmp_path / "map.tiff", "--json")
    printed = json.loads(capsys.readouterr().out)["alignment"]
    dx, dy = SHIFTS[int(printed.split("aligned to p")[1][0])]
    y, x = np.mgrid[:120, :160].astype(float)
    light = _light(x - dx, y - dy)
    steep = np.hypot(*np.gradient(light)) / light
    steep[:20] = steep[48:] = steep[:, :20] = steep[:, -20:] = 0.0  # clear of edges and of the ball
    row, column = np.unravel_index(np.argmax(steep), steep.shape)
    one, other = f"{column - 1},{row - 1},3,3", "60,20,3,3"
    expected = light[row - 1 : row + 2, column - 1 : column + 2].mean() / light[20:23, 60:63].mean()
    found = read(one)
    assert found["alignment"] == printed
    assert found["radiance"]["value"] / read(other)["radiance"]["value"] == pytest.approx(expected, rel=0.05)
    assert read(one, "--align", "off")["alignment"] is None


@pytest.mark.slow
def test_what_holds_of_every_colour_is_reported_once(tmp_path, capsys):
    """Grey photographs at whole stops: the remark on whole stops stands in one line, with the colours it holds of."""
    y, x = np.mgrid[:120:3, :160:3].astype(float)
    rng, light = np.random.default_rng(14), 20.0 * _light(x, y)[..., None]
    pictures = (eight_bits(rng.normal(light * s, 0.5, (*x.shape, 3))) for s in TIMES)
    write_photographs(tmp_path, pictures, TIMES)
    assert run(["merge", str(tmp_path), "-o", str(tmp_path / "map.exr"), "--align", "off"]) == 0
    printed = capsys.readouterr()
    lines = [
        line for line in (printed.err + printed.out).replace("\n ", " ").split("\n") if "whole stops apart" in line
    ]
    assert len(lines) == 1
    assert lines[0].startswith("red, green, blue: ")
    assert "pixels, 4 exposures, relative values" in printed.out


def test_a_file_in_place_of_a_folder_is_reported_to_be_one(tmp_path, capsys):
    """One photograph is no folder; a path that leads nowhere does not exist."""
    (tmp_path / "one.txt").write_text("")
    for name, what in (("one.txt", "is not a folder"), ("none", "does not exist")):
        assert run(["merge", str(tmp_path / name), "-o", str(tmp_path / "map.exr")]) != 0
        assert what in capsys.readouterr().err


@pytest.mark.parametrize(
    ("px", "u_px", "message"),
    [
        (0.0, 0.2, "below about 0.2 pixels"),
        (0.0, 0.0, "these frames cannot show one"),
        (0.31, 0.15, "0.31 ± 0.15 pixels"),
    ],
)
def test_a_displacement_that_frames_cannot_determine_is_not_reported_as_zero(px, u_px, message):
    """A bound of 0 pixels is no bound; others are reported with as many digits as are known."""
    assert message in displacement_in_words(px, u_px)


def test_a_fall_off_that_is_not_known_is_refused_before_the_work(folder, tmp_path, capsys, monkeypatch):
    """PNG files without an EXIF record: refused at once, not after frames were aligned and their response recovered."""
    pytest.importorskip("lensfunpy")
    monkeypatch.setattr("radiometer.photographs.scene.in_one_place", lambda *_: pytest.fail("aligned first"))
    words = ["merge", str(folder), "--vignetting", "lensfun", "-o", str(tmp_path / "map.exr")]
    assert run(words) == 1
    assert "lensfun's fall-off needs it" in capsys.readouterr().err


@pytest.fixture
def few_colours(tmp_path, monkeypatch):
    """Return a folder of colour photographs, and how often their response is recovered; each time as by a root."""
    y, x = np.mgrid[:120:3, :160:3].astype(float)
    rng, light = np.random.default_rng(15), _light(x, y)[..., None]
    pictures = (eight_bits(rng.normal(60.0 * np.sqrt(light * s), 0.7, (40, 54, 3))) for s in TIMES[:3])
    write_photographs(tmp_path, pictures, TIMES[:3])
    recovered = []

    def recover(brackets):
        recovered.append(len(brackets))
        return [recover_response_debevec1997(bracket) for bracket in brackets]

    monkeypatch.setattr(auto, "recover_colours_auto", recover)
    return tmp_path, recovered


@pytest.mark.slow
def test_a_kept_response_is_taken_up_as_long_as_photographs_and_recovery_stay(few_colours, capsys, monkeypatch):
    """Merged again, the response next to the map is used; of other pictures, or by another version, it is not."""
    folder, recovered = few_colours
    words = ["merge", "--force", str(folder), "-o", str(folder / "out.exr"), "--align", "off", "--channel", "each"]
    for _ in range(2):
        assert run(words) == 0
    assert recovered == [3]
    assert "recovered anew" not in capsys.readouterr().err
    picture = min(folder.glob("*.png"))
    cv2.imwrite(str(picture), 255 - (255 - cv2.imread(str(picture))) // 2 * 2)
    assert run(words) == 0
    assert recovered == [3, 3]
    monkeypatch.setattr(provenance, "source_hash", lambda *_: "another")
    for _ in range(2):
        assert run(words) == 0
    assert recovered == [3, 3, 3]
    printed = capsys.readouterr().err.replace("\n", " ")
    assert printed.count("from another version of the recovery of responses; recovered anew") == 1


@pytest.mark.slow
def test_a_colour_by_itself_does_not_take_up_what_three_colours_determined(few_colours):
    """Labels are judged by all colours together: red alone is recovered by itself, and the three together again."""
    folder, recovered = few_colours
    for channel in ("each", "red", "each"):
        words = ["-o", str(folder / "out.exr"), "--align", "off", "--channel", channel]
        assert run(["merge", "--force", str(folder), *words]) == 0
    assert recovered == [3, 1, 3]


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """Return a folder of four shifted photographs of 8 bits stored as a root of the light: M = 90·√H, noise of 1 DN."""
    rng = np.random.default_rng(16)
    y, x = np.mgrid[:120, :160].astype(float)
    exposures = (_light(x - dx, y - dy) * seconds for seconds, (dx, dy) in zip(TIMES, SHIFTS, strict=True))
    pictures = (eight_bits(90.0 * np.sqrt(one) + rng.normal(0.0, 1.0, x.shape)) for one in exposures)
    return write_photographs(tmp_path_factory.mktemp("bent"), pictures, TIMES)


@pytest.mark.slow
def test_the_response_of_photographs_from_the_hand_is_that_of_aligned_ones(bent, tmp_path, capsys):
    """ln H of a root is 2 ln M: found to 1 % (rms from 40 to 220 DN) in one place, three times worse as they lie."""
    off = {}
    for align in ("auto", "off"):
        target = tmp_path / f"{align}.csv"
        assert run(["response", str(bent), "--align", align, "-o", str(target)]) == 0
        assert ("aligned to p" in capsys.readouterr().err) is (align == "auto")
        dn = np.arange(40, 221)
        off[align] = float(np.std(ResponseCurve.read(target).log_exposure[dn] - 2.0 * np.log(dn)))
    assert off["auto"] < 0.01
    assert off["off"] > 3.0 * off["auto"]
    assert run(["reconcile", str(bent), "--json"]) == 0  # in one place their printed exposures agree
    printed = capsys.readouterr()
    assert json.loads(printed.out)["verdict"] == "agrees"
    assert "aligned to p" in printed.err


def test_pictures_of_a_row_have_no_place_to_be_brought_to(tmp_path, capsys):
    """Photographs one pixel high cannot be aligned: they are taken as they lie, no library's assertion."""
    light = np.geomspace(0.02, 1.0, 600)[None]
    roots = (250.0 * np.sqrt(light * s / 8.0) for s in TIMES)
    pictures = (eight_bits(np.random.default_rng(k).normal(root, 0.6)) for k, root in enumerate(roots))
    write_photographs(tmp_path, pictures, TIMES)
    assert run(["response", str(tmp_path)]) == 0
    assert "aligned to" not in capsys.readouterr().err


@pytest.mark.slow
def test_what_a_given_curve_leaves_open_is_reported(few_colours, tmp_path, capsys):
    """The uncertainty that another program's file does not state, and a colour that another one's curve stands for."""
    folder, _ = few_colours
    assert run(["response", str(folder), "--channel", "each", "-o", str(tmp_path / "c.m")]) == 0
    assert run(["response", str(folder), "--channel", "each", "-o", str(tmp_path / "c.yaml")]) == 0

    def assumed(*files):
        capsys.readouterr()
        given = [word for file in files for word in ("--response", str(tmp_path / file))]
        assert run(["merge", "--force", str(folder), *given, "-o", str(tmp_path / "map.exr"), "--json"]) == 0
        return [text for text in json.loads(capsys.readouterr().out)["assumptions"] if "stray light" not in text]

    assert "u(ln H) 3 %: c.m states none" in assumed("c.m")
    of_green = assumed("c-green.yaml")
    assert "red: the response curve given (green) holds for red" in of_green
    assert "blue: the response curve given (green) holds for blue" in of_green
    assert not [text for text in assumed("c-red.yaml", "c-green.yaml", "c-blue.yaml") if "curve given" in text]


def _map(level, u_rel, flagged=0, displacement=None):
    """Return a map of 20 × 10 equal pixels, so many of them saturated."""
    radiance, mask = np.full((10, 20), level, np.float32), np.zeros((10, 20), np.uint8)
    mask.flat[:flagged] = PixelMask.SATURATED
    reported = (
        {} if displacement is None else dict(zip(("displacement_px", "displacement_u_px"), displacement, strict=True))
    )
    return RadianceMap(
        radiance, radiance * u_rel, mask, "relative", 0.003, (1.0,), Provenance("m", parameters=reported)
    )


def _printed(report, capsys):
    show_map_report(report)
    return capsys.readouterr().out


def test_every_colour_has_its_own_figures(capsys):
    """Blue is ten times as noisy as green and has saturated pixels: both stand there, not those of green alone."""
    maps = {
        "red": _map(2.0, 0.02, displacement=(0.0, 0.1)),
        "green": _map(3.0, 0.01, displacement=(0.25, 0.05)),
        "blue": _map(5.0, 0.1, 50, displacement=(0.0, 0.1)),
    }
    report = Radiance(maps, (Path("map.exr"),)).to_mapping()
    assert (report["values"]["median"], report["pixels"]["good"]) == (3.0, 200)
    found = {name: one["median_u_rel"] for name, one in report["by_channel"].items()}
    assert found == pytest.approx({"red": 0.02, "green": 0.01, "blue": 0.1})
    text = _printed(report, capsys)
    for line in (
        "values     blue: 5 to 5, median 5",
        "noise      green: 1 % per pixel (median, k = 1), 0.3 % common to all",
        "noise      blue: 10 % per pixel",
        "good         red 200, green 200, blue 150 pixels (100, 100, 75 %)",
        "saturated    red 0, green 0, blue 50 pixels (0, 0, 25 %)",
        "frames     green: displaced by 0.250 ± 0.050 pixels",
    ):
        assert line in text


def test_one_channel_needs_no_name_and_what_colours_share_is_reported_once(capsys):
    """Grey photographs have one line each; what no pixel is flagged with is not listed."""
    mapping = _printed(Radiance({"mono": _map(2.0, 0.02, 20)}).to_mapping(), capsys)
    assert "values     2 to 2, median 2\nnoise      2 % per pixel" in mapping
    assert "good         180 pixels (90 %)\nsaturated    20 pixels (10 %)\n" in mapping
    assert "mono" not in mapping
    assert "inconsistent" not in mapping
    same = {name: _map(2.0, 0.02) for name in ("red", "green", "blue")}
    assert _printed(Radiance(same).to_mapping(), capsys).count("noise") == 1
