"""Guards against files that would take all memory or time."""

from __future__ import annotations

import contextlib
import math
import os
import struct
import threading
import time
import unicodedata
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import example, given
from hypothesis import strategies as st

from radiometer.cli.main import run
from radiometer.data import reader_limits
from radiometer.data.capture_set import read_digital_numbers
from radiometer.data.guards import (
    MOST_PICTURE_BYTES,
    is_file,
    refuse_deep_yaml,
    refuse_large_picture,
    refuse_size,
    safe_file_name,
    safe_name,
)
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.data.storage import read_yaml
from radiometer.errors import CaptureError, ConfigurationError, InputError, MissingLibrary, RadiometerError, UsageError
from radiometer.reporting.plain_text import one_line, printable, spreadsheet_cell
from simulators.scenes.image_file import ImageScene
from testing import faulty_readers
from testing.reader_fuzz import Fuzzed, bombs, fuzz, hostile, seeds


def _png(width: int, height: int, bits: int = 16, colour: int = 0, data: bytes = b"") -> bytes:
    """Return a PNG with the header stated and data that need not fit it."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


@pytest.mark.parametrize(
    "content",
    [
        _png(80_000, 80_000),
        _png(20_000, 20_001, 8),
        _png(8_000, 8_500, 16, colour=2),
        _png(2**31 - 1, 2**31 - 1, 16, colour=6),
    ],
)
def test_a_picture_bomb_is_refused_by_its_header(tmp_path, content):
    """Some bytes that state gigapixels are never decoded; the message gives the size and the limit."""
    path = tmp_path / "0.png"
    path.write_bytes(content)
    with pytest.raises(CaptureError, match=r"header states .* at most 400 MB"):
        read_digital_numbers(path)


def test_hdr_and_exr_bombs_are_refused_by_their_headers(tmp_path):
    """Whichever way the axes run; what fits is left to its decoder."""
    hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 50000\n"
    window = struct.pack("<4i", -10, -20, 69_989, 59_979)
    exr = b"v/1\x01\x02\0\0\0" + b"dataWindow\0box2i\0" + struct.pack("<i", 16) + window
    for content, extents in ((hdr, "60000 × 50000 × 3"), (exr, "60000 × 70000 × 4")):
        with pytest.raises(CaptureError, match=extents):
            refuse_large_picture(tmp_path / "a", content)
    refuse_large_picture(tmp_path / "a", hdr.replace(b"60000", b"600"))
    refuse_large_picture(tmp_path / "a", exr[:30])


@pytest.mark.parametrize(("head", "seen"), [(65_536, True), (65_537, False)])
def test_a_picture_s_extents_are_sought_in_its_first_64_kib(tmp_path, head, seen):
    """What stands behind that is no header: its decoder says what the file is."""
    start, size = b"#?RADIANCE\n", b"-Y 60000 +X 50000\n"
    content = start + b"#" * (head - len(start) - len(size) - 1) + b"\n" + size
    with pytest.raises(CaptureError, match="60000") if seen else contextlib.nullcontext():
        refuse_large_picture(tmp_path / "a", content)


def test_a_scene_that_is_no_picture_is_refused_in_one_line(tmp_path):
    """An array that states more than it holds, one of another kind, an empty picture, text: never a traceback."""
    np.save(tmp_path / "words.npy", np.array(["a", "b"]))
    with (tmp_path / "huge.npy").open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": (2**20, 2**20)})
    np.save(tmp_path / "none.npy", np.zeros((0, 3)))
    whole = (tmp_path / "words.npy").read_bytes()
    (tmp_path / "open.npy").write_bytes(whole.replace(b"}", b" "))  # a brace that is never closed
    (tmp_path / "text.exr").write_bytes(b"v/1\x01 but no more")
    (tmp_path / "text.png").write_bytes(b"no picture")
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises((ConfigurationError, MissingLibrary)) as refusal:
            ImageScene(file=path).render(8, 8)
        assert path.name in str(refusal.value) or isinstance(refusal.value, MissingLibrary)
    np.save(tmp_path / "good.npy", np.full((4, 4), 0.5, np.float32))
    assert ImageScene(file=tmp_path / "good.npy").render(2, 2).radiance.tolist() == [[0.5, 0.5], [0.5, 0.5]]


def test_a_tiff_bomb_is_refused_by_its_header(tmp_path):
    """Little and big endian, width and height as 16 and 32 bits, several samples."""
    for order in "<>":
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5), np.uint16), byteorder=order)
        content = bytearray((tmp_path / "a.tif").read_bytes())
        refuse_large_picture(tmp_path / "a.tif", bytes(content))
        at = int(struct.unpack_from(f"{order}I", content, 4)[0])
        for number in range(struct.unpack_from(f"{order}H", content, at)[0]):
            tag, kind = struct.unpack_from(f"{order}HH", content, at + 2 + 12 * number)
            if tag in (256, 257):
                struct.pack_into(f"{order}{'H' if kind == 3 else 'I'}", content, at + 10 + 12 * number, 60_000)
        with pytest.raises(CaptureError, match=r"60000 × 60000 × 1 .* 7200 MB"):
            refuse_large_picture(tmp_path / "a.tif", bytes(content))


def test_pictures_of_real_sensors_are_read(tmp_path):
    """151 million pixels of 16 bits are within the limit, one byte more than the limit is not."""
    refuse_size(tmp_path, (10_652, 14_204), 2)
    refuse_size(tmp_path, (MOST_PICTURE_BYTES,), 1)
    with pytest.raises(CaptureError):
        refuse_size(tmp_path, (MOST_PICTURE_BYTES + 1,), 1)
    dn = np.arange(2000, dtype=np.uint16).reshape(40, 50)
    cv2.imwrite(str(tmp_path / "a.png"), dn)
    cv2.imwrite(str(tmp_path / "a.tif"), dn)
    for name in ("a.png", "a.tif"):
        assert np.array_equal(read_digital_numbers(tmp_path / name), dn)


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "a: " + "{b: " * 100_000, "- " * 100_000, "? " * 100_000,
     "\n".join(" " * n + f"k{n}:" for n in range(2000))],
    ids=["lists", "mappings", "sequences", "keys", "indented"],
)  # fmt: skip
def test_deep_yaml_is_refused(tmp_path, text):
    """What would overflow the stack of the parser is refused with its line; the process goes on."""
    path = tmp_path / "deep.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"nested more than 64 deep|not valid YAML"):
        read_yaml(path)


def test_yaml_that_repeats_itself_is_refused(tmp_path):
    """Nine levels of nine repetitions are a billion entries; a few repetitions are none."""
    lines = ["l0: &l0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]" for n in range(1, 9)]
    path = tmp_path / "laughs.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match="repetitions"):
        read_yaml(path)
    path.write_text("\n".join(lines[:3]), encoding="utf-8")
    assert read_yaml(path)["l2"][0][0] == ["x"] * 9


def test_nesting_of_real_files_is_fine():
    """Long lists, long texts and 64 levels pass."""
    refuse_deep_yaml("a: [" + "1, " * 100_000 + "1]", "here")
    refuse_deep_yaml("[" * 64 + "]" * 64, "here")
    with pytest.raises(InputError):
        refuse_deep_yaml("[" * 65 + "]" * 65, "here")


@pytest.mark.parametrize("command", ["merge", "response", "measure"])
def test_commands_live_through_deep_yaml(tmp_path, command, capsys):
    """One line and an exit code, where the process ended before."""
    (tmp_path / "set").mkdir()
    deep = tmp_path / "set" / "capture.yaml"
    deep.write_text("frames: " + "[" * 100_000, encoding="utf-8")
    words = {"measure": ["measure", "--bench", str(deep)]}.get(command, [command, str(tmp_path / "set")])
    words += (
        ["-o", str(tmp_path / "o.exr" if command == "merge" else tmp_path / "o.yaml")] if command != "measure" else []
    )
    assert run(words) in (1, 2)
    assert "nested more than" in capsys.readouterr().err


@pytest.mark.parametrize("subject", ["../../x", "/etc/x", "..", ".hidden", "-o", "a/b", "a\\b", "a\0b", "", "x" * 65])
def test_a_subject_cannot_lead_out_of_the_folder(tmp_path, monkeypatch, capsys, subject):
    """A pseudonym that is a path is misuse; nothing is written anywhere."""
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    monkeypatch.chdir(inside)
    with pytest.raises(UsageError):
        safe_name(subject, "--subject")
    if "\0" not in subject:
        assert run(["adapt", "run", "quick", f"--subject={subject}", "--simulate", "steady"]) == 2
        assert "--subject" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    assert safe_name("S-01 anna.b", "--subject") == "S-01 anna.b"


@given(st.text(max_size=300))
@example("..").via("a folder")
@example("../../etc/passwd").via("FITS INSTRUME")
@example("\U0001d7d8" * 64).via("four bytes each")
@example("\ud800").via("half a character")
def test_any_text_becomes_the_name_of_one_file(tmp_path_factory, text):
    """In its own folder, with an ending; a name stays as it is, and one made of it is never another text's."""
    name = safe_file_name(text)
    folder = tmp_path_factory.getbasetemp()
    file = folder / f"{name}.yaml"
    file.touch()
    assert file.resolve().parent == folder.resolve()
    file.unlink()
    assert not name.startswith((".", "-"))
    assert safe_file_name(name) == name


