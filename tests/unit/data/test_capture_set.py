"""Capture sets: written, read, and taken up by any sequence of steps."""

import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

from radiometer.data import CameraDescription, CaptureSet, CaptureSetWriter, Frame, FrameSettings
from radiometer.errors import CaptureError, InputError, OutputError

PORT = {"name": "port", "x": 0, "y": 0, "width": 2, "height": 2}

STATISTIC = {"exposure_s": 0.01, "mean_dn": 100.0, "variance_dn2": 40.0, "pixels": 48}

CAMERA = CameraDescription(bit_depth=12, model="BFS-U3-19S4M", serial="22500001")


def frame(level=100, exposure_s=0.01, shape=(6, 8), **settings):
    """Return a uniform 12-bit frame."""
    return Frame(np.full(shape, level, np.uint16), 12, FrameSettings(exposure_s, **settings))


@pytest.fixture
def capture(tmp_path):
    """Return the folder of a finished capture set of three light frames and a dark one."""
    folder = tmp_path / "capture"
    with CaptureSetWriter(folder, CAMERA) as writer:
        for exposure_s, level in ((0.04, 400), (0.01, 100), (0.02, 4095)):
            writer.add(frame(level, exposure_s, temperature_c=41.5, black_level_dn=64.0))
        writer.add(frame(64, 0.04, shutter="closed"))
    return folder


def edit(folder, change):
    """Change capture.yaml through a function of its mapping."""
    path = folder / "capture.yaml"
    mapping = yaml.safe_load(path.read_text())
    change(mapping)
    path.write_text(yaml.safe_dump(mapping))


def test_digital_numbers_and_settings_survive_the_disk(capture):
    """A 12-bit 4095 is stored as 4095; settings come back as they were."""
    read = CaptureSet.read(capture)
    frames = list(read.frames())
    assert [int(f.dn[0, 0]) for f in frames] == [400, 100, 4095, 64]
    assert frames[0].settings == FrameSettings(0.04, black_level_dn=64.0, temperature_c=41.5)
    assert frames[3].settings.is_dark
    edit(capture, lambda m: m["frames"][3].update(exposure_s=0))  # a bias frame is read out at once
    assert CaptureSet.read(capture).read_frame(3).settings.is_dark


SPELT = (
    ("gain_db", "gain_dB"), ("gain_db", "Gain-db"), ("gain_db", "gaindb"), ("gain_db", "gain"), ("gain_db", "gain_x"),
    ("f_number", "fNumber"), ("f_number", "f_numbre"), ("black_level_dn", "black_level"), ("shutter", "Shutter"),
    ("temperature_C", "temperature_c"), ("temperature_C", "temperature_K"), ("source_level", "sourcelevel"),
)  # fmt: skip


@pytest.mark.parametrize(("known", "spelt"), SPELT)
def test_a_known_key_in_another_spelling_is_refused(capture, known, spelt):
    """It would be ignored in silence, and a default count in its place. The known one is named."""
    edit(capture, lambda m: m["frames"][1].update({spelt: m["frames"][1].pop(known, 1)}))
    with pytest.raises(CaptureError, match=rf"frames\.1: key '{spelt}' is not read; write '{known}'"):
        CaptureSet.read(capture)


