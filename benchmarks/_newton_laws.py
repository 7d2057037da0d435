"""Reads the laws of NewtonBench from a checkout of it: functions, their variables and the ranges of these.

Nothing of it is kept in this project. Source: HKUST-KnowComp/NewtonBench (MIT), arXiv:2510.07172.
"""

from __future__ import annotations

import inspect
import itertools
import re
import runpy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.reconciliation.propose.grammar import formula

_SAMPLES: Final = 40  # random places at which a form is recognised: more than any form has constants
_SAME: Final = 1e-9  # relative: what is the same function but for rounding
_NUMBER: Final = r"(?:np\.log\()?([^,()]+)\)?"


@dataclass(frozen=True)
class Law:
    """One law of the benchmark."""

    domain: str
    level: str  # easy, medium or hard
    version: str
    function: Callable[..., float]
    ranges: Mapping[str, tuple[float, float]]  # of its variables, in the order of its arguments

    @property
    def name(self) -> str:
        """Return domain, level and version."""
        return f"{self.domain} {self.level} {self.version}"

    def values(self, variables: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the law's value at each place, NaN where it has none."""
        rows = zip(*(variables[name] for name in self.ranges), strict=True)
        return np.array([float(self.function(*(float(v) for v in row))) for row in rows])

    def middle(self) -> dict[str, float]:
        """Return the middle of each range, in the logarithm."""
        return {name: float(np.sqrt(low * high)) if low > 0 else high / 2 for name, (low, high) in self.ranges.items()}

    def drawn(self, dice: np.random.Generator) -> dict[str, np.ndarray]:
        """Return random places in its ranges."""
        return {name: dice.uniform(low, high, _SAMPLES) for name, (low, high) in self.ranges.items()}

    def depends_on(self, dice: np.random.Generator) -> tuple[str, ...]:
        """Return the variables that its value depends on."""
        places = self.drawn(dice)
        here, found = self.values(places), []
        for name in self.ranges:
            there = self.values({**places, name: places[name][::-1]})
            if not np.allclose(there, here, rtol=_SAME, atol=0.0, equal_nan=True):
                found.append(name)
        return tuple(found)


def read_laws(checkout: Path) -> Iterator[Law]:
    """Yield the laws of a checkout, domain by domain.

    Raises:
        OSError: If the folder holds no `modules/*/laws.py`.
        ValueError: If a range of a variable cannot be read from `core.py`.
    """
    files = sorted(checkout.glob("modules/m*/laws.py"))
    if not files:
        raise FileNotFoundError(f"{checkout}: no modules/*/laws.py; give a checkout of HKUST-KnowComp/NewtonBench")
    for file in files:
        text = file.with_name("core.py").read_text(encoding="utf-8")
        for level, versions in runpy.run_path(str(file))["LAW_REGISTRY"].items():
            for version, function in versions.items():
                names = inspect.signature(function).parameters
                yield Law(file.parent.name, level, version, function, {name: _range_of(name, text) for name in names})


def _range_of(name: str, text: str) -> tuple[float, float]:
    """Return the range from which the benchmark's evaluation draws a variable."""
    found = re.search(
        rf"\b{name}(?:_values|_magnitudes)?'?\s*[:=]\s*(?:np\.exp\()?np\.random\.uniform\({_NUMBER},\s*{_NUMBER}", text
    )
    if found is None:
        raise ValueError(f"no range of {name!r}")
    low, high = (float(formula(part.strip())({})) for part in found.groups())
    return low, high


@dataclass(frozen=True)
class Factor:
    """A factor of a law that a grammar of products can hold: a power or an exponential of one variable."""

    variable: str
    form: str  # power or decay
    value: float  # exponent, or the length of the exponential


def factors_of(value: Callable[[Mapping[str, np.ndarray]], np.ndarray], places: Mapping[str, np.ndarray]) -> (
    tuple[Factor, ...] | None
):  # fmt: skip
    """Return a function as a product of powers and exponentials; None where it is none.

    Args:
        value: The function.
        places: Random places, by variable.
    """
    found = value(places)
    sign = np.sign(found)
    if not np.isfinite(found).all() or not (sign == sign[0]).all() or sign[0] == 0:
        return None
    names, target = list(places), np.log(np.abs(found))
    for forms in itertools.product(("power", "decay"), repeat=len(names)):
        columns = [np.log(places[n]) if form == "power" else places[n] for n, form in zip(names, forms, strict=True)]
        if not np.isfinite(columns).all():
            continue
        scales = np.array([np.abs(column).max() for column in columns])
        matrix = np.stack([np.ones(target.size), *(c / s for c, s in zip(columns, scales, strict=True))], axis=1)
        solved = np.linalg.lstsq(matrix, target, rcond=None)[0]
        if np.abs(matrix @ solved - target).max() < 1e-6 * max(float(np.ptp(target)), 1e-6):
            slopes = solved[1:] / scales
            shown = [(n, f, s) for n, f, s in zip(names, forms, slopes, strict=True) if abs(s) > 1e-6]
            return tuple(Factor(n, f, float(s if f == "power" else -1.0 / s)) for n, f, s in shown)
    return None
