"""`radiometer` with the simulated camera of each bench behind the GigE Vision protocol, and a hand at the bench.

    python -m testing.wire_program measure --bench lab.yaml

Commands that open a bench's camera get one on the wire, served in this process until they end. The others run as they
are: a simulated display or light box is seen by the simulated camera of the same process alone.
"""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

from radiometer.bench.config import DEFAULT_BENCH
from radiometer.bench.served import served_camera
from radiometer.data.storage import shipped_config
from simulators.cameras.blackfly_gige import BlackflyGige, ForwardModelSource
from testing.wire import LOOPBACK, only_camera, radiometer

OPEN_A_CAMERA: Final = ("measure", "bracket", "serve")
_ASKED: Final = re.compile(r"([^\n]*)\. Done\? \[Y/n\]:$")  # the last words that a person at the terminal is shown
_PATTERN: Final = re.compile(r"show the pattern '(\w+)'", re.IGNORECASE)


def main(words: list[str]) -> int:
    """Run a command line and return its exit code."""
    if words[:1] not in [[one] for one in OPEN_A_CAMERA] or "--camera" in words:
        return subprocess.call(radiometer(*words))
    if "--bench" not in words:  # a camera that is named stands on no bench by itself
        words = [*words, "--bench", str(shipped_config(DEFAULT_BENCH))]
    bench = Path(words[words.index("--bench") + 1])
    with only_camera(), served_camera(bench, real_time=False) as camera:
        return _at_a_terminal(radiometer(*words, "--camera", LOOPBACK), camera)


def _at_a_terminal(command: list[str], camera: BlackflyGige) -> int:
    """Run a command, pass its errors on, and do at the bench what it asks for."""
    keyboard, terminal = pty.openpty()
    child = subprocess.Popen(command, stdin=terminal, stderr=subprocess.PIPE)
    signal.signal(signal.SIGTERM, lambda number, _: child.send_signal(number))
    assert child.stderr is not None
    shown = b""
    while part := os.read(child.stderr.fileno(), 4096):
        os.write(sys.stderr.fileno(), part)
        shown = (shown + part)[-200:]
        if asked := _ASKED.search(shown.decode(errors="replace").rstrip()):
            _do(asked[1], camera)
            os.write(keyboard, b"\n")
            shown = b"\n"
    return child.wait()


def _do(wish: str, camera: BlackflyGige) -> None:
    """Put the cap on or off and show a pattern, as wished."""
    if "cover the lens" in wish.lower():
        camera.cap(on="uncover" not in wish.lower())
    if (pattern := _PATTERN.search(wish)) and isinstance(camera.source, ForwardModelSource):
        camera.source.show(pattern[1])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
