"""Damages files and reads them: `python reader_fuzz.py FOLDER COUNT SEED`; exit code 1 where a reader does not refuse.

Every reader gets COUNT files: files that no reader may take (bombs, nesting, loops, noise), then a good file with one
to four damages drawn by chance. It returns, or raises one of our own errors of one line.
"""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import lzma
import os
import random
import resource
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
import tifffile
import yaml

import radiometer as rm
from radiometer.adaptation.threshold_files import read_table
from radiometer.analysis.exports.curves import read_curves, write_curves
from radiometer.analysis.exports.maps import MapPicture, write_tiff
from radiometer.analysis.photometry.photometry import spectrum_from_csv
from radiometer.archive.trend import read_histories
from radiometer.bench.boxes import read_preset
from radiometer.data import Calibration, CaptureSet, RadianceMap, ResponseCurve
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.event_journal import read_events
from radiometer.data.light_calibration import LightCalibration
from radiometer.data.storage import read_yaml
from radiometer.errors import RadiometerError
from radiometer.importing.emva_listing import EmvaListing
from radiometer.importing.exif import read_xmp
from radiometer.importing.fits_files import read_fits_headers, read_fits_pixels
from radiometer.importing.light_tables import read_meter_table
from radiometer.importing.log_table import read_log
from radiometer.importing.photograph_pixels import read_photograph
from radiometer.importing.photograph_times import read_exif, read_list
from radiometer.importing.statistics_table import read_statistics_table
from radiometer.importing.tiff_files import read_tiff_headers, read_tiff_pixels
from radiometer.screen.measured_elsewhere import read_screen_readings
from simulators.scenes.kinds import ImageScene
from testing.sky_log import sky_log

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


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return bytes with one to four places changed, cut, doubled or filled with what hurts."""
    found = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at, word = rng.randrange(max(1, len(found))), rng.choice(_WORDS)
        match rng.choice(["over", "into", "cut", "byte", "end", "twice", "digit"]):
            case "over":
                found[at : at + len(word)] = word
            case "into":
                found[at:at] = word
            case "cut":
                del found[at : at + rng.randint(1, 64)]
            case "byte":
                found[at : at + 1] = bytes([rng.randrange(256)])
            case "end":
                del found[at:]
            case "twice":
                found[at:at] = found[at : at + 300]
            case "digit":  # a number that is still one, in a head that is still understood
                digits = [i for i in range(at, min(at + 64, len(found))) if chr(found[i]).isdigit()]
                for i in digits[:1]:
                    found[i : i + 1] = rng.choice([b"%d" % rng.randrange(10), b"9" * rng.randint(5, 60)])
    return bytes(found)


@cache
def hostile() -> tuple[bytes, ...]:
    """Return contents that no reader may stumble over, whatever the file is called."""
    zeros, deep = bytes(70_000_000), 100_000
    loop = b"II*\x00" + struct.pack("<IHI", 8, 0, 8)  # a directory whose next one is itself
    laughs = b"".join(b"a%d: &a%d [%s]\n" % (n, n, b", ".join([b"*a%d" % (n - 1)] * 10)) for n in range(1, 12))
    entities = b"".join(b'<!ENTITY e%d "%s">' % (n, b"&e%d;" % (n - 1) * 10) for n in range(1, 12))
    scans = b"\xff\xd8" + b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00" * 20_000
    return (
        b"", bytes(1_000_000), b"\n" * 1_000_000, b"," * 1_000_000, b"9" * 1_000_000, b"\xff" * 1_000_000,
        b"[" * deep, b"{" * deep, b'{"a":' * deep, b"(" * deep, b"- " * deep, b"a: [" * deep,
        gzip.compress(zeros, 1), bz2.compress(zeros, 1), lzma.compress(zeros, preset=0),
        gzip.compress(b"SIMPLE  =                    T" + zeros, 1), bz2.compress(b"RDX3\nX\n" + zeros, 1),
        loop, loop.replace(b"II*\x00", b"MM\x00*"), b"a0: &a0 x\n" + laughs,
        b'<!DOCTYPE x [<!ENTITY e0 "x">' + entities + b"]><x>&e11;</x>", scans,
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x10\x06\x00\x00\x00",
        b"v/1\x01" + zeros[:1_000_000],
        b"#?RADIANCE\n\n-Y 2000000000 +X 2000000000\n", b"1:2000000000", b"a,b\n" + b'"' * 1_000_000,
    )  # fmt: skip


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
    return (
        made
        | _pictures(folder)
        | _imported(folder)
        | _texts(folder)
        | _records(root)
        | _fits(folder, dn)
        | _apart(folder, dn)
    )


def _records(root: Path) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return what the program itself keeps, and what meters write."""
    rows = sky_log(1, nights=3, readings=20)
    log = ",".join(rows[0]) + "\n" + "".join(",".join(str(v) for v in row.values()) + "\n" for row in rows)
    event = b'{"sequence": %d, "kind": "trial", "time_s": 1.5, "log10": -2.5, "seen": true}\n'
    box = read_yaml(root / "configs/calibrations/simulated-box.yaml")
    return {
        "box.yaml": (yaml.safe_dump(box).encode(), LightCalibration.read),
        "preset.yaml": ((root / "configs/light_boxes/reference.yaml").read_bytes(), read_preset),
        "run.jsonl": (b"".join(event % n for n in range(5)), read_events),
        "meter.csv": (b"luminance,f_number,time,iso\n1000,8,1/125,100\n2000,8,1/250,100\n", read_meter_table),
        "log.csv": (log.encode(), read_log),
    }


