"""Small files as public reports have them: right ones of other people's programs that were once misread."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from astropy.io import fits
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from testing.edge_devices import dng_bytes
from testing.photograph_folder import write_photographs

SECONDS = (0.01, 0.02, 0.05, 0.1)
_MATRIX = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)


def fits_frames(
    folder: Path, cards: Callable[[float], dict[str, Any]], *, level: float = 1e5, dark: float = 0.0, **kind: Any
) -> Path:
    """Write pairs of light and dark frames at four exposures: e⁻/s of light and of dark current above 100 DN.

    The gain is 0.5 DN/e⁻ and the noise 5 e⁻.
    """
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(1)
    scale, black = kind.pop("scale", 0.5), kind.pop("black", 100)
    for seconds in SECONDS:
        for name, rate in (("Light1", level + dark), ("Light2", level + dark), ("Dark1", dark), ("Dark2", dark)):
            electrons = rng.poisson(rate * seconds, (48, 48)) + rng.normal(0.0, 5.0, (48, 48))
            unit = fits.PrimaryHDU(np.rint(black + scale * electrons).clip(0, 65_535).astype(np.uint16))
            for key, value in {"IMAGETYP": name[:-1], "INSTRUME": "CAM", **kind, **cards(seconds)}.items():
                unit.header[key.replace("_", "-")] = value
            unit.writeto(folder / f"{name}_{scale}_{black}_{seconds}.fits")
    return folder


def tiff(path: Path, pages: Sequence[Any], tags: Sequence[Sequence[Any]], **options: Any) -> Path:
    """Write a TIFF, each page with separate tags."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tifffile.TiffWriter(path) as writer:
        for page, own in zip(pages, tags, strict=True):
            writer.write(
                np.asarray(page, np.uint16), extratags=own, metadata=None, contiguous=False,
                **{"photometric": "minisblack", **options},
            )  # fmt: skip
    return path


def flat(level: float, seed: int = 0) -> Any:
    """Return an even picture of a level in DN with noise of 4 DN."""
    return np.rint(np.random.default_rng(seed).normal(level, 4.0, (48, 64)))


def exposure_tag(seconds: float) -> tuple[Any, ...]:
    """Return the EXIF tag ExposureTime as a rational."""
    return (33434, "2I", 1, (round(seconds * 1e6), 1_000_000), True)


def stack(folder: Path, name: str = "s.tif") -> Path:
    """Write a TIFF of four pages, each with its exposure, which its name does not hold."""
    return tiff(folder / name, [flat(256 + 2e4 * s) for s in SECONDS], [[exposure_tag(s)] for s in SECONDS])


def screen(path: Path, heading: str, row: Callable[[int, int, float], str], *, comma: bool = False) -> Path:
    """Write a table of a screen of 0.2 + 230·(level/255)^2.2 cd/m² in steps of 15 levels."""
    lines = [row(i, n, 0.2 + 230 * (n / 255) ** 2.2) for i, n in enumerate(range(0, 256, 15), 1)]
    path.write_text("\n".join([heading, *(line.replace(".", ",") if comma else line for line in lines)]) + "\n")
    return path


