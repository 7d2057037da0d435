"""What the package emva1288 finds in pairs of frames.

    python judge_sets.py FRAMES.json

Run by an interpreter that has emva1288, which this project does not need. The file names arrays (.npy) by exposure in
ms and photons per pixel, 0 for dark frames. Prints one JSON object: gain in DN/e-, black level and dark noise in DN.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import numpy as np
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.results import Results1288


def main() -> None:
    stated = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    temporal = {float(t): {float(p): files for p, files in by.items()} for t, by in stated.items()}
    middle = sorted(temporal)[len(temporal) // 2]
    images = {"temporal": temporal, "spatial": {middle: temporal[middle]}}
    loaded = LoadImageData(images, loglevel=logging.WARNING, fload=lambda path: np.load(path))
    data = Data1288(loaded.data, loglevel=logging.WARNING).data
    seen = data["temporal"]
    # Of the shortest exposure, as the standard has it: the mean over all exposures holds dark current.
    found = {"black": seen["u_ydark"][0], "noise": np.sqrt(seen["s2_ydark"][0])}
    if len(temporal) > 1:
        results = Results1288(data, loglevel=logging.WARNING)
        found |= {"K": results.K, "noise": results.sigma_y_dark}
    else:  # its line needs several exposures; through the origin one point gives the same slope
        found["K"] = (seen["s2_y"][0] - seen["s2_ydark"][0]) / (seen["u_y"][0] - seen["u_ydark"][0])
    print(json.dumps({name: float(value) for name, value in found.items()}))


if __name__ == "__main__":
    main()
