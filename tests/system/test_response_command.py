"""`radiometer response` on captures and on photographs, whole and damaged."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiometer.bench.sources import open_source
from radiometer.cli.main import run
from radiometer.data import ResponseCurve
from testing.photograph_folder import eight_bits, write_photographs


def _photographs(folder: Path, *, times=(0.01, 0.02, 0.04, 0.08, 0.16), colour=False) -> Path:
    """Write a gamma stack of a gradient as PNG files with exposures.txt."""
    rng = np.random.default_rng(5)
    radiance = np.exp(np.linspace(0.0, 4.5, 120))[None, :].repeat(90, axis=0)
    exposures = (radiance * s * (1 + 0.01 * rng.standard_normal(radiance.shape)) for s in times)
    grey = (eight_bits(np.clip(one, 0, 1) ** 0.45 * 255) for one in exposures)
    return write_photographs(folder, (np.dstack([g // 2, g, g // 3]) if colour else g for g in grey), times)


@pytest.mark.parametrize("words", [["--plot"], ["--plot", "picture.svg"]])
def test_plot_with_and_without_a_name(tmp_path, monkeypatch, words):
    """`--plot` alone draws next to the output, `--plot FILE` where it is asked to."""
    monkeypatch.chdir(tmp_path)
    assert run(["response", str(_photographs(tmp_path / "p")), "-o", "curve.csv", *words]) == 0
    assert (tmp_path / (words[1] if len(words) > 1 else "curve.png")).stat().st_size > 5000


def test_each_channel_gets_a_file_and_two_folders_one_curve(tmp_path, capsys):
    """--channel each writes one curve per colour, the colour in the name; several PATHs are fitted jointly."""
    folder = _photographs(tmp_path / "p", colour=True)
    assert run(["response", str(folder), "-o", str(tmp_path / "c.csv"), "--channel", "each"]) == 0
    assert sorted(f.name for f in tmp_path.glob("*.csv")) == ["c-blue.csv", "c-green.csv", "c-red.csv"]
    folders = [str(_photographs(tmp_path / name)) for name in ("q", "r")]
    capsys.readouterr()
    assert run(["response", *folders, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["curves"][0]["pixels"] == 2 * 90 * 120


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Path.mkdir, "is empty"),
        (lambda folder: _photographs(folder, times=(0.04,)), "holds one exposure only"),
        (lambda folder: _photographs(folder, times=(2.0, 4.0, 8.0)), "all frames are clipped"),
        (lambda folder: None, "does not exist"),
    ],
)
def test_bad_input_is_one_clear_line(tmp_path, capsys, make, message):
    """Unusable input gives one line on standard error that names the trouble, and exit code 1."""
    make(tmp_path / "p")
    assert run(["response", str(tmp_path / "p"), "-o", str(tmp_path / "curve.csv")]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert message in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "curve.csv").exists()


def test_misuse_is_refused(tmp_path, monkeypatch, capsys):
    """A target that cannot be written or an unknown choice is refused before the work is done."""
    monkeypatch.chdir(tmp_path)
    _photographs(tmp_path / "p")
    for words, message in (
        (["-o", "p"], "it is a folder"),
        (["--channel", "infrared"], "there is no channel 'infrared'"),
    ):
        assert run(["response", "p", *words]) == 2
        assert message in capsys.readouterr().err


BLUE, GREEN, RED = 0, 1, 2


@pytest.fixture(scope="module")
def memorial(shared_data):
    """Return (folder, radiance map in the order blue, green, red, mask of pixels that no frame's border covers)."""
    folder = shared_data / "stacks" / "memorial_film"
    reference = cv2.imread(str(folder / "memorial.hdr"), cv2.IMREAD_UNCHANGED)
    border = np.zeros(reference.shape[:2], bool)
    for file in folder.glob("memorial00*.png"):
        image = cv2.imread(str(file))
        border |= (image[..., BLUE] == 255) & (image[..., GREEN] < 40) & (image[..., RED] < 40)
    return folder, reference, cv2.dilate(border.astype(np.uint8), np.ones((9, 9))) == 0


@pytest.mark.parametrize(("channel", "index"), [("red", RED), ("green", GREEN), ("blue", BLUE)])
def test_memorial_radiance_follows_the_published_map(memorial, tmp_path, channel, index):
    """Log radiance through the recovered curve correlates by 0.99 or more with Debevec's own radiance map."""
    folder, reference, inside = memorial
    target = tmp_path / "curve.csv"
    assert run(["response", str(folder), "-o", str(target), "--channel", channel]) == 0
    g = ResponseCurve.read(target).log_exposure
    total, weights = np.zeros(inside.shape), np.zeros(inside.shape)
    for frame in open_source(folder, channel).brackets[0].light:
        weight = np.interp(frame.dn, [20, 128, 250], [0.0, 1.0, 0.0])
        total += weight * (g[frame.dn] - np.log(frame.settings.exposure_s))
        weights += weight
    used = inside & (weights > 0) & (reference[..., index] > 0)
    log_radiance, log_reference = total[used] / weights[used], np.log(reference[..., index][used])
    assert np.corrcoef(log_radiance, log_reference)[0, 1] >= 0.99
