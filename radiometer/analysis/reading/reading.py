"""The radiance of one patch from the frames of a bracket, with its GUM budget and flags."""

from __future__ import annotations

import datetime as dt
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.photometry import holds_visible_light, luminous_efficacy
from radiometer.analysis.photometry.photometry import spectrum as spectrum_of
from radiometer.analysis.reading.budget import (
    Falloff,
    PatchSituation,
    Shown,
    Surround,
    budget_terms,
    combined_u,
    conditions_of,
    coverage_factor,
    effective_degrees_of_freedom,
    reading_flags,
    unstated_u_rel,
)
from radiometer.analysis.reading.estimate import PatchEstimate, estimate_patch
from radiometer.analysis.signal.dark_map import dark_map
from radiometer.analysis.signal.lens import (
    falloff_known,
    flat_doubt,
    is_as_scaled,
    known_f_number,
    lens_factor_sr,
    relative_sensitivity,
)
from radiometer.analysis.signal.model import (
    DarkLevel,
    PatchFrame,
    SignalModel,
    corrected_frames,
    crop_frames,
    dark_levels,
    picked,
    refuse_brighter_darks,
    straightened,
    temperature_factor,
    with_found_code_step,
    without_glare,
)
from radiometer.analysis.signal.situation import Situation, flat_field_for, situation_of
from radiometer.analysis.signal.taps import levelled_frames
from radiometer.data import (
    Bracket,
    Calibration,
    CameraDescription,
    Flag,
    FoundEffects,
    Frame,
    LensDescription,
    Patch,
    Provenance,
    Quantity,
    Reading,
    ScaleConditions,
)
from radiometer.data.frame import Copies
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT, RELATIVE_UNIT
from radiometer.data.setup import Setup
from radiometer.data.white_level import white_level_notes


def read_patch(
    frames: Bracket | Iterable[Frame],
    patch: Patch,
    setup: Setup,
    *,
    now: dt.datetime | None = None,
    sequence: int = 0,
) -> Reading:
    """Return the radiance of a patch in W·sr⁻¹·m⁻² (relative without a calibration) with its budget.

    Args:
        frames: A bracket, or any frames of one unmoving scene; frames with the shutter closed give the dark level.
        setup: Camera, lens and calibration in use, and the light. Without a calibration values are relative and the
            flag `uncalibrated` is set; without a stated spectrum the kinds of light that there are count, and the
            reading is flagged so.
        now: Time that the calibration's age is counted to, with time zone; None for when the frames were taken.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        InputError: If there is no such spectrum.
        MeasurementError: If the patch is outside the frame, or there is no light frame.
    """
    situation = patch_situation(frames, patch, setup, now)
    reading = _reading(situation, patch, sequence)
    if setup.calibration is not None and setup.calibration.absolute and not setup.spectrum_stated:
        reading = replace(reading, flags=tuple(sorted({*reading.flags, Flag.SPECTRUM_ASSUMED})))
    return _with_luminance(reading, setup)


