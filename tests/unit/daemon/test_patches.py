"""Patches with names: measured in every period, limited without flapping, drawn with their gaps, and logged."""

import datetime as dt
import json
import logging
import math
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
import structlog
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import radiometer as rm
from radiometer.cli.main import run
from radiometer.daemon.http.resources import trend_columns
from radiometer.daemon.journal import Journal
from radiometer.daemon.journal_reader import JournalReader, TrendPoint
from radiometer.daemon.log import log
from radiometer.daemon.mqtt import topic_level
from radiometer.daemon.patches import PatchLimits, PatchWatch, check_name
from radiometer.daemon.service import LogThrottle
from radiometer.daemon.station import Station
from radiometer.daemon.timestamps import iso_time, microseconds
from radiometer.data import Flag, Patch, Quantity
from radiometer.errors import UsageError

LAMP = Patch(5, 6, 7, 8)  # the fake instrument's radiance is 1 + x
WATT = "W sr-1 m-2"
START_US = microseconds("2026-06-01T00:00:00Z")


async def test_a_patch_with_a_name_is_measured_next_to_the_shared_one(station, client, eventually):
    """Each period gives one reading of each; FETC? and FETC:PATC? keep them apart, and so do stream and figures."""
    listener = station.hub.subscribe()
    await client.send('SENS:PATC:DEF "lamp",5,6,7,8;:TRIG:TIM 0.02')
    await eventually(
        lambda: "lamp" in station.patches.watches and station.patches.watches["lamp"].latest and station.shown.latest
    )
    for _ in range(10):
        assert float((await client.ask("FETC?")).split(",")[0]) == 17.0
        assert float((await client.ask('FETC:PATC? "lamp"')).split(",")[0]) == 6.0
        assert float((await client.ask('FETC:PATC? "main"')).split(",")[0]) == 17.0
    events = [await listener.next() for _ in range(12)]
    shown = {
        (e.kind, json.loads(e.line)["patch"]["x"]) for e in events if e is not None and e.kind in ("reading", "patch")
    }
    assert shown == {("reading", 16), ("patch", 5)}
    assert b'radiometer_patch_radiance{patch="lamp",unit="W sr-1 m-2"} 6.0' in station.metrics.render()
    assert b'radiometer_radiance{unit="W sr-1 m-2"} 17.0' in station.metrics.render()


async def test_patches_and_limits_outlive_a_restart(instrument, tmp_path, eventually):
    """They are kept in the journal; a deleted one is not."""
    for turn in range(2):
        station = Station(instrument, Journal(tmp_path / "j.sqlite"))
        await station.start()
        if turn == 0:
            station.patches.define("lamp", LAMP)
            station.patches.define("gone", LAMP)
            station.patches.delete("gone")
            station.patches.set_limits("lamp", PatchLimits(1.0, 2.0, 0.05))
            station.patches.set_limits("main", PatchLimits(high=3.0))
        else:
            assert station.acquisition.named == {"lamp": LAMP}
            assert station.patches.watches["lamp"].limits == PatchLimits(1.0, 2.0, 0.05)
            assert station.patches.watches["main"].limits == PatchLimits(None, 3.0)
        await station.stop()


@pytest.mark.parametrize(
    ("name", "before_s", "after_s", "alarmed"),
    [("main", 0.5, None, True), ("lamp", 0.5, 86_400.0, True), ("main", 0.5, 9.0, False), ("lamp", 60.0, 299.0, False),
     ("main", 60.0, 301.0, True), ("lamp", None, None, True), ("main", None, 86_400.0, False)],
)  # fmt: skip
async def test_limits_that_no_measurement_watches_are_an_alarm_of_any_daemon(
    name, before_s, after_s, alarmed, instrument, tmp_path
):
    """They belong to the period at which they were set, or the first one after it, in whatever daemon."""
    for every_s in (before_s, after_s):
        station = Station(instrument, Journal(tmp_path / "j.sqlite"))
        await station.start()
        station.set_every(every_s)
        if every_s is before_s and "lamp" not in station.patches.watches:
            station.patches.define("lamp", LAMP)
            station.patches.set_limits(name, PatchLimits(high=99.0))
        await station.stop()
        station = Station(instrument, Journal(tmp_path / "j.sqlite"))
    await station.start()
    station.set_every(after_s)
    assert ("stopped" in station.troubles()) is alarmed
    station.patches.set_limits(name, PatchLimits(high=98.0))
    assert ("stopped" in station.troubles()) is alarmed
    station.patches.set_limits(name, PatchLimits())
    assert "stopped" not in station.troubles()
    station.patches.set_limits(name, PatchLimits(high=99.0))
    assert ("stopped" in station.troubles()) is (after_s is None)
    await station.stop()


