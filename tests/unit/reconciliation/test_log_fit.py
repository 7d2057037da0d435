"""Logs of an all-sky camera and a sky meter: each planted term is named with its size, and nothing where nothing is.

The offline count of false alarms is in docs/benchmarks/reconcile.md.
"""

import json
import math

import numpy as np
import pytest

from radiometer.cli.main import run
from radiometer.data.statements import StatementMap
from radiometer.errors import InputError, UnsettledError
from radiometer.importing.log_table import read_log
from radiometer.reconciliation.log_fit import fit_log
from testing.sky_log import Camera, sky_log, write

GAIN_AT_18 = math.log(10.0) / 20.0


def _fitted(tmp_path, camera, seed=3, control=False):
    return fit_log(read_log(write(sky_log(seed, camera), tmp_path / "log.csv")), control=control)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "name", "parameter", "true"),
    [
        (Camera(black_dn=150.0), "black_level_offset", "offset_dn", 150.0),
        (Camera(magnitude_per_colour=0.2), "spectral_mismatch", "per_colour", -0.08 * math.log(10.0)),
        (Camera(wrong_db=(0.0, 0.2, 0.4, 0.6)), "gain_step_error", "per_dB", 0.2 / 6.1 * GAIN_AT_18),
        (Camera(wrong_db=(0.0, 0.2, 0.1, 0.5)), "gain_step_error", "at_0.0dB", -0.5 * GAIN_AT_18),
        (Camera(share_per_kelvin=-0.006), "quantum_efficiency_temperature", "per_K", math.log(0.994)),
        (Camera(dark_e_per_s_at_25=20.0), "dark_current", "dark_at_25C_dn_per_s", 5.0),
        (Camera(shutter_late_s=0.01), "exposure_time_offset", "offset_s", 0.01),
        (Camera(lamp_share_of_21_mag=0.1), "ambient_light_leak", "constant", 0.1 * 10.8e4 * 10.0 ** (-0.4 * 21.0)),
    ],
)
def test_planted_term_is_named_with_its_size(tmp_path, camera, name, parameter, true):
    """One term, named first and alone, within two of its standard uncertainties; the error of nights shrinks."""
    found = _fitted(tmp_path, camera)
    assert str(found.result.verdict) == "effects_found"
    assert [effect.name for effect in found.result.effects] == [name]
    entry = found.result.effects[0].parameters[parameter]
    assert abs(entry.value - true) < 2.0 * entry.u + 1e-3 * abs(true)
    assert entry.u < 0.2 * abs(true)
    assert found.error_after < 0.9 * found.error_before
    assert found.result.gap_after < 1.2 < found.result.gap_before


@pytest.mark.slow
def test_other_columns_and_bends_are_recognised(tmp_path):
    """A bent response is found or the rival; what has no name by its column."""
    effect = _fitted(tmp_path, Camera(bends_at_dn=6000.0)).result.effects[0]
    assert "response_nonlinearity" in (effect.name, *effect.alternatives)
    result = _fitted(tmp_path, Camera(share_per_day=-0.02)).result
    assert str(result.verdict) == "unnamed_effect"
    assert [(effect.name, effect.where) for effect in result.effects] == [("unnamed", "time")]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_nothing_is_found_where_nothing_is(tmp_path, seed):
    """Clouds, haze and a moon alone raise no alarm, and limits say what would have been seen."""
    result = _fitted(tmp_path, Camera(), seed).result
    assert str(result.verdict) == "agrees"
    assert result.effects == ()
    assert 0.5 < result.gap_after < 1.5
    assert 0.0 < result.limits["quantum_efficiency_temperature"].amplitude < 0.01
    assert 0.0 < result.limits["exposure_time_offset"].amplitude < 0.005


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lamp_that_stays_the_same_shows_no_leak_of_light(tmp_path, seed):
    """A meter that scatters by 1 % about 5 lx cannot show an ambient light: none is found, and the way out is given."""
    rng, lines = np.random.default_rng(seed), ["utc,adu,exposure_s,gain_db,lux"]
    for at in range(270):
        seconds, stamp = (0.1, 0.2, 0.4)[at % 3], np.datetime64("2026-03-01T20:00") + at // 45 * 1440 + at % 45 * 8
        value, lux = 2e4 * seconds * (1 + rng.normal(0, 0.003)), 5 * (1 + rng.normal(0, 0.01))
        lines.append(f"{stamp},{value:.1f},{seconds},0,{lux:.4f}")
    path = tmp_path / "lamp.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    result = fit_log(read_log(path), control=False).result
    assert str(result.verdict) == "agrees"
    assert 0.5 < result.gap_after < 1.5
    assert result.limits["ambient_light_leak"].amplitude is None
    assert any("a half and a quarter of the light" in line for line in result.assumptions)


