"""Response curves written and read in the formats of other programs, and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import comb
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.data import Provenance, ResponseCurve
from radiometer.data.drawing import check_plot_name, write_figure
from radiometer.data.reader_limits import bounded_reader
from radiometer.data.storage import write_text_atomic
from radiometer.errors import InputError, UsageError
from radiometer.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVE_SUFFIXES: Final = (".m", ".rsp")
_CHANNELS: Final = {"red": "IR", "green": "IG", "blue": "IB"}
FILE_METHOD: Final = "file"
ASSUMED_U_LOG: Final = 0.03  # what curves of other programs are off by on real cameras, in ln H
_HIGHEST_ORDER: Final = 12  # of the polynomial: above it the sums lose digits of double precision
_GOOD_ENOUGH: Final = 5e-4  # rms of the polynomial about the curve, of full scale
_COLOURS: Final = {"red": "#c0392b", "green": "#27843f", "blue": "#2a5db0"}


def write_curves(path: Path, curves: Mapping[str, ResponseCurve]) -> None:
    """Write curves for another program, by the ending of the name: three channels in one file.

    One curve serves all three channels; otherwise red, green and blue must be there.

    Args:
        path: File to write, ending in .m or .rsp.

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


@bounded_reader(error=InputError)
def read_curves(path: Path, bit_depth: int = 8) -> dict[str, ResponseCurve]:
    """Return the curves of a file by channel: ours (.csv, .yaml), pfstools' (.m) or hdrgen's (.rsp).

    The last two state no uncertainty: `ASSUMED_U_LOG` is taken, and the provenance states it. A CSV file is of the
    channel that its name ends in (`curve-red.csv`), else of "mono".

    Args:
        bit_depth: Bits per digital number of a polynomial (.rsp), which does not say.

    Raises:
        InputError: If the file cannot be read or holds no curve.
    """
    suffix = path.suffix.lower()
    if suffix not in CURVE_SUFFIXES:
        curve = ResponseCurve.read(path)
        named = path.stem.rpartition("-")[2].lower()
        channel = named if suffix == ".csv" and named in (*_CHANNELS, "luminance") else curve.channel
        return {channel: replace(curve, channel=channel)}
    try:
        words = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()[:1] not in "#"]
        rows = [np.array([float(word) for word in line]) for line in words if line]
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {error}") from error
    found = _from_pfstools(rows) if suffix == ".m" else _from_hdrgen(rows, 1 << bit_depth)
    if found is None:
        what = (
            "three columns and as many rows for each of three channels" if suffix == ".m" else "one polynomial a line"
        )
        raise InputError(f"{path}: holds no response curves; expected {what}")
    return {name: _as_curve(name, relative, path) for name, relative in zip(_CHANNELS, found, strict=True)}


def _from_pfstools(rows: list[NDArray[np.float64]]) -> list[NDArray[np.float64]] | None:
    """Return relative exposure by digital number, red, green, blue."""
    if not rows or len(rows) % 3 or any(row.size != 3 for row in rows):
        return None
    third = len(rows) // 3
    return [np.array([row[2] for row in rows[k * third : (k + 1) * third]]) for k in range(3)]


def _from_hdrgen(rows: list[NDArray[np.float64]], size: int) -> list[NDArray[np.float64]] | None:
    whole = all(np.isfinite(row).all() and row.size == int(row[0]) + 2 for row in rows)
    if len(rows) not in (1, 3) or not whole:
        return None
    scaled = np.linspace(0.0, 1.0, size)
    found = [np.maximum.accumulate(np.polyval(row[1:], scaled)) for row in rows]
    return found if len(found) == 3 else found * 3


def _as_curve(channel: str, relative: NDArray[np.float64], path: Path) -> ResponseCurve:
    known = np.flatnonzero(relative > 0.0)
    if known.size < 2 or known[0] > relative.size // 2:
        raise InputError(f"{path}: the response of {channel} is not above zero")
    middle = relative.size // 2
    with np.errstate(divide="ignore"):
        g = np.where(relative > 0.0, np.log(np.maximum(relative, 1e-300) / relative[middle]), -np.inf)
    u = np.where(np.isfinite(g), ASSUMED_U_LOG, np.inf)
    return ResponseCurve(
        g,
        u,
        valid_dn=(max(int(known[0]), 1), relative.size - 2),
        channel=channel,
        provenance=Provenance(
            FILE_METHOD, (path.name,), assumptions=(f"u(ln H) {100 * ASSUMED_U_LOG:g} %: {path.name} states none",)
        ),
    )


def polynomial(curve: ResponseCurve) -> NDArray[np.float64]:
    """Return the coefficients (highest power first) of relative exposure over M/M_max, 1 at M_max, never falling.

    The lowest order whose rms is under 0.05 % of full scale is taken, or the best of orders 1 to 12.

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


def draw_curves(axes: Axes, estimates: Sequence[ResponseEstimate]) -> list[tuple[Array, Array, Any]]:
    """Draw ln H over the digital number with its k = 2 band, where the data support it.

    Returns:
        Digital numbers drawn, the standard uncertainty at each, and the colour, of every curve.
    """
    by_channel, drawn = len({one.method for one in estimates}) == 1, list[tuple[Array, Array, Any]]()
    for estimate in estimates:
        curve = estimate.curve
        low, high = curve.valid_dn or (0, curve.log_exposure.size - 1)
        dn = np.arange(low, high + 1, dtype=np.float64)
        g, u = curve.log_exposure[low : high + 1], curve.u_log_exposure[low : high + 1]
        colour = _COLOURS.get(curve.channel) if by_channel else None
        (line,) = axes.plot(dn, g, label=f"{estimate.method}, {curve.channel}", color=colour, linewidth=1.2)
        axes.fill_between(dn, g - 2 * u, g + 2 * u, color=line.get_color(), alpha=0.2, linewidth=0)
        drawn.append((dn, u, line.get_color()))
    absolute = any(one.curve.absolute for one in estimates)
    axes.set_ylabel("ln H  (J·m⁻²)" if absolute else "ln H, relative to the middle value")
    axes.grid(visible=True, alpha=0.3)
    return drawn


def draw_responses(estimates: Sequence[ResponseEstimate], path: Path) -> None:
    """Draw ln H over the digital number with its k = 2 band, and below it the standard uncertainty.

    Raises:
        OutputError: If the file cannot be written.
        UsageError: If its ending is no picture form.
    """
    from matplotlib.figure import Figure  # half a second, and few responses are drawn

    check_plot_name(path)
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    drawn = draw_curves(upper, estimates)
    upper.legend(frameon=False)
    for dn, u, colour in drawn:
        lower.semilogy(dn[u > 0], u[u > 0], color=colour, linewidth=1.0)
    # Beyond a factor of e a curve says nothing; at the digital number that the curve is relative to, u is 0.
    least = min(0.1 * float(np.median(u)) for _, u, _ in drawn)
    lower.set_ylim(max(least, lower.get_ylim()[0]), min(1.0, lower.get_ylim()[1]))
    lower.set_ylabel("u(ln H), k = 1")
    lower.set_xlabel("digital number M (DN)")
    lower.grid(visible=True, alpha=0.3)
    write_figure(path, lower)
