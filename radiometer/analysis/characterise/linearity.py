"""How far the signal is from proportional to light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiometer.analysis.characterise.steps import SignalStep
from radiometer.data import Quantity

_LOWEST_SHARE, _HIGHEST_SHARE = 0.05, 0.95  # of saturation: EMVA 1288, release 4.0 (linear)
_FEWEST_STEPS = 4


@dataclass(frozen=True, slots=True)
class Linearity:
    """Deviations from the line that fits best in relative terms.

    u of a step holds noise, and light that differs between its frames. The uncertainty of LE_min and LE_max is the
    largest deviation that u leads to among as many steps, √(2·ln n)·u: a linear camera shows values of that size.
    """

    LE_min: Quantity  # most negative deviation in %
    LE_max: Quantity  # most positive deviation in %
    # (light, relative deviation in %, its standard uncertainty in %) of every step in the range
    deviations: tuple[tuple[float, float, float], ...]
    # By how much light differs between the frames of a step, standard deviation in %; 0 where that is less than noise
    unsteady_light: float = 0.0


def linearity(steps: Sequence[SignalStep], saturation_dn: float) -> Linearity | None:
    """Return the linearity error between 5 % and 95 % of saturation; None with fewer than four steps there.

    The line a·x + b minimises the relative deviations, as the standard has it.

    Args:
        steps: Steps of one region.

    Source: EMVA Standard 1288, release 4.0, section 6.8, equations (21) to (24).
    """
    used = [s for s in steps if _LOWEST_SHARE * saturation_dn <= s.signal_dn <= _HIGHEST_SHARE * saturation_dn]
    if len(used) < _FEWEST_STEPS or len({s.light for s in used}) < 2:
        return None
    x, y = np.array([(s.light, s.signal_dn) for s in used]).T
    slope, offset = np.polyfit(x, y, 1, w=1.0 / y)
    fitted = slope * x + offset
    deviations = 100.0 * (y - fitted) / fitted
    unsteady = 100.0 * _unsteady_light(used)
    own = 100.0 * np.array([s.u_signal_dn for s in used]) / fitted
    u = np.hypot(own, unsteady / np.sqrt([s.bright.frames for s in used]))
    u_extreme = float(u.max()) * math.sqrt(2.0 * math.log(len(used)))
    return Linearity(
        Quantity(float(deviations.min()), u_extreme, "%"),
        Quantity(float(deviations.max()), u_extreme, "%"),
        tuple((float(a), float(b), float(c)) for a, b, c in zip(x, deviations, u, strict=True)),
        unsteady,
    )


def _unsteady_light(steps: Sequence[SignalStep]) -> float:
    """Return the relative standard deviation of light between the frames of a step; 0 where noise explains it.

    A lamp's output scatters by a share of the signal, so the steps are pooled.
    """
    pairs = [s for s in steps if s.bright.has_noise]
    freedom = sum(s.bright.frames - 1 for s in pairs)
    if not freedom:
        return 0.0
    found = sum((s.bright.frames - 1) * s.bright.frame_variance_dn2 / s.signal_dn**2 for s in pairs) / freedom
    noise = sum((s.bright.frames - 1) * s.bright.frames * (s.bright.u_mean_dn / s.signal_dn) ** 2 for s in pairs)
    noise /= freedom
    # Within two standard deviations of a mean square: χ² of as many degrees of freedom
    return math.sqrt(found - noise) if found > noise * (1.0 + 2.0 * math.sqrt(2.0 / freedom)) else 0.0
