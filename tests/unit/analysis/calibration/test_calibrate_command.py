"""`radiometer calibrate`: scales that readings then reproduce, and refusals in one line."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.reading.reading import read_patch
from radiometer.cli.main import run
from radiometer.data import Calibration, CaptureSetWriter, Patch, PatchDescription, ResponseCurve
from radiometer.data.setup import Setup

METER_WORDS = {"--luminance-meter-k": "16.5", "--f-number": "16", "--exposure": "1/125", "--iso": "136"}


def meter(**other):
    """Return the words of a light meter's reading, some of them others: each is given once."""
    words = METER_WORDS | {f"--{name.replace('_', '-')}": value for name, value in other.items()}
    return [word for pair in words.items() for word in pair]


METER = meter()


@pytest.fixture
def curve(tmp_path):
    """Return the file of an 8-bit gamma curve."""
    dn = np.arange(256.0)
    with np.errstate(divide="ignore"):
        ResponseCurve(2.2 * np.log(dn / 128), np.full(256, 0.005), valid_dn=(2, 253)).write(tmp_path / "curve.csv")
    return tmp_path / "curve.csv"


@pytest.fixture
def capture(rig, tmp_path):
    """Return a capture set of a source of known radiance, and that radiance."""
    radiance = 0.6 * rig.radiance_of_full_scale(1e-3)
    known = PatchDescription(name="port", x=1, y=1, width=20, height=20, radiance_W_per_sr_m2=radiance, u_rel=0.004)
    rng = np.random.default_rng(1)
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens, patches=(known,)) as writer:
        for exposure_s in (2.5e-4, 5e-4, 1e-3):
            writer.add(rig.frame(np.full((24, 24), radiance), exposure_s, rng))
    return tmp_path / "capture", radiance


def test_a_scale_from_a_known_source_reads_other_patches_right(rig, capture, tmp_path):
    """The calibration made from one radiance reads a ten times lower one within its interval."""
    folder, radiance = capture
    assert run(["calibrate", str(folder), "-o", str(tmp_path / "cal.yaml")]) == 0
    calibration = Calibration.read(tmp_path / "cal.yaml")
    assert calibration.scale.value == pytest.approx(rig.true_scale, rel=0.002)
    assert calibration.scale.u_rel == pytest.approx(math.hypot(0.004, 0.001), rel=0.1)
    frames = rig.frames(np.full((24, 24), radiance / 10), np.random.default_rng(2), (1e-3, 2e-3, 4e-3, 8e-3, 8e-3))
    reading = read_patch(frames, Patch(0, 0, 24, 24), Setup(rig.description, rig.lens, calibration))
    assert abs(reading.radiance.value - radiance / 10) < 2 * reading.radiance.u
    assert reading.flags == ()


def test_the_meter_puts_the_reference_pixel_at_its_exposure(curve, tmp_path, capsys):
    """At face value the thesis's figures; a dial's 1/60 s is 15.625 ms, which the report states."""
    command = ["calibrate", "--response", str(curve), *METER, "--as-printed", "--reference-dn", "127", "--json"]
    assert run([*command, "-o", str(tmp_path / "cal.yaml")]) == 0
    report = json.loads(capsys.readouterr().out)
    assert round(report["metered"]["luminance"]["value"], 4) == 3882.3529
    assert report["metered"]["thesis_spectral_radiance"]["value"] == pytest.approx(53.2234, abs=1e-4)
    assert report["metered"]["thesis_spectral_radiance"]["unit"] == "W sr-1 m-2 um-1"
    calibration = Calibration.read(tmp_path / "cal.yaml")
    exposure = calibration.scale.value * (127 / 128) ** 2.2
    radiance = report["metered"]["radiance"]["value"]
    assert exposure == pytest.approx(radiance * math.pi / 4 / 256 / 125, rel=1e-6)
    of_iso_2720 = (13.4 - 10.6) / (13.4 + 10.6) / math.sqrt(3)
    expected = math.hypot(math.log(2) / 6 / math.sqrt(3), of_iso_2720, 0.005)
    assert calibration.scale.u_rel == pytest.approx(expected, rel=1e-3)
    command = ["calibrate", "--response", str(curve), "--luminance-meter-k", "12.5", "--f-number", "16", "--iso", "100"]
    command += ["--exposure", "1/60", "--reference-dn", "127", "--json"]
    for name, more, shown in (("a", [], True), ("b", ["--as-printed"], False)):
        assert run([*command, *more, "-o", str(tmp_path / f"{name}.yaml")]) == 0
        assert ("15.625 ms" in capsys.readouterr().out) == shown
    assert run(["60" if word == "1/60" else word for word in [*command, "-o", str(tmp_path / "c.yaml")]]) == 2
    assert "is 60 s meant, or 1/60 s?" in capsys.readouterr().err


