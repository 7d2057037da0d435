"""Limits of memory, time and size for every reader of a file, whatever library it uses, and one line where it fails.

Readers of libraries that may hang, crash or take all memory work apart, in a process. It is started at the first such
file (some 0.4 s of processor time) and serves further ones. It limits the damage that a damaged file does. It is no
protection against a file that is made to take over the process.
"""

from __future__ import annotations

import atexit
import bz2
import contextlib
import ctypes
import functools
import importlib
import lzma
import os
import pickle
import resource
import select
import stat
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, Final, ParamSpec, TypeVar

from radiometer.data.guards import MOST_FILE_BYTES
from radiometer.errors import CaptureError, InputError, RadiometerError

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
    "import sys; sys.path[:] = sys.argv[1:]; from radiometer.data.reader_limits import serve_readers; serve_readers()"
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


READER_BYTES: Final = 2_000_000_000  # a picture of 400 MB, decoded, converted and copied
RAW_READER_BYTES: Final = 5_000_000_000  # 151 million raw pixels: LibRaw keeps four values of 16 bits for each
_AGAIN_S: Final = 0.1  # between two attempts to end a reader: a library may keep the first one to itself
READER_SECONDS: Final = 60.0  # of processor time; the largest pictures take some 5 s
_P = ParamSpec("_P")
_R = TypeVar("_R")
_PACKED: Final[dict[bytes, Callable[[], Any]]] = {
    b"\x1f\x8b": functools.partial(zlib.decompressobj, 16 + zlib.MAX_WBITS),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ": lzma.LZMADecompressor,
}
_LOCK: Final = threading.Lock()
_THREAD: Final = threading.local()


class _TooLong(BaseException):
    """The time of a reader is over: no `except Exception` of a library may keep it."""


class _Budget:
    """The memory that readers at work may take together; kept for the process, as the system counts it so."""

    def __init__(self) -> None:
        self.readers, self.granted, self.before = 0, 0, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)


_BUDGET: Final = _Budget()


def bounded_reader(
    memory_bytes: int = READER_BYTES, *, error: type[RadiometerError] = CaptureError, apart: str = ""
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Return a decorator that keeps a reader of a file within limits.

    The first argument of the reader that is a path names the file. It must be a regular file of at most
    `MOST_FILE_BYTES`; a folder or a missing file is left to the reader. Whatever a damaged file makes a library raise
    becomes one line that names the file.

    Most readers work in this process. What they do is Python, or decodes in a time that grows with a size which is
    refused before (`refuse_large_picture`, `refuse_size`, `unpacked`). A reader whose compiled library may hang or
    crash on a damaged file works apart (`reader_process`): LibRaw, OpenEXR, Parquet, compressed FITS, what Pillow
    decodes in TIFF, and R's files, whose structure may refer to itself.

    Args:
        memory_bytes: Memory in bytes that the reader may take beyond what the process has.
        error: Kind of error that names the file.
        apart: Library for which the file is read in another process; "" to read it here. Such a reader is a function
            of a module, with plain arguments and results. Where the library is missing, the reader says so here.
    """

    def decorate(read: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(read)
        def bounded(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if apart and not is_inside() and find_spec(apart) is not None:
                return _read_apart(bounded, args, kwargs, memory_bytes, error)
            if getattr(_THREAD, "reading", False):  # within the limits of the reader that asked for this one
                return read(*args, **kwargs)
            path = next((one for one in args if isinstance(one, Path)), None)
            if path is not None:
                refuse_endless(path, error)
            where = str(path) if path is not None else "the data"
            _THREAD.reading = True
            try:
                with _limited_memory(memory_bytes), _limited_time():
                    return read(*args, **kwargs)
            except RadiometerError:
                raise
            except MemoryError as failure:
                raise error(
                    f"{where}: reading it takes more than {memory_bytes / 1e9:g} GB of memory; look whether the file is"
                    " what it says"
                ) from failure
            except _TooLong as failure:
                raise error(
                    f"{where}: reading it takes more than {READER_SECONDS:g} s of processor time; look whether the file"
                    " is what it says"
                ) from failure
            except OSError as failure:
                raise error(f"cannot read {where}: {failure.strerror or _one_line(failure)}") from failure
            except Exception as failure:  # a damaged file makes libraries raise nearly anything
                if path is None:
                    raise
                reason = f"{type(failure).__name__}: {_one_line(failure)}"
                raise error(f"{where}: damaged, or of a form that is not read ({reason})") from failure
            finally:
                _THREAD.reading = False

        return bounded

    return decorate


def _one_line(failure: BaseException) -> str:
    return (str(failure).strip().splitlines() or [""])[0][:200]


def _read_apart(
    read: Callable[..., _R], args: tuple[Any, ...], kwargs: dict[str, Any], memory_bytes: int,
    error: type[RadiometerError],
) -> _R:  # fmt: skip
    path = next(one for one in args if isinstance(one, Path))
    refuse_endless(path, error)
    try:
        found: _R = run_apart(read, args, kwargs, processor_s=READER_SECONDS, most_bytes=memory_bytes)
    except ReaderEnded as failure:
        raise error(f"{path}: {failure}; look whether the file is what it says") from failure
    except MemoryError as failure:
        raise error(f"{path}: holds more than {memory_bytes / 1e9:g} GB; look whether it is what it says") from failure
    return found


def refuse_endless(path: Path, error: type[RadiometerError] = InputError) -> None:
    """Refuse a file that has no end, or is larger than any that is read.

    Raises:
        InputError: If it is a device, pipe or socket, or larger than `MOST_FILE_BYTES`.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):
        return  # its reader names what is missing
    if stat.S_ISDIR(found.st_mode):
        return
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path}: no regular file (a device, pipe or socket); save its content as a file first")
    if found.st_size > MOST_FILE_BYTES:
        raise error(f"{path}: {found.st_size / 1e6:.0f} MB; at most {MOST_FILE_BYTES / 1e6:.0f} MB are read")


