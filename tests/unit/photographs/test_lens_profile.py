"""The fall-off of lenses by lensfun's database: held next to its own measured values, and taken out of a map."""

import csv
import gzip
import io
import re
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from PIL import Image

import radiometer as rm
from radiometer.cli.main import run
from radiometer.errors import CaptureError, InputError
from radiometer.photographs.lens_profile import LensRecord, lensfun_flat_field, read_lens_record

LENS = "Canon EF 24-105mm f/4L IS USM"
RECORD = LensRecord("Canon", "Canon EOS 5D Mark II", LENS, 24.0, 4.0)


def _photograph(path, values, seconds, lens=LENS, **without):
    exif = Image.Exif()
    exif[271], exif[272] = "Canon", "Canon EOS 5D Mark II"
    inner = exif.get_ifd(0x8769)
    inner[33434], inner[33437], inner[37386], inner[42036] = seconds, 4.0, 24.0, lens
    for tag in without.get("without", ()):
        del inner[tag]
    inner.update(without.get("more", {}))
    Image.fromarray(values).save(path, exif=exif)


WHOLE = {40962: 5616, 40963: 3744}
PER_INCH = {41486: 5616 / 36.0 * 25.4, 41488: 2}


@pytest.mark.parametrize(
    ("sides", "more", "outcome"),
    [
        ((24, 36), WHOLE | PER_INCH, "made smaller and not cut"),
        ((36, 24), WHOLE, "made smaller and not cut"),
        ((24, 24), WHOLE, "was cut"),
        ((24, 36), {}, "whole picture of the camera$"),
        ((24, 36), {40962: 3600, 40963: 2400} | PER_INCH, "27.7 mm of the sensor's diagonal of 43.3 mm"),
    ],
)
def test_a_part_of_a_picture_is_not_taken_for_the_whole(tmp_path, sides, more, outcome):
    """Sides of another shape than the record states are a cut, and so is a smaller part of the sensor."""
    pytest.importorskip("lensfunpy")
    _photograph(tmp_path / "a.png", np.zeros(sides, np.uint16), 0.1, more=more)
    try:
        said = lensfun_flat_field(read_lens_record(tmp_path / "a.png"), sides)[1]
    except (CaptureError, InputError) as error:
        said = str(error)
    assert re.search(outcome, said)


def test_focus_that_moves_within_a_bracket_is_doubted(tmp_path):
    """A lens of 24 mm has (0.1·0.276/(0.3·0.076))² − 1 = 47 % more light at 0.3 m than at 0.1 m, none far away."""
    for near_m, doubted in ((0.1, "may differ by 47 %"), (30.0, None)):
        folder = tmp_path / f"{near_m}"
        folder.mkdir()
        for seconds, at_m in ((0.02, near_m), (0.04, 3.0 * near_m)):
            dn = np.random.default_rng(1).poisson(seconds * 300_000.0, (80, 120)).astype(np.uint16)
            _photograph(folder / f"t{seconds}.png", dn, seconds, more={37382: at_m})
        notes = [one for one in rm.merge(folder, linear=True).notes if "focus" in one]
        assert len(notes) == (doubted is not None)
        assert doubted is None or doubted in notes[0]


@pytest.mark.slow
def test_coefficients_are_those_that_were_measured(shared_data):
    """At a measured focal length, aperture and distance the sensitivity is 1 + k₁r² + k₂r⁴ + k₃r⁶ of the table."""
    pytest.importorskip("lensfunpy")
    table = shared_data / "sensors" / "lensfun_vignetting" / "vignetting_pa.csv.gz"
    rows = list(csv.DictReader(io.StringIO(gzip.decompress(table.read_bytes()).decode())))
    measured = [
        row for row in rows if row["model"] == LENS and row["distance_m"] == "1000" and float(row["cropfactor"]) == 1.0
    ]
    assert len(measured) >= 5
    for row in measured[::3]:
        record = LensRecord("Canon", RECORD.camera, LENS, float(row["focal_mm"]), float(row["aperture"]), 1000.0)
        flat, _ = lensfun_flat_field(record, (400, 600))
        k = [float(row[name]) for name in ("k1", "k2", "k3")]
        for share in (0.3, 0.7, 1.0):
            x, y = 299.5 + share * 300.0, 199.5 + share * 200.0
            found = flat.at(np.array([x]), np.array([y]))[0]
            assert found == pytest.approx(1.0 + k[0] * share**2 + k[1] * share**4 + k[2] * share**6, abs=2e-3)


