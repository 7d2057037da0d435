"""Guards against files that take all memory or time, TIFF of every layout, and values that cannot be."""

import contextlib
import copy
import functools
import importlib
import itertools
import math
import operator
import os
import pkgutil
import random
import re
import struct
import threading
import time
import unicodedata
import zlib
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

import cv2
import numpy as np
import pytest
import tifffile
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image
from pydantic import TypeAdapter, ValidationError

import radiometer
import radiometer as rm
from radiometer.adaptation.protocol import Fixation, FixationCheck, SteadyBleach, read_protocol
from radiometer.bench.boxes import read_preset
from radiometer.cli.main import run
from radiometer.data import (
    Calibration,
    CameraDescription,
    FoundEffects,
    LensDescription,
    Scale,
    SourceDescription,
    reader_limits,
)
from radiometer.data.capture_set import FrameEntry, read_digital_numbers
from radiometer.data.guards import (
    MOST_PICTURE_BYTES,
    is_file,
    refuse_deep_yaml,
    refuse_large_picture,
    refuse_size,
    safe_file_name,
    safe_name,
)
from radiometer.data.light_calibration import LightCalibration
from radiometer.data.reader_limits import bounded_reader, unpacked
from radiometer.data.storage import read_yaml
from radiometer.data.validation import ConfigSection, FileSection, validate
from radiometer.devices import CameraPreset
from radiometer.errors import CaptureError, ConfigurationError, InputError, MissingLibrary, RadiometerError, UsageError
from radiometer.importing.photograph_pixels import read_photograph
from radiometer.importing.tiff_files import read_tiff_pixels
from radiometer.reporting.plain_text import one_line, printable, spreadsheet_cell
from simulators.effects.lens import Lens
from simulators.scenes.kinds import ImageScene
from testing import faulty_readers
from testing.reader_fuzz import bombs, fuzz, hostile, seeds


def _png(width, height, bits=16, colour=0, data=b""):
    """Return a PNG with the header stated and data that need not fit it."""

    def chunk(kind, content):
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


@pytest.mark.parametrize(
    ("changed", "shown"),
    [({256: 60_000, 257: 60_000}, "60000 × 60000 × 1 .* 7200 MB"), ({256: 60_000, 257: 60_000, 258: 0}, "3600 MB")],
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_bomb_is_refused_by_its_header(tmp_path, order, changed, shown):
    """Little and big endian, width and height as 16 and 32 bits; without a depth (0 bits) a byte for each value."""
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5), np.uint16), byteorder=order)
    content = bytearray((tmp_path / "a.tif").read_bytes())
    refuse_large_picture(tmp_path / "a.tif", bytes(content))
    at = int(struct.unpack_from(f"{order}I", content, 4)[0])
    for number in range(struct.unpack_from(f"{order}H", content, at)[0]):
        tag, kind = struct.unpack_from(f"{order}HH", content, at + 2 + 12 * number)
        if tag in changed:
            struct.pack_into(f"{order}{'H' if kind == 3 else 'I'}", content, at + 10 + 12 * number, changed[tag])
    with pytest.raises(CaptureError, match=shown):
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


def test_repetitions_count_as_if_written_out(tmp_path):
    """Nine levels of nine are refused; long lists, 64 levels and 4.9 million entries are not."""
    lines = ["l0: &l0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]" for n in range(1, 9)]
    path = tmp_path / "laughs.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match="repetitions"):
        read_yaml(path)
    path.write_text("\n".join(lines[:3]), encoding="utf-8")
    assert read_yaml(path)["l2"][0][0] == ["x"] * 9
    refuse_deep_yaml("a: [" + "1, " * 100_000 + "1]", "here")
    refuse_deep_yaml("[" * 64 + "]" * 64, "here")
    with pytest.raises(InputError):
        refuse_deep_yaml("[" * 65 + "]" * 65, "here")
    with pytest.raises(InputError):
        refuse_deep_yaml("\n".join(" " * n + f"k{n}:" for n in range(66)), "here")
    lines = ["a: &a [" + "1, " * 999 + "1]", "b: &b [" + "*a, " * 99 + "*a]"]
    refuse_deep_yaml("\n".join([*lines, "c: [" + "*b, " * 48 + "]"]), "here")
    with pytest.raises(InputError, match="more than 5000000 entries"):
        refuse_deep_yaml("\n".join([*lines, "c: [" + "*b, " * 50 + "]"]), "here")


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
    """In its own folder, with an ending; a name stays as it is, and one made of it is never another text's.

    However alike texts look once their slashes are gone.
    """
    texts = {text, "a/b", "a_b", "a\\b", "a b", "a\0b", "x" * 65, "x" * 66, "", " ", ".", "..", "S/1 ", "S/1"}
    assert len({safe_file_name(one) for one in texts}) == len(texts)
    name = safe_file_name(text)
    folder = tmp_path_factory.getbasetemp()
    file = folder / f"{name}.yaml"
    file.touch()
    assert file.resolve().parent == folder.resolve()
    file.unlink()
    assert not name.startswith((".", "-"))
    assert safe_file_name(name) == name


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