def test_both_ways_give_a_ratio_and_the_better_scale(capture, tmp_path, capsys):
    """With meter and source the ratio is printed with its uncertainty, and the source's scale is kept."""
    folder, _ = capture
    command = ["calibrate", str(folder), *METER, "--reference-dn", "1000", "--json", "-o", str(tmp_path / "cal.yaml")]
    assert run(command) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["scale"]["method"] == "known_radiance"
    ratio = report["meter_over_source"]
    assert ratio["u"] / ratio["value"] == pytest.approx(math.hypot(0.0668, 0.0674), rel=0.01)
    other = Calibration.read(tmp_path / "cal.yaml").provenance.parameters["other_scale"]
    assert other["value"] / report["scale"]["value"] == pytest.approx(ratio["value"])


def test_a_known_luminance_goes_through_the_spectrum(capture, tmp_path):
    """683 cd/m² at 555 nm are 1 W·sr⁻¹·m⁻²."""
    folder, radiance = capture
    common = ["calibrate", str(folder), "--patch", "1,1,20,20", "--u-rel", "0.01", "--spectrum", "line:555"]
    assert run([*common, "--luminance", str(683 * radiance), "-o", str(tmp_path / "a.yaml")]) == 0
    assert run([*common, "--radiance", str(radiance), "-o", str(tmp_path / "b.yaml")]) == 0
    scales = [Calibration.read(tmp_path / name).scale.value for name in ("a.yaml", "b.yaml")]
    assert scales[0] == pytest.approx(scales[1], rel=1e-6, abs=0.0)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["-o", "{out}"], 2, "--radiance"),
        (["-o", "{out}", *METER], 2, "--response"),
        (["-o", "{out}", "--luminance-meter-k", "16.5"], 2, "--f-number"),
        (["-o", "{out}", "--radiance", "1", "--u-rel", "0.1"], 2, "capture set"),
        (["{capture}", "-o", "{out}", "--patch", "0,0,99,99", "--radiance", "1", "--u-rel", "0.1"], 1, "99"),
        (["{capture}", "-o", "{out}", "--patch", "1,1,9,9", "--radiance", "1"], 2, "--u-rel"),
        (["{capture}", "-o", "{out}", "--spectrum", "moon"], 1, "equal_energy"),
        (["{capture}", "-o", "{out}", "--response", "{curve}"], 1, "8 bits"),
        (["{capture}", "-o", "{out}", *METER, "--reference-dn", "5000"], 2, "5000"),
        (["{capture}", "-o", "{out}", *METER, "--reference-dn", "4095"], 2, "4095"),
        (["{capture}", "-o", "{out}", *METER, "--reference-dn", "64"], 2, "above 64 and below 4095 DN"),
        (["{capture}", "-o", "{out}", "--camera", "sim"], 2, "not both"),
        (["{capture}", "-o", "{out}", "--radiance", "1", "--luminance", "1", "--u-rel", "0.1"], 2, "exclude"),
        (["{capture}", "-o", "{out}", "--f-number", "8"], 2, "f/4"),
        (["{capture}", "-o", "{out}", "--stated", "glare_u"], 2, "NAME=U"),
        (["{capture}", "-o", "{out}", "--stated", "glare_u=-0.1"], 2, "0 or more"),
        (["{capture}", "-o", "{out}", "--stated", "glare_u=1e300"], 2, "stated is"),
        (["{capture}", "-o", "{out}", "--dynamic-range", "254,1/2000"], 2, "--response"),
        (["-o", "{out}", "--response", "{curve}", *METER, "--dynamic-range", "254,1/2000,1,2"], 2, "M,TIME"),
        (["-o", "{out}", "--response", "{curve}", *METER, "--dynamic-range", "a,1/2000"], 2, "M,TIME"),
        (["-o", "{out}", "--response", "{curve}", *meter(exposure="9999999999s")], 2, "exposure_s is 9999999999"),
        (["{capture}", "-o", "{out}", "--flat", "{curve}"], 1, "curve.csv"),
        (
            ["-o", "{out}", "--response", "{curve}", *METER, "--measured-iso", "100=136"],
            2,
            "no photograph states ISO 100",
        ),
    ],
)
def test_misuse_is_one_line_and_an_exit_code(words, code, message, capture, curve, tmp_path, capsys):
    """No traceback, the message names the way out, and nothing is written."""
    places = {"out": tmp_path / "cal.yaml", "capture": capture[0], "curve": curve}
    assert run(["calibrate", *(word.format(**places) for word in words)]) == code
    printed = capsys.readouterr().err.rpartition("\n\nError: ")[2]  # after the usage, where that is what is wrong
    assert message in printed
    assert len(printed.strip().splitlines()) == 1
    assert not (tmp_path / "cal.yaml").exists()


def test_a_clipped_source_carries_no_scale(rig, tmp_path, capsys):
    """The refusal names the flag."""
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens) as writer:
        writer.add(rig.frame(np.full((9, 9), 9 * rig.radiance_of_full_scale(1e-3)), 1e-3, np.random.default_rng(1)))
    command = ["calibrate", str(tmp_path / "capture"), "--patch", "0,0,9,9", "--radiance", "1", "--u-rel", "0.01"]
    assert run([*command, "-o", str(tmp_path / "cal.yaml")]) == 1
    assert "saturated" in capsys.readouterr().err


