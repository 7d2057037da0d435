"""Opening a camera: checks, quirks, features and access to settings."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from drivers.cameras import aravis_camera, camera_opening
from drivers.cameras.aravis_camera import AravisCamera
from drivers.cameras.camera_checks import USB3_BYTES_S, check_features
from drivers.cameras.camera_opening import open_session
from drivers.cameras.camera_quirks import CameraMatch, load_preset, quirks_for
from drivers.cameras.feature_access import (
    FALSIFYING_FEATURES,
    LIMIT,
    SPEED,
    FalsifyingFeature,
    FeatureAccess,
    HygieneFinding,
    Refusal,
    choose_throughput,
    switch_off_falsifiers,
    translated,
)
from drivers.cameras.frame_stream import changed_chunks, switch_on_chunks
from drivers.cameras.settings_access import SettingsAccess
from radiometer.data.storage import shipped_config
from radiometer.devices import CameraIdentity, CameraSettings, Health, Roi
from radiometer.errors import ConfigurationError, DeviceError, DeviceInUse, DeviceLost, SettingOutOfRange

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


def test_chunks_are_switched_on_one_by_one(chunked, wooden_camera):
    """Only those that tell settings are touched: Image and CRC are locked on real cameras; none is missed."""
    camera, features = chunked(locked=("Image", "CRC"))
    notes: list[str] = []
    assert switch_on_chunks(camera, features, notes) == ("ExposureTime", "Gain", "BlackLevel")
    assert camera.features["ChunkModeActive"] is True
    assert camera.features.on == {"Image", "CRC", "ExposureTime", "Gain", "BlackLevel"}
    assert switch_on_chunks(*wooden_camera({"Gain": 0.0}), notes) == ()
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


def test_slowing_down_goes_by_quarters_to_the_lowest(wooden_camera):
    """Each step takes a quarter off to the lowest; a camera that refuses is noted, and opens all the same."""
    camera, found, _ = throughput(wooden_camera, gige=True, limit=2_000_000, speed=None)
    assert [found.slow_down() for _ in range(4)] == [True, True, True, False]
    assert found.limit_bytes_s == camera.features[LIMIT] == 1_000_000
    _, stubborn, _ = throughput(wooden_camera, gige=True, limit=2_000_000, speed=None, refused=(LIMIT,))
    assert stubborn.slow_down() is False
    _, locked, notes = throughput(wooden_camera, gige=True, limit=125_000_000, speed=125_000_000, refused=(LIMIT,))
    assert (locked, "frames may be lost" in notes[0]) == (None, True)


def test_a_camera_in_use_is_reported_before_the_library_is_asked(monkeypatch):
    """The library takes 5 s to say it; the camera itself says it at once."""
    monkeypatch.setattr(camera_opening, "is_controlled", lambda address: address == "10.0.0.2")
    monkeypatch.setattr(camera_opening, "name_at", lambda address: ("", "", ""))
    identity = CameraIdentity("FLIR", "BFS-PGE-19S4M", "0138C343", "FLIR-1", "GigEVision 10.0.0.2")
    with pytest.raises(DeviceInUse, match=r"camera FLIR BFS-PGE-19S4M 0138C343 \(20497219\) is in use by another"):
        open_session(None, RuntimeError, identity, None)


@pytest.mark.parametrize(
    ("vendor", "model", "info", "discarded"),
    [
        ("FLIR", "Blackfly S BFS-U3-19S4M", "", 2),
        ("Point Grey Research", "BFS-PGE-19S4M", "", 2),
        ("FLIR", "BFS-U3-19S4M", "simulated by radiometer", 0),
        ("Aravis", "Fake", "none", 0),
        ("Basler", "acA1920-40gm", "", 2),
    ],
)
def test_a_family_is_known_by_vendor_model_and_info(vendor, model, info, discarded):
    """Each family gets its own file, an unknown one the cautious default."""
    assert quirks_for(vendor, model, info).discard_after_change == discarded


def test_the_target_and_its_twin_alone_find_their_preset():
    """They share a sensor and so a preset, other names have none; an unknown one is refused with those there are."""
    for model in ("BFS-U3-19S4M", "Blackfly S BFS-U3-19S4M", "BFS-PGE-19S4M", "Blackfly S BFS-PGE-19S4M-C"):
        assert quirks_for("FLIR", model).preset_of(model).model == "BFS-U3-19S4M"
    assert quirks_for("FLIR", "BFS-U3-51S5M").preset_of("BFS-U3-51S5M") is None
    assert not CameraMatch(vendor="FLIR", model="BFS-U3-19S4M").fits("FLIR", "BFS-U3-19S4M-SPECIAL")
    with pytest.raises(ConfigurationError, match=r"BFS-U3-19S4M\.yaml"):
        load_preset("BFS-U3-99")


def test_every_figure_of_a_quirk_file_has_a_source():
    """What a quirk file sets beyond the default is explained."""
    for path in shipped_config("cameras/quirks/generic.yaml").parent.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        assert "sources:" in text, path
        assert "  discard_after_change:" in text, path


GAMMA = FalsifyingFeature("GammaEnable", False, "digital numbers are bent")

SHARP = FalsifyingFeature("SharpeningEnable", False, "edges shine")


class Features:
    """Features that answer what they are given."""

    def __init__(self, **values):
        self.values = values

    def read_if_there(self, name, kind):
        return self.values.get(name)

    def call(self, function):
        return function()


def camera(*, hygiene=(), notes=(), gige=False, packet=1400, believed=0, **features):
    session = SimpleNamespace(
        hygiene=hygiene,
        notes=notes,
        identity=SimpleNamespace(interface="eth0" if gige else ""),
        quirks=SimpleNamespace(mono16_left_aligned_bits=believed),
        features=Features(**features),
        camera=SimpleNamespace(is_gv_device=lambda: gige, gv_get_packet_size=lambda: packet),
    )
    return SimpleNamespace(session=session)


def found(name, **reported):
    return [f for f in check_features(camera(**reported)) if f.check == name]


def test_what_falsifies_and_could_not_be_switched_off_is_a_fault():
    """With the way out; what was switched off is a note, what was off already is named together."""
    hygiene = (
        HygieneFinding(GAMMA, True, True, "still_on", "it is locked"),
        HygieneFinding(SHARP, True, False, "switched_off", ""),
    )
    (gamma,), (sharp,) = (found(f"feature {name}", hygiene=hygiene) for name in ("GammaEnable", "SharpeningEnable"))
    assert (gamma.health, sharp.health) == (Health.FAULT, Health.NOTE)
    assert "power-on user set" in gamma.cure
    assert "was True and has been switched off, else edges shine" in sharp.message
    assert found("features", hygiene=hygiene) == []
    off = tuple(HygieneFinding(one, False, False, "off", "") for one in (GAMMA, SHARP))
    (together,) = found("features", hygiene=off)
    assert (together.health, together.message) == (Health.OK, "off as they must be: GammaEnable, SharpeningEnable")
    (none,) = found("features")
    assert none.health is Health.NOTE


@pytest.mark.parametrize(("packet", "health"), [(1400, Health.NOTE), (1500, Health.NOTE), (8952, Health.OK)])
def test_small_packets_are_noted(packet, health):
    """Up to 1500 bytes the interface's MTU may be raised."""
    (link,) = found("link", gige=True, packet=packet)
    assert link.health is health
    assert f"packets of {packet} bytes" in link.message
    assert bool(link.cure) is (health is Health.NOTE)


