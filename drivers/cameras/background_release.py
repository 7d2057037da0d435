"""Lets go of a camera that is gone without waiting for it.

When the library's objects end, they say goodbye to the camera: the stream closes its channel, the device gives up
control. Each goodbye to a camera that no longer answers waits 2.5 s, in whichever thread drops the object last.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import suppress
from typing import Any, Final

_OWN_REFERENCES: Final = 2  # that of the list, and that of the question itself
_LOOK_S: Final = 0.05  # short against the 2.5 s that each goodbye may wait
_PATIENCE_S: Final = 60.0  # an exception may hold an object for a while; a minute later it is dropped whoever holds it
# A second between two heartbeats, 5 s in which one is repeated, five times 0.5 s for the last of them (Aravis 0.8).
HEARTBEAT_S: Final = 10.0


def drop_in_background(*objects: Any) -> None:
    """Take over objects of the library, and drop them in a separate thread once no other code holds them.

    Args:
        *objects: Objects to let go, in the order in which they are to end. The caller drops its own references, which
            an exception on its way up may hold a while longer.
    """
    threading.Thread(target=_drop, args=(list(objects),), name="camera release", daemon=True).start()


def give_up_in_background(camera: Any, library_error: type[Exception]) -> None:
    """Take a camera of the library over that was lost; give up control and drop it once its heartbeat is over.

    A camera that is back by now is free for others as soon as control is given up.

    Args:
        camera: An `Aravis.Camera`.
        library_error: The exception class of the library, `GLib.Error`.
    """
    threading.Thread(target=_give_up, args=([camera], library_error), name="camera release", daemon=True).start()


def _give_up(kept: list[Any], library_error: type[Exception]) -> None:
    if kept[0].is_gv_device():
        with suppress(library_error):  # it is gone: that it does not answer is no news
            kept[0].get_device().leave_control()
        time.sleep(HEARTBEAT_S)
    _drop(kept)


def _drop(kept: list[Any]) -> None:
    give_up = time.monotonic() + _PATIENCE_S
    while kept:
        if sys.getrefcount(kept[0]) > _OWN_REFERENCES and time.monotonic() < give_up:
            time.sleep(_LOOK_S)
        else:
            del kept[0]
