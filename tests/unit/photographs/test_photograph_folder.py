"""Folders of photographs: times from EXIF or lists, channels, and what is refused."""

import unicodedata
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from radiometer.errors import CaptureError, UsageError
from radiometer.importing.photograph_times import read_list
from radiometer.photographs.folder import read_photographs


def _grey(folder: Path, name: str, level: int, dtype=np.uint8, shape=(24, 32)) -> None:
    gradient = np.linspace(level / 2, level, shape[1])[None, :].repeat(shape[0], axis=0)
    cv2.imwrite(str(folder / name), gradient.astype(dtype))


def _jpeg(folder: Path, name: str, level: int, *, time=None, f_number=8.0, iso=100) -> None:
    image = Image.fromarray(np.full((24, 32, 3), (level, level // 2, level // 4), np.uint8))
    exif = Image.Exif()
    if time is not None:
        exif.get_ifd(0x8769).update({33434: time, 33437: f_number} | ({} if iso is None else {34855: iso}))
    image.save(folder / name, exif=exif, quality=95)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("# name time\na.png 1/125\n", 1 / 125), ("\na.png, 0.5\n", 0.5), ("a.png\t2 s\n", 2.0),
        ("a.png 2.5 ms", 2.5e-3),
        ("# Filename 1/shutter_speed f/stop\na.png 0.25 8\n", 4.0), ("a.png\t2.5ms", 2.5e-3), ("a.png,2500 us", 2.5e-3),
        ("name time_ms\na.png 2.5", 2.5e-3), ("# file, time (ms)\na.png, 2.5", 2.5e-3), ("./a.png 0.0025 s 8", 2.5e-3),
        ('"a.png" 1/400 sec', 2.5e-3), ("a.png,0.5,8", 0.5), ("a.png 32 0.03125 8 0 0", 32.0), ("a.png 4 8", 4.0),
    ],
)  # fmt: skip
def test_a_line_of_a_list_gives_a_time(tmp_path, text, seconds):
    """Fractions, units behind the number or in the heading, 1/t where the heading says so; further columns are left."""
    (tmp_path / "exposures.txt").write_text(text)
    found = read_list(tmp_path / "exposures.txt")
    assert {name: one.exposure_s for name, one in found.items()} == {"a.png": pytest.approx(seconds)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((f"# heading\na.png{time}\n", "line 2") for time in ("", " soon", " 0", " -1/30", " 1/0")),
        *((f"a.png{mark}3,2\n", r"line 1: '3,2' has a decimal comma; write 3\.2") for mark in "; \t"),
        ("a.png 1\nb.png 2\na.png 4\n", r"line 3: names 'a\.png' again \(as line 1 does\)"),
    ],
)
def test_a_line_without_one_time_is_refused_by_its_number(tmp_path, text, said):
    """No positive time, 3,2 s that would be read as 3 s, and a second time for one photograph."""
    (tmp_path / "exposures.txt").write_text(text)
    with pytest.raises(CaptureError, match=rf"exposures\.txt, {said}"):
        read_list(tmp_path / "exposures.txt")


def test_names_with_blanks_are_those_of_files_that_lie_there(tmp_path):
    """A blank belongs to a name where a file of that name is next to the list; quotes around it do not."""
    for name in ("day 1.png", "day 2, noon.png", "c.png"):
        _grey(tmp_path, name, 100)
    (tmp_path / "exposures.csv").write_text('day 1.png,1/125\n"day 2, noon.png" 0.5\nc.png, 2\n')
    times = {name: known.exposure_s for name, known in read_list(tmp_path / "exposures.csv").items()}
    assert times == {"day 1.png": 1 / 125, "day 2, noon.png": 0.5, "c.png": 2.0}


def test_exif_dial_times_become_exact_stops(tmp_path):
    """EXIF 1/60 s is 2⁻⁶ s and f/5.6 is 2^2.5; the printed time stays next to it."""
    _jpeg(tmp_path, "a.jpg", 50, time=1 / 60, f_number=5.6)
    _jpeg(tmp_path, "b.jpg", 100, time=1 / 3, f_number=5.6)
    _jpeg(tmp_path, "c.jpg", 120, time=0.4, f_number=5.6)  # of a dial in thirds of a stop, so 1/3 s is one too
    bracket = read_photographs(tmp_path, "red")[0]
    assert [f.settings.exposure_s for f in bracket.light] == pytest.approx([2.0**-6, 2.0 ** (-5 / 3), 2.0 ** (-4 / 3)])
    assert bracket.light[0].settings.f_number == pytest.approx(2**2.5)
    assert bracket.light[0].extra["nominal_exposure_s"] == pytest.approx(1 / 60)


def test_each_channel_is_a_bracket_of_its_own(tmp_path):
    """ "each" gives red, green and blue; the values are those of the file."""
    _jpeg(tmp_path, "a.jpg", 80, time=0.1)
    _jpeg(tmp_path, "b.jpg", 160, time=0.2)
    brackets = read_photographs(tmp_path, "each")
    assert [b.light[0].extra["channel"] for b in brackets] == ["red", "green", "blue"]
    assert [int(np.median(b.light[1].dn)) for b in brackets] == pytest.approx([160, 80, 40], abs=2)