def test_numbers_and_plain_texts_stay_as_they_are(tmp_path):
    """Also negative ones, in a cell as anywhere; what is no text is no formula; what can be no file is none."""
    plain = ("-1.5e-3", "+2", "a=b", -1.5, None)
    assert tuple(map(spreadsheet_cell, plain)) == plain
    assert spreadsheet_cell("=1+1\x1b") == "'=1+1\\x1b"
    assert printable("\x1b]0;x\x07 µ\n") == "\\x1b]0;x\\x07 µ\n"
    (tmp_path / "a").write_bytes(b"")
    names = ("a", ".", "b", "c" * 5000, "a\0")
    assert [is_file(tmp_path / name) for name in names] == [True, False, False, False, False]


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


_BYTES_ONLY = {"packet.xmp"}  # its reader takes bytes, which another reader has bounded

_BOMBS = bombs()


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
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


def _all_of_it(path):
    return np.empty(4_000_000_000, np.uint8)


def _for_ever(path):
    while True:
        with contextlib.suppress(Exception):  # as libraries do
            time.process_time()


def _by_chance(path):
    raise KeyError("TAG")


@pytest.mark.parametrize(
    ("read", "reason"),
    [(_all_of_it, "more than 2 GB of memory"), (_for_ever, "processor time"), (_by_chance, "damaged.*KeyError: 'TAG'")],
)
def test_whatever_a_library_does_becomes_one_line(read, reason, tmp_path, monkeypatch):
    """Memory, time, any error, in a thread of a pool as in the main one; afterwards the process is free as before."""
    monkeypatch.setattr(reader_limits, "READER_SECONDS", 0.2)
    bounded = bounded_reader(error=InputError)(read)
    with ThreadPoolExecutor(1) as pool:
        for call in (bounded, lambda path: pool.submit(bounded, path).result()):
            with pytest.raises(InputError, match=f"a.bin: .*{reason}"):
                call(tmp_path / "a.bin")
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


