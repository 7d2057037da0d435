"""A merged bracket as arrays: radiance, its standard uncertainty and a mask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.exports.maps import MapPicture, writer_for
from radiometer.analysis.merge.bracket import merge as merge_bracket
from radiometer.analysis.response.curves import black_of_curve
from radiometer.api.files import PathLike, Stack
from radiometer.api.response import Response
from radiometer.data import BlackLevel, Bracket, Calibration, PixelMask, RadianceMap, Scale, SensorNoise
from radiometer.data.drawing import new_axes, picture
from radiometer.errors import MissingLibrary, UsageError

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Radiance:
    """Radiance per pixel.

    Examples:
        >>> import radiometer as rm
        >>> radiance = rm.merge(rm.read("out/chart"), calibration="calibration.yaml")
        >>> radiance.value.shape, radiance.u.shape, radiance.unit
        ((64, 96), (64, 96), 'W sr-1 m-2')
        >>> radiance.mask.dtype, bool((radiance.u[radiance.mask == 0] > 0).all())
        (dtype('uint8'), True)
        >>> radiance.to_xarray().radiance.attrs["units"]
        'W sr-1 m-2'
        >>> radiance.write("map.exr")

    Attributes:
        map: Values, uncertainties, mask and provenance as the merge gave them.
    """

    map: RadianceMap

    @property
    def value(self) -> NDArray[np.float32]:
        """Return radiance per pixel in `unit`, shape (height, width)."""
        return self.map.radiance

    @property
    def u(self) -> NDArray[np.float32]:
        """Return the standard uncertainty of each pixel's own, in `unit`; `u_rel_common` is beside it."""
        return self.map.u_radiance

    @property
    def mask(self) -> NDArray[np.uint8]:
        """Return PixelMask bits per pixel; 0 is good."""
        return self.map.mask

    @property
    def unit(self) -> str:
        """Return "W sr-1 m-2", or "relative"."""
        return self.map.unit

    @property
    def u_rel_common(self) -> float:
        """Return the relative standard uncertainty that all pixels share."""
        return self.map.u_rel_common

    def write(self, path: PathLike) -> None:
        """Write .exr, .hdr, .tiff or .png by the ending. Raises UsageError for another, OutputError if it fails."""
        target = Path(path)
        writer_for(target)(target, MapPicture({"mono": self.map}))

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray.Dataset with `radiance`, its two uncertainties and `mask`: units and flags as in CF.

        `u_radiance` is each pixel's own, `u_common` what all share; how they hang together stands in their attributes
        as obsarray reads it (`unc_comps`, `err_corr_…`). `to_netcdf(…, engine="h5netcdf")` keeps all of it.

        Raises:
            MissingLibrary: If xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise MissingLibrary("xarray is not installed: pip install 'radiometer[xarray]'") from error
        return xarray.Dataset(
            _variables(self),
            coords={
                name: (name, np.arange(size), _axis(name)) for name, size in zip("yx", self.map.shape, strict=True)
            },
            attrs={
                "Conventions": "CF-1.11",
                "title": "radiance per pixel",
                "u_rel_common": self.u_rel_common,
                "exposures_s": list(self.map.exposures_s),
                "assumptions": "; ".join(self.map.provenance.assumptions),
            },
        )

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the map in logarithmic false colours; what is not good is left white.

        Args:
            axes: Where to draw; a new figure by default.
        """
        from matplotlib.colors import LogNorm

        where = axes if axes is not None else new_axes()
        lost = (self.mask & (PixelMask.SATURATED | PixelMask.BELOW_NOISE)) != 0
        shown = np.ma.masked_where(lost | (self.value <= 0), self.value)
        low, high = (float(shown.min()), float(shown.max())) if shown.count() else (None, None)
        drawn = where.imshow(shown, norm=LogNorm(low, high), cmap="viridis")
        figure: Any = where.figure
        figure.colorbar(drawn, ax=where, label=f"radiance in {self.unit}")
        return where

    def __repr__(self) -> str:
        """Return size, range and share of good pixels in one line."""
        height, width = self.map.shape
        good = self.mask == 0
        if not good.any():
            return f"<Radiance {width} × {height} pixels in {self.unit}: no good pixel>"
        low, high = float(self.value[good].min()), float(self.value[good].max())
        return (
            f"<Radiance {width} × {height} pixels in {self.unit}: {low:.4g} to {high:.4g}, "
            f"{100 * good.mean():.3g} % good, {100 * self.u_rel_common:.2g} % common>"
        )

    def _repr_html_(self) -> str:
        return picture(self.plot, repr(self))


def _variables(radiance: Radiance) -> dict[str, Any]:
    """Return the variables of a Dataset: dimensions, values, attributes."""
    dims, unit = ("y", "x"), radiance.unit.replace("relative", "1")
    bits = [flag for flag in PixelMask if flag]
    common = np.abs(radiance.value) * np.float32(radiance.u_rel_common)
    named = {
        "long_name": "what must be known of a pixel",
        "flag_masks": np.array([int(bit) for bit in bits], dtype=np.uint8),
        "flag_meanings": " ".join(map(_meaning, bits)),
    }
    own = {"units": unit, "long_name": "standard uncertainty of each pixel's own (k = 1)"} | _correlation("random")
    shared = {"units": unit, "long_name": "standard uncertainty shared by all pixels (k = 1)"} | _correlation(
        "systematic"
    )
    held = {
        "units": unit,
        "long_name": "radiance",
        "ancillary_variables": "u_radiance u_common mask",
        "unc_comps": ["u_radiance", "u_common"],
    }
    return {
        "radiance": (dims, radiance.value, held),
        "u_radiance": (dims, radiance.u, own),
        "u_common": (dims, common, shared),
        "mask": (dims, radiance.mask, named),
    }


def _correlation(form: str) -> dict[str, Any]:
    """Return how errors of pixels hang together along both axes, by obsarray's names."""
    found: dict[str, Any] = {"pdf_shape": "gaussian"}
    for number, dimension in ((1, "y"), (2, "x")):
        key = f"err_corr_{number}"
        found |= {f"{key}_dim": dimension, f"{key}_form": form, f"{key}_params": [], f"{key}_units": []}
    return found


