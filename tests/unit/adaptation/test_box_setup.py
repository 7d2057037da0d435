"""Setting up a test on the light box from its protocol."""

import datetime as dt
from dataclasses import replace

import pytest

import radiometer as rm
from radiometer.adaptation.box_setup import SIMULATED_CALIBRATION, BoxLights, BoxStage, open_box_stage
from radiometer.adaptation.checks import judge_age, judge_room
from radiometer.adaptation.protocol import SHIPPED, FlashBleach, read_protocol
from radiometer.adaptation.request import RunRequest
from radiometer.bench.boxes import open_light_box
from radiometer.bench.served import served_box
from radiometer.data.light_calibration import LightCalibration
from radiometer.data.provenance import utc_now
from radiometer.data.storage import shipped_config
from radiometer.errors import (
    CalibrationError,
    ConfigurationError,
    DeviceError,
    MeasurementError,
    UnsafeStimulus,
    UsageError,
)
from testing.recording_devices import RecordingBox

NOW = dt.datetime(2026, 11, 21, tzinfo=dt.UTC)


@pytest.fixture
def quick():
    return read_protocol("quick")


def before_box(protocol, **asked):
    """Return the request of a run before the simulated box."""
    return RunRequest(protocol, box="sim", **asked)


def findings(protocol, **asked):
    """Return what the checks of a simulated box find."""
    with open_box_stage(before_box(protocol, **asked)) as (_, checks):
        return [check() for check in checks]


def changed(protocol, section, **values):
    """Return a protocol with other values in a section."""
    return protocol.model_copy(update={section: getattr(protocol, section).model_copy(update=values)})


def refusal(protocol, **asked):
    """Return why a test would not begin."""
    refused = [f.refusal for f in findings(protocol, **asked) if f.refusal is not None]
    assert refused
    return refused[0]


@pytest.mark.parametrize("name", ["classic", "quick", "led-only", "questplus"])
def test_shipped_protocols_are_within_the_limits_of_eye_and_box(name):
    """Every one for the box can be run on the reference box, the flash too; the journal gets the hazard fractions."""
    (safety,) = findings(read_protocol(name))
    assert safety.refusal is None
    assert 0 < safety.facts["blue_light"] < safety.facts["allowed_fraction"]


def test_calibration_age_against_the_protocols_limit(quick):
    """30 days: 29 pass; 31 are refused with both figures and the way out, or accepted with a mark in the journal."""
    age = {days: (NOW - dt.timedelta(days=days)).isoformat() for days in (29, 31)}
    assert judge_age("box X", age[29], quick, NOW).refusal is None
    refused = judge_age("box X", age[31], quick, NOW).refusal
    assert isinstance(refused, CalibrationError)
    assert all(word in str(refused) for word in ("box X", "31 days", "allows 30", "--accept-stale"))
    future = judge_age("box X", (NOW + dt.timedelta(days=31)).isoformat(), quick, NOW).refusal
    assert "from the future (31 days" in str(future)
    accepted = judge_age("box X", age[31], quick, NOW, accept_stale=True)
    assert accepted.refusal is None
    assert accepted.facts["accepted_stale"] is True


def test_own_calibration_of_a_box_is_checked_for_its_age(tmp_path, quick):
    """The check is made on the file that the levels come from."""
    old = replace(LightCalibration.read(shipped_config(SIMULATED_CALIBRATION)), created="2020-01-01T00:00:00Z")
    old.write(tmp_path / "old.yaml")
    assert isinstance(refusal(quick, calibration=tmp_path / "old.yaml"), CalibrationError)
    accepted = findings(quick, calibration=tmp_path / "old.yaml", accept_stale=True)
    assert [finding.refusal for finding in accepted] == [None, None]


