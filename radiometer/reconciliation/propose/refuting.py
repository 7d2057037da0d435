"""Plans the captures that would refute a law: settings not taken yet under which it predicts most."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from radiometer.reconciliation.advice.capture_pool import FRAMES, CapturePool
from radiometer.reconciliation.propose.proposal import Proposal
from simulators.chain.law_stages import LINKS

_CAPTURES: Final = 3
_SHOWS_CHI2: Final = 9.0


def refuting_frames(proposal: Proposal) -> tuple[list[dict[str, Any]], list[str]]:
    """Return frames for `radiometer bracket --plan`, and for each what the law predicts there.

    New settings come first, those where the camera with the law and the one without it differ most. Where the rig has
    no new settings, those in use are repeated.
    """
    pool = CapturePool.of(proposal.after)
    with_law, without = pool.predicted(proposal.after), pool.predicted(proposal.before)
    worth = np.nan_to_num(pool.separation(with_law, without))
    worth = np.where(pool.is_new, worth, 0.5 * worth)
    is_noise = LINKS[proposal.law.link].is_noise
    apart = np.sqrt(with_law.variance) - np.sqrt(without.variance) if is_noise else with_law.mean - without.mean
    does = "scatters by" if is_noise else "differs by"
    frames, reasons = list[dict[str, Any]](), list[str]()
    for index in np.argsort(-worth)[:_CAPTURES].tolist():
        if worth[index] < _SHOWS_CHI2 and frames:
            break
        tile = int(np.argmax(np.abs(apart[index])))
        frame = pool.frame(index)
        shown = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
        frames.append(shown | {"repeat": FRAMES})
        reasons.append(
            f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB, source level {frame.source_level:g}, shutter "
            f"{frame.shutter}: with {proposal.name} patch {pool.design.tiles[tile].name} {does} "
            f"{apart[index, tile]:+.3g} DN relative to the camera without it; the law is refuted where that is not seen"
        )
    return frames, reasons
