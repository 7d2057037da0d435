"""Sources of each area, from which mistakes are drawn blind: patterns of names below the root."""

from __future__ import annotations


def _of(folder: str, names: str = "*") -> tuple[str, ...]:
    """Return the patterns of Python files in a folder, of which the names are stated without their ending."""
    return tuple(f"{folder}/{name}.py" for name in names.split())


AREAS: dict[str, tuple[str, ...]] = {
    "merge": _of("radiometer/analysis/merge"),
    "patch_and_budget": (*_of("radiometer/analysis/reading"), *_of("radiometer/statistics")),
    "response": (*_of("radiometer/analysis/response"), *_of("radiometer/data", "response_curve")),
    "absolute_scale": (*_of("radiometer/analysis/calibration"), *_of("radiometer/data", "calibration* guards")),
    "signal_and_photometry": _of("radiometer/analysis", "signal/* photometry/*"),
    "flicker_and_regions": _of("radiometer/analysis", "flicker regions"),
    "colour": (*_of("radiometer/analysis/colour"), *_of("radiometer/data", "mosaic")),
    "flux": _of("radiometer/analysis/flux"),
    "emva": _of("radiometer/analysis/characterise"),
    "planning": (*_of("radiometer/acquire"), *_of("radiometer", "units")),
    "journal": _of("radiometer/daemon", "journal* timestamps"),
    "scpi": _of("radiometer/daemon/scpi"),
    "http": _of("radiometer/daemon", "http/* limits"),
    "daemon": (
        *_of("radiometer/daemon", "keeper station service acquisition bench_instrument patches"),
        *_of("radiometer/bench", "doctor reopening box_holder"),
    ),
    "light_box": (
        *_of("drivers/light_box"),
        *_of("radiometer/devices", "retinal_safety exposure_ledger"),
        *_of("radiometer/data", "light_calibration"),
        *_of("simulators/light_box"),
        "drivers/firmware/light_box/*.c",
        "drivers/firmware/light_box/config.h",
    ),
    "adaptation": _of("radiometer/adaptation"),
    "reconcile": (
        *_of("radiometer/reconciliation", "comparison descent linear nuisances state localise screening search"),
        *_of("radiometer/reconciliation", "repeatability shared_errors statistics verdict"),
    ),
    "sensor_effects": _of("simulators/effects"),
    "files": _of("radiometer", "data/* importing/*"),
    "photographs_and_screen": _of("radiometer", "photographs/* screen/*"),
    "archive_and_bench": _of("radiometer", "archive/* bench/* devices/*"),
    "reconcile_rooms": _of("radiometer/reconciliation", "* propose/*"),
    "alarms_and_networks": (
        *_of("radiometer/adapters"),
        *_of("radiometer/daemon", "alarm* epics* light* log* mqtt*"),
        *_of("radiometer/daemon", "bench* instr* metrics* resources* patch_book* s*"),
    ),
    "faces": _of("radiometer", "* api/* cli/* cli/*/*"),
    "cameras_and_worlds": (
        *_of("drivers/cameras"),
        *_of("simulators", "* cameras/* chain/* displays/* observers/* scenes/*"),
    ),
    "quality_and_exports": (*_of("radiometer/analysis", "exports/* quality/*"), *_of("radiometer/reporting")),
}
