"""`radiometer measure --photographs` without a calibration: through the response that they tell themselves."""

import json
import math

import numpy as np
import pytest
import tifffile

from radiometer.cli.main import run
from testing.photograph_folder import eight_bits, write_photographs

TIMES = (0.004, 0.01, 0.025, 0.0625, 0.15)
LIGHT = np.geomspace(0.4, 200.0, 12)  # fields of a chart, one next to the other
Y, X = np.mgrid[:144, :192]
FIELDS = LIGHT[(X // 48) + 4 * (Y // 48)]


pytestmark = pytest.mark.usefixtures("recovered_once")


@pytest.fixture
def chart(tmp_path):
    """Return a folder of photographs of a chart, stored as the root of the light: M = 255·√(H/2) and noise of 1 DN."""
    rng = np.random.default_rng(31)
    pictures = (eight_bits(255.0 * np.sqrt(FIELDS * s / 2.0) + rng.normal(0.0, 1.0, FIELDS.shape)) for s in TIMES)
    return write_photographs(tmp_path, pictures, TIMES)


def _read(folder, field, *words):
    patch = f"{48 * (field % 4) + 12},{48 * (field // 4) + 12},24,24"
    command = ["measure", "--photographs", str(folder), "--uncalibrated", "--patch", patch, "--align", "off"]
    return run([*command, "--json", *words])


def test_one_photograph_holds_no_response(chart, capsys):
    """One exposure of an unknown response is refused; --linear takes the numbers as they are, a root apart."""
    (chart / "exposures.txt").write_text("p2.png 0.025\n")
    assert _read(chart, 6) == 1
    assert "at least two different ones" in capsys.readouterr().err
    values = []
    for field in (6, 8):
        assert _read(chart, field, "--linear") == 0
        values.append(json.loads(capsys.readouterr().out)["radiance"]["value"])
    assert values[1] / values[0] == pytest.approx(math.sqrt(LIGHT[8] / LIGHT[6]), rel=0.005)


@pytest.fixture
def film(tmp_path):
    """Return photographs of the chart on film: fog at 20 DN in every frame, above it the root of the light."""
    rng, times = np.random.default_rng(32), [5e-6 * 4.0**k for k in range(9)]
    noise = (rng.normal(0.0, 1.0, FIELDS.shape) for _ in times)
    pictures = (eight_bits(20.0 + 215.0 * np.sqrt(FIELDS * s / 2.0) + n) for s, n in zip(times, noise, strict=True))
    return write_photographs(tmp_path, pictures, times)


@pytest.mark.slow
def test_the_fog_of_a_film_is_black(film, tmp_path, capsys):
    """Short frames show the fog, not light: fields 5.4 times apart read so, in a patch as in a map.

    Taken for light, the fog of the shortest frame is tens of thousands of times as bright as the darker field.
    """
    found = []
    for field in (1, 4):
        assert _read(film, field) == 0
        found.append(json.loads(capsys.readouterr().out))
        assert "flicker" not in found[-1]["flags"]
    value = [one["radiance"]["value"] for one in found]
    # Black is known to half a DN, 5 % of what the darker field shows at best; there is no stray light.
    assert value[1] / value[0] == pytest.approx(LIGHT[4] / LIGHT[1], rel=0.1)
    assert run(["merge", str(film), "--align", "off", "-o", str(tmp_path / "map.tiff")]) == 0
    capsys.readouterr()
    radiance = tifffile.imread(tmp_path / "map.tiff", key=0).astype(float)
    dark, bright = radiance[12:36, 60:84].mean(), radiance[60:84, 12:36].mean()
    assert bright / dark == pytest.approx(value[1] / value[0], rel=0.1)
    assert np.isfinite(radiance).all()


def test_numbers_of_12_bits_in_files_of_16_are_white_where_they_end(tmp_path, capsys):
    """Linear photographs that clip at 4095 of 65535: every field of the map is the light, though most frames clip."""
    rng, times = np.random.default_rng(33), [0.002 * 4.0**k for k in range(5)]
    electrons = (rng.poisson(FIELDS * s * 2e4) + rng.normal(0.0, 4.0, FIELDS.shape) for s in times)
    pictures = (np.clip(np.rint(e / 2.0), 0, 4095).astype(np.uint16) for e in electrons)
    folder = write_photographs(tmp_path / "linear", pictures, times)
    words = ["--linear", "--align", "off", "--json", "-o", str(tmp_path / "map.tiff")]
    assert run(["merge", str(folder), *words]) == 0
    assert json.loads(capsys.readouterr().out)["pixels"]["below_noise"] == 0
    radiance = tifffile.imread(tmp_path / "map.tiff", key=0).astype(float)
    means = [radiance[48 * (f // 4) + 12 : 48 * (f // 4) + 36, 48 * (f % 4) + 12 :][:, :24].mean() for f in range(12)]
    ratio = np.array(means) / LIGHT
    # 576 pixels of 5 % each at worst: 0.2 %; half a DN of black is 1 % of the darkest field in its best frame.
    assert ratio == pytest.approx(np.full(12, ratio.mean()), rel=0.015)


@pytest.mark.parametrize("command", ["response", "merge", "reconcile"])
def test_folders_of_photographs_within_a_folder_are_named(chart, tmp_path, capsys, command):
    """A folder of folders holds no photographs itself: those of its folders that do are stated."""
    for name in ("before", "after"):
        (tmp_path / "day" / name).mkdir(parents=True)
        for file in ("p0.png", "p1.png"):
            (tmp_path / "day" / name / file).write_bytes((chart / file).read_bytes())
    (tmp_path / "day" / "notes").mkdir()
    words = ["-o", str(tmp_path / "map.exr")] if command == "merge" else []
    assert run([command, str(tmp_path / "day"), *words]) == 1
    assert "in folders below it (after, before); give one of these" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("command", ["response", "merge", "reconcile"])
def test_times_written_as_their_inverse_are_reported_to_be_wrong_throughout(chart, tmp_path, capsys, command):
    """A list of 1/t in place of t: every command says that, not that the photographs hardly overlap."""
    (chart / "exposures.txt").write_text("".join(f"p{k}.png {1.0 / s}\n" for k, s in enumerate(TIMES)))
    words = ["-o", str(tmp_path / "map.exr")] if command == "merge" else []
    assert run([command, str(chart), *words]) == 1
    assert "the times are wrong throughout" in " ".join(capsys.readouterr().err.split())
