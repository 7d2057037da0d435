"""The wheel works from anywhere: built, installed into a folder of its own, run from another one."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from testing.patience import within

pytestmark = pytest.mark.slow

LARGEST_BYTES = 2_200_000


@pytest.fixture(scope="module")
def wheel(project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel, built without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(words, cwd=project_root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("radiometer-*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that the wheel alone was installed into."""
    folder = tmp_path_factory.mktemp("site")
    words = ["pip", "install", "-q", "--no-deps", "--no-index", "--target", str(folder), str(wheel)]
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_wheel_is_small_and_holds_what_it_needs(wheel):
    """At most 2 MB, with the shipped benches, the manual page, and neither tests nor documentation."""
    assert wheel.stat().st_size <= LARGEST_BYTES
    names = zipfile.ZipFile(wheel).namelist()
    assert "radiometer/_configs/bench-simulated.yaml" in names
    assert any(name.endswith(".data/data/share/man/man1/radiometer.1") for name in names)
    assert any(name.startswith("drivers/firmware/") for name in names)
    assert not any(name.startswith(("tests/", "docs/", "benchmarks/")) for name in names)


def test_the_installed_program_measures_from_any_folder(installed, tmp_path):
    """`radiometer measure` of the wheel, in an empty folder, reads the simulated patch: what `pipx run` does."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    env |= {"PYTHONPATH": str(installed), "HOME": str(tmp_path)}
    words = [sys.executable, str(installed / "bin" / "radiometer"), "measure", "--json"]
    done = subprocess.run(
        words, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=within(300)
    )
    assert done.returncode == 0, done.stderr
    reading = json.loads(done.stdout)["radiance"]
    assert reading["unit"] == "W sr-1 m-2"
    assert abs(reading["value"] - 1.5 * 0.5**2.2) < 4 * reading["u"]
    where = [sys.executable, "-c", "import radiometer, drivers, simulators; print(radiometer.__file__)"]
    assert subprocess.run(where, cwd=tmp_path, env=env, capture_output=True, text=True, check=True).stdout.startswith(
        str(installed)
    )
