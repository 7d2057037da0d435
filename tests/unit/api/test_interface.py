"""The Python interface, as a notebook uses it, and the names that `import radiometer` offers."""

import ast
import importlib
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiometer as rm
from drivers.cameras.aravis_camera import load_library
from radiometer.data import Calibration, CaptureSetWriter
from radiometer.data.storage import shipped_config
from radiometer.devices.exposure_account import NO_EYE
from radiometer.errors import CalibrationError, CaptureError, DeviceLost, MissingLibrary, UsageError

BENCH = """\
format: radiometer-bench/1
camera: {kind: simulated, preset: BFS-U3-19S4M, serial: "22500001", seed: 5, width: 96, height: 64}
lens: {focal_length_mm: 16, f_number: 4}
scene: {kind: uniform, radiance_W_per_sr_m2: 0.3}
patch: {x: 40, y: 24, width: 16, height: 16}
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bench file of a small camera before an even field."""
    path = tmp_path_factory.mktemp("bench") / "bench.yaml"
    path.write_text(BENCH, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def stack(bench: Path) -> rm.Stack:
    """Return a bracket of the whole frame, with dark frames."""
    with rm.open(bench, uncalibrated=True) as meter:
        return meter.bracket(darks=2)


@pytest.fixture(scope="module")
def capture(stack: rm.Stack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the same frames as a capture set on disk."""
    folder = tmp_path_factory.mktemp("capture") / "even"
    with CaptureSetWriter(folder, stack.camera, stack.lens, None, ()) as writer:
        for frame in (*stack.bracket.light, *stack.bracket.dark):
            writer.add(frame)
    return folder


def test_a_meter_reads_a_patch_and_says_what_it_is(bench):
    """Two patches of an even field agree within their uncertainties; the meter's line names camera and patch."""
    with rm.open(bench, uncalibrated=True) as meter:
        first, second = meter.measure(), meter.measure(patch=(4, 4, 12, 12))
        assert "BFS-U3-19S4M" in repr(meter)
        assert "uncalibrated" in repr(meter)
    meter.close()  # again: does nothing, and the camera is free for the next
    with rm.open(bench, uncalibrated=True) as again:
        assert again.calibration is None
    gap = first.radiance.value - second.radiance.value
    assert abs(gap) < 4 * np.hypot(first.radiance.u, second.radiance.u)
    assert second.patch == rm.Patch(4, 4, 12, 12)


@pytest.mark.parametrize("stated", ["1", None])
def test_a_camera_that_bins_is_not_read_as_one_that_does_not(stated, tmp_path):
    """Refused by a calibration of unbinned pixels, for readings and maps; named where the calibration says nothing."""
    known, path, patch = (
        Calibration.read(shipped_config("calibrations/simulated.yaml")),
        tmp_path / "cal.yaml",
        (8,) * 4,
    )
    replace(known, camera=known.camera.model_copy(update={"binning": stated})).write(path)
    lens = "f_number: 4, transmittance: 0.95, transmittance_u_rel: 0.01}"
    (tmp_path / "bench.yaml").write_text(BENCH.replace("f_number: 4}", lens), encoding="utf-8")
    with rm.open(tmp_path / "bench.yaml", calibration=path) as meter:
        first, camera = meter.measure(patch), meter.instrument.camera
        assert abs(first.radiance.value - 0.3) < 3 * first.radiance.u
        assert not any("binning" in line for line in first.more["assumptions"])
        camera.configure(replace(camera.settings, binning=2))
        stack = meter.bracket(patch)
        if stated:
            for ask in (lambda: meter.measure(patch), lambda: rm.merge(stack, calibration=path)):
                with pytest.raises(CalibrationError, match="holds for binning 1, the frames were taken with 2"):
                    ask()
            return
        for assumed in (meter.measure(patch).more["assumptions"], rm.merge(stack, calibration=path).assumptions):
            assert any(line.startswith("binning 2 at calibration too") for line in assumed)
        for ask in (meter.measure, lambda: meter.bracket((40, 0, 20, 20))):
            with pytest.raises(UsageError, match="leaves the frame of 48 × 32 pixels"):
                ask()


def test_threads_that_share_a_meter_take_turns():
    """Each gets the reading of its own patch, of a camera behind the GenICam library too."""
    try:
        load_library()
    except MissingLibrary as error:
        pytest.skip(str(error))
    patches = [(4, 4, 16, 16), (64, 64, 16, 16)]
    with rm.open("Fake_1", uncalibrated=True) as meter, ThreadPoolExecutor(2) as threads:
        readings = list(threads.map(meter.measure, patches))
    assert [reading.patch for reading in readings] == [rm.Patch(*patch) for patch in patches]
    assert all(reading.radiance.value > 0 for reading in readings)


def test_a_bracket_is_one_channel_as_it_was_taken(stack, capture):
    """Two dark frames per exposure, camera and lens from disk; a stack of two is refused."""
    exposures = {frame.settings.exposure_s for frame in stack.bracket.light}
    assert len(stack.bracket.dark) == 2 * len(exposures)
    assert f"{len(stack.bracket.light)} + {2 * len(exposures)} dark frames of 96 × 64 pixels, 12 bits" in repr(stack)
    double = rm.Stack({"red": stack.bracket, "blue": stack.bracket}, stack.camera, stack.lens, "here")
    with pytest.raises(UsageError, match=r"here holds 2 brackets; choose one: stack\['red'\]"):
        rm.merge(double)
    assert rm.merge(double["blue"]).value.shape == (64, 96)
    again = rm.read(capture)
    assert again.camera == stack.camera
    assert again.lens.f_number == stack.lens.f_number
    for mine, theirs in zip(stack.bracket.light, again.bracket.light, strict=True):
        assert np.array_equal(mine.dn, theirs.dn)
    with pytest.raises(CaptureError, match=r"use radiometer\.read"):
        rm.read_photographs(capture)


def test_a_merged_bracket_is_arrays_with_unit_and_uncertainty(stack, tmp_path):
    """An even field: the scatter of pixels is what their uncertainties say, within 10 %."""
    radiance = rm.merge(stack)
    assert radiance.unit == "relative"
    pulls = (radiance.value - radiance.value.mean()) / radiance.u
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)
    radiance.write(tmp_path / "map.exr")
    assert (tmp_path / "map.exr").stat().st_size > 0
    assert "100 % good" in repr(radiance)


def test_netcdf_keeps_units_uncertainties_and_flags(stack, tmp_path):
    """Written and read by a real engine: values, CF attributes, and what obsarray needs to add the uncertainties up."""
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    radiance = rm.merge(stack)
    radiance.to_xarray().to_netcdf(tmp_path / "map.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as back:
        assert back.attrs["Conventions"].startswith("CF-")
        assert np.array_equal(back.radiance.values, radiance.value)
        assert np.allclose(np.hypot(back.u_radiance.values, back.u_shared.values), radiance.u)  # of the dark frames
        assert np.allclose(back.u_common.values, np.abs(radiance.value) * radiance.u_rel_common)
        assert {back[name].attrs["units"] for name in ("radiance", "u_radiance", "u_common")} == {"1"}
        assert list(back.radiance.attrs["unc_comps"]) == ["u_radiance", "u_common", "u_shared"]
        forms = {name: back[name].attrs["err_corr_1_form"] for name in back.radiance.attrs["unc_comps"]}
        assert forms == {"u_radiance": "random", "u_common": "systematic", "u_shared": "systematic"}
        assert [back.u_common.attrs[f"err_corr_{n}_dim"] for n in (1, 2)] == ["y", "x"]
        assert back.mask.attrs["flag_masks"].dtype == back.mask.dtype
        assert back.attrs["exposures_s"].tolist() == pytest.approx(list(radiance.map.exposures_s))


def test_a_response_is_recovered_drawn_and_written(tmp_path):
    """A linear camera: ln H rises as ln(DN − black) within 4 u; plot, notebook picture and table show it."""
    response = rm.recover_response(_gradient(), method="linear_spline")
    low, high = response.curve.valid_dn
    dn = np.arange(max(low, 300), min(high, 3500))
    middle = response.curve.mid_dn
    expected = np.log((dn - 64.0) / (middle - 64.0))
    # The black level of the simulated frames is 64 DN; the gauge point is exact.
    assert np.abs(response.log_exposure[dn] - expected).max() < 0.02
    response.to_csv(tmp_path / "curve.csv")
    assert (tmp_path / "curve.csv").read_text().startswith("dn,log_exposure,u_log_exposure\n")
    axes = response.plot()
    assert axes.get_xlabel() == "digital number M (DN)"
    from matplotlib import pyplot

    drawn = response.plot()
    assert pyplot.gca() in drawn.figure.axes  # what `plt.savefig` writes
    pyplot.close(drawn.figure)
    assert response._repr_html_().startswith('<figure><img alt="&lt;Response by linear_spline')
    # Light of a sphere, nearly even, at times close together: what lies outside of the data is extrapolated.
    found = rm.recover_response(_gradient(32_000.0, (0.01, 0.011, 0.012, 0.014)), method="linear_spline")
    assert any("stops only: readings outside them are extrapolated" in one for one in found.estimate.notes)


def test_a_sensor_reports_its_figures_with_unit_and_uncertainty(stack, capture):
    """Black level and dark noise of the simulated camera, by hand from its description; single lit frames give no K."""
    sensor = rm.characterise(capture)
    about = stack.camera
    noise_dn = np.sqrt((about.read_noise_e / about.conversion_gain_e_per_dn) ** 2 + 1 / 12)
    assert abs(sensor["mu_y_dark"].value - 64.0) < 4 * sensor["mu_y_dark"].u
    assert abs(sensor["sigma_y_dark"].value - noise_dn) < 4 * sensor["sigma_y_dark"].u
    assert "K" not in sensor.figures
    assert "mu_y_dark = 64.0" in repr(sensor)
    assert "<td>mu_y_dark</td><td>64.0" in sensor._repr_html_()


def _gradient(dimmest: float = 40.0, times: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)) -> rm.Stack:
    """Return frames of a ramp of light by a linear 12-bit camera with noise, made here."""
    from radiometer.data import Bracket, CameraDescription, Frame, FrameSettings, LensDescription

    rng = np.random.default_rng(8)
    light = np.geomspace(dimmest, 40000.0, 120)[None, :] * np.ones((60, 1))
    frames = []
    for exposure_s in times:
        electrons = rng.poisson(light * exposure_s * 10.0)
        dn = np.clip(np.round(electrons / 2.6 + 64.0 + rng.normal(0, 1.0, light.shape)), 0, 4095).astype(np.uint16)
        frames.append(Frame(dn, 12, FrameSettings(exposure_s=exposure_s, black_level_dn=64.0)))
    camera = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.6, black_level_dn=64.0)
    return rm.Stack({"ramp": Bracket.from_frames(frames)}, camera, LensDescription(), "ramp")


