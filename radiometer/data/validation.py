"""Pydantic's findings in one plain line that names key, value and what is allowed."""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Iterator, Mapping
from difflib import SequenceMatcher
from typing import Annotated, Any, Final, Self, TypeVar, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    model_validator,
)

from radiometer.errors import RadiometerError
from radiometer.plausible import LARGEST, PLAUSIBLE
from radiometer.typing import Array

ModelT = TypeVar("ModelT", bound=BaseModel)
_SMALLEST: Final = 1 / LARGEST  # what must be above 0 is not so small
_LARGEST_WHOLE: Final = 2**32  # counts, places, and seeds of 32 bits
_ALIKE: Final = 0.85  # share of letters in common: one wrong, missing or swapped letter of seven or more
_LONGEST_KEY: Final = 64  # characters; those of this program have up to 30
_UNITS: Final = frozenset(
    ("s", "ms", "us", "ns", "min", "db", "x", "dn", "adu", "e", "c", "k", "degc", "um", "mm", "nm", "m", "hz", "px")
) | {"number", "name"}  # last words of keys that add nothing to the others
_MOST_SIDE: Final = 100_000  # pixels; the longest line sensors have 32,768
_MOST_PIXELS: Final = 200_000_000  # the largest sensors sold have 151 million


def within(quantity: str) -> AfterValidator:
    """Return what makes a field refuse numbers outside the plausible range of its quantity; None passes.

    Args:
        quantity: Key of `PLAUSIBLE`.

    Raises:
        ValueError: When a field is checked, of a number outside the range; pydantic reports it with the field.
    """

    def check(value: float | tuple[float, ...] | None) -> float | tuple[float, ...] | None:
        for one in value if isinstance(value, tuple) else () if value is None else (value,):
            if not PLAUSIBLE[quantity].holds(one):
                raise ValueError(PLAUSIBLE[quantity].refusal(one))
        return value

    return AfterValidator(check)


