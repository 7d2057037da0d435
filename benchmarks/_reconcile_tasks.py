"""The runs of the confusion matrix: what is hidden in each, and how the finder is asked."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from testing.generator import session  # noqa: F401  (fills the registry)
from testing.generator.registry import ENTRIES, OUTSIDERS, VARIANTS, forms_of

KINDS = tuple(
    "null single weak pair own_pair variant outsider removed unknown plain plain_unknown".split()  # noqa: SIM905
)
# Pairs of which one hides or imitates the other outright, with this plan: the same light, codes or charge twice.
INSEPARABLE = (
    {"missing_codes", "reduced_bit_depth"},
    {"dark_current", "dark_current_clamped"},
    {"pwm_flicker", "mains_ripple"},
    {"full_well_saturation", "soft_saturation"},
    {"full_well_saturation", "adc_saturation"},
    {"natural_vignetting", "angle_dependence"},
    {"mechanical_vignetting", "angle_dependence"},
)


# Every entry but the one that stands in the labels themselves: a bracket has no printed stops.
PLAIN = [n for n, hidden in ENTRIES.items() if hidden.plan != "printed"]


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        kind: One of `KINDS`.
        names: What is hidden: entries, `entry:form` for another equation of one, or outsiders.
        seed: Seed of rig and session.
        scale: Factor on the drawn size (1 to 2 units).
        without: Entries that the finder may not use.
        known_patches: Whether the patches' radiances are stated.
        plan: Name of the plan; None for the effect's own.
    """

    kind: str
    names: tuple[str, ...]
    seed: int
    scale: float = 1.0
    without: tuple[str, ...] = ()
    known_patches: bool = True
    plan: str | None = None

    @property
    def key(self) -> str:
        """Return the name under which the result is kept."""
        return f"{self.kind}/{'+'.join(self.names) or '-'}/{self.seed}"

    def to_mapping(self) -> dict[str, Any]:
        """Return it for the results' file."""
        return asdict(self)


def visible() -> list[str]:
    """Return the entries that the standard plan can show."""
    return [n for n, h in ENTRIES.items() if h.visible]


def tasks(kinds: tuple[str, ...], seeds: int, *, first_seed: int = 0) -> Iterator[Task]:
    """Yield the runs of the kinds, `seeds` of each entry (nulls: 50 times as many, pairs: 20 times).

    Weak and paired effects take the entry's own equation or one of its other forms, drawn by their seed; `own_pair`
    hides both by the entries' own equations.
    """
    makers = {
        "null": lambda: (Task("null", (), first_seed + s) for s in range(50 * seeds)),
        "single": lambda: _each("single", visible(), seeds, first_seed),
        "weak": lambda: map(_in_any_form, _each("weak", visible(), max(1, seeds // 2), first_seed, scale=0.3)),
        "pair": lambda: map(_in_any_form, _pairs("pair", 20 * seeds, first_seed + 2000)),
        "own_pair": lambda: _pairs("own_pair", 20 * seeds, first_seed + 6000),
        "variant": lambda: _each("variant", list(VARIANTS), seeds, first_seed),
        "outsider": lambda: _each("outsider", list(OUTSIDERS), seeds, first_seed),
        "removed": lambda: _removed(max(1, seeds // 2), first_seed),
        "unknown": lambda: _each("unknown", visible(), max(1, seeds // 4), first_seed, known_patches=False),
        "plain": lambda: _each("plain", PLAIN, max(1, seeds // 4), first_seed, plan="bracket"),
        "plain_unknown": lambda: _each(
            "plain_unknown", PLAIN, max(1, seeds // 4), first_seed, plan="bracket", known_patches=False
        ),
    }
    return itertools.chain.from_iterable(makers[kind]() for kind in kinds)


def _each(kind: str, names: list[str], seeds: int, first: int, **options: Any) -> Iterator[Task]:
    for s, name in itertools.product(range(seeds), names):
        yield Task(kind, (name,), first + 1000 + s, **options)


def _in_any_form(task: Task) -> Task:
    """Return the task with each entry in one of its forms, all alike likely."""
    names = []
    for name in task.names:
        forms = forms_of(name)
        rng = np.random.default_rng([task.seed, zlib.crc32(f"{task.kind}/{name}".encode())])
        names.append(forms[int(rng.integers(len(forms)))])
    return replace(task, names=tuple(names))


def _pairs(kind: str, count: int, first: int) -> Iterator[Task]:
    rng = np.random.default_rng([first, 77])
    names = [n for n in visible() if ENTRIES[n].plan == "rich"]
    made = 0
    while made < count:
        pair = {names[i] for i in rng.choice(len(names), 2, replace=False)}
        if pair not in INSEPARABLE:
            yield Task(kind, tuple(sorted(pair)), first + made)
            made += 1


def _removed(seeds: int, first: int) -> Iterator[Task]:
    for s, name in itertools.product(range(seeds), visible()):
        gone = (name, *(a for a in ENTRIES[name].accepted if a in ENTRIES and name in ENTRIES[a].accepted))
        yield Task("removed", (name,), first + 3000 + s, without=gone)