@pytest.mark.parametrize(
    ("speed", "health"),
    [(None, Health.OK), (USB3_BYTES_S, Health.OK), (USB3_BYTES_S - 1, Health.WARNING), (48_000_000, Health.WARNING)],
)
def test_a_usb_2_link_is_a_warning(speed, health):
    """500 MB/s are USB 3; what is not reported is not judged. What was noted at the opening is repeated."""
    (link,) = found("link", DeviceLinkSpeed=speed)
    assert link.health is health
    assert ("USB 2 link" in link.message, "USB 3 port" in link.cure) == (health is Health.WARNING,) * 2
    (opening,) = found("opening", notes=("it was so",), DeviceLinkSpeed=speed)
    assert (opening.health, opening.message) == (Health.NOTE, "it was so")


@pytest.mark.parametrize(
    ("depth", "believed", "warned"),
    [("Bit12", 12, False), ("Bit10", 12, True), ("Bit10", 0, False), ("Bit99", 12, False), (None, 12, False)],
)
def test_mono16_that_lies_otherwise_than_believed_is_a_warning(depth, believed, warned):
    """Only where both the converter's depth and the quirk file's are known and differ."""
    findings = found("Mono16", believed=believed, AdcBitDepth=depth)
    assert [f.health for f in findings] == ([Health.WARNING] if warned else [])


WANTED = CameraSettings(0.005, gain_db=6.0, black_level_dn=81.9, pixel_format="Mono12p", roi=Roi(16, 8, 64, 48))


ANSWERS = {
    "is_feature_available": False,
    "is_gain_available": True,
    "is_black_level_available": True,
    "is_binning_available": False,
    "get_exposure_time_bounds": (11.0, 30e6),
    "get_gain_bounds": (0.0, 47.9943),
    "get_black_level_bounds": (0.0, 12.5),
    "dup_available_pixel_formats_as_strings": ["Mono8", "Mono12p", "Mono16", "BayerRG8"],
    "get_sensor_size": SimpleNamespace(width=1616, height=1240),
    "get_device": SimpleNamespace(get_feature=lambda _name: SimpleNamespace(get_unit=lambda: "%")),
}


