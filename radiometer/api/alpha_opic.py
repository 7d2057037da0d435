"""α-opic quantities (CIE S 026) of a value, a reading or a level of a screen whose spectrum is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radiometer.analysis.photometry.alpha_opic import UNITS, AlphaOpic, alpha_opic_quantities
from radiometer.analysis.photometry.facing import facing_irradiance
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.api.files import PathLike
from radiometer.api.result import Drawn, require_other
from radiometer.data import Flag, Quantity, Reading
from radiometer.data.drawing import new_axes
from radiometer.data.reading import of_reading
from radiometer.errors import UsageError
from radiometer.plausible import Length, NotNegative, RelativeUncertainty, Uncertainty, WavelengthUncertainty
from radiometer.screen.calibration import LUMINANCE, ScreenCalibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SPELT: Final = {
    "cd": "cd m-2", "cd/m2": "cd m-2", "cd·m⁻²": "cd m-2", "lux": "lx",
    "W": "W sr-1 m-2", "W/sr/m2": "W sr-1 m-2", "W·sr⁻¹·m⁻²": "W sr-1 m-2", "W/m2": "W m-2", "W·m⁻²": "W m-2",
}  # fmt: skip
_IN_JSON: Final = {
    "quantity": "quantity", "equivalent_daylight": "equivalent_daylight", "efficacy": "efficacy_mw_lm",
    "daylight_efficacy_ratio": "daylight_ratio",
}  # fmt: skip
_FOR_SPECTRUM: Final = "spectrum "  # an assumption of a reading: which light its luminance is of


@dataclass(frozen=True, repr=False)
class AlphaOpicQuantities(Drawn):
    """The five α-opic quantities of one light.

    Attributes:
        source: The value that they were made of, with its standard uncertainty.
        spectrum: Name of its spectrum.
        quantities: One per receptor.
        assumptions: What was assumed, a sentence each.
    """

    source: Quantity
    spectrum: str
    quantities: tuple[AlphaOpic, ...]
    assumptions: tuple[str, ...] = ()

    def __getitem__(self, receptor: str) -> AlphaOpic:
        """Return the quantities of a receptor, such as "melanopic". Raises KeyError."""
        return {one.receptor: one for one in self.quantities}[receptor]

    def to_mapping(self) -> dict[str, Any]:
        found = {
            one.receptor: {name: getattr(one, field) for name, field in _IN_JSON.items()} for one in self.quantities
        }
        return self.plain("source", "spectrum", "assumptions", quantities=found)

    def plot(self, axes: Axes | None = None) -> Axes:
        where = axes if axes is not None else new_axes()
        names = [one.receptor.replace("_", "-") for one in self.quantities]
        ratios = [one.daylight_ratio for one in self.quantities]
        where.barh(names, [one.value for one in ratios], xerr=[2 * one.u for one in ratios], color="tab:blue")
        where.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
        where.invert_yaxis()
        where.set_xlabel(f"efficacy over that of daylight D65, of {self.spectrum} (k = 2)")
        return where

    def __str__(self) -> str:
        return f"melanopic equivalent daylight {self['melanopic'].equivalent_daylight.text(with_k=True)}"


def alpha_opic(
    value: NotNegative | Reading | None = None,
    unit: str = "cd m-2",
    *,
    u: Uncertainty = 0.0,
    reading: PathLike | None = None,
    screen: ScreenCalibration | PathLike | None = None,
    level: NotNegative | None = None,
    channel: str = "grey",
    spectrum: str | None = None,
    spectrum_u_rel: RelativeUncertainty = 0.0,
    wavelength_u_nm: WavelengthUncertainty = 0.0,
    size_m: Sequence[Length] | None = None,
    distance_m: Length | None = None,
    u_distance_m: Uncertainty = 0.0,
) -> AlphaOpicQuantities:
    """Convert a radiance, luminance, irradiance or illuminance into the five α-opic quantities of CIE S 026.

    They are S-, M-, L-cone-opic, rhodopic and melanopic, each with the daylight (D65) that has the same.

    Examples:
        >>> import radiometer as rm
        >>> round(rm.alpha_opic(100.0, "lx", spectrum="cie_d65")["melanopic"].equivalent_daylight.value, 6)
        100.0
        >>> rm.alpha_opic(100.0, "cd m-2", u=1.0, spectrum="white_led")
        <AlphaOpicQuantities melanopic equivalent daylight 63... ± 1... cd·m⁻² (k = 2)>

    Args:
        value: Value to convert, or a reading; one of value, reading file and screen is given.
        unit: Unit of a value: "cd m-2", "lx", "W sr-1 m-2" or "W m-2".
        u: Its standard uncertainty in the same unit.
        reading: File that holds the JSON of a reading; its luminance counts, else its radiance.
        screen: Screen calibration, or its file.
        level: Level of the screen.
        channel: Channel of the screen.
        spectrum: Spectrum of the light by name, or a CSV of wavelength and relative power; a screen's own by default.
        spectrum_u_rel: Relative standard uncertainty of each entry of the spectrum, independent of the others.
        wavelength_u_nm: Standard uncertainty of the spectrum's wavelength scale in nm.
        size_m: Width and height, or diameter, of the source in m: of a radiance or luminance this gives the
            irradiance or illuminance on a parallel plane before its middle.
        distance_m: Distance of that plane in m.
        u_distance_m: Its standard uncertainty in m.

    Raises:
        UsageError: If not exactly one source is given, no spectrum is known, or options contradict each other.
        InputError: If spectrum, unit or file cannot be used.
        CalibrationError: If the screen has no such channel.
    """
    if sum(one is not None for one in (value, reading, screen)) != 1:
        raise UsageError("give one of a value, --reading FILE and --screen FILE")
    if (level is None) != (screen is None):
        raise UsageError("--screen and --level need each other")
    require_other("--spectrum", spectrum, spectrum_u_rel=spectrum_u_rel, wavelength_u=wavelength_u_nm)
    named, assumptions = spectrum, list[str]()
    if screen is not None and level is not None:
        known = screen if isinstance(screen, ScreenCalibration) else ScreenCalibration.read(Path(screen))
        curve = known.channel(channel)
        source = curve.at(level, LUMINANCE)
        if named is None:
            named = curve.spectrum
            assumptions.append(f"the spectrum of {channel} is that of the screen's calibration: {named}")
    elif isinstance(value, Reading) or reading is not None:
        stated = value if isinstance(value, Reading) else Path(str(reading))
        source = of_reading(stated, lambda content: _quantity_of(content, named, assumptions))
    else:
        source = Quantity(float(value or 0.0), u, _SPELT.get(unit, unit))
    if source.unit not in UNITS:
        raise UsageError(f"unit {source.unit!r}: choose {', '.join(UNITS)}")
    if named is None:
        raise UsageError("α-opic quantities depend on the spectrum: state --spectrum NAME or FILE.csv")
    if not spectrum_u_rel and not wavelength_u_nm:
        assumptions.append(f"the spectrum {named} is exact; --spectrum-u-rel states how well it is known")
    if (size_m is None) != (distance_m is None) or (u_distance_m and distance_m is None):
        raise UsageError("--size and --distance need each other, and --distance-u both")
    if size_m is not None and distance_m is not None:
        source = facing_irradiance(source, size_m, distance_m, u_distance_m)
        assumptions.append("the source is evenly bright, alike in all directions, and straight before the plane")
    light = spectrum_of(named)
    found = alpha_opic_quantities(source, light, spectrum_u_rel, wavelength_u_nm)
    return AlphaOpicQuantities(source, light.name, found, tuple(assumptions))


def _quantity_of(content: Mapping[str, Any], spectrum: str | None, assumptions: list[str]) -> Quantity:
    """Return the luminance of a reading, or its radiance where it has none; its flags join the assumptions.

    Raises UsageError if the reading is a relative one, or was made for another spectrum.
    """
    flags = [str(flag) for flag in content.get("flags", [])]
    if Flag.UNCALIBRATED.value in flags or (content["radiance"] or {}).get("unit") == "relative":
        raise UsageError("the reading is relative: it has no α-opic quantities; calibrate the camera first")
    made_for = [one for one in content.get("assumptions", []) if str(one).startswith(_FOR_SPECTRUM)]
    own = {str(one).removeprefix(_FOR_SPECTRUM) for one in made_for}
    if spectrum is not None and own and not own & {spectrum, spectrum_of(spectrum).name}:
        raise UsageError(
            f"the reading was made for the spectrum {', '.join(sorted(own))}, not {spectrum}: its luminance is that of "
            f"such light; measure again with --spectrum {spectrum}"
        )
    assumptions += [f"the reading is flagged {flag}" for flag in flags]
    stated = content["luminance"] or content["radiance"]
    return Quantity(float(stated["value"]), float(stated["u"]), str(stated["unit"]))
