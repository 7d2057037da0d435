"""A session as a folder of pictures and a `capture.yaml`, and next to it the secret of what was hidden."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

PLANCK_C = 6.62607015e-34 * 299792458.0


@dataclass(frozen=True)
class Hidden:
    """One thing that a generator can hide.

    Attributes:
        name: Its own name; for outsiders not one of any catalogue.
        kind: `single` (an entry by its usual equation), `law` (an entry by another one) or `outsider`.
        install: Called with the world, a random generator and the size (about 1); returns what it drew.
        plans: Plans that can show it.
        right: Catalogue names that are right for it.
        stage: Where it acts: source, scene, optics, shutter, charge, well, readout or digital.
        covariates: What it goes with, each with the names that results may use for it.
        together: Names that a plan cannot tell from it, by plan; they are right there too.
    """

    name: str
    kind: str
    install: Callable[[Any, np.random.Generator, float], Mapping[str, Any]]
    plans: tuple[str, ...]
    right: tuple[str, ...] = ()
    stage: str = ""
    covariates: tuple[str, ...] = ()
    together: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Secret:
    """What was hidden in a session: its kind, plan, names that are right, place, and what was drawn."""

    kind: str
    plan: str
    name: str = ""
    right: tuple[str, ...] = ()
    stage: str = ""
    covariates: tuple[str, ...] = ()
    drawn: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Session:
    """Header and frames as they go to disk, and the secret that does not."""

    header: dict[str, Any]
    frames: list[np.ndarray]
    secret: Secret

    def write(self, folder: Path) -> Path:
        """Write the capture set, `capture.yaml` last."""
        (folder / "frames").mkdir(parents=True)
        for entry, picture in zip(self.header["frames"], self.frames, strict=True):
            if not cv2.imwrite(str(folder / entry["file"]), picture):
                raise OSError(f"{folder / entry['file']} could not be written")
        text = yaml.safe_dump(plain(self.header), sort_keys=False, allow_unicode=True)
        unfinished = folder / "capture.yaml.part"
        unfinished.write_text(text, encoding="utf-8")
        unfinished.rename(folder / "capture.yaml")
        return folder


def plain(value: Any) -> Any:
    """Return a value without NumPy's types, fit for YAML."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value
