"""What the model of a camera lacks."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiometer.api.files import PathLike
from radiometer.data.drawing import new_axes, picture
from radiometer.reconciliation.inputs.sources import Done, reconcile_source
from radiometer.reconciliation.result import FittedParameter, FoundEffect

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Reconciliation:
    """Where simulation and measurement disagree, and which effect is missing.

    Examples:
        >>> import radiometer as rm
        >>> found = rm.reconcile("meter.csv")
        >>> found.verdict, [effect.name for effect in found.effects]
        ('effects_found', ['nominal_settings'])
        >>> before, after = found.gap
        >>> after <= before
        True
        >>> found.write_report("report.html")

    Attributes:
        done: The result, and what can be written of it.
    """

    done: Done

    @property
    def verdict(self) -> str:
        """Return "agrees", "effects_found", "unnamed_effect" or "incomplete"."""
        return str(self.done.result.verdict)

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Return what was found, in the order of finding."""
        return self.done.result.effects

    @property
    def gap(self) -> tuple[float, float]:
        """Return the held-out gap before and after."""
        return self.done.result.gap_before, self.done.result.gap_after

    def write_model(self, path: PathLike) -> None:
        """Write the camera model with what was found. Raises OutputError if it cannot be written."""
        self.done.write_model(Path(path))

    def write_report(self, path: PathLike) -> None:
        """Write the self-contained HTML report. Raises OutputError if it cannot be written."""
        self.done.write_report(Path(path))

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form."""
        return self.done.result.to_mapping()

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the gap of held-out settings as it closes, name by name.

        Args:
            axes: Where to draw; a new figure by default.
        """
        where = axes if axes is not None else new_axes()
        names = ["as it was", *(f"+ {effect.name}" for effect in self.effects)]
        gaps = [self.gap[0], *(effect.gap_after for effect in self.effects)]
        where.barh(names, gaps, color=["tab:red", *["tab:blue"] * len(self.effects)])
        where.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
        where.invert_yaxis()
        where.set_xlabel("gap of held-out settings (dotted: noise alone)")
        return where

    def __repr__(self) -> str:
        """Return verdict, names and gap in one line."""
        names = ", ".join(effect.name for effect in self.effects) or "nothing missing"
        before, after = self.gap
        return f"<Reconciliation {self.verdict}: {names}; gap {before:.3g} → {after:.3g}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{html.escape(effect.name)}</td><td>{html.escape(_parameters(effect))}</td>"
            f"<td>{html.escape(effect.where)}</td><td>{html.escape(', '.join(effect.alternatives))}</td></tr>"
            for effect in self.effects
        )
        head = "<tr><th>effect</th><th>parameters</th><th>where</th><th>alternatives</th></tr>"
        table = f"<table>{head}{rows}</table>" if rows else ""
        return picture(self.plot, repr(self)) + table


def reconcile(path: PathLike, *, model: PathLike | None = None, without: tuple[str, ...] = ()) -> Reconciliation:
    """Find where simulation and measurement disagree, name the missing effect, and show the gap shrink.

    Examples:
        >>> import radiometer as rm
        >>> rm.reconcile("meter.csv")
        <Reconciliation effects_found: nominal_settings; gap ... → ...>

    Args:
        path: Capture set, EMVA 1288 descriptor, or light-meter table.
        model: Model file to start from; the ideal camera by default.
        without: Entries of the catalogue to leave out.

    Raises:
        CaptureError: If the path holds nothing that can be reconciled.
    """
    return Reconciliation(reconcile_source(Path(path), model_path=Path(model) if model else None, without=without))


def _parameters(effect: FoundEffect) -> str:
    return ", ".join(f"{name} = {_parameter(found)}" for name, found in effect.parameters.items())


def _parameter(found: FittedParameter) -> str:
    own = "" if found.u is None else f" ± {found.u:.2g}"
    return f"{found.value:.4g}{own} {found.unit}"
