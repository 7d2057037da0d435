"""A false-colour picture with a scale bar in the unit of the map."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import radiometer
from radiometer.analysis.exports.maps import MapPicture
from radiometer.data import PixelMask
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT
from radiometer.data.storage import write_bytes_atomic
from radiometer.errors import MeasurementError, UsageError

_LABELS: Final = {RADIANCE_UNIT: "radiance / W·sr⁻¹·m⁻²", LUMINANCE_UNIT: "luminance / cd·m⁻²"}
_CLIPPED_COLOUR: Final = "#ff40ff"
_MOST_DECADES: Final = 6.0


def write_false_colour(path: Path, picture: MapPicture) -> None:
    """Write a map as PNG in false colours on a logarithmic scale, with a scale bar.

    What clips everywhere is magenta, what never rises above the noise is black. Of a colour picture the green
    channel is shown.

    Args:
        path: File to write.
        picture: The map, with the bounds of the scale where they are requested.

    Raises:
        UsageError: If the bounds are not 0 < low < high.
        MeasurementError: If no pixel has a value above 0.
        OutputError: If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch as Swatch

    found = picture.first
    low, high = _bounds(picture)
    height, width = found.shape
    inches = 6.4 * min(2.0, max(0.4, height / width))
    figure = Figure(figsize=(8.6, inches + 0.6), dpi=max(100.0, min(300.0, width / 6.4)), layout="constrained")
    axes = figure.add_subplot()
    shown = np.ma.masked_less_equal(found.radiance, 0.0)
    image = axes.imshow(shown, norm=LogNorm(low, high), cmap="inferno", interpolation="nearest")
    axes.set_facecolor("black")
    axes.set_xticks([])
    axes.set_yticks([])
    figure.colorbar(image, ax=axes, label=_LABELS.get(found.unit, "relative radiance"), extend="both", fraction=0.05)
    clipped = found.mask & PixelMask.SATURATED > 0
    if clipped.any():
        axes.imshow(_overlay(clipped), interpolation="nearest")
        axes.legend(handles=[Swatch(color=_CLIPPED_COLOUR, label="clipped in every frame")], loc="lower right")
    stream = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(stream, format="png", metadata={"Software": f"radiometer {radiometer.__version__}"})
    write_bytes_atomic(path, stream.getvalue())


def _bounds(picture: MapPicture) -> tuple[float, float]:
    if picture.bounds is not None:
        low, high = picture.bounds
        if not 0.0 < low < high:
            raise UsageError(f"the scale runs from {low:g} to {high:g}; it needs 0 < low < high")
        return low, high
    found = picture.first
    sound = found.radiance[(found.radiance > 0) & (found.mask & (PixelMask.BELOW_NOISE | PixelMask.SATURATED) == 0)]
    values = sound if sound.size else found.radiance[found.radiance > 0]
    if not values.size:
        raise MeasurementError("no pixel shows light, so there is nothing to colour")
    low, high = (float(v) for v in np.percentile(values, (0.1, 99.9)))
    low = max(low, high * 10.0**-_MOST_DECADES)
    return (low, high) if low < high else (low / 2.0, high * 2.0)


def _overlay(clipped: NDArray[np.bool_]) -> NDArray[np.uint8]:
    colour = tuple(int(_CLIPPED_COLOUR[i : i + 2], 16) for i in (1, 3, 5))
    overlay = np.zeros((*clipped.shape, 4), np.uint8)
    overlay[clipped] = (*colour, 255)
    return overlay
