"""The third generator: discs (or plates) on a slope of unstated light, photons counted before they become electrons.

Another rig than the second's throughout: a whole setting is made at once as a stack of frames, 10 to 14 bits, three or
five frames per setting, exposures on no grid, and headers that leave things out. A hidden thing is an object with
methods named after the places of the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from testing.outside.session import PLANCK_C, Hidden, Secret, Session

PLANS = ("bracket", "surrounds", "levels", "darks", "flats")
WAVELENGTH_M = 525e-9


class Nothing:
    """What is hidden where nothing is: every place of the chain as it should be, for stacks (frames, rows, columns)."""

    def source(self, factor: np.ndarray, at: Stack) -> np.ndarray:
        """Return the source's output, one factor a frame, shape (frames, 1, 1)."""
        return factor

    def scene(self, radiance: np.ndarray, at: Stack) -> np.ndarray:
        """Return the light of the scene."""
        return radiance

    def optics(self, radiance: np.ndarray, at: Stack) -> np.ndarray:
        """Return the light behind the lens."""
        return radiance

    def seconds(self, seconds: Any, at: Stack) -> Any:
        """Return how long light is gathered."""
        return seconds

    def charge(self, electrons: np.ndarray, at: Stack, dice: np.random.Generator) -> np.ndarray:
        """Return the charge that is read: whole electrons."""
        return electrons

    def added(self, at: Stack) -> Any:
        """Return expected electrons that no light brought."""
        return 0.0

    def analog(self, dn: np.ndarray, at: Stack, dice: np.random.Generator) -> np.ndarray:
        """Return the amplified signal in DN, without the black level."""
        return dn

    def digital(self, dn: np.ndarray, at: Stack) -> np.ndarray:
        """Return what is rounded."""
        return dn

    def codes(self, codes: np.ndarray, at: Stack) -> np.ndarray:
        """Return the codes."""
        return codes


@dataclass
class Rig:
    """What a session has: sensor, lens, scene."""

    rows: int
    columns: int
    bits: int
    k_dn_per_e: float
    read_e: float
    well_e: float
    dark_e_s: float
    pedestal: float
    pitch_m: float
    catches: float
    n: float
    focal_mm: float
    repeats: int
    y: np.ndarray
    x: np.ndarray
    longest_s: float = 1.0
    stated_k: float = 0.0

    @property
    def photons_per_radiance_second(self) -> float:
        """Return photons on a pixel for 1 W/(sr m²) and 1 s."""
        return float(np.pi / 4 / self.n**2 * self.pitch_m**2 * WAVELENGTH_M / PLANCK_C)


@dataclass
class Stack:
    """The frames of one setting.

    Attributes:
        seconds: Exposure.
        db: Gain.
        celsius: Sensor temperature.
        level: Source level.
        pattern: What the screen shows.
        lit: Whether the shutter opens.
        times: Time of each frame, shape (frames, 1, 1).
        idles: Time since the frame before, likewise.
        first: Number of the stack's first frame in the session.
        before: Charge of the last frame before, None at the start.
        rig: The rig.
    """

    seconds: float
    db: float = 0.0
    celsius: float = 30.0
    level: float = 1.0
    pattern: str = "discs"
    lit: bool = True
    times: Any = None
    idles: Any = None
    first: int = 0
    before: Any = None
    rig: Any = None


def draw_rig(dice: np.random.Generator) -> Rig:
    """Return a rig of its own."""
    rows, columns = int(dice.integers(110, 161)), int(dice.integers(150, 211))
    bits = int(dice.choice([10, 12, 14]))
    well = float(dice.integers(80, 200) * 100)
    pedestal = round((2**bits) * dice.uniform(0.02, 0.05), 0)
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    return Rig(
        rows, columns, bits, k_dn_per_e=(2**bits - 1 - pedestal) / well * dice.uniform(0.9, 1.0),
        read_e=round(dice.uniform(2.0, 5.0) + 2.5 * (bits == 10), 2), well_e=well,
        dark_e_s=round(dice.uniform(0.2, 2.0), 2),
        pedestal=float(pedestal), pitch_m=float(dice.choice([2.74e-6, 3.45e-6, 5.86e-6])),
        catches=round(dice.uniform(0.4, 0.75), 2), n=float(dice.choice([2.0, 2.8, 4.0])),
        focal_mm=float(dice.choice([8.0, 16.0, 35.0])), repeats=int(dice.choice([3, 5])), y=y, x=x,
    )  # fmt: skip


