"""The tools that are scored: reconcile, and a baseline that a reader can write in an afternoon."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import chi2

import radiometer as rm
from radiometer.data import CaptureSet, FrameSettings
from radiometer.errors import RadiometerError
from simulators.chain.camera_model import CameraModel
from simulators.effects.base import Effect
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import FrameGeometry
from simulators.effects.registry import all_effects

_LEVEL: Final = 0.001  # of the chi-square test: one null in a thousand is called wrong
_MODEL_REL: Final = 0.01  # of a mean: radiances, lamp and model are known to about as much
_LIT_DN: Final = 30.0  # above the black level: errors of the black level are then some percent at most
_ALIKE: Final = 0.9  # of the cosine between residual and template, below which the baseline gives no name


def reconcile(folder: Path) -> dict[str, Any]:
    """Return what `radiometer reconcile` answers for a capture set."""
    begun = time.process_time()
    found = rm.reconcile(folder).to_mapping()
    names = [
        {"name": e["name"], "probability": e.get("probability") or 0.0, "alternatives": e["alternatives"]}
        for e in found["effects"]
        if e["name"] != "unnamed"
    ]
    return {"names": names, "something_missing": found["verdict"] != "agrees", "seconds": time.process_time() - begun}


@dataclass(frozen=True)
class _Seen:
    """What the baseline reads of a capture set: one row per run of frames of one setting, one column per patch."""

    settings: tuple[FrameSettings, ...]
    places: FrameGeometry
    radiances: np.ndarray  # W/(sr m2), nothing where the frame is dark
    mean: np.ndarray  # DN
    variance: np.ndarray  # DN², over the pixels of a patch
    pixels: np.ndarray  # pixels of a patch times frames

    @classmethod
    def of(cls, capture: CaptureSet) -> _Seen:
        """Return the means and variances of every patch in repeats of a setting."""
        header = capture.header
        patches = [one.patch for one in header.patches]
        height, width = capture.read_frame(0).shape
        x, y = (np.array([p.x + p.width / 2 for p in patches]), np.array([p.y + p.height / 2 for p in patches]))
        means, variances, settings, radiances, pixels = [], [], [], [], []
        for one, repeats in groupby(header.frames, key=lambda entry: replace(entry.settings, timestamp_s=None)):
            files = [entry.file for entry in repeats]
            parts = [[dn[p.slices].astype(float) for p in patches] for dn in map(capture.read_numbers, files)]
            means.append(np.mean([[part.mean() for part in frame] for frame in parts], axis=0))
            variances.append(np.mean([[part.var(ddof=1) for part in frame] for frame in parts], axis=0))
            pixels.append(np.array([p.width * p.height * len(files) for p in patches]))
            settings.append(one)
            known = [p.radiance_W_per_sr_m2 for p in header.patches]
            own = np.array([r.get(one.pattern, 0.0) if isinstance(r, dict) else r or 0.0 for r in known])
            radiances.append(np.zeros_like(own) if one.is_dark else own)
        stacked = (np.array(rows) for rows in (radiances, means, variances, pixels))
        return cls(tuple(settings), FrameGeometry(x, y, width, height), *stacked)

    def at(self, rows: Sequence[int]) -> _Seen:
        """Return some of its settings."""
        parts = (part[rows] for part in (self.radiances, self.mean, self.variance, self.pixels))
        return _Seen(tuple(self.settings[n] for n in rows), self.places, *parts)

    def predicted(self, model: CameraModel) -> np.ndarray:
        """Return a model's means and variances, shape (2, settings, patches)."""
        rows = zip(self.settings, self.radiances, strict=True)
        moments = [model.moments(radiance, model.context(one, self.places)) for one, radiance in rows]
        shape = self.places.shape
        mean = [np.broadcast_to(m.mean, shape) for m in moments]
        variance = [np.broadcast_to(m.variance + m.spatial_variance, shape) for m in moments]
        return np.array([mean, variance])

    def u(self, predicted: np.ndarray) -> np.ndarray:
        """Return the standard uncertainties of means and variances about a prediction, in its shape."""
        mean, variance = predicted
        u_mean = np.sqrt(variance / self.pixels + (_MODEL_REL * mean) ** 2)
        return np.maximum(np.array([u_mean, variance * np.sqrt(2.0 / self.pixels)]), 1e-3)  # a DN has no finer parts

    def summary(self, sigmas: np.ndarray) -> dict[Any, np.ndarray]:
        """Return a change by setting: its part that is even, and its slopes along light, column, row and radius².

        These do not depend on the places of the patches, so that sessions of one plan can be compared.

        Args:
            sigmas: Change over its uncertainty, shape (2, settings, patches).
        """
        x = 2.0 * self.places.x_px / self.places.sensor_width - 1.0
        y = 2.0 * self.places.y_px / self.places.sensor_height - 1.0
        found: dict[Any, list[np.ndarray]] = {}
        for n, (one, radiance) in enumerate(zip(self.settings, self.radiances, strict=True)):
            light = np.log(np.where(radiance > 0, radiance, 1.0))
            basis = np.array([np.ones_like(x), light - light.mean(), x, y, x**2 + y**2])
            found.setdefault(_key(one), []).append(np.ravel(sigmas[:, n] @ np.linalg.pinv(basis)))
        return {key: np.mean(parts, axis=0) for key, parts in found.items()}