@pytest.mark.slow
def test_command_says_what_it_took_and_its_control_is_silent(tmp_path, capsys):
    """Columns, unit of the gain, magnitudes, error before and after, the control; JSON in the words of reconcile."""
    path = write(sky_log(3, Camera(magnitude_per_colour=0.2)), tmp_path / "log.csv")
    assert run(["log-fit", str(path)]) == 0
    printed = capsys.readouterr()
    assert "reference from 'sqm_mag'" in printed.err
    assert "spectral_mismatch" in printed.out
    assert "negative control" in printed.out
    assert "silent" in printed.out
    assert "10.8e4" in printed.out
    assert run(["log-fit", str(path), "--json", "--no-control"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "effects_found"
    assert result["negative_control"] is None
    assert result["night_error_rel"]["after"] < 0.5 * result["night_error_rel"]["before"]
    assert result["gap"]["unit"] == "reduced chi-square on held-out nights"


def test_reference_of_a_file_of_its_own_is_joined_by_time(tmp_path):
    """A meter's own file (header behind #, semicolons) is interpolated in time; rows with no neighbour are left out."""
    rows = sky_log(3, Camera())
    lines = ["# Light Pollution Monitoring Data Format 1.0", "# UTC Date & Time; Temperature; MSAS"]
    for row in rows[:-40]:
        stamp = np.datetime64(int(row["utc"]), "s")
        lines.append(f"{stamp};{row['temp_c']};{row['sqm_mag']}")
    meter = tmp_path / "meter.dat"
    meter.write_text("\n".join(lines), encoding="utf-8")
    camera = write(rows, tmp_path / "camera.csv", "sqm_mag")
    log = read_log(camera, reference=meter)
    whole = read_log(write(rows, tmp_path / "whole.csv"))
    assert log.size == len(rows) - 40
    assert np.allclose(log.reference, whole.reference[: log.size], rtol=0.02)
    assert any("40 rows without a reference" in line for line in log.assumptions)
    assert "reference from 'MSAS' of meter.dat" in log.taken


def test_units_of_columns_are_taken_by_their_names(tmp_path):
    """Milliseconds, gains as factors, ISO, tenths of a decibel and magnitudes come out in s, dB and cd/m²."""
    head = "adu,exposure_ms,gain_x,mpsas,night"
    lines = [head, *(f"1000,{250 * (1 + n)},10,{20 + n / 10},{n % 3}" for n in range(12))]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    log = read_log(path)
    assert log.exposure_s[:2].tolist() == [0.25, 0.5]
    assert log.gain_db[0] == pytest.approx(20.0)
    assert log.reference[0] == pytest.approx(1.08e-3)
    assert log.reference[10] / log.reference[0] == pytest.approx(10 ** (-0.4))
    assert log.nights == 3
    changing = [line.replace(",10,", f",{200 + 10 * n},") for n, line in enumerate(lines[1:])]
    path.write_text("\n".join([head.replace("gain_x", "gain"), *changing]), encoding="utf-8")
    with pytest.raises(UnsettledError, match="--map gain=gain:UNIT"):
        read_log(path)
    for unit, first_db in (("iso", 6.0206), ("0.1dB", 20.0), ("x", 46.0206)):
        log = read_log(path, StatementMap.parse([f"gain=gain:{unit}"]))
        assert log.gain_db[0] == pytest.approx(first_db, abs=1e-3)


OPEN = {
    "exposure": ("exposure_s", "exposure", "exposure:ms", "exposure_s", 1e-3),
    "temperature": ("temp_c", "temp", "temp:F", "temperature_c", 5.0 / 9.0),
    "reference": ("sqm_mag", "reference", "reference:mag", "reference", None),
}


@pytest.mark.parametrize("fact", OPEN)
def test_a_unit_that_no_heading_states_stops_until_the_user_states_it(fact, tmp_path, capsys):
    """The line names the option; with it the column is read in that unit."""
    heading, bare, place, attribute, factor = OPEN[fact]
    rows = sky_log(1, Camera(), 4, 10)
    whole = read_log(write(rows, tmp_path / "whole.csv"))
    path = write(
        [{bare if name == heading else name: v for name, v in row.items()} for row in rows], tmp_path / "t.csv"
    )
    assert run(["log-fit", str(path)]) == 1
    assert f"--map {fact}={bare}:UNIT" in capsys.readouterr().err
    found = getattr(read_log(path, StatementMap.parse([f"{fact}={place}"])), attribute)
    expected = getattr(whole, attribute)
    if fact == "temperature":
        expected = expected - 32.0
    assert found == pytest.approx(expected * (factor or 1.0), rel=1e-6)


def test_tables_are_split_into_nights_and_their_columns_named(tmp_path):
    """Three hours without a reading, else noon; a column that is not there is refused."""
    rows = sky_log(1, Camera())
    assert read_log(write(rows, tmp_path / "a.csv")).nights == 8
    lines = ["adu,exposure_s,lux,utc", *(f"1000,1,5,{1.7e9 + 3600 * n}" for n in range(96))]
    path = tmp_path / "b.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    log = read_log(path)
    assert any("noon" in line for line in log.assumptions)
    assert log.nights in (4, 5)
    path = write(sky_log(1, Camera(), 3, 5), tmp_path / "t.csv")
    with pytest.raises(UnsettledError, match="no column 'lumen', which --map reference names; it has utc, adu"):
        read_log(path, StatementMap.parse(["reference=lumen"]))
    other = tmp_path / "m.csv"
    other.write_text("utc,mpsas\n2001-01-01T00:00:00,20\n2001-01-01T00:01:00,20\n", encoding="utf-8")
    with pytest.raises(InputError, match="both are in UTC"):
        read_log(path, reference=other)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("adu,exposure_s\n1,1\n", "no column for reference"),
        ("adu,exposure_s,lux\n1,x,3\n", "line 2: exposure_s"),
        ("adu,exposure_s,lux\n" + "1,1,3\n" * 4, "at least 12 of 3"),
        ("adu,exposure_s,lux,night\n" + "".join(f"{n - 5},1,3,{n}\n" for n in range(20)), "has no logarithm"),
        ("1,2,3\n4,5,6\n", "no line that names its columns"),
    ],
)
def test_unusable_table_is_refused_in_one_line(tmp_path, capsys, text, message):
    """What is wrong, where, and the way out; exit code 1, no traceback."""
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    assert run(["log-fit", str(path)]) == 1
    printed = capsys.readouterr().err.strip()
    assert message in printed
    assert len(printed.splitlines()) == 1