async def test_new_limits_are_compared_at_once(station, eventually):
    """With the longest period too the patch is measured next, not in a day."""
    station.set_every(86_400.0)
    await eventually(lambda: station.shown.latest)
    station.patches.define("lamp", LAMP)
    await eventually(lambda: station.patches.latest_of("lamp"))
    for name in ("main", "lamp"):
        before = station.patches.latest_of(name)
        station.patches.set_limits(name, PatchLimits(high=99.0))
        await eventually(lambda name=name, before=before: station.patches.latest_of(name) is not before)
        assert station.troubles() == []


async def test_a_limit_is_compared_with_its_own_unit_only(instrument, tmp_path, eventually, make_reading):
    """A daemon that measures relative numbers alarms that limits in W·sr⁻¹·m⁻² are not compared, as does `breach`."""
    station = Station(instrument, Journal(tmp_path / "j.sqlite"))
    await station.start()
    station.set_every(0.02)
    station.patches.set_limits("main", PatchLimits(low=0.5))
    await eventually(lambda: station.status()["patches"]["main"]["limits"]["unit"])
    assert station.troubles() == []
    await station.stop()
    whole = instrument.measure
    instrument.measure = lambda settings: _in_unit(whole(settings), "relative")
    other = Station(instrument, Journal(tmp_path / "j.sqlite"))
    await other.start()
    other.set_every(0.02)
    await eventually(lambda: other.troubles() == ["limit main"])
    assert "its limits are in W·sr⁻¹·m⁻²: they are not compared" in other.alarms.message_of("limit main")
    other.patches.set_limits("main", PatchLimits(low=0.5))
    await eventually(lambda: other.status()["patches"]["main"]["limits"]["unit"] == "relative")
    assert other.troubles() == []
    await other.stop()
    for value in (0.1, 1.0, 1e9, math.nan):
        reading = make_reading(radiance=Quantity(value, 0.01, "relative"))
        for limits in (PatchLimits(low=0.5, unit="W sr-1 m-2"), PatchLimits(high=0.5, unit="W sr-1 m-2")):
            assert limits.breach(reading, standing=False) == limits.breach(reading, standing=True) == "unseen"


def _in_unit(measurement, unit):
    reading = measurement.reading
    return replace(measurement, reading=replace(reading, radiance=replace(reading.radiance, unit=unit)))


@pytest.mark.parametrize("patch", [None, LAMP])
async def test_a_patch_that_is_saturated_everywhere_is_an_alarm(station, instrument, eventually, patch):
    """What every frame clips is a lower bound, not measured; the alarm ends with the first reading that is none."""
    whole, clipped = instrument.measure, [True]

    def measure(settings):
        found = whole(settings)
        flags = (Flag.SATURATED,) if clipped[0] and settings.patch == patch else ()
        return replace(found, reading=replace(found.reading, flags=flags))

    instrument.measure = measure
    station.patches.define("lamp", LAMP)
    station.set_every(0.02)
    name = "measurement lamp" if patch else "measurement"
    await eventually(lambda: station.troubles() == [name])
    assert "saturated even in the shortest exposure (above" in station.alarms.message_of(name)
    clipped[0] = False
    await eventually(lambda: station.troubles() == [])


