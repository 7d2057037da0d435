"""Asks whoever holds a light box to darken it: a socket for each open box, for programs of the same user."""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radiometer.data.storage import state_folder
from radiometer.errors import DeviceError, DeviceInUse, OutputError

STATE_VARIABLE: Final = "RADIOMETER_STATE"
_PATIENCE_S: Final = 3.0  # the box answers, or is dark by its dead-man timer, in less
_LONGEST_WORD: Final = 4400  # characters: a path of 4095 bytes, a serial number and a process


@dataclass(frozen=True, slots=True)
class HeldBox:
    """A light box that a program holds."""

    serial: str  # its serial number; empty where that program does not answer
    port: str  # the port it is on; empty where that program does not answer
    pid: int  # process that holds it
    address: Path | str  # socket on which that program can be asked: a file, or a name without one (unix(7))


def account_folder() -> Path:
    """Return where the account of retinal exposure is kept: in RADIOMETER_STATE, else in the XDG state folder.

    Every program that may light a box writes there, whatever session, service or scheduler started it.
    """
    return Path.home() / (os.environ.get(STATE_VARIABLE) or state_folder())


def own_folder(name: str) -> Path:
    """Return a folder of this user alone next to the account of retinal exposure, made where missing.

    Raises:
        OutputError: If it cannot be made, is no folder, or belongs to (or is open to) another user.
    """
    folder = account_folder() / name
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = folder.lstat()
    except OSError as error:
        raise OutputError(f"cannot make {folder}: {error.strerror or error}") from error
    if not is_ours(folder):
        raise OutputError(
            f"{folder} belongs to user {owner.st_uid} or is open to others (mode {owner.st_mode & 0o777:o}):"
            f" remove it, or set {STATE_VARIABLE} to a folder of your own"
        )
    return folder


def is_ours(folder: Path) -> bool:
    """Return whether a path is a folder, no link, of this user, into which no other user may write."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    return folder.is_dir() and not folder.is_symlink() and found.st_uid == os.getuid() and not found.st_mode & 0o022


def _held_here() -> str:
    """Return the name of this machine's folder of sockets: a home folder may be that of several machines."""
    return f"held-boxes-{os.uname().nodename}"


@contextmanager
def holding(serial: str, port: str, darken: Callable[[], None]) -> Iterator[None]:
    """Let other programs of this user ask for darkness while the block runs.

    Args:
        serial: Serial number of the box held.
        darken: Darkens every channel, or raises DeviceError; called from a separate thread.
    """
    own = f"{os.getpid()}-{threading.get_ident()}"
    file = own_folder(_held_here()) / f"{hashlib.sha256(port.encode()).hexdigest()[:12]}-{own}"
    with ExitStack() as held:
        for address in (file, f"{_of_port(port)}{own}"):
            held.enter_context(_listening(address, f"{serial} {os.getpid()} {port}", darken))
        yield


@contextmanager
def _listening(address: Path | str, name: str, darken: Callable[[], None]) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        with _short(address) as short:
            listener.bind(short)
        listener.listen(4)
        thread = threading.Thread(target=_serve, args=(listener, name, darken), name="box holder", daemon=True)
        thread.start()
        try:
            yield
        finally:
            if isinstance(address, Path):
                address.unlink(missing_ok=True)
            listener.shutdown(socket.SHUT_RDWR)
            thread.join(_PATIENCE_S)


def _of_port(port: str) -> str:
    """Return how the names of sockets begin that holders of a port listen on, whatever their state folder is."""
    real = hashlib.sha256(os.path.realpath(port).encode()).hexdigest()[:12]
    return f"\0radiometer-box-{os.getuid()}-{real}-"


def holder_of(port: str) -> HeldBox | None:
    """Return the program of this user that holds the light box on a port; None where none of this software does.

    It is found wherever it keeps its state, in this network namespace.
    """
    try:
        listening = Path("/proc/net/unix").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    beginning = _of_port(port).replace("\0", "@")
    for address in sorted({line.rpartition(" ")[2] for line in listening}):
        if address.startswith(beginning):
            name = address.replace("@", "\0", 1)
            words = _asked(name, "who").split(" ", 2)
            if len(words) == 3 and words[1].isdigit():
                return HeldBox(words[0], words[2], int(words[1]), name)
    return None


