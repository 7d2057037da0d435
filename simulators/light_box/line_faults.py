"""What a bad cable does to bytes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(slots=True)
class LineFaults:
    """Corrupts, drops and invents bytes."""

    corrupt: float = 0.0  # probability that a byte becomes another one
    drop: float = 0.0  # probability that a byte is lost
    insert: float = 0.0  # probability that a byte is followed by an invented one
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))  # source of chance
    touched: int = 0  # how many bytes were corrupted, dropped or invented

    def apply(self, sent: bytes) -> bytes:
        """Return what arrives of `sent`."""
        if not sent or self.corrupt == self.drop == self.insert == 0.0:
            return sent
        arrived = np.frombuffer(sent, dtype=np.uint8).copy()
        chance = self.rng.random((3, arrived.size))
        wrong = chance[0] < self.corrupt
        arrived[wrong] ^= self.rng.integers(1, 256, int(wrong.sum()), dtype=np.uint8)
        lost, followed = chance[1] < self.drop, chance[2] < self.insert
        self.touched += int(wrong.sum() + lost.sum() + followed.sum())
        invented = self.rng.integers(0, 256, arrived.size, dtype=np.uint8)
        pairs = np.stack([arrived, invented], axis=1)
        return bytes(pairs[np.stack([~lost, followed], axis=1)].tobytes())
