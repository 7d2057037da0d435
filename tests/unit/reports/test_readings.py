"""Public reports of misread headers and tables, one line each: the report, the input, what is right.

What is right is a value, a doubt that names the cause, or a refusal that names it. Values are those the input was made
with.
"""

import struct
from typing import Any

import numpy as np
import pytest
import tifffile
from astropy.io import fits

from radiometer.errors import RadiometerError
from tests.unit.reports import inputs
from tests.unit.reports.readers import (
    read_image,
    read_means,
    read_meter,
    read_nights,
    read_screen,
    read_spectrum,
    read_thresholds,
    read_times,
)

LEVEL = 900
Facts = dict[str, Any]


def flat(dtype=np.uint16, level=LEVEL):
    """Return an even picture of one level."""
    return np.full((16, 24), level, dtype)


def in_fits(cards, picture=None, **above):
    """Return what writes a FITS picture, in an extension where the primary header states something."""

    def make(folder):
        kind = fits.ImageHDU if above else fits.PrimaryHDU
        unit = kind(flat() if picture is None else picture)
        unit.header.update({"IMAGETYP": "Light", "EXPTIME": 1.0} | cards)
        units = [fits.PrimaryHDU(header=fits.Header(above)), unit] if above else [unit]
        fits.HDUList(units).writeto(folder / "a.fits")
        return folder / "a.fits"

    return make


def in_tiff(*tags, picture=None, name="a.tif", seconds=(8, 1000), **how):
    """Return what writes a TIFF of 8 ms with further tags."""

    def make(folder):
        own = [(33434, "2I", 1, seconds, True)] if seconds else []
        inputs.tiff(folder / name, [flat() if picture is None else picture], [[*own, *tags]], **how)
        return folder / name

    return make


def one_directory_of_four(folder):
    """Write ImageJ's form of a large stack: four pictures, one directory."""
    path = folder / "stack_8ms.tif"
    tifffile.imwrite(path, np.stack([flat(level=LEVEL + 100 * n) for n in range(4)]), imagej=True)
    content = bytearray(path.read_bytes())
    order = ">" if content[:2] == b"MM" else "<"
    first = struct.unpack(f"{order}I", content[4:8])[0]
    entries = struct.unpack(f"{order}H", content[first : first + 2])[0]
    content[first + 2 + 12 * entries : first + 6 + 12 * entries] = bytes(4)
    path.write_bytes(content)
    return path


def in_ome(plane, pixels="", channel=""):
    """Return what writes an OME-TIFF of one page."""

    def make(folder):
        xml = (
            '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
            '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="24" SizeY="16" SizeZ="1" SizeC="1" '
            f'SizeT="1" {pixels}>{channel}<TiffData/><Plane TheZ="0" TheC="0" TheT="0" {plane}/></Pixels></Image></OME>'
        )
        tifffile.imwrite(folder / "a.ome.tif", flat(), description=xml, metadata=None, photometric="minisblack")
        return folder / "a.ome.tif"

    return make


def scaled_integers(folder):
    """Write 16-bit numbers that the header scales by two."""
    unit = fits.PrimaryHDU(flat(np.int16))
    unit.header.update({"IMAGETYP": "Light", "EXPTIME": 1.0})
    unit.scale("int16", bscale=2.0, bzero=100.0)
    unit.writeto(folder / "a.fits")
    return folder / "a.fits"


def compressed_unsigned(folder):
    """Write unsigned numbers in a compressed extension."""
    unit = fits.CompImageHDU(flat(level=40_000))
    unit.header.update({"IMAGETYP": "Light", "EXPTIME": 1.0})
    fits.HDUList([fits.PrimaryHDU(), unit]).writeto(folder / "a.fits")
    return folder / "a.fits"


def black_levels_of_previews(folder):
    """Write a small picture, the sensor's one and a preview behind it, which have other black levels."""
    path = folder / "a.tif"
    exposure = (33434, "2I", 1, (8, 1000), True)
    with tifffile.TiffWriter(path) as writer:
        small = np.zeros((8, 12, 3), np.uint8)
        writer.write(small, photometric="rgb", subfiletype=1, subifds=2, metadata=None, extratags=[exposure])
        for picture, kind, black in ((flat(), 0, 256), (np.zeros((4, 6), np.uint8), 1, 0)):
            level = [(50714, "H", 1, black, True)]
            writer.write(picture, photometric="minisblack", subfiletype=kind, metadata=None, extratags=level)
    return path


def repeated(folder):
    """Write a header that states the exposure twice, 1 s and 10 s."""
    unit = fits.PrimaryHDU(flat())
    unit.header.extend([("IMAGETYP", "Light"), ("EXPTIME", 1.0)])
    unit.header.append(("EXPTIME", 10.0))
    unit.writeto(folder / "a.fits")
    return folder / "a.fits"


