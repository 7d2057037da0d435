"""Frames of sensors with a mosaic of colour filters: a plane per colour, of its first pixel in every 2 × 2."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radiometer.data.capture_header import CameraDescription, LensDescription, PatchDescription
from radiometer.data.reading import Patch

COLOURS: Final = ("red", "green", "blue")
LUMA: Final = (0.299, 0.587, 0.114)  # of them in the luminance of a photograph: ITU-R BT.601
_SIDE: Final = 2  # pixels of a cell in each direction


def plane_of(numbers: NDArray[np.uint8] | NDArray[np.uint16], mosaic: str, colour: str) -> NDArray[np.uint16]:
    """Return the plane of one of `COLOURS`, half as wide and high; the mosaic is a cell by rows, such as "RGGB"."""
    row, column = divmod(mosaic.index(colour[0].upper()), _SIDE)
    height, width = (size // _SIDE * _SIDE for size in numbers.shape)
    return np.ascontiguousarray(numbers[row:height:_SIDE, column:width:_SIDE])


def shifted(mosaic: str, x: int, y: int) -> str:
    """Return the mosaic of a picture whose first pixel is at (x, y) of one of this mosaic."""
    places = [((row + y) % _SIDE, (column + x) % _SIDE) for row in range(_SIDE) for column in range(_SIDE)]
    return "".join(mosaic[_SIDE * row + column] for row, column in places)


def in_cells(patch: Patch) -> Patch:
    """Return a patch of the sensor grown to whole cells of a mosaic."""
    x, y = (start // _SIDE * _SIDE for start in (patch.x, patch.y))
    right, bottom = (-(-end // _SIDE) * _SIDE for end in (patch.x + patch.width, patch.y + patch.height))
    return Patch(x, y, right - x, bottom - y)


def of_sensor(camera: CameraDescription) -> CameraDescription:
    """Return the camera of a plane in pixels of the sensor, as files state it; itself where it has no mosaic."""
    spacing_um = camera.pixel_spacing_um
    if camera.mosaic is None or spacing_um is None:
        return camera
    return camera.model_copy(update={"pixel_spacing_um": spacing_um / _SIDE})


def of_colour(camera: CameraDescription, colour: str) -> CameraDescription:
    """Return the camera of the pixels of a colour, without a quantum efficiency that is not stated for them."""
    known = {} if camera.channel == colour else {"quantum_efficiency": None}
    return camera.model_copy(update={"channel": colour, **known})


def in_planes(
    camera: CameraDescription, lens: LensDescription, patches: tuple[PatchDescription, ...]
) -> tuple[CameraDescription, LensDescription, tuple[PatchDescription, ...]]:
    """Return camera, lens and patches in pixels of a plane, where those of the file are pixels of the sensor."""
    spacing_um, axis = camera.pixel_spacing_um or camera.pixel_pitch_um, lens.principal_point_px
    return (
        camera.model_copy(update={"pixel_spacing_um": None if spacing_um is None else _SIDE * spacing_um}),
        lens.model_copy(update={"principal_point_px": axis and tuple((one - 0.5) / _SIDE for one in axis)}),
        tuple(
            one.model_copy(
                update={
                    **{name: -(-getattr(one, name) // _SIDE) for name in ("x", "y")},
                    **{name: max(1, getattr(one, name) // _SIDE) for name in ("width", "height")},
                }
            )
            for one in patches
        ),
    )
