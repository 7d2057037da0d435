"""The one writer and the one reader of JSON.

A number that is not finite is written as null, because JSON has no NaN and no infinity. A key that occurs twice in an
object is refused, because which of its two values is meant is not known (RFC 8259, section 4).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any


def json_text(content: Any, *, indent: int | None = None, sort_keys: bool = False, ascii_only: bool = False) -> str:
    """Return content as JSON that every reader accepts.

    Args:
        content: Mappings, sequences, numbers (numpy's too), text, booleans and None.
        indent: Blanks per level; None writes one line.
        sort_keys: Whether keys are sorted.
        ascii_only: Whether characters beyond ASCII are escaped.

    Raises:
        TypeError: If a value is none of these.
    """
    return json.dumps(  # noqa: TID251 (the one place)
        finite_or_null(content),
        indent=indent,
        sort_keys=sort_keys,
        ensure_ascii=ascii_only,
        allow_nan=False,
    )


class RepeatedKey(ValueError):
    """A key occurs twice in one object of a JSON text."""


def parsed_json(text: str | bytes) -> Any:
    """Return what a JSON text holds.

    Raises:
        RepeatedKey: If a key occurs twice in one object.
        ValueError: If it is no JSON, or nested too deeply.
    """
    try:
        return json.loads(text, object_pairs_hook=_object)  # noqa: TID251 (the one place)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise RepeatedKey(f"the key {twice[:40]!r} occurs twice in one object; leave one out")
    return found


def finite_or_null(value: Any) -> Any:
    """Return a JSON value of plain ones: None for a number that is not finite, the documented form of an object."""
    if isinstance(value, str | bool | int | None):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: finite_or_null(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_null(entry) for entry in value]
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return finite_or_null(value.tolist())
    if hasattr(value, "to_mapping"):
        return finite_or_null(value.to_mapping())
    return str(value) if isinstance(value, PurePath) else value
