"""Tables of light engines: the drive law is fitted, and what is not proportional gets its name."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.flux.drive_law import fit_drive_law
from radiometer.cli.main import run

DRIVES = np.arange(1, 33) / 32


def _written(path, light):
    rows = [f"{name},{round(4095 * d)},{y:.9g}" for name, ys in light.items() for d, y in zip(DRIVES, ys, strict=True)]
    path.write_text("\n".join(["primary,setting,radiance", *rows, *(f"{name},0,0" for name in light)]) + "\n")
    return path


def _engine(rng, droop, noise=0.005):
    """Return three channels of different brightness, light = a·d·e^(−k·d), with relative noise."""
    return {
        name: size * DRIVES * np.exp(-droop * DRIVES) * (1.0 + noise * rng.standard_normal(DRIVES.size))
        for name, size in (("blue", 1.0), ("green", 0.4), ("red", 2.5))
    }


def _stepped(light, at, ratio):
    return {name: np.where(ys > at, ratio * ys, ys) for name, ys in light.items()}


@pytest.mark.parametrize("seed", [71, 72, 73])
def test_proportional_engine_agrees(seed, tmp_path):
    """Noise alone has no name, and its law is proportional within 3 u."""
    file = _written(tmp_path / "e.csv", _engine(np.random.default_rng(seed), 0.0))
    assert [one.name for one in rm.reconcile(file).result.effects] == []
    for law in rm.light_law(file).laws.values():
        half = law.parameters["deviation_at_half_drive"]
        assert abs(half.value) <= 3.0 * half.u


@pytest.mark.parametrize("seed", [74, 75, 76])
def test_saturating_channels_are_named_led_droop(seed, tmp_path):
    """A droop of 10 % at full drive is named alone; half drive is e^0.05 over proportional, within 3 u."""
    file = _written(tmp_path / "e.csv", _engine(np.random.default_rng(seed), 0.1))
    effects = rm.reconcile(file).result.effects
    assert [one.name for one in effects] == ["led_droop"]
    size = effects[0].parameters["deviation_at_half_drive"]
    assert abs(size.value - np.expm1(0.05)) <= 3.0 * size.u
    of_laws = [one.parameters["deviation_at_half_drive"] for one in rm.light_law(file).laws.values()]
    largest = max(of_laws, key=lambda one: one.value)
    assert (size.value, size.u) == pytest.approx((largest.value, largest.u))


@pytest.mark.parametrize("seed", [77, 78, 79])
def test_meter_that_changes_its_range_is_named(seed, tmp_path):
    """A jump of 3 % at one reading in all channels is the meter's; its ratio is found within 3 u, the reading too."""
    light = _stepped(_engine(np.random.default_rng(seed), 0.0), 0.3, 1.03)
    effects = rm.reconcile(_written(tmp_path / "e.csv", light)).result.effects
    assert [one.name for one in effects] == ["meter_range_step"]
    ratio, reading = (effects[0].parameters[name] for name in ("ratio", "reading"))
    assert abs(ratio.value - 1.03) <= 3.0 * ratio.u
    assert reading.value == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("seed", [82, 83, 84])
def test_onset_of_a_driver_is_fitted_and_leaves_the_droop_its_name(seed, tmp_path):
    """Light from 3 % of full drive on: the onset is within 3 u, half drive (0.47/0.97)·2·e^0.05 over proportional."""
    light = _engine(np.random.default_rng(seed), 0.1)
    light = {name: ys * np.maximum(DRIVES - 0.03, 0.0) / DRIVES for name, ys in light.items()}
    file = _written(tmp_path / "e.csv", light)
    for law in rm.light_law(file).laws.values():
        onset, half = (law.parameters[name] for name in ("onset", "deviation_at_half_drive"))
        assert abs(onset.value - 0.03) <= 3.0 * onset.u < 0.01
        assert abs(half.value - (0.47 / 0.97 * 2.0 * np.exp(0.05) - 1.0)) <= 3.0 * half.u
        assert law.misfit_rel < 0.008
    assert [one.name for one in rm.reconcile(file).result.effects] == ["led_droop"]


def test_the_law_s_uncertainty_holds_an_onset_that_noise_hides():
    """Light from 1 % of full drive on with 1 % of noise: light at 0.3 over that at 0.9 is within k = 2 in 91 of 100."""
    rng, drive, inside = np.random.default_rng(85), np.arange(1, 17) / 16, 0
    for _ in range(100):
        law = fit_drive_law(drive, (drive - 0.01) * (1.0 + 0.01 * rng.standard_normal(drive.size)))
        found = law.light_over(0.3, 0.9)
        inside += abs(found.value - 0.29 / 0.89) <= 2.0 * found.u
    assert inside >= 91
    moved = [replace(law, **{name: getattr(law, name) + 1e-7}) for name in ("exponent", "droop", "onset")]
    slope = np.array([one.light_over(0.3, 0.9).value - found.value for one in moved]) / 1e-7
    assert found.u == pytest.approx(np.sqrt(slope @ law.covariance @ slope), rel=1e-4)


def test_both_are_named(tmp_path):
    """A droop and a step in one table get both names, and drives held out are predicted better by each."""
    light = _stepped(_engine(np.random.default_rng(80), 0.15), 0.3, 1.04)
    result = rm.reconcile(_written(tmp_path / "e.csv", light)).result
    assert {one.name for one in result.effects} == {"led_droop", "meter_range_step"}
    assert result.gap_after < 2.0 < result.gap_before


