"""Files are whole or absent, and a failure is said in one line."""

from __future__ import annotations

import errno
import os
import stat

import numpy as np
import pytest

from radiometer.analysis.exports.maps import WRITERS, MapPicture, writer_for
from radiometer.data import RadianceMap, storage
from radiometer.data.storage import read_text, read_yaml
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


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
@pytest.mark.parametrize("ending", [".txt", *WRITERS])
def test_a_file_may_be_read_by_whom_the_user_s_mask_allows(tmp_path, ending, mask, mode):
    """The owner alone under 077, members of the group too under 002: neither more nor fewer."""
    before = os.umask(mask)
    try:
        write(tmp_path / f"result{ending}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / f"result{ending}").stat().st_mode) == mode


@pytest.mark.parametrize("ending", [".txt", *WRITERS])
def test_a_file_gets_its_name_when_its_content_is_on_the_disk(tmp_path, monkeypatch, ending):
    """A power cut leaves the old file or the whole new one: what is renamed was flushed before."""
    path, steps, (fsync, replace) = tmp_path / f"result{ending}", [], (os.fsync, os.replace)
    monkeypatch.setattr(os, "fsync", lambda file: steps.append(os.fstat(file).st_size) or fsync(file))
    monkeypatch.setattr(os, "replace", lambda old, new: steps.append(new) or replace(old, new))
    write(path)
    assert steps == [path.stat().st_size, path]
    assert steps[0] > 0


def write(path):
    """Write a text file, or a map of 2 × 2 pixels in the form that the ending names."""
    if path.suffix == ".txt":
        return storage.write_text_atomic(path, "text")
    one = np.ones((2, 2), np.float32)
    grey = RadianceMap(one, 0.1 * one, np.zeros((2, 2), np.uint8), "relative")
    return writer_for(path)(path, MapPicture({"mono": grey}))


@pytest.mark.parametrize(
    ("text", "key", "line"),
    [
        ("limit: 1\nlimit: 2\n", "limit", 2),
        ("channels:\n  spot: {bound: 1}\n  field: {bound: 2}\n  spot: {bound: 3}\n", "spot", 4),
        ("flash: {bound: 1, duration: 2, bound: 3}\n", "bound", 1),
        ("a: 1\n'a': 2\n", "a", 2),
    ],
)
def test_a_key_that_occurs_twice_is_refused(tmp_path, text, key, line):
    """Of two bounds for one channel neither is chosen; what an anchor brings in may be replaced."""
    file = tmp_path / "preset.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"line {line}, .* key '{key}' occurs twice"):
        read_yaml(file)
    file.write_text("base: &base {bound: 1}\nspot: {<<: *base, bound: 2}\n", encoding="utf-8")
    assert read_yaml(file)["spot"] == {"bound": 2}
