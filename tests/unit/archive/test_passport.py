"""Passports: one dark law over sessions, gains held against what headers state, the lamp kept apart from the camera."""

import datetime as dt
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

from radiometer.archive.passport import fit_dark_law, light_line, passports
from radiometer.archive.sessions import LightSeries, Session, find_sessions, read_sessions
from radiometer.cli.main import run
from radiometer.data import Quantity
from radiometer.errors import InputError


def session(name, *, temperatures=(), rate_at_0=0.7, doubling_k=4.8, K=0.5, stated=2.0, series=(), u_k=0.05):
    """Return a session with dark currents by D = D0·2^(T/Td)."""
    rates = tuple(
        (t, u_k, Quantity(rate_at_0 * 2 ** (t / doubling_k), 0.002 * rate_at_0, "DN/s")) for t in temperatures
    )
    figures = {"K": Quantity(K, 0.005, "DN/e-")} if K else {}
    return Session(name, ("one",), dt.datetime(2017, 1, 1, tzinfo=dt.UTC), stated, figures, rates, tuple(series), ())


def test_one_law_over_two_sessions():
    """Rates of one exponential give its doubling and its rate at 0 °C; nothing changed."""
    law = fit_dark_law([session("a", temperatures=(-10, -5)), session("b", temperatures=(0, 10))])
    assert law.doubling_k.value == pytest.approx(4.8)
    assert law.rate_at_0.value == pytest.approx(0.7)
    assert law.is_one
    assert law.doubling_k.u == pytest.approx(4.8 * 0.05 * math.sqrt(4 / np.var([-10, -5, 0, 10])) / 2 / 2, rel=0.2)


def silicon(celsius, diffusion, generation):
    """Return a dark current in DN/s of parts with n_i² and n_i, whose gap goes by Varshni, by their amounts at 0 °C."""
    carriers = []
    for T in (celsius + 273.15, 273.15):
        gap_ev = 1.17 - 4.73e-4 * T**2 / (T + 636.0)
        carriers.append(T**1.5 * math.exp(-gap_ev / (2.0 * 8.617e-5 * T)))
    return diffusion * (carriers[0] / carriers[1]) ** 2 + generation * carriers[0] / carriers[1]


def of_silicon(name, temperatures, parts):
    one = session(name)
    rates = [silicon(t, *parts) for t in temperatures]
    figures = {"T_d": Quantity((temperatures[-1] - temperatures[0]) / math.log2(rates[-1] / rates[0]), 0.05, "K")}
    known = tuple((t, 0.05, Quantity(r, 0.01 * r, "DN/s")) for t, r in zip(temperatures, rates, strict=True))
    return replace(one, dark_rates=known, figures=figures)


def test_diffusion_and_generation_are_one_law_whose_doubling_goes_with_the_temperature():
    """Sessions of one sensor, 40 % generation at 0 °C: each doubles otherwise, the law says how, and all are one."""
    cold, warm = of_silicon("a", (-20.0, -10.0), (0.42, 0.28)), of_silicon("b", (0.0, 10.0, 20.0), (0.42, 0.28))
    law = fit_dark_law([cold, warm])
    assert law.birge_ratio < 0.5
    assert law.is_one
    assert law.rate_at_0.value == pytest.approx(0.7, rel=0.01)
    assert law.generation_share.value == pytest.approx(0.4, abs=0.03)  # halfway, at 0 °C
    assert law.between_c == (-20.0, 20.0)
    growth = math.log2(silicon(20.0, 0.42, 0.28) / silicon(-20.0, 0.42, 0.28))
    assert law.doubling_k.value == pytest.approx(40.0 / growth, rel=0.005)
    measured = [one.measured_k.value for one in law.doublings]
    assert [one.expected_k for one in law.doublings] == pytest.approx(measured, abs=0.1)
    assert measured[0] - measured[1] > 0.4
    assert law.doublings_apart_u < 2.0
    off = fit_dark_law([cold, replace(warm, figures={"T_d": Quantity(measured[1] - 0.5, 0.1, "K")})])
    first, second = (one.measured_k.value - one.expected_k for one in off.doublings)
    assert off.doublings_apart_u == pytest.approx(abs(first - second) / math.hypot(0.05, 0.1))


