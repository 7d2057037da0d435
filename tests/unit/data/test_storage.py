"""Files are whole or absent, and a failure is stated in one line."""

import contextlib
import errno
import os
import re
import socket
import stat
from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.exports.maps import WRITERS, MapPicture, writer_for
from radiometer.data import CameraDescription, CaptureSet, CaptureSetWriter, Frame, FrameSettings, RadianceMap, storage
from radiometer.data.storage import read_text, read_yaml, write_text_atomic, write_yaml_atomic
from radiometer.errors import InputError, OutputError, OutputRefused


def _raising(number):
    """Return what a call to the system does that fails."""

    def fail(*_):
        raise OSError(number, os.strerror(number))

    return fail


def test_results_survive_a_full_disk_and_a_vanished_folder(tmp_path, monkeypatch):
    """The old file stays whole; the new one is saved elsewhere, which is named."""
    target = tmp_path / "result.yaml"
    target.write_text("old")

    monkeypatch.setattr(storage.os, "fsync", _raising(errno.ENOSPC))
    with pytest.raises(OutputError, match="No space left"):
        storage.write_text_atomic(target, "new")
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["result.yaml"]
    monkeypatch.undo()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with pytest.raises(OutputError, match=r"cannot write .*absent/x: No such file") as refusal:
        storage.write_text_atomic(tmp_path / "absent" / "x", "text")
    (saved,) = (tmp_path / "state").rglob("x")
    assert saved.read_text() == "text"
    assert str(saved) in str(refusal.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="the system's administrator may write everywhere")
def test_a_folder_that_takes_no_files_is_refused(tmp_path):
    """Before the work, by what the system itself says."""
    tmp_path.chmod(0o500)
    with pytest.raises(OutputRefused, match="takes no files"):
        storage.check_outputs(tmp_path / "map.exr")


@pytest.mark.parametrize(
    ("name", "force", "reason"),
    [
        ("new", False, None),
        ("there", False, "exists already"),
        ("there", True, None),
        ("folder", True, "it is a folder"),
        ("pipe", True, "no regular file"),
        ("link", False, "exists already"),
        ("absent/x", True, "does not exist"),
        ("there/x", True, "Not a directory"),
        ("n" * 300, True, "too long"),
        ("a\0b", True, "null"),
    ],
)
def test_an_output_is_refused_before_the_work(tmp_path, name, force, reason):
    """What exists, is no regular file, or has no folder that takes it; --force replaces regular files only."""
    (tmp_path / "there").touch()
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(OutputRefused, match=reason) if reason else contextlib.nullcontext():
        storage.check_outputs(tmp_path / name, None, force=force)


def test_outputs_are_two_files_and_folders_never_replaced(tmp_path):
    """By whatever way they are named; a new or empty folder is filled."""
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputRefused, match="two outputs"):
        storage.check_outputs(tmp_path / "x", tmp_path / "a" / ".." / "x")
    loop = tmp_path / "loop.exr"
    loop.symlink_to(loop)
    with pytest.raises(OutputRefused, match="leads back to itself"):
        storage.check_outputs(loop, force=True)
    with pytest.raises(OutputError, match="cannot write"):
        storage.write_text_atomic(loop, "new")
    storage.check_new_folder(tmp_path / "a")
    storage.check_new_folder(tmp_path / "b" / "c")
    (tmp_path / "file").touch()
    with pytest.raises(OutputRefused, match="Not a directory"):
        storage.check_new_folder(tmp_path / "file" / "b")
    for taken in (tmp_path, tmp_path / "file"):
        with pytest.raises(OutputRefused, match="name a new folder"):
            storage.check_new_folder(taken)


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_another_program_wrote_meanwhile_is_kept(tmp_path, monkeypatch, links):
    """Without --force only: its result is saved elsewhere; a file written twice by one program is its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    target = tmp_path / "map.exr"
    for force, held in ((True, "mine"), (False, "theirs")):
        with storage.new_files_stay_new():
            storage.check_outputs(target, force=force)
            target.write_text("theirs")
            with contextlib.nullcontext() if force else pytest.raises(OutputError, match=r"meanwhile.*saved as"):
                storage.write_text_atomic(target, "mine")
        assert target.read_text() == held
        target.unlink()
    if not links:  # as on FAT
        monkeypatch.setattr(storage.os, "link", _raising(errno.EPERM))
    with storage.new_files_stay_new():
        storage.check_outputs(target)
        storage.write_text_atomic(target, "first")
        storage.write_text_atomic(target, "second")
    assert target.read_text() == "second"
    assert [one.name for one in tmp_path.iterdir() if one.name.startswith(".")] == []


def test_a_replaced_file_keeps_its_mode_and_its_link(tmp_path):
    """A new file has the mode of the user's mask; a link goes on leading to the same, new file."""
    target, link = tmp_path / "a", tmp_path / "b"
    before = os.umask(0o027)
    try:
        storage.write_text_atomic(target, "1")
        assert target.stat().st_mode & 0o777 == 0o640
        target.chmod(0o604)
        link.symlink_to(target)
        storage.write_text_atomic(link, "2")
    finally:
        os.umask(before)
    assert (link.is_symlink(), target.read_text(), target.stat().st_mode & 0o777) == (True, "2", 0o604)