def test_a_smaller_sensor_sees_the_middle_of_the_lens():
    """On a camera of crop factor 1.6 the corner lies at r = 1/1.6 of a lens measured on a full frame."""
    pytest.importorskip("lensfunpy")
    full, _ = lensfun_flat_field(RECORD, (400, 600))
    small, _ = lensfun_flat_field(LensRecord("Canon", "Canon EOS 50D", LENS, 24.0, 4.0), (400, 600))
    corner = float(small.at(np.zeros(1), np.zeros(1))[0])
    inside = np.array([299.5 * (1 - 1 / 1.6)]), np.array([199.5 * (1 - 1 / 1.6)])
    assert corner == pytest.approx(float(full.at(*inside)[0]), abs=0.02)
    assert corner > float(full.at(np.zeros(1), np.zeros(1))[0]) + 0.1


def test_planted_falloff_is_taken_out(tmp_path, capsys):
    """An even wall through that lens comes out even, and the line says by which lens and how far to trust it."""
    pytest.importorskip("lensfunpy")
    y, x = np.mgrid[:80, :120]
    r2 = ((x - 59.5) ** 2 + (y - 39.5) ** 2) / (60.0**2 + 40.0**2)
    place = 1.0 - 0.546 * r2 - 0.2245 * r2**2 - 0.0825 * r2**3
    folder = tmp_path / "wall"
    folder.mkdir()
    rng = np.random.default_rng(2)
    for seconds in (0.02, 0.04, 0.08):
        dn = rng.poisson(place * seconds * 300_000.0).astype(np.uint16)
        _photograph(folder / f"t{seconds}.png", dn, seconds)
    words = ["merge", "--force", str(folder), "--linear", "-o", str(tmp_path / "map.tiff")]
    assert run([*words, "--vignetting", "lensfun"]) == 0
    assert f"{LENS} at 24 mm, f/4" in capsys.readouterr().out
    value = tifffile.imread(tmp_path / "map.tiff", key=0).astype(float)
    assert value[:6, :6].mean() / value[37:43, 57:63].mean() == pytest.approx(1.0, abs=0.02)
    assert run(words) == 0
    value = tifffile.imread(tmp_path / "map.tiff", key=0).astype(float)
    assert value[:6, :6].mean() / value[37:43, 57:63].mean() == pytest.approx(place[:6, :6].mean(), abs=0.02)


def test_what_the_photograph_does_not_say_is_named(tmp_path):
    """A record without lens and focal length is refused by what is missing; --lens names the lens."""
    _photograph(tmp_path / "a.png", np.zeros((8, 8), np.uint16), 0.1, without=(42036, 37386))
    with pytest.raises(CaptureError, match=r"does not state the lens .* the focal length"):
        read_lens_record(tmp_path / "a.png")
    _photograph(tmp_path / "b.png", np.zeros((8, 8), np.uint16), 0.1, without=(42036,))
    assert read_lens_record(tmp_path / "b.png", LENS).lens == LENS


def test_a_name_of_several_lenses_is_refused_with_their_names():
    """A part of two lenses' names names neither; a lens's whole name, with or without its maker, is that lens's."""
    pytest.importorskip("lensfunpy")
    several = r"several lenses .*: Canon EF 24-70mm f/2.8L USM, Canon EF 24-70mm f/2.8L II USM; name one with --lens"
    with pytest.raises(InputError, match=several):
        lensfun_flat_field(replace(RECORD, lens="EF 24-70mm f/2.8"), (40, 60))
    for name in ("EF24-70mm f/2.8L USM", "Canon EF 24-70mm f/2.8L USM"):
        assert (
            "lensfun: Canon EF 24-70mm f/2.8L USM at 24 mm"
            in lensfun_flat_field(replace(RECORD, lens=name), (40, 60))[1]
        )
    near = lensfun_flat_field(replace(RECORD, lens="Sigma 24-70mm F2.8 EX DG"), (40, 60))[1]
    assert "IF EX DG HSM (the only lens known that 'Sigma 24-70mm F2.8 EX DG' fits)" in near


@pytest.mark.parametrize(("camera", "lens"), [("Pinhole 3000", LENS), ("Canon EOS 5D Mark II", "Bottle 7 mm")])
def test_unknown_camera_or_lens_is_named(camera, lens):
    """What the database does not know is refused in one line with the way out."""
    pytest.importorskip("lensfunpy")
    with pytest.raises(InputError, match="flat field of your own"):
        lensfun_flat_field(LensRecord("Canon", camera, lens, 24.0, 4.0), (40, 60))