def test_what_either_law_makes_of_a_session_is_within_the_u_of_its_offset():
    """Silicon of two mechanisms, each session cold or warm: by doublings the warm one is off, and the u knows of it."""
    sessions = [of_silicon("a", (-20.0, -10.0), (0.42, 0.28)), of_silicon("b", (10.0, 20.0), (0.42, 0.28))]
    law = fit_dark_law(sessions)
    cold, warm = (float(np.mean([math.log(r.value) for _, _, r in one.dark_rates])) for one in sessions)
    slope = sum(math.log(one.dark_rates[1][2].value / one.dark_rates[0][2].value) for one in sessions) / 20.0
    by_doublings = warm - cold - 30.0 * slope
    assert abs(law.offset.value) < 0.01
    assert 1.0 < law.offset.u / (abs(by_doublings) / math.sqrt(3.0)) < 1.6


def test_a_sensor_that_ages_follows_no_one_law():
    """A session whose dark current rose by 40 % at the same temperatures is named, with the ratio and its direction."""
    sessions = [session("a", temperatures=(-10, 0, 10)), session("b", temperatures=(-10, 0, 10), rate_at_0=0.98)]
    (found,) = passports(sessions)
    assert not found.dark_law.is_one
    law, shown = found.dark_law, found.to_mapping()["dark_law"]["session_offset"]
    ratio = {"a": 0.7 / 0.98, "b": 0.98 / 0.7}[law.offset_session]
    assert (shown["session"], shown["value"]) == (law.offset_session, pytest.approx(ratio - 1.0, rel=0.01))
    assert f"{law.offset_session} {law.relative_offset.scaled(100.0, '%').text(with_k=True)} from it" in next(
        change.what for change in found.changes if change.quantity == "dark current"
    )
    assert [change.changed for change in found.changes if change.quantity == "dark current"] == [True]


@pytest.mark.parametrize(("risen", "changed"), [(1.0, False), (1.004, False), (1.3, True)])
def test_at_one_temperature_dark_currents_are_compared_as_they_are(risen, changed):
    """No law needs to be known for that; the temperature is, to 0.05 K, which is 0.6 % of a rate."""
    sessions = [session("a", temperatures=(20.0,)), session("b", temperatures=(20.0,), rate_at_0=0.7 * risen)]
    (found,) = passports(sessions)
    assert found.dark_law is None
    assert [change.changed for change in found.changes if change.quantity == "dark current"] == [changed]


def test_what_shows_no_law_is_fitted_by_none_and_judges_nothing():
    """Light that leaks in falls with the temperature; one temperature per session, or one session, tells no ageing."""
    for temperatures in ((-10, 0, 10), (-10, 10)):
        assert fit_dark_law([session("a", temperatures=temperatures, doubling_k=-4.8)]) is None
    for sessions in ([session("a", temperatures=(-10,)), session("b", temperatures=(10,))],
                     [session("a", temperatures=(-10, 0, 10))]):  # fmt: skip
        law = fit_dark_law(sessions)
        assert law.offset is None
        assert law.is_one


def test_a_header_gain_wrong_by_six_percent():
    """2.06 e-/DN stated and 1.94 measured from light and darks: +6.2 %, and the two agree."""
    one = session("a", K=1 / 1.94, stated=2.06)
    one.figures["K_dark"] = Quantity(1 / 1.95, 0.008, "DN/e-")
    (found,) = passports([one])
    sentence = " | ".join(found.gain)
    assert "off by +6.2 % against light" in sentence
    assert "wrong" in sentence
    assert "light and darks agree" in sentence