async def test_a_limit_alarms_on_every_interface(station, client, instrument, eventually):
    """Two readings beyond it: alarm, error queue, Prometheus and state; back inside: all clear."""
    await client.send('TRIG:TIM 0.01;:SENS:PATC:LIM "main",NONE,16.5')
    await eventually(lambda: [alarm.name for alarm in station.alarms.active] == ["limit main"])
    assert "above its high limit 16.5" in station.alarms.active[0].message
    assert (await client.ask("SYST:ERR?")).startswith("-200")
    assert b'radiometer_limit_alarm{patch="main"} 1.0' in station.metrics.render()
    assert station.status()["patches"]["main"]["breached"] == "high"
    await client.send('SENS:PATC:LIM "main",NONE,18')
    assert await client.ask('SENS:PATC:LIM? "main"') == "NONE,1.800000000E+01,1.000000000E-02"
    await eventually(lambda: not station.alarms.active)
    assert b'radiometer_limit_alarm{patch="main"} 0.0' in station.metrics.render()


def test_an_alarm_does_not_flap(make_reading):
    """Noise about a limit puts it up once, two readings inside by the hysteresis end it; a saturated one ends none."""
    watch = PatchWatch(PatchLimits(high=1.0, hysteresis_rel=0.05))

    def course(*values):
        changes = []
        for value in values:
            if watch.take(make_reading(radiance=Quantity(value, 0.01, "W sr-1 m-2"))):
                changes.append(watch.breached or "well")
        return changes

    assert course(0.9, 1.1, 0.9, 1.1, 0.99) == []  # single outliers are no alarm
    assert course(1.01, 1.02) == ["high"]
    assert course(0.99, 1.01, 0.96, 0.99, 0.97, 0.94, 0.96) == []  # within the hysteresis it stands
    assert course(0.94, 0.93) == ["well"]
    bright = make_reading(radiance=Quantity(1.5, 0.01, "W sr-1 m-2"))
    bound = make_reading(radiance=Quantity(0.15, 0.3, "W sr-1 m-2"), flags=(Flag.SATURATED,))
    watch = PatchWatch(PatchLimits(high=1.0))
    taken = [watch.take(reading) for reading in (bright, bright, bound, bound, bound)]
    assert taken == [False, True, False, False, False]
    assert watch.breached == "high"
    watch.limit(PatchLimits(high=1.0))
    assert [watch.take(bound), watch.take(bound), watch.breached] == [False, True, "unseen"]
    assert "cannot be seen" in watch.message("main")
    watch.limit(PatchLimits(low=0.1))
    assert [watch.take(bound), watch.take(bound)] == [False, False]


@pytest.mark.parametrize(
    ("flag", "value", "breach"),
    [
        (Flag.SATURATED, 0.5, "unseen"),
        (Flag.SATURATED, 1.5, "unseen"),
        (Flag.SATURATED, 3.0, "high"),
        (Flag.BELOW_NOISE, 3.0, "unseen"),
        (Flag.BELOW_NOISE, 1.5, "unseen"),
        (Flag.BELOW_NOISE, 0.5, "low"),
    ],
)
def test_a_bound_breaks_only_the_limit_it_is_beyond(make_reading, flag, value, breach):
    """A saturated value is at least so large, one below the noise at most: neither shows that it is within."""
    reading = make_reading(radiance=Quantity(value, 0.1, "W sr-1 m-2"), flags=(flag,))
    assert PatchLimits(1.0, 2.0).breach(reading, standing=False) == breach


def test_names_that_lead_astray_are_refused():
    """32 letters, digits and a few signs; no radiance is above 2 and below 2, and the hysteresis is half at most."""
    for name in ("", "main", "MAIN", " lamp", "a/b", "lämp", "x" * 33, "a\nb", '"'):
        with pytest.raises(UsageError):
            check_name(name)
    for name in ("x" * 32, "a", "mains", "Lamp 1.b_c-d+e"):
        assert check_name(name) == name
    for low, high in ((2.0, 2.0), (3.0, 2.0), (math.nan, None), (None, math.inf)):
        with pytest.raises(UsageError):
            PatchLimits(low, high)
    assert PatchLimits(1.0, 2.0, 0.5).hysteresis_rel == 0.5
    with pytest.raises(UsageError, match="hysteresis"):
        PatchLimits(1.0, 2.0, 0.51)