def ome_of(images, pages=1, **root):
    """Return what writes an OME-TIFF of some images, each given by what its pixels hold."""

    def make(folder):
        size = 'Type="uint16" SizeX="24" SizeY="16" SizeZ="1" SizeC="1" SizeT="2"'
        inner = "".join(
            f'<Image ID="Image:{n}"><Pixels ID="Pixels:{n}" DimensionOrder="XYZCT" {size}>{body}</Pixels></Image>'
            for n, body in enumerate(images)
        )
        attributes = "".join(f' {key}="{value}"' for key, value in root.items())
        space = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
        xml = f'<?xml version="1.0"?><OME xmlns="{space}"{attributes}>{inner}</OME>'
        stack = np.stack([flat()] * pages)
        tifffile.imwrite(folder / "a.ome.tif", stack, description=xml, metadata=None, photometric="minisblack")
        return folder / "a.ome.tif"

    return make


def plane(seconds, t=0):
    """Return the OME-XML of a plane's exposure."""
    return f'<Plane TheZ="0" TheC="0" TheT="{t}" ExposureTime="{seconds}"/>'


def of_uuid(t, uuid):
    """Return the OME-XML of where a plane is: in the first directory of the file of a UUID."""
    return f'<TiffData FirstT="{t}" IFD="0" PlaneCount="1"><UUID>{uuid}</UUID></TiffData>'


def interval(folder):
    """Write ImageJ's stack with the time from frame to frame, which is no exposure."""
    metadata = {"finterval": 0.5, "axes": "TYX"}
    tifffile.imwrite(folder / "a.tif", np.stack([flat()] * 3), imagej=True, metadata=metadata)
    return folder / "a.tif"


def pyramid(folder):
    """Write a picture with a smaller copy in a directory of it."""
    with tifffile.TiffWriter(folder / "a_8ms.tif") as writer:
        writer.write(flat(), subifds=1, metadata=None)
        writer.write(flat()[::2, ::2], subfiletype=1, metadata=None)
    return folder / "a_8ms.tif"


def signed(folder):
    """Write signed numbers below zero."""
    tifffile.imwrite(folder / "a_8ms.tif", flat(np.int16) - 1000)
    return folder / "a_8ms.tif"


