"""Runs readers apart: in a process that may be ended where a compiled library hangs, crashes or takes all memory.

The process is started at the first such file (some 0.4 s of processor time) and serves further ones. It limits the
damage that a damaged file does. It is no protection against a file that is made to take over the process.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
import pickle
import resource
import select
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

_HEAD: Final = struct.Struct("<QQ")  # bytes of the pickle, number of its arrays
_SIZE: Final = struct.Struct("<Q")
_MOST_REQUEST_BYTES: Final = 10_000_000  # names of files and what a user states of them
_MOST_ARRAYS: Final = 10_000
_GRACE_S: Final = 5.0  # Python's own limit of time comes first and says more
# A computer on which twenty programs wait for each core still decodes within its limit of processor time.
_WALL_FACTOR: Final = 20.0
_PIECE: Final = 1 << 20
_PIPE_BYTES: Final = 1 << 20
_F_SETPIPE_SZ: Final = 1031  # fcntl(2) of Linux
# -P is not used: the folders of the caller's path, in its order, are where its modules come from.
_CODE: Final = (
    "import sys; sys.path[:] = sys.argv[1:]; from radiometer.data.reader_process import serve_readers; serve_readers()"
)


class ReaderEnded(Exception):
    """The process of a reader has ended, or was ended, before it answered; its text says why."""


class _Inside:
    """Whether this process is the one that reads for another."""

    value = False


@dataclass(slots=True)
class _Reader:
    """A process that waits for a file to read, and the pipe on which it answers."""

    process: subprocess.Popen[bytes]
    answers: int

    def end(self) -> None:
        """End it, whatever it does."""
        self.process.kill()
        self.process.wait()
        with contextlib.suppress(OSError):
            self.process.stdin.close()  # type: ignore[union-attr]
        os.close(self.answers)


class _Idle:
    """Processes of this process that wait; what a fork inherits belongs to its parent."""

    def __init__(self) -> None:
        self.pid, self.readers = os.getpid(), list[_Reader]()

    def take(self) -> _Reader:
        """Return one that waits, or a new one. Lists are changed in one step, so that threads need no lock."""
        if self.pid != os.getpid():
            self.pid, self.readers = os.getpid(), []
        try:
            return self.readers.pop()
        except IndexError:
            return _started()


_IDLE: Final = _Idle()


def is_inside() -> bool:
    """Return whether this process is the one that reads for another."""
    return _Inside.value


def run_apart(
    read: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], *, processor_s: float, most_bytes: int
) -> Any:
    """Return what a reader returns, or raise what it raises, run in another process.

    Args:
        read: A function of a module that can be imported.
        args: Its arguments.
        kwargs: Its arguments by name.
        processor_s: Processor time that it may take in s.
        most_bytes: Most bytes that it may return.

    Raises:
        ReaderEnded: If the process crashed, or took longer.
        MemoryError: If it returns more.
    """
    reader = _IDLE.take()
    try:
        request = pickle.dumps((read.__module__, read.__qualname__, args, kwargs, processor_s))
        _write(reader.process.stdin, _SIZE.pack(len(request)) + request)
        end_s = time.monotonic() + _WALL_FACTOR * processor_s
        succeeded, value = _answer(reader, end_s, most_bytes)
    except (ReaderEnded, OSError) as error:
        reader.end()
        raise ReaderEnded(str(error) if isinstance(error, ReaderEnded) else _why(reader)) from error
    except BaseException:  # an interrupt, or too much: its answer is still under way
        reader.end()
        raise
    _IDLE.readers.append(reader)
    if succeeded:
        return value
    raise value


def _started() -> _Reader:
    answers, theirs = os.pipe()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", _CODE, *sys.path], stdin=subprocess.PIPE, stdout=theirs, stderr=subprocess.DEVNULL,
            process_group=0,  # an interrupt at the terminal is for its parent, which ends it
        )  # fmt: skip
    except OSError as error:
        os.close(answers)
        raise ReaderEnded(f"no process could be started for it ({error.strerror or error})") from error
    finally:
        os.close(theirs)
    return _Reader(process, answers)


def _answer(reader: _Reader, end_s: float, most_bytes: int) -> tuple[bool, Any]:
    """Return whether a reader succeeded, and what it returned or raised."""
    size, count = _HEAD.unpack(_read(reader, _HEAD.size, end_s))
    if size > most_bytes or count > _MOST_ARRAYS:
        raise MemoryError
    pickled, arrays, left = _read(reader, size, end_s), list[bytearray](), most_bytes
    for _ in range(count):
        (size,) = _SIZE.unpack(_read(reader, _SIZE.size, end_s))
        if (left := left - size) < 0:
            raise MemoryError
        arrays.append(_read(reader, size, end_s))
    return pickle.loads(pickled, buffers=arrays)  # type: ignore[no-any-return]


def _read(reader: _Reader, size: int, end_s: float) -> bytearray:
    """Return so many bytes. Raises ReaderEnded where they do not come in time."""
    content, at = bytearray(size), 0
    view = memoryview(content)
    while at < size:
        if not select.select([reader.answers], [], [], max(end_s - time.monotonic(), 0.0))[0]:
            raise ReaderEnded("reading it never ends")
        if not (got := os.readv(reader.answers, [view[at : at + _PIECE]])):
            raise ReaderEnded(_why(reader))
        at += got
    return content


def _why(reader: _Reader) -> str:
    """Return why a process has ended."""
    try:
        code = reader.process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        return "reading it failed"
    if code == -24:  # SIGXCPU
        return "reading it takes too much processor time"
    return f"the library that reads it crashed (exit code {code})"


@atexit.register
def _end_all() -> None:
    if _IDLE.pid == os.getpid():
        while _IDLE.readers:
            _IDLE.readers.pop().end()


def serve_readers() -> None:
    """Read files for the parent until it ends: the body of the process."""
    _Inside.value = True
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1):  # what libraries print is no answer
        os.dup2(null, standard)
    with contextlib.suppress(OSError):
        import fcntl

        fcntl.fcntl(answers, _F_SETPIPE_SZ, _PIPE_BYTES)
    while len(head := requests.read(_SIZE.size)) == _SIZE.size:
        (size,) = _SIZE.unpack(head)
        if size > _MOST_REQUEST_BYTES:
            return
        module, name, args, kwargs, processor_s = pickle.loads(requests.read(size))
        read: Any = importlib.import_module(module)
        for part in name.split("."):
            read = getattr(read, part)
        _limit_processor_time(processor_s + _GRACE_S)
        try:
            answer = True, read(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 (whatever it is, the parent gets it)
            answer = False, error
        _send(answers, answer)


def _limit_processor_time(seconds: float) -> None:
    """Have the system end this process once it has taken so much more processor time, whatever it does then."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft = int(used.ru_utime + used.ru_stime + seconds) + 1
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))


def _send(stream: BinaryIO, answer: tuple[bool, Any]) -> None:
    """Write an answer: its pickle, then its arrays as they are."""
    buffers = list[pickle.PickleBuffer]()
    try:
        pickled = pickle.dumps(answer, protocol=5, buffer_callback=buffers.append)
    except Exception as error:  # noqa: BLE001 (an error of a library may hold what has no bytes)
        pickled, buffers = pickle.dumps((False, RuntimeError(f"{type(answer[1]).__name__}: {error}"))), []
    _write(stream, _HEAD.pack(len(pickled), len(buffers)) + pickled)
    for buffer in buffers:
        with buffer.raw() as raw:
            _write(stream, _SIZE.pack(raw.nbytes))
            _write(stream, raw)


def _write(stream: Any, content: bytes | memoryview) -> None:
    stream.write(content)
    stream.flush()