def patch_situation(
    frames: Bracket | Iterable[Frame], patch: Patch, setup: Setup, now: dt.datetime | None = None
) -> PatchSituation:
    """Return what a reading of a patch is made from, for a look behind its budget.

    Args:
        frames: As for `read_patch`.
        setup: As for `read_patch`.
        now: Time of the reading, with time zone; None for when the frames were taken.

    Raises:
        CalibrationError: If the calibration is of another camera or lens.
        MeasurementError: If the patch is outside the frame, or there is no light frame.
    """
    listed = iter(frames.every_frame if isinstance(frames, Bracket) else frames)
    first, copies = next(listed, None), Copies()
    settled, calibration, camera = situation_of(setup, first), setup.calibration, setup.camera
    frames = copies.left_out(itertools.chain([] if first is None else [first], listed))
    if calibration is not None:
        frames = corrected_frames(frames, calibration.found, settled.black.dn)
    levelled, taps = levelled_frames(frames, setup)
    lit, defects = None if taps is None else taps.lit, calibration.defects if calibration else ()
    light, dark_frames, shape = crop_frames(levelled, patch, settled.model, lit, defects)
    codes = [*(one.dn if one.codes is None else one.codes for one in light), *(one.dn for one in dark_frames)]
    settled = replace(settled, model=with_found_code_step(settled.model, codes))
    tap = None if taps is None else taps.tap_of(patch)
    if calibration is not None and settled.model.linear:
        light = [_straightened(one, calibration.found, settled.model) for one in light]
    chosen = [one for one in light if one.usable] or [one for one in light if one.unclipped] or [light[0]]
    # Below its data the curve is a line to the black level. Noise that was cut off there reads as light, in the longest
    # frame the least.
    chosen = [one for one in chosen if one.in_data] or chosen[-1:]
    good, whole_darks = chosen[0].sound, dark_frames
    dark_frames = [picked(frame, good) for frame in dark_frames]
    masked = [one.masked_dn for one in chosen]
    dark = dark_levels(
        [one.settings for one in chosen], dark_frames, settled.model, settled.black, masked_dn=masked,
        darkest=[one.darkest for one in chosen],
    )  # fmt: skip
    even = [_without_pattern(one, whole_darks, level, settled.model) for one, level in zip(chosen, dark, strict=True)]
    for one, level in zip(even, dark, strict=True):
        if dark_frames:
            middle = float(np.median(one.signal))
            refuse_brighter_darks(one.settings, middle, level.signal, level.u_common, settled.model)
    dark = [replace(d, u_independent=math.hypot(d.u_independent, f.u_black)) for d, f in zip(dark, chosen, strict=True)]
    gain = 1.0 if taps is None else taps.gain_of(patch)
    place = _sensitivity(calibration, camera, settled.lens, shape, patch)
    factors = float(place.mean() * np.mean(gain)) * _lens_factors(light, calibration, settled.lens)
    surround = _surround(light, factors, settled)
    kept = [any(one is other for other in chosen) for one in light]
    chosen = [_evened(one, level.signal, place * gain) for one, level in zip(even, dark, strict=True)]
    exposures = np.array([one.settings.exposure_s for one in chosen]) * factors[kept]
    estimate = estimate_patch(chosen, dark, exposures, good, settled.model)
    field = _field(camera, settled.lens, shape, patch)
    conditions = _conditions(estimate, chosen, settled, surround, place, field).model_copy(update={"tap": tap})
    scale, stray = _corrected_scale(settled.scale, surround, conditions, calibration)
    shown = Shown(
        estimate,
        tuple(chosen),
        tuple(dark),
        good,
        len(light),
        _unsteady(light),
        (*copies.notes, *_left_out(good), *estimate.doubts),
    )
    falloff = _falloff(calibration, camera, settled.lens, chosen, place)
    now = now or setup.taken or dt.datetime.now(dt.UTC)
    return PatchSituation(settled, shown, scale, conditions, surround, falloff, now, stray, taps)


def _straightened(frame: PatchFrame, found: FoundEffects, model: SignalModel) -> PatchFrame:
    """Return the frame's patch without the bend of the response that was found."""
    signal = straightened(frame.signal, found, model.electrons_per_unit)
    whole = float(straightened(frame.whole, found, model.electrons_per_unit))
    return replace(frame, signal=signal, whole=whole)


def _corrected_scale(
    scale: float, surround: Surround, here: ScaleConditions, calibration: Calibration | None
) -> tuple[float, float]:
    """Return radiance per unit of the estimate, and what is taken off it, with warmth and glare as they were found."""
    if calibration is None:
        return scale, 0.0
    found, there = calibration.found, calibration.scale.conditions
    warm = scale * temperature_factor(found, here.temperature_c, there.temperature_c)
    gain, of_surround = without_glare(found.glare, there.surround)
    return warm * gain, warm * of_surround * surround.rate


def _left_out(good: NDArray[np.bool_]) -> tuple[str, ...]:
    count = int(np.count_nonzero(~good))
    return (f"{count} of {good.size} pixels are left out: defective, or struck in one frame alone",) if count else ()