def test_two_texts_never_become_one_name():
    """However alike they look once their slashes are gone."""
    texts = ["a/b", "a_b", "a\\b", "a b", "a\0b", "x" * 65, "x" * 66, "", " ", ".", "..", "S/1 ", "S/1"]
    assert len({safe_file_name(text) for text in texts}) == len(texts)


@given(st.text())
def test_no_text_from_outside_steers_a_terminal_or_a_spreadsheet(text):
    """No control character but line feed and tab is left, whatever the text; no cell begins a formula."""
    shown, line, cell = printable(text), one_line(text), spreadsheet_cell(text)
    assert not [char for char in shown if unicodedata.category(char) == "Cc" and char not in "\n\t"]
    assert shown == text or "\\x" in shown
    assert len(line.splitlines()) <= 1
    assert (
        line.replace("\\x0a", "\n").replace("\\x2028", "\u2028").replace("\\x2029", "\u2029") == shown or "\\x" in text
    )
    assert cell[:1] not in ("=", "@", "\t")
    assert cell[:1] not in ("+", "-") or math.isfinite(float(cell))


def test_numbers_and_plain_texts_stay_as_they_are():
    """Also negative ones, in a cell as anywhere; what is no text is no formula."""
    assert [spreadsheet_cell(value) for value in ("-1.5e-3", "+2", "a=b", -1.5, None)] == [
        "-1.5e-3",
        "+2",
        "a=b",
        -1.5,
        None,
    ]
    assert spreadsheet_cell("=1+1\x1b") == "'=1+1\\x1b"
    assert printable("\x1b]0;x\x07 µ\n") == "\\x1b]0;x\\x07 µ\n"


