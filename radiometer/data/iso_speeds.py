"""ISO speeds of a camera: as it states them and as they really are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from radiometer.errors import UsageError


@dataclass(frozen=True, slots=True)
class IsoSpeeds:
    """What is known of a camera's ISO speeds beyond what its photographs state."""

    measured: Mapping[float, float] = field(default_factory=dict)  # real speed by stated one, such as {200: 136}
    reference: float | None = None  # real speed at which the gain is 0 dB; None for the lowest one in use
    reference_stated: float | None = None  # that speed as the camera states it; None where unknown

    def real(self, stated: float) -> float:
        """Return the speed as measured where it was, else as stated."""
        return self.measured.get(stated, stated)

    def gain_db(self, stated: float, in_use: Iterable[float]) -> float:
        """Return the gain in dB of amplitude of an ISO speed.

        Real speeds are compared where this one was measured; else stated ones, where the reference's is known. A
        speed that is only stated is compared with a real reference where nothing else is known of it.

        Args:
            stated: Speed that a photograph states, above 0.
            in_use: Speeds that all photographs of the set state.
        """
        if self.reference is not None and stated in self.measured:
            return 20.0 * math.log10(self.measured[stated] / self.reference)
        if self.reference_stated is not None:
            return 20.0 * math.log10(stated / self.reference_stated)
        if self.reference is not None:
            return 20.0 * math.log10(stated / self.reference)
        return 20.0 * math.log10(self.real(stated) / min(self.real(one) for one in in_use))

    def refuse_unstated(self, where: str, in_use: set[float]) -> None:
        """Refuse a measured speed that no photograph states: the word was meant for another one.

        Raises:
            UsageError: If there is one.
        """
        for stated in self.measured:
            if stated not in in_use:
                there = ", ".join(f"{one:g}" for one in sorted(in_use)) or "none"
                raise UsageError(f"{where}: no photograph states ISO {stated:g}; stated are {there}")
