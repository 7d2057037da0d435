"""Kinds of scenes; a new one is a class here and a line in the table at the end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any, Final, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from radiometer.data import Patch, PatchDescription
from radiometer.data.guards import refuse_large_picture, refuse_size
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.tiff_pixels import decoded
from radiometer.data.validation import ConfigSection, Side, validate
from radiometer.errors import CaptureError, ConfigurationError, required_library
from simulators.scenes.base import (
    LitScene,
    Scene,
    SceneImage,
    Weight,
    described,
    grid,
    per_pattern,
    refuse_outside,
    refuse_unknown_pattern,
)


class UniformScene(LitScene):
    """Uniform radiance over the whole field; the scene for characterising a camera."""

    kind: Literal["uniform"] = "uniform"
    radiance_W_per_sr_m2: float = Field(1.0, ge=0)  # noqa: N815 (the file's key)
    source_kind = "sphere"

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        refuse_unknown_pattern(pattern, self.patterns)
        level = self.radiance_W_per_sr_m2
        return SceneImage(np.full((height, width), level, np.float32), peak_radiance=level)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        return (described("field", Patch(0, 0, width, height), self.radiance_W_per_sr_m2),)


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


class Steps(ConfigSection):
    """Equal steps of log radiance: how many, from where to where in W·sr⁻¹·m⁻²."""

    count: int = Field(gt=0, le=4096)
    lowest: float = Field(gt=0)
    highest: float = Field(gt=0)


class StepChartScene(LitScene):
    """Patches in a grid on a surround, from the darkest to the lightest row by row, or scrambled.

    Give `radiances_W_per_sr_m2` or `steps`. The share `margin` of each cell's side stays surround; `scramble_seed`
    shuffles the patches. The switch `inverted: true` adds a pattern in reverse order, so that every patch is seen at
    two radiances.
    """

    kind: Literal["step_chart"] = "step_chart"
    radiances_W_per_sr_m2: tuple[float, ...] | None = None  # noqa: N815 (the file's key)
    steps: Steps | None = None
    background_W_per_sr_m2: float = Field(0.0, ge=0)  # noqa: N815
    columns: int | None = Field(None, gt=0)
    margin: float = Field(0.3, ge=0, lt=1)
    scramble_seed: int | None = None
    inverted: bool = False

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.radiances_W_per_sr_m2 is None) == (self.steps is None):
            raise ValueError("give either radiances_W_per_sr_m2 or steps")
        if self.radiances_W_per_sr_m2 is not None and (
            not self.radiances_W_per_sr_m2 or min(self.radiances_W_per_sr_m2) < 0
        ):
            raise ValueError("radiances_W_per_sr_m2 needs at least one value, each 0 or more")
        return self

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return "default", with "inverted" where asked for."""
        return ("default", "inverted") if self.inverted else ("default",)

    def radiances(self, pattern: str = "default") -> NDArray[np.float64]:
        """Return the radiance of each patch in W·sr⁻¹·m⁻² in the order of `patches`."""
        if self.steps is not None:
            values = np.geomspace(self.steps.lowest, self.steps.highest, self.steps.count)
        else:
            values = np.array(self.radiances_W_per_sr_m2)
        if self.scramble_seed is not None:
            values = np.random.default_rng(self.scramble_seed).permutation(values)
        return values[::-1] if pattern == "inverted" else values

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the chart. Raises ConfigurationError where the sensor is too small for it."""
        refuse_unknown_pattern(pattern, self.patterns)
        radiance = np.full((height, width), self.background_W_per_sr_m2, np.float32)
        values = self.radiances(pattern)
        for patch, value in zip(self._layout(width, height), values, strict=True):
            radiance[patch.slices] = value
        return SceneImage(radiance, peak_radiance=float(values.max()))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the patches p00, p01, … with the radiance of each pattern."""
        by_pattern = {pattern: self.radiances(pattern) for pattern in self.patterns}
        return tuple(
            described(f"p{index:02d}", patch, per_pattern({name: float(t[index]) for name, t in by_pattern.items()}))
            for index, patch in enumerate(self._layout(width, height))
        )

    def _layout(self, width: int, height: int) -> tuple[Patch, ...]:
        return grid(len(self.radiances()), self.columns, self.margin, width, height)


_GRID_NM = np.arange(350.0, 851.0)  # a camera sees nothing beyond


