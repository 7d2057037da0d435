"""Bluesky plans over the simulated light box and a simulated motor: radiance ± u in the documents."""

from contextlib import ExitStack

import bluesky.plans as bp
import pytest
from bluesky import RunEngine
from bluesky.utils import FailedStatus
from ophyd_async.core import init_devices
from ophyd_async.sim import SimMotor

import radiometer as rm
from radiometer.adapters.bluesky import LightBoxLevel, RadiometerDetector, open_light_bench
from radiometer.adapters.readings import MeterSource
from radiometer.analysis.photometry.spectral_correction import spectral_factor
from radiometer.api.meter import Meter
from radiometer.bench.boxes import open_light_box
from radiometer.bench.light_bench import open_light_camera
from radiometer.data import Patch, Quantity, Reading
from radiometer.errors import DeviceError, UsageError
from testing.daemon_process import write_small_bench


class Told:
    """A source whose readings are reported beforehand."""

    origin = "radiometer:stated"

    def __init__(self, *readings):
        self._readings = list(readings)

    def measure(self):
        first = self._readings.pop(0)
        if isinstance(first, Exception):
            raise first
        return first


def _reading(value, luminance=None, unit="W sr-1 m-2"):
    return Reading(Quantity(value, 0.01 * value, unit), Patch(0, 0, 4, 4), "stated", luminance)


@pytest.fixture(scope="module")
def engine():
    """Return a run engine."""
    return RunEngine({})


def _run(engine, plan):
    documents = []
    engine(plan, lambda name, document: documents.append((name, document)))
    keys = next(document["data_keys"] for name, document in documents if name == "descriptor")
    return keys, [document["data"] for name, document in documents if name == "event"]


def test_scan_of_the_light_boxs_level_reads_its_radiance(engine):
    """Each of four levels reads what the box's LED emits, within four times the stated uncertainty."""
    with open_light_box("sim") as opened, open_light_camera(opened, None, None, None, None) as instrument:
        optics = opened.config.optics["spot"]
        # The camera's calibration is for light of 550 nm, the spot is blue: a reading times this is its radiance.
        factor = spectral_factor(instrument.calibration.spectrum, optics.peak_nm, optics.fwhm_nm, None)
        with pytest.raises(UsageError, match="spot_green"):  # of those that the box has
            LightBoxLevel(opened.box, "lamp")
        level = LightBoxLevel(opened.box, "spot", "level")
        emitted = []

        class Watched(RadiometerDetector):
            def _keep(self, reading):
                emitted.append(opened.twin.emission("spot", opened.twin.time_s).radiance_w_sr_m2)
                super()._keep(reading)

        detector = Watched(MeterSource(Meter(instrument, ExitStack())), "radiometer")
        keys, events = _run(engine, bp.scan([detector], level, 500, 8000, 4))
    assert [event["level"] for event in events] == [500, 3000, 5500, 8000]
    for event, true in zip(events, emitted, strict=True):
        assert abs(event["radiometer-radiance"] * factor - true) < 4 * event["radiometer-u_radiance"]
        assert 0 < event["radiometer-u_radiance"] < 0.02 * true
    assert events[-1]["radiometer-radiance"] > 15 * events[0]["radiometer-radiance"]
    assert keys["radiometer-radiance"]["units"] == keys["radiometer-u_radiance"]["units"] == "W sr-1 m-2"
    assert keys["radiometer-luminance"]["units"] == "cd m-2"
    assert keys["radiometer-radiance"]["dtype"] == "number"
    assert keys["radiometer-radiance"]["source"] == "radiometer:22500001/radiance"


def test_light_bench_opens_both_devices(engine):
    """The bench of the documentation: a detector and a level that a plan moves."""
    with open_light_bench() as (detector, level):
        _, events = _run(engine, bp.scan([detector], level, 1000, 4000, 2))
    assert events[1]["radiometer-radiance"] == pytest.approx(4 * events[0]["radiometer-radiance"], rel=0.03)


@pytest.mark.slow
def test_scan_over_a_motor_and_count_read_the_meters_patch(engine, tmp_path):
    """The still scene reads the same at each place of a motor; the patch is the source's, not the bench's."""
    with rm.open(write_small_bench(tmp_path)) as meter:
        whole, dim = meter.measure(), meter.measure((95, 30, 20, 20))
        with init_devices():
            motor = SimMotor(instant=True)
            detector = RadiometerDetector(MeterSource(meter, Patch(95, 30, 20, 20)))
        _, events = _run(engine, bp.scan([detector], motor, -1, 1, 2))
        _, counted = _run(engine, bp.count([detector], num=1))
    assert [event["motor"] for event in events] == [-1, 1]
    for event in (*events, *counted):
        assert abs(event["detector-radiance"] - dim.radiance.value) < 4 * dim.radiance.u
    assert abs(whole.radiance.value - dim.radiance.value) > 10 * dim.radiance.u


def test_documents_hold_what_the_reading_says(engine):
    """Value, u, luminance, U and flags; a luminance that is not known is no number."""
    lit = Reading(
        Quantity(2.0, 0.1, "W sr-1 m-2"), Patch(0, 0, 4, 4), "stated", Quantity(900.0, 45.0, "cd m-2"),
        (rm.data.reading.Flag.FLICKER, rm.data.reading.Flag.SATURATED), coverage_factor=2.5,
    )  # fmt: skip
    detector = RadiometerDetector(Told(lit, _reading(1.0)), "r")
    _, (first, second) = _run(engine, bp.count([detector], num=2))
    assert (first["r-radiance"], first["r-u_radiance"]) == (2.0, 0.1)
    assert (first["r-luminance"], first["r-u_luminance"]) == (900.0, 45.0)
    assert first["r-expanded_u_rel"] == pytest.approx(2.5 * 0.05)
    assert first["r-flags"] == "flicker,saturated"
    assert second["r-luminance"] != second["r-luminance"]
    assert second["r-flags"] == ""


def test_units_are_never_mixed(engine):
    """Relative readings are refused under W sr-1 m-2 and taken as such; a camera that is lost ends the plan."""
    with pytest.raises(FailedStatus) as refused:
        _run(engine, bp.count([RadiometerDetector(Told(_reading(1.0, unit="relative")), "r")]))
    assert "unit='relative'" in str(refused.value.__cause__ or refused.value)
    detector = RadiometerDetector(Told(_reading(1.0, unit="relative")), "r", unit="relative")
    keys, _ = _run(engine, bp.count([detector]))
    assert keys["r-radiance"]["units"] == "relative"
    with pytest.raises(UsageError, match="'W sr-1 m-2', or 'relative'"):
        RadiometerDetector(Told(), "r", unit="nits")
    with pytest.raises(FailedStatus):
        _run(engine, bp.count([RadiometerDetector(Told(DeviceError("camera lost")), "r")]))


def test_example_of_the_documentation_runs(project_root, capsys):
    """The first example of docs/reference/interoperability.md prints level, radiance and u of four readings, rising."""
    page = (project_root / "docs" / "reference" / "interoperability.md").read_text(encoding="utf-8")
    example = page.split("```python\n", 1)[1].split("```", 1)[0]
    exec(compile(example, "docs/reference/interoperability.md", "exec"), {})
    rows = [[float(cell) for cell in line.split()] for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == [500, 1667, 2833, 4000]
    assert [row[1] for row in rows] == sorted(row[1] for row in rows)
    assert all(0 < u < 0.02 * value for _, value, u in rows)
