"""What the third generator hides: objects that change one place of its chain each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from testing.outside.session import Hidden
from testing.outside.three import Nothing, Rig

HIDDEN: dict[str, Hidden] = {}
_LIT = ("bracket", "surrounds", "levels")
_UNIFORM = ("veiling_glare", "ambient_light_leak", "display_black_leak")
_BENT = ("gamma_enabled", "soft_saturation", "response_nonlinearity")


class Secretive(Nothing):
    """A hidden thing: draws itself from the rig."""

    def __init__(self, rig: Rig, dice: np.random.Generator, size: float) -> None:
        self.rig = rig
        self.sign = float(dice.choice([-1.0, 1.0]))
        self.drawn: dict[str, Any] = {}
        self.draw(dice, size)

    def draw(self, dice: np.random.Generator, size: float) -> None:
        """Draw the parameters."""

    def keep(self, **drawn: float) -> None:
        """Keep parameters as attributes and for the secret."""
        for name, value in drawn.items():
            setattr(self, name, value)
        self.drawn |= drawn


def hides(
    kind: str,
    *plans: str,
    right: tuple[str, ...] = (),
    stage: str = "",
    along: tuple[str, ...] = (),
    together: Mapping[str, tuple[str, ...]] | None = None,
) -> Any:
    """Enter a class under its own name in small letters."""

    def enter(kept: type[Secretive]) -> type[Secretive]:
        name = "".join("_" + c.lower() if c.isupper() else c for c in kept.__name__).lstrip("_")

        def install(rig: Rig, dice: np.random.Generator, size: float) -> Any:
            secret = kept(rig, dice, size)
            return secret, secret.drawn

        HIDDEN[name] = Hidden(name, kind, install, plans, right, stage, along, together or {})
        return kept

    return enter


# ---------------------------------------------------------------------------------------------- usual equations


@hides("single", "bracket", "levels", "darks", right=("column_pattern",))
class Columns(Secretive):
    def draw(self, dice, size):
        self.keep(sigma_e=dice.uniform(0.8, 2.0) * size)
        self.pattern = self.sigma_e * dice.standard_normal((1, 1, self.rig.columns))

    def charge(self, electrons, at, dice):
        return electrons + self.pattern


@hides("single", "bracket", "levels", "darks", right=("row_pattern",))
class Rows(Secretive):
    def draw(self, dice, size):
        self.keep(sigma_e=dice.uniform(0.8, 2.0) * size)
        self.pattern = self.sigma_e * dice.standard_normal((1, self.rig.rows, 1))

    def charge(self, electrons, at, dice):
        return electrons + self.pattern


@hides("single", "bracket", "levels", "flats", right=("conversion_gain_error",))
class StatedGain(Secretive):
    """The stated conversion gain is wrong: fewer, larger electrons."""

    def draw(self, dice, size):
        self.keep(error=self.sign * dice.uniform(0.04, 0.09) * size)
        self.rig.stated_k = self.rig.k_dn_per_e * (1 + self.error)


@hides("single", "bracket", "levels", right=("image_lag",), together={"levels": ("residual_charge",)})
class Lag(Secretive):
    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.004, 0.012) * size)

    def charge(self, electrons, at, dice):
        out, before = np.empty_like(electrons), at.before if at.before is not None else 0.0
        for i, frame in enumerate(electrons):
            out[i] = frame + self.share * before
            before = frame
        return out


@hides("single", "darks", right=("hot_pixels", "dark_current_nonuniformity"))
class Hot(Secretive):
    def draw(self, dice, size):
        self.keep(share=0.004 * size, rate_e_s=dice.uniform(60, 150))
        hot = dice.uniform(size=(self.rig.rows, self.rig.columns)) < self.share
        self.map = hot * dice.exponential(self.rate_e_s, hot.shape)

    def added(self, at):
        return self.map * 2.0 ** ((at.celsius - 25) / 7.0) * at.seconds


@hides("single", *_LIT, right=("psf_blur",), together=dict.fromkeys(_LIT, ("defocus", "crosstalk")))
class Soft(Secretive):
    def draw(self, dice, size):
        self.keep(sigma_px=dice.uniform(0.7, 1.2) * size)
        reach = np.arange(-6, 7)
        bell = np.exp(-0.5 * (reach / self.sigma_px) ** 2)
        self.bell = bell / bell.sum()

    def optics(self, radiance, at):
        return smeared(smeared(radiance, self.bell, 1), self.bell, 2)


@hides("single", "bracket", "flats", "levels", right=("crosstalk",))
class Neighbours(Secretive):
    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.012, 0.03) * size)

    def charge(self, electrons, at, dice):
        kernel = np.array([self.share, 1 - 2 * self.share, self.share])
        return smeared(electrons, kernel, 1) + smeared(electrons, kernel, 2) - electrons


@hides(
    "single",
    "bracket",
    "flats",
    "levels",
    right=("source_warmup_drift",),
    together=dict.fromkeys(("bracket", "flats", "levels"), ("lamp_step",)),
)
class WarmUp(Secretive):
    def draw(self, dice, size):
        self.keep(depth=self.sign * dice.uniform(0.01, 0.025) * size, tau_s=dice.uniform(40, 120))

    def source(self, factor, at):
        return factor * (1 + self.depth * np.exp(-at.times / self.tau_s))


@hides("single", "levels", right=("ambient_light_leak",), together={"levels": ("display_black_leak",)})
class Room(Secretive):
    """Light of the room, there with the source off."""

    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.004, 0.01) * size)

    def optics(self, radiance, at):
        rig = self.rig
        brightest = 0.8 * rig.well_e / (rig.photons_per_radiance_second * rig.catches * rig.longest_s)
        return radiance + self.share * brightest


@hides("single", "darks", "levels", right=("black_level_gain_slope",), together={"darks": ("black_level_offset",)})
class GainedBlack(Secretive):
    def draw(self, dice, size):
        self.keep(shift_dn=self.sign * dice.uniform(0.8, 2.0) * size)

    def analog(self, dn, at, dice):
        return dn + self.shift_dn * (10 ** (at.db / 20) - 1)


@hides("single", "darks", right=("black_level_drift",))
class BlackWithHeat(Secretive):
    def draw(self, dice, size):
        self.keep(slope=self.sign * dice.uniform(0.05, 0.15) * size)

    def digital(self, dn, at):
        return dn + self.slope * (at.celsius - 28.0)


@hides("single", "bracket", "levels", "flats", right=("missing_codes", "reduced_bit_depth"))
class LostBit(Secretive):
    def draw(self, dice, size):
        self.keep(step=2.0)

    def codes(self, codes, at):
        return codes - codes % 2


# ---------------------------------------------------------------------------------------------- other laws


@hides("law", *_LIT, right=("psf_blur",), together=dict.fromkeys(_LIT, ("defocus", "crosstalk")))
class BoxBlur(Secretive):
    """A blur by a square of three to five pixels: the camera shook."""

    def draw(self, dice, size):
        self.keep(width_px=float(dice.choice([3, 5])))
        self.box = np.full(int(self.width_px), 1 / self.width_px)

    def optics(self, radiance, at):
        return smeared(smeared(radiance, self.box, 1), self.box, 2)


@hides("law", "bracket", "flats", "levels", right=("crosstalk",))
class SideTalk(Secretive):
    """Crosstalk along the rows only."""

    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.015, 0.04) * size)

    def charge(self, electrons, at, dice):
        return smeared(electrons, np.array([self.share, 1 - 2 * self.share, self.share]), 2)


@hides("law", "bracket", "levels", right=("image_lag",))
class LongLag(Secretive):
    """A lag that goes with the square root of what was there."""

    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.3, 0.6) * size)

    def charge(self, electrons, at, dice):
        out, before = np.empty_like(electrons), at.before if at.before is not None else 0.0
        for i, frame in enumerate(electrons):
            out[i] = frame + self.share * np.sqrt(np.maximum(before, 0.0))
            before = frame
        return out


@hides("law", "bracket", "levels", "darks", right=("column_pattern",))
class OddEven(Secretive):
    """Two converters take turns: odd columns differ from even ones, and fours from fours."""

    def draw(self, dice, size):
        self.keep(step_e=dice.uniform(1.0, 2.0) * size)
        column = np.arange(self.rig.columns)
        self.pattern = (self.step_e * ((column % 2) - 0.5) + 0.5 * self.step_e * ((column // 4 % 2) - 0.5))[
            None, None, :
        ]

    def charge(self, electrons, at, dice):
        return electrons + self.pattern


@hides("law", "bracket", "levels", "darks", right=("row_temporal_noise",))
class RowJumps(Secretive):
    """Row noise of two states instead of a bell."""

    def draw(self, dice, size):
        self.keep(step_e=dice.uniform(2.0, 4.0) * size)

    def charge(self, electrons, at, dice):
        return electrons + self.step_e * dice.choice([-0.5, 0.5], size=(electrons.shape[0], self.rig.rows, 1))


@hides("law", "darks", right=("black_level_drift",))
class CurvedBlack(Secretive):
    """A black level that bends with temperature."""

    def draw(self, dice, size):
        self.keep(slope=self.sign * dice.uniform(0.05, 0.12) * size, bend=dice.uniform(0.2, 0.5))

    def digital(self, dn, at):
        warmer = at.celsius - 28.0
        return dn + self.slope * warmer * (1 + self.bend * warmer / 13.0)


@hides("law", "levels", right=("gain_step_error",))
class GainTable(Secretive):
    """Each gain step has an error of its own."""

    def draw(self, dice, size):
        self.table = {d: float(dice.choice([-1, 1])) * dice.uniform(0.008, 0.02) * size for d in (4.0, 8.0, 12.0)}
        self.drawn |= {f"error_{d:g}": v for d, v in self.table.items()}

    def analog(self, dn, at, dice):
        return dn * (1 + self.table.get(at.db, 0.0))


@hides(
    "law", "bracket", "flats", right=("mains_ripple",), together=dict.fromkeys(("bracket", "flats"), ("pwm_flicker",))
)
class TriangleHum(Secretive):
    """Light that swings at 100 Hz in triangles."""

    def draw(self, dice, size):
        self.keep(depth=dice.uniform(0.05, 0.2) * size)
        self.dice = np.random.default_rng(int(dice.integers(2**31)))

    def source(self, factor, at):
        phases = self.dice.uniform(size=(len(factor), 1))
        steps = phases + 100.0 * at.seconds * (np.arange(200)[None, :] + 0.5) / 200
        wave = 4 * np.abs(steps % 1.0 - 0.5) - 1
        return factor * (1 + self.depth * wave.mean(axis=1)[:, None, None])


@hides(
    "law",
    "bracket",
    "flats",
    "surrounds",
    right=("natural_vignetting",),
    together=dict.fromkeys((*_LIT, "flats"), ("angle_dependence", "mechanical_vignetting", "display_nonuniformity")),
)
class Polynomial(Secretive):
    """A fall-off 1 − a·ρ² − b·ρ⁶."""

    def draw(self, dice, size):
        self.keep(a=dice.uniform(0.02, 0.05) * size, b=dice.uniform(0.01, 0.03) * size)
        rho2 = ((self.rig.x - (self.rig.columns - 1) / 2) ** 2 + (self.rig.y - (self.rig.rows - 1) / 2) ** 2) / (
            (self.rig.columns / 2) ** 2 + (self.rig.rows / 2) ** 2
        )
        self.fall = 1 - self.a * rho2 - self.b * rho2**3

    def optics(self, radiance, at):
        return radiance * self.fall


@hides("law", "bracket", "levels", right=("response_nonlinearity",), together=dict.fromkeys(_LIT, _BENT))
class Saturating(Secretive):
    """A response as 1/(1 + (z/z0)^1.5)."""

    def draw(self, dice, size):
        self.keep(bend=dice.uniform(0.02, 0.06) * size)

    def charge(self, electrons, at, dice):
        return electrons / (1 + self.bend * (np.maximum(electrons, 0.0) / self.rig.well_e) ** 1.5)


@hides("law", "bracket", "surrounds", right=("veiling_glare",), together={"bracket": _UNIFORM})
class LopsidedVeil(Secretive):
    """A veil of the scene's light that counts the left of the field more."""

    def draw(self, dice, size):
        self.keep(share=dice.uniform(0.006, 0.015) * size)
        self.weight = (1.5 - self.rig.x / self.rig.columns) / float((1.5 - self.rig.x / self.rig.columns).sum())

    def optics(self, radiance, at):
        return (1 - self.share) * radiance + self.share * (radiance * self.weight).sum(axis=(1, 2), keepdims=True)