def draw_plan(plan: str, rig: Rig, dice: np.random.Generator) -> list[Stack]:
    """Return the settings in the order in which they are taken."""
    top = dice.uniform(0.008, 0.03)
    times = sorted(float(f"{top * 10**-u:.4g}") for u in (0.0, *dice.uniform(0.05, 2.0, 5), 2.05))
    rounds = 2 if rig.repeats == 5 else 3
    made: list[Stack] = []
    if plan == "bracket":
        made = [Stack(t) for t in times] * rounds
    elif plan == "surrounds":
        made = [Stack(t, pattern=p) for t in times[::2] for p in ("discs", "bright_surround", "dark_surround")] * 2
    elif plan == "levels":
        made = [
            Stack(t, level=v, celsius=c)
            for t in times[1::2]
            for v, c in ((0.08, 30.0), (0.3, 22.0), (0.65, 38.0), (1.0, 30.0))
        ] * 2
        made += [Stack(times[-2], level=v, celsius=c) for v, c in ((0.3, 30.0), (0.65, 22.0), (1.0, 38.0), (1.0, 22.0))]
        made += [Stack(times[2], level=0.5, db=d) for d in (4.0, 8.0, 12.0)] * 2
        made += [Stack(times[-1], level=0.0), Stack(times[2], level=0.0)]
    elif plan == "flats":
        made = [Stack(t, pattern="sphere") for t in times] * rounds
    else:
        made = [Stack(t, celsius=c, lit=False) for c in (15.0, 28.0, 40.0) for t in (0.0005, 0.03, 0.4, 2.5)]
        made += [Stack(t, db=12.0, celsius=28.0, lit=False) for t in (0.0005, 0.4, 2.5)] * 2
    if plan not in ("darks", "flats"):
        gains = sorted({s.db for s in made})
        made += [Stack(t, db=d, lit=False) for d in gains for t in (times[0], times[-1])]
    return [made[i] for i in dice.permutation(len(made))]


def scene_of(rig: Rig, dice: np.random.Generator, peak: float) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """Return discs or plates in a honeycomb on a slope of light, and squares inside them as patches."""
    across, down = 6, 4
    pitch_x, pitch_y = rig.columns / (across + 0.5), rig.rows / down
    radius = 0.44 * min(pitch_x, pitch_y)
    side, is_round = int(radius * 1.3), bool(dice.uniform() < 0.4)
    ladder = peak * np.geomspace(1.0, 1 / 40, across * down)[dice.permutation(across * down)]
    slope = 0.02 + 0.2 * rig.x / rig.columns + 0.1 * rig.y / rig.rows
    grounds = {"discs": peak * slope, "bright_surround": peak * (0.6 + slope), "dark_surround": peak * 0.01 * slope}
    patches = []
    for i, level in enumerate(ladder):
        down_i, across_i = divmod(i, across)
        cy, cx = (down_i + 0.5) * pitch_y, (across_i + 0.5 + 0.5 * (down_i % 2)) * pitch_x
        round_off = (rig.y - cy) ** 2 + (rig.x - cx) ** 2 < radius**2
        inside = round_off if is_round else np.maximum(abs(rig.y - cy), abs(rig.x - cx)) < radius * 0.9
        for ground in grounds.values():
            ground[inside] = level
        patches.append({"name": f"d{i}", "x": round(cx - side / 2), "y": round(cy - side / 2), "width": side,
                        "height": side, "u_rel": 0.004, "radiance_W_per_sr_m2":
                        float(f"{level * (1 + 0.004 * dice.standard_normal()):.7g}")})  # fmt: skip
    return grounds, patches