@pytest.mark.parametrize(
    "light",
    [
        lambda **whose: rm.light_set("spot", level=1, hold_s=0.0, **whose),
        lambda **whose: rm.light_pulse("spot", 0.1, level=1, **whose),
        lambda **whose: rm.light_blink("spot", 0.1, 0.1, 2, level=1, **whose),
    ],
)
@pytest.mark.parametrize(
    ("whose", "eye"), [({}, None), ({"subject": "S07", "eye": "left"}, "s07 left"), ({"no_eye": True}, NO_EYE)]
)
def test_light_counts_for_whose_eye_is_named_and_else_for_every_eye(monkeypatch, light, whose, eye):
    """Every function that lights opens the box for the eye that is named; that no eye looks has to be stated."""
    opened_for = []

    def opened(*_, eye, **__):
        opened_for.append(eye)
        raise DeviceLost("unplugged")

    monkeypatch.setattr("radiometer.api.light.open_light_box", opened)
    with pytest.raises(DeviceLost):
        light(box="LB000001", **whose)
    assert opened_for == [eye]


def in_a_new_process(code: str) -> str:
    """Return what a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_all_names_can_be_had_and_those_of_pages_exist(project_root):
    """Documented, in dir(), with the nearest of a wrong one; programs of README and docs import."""
    for name in rm.__all__:
        assert getattr(rm, name).__doc__
    assert set(rm.__all__) <= set(dir(rm))
    with pytest.raises(AttributeError, match=r"no attribute 'Bracket'; did you mean 'bracket'\?"):
        _ = rm.Bracket
    used = set()
    for page in (project_root / "README.md", *sorted((project_root / "docs").rglob("*.md"))):
        for program in re.findall(r"^```py[^\n]*\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S):
            for node in ast.walk(ast.parse(program)):
                if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("radiometer", "simulators"):
                    used |= {(str(node.module), one.name) for one in node.names}
                elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rm":
                    used.add(("radiometer", node.attr))
    assert ("radiometer.adapters.psychopy", "RadiometerPhotometer") in used
    assert [one for one in sorted(used) if not hasattr(importlib.import_module(one[0]), one[1])] == []


@pytest.mark.parametrize(("error", "code"), [(rm.UsageError, 2), (rm.CalibrationError, 1), (rm.DeviceError, 1)])
def test_every_error_can_be_caught_by_its_public_root(error, code):
    """A program catches RadiometerError and finds the exit code of the command line."""
    with pytest.raises(rm.RadiometerError) as caught:
        raise error("no")
    assert caught.value.exit_code == code


@pytest.mark.slow
def test_importing_loads_neither_numpy_nor_any_room(stack):
    """A response and a calibration exclude each other."""
    code = "import sys, radiometer; print([m for m in sys.modules if m.startswith(('numpy', 'radiometer.'))])"
    assert in_a_new_process(code) == "[]"
    response = rm.recover_response(_gradient())
    with pytest.raises(UsageError, match="leave --response out"):
        rm.merge(stack, response, calibration="anything.yaml")