@pytest.mark.parametrize(
    ("factor", "steps", "reason"),
    [
        (1e-6, 1024, "cap or filter"),
        (1e-3, 1024, "a filter before the"),
        (1.0, 8192, "8192 duty steps, the box states 1024"),
    ],
)
def test_a_calibration_that_belies_box_or_preset_gives_no_light(tmp_path, factor, steps, reason):
    """By radiances a million times too low, the account of the exposure would count as much less."""
    known = LightCalibration.read(shipped_config(SIMULATED_CALIBRATION))

    def changed(one):
        points = tuple(
            p.model_copy(update={"radiance_W_per_sr_m2": factor * p.radiance_W_per_sr_m2}) for p in one.points
        )
        return one.model_copy(update={"points": points, "duty_steps": steps})

    replace(known, channels={"field": changed(known.channels["field"])}).write(tmp_path / "c.yaml")
    with pytest.raises(CalibrationError, match=reason), open_light_box("sim", calibration=tmp_path / "c.yaml"):
        pass


@pytest.mark.parametrize(
    ("created", "warned"), [("2020-01-01T00:00:00Z", True), ("2090-01-01T00:00:00Z", True), (None, False)]
)
def test_light_by_a_calibration_out_of_date_is_given_with_a_warning(tmp_path, created, warned):
    """Also by one from the future."""
    known = LightCalibration.read(shipped_config(SIMULATED_CALIBRATION))
    replace(known, created=created or utc_now()).write(tmp_path / "c.yaml")
    heard = list[str]()
    rm.light_pulse("spot", 0.01, 0.001, box="sim", calibration=tmp_path / "c.yaml", notice=heard.append)
    assert any("not within its" in line for line in heard) == warned


@pytest.mark.parametrize(
    ("name", "section", "values", "kind", "words"),
    [
        # 6e6 td·s in 20 ms are 19 kW/sr/m²; at 2.556 the same energy takes 152 s.
        ("quick", "bleach", {"retinal_td_s": 6e6, "duration_s": 0.02}, Exception, "152 s at least for 6e+06 td·s"),
        # The white channel's energy budget ends 800 cd/m² after some 200 s; no half bleach is given.
        ("led-only", "bleach", {"luminance_cd_m2": 800.0, "duration_s": 600.0}, UnsafeStimulus, "energy budget"),
        # Without its filter the spot does not get as dim as the rods see; what it reaches is stated.
        ("quick", "spot", {"filter_density": 0.0}, MeasurementError, "reaches -1.91 to 3.16 log₁₀ scotopic cd·m⁻²"),
        # A 505 nm protocol on a 453 nm LED would be wrong by a factor of two without anybody noticing.
        ("quick", "spot", {"peak_nm": 505.0}, Exception, "505 nm"),
        # 10⁻⁹ cd/m² is below what the red LED can be dimmed to: the message names the protocol's key.
        ("quick", "fixation_check", {"luminance_cd_m2": 1e-9}, Exception, "fixation_check.luminance_cd_m2"),
        # The red channel of the reference box stands in the blind spot: no one would see it as a test spot.
        ("quick", "spot", {"channel": "spot_red", "peak_nm": 640.0}, Exception, "is 15.6° from it"),
    ],
)
def test_light_that_the_box_cannot_give_is_refused_before_it_begins(name, section, values, kind, words):
    """Flash, bleach, spot and light in the blind spot: each refusal says why, and what would do."""
    refused = refusal(changed(read_protocol(name), section, **values))
    assert isinstance(refused, kind)
    assert words in str(refused)


def test_bleach_beyond_the_exposure_limit_is_refused(quick):
    """With a ten-thousandth of the limit allowed, the flash (3.4e-4 of it) is refused by IEC 62471's name."""
    with open_box_stage(before_box(quick)) as (stage, checks):
        stage.box.ledger.allowed_fraction = 1e-4
        refused = checks[0]().refusal
    assert isinstance(refused, UnsafeStimulus)
    assert "IEC 62471" in str(refused)


