"""A screen as the stage: which levels it has, what is shown where, whose presses count."""

import math
from dataclasses import replace

import numpy as np
import pytest

from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.screen_setup import ScreenStage, SpotLevels, field_code, mark_code, within_reach
from radiometer.errors import ConfigurationError, UsageError
from radiometer.screen.calibration import LUMINANCE, SCOTOPIC, ChannelCurve, ScreenCalibration
from radiometer.screen.stimulus import Hold, Viewing
from testing.recording_devices import RecordingScreen

BLACK, WHITE = 3e-4, 0.7  # radiance of black and white in W/sr/m2
EFFICACIES = {"grey": (320.0, 750.0), "red": (200.0, 60.0), "blue": (90.0, 1000.0)}


def _curve(name, share, u_rel=1e-3):
    levels = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 160, 192, 224, 255)
    values = tuple(BLACK + (WHITE - BLACK) * share * (n / 255) ** 2.2 for n in levels)
    return ChannelCurve(name, levels, values, tuple(u_rel * v for v in values), 0.01, *EFFICACIES[name], "assumed")


@pytest.fixture
def screen():
    """Return a calibrated screen of 224 cd/m² with a shining black."""
    curves = {"grey": _curve("grey", 1.0), "red": _curve("red", 0.25), "blue": _curve("blue", 0.3)}
    return ScreenCalibration("desk", curves, created="2026-11-21T12:00:00.000000Z", pixel_mm=0.27)


@pytest.fixture
def protocol(screen):
    return within_reach(read_protocol("screen-only"), SpotLevels.of(screen, "blue"))


@pytest.fixture
def watched():
    return RecordingScreen()


@pytest.fixture
def stage(screen, protocol, watched):
    return ScreenStage(watched, screen, protocol, Viewing(600.0, 0.27), lambda: watched.time)


def _added(code):
    """Return what a code of blue adds to black, log10 of scotopic cd/m²: the truth behind the calibration."""
    return math.log10((WHITE - BLACK) * 0.3 * (code / 255) ** 2.2 * EFFICACIES["blue"][1])


def test_levels_are_what_each_code_adds_to_black(screen):
    """At every code right within four sigmas, which shrink towards white; none is below the limit of detection."""
    levels = SpotLevels.of(screen, "blue")
    z = [(v - _added(int(n))) / u for n, v, u in zip(levels.codes, levels.log10, levels.u_log10, strict=True)]
    assert np.abs(z).max() < 4
    assert levels.u_log10[0] > 10 * levels.u_log10[-1]
    assert levels.u_common_log10 == pytest.approx(0.01 / math.log(10))
    curve = replace(screen.channels["blue"], detection_limit=1e-3)
    levels = SpotLevels.of(replace(screen, channels={**screen.channels, "blue": curve}), "blue")
    assert 10 ** levels.log10[0] > 1e-3 * EFFICACIES["blue"][1]


def test_darkest_level_is_the_first_that_is_distinguished_from_black(screen):
    """The first code used is known to a factor of two, the one before it is not; a less certain black raises it."""
    sharp, blurred = (
        SpotLevels.of(replace(screen, channels={**screen.channels, "blue": _curve("blue", 0.3, u)}), "blue")
        for u in (1e-3, 3e-2)
    )
    for levels, u in ((sharp, 1e-3), (blurred, 3e-2)):
        first = int(levels.codes[0])
        alone = 10.0 ** _added(first) / EFFICACIES["blue"][1]
        assert 2 * u * math.sqrt(2) * BLACK < 0.5 * alone
        if first > 1:
            before = 10.0 ** _added(first - 1) / EFFICACIES["blue"][1]
            assert 2 * u * math.hypot(BLACK, BLACK + before) > 0.4 * before
    assert blurred.codes[0] > sharp.codes[0]


def test_protocol_is_narrowed_to_the_screens_reach(screen):
    """The spot goes no lower than the screen; a criterion beyond it is refused with both figures."""
    levels = SpotLevels.of(screen, "blue")
    asked = read_protocol("screen-only")
    narrowed = within_reach(asked, levels)
    assert narrowed.spot.lowest_log10 == levels.reach[0] > asked.spot.lowest_log10
    assert narrowed.spot.highest_log10 == min(asked.spot.highest_log10, levels.reach[1])
    chosen = asked.model_copy(update={"end": asked.end.model_copy(update={"criterion_log10": -3.0})})
    with pytest.raises(ConfigurationError, match=r"criterion -3 is below"):
        within_reach(chosen, levels)