def test_readers_work_apart_and_within_each_other(tmp_path):
    """Each thread gets its own answer; an inner reader's error keeps its words."""
    for number in range(8):
        (tmp_path / f"{number}").write_bytes(b"x" * number)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda number: faulty_readers.read(tmp_path / f"{number}")[2]["a"], range(8)))
    assert found == list(range(8))

    @bounded_reader()
    def inner(path):
        raise CaptureError("the inner one")

    with pytest.raises(CaptureError, match=r"^the inner one$"):
        bounded_reader()(lambda path: inner(path))(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("part", [pytest.param(n, marks=[pytest.mark.long] * (n > 0)) for n in range(5)])
def test_every_reader_refuses_files_made_to_harm(part, tmp_path_factory):
    """Bombs, loops, nesting and noise under each name, then damaged files: one line of our own, in 10 s each.

    All readers stand behind one guard: a fifth of them shows here that it holds.
    """
    folder = tmp_path_factory.mktemp("harm")
    for name, seeded in [*seeds(folder).items()][part::5]:
        place = folder / f"harm {name}"
        place.mkdir()
        (place / "a.png").write_bytes((folder / "a.png").read_bytes())
        found = fuzz(place, name, len(hostile()) + 8, 3, seeded)
        assert found.faults == []
        assert found.refused > len(hostile()) // 2 or name in _BYTES_ONLY
        assert found.longest_s < 10.0


def test_readers_in_several_threads_each_have_their_memory(tmp_path):
    """Three of them hold 0.5 GB each under a limit of 1 GB for one, at the same time."""
    together = threading.Barrier(3, timeout=60.0)
    sizes = []

    @bounded_reader(1_000_000_000)
    def read(path):
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


# TIFF files of every layout: as photographs and as frames they hold what was written, or are refused in one line.


ROWS, COLUMNS = 40, 48
_ALPHA = {2: "minisblack", 4: "rgb"}


def picture(dtype, samples=1):
    """Return a picture of which no two samples are alike, the values of the type's whole range."""
    top = np.iinfo(dtype).max
    values = np.random.default_rng(samples).integers(0, top, (ROWS, COLUMNS, samples), dtype, endpoint=True)
    return values[..., 0] if samples == 1 else values


def write(path, values, *, planes_apart=False, alpha="unassalpha", **layout):
    """Write a TIFF of grey values or colours, with a transparency where there are two or four samples."""
    samples = 1 if values.ndim == 2 else values.shape[2]
    if samples > 1:
        layout |= {"planarconfig": "separate" if planes_apart else "contig"}
        layout |= {"extrasamples": [alpha]} if samples in _ALPHA else {}
        values = np.moveaxis(values, -1, 0) if planes_apart else values
    tifffile.imwrite(path, values, photometric="rgb" if samples > 2 else "minisblack", metadata=None, **layout)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("samples", [1, 2, 3, 4])
@pytest.mark.parametrize("planes_apart", [False, True], ids=["together", "planes apart"])
def test_a_photograph_of_any_layout_is_as_written(dtype, samples, planes_apart, tmp_path):
    """Byte order, tiles, compression, predictor and both kinds of transparency, which is left out."""
    values = picture(dtype, samples)
    expected = values if samples == 1 else values[..., 0] if samples == 2 else values[..., :3]
    packings = ({}, {"compression": "zlib"}, {"compression": "zlib", "predictor": True})
    for order, tile, packing, alpha in itertools.product(
        "<>", (None, (16, 16)), packings, ("unassalpha", "assocalpha")
    ):
        layout = {"byteorder": order, "tile": tile, **packing}
        write(tmp_path / "a.tif", values, planes_apart=planes_apart, alpha=alpha, **layout)
        found = read_photograph(tmp_path / "a.tif")
        assert found.bit_depth == 8 * np.dtype(dtype).itemsize
        assert np.array_equal(found.values, expected), layout
        if samples == 1:
            assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), expected), layout


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("samples", [1, 3, 4])
def test_lzw_is_as_written(dtype, samples, tmp_path):
    """The compression that OpenCV and most programs write; a transparency is left out."""
    values = picture(dtype, samples)
    cv2.imwrite(str(tmp_path / "a.tif"), values if samples == 1 else values[..., [2, 1, 0, 3][:samples]])
    found = read_photograph(tmp_path / "a.tif").values
    assert np.array_equal(found, values if samples == 1 else values[..., :3])


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", None])
def test_no_orientation_is_applied(samples, compression, tmp_path):
    """Pixels count as stored, in TIFF and JPEG alike: a patch is at one place of the sensor, however it was held."""
    values = np.zeros((ROWS, COLUMNS, samples), np.uint8)
    values[: ROWS // 2, : COLUMNS // 2] = 200
    image = Image.fromarray(values[..., 0] if samples == 1 else values)
    for turned in range(1, 9):
        exif = Image.Exif()
        exif[274] = turned
        image.save(tmp_path / "a.tif", compression=compression, tiffinfo={274: turned})
        image.save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
        of_tiff, of_jpeg = (read_photograph(tmp_path / name).values for name in ("a.tif", "a.jpg"))
        assert np.array_equal(of_tiff, np.asarray(image)), turned
        assert of_jpeg.shape == of_tiff.shape
        assert np.abs(of_jpeg.astype(int) - of_tiff).max() < 20
        if samples == 1:
            assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), values[..., 0]), turned
            assert np.array_equal(read_tiff_pixels(tmp_path / "a.tif", 0), values[..., 0]), turned


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("big", [False, True], ids=["classic", "BigTIFF"])
def test_a_reduced_picture_is_not_the_picture(samples, big, tmp_path):
    """Before or after the picture a smaller copy (NewSubfileType 1) is left alone; of two pictures none is taken."""
    values, file = picture(np.uint16, samples), tmp_path / "a.tif"
    smaller = np.ascontiguousarray(values[::2, ::2])
    for kinds, refused in (((1, 0), False), ((0, 1), False), ((0, 0), True)):
        with tifffile.TiffWriter(file, bigtiff=big) as tiff:
            for kind in kinds:
                tiff.write(smaller if kind else values, subfiletype=kind, metadata=None)
        for read in (lambda path: read_photograph(path).values, *[read_digital_numbers] * (samples == 1)):
            with pytest.raises(CaptureError, match="a TIFF of 2 pages") if refused else contextlib.nullcontext():
                assert np.array_equal(read(file), values)
    tifffile.imwrite(file, values, subfiletype=1, metadata=None, bigtiff=big)  # a writer that marks all as reduced
    assert samples > 1 or np.array_equal(read_tiff_pixels(file, 0), values)