class ColourLight(ConfigSection):
    """One light: its name, and bands of (peak in nm, full width at half maximum in nm, radiance in W·sr⁻¹·m⁻²)."""

    name: str
    bands: tuple[tuple[float, float, float], ...] = Field(min_length=1)

    def spectral_radiance(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the spectral radiance in W·sr⁻¹·m⁻²·nm⁻¹: a sum of Gaussians."""
        found = np.zeros(wavelength_nm.shape)
        for peak_nm, width_nm, radiance in self.bands:
            sigma_nm = width_nm / math.sqrt(8.0 * math.log(2.0))
            bell = np.exp(-0.5 * ((wavelength_nm - peak_nm) / sigma_nm) ** 2)
            found += radiance * bell / (sigma_nm * math.sqrt(2.0 * math.pi))
        return found


class ColourChartScene(LitScene):
    """Lights in a grid on a dark surround, row by row. `margin` of each cell's side stays dark."""

    kind: Literal["colour_chart"] = "colour_chart"
    lights: tuple[ColourLight, ...] = Field(min_length=1)
    columns: int | None = Field(None, gt=0)
    margin: float = Field(0.3, ge=0, lt=1)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the radiance of the lights. Raises ConfigurationError where the sensor is too small for them."""
        return self.seen_through(np.ones_like, width, height, pattern)

    def seen_through(self, weight: Weight, width: int, height: int, pattern: str = "default") -> SceneImage:
        refuse_unknown_pattern(pattern, self.patterns)
        radiance = np.zeros((height, width), np.float32)
        values = [float(np.sum(one.spectral_radiance(_GRID_NM) * weight(_GRID_NM))) for one in self.lights]
        for patch, value in zip(grid(len(values), self.columns, self.margin, width, height), values, strict=True):
            radiance[patch.slices] = value
        return SceneImage(radiance, peak_radiance=max(values))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        places = grid(len(self.lights), self.columns, self.margin, width, height)
        return tuple(
            described(one.name, patch, sum(radiance for *_, radiance in one.bands))
            for one, patch in zip(self.lights, places, strict=True)
        )


_OVERSAMPLING = 5  # per pixel and axis: an edge is placed to a fifth of a pixel


class LedScene(LitScene):
    """A round emitting area of known flux, with a glow around it where it is out of focus.

    The diode emits as L(θ) = L₀·cosᵐ⁻¹θ (intensity ∝ cosᵐθ) with cosᵐ(half angle) = 1/2, so its flux Φ and its axial
    radiance are tied by Φ = 2π·A·L₀/(m + 1), A the emitting area. The image of the area is a disc of `diameter_px`;
    defocus spreads it by a disc of `blur_px` and keeps its total.

    A lens near a narrow beam sees less than the axial radiance towards the rim of its pupil. With
    `pupil_half_angle_deg`, the angle that the pupil's radius subtends at the diode, the picture holds the radiance
    that, taken as the same over the pupil, carries the true flux: Φ·(1 − cosᵐ⁺¹θ_p) / (π·A·tan²θ_p).

    Source: generalised Lambertian emitter (Moreno and Sun 2008, equation 1).
    """

    kind: Literal["led"] = "led"
    flux_mW: float = Field(5.0, gt=0)  # noqa: N815 (the file's key)
    emitter_diameter_mm: float = Field(5.0, gt=0)
    half_angle_deg: float = Field(60.0, gt=0, lt=90)
    pupil_half_angle_deg: float | None = Field(None, gt=0, lt=80)
    diameter_px: float = Field(60.0, gt=0)
    blur_px: float = Field(0.0, ge=0)
    center_px: tuple[float, float] | None = None
    background_W_per_sr_m2: float = Field(0.0, ge=0)  # noqa: N815
    source_kind = "led"
    wavelength_nm: float = Field(590.0, gt=0)

    @property
    def intensity_exponent(self) -> float:
        """Return m of I ∝ cosᵐθ; 1 for a Lambertian emitter (half angle 60°)."""
        return math.log(0.5) / math.log(math.cos(math.radians(self.half_angle_deg)))

    @property
    def emitting_area_m2(self) -> float:
        """Return the emitting area in m²."""
        return math.pi * (0.5e-3 * self.emitter_diameter_mm) ** 2

    @property
    def axial_radiance(self) -> float:
        """Return L₀ in W·sr⁻¹·m⁻² at source level 1."""
        flux_w = 1e-3 * self.flux_mW
        return flux_w * (self.intensity_exponent + 1) / (2 * math.pi * self.emitting_area_m2)

    @property
    def seen_radiance(self) -> float:
        """Return the radiance in W·sr⁻¹·m⁻² that the lens sees, averaged over its pupil; axial where that is small."""
        if self.pupil_half_angle_deg is None:
            return self.axial_radiance
        theta = math.radians(self.pupil_half_angle_deg)
        entering_w = 1e-3 * self.flux_mW * (1.0 - math.cos(theta) ** (self.intensity_exponent + 1))
        return float(entering_w / (math.pi * self.emitting_area_m2 * math.tan(theta) ** 2))

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the disc (its edge pixels by the share that it covers), spread by the defocus."""
        refuse_unknown_pattern(pattern, self.patterns)
        share = _disc(width, height, self._center(width, height), self.diameter_px)
        if self.blur_px > 0:
            share = cv2.filter2D(share, -1, _disc_kernel(self.blur_px), borderType=cv2.BORDER_CONSTANT)
        radiance = share * np.float32(self.seen_radiance) + np.float32(self.background_W_per_sr_m2)
        return SceneImage(radiance.astype(np.float32), peak_radiance=self.seen_radiance)

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return the square inside the part of the disc that defocus leaves flat; none where nothing is flat."""
        side = int((self.diameter_px - self.blur_px) / math.sqrt(2)) - 2
        x, y = (round(c - (side - 1) / 2) for c in self._center(width, height))
        if side < 1 or min(x, y) < 0 or x + side > width or y + side > height:
            return ()
        radiance = self.seen_radiance + self.background_W_per_sr_m2
        return (described("led", Patch(x, y, side, side), radiance),)

    def _center(self, width: int, height: int) -> tuple[float, float]:
        return self.center_px or ((width - 1) / 2, (height - 1) / 2)


def _disc(width: int, height: int, center: tuple[float, float], diameter: float) -> NDArray[np.float32]:
    """Return the share of each pixel that a disc covers, from 5 × 5 points per pixel in its bounding box."""
    share = np.zeros((height, width), np.float32)
    x0, y0 = (max(math.floor(c - diameter / 2 - 1), 0) for c in center)
    x1 = min(math.ceil(center[0] + diameter / 2 + 2), width)
    y1 = min(math.ceil(center[1] + diameter / 2 + 2), height)
    if x1 <= x0 or y1 <= y0:
        return share
    n = _OVERSAMPLING
    xs = x0 - 0.5 + (np.arange((x1 - x0) * n) + 0.5) / n - center[0]
    ys = y0 - 0.5 + (np.arange((y1 - y0) * n) + 0.5) / n - center[1]
    inside = np.square(xs)[np.newaxis, :] + np.square(ys)[:, np.newaxis] <= (diameter / 2) ** 2
    share[y0:y1, x0:x1] = inside.reshape(y1 - y0, n, x1 - x0, n).mean(axis=(1, 3))
    return share


def _disc_kernel(diameter: float) -> NDArray[np.float32]:
    side = 2 * math.ceil(diameter / 2) + 1
    kernel = _disc(side, side, ((side - 1) / 2, (side - 1) / 2), diameter)
    normalised: NDArray[np.float32] = kernel / kernel.sum()
    return normalised


class ImageScene(LitScene):
    """An image file whose values are radiance: L = L_peak·v^γ, v the value over full scale (over 1 for float images).

    Any image that OpenCV reads (PNG, TIFF, JPEG, Radiance HDR), an OpenEXR `.exr` or a NumPy `.npy`; colours become
    luma. It is scaled to the sensor by area averaging.
    """

    kind: Literal["image"] = "image"
    file: Path
    peak_radiance_W_per_sr_m2: float = Field(1.0, gt=0)  # noqa: N815 (the file's key)
    gamma: float = Field(1.0, gt=0, le=5)

    def render(self, width: int, height: int, pattern: str = "default") -> SceneImage:
        """Return the picture's radiance. Raises ConfigurationError if the file is no usable image."""
        refuse_unknown_pattern(pattern, self.patterns)
        relative = cv2.resize(_read_relative(self.file), (width, height), interpolation=cv2.INTER_AREA)
        if not np.all(np.isfinite(relative)) or float(relative.min()) < 0:
            raise ConfigurationError(f"scene: {self.file}: holds values that are negative or not finite")
        peak = np.float32(self.peak_radiance_W_per_sr_m2)
        radiance = (peak * relative ** np.float32(self.gamma)).astype(np.float32)
        return SceneImage(radiance, peak_radiance=float(radiance.max()))

    def patches(self, width: int, height: int) -> tuple[PatchDescription, ...]:
        """Return none: a picture has no patches."""
        return ()


@bounded_reader(error=ConfigurationError)
def _read_relative(path: Path) -> NDArray[np.float32]:
    """Return one channel, 1 at full scale of an integer image."""
    try:
        image: Any = _READERS.get(path.suffix.lower(), _decode)(path)
    except (OSError, ValueError, cv2.error, CaptureError) as error:
        raise ConfigurationError(f"scene: cannot read {path}: {error}") from error
    if image is None or image.ndim not in (2, 3) or not image.size or image.dtype.kind not in "uif":
        raise ConfigurationError(f"scene: {path} is not an image that can be read")
    scale = float(np.iinfo(image.dtype).max) if np.issubdtype(image.dtype, np.integer) else 1.0
    relative = np.asarray(image, np.float32) / np.float32(scale)
    if relative.ndim == 3 and relative.shape[2] < 3:
        return relative[..., 0]
    if relative.ndim == 3:
        relative = cv2.cvtColor(np.ascontiguousarray(relative[..., :3]), cv2.COLOR_BGR2GRAY)
    return relative


def _decode(path: Path) -> NDArray[np.generic] | None:
    content = np.fromfile(path, np.uint8)
    refuse_large_picture(path, content.tobytes())
    picture: NDArray[np.generic] | None = decoded(content)
    return picture


@bounded_reader(error=ConfigurationError, apart="OpenEXR")
def _exr(path: Path) -> NDArray[np.generic]:
    """Return blue, green and red, or the one channel, of an OpenEXR picture."""
    with path.open("rb") as stream:
        refuse_large_picture(path, stream.read(2**16))
    OpenEXR = required_library("OpenEXR", "reading .exr needs the package OpenEXR (pip install OpenEXR); or give .hdr")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, KeyError, MemoryError) as error:
        raise ValueError(f"damaged, or a form of OpenEXR that is not read ({error})") from error
    if {"R", "G", "B"} <= channels.keys():
        return np.stack([channels[name] for name in "BGR"], axis=-1)
    if len(channels) != 1 and "Y" not in channels:
        raise ValueError(f"it holds the channels {', '.join(sorted(channels))[:80]}; R, G, B or Y are read")
    return channels["Y"] if "Y" in channels else next(iter(channels.values()))


