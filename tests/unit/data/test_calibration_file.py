"""Calibrations, response curves, levels of a light box: whole round trips, and refusals that name the key."""

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.analysis.calibration.shared import require_camera, require_lens
from radiometer.data import (
    BlackLevel,
    Calibration,
    CameraDescription,
    FlatField,
    LensDescription,
    Provenance,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.data.light_calibration import ChannelCalibration, LightCalibration, LightPoint
from radiometer.errors import CalibrationError, InputError, SettingOutOfRange

CAMERA = CameraDescription(bit_depth=12, model="BFS-U3-19S4M", serial="7", full_well_e=10500.0)


@pytest.fixture
def calibration() -> Calibration:
    """Return a calibration with every part present."""
    dn = np.arange(4096.0)
    with np.errstate(divide="ignore"):
        curve = ResponseCurve(np.log(dn / 2048), np.full(4096, 0.002), valid_dn=(10, 4000))
    return Calibration(
        camera=CAMERA,
        lens=LensDescription(focal_length_mm=16.0, f_number=4.0),
        scale=Scale(value=1.3e-3, u_rel=0.01, method="known_radiance", f_number=4.0),
        response=curve,
        noise=SensorNoise.of(CAMERA),
        black_level=BlackLevel(dn=64.0, u_dn=0.1),
        flat_field=FlatField(principal_point_px=(8.0, 6.0), radius_px=10.0, shape=(12, 16), u_rel=0.002),
        spectrum="cie_d65",
        defects=((3, 4),),
        created="2026-01-02T03:04:05+00:00",
    )


def test_a_written_calibration_reads_back_the_same(calibration, tmp_path):
    """A serial number fits in either notation."""
    calibration.write(tmp_path / "cal.yaml")
    back = Calibration.read(tmp_path / "cal.yaml")
    for name in ("camera", "lens", "scale", "noise", "black_level", "flat_field", "spectrum", "defects", "created"):
        assert getattr(back, name) == getattr(calibration, name), name
    assert np.isneginf(back.response.log_exposure[0])
    np.testing.assert_allclose(back.response.log_exposure[1:], calibration.response.log_exposure[1:], atol=1e-8)
    assert back.response.valid_dn == (10, 4000)
    assert back.validity_days == 365.0
    known = replace(calibration, camera=CAMERA.model_copy(update={"serial": "20497219"}))
    require_camera(known, CameraDescription(bit_depth=12, serial="0138C343"))
    require_camera(known, CameraDescription(bit_depth=12))  # what is unknown is not compared
    with pytest.raises(CalibrationError, match="its serial is 20497219"):
        require_camera(known, CameraDescription(bit_depth=12, serial="0138C344"))


@pytest.mark.parametrize(
    ("change", "named"), [({"model": "other"}, "model"), ({"serial": "8"}, "serial"), ({"bit_depth": 8}, "bit depth")]
)
def test_another_camera_is_refused(calibration, change, named):
    """The message names what differs."""
    with pytest.raises(CalibrationError, match=named):
        require_camera(calibration, CAMERA.model_copy(update=change))


@pytest.mark.parametrize(("focal_mm", "taken"), [(16.16, True), (16.17, False), (15.85, True), (15.84, False)])
def test_a_focal_length_fits_within_a_hundredth(calibration, focal_mm, taken):
    """Of 16 mm, to either side; one that is unknown is not compared."""
    lens = LensDescription(focal_length_mm=focal_mm)
    if taken:
        require_lens(calibration, lens)
    else:
        with pytest.raises(CalibrationError, match="made with a lens of 16 mm"):
            require_lens(calibration, lens)
    require_lens(replace(calibration, lens=LensDescription()), lens)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "radiometer-capture/1", "radiometer-calibration/1"),
        ("created", "2026-01-02T03:04:05", "created"),
        ("created", "yesterday", "created"),
        ("validity_days", -1, "validity_days"),
        ("scale", None, "scale"),
        ("scale", {"value": 0, "u_rel": 0.1, "method": "known_radiance"}, "scale.value"),
        ("scale", {"value": 1, "u_rel": 0.1, "method": "guess"}, "scale.method"),
        ("noise", {"read_noise_e": 2}, "conversion_gain_e_per_dn"),
        ("camera", {"bit_depth": 10}, "10"),
        ("black", {"dn": 70}, "unknown key 'black'; allowed here: black_level"),
        ("uncertainties", {"drift": 0.1}, "unknown key 'uncertainties.drift'"),
        ("camera", {"bit_depth": 12, "serial_number": "1"}, "write 'serial'"),
        ("response", {"format": "radiometer-response/1", "valid": [3, 4000]}, "unknown key 'valid'; allowed here"),
    ],
)
def test_a_wrong_entry_is_refused_by_name(calibration, key, value, message):
    """The message names the key, or shows the value."""
    mapping = {**calibration.to_mapping(), key: value}
    with pytest.raises((CalibrationError, InputError), match=message):
        Calibration.from_mapping(mapping, "cal.yaml")