@pytest.mark.parametrize(("value", "text"), [(3.0, "above its high limit 2"), (0.5, "below its low limit 1")])
def test_an_alarm_names_the_limit_that_was_passed(make_reading, value, text):
    """The side and the number are those of the limit broken, not of the other one."""
    watch = PatchWatch(PatchLimits(1.0, 2.0))
    for _ in range(2):
        watch.take(make_reading(radiance=Quantity(value, 0.01, "W sr-1 m-2")))
    assert text in watch.message("lamp")
    assert str(watch.latest) in watch.message("lamp")
    watch.limit(watch.limits)
    assert watch.breached == ""
    assert not watch.take(watch.latest), "what was reported before the limits were set counts no longer"


async def test_wrong_patches_are_refused(station):
    """Outside the picture, too many, unknown: each with its reason, and nothing is changed."""
    for number in range(12):
        station.patches.define(f"p{number}", LAMP)
    station.patches.define("p3", replace(LAMP, x=1))  # moving one is not another one
    for call, text in (
        (lambda: station.patches.define("one more", LAMP), "12 patches"),
        (lambda: station.patches.define("p1", Patch(60, 0, 10, 10)), "not inside"),
        (lambda: station.patches.delete("unknown"), "no patch"),
        (lambda: station.patches.delete("main"), "not deleted"),
    ):
        with pytest.raises(UsageError, match=text):
            call()
    assert len(station.acquisition.named) == 12


@pytest.mark.parametrize(
    ("other", "bound"),
    [
        ({"patch": Patch(0, 0, 11, 10)}, ""),
        ({"instrument": "4712"}, ""),
        ({"patch": Patch(1, 0, 10, 10)}, ""),
        ({"flags": (Flag.NONUNIFORM, Flag.SATURATED)}, "at least"),
        ({"flags": (Flag.BELOW_NOISE,)}, "at most"),
    ],
)
@pytest.mark.parametrize("minutes", [90, 24 * 60])
def test_a_trend_mixes_neither_places_nor_values_with_bounds(tmp_path, make_reading, other, bound, minutes):
    """A patch that was moved, read by another camera, or saturated: no mean holds both, and no line joins them."""
    readings = []
    for k in range(60):
        changes = {} if k < 31 else other
        level = 1.0 if k < 31 else 2.0
        radiance = Quantity(level, 0.1, "W sr-1 m-2")
        readings.append(make_reading(time=iso_time(START_US + k * 20_000_000), radiance=radiance, **changes))
    with Journal(tmp_path / "j.sqlite") as journal:
        journal.append(readings)
    found = JournalReader(tmp_path / "j.sqlite").trend("", START_US, START_US + minutes * 60_000_000, 10)
    assert {point.value for point in found} == {1.0, 2.0}
    assert sum(point.count for point in found) == 60
    columns = trend_columns(found, 20.0)
    values = columns["value"]
    assert values[values.index(2.0) - 1] is None
    assert dict(zip(values, columns["bound"], strict=True)) == {1.0: "", None: None, 2.0: bound}
    logged = log(tmp_path / "j.sqlite")
    logged.write_plot(tmp_path / "log.svg")
    if bound:
        assert f"29 {other['flags'][-1]} ({bound} their value): mean 1," in logged.places[0].summary()
        assert f"{other['flags'][-1]}: {bound} this" in (tmp_path / "log.svg").read_text(encoding="utf-8")
    assert values.count(None) == 1


