"""Options of `radiometer measure`: f-number, ISO and what else it is given."""

import json
import math

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data import Calibration, ResponseCurve
from testing.photograph_folder import eight_bits, write_jpeg, write_photographs


@pytest.mark.slow
def test_the_drawn_interval_is_next_to_the_budget_s(capsys):
    """On the simulated bench both agree: the ends lie within the tolerance that is stated."""
    assert run(["measure", "--json", "--monte-carlo"]) == 0
    printed = json.loads(capsys.readouterr().out)
    drawn, radiance = printed["monte_carlo"], printed["radiance"]
    assert drawn["validates"]
    assert abs(drawn["u"] / radiance["u"] - 1.0) < 0.02
    assert drawn["low"] < radiance["value"] < drawn["high"]


PATCH = "2,2,20,20"


@pytest.fixture
def folder(tmp_path):
    """Return a folder of photographs of an even surface whose times stand in a list, a curve next to it."""
    dn = np.arange(256.0)
    ResponseCurve(np.log(np.maximum(dn, 0.25) / 128), np.full(256, 1e-4), valid_dn=(1, 254)).write(tmp_path / "c.yaml")
    rng = np.random.default_rng(1)
    pictures = [eight_bits(128 + rng.normal(0, 0.6, (24, 24))) for _ in range(3)]
    for numbers in pictures:
        numbers[:, 22:] = 1  # a dark edge: no dark signal is above it
    return write_photographs(tmp_path / "photos", pictures, [0.125] * 3)


def calibrate(folder, *more: str) -> int:
    command = ["calibrate", str(folder), "--response", str(folder.parent / "c.yaml"), "--patch", PATCH]
    given = ["--radiance", "0.5", "--u-rel", "0.005", "--spectrum", "white_led", "-o", str(folder.parent / "cal.yaml")]
    return run([*command, *given, *more])


def measure(folder, *more: str) -> int:
    calibration = str(folder.parent / "cal.yaml")
    return run(
        ["measure", "--photographs", str(folder), "--calibration", calibration, "--patch", PATCH, "--json", *more]
    )


def test_a_scale_and_a_reading_ask_for_the_f_number_and_use_it(folder, capsys):
    """Unstated they are refused with the way out. Calibrated at f/16 the pictures at f/5.6 mean an eighth."""
    assert calibrate(folder) == 2
    assert "--f-number" in capsys.readouterr().err
    assert not (folder.parent / "cal.yaml").exists()
    assert calibrate(folder, "--f-number", "16") == 0
    assert measure(folder) == 1
    assert "--f-number" in capsys.readouterr().err
    assert measure(folder, "--f-number", "5.6") == 0
    assert json.loads(capsys.readouterr().out)["radiance"]["value"] == pytest.approx(0.5 / 8.0, rel=2e-3)


def test_photographs_have_a_drawn_interval_too(folder, capsys):
    """At f/8 under an f/16 calibration (4 % of radiance) both intervals agree."""
    assert calibrate(folder, "--f-number", "16") == 0
    capsys.readouterr()
    assert measure(folder, "--f-number", "8", "--monte-carlo") == 0
    printed = json.loads(capsys.readouterr().out)
    drawn, u = printed["monte_carlo"], printed["radiance"]["u"]
    assert drawn["u"] == pytest.approx(u, rel=0.02)
    assert drawn["high"] - drawn["low"] == pytest.approx(2.0 * printed["coverage_factor"] * u, rel=0.05)


LIGHT_AT_FULL_SCALE_S = 0.1  # a radiance of 1 fills the scale in this time at ISO 100

ISO_PATCH = "2,2,30,20"


def photograph(folder, name: str, radiance: float, time_s: float, stated: float, real: float) -> None:
    """Write a linear 8-bit photograph of a surface whose radiance runs by a tenth from left to right."""
    row = radiance * time_s / LIGHT_AT_FULL_SCALE_S * real / 100.0 * np.linspace(0.95, 1.05, 36)
    rng = np.random.default_rng(int(1e6 * time_s) + int(stated))
    write_jpeg(folder / name, 255.0 * row + rng.normal(0.0, 0.6, (24, 36)), time_s, int(stated))


@pytest.fixture
def linear_curve(tmp_path):
    """Return the file of a linear curve."""
    dn = np.arange(256.0)
    curve = ResponseCurve(np.log(np.maximum(dn, 0.25) / 128), np.full(256, 1e-4), valid_dn=(1, 254))
    curve.write(tmp_path / "linear.yaml")
    return tmp_path / "linear.yaml"


@pytest.fixture
def calibration(tmp_path, linear_curve):
    """Return a calibration by photographs at ISO 100 of a surface of 0.5 W/(sr m²)."""
    photograph(tmp_path / "known", "a.jpg", 0.5, 1 / 8, 100, 100)
    command = ["calibrate", str(tmp_path / "known"), "--response", str(linear_curve), "--patch", ISO_PATCH]
    assert run([*command, "--radiance", "0.5", "--u-rel", "0.005", "-o", str(tmp_path / "cal.yaml")]) == 0
    return tmp_path / "cal.yaml"


