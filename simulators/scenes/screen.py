"""A display that shows patches on a uniform surround."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from radiometer.data import Patch, PatchDescription
from radiometer.data.validation import ConfigSection, Side
from simulators.scenes.base import SceneImage
from simulators.scenes.layout import LitScene, described, per_pattern, refuse_outside, refuse_unknown_pattern

# Drive of the surround in patterns that every screen can show: the patches of its first pattern stay as they are.
SURROUNDS = {"bright_surround": 1.0, "dark_surround": 0.0}


class ScreenPatch(ConfigSection):
    """A patch of the screen: where it appears on the sensor in pixels, and its drive or radiance.

    `drive` (0 to 1) may differ between patterns; `radiance_W_per_sr_m2` states the radiance outright instead.
    """

    name: str
    x: int = Field(ge=0)
    y: int = Field(ge=0)
    width: Side
    height: Side
    drive: float | dict[str, float] | None = None
    radiance_W_per_sr_m2: float | None = Field(None, ge=0)  # noqa: N815 (the file's key)

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.drive is None) == (self.radiance_W_per_sr_m2 is None):
            raise ValueError(f"patch {self.name!r} needs either drive or radiance_W_per_sr_m2")
        drives = self.drive.values() if isinstance(self.drive, dict) else [self.drive or 0.0]
        if any(not 0.0 <= drive <= 1.0 for drive in drives):
            raise ValueError(f"patch {self.name!r}: a drive is between 0 and 1")
        return self

    @property
    def patch(self) -> Patch:
        """Return the region."""
        return Patch(self.x, self.y, self.width, self.height)


class ScreenScene(LitScene):
    """A display with L(d) = L_peak·d^γ: patches on a uniform surround.

    `background` is the surround's drive, one number or one per pattern; pattern names come from the patches and
    the background together. `bright_surround` and `dark_surround` show the first pattern's patches in another one.
    """

    kind: Literal["screen"] = "screen"
    peak_radiance_W_per_sr_m2: float = Field(0.5, gt=0)  # noqa: N815 (the file's key)
    gamma: float = Field(2.2, gt=0, le=5)
    background: float | dict[str, float] = 0.0
    patches_px: tuple[ScreenPatch, ...] = Field((), alias="patches")
    source_kind = "screen"

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return all pattern names that occur, or "default", and the first one's patches in other surrounds."""
        return tuple(dict.fromkeys((*self._stated, *SURROUNDS)))

    @property
    def _stated(self) -> tuple[str, ...]:
        tables = [t for t in (self.background, *(p.drive for p in self.patches_px)) if isinstance(t, dict)]
        return tuple(dict.fromkeys(name for table in tables for name in table)) or ("default",)

    @model_validator(mode="after")
    def _patterns_complete(self) -> Self:
        for name, table in (("background", self.background), *((p.name, p.drive) for p in self.patches_px)):
            missing = set(self._stated) - set(table) if isinstance(table, dict) else None
            if missing:
                raise ValueError(f"{name}: states no drive for pattern {', '.join(sorted(missing))}")
        return self

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return radiance and drive at every pixel. Raises ConfigurationError where a patch is off the sensor."""
        refuse_unknown_pattern(pattern, self.patterns)
        own = self._shown(pattern)
        drive = _drive(self.background, pattern) if own == pattern else SURROUNDS[pattern]
        code = np.full((height, width), drive, np.float32)
        for patch in self.patches_px:
            refuse_outside(patch.name, patch.patch, width, height)
            code[patch.patch.slices] = self._drive_of(patch, own)
        radiance = np.float32(self.peak_radiance_W_per_sr_m2) * code ** np.float32(self.gamma)
        return SceneImage(radiance, code, self.peak_radiance_W_per_sr_m2)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return tuple(self._described(patch) for patch in self.patches_px)

    def _described(self, patch: ScreenPatch) -> PatchDescription:
        radiance = {
            pattern: self.peak_radiance_W_per_sr_m2 * self._drive_of(patch, self._shown(pattern)) ** self.gamma
            for pattern in self.patterns
        }
        return described(patch.name, patch.patch, per_pattern(radiance))

    def _shown(self, pattern: str) -> str:
        """Return the pattern whose patches are shown: its own, or the first one's in another surround."""
        return pattern if pattern in self._stated else self._stated[0]

    def _drive_of(self, patch: ScreenPatch, pattern: str) -> float:
        if patch.radiance_W_per_sr_m2 is not None:
            return float((patch.radiance_W_per_sr_m2 / self.peak_radiance_W_per_sr_m2) ** (1.0 / self.gamma))
        return _drive(patch.drive or 0.0, pattern)


def _drive(table: float | dict[str, float], pattern: str) -> float:
    return table[pattern] if isinstance(table, dict) else table