def photographs(folder: Path) -> Path:
    """Write JPEGs of gamma 2.2 at ISO 25600 to 102400; the last stands as 65535 in the 16-bit tag."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(4)
    scene = np.exp(np.linspace(np.log(0.003), np.log(3), 128))[None, :] * np.linspace(1, 1.5, 96)[:, None]
    for n, (stops, iso) in enumerate(((10, 25_600), (10, 51_200), (10, 102_400), (8, 102_400), (6, 102_400))):
        light = scene * 2.0 ** (10 - stops) * iso / 102_400 / 4
        dn = 255 * np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, 0.5, light.shape)
        exif = Image.Exif()
        tags = exif.get_ifd(0x8769)
        tags[33434], tags[34855], tags[0x8830], tags[0x8832] = IFDRational(1, 2**stops), min(iso, 65_535), 2, iso
        Image.fromarray(dn.clip(0, 255).round().astype(np.uint8)).save(folder / f"p{n}.jpg", quality=98, exif=exif)
    return folder


def raw_photographs(folder: Path, photometric: int = 32803) -> Path:
    """Write two DNG of 1/100 and 1/25 s whose picture is in the first directory; 34892 is LinearRaw of one sample."""
    for n, (over, scale) in enumerate(((100, 1.0), (25, 4.0))):
        dn = np.rint(np.random.default_rng(n).normal(64 + scale * np.linspace(10, 800, 96) * np.ones((64, 1)), 5.0))
        tags = [
            (50706, "B", 4, (1, 4, 0, 0), True), (50708, "s", 0, "Test Camera", True), (50714, "H", 1, 64, True),
            (50717, "I", 1, 4095, True), (33434, "2I", 1, (1, over), True),
        ]  # fmt: skip
        if photometric == 32803:
            tags += [
                (33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True), (50721, "2i", 9, _MATRIX, True),
                (50728, "2I", 3, (1, 1) * 3, True), (50778, "H", 1, 21, True),
            ]  # fmt: skip
            tiff(folder / f"p{n}.dng", [dn], [tags], photometric=photometric)
        else:
            path = tiff(folder / f"p{n}.dng", [dn], [tags])
            with tifffile.TiffFile(path, mode="r+b") as file:
                file.pages[0].tags[262].overwrite(photometric)
    return folder


def fits_series(folder: Path, shots: Iterable[tuple[str, float, Any]], **cards: Any) -> Path:
    """Write FITS frames of kind, exposure in s and digital numbers, shape (height, width), with the same cards."""
    folder.mkdir(exist_ok=True)
    for kind, seconds, dn in shots:
        unit = fits.PrimaryHDU(np.rint(dn).clip(0, 65_535).astype(np.uint16))
        unit.header.update(
            {"EXPTIME": seconds, "IMAGETYP": kind, **{key.replace("_", "-"): one for key, one in cards.items()}}
        )
        unit.writeto(folder / f"{len(list(folder.iterdir())):02d}.fits")
    return folder


def ramp_bracket(folder: Path, top: int, step: int = 1, **cards: Any) -> Path:
    """Write FITS frames and darks of a ramp of 800 000 DN/s above 500 DN that saturates at a digital number."""
    rng = np.random.default_rng(6)
    means = [
        (kind, seconds, rate * seconds * np.linspace(0.02, 1, 96)[None, :] * np.ones((64, 1)))
        for seconds in (1 / 256, 1 / 64, 1 / 16, 1 / 4)
        for kind, rate in (("Light", 8e5), ("Dark", 0.0))
    ]
    drawn = ((kind, s, np.minimum(500 + rng.normal(mean, np.sqrt(0.5 * mean + 9)), top)) for kind, s, mean in means)
    return fits_series(folder, ((kind, s, np.floor(dn / step) * step) for kind, s, dn in drawn), **cards)


def raw_ramp(folder: Path, spread_dn: float, strays: int) -> Path:
    """Write DNG of a ramp of 240 000 DN/s in green whose sensor saturates at 15 780 DN, the tag stating 16 383."""
    rng = np.random.default_rng(3)
    times, files = (1 / 256, 1 / 64, 1 / 16, 1 / 4), []
    colour = np.ones((128, 192))
    colour[0::2, 0::2], colour[1::2, 1::2] = 0.5, 0.3
    for seconds in times:
        mean = 240_000 * seconds * np.linspace(0.02, 1, 192)[None, :] * colour
        dn = 600 + rng.normal(mean, np.sqrt(0.3 * mean + 9))
        dn = np.minimum(dn, 15_780 + rng.normal(0.0, spread_dn, dn.shape))
        full = np.flatnonzero(dn.ravel() >= 15_779)
        if full.size > strays:
            dn.ravel()[rng.choice(full, strays, replace=False)] = rng.integers(15_780, 16_180, strays)
        files.append(dng_bytes(np.rint(dn).clip(0, 16_383).astype(np.uint16), 600, 16_383))
    return write_photographs(folder, files, times, ".dng")


def steady_log(path: Path, seed: int) -> Path:
    """Write six nights of a camera that lacks nothing, whose exposure keeps the value at 30 000 DN ± 0.5 %."""
    rng = np.random.default_rng(seed)
    lines = ["utc,adu,exposure_s,gain_db,sqm"]
    for night in range(6):
        phase, base = rng.uniform(0, 6), rng.uniform(19.5, 21)
        for k in range(45):
            magnitude = base + 0.5 * math.sin(k / 9 + phase) + rng.normal(0, 0.01)
            light = 10.8e4 * 10 ** (-0.4 * magnitude)
            seconds = round(0.0015 / light, 3)
            value = 2e7 * light * seconds * (1 + rng.normal(0, 0.005))
            stamp = f"2026-03-{1 + night:02d}T{20 + k * 8 // 60 % 4:02d}:{k * 8 % 60:02d}:00"
            lines.append(f"{stamp},{value:.1f},{seconds:.6g},0,{magnitude:.2f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def light_and_dark(folder: Path, seconds: Sequence[float], celsius: float) -> Path:
    """Write a ramp of 10 000 DN/s at −10 °C with 1000 DN/s of dark signal, and dark frames; it doubles every 7 K."""
    rng = np.random.default_rng(5)
    ramp, dark = 1e4 * np.linspace(0.1, 1.0, 64)[None, :] * np.ones((48, 1)), 1000.0
    warm = dark * 2.0 ** ((celsius + 10.0) / 7.0)

    def drawn(kind: str, exposure: float, rate: Any) -> tuple[str, float, Any]:
        return kind, exposure, 500 + rng.normal(rate * exposure, np.sqrt(0.5 * rate * exposure + 9))

    fits_series(folder, (drawn("Light", t, ramp + dark) for t in SECONDS), CCD_TEMP=-10.0)
    darks = (drawn("Dark", t, warm * np.ones_like(ramp)) for t in seconds for _ in range(3))
    return fits_series(folder, darks, CCD_TEMP=celsius)
