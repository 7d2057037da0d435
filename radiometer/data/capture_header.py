"""Header of `capture.yaml` without the frames: camera, lens, source and patches, as their datasheets state them.

A USB3 camera of FLIR carries its number in its USB descriptor as eight hexadecimal digits (`0138C343`); its label, its
GigE twin and people write the same number in decimal (`20497219`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, ClassVar, Final, Literal

from pydantic import BeforeValidator, Field

from radiometer.data.reading import Patch
from radiometer.data.validation import FileSection, Side, within
from radiometer.data.white_level import WhiteLevel

_HEXADECIMAL: Final = re.compile(r"[0-9A-Fa-f]{8}")
_PLAINLY_HEXADECIMAL: Final = re.compile(r"(?=.*[A-Fa-f]|0)[0-9A-Fa-f]{8}")  # a letter, or filled up with zeros


def same_serial(one: str, other: str) -> bool:
    """Return whether two serial numbers are the same, whichever of them is written in hexadecimal."""
    if one.casefold() == other.casefold():
        return True
    return any(
        _HEXADECIMAL.fullmatch(first) is not None and second.isdecimal() and int(first, 16) == int(second)
        for first, second in ((one, other), (other, one))
    )


def other_notation(serial: str) -> str:
    """Return the decimal form of a serial number that is plainly hexadecimal; "" for any other."""
    return str(int(serial, 16)) if _PLAINLY_HEXADECIMAL.fullmatch(serial) else ""


def serial_shown(serial: str) -> str:
    """Return a serial number for people: as it stands, and in decimal where it is plainly hexadecimal."""
    other = other_notation(serial)
    return f"{serial} ({other})" if other else serial


LensHandling = Literal["reseated", "refocused", "iris_reset"]


class TapDescription(FileSection):
    """The pixels that one output amplifier reads, in pixels of the stored frame.

    `overscan` holds rectangles (x, y, width, height) that it reads without light. `first_pixel` is the corner of its
    rectangle that it reads first. Its conversion gain and the relative standard uncertainty of that are those of a
    characterisation.
    """

    name: str
    x: int = Field(ge=0)
    y: int = Field(ge=0)
    width: Side
    height: Side
    overscan: tuple[tuple[int, int, int, int], ...] = ()
    first_pixel: Literal["upper left", "upper right", "lower left", "lower right"] | None = None
    conversion_gain_e_per_dn: float | None = Field(None, gt=0)
    conversion_gain_u_rel: float | None = Field(None, ge=0)

    @property
    def patch(self) -> Patch:
        """Return the rectangle that light reaches."""
        return Patch(self.x, self.y, self.width, self.height)


def as_binning(written: object) -> object:
    """Return binning as one text, "2" or "2x1", for what programs write: 2, 2.0, "2x2", "2 2", "(2, 1)"."""
    factors = re.findall(r"(\d+)(?:\.\d*)?", str(written)) if isinstance(written, int | float | str) else []
    return "x".join(dict.fromkeys(factors)) or written


AUTOMATIC: Final = "automatic"  # white balance that the camera sets by what it sees


class CameraDescription(FileSection):
    """The camera as its datasheet or calibration believes it to be; all but the bit depth may be unknown."""

    # What decides which light is one digital number
    SETTINGS: ClassVar = ("mode", "filter", "band", "binning", "white_balance")

    bit_depth: int = Field(ge=1, le=16)
    code_step_dn: int | None = Field(None, ge=1)  # distance between codes where the low bits are padding; 1 if unknown
    vendor: str | None = None
    model: str | None = None
    serial: str | None = None
    pixel_pitch_um: float | None = Field(None, gt=0)
    pixel_spacing_um: float | None = Field(None, gt=0)
    conversion_gain_e_per_dn: Annotated[float | None, within("conversion_gain")] = None
    read_noise_e: Annotated[float | None, within("read_noise")] = None
    full_well_e: float | None = Field(None, gt=0)
    dark_current_e_per_s: float | None = Field(None, ge=0)
    dark_current_reference_C: Annotated[float | None, within("temperature")] = None  # noqa: N815 (the file's key)
    dark_current_doubling_K: Annotated[float | None, within("doubling")] = None  # noqa: N815
    black_level_dn: Annotated[float | None, within("black_level")] = None
    white_level_dn: float | None = Field(None, gt=0)  # from which pixels are saturated, where the camera states it
    quantum_efficiency: float | None = Field(None, gt=0, le=1)
    mode: str | None = None  # read-out mode, gain in the camera's own unit, where files state them
    filter: str | None = None  # name of the filter before it
    white_balance: str | None = None  # of developed photographs: `AUTOMATIC`, or as it was set
    band: str | int | None = None  # its place among the bands of a multispectral camera
    binning: Annotated[str | None, BeforeValidator(as_binning)] = None  # pixels that are one, along a row and a column
    mosaic: Literal["RGGB", "GRBG", "GBRG", "BGGR"] | None = None  # colour filters of 2 × 2 pixels, row by row
    channel: Literal["red", "green", "blue"] | None = None  # of a mosaic: whose quantum efficiency it is
    taps: tuple[TapDescription, ...] | None = None  # of cameras with several output amplifiers

    @property
    def name(self) -> str:
        """Return maker, model and serial number in one line; "" where none is stated."""
        return " ".join(word for word in (self.vendor, self.model, self.serial) if word)

    @property
    def tap_parts(self) -> tuple[Patch, ...]:
        """Return the rectangles that its taps read; none where they are not described."""
        return tuple(tap.patch for tap in self.taps or ())

    @property
    def full_scale_dn(self) -> int:
        """Return the highest digital number, 2**bit_depth − 1."""
        return (1 << self.bit_depth) - 1

    @property
    def white_level(self) -> WhiteLevel | None:
        """Return the stated white level, else the highest code where low bits are padding, else None."""
        highest_code_dn = self.full_scale_dn + 1 - (self.code_step_dn or 1)
        if self.white_level_dn is not None and self.white_level_dn <= self.full_scale_dn:
            return WhiteLevel.stated(min(self.white_level_dn, highest_code_dn))
        return WhiteLevel(highest_code_dn, "assumed", highest_code_dn) if (self.code_step_dn or 1) > 1 else None

    @property
    def saturated_dn(self) -> int:
        """Return the digital number from which pixels are saturated as far as this description knows."""
        return self.full_scale_dn if self.white_level is None else self.white_level.saturated_dn


class LensDescription(FileSection):
    """The lens: focal length in mm, f-number, transmittance with relative standard uncertainty, vignetting.

    `since_calibration` names what was done to it after the camera was calibrated: taken off and on again (reseated),
    focused anew (refocused), its iris turned and set again (iris_reset).
    """

    focal_length_mm: float | None = Field(None, gt=0, description="Focal length in mm.")
    f_number: Annotated[float | None, within("f_number")] = Field(None, description="f-number that it is set to.")
    transmittance: float | None = Field(None, gt=0, le=1, description="Transmittance.")
    transmittance_u_rel: float | None = Field(None, ge=0, description="Its relative standard uncertainty.")
    magnification: float = Field(0.0, ge=0, description="Image size over object size; 0 for a distant object.")
    pupil_magnification: float = Field(1.0, gt=0, description="Exit pupil over entrance pupil.")
    principal_point_px: tuple[float, float] | None = Field(
        None, description="Where the optical axis meets the frame: x and y in pixels; its middle by default."
    )
    vignetting: Literal["none", "cos4"] = Field("none", description="Natural fall-off to the corners: cos⁴, or none.")
    since_calibration: tuple[LensHandling, ...] = Field(
        (), description="What was done to it since the camera was calibrated; each adds to the uncertainty."
    )

    @property
    def extension(self) -> float:
        """Return the image distance, as rays of the pupil's middle see it, over the focal length: 1 + m/p."""
        return 1.0 + self.magnification / self.pupil_magnification

    def in_words(self, f_numbers: Iterable[float | None] = ()) -> str:
        """Return focal length and f-number in one line; "" where neither is stated.

        Args:
            f_numbers: Of the frames; the lens's own where they state none.
        """
        stops = sorted({one for one in f_numbers if one is not None})
        if not stops and self.f_number is not None:
            stops = [self.f_number]
        focal = "" if self.focal_length_mm is None else f"{self.focal_length_mm:g} mm"
        return ", ".join(filter(None, (focal, *(f"f/{one:.4g}" for one in stops))))