def test_the_scale_says_what_it_is_made_up_from(capture, tmp_path, capsys):
    """Squares of the contributions sum to that of u, the largest first; stated ones take the default's place."""
    folder, _ = capture
    assert run(["calibrate", str(folder), "-o", str(tmp_path / "cal.yaml")]) == 0
    scale = Calibration.read(tmp_path / "cal.yaml").scale
    assert math.hypot(*scale.budget.values()) == pytest.approx(scale.u_rel, rel=1e-9)
    printed = capsys.readouterr().out
    assert printed.index("reference source") < printed.index("response curve")
    command = ["calibrate", str(folder), "-o", str(tmp_path / "cal.yaml"), "--force"]
    assert run([*command, "--stated", "glare_u=0.002"]) == 0
    assert Calibration.read(tmp_path / "cal.yaml").uncertainties.glare_u == 0.002
    assert run([*command, "--stated", "glare=0.002"]) == 2
    assert "glare_u" in capsys.readouterr().err


def test_frames_at_lower_source_levels_are_left_aside(rig, tmp_path):
    """What is known of a patch holds at level 1: frames at other levels, the room's light among them, do not count."""
    radiance = 0.6 * rig.radiance_of_full_scale(1e-3)
    known = PatchDescription(name="port", x=1, y=1, width=20, height=20, radiance_W_per_sr_m2=radiance, u_rel=0.004)
    rng = np.random.default_rng(1)
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens, patches=(known,)) as writer:
        for level in (0.0, 0.5, 1.0):
            writer.add(rig.frame(np.full((24, 24), level * radiance), 1e-3, rng, source_level=level))
    assert run(["calibrate", str(tmp_path / "capture"), "-o", str(tmp_path / "cal.yaml")]) == 0
    assert Calibration.read(tmp_path / "cal.yaml").scale.value == pytest.approx(rig.true_scale, rel=0.002)


def test_the_meter_alone_needs_no_patch(rig, tmp_path):
    """A capture set then only says what camera and lens there are."""
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens) as writer:
        writer.add(rig.frame(np.full((9, 9), 1.0), 1e-3, np.random.default_rng(1)))
    command = ["calibrate", str(tmp_path / "capture"), *METER, "--reference-dn", "1000"]
    assert run([*command, "-o", str(tmp_path / "cal.yaml")]) == 0
    calibration = Calibration.read(tmp_path / "cal.yaml")
    assert calibration.camera.serial == "1"
    assert calibration.scale.method == "light_meter_k"


@pytest.mark.parametrize(("words", "u_rel"), [([], 0.43), (["--spectrum", "white_led"], 0.0)])
def test_a_spectrum_without_a_statement_is_known_to_43_percent(capture, tmp_path, words, u_rel):
    """Stated among the assumptions; a stated spectrum carries none of it."""
    folder, _ = capture
    assert run(["calibrate", str(folder), *words, "-o", str(tmp_path / "cal.yaml")]) == 0
    calibration = Calibration.read(tmp_path / "cal.yaml")
    assert calibration.uncertainties.efficacy_u_rel == u_rel
    assert any("43 %" in text for text in calibration.provenance.assumptions) == (not words)


@pytest.mark.parametrize("known", [0, 2])
def test_of_no_or_several_known_patches_the_user_names_one(rig, tmp_path, known, capsys):
    """Which source is meant is asked, with their number; nothing is written."""
    patches = tuple(
        PatchDescription(name=f"p{k}", x=12 * k, y=0, width=10, height=10, radiance_W_per_sr_m2=5.0, u_rel=0.01)
        for k in range(known)
    )
    with CaptureSetWriter(tmp_path / "capture", rig.description, rig.lens, patches=patches) as writer:
        writer.add(rig.frame(np.full((24, 24), 5.0), 1e-3, np.random.default_rng(1)))
    assert run(["calibrate", str(tmp_path / "capture"), "-o", str(tmp_path / "cal.yaml")]) == 2
    printed = capsys.readouterr().err
    assert "--patch" in printed
    assert f"{known} patches" in printed
    assert not (tmp_path / "cal.yaml").exists()


def test_the_scale_holds_for_the_spectrum_that_it_was_made_with(rig, capture, tmp_path):
    """A scale under 500 nm reads 600 nm light, to which the camera responds twice as much, as half of its numbers."""
    folder, radiance = capture
    (tmp_path / "response.csv").write_text("400,0\n500,1\n600,2\n700,3\n")
    words = ["--spectrum", "line:500", "--spectral-response", str(tmp_path / "response.csv")]
    assert run(["calibrate", str(folder), *words, "-o", str(tmp_path / "cal.yaml")]) == 0
    made = Calibration.read(tmp_path / "cal.yaml")
    frames = rig.frames(np.full((24, 24), radiance), np.random.default_rng(2), (1e-3,) * 5)
    read = [
        read_patch(
            frames, Patch(2, 2, 20, 20), Setup(rig.description, rig.lens, replace(made, spectrum=name))
        ).radiance.value
        for name in ("line:500", "line:600")
    ]
    assert read[1] / read[0] == pytest.approx(0.5, rel=1e-9)
    assert read[0] == pytest.approx(radiance, rel=0.01)