@pytest.mark.parametrize(
    ("usual_s", "every_s", "longest_s"), [(0.02, None, 3.0), (0.02, 0.02, 3.0), (10.0, None, 30.0), (2.0, 60.0, 180.0)]
)
def test_readings_are_missing_after_three_periods(usual_s, every_s, longest_s):
    """Of those asked for, or of those that there were where these are longer, and never within 3 s: a row of nulls."""
    for pause_s, gaps in ((0.98 * longest_s, 0), (1.02 * longest_s, 1)):
        times = [0.0, usual_s, 2.0 * usual_s, 2.0 * usual_s + pause_s]
        points = [TrendPoint(START_US + round(1e6 * t), 1.0, 0.1, 0.8, 1.3, 6, 2, "u") for t in times]
        columns = trend_columns(points, every_s)
        assert columns["value"] == [1.0] * 3 + [None] * gaps + [1.0]
        last = {name: column[-1] for name, column in columns.items() if name != "time"}
        assert last == {"unit": "u", "value": 1.0, "U": 0.2, "low": 0.8, "high": 1.3, "count": 6, "flagged": 2,
                        "bound": ""}  # fmt: skip
        assert columns["time"][-1] == pytest.approx(START_US / 1e6 + times[-1], abs=1e-5)
    assert trend_columns([], every_s)["time"] == []


async def test_http_serves_patches_trends_and_remarks(http, station, eventually):
    """Define, limit, measure, draw, remark, delete: each by its route, each refused with its reason where wrong."""

    async def post(path, body):
        reply = await http.post(path, json=body)
        return reply.status, reply.json()

    place = {"x": 5, "y": 6, "width": 7, "height": 8}
    status, state = await post("/patches", {"name": "lamp", "patch": place, "limits": {"low": 1, "high": 20}})
    lamp = state["patches"]["lamp"]
    assert (status, lamp["limits"]["high"], lamp["patch"]) == (200, 20, place)
    assert (await post("/patches", {"name": "../x", "patch": place}))[0] == 400
    assert (await post("/patches", {"name": "lamp", "limits": {"low": 3, "high": 2}}))[0] == 400
    station.set_every(0.02)
    await eventually(lambda: station.patches.watches["lamp"].latest)
    trend = (await http.get("/trend", params={"stream": "patch lamp", "since": "10min"})).json()
    assert (trend["unit"], trend["value"][0]) == ("W sr-1 m-2", 6.0)
    for wrong in (
        "trend?stream=own2",
        "trend?stream=all",
        "trend?points=1",
        "trend?since=1h&until=2h",
        "events?limit=0",
    ):
        assert (await http.get(f"/{wrong}")).status == 400
    assert (await post("/events", {"message": "lamp  exchanged\n"}))[1]["message"] == "lamp exchanged"
    assert (await post("/events", {"message": " "}))[0] == 400
    while "lamp exchanged" not in [event["message"] for event in (await http.get("/events?since=1h")).json()]:
        pass
    assert (await post("/patches/delete", {"name": "lamp"}))[0] == 200
    assert (await post("/patches/delete", {"name": "lamp"}))[0] == 400
    assert b'patch="lamp",unit' not in station.metrics.render()


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(limit=st.floats(-10.0, 10.0), share=st.floats(0.01, 0.5), away=st.floats(-0.9, 0.9), standing=st.booleans())
def test_a_low_limit_is_the_mirror_of_a_high_one(make_reading, limit, share, away, standing):
    """Of any sign; one that is broken counts as broken until it is left by the hysteresis, a share of its size."""
    value = limit + away * abs(limit)
    outside = away > (-share if standing else 0.0)
    assume(abs(limit) > 1e-3 and abs(away - (-share if standing else 0.0)) > 1e-6)
    high = PatchLimits(high=limit, hysteresis_rel=share)
    low = PatchLimits(low=-limit, hysteresis_rel=share)
    above, below = (make_reading(radiance=Quantity(v, 0.1, "W sr-1 m-2")) for v in (value, -value))
    assert high.breach(above, standing=standing) == ("high" if outside else "")
    assert low.breach(below, standing=standing) == ("low" if outside else "")


@given(names=st.lists(st.text(" ._-+aB1", min_size=1, max_size=8), min_size=2, unique=True))
def test_no_two_patches_share_a_topic(names):
    """Each name is one level of its own, without wildcards; a plain name stays as it is."""
    levels = [topic_level(name) for name in names]
    assert len(set(levels)) == len(names)
    assert not any(sign in level for level in levels for sign in "+#/ ")
    assert topic_level("lamp_1.b-c") == "lamp_1.b-c"


