"""Location of the configuration files that come with the product."""

from __future__ import annotations

from pathlib import Path

from radiometer.errors import ConfigurationError


def shipped_config(name: str) -> Path:
    """Return the path of a configuration file that comes with the product, such as "bench-simulated.yaml".

    Raises:
        ConfigurationError: If there is none of that name; the message lists those of the same folder.
    """
    package = Path(__file__).resolve().parent.parent
    for root in (package.parent / "configs", package / "_configs"):
        candidate = root / name
        if candidate.is_file():
            return candidate
    folder = next((r / name for r in (package.parent / "configs", package / "_configs") if r.is_dir()), package).parent
    there = ", ".join(sorted(p.name for p in folder.glob("*.yaml"))) if folder.is_dir() else "none"
    raise ConfigurationError(f"no shipped configuration {name!r}; there are: {there}")