GAIN = '<Channel ID="Channel:0:0" SamplesPerPixel="1"><DetectorSettings ID="D" Gain="100"/></Channel>'
CODES = np.random.default_rng(0).integers(500, 900, (64, 64)).astype(np.uint16)
COLOURS = np.stack([flat(), flat(level=400), flat(level=200)])
SHORTS = (50713, "H", 2, (2, 2), True)
STEPS = tuple(range(0, 4096, 4))
IMAGES: dict[str, tuple[Any, Facts, str]] = {
    "astroufsc/chimera/issues/102": (in_fits({"EXPTIME": -1.0, "IMAGETYP": "bias"}), {"s": 0.0}, ""),
    "desihub/desispec/issues/964": (in_fits({"EXPTIME": 15.0}, EXPTIME=60.0), {"s": 15.0}, "primary header"),
    "Keck-DataReductionPipelines/KPF-Pipeline/pull/646": (
        in_fits({"EXPTIME": 10.0, "ELAPSED": (12.3, "[s] actual exposure")}), {}, "ELAPSED 12.3"),
    "rzellem/EXOTIC/issues/1178": (in_fits({"GAIN": 360}, flat(np.uint8, 120)), {"bits": 8}, "gain is 360"),
    "astrogo/fitsio/issues/35": (in_fits({}, flat(level=40_000)), {"last": 40_000.0}, ""),
    "astropy/astropy/issues/4974": (in_fits({"BZERO": 32768.0}, flat(np.float32)), {}, "refused: full scale"),
    "LCOGT/banzai/issues/479": (in_fits({"BUNIT": "electron"}), {}, "BUNIT"),
    "rate images": (in_fits({"BUNIT": "adu/s"}), {}, "BUNIT"),
    "indilib/indi/issues/292": (in_fits({"EPERADU": 0.5}), {"e/DN": 0.5}, ""),
    "scriptorron/indi_pylibcamera/issues/9": (in_fits({}, CODES * 16), {}, "multiples of 16"),
    "planes of colours": (in_fits({"CTYPE3": "RGB"}, COLOURS), {}, "refused: colours"),
    "planes that may be colours": (in_fits({}, COLOURS), {"frames": 3}, "three planes"),
    "a mosaic of rows in any order": (in_fits({"BAYERPAT": "RGGB"}), {}, "first stored row"),
    "a mosaic as one channel": (in_fits({"BAYERPAT": "RGGB", "XBINNING": 2}), {}, "several colours"),
    "spacetelescope/jwst/issues/7737": (in_fits({"NSUBEXP": 10}), {}, "10 frames were combined"),
    "stacks of smart telescopes": (in_fits({"STACKCNT": 60}), {}, "60 frames were combined"),
    "an exposure in words": (in_fits({"EXPTIME": "1/125"}), {"s": 0.008}, ""),
    "a decimal comma": (in_fits({"EXPTIME": "0,008"}), {"s": 0.008}, ""),
    "a dark nebula": (in_fits({"IMAGETYP": "", "OBJECT": "Dark Nebula B33"}), {"shutter": "open"}, "open is assumed"),
    "OBJECT for the kind": (in_fits({"IMAGETYP": "", "OBJECT": "Dark 10s"}), {"shutter": "closed"}, ""),
    "PEDESTAL of MaxIm": (in_fits({"PEDESTAL": -100}), {}, "PEDESTAL -100"),
    "Fahrenheit": (in_fits({"CCD-TEMP": (68.0, "[F] sensor")}), {"C": 20.0}, ""),
    "haraldk/TwelveMonkeys WhiteIsZero": (in_tiff(photometric="miniswhite"), {"last": 65_535.0 - LEVEL}, "0 is white"),
    "a palette": (in_tiff(picture=flat(level=60), photometric="palette", colormap=np.zeros((3, 65_536), np.uint16)),
                  {}, "refused: table of colours"),
    "scikit-image/scikit-image/issues/1929": (
        lambda p: tifffile.imwrite(p / "8ms.tif", flat(np.float32, 0.4)) or p / "8ms.tif", {}, "refused: full scale"),
    "emmanueltouzery/hsexif/issues/23": (
        in_tiff((37377, "2i", 1, (827, 100), True), seconds=None), {"s": 2.0**-8.27}, ""),
    "mattiasw/ExifReader/issues/201": (
        in_tiff((37377, "2i", 1, (-2_584_963, 1_000_000), True), seconds=None), {"s": 6.0}, ""),
    "mattiasw/ExifReader/issues/270": (in_tiff(seconds=(15, 10)), {"s": 1.5}, ""),
    "darktable-org/darktable/pull/6723": (in_tiff((37378, "2I", 1, (6, 1), True)), {"f": 8.0, "s": 0.008}, ""),
    "two exposures in EXIF": (in_tiff((37377, "2i", 1, (2, 1), True)), {"s": 0.008}, "ShutterSpeedValue 0.25"),
    "no exposure but APEX": (in_tiff((37377, "2i", 1, (7, 1), True), seconds=(0, 1)), {"s": 1 / 128}, ""),
    "jcelaya/hdrmerge/issues/5": (in_tiff((33437, "2I", 1, (0, 0), True)), {"f": None}, ""),
    "LibRaw/LibRaw/issues/107": (
        in_tiff((50713, "H", 2, (6, 6), True), (50714, "H", 36, (1022,) * 36, True)), {"black": 1022.0}, ""),
    "klauspost/rawspeed/issues/63": (
        in_tiff((50713, "H", 2, (2, 2), True), (50714, "H", 4, (10, 20, 20, 30), True)), {}, "differs by up to 20"),
    "LinearizationTable": (in_tiff((50712, "H", 1024, STEPS, True)), {"last": 3600.0}, "LinearizationTable"),
    "a large stack of ImageJ": (one_directory_of_four, {"frames": 4, "last": LEVEL + 300.0, "s": 0.008}, ""),
    "1/125 s in a name": (in_tiff(name="img_1-125s.tif", seconds=None), {}, "refused: 1/125 s or 125 s of number 1"),
    "0,5 s in a name": (in_tiff(name="img_0,5s.tif", seconds=None), {"s": 0.5}, ""),
    "basler/pypylon/issues/804": (
        in_tiff(picture=CODES * 16), {}, "multiples of 16"),
    "ome/ome-model/issues/176": (in_ome('ExposureTime="0.5"'), {"s": 0.5}, ""),
    "ome/bioformats/pull/601": (in_ome('ExposureTime="0.0005" ExposureTimeUnit="ks"'), {"s": 0.5}, ""),
    "ilastik/ilastik/pull/3093": (in_ome('ExposureTime="2" ExposureTimeUnit="frame"'), {}, "refused: frame"),
    "OME SignificantBits": (in_ome('ExposureTime="0.5"', 'SignificantBits="12"'), {"bits": 12}, ""),
    "OME DetectorSettings": (in_ome('ExposureTime="0.5"', "", GAIN), {"dB": 0.0}, "gain is 100"),
    "macro-consortium/pyscope/issues/125": (in_fits({"EXPTIME": None, "SUBEXP": None}), {}, "refused: exposure"),
    "WorldWideTelescope/wwt-web-client/issues/210": (scaled_integers, {}, "refused: full scale"),
    "astropy/astropy/issues/5999": (compressed_unsigned, {"last": 40_000.0}, ""),
    "RawTherapee/RawTherapee/issues/6443": (black_levels_of_previews, {"black": 256.0, "last": float(LEVEL)}, ""),
    "PHPExif/php-exif/pull/43": (in_tiff(seconds=(0, 1)), {}, "refused: exposure"),
    "LuminanceHDR/LuminanceHDR/issues/177": (
        in_tiff((37380, "2i", 1, (-2, 1), True), seconds=None), {}, "refused: exposure"),
    "OME DeltaT is no exposure": (in_ome('DeltaT="0.5"'), {}, "refused: exposure"),
    "astropy/ccdproc/issues/464": (repeated, {}, "refused: '1.0' or '10.0'"),
    "CARTAvis/carta-backend/issues/1492": (in_fits({"BLANK": -32768}), {}, "BLANK -32768"),
    "AstarVienna/ScopeSim/issues/464": (in_fits({"HIERARCH ESO DET NDIT": 10}), {}, "10 frames were combined"),
    "punch-mission/punchbowl/issues/63": (in_fits({"NSUMEXP": 3}), {}, "3 frames were combined"),
    "desihub/desispec/issues/1078": (in_fits({"LIVETIME": 60.0}), {"s": 1.0}, "LIVETIME 60"),
    "gordtulloch/astrofiler-gui/issues/47": (in_fits({"IMAGETYP": "FlatDark"}), {"shutter": "closed"}, ""),
    "indigo-astronomy/indigo/issues/387": (in_tiff(name="dark_flat.tif"), {"shutter": "closed"}, ""),
    "macro-consortium/pyscope/issues/346": (in_fits({"SHUTTER": "CLOSED"}), {"shutter": "open"}, "a closed shutter"),
    "indilib/indi-3rdparty/pull/1245": (in_fits({"EXPTIME": 0.0}), {}, "a bias frame is assumed"),
    "isbeorn/nina/issues/220": (in_fits({"EGAIN": -1.0}), {"e/DN": None}, "EGAIN states -1"),
    "the reciprocal of EGAIN": (in_fits({"EGAIN": (0.5, "[ADU/e-]")}), {"e/DN": 2.0}, ""),
    "tenths of a degree": (in_fits({"CCD-TEMP": (-100, "[0.1 C]")}), {"C": -10.0}, ""),
    "an exposure in hours and minutes": (in_fits({"EXPTIME": "00:00:30"}), {}, "refused: 00:00:30"),
    "an exposure beyond all": (in_fits({"EXPTIME": 1e30}), {}, r"refused: 1e\+30"),
    "a gain beyond all": (in_fits({"GAIN": (1e9, "[dB]")}), {"dB": 0.0}, "no gain is known"),
    "a pixel beyond all": (in_fits({"XPIXSZ": 1e40}), {}, "refused: pixel_pitch_um"),
    "cgohlke/tifffile/issues/61": (signed, {}, "refused: negative values"),
    "cgohlke/tifffile/issues/152": (interval, {}, "refused: exposure"),
    "geotiffjs/geotiff.js/issues/202": (pyramid, {"frames": 1, "last": float(LEVEL)}, ""),
    "immich-app/immich/issues/2601": (in_tiff((34855, "H", 3, (64, 0, 0), True)), {"dB": 0.0}, "iso unknown"),
    "two times in a name": (in_tiff(name="a_1s_2s.tif", seconds=None), {}, "refused: 1 s and 2 s"),
    "a power of ten in a name": (in_tiff(name="a_1.5e-3s.tif", seconds=None), {"s": 0.0015}, ""),
    "ome/bioformats/issues/3062": (
        ome_of([of_uuid(0, "urn:a") + of_uuid(1, "urn:b") + plane(0.5) + plane(2.0, 1)], UUID="urn:b"), {"s": 2.0}, ""),
    "ome/bioformats/pull/1839": (
        ome_of(['<TiffData IFD="1" PlaneCount="1"/>' + plane(2.0), '<TiffData IFD="0" PlaneCount="1"/>' + plane(0.5)],
               pages=2), {}, "refused: images .Image_1, Image_0"),
    "a temperature of the air": (in_fits({"TEMP": (31.0, "[C] ambient temperature")}), {"C": None}, ""),
    "a stack of another program": (in_fits({"NSTACK": 16}), {}, "16 frames were combined"),
    "ilastik/ilastik/issues/3092": (in_ome('ExposureTime="500" ExposureTimeUnit=""'), {}, "refused: exposure"),
    "sunpy/sunpy/pull/4882": (in_fits({"EXPTIME": 8.0, "TIMEUNIT": "ms"}), {"s": 0.008}, ""),
    "sunpy/sunpy/issues/6513": (in_fits({"EXPTIME": None, "XPOSURE": 0.008}), {"s": 0.008}, ""),
    "nfo.edu": (in_fits({"EXPTIME": (8.0, "exposure time in ms")}), {"s": 0.008}, ""),
    "AstroDMx": (in_fits({"EXPTIME": None, "EXPOINUS": 8000}), {"s": 0.008}, ""),
    "haraldk/TwelveMonkeys/issues/412": (inputs.stack, {"all s": list(inputs.SECONDS)}, ""),
    "black levels as shorts": (in_tiff(SHORTS, (50714, "H", 4, (256,) * 4, True)), {"black": 256.0}, ""),
    "timothybrooks/hdr-plus/issues/58": (
        in_tiff(SHORTS, (50714, "2I", 4, (256, 1) * 4, True)), {"black": 256.0}, ""),
    "darktable-org/rawspeed/pull/216": (
        in_tiff((50713, "H", 2, (1, 2), True), (50714, "H", 2, (256, 256), True)), {"black": 256.0}, ""),
    "dnglab/dnglab/issues/820": (
        in_tiff((50714, "2I", 1, (0, 1), True), (50716, "2i", 16, (256, 1) * 16, True)), {"black": 256.0}, ""),
    "black level deltas by column": (
        in_tiff((50714, "I", 1, 200, True), (50715, "2i", 24, (56, 1) * 24, True)), {"black": 256.0}, ""),
}  # fmt: skip


