"""What each reader gives of a file: facts by name, and all that it doubts in one text."""

from pathlib import Path
from typing import Any

import numpy as np

from radiometer.adaptation.threshold_files import read_table
from radiometer.analysis.photometry.photometry import spectrum_from_csv
from radiometer.importing import import_sources, open_capture, statistics_of
from radiometer.importing.found import record_in
from radiometer.importing.log_table import read_log
from radiometer.importing.photograph_times import read_list
from radiometer.reconciliation.tables import reconcile_meter_table
from radiometer.screen.measured_elsewhere import read_screen_readings

Read = tuple[dict[str, Any], str]


def read_image(path: Path) -> Read:
    """Return facts of the first frame, the exposures of all, and the level of the last."""
    header = import_sources([path])[0].header
    entry, frames = header.frames[0], open_capture(path)
    facts = {"s": entry.exposure_s, "dB": entry.gain_db, "black": entry.black_level_dn, "f": entry.f_number}
    facts |= {"C": entry.temperature_C, "shutter": str(entry.shutter), "bits": header.camera.bit_depth}
    facts |= {"last": float(frames.read_frame(len(header.frames) - 1).dn.mean()), "frames": len(header.frames)}
    facts |= {"e/DN": header.camera.conversion_gain_e_per_dn, "all s": [one.exposure_s for one in header.frames]}
    return facts, " ".join(record_in(header).doubts)


def read_import(path: Path) -> Read:
    """Return exposure, black level, temperature and gain of every frame of what a file becomes."""
    found = import_sources([path])
    facts = {}
    for n, entry in enumerate(entry for one in found for entry in one.header.frames):
        facts |= {f"exposure {n}": entry.exposure_s, f"black {n}": entry.black_level_dn}
        facts |= {f"temperature {n}": entry.temperature_C, f"gain {n}": entry.gain_db}
    records = [record_in(one.header) for one in found]
    return facts, " ".join(line for one in records for line in (*one.doubts, *one.left_out))


def read_spectrum(path: Path) -> Read:
    """Return the mean wavelength, and the largest power."""
    found = spectrum_from_csv(path)
    return {"nm": float(found.wavelength_nm @ found.power / found.power.sum()), "peak": float(found.power.max())}, ""


def read_screen(path: Path) -> Read:
    """Return the luminance of each level of grey, and how many there are."""
    found = read_screen_readings(path)
    facts = {str(n): float(np.mean(light)) for n, light in found.grey.items()}
    return facts | {"levels": len(facts)}, " ".join(found.doubts)


def read_times(path: Path) -> Read:
    """Return the exposure of each listed photograph."""
    return {name: one.exposure_s for name, one in read_list(path).items()}, ""


def read_nights(path: Path, of: str = "") -> Read:
    """Return what a log has; of its assumptions those that hold some words."""
    log = read_log(path)
    celsius = [None] if log.temperature_c is None else log.temperature_c.tolist()
    facts = {"rows": log.size, "s": float(log.exposure_s[0])} | {f"C {n}": one for n, one in enumerate(celsius)}
    facts["colour"] = None if log.colour is None else float(log.colour[0])
    return facts, " ".join(one for one in log.assumptions if of in one and "Unihedron" not in one)


def read_meter(path: Path) -> Read:
    """Return what readings of a light meter hold."""
    found = reconcile_meter_table(path)
    row = found.rows[0]
    remarks = found.result.extra["remarks"]
    return {"cd/m2": row.luminance_cd_m2, "s": row.time_s, "iso": row.iso}, " ".join(
        one for one in remarks if "unit" in one
    )


def read_means(path: Path) -> Read:
    """Return the rows of a table of statistics."""
    header = statistics_of(path)
    rows = () if header is None else header.statistics
    facts = {f"{what} {n}": value for n, row in enumerate(rows)
             for what, value in (("s", row.exposure_s), ("mean", row.mean_dn), ("var", row.variance_dn2))}  # fmt: skip
    return facts, "" if header is None else " ".join(record_in(header).doubts)


def read_thresholds(path: Path) -> Read:
    """Return time in min and logarithm of each threshold."""
    rows = read_table(path).rows
    return {f"{what} {n}": float(row[k]) for n, row in enumerate(rows) for k, what in enumerate(("min", "log"))}, ""