def test_luminance_is_luma_and_saturated_where_a_channel_is(tmp_path):
    """Luma weights are 0.299, 0.587, 0.114; one channel at 253, as JPEG returns a blue of 255, saturates the sum."""
    image = np.zeros((8, 8, 3), np.uint8)
    image[:4], image[4:] = (10, 100, 200), (253, 0, 0)  # blue, green, red
    cv2.imwrite(str(tmp_path / "a.png"), image)
    (tmp_path / "exposures.txt").write_text("a.png 1\n")
    luma = read_photographs(tmp_path, "luminance")[0].light[0].dn
    assert int(luma[0, 0]) == round(0.299 * 200 + 0.587 * 100 + 0.114 * 10)
    assert int(luma[7, 0]) == 255


def test_sixteen_bit_files_keep_their_values(tmp_path):
    """A 16-bit PNG and TIFF are read without scaling, also a PNG that is called a JPEG."""
    for name, dn in (("a.png", 39_000), ("b.tif", 40_000), ("c.png", 41_000)):
        cv2.imwrite(str(tmp_path / name), np.full((8, 8), dn, np.uint16))
    (tmp_path / "c.png").rename(tmp_path / "c.jpg")
    (tmp_path / "exposures.txt").write_text("a.png 1\nb.tif 2\nc.jpg 4\n")
    bracket = read_photographs(tmp_path)[0]
    assert bracket.bit_depth == 16
    assert [int(f.dn[0, 0]) for f in bracket.light] == [39_000, 40_000, 41_000]


def test_a_palette_of_greys_is_grey(tmp_path):
    """Numbers of a palette stand for its greys: a ramp upside down comes back as its greys, in one channel."""
    numbers = np.arange(192, dtype=np.uint8).reshape(12, 16)
    pictures = {"a.png": numbers, "b.tif": numbers[::-1]}
    for name, picture in pictures.items():
        image = Image.fromarray(np.ascontiguousarray(picture), "P")
        image.putpalette([grey for number in range(256) for grey in [255 - number] * 3])
        image.save(tmp_path / name)
    (tmp_path / "exposures.txt").write_text("a.png 1\nb.tif 2\n")
    (bracket,) = read_photographs(tmp_path, "each")
    for frame in bracket.light:
        assert np.array_equal(frame.dn, 255 - pictures[frame.extra["file"]])


def _cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-20])


def _palette_of_colours(file: Path) -> None:
    image = Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8), "P")
    image.putpalette([(number * k) % 256 for number in range(256) for k in (1, 2, 3)])
    image.save(file)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: _grey(folder, "b.png", 200, shape=(24, 30)), "b.png is 30 × 24 pixels"),
        (lambda folder: _grey(folder, "b.png", 20_000, np.uint16), "b.png has 16 bits"),
        (lambda folder: (_grey(folder, "b.png", 200), _cut(folder / "b.png")), r"b\.png: the PNG is truncated"),
        (lambda folder: (folder / "b.png").write_text("nothing of the kind"), r"b\.png: not a readable PNG"),
        (lambda folder: _palette_of_colours(folder / "b.png"), r"b\.png: its colours are indices into a palette"),
    ],
)
def test_unusable_files_are_named(tmp_path, make, message):
    """Mixed sizes or bit depths, truncated and foreign files are refused, the file named."""
    _grey(tmp_path, "a.png", 100)
    make(tmp_path)
    (tmp_path / "exposures.txt").write_text("a.png 1\nb.png 2\n")
    with pytest.raises(CaptureError, match=message):
        read_photographs(tmp_path)


@pytest.mark.parametrize(
    ("make", "channel", "error", "message"),
    [
        (lambda folder: _cut(folder / "a.jpg"), "red", CaptureError, r"a\.jpg: not a readable JPEG"),
        (lambda folder: _jpeg(folder, "a.jpg", 80), "red", CaptureError, r"a\.jpg: has no exposure time.*exposures\."),
        (lambda folder: _jpeg(folder, "b.jpg", 160, time=0.1, f_number=5.6), "red", CaptureError, "f-number changes"),
        (lambda folder: None, "infrared", UsageError, "choose one of"),
    ],
    ids=["cut short", "no time", "two f-numbers", "no such channel"],
)
def test_photographs_that_cannot_be_used_are_refused_with_the_way_out(tmp_path, make, channel, error, message):
    """A cut JPEG is not filled with grey; without EXIF a list is asked for; a lens's stops are not known so well."""
    _jpeg(tmp_path, "a.jpg", 80, time=0.1)
    make(tmp_path)
    with pytest.raises(error, match=message):
        read_photographs(tmp_path, channel)