def _unsteady(light: list[PatchFrame]) -> bool:
    """Return whether a frame clips that was exposed no longer than one that does not."""
    unclipped = [one.settings.effective_exposure_s for one in light if one.unclipped]
    clipped = [one.settings.effective_exposure_s for one in light if not one.unclipped and one.clipped.all()]
    return bool(unclipped and clipped) and min(clipped) <= max(unclipped) * (1.0 + 1e-9)


def _surround(light: list[PatchFrame], factors: NDArray[np.float64], settled: Situation) -> Surround:
    """Return the light of the whole picture from the frame that shows most of it unclipped, the longest of those."""
    best = min(range(len(light)), key=lambda i: (round(light[i].whole_clipped, 3), -light[i].settings.exposure_s))
    one = light[best]
    signal = one.whole - settled.model.modelled_dark(one.settings)
    return Surround(signal / (one.settings.exposure_s * float(factors[best])), one.whole_clipped)


def _conditions(
    estimate: PatchEstimate,
    chosen: list[PatchFrame],
    settled: Situation,
    surround: Surround,
    place: NDArray[np.float64],
    field: float,
) -> ScaleConditions:
    shares = estimate.coefficients * estimate.expected / (estimate.rate or 1.0)
    model, settings = settled.model, [one.settings for one in chosen]
    heights = [
        (float(model.dn_of(x, one)) - model.black_of(one)) / (model.full_scale_dn - model.black_of(one))
        for x, one in zip(estimate.expected, settings, strict=True)
    ]
    level = float(np.abs(shares) @ heights) / max(float(np.abs(shares).sum()), 1e-300)
    ratio = surround.rate / estimate.rate if estimate.rate > 0.0 else 0.0
    return conditions_of(shares, settings, level, float(place.mean()), field, ratio, settled.setup.polarised)


def _field(camera: CameraDescription, lens: LensDescription, shape: tuple[int, int], patch: Patch) -> float:
    """Return the distance of a patch from the optical axis over that of a corner of the frame."""
    middle = ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    centre = lens.principal_point_px or middle
    away = (patch.x + (patch.width - 1) / 2.0 - centre[0], patch.y + (patch.height - 1) / 2.0 - centre[1])
    return math.hypot(*away) / max(math.hypot(*middle), 0.5)


def _falloff(
    calibration: Calibration | None,
    camera: CameraDescription,
    lens: LensDescription,
    chosen: list[PatchFrame],
    place: NDArray[np.float64],
) -> Falloff:
    """Return what is known of the sensitivity over the picture."""
    if calibration is None:
        return Falloff(falloff_known(camera, lens))
    numbers, flat = {one.settings.f_number or lens.f_number for one in chosen}, calibration.flat_field
    if flat is None:
        return Falloff(falloff_known(camera, lens), as_calibrated=is_as_scaled(calibration, lens, numbers))
    doubt = flat_doubt(calibration, lens, numbers) * abs(1.0 - float(place.mean()))
    return Falloff("flat_field", math.hypot(flat.u_rel, doubt))


def _sensitivity(
    calibration: Calibration | None,
    camera: CameraDescription,
    lens: LensDescription,
    shape: tuple[int, int],
    patch: Patch,
) -> NDArray[np.float64]:
    """Return the sensitivity of the patch's pixels relative to the optical axis; 1 without a calibration."""
    if calibration is None:
        return np.ones((patch.height, patch.width))
    rows, columns = np.mgrid[patch.slices]
    return relative_sensitivity(camera, lens, flat_field_for(calibration, shape), shape, columns, rows)


def _without_pattern(
    frame: PatchFrame, dark_frames: Sequence[Frame], level: DarkLevel, model: SignalModel
) -> PatchFrame:
    """Return the frame's patch with what its dark frames show of single pixels taken out, its mean left as it is."""
    own = dark_map(frame.settings, dark_frames, model, level)
    if own.signal.size == 1:
        return replace(frame, dark_variance=own.variance)
    pattern = own.signal.reshape(frame.signal.shape)
    return replace(frame, signal=frame.signal - (pattern - pattern[frame.sound].mean()), dark_variance=own.variance)