def check(read, path, facts, words):
    """Check what a reader gives: facts, words in a doubt, or words in a refusal."""
    if words.startswith("refused: "):
        with pytest.raises(RadiometerError, match=words.removeprefix("refused: ")):
            read(path)
        return
    found, doubts = read(path)
    for name, fact in facts.items():
        assert found[name] == (pytest.approx(fact, rel=1e-4) if isinstance(fact, float) else fact), name
    assert words in doubts
    assert words or not doubts or "open is assumed" in doubts or "means no" in doubts


@pytest.mark.parametrize(("make", "facts", "words"), IMAGES.values(), ids=IMAGES)
def test_pictures_are_read_as_their_headers_state(make, facts, words, tmp_path):
    """A value, a doubt or a refusal that names the cause."""
    check(read_image, make(tmp_path), facts, words)


NM = range(400, 701, 10)
POWER = [float(np.exp(-0.5 * ((nm - 560) / 40) ** 2)) + 0.001 for nm in NM]
LEVELS = range(0, 256, 15)
LIGHT = [0.2 + 230 * (n / 255) ** 2.2 for n in LEVELS]
MINUTES, LOGS = (0.5, 1, 2, 4, 8, 12, 20), (-1.0, -1.5, -2.0, -2.2, -2.6, -3.5, -4.5)