def make_socket(path):
    """Leave the name of a socket that no program listens on."""
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("make", [os.mkfifo, make_socket, os.mkdir])
def test_only_a_file_is_replaced(tmp_path, monkeypatch, make, linked):
    """A pipe, socket or folder stays what it is, also behind a link: so does a device, as /dev/null."""
    monkeypatch.chdir(tmp_path)  # the path of a socket has 108 bytes at most
    make(Path("there"))
    before = Path("there").stat()
    if linked:
        Path("link").symlink_to("there")
    with pytest.raises(OutputError, match=r"cannot write .*no regular file"):
        storage.write_bytes_atomic(Path("link" if linked else "there"), b"1", rescue=False)
    assert Path("there").stat().st_ino == before.st_ino
    assert {path.name for path in tmp_path.iterdir()} == {"there"} | ({"link"} if linked else set())


def test_text_is_read_without_marks_and_names_written_with_escapes(tmp_path):
    """A byte order mark is no part of a word; a folder of an old archive can be shown."""
    path = tmp_path / "t.csv"
    path.write_bytes(b"\xef\xbb\xbfwavelength_nm,W\n")
    assert read_text(path) == "wavelength_nm,W\n"
    path.write_bytes(b"abc\xff")
    with pytest.raises(InputError, match=r"is not a text file \(byte 3 is not UTF-8\)"):
        read_text(path)
    with pytest.raises(InputError, match=r"cannot read .*no\.csv: No such file"):
        read_text(tmp_path / "no.csv")
    write_text_atomic(tmp_path / "t.txt", "by\udcff")
    write_yaml_atomic(tmp_path / "y.yaml", {"by\udcff": ["µm", "\udcff"]})
    assert read_text(tmp_path / "t.txt") == r"by\udcff"
    assert read_yaml(tmp_path / "y.yaml") == {r"by\udcff": ["µm", r"\udcff"]}


@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o002, 0o664)])
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
    """A power cut leaves the old file or the whole new one: the content is flushed before the name, then its folder."""
    path, steps, (fsync, replace) = tmp_path / f"result{ending}", [], (os.fsync, os.replace)

    def flushed(file):
        found = os.fstat(file)
        steps.append("folder" if stat.S_ISDIR(found.st_mode) else found.st_size)
        fsync(file)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", lambda old, new: steps.append(new) or replace(old, new))
    write(path)
    assert steps == [path.stat().st_size, path, "folder"]
    assert steps[0] > 0


def write(path):
    """Write a text file, or a map of 2 × 2 pixels in the form that the ending names."""
    if path.suffix == ".txt":
        return storage.write_text_atomic(path, "text")
    one = np.ones((2, 2), np.float32)
    grey = RadianceMap(one, 0.1 * one, np.zeros((2, 2), np.uint8), "relative")
    return writer_for(path)(path, MapPicture({"mono": grey}))


@pytest.mark.parametrize("taken", [2, 4])
def test_frames_that_the_disk_does_not_take_are_finished_elsewhere(tmp_path, monkeypatch, taken):
    """A full disk at the third of four frames, or after all: the set is whole in the state folder, which is named."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    out, fsync = tmp_path / "set", os.fsync

    def full(file):
        is_in_set = Path(f"/proc/self/fd/{file}").readlink().is_relative_to(out)
        if is_in_set and len(list(tmp_path.rglob("*.png"))) >= taken:
            raise OSError(errno.ENOSPC, "No space left on device")
        fsync(file)

    def capture():
        with CaptureSetWriter(out, CameraDescription(bit_depth=12)) as writer:
            for number in range(4):
                writer.add(Frame(np.full((4, 5), number, np.uint16), 12, FrameSettings(0.01)))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=r"No space left.*the finished capture set is saved as ") as refusal:
        capture()
    saved = CaptureSet.read(Path(re.search(r"saved as (.*): move", str(refusal.value))[1]))
    assert [int(frame.dn[0, 0]) for frame in saved.frames()] == [0, 1, 2, 3]
    assert not out.exists()


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
