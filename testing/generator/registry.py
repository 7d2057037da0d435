"""The list of what can be hidden: one function per effect, entered by a decorator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testing.generator.world import World

Truth = dict[str, float | list[float] | str]
Hide = Callable[[World, np.random.Generator, float], Truth]


@dataclass(frozen=True)
class Hidden:
    """One thing that can be hidden.

    Attributes:
        name: Name of this form; the entry's name for the entry itself, `entry:form` for another form of it.
        entry: Catalogue name, or "" for what is in no catalogue.
        hide: Function (world, rng, scale) that puts it into the world and returns its true parameters; scale 1 is
            the smallest realistic size.
        covariates: Where it may rightly be seen: any of these is the right place.
        accepted: Other catalogue names that name it as well (the same family, or the same thing with these data).
        plan: Plan that shows it: rich, colours, printed.
        visible: Whether such a plan can show it at all.
    """

    name: str
    entry: str
    hide: Hide
    covariates: tuple[str, ...]
    accepted: tuple[str, ...] = ()
    plan: str = "rich"
    visible: bool = True


ENTRIES: dict[str, Hidden] = {}
VARIANTS: dict[str, Hidden] = {}
OUTSIDERS: dict[str, Hidden] = {}


def entry(
    name: str, *covariates: str, accepted: tuple[str, ...] = (), plan: str = "rich", visible: bool = True
) -> Callable[[Hide], Hide]:
    """Enter a catalogue effect under its canonical name."""

    def enter(function: Hide) -> Hide:
        ENTRIES[name] = Hidden(name, name, function, covariates, accepted, plan, visible)
        return function

    return enter


def variant(
    name: str, form: str, *covariates: str, accepted: tuple[str, ...] = (), plan: str = "rich"
) -> Callable[[Hide], Hide]:
    """Enter another form of a catalogue effect: the same cause, another equation."""

    def enter(function: Hide) -> Hide:
        VARIANTS[f"{name}:{form}"] = Hidden(f"{name}:{form}", name, function, covariates, accepted, plan)
        return function

    return enter


def outsider(name: str, *covariates: str, accepted: tuple[str, ...] = ()) -> Callable[[Hide], Hide]:
    """Enter an effect that no catalogue holds."""

    def enter(function: Hide) -> Hide:
        OUTSIDERS[name] = Hidden(name, "", function, covariates, accepted)
        return function

    return enter


def forms_of(name: str) -> list[str]:
    """Return the entry and all its other forms."""
    return [name, *(form for form, hidden in VARIANTS.items() if hidden.entry == name)]


def everything() -> dict[str, Hidden]:
    """Return all forms by name."""
    return {**ENTRIES, **VARIANTS, **OUTSIDERS}