class SourceDescription(FileSection):
    """The light source: its kind, wavelength in nm, relative reproducibility, polarisation and flicker in Hz."""

    kind: Literal["screen", "led", "sphere", "scene"] = Field("scene", description="What gives the light.")
    wavelength_nm: float | None = Field(None, gt=0, description="Wavelength in nm; of a narrow line alone.")
    reproducibility_u_rel: float | None = Field(
        None, ge=0, description="Relative standard uncertainty of its light from one setting to the next."
    )
    polarised: bool | None = Field(None, description="Whether its light is polarised.")
    flicker_hz: float | None = Field(None, gt=0, description="Frequency of its flicker in Hz.")

    @property
    def spectrum(self) -> str | None:
        """Return the name of the spectrum that a stated wavelength means; None where none is stated."""
        return None if self.wavelength_nm is None else f"line:{self.wavelength_nm:g}"


class PatchDescription(FileSection):
    """A region of the scene and what is known of its radiance at source level 1 (None: unknown but constant)."""

    name: str = Field(description="Its name.")
    x: int = Field(ge=0, description="Left edge in pixels.")
    y: int = Field(ge=0, description="Upper edge in pixels.")
    width: Side = Field(description="Width in pixels.")
    height: Side = Field(description="Height in pixels.")
    radiance_W_per_sr_m2: float | dict[str, float] | None = Field(  # noqa: N815 (the file's key)
        None, description="Radiance in W·sr⁻¹·m⁻² at source level 1, or one for each pattern; unknown by default."
    )
    u_rel: float | None = Field(None, ge=0, description="Relative standard uncertainty of the radiance.")

    @property
    def patch(self) -> Patch:
        """Return the region as a Patch."""
        return Patch(self.x, self.y, self.width, self.height)

    def radiance(self, pattern: str = "default") -> float | None:
        """Return the known radiance in W·sr⁻¹·m⁻² under a pattern; None where unknown."""
        known = self.radiance_W_per_sr_m2
        return known.get(pattern) if isinstance(known, dict) else known
