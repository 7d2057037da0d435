"""What a `with` block opens and closes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Opened(ABC):
    """A device, page or file that is open within a `with` block."""

    @abstractmethod
    def open(self) -> None:
        """Open it."""

    @abstractmethod
    def close(self) -> None:
        """Close it; closing twice does nothing."""

    def __enter__(self) -> Self:
        """Open it."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