class WoodenAravis:
    """Remembers what it was set to, in its own units."""

    def __init__(self) -> None:
        self.set = {"exposure_time": 10_000.0, "gain": 0.0, "black_level": 0.0}
        self.format, self.region = "Mono8", (0, 0, 1616, 1240)

    def get_pixel_format_as_string(self) -> str:
        return self.format

    def set_pixel_format_from_string(self, name: str) -> None:
        self.format = name

    def set_region(self, *region: int) -> None:
        self.region = region

    def get_region(self) -> SimpleNamespace:
        return SimpleNamespace(**dict(zip(("x", "y", "width", "height"), self.region, strict=True)))

    def __getattr__(self, name: str):
        if name in ANSWERS:
            return lambda *_: ANSWERS[name]
        kind, _, setting = name.partition("_")
        if kind == "set" and setting in self.set:
            return lambda value: self.set.__setitem__(setting, value)
        if kind == "get" and setting in self.set:
            return lambda: self.set[setting]
        if name.endswith("_increment"):
            return lambda: 4
        raise AttributeError(name)


@pytest.fixture
def access(library_error) -> SettingsAccess:
    """Return the settings of a wooden Blackfly."""
    camera = WoodenAravis()
    features = FeatureAccess(camera, "camera W1", library_error)
    return SettingsAccess(camera, features, quirks_for("FLIR", "BFS-U3-19S4M"), "camera W1")


def test_the_camera_is_sent_microseconds_and_per_cent(access):
    """5 ms are 5000 µs, 81.9 DN of 4095 are 2 %; its own rounding comes back in s, dB and DN."""
    access.write(WANTED)
    assert access.camera.set == pytest.approx({"exposure_time": 5000.0, "gain": 6.0, "black_level": 2.0})
    assert access.camera.region == (16, 8, 64, 48)
    access.write(WANTED)
    access.camera.set.update(exposure_time=4999.16, gain=5.9998, black_level=1.953125)
    found = access.read()
    assert found.exposure_s == pytest.approx(4.99916e-3, rel=1e-12)
    assert (found.gain_db, found.pixel_format, found.roi) == (5.9998, "Mono12p", Roi(16, 8, 64, 48))
    assert found.black_level_dn == pytest.approx(79.98046875)


@pytest.mark.parametrize(("name", "full_scale"), [("Mono8", 255), ("Mono12p", 4095), ("Mono16", 4095)])
def test_limits_come_in_seconds_and_in_the_formats_own_numbers(access, name, full_scale):
    """Mono16 of this family holds twelve bits, so that a per cent of black level is 40.95 DN in it too."""
    limits = access.capabilities(name)
    assert limits.exposure_s == pytest.approx((11e-6, 30.0))
    assert limits.black_level_dn == pytest.approx((0.0, 0.125 * full_scale))
    assert limits.pixel_formats == ("Mono8", "Mono12p", "Mono16", "BayerRG8")


def test_pixels_of_unequal_binning_are_refused(access):
    """The frames' scale would be of neither 1 nor 2."""
    access.camera.is_binning_available = lambda: True
    access.camera.get_binning = lambda: SimpleNamespace(dx=2, dy=1)
    with pytest.raises(DeviceError, match="bins 2 × 1 pixels; set BinningHorizontal and BinningVertical alike"):
        access.read()


@pytest.mark.parametrize("exposure_s", [10e-6, 31.0])
def test_nothing_is_written_where_a_value_is_out_of_range(access, exposure_s):
    """The refusal gives the limits in s, and the camera keeps what it had."""
    before = dict(access.camera.set)
    with pytest.raises(SettingOutOfRange, match=r"allowed is 1\.1e-05 to 30 s"):
        access.check(replace(WANTED, exposure_s=exposure_s))
    assert access.camera.set == before


@pytest.mark.parametrize("error", [DeviceInUse("held by another"), DeviceLost("gone"), DeviceError("refused")])
def test_an_opening_that_fails_says_why_and_can_be_tried_again(monkeypatch, error):
    """The reason reaches whoever opens, and the camera is not taken for open: a second try asks it again."""
    asked = []

    def fail(*_arguments: object) -> None:
        asked.append(1)
        raise error

    monkeypatch.setattr(aravis_camera, "open_session", fail)
    monkeypatch.setattr(
        aravis_camera, "load_library", lambda: SimpleNamespace(aravis=None, glib=SimpleNamespace(Error=RuntimeError))
    )
    camera = AravisCamera(CameraIdentity("FLIR", "BFS", "W1", "FLIR-W1"))
    for _ in range(2):
        with pytest.raises(type(error), match=str(error)):
            camera.open()
    assert len(asked) == 2


