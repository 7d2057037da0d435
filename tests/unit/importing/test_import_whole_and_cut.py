"""No file crashes an import, whole or cut anywhere; what cannot be read is named in one line."""

import gzip
import json
import os

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import CaptureSet
from radiometer.errors import RadiometerError
from radiometer.importing import import_sources, imported_of, open_capture
from radiometer.importing.sources import as_capture

PICTURE = (np.random.default_rng(1).integers(300, 3000, (40, 60)) * 16).astype(np.uint16)


@pytest.fixture
def run_command(capsys):
    """Return a function that runs the command line and returns exit code, standard output and standard error."""

    def call(*words):
        code = run([str(word) for word in words])
        out, err = capsys.readouterr()
        return code, out, err

    return call


def test_an_import_is_a_capture_set(write_fits, run_command, tmp_path):
    """What was written reads back with the same pixels, settings, record and original name."""
    for index in range(2):
        source = write_fits(
            f"s/{index}.fits", PICTURE + np.uint16(index), EXPTIME=1.0 + index, IMAGETYP="dark", CCD_TEMP=1.5
        )
    code, _, err = run_command("import", source.parent, "-o", tmp_path / "out")
    assert code == 0
    assert "exposure_s from EXPTIME (2 frames)" in err
    capture = CaptureSet.read(tmp_path / "out")
    assert [e.exposure_s for e in capture.header.frames] == [1.0, 2.0]
    assert capture.header.frames[1].model_extra["original"] == "1.fits"
    assert np.array_equal(capture.read_frame(1).dn, PICTURE + np.uint16(1))
    assert imported_of(capture).taken


@pytest.mark.parametrize(
    ("stated", "options", "mosaic"),
    [
        ({"ROWORDER": "TOP-DOWN"}, (), "RGGB"),
        ({"XBAYROFF": 1}, (), "GRBG"),
        ({}, ("--crop", "1,1,40,20"), "BGGR"),
        ({}, ("--sample", "3"), "RGGB"),
        ({}, ("--sample", "2"), None),
        ({"XBINNING": 2}, (), None),
    ],
)
def test_a_mosaic_in_a_header_is_read_by_its_colours(write_fits, run_command, tmp_path, stated, options, mosaic):
    """Of a whole frame or a part: the plane of a colour is that of the file, as of the capture set that is written."""
    source = write_fits("s/0.fits", PICTURE, EXPTIME=1.0, IMAGETYP="light", BAYERPAT="RGGB", **stated)
    assert run_command("import", source.parent, "-o", tmp_path / "out", *options)[0] == 0
    written = CaptureSet.read(tmp_path / "out")
    assert written.header.camera.mosaic == mosaic
    if mosaic is None:
        return
    y, x = divmod(mosaic.index("B"), 2)
    left, step = (1 if "--crop" in options else 0), (3 if "--sample" in options else 1)
    part = PICTURE[left:21, left:41] if left else PICTURE[::step, ::step]
    assert np.array_equal(written.in_colour("blue").read_frame(0).dn, part[y::2, x::2])
    if not options:
        assert np.array_equal(open_capture(source).in_colour("blue").read_frame(0).dn, part[y::2, x::2])


def test_a_list_gives_the_times_that_files_do_not_state(write_fits, run_command, tmp_path):
    """A file's own time counts before the list; one that neither states is left out and named."""
    folder = write_fits("s/a.fits", PICTURE, EXPTIME=1.0).parent
    for name in ("b", "c"):
        write_fits(f"s/{name}.fits", PICTURE)
    (folder / "exposures.txt").write_text("a.fits 9\nb.fits 20 ms\n")
    code, _, err = run_command("import", folder, "-o", tmp_path / "out")
    assert (code, "c.fits" in err) == (0, True)
    assert [e.exposure_s for e in CaptureSet.read(tmp_path / "out").header.frames] == [1.0, 0.02]
    (folder / "exposures.txt").unlink()
    (folder / "a.fits").unlink()
    code, _, err = run_command("import", folder, "-o", tmp_path / "none")
    assert (code, "exposures.txt" in err) == (1, True)


