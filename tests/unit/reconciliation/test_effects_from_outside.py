"""Effects that a laboratory keeps for itself: installed as a package or given as a file, and found like any other."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from radiometer.errors import ConfigurationError
from radiometer.reconciliation.engine import whole_catalogue
from simulators.effects.registry import EFFECTS, all_effects, register_file
from testing import effects_of_a_laboratory
from testing.reconciled import reconcile

EFFECTS_OF_A_LABORATORY = Path(effects_of_a_laboratory.__file__).read_text(encoding="utf-8")
NAMES = ("lamp_driver_noise", "display_ceiling", "driver_steps")


def install(site, text):
    """Install a package of three effects: one that acts by its square, one that saturates, one that steps."""
    (site / "cellar_bench.py").write_text(text, encoding="utf-8")
    about = site / "cellar_bench-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: cellar-bench\nVersion: 1.0\n", encoding="utf-8")
    classes = ("LampDriverNoise", "DisplayCeiling", "DriverSteps")
    lines = (f"{name} = cellar_bench:{kind}\n" for name, kind in zip(NAMES, classes, strict=True))
    (about / "entry_points.txt").write_text("[radiometer.effects]\n" + "".join(lines), encoding="utf-8")


@pytest.fixture
def untouched():
    """Put the table of effects back as it was."""
    held = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(held)
    for module in [name for name in sys.modules if name.startswith("_effects_of_")]:
        del sys.modules[module]


def _noisy(setting):
    key = [int(1e9 * setting["t"]), int(1e3 * setting["d"]), next(_DRAWN)]
    drive = setting["d"] * (setting["shutter"] == "open")  # the lamp is off for darks
    return 2.0 * drive * np.random.default_rng(key).standard_normal((64, 96))


_DRAWN = iter(range(10_000))
# Entries of the table that come nearest: noise, what saturates, and what goes with the drive.
RIVALS = ("excess_read_noise", "full_well_saturation", "adc_saturation", "led_thermal_droop", "exposure_time_offset")
HIDDEN = {
    "lamp_driver_noise": ({"extra_dn": _noisy}, "amplitude_dn", 2.0),
    "display_ceiling": ({"picture": lambda i, s: np.minimum(i * s["d"], 0.6) / max(s["d"], 1e-9)}, "ceiling", 0.6),
    "driver_steps": ({"picture": lambda i, s: i * (0.08 * int(s["d"] / 0.08) / max(s["d"], 1e-9))}, "step", 0.08),
}


@pytest.mark.slow
@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize("name", NAMES)
def test_own_effect_is_found_where_it_is_hidden(make_capture, tmp_path, name):
    """A squared, a saturating and a stepwise effect of a file are named alone, of the size that was hidden."""
    (tmp_path / "cellar.py").write_text(EFFECTS_OF_A_LABORATORY, encoding="utf-8")
    register_file(tmp_path / "cellar.py")
    hooks, parameter, hidden = HIDDEN[name]
    captured = make_capture(seed=42, **hooks)
    entries = {one: whole_catalogue()[one] for one in (*NAMES, *RIVALS)}
    result = reconcile(captured.header, captured.frames, catalogue=entries)
    assert (result.verdict, [effect.name for effect in result.effects]) == ("effects_found", [name])
    found = result.effects[0].parameters[parameter]
    assert found.value == pytest.approx(hidden, abs=max(4.0 * (found.u or 0.0), 1e-9))
    limit = result.limits[name].amplitude
    assert limit < hidden if name == "lamp_driver_noise" else limit >= 0.95 * hidden


@pytest.mark.slow  # a process each: a package is installed before a program starts
@pytest.mark.parametrize(
    ("text", "printed"),
    [(EFFECTS_OF_A_LABORATORY, "step=0.1"), ("import nothing_of_the_kind\n", "repair or uninstall its package")],
)
def test_effects_of_an_installed_package_are_known_by_name(tmp_path, text, printed):
    """They are made with parameters like those of the table; a package that cannot be loaded is refused."""
    install(tmp_path, text)
    program = "from simulators.effects.registry import make_effect as make; print(make('driver_steps', {'step': 0.1}))"
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", ""), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert printed in done.stdout + done.stderr


@pytest.mark.usefixtures("untouched")
def test_file_is_taken_and_is_next_to_the_others(tmp_path):
    """Its classes are known by name; the same file again changes nothing; a foreign name is refused with a way out."""
    path, taken = tmp_path / "own.py", tmp_path / "taken.py"
    path.write_text(EFFECTS_OF_A_LABORATORY, encoding="utf-8")
    taken.write_text(EFFECTS_OF_A_LABORATORY.replace('"driver_steps"', '"dsnu"'), encoding="utf-8")
    for _ in range(2):
        assert register_file(path) == NAMES
        assert set(NAMES) <= set(all_effects())
    for name in NAMES:
        del EFFECTS[name]
    with pytest.raises(ConfigurationError, match=r"an effect 'dsnu' already; give yours another name"):
        register_file(taken)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import nothing_of_the_kind\n", "cannot be run: ModuleNotFoundError"),
        ("x = 1\n", "defines no effect"),
        (EFFECTS_OF_A_LABORATORY.replace('    where = "patch_level"\n', ""), "does not say its where"),
        (
            EFFECTS_OF_A_LABORATORY.replace('where = "patch_level"', 'where = "nowhere"'),
            "its where is 'nowhere'; possible",
        ),
        (EFFECTS_OF_A_LABORATORY.replace('"driver_steps"', '"../x y"'), "its name may hold"),
        (EFFECTS_OF_A_LABORATORY.replace('trials = ({"amplitude_dn": 1.0},)', "trials = ()"), "its trials are empty"),
        (
            EFFECTS_OF_A_LABORATORY.replace('fitted = ("amplitude_dn",)', 'fitted = ("amp",)'),
            "name 'amp', which is none",
        ),
        ("raise SystemExit(0)", "cannot be run: SystemExit"),
    ],
)
@pytest.mark.usefixtures("untouched")
def test_file_that_cannot_be_taken_is_reported_in_one_line(tmp_path, text, message):
    """What is wrong with it stands behind its name."""
    path = tmp_path / "broken.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=f"broken.py: .*{message}"):
        register_file(path)


FAULTS = {
    "an error": ('raise RuntimeError("boom")', "`factor` of effect 'driver_steps' fails: RuntimeError: boom"),
    "another shape": ("return np.ones(7)", r"`factor` .* an array of shape \(7,\)"),
    "an end": ("raise SystemExit", "`factor` of effect 'driver_steps' fails: SystemExit"),
    "a complex number": ("return 1.0 + 1.0j", "`factor` of effect 'driver_steps' gives numbers that are complex"),
    "NaN": ("return np.nan", "`factor` of effect 'driver_steps' gives numbers that are complex, NaN or infinite"),
    "no number": ('return "many"', "`(mean|slope)` of effect 'driver_steps' fails"),
}


@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize(("body", "message"), FAULTS.values(), ids=FAULTS)
def test_faults_of_an_effect_name_its_file(make_capture, tmp_path, body, message):
    """The user's own code is at fault, whatever it does: the line names file, method and effect."""
    head, _, _ = EFFECTS_OF_A_LABORATORY.rpartition("        drive = ")
    path = tmp_path / "faulty.py"
    path.write_text(f"{head}        {body}\n", encoding="utf-8")
    register_file(path)
    captured = make_capture(seed=42, frames=2, plan=[{"t": t, "d": d} for t in (1e-3, 3e-3) for d in (0.3, 0.9)])
    with pytest.raises(ConfigurationError, match=f"faulty.py: {message}"):
        reconcile(captured.header, captured.frames)


@pytest.mark.parametrize(
    ("name", "message"), [("gone.py", "does not exist"), ("law.txt", "is no Python"), ("folder.py", "is no Python")]
)
def test_a_file_that_cannot_hold_effects_is_refused_for_what_it_is(tmp_path, name, message):
    """One that is not there is not called no Python file."""
    (tmp_path / "law.txt").write_text("", encoding="utf-8")
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(ConfigurationError, match=f"{name}:? {message}"):
        register_file(tmp_path / name)