def test_two_spellings_of_one_key_are_refused_and_two_units_are_not(capture):
    """Which of the two is meant is not guessed; another program may state a quantity in its own unit as well."""
    edit(capture, lambda m: m.update(laboratory={"room": 12}))
    assert CaptureSet.read(capture).header.to_mapping()["laboratory"] == {"room": 12}  # of another program: it stays
    edit(capture, lambda m: m["frames"][1].update(gain_x=1.0, exposure_ms=10.0))
    assert CaptureSet.read(capture).header.frames[1].model_extra == {"gain_x": 1.0, "exposure_ms": 10.0}
    edit(capture, lambda m: m["frames"][1].update(gain_dB=6.0))
    with pytest.raises(CaptureError, match="'gain_dB' is not read; write 'gain_db'"):
        CaptureSet.read(capture)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(sorce={}), r"'sorce' is not read; write 'source'"),
        (lambda m: m["camera"].update(Serial="1"), r"camera: key 'Serial' is not read; write 'serial'"),
        (lambda m: m.update(lens={"f-number": 4}), r"lens: key 'f-number' is not read; write 'f_number'"),
        (lambda m: m.update(patches=[PORT | {"U_rel": 0.1}]), r"patches\.0: key 'U_rel' is not read; write 'u_rel'"),
        (lambda m: m["camera"].pop("bit_depth"), r"'camera.bit_depth' is missing"),
        (lambda m: m["frames"][1].update(exposure_s=-1), r"frames\.1\.exposure_s = -1"),
        (lambda m: m["frames"][1].update(file="frames/9999.png"), r"9999\.png' does not exist"),
        (lambda m: m["frames"][1].update(file="../../etc/passwd"), "outside the capture set"),
        (lambda m: m["frames"][1].update(file="a" * 5000), "'aaa+' is not a file name"),
        (lambda m: m["frames"][1].update(file="a\0.png"), "is not a file name"),
        (lambda m: m.update(format="radiometer-capture/9"), "this version reads"),
        (lambda m: m.update(frames=[]), "frames is missing or empty"),
        (lambda m: m.update(frames=[m["frames"][0], m["frames"][0] | {"exposure_s": 9.0}]), "for two exposure times"),
        (lambda m: m["frames"][1].update(exposure_s=0), "shutter: closed"),
        (lambda m: m["frames"][1].update(shutter="ajar"), r"frames\.1\.shutter"),
        (lambda m: m["frames"][1].update(source_level=-0.1), r"source_level = -0\.1"),
        (lambda m: m["frames"][1].update(f_number=0), "f_number = 0"),
        (lambda m: m["frames"][1].update(black_level_dn=4095), "4095 DN is not below full scale"),
        (lambda m: m.update(created="01/02/2026"), r"created = '01/02/2026'"),
        (lambda m: m["frames"][1].update(photons=-1), "photons = -1"),
        (lambda m: m.update(patches=[PORT, PORT]), "patch name 'port' occurs twice"),
        (lambda m: m.update(patches=[PORT | {"width": 0}]), r"patches\.0\.width = 0"),
        (lambda m: m.update(patches=[PORT | {"x": -1}]), r"patches\.0\.x = -1"),
        (lambda m: m.update(frames=[], statistics=[STATISTIC]), "statistics of settings and no pictures"),
        (lambda m: m.update(frames=[], statistics=[STATISTIC | {"clipped_share": 1.1}]), r"clipped_share = 1\.1"),
    ],
)
def test_a_wrong_header_is_refused_with_key_and_reason(capture, change, message):
    """The error names the file, the key and what is wrong."""
    edit(capture, change)
    with pytest.raises(CaptureError, match=message):
        CaptureSet.read(capture)
    (capture / "capture.yaml").write_text("camera: {bit_depth: 12\nframes: ]")
    with pytest.raises(InputError, match="line 2"):  # no YAML at all
        CaptureSet.read(capture)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.full((6, 8), 5000, np.uint16), "holds the value 5000, above the full scale 4095"),
        (np.full((5, 8), 50, np.uint16), r"0001\.png: is 8 × 5 pixels, the frames before 8 × 6"),
        (np.zeros((6, 8, 3), np.uint16), "expected one channel"),
    ],
)
def test_frames_that_contradict_the_header_or_each_other_are_refused(capture, picture, message):
    """All have one size and one channel, and numbers of as many bits as stated; the error names the file."""
    cv2.imwrite(str(capture / "frames" / "0001.png"), picture)
    with pytest.raises(CaptureError, match=message):
        list(CaptureSet.read(capture).frames())


def test_a_folder_that_holds_nothing_of_a_capture_is_refused(tmp_path):
    """It is no capture set; what is unfinished or lacks a frame is taken up below."""
    with pytest.raises(CaptureError, match="it is no capture set"):
        CaptureSet.read(tmp_path)


def test_a_file_that_is_no_picture_is_refused(capture):
    """Damaged and missing files are distinguished, each by its name."""
    (capture / "frames" / "0001.png").write_bytes(b"\x89PNG" + bytes(200) + b"IEND")
    read = CaptureSet.read(capture)
    with pytest.raises(CaptureError, match=r"0001\.png: .*damaged"):
        read.read_frame(1)
    (capture / "frames" / "0001.png").unlink()
    with pytest.raises(CaptureError, match=r"cannot read frame .*0001\.png: No such file"):
        read.read_frame(1)