@pytest.mark.parametrize(
    ("name", "before", "after", "changed"),
    [
        ("mu_y_dark", Quantity(100.0, 0.0024, "DN"), Quantity(105.5, 0.0024, "DN"), True),
        ("mu_y_dark", Quantity(100.0, 0.0024, "DN"), Quantity(100.8, 0.0024, "DN"), False),  # repeats to 1 DN
        ("K", Quantity(0.5, 0.005, "DN/e-"), Quantity(0.5275, 0.005, "DN/e-"), True),  # 3.9 u
        ("K", Quantity(0.5, 0.008, "DN/e-"), Quantity(0.5275, 0.008, "DN/e-"), False),  # 2.4 u
    ],
)
def test_a_figure_changed_where_two_sessions_differ_beyond_their_u_and_what_repeats(name, before, after, changed):
    """Each session is compared with the other, not with a mean that holds it itself."""
    sessions = [replace(session(at, K=None), figures={name: one}) for at, one in (("a", before), ("b", after))]
    (found,) = passports(sessions)
    (change,) = found.changes
    assert change.changed is changed
    assert ("b against a +" in change.what) is changed


def test_chance_names_a_change_of_twelve_sessions_as_seldom_as_of_two():
    """Of 400 archives of an unchanged black level, 3 u of one pair name 0.27 %: at most 5 are allowed at 66 pairs."""
    rng = np.random.default_rng(8)
    names = 0
    for _ in range(400):
        figures = [{"mu_y_dark": Quantity(100.0 + rng.normal(0.0, 2.0), 2.0, "DN")} for _ in range(12)]
        (found,) = passports([replace(session(str(n), K=None), figures=one) for n, one in enumerate(figures)])
        names += found.changes[0].changed
    assert names <= 5


def series(levels, exposure_s=1.0):
    """Return repeated frames of one setting."""
    names = tuple(f"f{i}" for i in range(len(levels)))
    return LightSeries(exposure_s, 0.0, 1.0, "default", names, tuple(float(v) for v in levels))


def test_a_lamp_that_jumped_or_wandered_within_a_session():
    """A step of 1 % between the fifth and the sixth of ten frames, and scatter of 0.4 %; 0.02 % is nothing."""
    rng = np.random.default_rng(4)
    levels = 1000.0 * (1 + rng.normal(0, 2e-4, 10)) * np.where(np.arange(10) >= 5, 1.01, 1.0)
    assert "jumped by +0.99 % between f4 and f5" in light_line("a", series(levels))
    rng = np.random.default_rng(4)
    assert "wandered" in light_line("a", series(1000.0 * (1 + rng.normal(0, 4e-3, 8))))
    assert light_line("a", series(1000.0 * (1 + rng.normal(0, 2e-4, 8)))) is None


