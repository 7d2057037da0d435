"""Ranges that no camera, lens, light or eye leaves: one table for files of every kind, their headers and arguments.

A number outside its range is a mistake of unit or of power of ten. Data classes and arguments refuse it. In the headers
of other people's files it means "unknown", and a doubt is reported.

The types at the end state the ranges of arguments: public functions have them in their signatures, where
`argument_types.checked` compares, and commands give them to their options.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Final

from radiometer.errors import InputError, RadiometerError
from radiometer.numbers import unit_text
from radiometer.units import ZERO_CELSIUS_K

# No quantity in the units of files and arguments is so large: products and powers of some stay finite.
LARGEST: Final = 1e30


@dataclass(frozen=True, slots=True)
class Range:
    """What a quantity can be; always finite."""

    low: float = -LARGEST  # least value in the unit
    high: float = LARGEST  # greatest value in the unit
    unit: str = "1"  # unit in the form of the files
    above: bool = False  # True where a value must be above the least one

    def holds(self, value: float) -> bool:
        """Return whether a value is in the range; what is no number is not."""
        return (self.low < value if self.above else self.low <= value) and value <= self.high

    def words(self, noun: str) -> str:
        """Return what it allows, such as "number from 1 to 9 mm"; `noun` alone where it is open."""
        unit = f" {unit_text(self.unit)}".rstrip()
        above, below = f"above {self.low:g}{unit}", f"up to {self.high:g}{unit}"
        if self.high >= LARGEST:
            least = above if self.above else f"of {self.low:g}{unit} or more"
            return noun if self.low <= -LARGEST else f"{noun} {least}"
        return f"{noun} {above}, {below}" if self.above else f"{noun} from {self.low:g} to {self.high:g}{unit}"

    def refusal(self, value: float) -> str:
        """Return in words why a value is refused, and the way out."""
        unit = f" {unit_text(self.unit)}".rstrip()
        return f"{value:g}{unit} is outside {self.low:g} to {self.high:g}{unit}; correct the number or its unit"

    def check(self, name: str, value: float, error: type[RadiometerError] = InputError) -> float:
        """Return a value that is in the range.

        Raises:
            RadiometerError: Of the class `error`, with name, value and range, if it is not.
        """
        if not self.holds(value):
            raise error(f"{name}: {self.refusal(value)}")
        return value


PLAUSIBLE: Final[Mapping[str, Range]] = {
    "exposure": Range(0.0, 1e9, "s"),  # 30 years; the longest photograph on record took eight
    "gain": Range(-200.0, 200.0, "dB"),  # image intensifiers reach a factor of 10⁷, 140 dB
    # No image sensor works below 1 K or above 150 °C.
    "temperature": Range(1.0 - ZERO_CELSIUS_K, 150.0, "°C"),
    "doubling": Range(0.5, 100.0, "K"),  # of a dark current: 5 K near −10 °C, some 10 K at 80 °C
    "iso": Range(1.0, 1e9),  # cameras state 6 to 4.5 million
    "f_number": Range(0.5, 1000.0),  # the least that a lens in air can have, and a pinhole's
    "conversion_gain": Range(1e-6, 1e9, "e-/DN"),  # with electron multiplication 10⁻³; large wells in 8 bits 10⁴
    "black_level": Range(-65_536.0, 65_536.0, "DN"),  # of 16 bits; taps and processed frames may be below 0
    "read_noise": Range(0.0, 1e9, "e-"),
    "radiance": Range(1e-18, 1e18, "W sr-1 m-2"),  # a dark sky 10⁻⁷, the sun 2·10⁷, lasers 10¹⁵
    "width": Range(1e-6, 1000.0, "nm"),  # of a line: lasers 10⁻⁶, phosphors 100
    "wavelength_u": Range(0.0, 50.0, "nm"),  # of a spectrum's scale: prisms and filter sets reach some 5
    "length": Range(1e-6, 1e6, "m"),  # of a source, or to it
    "angle": Range(0.1, 180.0, "°"),  # of half intensity: laser diodes some tenths
    "screen": Range(-1.0, 1e6, "cd m-2"),  # the brightest walls have 10⁴; noise may bring black below 0
    "luminance": Range(0.0, 1e15, "cd m-2"),  # the sun 1.6·10⁹
    "scotopic_ratio": Range(0.0, 1000.0),  # the greatest, in the violet, is some 60
    "field": Range(0.0, 41_253.0, "deg2"),  # the whole sphere
    # Of one DN: an electron in a large pixel is 10⁻⁹ J·m⁻², and 10⁴ J·m⁻² burn a sensor.
    "scale": Range(1e-15, 1e6, "J m-2"),
    "time_in_dark": Range(0.0, 1440.0, "min"),  # a day; recovery ends within an hour
    "log10_threshold": Range(-20.0, 20.0),  # eyes span 10⁻⁶ to 10⁸ cd·m⁻²; other units shift that by some powers
    "u_rel": Range(0.0, 1.0),  # relative standard uncertainty; above 1 nothing is known
    "hold": Range(0.0, 1e7, "s"),  # of a light or a wait: four months
    "frames": Range(0, 1_000_000),  # of one setting
    "journal_number": Range(-(2**62), 2**62),  # the journal counts in 64 bits
}

# Types of arguments. A plain `float` is any finite number.
NotNegative = Annotated[float, Range(0.0)]
Positive = Annotated[float, Range(0.0, above=True)]
Uncertainty = Annotated[float, Range(0.0)]  # standard uncertainty in the unit of its value
RelativeUncertainty = Annotated[float, PLAUSIBLE["u_rel"]]
Share = Annotated[float, Range(0.0, 1.0)]
Duration = Annotated[float, PLAUSIBLE["hold"]]
Exposure = Annotated[float, Range(0.0, PLAUSIBLE["exposure"].high, "s", above=True)]
FNumber = Annotated[float, PLAUSIBLE["f_number"]]
Iso = Annotated[float, PLAUSIBLE["iso"]]
# ISO 2720 recommends 10.6 to 13.4, and makers use up to 14; the illumination constant C, from 240 on, is another.
MeterConstant = Annotated[float, Range(5.0, 30.0)]
Luminance = Annotated[float, PLAUSIBLE["luminance"]]
ScotopicRatio = Annotated[float, PLAUSIBLE["scotopic_ratio"]]
WavelengthUncertainty = Annotated[float, PLAUSIBLE["wavelength_u"]]
Length = Annotated[float, PLAUSIBLE["length"]]
Millimetres = Annotated[float, Range(1e-3, 1e9, "mm")]  # of a source, or to it
KnownRadiance = Annotated[float, PLAUSIBLE["radiance"]]
HalfAngle = Annotated[float, PLAUSIBLE["angle"]]
FieldOfView = Annotated[float, Range(0.0, 360.0, "°", above=True)]
FieldArea = Annotated[float, Range(0.01, PLAUSIBLE["field"].high, "deg2")]
Pupil = Annotated[float, Range(1.0, 9.0, "mm")]  # the widest that were measured have some 9 mm
Age = Annotated[float, Range(0.0, 120.0)]  # of a subject in years
PupilAge = Annotated[float, Range(20.0, 83.0)]  # in years: those that Watson and Yellott (2012) measured
PatchSize = Annotated[float, Range(0.01, 1.0)]  # as a share of the screen's
PixelPitch = Annotated[float, Range(0.01, 5.0, "mm")]  # from telephones to walls of diodes
Gamma = Annotated[float, Range(0.1, 10.0)]
FilterDensity = Annotated[float, Range(0.0, 6.0)]
PointsPerDecade = Annotated[float, Range(1.0, 50.0)]
Period = Annotated[float, Range(0.0, 86_400.0, "s")]
Days = Annotated[float, Range(0.01, 1e6)]
Megabytes = Annotated[float, Range(0.1)]
RequestRate = Annotated[float, Range(1.0)]
LineDistance = Annotated[float, Range(1.0)]  # from pixel to pixel of a picture
Seed = Annotated[int, Range(0)]
Port = Annotated[int, Range(0, 65_535)]
AnyCount = Annotated[int, Range(0, 10**6)]
Count = Annotated[int, Range(1, 10**6)]
Limit = Annotated[int, Range(1, 10**9)]  # of a list
BoxLevel = Annotated[int, Range(0, 65_535)]  # of a channel of the light box, which counts in 16 bits
BlinkCount = Annotated[int, Range(0, 65_535)]
PerMille = Annotated[int, Range(0, 1000)]
ExposureSteps = Annotated[int, Range(6, 10_000)]  # of a sensor, from darkness to saturation