class CaptureMachine(RuleBasedStateMachine):
    """What the folder holds is absent, unfinished, or exactly the frames that were added."""

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(tempfile.mkdtemp())
        self.folder = self.root / "capture"
        self.writer: CaptureSetWriter | None = None
        self.added: list[Frame] = []
        self.state, self.digest, self.missing = "absent", "", ""

    def teardown(self) -> None:
        """Leave no file behind."""
        shutil.rmtree(self.root)

    @rule()
    def begin(self) -> None:
        """A folder that holds anything is refused; else frames may come, and none is there yet."""
        writer = CaptureSetWriter(self.folder, CAMERA, patterns=("default", "chart"))
        if self.state != "absent":
            with pytest.raises(OutputError, match="exists already"):
                writer.__enter__()
            return
        self.writer, self.added, self.state = writer.__enter__(), [], "unfinished"

    @precondition(lambda self: self.writer)
    @rule(
        exposure_s=st.sampled_from([0.001, 0.02, 0.5, 8.0]),
        gain_db=st.sampled_from([0.0, 12.0]),
        pattern=st.sampled_from(["default", "chart"]),
        dark=st.booleans(),
        seed=st.integers(0, 9),
    )
    def add(self, exposure_s: float, gain_db: float, pattern: str, dark: bool, seed: int) -> None:
        """One frame more."""
        assert self.writer is not None
        dn = np.random.default_rng(seed).integers(0, 4096, (3, 4)).astype(np.uint16)
        shutter = "closed" if dark else "open"
        taken = FrameSettings(exposure_s, gain_db, pattern=pattern, shutter=shutter, black_level_dn=64.0)
        self.added.append(Frame(dn, 12, taken))
        self.writer.add(self.added[-1])

    @precondition(lambda self: self.writer)
    @rule()
    def finish(self) -> None:
        """With frames it is a capture set from now on; without one there is nothing to finish, and nothing is left."""
        assert self.writer is not None
        if not self.added:
            with pytest.raises(OutputError, match="nothing to finish"):
                self.writer.__exit__(None, None, None)
            self.state = "absent"
        else:
            self.writer.__exit__(None, None, None)
            self.state, self.digest = "finished", CaptureSet.read(self.folder).content_hash()
        self.writer = None

    @precondition(lambda self: self.writer)
    @rule()
    def fail(self) -> None:
        """An error while capturing removes what was written."""
        assert self.writer is not None
        self.writer.__exit__(RuntimeError, RuntimeError("camera gone"), None)
        self.writer, self.state = None, "absent"

    @precondition(lambda self: self.writer)
    @rule()
    def die(self) -> None:
        """A program that is killed leaves what it had written."""
        self.writer = None

    @precondition(lambda self: self.state != "absent" and not self.writer)
    @rule()
    def tidy(self) -> None:
        """Somebody removes the folder."""
        shutil.rmtree(self.folder)
        self.state = "absent"

    @precondition(lambda self: self.state == "finished")
    @rule(place=st.integers(0, 20))
    def lose_and_find_a_frame(self, place: int) -> None:
        """Without one of its files the set is incomplete, and says which; with it again it is the same."""
        file = self.folder / "frames" / f"{place % len(self.added):04d}.png"
        content = file.read_bytes()
        file.unlink()
        with pytest.raises(CaptureError, match=f"{file.name}.* does not exist"):
            CaptureSet.read(self.folder)
        file.write_bytes(content)

    @precondition(lambda self: self.state == "finished")
    @rule(place=st.integers(0, 20))
    def cut_a_frame(self, place: int) -> None:
        """Of a file cut short the set has another hash, and reading it is refused."""
        file = self.folder / "frames" / f"{place % len(self.added):04d}.png"
        content = file.read_bytes()
        file.write_bytes(content[:-20])
        found = CaptureSet.read(self.folder)
        assert found.content_hash() != self.digest
        with pytest.raises(CaptureError, match=file.name):
            list(found.frames())
        file.write_bytes(content)

    @invariant()
    def the_folder_is_what_it_says(self) -> None:
        """Absent or unfinished it is refused with that reason; finished it holds every frame in its order."""
        if self.state != "finished":
            said = "does not exist" if self.state == "absent" else "not finished"
            with pytest.raises(CaptureError, match=said):
                CaptureSet.read(self.folder)
            assert self.folder.exists() == (self.state == "unfinished")
            return
        found = CaptureSet.read(self.folder)
        assert (len(found), found.content_hash()) == (len(self.added), self.digest)
        for read, added in zip(found.frames(), self.added, strict=True):
            np.testing.assert_array_equal(read.dn, added.dn)
            assert read.settings == added.settings
        self.brackets_part_the_frames(found)

    def brackets_part_the_frames(self, found: CaptureSet) -> None:
        """A pattern's bracket holds its own light frames from short to long and every dark one."""
        for pattern in ("default", "chart"):
            own = [one for one in self.added if not one.settings.is_dark and one.settings.pattern == pattern]
            if not own:
                with pytest.raises(CaptureError, match="holds no frame of pattern"):
                    found.bracket(pattern)
                continue
            bracket = found.bracket(pattern)
            exposures = [one.settings.exposure_s * 10 ** (one.settings.gain_db / 20) for one in bracket.light]
            assert exposures == sorted(exposures)
            assert len(exposures) == len(own)
            assert len(bracket.dark) == sum(one.settings.is_dark for one in self.added)


def test_a_capture_set_is_all_or_nothing() -> None:
    """Whatever happens in whatever order, no one takes for a capture set what is not the whole of one."""
    run_state_machine_as_test(
        CaptureMachine,
        settings=settings(
            max_examples=25, stateful_step_count=12, deadline=None, suppress_health_check=list(HealthCheck)
        ),
    )
