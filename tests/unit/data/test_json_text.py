"""Whatever numbers come in, what goes out is JSON that every strict reader accepts."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiometer.data.json_text import json_text

_NUMBERS = st.floats() | st.integers() | st.floats(width=32).map(np.float32) | st.integers(-99, 99).map(np.int64)
_CONTENT = st.recursive(
    st.none() | st.booleans() | st.text() | _NUMBERS,
    lambda inner: st.lists(inner) | st.tuples(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


@given(_CONTENT)
def test_every_content_is_strict_json(content: Any) -> None:
    """No NaN, no infinity, one line, and the same again when written anew."""
    text = json_text(content)
    again = json.loads(text, parse_constant=_refuse)
    assert json_text(again) == text
    assert "\n" not in text


@given(_NUMBERS)
def test_a_number_stays_what_it_is_or_is_null(number: float) -> None:
    """NaN and infinity are null; any other number comes back to the bit."""
    assert json.loads(json_text([number])) == [number if math.isfinite(number) else None]


def test_arrays_are_lists_and_what_has_no_form_is_refused() -> None:
    """An array's NaN is null as well; an object without a JSON form is an error."""
    assert json_text({"u": np.array([1.0, np.nan, -np.inf])}) == '{"u": [1.0, null, null]}'
    with pytest.raises(TypeError):
        json_text(object())