def test_damaged_calibrations_and_curves_are_refused(calibration):
    """By the key that is missing; a curve neither falls nor changes."""
    mapping = calibration.to_mapping()
    mapping["response"]["log_exposure"] = "0 1 two"
    with pytest.raises(CalibrationError, match=r"response\.log_exposure"):
        Calibration.from_mapping(mapping, "cal.yaml")
    del mapping["scale"]
    with pytest.raises(CalibrationError, match="'scale' is missing"):
        Calibration.from_mapping(mapping, "cal.yaml")
    with pytest.raises(ValueError, match="read-only"):
        curve().log_exposure[0] = 1.0
    values = curve().log_exposure.copy()
    values[100] = 5.0
    with pytest.raises(InputError, match="must not fall"):
        ResponseCurve(values, np.zeros(256))


# Response curves: files round trip to the last bit; what is no curve is refused.


def curve():
    """Return a gamma curve at 8 bit, zero at its middle, undefined at black."""
    dn = np.arange(256)
    log_exposure = np.full(256, -np.inf)
    log_exposure[1:] = 2.2 * np.log(dn[1:] / 128.0)
    return ResponseCurve(log_exposure, np.full(256, 0.01))


@pytest.mark.parametrize("name", ["curve.csv", "curve.yaml"])
def test_a_curve_survives_the_disk_bit_for_bit(tmp_path, name):
    """Both forms hold every digit; other programs read the CSV by its header."""
    curve().write(tmp_path / name)
    lines = (tmp_path / name).read_text().splitlines()
    if name == "curve.csv":
        assert (lines[0], lines[129][:8], len(lines)) == ("dn,log_exposure,u_log_exposure", "128,0.0,", 257)
    read = ResponseCurve.read(tmp_path / name)
    np.testing.assert_array_equal(read.log_exposure, curve().log_exposure)
    np.testing.assert_array_equal(read.u_log_exposure, curve().u_log_exposure)
    assert read.absolute is False


@pytest.mark.parametrize(
    "text",
    ["", "dn,g\n0,1\n", *(f"dn,log_exposure,u_log_exposure\n{rows}\n" for rows in (
        "0,0,0\n2,1,0", "0,0,0", "0,0,0\n1,1,0\n2,2,0", "0,1,0\n1,0,0", "0,a,0\n1,1,0", "0,0\n1,1"))],
)  # fmt: skip
def test_a_csv_that_is_no_curve_is_refused(tmp_path, text):
    """Wrong header, gaps, emptiness, a size that is none, a fall, a word, two columns: the file is always named."""
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(InputError, match=r"c\.csv"):
        ResponseCurve.read(tmp_path / "c.csv")


