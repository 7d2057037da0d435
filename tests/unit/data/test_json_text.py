"""Whatever numbers come in, what goes out is JSON that every strict reader accepts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from radiometer.adaptation.journal import read_events
from radiometer.data.json_text import RepeatedKey, json_text, parsed_json
from radiometer.errors import RadiometerError
from radiometer.importing.statistics_table import read_statistics_table
from radiometer.importing.tiff_files import read_tiff_headers

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


def _beside(path: Path) -> object:
    """Read a TIFF that has this text as Micro-Manager's metadata next to it."""
    tifffile.imwrite(path.with_name("a.tif"), np.zeros((4, 4), np.uint16), metadata=None)
    return read_tiff_headers(path.with_name("a.tif"))


def _within(path: Path) -> object:
    """Read a TIFF that has this text as Micro-Manager's tag."""
    tags = [(51123, "s", 0, path.read_text(), True)]
    tifffile.imwrite(path.with_name("a.tif"), np.zeros((4, 4), np.uint16), extratags=tags, metadata=None)
    return read_tiff_headers(path.with_name("a.tif"))


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("t.json", '[{"exposure_s": 1, "mean": 20, "variance": 4, "%s": 2}]', read_statistics_table),
        ("t.jsonl", '{"mean": 20, "variance": 4, "exposure_s": 1, "%s": 2}\n', read_statistics_table),
        ("run.jsonl", '{"sequence": 0, "kind": "begin", "exposure_s": 1, "%s": 2}\n', read_events),
        ("metadata.txt", '{"FrameKey-0": {"FileName": "a.tif", "exposure_s": 1, "%s": 2}}', _beside),
        ("tag.txt", '{"exposure_s": 1, "%s": 2}', _within),
    ],
)
def test_a_key_that_stands_twice_is_refused_in_every_file(
    name: str, text: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    """Which of two exposures is meant is not known; another key in its place is read."""
    path = tmp_path / name
    path.write_text(text % "other")
    assert read(path)
    path.write_text(text % "exposure_s")
    with pytest.raises(RadiometerError, match=r"'exposure_s' occurs twice.*leave one out") as refusal:
        read(path)
    assert str(tmp_path) in str(refusal.value)


@given(_CONTENT)
def test_what_is_written_is_read_and_what_has_a_key_twice_is_not(content: Any) -> None:
    """At any depth."""
    text = json_text(content)
    assert json_text(parsed_json(text)) == text
    with pytest.raises(RepeatedKey):
        parsed_json(f'[{{"a": [{{"b": 1, "b": {text}}}]}}]')
