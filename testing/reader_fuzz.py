"""Damages files and reads them: `python reader_fuzz.py FOLDER COUNT [--random]`; fails where a reader does.

Hypothesis chooses the damage and, where a reader fails, finds the least that makes it fail.
"""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import os
import resource
import struct
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
import tifffile
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from radiometer.adaptation.journal import read_events
from radiometer.adaptation.threshold_files import read_table
from radiometer.analysis.exports.curves import read_curves, write_curves
from radiometer.analysis.photometry.photometry import spectrum_from_csv
from radiometer.archive.history import read_histories
from radiometer.data import Calibration, CaptureSet, ResponseCurve
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.storage import read_yaml
from radiometer.errors import RadiometerError
from radiometer.importing.emva_listing import EmvaListing
from radiometer.importing.fits_files import read_fits_headers, read_fits_pixels
from radiometer.importing.photograph_pixels import read_photograph
from radiometer.importing.photograph_times import read_exif, read_list
from radiometer.importing.statistics_table import read_statistics_table
from radiometer.importing.tiff_files import read_tiff_headers, read_tiff_pixels
from radiometer.importing.xmp import read_xmp
from radiometer.screen.measured_elsewhere import read_screen_readings
from simulators.scenes.image_file import ImageScene

_WORDS = (
    b"\xff\xff\xff\xff",
    b"\x00\x00\x00\x00",
    b"\x7f\xff\xff\xff",
    b"[" * 200,
    b"{a: " * 100,
    b"- " * 100,
    b"9" * 30,
    b"&a [*a]",
    b"1e999",
    b"nan",
    b"\x00",
    b"!!python/object",
    b"0x" + b"f" * 20,
)


# One damage: what is done, where in the file (a share of its length), with which word, byte or length.
DAMAGES = st.lists(
    st.tuples(
        st.sampled_from(["over", "into", "cut", "byte", "end", "twice", "digit"]),
        st.floats(0.0, 1.0),
        st.sampled_from(_WORDS),
        st.integers(0, 255),
    ),
    min_size=1,
    max_size=4,
)


def damaged(content: bytes, damages: list[tuple[str, float, bytes, int]]) -> bytes:
    """Return bytes with a few places changed, cut, doubled or filled with what hurts."""
    found = bytearray(content)
    for kind, share, word, number in damages:
        at = min(int(share * len(found)), max(0, len(found) - 1))
        match kind:
            case "over":
                found[at : at + len(word)] = word
            case "into":
                found[at:at] = word
            case "cut":
                del found[at : at + 1 + number % 64]
            case "byte":
                found[at : at + 1] = bytes([number])
            case "end":
                del found[at:]
            case "twice":
                found[at:at] = found[at : at + 300]
            case "digit":  # a number that is still one, in a head that is still understood
                digits = [i for i in range(at, min(at + 64, len(found))) if chr(found[i]).isdigit()]
                for i in digits[:1]:
                    found[i : i + 1] = b"%d" % (number % 10) if number < 200 else b"9" * (number - 195)
    return bytes(found)