def unpacked(path: Path, content: bytes, most_bytes: int) -> bytes:
    """Return the bytes of a gzip, bzip2 or xz file, unpacked no further than a limit; others as they are.

    Args:
        path: The file, for the message.
        content: Its bytes.
        most_bytes: Most bytes once unpacked.

    Raises:
        InputError: If there are more, or the stream is damaged or ends too early.
    """
    pieces, size = list[bytes](), 0
    try:
        while kind := next((kind for magic, kind in _PACKED.items() if content.startswith(magic)), None):
            unpacker = kind()
            pieces.append(unpacker.decompress(content, most_bytes + 1 - size))
            size += len(pieces[-1])
            if size > most_bytes:
                raise InputError(f"{path}: more than {most_bytes / 1e6:g} MB once unpacked; unpack and cut it first")
            if not unpacker.eof:
                raise InputError(f"{path}: its packed data end too early; copy it again")
            content = unpacker.unused_data  # several packed files may stand one after the other
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise InputError(f"{path}: its packed data are damaged ({error}); copy it again") from error
    return b"".join(pieces) if pieces else content


@contextmanager
def _limited_memory(extra_bytes: int) -> Iterator[None]:
    """Let the process take so many bytes more while the block runs; readers in other threads add theirs."""
    with _LOCK:
        if not _BUDGET.readers:
            _BUDGET.before = resource.getrlimit(resource.RLIMIT_AS)
            _BUDGET.granted = _virtual_bytes()
        _BUDGET.readers += 1
        _BUDGET.granted += extra_bytes
        _set_limit(_BUDGET.granted)
    try:
        yield
    finally:
        with _LOCK:
            _BUDGET.readers -= 1
            if _BUDGET.readers:
                _BUDGET.granted -= extra_bytes
                # What finished readers returned is the process's now: the others keep the room they were promised.
                _BUDGET.granted = max(_BUDGET.granted, _virtual_bytes())
                _set_limit(_BUDGET.granted)
            else:
                resource.setrlimit(resource.RLIMIT_AS, _BUDGET.before)


def _set_limit(size: int) -> None:
    soft, hard = _BUDGET.before
    known = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([size, *known]), hard))


def _virtual_bytes() -> int:
    """Return the address space of the process in bytes (proc(5), statm: pages)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()


@contextmanager
def _limited_time() -> Iterator[None]:
    """End the block after `READER_SECONDS` of processor time of its thread, as soon as Python runs in it."""
    reader, lock = threading.get_ident(), threading.Lock()
    done, over = threading.Event(), threading.Event()
    clock = time.pthread_getcpuclockid(reader)
    end_s = time.clock_gettime(clock) + READER_SECONDS

    def watch() -> None:
        while not done.wait(max(end_s - time.clock_gettime(clock), _AGAIN_S)):
            with lock:
                if not done.is_set() and time.clock_gettime(clock) >= end_s:
                    over.set()
                    _raise_in(reader, _TooLong)

    watcher = threading.Thread(target=watch, name="reader's time", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        with lock:
            done.set()
            # What was raised and has not arrived. Where nothing was, Python 3.11 would look for it at each later step.
            if over.is_set():
                _raise_in(reader, None)
        watcher.join()


def _raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Raise an error in a thread, once Python runs there; None takes one back that has not arrived yet."""
    given = ctypes.py_object(error) if error is not None else None
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)