def test_bleach_is_the_protocols_luminance_or_refused(screen):
    """The field's grey shows it to the nearest level; what the screen does not reach is refused with its best."""
    code = field_code(screen, 120.0, "p")
    shown = screen.channel("grey").at(code[0], LUMINANCE).value
    step = screen.channel("grey").at(code[0] + 1, LUMINANCE).value - shown
    assert len(set(code)) == 1
    assert abs(shown - 120.0) <= 0.51 * step
    with pytest.raises(ConfigurationError, match="reaches 224"):
        field_code(screen, 300.0, "p")


def test_mark_is_red_and_dim(screen):
    """0.1 cd/m² above black by the red primary; by a share of grey, and stated so, where red was not measured."""
    rgb, measured = mark_code(screen, 0.1)
    red = screen.channel("red")
    assert rgb[1:] == (0, 0)
    assert red.at(rgb[0], LUMINANCE).value - red.at(0, LUMINANCE).value == pytest.approx(0.1, rel=0.1)
    assert measured
    _, known = mark_code(replace(screen, channels={"grey": screen.channels["grey"]}), 0.1)
    assert not known


def test_mark_and_spot_stand_where_the_eye_sees_them(stage, watched):
    """Eight degrees lie between their middles for an eye at 600 mm, and the spot subtends 1.5°."""
    stage.blink(0.0, 0, 0)
    (mark, spot), pixel = watched.blinks[0][0].shapes, 0.27
    place = [math.degrees(math.atan(s.x * pixel / 600.0)) for s in (mark, spot)]
    assert place[1] - place[0] == pytest.approx(8.0, abs=0.02)
    edges = [math.degrees(math.atan((spot.x + side * spot.width / 2) * pixel / 600.0)) for side in (-1, 1)]
    assert edges[1] - edges[0] == pytest.approx(1.5, abs=1e-6)
    away = math.hypot(600.0, spot.x * pixel)
    assert 2 * math.degrees(math.atan(spot.height * pixel / 2 / away)) == pytest.approx(1.5, abs=0.01)


def test_blink_shows_the_nearest_level_and_reports_it(stage, watched):
    """The code shown is the one whose light is nearest, and is journalled; a catch shows the mark alone."""
    watched.presses = (0.4, 0.9)
    assert stage.blink(None, 0, 0) == [0.4, 0.9]
    assert watched.blinks[0][0] == watched.blinks[0][1]
    assert stage.now_s() == pytest.approx(1.0)
    for asked in (0.31, -0.2, stage.protocol.spot.lowest_log10):
        stage.blink(asked, 0, 0)
        lit, rest, on_s, cycle_s = watched.blinks[-1]
        code = lit.shapes[-1].rgb[2]
        assert abs(_added(code) - asked) <= min(abs(_added(code + k) - asked) for k in (-1, 1) if code + k) + 0.01
        assert stage.shown_log10(asked) == pytest.approx(_added(code), abs=0.02)
        assert rest.shapes == lit.shapes[:1]
        assert (on_s, cycle_s) == (0.3, 1.0)


def test_bleach_fills_the_screen_for_its_time_and_leaves_the_mark(stage, watched):
    """A grey field without shapes for 300 s, then the mark on black."""
    stage.bleach(stage.protocol)
    field, rest = watched.shown
    assert field.shapes == ()
    assert field.field[0] > 150
    assert (rest.field, len(rest.shapes)) == ((0, 0, 0), 1)
    assert stage.now_s() == pytest.approx(300.0)


def test_long_press_is_reported_once_with_its_beginning(stage, watched):
    """A press that has lasted 2.5 s and goes on is reported as begun 2.5 s ago, and not again while it lasts."""
    watched.hold = Hold(1.0, 1.0)
    stage.rest(1.0)
    assert stage.long_press(2.0) is None
    watched.hold = Hold(2.5, 2.5)
    stage.rest(1.5)
    assert stage.long_press(2.0) == pytest.approx(0.0)
    watched.hold = Hold(3.5, 3.5)
    stage.rest(1.0)
    assert stage.long_press(2.0) is None