# ---------------------------------------------------------------------------------------------- outsiders


@hides("outsider", "levels", stage="source", along=("temperature_C",))
class HeatBow(Secretive):
    """The light falls with the square of the distance from the best temperature."""

    def draw(self, dice, size):
        self.keep(depth=dice.uniform(0.03, 0.05) * size)

    def source(self, factor, at):
        return factor * (1 - self.depth * ((at.celsius - 30.0) / 8.0) ** 2)


@hides("outsider", "darks", stage="charge", along=("exposure_s",))
class Traps(Secretive):
    """Charge that grows with the square root of the exposure: traps that empty."""

    def draw(self, dice, size):
        self.keep(charge_e=dice.uniform(10, 25) * size)

    def added(self, at):
        return self.charge_e * math.sqrt(at.seconds / self.rig.longest_s)


@hides("outsider", "levels", stage="readout", along=("image_y", "gain_db"))
class GainedBow(Secretive):
    """A bow over the rows in front of the amplifier."""

    def draw(self, dice, size):
        self.keep(depth_e=self.sign * dice.uniform(10, 20) * size)
        self.bow = ((self.rig.y / self.rig.rows - 0.5) * 2) ** 2

    def analog(self, dn, at, dice):
        return dn + self.depth_e * self.rig.k_dn_per_e * 10 ** (at.db / 20) * self.bow