def _apart(folder: Path, dn: Any) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return files whose library works in another process."""
    made: dict[str, tuple[bytes, Callable[[Path], Any]]] = {}
    cv2.imwrite(str(folder / "l.tif"), dn, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    made["lzw.tif"] = ((folder / "l.tif").read_bytes(), lambda path: read_tiff_pixels(path, 0))
    with contextlib.suppress(ImportError):
        import rawpy  # noqa: F401

        codes = (33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True)  # CFARepeatPatternDim, CFAPattern
        levels = (50714, "H", 1, 64, True), (50717, "I", 1, 4095, True)  # BlackLevel, WhiteLevel
        matrix = (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True)
        neutral, lamp = (50728, "2I", 3, (1,) * 6, True), (50778, "H", 1, 21, True)
        version, model = (50706, "B", 4, (1, 4, 0, 0), True), (50708, "s", 0, "Test Camera", True)
        tags = [*codes, version, model, *levels, matrix, neutral, lamp]
        tifffile.imwrite(folder / "r.dng", np.full((64, 96), 500, np.uint16), photometric=32803, extratags=tags)
        made["raw.dng"] = ((folder / "r.dng").read_bytes(), read_photograph)
    with contextlib.suppress(ImportError):
        import pandas as pd

        columns = {"captured": 1.7e9, "quantity": "radiance", "patch": "p", "value": 1.5, "u": 0.1, "unit": "W"}
        frame = pd.DataFrame([{**columns, "captured": 1.7e9 + 86_400.0 * n, "status": "ok"} for n in range(12)])
        frame.to_parquet(folder / "r.parquet")
        made["results.parquet"] = (folder / "r.parquet").read_bytes(), lambda path: read_histories(path, "radiance")
    with contextlib.suppress(ImportError):
        import rdata

        run = {"time": np.arange(9.0), "thrs": np.linspace(1.0, -3.0, 9)}
        rdata.write_rda(folder / "r.rda", {"dark": run})
        made["run.rda"] = ((folder / "r.rda").read_bytes(), read_table)
        rdata.write_rds(folder / "r.rds", run, compression=None)
        made["run.rds"] = ((folder / "r.rds").read_bytes(), read_table)
    with contextlib.suppress(ImportError):
        from astropy.io import fits

        for kind in ("RICE_1", "HCOMPRESS_1"):
            packed = fits.CompImageHDU(dn.astype(np.int16), compression_type=kind)
            fits.HDUList([fits.PrimaryHDU(), packed]).writeto(folder / f"{kind}.fits")
            content = (folder / f"{kind}.fits").read_bytes()
            made[f"{kind.lower()}.fits"] = content, lambda p: (read_fits_headers(p), read_fits_pixels(p, 0))
    return made


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


def _imported(folder: Path) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    """Return files that commands use to the end: a map of radiance, and frames without and with compression."""
    level, mask = np.full((20, 30), 0.5, np.float32), np.zeros((20, 30), np.uint8)
    write_tiff(folder / "map.tiff", MapPicture({"mono": RadianceMap(level, 0.01 * level, mask, "W sr-1 m-2", 0.02)}))
    dn = np.random.default_rng(2).integers(0, 4096, (32, 48)).astype(np.uint16)
    tifffile.imwrite(folder / "plain.tiff", dn, metadata=None)
    tifffile.imwrite(folder / "tiled.tiff", dn, tile=(16, 16), compression="zlib", predictor=True)

    def taken(path: Path) -> Any:
        with tempfile.TemporaryDirectory() as out:
            return rm.import_capture([path], Path(out) / "set", mapped=["exposure=0.02:s"])

    readers = {"map.tiff": lambda path: rm.analyse(path, regions={"a": (1, 1, 9, 9)})}
    names = ("map.tiff", "plain.tiff", "tiled.tiff")
    return {name: ((folder / name).read_bytes(), readers.get(name, taken)) for name in names}


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
        "nested.jsonl": (b'{"sequence": 0, "a": ' + nested + b"\n", read_events),
        "numbers.jsonl": (b'{"sequence": 0, "a": ' + b"9" * 10_000 + b"}\n" + b"[]\n", read_events),
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


@dataclass
class Fuzzed:
    """What became of the files of one reader.

    Attributes:
        count: Files read.
        refused: Those that were refused with one of our own errors.
        faults: What else was raised, and by which file.
        longest_s: Longest processor time of one file in s, with that of the process that reads apart.
    """

    count: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)
    longest_s: float = 0.0

    def read(self, path: Path, content: bytes, read: Callable[[Path], Any], what: str) -> None:
        """Write a file, read it, and see what comes of it."""
        path.write_bytes(content)
        begun_s = processor_s()
        self.count += 1
        try:
            read(path)
        except RadiometerError as error:
            self.refused += 1
            if not str(error).strip() or "\n" in str(error):
                self.faults.append(f"{what}: {str(error)!r} is no line")
        except Exception as error:  # noqa: BLE001 (this is what is looked for)
            self.faults.append(f"{what}: {type(error).__name__}: {error}")
        self.longest_s = max(self.longest_s, processor_s() - begun_s)


def processor_s() -> float:
    """Return the processor time of this process and of those it started, in s."""
    found, task = time.process_time(), Path("/proc/thread-self/children")
    for pid in task.read_text().split() if task.exists() else ():
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            found += (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return found


def fuzz(place: Path, name: str, count: int, seed: int, seeded: tuple[bytes, Callable[[Path], Any]]) -> Fuzzed:
    """Let one reader read so many files in a folder."""
    (content, read), found, rng = seeded, Fuzzed(), random.Random(f"{name} {seed}")
    for number, whole in enumerate(hostile()[:count]):
        found.read(place / name, whole, read, f"hostile {number}")
    while found.count < count:
        spoilt = damaged(content, rng)
        found.read(place / name, spoilt, read, f"file {found.count} of {name}, seed {seed}")
    return found


def main() -> int:
    """Fuzz every reader; print a line for each and, on standard error, what is to be corrected."""
    folder, count, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    warnings.simplefilter("ignore")
    failed = False
    for name, seeded in seeds(folder).items():
        place = folder / f"fuzz-{name.replace('.', '-')}"
        place.mkdir()
        (place / "a.png").write_bytes((folder / "a.png").read_bytes())
        (place / name).write_bytes(seeded[0])
        seeded[1](place / name)  # a seed that is refused would let nothing past the head
        found = fuzz(place, name, count, seed, seeded)
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{found.count} files of {name}: {found.refused} refused; {len(found.faults)} faults; longest"
            f" {found.longest_s:.2f} s; peak {peak_mb:.0f} MB",
            flush=True,
        )
        for fault in found.faults[:5]:
            print(f"{name}: {fault[:300]}", file=sys.stderr, flush=True)
        failed |= bool(found.faults)
    found = Fuzzed()
    found.read(folder / "a.tif.gz", _large_bomb(), read_tiff_headers, "850 MB once unpacked")
    print(f"850 MB once unpacked: {found.refused} refused; longest {found.longest_s:.2f} s", flush=True)
    return int(failed or not found.refused)


def _large_bomb() -> bytes:
    packed = io.BytesIO()
    with gzip.open(packed, "wb", 1) as stream:  # in pieces: this process has no room for all of it
        stream.write(b"II*\x00")
        for _ in range(85):
            stream.write(bytes(10_000_000))
    return packed.getvalue()


if __name__ == "__main__":
    sys.exit(main())
