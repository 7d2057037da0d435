"""Eyes drawn around published figures, for tests and studies of the fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulators.observers.eye_kinetics import Eye, scotopic_per_photopic


def drawn_eye(rng: np.random.Generator, break_range_min: tuple[float, float] = (6.0, 12.0)) -> Eye:
    """Return an eye drawn around published figures: S2 −0.24 ± 0.02 log10 per min, break 6 to 12 min at 453 nm.

    Source: Lamb and Pugh 2004; Jackson, Owsley and McGwin 1999 (Vision Res 39:3975).
    """
    eye = Eye(
        cone_plateau_log10=float(rng.normal(-2.3, 0.15)),
        cone_amplitude=float(rng.normal(2.2, 0.2)),
        cone_tau_min=float(rng.uniform(1.2, 1.9)),
        rod_final_log10=float(rng.normal(-4.3, 0.15)),
        s2_slope_per_min=float(rng.normal(-0.24, 0.02)),
        s3_slope_per_min=float(rng.uniform(-0.05, -0.03)),
    )
    break_min = float(rng.uniform(*break_range_min))
    elevation = eye.cone_log10(break_min, 453.0) - eye.rod_final_log10
    return replace(eye, s2_zero_min=break_min - elevation / eye.s2_slope_per_min)


def drawn_full_bleach_eye(rng: np.random.Generator) -> Eye:
    """Return a healthy eye with S2 −0.24 ± 0.02 log10 per min, its break at 505 nm 7 to 12 min after a full bleach.

    Source: Hecht, Haig and Chase 1937; Lamb and Pugh 2004.
    """
    eye = Eye(
        cone_plateau_log10=float(rng.normal(-2.3, 0.15)),
        cone_tau_min=float(rng.uniform(1.2, 1.9)),
        rod_final_log10=float(rng.normal(-4.3, 0.15)),
        s2_slope_per_min=float(rng.normal(-0.24, 0.02)),
        s3_slope_per_min=float(rng.uniform(-0.05, -0.03)),
    )
    break_min = float(rng.uniform(7.0, 12.0))
    elevation = eye.cone_plateau_log10 + math.log10(scotopic_per_photopic(505.0)) - eye.rod_final_log10
    return replace(eye, full_bleach_min=break_min - elevation / eye.s2_slope_per_min)
