"""Response curves in the forms of other programs: pfstools (.m) and hdrgen or Photosphere (.rsp)."""

from __future__ import annotations

from collections.abc import Mapping
from math import comb
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from radiometer.data import ResponseCurve
from radiometer.data.storage import write_text_atomic
from radiometer.errors import UsageError

CURVE_SUFFIXES: Final = (".m", ".rsp")
_CHANNELS: Final = {"red": "IR", "green": "IG", "blue": "IB"}
_HIGHEST_ORDER: Final = 12
_GOOD_ENOUGH: Final = 5e-4  # rms of the polynomial about the curve, of full scale


def write_curves(path: Path, curves: Mapping[str, ResponseCurve]) -> None:
    """Write curves for another program, by the ending of the name: three channels in one file.

    One curve serves all three channels; otherwise red, green and blue must be there.

    Args:
        path: File to write, ending in .m or .rsp.
        curves: By channel.

    Raises:
        UsageError: If the ending is another, or channels are missing.
        OutputError: If the file cannot be written.
    """
    three = _three(path, curves)
    if path.suffix.lower() == ".m":
        write_text_atomic(path, "".join(_pfstools(_CHANNELS[name], curve) for name, curve in three.items()))
    elif path.suffix.lower() == ".rsp":
        write_text_atomic(path, "".join(_hdrgen(curve) for curve in three.values()))
    else:
        raise UsageError(f"{path}: a curve for another program ends in {' or '.join(CURVE_SUFFIXES)}")


def polynomial(curve: ResponseCurve) -> NDArray[np.float64]:
    """Return the coefficients (highest power first) of relative exposure over M/M_max, 1 at M_max, never falling.

    The lowest order whose rms is under 0.05 % of full scale is taken, or the best of orders 1 to 12.

    Args:
        curve: The response curve.

    Source: Mitsunaga and Nayar 1999, equation (3): H = Σ c_n·Mⁿ with f(1) = 1. A Bernstein polynomial with rising
    coefficients rises (Farouki 2012, Comput. Aided Geom. Des. 29, 379), so that these are fitted, then expanded.
    """
    x = np.linspace(0.0, 1.0, curve.log_exposure.size)
    y = _continued(curve)
    best, least = np.array([1.0, 0.0]), np.inf
    for order in range(1, _HIGHEST_ORDER + 1):
        bernstein = np.stack([comb(order, k) * x**k * (1.0 - x) ** (order - k) for k in range(order + 1)], axis=1)
        upper = np.cumsum(bernstein[:, ::-1], axis=1)[:, ::-1]
        # f = 1 − Σ d_k·(1 − Σ_{j≥k} B_j) with steps d_k ≥ 0 is 1 at the end and rises everywhere.
        steps, norm = optimize.nnls(1.0 - upper[:, 1:], 1.0 - y)
        rms = float(norm) / np.sqrt(x.size)
        if rms < least:
            best, least = _powers(1.0 - np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])), rms
        if least < _GOOD_ENOUGH:
            break
    return best


def _powers(bernstein: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of powers, highest first, of a polynomial given by its Bernstein coefficients."""
    order = bernstein.size - 1
    found = np.zeros(order + 1)
    for n in range(order + 1):
        found[n] = comb(order, n) * sum((-1) ** (n - k) * comb(n, k) * bernstein[k] for k in range(n + 1))
    return found[::-1]


def _relative_exposure(curve: ResponseCurve) -> NDArray[np.float64]:
    """Return exp(g) with the highest value at 1, and 0 where the curve says nothing at the black end."""
    g = curve.log_exposure
    finite = np.isfinite(g)
    top = float(g[finite][-1])
    dn = np.arange(g.size)
    return np.where(dn < dn[finite][0], 0.0, np.exp(np.interp(dn, dn[finite], g[finite]) - top))


def _continued(curve: ResponseCurve) -> NDArray[np.float64]:
    """Return relative exposure, 1 at the end, that goes on as a straight line above the last number with data.

    A curve extrapolated in the logarithm may shoot up by decades there, and a polynomial would follow only that.
    """
    relative = _relative_exposure(curve)
    last = min(curve.valid_dn[1], relative.size - 1) if curve.valid_dn else relative.size - 1
    before = max(last - relative.size // 32, 0)
    slope = (relative[last] - relative[before]) / max(last - before, 1)
    beyond = np.arange(relative.size) - last
    line = np.where(beyond > 0, relative[last] + slope * beyond, relative)
    return np.asarray(line / line[-1])


def _three(path: Path, curves: Mapping[str, ResponseCurve]) -> dict[str, ResponseCurve]:
    if len(curves) == 1:
        return dict.fromkeys(_CHANNELS, next(iter(curves.values())))
    missing = [name for name in _CHANNELS if name not in curves]
    if missing:
        raise UsageError(f"{path}: needs one curve, or red, green and blue; missing: {', '.join(missing)}")
    return {name: curves[name] for name in _CHANNELS}


def _pfstools(name: str, curve: ResponseCurve) -> str:
    """Return the matrix of one channel as pfshdrcalibrate reads and writes it."""
    lines = [
        f"# Camera response curve, channel {name}",
        "# data layout: log10(response) | camera output | response",
        f"# name: {name}",
        "# type: matrix",
        f"# rows: {curve.log_exposure.size}",
        "# columns: 3",
    ]
    relative = _relative_exposure(curve)
    for dn, value in enumerate(relative / relative[relative.size // 2]):
        logarithm = np.log10(value) if value > 0.0 else -6.0
        lines.append(f" {logarithm:15.9f} {dn:4d} {value:15.9f}")
    return "\n".join(lines) + "\n\n"


def _hdrgen(curve: ResponseCurve) -> str:
    """Return one line: the order, then the coefficients from the highest power down."""
    coefficients = polynomial(curve)
    return " ".join([str(coefficients.size - 1), *(f"{c:.12g}" for c in coefficients)]) + "\n"