# The log of a journal that holds readings of several places: each has its own mean, and its own line in a picture.


@pytest.fixture
def journal(tmp_path, make_reading):
    """Return a journal of a wall at 0.30 and, read once in between, a lamp at 0.90."""
    places = [(0.300, Patch(1, 2, 3, 4)), (0.90, Patch(50, 60, 7, 8)), (0.303, Patch(1, 2, 3, 4))]
    with Journal(tmp_path / "j.sqlite") as written:
        for value, patch in places:
            written.append([make_reading(radiance=Quantity(value, 0.003, "W sr-1 m-2"), patch=patch)])
    return tmp_path / "j.sqlite"


def test_readings_of_another_place_do_not_count_in_a_mean(journal, capsys, monkeypatch):
    """The wall's standard deviation is 0.0021 (0.7 %), not the 69 % of all three; the lamp has its own line."""
    monkeypatch.setenv("COLUMNS", "160")
    assert run(["log", str(journal)]) == 0
    *table, wall, lamp = capsys.readouterr().out.splitlines()
    assert [("1,2 3" in line, "50,60" in line) for line in table[2:]] == [(True, False), (False, True), (True, False)]
    assert wall.startswith("patch 1,2 3 × 4: 2 readings")
    assert wall.endswith("mean 0.3015, standard deviation 0.0021 W·sr⁻¹·m⁻² (0.7 %)")
    assert lamp.startswith("patch 50,60 7 × 8: 1 reading,")


def test_each_place_is_a_line_of_its_own_in_the_picture(journal, tmp_path):
    """Two lines with a name each; a name without a picture's ending is refused."""
    lines = rm.log(journal).plot().get_lines()
    assert [line.get_label() for line in lines] == ["patch 1,2 3 × 4", "patch 50,60 7 × 8"]
    rm.log(journal).write_plot(tmp_path / "log.png")
    assert (tmp_path / "log.png").stat().st_size > 1000
    with pytest.raises(rm.UsageError, match=r"one of \.png"):
        rm.log(journal).write_plot(tmp_path / "log.txt")


def hours(make_reading, *minutes, start=dt.datetime(2026, 11, 20, 8, tzinfo=dt.UTC), **how):
    """Return readings of 0.3 W·sr⁻¹·m⁻² at minutes of one day."""
    times = [(start + dt.timedelta(minutes=m)).isoformat(timespec="milliseconds") for m in minutes]
    return [make_reading(radiance=Quantity(0.3, 0.004, "W sr-1 m-2"), time=at, **how) for at in times]


@pytest.fixture
def logged(tmp_path):
    """Return a function that writes a journal of notes (tuples) and of readings (lists), and returns its log."""

    def write(*entries):
        with Journal(tmp_path / "j.sqlite") as journal:
            for entry in entries:
                journal.note(*entry) if isinstance(entry, tuple) else journal.append(entry)
        return rm.log(tmp_path / "j.sqlite")

    return write


def test_a_line_and_its_band_end_where_the_readings_pause(logged, make_reading):
    """A reading a minute, an hour without, one alone, an hour, and more: two pieces and a dot, nothing between."""
    axes = logged(hours(make_reading, 0, 1, 2, 3, 4, 63, 123, 124, 129, 130)).plot()
    line, dot = axes.get_lines()
    assert [int(np.isnan(v)) for v in line.get_ydata()] == [0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0]
    assert (list(dot.get_ydata()), dot.get_linestyle()) == ([0.3], "None")
    (band,) = axes.collections
    assert len(band.get_paths()) >= 2


def from_now(make_reading, *minutes, **how):
    """Return readings at minutes from now: limits that a journal notes are in force from now on."""
    return hours(make_reading, *minutes, start=dt.datetime.now(dt.UTC), **how)


def limits_in(unit, low=None, high=None, name="lamp"):
    """Return the event that limits were set."""
    return "patch", PatchLimits(low, high, unit=unit).note(name)


