"""The second generator: a brick wall of patches, photons one by one through a chain of plain array operations.

Charge is drawn in every pixel (Poisson), cut at the full well, amplified, lifted by the black level, rounded and cut by
the converter. What is hidden hooks into the chain by its physical place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from testing.outside.session import PLANCK_C, Secret, Session

PLANS = ("bracket", "surrounds", "levels", "darks", "flats")
FRAMES = 4


@dataclass(frozen=True)
class Shot:
    """One frame as it is taken.

    Attributes:
        seconds: Exposure.
        gain_db: Gain.
        celsius: Temperature of the sensor.
        time_s: Time since the first frame.
        idle_s: Time since the frame before.
        level: Source level.
        pattern: What the screen shows.
        lit: Whether the shutter opens.
        number: Number of the frame in the session.
        turn: Number of the frame within its setting.
    """

    seconds: float
    gain_db: float = 0.0
    celsius: float = 35.0
    time_s: float = 0.0
    idle_s: float = 5.0
    level: float = 1.0
    pattern: str = "wall"
    lit: bool = True
    number: int = 0
    turn: int = 0


@dataclass
class Camera:
    """The rig of a session, and the hooks for what is hidden."""

    width: int
    height: int
    bits: int
    e_per_dn: float
    noise_e: float
    well_e: float
    black_dn: float
    pitch_um: float
    quantum: float
    stop: float
    focal_mm: float
    dark_e_per_s: float
    glass: float = 0.93
    longest_s: float = 1.0  # exposure of the plan
    lamp: list[Callable[[Shot], float]] = field(default_factory=list)
    screen: list[Callable[[np.ndarray, Shot], np.ndarray]] = field(default_factory=list)
    optics: list[Callable[[np.ndarray, Shot], np.ndarray]] = field(default_factory=list)
    shutter: list[Callable[[Any, Shot], Any]] = field(default_factory=list)
    charge: list[Callable[[np.ndarray, Shot], np.ndarray]] = field(default_factory=list)
    caught: list[Callable[[np.ndarray, Shot, np.random.Generator], np.ndarray]] = field(default_factory=list)
    volts: list[Callable[[np.ndarray, Shot, np.random.Generator], np.ndarray]] = field(default_factory=list)
    digits: list[Callable[[np.ndarray, Shot], np.ndarray]] = field(default_factory=list)

    @property
    def e_per_radiance_second(self) -> float:
        """Return electrons per pixel for 1 W/(sr m²) and 1 s at 550 nm."""
        irradiance = np.pi * self.glass / (4 * self.stop**2)
        return float(irradiance * (self.pitch_um * 1e-6) ** 2 * self.quantum * 550e-9 / PLANCK_C)

    def yx(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns as open grids."""
        return np.arange(self.height, dtype=float)[:, None], np.arange(self.width, dtype=float)[None, :]

    def expose(self, radiance: np.ndarray, shot: Shot, dice: np.random.Generator) -> np.ndarray:
        """Return the codes of one frame."""
        light = radiance * (shot.level if shot.lit else 0.0)
        for act in self.lamp:
            light = light * act(shot)
        for paint in self.optics:
            light = paint(light, shot)
        light = light * (1.0 if shot.lit else 0.0)
        open_s: Any = shot.seconds
        for delay in self.shutter:
            open_s = delay(open_s, shot)
        dark = self.dark_e_per_s * 2 ** ((shot.celsius - 25) / 7) * shot.seconds
        expected = light * self.e_per_radiance_second * open_s + dark
        for add in self.charge:
            expected = add(expected, shot)
        electrons = dice.poisson(np.maximum(expected, 0.0)).astype(float)
        for move in self.caught:
            electrons = move(electrons, shot, dice)
        electrons = np.minimum(electrons, self.well_e)
        volts = electrons + self.noise_e * dice.standard_normal(electrons.shape)
        volts = volts * (10 ** (shot.gain_db / 20) / self.e_per_dn)
        for bend in self.volts:
            volts = bend(volts, shot, dice)
        codes = volts + self.black_dn
        for shift in self.digits:
            codes = shift(codes, shot)
        return np.clip(np.rint(codes), 0, 2**self.bits - 1).astype(np.uint16)


