"""A response recovered with a shutter's offset, given for other photographs of the camera or in a calibration."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiometer.analysis.response.shutter_offset import is_possible
from radiometer.cli.main import run
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FoundEffects,
    Frame,
    FrameSettings,
    LensDescription,
    Provenance,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.photographs.response import offset_in_words, shutter_offset_of, with_offset_of_response
from radiometer.photographs.scene import Photographs, prepared
from testing.photograph_folder import write_jpeg

OFFSET_S, U_S = 3e-5, 4e-6
LABELS_S = tuple(2.0**-k for k in (13, 12, 11, 10))
SAID = "all exposures 30.0 ± 4.0 µs longer than their labels, the shutter's offset that the response was recovered with"
NOT_TAKEN = "the shutter's offset of the response (exposures 30.0 ± 4.0 µs longer than their labels) is not used"


def curve(**parameters: object) -> ResponseCurve:
    dn = np.arange(256.0)
    g = np.log(np.maximum(dn, 0.25) / 128.0)
    return ResponseCurve(g, np.full(256, 1e-4), valid_dn=(1, 254), provenance=Provenance("auto", parameters=parameters))


def of_offset(seconds: float = OFFSET_S) -> ResponseCurve:
    return curve(shutter_offset_s=seconds, u_shutter_offset_s=U_S)


def bracket(*labels_s: float) -> Bracket:
    dark = Frame(np.zeros((2, 2), np.uint8), 8, FrameSettings(1.0, shutter="closed"))
    light = [Frame(np.full((2, 2), 9, np.uint8), 8, FrameSettings(one)) for one in labels_s]
    return Bracket.from_frames([*light, dark], origin="here")


@pytest.fixture
def photographs(tmp_path):
    """Return a folder of four linear photographs whose EXIF times are too short by the offset, and a response."""
    folder, rng = tmp_path / "photographs", np.random.default_rng(5)
    light = rng.uniform(0.05, 3.0, (40, 60))
    for k, label in enumerate(LABELS_S):
        dn = 100.0 * light * (label + OFFSET_S) / 2.0**-12 + rng.normal(0.0, 0.5, light.shape)
        write_jpeg(folder / f"p{k}.jpg", dn, label)
    of_offset().write(tmp_path / "offset.yaml")
    curve().write(tmp_path / "plain.yaml")
    return folder


def merged(folder, response, capsys) -> tuple[dict, str]:
    """Return what `merge` reports, and what it notes."""
    capsys.readouterr()
    words = ["--response", str(folder.parent / response), "-o", str(folder.parent / "map.exr"), "--align", "off"]
    assert run(["merge", "--force", str(folder), *words, "--json"]) == 0
    printed = capsys.readouterr()
    return json.loads(printed.out), printed.err


def test_exif_times_are_lengthened_by_it_which_is_reported(photographs, capsys):
    """The map is that of exposures listed as label and offset, and reports it among its assumptions."""
    found, text = merged(photographs, "offset.yaml", capsys)
    assert f"{SAID}\n" in text
    assert SAID in found["assumptions"]
    plain, nothing = merged(photographs, "plain.yaml", capsys)
    assert "shutter" not in nothing + " ".join(plain["assumptions"])
    listed = "".join(f"p{k}.jpg {label + OFFSET_S!r}\n" for k, label in enumerate(LABELS_S))
    (photographs / "exposures.txt").write_text(listed)
    by_list, refused = merged(photographs, "offset.yaml", capsys)
    assert f"{NOT_TAKEN}: exposures.txt gives the exposures\n" in refused
    assert NOT_TAKEN not in " ".join(by_list["assumptions"])
    assert SAID not in by_list["assumptions"]
    assert found["exposures_s"] == by_list["exposures_s"] == [label + OFFSET_S for label in LABELS_S]
    assert plain["exposures_s"] == list(LABELS_S)
    assert found["values"] == by_list["values"]
    assert found["values"]["median"] < 0.98 * plain["values"]["median"]


def test_a_calibration_and_its_readings_have_it(tmp_path, capsys):
    """A source of 1 W/(sr m²) at 1/8192 s gives the scale, by which one of 0.5 at 1/512 s is read and mapped."""
    of_offset().write(tmp_path / "offset.yaml")
    for name, radiance, label in (("known", 1.0, 2.0**-13), ("other", 0.5, 2.0**-9)):
        dn = np.full((24, 36), 60.0 * radiance * (label + OFFSET_S) / 2.0**-11)
        dn = np.random.default_rng(6).normal(dn, 0.7)
        write_jpeg(tmp_path / name / "p.jpg", dn, label)
    known, other = str(tmp_path / "known"), str(tmp_path / "other")
    patch, scale = ["--patch", "4,4,20,16"], ["--calibration", str(tmp_path / "cal.yaml")]
    source = ["--radiance", "1", "--u-rel", "0.01", "--response", str(tmp_path / "offset.yaml")]

    def report_of(*words: str) -> dict:
        capsys.readouterr()
        assert run(list(words)) == 0
        found = capsys.readouterr()
        assert SAID in found.err
        return json.loads(found.out)

    report_of("calibrate", known, *patch, *source, "-o", str(tmp_path / "cal.yaml"), "--json")
    read = report_of("measure", "--photographs", other, *patch, *scale, "--json")["radiance"]["value"]
    assert read == pytest.approx(0.5, rel=0.01)
    found = report_of("merge", other, *scale, "-o", str(tmp_path / "map.exr"), "--json")
    assert found["values"]["median"] == pytest.approx(0.5, rel=0.02)
    assert SAID in found["assumptions"]


def test_a_model_that_holds_an_offset_takes_its_own():
    """What `reconcile` found of exposures is in a calibration's effects, and is not added twice."""
    camera = CameraDescription(bit_depth=8)
    calibration = Calibration(
        camera=camera,
        lens=LensDescription(),
        scale=Scale(value=1.0, u_rel=0.01, method="known_radiance"),
        response=of_offset(),
        noise=SensorNoise.of(camera),
        black_level=BlackLevel(dn=0.0),
    )
    labelled = Photographs({"mono": bracket(*LABELS_S)}, Path("here"))
    times = [frame.settings.exposure_s for frame in prepared(labelled, calibration=calibration).only.light]
    assert times == [label + OFFSET_S for label in LABELS_S]
    held = replace(calibration, found=FoundEffects(exposure_offset_s=1e-5))
    assert [f.settings.exposure_s for f in prepared(labelled, calibration=held).only.light] == list(LABELS_S)


