"""The recovered response of a camera, with plot and table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.response.estimate import ResponseEstimate, median_uncertainty
from radiometer.analysis.response.labels import refuse_lying_labels
from radiometer.analysis.response.methods import DEFAULT_METHOD, METHODS, method_names
from radiometer.api.files import PathLike, Stack
from radiometer.data import Bracket, ResponseCurve
from radiometer.data.drawing import new_axes, picture
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Response:
    """How digital numbers follow from exposure.

    Examples:
        >>> import radiometer as rm
        >>> response = rm.recover_response(rm.read("out/chart"), "linear_spline")
        >>> response.log_exposure.shape, response.u.shape
        ((4096,), (4096,))
        >>> response.to_csv("curve.csv")
        >>> response.plot().get_xlabel()
        'digital number M (DN)'

    Attributes:
        estimate: The curve with all diagnostics.
    """

    estimate: ResponseEstimate

    @property
    def curve(self) -> ResponseCurve:
        """Return the curve g(M) = ln H."""
        return self.estimate.curve

    @property
    def log_exposure(self) -> NDArray[np.float64]:
        """Return ln H per digital number, shape (2**bit_depth,)."""
        return self.curve.log_exposure

    @property
    def u(self) -> NDArray[np.float64]:
        """Return the standard uncertainty of ln H, same shape."""
        return self.curve.u_log_exposure

    def to_csv(self, path: PathLike) -> None:
        """Write `dn,log_exposure,u_log_exposure`. Raises UsageError for another ending, OutputError if it fails."""
        target = Path(path)
        if target.suffix.lower() != ".csv":
            raise UsageError(f"{path}: the name must end in .csv")
        self.curve.write(target)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw ln H over the digital number with its k = 2 band, where the data support it.

        Args:
            axes: Where to draw; a new figure by default.
        """
        where = axes if axes is not None else new_axes()
        low, high = self.curve.valid_dn or (0, self.log_exposure.size - 1)
        dn = np.arange(low, high + 1)
        g, u = self.log_exposure[low : high + 1], self.u[low : high + 1]
        (line,) = where.plot(dn, g, label=f"{self.estimate.method}, {self.curve.channel}")
        where.fill_between(dn, g - 2 * u, g + 2 * u, color=line.get_color(), alpha=0.2, linewidth=0)
        where.set_xlabel("digital number M (DN)")
        where.set_ylabel("ln H  (J m⁻²)" if self.curve.absolute else "ln H, relative to the middle value")
        where.grid(visible=True, alpha=0.3)
        return where

    def __repr__(self) -> str:
        """Return method, depth, range and median uncertainty in one line."""
        valid = self.curve.valid_dn or (0, self.log_exposure.size - 1)
        u = 100 * median_uncertainty(self.curve)
        return (
            f"<Response by {self.estimate.method}: {self.curve.channel}, {self.curve.bit_depth} bits, "
            f"DN {valid[0]} to {valid[1]}, median u {u:.2g} %>"
        )

    def _repr_html_(self) -> str:
        return picture(self.plot, repr(self))


def recover_response(stacks: Stack | Bracket | Sequence[Stack | Bracket], method: str = DEFAULT_METHOD) -> Response:
    """Recover a camera's response from brackets of one unmoving scene each.

    Examples:
        >>> import radiometer as rm
        >>> rm.recover_response(rm.read("out/chart"), "linear_spline")
        <Response by linear_spline: ..., 12 bits, DN ... to ..., median u ... %>

    Args:
        stacks: One or several; all of one camera and channel, fitted jointly.
        method: "auto", "debevec1997", "mitsunaga1999", "robertson1999" or "linear_spline".

    Raises:
        UsageError: If there is no such method, or a stack holds several channels.
        MeasurementError: If the frames do not determine a curve.
    """
    if method_names(method) != [method]:
        raise UsageError(f"one method at a time: {', '.join(METHODS)}")
    several = stacks if isinstance(stacks, Sequence) else [stacks]
    brackets = [one if isinstance(one, Bracket) else one.bracket for one in several]
    for bracket in brackets:
        refuse_lying_labels(bracket)
    return Response(METHODS[method](brackets))
