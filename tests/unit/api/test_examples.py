"""The examples of all public names run as they stand, and so do those of the Python page."""

import dataclasses
import doctest
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import radiometer as rm
from radiometer.bench.cameras import open_camera
from radiometer.bench.config import read_bench
from radiometer.data import Flag, Quantity
from radiometer.errors import UsageError


def vars_of_all() -> list[tuple[str, object]]:
    """Return every public name with what it names."""
    return [(name, getattr(rm, name)) for name in rm.__all__]


# Served until they are stopped; each has tests of its own.
SERVERS = {"serve", "simulate_box", "simulate_camera"}
# Returned by functions whose examples show them.
SHOWN_BY_FUNCTIONS = {
    name for name, kind in vars_of_all() if dataclasses.is_dataclass(kind) and ">>>" not in (kind.__doc__ or "")
}
ERRORS = {name for name, kind in vars_of_all() if isinstance(kind, type) and issubclass(kind, Exception)}


# Searches, each as long as twenty others: how they are called is tried in `test_argument_types.py`.
SEARCHES = {"Separability", "reconcile_plan"}
EXAMPLES = sorted(set(rm.__all__) - SERVERS - SHOWN_BY_FUNCTIONS - ERRORS)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.long) if one in SEARCHES else one for one in EXAMPLES]
)
def test_the_example_of_a_public_name_runs_as_it_stands(name, desk, monkeypatch):
    """Every public name has an example, and the example prints what it says."""
    monkeypatch.chdir(desk)
    kind = getattr(rm, name)
    namespace = {}
    (example,) = doctest.DocTestFinder(recurse=False).find(kind, name, globs=namespace)
    assert example.examples, f"radiometer.{name} has no example"
    reported: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False)
    assert runner.run(example, out=reported.append).failed == 0, "".join(reported)


@pytest.mark.slow
def test_the_python_page_runs_as_it_stands(desk, monkeypatch, project_root):
    """The blocks of docs/reference/python-guide.md run in order where its files are; nothing in it is a sketch."""
    monkeypatch.chdir(desk)
    text = (project_root / "docs" / "reference" / "python-guide.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) >= 3
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/reference/python-guide.md", "exec"), namespace)
    assert namespace["absolute"].unit == "W sr-1 m-2"
    assert namespace["found"].verdict == "effects_found"


@pytest.mark.slow
def test_every_object_shows_itself_in_a_picture(desk, monkeypatch):
    """Reading, bracket, response, map, sensor and result: HTML with a picture, and a plot on given axes."""
    monkeypatch.chdir(desk)
    stack = rm.read("out/chart")
    shown = [
        rm.measure(bench="bench.yaml"), stack, rm.recover_response(stack, "linear_spline"), rm.merge(stack),
        rm.characterise("out/chart"), rm.reconcile("meter.csv"),
    ]  # fmt: skip
    for one in shown:
        assert len(repr(one)) < 200
        assert one._repr_html_().startswith('<figure><img alt="')
        assert "data:image/png;base64," in one._repr_html_()
        axes = Figure().subplots()
        assert one.plot(axes) is axes
        assert axes.has_data()


def test_figures_are_printed_with_two_digits_of_their_uncertainty(desk, monkeypatch):
    """A reading at the same place; a sensor's table to the last digit."""
    reading = rm.Reading(
        radiance=Quantity(0.326512, 0.00164, "W sr-1 m-2"),
        patch=rm.Patch(840, 240, 120, 120),
        instrument="22500001",
        flags=(Flag.DRIFT,),
    )
    assert str(reading) == "0.3265 ± 0.0033 W·sr⁻¹·m⁻² (k = 2) [drift]"
    assert repr(reading) == f"<Reading {reading}, patch 840,240 120 × 120 of 22500001>"
    monkeypatch.chdir(desk)
    sensor = rm.characterise("out/chart")
    sensor.to_csv("figures.csv")
    lines = Path("figures.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "symbol,value,u,unit"
    table = {line.split(",")[0]: line.split(",")[1:] for line in lines[1:]}
    black = sensor["mu_y_dark"]
    assert table["mu_y_dark"] == [repr(black.value), repr(black.u), "DN"]
    with pytest.raises(UsageError, match=r"must end in \.csv"):
        sensor.to_csv("figures.txt")


def test_open_takes_a_bench_file_the_word_sim_a_serial_number_or_nothing(desk, monkeypatch):
    """Each but the number is the simulated camera; what is known of the bench differs.

    A serial number goes to the search for cameras on the wire, and nothing of any bench is taken along.
    """
    monkeypatch.chdir(desk)
    for source in ("bench.yaml", "sim", None):
        with rm.open(source) as meter:
            assert meter.instrument.camera.identity.serial == "22500001"
            assert (meter.instrument.camera.capabilities.width == 96) == (source == "bench.yaml")
    asked = []

    def opened(config, *_rest):
        asked.append((config.camera.kind, config.camera.id, config.lens))
        return open_camera(*read_bench(Path("bench.yaml")))

    monkeypatch.setattr("radiometer.bench.assembly.open_camera", opened)
    with rm.open("22500001", uncalibrated=True) as meter:
        assert meter.calibration is None
    assert asked[0][:2] == ("genicam", "22500001")
