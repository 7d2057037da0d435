"""Makes the frames that the `emva1288` package judges, and keeps its figures; see emva_oracle.md next to this file.

python tests/unit/simulators/chain/make_emva_oracle.py frames FOLDER          # in the project's environment
python tests/unit/simulators/chain/make_emva_oracle.py judge FOLDER OUT.json  # in the package's environment
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

WIDTH, HEIGHT, SEED = 320, 240, 1288
RADIANCE = 5.12e-4
WAVELENGTH_NM = 550.0
CAMERA = {
    "bit_depth": 12,
    "pixel_pitch_um": 4.5,
    "conversion_gain_e_per_dn": 5.95,
    "read_noise_e": 5.4,
    "full_well_e": 20_000,
    "dark_current_e_per_s": 4.0,
    "black_level_dn": 64,
    "quantum_efficiency": 0.62,
}
LENS = {"f_number": 4.0}


def exposures_s() -> list[float]:
    """Return 30 even steps to 92 % of full well and 30 finer ones through it, in whole ms.

    They end on the slope behind the largest variance: on a plateau the package takes the last local maximum for it.
    """
    coarse = [0.04 + 21.0 * step / 30 for step in range(30)]
    fine = [21.0 + 1.95 * step / 29 for step in range(30)]
    return [round(t, 3) for t in coarse + fine]


def photons_per_second() -> float:
    """Return μ_p per second of exposure, worked out here and not by the simulator."""
    irradiance = 3.141592653589793 * RADIANCE / (4 * 4.0**2)
    photon_j = 6.62607015e-34 * 299_792_458.0 / (WAVELENGTH_NM * 1e-9)
    return irradiance * (4.5e-6) ** 2 / photon_j


def make_frames(folder: Path) -> None:
    """Write pairs of bright and dark frames, a spatial stack, and the descriptor file."""
    import cv2

    from radiometer.data import CameraDescription, FrameSettings, LensDescription
    from simulators.chain.camera_model import CameraModel, VirtualSensor
    from simulators.scenes import UniformScene

    model = CameraModel.ideal(CameraDescription(**CAMERA), LensDescription(**LENS), WAVELENGTH_NM)
    scene = UniformScene(radiance_W_per_sr_m2=RADIANCE, wavelength_nm=WAVELENGTH_NM)
    sensor = VirtualSensor(model, scene, WIDTH, HEIGHT, seed=SEED)
    lines = ["v 4.0", f"n 12 {WIDTH} {HEIGHT}"]
    plan = [(t, shutter, 2) for t in exposures_s() for shutter in ("open", "closed")]
    plan += [(exposures_s()[15] + 0.0005, shutter, 8) for shutter in ("open", "closed")]
    (folder / "images").mkdir(parents=True)
    for number, (t, shutter, count) in enumerate(plan):
        kind = f"b {t * 1e9:.1f} {photons_per_second() * t:.6f}" if shutter == "open" else f"d {t * 1e9:.1f}"
        lines.append(kind)
        for index in range(count):
            name = f"images/{number:03d}_{index}.png"
            dn = sensor.expose(FrameSettings(t, f_number=4.0, black_level_dn=64.0, shutter=shutter))
            cv2.imwrite(str(folder / name), dn)
            lines.append(f"i {name.replace('/', chr(92))}")
    (folder / "EMVA1288_Data.txt").write_text("\n".join(lines) + "\n")


def judge(folder: Path, out: Path) -> None:
    """Run the package on the descriptor and keep its figures."""
    import logging

    import emva1288
    import numpy as np
    from emva1288.process.data import Data1288
    from emva1288.process.loader import LoadImageData
    from emva1288.process.parser import ParseEmvaDescriptorFile
    from emva1288.process.results import Results1288

    info = ParseEmvaDescriptorFile(str(folder / "EMVA1288_Data.txt"), loglevel=logging.WARNING)
    loaded = LoadImageData(info.images, str(folder), loglevel=logging.WARNING)
    data = Data1288(loaded.data, loglevel=logging.WARNING).data
    results = Results1288(data, loglevel=logging.WARNING)
    names = ["K", "R", "QE", "sigma_d", "u_e_sat", "u_p_sat", "u_I_mean", "LE_min", "LE_max", "SNR_max", "PRNU1288"]
    figures = {name: float(getattr(results, name)) for name in names}
    figures["DSNU1288"] = None if np.isnan(results.DSNU1288) else float(results.DSNU1288)
    temporal = {key: [float(v) for v in values] for key, values in data["temporal"].items()}
    kept = {"emva1288": emva1288.__version__, "numpy": np.__version__, "figures": figures, "temporal": temporal}
    out.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    if sys.argv[1] == "frames":
        make_frames(Path(sys.argv[2]))
    else:
        judge(Path(sys.argv[2]), Path(sys.argv[3]))
