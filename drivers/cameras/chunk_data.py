"""Chunks: what a camera sends with every frame of the settings that it was exposed under."""

from __future__ import annotations

from typing import Any, Final

from drivers.cameras.feature_access import FeatureAccess, Refusal
from drivers.cameras.frame_stream import RawFrame
from radiometer.devices import CameraSettings

CHUNKS: Final = ("ExposureTime", "Gain", "BlackLevel")
_SAME_EXPOSURE_REL: Final = 1e-3  # the chunk is rounded as the register is; neighbouring settings differ by more
# A chunk counts whole µs (FLIR's descriptions: ChunkExposureTimeUS = RAW*1), and a whole µs more or less is another
# setting: only what is less than a step away may be the same.
_CHUNK_STEP_S: Final = 1e-6
_WITHIN_STEP: Final = 0.999  # a difference of a whole step counts as one, rounding of floats included
_SAME_GAIN_DB: Final = 0.01  # cameras step by 0.1 dB or finer steps of which rounding leaves hundredths
_SAME_BLACK_REL: Final = 2e-4  # of full scale
_SAME_BLACK_DN: Final = 0.5  # read back in whole DN


def switch_on_chunks(camera: Any, features: FeatureAccess, notes: list[str]) -> tuple[str, ...]:
    """Switch chunks for exposure time, gain and black level on, and return the names of those that are.

    A chunk that cannot be switched on is noted and done without: Blackflies lock the switches of some, and refuse the
    selector while a user set is being loaded.

    Args:
        camera: An `Aravis.Camera`.
        notes: What was met on the way is added here.
    """
    if not features.has("ChunkModeActive") or not features.has("ChunkSelector"):
        return ()
    try:
        features.write("ChunkModeActive", True)
        offered = features.call(camera.dup_available_enumerations_as_strings, "ChunkSelector")
    except Refusal as error:
        notes.append(f"no chunks ({error}): frames after a change of settings are thrown away by number")
        return ()
    return tuple(name for name in CHUNKS if name in offered and _switched_on(features, name, notes))


def _switched_on(features: FeatureAccess, name: str, notes: list[str]) -> bool:
    try:
        features.write("ChunkSelector", name)
        if features.read("ChunkEnable", bool) or features.write("ChunkEnable", True):
            return True
        reason = "it took the write and stayed off"
    except Refusal as error:
        reason = str(error)
    notes.append(f"no chunk {name} ({reason}): a change of it is waited for by number of frames")
    return False


def holds_other_settings(raw: RawFrame, settings: CameraSettings, exposure_step_s: float = 0.0) -> bool:
    """Tell whether a frame's chunks say that it was exposed under other settings than those in force.

    Args:
        settings: In force, as read back.
        exposure_step_s: The camera's own step of the exposure time in s; 0 where unknown.
    """
    exposure_us, gain_db = raw.chunks.get("ExposureTime"), raw.chunks.get("Gain")
    least_s = _WITHIN_STEP * max(exposure_step_s, _CHUNK_STEP_S)
    tolerance_s = max(_SAME_EXPOSURE_REL * settings.exposure_s, least_s)
    if exposure_us is not None and abs(exposure_us * 1e-6 - settings.exposure_s) > tolerance_s:
        return True
    return gain_db is not None and abs(gain_db - settings.gain_db) > _SAME_GAIN_DB


def stated_by_chunks(
    raw: RawFrame, changed: frozenset[str], settings: CameraSettings, black_level_scale: float, full_scale_dn: int
) -> bool:
    """Tell whether a frame's chunks confirm every setting that was changed.

    Args:
        raw: A frame whose exposure and gain are those in force, as far as its chunks say.
        changed: Names of the chunks of the settings that were changed.
        settings: In force, as read back.
        black_level_scale: DN of a unit of the camera's black level.
    """
    if not changed <= raw.chunks.keys():
        return False
    if "BlackLevel" not in changed:
        return True
    # Only ever a confirmation: a camera that counts this chunk in a unit of its own must not seem stale for ever.
    return determines_black(raw, settings.black_level_dn, black_level_scale, full_scale_dn)


def determines_black(raw: RawFrame, black_level_dn: float, black_level_scale: float, full_scale_dn: int) -> bool:
    """Tell whether a frame's chunk says that it was exposed under a black level.

    Args:
        black_level_dn: The black level in DN.
        black_level_scale: DN of a unit of the camera's black level.
    """
    chunk = raw.chunks.get("BlackLevel")
    tolerance_dn = max(_SAME_BLACK_DN, _SAME_BLACK_REL * full_scale_dn)
    return chunk is not None and abs(chunk * black_level_scale - black_level_dn) <= tolerance_dn


def exposure_of(raw: RawFrame, settings: CameraSettings) -> float:
    """Return the exposure time in s that a frame was taken with: its chunk's, else the one read back.

    A chunk in whole µs says less than a register that is finer: at 11.4 µs it would be 4 % off.
    """
    exposure_us = raw.chunks.get("ExposureTime")
    if exposure_us is None:
        return settings.exposure_s
    is_rounded = exposure_us == int(exposure_us) and abs(exposure_us * 1e-6 - settings.exposure_s) < _CHUNK_STEP_S
    return settings.exposure_s if is_rounded else exposure_us * 1e-6


def changed_chunks(before: CameraSettings, after: CameraSettings) -> frozenset[str]:
    """Return the chunks that identify a change of settings; what needs a stopped acquisition needs none."""
    pairs = (
        ("ExposureTime", before.exposure_s, after.exposure_s),
        ("Gain", before.gain_db, after.gain_db),
        ("BlackLevel", before.black_level_dn, after.black_level_dn),
    )
    return frozenset(name for name, old, new in pairs if old != new)