def draw_camera(dice: np.random.Generator) -> Camera:
    """Return a camera of its own."""
    e_per_dn = dice.uniform(1.8, 3.6)
    return Camera(
        width=int(dice.integers(18, 25)) * 8,
        height=int(dice.integers(14, 20)) * 8,
        bits=12,
        e_per_dn=round(e_per_dn, 3),
        noise_e=round(dice.uniform(2.5, 7.0), 2),
        well_e=round(e_per_dn * dice.uniform(3200, 3700), -1),
        black_dn=round(dice.uniform(60, 260), 1),
        pitch_um=float(dice.choice([3.45, 4.8, 5.5])),
        quantum=round(dice.uniform(0.45, 0.7), 2),
        stop=float(dice.choice([2.8, 4.0, 5.6])),
        focal_mm=float(dice.choice([12.0, 16.0, 25.0])),
        dark_e_per_s=round(dice.uniform(0.3, 3.0), 2),
    )


def draw_plan(plan: str, dice: np.random.Generator) -> list[Shot]:
    """Return one shot for each setting, in random order."""
    longest = 0.0128 * dice.uniform(0.6, 1.6)
    ladder = [float(f"{longest / 2**k:.4g}") for k in range(8)]
    shots: list[Shot] = []
    if plan == "bracket":
        shots = [Shot(t) for t in ladder] * 2
    elif plan == "surrounds":
        shots = [Shot(t, pattern=p) for t in ladder[::2] for p in ("wall", "bright_surround", "dark_surround")] * 2
    elif plan == "levels":
        shots = [Shot(t, level=level) for t in ladder[::3] for level in (0.1, 0.25, 0.45, 0.7, 1.0)] * 2
        shots += [Shot(t, gain_db=g, level=0.4 * 10 ** (-g / 20) * 2) for t in ladder[:2] for g in (6.0, 12.0)] * 2
    elif plan == "flats":
        shots = [Shot(t, pattern="flat") for t in ladder] * 2
    elif plan == "darks":
        shots = [
            Shot(t, gain_db=g, celsius=c, lit=False)
            for t in (1e-3, 0.1, 1.0, 4.0)
            for g in (0.0, 12.0)
            for c in (25.0, 42.0)
        ]
        shots += [Shot(t, celsius=34.0, lit=False) for t in (0.01, 0.3, 2.0)] * 2
    if plan not in ("flats", "darks"):
        shots += [
            Shot(t, gain_db=g, lit=False) for t in (ladder[0], ladder[-1]) for g in sorted({s.gain_db for s in shots})
        ]
    order = dice.permutation(len(shots))
    if plan == "darks":  # a chamber does not jump about
        order = np.array(sorted(order, key=lambda i: -shots[i].celsius))
    return [shots[i] for i in order]


def wall_of(
    camera: Camera, dice: np.random.Generator, peak: float
) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """Return the pictures by pattern in W/(sr m²), and the patches as they are stated."""
    rows, columns = 4, 5
    step_y, step_x = camera.height // rows, camera.width // columns
    tall, wide = int(step_y * 0.68), int(step_x * 0.68)
    levels = peak * np.geomspace(1.0, 1 / 60, rows * columns)[dice.permutation(rows * columns)]
    grain = 1 + 0.03 * np.sin(np.arange(camera.width) / 9.0)[None, :] * np.cos(np.arange(camera.height) / 7.0)[:, None]
    mixed = peak * dice.uniform(0.05, 0.4)
    pictures = {
        "wall": mixed * grain,
        "bright_surround": peak * 0.9 * grain,
        "dark_surround": peak * 0.004 * grain,
    }
    stated = []
    for number, level in enumerate(levels):
        row, column = divmod(number, columns)
        shift = (row % 2) * (step_x - wide - 4) // 2
        y, x = row * step_y + (step_y - tall) // 2, column * step_x + 2 + shift
        for picture in pictures.values():
            picture[y : y + tall, x : x + wide] = level
        text = float(f"{level * (1 + 0.005 * dice.standard_normal()):.6g}")
        stated.append({"name": f"b{number:02d}", "x": x + 3, "y": y + 3, "width": wide - 6, "height": tall - 6,
                       "radiance_W_per_sr_m2": text, "u_rel": 0.005})  # fmt: skip
    return pictures, stated