@pytest.mark.parametrize(("size", "bits"), [(2, 1), (4, 2), (256, 8), (65536, 16)])
def test_a_curve_has_a_value_for_every_number_of_its_bits(size, bits):
    """Powers of two from 2 to 65536; the middle one is that above half of them."""
    one = ResponseCurve(np.linspace(-4.0, 4.0, size), np.zeros(size))
    assert (one.bit_depth, one.mid_dn) == (bits, size // 2)


@pytest.mark.parametrize("size", [0, 1, 3, 255, 65535, 131072])
def test_other_sizes_are_no_curve(size):
    """Nor a table of two columns, nor one uncertainty for many values; equal neighbours are one."""
    with pytest.raises(InputError, match="2, 4, … 65536 values"):
        ResponseCurve(np.arange(float(size)), np.zeros(size))
    with pytest.raises(InputError, match="2, 4, … 65536 values"):
        ResponseCurve(np.zeros((4, 2)), np.zeros((4, 2)))
    with pytest.raises(InputError, match="one uncertainty per value"):
        ResponseCurve(np.arange(4.0), np.zeros(2))
    assert ResponseCurve(np.zeros(4), np.zeros(4)).bit_depth == 2


@pytest.mark.parametrize(("known", "taken"), [([0.0, 1.0], True), ([1.0], False), ([], False)])
def test_a_curve_says_something_of_two_numbers_at_least(known, taken):
    """What is not finite is left aside; a fall across it counts."""
    values = np.full(4, np.nan)
    values[1 : 1 + len(known)] = known
    if taken:
        assert ResponseCurve(values, np.zeros(4)).log_exposure[2] == 1.0
    else:
        with pytest.raises(InputError, match="must not fall"):
            ResponseCurve(values, np.zeros(4))
    with pytest.raises(InputError, match="must not fall"):
        ResponseCurve(np.array([1.0, np.nan, np.nan, 0.5]), np.zeros(4))


def test_a_file_keeps_all_that_is_known_of_a_curve(tmp_path):
    """Range, channel, gauge and where it is from; a table reports by its middle whether it is absolute."""
    whole = ResponseCurve(
        np.arange(4.0), np.full(4, 0.1), absolute=True, valid_dn=(1, 2), channel="red",
        provenance=Provenance("by hand", ("a.png",), ("none",), {"x": 1}),
        camera=CameraDescription(bit_depth=2, vendor="V", model="M", serial="1", mode="vivid"),
    )  # fmt: skip
    whole.write(tmp_path / "c.yaml")
    read = ResponseCurve.read(tmp_path / "c.yaml")
    assert (read.absolute, read.valid_dn, read.channel, read.provenance) == (True, (1, 2), "red", whole.provenance)
    assert read.camera == whole.camera
    assert whole.to_mapping()["unit"] == "ln(J m-2)"
    assert curve().to_mapping()["unit"] == "ln(relative exposure)"
    for middle, absolute in ((0.0, False), (0.9e-9, False), (-0.9e-9, False), (1.1e-9, True), (-1.1e-9, True)):
        one = ResponseCurve(np.array([-2.0, -1.0, middle, 1.0]), np.zeros(4), absolute=absolute)
        one.write(tmp_path / "c.CSV")
        assert ResponseCurve.read(tmp_path / "c.CSV").absolute is absolute


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "radiometer-response/0"}, "expected 'radiometer-response/1'"),
        ({"log_exposure": None}, "c.yaml: a response curve needs 2"), ({"u_log_exposure": ["x"]}, "c.yaml: could not"),
        ({"camera": {"color": 3}}, "c.yaml: camera: unknown key 'color'"), ({"camera": 3}, "c.yaml: 'int'"),
        ({"valid_dn": [1, "x"]}, "c.yaml: invalid"), ({"valid_dn": 3}, "c.yaml: 'int'"),
    ],
)  # fmt: skip
def test_a_mapping_that_is_no_curve_is_refused_by_its_place(change, message):
    """The file is named, and the key that is missing."""
    whole = curve().to_mapping()
    with pytest.raises(InputError, match=message):
        ResponseCurve.from_mapping({**whole, **change}, "c.yaml")
    for key in ("log_exposure", "u_log_exposure"):
        with pytest.raises(InputError, match=f"c.yaml: key '{key}' is missing"):
            ResponseCurve.from_mapping({name: one for name, one in whole.items() if name != key}, "c.yaml")
    least = {"format": whole["format"], "log_exposure": [0.0, 1.0], "u_log_exposure": [0.0, 0.0]}
    found = ResponseCurve.from_mapping(least, "c.yaml")
    assert (found.absolute, found.valid_dn, found.channel) == (False, None, "mono")


