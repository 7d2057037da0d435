"""Spots that a calibrated screen can show: light above its own black, in whole levels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.adaptation.protocol import AdaptationProtocol
from radiometer.errors import ConfigurationError
from radiometer.screen.calibration import LUMINANCE, SCOTOPIC, ChannelCurve, ScreenCalibration
from radiometer.screen.stimulus import Code
from radiometer.typing import Array

_MASKS: Final[dict[str, Code]] = {"grey": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
# A spot whose light above black is less certain than this factor (k = 2) is not shown as a level.
_LEAST_KNOWN_REL: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SpotLevels:
    """The levels of one channel as spots."""

    channel: str  # name of the channel
    codes: NDArray[np.int64]  # whole levels that can be distinguished from black, ascending, shape (n,)
    log10: Array  # log10 of the scotopic luminance in cd·m⁻² that each adds to the black, behind the filter, shape (n,)
    u_log10: Array  # its standard uncertainty without what all levels share, shape (n,)
    u_common_log10: float  # what all share: the scale

    @classmethod
    def of(cls, calibration: ScreenCalibration, channel: str, filter_density: float = 0.0) -> SpotLevels:
        """Return the spots of a channel of a calibrated screen.

        Args:
            calibration: The screen's calibration.
            filter_density: Optical density of a neutral filter before screen or eye.

        Raises:
            CalibrationError: If the channel was not measured.
            ConfigurationError: If the screen has other than 8 bits, or none of its levels can be distinguished from
                black.
        """
        curve = calibration.channel(channel)
        if curve.bits != 8:
            raise ConfigurationError(f"screen {calibration.name}: a page shows 8 bits per channel, not {curve.bits}")
        codes = np.arange(curve.levels[0] + 1, curve.levels[-1] + 1)
        added, u = _above_black(curve, codes)
        usable = (added > curve.detection_limit * curve.efficacy(SCOTOPIC)) & (2 * u < _LEAST_KNOWN_REL * added)
        first = int(np.argmax(usable)) if usable.any() else codes.size
        if first == codes.size:
            raise ConfigurationError(
                f"screen {calibration.name}: no level of {channel} can be distinguished from its black; calibrate "
                "it with more "
                "repeats"
            )
        # Above the first usable level all are used: an uncertain one between two good ones is bounded by them.
        value = np.maximum.accumulate(added[first:])
        relative = u[first:] / value / math.log(10)
        at_eye = np.log10(value) - filter_density
        return cls(channel, codes[first:], at_eye, relative, curve.u_common_rel / math.log(10))

    @property
    def reach(self) -> tuple[float, float]:
        """Return the lowest and the highest level, log10 of scotopic cd·m⁻²."""
        return float(self.log10[0]), float(self.log10[-1])

    def coarsest_step(self, lowest_log10: float) -> float:
        """Return the greatest distance in log10 of two neighbouring levels that are not below a level."""
        return float(np.diff(self.log10[self.log10 >= lowest_log10 - 1e-9]).max(initial=0.0))

    def nearest(self, log10_level: float) -> int:
        """Return the position of the level nearest to one asked for."""
        return int(np.argmin(np.abs(self.log10 - log10_level)))

    def rgb(self, position: int) -> Code:
        """Return the codes of the level at a position."""
        code = int(self.codes[position])
        red, green, blue = _MASKS[self.channel]
        return (red * code, green * code, blue * code)


def _above_black(curve: ChannelCurve, codes: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return what levels add to the lowest one in scotopic cd·m⁻², and its own standard uncertainty."""
    black, factor = curve.levels[0], curve.efficacy(SCOTOPIC)
    added = np.array([curve.radiance_at(int(n)).value for n in codes]) - curve.radiance_at(black).value
    u = np.array([math.hypot(curve.u_shape_at(int(n)), curve.u_shape_at(black)) for n in codes])
    return factor * added, factor * u


def within_reach(protocol: AdaptationProtocol, levels: SpotLevels) -> AdaptationProtocol:
    """Return a protocol whose spot goes no further than a screen's levels.

    Raises:
        ConfigurationError: If the screen shows none of the protocol's levels, or not its criterion.
    """
    spot, (low, high) = protocol.spot, levels.reach
    lowest, highest = max(spot.lowest_log10, low), min(spot.highest_log10, high)
    if lowest >= highest:
        raise ConfigurationError(
            f"protocol {protocol.name}: the screen's {levels.channel} spot goes from {low:.2f} to {high:.2f} log₁₀ "
            f"scotopic cd·m⁻², the protocol's from {spot.lowest_log10:g} to {spot.highest_log10:g}"
        )
    criterion = protocol.end.criterion_log10
    if criterion is not None and criterion <= lowest:
        raise ConfigurationError(
            f"protocol {protocol.name}: its criterion {criterion:g} is below the darkest spot of the screen, "
            f"{low:.2f} log₁₀ scotopic cd·m⁻²"
        )
    narrowed = spot.model_copy(update={"lowest_log10": lowest, "highest_log10": highest})
    return protocol.model_copy(update={"spot": narrowed})


def field_code(calibration: ScreenCalibration, luminance_cd_m2: float, name: str) -> Code:
    """Return the grey that bleaches with a luminance.

    Raises:
        ConfigurationError: If the screen does not get so bright.
    """
    grey = calibration.channel("grey")
    brightest = grey.at(grey.levels[-1], LUMINANCE).value
    if luminance_cd_m2 > brightest:
        raise ConfigurationError(
            f"protocol {name}: the bleach of {luminance_cd_m2:g} cd·m⁻² is beyond screen {calibration.name}, which "
            f"reaches {brightest:.0f}: lower bleach.luminance_cd_m2 and lengthen bleach.duration_s"
        )
    code = grey.level_for(luminance_cd_m2, LUMINANCE)
    return (code, code, code)


def mark_code(calibration: ScreenCalibration, luminance_cd_m2: float) -> tuple[Code, bool]:
    """Return the red of the mark, and whether it is calibrated: a share of grey is assumed where red was not measured.

    Source of the share: luminance of the red primary in white, ITU-R BT.709: 0.2126.
    """
    measured = "red" in calibration.channels
    curve = calibration.channel("red" if measured else "grey")
    target = luminance_cd_m2 if measured else luminance_cd_m2 / 0.2126
    low, high = (curve.at(curve.levels[i], LUMINANCE).value for i in (0, -1))
    code = curve.level_for(min(target + low, high), LUMINANCE)
    return (max(code, 1), 0, 0), measured