HARMFUL = {bool: True, str: "Continuous", float: 0.8}


@pytest.mark.parametrize("feature", FALSIFYING_FEATURES, ids=lambda feature: feature.name)
def test_what_falsifies_is_switched_off_and_read_back(wooden_camera, feature):
    """Each falsifying feature that is on is switched off, and the finding says what it was."""
    camera, features = wooden_camera({feature.name: HARMFUL[type(feature.harmless)]})
    (finding,) = switch_off_falsifiers(features)
    assert finding.state == "switched_off"
    assert camera.features[feature.name] == feature.harmless
    assert finding.now == feature.harmless


class SelectedPatterns(dict):
    """Two test patterns behind one name, as a selector chooses them."""

    def __init__(self, **patterns: str) -> None:
        super().__init__(TestPatternGeneratorSelector="Sensor")
        self.patterns = patterns

    def __contains__(self, name: object) -> bool:
        return name in ("TestPattern", "TestPatternGeneratorSelector")

    def __getitem__(self, name: str) -> str:
        if name == "TestPattern":
            return self.patterns[super().__getitem__("TestPatternGeneratorSelector")]
        return str(super().__getitem__(name))

    def __setitem__(self, name: str, value: str) -> None:
        if name == "TestPattern":
            self.patterns[super().__getitem__("TestPatternGeneratorSelector")] = value
        else:
            super().__setitem__(name, value)


def test_every_test_pattern_generator_is_switched_off(wooden_camera):
    """A pattern drawn behind the second selector entry is found and ended, as the one behind the first."""
    camera, features = wooden_camera({})
    camera.features = SelectedPatterns(Sensor="Off", PipelineStart="Increment")
    assert [found.state for found in switch_off_falsifiers(features)] == ["off", "switched_off"]
    assert camera.features.patterns == {"Sensor": "Off", "PipelineStart": "Off"}


@pytest.mark.parametrize(
    ("features", "camera_does", "states", "said"),
    [
        ({"GammaEnable": False, "Gamma": 1.0, "ExposureAuto": "Off"}, {}, {"off"}, ""),
        ({"GammaEnable": True}, {"stuck": ("GammaEnable",)}, {"still_on"}, "no longer proportional to light"),
        (
            {"GainAuto": "Continuous", "LUTEnable": True},
            {"refused": ("GainAuto",)},
            {"still_on", "switched_off"},
            "GainAuto",
        ),
    ],
    ids=["off already", "keeps its value", "refuses the write"],
)
def test_what_is_off_is_left_alone_and_what_stays_on_is_reported(wooden_camera, features, camera_does, states, said):
    """With what it does to the measurement; the others are still treated."""
    camera, access = wooden_camera(features, **camera_does)
    findings = switch_off_falsifiers(access)
    assert {finding.state for finding in findings} == states
    assert [str(f) for f in findings if f.state == "still_on" and said not in str(f)] == []
    assert (camera.written == []) is (states == {"off"})


def test_a_lost_camera_is_not_taken_for_a_stubborn_one(wooden_camera, library_error):
    """A camera that stops answering while it is being cleaned raises DeviceLost."""
    camera, _ = wooden_camera({"GammaEnable": True})

    def vanish(name: str, value: bool) -> None:
        raise library_error("read_register timeout", code=5)

    camera.set_boolean = vanish
    with pytest.raises(DeviceLost):
        switch_off_falsifiers(FeatureAccess(camera, "camera W1", library_error))


@pytest.mark.parametrize(
    ("code", "kind"), [(5, DeviceLost), (4, DeviceLost), (2, DeviceLost), (10, DeviceInUse), (1, Refusal)]
)
def test_errors_of_the_library_become_the_projects_own(library_error, code, kind):
    """Each code of the library becomes the error that says what to do, with the camera's name."""
    error = translated(library_error("text of the library", code), "camera W1")
    assert type(error) is kind
    assert "camera W1" in str(error)


def test_the_target_has_most_of_the_listed_features(shared_data):
    """The names are not invented: FLIR's description of the target's twin knows the greater part of them."""
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    known = [f.name for f in FALSIFYING_FEATURES if re.search(rf'<(Boolean|Enumeration|Float) Name="{f.name}"', text)]
    assert len(known) >= 10
    assert {"ExposureAuto", "GainAuto", "Gamma", "GammaEnable", "SharpeningEnable", "LUTEnable"} <= set(known)
    assert {"DefectCorrectStaticEnable", "BlackLevelClampingEnable"} <= set(known)