def _evened(frame: PatchFrame, dark: float, place: NDArray[np.float64]) -> PatchFrame:
    """Return the frame's patch with the change of sensitivity over it taken out, its mean left as it is."""
    return replace(frame, signal=dark + (frame.signal - dark) * (place.mean() / place))


def _lens_factors(
    chosen: list[PatchFrame], calibration: Calibration | None, lens: LensDescription
) -> NDArray[np.float64]:
    """Return irradiance per radiance in sr of every frame; relative to the first without a calibration."""
    numbers = [known_f_number(calibration, one.settings, lens) for one in chosen]
    if calibration is not None and calibration.scale.f_number is None:
        return np.ones(len(chosen))
    factors = np.array([lens_factor_sr(lens, number) for number in numbers])
    return factors if calibration is not None else np.asarray(factors / factors[0])


def _reading(situation: PatchSituation, patch: Patch, sequence: int) -> Reading:
    settled, camera = situation.settled, situation.settled.setup.camera
    calibration, estimate = situation.calibration, situation.shown.estimate
    value = situation.value
    terms = budget_terms(situation)
    absolute = calibration is not None and calibration.absolute
    freedom = effective_degrees_of_freedom(terms)
    return Reading(
        radiance=Quantity(value, combined_u(terms), RADIANCE_UNIT if absolute else RELATIVE_UNIT),
        patch=patch,
        instrument=camera.serial or camera.model or "unknown",
        flags=reading_flags(situation, terms),
        exposures_s=tuple(sorted({one.settings.exposure_s for one in situation.shown.frames})),
        budget=tuple(term.contribution(value) for term in terms),
        sequence=sequence,
        coverage_factor=coverage_factor(freedom),
        degrees_of_freedom=freedom,
        time=situation.now.astimezone(dt.UTC).isoformat(timespec="microseconds").replace("+00:00", "Z"),
        provenance=Provenance(
            "maximum-likelihood patch estimate",
            assumptions=(
                *settled.assumptions,
                *white_level_notes(one.settings.white_level for one in situation.shown.frames),
                *situation.shown.notes,
                *situation.notes_on_taps,
            ),
            parameters={
                "frames": situation.shown.light_frames,
                "frames_used": len(situation.shown.frames),
                "fluctuation_rel": estimate.fluctuation_rel,
            },
        ),
    )


def _with_luminance(reading: Reading, setup: Setup) -> Reading:
    """Return the reading with its band and the luminance of its radiance; relative or invisible light has none."""
    calibration = setup.calibration
    if calibration is None or not calibration.absolute:
        return reading
    reading = replace(reading, band_nm=spectrum_of(calibration.spectrum).band_nm)
    spectrum = spectrum_of(calibration.spectrum)
    if not holds_visible_light(spectrum):
        return reading
    efficacy, radiance = luminous_efficacy(spectrum), reading.radiance
    own = _luminance_u(reading, calibration, spectrum_stated=setup.spectrum_stated)
    of_scale = calibration.scale.spectrum or calibration.spectrum
    if calibration.scale.quantity == "radiance" or of_scale != calibration.spectrum:
        own = math.hypot(own, efficacy.u_rel * radiance.value)
    u = efficacy.value * own
    return replace(reading, luminance=Quantity(efficacy.value * radiance.value, u, LUMINANCE_UNIT))


def _luminance_u(reading: Reading, calibration: Calibration, *, spectrum_stated: bool) -> float:
    """Return u of the radiance, in its unit, as it counts for the luminance.

    The efficacy of an assumed spectrum stands between what the reference stated and what it did not: a luminance read
    by a scale from a luminance went through it twice, there and back. Light of any kind is off in luminance by another
    factor than in radiance.
    """
    value, stated = reading.radiance.value, calibration.uncertainties
    variance = reading.radiance.u**2
    if not spectrum_stated:
        here, there = (unstated_u_rel(calibration, stated, observer) for observer in ("photopic", None))
        variance += (here**2 - there**2) * value**2
    of_efficacy = stated.efficacy_u_rel * value
    if calibration.scale.quantity == "radiance":
        return math.sqrt(max(variance + of_efficacy**2, 0.0))
    return math.sqrt(max(variance - of_efficacy**2, 0.0))
