"""Files are whole or absent, and a failure is said in one line."""

from __future__ import annotations

import errno
import os

import pytest

from radiometer.data import storage
from radiometer.data.storage import read_text
from radiometer.errors import InputError, OutputError


def test_a_full_disk_leaves_the_old_file_whole(tmp_path, monkeypatch):
    """The new content never appears in part; the old stays; nothing else is left in the folder."""
    target = tmp_path / "result.yaml"
    target.write_text("old")

    def full(_descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(storage.os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        storage.write_text_atomic(target, "new")
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["result.yaml"]


def test_an_unwritable_place_is_named(tmp_path):
    """The message says which file and why."""
    with pytest.raises(OutputError, match=r"cannot write .*absent/x: No such file"):
        storage.write_text_atomic(tmp_path / "absent" / "x", "text")


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch):
    """A folder, a file in a folder that is not there, and one that takes no files; a file that can be is not."""
    storage.refuse_unwritable(tmp_path / "map.exr")
    with pytest.raises(OutputError, match="it is a folder"):
        storage.refuse_unwritable(tmp_path)
    with pytest.raises(OutputError, match=r"the folder .*absent does not exist"):
        storage.refuse_unwritable(tmp_path / "absent" / "map.exr")
    monkeypatch.setattr(storage.os, "access", lambda folder, mode: (folder, mode) != (tmp_path, os.W_OK | os.X_OK))
    with pytest.raises(OutputError, match="takes no files"):
        storage.refuse_unwritable(tmp_path / "map.exr")


def test_an_exception_of_the_writer_leaves_nothing(tmp_path):
    """Whatever goes wrong in the block, no file appears."""

    def fail():
        with storage.atomic_file(tmp_path / "x") as stream:
            stream.write("half")
            raise KeyError("boom")

    with pytest.raises(KeyError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_text_is_read_without_an_editor_s_mark(tmp_path):
    """A byte order mark is no part of the first word; what is no text is told by the place of its first wrong byte."""
    path = tmp_path / "t.csv"
    path.write_bytes(b"\xef\xbb\xbfwavelength_nm,W\n")
    assert read_text(path) == "wavelength_nm,W\n"
    path.write_bytes(b"abc\xff")
    with pytest.raises(InputError, match=r"is not a text file \(byte 3 is not UTF-8\)"):
        read_text(path)
    with pytest.raises(InputError, match=r"cannot read .*no\.csv: No such file"):
        read_text(tmp_path / "no.csv")