def test_what_can_be_no_file_is_none(tmp_path):
    """A file is; a folder, what is not there, a name too long for any disk and one with a zero in it are not."""
    (tmp_path / "a").write_bytes(b"")
    names = ("a", ".", "b", "c" * 5000, "a\0")
    assert [is_file(tmp_path / name) for name in names] == [True, False, False, False, False]


@pytest.mark.parametrize(("repeated", "read"), [(48, True), (50, False)])
def test_what_is_repeated_counts_as_if_it_were_written_out(repeated, read):
    """A thousand numbers, a hundred times, 48 times and once: 4.9 million entries are read, 5.1 million not."""
    lines = ["a: &a [" + "1, " * 999 + "1]", "b: &b [" + "*a, " * 99 + "*a]", "c: [" + "*b, " * repeated + "]"]
    if read:
        refuse_deep_yaml("\n".join(lines), "here")
    else:
        with pytest.raises(InputError, match="more than 5000000 entries"):
            refuse_deep_yaml("\n".join(lines), "here")


@pytest.mark.parametrize("start", [b"text about ", b"\xff\xd8\xff\xfe\x00\x40", b"v/1\x02"])
def test_what_stands_in_another_file_is_no_header_of_a_picture(tmp_path, start):
    """A resolution line or a data window counts only in a file that begins as such a picture does."""
    window = struct.pack("<4i", 0, 0, 69_999, 59_999)
    for inside in (b"\n-Y 60000 +X 50000\n", b"dataWindow\0box2i\0" + struct.pack("<i", 16) + window):
        refuse_large_picture(tmp_path / "a", start + inside)


@pytest.mark.parametrize(
    ("bits", "colour", "bytes_each"),
    [(1, 0, 1), (8, 0, 1), (16, 0, 2), (8, 2, 3), (16, 2, 6), (8, 3, 1), (8, 4, 2), (16, 4, 4), (8, 6, 4), (16, 6, 8)],
)
def test_a_png_is_as_large_as_its_pixels_are(tmp_path, bits, colour, bytes_each):
    """Rows of 1000 pixels of so many channels and bytes fill the limit, and one row more does not fit."""
    rows = MOST_PICTURE_BYTES // (1000 * bytes_each)
    refuse_large_picture(tmp_path / "a", _png(1000, rows, bits, colour))
    with pytest.raises(CaptureError, match=f"{rows + 1} × 1000"):
        refuse_large_picture(tmp_path / "a", _png(1000, rows + 1, bits, colour))