def sphere_of(rig: Rig, peak: float) -> tuple[dict[str, np.ndarray], list[dict[str, Any]]]:
    """Return an even field, and patches in a grid of which nothing is stated."""
    side = 20
    patches = [{"name": f"s{j}_{i}", "x": 2 + i * 25, "y": 2 + j * 25, "width": side, "height": side}
               for j in range((rig.rows - 2) // 25) for i in range((rig.columns - 2) // 25)]  # fmt: skip
    return {"sphere": np.full((rig.rows, rig.columns), peak)}, patches


def take(rig: Rig, at: Stack, light: np.ndarray, secret: Nothing, dice: np.random.Generator) -> np.ndarray:
    """Return the codes of a setting's frames, shape (frames, rows, columns); `at.before` is moved on."""
    output = secret.source(np.full((rig.repeats, 1, 1), at.level), at) * (1.0 + 0.001 * dice.standard_normal())
    radiance = secret.optics(secret.scene(light[None] * output, at), at)
    photons = np.maximum(radiance, 0) * (rig.photons_per_radiance_second * secret.seconds(at.seconds, at)) * at.lit
    caught = dice.poisson(photons * rig.catches)  # photons caught with a chance are Poisson again
    thermal = rig.dark_e_s * 2.0 ** ((at.celsius - 25.0) / 7.0) * at.seconds + secret.added(at)
    caught = caught + dice.poisson(np.maximum(np.broadcast_to(thermal, caught.shape), 0))
    charge = np.minimum(secret.charge(caught.astype(float), at, dice), rig.well_e)
    at.before = charge[-1]
    analog = (charge + rig.read_e * dice.standard_normal(charge.shape)) * rig.k_dn_per_e * 10 ** (at.db / 20)
    dn = secret.digital(secret.analog(analog, at, dice) + rig.pedestal, at)
    codes = np.clip(np.floor(dn + 0.5), 0, 2**rig.bits - 1)
    return secret.codes(codes, at).astype(np.uint16)


def make(
    seed: int, hidden: Hidden | None = None, plan: str | None = None, size: float = 1.0, again: int = 0
) -> Session:
    """Return the session of a seed.

    Args:
        seed: Of rig, plan and noise.
        hidden: What is hidden; its `install` returns the object and what it drew. None for nothing.
        plan: One of `PLANS`; drawn among those that show the hidden thing by default.
        size: Factor on its usual size.
        again: Number of a further session of the rig, the hidden thing in it, in another order; 0 for the first.
    """
    dice = np.random.default_rng([3, seed, 33])
    rig = draw_rig(dice)
    plan = plan or str(dice.choice(hidden.plans if hidden else PLANS))
    stacks = draw_plan(plan, rig, dice)
    rig.longest_s = max([s.seconds for s in stacks if s.lit and s.level > 0] or [s.seconds for s in stacks])
    top_e = min(rig.well_e, (2**rig.bits - 1 - rig.pedestal) / rig.k_dn_per_e)
    peak = 0.8 * top_e / (rig.photons_per_radiance_second * rig.catches * rig.longest_s)
    pictures, patches = sphere_of(rig, peak) if plan == "flats" else scene_of(rig, dice, peak)
    secret, drawn = hidden.install(rig, np.random.default_rng([333, seed]), size) if hidden else (Nothing(), {})
    if again:
        dice = np.random.default_rng([3, seed, 33, again])
        stacks = [stacks[i] for i in dice.permutation(len(stacks))]
    frames: list[np.ndarray] = []
    entries: list[dict[str, Any]] = []
    clock, last, before = 0.0, -8.0, None
    for at in stacks:
        clock += float(dice.exponential(8.0)) + 0.5
        starts = clock + np.arange(rig.repeats) * (0.35 + at.seconds)
        at.times = starts[:, None, None]
        at.idles = np.diff(np.concatenate([[last], starts]))[:, None, None]
        at.first, at.before, at.rig = len(frames), before, rig
        at.celsius += 0.1 * float(dice.standard_normal())
        picture = pictures.get(at.pattern, next(iter(pictures.values())))
        for shown, start in zip(take(rig, at, picture, secret, dice), starts, strict=True):
            entries.append(_listed(at, float(start), len(frames)))
            frames.append(shown)
        before, last, clock = at.before, float(starts[-1]), float(starts[-1]) + at.seconds
    header = _header(rig, plan, patches, entries)
    if hidden is None:
        return Session(header, frames, Secret("null", plan))
    right = tuple(dict.fromkeys((*hidden.right, *hidden.together.get(plan, ()))))
    return Session(
        header, frames, Secret(hidden.kind, plan, hidden.name, right, hidden.stage, hidden.covariates, drawn)
    )


def _listed(at: Stack, start: float, number: int) -> dict[str, Any]:
    return {
        "file": f"frames/{number:05d}.png", "exposure_s": at.seconds, "gain_db": at.db, "temperature_C":
        round(at.celsius, 1), "timestamp_s": round(start, 3), "source_level": at.level, "pattern": at.pattern,
        "shutter": "open" if at.lit else "closed",
    }  # fmt: skip


def _header(rig: Rig, plan: str, patches: Any, entries: Any) -> dict[str, Any]:
    """Return the header; this camera states its full well nowhere, and its black level once, not with each frame."""
    return {
        "format": "radiometer-capture/1",
        "camera": {
            "vendor": "third", "model": "honeycomb", "serial": "7", "bit_depth": rig.bits,
            "pixel_pitch_um": rig.pitch_m * 1e6, "conversion_gain_e_per_dn": 1 / (rig.stated_k or rig.k_dn_per_e),
            "read_noise_e": rig.read_e, "dark_current_e_per_s": rig.dark_e_s, "dark_current_reference_C": 25.0,
            "dark_current_doubling_K": 7.0, "black_level_dn": rig.pedestal, "quantum_efficiency": rig.catches,
        },
        "lens": {"focal_length_mm": rig.focal_mm, "f_number": rig.n},
        "source": {"kind": "sphere" if plan == "flats" else "screen", "wavelength_nm": WAVELENGTH_M * 1e9,
                   "reproducibility_u_rel": 0.001},
        "patterns": list(dict.fromkeys(e["pattern"] for e in entries)), "patches": patches, "frames": entries,
    }  # fmt: skip
