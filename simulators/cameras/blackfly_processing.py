"""What the signal processing of a Blackfly S does to a picture where it is left on, as it is when shipped."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from radiometer.data.frame import DigitalNumbers

AUTO_TARGET: Final = 0.5  # of full scale, the mean that automatic exposure steers to
_AUTO_STEP: Final = 2.0  # largest change from frame to frame


def gamma_corrected(dn: DigitalNumbers, gamma: float, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers after a gamma curve: full scale × (DN / full scale)^gamma, rounded."""
    curve = full_scale_dn * (np.arange(full_scale_dn + 1) / full_scale_dn) ** gamma
    return _like(dn, curve[dn])


def sharpened(dn: DigitalNumbers, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers with half of their difference from the mean of 3 × 3 neighbours added."""
    exact: NDArray[np.float32] = dn.astype(np.float32)
    crisp = exact + 0.5 * (exact - uniform_filter(exact, 3))
    return _like(dn, np.clip(crisp, 0, full_scale_dn))


def steered(setting: float, mean_dn: float, full_scale_dn: int, low: float, high: float) -> float:
    """Return the exposure time or amplitude gain that automatic exposure takes for the next frame.

    Args:
        setting: What the last frame was taken with, in any unit proportional to the signal.
        mean_dn: Mean of the last frame in DN.
    """
    factor = AUTO_TARGET * full_scale_dn / max(mean_dn, 1.0)
    return min(max(setting * min(max(factor, 1 / _AUTO_STEP), _AUTO_STEP), low), high)


def _like(dn: DigitalNumbers, exact: NDArray[np.floating[Any]]) -> DigitalNumbers:
    rounded: DigitalNumbers = np.rint(exact).astype(dn.dtype)
    return rounded