def test_files_that_a_list_names_and_that_are_not_there_are_told(tmp_path):
    """Each is named, and one that differs in capital letters alone is told as it is called."""
    _grey(tmp_path, "IMG_1.png", 100)
    (tmp_path / "exposures.txt").write_text("IMG_1.png 1\nb.png 2\nc.png 4\n")
    with pytest.raises(CaptureError, match=r"names 'b\.png', 'c\.png', 2 files that are not in the folder; correct"):
        read_photographs(tmp_path)
    (tmp_path / "exposures.txt").write_text("img_1.PNG 1\n")
    with pytest.raises(
        CaptureError, match=r"'img_1\.PNG', which is not in the folder; the file is called 'IMG_1\.png'"
    ):
        read_photographs(tmp_path)


def test_photographs_that_a_list_does_not_name_are_reported_to_be_left_out(tmp_path, capsys):
    """A list of two of three photographs uses these two, and says on standard error which it leaves."""
    for name in ("a.png", "b.png", "c.png"):
        _grey(tmp_path, name, 100 + ord(name[0]))
    (tmp_path / "exposures.txt").write_text("a.png 1\nc.png 4\n")
    assert len(read_photographs(tmp_path)[0].light) == 2
    printed = capsys.readouterr().err
    assert "b.png" in printed
    assert "a.png" not in printed


def test_umlauts_are_one_letter_or_two_marks(tmp_path):
    """A list made where ü is one letter finds the file of a system that stores it as u and two dots, blanks and all."""
    stored, listed = (unicodedata.normalize(form, "Küche 1.png") for form in ("NFD", "NFC"))
    _grey(tmp_path, "x.png", 100)
    (tmp_path / "x.png").rename(tmp_path / stored)
    (tmp_path / "exposures.txt").write_text(f"{listed} 0.5\n", encoding="utf-8")
    assert read_photographs(tmp_path)[0].light[0].settings.exposure_s == 0.5


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_a_list_that_is_not_utf_8_is_reported_with_the_way_out(tmp_path, encoding):
    """What Windows' own programs write in other encodings is refused in words, not by a codec's."""
    (tmp_path / "exposures.txt").write_bytes("Küche.png 1\n".encode(encoding))
    with pytest.raises(CaptureError, match=r"is not UTF-8\); save the list as plain text in UTF-8"):
        read_list(tmp_path / "exposures.txt")


def test_a_copy_of_a_photograph_is_refused(tmp_path):
    """A copied file is no second exposure: both are named; black frames, which are alike, are none."""
    for name, level in (("a.png", 100), ("b.png", 200), ("c.png", 200)):
        _grey(tmp_path, name, level)
    lines = ["a.png 1", "b.png 2", "c.png 2"]
    (tmp_path / "exposures.txt").write_text("\n".join(lines))
    with pytest.raises(CaptureError, match=r"c\.png and b\.png hold the same picture"):
        read_photographs(tmp_path)
    for name in ("b.png", "c.png"):
        _grey(tmp_path, name, 3)
    assert len(read_photographs(tmp_path)[0].light) == 3


def test_times_of_a_camera_without_a_dial_stand_for_no_stops(tmp_path):
    """A telephone's 1/60 s with 1/3021 s is 1/60 s, not the 1/64 s of a dial; times by hand (90 s) change nothing."""
    for folder, other, expected in (("phone", 1 / 3021, 1 / 60), ("dial", 90.0, 2.0**-6)):
        (tmp_path / folder).mkdir()
        _jpeg(tmp_path / folder, "a.jpg", 50, time=1 / 60)
        _jpeg(tmp_path / folder, "b.jpg", 100, time=other)
        times = {f.extra["file"]: f.settings.exposure_s for f in read_photographs(tmp_path / folder, "red")[0].light}
        assert times["a.jpg"] == pytest.approx(expected, rel=1e-6)
        assert times["b.jpg"] == pytest.approx(other, rel=1e-4)


def test_a_photograph_without_an_iso_speed_among_several_speeds_is_refused(tmp_path):
    """Twice the speed is 6.02 dB; one that states none counts for nothing among others of one speed only."""
    _jpeg(tmp_path, "a.jpg", 50, time=0.1, iso=100)
    _jpeg(tmp_path, "b.jpg", 100, time=0.1, iso=200)
    gains = [f.settings.gain_db for f in read_photographs(tmp_path, "green")[0].light]
    assert gains == pytest.approx([0.0, 6.0206], abs=1e-4)
    for name, level, iso in (("a.jpg", 50, 100), ("b.jpg", 100, None), ("c.jpg", 200, 100)):
        _jpeg(tmp_path, name, level, time=level / 400, iso=iso)
    assert {f.settings.gain_db for f in read_photographs(tmp_path, "red")[0].light} == {0.0}
    _jpeg(tmp_path, "c.jpg", 200, time=0.5, iso=200)
    with pytest.raises(CaptureError, match=r"b\.jpg states no ISO speed, others 100 to 200; leave it out"):
        read_photographs(tmp_path, "red")
