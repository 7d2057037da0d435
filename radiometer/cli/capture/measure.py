"""`radiometer measure`: the radiance of a patch, with its uncertainty."""

from __future__ import annotations

import functools
import inspect
import time
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from radiometer.cli.console import console, note, show_table
from radiometer.cli.function import command_of
from radiometer.cli.options import CameraOption
from radiometer.errors import UsageError
from radiometer.numbers import below, rounded, upper_limit, with_u
from radiometer.reporting.reading_page import FLAG_MEANINGS

if TYPE_CHECKING:
    from radiometer import Reading


def _served(json: bool, watch: bool = False, **_: Any) -> dict[str, Any]:
    """Return what the readings of a camera are given; JSON goes to programs, which find a notice in the reading."""
    heard = (lambda line: None) if json and not watch else note
    return {"notice": heard, "sleep": time.sleep, "clock": time.monotonic}


def _show_distribution(reading: Reading) -> None:
    """Print the interval by the propagation of distributions next to the budget's."""
    drawn = reading.more["monte_carlo"]
    out, u = console(), reading.radiance.u
    low, high = (rounded(drawn[end], 2 * u)[0] for end in ("low", "high"))
    out.print(f"drawn      {low} to {high} (95.45 %, JCGM 101), u = {drawn['u']:.3g}")
    if drawn["validates"]:
        out.print(f"           agrees with the budget to {drawn['tolerance']:.2g}")
    else:
        out.print(
            f"[yellow]           differs from the budget: by {drawn['low_differs_by']:+.2g} at the lower end and "
            f"{drawn['high_differs_by']:+.2g} at the upper, more than {drawn['tolerance']:.2g}[/yellow]; "
            "quote this one"
        )


def _show(reading: Reading, *, budget: bool) -> None:
    out = console()
    value = reading.radiance
    k, limit, luminance = reading.coverage_factor, reading.upper_limit, reading.luminance
    if limit is None:
        shown, share = with_u(value.value, k * value.u, value.unit), f"{100 * reading.expanded_u_rel:.2g}"
        out.print(f"radiance   [bold]{shown}[/bold]   (k = {k:.3g}, {share} %)")
    else:
        out.print(f"radiance   [bold]{below(limit.value, limit.unit)}[/bold]")
    if luminance and limit is None:
        out.print(f"luminance  {with_u(luminance.value, k * luminance.u, luminance.unit, k=k)}")
    elif luminance:
        out.print(f"luminance  {below(upper_limit(luminance.value, luminance.u), luminance.unit)}")
    if reading.band_nm:
        out.print("band       {:g} to {:g} nm".format(*reading.band_nm))
    exposures = ", ".join(_time(t) for t in sorted(set(reading.exposures_s)))
    out.print(f"exposures  {exposures}")
    for flag in reading.flags:
        out.print(f"[yellow]flag       {flag}[/yellow]: {FLAG_MEANINGS[flag]}")
    if budget:
        _show_budget(reading)
    if "monte_carlo" in reading.more:
        _show_distribution(reading)


def _time(seconds: float) -> str:
    unit, scale = ("s", 1.0) if seconds >= 1 else ("ms", 1e-3) if seconds >= 1e-3 else ("µs", 1e-6)
    return f"{seconds / scale:.4g} {unit}"


_ENDLESS: Final = 1e5  # degrees of freedom: Student's t is the normal distribution to 5 digits


def _show_budget(reading: Reading) -> None:
    total, rows = sum(entry.u_rel**2 for entry in reading.budget) or 1.0, []
    for entry in sorted(reading.budget, key=lambda contribution: -contribution.u_rel):
        dof = f"{entry.degrees_of_freedom:.0f}" if entry.degrees_of_freedom < _ENDLESS else "∞"
        share = 100 * entry.u_rel**2 / total
        rows.append((entry.name, f"{100 * entry.u_rel:.3f}", f"{share:.1f}", entry.kind, dof, entry.note))
    head = ("contribution", "u rel. %", "share %", "type", "dof", "from")
    show_table("uncertainty budget (k = 1)", head, rows, words=(0, 3, 5))


def _show_of_photographs(reading: Reading, *, budget: bool) -> None:
    if reading.more["alignment"]:
        note(f"frames: {reading.more['alignment']}")
    for assumption in reading.more["assumptions"]:
        note(f"assumed: {assumption}")
    _show(reading, budget=budget)


_BUDGET: Final = {"budget": (False, Annotated[bool, typer.Option("--budget", help="Print the uncertainty budget.")])}
_OF_CAMERA: Final = command_of(
    "readings", _show, files=("report",), serves=_served, shown=_BUDGET, camera=CameraOption,
    patch=typer.Option(),
)  # fmt: skip
_OF_PHOTOGRAPHS: Final = command_of(
    "measure_photographs", _show_of_photographs, files=("report",), shown=_BUDGET,
    defaults={"photographs": None}, photographs=typer.Option(), patch=typer.Option(),
)  # fmt: skip
_TAKEN: Final = {one: inspect.signature(one).parameters for one in (_OF_CAMERA, _OF_PHOTOGRAPHS)}


@functools.wraps(_OF_CAMERA)
def command(**given: Any) -> int:
    """Read a camera, or photographs where a folder of them is named."""
    if given["report"] is not None and (given["watch"] or given["repeat"] > 1):
        raise UsageError("--report writes the page of one reading: leave --watch and --repeat out")
    chosen, other = (_OF_CAMERA, _OF_PHOTOGRAPHS)[:: 1 if given["photographs"] is None else -1]
    for name in _TAKEN[other].keys() - _TAKEN[chosen].keys():
        if given.pop(name) != _TAKEN[other][name].default:
            belongs = "belongs to" if other is _OF_PHOTOGRAPHS else "excludes"
            raise UsageError(f"--{name.replace('_', '-')} {belongs} --photographs; leave it out, or correct both")
    return chosen(**given)


command.__doc__ = """Read the radiance of a patch, with its uncertainty.

Meters the patch, takes the necessary exposures and merges them; --photographs reads a folder instead of a camera.
Prints the radiance in W·sr⁻¹·m⁻² with its expanded uncertainty (95.45 %, k by Student's t), the luminance, and the
flags of the reading.
"""
_parameters = {**_TAKEN[_OF_PHOTOGRAPHS], **_TAKEN[_OF_CAMERA]}
_parameters["force"] = _parameters.pop("force")
command.__signature__ = inspect.Signature(list(_parameters.values()))  # type: ignore[attr-defined]
command.__annotations__ = {name: one.annotation for name, one in _parameters.items()}
