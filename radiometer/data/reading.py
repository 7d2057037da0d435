"""A reading: the radiance of one patch with its uncertainty, and the budget behind it."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from radiometer.argument_types import with_checked_methods
from radiometer.data.json_text import finite_or_null, json_text, parsed_json
from radiometer.data.provenance import Provenance, utc_now
from radiometer.data.storage import read_text
from radiometer.errors import InputError, UsageError
from radiometer.numbers import below, lower_limit, upper_limit, with_u

if TYPE_CHECKING:
    from matplotlib.axes import Axes

T = TypeVar("T")
CLIPPING: Final = "clipping"  # name of the contribution that says that a value is a lower bound
_BARS: Final = 8  # contributions that a plot shows
RADIANCE_UNIT = "W sr-1 m-2"
LUMINANCE_UNIT = "cd m-2"
RELATIVE_UNIT = "relative"


class Flag(StrEnum):
    """What a user must know about a reading."""

    SATURATED = "saturated"
    BELOW_NOISE = "below_noise"
    EXTRAPOLATED = "extrapolated"
    FLICKER = "flicker"
    STALE_CALIBRATION = "stale_calibration"
    UNCALIBRATED = "uncalibrated"
    NONUNIFORM = "nonuniform"
    FEW_FRAMES = "few_frames"
    STRAY_LIGHT = "stray_light"
    SHORT_EXPOSURE = "short_exposure"
    DARK_ASSUMED = "dark_assumed"
    FALLOFF_ASSUMED = "falloff_assumed"
    SPECTRUM_ASSUMED = "spectrum_assumed"
    SMALL_PATCH = "small_patch"
    TEMPERATURE = "temperature"
    GAIN = "gain"
    DRIFT = "drift"
    LENS_CHANGED = "lens_changed"
    POLARISATION = "polarisation"
    LINEARITY = "linearity"
    EXPOSURE_UNCONFIRMED = "exposure_unconfirmed"
    REPEATED_FRAME = "repeated_frame"
    OTHER_TAP = "other_tap"


@dataclass(frozen=True, slots=True, order=True)
class Patch:
    """A rectangle of pixels: left, top, width and height in pixels of the frame.

    Examples:
        >>> import radiometer as rm
        >>> patch = rm.Patch(840, 240, 120, 100)
        >>> patch.slices
        (slice(240, 340, None), slice(840, 960, None))
        >>> patch.fits((1240, 1616)), patch.fits((480, 640))
        (True, False)
    """

    x: int
    y: int
    width: int
    height: int

    def __post_init__(self) -> None:
        for number in (self.x, self.y, self.width, self.height):
            if not isinstance(number, numbers.Integral):
                raise UsageError(f"a patch is of whole pixels; {number!r} is no whole number")

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"

    @property
    def slices(self) -> tuple[slice, slice]:
        """Return the (row, column) slices of the patch."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    def fits(self, shape: tuple[int, int]) -> bool:
        """Return whether the patch is wholly inside a frame of (height, width)."""
        return (
            self.x >= 0
            and self.y >= 0
            and self.width > 0
            and self.height > 0
            and self.y + self.height <= shape[0]
            and self.x + self.width <= shape[1]
        )


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value with its standard uncertainty (k = 1) and unit."""

    value: float
    u: float
    unit: str

    @property
    def u_rel(self) -> float:
        """Return the relative standard uncertainty; infinite at value 0."""
        return abs(self.u / self.value) if self.value else float("inf")

    def scaled(self, factor: float, unit: str) -> Quantity:
        """Return it times a factor that is exact, in another unit."""
        return Quantity(self.value * factor, self.u * abs(factor), unit)

    def text(self, k: float = 2.0, *, bare: bool = False, with_k: bool = False, apart: float = math.inf) -> str:
        """Return "value ± U unit" with U = k·u; bare without the unit, for where that is stated once for all.

        Values that share most of their u get the digits of their difference, `apart`.
        """
        return with_u(self.value, k * self.u, "" if bare else self.unit, k if with_k else None, apart)

    def to_mapping(self) -> dict[str, Any]:
        """Return {value, u, unit}."""
        return {"value": self.value, "u": self.u, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a GUM uncertainty budget.

    Attributes:
        name: What the uncertainty comes from.
        u_rel: Relative standard uncertainty of the reading due to it.
        kind: "A" (from repeated observation) or "B" (from anything else).
        degrees_of_freedom: Degrees of freedom of the estimate; infinite where taken as exactly known.
        correlated: True where two readings made with one calibration share it.
        note: Where the figure comes from.
    """

    name: str
    u_rel: float
    kind: str = "B"
    degrees_of_freedom: float = float("inf")
    correlated: bool = False
    note: str = ""


