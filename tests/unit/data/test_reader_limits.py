"""Every reader of a file works within limits of memory, time and size, and says in one line what is wrong."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.data import reader_limits
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.errors import CaptureError, InputError, RadiometerError
from testing.reader_fuzz import bombs, seeds

_BYTES_ONLY = {"packet.xmp"}  # its reader takes bytes, which another reader has bounded

_BOMBS = bombs()


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Callable[[Path], Any]]:
    """Return every reader of the fuzz by the name of a file that it reads."""
    return {name: read for name, (_, read) in seeds(tmp_path_factory.mktemp("seeds")).items()}


def test_every_reader_refuses_what_has_no_end(readers: dict[str, Callable[[Path], Any]], tmp_path: Path) -> None:
    """A pipe that is never filled and a file of 3 TB that takes no room on the disk: at once, by name."""
    for name, read in readers.items():
        if name in _BYTES_ONLY:
            continue
        place = tmp_path / name.replace(".", "-")
        place.mkdir()
        os.mkfifo(place / name)
        with pytest.raises(RadiometerError, match="no regular file"):
            read(place / name)
        (place / name).unlink()
        with (place / name).open("wb") as sparse:
            sparse.truncate(3 * 10**12)
        with pytest.raises(RadiometerError, match="MB"):
            read(place / name)


@pytest.mark.parametrize("name", list(_BOMBS))
def test_a_bomb_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    """Unpacking, cycles, nesting, ranges and one wrong byte: no defect of the program, and no gigabytes."""
    content, read = _BOMBS[name]
    (tmp_path / name).write_bytes(content)
    begun = time.process_time()
    with pytest.raises(RadiometerError) as refusal:
        read(tmp_path / name)
    assert time.process_time() - begun < 20.0
    assert name in str(refusal.value)
    assert "\n" not in str(refusal.value)


def _all_of_it(path: Path) -> object:
    return np.empty(4_000_000_000, np.uint8)


def _for_ever(path: Path) -> object:
    while True:
        with contextlib.suppress(Exception):  # as libraries do
            time.process_time()


def _by_chance(path: Path) -> object:
    raise KeyError("TAG")


@pytest.mark.parametrize(
    ("read", "reason"),
    [(_all_of_it, "more than 2 GB of memory"), (_for_ever, "processor time"), (_by_chance, "damaged.*KeyError: 'TAG'")],
)
def test_whatever_a_library_does_becomes_one_line(
    read: Callable[[Path], object], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory, time, any error; afterwards the process is as free as before."""
    monkeypatch.setattr(reader_limits, "READER_SECONDS", 0.2)
    with pytest.raises(InputError, match=f"a.bin: .*{reason}"):
        bounded_reader(error=InputError)(read)(tmp_path / "a.bin")
    assert np.empty(2_500_000_000, np.uint8).nbytes == 2_500_000_000


def test_readers_in_several_threads_each_have_their_memory(tmp_path: Path) -> None:
    """Three of them hold 0.5 GB each under a limit of 1 GB for one, at the same time."""
    together = threading.Barrier(3, timeout=60.0)
    sizes = []

    @bounded_reader(1_000_000_000)
    def read(path: Path) -> None:
        held = np.ones(500_000_000, np.uint8)
        together.wait()
        sizes.append(held.nbytes)

    threads = [threading.Thread(target=read, args=(tmp_path / f"{n}",)) for n in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sizes == [500_000_000] * 3


@pytest.mark.parametrize("pack", ["gzip", "bz2", "lzma"])
def test_packed_bytes_come_out_as_they_went_in(pack: str, tmp_path: Path) -> None:
    """Several streams one after the other; up to the limit, and one byte more is refused; a cut stream as well."""
    compress = __import__(pack).compress
    content = compress(b"abc") + compress(b"def")
    assert unpacked(tmp_path, content, 6) == b"abcdef"
    assert unpacked(tmp_path, b"plain", 1) == b"plain"
    for wrong, most in ((content, 5), (content[:-1], 9), (content[:30], 9)):
        with pytest.raises(InputError):
            unpacked(tmp_path, wrong, most)


def test_a_reader_of_another_is_within_its_limits(tmp_path: Path) -> None:
    """An error of the inner reader keeps its own words."""

    @bounded_reader()
    def inner(path: Path) -> None:
        raise CaptureError("the inner one")

    with pytest.raises(CaptureError, match=r"^the inner one$"):
        bounded_reader()(lambda path: inner(path))(tmp_path)
