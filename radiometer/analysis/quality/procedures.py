"""What every quality index asks for: captures by name, what must stand before the camera, and the definition."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

Exposures = Literal["patch", "scene", "ladder", "overexposed"]

STANDARD: Final = "ISO/CIE 19476 (CIE S 023)"
IMAGING: Final = "CIE 244"


_GAIN: Final = r"(-?\d+(?:\.\d+)?) ?[dD][bB]"
_NUMBER: Final = r"\d+(?:\.\d+)?"


@dataclass(frozen=True, slots=True)
class ProcedureStep:
    """One capture of a procedure."""

    name: str  # folder of the capture within the procedure's
    ask: str  # what must be arranged before it is taken


@dataclass(frozen=True, slots=True)
class Procedure:
    """One quality index."""

    name: str  # folder in the session, and name on the command line
    symbol: str  # as the field writes it
    title: str  # what it measures, in words
    definition: str  # formula, in terms of the reading Y
    source: str  # document that defines the index; the definition here is the one found in open literature
    steps: tuple[ProcedureStep, ...] = ()  # captures that the command asks for
    more: str = ""  # what further captures may be named, and what their names mean; empty for none
    form: str = ""  # regular expression of their names
    # Which exposures a capture takes: the patch's, the whole scene's, a ladder up to the patch's longest, or that
    # ladder and beyond, so that the patch clips
    exposures: Exposures = "patch"

    @property
    def called(self) -> str:
        """Return what it measures and, where it has one, its symbol."""
        return self.title if self.symbol == self.title else f"{self.title} ({self.symbol})"


PROCEDURES: Final = (
    Procedure(
        "spectral",
        "f1′",
        "general V(λ) mismatch",
        "f1′ = ∫|s*(λ) − V(λ)| dλ / ∫V(λ) dλ, s* scaled so that the light of CIE illuminant A reads as V(λ) does",
        STANDARD,
    ),
    Procedure(
        "linearity",
        "f3",
        "linearity",
        "f3 = max |(Y/X)·(X_max/Y_max) − 1|, X the exposure time before a steady source, signals of 2 % of Y_max up",
        STANDARD,
        (ProcedureStep("ladder", "a steady, even source over the patch, so dim that full scale takes 50 ms or more"),),
        exposures="ladder",
    ),
    Procedure(
        "temperature",
        "f6",
        "temperature dependence",
        "f6 = |Y(T₂)/Y(T₁) − 1|·10 K/|T₂ − T₁|, T as the camera reports it",
        STANDARD,
        (
            ProcedureStep(
                "cool", "the camera as cool as it will be used, at rest there; a steady source over the patch"
            ),
            ProcedureStep("warm", "the camera at least 10 K warmer; the source as before"),
        ),
    ),
    Procedure(
        "modulation",
        "f7",
        "modulated light",
        "f7 = |Y(modulated)/Y(steady) − 1| at one mean radiance, the worst of the frequencies",
        STANDARD,
        (
            ProcedureStep("steady", "a steady source over the patch"),
            ProcedureStep("100Hz", "the same source modulated at 100 Hz, its mean unchanged"),
        ),
        more="further frequencies by name, such as 240Hz",
        form=f"{_NUMBER} ?Hz",
    ),
    Procedure(
        "polarisation",
        "f8",
        "polarisation",
        "f8 = (Y_max − Y_min)/(Y_max + Y_min) before linearly polarised light, from Y = Y₀·(1 + f8·cos 2(φ − φ₀))",
        STANDARD,
        tuple(
            ProcedureStep(
                f"{angle}", f"the camera turned to {angle}° about its axis, the patch on linearly polarised light"
            )
            for angle in (0, 45, 90, 135)
        ),
        more="further angles by their number of degrees",
        form=f"{_NUMBER}°?",
    ),
    Procedure(
        "range",
        "f11",
        "range change",
        "f11 = max |Y(range)/Y(first range) − 1| before one steady source",
        STANDARD,
        (
            ProcedureStep("0dB", "a steady source over the patch; gain 0 dB"),
            ProcedureStep("12dB", "the same source; gain 12 dB"),
        ),
        more="further gains or stops by name, such as 6.5dB or f5.6; the first in order of steps is the reference",
        form=f"{_GAIN}|f{_NUMBER}",
    ),
    Procedure(
        "focus",
        "f12",
        "focus distance",
        "f12 = |Y(near)/Y(far) − 1| before an even source that fills the view at both distances",
        STANDARD,
        (
            ProcedureStep("far", "an even source, the lens focused as at calibration"),
            ProcedureStep("near", "the same source, the lens focused as near as it will be used"),
        ),
    ),
    Procedure(
        "uniformity",
        "f21",
        "uniformity over the picture",
        "1 − L_min/L_max of the means of 10 × 10 tiles before an even source, the calibration's flat field applied",
        IMAGING,
        (ProcedureStep("even", "an even source (sphere, diffuser before the lens) over the whole picture"),),
        exposures="scene",
    ),
    Procedure(
        "edge",
        "edge",
        "edge",
        "distance in pixels over which a sharp edge rises from 10 to 90 %",
        f"{IMAGING}; ISO 12233",
        (
            ProcedureStep(
                "edge", "one straight, sharp, slightly slanted edge between dark and bright through the patch"
            ),
        ),
    ),
    Procedure(
        "smear",
        "smear",
        "smear",
        "signal in the columns of an overexposed source over that of the neighbouring columns, relative to "
        "the source's, for a source of a tenth of the picture's height",
        IMAGING,
        (ProcedureStep("source", "a small, very bright source in the patch, all else dark"),),
        exposures="overexposed",
    ),
    Procedure(
        "size",
        "size of source",
        "size of source",
        "max |Y(diameter)/Y(largest diameter) − 1| at one radiance",
        f"{STANDARD}; {IMAGING}",
        (
            ProcedureStep("2", "an even round source of 2 (degrees, or any unit) around the patch, all else dark"),
            ProcedureStep("5", "the same radiance, 5 across"),
            ProcedureStep("20", "the same radiance, 20 across"),
        ),
        more="further diameters by their number",
        form=_NUMBER,
    ),
    Procedure(
        "glare",
        "VGI",
        "veiling glare index",
        "VGI = Y(black)/Y(white) at one place: a black patch in a white surround over that white",
        "ISO 9358, black patch method",
        (
            ProcedureStep("white", "an even white over the whole view"),
            ProcedureStep("black", "a black patch (light trap) over the patch, the white all around it"),
        ),
    ),
)


def gain_of_step(name: str) -> float | None:
    """Return the gain in dB that a step's name states, such as 12 of "12dB"; None where it states none."""
    stated = re.fullmatch(_GAIN, name, re.ASCII)
    return float(stated[1]) if stated else None


def procedure(name: str) -> Procedure | None:
    """Return the procedure of a name, None where there is none."""
    return next((one for one in PROCEDURES if one.name == name), None)