def test_every_exposure_is_longer_by_it_within_what_a_shutter_can_do():
    """Numbers and darks stay; 0.9 ms or a stop of the shortest at most."""
    timed, text, taken = with_offset_of_response(bracket(*LABELS_S), of_offset(), None)
    assert [frame.settings.exposure_s for frame in timed.light] == [label + OFFSET_S for label in sorted(LABELS_S)]
    assert [frame.settings.exposure_s for frame in timed.dark] == [1.0]
    assert (timed.origin, text, taken) == ("here", SAID, True)
    short = bracket(3e-5, 1e-3)
    timed, text, taken = with_offset_of_response(short, of_offset(), None)
    assert timed is short
    assert (text, taken) == (f"{NOT_TAKEN}: it is too large for an exposure of 3e-05 s", False)
    assert with_offset_of_response(bracket(3.1e-5, 1e-3), of_offset(), None)[2]
    for offset_s, shortest_s, possible in (
        (8.99e-4, 1.0, True), (9.01e-4, 1.0, False), (9.9e-5, 1e-4, True), (1e-4, 1e-4, False),
        (-4.9e-5, 1e-4, True), (-5e-5, 1e-4, False),
    ):  # fmt: skip
        assert is_possible(offset_s, shortest_s) is possible


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"shutter_offset_s": OFFSET_S},
        {"shutter_offset_s": "long", "u_shutter_offset_s": U_S},
        {"shutter_offset_s": float("nan"), "u_shutter_offset_s": U_S},
        {"shutter_offset_s": OFFSET_S, "u_shutter_offset_s": float("inf")},
        {"shutter_offset_s": None, "u_shutter_offset_s": U_S},
    ],
)
def test_a_response_that_has_none_changes_nothing(parameters):
    """Nor does one whose file holds no number there, nor none, as of linear photographs."""
    labelled = bracket(*LABELS_S)
    assert with_offset_of_response(labelled, None, "exposures.txt") == (labelled, None, False)
    assert shutter_offset_of(curve(**parameters)) is None
    assert with_offset_of_response(labelled, curve(**parameters), None) == (labelled, None, False)


def test_a_response_of_the_same_photographs_reports_it_in_the_map():
    """Shorter exposures are reported to be shorter."""
    sentence = "all exposures 30.0 ± 4.0 µs {} than their labels, the shutter's offset"
    assert offset_in_words(of_offset()) == sentence.format("longer")
    assert offset_in_words(of_offset(-OFFSET_S)) == sentence.format("shorter")
    assert offset_in_words(replace(curve(), channel="red")) is None