@pytest.mark.parametrize(
    ("values", "layout", "message"),
    [
        (picture(np.uint16), {"photometric": "miniswhite"}, "0 is white"),
        (picture(np.uint8, 4), {"photometric": "separated"}, "neither grey values nor red, green and blue"),
        (picture(np.uint8, 3), {"photometric": "minisblack", "planarconfig": "contig"}, "3 samples per pixel"),
        (picture(np.uint16), {"photometric": 32803}, "a mosaic of colours"),
        (picture(np.uint16).astype(np.float32), {"photometric": "minisblack"}, "holds float32 values"),
        (picture(np.uint8, 3).astype(np.float16), {"photometric": "rgb"}, "holds float16 values"),
        (picture(np.uint16).astype(np.int16), {"photometric": "minisblack"}, "holds int16 values"),
        (picture(np.uint16).astype(np.uint32), {"photometric": "minisblack"}, "holds uint32 values"),
        (picture(np.uint8) > 9, {"photometric": "minisblack"}, "holds bool values"),
    ],
    ids=["white", "inks", "three greys", "mosaic", "float", "half", "signed", "32 bits", "1 bit"],
)
def test_other_numbers_are_refused_in_one_line(values, layout, message, tmp_path):
    """What is neither grey values nor colours of 8 or 16 bits is not guessed."""
    tifffile.imwrite(tmp_path / "a.tif", values, metadata=None, **layout)
    with pytest.raises(CaptureError, match=message) as refusal:
        read_photograph(tmp_path / "a.tif")
    assert "\n" not in str(refusal.value)


def test_tiffs_that_decoders_mix_up_are_refused_and_mosaics_are_frames(tmp_path):
    """16 bits in planes apart under LZW; grey with a transparency."""
    for samples in (2, 3):
        write(tmp_path / "a.tif", picture(np.uint16, samples), planes_apart=samples == 3)
        with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as tiff:
            tiff.pages[0].tags["Compression"].overwrite(5)
        with pytest.raises(CaptureError, match="save it without compression"):
            read_photograph(tmp_path / "a.tif")
    values = picture(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric=32803, metadata=None)
    assert np.array_equal(read_digital_numbers(tmp_path / "a.tif"), values)


# Fields of files, requests and options take what exists in the world, and refuse what their quantity cannot be.


for part in ("adaptation", "bench", "data", "devices"):
    folder = importlib.import_module(f"{radiometer.__name__}.{part}")
    for one in pkgutil.iter_modules(folder.__path__):
        importlib.import_module(f"{folder.__name__}.{one.name}")


def models(kind):
    """Return all kinds of section that are declared, of any depth."""
    return [found for sub in kind.__subclasses__() for found in (sub, *models(sub))]


def named(pattern):
    """Return the numeric fields whose names match a pattern, as (what takes its values)."""
    found = []
    for model in {*models(FileSection), *models(ConfigSection)}:
        if not model.__module__.startswith(("radiometer.", "simulators.")):
            continue
        for name, field in model.model_fields.items():
            if re.search(pattern, name) and field.annotation in (float, float | None):
                takes = TypeAdapter(Annotated[field.annotation, *field.metadata])
                found.append(pytest.param(takes, id=f"{model.__name__}.{name}"))
    return sorted(found, key=lambda one: str(one.id))


def is_taken(takes, value):
    """Tell whether a field takes a value."""
    try:
        takes.validate_python(value)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize("takes", named(r"(^|_)u_(rel|dn|s)(_|$)|^u$|^glare_u$"))
def test_an_uncertainty_may_be_nothing_but_not_less(takes):
    """0 is what is known exactly; −1e-9 is no standard uncertainty."""
    assert is_taken(takes, 0.0)
    assert not is_taken(takes, -1e-9)