def _key(one: FrameSettings) -> tuple[str, ...]:
    """Return what makes a setting the same in another session of its plan: temperatures there differ by tenths."""
    warm = round((one.temperature_c or 0.0) / 5.0)
    parts = (f"{one.exposure_s:.3g}", one.gain_db, one.f_number, warm, one.source_level, one.pattern, one.shutter)
    return tuple(map(str, parts))


class Template:
    """The nearest template: the entry whose change of means and variances is most like the residual.

    Every entry is simulated once per plan, at the middle of the sizes that it starts from. What depends on the time or
    on the order of the frames has no template.
    """

    def __init__(self) -> None:
        """Begin without templates."""
        self._made: dict[tuple[str, ...], dict[str, np.ndarray]] = {}

    def __call__(self, folder: Path) -> dict[str, Any]:
        """Return the answer for a capture set."""
        begun = time.process_time()
        capture = CaptureSet.read(folder)
        header, seen = capture.header, _Seen.of(capture)
        model = CameraModel.ideal(header.camera, header.lens, header.source.wavelength_nm or 550.0)
        seen = replace(seen, radiances=seen.radiances * _responsivity(seen, seen.predicted(model)[0]))
        plain = seen.predicted(model)
        residual = (np.array([seen.mean, seen.variance]) - plain) / seen.u(plain)
        missing = float(np.sum(residual**2)) > float(chi2.isf(_LEVEL, residual.size))
        names = []
        if missing:
            found = seen.summary(residual)
            templates = self._templates(model, seen, sorted(found))
            here = np.concatenate([found[key] for key in sorted(found)])
            likeness = {name: abs(float(one @ here)) / float(np.linalg.norm(here)) for name, one in templates.items()}
            best = max(likeness, key=lambda name: likeness[name])
            if likeness[best] > _ALIKE:
                names.append({"name": best, "probability": min(likeness[best], 1.0), "alternatives": []})
        return {"names": names, "something_missing": missing, "seconds": time.process_time() - begun}

    def _templates(self, model: CameraModel, seen: _Seen, keys: Sequence[tuple[str, ...]]) -> dict[str, np.ndarray]:
        """Return the change by each entry in a plan, of length 1."""
        plan = (model.camera.model_dump_json(), model.lens.model_dump_json(), *map("|".join, keys))
        if plan not in self._made:
            first = {_key(one): n for n, one in reversed(list(enumerate(seen.settings)))}
            short = seen.at([first[key] for key in keys])
            plain = short.predicted(model)
            changes = {name: _change(short, model, kind, plain) for name, kind in all_effects().items()}
            self._made[plan] = {name: one for name, one in changes.items() if one is not None}
        return self._made[plan]


def _responsivity(seen: _Seen, mean: np.ndarray) -> float:
    """Return the factor on all light that fits best: a lens and a sensor are known to some percent."""
    black = np.array([one.black_level_dn or 0.0 for one in seen.settings])[:, None]
    lit = (mean - black > _LIT_DN) & (seen.variance > 0)
    return float(np.median(((seen.mean - black) / np.maximum(mean - black, 1.0))[lit])) if lit.any() else 1.0


def _change(short: _Seen, model: CameraModel, kind: type[Effect], plain: np.ndarray) -> np.ndarray | None:
    """Return what an entry changes in a plan, of length 1; None where it changes nothing here."""
    if not issubclass(kind, CatalogueEffect) or not kind.trials:
        return None
    try:
        changed = short.predicted(model.with_effect(kind(**kind.trials[len(kind.trials) // 2])))
    except (RadiometerError, TypeError, ValueError, ArithmeticError):
        return None
    found = short.summary((changed - plain) / short.u(plain))
    change = np.concatenate([found[key] for key in sorted(found)])
    size = float(np.linalg.norm(change))
    return change / size if size > 0 and np.isfinite(size) else None


TOOLS: Final[dict[str, Callable[[Path], dict[str, Any]]]] = {"reconcile": reconcile, "template": Template()}
