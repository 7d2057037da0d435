"""The outsiders of the tests' own generator as the benchmark of proposed laws takes them: stage and covariates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testing.generator.registry import OUTSIDERS
from testing.generator.session import Session as OwnSession
from testing.generator.session import make_session
from testing.outside.session import Hidden, Secret

ANOTHER = 500_000  # added to the seed of a further session of a rig, each number once more
PLACES = {  # stage and covariates, read off the equations in testing/generator/outsiders.py
    "sinusoidal_lamp_drift": ("source", ("timestamp_s",)),
    "dust_shadow": ("optics", ("image_xy",)),
    "converter_ripple": ("digital", ("signal",)),
    "stop_hysteresis": ("optics", ("f_number",)),
    "warm_gain": ("readout", ("temperature_C", "gain_db")),
    "evening_light": ("optics", ("timestamp_s", "f_number")),  # it comes through the lens
    "gain_drift": ("readout", ("timestamp_s",)),
    "shutter_skew": ("shutter", ("image_y", "exposure_s")),
    "long_mode_black": ("digital", ("exposure_s",)),
    "gain_noise": ("readout", ("signal",)),
    "dark_top": ("digital", ("image_y",)),
    "brightness_limiter": ("scene", ("picture_mean",)),
    "smear": ("charge", ("column_light",)),
    "two_slopes": ("digital", ("signal",)),
}
HIDDEN = {
    name: Hidden(name, "outsider", lambda *drawn: {}, ("rich",), stage=PLACES[name][0], covariates=PLACES[name][1])
    for name in OUTSIDERS
}


@dataclass(frozen=True)
class Written:
    """A session of the own generator with the secret in the form of the others."""

    session: OwnSession
    secret: Secret

    def write(self, folder: Path) -> Path:
        """Write the capture set, without the sealed truth."""
        self.session.write(folder)
        return folder


def make(seed: int, hidden: Hidden | None, plan: str | None, *, again: int = 0) -> Written:
    """Return a session of a rig with an outsider, or of the same rig with nothing hidden.

    Args:
        seed: Of the rig, the size and the first session.
        hidden: What is hidden; None for nothing.
        plan: None or the only one, `rich`.
        again: Number of a further session of the same rig; 0 for the first.
    """
    names = () if hidden is None else (hidden.name,)
    own = make_session(*names, camera_seed=seed, session_seed=seed + again * ANOTHER, plan=plan)
    if hidden is None:
        return Written(own, Secret("null", "rich"))
    drawn = {k: float(v) for k, v in own.truth[hidden.name].items() if np.ndim(v) == 0 and not isinstance(v, str)}
    return Written(own, Secret("outsider", "rich", hidden.name, (), hidden.stage, hidden.covariates, drawn))
