"""A folder of captures against a plain list: begun, broken off, killed, finished, damaged, corrected in any order."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

from radiometer.data import CameraDescription, CaptureSet, CaptureSetWriter, Frame, FrameSettings
from radiometer.errors import CaptureError, OutputError

CAMERA = CameraDescription(bit_depth=12, serial="22500001")
exposures = st.sampled_from([0.001, 0.02, 0.5, 8.0])


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
        exposure_s=exposures,
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