@pytest.mark.parametrize(("later_s", "reported"), [(0.15, False), (0.25, True)])
def test_beginnings_close_together_are_one_press(stage, watched, later_s, reported):
    """A page's times scatter: what seems to begin 0.2 s after a reported press is that press, later another."""
    watched.hold = Hold(2.5, 2.5)
    stage.rest(2.5)
    begun_s = stage.long_press(2.0)
    assert begun_s == pytest.approx(0.0)
    watched.hold = Hold(lasted_s=2.2, began_ago_s=3.0 - later_s)
    stage.rest(0.5)
    assert stage.long_press(2.0) == (pytest.approx(later_s) if reported else None)


def test_journal_learns_what_the_screen_is(stage):
    """Reach, steps, uncertainties, place of the eye and the page's warnings; a press is known to some 30 ms."""
    facts = stage.facts()
    assert facts["screen"] == "desk"
    assert facts["reach_log10"][0] == pytest.approx(stage.protocol.spot.lowest_log10, abs=1e-4)
    assert 0.029 < facts["u_press_s"] < 0.031
    assert facts["warnings"] == ["the page is not full screen: press F11"]
    assert "F11" in stage.health()["page"]


def test_what_does_not_fit_is_refused(screen, protocol, watched):
    """A phone too far away has no room for 8°, no screen gives a flash; without room at 11.5° the test goes on."""
    watched.size = (390, 844)
    with pytest.raises(ConfigurationError, match="sit closer"):
        ScreenStage(watched, screen, protocol, Viewing(600.0, 0.08), lambda: 0.0)
    flash = protocol.model_copy(update={"bleach": read_protocol("quick").bleach})
    with pytest.raises(UsageError, match="gives no flash"):
        ScreenStage(watched, screen, flash, Viewing(600.0, 0.27), lambda: 0.0)
    assert screen.channel("blue").efficacy(SCOTOPIC) == EFFICACIES["blue"][1]
    watched.size = (600, 400)
    stage = ScreenStage(watched, screen, protocol, Viewing(600.0, 0.27), lambda: watched.time)
    assert not stage.checks_fixation
    assert "no room" in stage.facts()["no_fixation_check"]
    with pytest.raises(UsageError, match="no room"):
        stage.blink_blind_spot(0, 0)


@pytest.mark.parametrize(("eye", "side"), [("right", 1), ("left", -1)])
def test_light_in_the_blind_spot_stands_temporal_of_the_mark(screen, protocol, watched, eye, side):
    """15.5° from the mark and 1.5° below it, red, for an eye 600 mm away; the spot is on the same side."""
    viewing = Viewing(600.0, 0.27)
    stage = ScreenStage(watched, screen, protocol, viewing, lambda: watched.time, eye=eye)
    watched.presses = (0.4,)
    assert stage.blink_blind_spot(0, 0) == [0.4]
    lit, rest, on_s, _ = watched.blinks[0]
    mark, light = rest.shapes[0], lit.shapes[-1]
    angles = [math.degrees(math.atan(side * shape.x * 0.27 / 600)) for shape in (mark, light)]
    assert angles[1] - angles[0] == pytest.approx(15.5, abs=0.02)
    assert math.degrees(math.atan(light.y * 0.27 / math.hypot(600, light.x * 0.27))) == pytest.approx(1.5, abs=0.01)
    assert light.rgb[0] > 0
    assert light.rgb[1:] == (0, 0)
    assert on_s == protocol.spot.on_s
    stage.blink(0.0, 0, 1)
    assert side * watched.blinks[1][0].shapes[-1].x > 0


@pytest.mark.parametrize(
    ("channel", "rgb"), [("red", (7, 0, 0)), ("green", (0, 7, 0)), ("blue", (0, 0, 7)), ("grey", (7, 7, 7))]
)
def test_a_level_is_shown_in_its_channel_alone(channel, rgb):
    """Level 7 of red lights nothing but red; of grey all three alike."""
    levels = SpotLevels(channel, np.array([5, 7]), np.array([-1.0, 0.0]), np.full(2, 0.1), 0.0)
    assert levels.rgb(levels.nearest(0.2)) == rgb