def test_several_bands_become_several_sets_or_nothing(write_raw_tiff, write_fits, run_command, tmp_path):
    """Each band has its folder; a second camera that cannot be taken leaves no first one behind."""
    write_raw_tiff("s/IMG_1.tif", PICTURE, band="Blue")
    folder = write_raw_tiff("s/IMG_2.tif", PICTURE, band="Red").parent
    assert run_command("import", folder, "-o", tmp_path / "out")[0] == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["Blue", "Red"]
    write_fits("f/a.fits", PICTURE, EXPTIME=1.0)
    write_fits("f/b.fits", PICTURE[:20].astype(np.int16) - 9000, EXPTIME=1.0)
    code, _, err = run_command("import", tmp_path / "f", "-o", tmp_path / "none")
    assert (code, "--pedestal" in err, (tmp_path / "none").exists()) == (1, True, False)


def test_a_damaged_file_of_a_folder_is_left_out_and_named(write_fits, tmp_path):
    """The others are taken; the record says which was not and why."""
    whole = write_fits("s/a.fits", PICTURE, EXPTIME=1.0)
    cut = write_fits("s/b.fits", PICTURE, EXPTIME=1.0)
    cut.write_bytes(cut.read_bytes()[:4000])
    capture = open_capture(whole.parent)
    assert [e.file for e in capture.header.frames] == ["a.fits"]
    assert any("b.fits" in line and "truncated" in line for line in imported_of(capture).left_out)


@pytest.mark.parametrize("kind", ["fits", "fits.gz", "tif", "tif.gz"])
def test_a_file_cut_anywhere_is_one_line(kind, write_fits, write_raw_tiff, run_command, tmp_path):
    """Cut at twelve places from the first byte to the last, a file gives exit code 1 and one line that names it."""
    writer = write_fits if kind.startswith("fits") else write_raw_tiff
    facts = {"EXPTIME": 1.0} if kind.startswith("fits") else {}
    path = writer(f"a.{kind.removesuffix('.gz')}", PICTURE, **facts)
    content = path.read_bytes() if not kind.endswith(".gz") else gzip.compress(path.read_bytes())
    # FITS data end where the last block of 2880 bytes is padded: cuts inside the padding lose nothing.
    end = 2880 + PICTURE.nbytes if kind == "fits" else len(content)
    target = tmp_path / f"cut.{kind}"
    for share in (0.0, 0.001, 0.01, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 0.999):
        target.write_bytes(content[: int(share * end)])
        out = tmp_path / f"out-{share}"
        code, _, err = run_command("import", target, "-o", out)
        assert code == 1, (share, err)
        assert err.startswith("error: ")
        assert "cut." in err
        assert "defect" not in err
        assert len(err.strip().splitlines()) == 1, err
        assert not out.exists()


@pytest.mark.slow
def test_a_plan_is_reported_of_files_where_they_lie(write_fits, run_command):
    """`reconcile --plan-only` takes FITS files as `reconcile` does: darks of one exposure tell no source's warm-up."""
    rng = np.random.default_rng(3)
    for index in range(4):
        dark = np.round(rng.normal(300.0, 8.0, (40, 60))).astype(np.uint16)
        folder = write_fits(f"s/{index}.fits", dark, EXPTIME=1.0, IMAGETYP="dark", CCD_TEMP=1.5).parent
    code, out, err = run_command("reconcile", folder, "--plan-only", "--json")
    assert (code, err) == (0, "")
    assert {"source_warmup_drift", "prnu", "veiling_glare"} <= set(json.loads(out)["blind"])


def test_several_files_of_which_none_is_read_are_one_line(tmp_path, run_command):
    """Named alone or together, by `import` or met by `passport` in an archive."""
    for name in ("a.csv", "b.fits"):
        (tmp_path / name).write_text("luminance,f_number\n1,2\n")
    code, _, err = run_command("import", tmp_path / "a.csv", tmp_path / "b.fits", "-o", tmp_path / "out")
    assert code == 1
    assert "a.csv: not FITS or TIFF" in err
    assert "(and 1 more)" in err
    code, _, err = run_command("passport", tmp_path)
    assert (code, "holds no capture set" in err) == (1, True)


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("command", ["import", "response", "reconcile", "characterise", "merge", "log", "log-fit"])
def test_a_pipe_is_not_called_missing_and_what_is_missing_is(command, there, tmp_path, run_command):
    """The line names what stands at the path; nothing waits for its content."""
    path = tmp_path / "pipe"
    if there:
        os.mkfifo(path)
    code, _, err = run_command(
        command, path, *(["-o", tmp_path / "out.tiff"] if command in ("import", "merge") else [])
    )
    assert code == 1
    missing = any(words in err for words in ("does not exist", "there is no journal", "No such file"))
    assert missing is not there
    assert ("no regular file" in err or "is not a folder" in err) is there