@pytest.mark.parametrize(("td_s", "count"), [(1.2e7, 8), (1.4e7, 9)])
def test_a_box_fires_eight_flashes_in_a_row(quick, td_s, count):
    """Some 1.6e6 td·s each: eight are foreseen with their hazard, a ninth is refused with the way out."""
    flash = FlashBleach(kind="flash", retinal_td_s=td_s, pupil_mm=6.0, source="flash")
    (safety,) = findings(quick.model_copy(update={"bleach": flash}))
    (one,) = findings(quick.model_copy(update={"bleach": flash.model_copy(update={"retinal_td_s": 1e6})}))
    if count > 8:
        assert f"takes {count} flashes, the box fires 8 in a row" in str(safety.refusal)
    else:
        assert safety.refusal is None
        assert safety.facts["blue_light"] > 1.5 * one.facts["blue_light"]


@pytest.mark.slow
def test_dark_room_is_measured_by_the_camera(quick):
    """In the dark the reading is 0 within its uncertainty; at 0.01 cd/m² it is that, and refused."""
    dark = findings(quick, measure_room=True)[-1]
    assert dark.refusal is None
    assert abs(dark.facts["luminance_cd_m2"]) < 3 * dark.facts["u_cd_m2"]
    lit = findings(quick, measure_room=True, room_cd_m2=0.01)[-1]
    assert isinstance(lit.refusal, MeasurementError)
    # The simulated camera was calibrated at another wavelength than that of the room: 1 % of quantum efficiency.
    assert lit.facts["luminance_cd_m2"] == pytest.approx(0.01, abs=3 * lit.facts["u_cd_m2"] + 0.0001)


@pytest.mark.parametrize(("value", "u", "message"), [(2e-3, 1e-5, "darken it"), (5e-4, 1e-3, "does not show")])
def test_room_must_be_shown_to_be_dark(quick, value, u, message):
    """Too bright, and not known well enough, are distinguished."""
    assert message in str(judge_room(value, u, quick).refusal)


def test_simulated_subject_sits_before_the_simulated_box_only(quick, tmp_path):
    """No box is opened for the refusal; the firmware in simavr has pins, no LEDs."""
    with pytest.raises(UsageError, match="--box sim"), open_box_stage(RunRequest(quick, box="LB1", simulate="steady")):
        pass
    with pytest.raises(UsageError, match="leave out one"):
        served_box("TWIN0001", tmp_path / "port", firmware=tmp_path / "x.hex", subject="steady")
    with pytest.raises(UsageError, match="choose steady"):
        served_box("TWIN0001", tmp_path / "port", subject="asleep")


def test_red_mark_has_the_protocols_luminance(quick):
    """0.1 cd/m² at the channel's 640 nm (119.5 lm/W, V = 0.175) unless stated; so has the light in the blind spot."""
    with open_box_stage(before_box(quick)) as (stage, _):
        assert stage.lights.fixation_w_sr_m2 == pytest.approx(0.1 / (683 * 0.175), rel=1e-3)
        assert stage.checks_fixation
        assert stage.lights.blind_spot_w_sr_m2 == stage.lights.fixation_w_sr_m2
        assert "no_fixation_check" not in stage.facts()
        assert stage.facts()["u_scale_log10"] == pytest.approx(0.01127 / 2.3026, abs=1e-4)  # 1.127 % shared by all
    with open_box_stage(before_box(quick, fixation_w_sr_m2=0.0)) as (stage, _):
        assert stage.lights.fixation_w_sr_m2 == 0.0


def _preset(path, text):
    """Write the reference preset with another place of its red channel."""
    whole = shipped_config("light_boxes/reference.yaml").read_text(encoding="utf-8")
    stated = "place: {temporal_deg: 15.5, below_deg: 1.5}"
    assert stated in whole
    path.write_text(whole.replace(f",\n    {stated}", text), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("stated", "why"), [("", "states no `place`"), (", place: {temporal_deg: 5, below_deg: 0}", "is 5° temporal")]
)
def test_box_whose_red_light_stands_elsewhere_says_that_fixation_is_not_checked(tmp_path, quick, stated, why):
    """The test is run all the same, and the journal shows why."""
    with open_box_stage(before_box(quick, preset=_preset(tmp_path / "p.yaml", stated))) as (stage, _):
        assert not stage.checks_fixation
        assert why in str(stage.facts()["no_fixation_check"])


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_protocols_are_valid(name):
    """Each is read by its name and carries it; one that is not there lists them."""
    assert read_protocol(name).name == name
    with pytest.raises(ConfigurationError, match="classic, classic-blue, rapid, quick"):
        read_protocol("nothing.yaml")