@pytest.mark.parametrize(
    "takes", named(r"^(f_number|focal_length_\w+|wavelength_nm|pixel_\w+|full_well_e|validity_days)$")
)
def test_a_length_or_capacity_is_above_nothing(takes):
    """A lens of 0 mm or f/0, a wavelength or pixel of 0 and a validity of no time are mistakes."""
    assert not is_taken(takes, 0.0)
    assert not is_taken(takes, -1.0)


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (LensDescription, {"f_number": 0.95, "transmittance": 1.0}),  # f/0.95 lenses are sold for C-mount
        (LensDescription, {"f_number": 128.0, "focal_length_mm": 1.2, "transmittance": 0.015}),  # with a grey filter
        (LensDescription, {"magnification": 5.0, "pupil_magnification": 0.25}),
        (Scale, {"value": 1e-12, "u_rel": 0.0, "method": "known_radiance", "f_number": 0.95, "iso": 12_800.0}),
        (CameraDescription, {"bit_depth": 1}),
        (
            CameraDescription,
            {"bit_depth": 16, "read_noise_e": 0.0, "quantum_efficiency": 1.0, "dark_current_e_per_s": 0},
        ),
        (Lens, {"transmittance": 0.01}),  # behind a grey filter of density 2, for the sun
        (SourceDescription, {"wavelength_nm": 254.0, "reproducibility_u_rel": 0.0, "flicker_hz": 0.1}),
        (FrameEntry, {"file": "a.png", "exposure_s": 7200.0, "gain_db": -6.0, "source_level": 0.0}),
        (FrameEntry, {"file": "a.png", "exposure_s": 1e-6, "temperature_C": -100.0}),
        (FixationCheck, {"size_deg": 2.0, "temporal_deg": 13.5, "share": 0.3}),
        (Fixation, {"size_deg": 2.0, "luminance_cd_m2": 10.0}),
        (SteadyBleach, {"channel": "bleach", "luminance_cd_m2": 10_000.0, "duration_s": 600.0, "pupil_mm": 9.0}),
    ],
)
def test_what_exists_is_taken(model, fields):
    """Fast and slow lenses, one and sixteen bits, germicidal lamps, hours of exposure, cooled sensors: as stated."""
    made = model(**fields)
    assert {name: getattr(made, name) for name in fields} == fields


GOOD = {"file": "a.png", "exposure_s": 1.0}
SCALE = {"value": 1e-6, "u_rel": 0.01, "method": "known_radiance"}


@pytest.mark.parametrize(
    ("model", "fields", "shown"),
    [
        (FrameEntry, GOOD | {"exposure_s": 1e30}, "exposure_s.*1e\\+30 s is outside 0 to 1e\\+09 s"),
        (FrameEntry, GOOD | {"gain_db": 1e9}, "gain_db.*-200 to 200 dB"),
        (FrameEntry, GOOD | {"temperature_C": 1e6}, "temperature_C.*to 150 °C"),
        (FrameEntry, GOOD | {"black_level_dn": 1e300}, "black_level_dn.*-65536 to 65536 DN"),
        (Scale, SCALE | {"value": 1e300}, "value.*1e-15 to 1e\\+06"),
        (Scale, SCALE | {"value": 1e-300}, "value.*1e-15 to 1e\\+06"),
        (Scale, SCALE | {"unit": "mJ m-2"}, "unit = 'mJ m-2': input should be 'J m-2 per unit of signal'"),
        (FoundEffects, {"gains_db": (0.0, 1e9), "gain_errors_rel": (0.0, 0.1)}, "gains_db.*-200 to 200 dB"),
        (CameraDescription, {"bit_depth": 12, "full_well_e": 1e-300}, "full_well_e = 1e-300"),
    ],
)
def test_what_cannot_exist_is_refused_with_place_and_range(model, fields, shown):
    """A mistake of unit or power of ten: file, key, number and what is plausible."""
    with pytest.raises(InputError, match=f"^a.yaml: {shown}"):
        validate(model, fields, "a.yaml", InputError)


@pytest.mark.parametrize(
    "model", sorted({*models(FileSection), *models(ConfigSection)}, key=lambda one: one.__qualname__)
)
def test_true_is_no_number(model):
    """A level, bound or share that a file states as `true` is refused by its key: it would be 1."""
    for name, field in model.model_fields.items():
        if field.annotation in (int, float, int | None, float | None):
            with pytest.raises(ValidationError, match=rf"{name} = True: true and false are no numbers"):
                model.model_validate({name: True})