@hides("outsider", "bracket", "darks", stage="digital", along=("timestamp_s",))
class SlowHum(Secretive):
    """The black level swings with the air conditioner."""

    def draw(self, dice, size):
        self.keep(
            depth_dn=dice.uniform(4, 8) * size * self.rig.k_dn_per_e,
            period_s=dice.uniform(60, 140),
            phase=dice.uniform(0, 6.28),
        )

    def digital(self, dn, at):
        return dn + self.depth_dn * np.sin(2 * math.pi * at.times / self.period_s + self.phase)


@hides("outsider", "bracket", "levels", stage="source", along=("idle_s",))
class RestedLamp(Secretive):
    """A lamp that flashes with each frame is brighter after a rest."""

    def draw(self, dice, size):
        self.keep(depth=dice.uniform(0.02, 0.04) * size, tau_s=dice.uniform(1.5, 6.0))

    def source(self, factor, at):
        return factor * (1 - self.depth * np.exp(-at.idles / self.tau_s))


@hides("outsider", "bracket", stage="shutter", along=("image_y", "exposure_s"))
class SaggingShutter(Secretive):
    """The middle rows are exposed a constant time longer."""

    def draw(self, dice, size):
        self.keep(extra_s=0.04 * size * dice.uniform(1, 2) * self.rig.longest_s * 10**-2.05 * 3)
        self.sag = 1 - (2 * self.rig.y / self.rig.rows - 1) ** 2

    def seconds(self, seconds, at):
        return seconds + self.extra_s * self.sag