def flat_of(camera: Camera, peak: float) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """Return an even field and a grid of patches of which nothing is stated."""
    side = 24
    patches = [
        {"name": f"f{y}_{x}", "x": 4 + x * (side + 4), "y": 4 + y * (side + 4), "width": side, "height": side,
         "radiance_W_per_sr_m2": None, "u_rel": None}
        for y in range((camera.height - 4) // (side + 4)) for x in range((camera.width - 4) // (side + 4))
    ]  # fmt: skip
    return {"flat": np.full((camera.height, camera.width), peak)}, patches


def make(seed: int, hidden: Any = None, plan: str | None = None, size: float = 1.0, again: int = 0) -> Session:
    """Return the session of a seed.

    Args:
        seed: Of rig, plan and noise.
        hidden: What is hidden; None for nothing.
        plan: One of `PLANS`; drawn among those that show the hidden thing by default.
        size: Factor on its usual size.
        again: Number of a further session of the rig, the hidden thing in it, in another order; 0 for the first.
    """
    dice = np.random.default_rng([seed, 2])
    camera = draw_camera(dice)
    plan = plan or str(dice.choice(hidden.plans if hidden else PLANS))
    shots = draw_plan(plan, dice)
    room_e = min(camera.well_e, (2**camera.bits - 1 - camera.black_dn) * camera.e_per_dn)
    longest = max((s.seconds for s in shots if s.lit), default=1.0)
    camera.longest_s = max(s.seconds for s in shots)
    peak = 0.82 * room_e / (camera.e_per_radiance_second * longest)
    pictures, patches = flat_of(camera, peak) if plan == "flats" else wall_of(camera, dice, peak)
    drawn = dict(hidden.install(camera, np.random.default_rng([seed, 22]), size)) if hidden else {}
    if again:
        dice = np.random.default_rng([seed, 2, again])
        shots = [shots[i] for i in dice.permutation(len(shots))]
    frames, entries = [], []
    time_s, before_s = 0.0, -5.0
    for shot in shots:
        warm = shot.celsius + 0.15 * dice.standard_normal()
        wander = 1 + 0.001 * dice.standard_normal()
        time_s += dice.uniform(1.0, 20.0)
        for turn in range(FRAMES):
            now = replace(shot, celsius=warm, time_s=time_s, idle_s=time_s - before_s, turn=turn, number=len(frames))
            scene = pictures[shot.pattern if shot.lit else next(iter(pictures))] * wander
            for paint in camera.screen:
                scene = paint(scene, now)
            codes = camera.expose(scene, now, dice)
            entries.append(_entry(now, camera, len(frames)))
            frames.append(codes)
            before_s, time_s = time_s, time_s + 0.2 + shot.seconds
    header = _header(camera, plan, pictures, patches, entries)
    if hidden is None:
        return Session(header, frames, Secret("null", plan))
    right = tuple(dict.fromkeys((*hidden.right, *hidden.together.get(plan, ()))))
    return Session(
        header, frames, Secret(hidden.kind, plan, hidden.name, right, hidden.stage, hidden.covariates, drawn)
    )


def _entry(shot: Shot, camera: Camera, number: int) -> dict[str, Any]:
    return {
        "file": f"frames/{number:04d}.png", "exposure_s": shot.seconds, "gain_db": shot.gain_db,
        "f_number": camera.stop, "black_level_dn": camera.black_dn, "temperature_C": round(shot.celsius, 1),
        "timestamp_s": round(shot.time_s, 4), "source_level": shot.level, "pattern": shot.pattern,
        "shutter": "open" if shot.lit else "closed",
    }  # fmt: skip


def _header(camera: Camera, plan: str, pictures: Any, patches: Any, entries: Any) -> dict[str, Any]:
    used = list(dict.fromkeys(entry["pattern"] for entry in entries))
    return {
        "format": "radiometer-capture/1",
        "camera": {
            "vendor": "own hand", "model": "brick", "bit_depth": camera.bits, "pixel_pitch_um": camera.pitch_um,
            "conversion_gain_e_per_dn": camera.e_per_dn, "read_noise_e": camera.noise_e, "full_well_e": camera.well_e,
            "dark_current_e_per_s": camera.dark_e_per_s, "dark_current_reference_C": 25.0,
            "dark_current_doubling_K": 7.0, "black_level_dn": camera.black_dn, "quantum_efficiency": camera.quantum,
        },
        "lens": {"focal_length_mm": camera.focal_mm, "f_number": camera.stop, "transmittance": camera.glass,
                 "transmittance_u_rel": 0.03, "vignetting": "none"},
        "source": {"kind": "sphere" if plan == "flats" else "screen", "wavelength_nm": 550.0,
                   "reproducibility_u_rel": 0.001},
        "patterns": used, "patches": patches, "frames": entries,
    }  # fmt: skip