def seeds(folder: Path) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return for each kind of file a good one and its reader."""
    dn = (np.arange(600, dtype=np.uint16) * 7).reshape(20, 30)
    colour = np.stack([dn, dn, dn], axis=-1).astype(np.uint8)
    for name, picture in (("a.png", dn), ("c.png", colour), ("c.jpg", colour), ("c.tif", colour)):
        cv2.imwrite(str(folder / name), picture)
    tifffile.imwrite(folder / "t.tif", dn, description="exposure 0.01 s")
    capture = "format: radiometer-capture/1\ncamera: {bit_depth: 12}\nframes:\n  - {file: a.png, exposure_s: 0.01}\n"
    g = np.log((np.arange(256) + 0.5) / 128.5)
    curve = ResponseCurve(g, np.full(256, 0.01))
    curve.write(folder / "r.yaml")
    root = Path(__file__).resolve().parents[1]
    calibration = read_yaml(root / "configs/calibrations/simulated.yaml")
    calibration.pop("response")  # long, and fuzzed by itself
    made = {
        "capture.yaml": (capture.encode(), lambda path: CaptureSet.read(path.parent)),
        "calibration.yaml": (yaml.safe_dump(calibration).encode(), Calibration.read),
        "response.yaml": ((folder / "r.yaml").read_bytes(), ResponseCurve.read),
        "response.csv": (curve.to_csv().encode(), ResponseCurve.read),
        "bench.yaml": ((root / "configs/bench-simulated.yaml").read_bytes(), read_yaml),
        "frame.png": ((folder / "a.png").read_bytes(), read_digital_numbers),
        "frame.tif": ((folder / "t.tif").read_bytes(), read_digital_numbers),
        "photo.png": ((folder / "c.png").read_bytes(), read_photograph),
        "photo.jpg": ((folder / "c.jpg").read_bytes(), lambda path: (read_photograph(path), read_exif(path))),
        "photo.tif": ((folder / "c.tif").read_bytes(), read_photograph),
        "raw.tif": ((folder / "t.tif").read_bytes(), lambda p: (read_tiff_headers(p), read_tiff_pixels(p, 0))),
        "exposures.txt": (b"a.png 1/125\nb.png 0.5\nc.png 2\n", read_list),
        "packet.xmp": (
            b"<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>"
            b"<rdf:Description xmlns:c='urn:c' c:BlackCurrent='64'/></rdf:RDF></x:xmpmeta>",
            lambda path: read_xmp(path.read_bytes()),
        ),
    }
    return made | _pictures(folder) | _texts(folder) | _fits(folder, dn)


def _fits(folder: Path, dn: Any) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    try:
        from astropy.io import fits
    except ImportError:
        return {}
    fits.PrimaryHDU(dn).writeto(folder / "f.fits")
    return {"frame.fits": ((folder / "f.fits").read_bytes(), lambda p: (read_fits_headers(p), read_fits_pixels(p, 0)))}


def _pictures(folder: Path) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return the forms that radiance maps and scenes come in."""
    picture = np.linspace(0.1, 5.0, 24 * 16 * 3, dtype=np.float32).reshape(16, 24, 3)
    cv2.imwrite(str(folder / "p.hdr"), picture)
    np.save(folder / "p.npy", picture)
    made: dict[str, tuple[bytes, Callable[[Path], Any]]]
    made = {name: ((folder / name).read_bytes(), _picture) for name in ("p.hdr", "p.npy")}
    with contextlib.suppress(ImportError):
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": picture}).write(str(folder / "p.exr"))
        made["p.exr"] = ((folder / "p.exr").read_bytes(), _picture)
    return made


def _texts(folder: Path) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return curves of other programs and tables, and a descriptor whose images are there."""
    g = np.log((np.arange(256) + 0.5) / 128.5)
    curves = {"mono": ResponseCurve(g, np.full(256, 0.01))}
    for name in ("c.m", "c.rsp"):
        write_curves(folder / name, curves)
    listing = b"# EMVA1288 Data\nv 3.1\nn 12 30 20\nb 10000.0 2500.5\ni a.png\ni a.png\nd 10000.0\ni a.png\ni a.png\n"
    statistics = b"exposure_ms,mean_dn,variance_dn2,kind\n1,20.5,4.1,dark\n1,200.5,14.1,light\n2,400.1,24.2,light\n"
    thresholds = b"# subject: A\ntime_min;log10 threshold;sigma\n0,5;1,2;0,1\n1,5;0,4;0,1\n12;-2,1;0,1\n20;-3,3;0,1\n"
    screen = b"level,cd/m2\n0,0.2\n64,10.1\n128,50.3\n255,240.0\n"
    spectrum = b"wavelength_nm,power\n" + b"".join(b"%d,%d.5\n" % (nm, nm % 90) for nm in range(400, 720, 10))
    results = b"captured,quantity,patch,value,u,unit,status\n" + b"".join(
        b"%d,radiance,p,1.0%d,0.01,W,ok\n" % (1_700_000_000 + 86_400 * n, n % 7) for n in range(12)
    )
    return {
        "curve.m": ((folder / "c.m").read_bytes(), read_curves),
        "curve.rsp": ((folder / "c.rsp").read_bytes(), read_curves),
        "EMVA1288_Data.txt": (listing, EmvaListing.read),
        "statistics.csv": (statistics, read_statistics_table),
        "statistics.json": (b'[{"exposure_s": 0.1, "mean": 20.5, "variance": 4.5}]', read_statistics_table),
        "thresholds.csv": (thresholds, read_table),
        "screen.csv": (screen, read_screen_readings),
        "spectrum.csv": (spectrum, spectrum_from_csv),
        "results.csv": (results, lambda path: read_histories(path, "radiance")),
    }


def bombs() -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return files that say little and ask for much, by name, each with the reader that must refuse it."""
    nested = b"[" * 100_000
    loop = b"II*\x00" + struct.pack("<IHI", 8, 0, 8)  # one directory without entries, whose next one is itself
    deflated = io.BytesIO()
    tifffile.imwrite(deflated, np.arange(10_000, dtype=np.uint16).reshape(100, 100), compression="zlib")
    damaged_deflate = bytearray(deflated.getvalue())
    with tifffile.TiffFile(io.BytesIO(deflated.getvalue())) as tiff:
        damaged_deflate[tiff.pages[0].dataoffsets[0] + 5] ^= 0xFF
    zeros = bytes(65_000_000)
    return {
        "unpacking.rda": (bz2.compress(b"RDX3\n" + zeros, 1), read_table),
        "unpacking.rds": (gzip.compress(b"X\n" + zeros, 1), read_table),
        "range.txt": (b"list(time = 1:200000000, thrs = 1:200000000)", read_table),
        "unclosed.txt": (b"time = c(" * 40_000, read_table),
        "loop.tif": (loop, lambda p: (read_tiff_headers(p), read_tiff_pixels(p, 0))),
        "loop-frame.tif": (loop, read_digital_numbers),
        "loop-photo.tif": (loop, read_photograph),
        "deflate.tif": (bytes(damaged_deflate), lambda p: read_tiff_pixels(p, 0)),
        "numbers.ti3": (
            b"CTI3\nNUMBER_OF_FIELDS 1e99\nNUMBER_OF_SETS 9\nBEGIN_DATA\n1 2\nEND_DATA\n",
            read_screen_readings,
        ),
        **_compressed_fits(),
        "nested.json": (nested, read_statistics_table),
        "nested.yaml": (nested, read_yaml),
        "nested.jsonl": (b'{"sequence": 0, "a": ' + nested + b"\n", lambda p: list(read_events(p))),
        "numbers.jsonl": (b'{"sequence": 0, "a": ' + b"9" * 10_000 + b"}\n" + b"[]\n", lambda p: list(read_events(p))),
    }