@pytest.mark.parametrize(
    ("low", "high", "unit", "drawn", "legend"),
    [
        (0.29, 0.31, WATT, [0.29, 0.31], "lamp (limits 0.29 to 0.31)"),
        (None, 0.305, WATT, [0.305], "lamp (limits none to 0.305)"),
        (0.0, None, WATT, [], "lamp (limits 0 to none)"),
        (9.0, None, WATT, [9.0], "lamp (limits 9 to none)"),
        (None, 0.01, WATT, [0.01], "lamp (limits none to 0.01)"),
        (None, 0.305, "relative", [], "lamp"),
        (None, None, WATT, [], "lamp"),
    ],
)
def test_limits_are_in_the_picture_where_they_are_near_and_named_always(
    logged, make_reading, low, high, unit, drawn, legend
):
    """Those of a patch with a name and of its unit; one far from its readings only where the newest is beyond it."""
    axes = logged(limits_in(unit, low, high), from_now(make_reading, 1, 2, 3, name="lamp")).plot()
    line, *dashed = axes.get_lines()
    bottom, top = axes.get_ylim()
    assert line.get_label() == legend
    assert [bound for one in dashed if bottom < (bound := one.get_ydata()[0]) < top] == drawn


def test_limits_are_drawn_over_the_time_in_which_they_were_in_force(logged, make_reading):
    """Those of before the change end there, those of after it begin there; the legend names the newest."""
    before, after = from_now(make_reading, -3, -2, name="lamp"), from_now(make_reading, 1, 2, name="lamp")
    limits = [limits_in(WATT, high=high) for high in (0.31, 0.305)]
    line, old, new = logged(before, *limits, after).plot().get_lines()
    assert (line.get_label(), *old.get_ydata(), *new.get_ydata()) == (
        "lamp (limits none to 0.305)", 0.31, 0.31, 0.305, 0.305
    )  # fmt: skip
    times = line.get_xdata()
    assert times[0] < old.get_xdata()[0] <= old.get_xdata()[1] == new.get_xdata()[0] < new.get_xdata()[1] == times[-1]


def test_each_unit_has_a_panel_in_the_picture(logged, make_reading):
    """A calibration that came later moves the readings to an axis of their own; a patch keeps its colour."""
    raw = [replace(one, radiance=Quantity(9e4, 50.0, "relative")) for one in from_now(make_reading, 0, 1)]
    log_of_both = logged([*raw, *from_now(make_reading, 2, 3, flags=(Flag.NONUNIFORM,))])
    upper, lower = log_of_both.plot().figure.axes
    assert upper.get_ylim()[0] > 8e4 > 1 > lower.get_ylim()[1]
    assert [axes.get_ylabel().split("\n")[0] for axes in (upper, lower)] == [
        "radiance (relative)", "radiance (W·sr⁻¹·m⁻²)"
    ]  # fmt: skip
    assert len({line.get_color() for axes in (upper, lower) for line in axes.get_lines()[:1]}) == 1
    assert [text.get_text() for text in lower.get_legend().get_texts()] == ["patch 0,0 10 × 10", "flagged"]
    figure = type(upper.figure)()
    with pytest.raises(rm.UsageError, match="no subplot"):
        log_of_both.plot(figure.add_axes((0, 0, 1, 1)))


def test_limits_far_from_their_readings_are_drawn_where_another_patch_is_there(logged, make_reading):
    """A patch that reads nothing widens the picture to 0: the low limit of the bright one lies in it."""
    dark = [replace(one, radiance=Quantity(0.0, 0.004, WATT)) for one in from_now(make_reading, 4, 5, name="dark")]
    axes = logged(limits_in(WATT, low=0.1), from_now(make_reading, 1, 2, 3, name="lamp"), dark).plot()
    bottom, top = axes.get_ylim()
    assert bottom < 0.1 < top
    assert [0.1, 0.1] in [list(line.get_ydata()) for line in axes.get_lines()]