def _table(path: Path) -> NDArray[np.generic]:
    """Return a NumPy array no larger than what a picture may be; a header that states more is not followed."""
    try:
        stated = np.load(path, mmap_mode="r", allow_pickle=False)  # maps the file; reads no value
    except (
        EOFError,
        SyntaxError,
        TokenError,
        TypeError,
        LookupError,
        OverflowError,
        MemoryError,
        RecursionError,
    ) as error:
        raise ValueError(f"its header is damaged ({error})") from error
    if not isinstance(stated, np.ndarray):
        raise ValueError("it holds several arrays")
    refuse_size(path, stated.shape, stated.dtype.itemsize)
    return np.array(stated)


_READERS: Final = {".npy": _table, ".exr": _exr}


SCENES: Final[dict[str, type[LitScene]]] = {
    "colour_chart": ColourChartScene,
    "image": ImageScene,
    "led": LedScene,
    "screen": ScreenScene,
    "step_chart": StepChartScene,
    "uniform": UniformScene,
}


def scene_from_mapping(mapping: Mapping[str, Any], where: str = "scene", folder: Path | None = None) -> Scene:
    """Return the scene that a mapping describes.

    Args:
        mapping: `kind` and the keys of that kind.
        folder: Folder that a relative `file` is found in.

    Raises:
        ConfigurationError: If the kind or a key is unknown, or a value is not allowed; the message names it.
    """
    kind = mapping.get("kind")
    if not isinstance(kind, str) or kind not in SCENES:
        raise ConfigurationError(f"{where}: kind = {kind!r}: there is no such scene; allowed are {', '.join(SCENES)}")
    model: type[BaseModel] = SCENES[kind]
    scene: Any = validate(model, mapping, where, ConfigurationError)
    if isinstance(scene, ImageScene) and folder is not None and not scene.file.is_absolute():
        return scene.model_copy(update={"file": folder / scene.file})
    made: LitScene = scene
    return made
