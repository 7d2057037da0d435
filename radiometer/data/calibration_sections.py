"""The parts of a calibration file: scale, black level, flat field and the uncertainties that a user states."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from radiometer.data.validation import FileSection

ScaleMethod = Literal["known_radiance", "light_meter_k", "datasheet", "relative"]


class Scale(FileSection):
    """What turns the linear signal into exposure on the sensor: H = value · f(M).

    Attributes:
        value: J·m⁻² per unit of the linear signal: per exp(g) with a response curve, else per DN above black at 0 dB.
        u_rel: Relative standard uncertainty.
        method: How it was got.
        degrees_of_freedom: Of the uncertainty; None for infinitely many.
        f_number: f-number it was got at; None where unknown (the lens is then part of the value).
        reference: What it was compared with, in words.
        spectrum: Spectrum of what it was compared with; None where it is the calibration's.
        budget: Relative standard uncertainties that `u_rel` is made up from, by name.
        iso: ISO speed as really measured, or as stated where that is all, at which the gain of photographs is 0 dB.
        iso_stated: That speed as the camera states it; None where unknown.
        unit: Of the value, for people.
    """

    value: float = Field(gt=0)
    u_rel: float = Field(ge=0)
    method: ScaleMethod
    degrees_of_freedom: float | None = Field(None, gt=0)
    f_number: float | None = Field(None, gt=0)
    reference: str = ""
    spectrum: str | None = None
    budget: dict[str, float] = Field(default_factory=dict)
    iso: float | None = Field(None, gt=0)
    iso_stated: float | None = Field(None, gt=0)
    unit: str = "J m-2 per unit of signal"


class BlackLevel(FileSection):
    """Digital number without light, and its standard uncertainty in DN.

    Attributes:
        dn: Black level in DN.
        u_dn: Standard uncertainty in DN, of drift above all.
        dark_u_rel: Relative standard uncertainty of a dark signal that is modelled rather than measured.
    """

    dn: float = 0.0
    u_dn: float = Field(0.05, ge=0)
    dark_u_rel: float = Field(0.1, ge=0)


class SpectralResponse(FileSection):
    """The camera's spectral responsivity per watt, relative; 0 outside the wavelengths.

    Attributes:
        wavelength_nm: Ascending wavelengths in nm.
        relative: Responsivity at each, 0 or more, not all 0.
        u_rel: Relative standard uncertainty of a correction made with it.
    """

    wavelength_nm: tuple[float, ...] = Field(min_length=2)
    relative: tuple[Annotated[float, Field(ge=0)], ...] = Field(min_length=2)
    u_rel: float = Field(0.02, ge=0)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        rising = all(a < b for a, b in pairwise(self.wavelength_nm))
        if len(self.wavelength_nm) != len(self.relative) or not rising or not any(self.relative):
            raise ValueError("needs one value per wavelength, wavelengths rising, and values not all 0")
        return self


class FlatField(FileSection):
    """Relative sensitivity over the picture: cos⁴α · (1 + k₂ρ² + k₄ρ⁴ + k₆ρ⁶), 1 at the principal point.

    Attributes:
        principal_point_px: (x, y) of the optical axis in pixels of the frame.
        focal_length_px: Focal length in pixels; None leaves cos⁴α out.
        radius_px: Radius at which ρ is 1.
        coefficients: k₂, k₄, k₆.
        u_rel: Relative standard uncertainty of the correction at a pixel.
        shape: (height, width) of the frames it was made from; it fits no other size.
        f_number: f-number it was made at; vignetting changes with it.
    """

    principal_point_px: tuple[float, float]
    focal_length_px: float | None = Field(None, gt=0)
    radius_px: float = Field(gt=0)
    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)
    u_rel: float = Field(0.0, ge=0)
    shape: tuple[int, int]
    f_number: float | None = Field(None, gt=0)

    def at(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the relative sensitivity at pixel positions, same shape as the broadcast of x and y."""
        r2 = (x_px - self.principal_point_px[0]) ** 2 + (y_px - self.principal_point_px[1]) ** 2
        rho2 = r2 / self.radius_px**2
        k2, k4, k6 = self.coefficients
        falloff = 1.0 + rho2 * (k2 + rho2 * (k4 + rho2 * k6))
        if self.focal_length_px is not None:
            falloff = falloff / (1.0 + r2 / self.focal_length_px**2) ** 2
        return np.asarray(falloff, dtype=np.float64)


class StatedUncertainties(FileSection):
    """Standard uncertainties that the user states or the program assumes.

    Attributes:
        exposure_u_rel: Of exposure times.
        f_number_u_rel: Of the effective f-number, counted where it differs from the one of the scale.
        linearity_u_rel: Departure from a straight line where no response curve is given.
        spectral_u_rel: From the difference between the assumed spectrum and that of the source.
        magnification_u_rel: Of the change of magnification where the lens is focused otherwise than at calibration.
    """

    exposure_u_rel: float = Field(1e-4, ge=0)
    f_number_u_rel: float = Field(0.02, ge=0)
    linearity_u_rel: float = Field(1e-3, ge=0)
    spectral_u_rel: float = Field(0.0, ge=0)
    magnification_u_rel: float = Field(0.1, ge=0)