def test_limits_of_the_patch_for_all_are_of_where_it_is_now(logged, make_reading):
    """It was moved before they were set, and a client measured for itself since; neither has limits."""
    found = logged(
        from_now(make_reading, -3, -2, patch=Patch(1, 2, 3, 4)),
        limits_in(WATT, high=0.31, name="main"),
        ("patch", "limits of lamp: 9 to 3"),
        from_now(make_reading, 2, 3, patch=Patch(50, 60, 7, 8)),
        from_now(make_reading, 4, 5, patch=Patch(9, 9, 9, 9), session="web"),
    )
    labels = [line.get_label() for line in found.plot().get_lines()]
    assert [label for label in labels if "limits" in label] == ["patch 50,60 7 × 8 (limits none to 0.31)"]


@pytest.mark.parametrize("mixed", [False, True])
def test_dates_units_and_numbers_stay_whole_in_80_columns(tmp_path, make_reading, capsys, monkeypatch, mixed):
    """Places and flags are folded; unit and k are in the heading, or columns where readings differ in them."""
    monkeypatch.setenv("COLUMNS", "80")
    lux = Quantity(103.2, 0.9, "cd m-2")
    many = {"luminance": lux, "flags": (Flag.FLICKER, Flag.SATURATED)}
    with Journal(tmp_path / "j.sqlite") as written:
        written.append(hours(make_reading, 0, 1, name="lamp", **many))
        written.append(hours(make_reading, 2, patch=Patch(800, 600, 120, 120), **many))
        if mixed:
            written.append([make_reading(radiance=Quantity(2.0, 0.1, "relative"), coverage_factor=2.87)])
    assert run(["log", str(tmp_path / "j.sqlite")]) == 0
    printed = capsys.readouterr().out
    assert printed.count("2026-11-20 08:0") == 3
    varying = ("relative", "2.87") if mixed else ("k = 2", "0.0080")
    assert [whole for whole in ("W·sr⁻¹·m⁻²", "0.3000", "103.2 ± 1.8", *varying) if whole not in printed] == []
    if not mixed:
        assert max(map(len, printed.splitlines()[:-2])) <= 80


@pytest.mark.parametrize("library", [False, True])
def test_a_flood_is_ten_lines_a_minute_and_a_count(library):
    """61 000 equal lines in a minute become 20 and a count; each different line is written."""
    now = [0.0]
    throttle = LogThrottle(clock=lambda: now[0])
    lines = []

    def say(text):
        if library:
            record = logging.LogRecord("asyncio", logging.WARNING, "", 0, text, None, None)
            lines.extend([record.getMessage()] if throttle.filter(record) else [])
        else:
            try:
                lines.append(str(throttle(None, "warning", {"event": text})))
            except structlog.DropEvent:
                return

    for second in range(61):
        now[0] = float(second)
        for _ in range(1000):
            say("client refused")
        say(f"alarm {second}")
    assert sum("client refused" in line for line in lines) == 20
    assert sum("59990" in line for line in lines) == 1
    assert sum("alarm" in line for line in lines) == 61


def test_an_installed_throttle_bounds_what_is_written(capsys):
    """Of a hundred equal events ten lines reach standard error; what differs does too."""
    before = structlog.get_config()["processors"]
    try:
        LogThrottle().install()
        for _ in range(100):
            structlog.get_logger().warning("refused")
        structlog.get_logger().warning("another")
        assert len(capsys.readouterr().err.splitlines()) == 11
    finally:
        structlog.configure(processors=before)


@pytest.mark.parametrize("damage", ["{", "[" * 100_000, '{"time": "2026"}', b"\x00"])
def test_a_damaged_row_is_left_out_and_counted(journal, capsys, damage):
    """The other readings are shown."""
    with sqlite3.connect(journal) as connection:
        connection.execute("UPDATE readings SET json = ? WHERE sequence = 2", (damage,))
    assert run(["log", str(journal)]) == 0
    printed = capsys.readouterr()
    assert "1 rows of the journal are damaged" in printed.err
    assert "patch 1,2 3 × 4: 2 readings" in printed.out