def _compressed_fits() -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return a compressed FITS picture with wrong bytes in its data."""
    try:
        from astropy.io import fits
    except ImportError:
        return {}
    stream, dn = io.BytesIO(), np.random.default_rng(1).integers(0, 4096, (40, 50)).astype(np.int16)
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(dn, compression_type="GZIP_1")]).writeto(stream)
    content = bytearray(stream.getvalue())
    at = content.index(b"\x1f\x8b") + 12
    content[at : at + 4] = b"\xff\xff\xff\xff"
    return {"compressed.fits": (bytes(content), lambda p: (read_fits_headers(p), read_fits_pixels(p, 0)))}


def _picture(path: Path) -> Any:
    return ImageScene(file=path).render(8, 8)


def _read_damaged(
    path: Path,
    content: bytes,
    read: Callable[[Path], Any],
    refused: list[int],
    damages: list[tuple[str, float, bytes, int]],
) -> None:
    spoilt = damaged(content, damages)
    path.write_bytes(spoilt)
    refused[0] += 1
    try:
        read(path)
    except RadiometerError as error:
        refused[1] += 1
        if not str(error).strip():
            raise


def _reads(read: Callable[[list[tuple[str, float, bytes, int]]], None], count: int, *, at_random: bool) -> None:
    """Read a file with many kinds of damage; the least that a reader fails on is what the error shows."""

    @settings(
        max_examples=count, database=None, derandomize=not at_random, deadline=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(DAMAGES)
    def damages_of_all_kinds(damages: list[tuple[str, float, bytes, int]]) -> None:
        read(damages)

    damages_of_all_kinds()


def main() -> int:
    """Read damaged files of each kind; tell the least damage that a reader does not refuse as it should."""
    folder, count, at_random = Path(sys.argv[1]), int(sys.argv[2]), "--random" in sys.argv
    warnings.simplefilter("ignore")
    for name, (content, read) in seeds(folder).items():
        place = folder / f"fuzz-{name.replace('.', '-')}"
        place.mkdir()
        (place / "a.png").write_bytes((folder / "a.png").read_bytes())
        (place / name).write_bytes(content)
        read(place / name)  # a seed that is refused would let nothing past the head
        refused = [0, 0]

        _reads(partial(_read_damaged, place / name, content, read, refused), count, at_random=at_random)
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        sys.stdout.write(f"{refused[0]} files of {name}: {refused[1]} refused; peak {peak_mb:.0f} MB\n")
        sys.stdout.flush()
    packed = io.BytesIO()
    with gzip.open(packed, "wb", 1) as stream:  # in pieces: this process has no room for all of it
        stream.write(b"II*\x00")
        for _ in range(85):
            stream.write(bytes(10_000_000))
    large = {"unpacking.tif.gz": (packed.getvalue(), read_tiff_headers)}
    for name, (content, read) in (bombs() | large).items():
        (folder / name).write_bytes(content)
        with contextlib.suppress(RadiometerError):
            read(folder / name)
            sys.stderr.write(f"{name} was read\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
