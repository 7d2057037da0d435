"""Black and white of frames, and pixels that see no light, on either side of every bound."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.analysis.response.limits import find_limits
from radiometer.data import Bracket, Frame, FrameSettings
from radiometer.errors import MeasurementError

FULL = 4095  # a 128th of it, by which a peak may move, is 31


def frame(dn, seconds=1.0):
    return Frame(np.asarray(dn, np.uint16).reshape(10, -1), 12, FrameSettings(seconds))


@pytest.mark.parametrize(("value", "said"), [(FULL, "67 % .*saturated, 33 % black.*shorter"), (0, "33 % .*longer")])
def test_where_all_is_clipped_it_is_said_which_way_to_go(value, said):
    """More white than black calls for shorter exposures, more black for longer ones."""
    values = np.repeat([value, value, FULL - value], 10)
    with pytest.raises(MeasurementError, match=said):
        find_limits([Bracket.from_frames([frame(values), frame(values, 2.0)])])