@hides("outsider", "bracket", "darks", stage="charge", along=("image_x", "exposure_s"))
class SideLeak(Secretive):
    """Charge in proportion to exposure that fades from the left edge as an exponential."""

    def draw(self, dice, size):
        self.keep(charge_e=dice.uniform(25, 50) * size, reach_px=dice.uniform(0.15, 0.4) * self.rig.columns)

    def added(self, at):
        return self.charge_e * np.exp(-self.rig.x / self.reach_px) * at.seconds / self.rig.longest_s


@hides("outsider", "bracket", "levels", stage="digital", along=("signal",))
class SecondRange(Secretive):
    """Above a quarter of the range the converter switches its range and adds a step."""

    def draw(self, dice, size):
        self.keep(
            limit_dn=dice.uniform(0.15, 0.35) * 2**self.rig.bits,
            step_dn=self.sign * dice.uniform(0.003, 0.006) * size * 2**self.rig.bits,
        )

    def analog(self, dn, at, dice):
        return dn + self.step_dn * (dn > self.limit_dn)


@hides("outsider", "darks", stage="digital", along=("temperature_C",))
class CoolerStep(Secretive):
    """The black level jumps when the cooler switches over."""

    def draw(self, dice, size):
        self.keep(step_dn=self.sign * dice.uniform(3, 6) * size * max(self.rig.k_dn_per_e, 0.3))

    def digital(self, dn, at):
        return dn + self.step_dn * (at.celsius > 33.0)


