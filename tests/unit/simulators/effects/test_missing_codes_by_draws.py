"""What missing codes cut off, against draws: noise far narrower than their step, which the series does not resolve."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from simulators.effects.missing_codes import MissingCodes


@pytest.mark.parametrize(
    ("period", "kept"), [(2, 1), (4, 1), (8, 1), (16, 1), (3, 2), (4, 2), (4, 3), (8, 7), (16, 15)]
)
def test_a_search_tries_the_codes_that_converters_leave_out(period: int, kept: int) -> None:
    """Bits that are stuck, one code of a period that never comes: some trial leaves exactly those codes."""
    codes, anywhere = np.arange(64.0), cast(Any, None)
    expected = set(codes[codes % period < kept])
    found = [set(np.ravel(MissingCodes(**trial).mean(codes, anywhere))) for trial in MissingCodes.trials]
    assert expected in found
