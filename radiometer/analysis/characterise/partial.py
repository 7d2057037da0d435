"""Figures from frames that are too few for a whole characterisation: darks alone, one level of light, single frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from radiometer.analysis.characterise.dark_signal import (
    by_temperature,
    dark_signal,
    determined,
    gain_from_darks,
    level_at_0_s,
    open_current_u_dn,
    typical_dark_current,
    unbent,
    with_open_current,
)
from radiometer.analysis.characterise.group_statistics import GroupStatistics, dark_points, mean_temperature_c
from radiometer.analysis.characterise.nonuniformity import best_stack, dsnu, nonuniformity_by_part, of_exposure, prnu
from radiometer.analysis.characterise.photon_transfer import (
    CLIPPED_SHARE,
    PhotonTransfer,
    photon_transfer,
    transfer_of_few,
)
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.sensitivity import sensitivity_figures
from radiometer.analysis.characterise.steps import SignalStep, make_steps
from radiometer.analysis.characterise.subject import Subject
from radiometer.data import Quantity
from radiometer.errors import MeasurementError
from radiometer.numbers import with_u
from radiometer.statistics.model_choice import THREE_SIGMA, is_supported
from radiometer.units import gain_factor


def partial_characterisation(
    subject: Subject,
    bright: Sequence[GroupStatistics],
    lit: Sequence[GroupStatistics],
    dark: Sequence[GroupStatistics],
) -> Characterisation:
    """Return the figures that can be had, with notes that say what is missing for the others.

    Args:
        bright: Bright groups, single frames included.
        lit: Bright groups of two frames or more that do not contradict the others.

    Raises:
        MeasurementError: If no figure can be had.
    """
    gain_db = _gain(lit or dark or bright)
    lit = [b for b in lit if b.settings.gain_db == gain_db]
    dark = [d for d in dark if d.settings.gain_db == gain_db]
    notes = list(subject.notes)
    steps, transfer, K = _photon_transfer(lit, dark, notes, subject.camera.code_step_dn or 1)
    figures = {"K": K} if K is not None else {}
    main = _main_region([*lit, *dark, *bright])
    own_dark = [d for d in dark if d.region == main]
    from_darks = gain_from_darks(subject, own_dark) if own_dark else None
    if from_darks is not None:
        figures["K_dark"] = from_darks[0]
        notes += disagreeing_gains(K, from_darks[0])
    best = K or (from_darks[0] if from_darks else None)
    of_darks, is_hidden = _dark_figures(own_dark, best, subject, mean_temperature_c(lit), notes)
    figures |= of_darks | _nonuniformity([b for b in lit if b.region == main], own_dark, best)
    if "mu_y_dark" not in figures and subject.masked_dn:
        figures["mu_y_dark"] = _of_masked_rows(subject.masked_dn)
        notes.append("the black level is that of the masked rows")
    if not figures or (K is None and not own_dark and "mu_y_dark" not in figures):
        raise MeasurementError(_nothing(subject, bright, lit))
    figures = determined(figures, own_dark, notes, subject.camera.code_step_dn or 1, is_hidden=is_hidden)
    if not figures:
        raise MeasurementError(f"{subject.origin}: {notes[-1]}")
    if best is not None:
        notes += stated_gain_doubt(subject.camera.conversion_gain_e_per_dn, best, gain_db)
    return Characterisation(
        believed=subject.camera,
        gain_db=gain_db,
        figures=figures,
        gains={gain_db: best} if best is not None else {},
        transfer=transfer,
        steps=tuple(s for s in steps if s.bright.region == main),
        dark_points=dark_points(own_dark),
        linearity=None,
        notes=tuple(notes),
        provenance=subject.provenance("EMVA 1288 release 4.0, linear, in part", notes),
        reference_temperature_c=mean_temperature_c(own_dark),
        limited_by="unknown",
    )


def bent(transfer: PhotonTransfer) -> str:
    """Return the note for a photon transfer that bends: the local gains at its two ends."""
    low, high = transfer.local
    return (
        f"the photon transfer bends: the local gain goes from {low:.3g} to {high:.3g} DN/e⁻. One K does not describe "
        "this sensor; the U of K covers that range"
    )


def scattered(transfer: PhotonTransfer) -> list[str]:
    """Return a note where the points of a photon transfer scatter by more than their noise."""
    if not transfer.line.scatters:
        return []
    return [
        f"the photon transfer scatters {transfer.line.birge_ratio:.1f} times more than noise alone (unsteady light or "
        "a sensor that is not linear); the uncertainty of K is widened by that"
    ]


def disagreeing_gains(K: Quantity | None, K_dark: Quantity) -> list[str]:
    """Return a note on how the gain from darks compares with that from light; none where there is no light."""
    if K is None:
        return ["the gain is that of the dark current's shot noise: there are no pairs of bright frames"]
    distance = abs(K.value - K_dark.value) / math.hypot(K.u, K_dark.u)
    word = "differs from" if is_supported(distance**2, THREE_SIGMA) else "agrees with"
    return [
        f"the gain from dark frames, {K_dark.text(with_k=True)}, {word} that from light, "
        f"{K.text(with_k=True)} ({distance:.1f} u)"
    ]


def stated_gain_doubt(stated_e_per_dn: float | None, K: Quantity, gain_db: float) -> list[str]:
    """Return a note where the conversion gain that a header or description states is off by 3 u or more."""
    if stated_e_per_dn is None:
        return []
    measured, u = gain_factor(gain_db) / K.value, gain_factor(gain_db) / K.value * K.u_rel
    if not is_supported(((stated_e_per_dn - measured) / u) ** 2, THREE_SIGMA):
        return []
    off = 100.0 * (stated_e_per_dn / measured - 1.0)
    return [
        f"conversion_gain_error: stated are {stated_e_per_dn:.4g} e⁻/DN, the noise says "
        f"{with_u(measured, 2.0 * u, k=2)}: the statement is off by {off:+.1f} %"
    ]


def _gain(groups: Sequence[GroupStatistics]) -> float:
    gains = [g.settings.gain_db for g in groups]
    return max(sorted(set(gains), key=abs), key=gains.count, default=0.0)


def _main_region(groups: Sequence[GroupStatistics]) -> int:
    return max(groups, key=lambda s: (s.pixels, s.mean_dn)).region if groups else 0


def _photon_transfer(
    lit: Sequence[GroupStatistics], dark: Sequence[GroupStatistics], notes: list[str], step_dn: int
) -> tuple[list[SignalStep], PhotonTransfer | None, Quantity | None]:
    if not lit:
        return [], None, None
    if any(d.has_noise for d in dark):
        try:
            steps = make_steps(lit, dark, step_dn)
        except MeasurementError as error:
            notes.append(str(error))
            return [], None, None
        K = transfer_of_few(steps)
        if K is not None:
            levels = len({s.light for s in steps})
            notes.append(
                f"the gain comes from {levels} level{'s' if levels > 1 else ''} of light: no linearity, no saturation, "
                "and a bend of the photon transfer would not show (2 % is kept for it)"
            )
        return steps, None, K
    return _without_darks(lit, notes)


def _without_darks(
    lit: Sequence[GroupStatistics], notes: list[str]
) -> tuple[list[SignalStep], PhotonTransfer | None, Quantity | None]:
    """Return K from a free line of variance over mean: the black level falls out of its slope."""
    steps = [
        SignalStep(b, b.settings.exposure_s if b.photons is None else b.photons, 0.0, 0.0, 0.0, 0.0)
        for b in sorted(lit, key=lambda b: b.mean_dn)
    ]
    top = max(steps, key=lambda s: s.bright.variance_dn2)
    try:
        transfer = photon_transfer(steps, top.signal_dn, free=True)
    except MeasurementError as error:
        notes.append(f"no gain without dark frames: {error}")
        return [], None, None
    notes.append(
        "no dark frames: the gain is the slope of a free line, and black level, read noise and saturation capacity "
        "do not follow from it"
    )
    notes += scattered(transfer)
    if transfer.bend_u > 0:
        notes.append(bent(transfer))
    full = [s for s in steps if s.bright.clipped_share > CLIPPED_SHARE]
    if full:
        notes.append(f"pixels clip at the highest code in {len(full)} of {len(steps)} settings: these are left out")
    return steps, transfer, transfer.K


def _dark_figures(
    dark: Sequence[GroupStatistics],
    K: Quantity | None,
    subject: Subject,
    temperature_c: float | None,
    notes: list[str],
) -> tuple[dict[str, Quantity], bool]:
    """Return the figures of darks, and whether rounding hides their noise."""
    figures, is_hidden = dict[str, Quantity](), False
    if not dark:
        return figures, is_hidden
    step_dn = subject.camera.code_step_dn or 1
    noisy = [p for p in by_temperature(dark) if any(d.has_noise for d in p)]
    if noisy:
        reference_c = -273.0 if temperature_c is None else temperature_c
        own = min(noisy, key=lambda p: abs((mean_temperature_c(p) or 0.0) - reference_c))
        signal = with_open_current(dark_signal(own, step_dn), own, K, subject.camera)
        temperature_c = signal.temperature_c
        figures["mu_y_dark"] = signal.mean_dn
        figures["sigma_y_dark"] = Quantity(
            math.sqrt(signal.variance_dn2.value), signal.variance_dn2.u / 2 / math.sqrt(signal.variance_dn2.value), "DN"
        )
        is_hidden = signal.quantisation_limited
        if K is not None:
            found = sensitivity_figures(K, signal.variance_dn2, None, None, signal.noise_dn2, is_bound=is_hidden)
            figures |= {name: found[name] for name in ("sigma_d", "mu_e_min")}
            if signal.mean_line is not None:
                line = signal.mean_line
                u = math.hypot(line.u_slope, line.slope * K.u_rel) / K.value
                figures["mu_I_mean"] = Quantity(line.slope / K.value, u, "e-/s")
    else:
        coldest = by_temperature(unbent(dark))[0]
        level, u_open = level_at_0_s(coldest, step_dn)[0], open_current_u_dn(coldest, K, subject.camera)
        figures["mu_y_dark"] = Quantity(level.value, math.hypot(level.u, u_open), "DN")
        notes.append("no two dark frames of one setting: no temporal dark noise")
    figures |= typical_dark_current(dark, temperature_c, K, step_dn)
    if len({d.settings.exposure_s for d in dark}) < 2:
        notes.append("dark current needs dark frames at two exposures or more")
    return figures, is_hidden


def _nonuniformity(
    lit: Sequence[GroupStatistics], dark: Sequence[GroupStatistics], K: Quantity | None
) -> dict[str, Quantity]:
    stacks = [d for d in dark if d.has_noise and d.split is not None]
    if not stacks:
        return {}
    below = max(stacks, key=lambda d: (d.frames, -d.settings.exposure_s))
    clear = [b for b in lit if b.clipped_share <= CLIPPED_SHARE and b.split is not None]
    bright = best_stack(clear, max(b.mean_dn for b in clear), below.mean_dn) if clear else None
    figures = {"DSNU_1288": dsnu(below, K)} if K is not None else {}
    if bright is not None:
        near = of_exposure(stacks, bright.settings.exposure_s)
        alike, signal_dn = next(one for one in by_temperature(stacks) if near in one), bright.mean_dn - near.mean_dn
        figures["PRNU_1288"] = prnu(bright, alike, signal_dn)
        return figures | nonuniformity_by_part(bright, alike, K, signal_dn)
    return figures | nonuniformity_by_part(None, [below], K)


def _of_masked_rows(masked_dn: Sequence[float]) -> Quantity:
    spread = float(np.std(masked_dn, ddof=1)) if len(masked_dn) > 1 else 1.0
    return Quantity(float(np.mean(masked_dn)), max(spread, 1 / math.sqrt(12)), "DN")


def _nothing(subject: Subject, bright: Sequence[GroupStatistics], lit: Sequence[GroupStatistics]) -> str:
    single = next((b for b in bright if not b.has_noise), None)
    if single is not None and not lit:
        return (
            f"{subject.origin}: only one frame at exposure {single.settings.exposure_s:g} s ({single.settings.shutter} "
            "shutter): temporal noise needs two frames at every setting; capture with --repeat 2"
        )
    return (
        f"{subject.origin}: holds no dark frames and fewer than three levels of light; capture both "
        "(radiometer bracket --repeat 2 --darks 2)"
    )
