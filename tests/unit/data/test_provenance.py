"""Where a result comes from, as it stands in files that people edit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from radiometer.data.provenance import Provenance, source_hash
from radiometer.errors import InputError


def test_what_is_written_reads_back() -> None:
    """Method, inputs, assumptions and settings come back in order; the rest as text."""
    made = Provenance("debevec1997", ("a.png", "b.png"), ("no flicker",), {"groups": 350}, "2026-01-02", "radiometer 1")
    assert Provenance.from_mapping(made.to_mapping(), "file") == made


@pytest.mark.parametrize("emptied", ["inputs", "assumptions", "parameters", "method", "created", "software"])
def test_an_entry_left_empty_holds_nothing(emptied: str) -> None:
    """A key with nothing behind it, as an editor leaves it, is as good as none."""
    made = Provenance("m", created="now", software="s")
    nothing = {"method": "unknown", "inputs": (), "assumptions": (), "parameters": {}, "created": "", "software": ""}
    expected = replace(made, **{emptied: nothing[emptied]})
    assert Provenance.from_mapping({**made.to_mapping(), emptied: None}, "file") == expected


def test_a_file_without_provenance_is_of_unknown_method() -> None:
    """Nothing at all is no error."""
    assert Provenance.from_mapping(None, "file").method == "unknown"


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ("by hand", "provenance is 'by hand', not a mapping"),
        ({"inputs": 5}, r"provenance\.inputs is '5', not a list"),
        ({"assumptions": "none"}, r"provenance\.assumptions is 'none', not a list"),
        ({"parameters": [1, 2]}, r"provenance\.parameters is .*, not a mapping"),
    ],
)
def test_another_shape_is_refused_by_name(stated: Any, named: str) -> None:
    """The message says which file and which key."""
    with pytest.raises(InputError, match=f"cal.yaml: {named}"):
        Provenance.from_mapping(stated, "cal.yaml")


def test_a_hash_over_no_source_is_refused() -> None:
    """A folder that was renamed has no source: its hash would never change, and stored results would never age."""
    with pytest.raises(ValueError, match="no source"):
        source_hash("analysis", "no_such_room")
