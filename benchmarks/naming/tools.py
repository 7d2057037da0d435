"""The tools that are scored: reconcile, and a baseline that a reader can write in an afternoon."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
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
_TRIALS: Final = 6  # sizes of each entry, evenly over those that it starts from: one has thousands
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


def template(folder: Path) -> dict[str, Any]:
    """Return the nearest template: the entry whose change of means and variances is most like the residual."""
    begun = time.process_time()
    capture = CaptureSet.read(folder)
    seen, settings, places, radiances, pixels = _seen(capture)
    model = CameraModel.ideal(capture.header.camera, capture.header.lens, capture.header.source.wavelength_nm or 550.0)
    plain = _predicted(model, settings, places, radiances)
    u = np.concatenate([np.sqrt(plain[1] / pixels + (0.01 * plain[0]) ** 2), plain[1] * np.sqrt(2.0 / pixels)])
    residual = (seen - np.concatenate(plain)) / np.maximum(u, 1e-3)
    missing = float(np.sum(residual**2)) > float(chi2.isf(_LEVEL, residual.size))
    names = []
    if missing:
        at = settings, places, radiances
        liked = {name: _likeness(model, kind, residual, plain, u, *at) for name, kind in all_effects().items()}
        likeness = {name: like for name, like in liked.items() if like is not None}
        best = max(likeness, key=lambda name: likeness[name])
        if likeness[best] > _ALIKE:
            names.append({"name": best, "probability": likeness[best], "alternatives": []})
    return {"names": names, "something_missing": missing, "seconds": time.process_time() - begun}


def _seen(capture: CaptureSet) -> tuple[np.ndarray, list[FrameSettings], FrameGeometry, list[np.ndarray], np.ndarray]:
    """Return means and variances of every patch in repeats of a setting, settings, places, radiances and pixels."""
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
    geometry = FrameGeometry(x, y, width, height)
    seen = np.concatenate([np.ravel(means), np.ravel(variances)])
    return seen, settings, geometry, radiances, np.ravel(pixels)


def _predicted(
    model: CameraModel, settings: list[FrameSettings], places: FrameGeometry, radiances: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    moments = [
        model.moments(radiance, model.context(one, places)) for one, radiance in zip(settings, radiances, strict=True)
    ]
    shape = places.shape
    mean = np.ravel([np.broadcast_to(m.mean, shape) for m in moments])
    variance = np.ravel([np.broadcast_to(m.variance + m.spatial_variance, shape) for m in moments])
    return mean, variance


def _likeness(
    model: CameraModel, kind: type[Effect], residual: np.ndarray, plain: tuple[np.ndarray, np.ndarray], u: np.ndarray,
    settings: list[FrameSettings], places: FrameGeometry, radiances: list[np.ndarray],
) -> float | None:  # fmt: skip
    """Return the cosine between the residual and what an entry changes; None where it changes nothing here."""
    if not issubclass(kind, CatalogueEffect):
        return None
    best = None
    for trial in kind.trials[:: max(1, len(kind.trials) // _TRIALS)]:
        try:
            changed = _predicted(model.with_effect(kind(**trial)), settings, places, radiances)
        except (RadiometerError, TypeError, ValueError, ArithmeticError):
            continue
        change = (np.concatenate(changed) - np.concatenate(plain)) / np.maximum(u, 1e-3)
        size = float(np.linalg.norm(change))
        if size > 0 and np.isfinite(size):
            cosine = abs(float(change @ residual)) / size / float(np.linalg.norm(residual))
            best = max(cosine, best or 0.0)
    return best


TOOLS: Final[dict[str, Callable[[Path], dict[str, Any]]]] = {"reconcile": reconcile, "template": template}