def european(number, places=1):
    """Return a number with points between thousands and a decimal comma."""
    return f"{number:,.{places}f}".translate(str.maketrans(",.", ".,"))


def spectrum(row, heading="wavelength_nm,power", *, falling=False):
    """Return a table of a spectrum about 560 nm."""
    rows = [row(nm, power) for nm, power in zip(NM, POWER, strict=True)]
    return "\n".join([heading, *(rows[::-1] if falling else rows)]) + "\n"


def ti3(keys, scale, full=100.0):
    """Return a file of ArgyllCMS, its Y times a factor and its RGB up to `full`."""
    rows = [f"{n} " + f"{n * full / 255:.4f} " * 3 + f"{v * scale:.5f}" for n, v in zip(LEVELS, LIGHT, strict=True)]
    names = "BEGIN_DATA_FORMAT\nSAMPLE_ID RGB_R RGB_G RGB_B XYZ_Y\nEND_DATA_FORMAT\n"
    return f"CTI3\n\n{keys}\n{names}BEGIN_DATA\n" + "\n".join(rows) + "\nEND_DATA\n"


def levels(heading, row):
    """Return a table of a screen."""
    return "\n".join([heading, *(row(n, v) for n, v in zip(LEVELS, LIGHT, strict=True))]) + "\n"


def nights(heading, row):
    """Return a log of four nights of five readings, each row given by its number in the night."""
    times = [(f"2026-03-{night:02d}T21:{10 * k:02d}:00", k) for night in range(1, 5) for k in range(5)]
    return "\n".join([heading, *(f"{time},{row(k)}" for time, k in times)]) + "\n"


def thresholds(heading, of_log):
    """Return a table of thresholds."""
    return "\n".join([heading, *(f"{t},{of_log(v):.6g}" for t, v in zip(MINUTES, LOGS, strict=True))]) + "\n"