def reading(capsys, folder, calibration, *more: str) -> dict:
    """Return what `radiometer measure --photographs` prints."""
    capsys.readouterr()
    command = ["measure", "--photographs", str(folder), "--calibration", str(calibration), "--patch", ISO_PATCH]
    assert run([*command, "--json", *more]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_measured_speed_takes_the_place_of_the_stated_one(tmp_path, calibration, capsys):
    """ISO 200 that is really 136: 0.25 W/(sr m²) is read within 2 u once that is stated, 0.68 times as much before."""
    photograph(tmp_path / "other", "a.jpg", 0.25, 1 / 8, 200, 136)
    right = reading(capsys, tmp_path / "other", calibration, "--measured-iso", "200=136")
    assert abs(right["radiance"]["value"] - 0.25) < 2 * right["radiance"]["u"]
    assert right["iso"] == [{"stated": 200.0, "measured": 136.0}]
    assert "ISO 200 is really 136" in right["assumptions"]
    wrong = reading(capsys, tmp_path / "other", calibration)
    assert wrong["radiance"]["value"] == pytest.approx(0.25 * 136 / 200, rel=0.02)
    assert wrong["iso"] == [{"stated": 200.0}]


def test_response_keeps_both_speeds(tmp_path, capsys):
    """Four times at ISO 100 and the same at "200", really 136: the ratio is 1.36, and both speeds are in the curve."""
    for index, time_s in enumerate((1 / 30, 1 / 15, 1 / 8, 1 / 4)):
        photograph(tmp_path / "both", f"a{index}.jpg", 0.3, time_s, 100, 100)
        photograph(tmp_path / "both", f"b{index}.jpg", 0.3, time_s, 200, 136)
    target = tmp_path / "curve.yaml"
    command = ["response", str(tmp_path / "both"), "--method", "debevec1997", "-o", str(target), "--json"]
    assert run([*command, "--measured-iso", "200=136"]) == 0
    report = json.loads(capsys.readouterr().out)
    ratios = report["curves"][0]["exposure_ratios"]
    assert ratios[0::2] == pytest.approx([1.36] * 4, rel=1e-6)
    assert ResponseCurve.read(target).provenance.parameters["iso"] == [
        {"stated": 100.0},
        {"stated": 200.0, "measured": 136.0},
    ]


def test_the_meter_takes_the_measured_speed(tmp_path, linear_curve, capsys):
    """Stated 200, really 136, is what --iso 136 is: the thesis's 3882.3529 cd/m²; the file keeps both speeds."""
    command = ["calibrate", "--response", str(linear_curve), "--luminance-meter-k", "16.5", "--f-number", "16"]
    command += ["--exposure", "1/125", "--iso", "200", "--measured-iso", "200=136", "--as-printed", "--json"]
    assert run([*command, "-o", str(tmp_path / "cal.yaml")]) == 0
    assert round(json.loads(capsys.readouterr().out)["metered"]["luminance"]["value"], 4) == 3882.3529
    scale = Calibration.read(tmp_path / "cal.yaml").scale
    assert (scale.iso, scale.iso_stated) == (136.0, 200.0)


def test_photographs_at_the_meters_speed_need_no_gain(tmp_path, linear_curve, capsys):
    """After the meter at stated ISO 200, photographs that state 200 have no gain: H_ref at the middle value."""
    command = ["calibrate", "--response", str(linear_curve), "--luminance-meter-k", "16.5", "--f-number", "8"]
    command += ["--exposure", "1/8", "--iso", "200", "--measured-iso", "200=136", "--reference-dn", "128", "--json"]
    assert run([*command, "-o", str(tmp_path / "cal.yaml")]) == 0
    metered = json.loads(capsys.readouterr().out)["metered"]["radiance"]["value"]
    # 128 of 255 at 1/8 s and a real speed of 136.
    radiance = 128 / 255 * LIGHT_AT_FULL_SCALE_S * 8 / 1.36
    photograph(tmp_path / "same", "a.jpg", radiance, 1 / 8, 200, 136)
    found = reading(capsys, tmp_path / "same", tmp_path / "cal.yaml")["radiance"]["value"]
    assert found == pytest.approx(metered, rel=0.01)


@pytest.mark.parametrize("word", ["200", "200=x", "0=-5", "250=136"])
def test_speeds_that_mean_nothing_are_a_misuse(tmp_path, capsys, word):
    """Not of the form STATED=REAL, or stated by no photograph: exit code 2, and the message says so."""
    photograph(tmp_path / "one", "a.jpg", 0.3, 1 / 8, 200, 136)
    photograph(tmp_path / "one", "b.jpg", 0.3, 1 / 4, 200, 136)
    assert run(["response", str(tmp_path / "one"), "--measured-iso", word]) == 2
    assert "ISO 250" in (printed := capsys.readouterr().err) or "STATED=REAL" in printed


@pytest.mark.slow
def test_known_ratio_fixes_the_exponent(tmp_path, capsys):
    """Times stated 2.2-fold for 2-fold: with one ratio known as 2 the others come out as 2, and the gauge says why."""
    rng, ramp = np.random.default_rng(3), np.tile(np.exp(np.linspace(-5.5, 0.5, 256)), (64, 1))
    lights = (ramp * 2.0 ** (k - 3) * (1 + 0.01 * rng.standard_normal(ramp.shape)) for k in range(7))
    pictures = (eight_bits(255 * np.clip(light, 0, 1) ** (1 / 1.8)) for light in lights)
    folder = write_photographs(tmp_path / "ladder", pictures, [2.2**k / 100 for k in range(7)])
    command = ["response", str(folder), "--method", "mitsunaga1999", "--json"]
    assert run([*command, "--known-ratio", "2=2.0"]) == 0
    found = json.loads(capsys.readouterr().out)["curves"][0]
    assert found["exposure_ratios"] == pytest.approx([2.0] * 6, rel=0.005)
    assert "known ratio of pair 2" in found["gauge"]
    assert run(["response", str(folder), "--known-ratio", "2=2.0"]) == 2
    assert "mitsunaga1999" in capsys.readouterr().err
    assert math.isclose(found["u_exposure_ratios"][2], 0.0, abs_tol=1e-12)
