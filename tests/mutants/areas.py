"""Sources of each area, from which mistakes are drawn blind: patterns of names below the root."""

from __future__ import annotations

AREAS: dict[str, tuple[str, ...]] = {
    "merge": ("radiometer/analysis/merge/*.py",),
    "patch_and_budget": ("radiometer/analysis/reading/*.py", "radiometer/statistics/*.py"),
    "response": (
        "radiometer/analysis/response/*.py",
        "radiometer/data/response_curve.py",
    ),
    "absolute_scale": (
        "radiometer/analysis/calibration/*.py",
        "radiometer/data/calibration*.py",
        "radiometer/data/guards.py",
    ),
    "signal_and_photometry": ("radiometer/analysis/signal/*.py", "radiometer/analysis/photometry/*.py"),
    "flicker_and_regions": ("radiometer/analysis/flicker.py", "radiometer/analysis/regions.py"),
    "colour": ("radiometer/analysis/colour/*.py", "radiometer/data/mosaic.py"),
    "flux": ("radiometer/analysis/flux/*.py",),
    "emva": ("radiometer/analysis/characterise/*.py",),
    "planning": (
        "radiometer/acquire/*.py",
        "radiometer/units.py",
    ),
    "journal": (
        "radiometer/daemon/journal*.py",
        "radiometer/daemon/timestamps.py",
    ),
    "scpi": ("radiometer/daemon/scpi/*.py",),
    "http": (
        "radiometer/daemon/http/*.py",
        "radiometer/daemon/limits.py",
    ),
    "daemon": (
        "radiometer/daemon/keeper.py",
        "radiometer/daemon/station.py",
        "radiometer/daemon/service.py",
        "radiometer/daemon/acquisition.py",
        "radiometer/daemon/bench_instrument.py",
        "radiometer/daemon/patches.py",
        "radiometer/bench/doctor.py",
        "radiometer/bench/reopening.py",
        "radiometer/bench/box_holder.py",
    ),
    "light_box": (
        "drivers/light_box/*.py",
        "radiometer/devices/retinal_safety.py",
        "radiometer/devices/exposure_ledger.py",
        "radiometer/data/light_calibration.py",
        "simulators/light_box/*.py",
        "drivers/firmware/light_box/*.c",
        "drivers/firmware/light_box/config.h",
    ),
    "adaptation": ("radiometer/adaptation/*.py",),
    "reconcile": (
        "radiometer/reconciliation/fit/*.py",
        "radiometer/reconciliation/repeatability.py",
        "radiometer/reconciliation/shared_errors.py",
        "radiometer/reconciliation/verdict.py",
        "radiometer/reconciliation/statistics.py",
        "radiometer/reconciliation/search/*.py",
    ),
    "sensor_effects": ("simulators/effects/*.py",),
    "files": ("radiometer/data/*.py", "radiometer/importing/*.py"),
    "photographs_and_screen": (
        "radiometer/photographs/*.py",
        "radiometer/screen/*.py",
        "radiometer/screen/report.py",
    ),
    "archive_and_bench": ("radiometer/archive/*.py", "radiometer/bench/*.py", "radiometer/devices/*.py"),
    "reconcile_rooms": (
        "radiometer/reconciliation/*.py",
        *(f"radiometer/reconciliation/{room}/*.py" for room in ("inputs", "measure", "propose")),
    ),
    "alarms_and_networks": (
        "radiometer/adapters/*.py",
        *(f"radiometer/daemon/{name}*.py" for name in ("alarm", "epics", "hub", "light", "log", "mqtt")),
        *(f"radiometer/daemon/{name}*.py" for name in ("bench", "instr", "metrics", "resources", "patch_book", "s")),
    ),
    "faces": ("radiometer/*.py", "radiometer/api/*.py", "radiometer/cli/*.py", "radiometer/cli/*/*.py"),
    "cameras_and_worlds": (
        "drivers/cameras/*.py",
        "simulators/*.py",
        *(f"simulators/{room}/*.py" for room in ("cameras", "chain", "displays", "observers", "scenes")),
    ),
    "quality_and_exports": (
        *(f"radiometer/analysis/{room}/*.py" for room in ("exports", "quality")),
        "radiometer/reporting/*.py",
    ),
}
