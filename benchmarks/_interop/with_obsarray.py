"""obsarray reads the uncertainties of a map, also from a NetCDF file."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np

import radiometer as rm
from radiometer.data import Bracket, CameraDescription, Frame, FrameSettings, LensDescription


def _map() -> rm.Radiance:
    rng = np.random.default_rng(1)
    frames = [
        Frame(rng.poisson(100 + 5e4 * s, (12, 16)).astype(np.uint16), 12, FrameSettings(s, black_level_dn=100.0))
        for s in (0.005, 0.01, 0.02)
    ]
    camera = CameraDescription(bit_depth=12, black_level_dn=100.0)
    return rm.merge(rm.Stack({"default": Bracket.from_frames(frames, "made")}, camera, LensDescription(), "made"))


def main() -> list[str]:
    """Return what obsarray takes for random, systematic and total, next to ours."""
    import importlib.metadata

    warnings.simplefilter("ignore")
    import obsarray  # noqa: F401 (registers the accessor)
    import xarray

    made = _map().to_xarray()
    lines = [f"obsarray {importlib.metadata.version('obsarray')}, means over the map:"]
    with tempfile.TemporaryDirectory() as folder:
        made.to_netcdf(Path(folder) / "map.nc", engine="h5netcdf")
        with xarray.open_dataset(Path(folder) / "map.nc", engine="h5netcdf") as back:
            for title, dataset in (("made", made), ("from NetCDF", back)):
                seen = dataset.unc["radiance"]
                uncertainties = (seen.random_unc(), seen.systematic_unc(), seen.total_unc())
                ours = (dataset.u_radiance, dataset.u_common, np.hypot(dataset.u_radiance, dataset.u_common))
                pairs = zip(("random", "systematic", "total"), uncertainties, ours, strict=True)
                text = ", ".join(f"{name} {float(a.mean()):.4g} (ours {float(b.mean()):.4g})" for name, a, b in pairs)
                lines.append(f"  {title}: {text}")
    return lines