def _array(values: Any) -> Array:
    if _holds_truth(values):
        raise ValueError("true and false are no numbers; state the number")
    try:
        found = np.array(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError("is no table of numbers with rows of one length") from error
    if found.ndim == 0:
        raise ValueError("is one number; a list is needed")
    if not np.all(np.abs(found) <= LARGEST):
        raise ValueError("holds a number that no quantity has; correct it")
    return found


# An array that is rows of numbers in the file.
FileArray = Annotated[Array, PlainValidator(_array), PlainSerializer(lambda array: array.tolist())]

# Width or height of a frame in pixels: what a file states decides how large an array will be.
Side = Annotated[int, Field(gt=0, le=_MOST_SIDE)]


def refuse_large_frame(width: int, height: int) -> None:
    """Refuse a frame that no sensor has. Raises ValueError, which pydantic reports with the section."""
    if width * height > _MOST_PIXELS:
        raise ValueError(f"{width} × {height} pixels: no sensor has so many; at most {_MOST_PIXELS / 1e6:g} million")


class _Section(BaseModel):
    """A section of a file, whose `true` is no number: pydantic would take it as 1."""

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_numbers(cls, mapping: Any) -> Any:
        for key, value in mapping.items() if isinstance(mapping, Mapping) else ():
            if _holds_truth(value) and key in cls.model_fields and not _takes_truth(cls, key):
                raise ValueError(f"{key} = {value}: true and false are no numbers; state the number")
            if key in cls.model_fields and int in _kinds(cls, key) and _exceeds_whole(value):
                raise ValueError(f"{key} = {str(value)[:40]}: no count has this size; at most {_LARGEST_WHOLE}")
        return mapping

    @model_validator(mode="after")
    def _numbers_have_a_size(self) -> Self:
        for key in type(self).model_fields:
            for number in _numbers_of(getattr(self, key)):
                if abs(number) > LARGEST or (_is_above_zero(type(self), key) and number < _SMALLEST):
                    raise ValueError(f"{key} = {number:g}: no quantity has this size; correct the power of ten")
        return self


class FileSection(_Section):
    """A section of an exchange file: frozen; keys that other programs added are kept.

    A key that is a known one in another spelling or unit is no such key, but one that would be ignored in silence.
    """

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _further_keys_are_others(cls, mapping: Any) -> Any:
        further = [str(key) for key in mapping if key not in cls.model_fields] if isinstance(mapping, Mapping) else []
        absent = frozenset(cls.model_fields.keys() - mapping.keys()) if further else frozenset()
        for key in further:
            if (meant := _meant(key, cls, absent)) is not None:
                raise ValueError(f"key {key[:80]!r} is not read; write {meant!r}, or give it a name less like that")
        return mapping


class ConfigSection(_Section):
    """A section of a file that this program alone reads: frozen; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def validate(model: type[ModelT], mapping: Mapping[str, Any], where: str, error: type[RadiometerError]) -> ModelT:
    """Return the model of a mapping.

    Raises:
        RadiometerError: Of the class `error`, naming key, value and what is allowed.
    """
    try:
        return model.model_validate(mapping)
    except ValidationError as found:
        lines = [_line(entry, model) for entry in found.errors(include_url=False)]
        more = f" (and {len(lines) - 3} more)" if len(lines) > 3 else ""
        raise error(f"{where}: " + "; ".join(lines[:3]) + more) from found


def refuse_unknown(
    mapping: Mapping[str, Any], known: Collection[str], where: str, error: type[RadiometerError]
) -> None:
    """Refuse a mapping with a key that is not known. Raises RadiometerError of the class `error`."""
    for key in mapping:
        if key not in known:
            raise error(f"{where}: {_unknown(str(key), known)}")


def _unknown(key: str, known: Collection[str]) -> str:
    return f"unknown key {key[:80]!r}" + (f"; allowed here: {', '.join(sorted(known))}" if known else "")


def _line(entry: Mapping[str, Any], model: type[BaseModel]) -> str:
    key, _ = _place(model, entry["loc"])
    if entry["type"] == "missing":
        return f"key {key!r} is missing"
    if entry["type"] == "extra_forbidden":
        return _unknown(key, list(_place(model, entry["loc"][:-1])[1].model_fields))
    message = entry["msg"].removeprefix("Value error, ")
    if isinstance(entry.get("input"), Mapping) and entry["type"] == "value_error":  # of a whole section, which names it
        return ": ".join(filter(None, (key, message)))
    shown = repr(entry.get("input"))
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return f"{key} = {shown}: {message[0].lower()}{message[1:]}"


@functools.lru_cache(1024)  # the frames of a capture set all have the same further keys
def _meant(key: str, model: type[BaseModel], absent: frozenset[str]) -> str | None:
    """Return the known key that an unknown one is in another spelling; None where it is like none.

    One that differs in its unit or in a letter is so only where the known key is absent. Next to that, it is a further
    statement of another program.
    """
    plain = _plain(key)
    for known in model.model_fields:
        if _plain(known) == plain:
            return known
    for known in sorted(absent):
        same_quantity = _plain(known, without_unit=True) == _plain(key, without_unit=True)
        if same_quantity or (len(plain) <= _LONGEST_KEY and _likeness(plain, _plain(known)) >= _ALIKE):
            return known
    return None


def _plain(key: str, *, without_unit: bool = False) -> str:
    """Return a key in small letters and digits alone."""
    words = re.findall("[a-z0-9]+", key.lower())
    return "".join(words[:-1] if without_unit and len(words) > 1 and words[-1] in _UNITS else words)


def _likeness(one: str, other: str) -> float:
    return SequenceMatcher(None, one, other, autojunk=False).ratio()


def _place(model: type[BaseModel], path: tuple[Any, ...]) -> tuple[str, type[BaseModel]]:
    """Return a place in a file in words, and the section there; pydantic adds the tag of a kind of section."""
    names, inside, kinds = list[str](), model, list[type[BaseModel]]()
    for part in path:
        tagged = [kind for kind in kinds if any(part in get_args(f.annotation) for f in kind.model_fields.values())]
        if tagged:
            inside, kinds = tagged[0], []
            continue
        names.append(str(part))
        field = inside.model_fields.get(part) if isinstance(part, str) else None
        if field is not None:
            kinds = [t for t in (field.annotation, *get_args(field.annotation)) if _is_model(t)]
            inside = kinds[0] if kinds else BaseModel
    return ".".join(names), inside


def _numbers_of(value: Any) -> Iterator[float]:
    if isinstance(value, float | int):
        yield value
    elif isinstance(value, dict | tuple):
        for one in value.values() if isinstance(value, dict) else value:
            if isinstance(one, float | int):
                yield one


@functools.cache
def _is_above_zero(model: type[BaseModel], name: str) -> bool:
    return any(getattr(rule, "gt", None) == 0 for rule in model.model_fields[name].metadata)


def _holds_truth(value: Any) -> bool:
    return isinstance(value, bool) or (isinstance(value, list | tuple) and any(map(_holds_truth, value)))


def _exceeds_whole(value: Any) -> bool:
    """Return whether a number, one written as text, or one in a list is larger than a count can be."""
    if isinstance(value, list | tuple):
        return any(map(_exceeds_whole, value))
    try:
        return abs(float(value)) > _LARGEST_WHOLE
    except OverflowError:  # an integer of more than 308 digits
        return True
    except (TypeError, ValueError):
        return False


@functools.cache
def _kinds(model: type[BaseModel], name: str) -> frozenset[type]:
    """Return the plain types of which the type of a field is put together."""
    kinds: list[Any] = [model.model_fields[name].annotation]
    for kind in kinds:
        kinds.extend(get_args(kind))
    return frozenset(kind for kind in kinds if isinstance(kind, type))


def _takes_truth(model: type[BaseModel], name: str) -> bool:
    """Return whether a field may hold true or false: where nothing that it takes is a number, its type decides."""
    kinds = _kinds(model, name)
    return bool in kinds or not {int, float} & kinds


def _is_model(candidate: Any) -> bool:
    return isinstance(candidate, type) and issubclass(candidate, BaseModel)