def test_classic_is_the_test_of_the_literature():
    """9,000 cd/m² for 180 s through 7 mm, 505 nm, 2° at 5°, up to 40 min; the blue one 453 nm at 8°."""
    classic = read_protocol("classic")
    assert (classic.bleach.luminance_cd_m2, classic.bleach.duration_s) == (9000, 180)
    assert (classic.spot.peak_nm, classic.spot.size_deg, classic.spot.eccentricity_deg) == (505, 2, 5)
    blue = read_protocol("classic-blue")
    assert (blue.spot.peak_nm, blue.spot.eccentricity_deg, blue.bleach) == (453, 8, classic.bleach)
    assert classic.end.duration_min == 40


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration_s: 180", "duration_s: -1", "duration_s"),
        ("kind: limits", "kind: guess", "method"),
        ("end: {", "ende: {", "unknown key 'ende'"),
        ("duration_min: 40", "duration_min: 40, criterion_log10: -9", "outside the spot's levels"),
        # Place and size of the light in the blind spot are those of the optic disc.
        *(("share: 0.06", bad, bad.split(":")[0]) for bad in ("temporal_deg: 10", "below_deg: 8", "size_deg: 2.1")),
        # The journal's file carries the name: it leads to no other folder.
        *(("name: classic", f"name: '{name}'", "name") for name in ("../../x", "a/b", "", ".hidden")),
        # A time or level far beyond any test is a slip of the pen, and would run without end.
        ("on_s: 0.2", "on_s: 1.0e6", "on_s"), ("highest_log10: 0.15", "highest_log10: 300", "highest_log10"),
        ("pause_between_s: 0.5", "pause_between_s: 1.0e9", "pause_between_s"),
        ("watch: {", "watch: {most_blinks: 1000000, ", "most_blinks"),
        ("end: {", "safety: {calibration_days: 1.0e9}\nend: {", "calibration_days"),
    ],
)  # fmt: skip
def test_wrong_protocols_are_refused(tmp_path, project_root, old, new, message):
    """The error names what is wrong."""
    text = (project_root / "configs" / "protocols" / "classic.yaml").read_text()
    assert old in text
    file = tmp_path / "p.yaml"
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=message):
        read_protocol(file)


@pytest.fixture
def box():
    return RecordingBox()


@pytest.fixture
def stage(box):
    def sleep(seconds):
        box.time += seconds

    lights = BoxLights(read_protocol("led-only"), 300.0, 600.0, 900.0, fixation_w_sr_m2=1e-4)
    return BoxStage(box, lights, lambda: box.time, sleep)


@pytest.mark.parametrize(
    ("call", "asked", "now_s"),
    [
        # 750 cd/m² at 300 lm/W are 2.5 W/sr/m² for 150 s; the red mark follows.
        (lambda stage: stage.bleach(stage.lights.protocol), [("bleach", 2.5, 150.0), ("fixation", 1e-4)], 150.0),
        # −3 log scotopic cd/m² behind a filter of density 3 at 900 lm/W, for the protocol's 0.3 s, in a cycle of 1 s.
        (lambda stage: stage.blink(-3.0, 0, 0), [("spot", 1.0 / 900, 0.3)], 1.0),
        (lambda stage: stage.blink(None, 0, 0), [], 1.0),
        # After a crash the time goes on, and the subject has something to look at again.
        (lambda stage: stage.resume_at(500.0), [("fixation", 1e-4)], 500.0),
    ],
    ids=["bleach", "blink", "catch", "resumed"],
)
def test_each_light_is_the_protocols_for_its_time(stage, box, call, asked, now_s):
    """Channel, radiance and duration are those asked of the box, and so long passes; a catch lights nothing."""
    call(stage)
    assert box.asked == [(name, pytest.approx(radiance), *more) for name, radiance, *more in asked]
    assert stage.now_s() == pytest.approx(now_s)


