"""How fast a camera may send: below what its link carries, and slower where frames are lost all the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import structlog

from drivers.cameras.feature_access import FeatureAccess, Refusal

_LOG = structlog.get_logger(__name__)

LIMIT: Final = "DeviceLinkThroughputLimit"
SPEED: Final = "DeviceLinkSpeed"  # bytes/s, as the limit (SFNC 2.7; FLIR: MBITS*1000000/8)
# Ethernet: 10 % stay free for answers and resent packets. USB: 5 Gbit/s are 500 MB/s of symbols, of which some 380
# arrive; the same share holds for the 40 of 60 MB/s of USB 2.
_SHARE: Final = {True: 0.9, False: 0.65}
_SLOWER: Final = 0.75  # each time that frames were lost


@dataclass(slots=True)
class LinkThroughput:
    """The limit of one open camera."""

    features: FeatureAccess  # the camera's features
    name: str  # how messages call it
    limit_bytes_s: int  # in force, as read back
    lowest_bytes_s: int  # what it may be set to at least

    def slow_down(self) -> bool:
        """Lower the limit by a quarter, and return whether that could be done; the acquisition must be stopped.

        Raises:
            DeviceLost: If the camera does not answer.
        """
        limit = max(self.lowest_bytes_s, int(_SLOWER * self.limit_bytes_s))
        if limit >= self.limit_bytes_s:
            return False
        try:
            now = int(self.features.write(LIMIT, limit))
        except Refusal as error:
            _LOG.info("link speed kept", camera=self.name, reason=str(error))
            return False
        was, self.limit_bytes_s = self.limit_bytes_s, now
        _LOG.warning("frames lost, camera slowed down", camera=self.name, was_bytes_s=was, now_bytes_s=now)
        return now < was


def choose_throughput(camera: Any, features: FeatureAccess, name: str, notes: list[str]) -> LinkThroughput | None:
    """Limit what the camera sends to what its link carries, and return the limit; None where it has none.

    Args:
        camera: An `Aravis.Camera`.
        notes: What was met on the way is added here.
    """
    if not features.has(LIMIT):
        return None
    try:
        low, high = features.call(camera.get_integer_bounds, LIMIT)
        found = now = int(features.read(LIMIT, int))
        speed = features.read_if_there(SPEED, int)
        if speed is not None and 0 < int(speed) * _SHARE[bool(camera.is_gv_device())] < found:
            limit = min(max(int(int(speed) * _SHARE[bool(camera.is_gv_device())]), int(low)), int(high))
            now = int(features.write(LIMIT, limit))
    except Refusal as error:
        notes.append(f"{LIMIT} kept ({error}): frames may be lost where the link is slower than the camera")
        return None
    if now < found:
        notes.append(f"{LIMIT} lowered from {found / 1e6:g} to {now / 1e6:g} MB/s, below what the link carries")
    return LinkThroughput(features, name, now, int(low))