def held_boxes() -> list[HeldBox]:
    """Return the light boxes that programs of this user hold; what a killed program left behind is removed."""
    if not (account_folder() / _held_here()).exists():
        return []
    found = []
    for address in sorted(own_folder(_held_here()).iterdir()):
        words = _asked(address, "who").split(" ", 2)
        if len(words) == 3 and words[1].isdigit():
            found.append(HeldBox(words[0], words[2], int(words[1]), address))
        elif words == [""] and (pid := address.name.split("-")[1:2]) and pid[0].isdigit() and address.exists():
            found.append(HeldBox("", "", int(pid[0]), address))  # a program that was stopped, or hangs
    return sorted(found, key=lambda held: held.port)


def ask_for_darkness(held: HeldBox) -> None:
    """Have the program that holds a box darken it. Raises DeviceInUse if it does not answer."""
    if not held.serial or _asked(held.address, "off") != "dark":
        raise DeviceInUse(
            f"process {held.pid} holds light box {held.serial or '(its number is unknown)'} and does not darken it;"
            " end that process (the box goes dark 1 s after it fell silent), or hold the button of the box for 3 s"
        )


def darken_held() -> str:
    """Have every program of this user that holds a light box darken it, and return in words which boxes are dark.

    A box without a holder is dark by itself: without a host it ends its light within 1 s.

    Raises:
        DeviceInUse: If a program that holds one does not answer; the others were asked all the same.
    """
    failure: DeviceInUse | None = None
    dark = []
    for held in held_boxes():
        try:
            ask_for_darkness(held)
            dark.append(held.serial)
        except DeviceInUse as error:
            failure = error
    if failure is not None:
        raise failure
    return f"dark: light box {', '.join(dark)}" if dark else "no program holds a light box, so none is lit"


def _asked(address: Path | str, word: str) -> str:
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.settimeout(_PATIENCE_S)
            with _short(address) as short:
                line.connect(short)
            if _peer_uid(line) not in (os.getuid(), 0):
                return ""
            line.sendall(word.encode() + b"\n")
            with line.makefile("r", encoding="utf-8", errors="replace") as answer:
                return answer.readline(_LONGEST_WORD).strip()
    except ConnectionRefusedError:
        if isinstance(address, Path):
            address.unlink(missing_ok=True)
        return ""
    except OSError:
        return ""


@contextmanager
def _short(address: Path | str) -> Iterator[str]:
    """Name a socket by a path of few bytes: it may have 107, which folders in folders outgrow (unix(7))."""
    if isinstance(address, str):
        yield address
        return
    folder = os.open(address.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{address.name}"
    finally:
        os.close(folder)


def _serve(listener: socket.socket, name: str, darken: Callable[[], None]) -> None:
    while True:
        try:
            line, _ = listener.accept()
        except OSError:
            return  # the block has ended
        with line, contextlib.suppress(OSError):
            line.settimeout(_PATIENCE_S)
            if _peer_uid(line) not in (os.getuid(), 0):
                continue
            with line.makefile("r", encoding="utf-8", errors="replace") as asked:
                word = asked.readline(_LONGEST_WORD).strip()
            line.sendall(_answer(word, name, darken).encode() + b"\n")


def _answer(word: str, name: str, darken: Callable[[], None]) -> str:
    if word == "off":
        try:
            darken()
        except DeviceError:
            return "not dark"
        return "dark"
    return name if word == "who" else "?"


def _peer_uid(line: socket.socket) -> int:
    """Return the user of the process at the other end (Linux, unix(7): SO_PEERCRED)."""
    size = struct.calcsize("3i")
    _, uid, _ = struct.unpack("3i", line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    return int(uid)