def test_a_tiff_that_states_no_bits_counts_a_byte_for_each_value(tmp_path):
    """What says nothing of its depth is not of no size."""
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5), np.uint8), byteorder="<")
    content = bytearray((tmp_path / "a.tif").read_bytes())
    at = int(struct.unpack_from("<I", content, 4)[0])
    for number in range(struct.unpack_from("<H", content, at)[0]):
        tag, kind = struct.unpack_from("<HH", content, at + 2 + 12 * number)
        if tag in (256, 257, 258):
            value = 0 if tag == 258 else 60_000
            struct.pack_into(f"<{'H' if kind == 3 else 'I'}", content, at + 10 + 12 * number, value)
    with pytest.raises(CaptureError, match="3600 MB"):
        refuse_large_picture(tmp_path / "a.tif", bytes(content))


_BYTES_ONLY = {"packet.xmp"}  # its reader takes bytes, which another reader has bounded

_BOMBS = bombs()


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Callable[[Path], Any]]:
    """Return every reader of the fuzz by the name of a file that it reads."""
    return {name: read for name, (_, read) in seeds(tmp_path_factory.mktemp("seeds")).items()}


def test_every_reader_refuses_what_has_no_end(readers, tmp_path):
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
        with pytest.raises(RadiometerError, match=r"MB|not FITS or TIFF"):
            read(place / name)


@pytest.mark.parametrize("name", list(_BOMBS))
def test_a_bomb_is_refused_in_one_line(name, tmp_path):
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
def test_whatever_a_library_does_becomes_one_line(read, reason, tmp_path, monkeypatch):
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
def test_what_a_library_does_in_another_process_ends_that_process_at_most(read, reason, tmp_path, monkeypatch):
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


def test_readers_of_several_threads_work_apart_at_the_same_time(tmp_path):
    """Each thread gets its own answer."""
    for number in range(8):
        (tmp_path / f"{number}").write_bytes(b"x" * number)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda number: faulty_readers.read(tmp_path / f"{number}")[2]["a"], range(8)))
    assert found == list(range(8))


def test_time_is_limited_in_every_thread(tmp_path, monkeypatch):
    """A reader in a thread of a pool ends as one in the main thread does."""
    monkeypatch.setattr(reader_limits, "READER_SECONDS", 0.2)
    with ThreadPoolExecutor(1) as pool, pytest.raises(InputError, match="processor time"):
        pool.submit(bounded_reader(error=InputError)(_for_ever), tmp_path / "a.bin").result()


@pytest.mark.slow
def test_every_reader_refuses_files_made_to_harm(tmp_path_factory):
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


@pytest.mark.parametrize("name", ["plain.tiff", "tiled.tiff", "map.tiff"])
def test_a_wrong_byte_of_a_directory_is_refused_or_read(name, tmp_path_factory):
    """Each byte of a TIFF's first directory as 0, 255 and one more: a picture of another shape is damage, too."""
    folder = tmp_path_factory.mktemp("bytes")
    content, read = seeds(folder)[name]
    begin = int.from_bytes(content[4:8], "little")
    end = begin + 2 + 12 * int.from_bytes(content[begin : begin + 2], "little")
    found = Fuzzed()
    for at in range(4, end, 2):
        for byte in {0, 255, (content[at] + 1) % 256}:
            found.read(folder / f"one-{name}", content[:at] + bytes([byte]) + content[at + 1 :], read, f"{at}: {byte}")
    assert found.faults == []
    assert found.refused > found.count // 10


def test_readers_in_several_threads_each_have_their_memory(tmp_path):
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
def test_packed_bytes_come_out_as_they_went_in(pack, tmp_path):
    """Several streams one after the other; up to the limit, and one byte more is refused; a cut stream as well."""
    compress = __import__(pack).compress
    content = compress(b"abc") + compress(b"def")
    assert unpacked(tmp_path, content, 6) == b"abcdef"
    assert unpacked(tmp_path, b"plain", 1) == b"plain"
    for wrong, most in ((content, 5), (content[:-1], 9), (content[:30], 9)):
        with pytest.raises(InputError):
            unpacked(tmp_path, wrong, most)


def test_a_reader_of_another_is_within_its_limits(tmp_path):
    """An error of the inner reader keeps its own words."""

    @bounded_reader()
    def inner(path: Path) -> None:
        raise CaptureError("the inner one")

    with pytest.raises(CaptureError, match=r"^the inner one$"):
        bounded_reader()(lambda path: inner(path))(tmp_path)
