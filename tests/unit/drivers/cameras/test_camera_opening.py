"""What opening a camera does with features that are locked, refuse, or want another value."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers.cameras import camera_opening
from drivers.cameras.camera_checks import check_features
from drivers.cameras.camera_opening import open_session
from drivers.cameras.camera_quirks import quirks_for
from drivers.cameras.chunk_data import changed_chunks, switch_on_chunks
from drivers.cameras.link_throughput import LIMIT, SPEED, choose_throughput
from radiometer.devices import CameraIdentity, CameraSettings, Health
from radiometer.errors import DeviceInUse, DeviceLost

OFFERED = ("Image", "CRC", "FrameID", "ExposureTime", "Gain", "BlackLevel")


class ChunkSwitches(dict):
    """Features in which ChunkEnable is that of the selected chunk."""

    def __init__(self, on: set[str]) -> None:
        super().__init__(ChunkModeActive=False, ChunkSelector="Image", ChunkEnable=False)
        self.on = on

    def __getitem__(self, name: str):
        return super().__getitem__("ChunkSelector") in self.on if name == "ChunkEnable" else super().__getitem__(name)

    def __setitem__(self, name: str, value) -> None:
        if name == "ChunkEnable" and value:
            self.on.add(super().__getitem__("ChunkSelector"))
        else:
            super().__setitem__(name, value)


@pytest.fixture
def chunked(wooden_camera, library_error):
    """Return a function that makes a camera with chunks of which some cannot be switched on."""

    def make(locked: tuple[str, ...] = (), on: tuple[str, ...] = ("Image", "CRC"), **options):
        camera, features = wooden_camera({}, **options)
        camera.features = ChunkSwitches(set(on))
        plain = camera.set_boolean

        def set_boolean(name: str, value: bool) -> None:
            if name == "ChunkEnable" and camera.features["ChunkSelector"] in locked:
                raise library_error("[ChunkEnable] node is locked")
            plain(name, value)

        camera.set_boolean = set_boolean
        camera.dup_available_enumerations_as_strings = lambda _name: OFFERED
        return camera, features

    return make


def test_chunks_are_switched_on_one_by_one(chunked):
    """Only those that tell settings are touched: the switches of Image and CRC are locked on real cameras."""
    camera, features = chunked(locked=("Image", "CRC"))
    notes: list[str] = []
    assert switch_on_chunks(camera, features, notes) == ("ExposureTime", "Gain", "BlackLevel")
    assert camera.features["ChunkModeActive"] is True
    assert camera.features.on == {"Image", "CRC", "ExposureTime", "Gain", "BlackLevel"}
    assert notes == []


@pytest.mark.parametrize(
    ("camera_has", "chunks", "note"),
    [
        ({"locked": ("Gain",)}, ("ExposureTime", "BlackLevel"), "camera W1: the camera refused ([ChunkEnable] node is"),
        ({"locked": ("Gain",), "on": ("Gain",)}, ("ExposureTime", "Gain", "BlackLevel"), None),
        ({"refused": ("ChunkModeActive",)}, (), "thrown away by number"),
    ],
)
def test_what_is_locked_or_refused_is_noted_and_done_without(chunked, camera_has, chunks, note):
    """The others are switched on all the same; a locked switch that is on already is used."""
    camera, features = chunked(**camera_has)
    notes: list[str] = []
    assert switch_on_chunks(camera, features, notes) == chunks
    assert len(notes) == (note is not None)
    assert note is None or note in notes[0]


def test_a_camera_that_vanishes_among_its_chunks_is_lost(chunked, library_error):
    """A time-out in the middle is not taken for a locked switch."""
    camera, features = chunked()

    def vanish(_name: str, _value: str) -> None:
        raise library_error("write_register timeout", code=5)

    camera.set_string = vanish
    with pytest.raises(DeviceLost):
        switch_on_chunks(camera, features, [])


def test_a_camera_without_chunks_needs_no_note(wooden_camera):
    """What is not there is not missed."""
    camera, features = wooden_camera({"Gain": 0.0})
    notes: list[str] = []
    assert switch_on_chunks(camera, features, notes) == ()
    assert notes == []


def test_what_was_changed_says_which_chunks_must_agree():
    """Each of the three settings that a chunk reports names its chunk; a region names none."""
    before = CameraSettings(exposure_s=0.01, gain_db=0.0, black_level_dn=64.0)
    assert changed_chunks(before, before) == frozenset()
    assert changed_chunks(before, CameraSettings(0.02, 0.0, 64.0, binning=2)) == {"ExposureTime"}
    assert changed_chunks(before, CameraSettings(0.01, 6.0, 60.0)) == {"Gain", "BlackLevel"}


def throughput(wooden_camera, *, gige: bool, limit: int, speed: int | None, **options):
    features = {LIMIT: limit} | ({} if speed is None else {SPEED: speed})
    camera, access = wooden_camera(features, **options)
    camera.get_integer_bounds, camera.is_gv_device = lambda _name: (1_000_000, 500_000_000), lambda: gige
    notes: list[str] = []
    return camera, choose_throughput(camera, access, "camera W1", notes), notes


@pytest.mark.parametrize(
    ("gige", "limit", "speed", "chosen"),
    [
        (True, 125_000_000, 125_000_000, 112_500_000),
        (True, 80_000_000, 125_000_000, 80_000_000),
        (True, 125_000_000, 12_500_000, 11_250_000),
        (False, 380_000_000, 500_000_000, 325_000_000),
        (False, 380_000_000, 60_000_000, 39_000_000),
        (True, 125_000_000, None, 125_000_000),
    ],
    ids=["gigabit", "slower already", "100 Mbit/s", "USB 3", "USB 2", "speed unknown"],
)
def test_the_camera_sends_less_than_its_link_carries(wooden_camera, gige, limit, speed, chosen):
    """The limit lies below the link's speed, is only ever lowered, and a change is noted."""
    camera, found, notes = throughput(wooden_camera, gige=gige, limit=limit, speed=speed)
    assert camera.features[LIMIT] == found.limit_bytes_s == chosen
    assert bool(notes) is (chosen != limit)


