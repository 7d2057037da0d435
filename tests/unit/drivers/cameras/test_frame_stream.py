from __future__ import annotations

import pytest

from drivers.cameras.frame_stream import missed_between


@pytest.mark.parametrize(
    ("last_id", "frame_id", "missed"),
    [
        (None, 65401, 0),
        (7, 8, 0),
        (7, 10, 2),
        (65535, 1, 0),
        (65534, 2, 2),
        (10, 9, -1),
        (1, 65535, -1),
        (70_000, 70_003, 2),
        (70_003, 70_001, -1),
    ],
    ids=[
        "first",
        "next",
        "gap",
        "wrap",
        "gap over the wrap",
        "late",
        "late over the wrap",
        "64-bit gap",
        "64-bit late",
    ],
)
def test_gaps_in_running_numbers_are_counted(last_id, frame_id, missed):
    """Frames that never arrived are counted, over the 16-bit wrap too; a late one is taken back."""
    assert missed_between(last_id, frame_id) == missed
