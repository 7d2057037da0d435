"""Damages files at random and reads them: `python reader_fuzz.py FOLDER COUNT`; exit code 1 where a reader fails."""

from __future__ import annotations

import os
import random
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import cv2
import numpy as np
import tifffile

from drivers.photograph_pixels import read_photograph
from drivers.photograph_times import read_exif, read_list
from radiometer.data import Calibration, CaptureSet, ResponseCurve
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.storage import read_yaml
from radiometer.errors import RadiometerError
from radiometer.importing.emva_listing import EmvaListing
from radiometer.importing.fits_files import read_fits_headers, read_fits_pixels
from radiometer.importing.tiff_files import read_tiff_headers, read_tiff_pixels
from radiometer.importing.xmp import read_xmp

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


def damaged(rng: random.Random, content: bytes) -> bytes:
    """Return bytes with a few places changed, cut, doubled or filled with what hurts."""
    found = bytearray(content)
    for _ in range(rng.randrange(1, 5)):
        at = rng.randrange(len(found) + 1)
        match rng.randrange(5):
            case 0:
                found[at : at + 4] = rng.choice(_WORDS)
            case 1:
                found[at:at] = rng.choice(_WORDS)
            case 2:
                del found[at : at + rng.randrange(1, 64)]
            case 3 if found:
                found[at % len(found)] = rng.randrange(256)
            case _:
                found = found[: rng.randrange(len(found) + 1)] if rng.random() < 0.2 else found + found[at : at + 300]
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
    root = Path(__file__).resolve().parents[3]
    made = {
        "capture.yaml": (capture.encode(), lambda path: CaptureSet.read(path.parent)),
        "calibration.yaml": ((root / "configs/calibrations/simulated.yaml").read_bytes()[:6000], Calibration.read),
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
        "listing.txt": (b"# EMVA1288 Data\nv 3.1\nn 12 30 20\nb 10000 0.0 \ni dark/a.png\n", EmvaListing.read),
        "packet.xmp": (
            b"<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>"
            b"<rdf:Description xmlns:c='urn:c' c:BlackCurrent='64'/></rdf:RDF></x:xmpmeta>",
            lambda path: read_xmp(path.read_bytes()),
        ),
    }
    return made | _fits(folder, dn)


def _fits(folder: Path, dn: Any) -> dict[str, tuple[bytes, Callable[[Path], Any]]]:
    try:
        from astropy.io import fits
    except ImportError:
        return {}
    fits.PrimaryHDU(dn).writeto(folder / "f.fits")
    return {"frame.fits": ((folder / "f.fits").read_bytes(), lambda p: (read_fits_headers(p), read_fits_pixels(p, 0)))}


def main() -> int:
    """Read damaged files of each kind; tell the first that is not refused as it should be."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    warnings.simplefilter("ignore")
    rng = random.Random(5)
    for name, (content, read) in seeds(folder).items():
        place = folder / f"fuzz-{name.replace('.', '-')}"
        place.mkdir()
        (place / "a.png").write_bytes((folder / "a.png").read_bytes())
        refused = 0
        for number in range(count):
            spoilt = damaged(rng, content)
            (place / name).write_bytes(spoilt)
            try:
                read(place / name)
            except RadiometerError as error:
                refused += 1
                if not str(error).strip():
                    raise
            except BaseException as error:
                sys.stdout.write(f"{name} number {number}: {type(error).__name__}: {error}\n{spoilt[:300]!r}\n")
                raise
        sys.stdout.write(f"{count} files of {name}: {refused} refused\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
