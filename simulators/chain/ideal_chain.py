"""The ideal chain of EMVA 1288: what a datasheet believes a camera to be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from radiometer.data import CameraDescription, LensDescription
from radiometer.errors import ConfigurationError
from simulators.effects.adc_saturation import AdcSaturation
from simulators.effects.base import Effect
from simulators.effects.black_level import BlackLevel
from simulators.effects.conversion_gain import ConversionGain
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.lens import Lens
from simulators.effects.photon_conversion import PhotonConversion
from simulators.effects.quantisation import Quantisation
from simulators.effects.quantum_efficiency import QuantumEfficiency
from simulators.effects.read_noise import ReadNoise
from simulators.effects.shot_noise import ShotNoise
from simulators.effects.shutter import Shutter
from simulators.effects.source_level import SourceLevel

# (effect of the ideal chain, its parameter) → key of the camera's description
_KEYS: Final = {
    (QuantumEfficiency.name, "quantum_efficiency"): "quantum_efficiency",
    (DarkCurrent.name, "rate_e_per_s"): "dark_current_e_per_s",
    (DarkCurrent.name, "reference_C"): "dark_current_reference_C",
    (DarkCurrent.name, "doubling_K"): "dark_current_doubling_K",
    (FullWellSaturation.name, "full_well_e"): "full_well_e",
    (ReadNoise.name, "read_noise_e"): "read_noise_e",
    (ConversionGain.name, "conversion_gain_e_per_dn"): "conversion_gain_e_per_dn",
}
_NEEDED = ("pixel_pitch_um", "conversion_gain_e_per_dn", "read_noise_e", "full_well_e", "quantum_efficiency")


def ideal_chain(camera: CameraDescription, lens: LensDescription) -> tuple[Effect, ...]:
    """Return the effects from radiance to digital numbers that a camera's and a lens's descriptions give.

    Args:
        camera: Must state pixel pitch, conversion gain, read noise, full well and quantum efficiency; dark current
            and black level count as 0 where missing.
        lens: Missing transmittance counts as 1 and missing focal length as 16 mm (used by cos⁴ only).

    Raises:
        ConfigurationError: If the camera leaves out a figure that the chain needs, or one is out of bounds.
    """
    missing = [key for key in _NEEDED if getattr(camera, key) is None]
    if missing:
        raise ConfigurationError(
            f"camera {camera.model or ''}: cannot be simulated without {', '.join(missing)}; add to its description"
        )
    return (*_light_path(lens), *_sensor(camera))


def next_to_ideal(
    effects: Sequence[Effect], camera: CameraDescription, lens: LensDescription
) -> tuple[CameraDescription, tuple[Effect, ...]]:
    """Return the camera with the figures that a chain's ideal links hold, and the other effects.

    Args:
        effects: A chain that was built on that of `ideal_chain`.
        camera: The camera's description.
        lens: The lens's.
    """
    ideal = [effect.name for effect in ideal_chain(camera, lens)]
    figures, further = dict[str, Any](), list[Effect]()
    for effect in effects:
        if effect.name not in ideal:
            further.append(effect)
            continue
        ideal.remove(effect.name)
        figures |= {_KEYS[effect.name, key]: v for key, v in effect.values().items() if (effect.name, key) in _KEYS}
    return camera.model_copy(update=figures), tuple(further)


def _light_path(lens: LensDescription) -> tuple[Effect, ...]:
    return (
        SourceLevel(),
        Lens(
            transmittance=1.0 if lens.transmittance is None else lens.transmittance,
            magnification=lens.magnification,
            pupil_magnification=lens.pupil_magnification,
            focal_length_mm=lens.focal_length_mm or 16.0,
            cos4=1.0 if lens.vignetting == "cos4" else 0.0,
        ),
        Shutter(),
        PhotonConversion(),
    )


def _sensor(camera: CameraDescription) -> tuple[Effect, ...]:
    return (
        QuantumEfficiency(camera.quantum_efficiency or 0.0),
        DarkCurrent(
            camera.dark_current_e_per_s or 0.0,
            25.0 if camera.dark_current_reference_C is None else camera.dark_current_reference_C,
            camera.dark_current_doubling_K or 7.0,
        ),
        ShotNoise(),
        FullWellSaturation(camera.full_well_e or 0.0),
        ReadNoise(camera.read_noise_e or 0.0),
        ConversionGain(camera.conversion_gain_e_per_dn or 0.0),
        BlackLevel(camera.black_level_dn or 0.0),
        Quantisation(),
        AdcSaturation(),
    )
