"""Radiance maps of an archive as Zarr groups."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from radiometer.data import RadianceMap
from radiometer.errors import MissingLibrary, OutputError


def write_map(merged: RadianceMap, path: Path) -> None:
    """Write a radiance map as a Zarr group with the arrays radiance, u_radiance and mask; whole or not at all.

    Args:
        path: Folder of the group; one that exists is replaced.

    Raises:
        MissingLibrary: If Zarr is not installed.
        OutputError: If the disk refuses it.
    """
    try:
        import zarr
    except ImportError as error:
        raise MissingLibrary(
            "Zarr is not installed; `pip install 'radiometer[cluster]'`, or leave out --maps"
        ) from error
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.open_group(str(unfinished), mode="w")
        for name in ("radiance", "u_radiance", "mask"):
            values = getattr(merged, name)
            group.create_array(name, shape=values.shape, dtype=values.dtype)[:] = values
        group.attrs.update(
            unit=merged.unit, u_rel_common=merged.u_rel_common, provenance=merged.provenance.to_mapping()
        )
        shutil.rmtree(path, ignore_errors=True)
        unfinished.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
