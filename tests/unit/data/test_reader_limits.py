"""Every reader of a file works within limits of memory, time and size, and says in one line what is wrong."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiometer.data import reader_limits
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.errors import CaptureError, InputError, RadiometerError
from testing import faulty_readers
from testing.reader_fuzz import bombs, fuzz, hostile, seeds

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


@pytest.mark.parametrize(
    ("read", "reason"),
    [
        (faulty_readers.crash, "the library that reads it crashed"),
        (faulty_readers.end, "the library that reads it crashed"),
        (faulty_readers.hang, "never ends"),
        (faulty_readers.take_memory, "more than 0.1 GB of memory"),
        (faulty_readers.stumble, "damaged.*KeyError: 'TAG'"),
        (faulty_readers.refuse, "gain 50 dB is out of range"),
    ],
)
def test_what_a_library_does_in_another_process_ends_that_process_at_most(
    read: Callable[[Path], object], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line each; the next file is read, its numbers to the bit, whatever the library prints."""
    file = tmp_path / "a.bin"
    file.write_bytes(b"abc")
    faulty_readers.read(file)  # has the process started
    monkeypatch.setattr(reader_limits, "READER_SECONDS", 0.2)
    with pytest.raises(RadiometerError, match=reason):
        read(file)
    monkeypatch.undo()
    pid, numbers, facts = faulty_readers.read(file)
    assert pid != os.getpid()
    assert np.array_equal(numbers, np.arange(2_000_000, dtype=np.uint16))
    numbers[0] = 1  # it is the caller's own
    assert facts == {"a": 3.0}


def test_readers_of_several_threads_work_apart_at_the_same_time(tmp_path: Path) -> None:
    """Each thread gets its own answer."""
    for number in range(8):
        (tmp_path / f"{number}").write_bytes(b"x" * number)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda number: faulty_readers.read(tmp_path / f"{number}")[2]["a"], range(8)))
    assert found == list(range(8))


def test_time_is_limited_in_every_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader in a thread of a pool ends as one in the main thread does."""
    monkeypatch.setattr(reader_limits, "READER_SECONDS", 0.2)
    with ThreadPoolExecutor(1) as pool, pytest.raises(InputError, match="processor time"):
        pool.submit(bounded_reader(error=InputError)(_for_ever), tmp_path / "a.bin").result()


@pytest.mark.slow
def test_every_reader_refuses_files_made_to_harm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Bombs, loops, nesting and noise under each name, then damaged files: one line of our own, in 10 s each."""
    folder = tmp_path_factory.mktemp("harm")
    for name, seeded in seeds(folder).items():
        place = folder / f"harm {name}"
        place.mkdir()
        (place / "a.png").write_bytes((folder / "a.png").read_bytes())
        found = fuzz(place, name, len(hostile()) + 8, 3, seeded)
        assert found.faults == []
        assert found.refused > len(hostile()) // 2 or name in _BYTES_ONLY
        assert found.longest_s < 10.0


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