@pytest.mark.parametrize("number", [10**11, 10**20, "1" + "0" * 20, [10**11]], ids=["1e11", "1e20", "text", "list"])
@pytest.mark.parametrize(
    "model", sorted({*models(FileSection), *models(ConfigSection)}, key=lambda one: one.__qualname__)
)
def test_no_count_of_a_file_sizes_an_array_without_bound(model, number):
    """Bits, pixels, counts, seeds: each field that takes a whole number refuses what memory could not hold."""
    for name, field in model.model_fields.items():
        if re.search(r"\bint\b", str(field.annotation)):
            with pytest.raises(ValidationError, match=rf"{name} = .*: no count has this size; at most"):
                model.model_validate({name: number})


FILES = {
    "radiometer-bench/1": lambda path: rm.open(path, uncalibrated=True).close(),
    "radiometer-calibration/1": Calibration.read,
    "radiometer-camera/1": CameraPreset.read,
    "radiometer-light-box/1": read_preset,
    "radiometer-light-calibration/1": LightCalibration.read,
    "radiometer-protocol/1": read_protocol,
    "radiometer-screen/1": lambda path: rm.screen_level(path, 50.0),
}
SCREEN = """\
format: radiometer-screen/1
channels:
  grey: {levels: [0, 128, 255], bits: 8, radiance_W_per_sr_m2: [0, 0.1, 0.4], u_independent: [0.001, 0.001, 0.004],
    u_common_rel: 0.02, photopic_lm_per_W: 320, scotopic_lm_per_W: 700, spectrum: white_led}
"""


SELF: list[object] = []
SELF.append(SELF)
ODD = (None, [], {}, "text", "", math.nan, math.inf, -1, 0, 1e-300, 1e300, True, [1, [2]], {"a": {"b": []}}, SELF)


def places(content, path=()):
    """Yield the path to each key and entry of a file, and what stands there."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, inside in items:
        yield (*path, key), inside
        yield from places(inside, (*path, key))


def changed(content, place, value):
    """Return a file with another value at a place."""
    new = copy.deepcopy(content)
    functools.reduce(operator.getitem, place[:-1], new)[place[-1]] = value
    return yaml.safe_dump(new)


def shipped(root):
    """Return the content of a file of each form: those of the package, and a screen's calibration."""
    texts = [path.read_text() for path in sorted((root / "configs").rglob("*.yaml"))]
    return [content for content in map(yaml.safe_load, (*texts, SCREEN)) if content.get("format") in FILES]


def test_no_odd_value_of_a_file_is_a_defect_of_the_program(project_root, tmp_path):
    """Null, lists, mappings, text, NaN, nothing, a list that holds itself: at places by chance, refused in a line."""
    rng, file, printed = random.Random(20261127), tmp_path / "changed.yaml", list[str]()
    every = [(one, place) for one in shipped(project_root) for place, _ in places(one) if len(place) < 5]
    tried = [(*one, SELF) for one in every[::40]] + [(*rng.choice(every), rng.choice(ODD)) for _ in range(150)]
    for content, place, value in tried:
        file.write_text(changed(content, place, value))
        try:
            FILES[content["format"]](file)
        except rm.RadiometerError as error:
            printed.append(str(error))
    assert len(printed) > 50
    assert all(line.strip() and "\n" not in line for line in printed)


@pytest.mark.parametrize(
    ("gains_db", "errors", "taken"),
    [((), (), True), ((0.0, 6.0), (0.01, 0.02), True), ((0.0, 6.0), (0.01,), False), ((0.0,), (0.01, 0.02), False),
     ((6.0, 0.0), (0.01, 0.02), False), ((0.0, 0.0), (0.01, 0.02), False)],
)  # fmt: skip
def test_a_table_of_gains_has_one_error_for_each(gains_db, errors, taken):
    """Gains rise, and none lacks its error."""
    if taken:
        assert FoundEffects(gains_db=gains_db, gain_errors_rel=errors).gain_errors_rel == errors
    else:
        with pytest.raises(ValidationError, match="one error per gain, gains rising"):
            FoundEffects(gains_db=gains_db, gain_errors_rel=errors)
