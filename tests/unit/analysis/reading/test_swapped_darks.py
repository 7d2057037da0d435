"""Dark and light frames that were swapped are refused by a reading of a patch as by a map."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.merge.bracket import merge
from radiometer.analysis.reading.reading import read_patch
from radiometer.data import CameraDescription, Frame, FrameSettings, Patch
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError

CAMERA = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.0, read_noise_e=4.0, black_level_dn=64.0)


def frames(light_dn: float, dark_dn: float, exposures_s: tuple[float, ...]) -> list[Frame]:
    """Return a dark and a light frame of each exposure, with these numbers above black at 10 ms."""
    rng, found = np.random.default_rng(48_020), list[Frame]()
    for shutter, level in (("closed", dark_dn), ("open", light_dn)):
        for exposure_s in exposures_s:
            dn = np.round(rng.normal(64.0 + level * exposure_s / 0.01, 3.0, (40, 40)))
            settings = FrameSettings(exposure_s, black_level_dn=64.0, shutter=shutter)  # type: ignore[arg-type]
            found.append(Frame(np.clip(dn, 0, 4095).astype(np.uint16), 12, settings))
    return found


@pytest.mark.parametrize("exposures_s", [(0.01,), (0.002, 0.01), (0.001, 0.002, 0.004, 0.008)])
@pytest.mark.parametrize("signal_dn", [40.0, 400.0, 3000.0])
def test_what_is_darker_than_its_darks_is_refused(exposures_s: tuple[float, ...], signal_dn: float) -> None:
    """Over exposures and levels; the same frames the right way round are read."""
    right, swapped = frames(signal_dn, 0.0, exposures_s), frames(0.0, signal_dn, exposures_s)
    for take in (
        lambda some: read_patch(some, Patch(4, 4, 16, 16), Setup(CAMERA)),
        lambda some: merge(some, Setup(CAMERA)),
    ):
        assert take(right) is not None
        with pytest.raises(MeasurementError, match="darker than the dark frames"):
            take(swapped)
