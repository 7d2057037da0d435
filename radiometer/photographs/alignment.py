"""Photographs of one scene brought into one place before they are merged or read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, Final

from radiometer.errors import UsageError
from radiometer.progress import Progress, counted, unseen

if TYPE_CHECKING:
    from radiometer.data import Bracket

ALIGN_CHOICES: Final = ("auto", "on", "off")


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Photographs in one place."""

    brackets: list[Bracket]  # by channel, as given or moved
    common: list[Bracket]  # the part of them that all frames show
    absent: list[Any]  # where each frame shows nothing, shape (height, width) each; empty where nothing was moved
    sentence: str | None  # how they lay, for people; None where it was not asked for


def in_one_place(brackets: Sequence[Bracket], align: str, progress: Progress = unseen) -> Placed:
    """Return photographs in the place of that which shows most of the scene.

    Args:
        brackets: One per channel, of the same photographs; the movement is sought in green or the only one.
        align: "auto" moves them where they need it, "on" always, "off" never looks.
        progress: Called after every photograph.

    Raises:
        UsageError: If it is none of these.
    """
    import numpy as np

    from radiometer.analysis.merge.alignment import aligned, find_alignment
    from radiometer.analysis.response.labels import frame_name

    if align not in ALIGN_CHOICES:
        raise UsageError(f"--align {align}: choose one of {', '.join(ALIGN_CHOICES)}")
    if align == "off" or len(brackets[0].light) < 2:
        return Placed(list(brackets), list(brackets), [], None)
    seen = next((one for one in brackets if one.light[0].extra.get("channel") == "green"), brackets[0])
    alignment = find_alignment(seen, counted(progress, "aligning"))
    sentence = alignment.sentence([frame_name(seen, k) for k in range(len(seen.light))], moved=align == "on")
    if not (alignment.needed or align == "on"):
        return Placed(list(brackets), list(brackets), [], sentence)
    moved = [aligned(one, alignment) for one in brackets]
    # A frame that shows nothing in one channel is not trusted in the others: their edges are the same.
    absent = [reduce(np.logical_or, masks) for masks in zip(*(masks for _, masks in moved), strict=True)]
    whole = [one for one, _ in moved]
    return Placed(whole, [alignment.trimmed(one) for one in whole], absent, sentence)
