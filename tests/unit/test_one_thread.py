"""BLAS is held to one thread where matrices are small."""

import pytest
from threadpoolctl import threadpool_info

from radiometer.data import CameraDescription, CaptureHeader, FrameEntry, FrameSettings
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.engine import examine


class Stopped(Exception):
    pass


def _threads():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_blas_is_held_to_one_thread_and_released():
    """Inside, BLAS has one thread; afterwards what it had before."""
    before = _threads()
    assert set(on_one_blas_thread(_threads)()) == {1}
    assert _threads() == before


def test_reconcile_works_on_one_thread():
    """From the first frame that it reads on, all that `reconcile` solves is held to one thread."""
    entries = tuple(FrameEntry.of(f"{i}.png", FrameSettings(exposure_s)) for i, exposure_s in enumerate((1e-3, 2e-3)))
    seen = []

    def read(index):
        seen.extend(_threads())
        raise Stopped

    with pytest.raises(Stopped):
        examine(CaptureHeader(camera=CameraDescription(bit_depth=12), frames=entries), read, (32, 32))
    assert set(seen) == {1}