WHITE = 'LUMINANCE_XYZ_CDM2 "218.7 230.2 253.2"'
NM_MEAN = {"nm": float(np.array(NM) @ POWER / np.sum(POWER))}
SCREEN = {"0": 0.2, "120": LIGHT[8], "255": 230.2}
METER = {"cd/m2": 1000.0, "s": 0.008, "iso": 100.0}
SKY = "utc,adu,exposure_s,temperature_c,sqm"
CURVE = {"min 0": 0.5, "log 0": -1.0}
PAIR = "1000,8,1/125,100\n2000,8,1/250,100\n"
TABLES: dict[str, tuple[Any, str, Facts, str]] = {
    "astropy/specreduce/issues/174": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p:.6f}", falling=True), NM_MEAN, ""),
    "jasp-stats/jasp-desktop/issues/403": (
        read_spectrum, spectrum(lambda n, p: f"{n};{european(1e6 * p)}", "nm;power"), NM_MEAN, ""),
    "no-break blanks between thousands": (
        read_spectrum, spectrum(lambda n, p: f"{n};{1e6 * p:,.1f}".replace(",", "\u202f"), "nm;power"), NM_MEAN, ""),
    "OpenCompare/OpenCompare/issues/143": (
        read_spectrum, spectrum(lambda n, p: f'"{n}","{p:.4f}"'.replace(".", ",")), {}, "refused: no number"),
    "ngscopeclient/scopehal/issues/494": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p:.4f}".replace(".", ",")), {}, "refused: decimal commas"),
    "publiclab/spectral-workbench/issues/365": (
        read_spectrum, spectrum(lambda n, p: f"{n}  {p:.6f}", "# a spectrum"), NM_MEAN, ""),
    "moviedo5/fda.usc/issues/7": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p:.6f}", "wavelength [mm],power"), {}, "refused: in mm"),
    "radis/radis/issues/707": (
        read_spectrum, spectrum(lambda n, p: f"{1e7 / n},{p}", "wavenumber [cm-1],power"), {}, "refused: wavenumber"),
    "radis/radis/pull/455": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p * n * n}", "nm,power per cm-1"), {}, "refused: per cm-1"),
    "kriswiner/AS7265X/issues/5": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p * n}", "nm,flux (umol/m2/s/nm)"), {}, "refused: umol"),
    "Ehlmann-research-group/WISER/issues/725": (
        read_spectrum, spectrum(lambda n, p: f"{n / 1e3},{p:.6f},,,,", "Wavelength_um,ARKSAW_18_G,,,,"), NM_MEAN, ""),
    "bryanhanson/ChemoSpec/issues/14": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p:.6f}", "freq,data"), {}, "refused: freq"),
    "ngscopeclient/scopehal-apps/issues/720": (
        read_spectrum, spectrum(lambda n, p: f"{n:.6E},{1e6 * p:.6E}"), NM_MEAN, ""),
    "publiclab/spectral-workbench/issues/140": (
        read_spectrum, spectrum(lambda n, p: f"0,{p:.6f}"), {}, "refused: wavelength"),
    "publiclab/spectral-workbench/issues/4": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p},{p / 2},{p / 3},{p / 4}", "Wavelength,Average,Red,Green,Blue"),
        {}, "refused: Average, Red"),
    "PMassicotte/eemR/issues/45": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p},{p / 2},{p / 3}", '"EM Wavelength/EX Wavelength",200,205,210'),
        {}, "refused: 4 columns"),
    "mm2/Little-CMS/issues/250": (read_screen, ti3('"NORMALIZED_TO_Y_100  ""NO"""', 1.0), {}, "refused: absolute"),
    "dgbowl/yadg/issues/95": (
        read_screen, ti3(f'{WHITE.replace(".", ",")}\nNORMALIZED_TO_Y_100 "YES"', 100 / 230.2), {}, "refused: 230,2"),
    "eoyilmaz/displaycal-py3/issues/443": (
        read_screen, ti3('NORMALIZED_TO_Y_100 "NO"', 1.0).replace("230.20000", "-nan(ind)"), {}, "refused: nan"),
    "ZEISS/czicompress/issues/39": (
        read_screen, levels("level,Lv", lambda n, v: f"{n},{v:.2f}".replace(".", ",")), {}, "refused: decimal"),
    "a second table in a .ti3": (
        read_screen, ti3('NORMALIZED_TO_Y_100 "NO"', 1.0) + ti3(f'{WHITE}\nNORMALIZED_TO_Y_100 "YES"', 2.0),
        SCREEN, ""),
    "RobTillaart/Max44009/issues/15": (
        read_screen, levels("level,Lv", lambda n, v: f"{n},{99999999 if n == 255 else v}"), {}, r"refused: 1e\+08"),
    "pacsdisplay/pacsdisplay/issues/3": (
        read_screen, levels("level,Lv", lambda n, v: f"{n},{v if n else '<0.3'}"), {}, "refused: <0.3"),
    "a heading twice": (read_screen, levels("level,Lv,Lv", lambda n, v: f"{n},{v},{2 * v}"), {}, "refused: may both"),
    "levels of 12 bits": (
        read_screen, levels("level,Lv", lambda n, v: f"{n * 4095 / 255:.0f},{v}"), {}, "refused: 4095"),
    "levels up to 100": (
        read_screen, levels("level,Lv", lambda n, v: f"{n * 100 / 255:.4f},{v}"), {}, "refused: without a unit"),
    "jasp-stats/jasp-issues/issues/3608": (
        read_screen, levels("Stufe;Leuchtdichte", lambda n, v: f"{n};{v:.3f}".replace(".", ",")), SCREEN, "no unit"),
    "a running number": (
        read_screen, levels("No,level,Lv (cd/m2)", lambda n, v: f"{n // 15 + 1},{n},{v:.4f}"), SCREEN, ""),
    "pkgforge-dev/Anylinux-AppImages/issues/390": (
        read_screen, levels("R,G,B,cd/m2", lambda n, v: f"{n},{n},{n},{v:.4f}"), SCREEN, ""),
    "columns swapped": (read_screen, levels("luminance,level", lambda n, v: f"{v:.4f},{n}"), SCREEN, "no unit"),
    "a second line of units": (
        read_screen, levels("level,Lv\n[8bit],[mcd/m2]", lambda n, v: f"{n},{1e3 * v}"), SCREEN, ""),
    "BurntSushi/xsv/issues/245": (
        read_meter, "luminance,f_number,time,iso\nkcd/m2,,ms,\n1,8,8,100\n2,8,4,100\n", METER, ""),
    "colour-science/colour/issues/796": (
        read_spectrum, spectrum(lambda n, p: f"{n},{p}", "Spectral Data 5[nm]\n") + "Spectral Data 1[nm]\n" + spectrum(
            lambda n, p: f"{n},{p}"), {}, "refused: cells"),
    "luox-app/luox/pull/67": (
        read_spectrum, spectrum(lambda n, p: f"<SpectralData wavelength=\"{n}\">{p}</SpectralData>"), {},
        "refused: wavelength"),
    "units in the cells": (read_spectrum, spectrum(lambda n, p: f"{n}nm;{p}", "wl;power"), NM_MEAN, ""),
    "a quantum efficiency": (read_spectrum, spectrum(lambda n, p: f"{n},{p}", "nm,QE"), {}, "refused: per photon"),
    "an absorbance": (
        read_spectrum, spectrum(lambda n, p: f"{n},{-np.log10(p)}", "nm,absorbance"), {}, "refused: absorbance"),
    "indilib/indi-3rdparty/pull/203": (read_times, "p.jpg 1m\n", {}, "refused: 1m"),
    "horshack-dpreview/Canomate/issues/3": (read_times, 'p.jpg 30"\n', {}, "refused: 30"),
    "a decimal comma and a unit": (read_times, "p.jpg 2,5s\n", {}, "refused: decimal comma"),
    "gphoto/gphoto2/issues/326": (read_times, "p.jpg 3.8s\n", {"p.jpg": 3.8}, ""),
    "a time beyond all": (read_times, "p.jpg 1e30\n", {}, r"refused: 1e\+09 s"),
    "astrorama/SourceXtractorPlusPlus/pull/113": (
        read_nights, nights(SKY, lambda k: f"{3e4 + k},0.5,20,{99.99 if k == 2 else 20 + k / 10}"), {"rows": 16},
        "above 30 mag is no reading"),
    "ropensci/nasapower/issues/36": (
        read_nights,
        nights("utc,adu,exposure_s,gain_db,sqm", lambda k: f"{3e4 + k},0.5,{-999 if k == 2 else 6},20.{k}"),
        {"rows": 16}, "the gain is unknown"),
    "a time of 65535": (read_means, "exposure_ms,mean,variance\n65535,120,4\n2,140,5\n5,200,6\n", {}, "refused: 65535"),
    "logarithms of ucd/m2": (
        read_thresholds, thresholds("time_min,log threshold (ucd/m2)", lambda v: v + 6), CURVE, ""),
    "Argyll relative": (read_screen, ti3(f'{WHITE}\nNORMALIZED_TO_Y_100 "YES"', 100 / 230.2), SCREEN, ""),
    "Argyll absolute": (read_screen, ti3('NORMALIZED_TO_Y_100 "NO"', 1.0), SCREEN, ""),
    "old Argyll, relative": (read_screen, ti3(WHITE, 100 / 230.2), SCREEN, ""),
    "old Argyll, absolute": (read_screen, ti3(WHITE, 1.0), SCREEN, ""),
    "old Argyll, unknown": (read_screen, ti3("", 100 / 230.2), {}, "refused: whether its XYZ are absolute"),
    "RGB of 8 bits in .ti3": (read_screen, ti3('NORMALIZED_TO_Y_100 "NO"', 1.0, 255.0), {}, "refused: above 100"),
    "points between thousands": (
        read_screen, levels("level;Lv (mcd/m2)", lambda n, v: f"{n};{european(1e3 * v)}"), SCREEN, ""),
    "commas between thousands": (
        read_screen, levels("level;Lv (mcd/m2)", lambda n, v: f"{n};{1e3 * v:,.1f}"), SCREEN, ""),
    "chromaticity y": (
        read_screen, levels("level,x,y,Y (cd/m2)", lambda n, v: f"{n},0.313,0.329,{v:.4f}"), SCREEN, ""),
    "lux": (read_screen, levels("level,illuminance (lx)", lambda n, v: f"{n},{v}"), {}, "refused: luminance"),
    "no reading": (read_screen, levels("level,Lv", lambda n, v: f"{n},{v if n else -1}"), {}, "refused: missing"),
    "blanks about the stroke": (read_times, "p.jpg 1 / 125\n", {"p.jpg": 0.008}, ""),
    "milliseconds in the heading": (read_times, "file;time [ms]\np.jpg;8\n", {"p.jpg": 0.008}, ""),
    "another column second": (read_times, "file,iso,time\np.jpg,100,0.008\n", {}, "refused: iso"),
    "stops": (read_times, "file,Tv\np.jpg,7\n", {}, "refused: Tv"),
    "a decimal comma in a list": (read_times, "p.jpg;0,008\n", {}, "refused: decimal comma"),
    "sensor in Fahrenheit": (
        read_nights, nights(SKY.replace("temperature_c", "temp (F)"), lambda k: f"{3e4 + k},0.5,68,20.{k}"),
        {"C 0": 20.0}, ""),
    "a colour temperature is in mired": (
        read_nights, nights("utc,adu,exposure_s,sqm,cct_k", lambda k: f"{3e4 + k},0.5,20.{k},4000"),
        {"colour": 250.0}, ""),
    "a colour index is none": (
        read_nights, nights("utc,adu,exposure_s,sqm,b_v", lambda k: f"{3e4 + k},0.5,20.{k},0.6"), {"colour": 0.6}, ""),
    "0 mag is no reading": (
        read_nights, nights(SKY, lambda k: f"{3e4 + k},0.5,20,{0 if k == 2 else 20}.{0 if k == 2 else k}"),
        {"rows": 16}, "0 mag is no reading"),
    "-999 degrees": (
        read_nights, nights(SKY, lambda k: f"{3e4 + k},0.5,{-999 if k == 2 else 20},20.{k}"), {"rows": 16}, "unknown"),
    "saturated readings": (
        read_nights, nights(SKY, lambda k: f"{65535 if k == 2 else 3e4 + k},0.5,20,20.{k}"), {"rows": 16}, "65535 DN"),
    "exposures as fractions": (
        read_nights, nights(SKY, lambda k: f"{3e4 + k},1/{k + 2},20,20.{k}"), {"s": 0.5, "rows": 20}, ""),
    "a meter in foot-lamberts": (
        read_meter, f"luminance (fL),f_number,time,iso\n{PAIR}", METER | {"cd/m2": 3426.259}, ""),
    "a meter in ms": (read_meter, "luminance,f_number,time_ms,iso\n1000,8,8,100\n2000,8,4,100\n", METER, ""),
    "denominators of times": (
        read_meter, "luminance,f_number,time,iso\n100,8,125,100\n200,8,62.5,100\n", {}, "refused: another unit"),
    "ISO with DIN": (
        read_meter, "luminance,f_number,time,iso\n100,8,1/125,100/21°\n200,8,1/250,100/21°\n", {}, "refused: 100/21"),
    "shares of full scale": (
        read_means, "exposure_ms,mean,variance\n1,0.03,1e-6\n2,0.05,2e-6\n5,0.2,5e-6\n", {}, "refused: shares of"),
    "a standard deviation": (read_means, "exposure_ms,mean,std\n1,120,4\n2,140,5\n5,200,6\n", {"var 0": 16.0}, ""),
    "thresholds of two eyes": (
        read_thresholds, "eye,time_min,log10_threshold\nOD,1,-1\nOS,2,-2\nOD,3,-3\n", {}, "refused: several .eye"),
    "statistics of three colours": (
        read_means, "channel,exposure_ms,mean,variance\nR,1,120,4\nG,1,240,8\nB,1,60,2\n", {}, "refused: several"),
    "temperatures without a unit": (
        read_means, "exposure_ms,mean,variance,temp\n1,120,4,68\n2,140,5,68\n5,200,6,68\n", {}, "refused: --map temp"),
    "counts of a spectrometer": (
        read_spectrum, spectrum(lambda n, p: f"{n},{900 + 1e4 * p:.0f}", "nm,power (counts)"), {}, "refused: counts"),
    "denominators in a list": (read_times, "p.jpg 125\nq.jpg 250\n", {}, "refused: 1/125"),
    "times of a zone": (
        read_nights, nights("time (CET),adu,exposure_s,sqm", lambda k: f"{3e4 + k},0.5,20.{k}"), {}, "refused: CET"),
    "thresholds whose u is of logarithms": (
        read_thresholds, "time_min,threshold (mcd/m2),u_log10\n0.5,100,0.1\n2,10,0.1\n", CURVE, ""),
    "apostilbs": (
        read_thresholds, thresholds("time_min,threshold (asb)", lambda v: np.pi * 10**v), CURVE, ""),
}  # fmt: skip


@pytest.mark.parametrize(("read", "text", "facts", "words"), TABLES.values(), ids=TABLES)
def test_tables_are_read_as_their_headings_state(read, text, facts, words, tmp_path):
    """A value, a doubt or a refusal that names the cause."""
    path = tmp_path / "exposures.csv"
    path.write_text(text, encoding="utf-8")
    check(read, path, facts, words)
