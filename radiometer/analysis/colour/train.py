"""Makes a colour calibration: from readings of known lights, or from responsivities and plausible lights."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from radiometer.analysis.colour.calibration import ALL, ColourCalibration
from radiometer.analysis.colour.matrix import Fit, Training, errors_of_other_lights, fit_matrix, plausible_training
from radiometer.analysis.colour.plausible import plausible_lights
from radiometer.data import CameraDescription, LensDescription, Provenance, ScaleConditions
from radiometer.data.mosaic import COLOURS
from radiometer.data.reading import LUMINANCE_UNIT, RELATIVE_UNIT
from radiometer.errors import CalibrationError
from radiometer.typing import Array


@dataclass(frozen=True, slots=True, eq=False)
class ColourCamera:
    """What is known of a camera before its colour calibration."""

    channels: tuple[str, ...]  # names of its channels
    camera: CameraDescription = field(default_factory=lambda: CameraDescription(bit_depth=16))  # its description
    lens: LensDescription = field(default_factory=LensDescription)  # its lens
    conditions: ScaleConditions = field(default_factory=ScaleConditions)  # gain and temperature of its frames
    iso: float | None = None  # lowest ISO speed of its photographs
    # Per watt over the grid of plausible lights, up to a common factor; None where unknown
    responsivities: Array | None = None
    inputs: tuple[str, ...] = ()  # files with their content hashes, for the record


def train_on_lights(
    known: ColourCamera, training: Training, *, powers: Array | None, per_kind: bool, u_rel: float,
    white: str | None = None,
) -> ColourCalibration:  # fmt: skip
    """Return the calibration fitted to readings of known lights.

    The error for a kind of light is that of lights left out of the training, and that of plausible lights of the kind;
    the larger counts. Spectra (`powers`) are over the grid of plausible lights; all known X, Y, Z share `u_rel`. The
    matrix gives the X, Y, Z of `white` exactly. Raises CalibrationError if the lights do not determine a matrix, or
    none is called as the white.
    """
    if white is not None and white not in training.names:
        raise CalibrationError(f"--white {white}: no light has that name; there are {', '.join(training.names)}")
    kinds = tuple(dict.fromkeys(training.kinds))
    fits, errors, of_displays = dict[str, Fit](), dict[str, Array](), dict[str, Array]()
    for name in kinds if per_kind else (ALL,):
        part = None if name == ALL else name
        try:
            fits[name] = fit_matrix(training.of_kind(part), white)
        except CalibrationError as error:
            raise CalibrationError(f"kind {name}: {error}" if part else str(error)) from error
        trained = [name] if part else list(kinds)
        others, linear = dict[str, Array](), dict[str, Array]()
        if known.responsivities is not None or known.channels == COLOURS:
            chosen = [part in (None, one) for one in training.kinds]
            others, linear = errors_of_other_lights(
                fits[name].matrix, training.of_kind(part), None if powers is None else powers[chosen],
                known.responsivities,
            )  # fmt: skip
        own = {kind: max(fits[name].error, others.get(kind, fits[name].error), key=np.trace) for kind in trained}
        errors |= own if part else {**others, **own}
        left_out = np.kron(fits[name].error, np.ones((3, 3)))
        for kind, one in linear.items():
            if part in (None, kind):
                of_displays[kind] = one + left_out if kind in trained else one
    assumed = []
    if known.responsivities is None and not per_kind:
        assumed.append(
            f"error for lights other than {', '.join(kinds)}: that of plausible colour cameras"
            if known.channels == COLOURS
            else f"error for lights other than {', '.join(kinds)}: unknown, in no uncertainty; give --responsivities"
        )
    origin = Provenance("least squares weighted by 1/u²", known.inputs, tuple(assumed), {"per_kind": per_kind})
    return ColourCalibration(
        channels=known.channels, camera=known.camera, lens=known.lens, conditions=known.conditions, iso=known.iso,
        unit=LUMINANCE_UNIT, matrices=fits, errors=errors, trained=kinds,
        training=training, u_rel=u_rel, provenance=origin, display_errors=of_displays,
    )  # fmt: skip


def train_on_responsivities(
    known: ColourCamera, scale: Training | None, *, per_kind: bool, u_rel: float
) -> ColourCalibration:
    """Return the calibration fitted to plausible lights, through the camera's responsivities.

    Raises CalibrationError if the responsivities determine no matrix, or a known light has no reading.
    """
    responsivities = known.responsivities
    if responsivities is None:
        raise CalibrationError("a matrix from plausible lights needs the camera's responsivities")
    fits, of_displays, lights = dict[str, Fit](), dict[str, Array](), plausible_training(responsivities)
    if per_kind:
        for kind in plausible_lights():
            try:
                fits[kind] = fit_matrix(lights.of_kind(kind))
            except CalibrationError:
                continue  # its lights are shades of one colour, or too few
        errors = {kind: fit.error for kind, fit in fits.items()}
    else:
        fits[ALL] = fit_matrix(lights)
        powers = np.vstack(list(plausible_lights().values()))
        errors, of_displays = errors_of_other_lights(fits[ALL].matrix, lights, powers, responsivities)
    unit, assumed, u_scale = RELATIVE_UNIT, ["X, Y, Z are relative: no light of known luminance took part"], 0.0
    if scale is not None:
        factor, u_scale = _scale(scale, fits)
        fits = {
            kind: fit.model_copy(update={"matrix": factor * fit.matrix, "spread": factor**2 * fit.spread})
            for kind, fit in fits.items()
        }
        unit, assumed = LUMINANCE_UNIT, ["the scale is that of the known lights"]
    origin = Provenance("plausible lights through responsivities", known.inputs, tuple(assumed), {"per_kind": per_kind})
    u_all = math.hypot(u_rel, u_scale)
    trained = tuple(fits) if per_kind else tuple(plausible_lights())
    return ColourCalibration(
        channels=known.channels, camera=known.camera, lens=known.lens, conditions=known.conditions, iso=known.iso,
        unit=unit, matrices=fits, errors=errors, trained=trained,
        training=scale, u_rel=u_all, provenance=origin, display_errors=of_displays,
    )  # fmt: skip


def _scale(known: Training, fits: dict[str, Fit]) -> tuple[float, float]:
    """Return the factor that gives known lights their luminance, and its relative standard uncertainty.

    Each light counts by its own uncertainty; the scatter counts where it is larger, and of a single light its error.
    """
    ratios, variances = [], []
    for n, kind in enumerate(known.kinds):
        fit = fits.get(kind) or fits.get(ALL)
        if fit is None:
            raise CalibrationError(f"light {known.names[n]!r}: there is no matrix for its kind {kind!r}")
        given = float(fit.matrix[1] @ known.signal[n])
        if not given > 0.0:
            raise CalibrationError(f"light {known.names[n]!r}: its reading gives no luminance above 0")
        noise = float(np.sum((fit.matrix[1] * known.u_signal[n]) ** 2)) / given**2
        own = fit.error[1, 1] * (known.xyz[n].sum() / known.xyz[n, 1]) ** 2
        ratios.append(float(known.xyz[n, 1]) / given)
        variances.append(noise + known.u_rel[n] ** 2 + own)
    weight = 1.0 / np.array(variances)
    factor = float(np.average(ratios, weights=weight))
    scatter = float(np.average((np.array(ratios) / factor - 1.0) ** 2, weights=weight)) / max(1, len(ratios) - 1)
    return factor, math.sqrt(max(1.0 / float(weight.sum()), scatter if len(ratios) > 1 else 0.0))