def test_spectra_are_summed_and_twins_compared(tmp_path):
    """A table with a column for each wavelength gives the law of the sum; a twin of 8 % more at half drive is found."""
    files = []
    for name, droop in (("left", 0.0), ("right", 2 * np.log(1.08))):
        bands = np.exp(-(((np.arange(500, 560, 5) - 530) / 15) ** 2))
        rows = [["0", f"{round(1000 * d)}", *(f"{v:.8g}" for v in d * np.exp(-droop * d) * bands)] for d in DRIVES]
        header = ["Primary", "Setting", *map(str, range(500, 560, 5))]
        (tmp_path / f"{name}.csv").write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
        files.append(tmp_path / f"{name}.csv")
    more = rm.light_law(*files).differences["0"]
    assert more.value == pytest.approx(0.08, abs=0.002 + 3 * more.u)


@pytest.mark.parametrize(("light", "says"), [(-0.7, "no light is below 0"), (0.0, None)])
def test_a_row_that_no_law_can_hold_is_refused_or_named(tmp_path, light, says):
    """A negative light is a mistake; a drive without light is left out, and stands in what was taken."""
    rows = "".join(f"blue,{10 * n},{light if n == 7 else 0.1 * n:.4f}\n" for n in range(1, 12))
    (tmp_path / "e.csv").write_text(f"channel,drive,light\n{rows}")
    if says is None:
        assert "blue: no light at drive 70: left out" in rm.light_law(tmp_path / "e.csv").table.taken
    else:
        with pytest.raises(rm.InputError, match=says):
            rm.light_law(tmp_path / "e.csv")


def test_commands_speak_json_and_write_a_page(tmp_path, capsys):
    """`light law --json` holds the law with u, `--plot` draws it; `reconcile` writes its report."""
    file = _written(tmp_path / "e.csv", _engine(np.random.default_rng(81), 0.1))
    assert run(["light", "law", str(file), "--json", "--plot", str(tmp_path / "law.png")]) == 0
    assert (tmp_path / "law.png").stat().st_size > 1000
    law = json.loads(capsys.readouterr().out)["channels"]["blue"]["drive_law"]
    assert law["droop"]["u"] > 0
    assert run(["reconcile", str(file), "--report", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text()
    assert "led_droop" in page
    assert "The missing effect was found" in page
    assert "effects_found" not in page  # a word for programs


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("primary,colour\n0,red\n1,blue\n", "needs a drive"),
        ("setting,radiance\n1,0.1\n2,x\n3,0.3\n", "line 3"),
        ("setting,radiance\n1,0.1\n2,0.2\n3,0.3\n", "drives above 0"),
        ("setting,radiance\n-1,0.1\n2,0.2\n3,0.3\n", "expected 0 and above"),
    ],
)
def test_unusable_table_is_refused_in_one_line(text, words, tmp_path, capsys):
    """The message names what is missing, with the line where one is wrong."""
    (tmp_path / "e.csv").write_text(text)
    assert run(["light", "law", str(tmp_path / "e.csv")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error:")
    assert words in error


@pytest.fixture(scope="module")
def diode(tmp_path_factory):
    """Return a capture of a diode of 0.05 mW at full drive."""
    folder = tmp_path_factory.mktemp("diode")
    bench = folder / "diode.yaml"
    bench.write_text(
        "format: radiometer-bench/1\n"
        'camera: {kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", width: 80, height: 60}\n'
        "lens: {focal_length_mm: 16, f_number: 4, magnification: 0.05}\n"
        "scene: {kind: led, flux_mW: 0.05, emitter_diameter_mm: 3, half_angle_deg: 60, diameter_px: 33}\n"
    )
    ladder = ["--from", "100us", "--to", "12.8ms", "--stops", "1", "--darks", "1"]
    assert run(["bracket", str(folder / "capture"), "--bench", str(bench), *ladder]) == 0
    return folder / "capture"


CALIBRATION = Path(__file__).parents[3] / "configs" / "calibrations" / "simulated.yaml"


def test_flux_at_another_drive_is_that_of_the_law_within_its_uncertainty(diode, tmp_path):
    """Of a droop of 10 %, a quarter of full drive has e^0.075/4 of the flux; 15 tables with 0.5 % noise hold it."""
    share, off = np.exp(0.1 * (1.0 - 1024 / 4095)) * 1024 / 4095, []
    for seed in range(1_500_001, 1_500_016):
        table = _written(tmp_path / "e.csv", _engine(np.random.default_rng(seed), 0.1))
        found = rm.flux(
            diode, calibration=CALIBRATION, half_angle=60, distance=336, drive_table=table, led="blue", drive=4095,
            at_drive=1024,
        )  # fmt: skip
        one, own, law = found.driven.flux, found.result, found.driven.law
        u_rel = np.sqrt(one.u_rel**2 - own.u_rel**2)  # of the ratio: of the law and of its misfit at both drives
        assert u_rel >= np.sqrt(2.0) * law.misfit_rel * (1.0 - 1e-9)
        off.append(one.value / own.value / share - 1.0)
        assert abs(one.value - share * 0.05e-3) <= 3.0 * one.u
        assert abs(off[-1]) <= 3.0 * u_rel
    assert np.std(off) < 0.005


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--led", "blue", "--drive", "4095", "--at-drive", "5000"], "holds from"),
        (["--led", "blue", "--drive", "100", "--at-drive", "4095"], "holds from"),
        (["--drive", "4095", "--at-drive", "1024"], "blue, green, red"),
        (["--led", "blue", "--drive", "4095"], "--at-drive"),
    ],
)
def test_a_drive_that_the_table_does_not_hold_is_refused(words, message, diode, tmp_path, capsys):
    """Drives outside the table, a channel or a drive left open: exit code 2 and the way out."""
    table = _written(tmp_path / "e.csv", _engine(np.random.default_rng(81), 0.1))
    assert run(["flux", str(diode), "--calibration", str(CALIBRATION), "--drive-table", str(table), *words]) == 2
    assert message in capsys.readouterr().err
