"""The camera before a light box."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

from radiometer.bench import light_bench
from radiometer.bench.instrument import Instrument
from radiometer.data import Calibration, Patch
from radiometer.data.config_files import shipped_config
from radiometer.devices import CameraPreset
from simulators.cameras.simulated_camera import SimulatedCamera
from simulators.chain.camera_model import CameraModel
from simulators.scenes import UniformScene


def test_the_light_of_a_box_is_no_light_of_any_kind(monkeypatch):
    """A bench that states no spectrum: the survey corrects for each channel's, and readings carry no doubt of it."""
    camera = SimulatedCamera(
        CameraModel.ideal(CameraPreset.shipped("BFS-U3-19S4M").camera), UniformScene(radiance_W_per_sr_m2=1.0), seed=1
    )
    camera.open()
    known = Calibration.read(shipped_config("calibrations/simulated.yaml"))
    monkeypatch.setattr("radiometer.analysis.signal.situation.require_camera", lambda *_: None)
    unstated = Instrument(camera, Patch(0, 0, 8, 8), calibration=known, spectrum_stated=False)

    @contextmanager
    def opened(*_):
        yield unstated

    monkeypatch.setattr(light_bench, "open_instrument", opened)
    with light_bench.open_light_camera(SimpleNamespace(twin=None), None, None, None, None) as instrument:
        assert instrument.spectrum_stated
