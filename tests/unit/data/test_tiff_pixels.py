"""TIFF files of every layout: as photographs and as frames they hold what was written, or are refused in one line."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from radiometer.data.capture_set import read_digital_numbers
from radiometer.errors import CaptureError
from radiometer.importing.photograph_pixels import read_photograph
from radiometer.importing.tiff_files import read_tiff_pixels

ROWS, COLUMNS = 40, 48
_ALPHA = {2: "minisblack", 4: "rgb"}


def picture(dtype, samples=1):
    """Return a picture of which no two samples are alike, the values of the type's whole range."""
    top = np.iinfo(dtype).max
    values = np.random.default_rng(samples).integers(0, top, (ROWS, COLUMNS, samples), dtype, endpoint=True)
    return values[..., 0] if samples == 1 else values


def write(path, values, *, planes_apart=False, alpha="unassalpha", **layout):
    """Write a TIFF of grey values or colours, with a transparency where there are two or four samples."""
    samples = 1 if values.ndim == 2 else values.shape[2]
    if samples > 1:
        layout |= {"planarconfig": "separate" if planes_apart else "contig"}
        layout |= {"extrasamples": [alpha]} if samples in _ALPHA else {}
        values = np.moveaxis(values, -1, 0) if planes_apart else values
    tifffile.imwrite(path, values, photometric="rgb" if samples > 2 else "minisblack", metadata=None, **layout)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("samples", [1, 2, 3, 4])
@pytest.mark.parametrize("planes_apart", [False, True], ids=["together", "planes apart"])
def test_a_photograph_of_any_layout_is_as_written(dtype, samples, planes_apart, tmp_path):
    """Byte order, tiles, compression, predictor and both kinds of transparency, which is left out."""
    values = picture(dtype, samples)
    expected = values if samples == 1 else values[..., 0] if samples == 2 else values[..., :3]
    packings = ({}, {"compression": "zlib"}, {"compression": "zlib", "predictor": True})
    for order, tile, packing, alpha in itertools.product(
        "<>", (None, (16, 16)), packings, ("unassalpha", "assocalpha")
    ):
        layout = {"byteorder": order, "tile": tile, **packing}
        write(tmp_path / "a.tif", values, planes_apart=planes_apart, alpha=alpha, **layout)
        found = read_photograph(tmp_path / "a.tif")
        assert found.bit_depth == 8 * np.dtype(dtype).itemsize
        assert np.array_equal(found.values, expected), layout
        if samples == 1:
            assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), expected), layout


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("samples", [1, 3, 4])
def test_lzw_is_as_written(dtype, samples, tmp_path):
    """The compression that OpenCV and most programs write; a transparency is left out."""
    values = picture(dtype, samples)
    cv2.imwrite(str(tmp_path / "a.tif"), values if samples == 1 else values[..., [2, 1, 0, 3][:samples]])
    found = read_photograph(tmp_path / "a.tif").values
    assert np.array_equal(found, values if samples == 1 else values[..., :3])


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", None])
def test_no_orientation_is_applied(samples, compression, tmp_path):
    """Pixels count as stored, in TIFF and JPEG alike: a patch is at one place of the sensor, however it was held."""
    values = np.zeros((ROWS, COLUMNS, samples), np.uint8)
    values[: ROWS // 2, : COLUMNS // 2] = 200
    image = Image.fromarray(values[..., 0] if samples == 1 else values)
    for turned in range(1, 9):
        exif = Image.Exif()
        exif[274] = turned
        image.save(tmp_path / "a.tif", compression=compression, tiffinfo={274: turned})
        image.save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
        of_tiff, of_jpeg = (read_photograph(tmp_path / name).values for name in ("a.tif", "a.jpg"))
        assert np.array_equal(of_tiff, np.asarray(image)), turned
        assert of_jpeg.shape == of_tiff.shape
        assert np.abs(of_jpeg.astype(int) - of_tiff).max() < 20
        if samples == 1:
            assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), values[..., 0]), turned
            assert np.array_equal(read_tiff_pixels(tmp_path / "a.tif", 0), values[..., 0]), turned


@pytest.mark.parametrize("samples", [1, 3])
def test_a_reduced_picture_is_not_the_picture(samples, tmp_path):
    """Before or after the picture, a smaller copy of it (NewSubfileType 1) is left alone; two pictures are refused."""
    values = picture(np.uint16, samples)
    smaller = np.ascontiguousarray(values[::2, ::2])
    for kinds, refused in (((1, 0), False), ((0, 1), False), ((0, 0), True)):
        with tifffile.TiffWriter(tmp_path / "a.tif") as tiff:
            for kind in kinds:
                tiff.write(smaller if kind else values, subfiletype=kind, metadata=None)
        if refused:
            with pytest.raises(CaptureError, match="a TIFF of 2 pages"):
                read_photograph(tmp_path / "a.tif")
        else:
            assert np.array_equal(read_photograph(tmp_path / "a.tif").values, values)


def test_a_stack_in_one_directory_is_refused(tmp_path):
    """ImageJ writes all pictures of a large stack behind one directory: none of them is taken as the photograph."""
    tifffile.imwrite(tmp_path / "a.tif", np.stack([picture(np.uint16)] * 3), imagej=True)
    for read in (read_photograph, read_digital_numbers):
        with pytest.raises(CaptureError, match="a TIFF of 3 pages"):
            read(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("values", "layout", "message"),
    [
        (picture(np.uint16), {"photometric": "miniswhite"}, "0 is white"),
        (picture(np.uint8, 4), {"photometric": "separated"}, "neither grey values nor red, green and blue"),
        (picture(np.uint8, 3), {"photometric": "minisblack", "planarconfig": "contig"}, "3 samples per pixel"),
        (picture(np.uint16), {"photometric": 32803}, "a mosaic of colours"),
        (picture(np.uint16).astype(np.float32), {"photometric": "minisblack"}, "holds float32 values"),
        (picture(np.uint8, 3).astype(np.float16), {"photometric": "rgb"}, "holds float16 values"),
        (picture(np.uint16).astype(np.int16), {"photometric": "minisblack"}, "holds int16 values"),
        (picture(np.uint16).astype(np.uint32), {"photometric": "minisblack"}, "holds uint32 values"),
        (picture(np.uint8) > 9, {"photometric": "minisblack"}, "holds bool values"),
    ],
    ids=["white", "inks", "three greys", "mosaic", "float", "half", "signed", "32 bits", "1 bit"],
)
def test_other_numbers_are_refused_in_one_line(values, layout, message, tmp_path):
    """What is neither grey values nor colours of 8 or 16 bits is not guessed."""
    tifffile.imwrite(tmp_path / "a.tif", values, metadata=None, **layout)
    with pytest.raises(CaptureError, match=message) as refusal:
        read_photograph(tmp_path / "a.tif")
    assert "\n" not in str(refusal.value)


def test_samples_that_no_decoder_reads_whole_are_refused(tmp_path):
    """16 bits in planes apart under LZW, and grey with a transparency: decoders mix them up or cut them to 8 bits."""
    for samples in (2, 3):
        write(tmp_path / "a.tif", picture(np.uint16, samples), planes_apart=samples == 3)
        with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as tiff:
            tiff.pages[0].tags["Compression"].overwrite(5)
        with pytest.raises(CaptureError, match="save it without compression"):
            read_photograph(tmp_path / "a.tif")


def test_a_mosaic_is_a_frame(tmp_path):
    """A frame may hold pixels under filters of several colours, which capture.yaml describes."""
    values = picture(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric=32803, metadata=None)
    assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), values)
