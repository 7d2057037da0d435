"""The chain of a camera of which not all is declared: what a fit moves and never names are links like any others."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data import CameraDescription, LensDescription
from simulators.chain.ideal_chain import ideal_chain
from simulators.chain.stages import place_for
from simulators.effects.base import DIGITAL_NUMBER, PHOTONS, Effect, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext, Signal
from simulators.effects.conversion_gain import ConversionGain
from simulators.effects.dark_current import DarkCurrent
from simulators.effects.full_well_saturation import FullWellSaturation
from simulators.effects.read_noise import ReadNoise

# Stand in where a description says nothing; they are fitted then, and reported as assumptions.
_TYPICAL: Final = {
    "conversion_gain_e_per_dn": 2.5,
    "read_noise_e": 5.0,
    "quantum_efficiency": 0.5,
    "pixel_pitch_um": 4.5,
}
_MARGIN_BITS: Final = 4.0  # replaces a full well that is not declared: far above what the converter can show


@dataclass(frozen=True, slots=True, eq=False)
class Undeclared:
    """How far a camera is off its description, and what the description leaves out."""

    log_responsivity: float = 0.0  # natural logarithm of the responsivity over the declared one
    log_gain: float = 0.0  # the same of the conversion gain K
    log_read: float = 0.0  # the same of the read noise's variance
    black_dn: float = 0.0  # black level in DN over the declared one
    dark_e_per_s: float = 0.0  # Dark current over the declared one
    # Relative variance of the scene's radiance within each tile, (patterns, tiles)
    texture: Signal = field(default_factory=lambda: np.zeros((1, 1)))


def completed(camera: CameraDescription, off: Undeclared | None = None) -> CameraDescription:
    """Return the camera with every figure that the ideal chain needs: declared, else fitted, else typical."""
    off = off or Undeclared()
    figures = {key: getattr(camera, key) or usual for key, usual in _TYPICAL.items()}
    read = _TYPICAL["read_noise_e"] if camera.read_noise_e is None else camera.read_noise_e
    e_per_dn = figures["conversion_gain_e_per_dn"] * float(np.exp(-off.log_gain))
    read *= float(np.exp(off.log_read / 2.0))
    # What is declared is refused out of its bounds; what a fit moves stays within.
    e_per_dn = e_per_dn if camera.conversion_gain_e_per_dn else _allowed(ConversionGain, e_per_dn)
    read = read if camera.read_noise_e is not None else _allowed(ReadNoise, read)
    most_e = _allowed(FullWellSaturation, _MARGIN_BITS * camera.full_scale_dn * e_per_dn)
    figures |= {"conversion_gain_e_per_dn": e_per_dn, "read_noise_e": read, "full_well_e": camera.full_well_e or most_e}
    return camera.model_copy(update=figures)


def _allowed(kind: type[Effect], value: float) -> float:
    """Return a fitted figure within the bounds of the link that has it as its first parameter."""
    known = kind.parameters()[0]
    return min(max(value, known.low), known.high)


def undeclared_chain(
    camera: CameraDescription, lens: LensDescription, off: Undeclared, pattern: NDArray[np.intp], *, ends_in_well: bool
) -> tuple[Effect, ...]:
    """Return the chain from radiance to codes, without the ends of the converter's range: what clips is not compared.

    Args:
        off: What is not, or not rightly.
        pattern: Position of each capture's pattern, (captures,).
    """
    figures = completed(camera, off)
    links = [
        effect
        for effect in ideal_chain(figures, lens)
        if not getattr(effect, "saturates", "") or (effect.stage is Stage.WELL and ends_in_well)
    ]
    reference_c = 25.0 if figures.dark_current_reference_C is None else figures.dark_current_reference_C
    further: list[Effect] = [_Light(float(np.exp(off.log_responsivity)), off.texture, pattern)]
    if off.dark_e_per_s:
        further.append(_FurtherDark(off.dark_e_per_s, reference_c, figures.dark_current_doubling_K or 7.0))
    if off.black_dn:
        further.append(_FurtherBlack(off.black_dn))
    for link in further:
        links.insert(place_for(link, links), link)
    return tuple(links)


@dataclass(frozen=True)
class _Light(Effect):
    """Scales all light by the responsivity over the declared one; tiles of a scene vary within."""

    name = "responsivity"
    stage = Stage.PHOTONS
    unit_in = PHOTONS
    unit_out = PHOTONS
    factor: float = parameter(1.0, "1", 0.0, np.inf, source="fitted")
    texture: Any = parameter(0.0, "1", -np.inf, np.inf, source="fitted, of each tile")  # noqa: RUF009
    pattern: Any = parameter(0.0, "1", 0.0, np.inf, source="of each capture")  # noqa: RUF009

    def mean(self, signal: Signal, context: ExposureContext) -> Signal:
        return signal * self.factor

    def slope(self, signal: Signal, context: ExposureContext) -> float:
        return self.factor

    def spatial_variance(self, signal: Signal, context: ExposureContext) -> Signal | float:
        """Return the variance of the scene within each tile."""
        if not np.any(self.texture):
            return 0.0
        return np.asarray(np.maximum(self.texture, 0.0)[self.pattern][..., None] * np.square(self.factor * signal))


@dataclass(frozen=True)
class _FurtherDark(DarkCurrent):
    """Adds the dark current beyond the declared one; a declared one may be too much."""

    name = "further_dark_current"
    rate_e_per_s: float = parameter(0.0, "e- s-1", -np.inf, np.inf, source="fitted")


@dataclass(frozen=True)
class _FurtherBlack(Offset):
    """Adds the black level beyond the declared one."""

    name = "further_black_level"
    stage = Stage.READOUT
    unit_in = DIGITAL_NUMBER
    unit_out = DIGITAL_NUMBER
    where = ""
    trials = ()
    fitted = ()
    offset_dn: float = parameter(0.0, "DN", -np.inf, np.inf, source="fitted")

    def offset(self, context: ExposureContext) -> float:
        return self.offset_dn
