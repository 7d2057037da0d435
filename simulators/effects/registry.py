"""The table of effects: a new effect is one file and one line here, or comes from outside.

What a laboratory keeps for itself is found by the entry points of installed packages (group `radiometer.effects`, the
effect's name and its class), or is read from a file.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from pydantic import Field

from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError
from simulators.effects.adc_saturation import AdcSaturation
from simulators.effects.ambient_light_leak import AmbientLightLeak
from simulators.effects.angle_dependence import AngleDependence
from simulators.effects.base import Effect
from simulators.effects.black_level import BlackLevel
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.black_level_gain_slope import BlackLevelGainSlope
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.brighter_fatter import BrighterFatter
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.column_pattern import ColumnPattern
from simulators.effects.conversion_gain import ConversionGain
from simulators.effects.conversion_gain_error import ConversionGainError
from simulators.effects.correlated_read_noise import CorrelatedReadNoise
from simulators.effects.crosstalk import Crosstalk
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.dark_current_clamped import DarkCurrentClamped
from simulators.effects.dark_current_nonuniformity import DarkCurrentNonuniformity
from simulators.effects.dark_frame_subtracted import DarkFrameSubtracted
from simulators.effects.defocus import Defocus
from simulators.effects.display_black_leak import DisplayBlackLeak
from simulators.effects.display_gamma_error import DisplayGammaError
from simulators.effects.display_nonuniformity import DisplayNonuniformity
from simulators.effects.dsnu import Dsnu
from simulators.effects.event_offset import EventOffset
from simulators.effects.excess_read_noise import ExcessReadNoise
from simulators.effects.exposure_label_error import ExposureLabelError
from simulators.effects.exposure_quantisation import ExposureQuantisation
from simulators.effects.exposure_time_offset import ExposureTimeOffset
from simulators.effects.first_frame_offset import FirstFrameOffset
from simulators.effects.fnumber_tstop_error import FnumberTstopError
from simulators.effects.free_law import kind_for
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.gain_step_error import GainStepError
from simulators.effects.gamma_enabled import GammaEnabled
from simulators.effects.ghost import Ghost
from simulators.effects.hot_pixels import HotPixels
from simulators.effects.image_lag import ImageLag
from simulators.effects.lamp_step import LampStep
from simulators.effects.led_thermal_droop import LedThermalDroop
from simulators.effects.lens import Lens
from simulators.effects.line_start_offset import LineStartOffset
from simulators.effects.mains_ripple import MainsRipple
from simulators.effects.mechanical_vignetting import MechanicalVignetting
from simulators.effects.missing_codes import MissingCodes
from simulators.effects.natural_vignetting import NaturalVignetting
from simulators.effects.nominal_settings import NominalSettings
from simulators.effects.parasitic_light_sensitivity import ParasiticLightSensitivity
from simulators.effects.photon_conversion import PhotonConversion
from simulators.effects.polarisation import Polarisation
from simulators.effects.prnu import Prnu
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.pwm_flicker import PwmFlicker
from simulators.effects.quantisation import Quantisation
from simulators.effects.quantum_efficiency import QuantumEfficiency
from simulators.effects.quantum_efficiency_temperature import QuantumEfficiencyTemperature
from simulators.effects.read_noise import ReadNoise
from simulators.effects.readout_dark_charge import ReadoutDarkCharge
from simulators.effects.reciprocity_failure import ReciprocityFailure
from simulators.effects.residual_charge import ResidualCharge
from simulators.effects.response_nonlinearity import ResponseNonlinearity
from simulators.effects.rolling_shutter_banding import RollingShutterBanding
from simulators.effects.row_dependent_exposure import RowDependentExposure
from simulators.effects.row_pattern import RowPattern
from simulators.effects.row_temporal_noise import RowTemporalNoise
from simulators.effects.series_settling import SeriesSettling
from simulators.effects.shot_noise import ShotNoise
from simulators.effects.shutter import Shutter
from simulators.effects.shutter_dead_time import ShutterDeadTime
from simulators.effects.soft_saturation import SoftSaturation
from simulators.effects.source_level import SourceLevel
from simulators.effects.source_not_proportional_to_exposure import SourceNotProportionalToExposure
from simulators.effects.source_warmup_drift import SourceWarmupDrift
from simulators.effects.spectral_mismatch import SpectralMismatch
from simulators.effects.stray_light_kernel import StrayLightKernel
from simulators.effects.veiling_glare import VeilingGlare

EFFECTS: Final[dict[str, type[Effect]]] = {
    "adc_saturation": AdcSaturation,
    "ambient_light_leak": AmbientLightLeak,
    "angle_dependence": AngleDependence,
    "black_level": BlackLevel,
    "black_level_drift": BlackLevelDrift,
    "black_level_gain_slope": BlackLevelGainSlope,
    "black_level_offset": BlackLevelOffset,
    "brighter_fatter": BrighterFatter,
    "column_pattern": ColumnPattern,
    "conversion_gain": ConversionGain,
    "conversion_gain_error": ConversionGainError,
    "correlated_read_noise": CorrelatedReadNoise,
    "crosstalk": Crosstalk,
    "dark_current": DarkCurrent,
    "dark_current_clamped": DarkCurrentClamped,
    "dark_current_nonuniformity": DarkCurrentNonuniformity,
    "dark_frame_subtracted": DarkFrameSubtracted,
    "defocus": Defocus,
    "display_black_leak": DisplayBlackLeak,
    "display_gamma_error": DisplayGammaError,
    "display_nonuniformity": DisplayNonuniformity,
    "dsnu": Dsnu,
    "event_offset": EventOffset,
    "excess_read_noise": ExcessReadNoise,
    "exposure_label_error": ExposureLabelError,
    "exposure_quantisation": ExposureQuantisation,
    "exposure_time_offset": ExposureTimeOffset,
    "first_frame_offset": FirstFrameOffset,
    "fnumber_tstop_error": FnumberTstopError,
    "full_well_saturation": FullWellSaturation,
    "gain_step_error": GainStepError,
    "gamma_enabled": GammaEnabled,
    "ghost": Ghost,
    "hot_pixels": HotPixels,
    "image_lag": ImageLag,
    "lamp_step": LampStep,
    "led_thermal_droop": LedThermalDroop,
    "lens": Lens,
    "line_start_offset": LineStartOffset,
    "mains_ripple": MainsRipple,
    "mechanical_vignetting": MechanicalVignetting,
    "missing_codes": MissingCodes,
    "natural_vignetting": NaturalVignetting,
    "nominal_settings": NominalSettings,
    "parasitic_light_sensitivity": ParasiticLightSensitivity,
    "photon_conversion": PhotonConversion,
    "polarisation": Polarisation,
    "prnu": Prnu,
    "psf_blur": PsfBlur,
    "pwm_flicker": PwmFlicker,
    "quantisation": Quantisation,
    "quantum_efficiency": QuantumEfficiency,
    "quantum_efficiency_temperature": QuantumEfficiencyTemperature,
    "read_noise": ReadNoise,
    "readout_dark_charge": ReadoutDarkCharge,
    "reciprocity_failure": ReciprocityFailure,
    "residual_charge": ResidualCharge,
    "response_nonlinearity": ResponseNonlinearity,
    "rolling_shutter_banding": RollingShutterBanding,
    "row_dependent_exposure": RowDependentExposure,
    "row_pattern": RowPattern,
    "row_temporal_noise": RowTemporalNoise,
    "series_settling": SeriesSettling,
    "shot_noise": ShotNoise,
    "shutter": Shutter,
    "shutter_dead_time": ShutterDeadTime,
    "soft_saturation": SoftSaturation,
    "source_level": SourceLevel,
    "source_not_proportional_to_exposure": SourceNotProportionalToExposure,
    "source_warmup_drift": SourceWarmupDrift,
    "spectral_mismatch": SpectralMismatch,
    "stray_light_kernel": StrayLightKernel,
    "veiling_glare": VeilingGlare,
}


ENTRY_POINTS: Final = "radiometer.effects"


def all_effects() -> Mapping[str, type[Effect]]:
    """Return all effects by name: those of this table, of installed packages, and of files that were read.

    Raises:
        ConfigurationError: If an installed package's effect cannot be loaded.
    """
    _load_installed()
    return EFFECTS


@cache
def _load_installed() -> None:
    for found in entry_points(group=ENTRY_POINTS):
        _register(_loaded(found), f"entry point {found.name!r} of {found.value}")


def _loaded(found: EntryPoint) -> Any:
    try:
        return found.load()
    except Exception as error:  # whatever a foreign package does when it is imported
        raise ConfigurationError(
            f"effect {found.name!r} ({found.value}) cannot be loaded: {type(error).__name__}: {error}; "
            "repair or uninstall its package"
        ) from error


def register_file(path: Path) -> tuple[str, ...]:
    """Take the effects that a Python file defines into the table, and return their names.

    The file is run: it is code of the user's own.

    Raises:
        ConfigurationError: If it cannot be run, defines no effect, or one whose name is taken.
    """
    module = _module_of(path)
    kinds = [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and kind.__module__ == module.__name__ and issubclass(kind, Effect)
        if not inspect.isabstract(kind) and isinstance(getattr(kind, "name", None), str)
    ]
    if not kinds:
        raise ConfigurationError(f"{path}: defines no effect; see docs/how-to/add-an-effect.md for what one is")
    for kind in kinds:
        _register(kind, str(path))
    return tuple(kind.name for kind in kinds)


def _module_of(path: Path) -> ModuleType:
    if not path.exists():
        raise ConfigurationError(f"{path} does not exist; give a Python file that defines effects")
    name = f"_effects_of_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigurationError(f"{path}: is no Python file; give one that ends in .py and defines effects")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file does
        del sys.modules[name]
        raise ConfigurationError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    return module


def _register(kind: Any, where: str) -> None:
    """Take one effect into the table; the same class under the same name again changes nothing."""
    if not (inspect.isclass(kind) and issubclass(kind, Effect)):
        raise ConfigurationError(f"{where}: is no effect; derive it from simulators.effects.base.Effect")
    if inspect.isabstract(kind):
        raise ConfigurationError(f"{where}: the effect leaves out {', '.join(sorted(kind.__abstractmethods__))}")
    lacking = [key for key in _NEEDED if not hasattr(kind, key)]
    lacking += [key for key in _SEARCHED if issubclass(kind, CatalogueEffect) and not hasattr(kind, key)]
    if lacking:
        raise ConfigurationError(
            f"{where}: the effect does not say its {', '.join(lacking)}; see docs/how-to/add-an-effect.md"
        )
    known = EFFECTS.get(kind.name)
    if known is not None and (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise ConfigurationError(f"{where}: there is an effect {kind.name!r} already; give yours another name")
    EFFECTS[kind.name] = kind


_NEEDED: Final = ("name", "stage", "unit_in", "unit_out")
_SEARCHED: Final = ("where", "trials", "fitted")


class _EntryFile(ConfigSection):
    name: str
    enabled: bool = True
    parameters: dict[str, Any] = Field(default_factory=dict)
    notes: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EffectEntry:
    """An effect as a camera model holds it: with a switch, and notes on where it comes from.

    Attributes:
        effect: The effect with its parameters.
        enabled: False takes it out of the chain but keeps it in the file.
        notes: Anything worth keeping with it (covariance, evidence, capture hashes).
    """

    effect: Effect
    enabled: bool = True
    notes: Mapping[str, Any] = field(default_factory=dict)

    def to_mapping(self) -> dict[str, Any]:
        """Return {name, enabled, parameters[, notes]}, plain enough for YAML."""
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in self.effect.values().items()}
        mapping: dict[str, Any] = {"name": self.effect.name, "enabled": self.enabled, "parameters": values}
        return mapping | ({"notes": dict(self.notes)} if self.notes else {})

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> EffectEntry:
        """Return the entry that a mapping describes.

        Args:
            mapping: {name, enabled, parameters, notes}; all but the name may be missing.
            where: File and position, for messages.

        Raises:
            ConfigurationError: If the effect or a parameter is unknown, or a value is out of its bounds.
        """
        entry = validate(_EntryFile, mapping, where, ConfigurationError)
        return cls(make_effect(entry.name, entry.parameters, where), entry.enabled, entry.notes)


def make_effect(name: str, parameters: Mapping[str, Any] | None = None, where: str = "camera model") -> Effect:
    """Return an effect by its canonical name; parameters not given take their defaults.

    Raises:
        ConfigurationError: If the effect or a parameter is unknown, or a value is out of its bounds.
    """
    kind = EFFECTS.get(name) or all_effects().get(name)
    if kind is None:
        raise ConfigurationError(f"{where}: there is no effect {name!r}; known are {', '.join(sorted(EFFECTS))}")
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in (parameters or {}).items()}
    kind = kind_for(kind, tuple(given)) if issubclass(kind, CatalogueEffect) else kind
    allowed = [known.name for known in kind.parameters()]
    for key in given:
        if key not in allowed:
            raise ConfigurationError(
                f"{where}: effect {name!r} has no parameter {key!r}; it has {', '.join(allowed) or 'none'}"
            )
    try:
        return kind(**given)
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from error