# Interpolation between measured levels of a light box.


STEPS = 8192


def point(step: int, radiance: float, current_range: str = "high", u_rel: float = 1e-4) -> LightPoint:
    """Return a measured level."""
    return LightPoint(
        current_range=current_range,
        level=min(step * 8, 65535),
        duty_step=step,
        radiance_W_per_sr_m2=radiance,
        u_rel=u_rel,
    )


def light_calibration(*points: LightPoint, common_u_rel: float = 0.0) -> LightCalibration:
    """Return a calibration of one channel."""
    channel = ChannelCalibration(duty_steps=STEPS, common_u_rel=common_u_rel, points=points)
    return LightCalibration("LB000001", {"spot": channel})


def test_levels_give_their_radiance_within_the_stated_error():
    """Every step in proportion; a droop of 10 % within k = √3."""
    found = light_calibration(point(16, 16.0), point(256, 256.0), point(4096, 4096.0))
    for step in (16, 17, 100, 1000, 4095, 4096):
        choice = found.choose("spot", float(step))
        assert choice.radiance_w_sr_m2 == pytest.approx(step, rel=1e-9)
        assert (choice.level * STEPS + 32768) // 65536 == step

    def radiance(step: float) -> float:
        return step * (1 - 0.1 * step / STEPS)

    steps = np.unique(np.round(np.geomspace(16, STEPS, 12)).astype(int))
    held = light_calibration(*(point(int(s), radiance(s), u_rel=0.0) for s in steps)).channels["spot"].ranges["high"]
    between = np.setdiff1d(np.unique(np.round(np.geomspace(16, STEPS, 200)).astype(int)), steps)
    ratios = [(held.at(int(s))[0] / radiance(s) - 1) / (math.sqrt(3) * held.at(int(s))[1]) for s in between]
    assert np.max(np.abs(ratios)) < 1.3  # the third derivative is not in the bound
    assert np.max(np.abs(ratios)) > 0.2  # and the bound is not idle


def test_every_level_holds_the_common_u_and_a_bound_above_it():
    """Not averaged away; unmeasured levels have none."""
    found = light_calibration(point(16, 16.0), point(4096, 4096.0), common_u_rel=0.01)
    choice = found.choose("spot", 300.0)
    assert choice.u_w_sr_m2 / choice.radiance_w_sr_m2 == pytest.approx(0.01, rel=1e-3)
    with pytest.raises(CalibrationError, match="light calibrate --channel bleach"):
        found.choose("bleach", 15.5)
    assert found.highest_radiance("spot", 8 * 100, True) == pytest.approx(102.0, rel=1e-3)
    assert found.highest_radiance("spot", 8 * 5000, True) is None
    assert found.highest_radiance("spot", 8 * 100, False) is None


def test_ranges_serve_to_their_ends():
    """Where both do, the nearer step wins; nothing beyond is given."""
    found = light_calibration(
        point(16, 16.0), point(4096, 4096.0), point(16, 16 / 256, "low"), point(8192, 8192 / 256, "low")
    )
    choice = found.choose("spot", 20.4)
    assert choice.current_range == "low"
    assert choice.radiance_w_sr_m2 == pytest.approx(20.4, rel=2e-4)
    found = light_calibration(point(16, 16.0), point(4096, 4096.0))
    assert [found.choose("spot", end).level for end in (16.0, 4096.0)] == [128, 32768]
    for beyond in (15.9, 4097.0, math.nan, math.inf):
        with pytest.raises(SettingOutOfRange, match=r"16 .* 4096"):
            found.choose("spot", beyond)
    assert found.limits("spot") == (16.0, 4096.0)