@pytest.mark.parametrize(("codes", "step"), [(1, None), (9, None), (10, 16), (400, 16)])
def test_few_codes_tell_no_padding(codes, step, write_fits):
    """Frames of 1000 everywhere are multiples of 8 by chance; ten different multiples of 16 are 12 bits in 16."""
    values = np.resize(16 * (60 + np.arange(codes)), (40, 60)).astype(np.uint16)
    capture = open_capture(write_fits("a.fits", values, EXPTIME=1.0))
    assert (capture.header.camera.model_extra or {}).get("code_step_dn", capture.header.camera.code_step_dn) == step
    assert any("padded" in line for line in imported_of(capture).doubts) == (step is not None)


@pytest.mark.parametrize("command", ["characterise", "reconcile"])
def test_what_is_no_picture_is_refused_in_words(command, tmp_path, run_command):
    """A spreadsheet, and a folder of them, are distinguished from a capture that was not finished."""
    book = tmp_path / "book.xls"
    book.write_bytes(b"\xd0\xcf\x11\xe0" * 400)
    code, _, err = run_command(command, book)
    assert (code, "codec" in err) == (1, False)
    assert "FITS" in err
    code, _, err = run_command(command, tmp_path)
    assert (code, "not finished" in err) == (1, False)
    assert "holds n" in err  # neither … nor photographs, or no capture.yaml nor other frames


def refused(path):
    """Return why a path is refused; None where it is read to the last pixel."""
    try:
        for one in import_sources([path]):
            as_capture(one, path).read_frame(0)
    except RadiometerError as error:
        return str(error)
    return None


@pytest.mark.slow
def test_every_file_of_the_real_folders(shared_data, tmp_path):
    """Whole or cut in half, each real file is read or refused in one line of ours."""
    files = [
        p for name in ("sensors", "displays", "emva") for p in sorted((shared_data / name).rglob("*")) if p.is_file()
    ]
    read = 0
    for file in files[::4]:
        half = tmp_path / file.name
        half.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        for path in (file, half):
            refusal = refused(path)
            read += refusal is None
            assert refusal is None or (path.name in refusal and "\n" not in refusal)
        half.unlink()
    assert read > 5


@pytest.mark.slow
def test_the_real_ccd_night(shared_data):
    """32 FITS frames: 60 s in files called expos1 is doubted, one header gain, exposures 0 to 300 s."""
    folder = shared_data / "sensors" / "sbig_stl1001_2017"
    if not folder.is_dir():
        pytest.skip("the CCD frames are not on this machine")
    one = import_sources([folder])[0]
    capture = as_capture(one, folder)
    assert len(capture) == 32
    assert capture.header.camera.conversion_gain_e_per_dn == 2.06
    assert {e.exposure_s for e in capture.header.frames} == {0, 10, 20, 23, 30, 60, 150, 300}
    assert "expos1-" in imported_of(capture).doubts[0]


@pytest.mark.slow
def test_real_multispectral_frames(shared_data):
    """RedEdge: 12 bits in 16, masked rows 4899 to 5562 off the tag of 4800, corners between 0.54 and 0.86."""
    folder = shared_data / "sensors" / "micasense_raw"
    if not folder.is_dir():
        pytest.skip("the multispectral frames are not on this machine")
    sets = {one.title: one.header for one in import_sources([folder])}
    red_edge = [header for title, header in sets.items() if "RedEdge" in title]
    assert {header.camera.code_step_dn for header in red_edge} == {16}
    assert {h.camera.code_step_dn for t, h in sets.items() if "Sequoia" in t} == {64}
    masked = [f.model_extra["masked_rows_dn"] for header in red_edge for f in header.frames]
    assert 4899 <= min(masked) < 5000
    assert 5300 < max(masked) <= 5562
    corners = [c for header in red_edge for c in header.lens.model_extra["maker_corner_illumination"]]
    assert 0.53 < min(corners) < 0.56
    assert 0.80 < max(corners) < 0.86
    doubts = [line for header in red_edge for line in header.model_extra["imported"]["doubts"]]
    assert sum("row_dependent_exposure" in line for line in doubts) == len(red_edge)
    assert sum("corners" in line and "natural_vignetting" in line for line in doubts) == len(red_edge)