@with_checked_methods
@dataclass(frozen=True, slots=True, repr=False)
class Reading:
    """The radiance of one patch at one moment.

    Examples:
        >>> import radiometer as rm
        >>> with rm.open("bench.yaml") as meter:
        ...     reading = meter.measure()
        >>> print(reading)
        0.30... ± 0.00... W·sr⁻¹·m⁻² (k = 2)
        >>> reading.radiance.unit, [str(flag) for flag in reading.flags]
        ('W sr-1 m-2', [])
        >>> max(reading.budget, key=lambda line: line.u_rel).name
        'scale'
        >>> reading.plot().get_xlabel()
        'relative standard uncertainty in %'

    Attributes:
        radiance: Radiance in W·sr⁻¹·m⁻² (unit "relative" where uncalibrated).
        patch: Where it was read.
        instrument: Serial number of the camera.
        luminance: Luminance in cd·m⁻²; None where no spectrum is known or assumed.
        flags: What the user must know, sorted.
        exposures_s: Exposure times that took part, in s.
        budget: Contributions to the uncertainty; empty where none was made up.
        sequence: Running number within the instrument's journal.
        name: Name of the patch where it has one; "" for the patch that is measured by default.
        session: Whose measurement it was, where it was a client's own; "" where it belongs to all.
        coverage_factor: k of the expanded uncertainty: Student's t at 95.45 % for the degrees of freedom.
        degrees_of_freedom: Effective ones of the uncertainty (Welch–Satterthwaite); infinite where all are.
        time: ISO 8601 in UTC.
        band_nm: Shortest and longest wavelength that the radiance counts light of, in nm; None where it is relative.
        more: Further entries of the JSON form by name, such as "monte_carlo".
    """

    radiance: Quantity
    patch: Patch
    instrument: str
    luminance: Quantity | None = None
    flags: tuple[Flag, ...] = ()
    exposures_s: tuple[float, ...] = ()
    budget: tuple[Contribution, ...] = ()
    sequence: int = 0
    coverage_factor: float = 2.0
    degrees_of_freedom: float = math.inf
    time: str = field(default_factory=utc_now)
    provenance: Provenance | None = None
    name: str = ""
    session: str = ""
    band_nm: tuple[float, float] | None = None
    more: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def upper_limit(self) -> Quantity | None:
        """Return what the radiance is below with 95 % probability; None where it rises above the noise."""
        if Flag.BELOW_NOISE not in self.flags:
            return None
        return Quantity(upper_limit(self.radiance.value, self.radiance.u), self.radiance.u, self.radiance.unit)

    @property
    def lower_limit(self) -> Quantity | None:
        """Return what the radiance is above with 95 % probability where every frame clips; None where none does."""
        if Flag.SATURATED not in self.flags:
            return None
        value = self.radiance.value
        known = [line.u_rel for line in self.budget if line.name != CLIPPING]
        u = abs(value) * math.hypot(*known) if self.budget else self.radiance.u
        return Quantity(lower_limit(value, u), u, self.radiance.unit)

    @property
    def expanded_u_rel(self) -> float:
        """Return the expanded relative uncertainty U_rel = k·u/|value|."""
        return self.coverage_factor * self.radiance.u_rel

    @property
    def budget_lines(self) -> list[dict[str, Any]]:
        """Return the budget in plain values, the largest contribution first."""
        ordered = sorted(self.budget, key=lambda line: -line.u_rel)
        return [{"name": line.name, "kind": line.kind, "u_rel": line.u_rel} for line in ordered]

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping of the documented JSON form; what is not finite becomes null."""
        mapping: dict[str, Any] = {
            "time": self.time,
            "instrument": self.instrument,
            "patch": asdict(self.patch),
            "radiance": self.radiance.to_mapping(),
            "luminance": self.luminance.to_mapping() if self.luminance else None,
            "coverage_factor": self.coverage_factor,
            "degrees_of_freedom": self.degrees_of_freedom,
            "U_rel": self.expanded_u_rel,
            "flags": [str(flag) for flag in self.flags],
            "exposures_s": list(self.exposures_s),
            "sequence": self.sequence,
        }
        mapping |= {"band_nm": list(self.band_nm)} if self.band_nm else {}
        limits = {"upper_limit": self.upper_limit, "lower_limit": self.lower_limit}
        for name, limit in limits.items():
            mapping |= {name: {"value": limit.value, "unit": limit.unit, "probability": 0.95}} if limit else {}
        mapping |= {"name": self.name} if self.name else {}
        mapping |= {"session": self.session} if self.session else {}
        mapping |= self.more
        return {key: finite_or_null(value) for key, value in mapping.items()}

    @property
    def notes(self) -> Sequence[str]:
        """Return what a user should know of it, a sentence each."""
        return tuple(self.more.get("notes", ()))

    def to_json(self) -> str:
        """Return the reading as one line of JSON."""
        return json_text(self.to_mapping())

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the largest contributions to the uncertainty as bars.

        Args:
            axes: Where to draw; a new figure by default.
        """
        from radiometer.data.drawing import new_axes

        where = axes if axes is not None else new_axes()
        largest = sorted(self.budget, key=lambda line: line.u_rel)[-_BARS:]
        where.barh([line.name for line in largest], [100 * line.u_rel for line in largest], color="tab:blue")
        where.set_xlabel("relative standard uncertainty in %")
        return where

    def __str__(self) -> str:
        """Return value, expanded uncertainty, unit and flags in one line; below the noise the limit in its place."""
        expanded = self.coverage_factor * self.radiance.u
        flags = f" [{', '.join(self.flags)}]" if self.flags else ""
        limit = self.upper_limit
        if limit is not None:
            return f"{below(limit.value, limit.unit)}{flags}"
        return f"{with_u(self.radiance.value, expanded, self.radiance.unit, k=self.coverage_factor)}{flags}"

    def __repr__(self) -> str:
        """Return value, patch and instrument in one line; `to_mapping()` holds every field."""
        where = f"{self.patch.x},{self.patch.y} {self.patch.width} × {self.patch.height}"
        return f"<Reading {self}, patch {where} of {self.instrument}>"

    def _repr_html_(self) -> str:
        from radiometer.data.drawing import picture

        return picture(self.plot, str(self))


def of_reading(source: Reading | str | PathLike[str], use: Callable[[dict[str, Any]], T]) -> T:
    """Return what a function makes of the JSON form of a reading, with its budget.

    Args:
        source: The reading, or the file that holds its JSON.
        use: The function.

    Raises:
        InputError: If the file cannot be read, or lacks what the function takes.
    """
    if isinstance(source, Reading):
        return use({**source.to_mapping(), "budget": source.budget_lines})
    try:
        return use(parsed_json(read_text(Path(source))))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        form = "the JSON of a reading, as `radiometer measure --json` prints it"
        raise InputError(f"{source}: is not {form} ({error})") from error
