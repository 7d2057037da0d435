"""Speed of what a user waits for: the overview, a calibration file, a response from two-megapixel frames, a frame."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks._sections import write_section
from radiometer.analysis.response.debevec1997 import recover_response_debevec1997
from radiometer.data import Bracket, Calibration, Frame, FrameSettings, LensDescription
from radiometer.devices import CameraPreset
from simulators.chain.camera_model import CameraModel
from simulators.effects.context import FrameGeometry
from testing.daemon_process import ROOT, machine_note

REPEATS = 5


def best_s(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest of some times in s."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def program(*words: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, check=True)


def stack(bit_depth: int) -> Bracket:
    """Return 16 frames of 1600 × 1250 pixels of a ramp, 1.6 times apart, through a power of 1/2.2."""
    rng = np.random.default_rng(1)
    scene = np.exp(np.linspace(np.log(0.5), np.log(400.0), 1600 * 1250, dtype=np.float32)).reshape(1250, 1600)
    top = 2**bit_depth - 1
    frames = []
    for exposure_s in 1e-4 * 1.6 ** np.arange(16):
        exposure = scene * exposure_s * (1 + 0.003 * rng.standard_normal(scene.shape, dtype=np.float32))
        dn = np.clip(np.rint(top * np.clip(exposure, 0, 1) ** (1 / 2.2)), 0, top)
        frames.append(Frame(dn.astype(np.uint16), bit_depth, FrameSettings(float(exposure_s))))
    return Bracket.from_frames(frames)


def opencv_debevec(bracket: Bracket) -> Callable[[], object]:
    """Return OpenCV's recovery (70 samples) of the same frames at 8 bit, which is all it takes."""
    pictures = [cv2.merge([(f.dn >> (f.bit_depth - 8)).astype(np.uint8)] * 3) for f in bracket.light]
    times = np.array([f.settings.exposure_s for f in bracket.light], np.float32)
    return lambda: cv2.createCalibrateDebevec().process(pictures, times)


def simulated_frame() -> Callable[[], object]:
    """Return the making of one full frame with cos⁴ and exact Poisson noise."""
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    model = CameraModel.ideal(preset, LensDescription(focal_length_mm=16, f_number=4.0, vignetting="cos4"))
    geometry = FrameGeometry.of_image(1616, 1240)
    context = model.context(FrameSettings(0.01, f_number=4.0), geometry)
    scene = np.linspace(0.0, 1.0, 1616 * 1240, dtype=np.float32).reshape(geometry.shape)
    return lambda: model.sample(scene, context, (0,))


def main() -> None:
    note = machine_note()
    bracket = stack(12)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "calibration.yaml"
        copy.write_bytes((ROOT / "configs" / "calibrations" / "simulated.yaml").read_bytes())
        rows = [
            ("`radiometer --help`", best_s(program("-m", "radiometer", "--help")), "`python -c 'import numpy'`",
             best_s(program("-c", "import numpy"))),
            ("reading a 12-bit calibration", best_s(lambda: Calibration.read(copy)), "", 0.0),
            ("Debevec–Malik, 16 × 2 Mpixel, 12 bit", best_s(lambda: recover_response_debevec1997(bracket), 2),
             "OpenCV's, 70 samples, 8 bit", best_s(opencv_debevec(bracket), 2)),
            ("one simulated frame, 1616 × 1240", best_s(simulated_frame()), "", 0.0),
        ]  # fmt: skip
    body = note + "| what | best (s) | peer | peer's best (s) | ratio |\n|---|---:|---|---:|---:|\n"
    for what, own_s, peer, peer_s in rows:
        body += f"| {what} | {own_s:.3f} | {peer} | {f'{peer_s:.3f} | {own_s / peer_s:.2f}' if peer else ' | '} |\n"
    print(body)
    write_section("main-job", "What a user waits for", "python -m benchmarks main_job", body)


if __name__ == "__main__":
    main()