@pytest.mark.parametrize("frames", [1, 3])
def test_another_lamp_is_not_another_camera(frames):
    """A signal 10 % up at one gain and one dark law is the light's; with the gain 10 % up it is no change of light."""
    level = series([1000.0, 1000.5, 999.5][:frames])
    up = series([1100.0, 1100.5, 1099.5][:frames])
    temperatures = (-10, 0, 10)
    before = session("a", temperatures=temperatures, series=[level])
    (lamp,) = passports([before, session("b", temperatures=temperatures, series=[up])])
    assert "+10.0 %" in lamp.light[0]
    assert "the light, or the quantum efficiency (gain and dark current did not change)" in lamp.light[0]
    unknown = [session(name, temperatures=temperatures, series=[one], K=0) for name, one in (("a", level), ("b", up))]
    assert passports(unknown)[0].light[0].endswith(": light or camera")
    assert not any(change.changed for change in lamp.changes)
    more = [replace(one, exposure_s=2.0) for one in (level, up)]
    pair = [session("a", series=[level, more[0]]), session("b", series=[up, more[1]])]
    assert any("at 1 to 2 s the signal changed by +10.0 %" in one for one in passports(pair)[0].light)
    (gain,) = passports([before, session("b", temperatures=temperatures, series=[up], K=0.55)])
    assert gain.light == ()
    assert [change.changed for change in gain.changes if change.quantity == "K"] == [True]


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Return an archive of two nights of one simulated CCD, drawn here from Poisson charge and one dark law."""
    root = tmp_path_factory.mktemp("archive")
    rng = np.random.default_rng(12)
    shape, K, read_e = (96, 96), 0.5, 10.0
    spread = rng.gamma(40.0, 1 / 40.0, shape)

    def frame(seconds, celsius, light_e=0.0):
        electrons = rng.poisson(1.5 * 2 ** (celsius / 5.0) * seconds * spread + light_e) + rng.normal(0, read_e, shape)
        return np.rint(1000 + K * electrons).astype(np.uint16)

    def write(folder, number, picture, seconds, celsius, kind, day):
        unit = fits.PrimaryHDU(picture)
        facts = {"EXPTIME": seconds, "CCD-TEMP": celsius, "IMAGETYP": kind, "EGAIN": 2.2, "INSTRUME": "CCD"}
        for key, value in {**facts, "DATE-OBS": f"{day}T20:{number // 60:02d}:{number % 60:02d}"}.items():
            unit.header[key] = value
        (root / folder).mkdir(exist_ok=True)
        unit.writeto(root / folder / f"{number:03d}.fits")

    for folder, day, temperatures in (("2017", "2017-09-08", (-10.0, -5.0)), ("2019", "2019-09-06", (0.0, 10.0))):
        number = 0
        for celsius in temperatures:
            for seconds in (0, 0, 30, 60, 120, 200, 300):
                write(folder, number, frame(seconds, celsius), seconds, celsius, "dark", day)
                number += 1
        for _ in range(3):
            write(folder, number, frame(5, temperatures[1], 20_000.0), 5, temperatures[1], "flat", day)
            number += 1
    return root


def test_two_nights_of_one_camera(archive):
    """Doubling 5 K and one law, gain 2 e-/DN from light and darks within 2 u each, the header's 2.2 off by 10 %."""
    (found,) = passports(read_sessions(archive))
    law = found.dark_law
    assert law.doubling_k.value == pytest.approx(5.0, abs=3 * law.doubling_k.u)
    assert law.doubling_k.u < 0.2
    assert law.is_one
    for session in found.sessions:
        for name in ("K", "K_dark"):
            K = session.figures[name]
            assert K.value == pytest.approx(0.5, abs=2.5 * K.u), (session.name, name)
    assert any("off by +10" in line and "wrong" in line for line in found.gain)
    assert [c.changed for c in found.changes if c.quantity in ("K", "dark current")] == [False, False]


def test_the_command_reports_people_the_same(archive, tmp_path, capsys):
    """Sessions by date, the law of the dark current, the stated gain, and each figure as changed or not."""
    assert run(["passport", str(archive)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "CCD: " in printed
    assert re.search(
        r"dark current doubles per [\d.]+ ± [\d.]+ K \(k = 2\) from -?\d+ to -?\d+ °C, \S+ DN/s at 0 °C", printed
    )
    assert ": one law" in printed
    assert "gain: " in printed
    assert re.search(r"K: unchanged \(", printed)
    with pytest.raises(InputError, match="no capture set"):
        find_sessions(tmp_path)


@pytest.mark.long
def test_the_real_camera_over_two_years(shared_data):
    """2017 and 2019: one dark law, doubling 4.6 to 4.9 K; header gain 6.5 % off against light; lamp wandered."""
    if not (shared_data / "sensors" / "sbig_stl1001_2019").is_dir():
        pytest.skip("the CCD frames are not on this machine")
    sessions = [one for year in (2017, 2019) for one in read_sessions(shared_data / "sensors" / f"sbig_stl1001_{year}")]
    (found,) = passports(sessions)
    assert 4.6 < found.dark_law.doubling_k.value < 4.9
    assert found.dark_law.doubling_k.u < 0.1
    assert found.dark_law.is_one
    assert found.dark_law.doublings_apart_u < 2.0
    assert 0.3 < found.dark_law.generation_share.value < 0.7
    assert any("off by +6." in line and "wrong" in line for line in found.gain)
    assert any("light and darks agree" in line for line in found.gain)
    assert any("wandered" in line for line in found.light)
