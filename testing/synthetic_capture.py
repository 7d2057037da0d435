"""Synthetic capture sets for tests of `reconcile`, made per pixel with equations of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometer.data import (
    CameraDescription,
    CaptureHeader,
    Frame,
    FrameEntry,
    FrameSettings,
    LensDescription,
    PatchDescription,
    SourceDescription,
)

HEIGHT, WIDTH, ROWS, COLUMNS = 64, 96, 4, 6
FULL_WELL_E, E_PER_DN, READ_E, BLACK_DN = 10_500.0, 2.6, 2.4, 64.0
EXPOSURE_AT_FULL_WELL_S = 6e-3
PATCH_U_REL, JITTER = 5e-3, 1e-3

Setting = dict[str, Any]
Image = NDArray[np.float64]


@dataclass(frozen=True)
class Synthetic:
    header: CaptureHeader
    frames: list[Frame]


def _plan() -> list[Setting]:
    dark = [{"t": t, "g": g, "shutter": "closed"} for t in (1e-4, 1e-2, 1.0) for g in (0.0, 12.0, 24.0)]
    off = [{"t": t, "d": 0.0} for t in (0.1, 1.0)]
    ladder = [{"t": float(t), "d": d} for d in (0.9, 0.25) for t in np.geomspace(4e-5, 6e-3, 8)]
    drives = [{"t": 3.7e-3, "d": d} for d in (0.1, 0.3, 0.5, 0.7, 1.0)]
    gains = [{"t": 4e-4, "g": g} for g in (0.0, 3.0, 6.0, 9.0, 12.0, 18.0) for _ in range(2)]
    stops = [{"t": 3e-3, "N": n} for n in (4.0, 5.6, 8.0, 11.0)] + [{"t": 8e-4, "N": n} for n in (2.0, 2.8, 4.0)]
    warm = [{"t": 3e-3, "T": t} for t in (25.0, 45.0) for _ in range(2)]
    patterns = [{"t": 3e-3, "pattern": p} for p in ("inverted", "bright") for _ in range(2)]
    repeats = [{"t": 4e-3} for _ in range(8)]
    return [*dark, *off, *ladder, *drives, *gains, *stops, *warm, *patterns, *repeats]


def _patterns(rng: np.random.Generator) -> dict[str, Image]:
    levels = np.geomspace(0.01, 1.0, ROWS * COLUMNS)[rng.permutation(ROWS * COLUMNS)]
    bright = np.where(np.arange(ROWS * COLUMNS) % 2, levels, 1.0)
    return {"chart": levels, "inverted": levels[::-1].copy(), "bright": bright}


def _scene(levels: Image) -> Image:
    return np.kron(levels.reshape(ROWS, COLUMNS), np.ones((HEIGHT // ROWS, WIDTH // COLUMNS)))


def make_capture(
    seed: int = 0,
    frames: int = 4,
    *,
    exposure: Callable[[float], float] = lambda t: t,
    extra_e: Callable[[Setting], Any] = lambda setting: 0.0,
    extra_dn: Callable[[Setting], Any] = lambda setting: 0.0,
    picture: Callable[[Image, Setting], Image] = lambda image, setting: image,
    plan: list[Setting] | None = None,
    known: bool = True,
) -> Synthetic:
    """Return a capture set of a screen with patches, taken in a drawn order.

    Args:
        seed: What draws noise, order and errors.
        frames: Frames of each capture.
        exposure: True exposure in s of a stated one.
        extra_e: Further electrons of a setting, a number or an image.
        extra_dn: Further digital numbers of a setting, a number or an image.
        picture: What becomes of the relative light of a pattern at a setting.
        plan: Settings: t in s, g in dB, N, d (drive), T in °C, pattern, shutter; those that hold every covariate.
        known: State the patches' radiances.
    """
    rng = np.random.default_rng((seed, 20261121))
    settings = plan or _plan()
    settings = [settings[i] for i in rng.permutation(len(settings))]
    patterns = _patterns(rng)
    real = {n: v * (1 + PATCH_U_REL * rng.standard_normal(v.size)) for n, v in patterns.items()}
    taken, entries, now = [], [], 0.0
    for chosen in settings:
        s: Setting = {"g": 0.0, "N": 4.0, "d": 0.9, "T": 35.0, "pattern": "chart", "shutter": "open"} | chosen
        warm = s["T"] + rng.normal(0, 0.1)
        light = s["d"] * (4.0 / s["N"]) ** 2 * (1 + JITTER * rng.standard_normal()) * (s["shutter"] == "open")
        for _ in range(frames):
            now += 2.5
            expected = picture(_scene(real[s["pattern"]]), s) * FULL_WELL_E * light
            expected = expected * exposure(s["t"]) / EXPOSURE_AT_FULL_WELL_S
            expected = expected + 2.0 ** ((warm - 25.0) / 7.0) * s["t"] + extra_e(s)
            electrons = rng.poisson(expected) + rng.normal(0, READ_E, expected.shape)
            value = BLACK_DN + extra_dn(s) + electrons * 10 ** (s["g"] / 20) / E_PER_DN
            dn = np.clip(np.floor(value + 0.5), 0, 4095).astype(np.uint16)
            read_back = FrameSettings(
                s["t"], s["g"], s["N"], BLACK_DN, round(warm, 2), round(now, 3), s["d"], s["pattern"], s["shutter"]
            )
            entries.append(FrameEntry.of(f"frames/{len(entries):04d}.png", read_back))
            taken.append(Frame(dn, 12, read_back, len(taken)))
    return Synthetic(_header(patterns, tuple(entries), known=known), taken)


def _header(patterns: dict[str, Image], entries: tuple[FrameEntry, ...], *, known: bool) -> CaptureHeader:
    height, width = HEIGHT // ROWS, WIDTH // COLUMNS
    patches = tuple(
        PatchDescription(
            name=f"p{k:02d}",
            x=(k % COLUMNS) * width,
            y=(k // COLUMNS) * height,
            width=width,
            height=height,
            radiance_W_per_sr_m2={n: float(v[k]) for n, v in patterns.items()} if known else None,
            u_rel=PATCH_U_REL if known else None,
        )
        for k in range(ROWS * COLUMNS)
    )
    camera = CameraDescription(
        bit_depth=12,
        pixel_pitch_um=4.5,
        conversion_gain_e_per_dn=E_PER_DN,
        read_noise_e=READ_E,
        full_well_e=FULL_WELL_E,
        dark_current_e_per_s=1.0,
        dark_current_reference_C=25.0,
        black_level_dn=BLACK_DN,
        quantum_efficiency=0.62,
    )
    return CaptureHeader(
        camera=camera,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0, transmittance=0.95),
        source=SourceDescription(kind="screen", wavelength_nm=550.0, reproducibility_u_rel=JITTER),
        patterns=tuple(patterns),
        patches=patches,
        frames=entries,
    )
