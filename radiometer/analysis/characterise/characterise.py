"""A camera's EMVA 1288 figures from its bright and dark frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from radiometer.analysis.characterise.dark_signal import (
    DarkSignal,
    by_temperature,
    dark_signal,
    determined,
    gain_from_darks,
    typical_dark_current,
    unbent,
    with_open_current,
)
from radiometer.analysis.characterise.group_statistics import GroupStatistics, dark_points
from radiometer.analysis.characterise.linearity import linearity
from radiometer.analysis.characterise.nonuniformity import best_stack, dsnu, nonuniformity_by_part, of_exposure, prnu
from radiometer.analysis.characterise.partial import (
    bent,
    disagreeing_gains,
    partial_characterisation,
    scattered,
    stated_gain_doubt,
)
from radiometer.analysis.characterise.photon_transfer import CLIPPED_SHARE, FewSteps, PhotonTransfer, photon_transfer
from radiometer.analysis.characterise.result import PLAUSIBLE_ETA_PERCENT, Characterisation
from radiometer.analysis.characterise.sensitivity import (
    Saturation,
    find_saturation,
    propagated,
    responsivity,
    sensitivity_figures,
)
from radiometer.analysis.characterise.steps import SignalStep, contradicting_darks, contradicting_steps, make_steps
from radiometer.analysis.characterise.subject import Subject
from radiometer.data import Quantity
from radiometer.errors import MeasurementError
from radiometer.numbers import lower_limit

_FEWEST_LEVELS = 3


def characterise(subject: Subject, statistics: Sequence[GroupStatistics] | None = None) -> Characterisation:
    """Return the figures of a camera with their standard uncertainties, as many as the frames determine.

    With pairs of bright frames at three levels or more and dark frames all of them; else those that can be had, with
    notes that say what is missing. Groups of frames that contradict all others are left out and named. Where frames
    of several gains are given, the figures hold at the gain nearest to 0 dB that has at least three bright steps, and K
    is given for every gain. Where several patches are given, the photon transfer takes all of them and the rest the
    largest one.

    Args:
        statistics: Their statistics where they are known already.

    Raises:
        MeasurementError: If the frames determine no figure at all, or show no shot noise.
        CaptureError: If a frame is unreadable.

    Source: EMVA Standard 1288, release 4.0 (linear).
    """
    statistics = subject.statistics() if statistics is None else statistics
    bright = [s for s in statistics if not s.settings.is_dark and s.settings.source_level > 0]
    dark = [s for s in statistics if s.settings.is_dark]
    lit = [s for s in bright if s.has_noise]
    kept, dark, named = _consistent(lit, dark)
    if named:
        subject = replace(subject, notes=(*subject.notes, *named))
    if not _complete(kept, dark):
        return partial_characterisation(subject, bright, kept, dark)
    try:
        gains = _characterised_gains(kept, dark, subject.camera.code_step_dn or 1)
    except FewSteps as few:
        if not few.used:
            raise
        subject = replace(subject, notes=(*subject.notes, str(few)))
        return partial_characterisation(subject, bright, [step.bright for step in few.used], dark)
    return _Work(subject, gains[0], {g.gain_db: g.transfer.K for g in sorted(gains, key=lambda g: g.gain_db)}).result()


def _complete(bright: Sequence[GroupStatistics], dark: Sequence[GroupStatistics]) -> bool:
    """Return whether one gain has three bright levels and dark frames with noise at a temperature of theirs."""
    return any(
        len({(b.settings.exposure_s, b.settings.source_level, b.photons) for b in bright if b.settings.gain_db == gain})
        >= _FEWEST_LEVELS
        and any(d.has_noise for d in dark if d.settings.gain_db == gain)
        for gain in {b.settings.gain_db for b in bright}
    )


def _consistent(
    bright: list[GroupStatistics], dark: list[GroupStatistics]
) -> tuple[list[GroupStatistics], list[GroupStatistics], list[str]]:
    """Return the groups without those that contradict all others, and a line for each of these."""
    top = max((b.mean_dn for b in bright), default=0.0)
    wrong, lines = list[GroupStatistics](), list[str]()
    for gain in sorted({d.settings.gain_db for d in dark}):
        own = [d for d in dark if d.settings.gain_db == gain]
        for region in sorted({d.region for d in own}):
            for plateau in by_temperature([d for d in own if d.region == region]):
                off = contradicting_darks(plateau, top)
                wrong += [group for group, _ in off]
                lines += [line for _, line in off]
    dark = [d for d in dark if d not in wrong]
    for gain, region in sorted({(b.settings.gain_db, b.region) for b in bright}):
        own = [b for b in bright if (b.settings.gain_db, b.region) == (gain, region)]
        fitting = [d for d in dark if d.settings.gain_db == gain and d.has_noise]
        if not fitting:
            continue
        try:
            contradicting = contradicting_steps(make_steps(own, fitting))
        except MeasurementError:
            continue  # no darks of its temperature: reported where the figures are made
        wrong += [step.bright for step, _ in contradicting]
        lines += [line for _, line in contradicting]
    return [b for b in bright if b not in wrong], dark, lines


@dataclass(frozen=True, slots=True)
class _AtGain:
    """The steps and the photon transfer of one gain; steps and saturation are those of the main region."""

    gain_db: float
    steps: tuple[SignalStep, ...]
    saturation: Saturation
    transfer: PhotonTransfer
    bright: tuple[GroupStatistics, ...]
    dark: tuple[GroupStatistics, ...]


def _characterised_gains(
    bright: Sequence[GroupStatistics], dark: Sequence[GroupStatistics], step_dn: int
) -> list[_AtGain]:
    """Return every gain that can be characterised, the one nearest to 0 dB first."""
    found, refused = list[_AtGain](), list[MeasurementError]()
    for gain in sorted({s.settings.gain_db for s in bright}, key=abs):
        lit, unlit = ([s for s in groups if s.settings.gain_db == gain] for groups in (bright, dark))
        try:
            found.append(_at_gain(gain, lit, unlit, step_dn))
        except MeasurementError as error:
            refused.append(error)
    if not found:
        raise refused[0] if refused else MeasurementError("there are no bright frames; open the shutter")
    return found


def _at_gain(gain_db: float, bright: list[GroupStatistics], dark: list[GroupStatistics], step_dn: int) -> _AtGain:
    steps = make_steps(bright, dark, step_dn)
    main = max({s.region: s for s in bright}.values(), key=lambda s: (s.pixels, s.mean_dn)).region
    own = tuple(s for s in steps if s.bright.region == main)
    saturation = find_saturation(own)
    return _AtGain(
        gain_db,
        own,
        saturation,
        photon_transfer(saturation.rising(steps), saturation.signal_dn, step_dn=step_dn),
        tuple(s for s in bright if s.region == main),
        tuple(s for s in dark if s.region == main),
    )


def _least_e(saturation: Saturation, K: Quantity) -> float:
    """Return how many electrons the brightest step shows at least, with a probability of 95 %."""
    shown = propagated(lambda dn, k: dn / k, "e-", Quantity(saturation.signal_dn, saturation.u_signal_dn, "DN"), K)
    return lower_limit(shown.value, shown.u)


@dataclass(frozen=True, slots=True)
class _Work:
    """Makes the result of one gain."""

    subject: Subject
    at: _AtGain
    gains: dict[float, Quantity]

    def result(self) -> Characterisation:
        K, camera = self.at.transfer.K, self.subject.camera
        groups = [one for one in by_temperature(self.at.dark) if any(d.has_noise for d in one)]
        plateaus = [(one, with_open_current(dark_signal(one, self._step_dn), one, K, camera)) for one in groups]
        # Bright frames are compared with darkness at their own temperature.
        bright_c = self.at.bright[0].settings.temperature_c or 0.0
        own = min(plateaus, key=lambda p: abs((p[1].temperature_c or 0.0) - bright_c))
        notes = list(self.subject.notes)
        figures = {"K": K, "mu_y_dark": own[1].mean_dn}
        figures |= self._sensitivity(own[1], notes)
        figures |= self._dark_current(own[1], [p[1] for p in plateaus], notes)
        figures |= self._nonuniformity(own[0])
        is_hidden = own[1].quantisation_limited
        figures = determined(figures, self.at.dark, notes, self._step_dn, is_hidden=is_hidden)
        from_darks = gain_from_darks(self.subject, self.at.dark)
        if from_darks is not None:
            figures["K_dark"] = from_darks[0]
            notes += disagreeing_gains(K, from_darks[0])
        if bent := [d.settings.exposure_s for d in own[0] if d not in unbent(own[0])]:
            notes.append(f"dark frames of {min(bent):g} s and longer are left out: their hot pixels are saturated")
        line = linearity(self.at.saturation.rising(self.at.steps), self.at.saturation.signal_dn)
        if line is not None:
            figures |= {"LE_min": line.LE_min, "LE_max": line.LE_max}
            if line.unsteady_light:
                notes.append(
                    f"light differs by {line.unsteady_light:.2g} % between the frames of a step, more than noise: "
                    "LE_min and LE_max contain it, and their uncertainty counts it; use steadier light"
                )
        self._warn(notes)
        return Characterisation(
            believed=camera,
            gain_db=self.at.gain_db,
            figures=figures,
            gains=self.gains,
            transfer=self.at.transfer,
            steps=self.at.steps,
            dark_points=dark_points(self.at.dark),
            linearity=line,
            notes=tuple(notes),
            provenance=self.subject.provenance("EMVA 1288 release 4.0, linear", notes),
            reference_temperature_c=own[1].temperature_c,
            limited_by=self._limited_by(),
        )

    @property
    def _step_dn(self) -> int:
        return self.subject.camera.code_step_dn or 1

    def _limited_by(self) -> str:
        """Return what ends the signal: pixels that pile up below the converter's end show the full well."""
        white = self.subject.white_levels.get(self.at.gain_db)
        is_below = white is not None and white.basis == "measured" and white.disagrees
        return "full well" if is_below else self.at.saturation.limited_by

    def _sensitivity(self, dark: DarkSignal, notes: list[str]) -> dict[str, Quantity]:
        figures: dict[str, Quantity] = {}
        eta = None
        K = self.at.transfer.K
        if self.at.bright[0].photons is not None:
            R = responsivity(self.at.steps, self.at.saturation, self.subject.photons_u_rel)
            eta = propagated(lambda r, k: 100 * r / k, "%", R, K)
            figures |= {"R": R, "eta": eta}
            low, high = PLAUSIBLE_ETA_PERCENT
            if not low <= eta.value <= high:
                notes.append(
                    f"the quantum efficiency of {eta.value:.3g} % is not plausible: check radiance, f-number, "
                    "transmittance, wavelength and pixel pitch"
                )
        saturation = self.at.saturation
        if saturation.plateau_dn is not None:
            # A full pixel holds dark electrons too, so only the black level is taken off.
            figures["mu_e_plateau"] = propagated(
                lambda top, black, k: (top - black) / k, "e-", saturation.plateau_dn, dark.mean_dn, K
            )
        sat_dn = Quantity(saturation.linear_signal_dn, saturation.u_linear_signal_dn, "DN")
        found = sensitivity_figures(
            K, dark.variance_dn2, sat_dn, eta, dark.noise_dn2, is_bound=dark.quantisation_limited
        )
        if not saturation.reached:
            notes.append(
                "saturation was not reached: saturation capacity, SNR_max, DR and linearity are left out or hold up to "
                f"{saturation.signal_dn:.0f} DN only. The saturation capacity is above "
                f"{_least_e(saturation, K):.3g} e- (95 %); take longer exposures"
            )
            keep = {"sigma_y_dark", "sigma_d", "mu_e_min", "mu_p_min"}
            found = {name: q for name, q in found.items() if name in keep}
        return figures | found

    def _dark_current(self, own: DarkSignal, plateaus: list[DarkSignal], notes: list[str]) -> dict[str, Quantity]:
        K, figures = self.at.transfer.K, dict[str, Quantity]()
        if own.mean_line is None or own.variance_line is None:
            notes.append("dark current needs dark frames at three exposures or more")
            return figures
        slope = Quantity(own.mean_line.slope, own.mean_line.u_slope, "DN/s")
        figures["mu_I_mean"] = propagated(lambda s, k: s / k, "e-/s", slope, K)
        slope = Quantity(own.variance_line.slope, own.variance_line.u_slope, "DN^2/s")
        figures["mu_I_var"] = propagated(lambda s, k: s / k**2, "e-/s", slope, K)
        return figures | typical_dark_current(self.at.dark, own.temperature_c, K, self._step_dn)

    def _nonuniformity(self, dark: Sequence[GroupStatistics]) -> dict[str, Quantity]:
        saturation = self.at.saturation.signal_dn
        if dark[0].split is None:
            return {}  # statistics without pictures
        chosen = [s for s in self.at.bright if s.clipped_share <= CLIPPED_SHARE] or list(self.at.bright)
        bright = best_stack(chosen, saturation, dark[0].mean_dn)
        signal_dn = next(step.signal_dn for step in self.at.steps if step.bright is bright)
        K, near = self.at.transfer.K, of_exposure(dark, bright.settings.exposure_s)
        return {
            "DSNU_1288": dsnu(near, K),
            "PRNU_1288": prnu(bright, dark, signal_dn),
            **nonuniformity_by_part(bright, dark, K, signal_dn),
        }

    def _warn(self, notes: list[str]) -> None:
        if self.at.gain_db != 0:
            notes.append(f"measured at {self.at.gain_db:g} dB; the conversion gain at 0 dB follows from nominal steps")
        notes += stated_gain_doubt(self.subject.camera.conversion_gain_e_per_dn, self.at.transfer.K, self.at.gain_db)
        if self.at.transfer.bend_u > 0:
            notes.append(bent(self.at.transfer))
        notes += scattered(self.at.transfer)