@pytest.mark.parametrize("dip", range(1, 4))
@pytest.mark.parametrize(("place", "reason"), [((0, 1.0), "must rise"), ((0, 0.9), "must rise"), ((1, 1.01), "twice")])
def test_levels_that_were_not_measured_well_are_refused(dip, place, reason):
    """Wherever it lies: one that gives no more light than the one below, and one that was measured twice."""
    steps, radiances = [16, 64, 256, 1024], [16.0, 64.0, 256.0, 1024.0]
    same, share = place
    radiances[dip] = share * radiances[dip - 1]
    steps[dip] = steps[dip - same] if same else steps[dip]
    points = [point(step, radiance) for step, radiance in zip(steps, radiances, strict=True)]
    with pytest.raises(CalibrationError, match=reason):
        light_calibration(*points).choose("spot", 20.0)


def test_between_two_levels_their_doubts_and_the_bend_count():
    """f = ln(radiance/duty) = c·x²: midway its bend c·w²/4 stands as a rectangle next to the halves of both u."""
    c, w = 0.02, math.log(4.0)
    steps = [16, 64, 256, 1024, 4096]
    x = [math.log(step / STEPS) for step in steps]
    u_rel = [0.001, 0.001, 0.003, 0.004, 0.001]
    points = [
        point(step, step / STEPS * math.exp(c * one**2), u_rel=u) for step, one, u in zip(steps, x, u_rel, strict=True)
    ]
    for near in (300, 370, 512, 700):
        choice = light_calibration(*points).choose("spot", near / STEPS * math.exp(c * math.log(near / STEPS) ** 2))
        step = choice.level * STEPS / 65536
        assert step == pytest.approx(near, rel=0.02)
        share = math.log(step / 256) / w
        own = math.hypot((1 - share) * 0.003, share * 0.004)
        bend = c * w**2 * share * (1 - share) / math.sqrt(3)
        expected = math.hypot(own, bend)
        assert choice.u_w_sr_m2 / choice.radiance_w_sr_m2 == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("current", [(1 / 256, 1.0), (1.0, 1.0), (1.0, 1 / 256)], ids=["right", "alike", "swapped"])
@pytest.mark.parametrize("steps", [(16, 4096), (4097, 8192)], ids=["one duty", "apart"])
def test_a_file_whose_low_current_is_not_the_darker_one_is_refused(current, steps, tmp_path):
    """Where it is read, whether or not both ranges were measured at the same duty; the file and channel are named."""
    low, high = current
    points = [point(step, step * low, "low") for step in steps] + [point(step, step * high) for step in (16, 4096)]
    light_calibration(*points).write(tmp_path / "box.yaml")
    if low < high:
        assert LightCalibration.read(tmp_path / "box.yaml").limits("spot")[1] == 4096.0
    else:
        with pytest.raises(CalibrationError, match=r"box\.yaml: channel spot: .* current_range is swapped"):
            LightCalibration.read(tmp_path / "box.yaml")


@pytest.mark.parametrize(("start_rel", "bound"), [(1.1, 110.0), (0.9, 100.0)])
def test_what_is_brighter_at_its_start_stays_below_that(start_rel, bound):
    """A start above the settled radiance counts, one below it does not make light safer."""
    points = [point(step, float(step), u_rel=0.0).model_copy(update={"start_rel": start_rel}) for step in (16, 4096)]
    assert light_calibration(*points).highest_radiance("spot", 800, True) == pytest.approx(bound)


@pytest.mark.parametrize(
    ("days", "stale"), [(-1.01, True), (-1.0, False), (0.0, False), (30.0, False), (30.001, True), (400.0, True)]
)
def test_a_calibration_is_stale_after_its_validity_and_not_before(days, stale):
    """Thirty days from when it was made, in whatever time zone one asks; one from the future is not valid either."""
    made = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
    found = replace(
        light_calibration(point(16, 16.0), point(4096, 4096.0)), created=made.isoformat(), validity_days=30.0
    )
    assert found.is_stale((made + dt.timedelta(days=days)).astimezone(dt.timezone(dt.timedelta(hours=9)))) is stale