def _axis(name: str) -> dict[str, str]:
    return {
        "units": "1",
        "long_name": {"y": "row of pixels, from the top", "x": "column of pixels, from the left"}[name],
    }


def merge(
    stack: Stack,
    response: Response | None = None,
    *,
    calibration: Calibration | PathLike | None = None,
) -> Radiance:
    """Merge a bracket into radiance per pixel, by maximum likelihood over the frames that do not clip there.

    Examples:
        >>> import radiometer as rm
        >>> stack = rm.read("out/chart")
        >>> rm.merge(stack)
        <Radiance 96 × 64 pixels in relative: ...>
        >>> rm.merge(stack, calibration="calibration.yaml").unit
        'W sr-1 m-2'

    Args:
        stack: Frames of one unmoving scene.
        response: The camera's response: relative values. Without it, and without a calibration, the camera counts as
            linear above its black level.
        calibration: Calibration, or its file: values in W·sr⁻¹·m⁻².

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        UsageError: If both response and calibration are given, or the stack holds several brackets.
    """
    if response is not None and calibration is not None:
        raise UsageError("a calibration holds a response of its own; give one of both")
    known = calibration if isinstance(calibration, Calibration | None) else Calibration.read(Path(calibration))
    bracket = stack.bracket
    if response is not None:
        known = _without_scale(response, stack, bracket)
    return Radiance(merge_bracket(bracket, stack.camera, stack.lens, known))


def _without_scale(response: Response, stack: Stack, bracket: Bracket) -> Calibration:
    stated = (bracket.light[0].settings.black_level_dn, stack.camera.black_level_dn, black_of_curve(response.curve))
    return Calibration(
        camera=stack.camera,
        lens=stack.lens,
        scale=Scale(value=1.0, u_rel=0.0, method="relative"),
        response=response.curve,
        noise=SensorNoise.of(stack.camera),
        black_level=BlackLevel(dn=next(black for black in stated if black is not None)),
    )


def _meaning(flag: PixelMask) -> str:
    return str(flag.name).lower()
