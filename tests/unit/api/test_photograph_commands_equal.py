"""`--json` and functions give the same numbers, bit for bit: merge, response, calibrate, flux, measure, reconcile."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.photometry.photometry import luminous_efficacy_lm_per_w
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from tests.unit.api.test_commands import Case, assert_the_same_numbers
from tests.unit.api.test_dark_frames import CAMERA, LENS, calibration
from tests.unit.photographs.test_one_path import TIMES_S, photographs, scene

PATCH = (20, 12, 16, 16)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of photographs, of colour photographs, a capture set with dark frames, and calibrations."""
    from radiometer.data import CaptureSetWriter, Frame, FrameSettings, SourceDescription

    folder = tmp_path_factory.mktemp("desk")
    light = scene()
    photographs(folder / "grey", light)
    photographs(folder / "colour", light, colours=(0.7, 1.0, 0.8), times_s=TIMES_S[::2])
    photographs(folder / "even", np.full((40, 60), 0.5), times_s=(2.0**-8, 2.0**-7, 2.0**-6))
    rng = np.random.default_rng(2)
    with CaptureSetWriter(folder / "set", CAMERA, LENS, source=SourceDescription(wavelength_nm=550.0)) as writer:
        for shutter, level in (("closed", 0.0), ("open", 6000.0)):
            for time_s in (0.125, 0.25, 0.5):
                dn = rng.normal(500.0 + level * time_s, 3.0, (40, 56))
                settings = FrameSettings(time_s, black_level_dn=500.0, shutter=shutter)
                writer.add(Frame(np.rint(dn).astype(np.uint16), 12, settings))
    known = calibration()
    steady = known.uncertainties.model_copy(update={"drift_u_rel_per_year": 0.0})  # two calls differ in its age
    replace(known, uncertainties=steady).write(folder / "cal.yaml")
    return folder


def case(words: str, call: Callable[[], Any]) -> Case:
    return Case(
        f"{words} --json", lambda _: call(), apart=frozenset({"files", "calibration", "responses", "model", "report"})
    )


CASES = (
    case("merge colour -o {out}/a.exr", lambda: rm.merge("colour")),
    case("merge colour -o {out}/a.exr", lambda: rm.merge(rm.read_photographs("colour"))),
    case(
        "merge set --calibration cal.yaml --luminance -o {out}/a.exr",
        lambda: rm.merge("set", calibration="cal.yaml", luminance=True),
    ),
    case("merge set --calibration cal.yaml -o {out}/a.exr", lambda: rm.merge(rm.read("set"), calibration="cal.yaml")),
    case("response colour --channel each", lambda: rm.recover_response(rm.read_photographs("colour"))),
    case("response grey --method debevec1997", lambda: rm.recover_response("grey", "debevec1997")),
    case(
        "calibrate set --patch 20,12,16,16 --radiance 1 --u-rel 0.01 -o {out}/own.yaml",
        lambda: rm.calibrate("set", patch=PATCH, radiance=1.0, u_rel=0.01),
    ),
    case(
        "calibrate even --patch 8,8,30,20 --luminance 90 --u-rel 0.01 -o {out}/own.yaml",
        lambda: rm.calibrate("even", patch=(8, 8, 30, 20), luminance=90.0, u_rel=0.01),
    ),
    case("flux set --patch 2,2,52,36", lambda: rm.flux("set", patch=(2, 2, 52, 36))),
    case(
        "measure --photographs grey --uncalibrated --patch 20,12,16,16 --monte-carlo",
        lambda: rm.measure_photographs("grey", PATCH, uncalibrated=True, monte_carlo=True),
    ),
    case(
        "measure --photographs set --calibration cal.yaml --patch 20,12,16,16",
        lambda: rm.measure_photographs("set", PATCH, calibration="cal.yaml"),
    ),
    case("reconcile grey", lambda: rm.reconcile(rm.read_photographs("grey"))),
    case("reconcile set", lambda: rm.reconcile("set")),
    case("reconcile set --plan-only", lambda: rm.reconcile_plan("set")),
)
SEARCH = "--plan-only"  # takes as long as all others together


@pytest.mark.parametrize(
    "case", [pytest.param(one, marks=[pytest.mark.long] * (SEARCH in one.words), id=one.words[:50]) for one in CASES]
)
def test_the_command_prints_what_the_function_returns(case, desk, tmp_path, monkeypatch, capsys):
    """Every key and every number; then the result prints in one line and as HTML."""
    monkeypatch.chdir(desk)
    assert_the_same_numbers(case, tmp_path, capsys)


@pytest.mark.parametrize("source", ["set", "stack"])
@pytest.mark.parametrize("spectrum", [None, "line:550.0", "white_led"])
def test_luminance_of_maps_and_readings_is_of_the_stated_wavelength(desk: Path, source: str, spectrum: str | None):
    """K of 550 nm is 679.7 lm/W (CIE 018). A spectrum that contradicts the capture counts, and both are named."""
    capture = rm.read(desk / "set") if source == "stack" else desk / "set"
    maps = rm.merge(capture, calibration=calibration(), luminance=True, spectrum=spectrum)
    radiance = rm.merge(capture, calibration=calibration()).value
    reading = rm.measure_photographs(desk / "set", PATCH, calibration=calibration(), spectrum=spectrum)
    analysed = rm.analyse(rm.merge(capture, calibration=calibration()), spectrum=spectrum)
    scaled = rm.calibrate(desk / "set", patch=PATCH, luminance=100.0, u_rel=0.02, spectrum=spectrum).calibration
    expected = 679.7 if spectrum != "white_led" else luminous_efficacy_lm_per_w(spectrum_of("white_led"))
    assert np.median(maps.value / radiance) == pytest.approx(expected, rel=1e-3)
    assert reading.luminance.value / reading.radiance.value == pytest.approx(expected, rel=1e-3)
    assert reading.luminance.u_rel == pytest.approx(reading.radiance.u_rel, rel=0.02) or spectrum == "white_led"
    for assumptions in (
        reading.more["assumptions"], maps.map.provenance.assumptions, analysed.assumptions,
        scaled.provenance.assumptions,
    ):  # fmt: skip
        assert any("states line:550" in text for text in assumptions) == (spectrum == "white_led")
