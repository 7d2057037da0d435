"""Ranges that no camera, lens, light or eye leaves: one table for files of every kind, their headers and arguments.

A number outside its range is a mistake of unit or of power of ten. Data classes and arguments refuse it. In the headers
of other people's files it means "unknown", and a doubt is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from radiometer.errors import InputError, RadiometerError
from radiometer.numbers import unit_text
from radiometer.units import ZERO_CELSIUS_K


@dataclass(frozen=True, slots=True)
class Range:
    """What a quantity can be."""

    low: float  # least value in the unit
    high: float  # greatest value in the unit
    unit: str = "1"  # unit in the form of the files

    def holds(self, value: float) -> bool:
        """Return whether a value is in the range; what is no number is not."""
        return self.low <= value <= self.high

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
    "frames": Range(0.0, 1e6),  # of one setting
    "journal_number": Range(-(2.0**62), 2.0**62),  # the journal counts in 64 bits
}
