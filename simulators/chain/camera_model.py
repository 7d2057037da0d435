"""A camera as a chain of effects, from the radiance of a scene to digital numbers.

model = CameraModel.ideal(camera, lens)                  # what the datasheets believe
model = model.with_effect(make_effect("exposure_time_offset", {"offset_s": 2e-5}))

context = model.context(settings, FrameGeometry.of_image(640, 480))
expected = model.moments(radiance, context)              # mean and variances in DN, no randomness
exposed = model.sample(radiance, context, seed=(7, 0))   # one frame
model.write(Path("reconciled.yaml"))
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from pydantic import Field

from radiometer.data import CameraDescription, FrameSettings, LensDescription
from radiometer.data.frame import DigitalNumbers
from radiometer.data.storage import read_yaml, write_yaml_atomic
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError, MeasurementError
from simulators.chain.ideal_chain import ideal_chain
from simulators.chain.stages import place_for
from simulators.effects.base import DIGITAL_NUMBER, RADIANCE, Effect, Moments, Stage
from simulators.effects.context import ExposureContext, FrameGeometry, Signal
from simulators.effects.registry import EffectEntry
from simulators.scenes.base import Scene, SceneImage

FORMAT: Final = "radiometer-model/1"
DEFAULT_WAVELENGTH_NM: Final = 550.0  # the middle of the visible, near the peak of V(λ)

_ResultT = TypeVar("_ResultT")


class _ModelFile(ConfigSection):
    format: str = Field(pattern=f"^{FORMAT}$")
    camera: CameraDescription
    lens: LensDescription = LensDescription()
    wavelength_nm: float = Field(DEFAULT_WAVELENGTH_NM, gt=0)
    effects: list[dict[str, Any]] = Field(min_length=1)


@dataclass(frozen=True, slots=True, eq=False)
class Exposed:
    """One simulated frame."""

    dn: DigitalNumbers  # digital numbers, uint8 up to 8 bits and uint16 above
    electrons: Signal  # what the pixels held at the end of the well stage; the next frame's `previous_e`


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A chain of effects whose units fit from one to the next."""

    camera: CameraDescription  # what the camera is called and believed to be, in its native bit depth
    entries: tuple[EffectEntry, ...]  # effects in the order of the chain, also those that are switched off
    lens: LensDescription = field(default_factory=LensDescription)  # the lens in front of it
    wavelength_nm: float = DEFAULT_WAVELENGTH_NM  # effective wavelength of the light

    def __post_init__(self) -> None:
        """Put the entries in stage order and check units. Raises ConfigurationError naming the effect that fails."""
        ordered = tuple(sorted(self.entries, key=lambda entry: entry.effect.stage))
        object.__setattr__(self, "entries", ordered)
        unit, giver = RADIANCE, "the scene"
        for effect in self.effects:
            if effect.unit_in != unit:
                raise ConfigurationError(
                    f"camera model: effect {effect.name!r} ({effect.stage.name.lower()} stage) takes {effect.unit_in}, "
                    f"but {giver} before it gives {unit}; an effect between them is missing, switched off or misplaced"
                )
            unit, giver = effect.unit_out, repr(effect.name)
        if unit != DIGITAL_NUMBER:
            raise ConfigurationError(f"camera model: ends with {giver} in {unit}, not in {DIGITAL_NUMBER}")

    @classmethod
    def ideal(
        cls,
        camera: CameraDescription,
        lens: LensDescription | None = None,
        wavelength_nm: float = DEFAULT_WAVELENGTH_NM,
    ) -> CameraModel:
        """Return the ideal EMVA 1288 chain of a camera and lens. Raises ConfigurationError if a figure is missing."""
        lens = lens or LensDescription()
        entries = tuple(EffectEntry(effect) for effect in ideal_chain(camera, lens))
        return cls(camera, entries, lens, wavelength_nm)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the effects that are switched on, in order."""
        return tuple(entry.effect for entry in self.entries if entry.enabled)

    def effect(self, name: str) -> Effect:
        """Return the first enabled effect of a name. Raises ConfigurationError if there is none."""
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise ConfigurationError(f"camera model: has no enabled effect {name!r}")

    def with_effect(self, effect: Effect, notes: Mapping[str, Any] | None = None) -> CameraModel:
        """Return the model with an effect added: in front of `effect.before`, else as late in its stage as fits.

        Raises:
            ConfigurationError: If its unit fits nowhere in its stage.
        """
        entry = EffectEntry(effect, notes=notes or {})
        at = place_for(effect, [e.effect for e in self.entries], [e.enabled for e in self.entries])
        return replace(self, entries=(*self.entries[:at], entry, *self.entries[at:]))

    def without_effect(self, name: str) -> CameraModel:
        """Return the model with every effect of a name switched off. Raises ConfigurationError if units then fail."""
        self.effect(name)
        entries = (replace(e, enabled=False) if e.effect.name == name else e for e in self.entries)
        return replace(self, entries=tuple(entries))

    def with_parameters(self, name: str, **values: Any) -> CameraModel:
        """Return the model with parameters of the first enabled effect of a name changed."""
        chosen = self.effect(name)
        entries = tuple(
            replace(e, effect=chosen.with_parameters(**values)) if e.effect is chosen else e for e in self.entries
        )
        return replace(self, entries=entries)

    def context(self, settings: FrameSettings, geometry: FrameGeometry, **more: Any) -> ExposureContext:
        """Return the context of one frame; `more` are further attributes of ExposureContext."""
        return ExposureContext(
            settings, geometry, self.camera, self.lens, **({"wavelength_nm": self.wavelength_nm} | more)
        )

    def mean(self, radiance: Signal, context: ExposureContext, until: Stage = Stage.DIGITAL) -> Signal:
        """Return the noiseless signal after a stage (by default the expected DN, not rounded).

        Raises:
            MeasurementError: If an effect fails; the message names it.
        """
        signal = np.asarray(radiance, dtype=np.float64)
        for effect in self.effects:
            if effect.stage <= until:
                signal = _run(effect, lambda e=effect, s=signal: e.mean(s, context))  # type: ignore[misc]
        return signal

    def moments(self, radiance: Signal, context: ExposureContext, until: Stage = Stage.DIGITAL) -> Moments:
        """Return mean, temporal, fixed-pattern and frame-common variance after a stage (by default in DN).

        Each limit treats what reaches it as normal. Where full well and converter end within 3 sigma of each other,
        the second starts from the first's clipped distribution, and the mean was found up to 0.05 sigma off there.

        Raises:
            MeasurementError: If an effect fails; the message names it.
        """
        moments = Moments.exactly(np.asarray(radiance, dtype=np.float64))
        for effect in self.effects:
            if effect.stage <= until:
                moments = _run(effect, lambda e=effect, m=moments: e.moments(m, context))  # type: ignore[misc]
        return moments

    def sample(self, radiance: Signal, context: ExposureContext, seed: Sequence[int]) -> Exposed:
        """Return one random frame; the same seed gives the same frame.

        Each effect draws from a separate generator, so that adding one leaves the noise of the others as it was.

        Args:
            radiance: Scene radiance in W·sr⁻¹·m⁻², shape of the geometry.
            context: The frame's circumstances.
            seed: Whole numbers, such as (run, frame number).

        Raises:
            MeasurementError: If an effect fails; the message names it.
        """
        signal: Signal = np.broadcast_to(np.asarray(radiance, dtype=np.float32), context.geometry.shape)
        electrons, drawn = signal, dict[str, int]()
        for effect in self.effects:
            drawn[effect.name] = drawn.get(effect.name, -1) + 1
            rng = np.random.default_rng((*seed, zlib.crc32(effect.name.encode()), drawn[effect.name]))
            signal = _run(effect, lambda e=effect, s=signal, r=rng: e.sample(s, context, r))  # type: ignore[misc]
            if effect.stage <= Stage.WELL:
                electrons = signal
        dn = signal.astype(np.uint8) if context.full_scale_dn < 256 else signal.astype(np.uint16)
        return Exposed(dn, electrons)

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that a model file holds."""
        return {
            "format": FORMAT,
            "camera": self.camera.model_dump(mode="json", exclude_none=True),
            "lens": self.lens.model_dump(mode="json", exclude_none=True),
            "wavelength_nm": self.wavelength_nm,
            "effects": [entry.to_mapping() for entry in self.entries],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> CameraModel:
        """Return the model that a mapping describes. Raises ConfigurationError saying what is wrong where."""
        file = validate(_ModelFile, mapping, where, ConfigurationError)
        entries = tuple(
            EffectEntry.from_mapping(entry, f"{where}: effects[{index}]") for index, entry in enumerate(file.effects)
        )
        return cls(file.camera, entries, file.lens, file.wavelength_nm)

    @classmethod
    def read(cls, path: Path) -> CameraModel:
        """Return the model in a YAML file. Raises InputError or ConfigurationError saying what is wrong where."""
        return cls.from_mapping(read_yaml(path), str(path))

    def write(self, path: Path | str) -> None:
        """Write the model as YAML, whole or not at all. Raises OutputError."""
        write_yaml_atomic(Path(path), self.to_mapping())


def _run(effect: Effect, step: Callable[[], _ResultT]) -> _ResultT:
    """Run one effect; an error is reported under its name."""
    try:
        with np.errstate(invalid="raise", divide="raise", over="raise"):
            result = step()
    except ConfigurationError as error:
        raise ConfigurationError(f"effect {effect.name!r}: {error}") from error
    except (ArithmeticError, ValueError, TypeError, IndexError, KeyError) as error:
        raise MeasurementError(f"effect {effect.name!r} failed: {error}; check its parameters and the scene") from error
    checked = np.asarray(result.mean if isinstance(result, Moments) else result)
    if not np.isfinite(checked.sum(dtype=np.float64)):
        raise MeasurementError(f"effect {effect.name!r} gave values that are not finite; check its parameters")
    return result


class VirtualSensor:
    """Exposes frames of a scene through a camera model.

    The whole sensor is simulated whatever region is asked for, so that glare, neighbours and fixed patterns stay
    what they are.

    Args:
        width: Sensor width in pixels.
        height: Sensor height in pixels.
        seed: Makes the noise; the same seed gives the same frames in the same order.
        device_seed: Makes this camera's fixed patterns.
    """

    def __init__(
        self, model: CameraModel, scene: Scene, width: int, height: int, *, seed: int = 0, device_seed: int = 0
    ) -> None:
        self.model, self.scene = model, scene
        self.width, self.height = width, height
        self.seed, self.device_seed = seed, device_seed
        self.frames_exposed = 0
        self._previous_e: Signal | None = None
        self._past = FadingPast()
        self._last_light_s: float | None = None
        self._last_frame_s: float | None = None
        self._rendered: tuple[Scene, str, SceneImage] | None = None

    def expose(
        self, settings: FrameSettings, *, output_bit_depth: int | None = None, binning: int = 1, frame_index: int = 0
    ) -> DigitalNumbers:
        """Return the digital numbers of the next frame, shape (height // binning, width // binning).

        Args:
            settings: Settings of the frame; the black level in DN of the output.
            output_bit_depth: Bits per pixel; None for the model's own.
            binning: Pixels summed in each direction.

        Raises:
            ConfigurationError: If the scene has no such pattern or the model lacks a figure.
            MeasurementError: If an effect fails; the message names it.
        """
        image = self._image(settings.pattern)
        geometry = self._geometry(binning)
        context = self.model.context(
            self._native(settings, output_bit_depth),
            geometry,
            wavelength_nm=self.scene.source.wavelength_nm or self.model.wavelength_nm,
            code=None if image.code is None else _binned(np.asarray(image.code), binning),
            peak_radiance=image.peak_radiance,
            previous_e=self._fitting_previous(geometry),
            past=self._past.at(settings.timestamp_s, geometry.shape),
            since_light_s=self._since(self._last_light_s, settings),
            since_frame_s=self._since(self._last_frame_s, settings),
            frame_index=frame_index,
            frame_numbers=(self.frames_exposed,),
            device_seed=self.device_seed,
            output_bit_depth=output_bit_depth,
        )
        exposed = self.model.sample(_binned(image.radiance, binning), context, (self.seed, self.frames_exposed))
        self._previous_e = exposed.electrons
        self._past.add(exposed.electrons, settings.timestamp_s)
        self.frames_exposed += 1
        self._last_frame_s = settings.timestamp_s
        if not settings.is_dark and settings.source_level > 0:
            self._last_light_s = settings.timestamp_s
        return exposed.dn

    @staticmethod
    def _since(last_s: float | None, settings: FrameSettings) -> float | None:
        return None if last_s is None or settings.timestamp_s is None else settings.timestamp_s - last_s

    def _image(self, pattern: str) -> SceneImage:
        if self._rendered is None or self._rendered[0] is not self.scene or self._rendered[1] != pattern:
            self._rendered = (self.scene, pattern, self.scene.render(self.width, self.height, pattern))
        return self._rendered[2]

    def _geometry(self, binning: int) -> FrameGeometry:
        camera = self.model.camera
        return FrameGeometry.of_image(
            self.width // binning,
            self.height // binning,
            binning=binning,
            sensor_width=self.width,
            sensor_height=self.height,
            principal_point_px=self.model.lens.principal_point_px,
            pixel_spacing_um=camera.pixel_spacing_um or camera.pixel_pitch_um or 1.0,
        )

    def _native(self, settings: FrameSettings, output_bit_depth: int | None) -> FrameSettings:
        if settings.black_level_dn is None or output_bit_depth is None:
            return settings
        scale = 2.0 ** (self.model.camera.bit_depth - output_bit_depth)
        return replace(settings, black_level_dn=settings.black_level_dn * scale)

    def _fitting_previous(self, geometry: FrameGeometry) -> Signal | None:
        previous = self._previous_e
        return previous if previous is not None and previous.shape == geometry.shape else None


class FadingPast:
    """What earlier frames held, added up for each time constant that was asked for: one picture for each of them.

    It counts from the first frame on for which an effect asks.
    """

    def __init__(self) -> None:
        self._now_s, self._last_s, self._shape = 0.0, 0.0, tuple[int, ...]()
        self._faded: dict[float, Signal] = {}

    def at(self, now_s: float | None, shape: tuple[int, ...]) -> FadingPast | None:
        """Return the past as a frame of this time and shape sees it; None without a time. Another shape forgets it."""
        if shape != self._shape:
            self._shape, self._faded = shape, {}
        self._now_s = self._now_s if now_s is None else now_s
        return None if now_s is None else self

    def faded(self, tau_s: float) -> Signal:
        """Return the sum of what earlier frames held, each times exp(−age/τ)."""
        known = self._faded.setdefault(tau_s, np.zeros(self._shape))
        return np.asarray(known * np.exp(-(self._now_s - self._last_s) / tau_s))

    def add(self, held_e: Signal, now_s: float | None) -> None:
        """Take up the frame that was exposed; one without a time is forgotten."""
        if now_s is None or held_e.shape != self._shape:
            return
        self._faded = {tau_s: self.faded(tau_s) + held_e for tau_s in self._faded}
        self._last_s = now_s


def _binned(image: Signal, binning: int) -> Signal:
    """Return the mean over blocks of binning × binning pixels; what does not fill a block is left out."""
    if binning == 1:
        return image
    height, width = image.shape[0] // binning, image.shape[1] // binning
    blocks = image[: height * binning, : width * binning].reshape(height, binning, width, binning)
    return np.asarray(blocks.mean(axis=(1, 3)))