def test_nothing_is_lit_once_another_program_has_switched_the_lights_off(stage, box):
    """In the bleach: it is over within a quarter of a second, and neither mark nor spot follows."""

    def sleep(seconds):
        box.time += seconds
        box.switched_off = box.time >= 102.0

    stage.sleep, stage.wall_clock = sleep, lambda: 1.7e9
    stage.bleach(stage.lights.protocol)
    stage.blink(-3.0, 0, 0)
    assert [asked[0] for asked in box.asked] == ["bleach"]
    assert stage.now_s() == pytest.approx(3.0, abs=0.3)


def test_a_bleach_that_the_box_ends_by_itself_is_no_bleach(stage, box):
    """Its energy budget, or its button: a curve after a tenth of the bleach would be taken for one after all of it."""

    dark_s = [102.0, 100.0 + 0.99 * 150.0]  # then a box whose clock is 1 % fast

    def sleep(seconds):
        box.time += seconds + 0.01  # what reading back takes
        box.level = 0 if box.time >= dark_s[0] else 1000

    stage.sleep, stage.wall_clock = sleep, lambda: 1.7e9
    with pytest.raises(DeviceError, match="148 s too early"):
        stage.bleach(stage.lights.protocol)
    assert len(box.asked) == 1
    box.time = 100.0
    dark_s.pop(0)
    stage.bleach(stage.lights.protocol)
    assert box.time == pytest.approx(250.0, abs=0.02)


def test_stop_ends_the_bleach(stage, box):
    """Within a quarter of a second, and no mark follows."""
    stage.wall_clock, stage.ended = (lambda: 1.7e9), lambda: box.time >= 102.0
    stage.bleach(stage.lights.protocol)
    assert box.asked[1:] == [("bleach", "off")]
    assert stage.now_s() == pytest.approx(2.0, abs=0.3)


def test_presses_count_from_the_onset_and_releases_do_not(stage, box):
    """A press before the onset is not an answer."""
    box.presses = [99.9, 100.4]
    assert stage.blink(-3.0, 0, 0) == [pytest.approx(0.4)]


def test_flash_gives_its_scotopic_troland_seconds(stage, box):
    """4e5 td·s in 15 s through 6 mm (28.27 mm²) are 943 scotopic cd/m², at 600 lm/W 1.572 W/sr/m²."""
    stage.lights = BoxLights(read_protocol("quick"), 300.0, 600.0, 900.0)
    stage.bleach(stage.lights.protocol)
    assert box.asked == [("bleach", pytest.approx(4e5 / 15 / 28.274 / 600, rel=1e-4), 15.0)]


def test_long_press_is_reported_once_and_a_short_one_never(stage, box):
    """Presses of 0.1 s are answers; one that is held is reported with its beginning, on the stage's clock."""
    box.presses = [100.4]
    stage.blink(-3.0, 0, 0)
    assert stage.long_press(2.0) is None
    box.held = [(101.5, 104.0)]
    assert stage.rest(5.0) == 2
    assert stage.long_press(2.0) == pytest.approx(1.5)
    assert stage.long_press(2.0) is None
    box.held = [(108.0, 999.0)]  # one that goes on is one as well: no one has to let go first
    stage.rest(4.0)
    assert stage.long_press(2.0) == pytest.approx(8.0)


def test_light_in_the_blind_spot_is_one_pulse_of_its_own_channel(stage, box):
    """No filter stands before it; presses count as for the spot. A box without one refuses to pretend."""
    assert not stage.checks_fixation
    with pytest.raises(UsageError, match="blind spot"):
        stage.blink_blind_spot(0, 0)
    stage.lights = BoxLights(read_protocol("led-only"), 300.0, 600.0, 900.0, blind_spot_w_sr_m2=8e-4)
    box.presses = [100.5]
    assert stage.checks_fixation
    assert stage.blink_blind_spot(0, 0) == [pytest.approx(0.5)]
    assert box.asked == [("spot_red", 8e-4, 0.3)]