@hides("outsider", "levels", stage="scene", along=("image_x", "source_level"))
class TiltingLight(Secretive):
    """The screen's light tilts sideways the more the higher it is driven."""

    def draw(self, dice, size):
        self.keep(tilt=self.sign * dice.uniform(0.03, 0.06) * size)
        self.across = 2 * self.rig.x / self.rig.columns - 1

    def scene(self, radiance, at):
        return radiance * (1 + self.tilt * at.level * self.across)


@hides("outsider", "bracket", "levels", "flats", stage="source", along=("frame",))
class SeventhFrame(Secretive):
    """Every seventh frame is brighter."""

    def draw(self, dice, size):
        self.keep(depth=dice.uniform(0.03, 0.06) * size, which=float(dice.integers(7)))

    def source(self, factor, at):
        number = at.first + np.arange(len(factor))[:, None, None]
        return factor * (1 + self.depth * (number % 7 == self.which))


@hides("outsider", "bracket", "flats", "levels", stage="optics", along=("image_xy",))
class BrightSpot(Secretive):
    """A reflection between the lenses brightens a round spot."""

    def draw(self, dice, size):
        self.keep(
            depth=dice.uniform(0.03, 0.06) * size,
            x=dice.uniform(0.2, 0.8),
            y=dice.uniform(0.2, 0.8),
            width=dice.uniform(0.1, 0.2),
        )
        across = (self.rig.x / self.rig.columns - self.x) ** 2 + (
            (self.rig.y - self.y * self.rig.rows) / self.rig.columns
        ) ** 2
        self.spot = 1 + self.depth * np.exp(-across / 2 / self.width**2)

    def optics(self, radiance, at):
        return radiance * self.spot


def smeared(picture: np.ndarray, kernel: np.ndarray, axis: int) -> np.ndarray:
    """Return a stack folded with a kernel along an axis; borders repeat."""
    reach = len(kernel) // 2
    ends = [(0, 0)] * 3
    ends[axis] = (reach, reach)
    wide = np.pad(picture, ends, mode="edge")
    out = np.zeros_like(picture)
    for i, share in enumerate(kernel):
        part = [slice(None)] * 3
        part[axis] = slice(i, i + picture.shape[axis])
        out += share * wide[tuple(part)]
    return out