def test_a_locked_limit_is_noted(wooden_camera):
    """A camera that refuses it opens all the same."""
    _, found, notes = throughput(wooden_camera, gige=True, limit=125_000_000, speed=125_000_000, refused=(LIMIT,))
    assert found is None
    assert "frames may be lost" in notes[0]


def test_slowing_down_goes_by_quarters_to_the_lowest(wooden_camera):
    """Each step takes a quarter off; at the lowest, or where the camera refuses, that is the end of it."""
    camera, found, _ = throughput(wooden_camera, gige=True, limit=2_000_000, speed=None)
    assert [found.slow_down() for _ in range(4)] == [True, True, True, False]
    assert found.limit_bytes_s == camera.features[LIMIT] == 1_000_000
    _, stubborn, _ = throughput(wooden_camera, gige=True, limit=2_000_000, speed=None, refused=(LIMIT,))
    assert stubborn.slow_down() is False


def test_a_camera_in_use_is_reported_before_the_library_is_asked(monkeypatch):
    """The library takes 5 s to say it; the camera itself says it at once."""
    monkeypatch.setattr(camera_opening, "is_controlled", lambda address: address == "10.0.0.2")
    monkeypatch.setattr(camera_opening, "name_at", lambda address: ("", "", ""))
    identity = CameraIdentity("FLIR", "BFS-PGE-19S4M", "0138C343", "FLIR-1", "GigEVision 10.0.0.2")
    with pytest.raises(DeviceInUse, match=r"camera FLIR BFS-PGE-19S4M 0138C343 \(20497219\) is in use by another"):
        open_session(None, RuntimeError, identity, None)


@pytest.mark.parametrize(
    ("speed", "health"), [(60_000_000, Health.WARNING), (500_000_000, Health.OK), (None, Health.OK)]
)
def test_an_open_usb_camera_reports_its_link_itself(wooden_camera, speed, health):
    """60 MB/s is a USB 2 link, warned of with the cure; a camera that does not say is not suspected."""
    camera, features = wooden_camera({} if speed is None else {SPEED: speed})
    camera.is_gv_device = lambda: False
    session = SimpleNamespace(
        camera=camera, features=features, hygiene=(), notes=("it was so",), quirks=quirks_for("FLIR", "BFS-U3-19S4M"),
        identity=CameraIdentity("FLIR", "BFS-U3-19S4M", "0138C343", "FLIR-1", "USB3Vision"),
    )  # fmt: skip
    found = {finding.check: finding for finding in check_features(SimpleNamespace(session=session))}
    assert found["link"].health is health
    assert ("USB 3 port" in found["link"].cure) is (health is Health.WARNING)
    assert (found["opening"].health, found["opening"].message) == (Health.NOTE, "it was so")
