"""500 random changes of exposure, gain and black level over the wire: no frame under any settings but its own."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks._sections import write_section
from drivers.cameras.aravis_camera import open_camera
from radiometer.devices import CameraPreset, CameraSettings
from testing.wire import LOOPBACK, radiometer, served

CHANGES, FRAMES_EACH = 500, 2
RADIANCE, F_NUMBER, WAVELENGTH_M = 0.4, 4.0, 550e-9
PHOTON_J = 6.62607015e-34 * 299_792_458 / WAVELENGTH_M
BENCH = f"""\
format: radiometer-bench/1
camera: {{kind: simulated, preset: BFS-U3-19S4M, width: 160, height: 120}}
lens: {{focal_length_mm: 16, f_number: {F_NUMBER}}}
scene: {{kind: uniform, radiance_W_per_sr_m2: {RADIANCE}}}
"""


def deviations(triggered: bool) -> tuple[np.ndarray, float]:
    """Return the deviation of every frame's mean from E = πL/(4N²) in sigma, and the time per change in s."""
    preset = CameraPreset.shipped("BFS-U3-19S4M").camera
    rng, sigmas = np.random.default_rng(17), []
    with open_camera(LOOPBACK) as camera:
        start = time.perf_counter()
        for _ in range(CHANGES):
            settings = camera.configure(
                CameraSettings(
                    exposure_s=math.exp(rng.uniform(math.log(1e-4), math.log(8e-3))),
                    gain_db=rng.uniform(0, 6),
                    black_level_dn=float(rng.integers(20, 200)),
                    software_trigger=triggered,
                )
            )
            gain = 10 ** (settings.gain_db / 20) / preset.conversion_gain_e_per_dn
            flux = math.pi * RADIANCE / (4 * F_NUMBER**2) * (preset.pixel_pitch_um * 1e-6) ** 2 / PHOTON_J
            dark = preset.dark_current_e_per_s * 2 ** ((40 - 25) / 7) * settings.exposure_s
            electrons = flux * preset.quantum_efficiency * settings.exposure_s + dark
            for frame in camera.capture(FRAMES_EACH):
                variance = (gain**2 * (electrons + preset.read_noise_e**2) + 1 / 12) / frame.dn.size
                expected = settings.black_level_dn + gain * electrons
                sigmas.append((frame.dn.mean() - expected) / math.sqrt(variance))
        elapsed_s = time.perf_counter() - start
    return np.array(sigmas), elapsed_s / CHANGES


def main() -> None:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Path(folder) / "bench.yaml"
        bench.write_text(BENCH, encoding="utf-8")
        with served(radiometer("simulate", "camera", "--fast", "--bench", str(bench))):
            for name, triggered in (("free running", False), ("software trigger", True)):
                sigmas, per_change_s = deviations(triggered)
                worst = float(np.abs(sigmas).max())
                mixed = int(np.sum(np.abs(sigmas) > 6))
                rows.append(
                    f"| {name} | {CHANGES} | {sigmas.size} | {mixed} | {sigmas.std():.2f} | {worst:.2f} "
                    f"| {1e3 * per_change_s:.0f} ms |"
                )
                if mixed:
                    raise SystemExit(f"{mixed} frames do not have the brightness of their settings: {rows}")
    body = (
        f"Each change draws exposure (0.1 to 8 ms), gain (0 to 6 dB) and black level (20 to 199 DN) and takes "
        f"{FRAMES_EACH} frames. Each frame's mean is compared with its settings in units of its predicted sigma.\n\n"
        "| | changes | frames | beyond 6 sigma | std of the deviation | worst | time per change |\n"
        "|---|---|---|---|---|---|---|\n" + "\n".join(rows)
    )
    print(body)
    write_section("wire_settings", "Settings are never mixed", "python -m benchmarks wire_settings", body)


if __name__ == "__main__":
    main()
