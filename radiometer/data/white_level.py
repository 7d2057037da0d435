"""The white level of a frame: the digital number from which its pixels are saturated, and what it rests on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

Basis = Literal["measured", "stated", "assumed"]

# The pile of saturated pixels reaches down to so many standard deviations; 3e-5 of a normal distribution are below.
EDGE_SIGMAS: Final = 4.0


@dataclass(frozen=True, slots=True)
class WhiteLevel:
    """The white level of frames of one gain."""

    saturated_dn: int  # digital numbers at or above are saturated
    # "measured" where the pile-up of saturated pixels decides, "stated" where the file or the camera does, "assumed"
    # where only the bit depth is known
    basis: Basis
    stated_dn: int  # as the file or the camera states it, else the highest code of the bit depth, in DN
    is_stated: bool = False  # whether the file or the camera states it
    measured_dn: float | None = None  # centre of the pile in DN; None where the frames show none
    spread_dn: float = 0.0  # standard deviation of the pile in DN
    piled_pixels: int = 0  # pixels in the pile of the frame that shows it best
    # The highest digital number that more than single pixels reach; None where frames were not compared
    reached_dn: int | None = None
    exposures: int = 0  # different exposures that were compared

    @classmethod
    def stated(cls, dn: float) -> WhiteLevel:
        """Return the white level that a file or a camera states, not compared with frames yet."""
        level_dn = int(dn)
        return cls(level_dn, "stated", level_dn, is_stated=True)

    @property
    def disagrees(self) -> bool:
        """Return whether the frames show another white level than the stated one or that of the bit depth."""
        tolerance_dn = EDGE_SIGMAS * self.spread_dn + 1.0
        return self.measured_dn is not None and abs(self.measured_dn - self.stated_dn) > tolerance_dn

    @property
    def note(self) -> str | None:
        """Return what a user must know of the white level; None where frames and statement agree.

        Frames that show no pile-up and stay below the stated level need no word: the level decides nothing there.
        """
        origin = "the file states" if self.is_stated else "the bit depth gives"
        if self.measured_dn is None:
            return (
                f"white level {self.saturated_dn} DN, as {origin}: a single exposure cannot show where pixels saturate"
                if self.exposures == 1
                else None
            )
        if not self.disagrees:
            return None
        pile = f"{self.piled_pixels} pixels gather at {self.measured_dn:.0f} DN while the exposure grows"
        if self.basis == "measured":
            return f"white level {self.saturated_dn} DN, as the frames show: {pile}; {origin} {self.stated_dn} DN"
        return f"white level {self.saturated_dn} DN, as {origin}: {pile}, and the lower of the two is used"


def white_level_notes(levels: Iterable[WhiteLevel | None]) -> tuple[str, ...]:
    """Return what a user must know of the white levels of some frames, each note once."""
    notes = (level.note for level in levels if level is not None)
    return tuple(dict.fromkeys(note for note in notes if note is not None))
