"""Digital numbers to a signal proportional to light: noise, dark level, found effects, and the patch in each frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from radiometer.analysis.signal.rounding import SHEPPARD, rounding_u_of_light, rounding_u_of_mean
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    FoundEffects,
    Frame,
    FrameSettings,
    Patch,
    ResponseCurve,
    SensorNoise,
)
from radiometer.data.code_step import code_step_of
from radiometer.data.frame import DigitalNumbers
from radiometer.data.sensor_noise import U_UNKNOWN_WARMTH_REL, most_dark_e_per_s, u_warmth_rel, warmer
from radiometer.errors import CalibrationError, MeasurementError
from radiometer.statistics.model_choice import THREE_SIGMA, is_supported
from radiometer.statistics.scale import TWENTIETH_TO_SIGMA, neighbour_sigma, robust_sigma, typical_pixels
from radiometer.units import gain_factor

# A full well is where charge stops; linearity and the datasheet's figure end a little before.
USABLE_FULL_WELL = 0.97
_SAME_EXPOSURE_REL = 0.01
_TWO_SIDED = 0.97725  # of a normal distribution, two standard deviations to either side
_OTHER_EXPOSURE_REL = 0.05  # dark frames that differ by less say nothing of the dark current
_DARKER_SIGMAS = 5.0  # of one pixel: no middle of a picture is so far below its dark level
_DARK_SIGMAS = 2.0  # of that level, whose causes have limits: the most by k = 2
_AS_WARM_K = 3.0  # beyond that a pixel's dark current no longer follows that of the others
_OTHER = "dark frames of other exposures"
_OTHER_WARMTH = "dark frames of unknown warmth"
_DARKEST_PERCENTILE = 5.0  # of a frame: its dark signal is not above that of its darkest pixels, hot ones left out
# Masked pixels against those next to them: half a digital number (a rectangle), and a tenth of the modelled dark
# signal.
_MASKED_U_DN = 0.29
_MASKED_U_REL = 0.1
_ROUNDS = 12  # each leaves a part a₂ of the error, some per cent
# A patch counts as unclipped where its mean stays this many standard deviations of its pixels below clipping.
_CLEAR_OF_CLIPPING_SIGMA = 4.0
# Particles strike fewer pixels of a frame than this: where more clip in one frame alone, the light changes.
_STRUCK_SHARE = 0.01
_HOT_SIGMAS = 10.0  # of the noise of dark frames: pixels that far above their middle are hot
# Dark frames with more of their pixels at 0 have their noise cut off there: its mean is above the black level.
FLOOR_SHARE = 0.01
_LEAST_ROUNDING_DN = 1e-3  # noise of half a number leaves less, which is none next to any black level's u
_HEADROOM_SIGMAS = 4.0  # of its noise above 0: there a black level keeps it whole
# So many pixels of the whole picture give its mean.
_PIXELS_OF_THE_WHOLE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class SignalModel:
    """The linear signal x = f(M) behind every digital number M, zero at the black level, at gain 0 dB."""

    # x, shape (2**bit_depth,): exp(g) with a response curve, M − black without; negative below black
    signal: NDArray[np.float64]
    slope: NDArray[np.float64]  # dx/dM, same shape
    u_rel: NDArray[np.float64]  # relative standard uncertainty of x, same shape
    valid_dn: tuple[int, int]  # digital numbers inside which x rests on data
    black_dn: float  # black level in DN that the table holds for
    electrons_per_unit: float  # electrons per unit of x
    noise: SensorNoise  # noise model of the sensor
    camera: CameraDescription  # the camera
    linear: bool  # true without a response curve
    saturation_known: bool  # whether the full well is known rather than typical

    @property
    def full_scale_dn(self) -> int:
        """Return the highest digital number."""
        return int(self.signal.size - 1)

    @property
    def code_variance_dn2(self) -> float:
        """Return the variance in DN² of rounding and of what else arises behind the response curve.

        What was measured with a curve holds the rounding of padded codes already.
        """
        return max((self.camera.code_step_dn or 1) ** 2 * SHEPPARD, self.noise.code_variance_dn2)

    def saturation_dn(self, settings: FrameSettings, *, within_data: bool = True) -> float:
        """Return the digital number from which a frame clips: its white level, or the full well's end if lower.

        Args:
            within_data: Count numbers above those that the response curve has data for as clipped too.
        """
        white = settings.white_level
        end = float(self.full_scale_dn if white is None else min(self.full_scale_dn, white.saturated_dn))
        if not self.linear and within_data:
            return min(end, self.valid_dn[1] + 1.0)
        if not (self.linear and self.saturation_known):
            return end
        black = self.black_of(settings)
        well = black + USABLE_FULL_WELL * self.noise.full_well_e * self.noise.gain_dn_per_e(settings.gain_db)
        return min(end, well)

    def black_of(self, settings: FrameSettings) -> float:
        """Return the black level in DN of a frame: its own where it states one."""
        return self.black_dn if settings.black_level_dn is None else settings.black_level_dn

    def table(self, settings: FrameSettings) -> NDArray[np.float64]:
        """Return x at 0 dB for every digital number of a frame with its own black level and gain."""
        shift = self.black_of(settings) - self.black_dn
        gain = gain_factor(settings.gain_db)
        if shift == 0.0:
            return self.signal / gain
        dn = np.arange(self.signal.size, dtype=np.float64)
        if self.linear:
            return (self.signal - shift) / gain
        return np.interp(dn - shift, dn, self.signal) / gain

    def at_dn(self, values: NDArray[np.float64], dn: ArrayLike) -> NDArray[np.float64]:
        """Return a table's value at (fractional) digital numbers, held at its ends."""
        return np.interp(np.asarray(dn, dtype=np.float64), np.arange(values.size), values)

    def dn_of(self, signal: ArrayLike, settings: FrameSettings) -> NDArray[np.float64]:
        """Return the expected digital number of a signal x at 0 dB in a frame."""
        effective = np.asarray(signal, dtype=np.float64) * gain_factor(settings.gain_db)
        shift = self.black_of(settings) - self.black_dn
        return np.interp(effective, self.signal, np.arange(self.signal.size)) + shift

    def curve_u_rel(self, signal: float, settings: FrameSettings) -> float:
        """Return the response curve's relative standard uncertainty at an expected signal x at 0 dB of a frame."""
        return float(self.at_dn(self.u_rel, self.dn_of(signal, settings) - self.black_of(settings) + self.black_dn))

    def variance(self, signal: ArrayLike, settings: FrameSettings) -> NDArray[np.float64]:
        """Return the expected variance of one sample of x: shot, read, dark current and quantisation noise.

        Args:
            signal: Expected x at 0 dB from light, any shape; below 0 counts as 0.

        Source: EMVA Standard 1288, release 4.0, equations (6)–(13), carried through the response to x.
        """
        light = np.maximum(np.asarray(signal, dtype=np.float64), 0.0)
        dark_e = self.noise.dark_e(settings.exposure_s, settings.temperature_c)
        electrons = light * self.electrons_per_unit + self.noise.read_noise_e**2 + dark_e
        slope = self.at_dn(self.slope, self.dn_of(light, settings)) / gain_factor(settings.gain_db)
        return np.asarray(electrons / self.electrons_per_unit**2 + slope**2 * self.code_variance_dn2)

    def modelled_dark(self, settings: FrameSettings) -> float:
        """Return the signal x that the modelled dark current makes in a frame."""
        return self.noise.dark_e(settings.exposure_s, settings.temperature_c) / self.electrons_per_unit


def signal_model(
    camera: CameraDescription,
    response: ResponseCurve | None,
    noise: SensorNoise,
    black_dn: float,
    linearity_u_rel: float = 0.0,
) -> SignalModel:
    """Return the signal model of a camera.

    A response curve in the logarithm cannot hold zero or less, so below its lowest well-known value it goes
    on as the straight line to zero at the black level. Without that a dark patch would be read too bright.

    Args:
        response: Its response curve; None takes the sensor as linear above black.
        linearity_u_rel: Relative standard uncertainty of a signal where the sensor is taken as linear.

    Raises:
        CalibrationError: If curve and camera differ in bit depth, or the curve has no usable part above black.
    """
    dn = np.arange(camera.full_scale_dn + 1, dtype=np.float64)
    known = "full_well_e" not in noise.assumed
    if response is None:
        return SignalModel(
            dn - black_dn,
            np.ones_like(dn),
            np.full_like(dn, linearity_u_rel),
            (0, camera.full_scale_dn),
            black_dn,
            noise.conversion_gain_e_per_dn,
            noise,
            camera,
            linear=True,
            saturation_known=known,
        )
    if response.bit_depth != camera.bit_depth:
        raise CalibrationError(
            f"the response curve has {response.bit_depth} bits, the frames {camera.bit_depth}; "
            "use a curve recovered from frames of the same pixel format"
        )
    signal, u_rel, valid = _through_black(response, black_dn)
    top = min(valid[1], camera.full_scale_dn)
    per_unit = noise.conversion_gain_e_per_dn * (top - black_dn) / signal[top]
    return SignalModel(
        signal,
        np.gradient(signal),
        u_rel,
        valid,
        black_dn,
        float(per_unit),
        noise,
        camera,
        linear=False,
        saturation_known=known,
    )


def _through_black(
    response: ResponseCurve, black_dn: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, int]]:
    """Return signal, its relative uncertainty and valid range, with the line to the black level below that range."""
    g, u = response.log_exposure, np.array(response.u_log_exposure)
    finite = np.flatnonzero(np.isfinite(g))
    low, high = response.valid_dn or (int(finite[0]), int(finite[-1]))
    low, high = max(low, int(finite[0]), int(np.floor(black_dn)) + 1), min(high, int(finite[-1]))
    if low >= high:
        raise CalibrationError(
            f"the response curve has no usable part above the black level {black_dn:g} DN; "
            "recover it from frames with this black level"
        )
    dn = np.arange(g.size, dtype=np.float64)
    filled = np.interp(dn, finite, g[finite])
    signal = np.exp(filled)
    line = signal[low] * (dn - black_dn) / (low - black_dn)
    signal = np.where(dn < low, line, signal)
    u = np.where(np.isfinite(u), u, 1.0)
    u[:low] = u[low]
    return signal, u, (low, high)


@dataclass(frozen=True, slots=True)
class DarkLevel:
    """Dark signal of one light frame in the unit of x at 0 dB."""

    signal: float  # expected dark signal
    # Standard uncertainty that this frame's dark level has for itself; frames of its exposure share its dark frames
    u_independent: float
    u_common: float  # standard uncertainty shared with all other frames
    source: str  # "dark frames", "masked pixels" or "black level"
    u_unstated: float = 0.0  # part of `u_common` that a dark current makes which nothing states
    # Whether one dark frame alone gives it: the lights of its exposure then show how far such frames scatter
    is_single: bool = False
    black: float = 0.0  # the part of `signal` that no warmth changes
    variance: float = 0.0  # of a pixel's x by shot noise of dark current that dark frames show and nothing states


def dark_levels(
    settings: Sequence[FrameSettings],
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
    masked_dn: Sequence[float | None] = (),
    darkest: Sequence[float] = (),
) -> list[DarkLevel]:
    """Return the dark level of every light frame.

    A dark frame of the same exposure and gain is used, with its dark signal as at the light frame's temperature. So are
    masked pixels of the frame itself, as they are. Dark
    frames of other exposures correct the black level, with the modelled dark current taken off theirs. Without any,
    or where they show it less well than it is stated, black level and model stand alone. Of dark frames that are cut
    off at 0 the mean is the most that the dark signal can be.

    Args:
        masked_dn: What masked pixels read in every light frame in DN, where known.
        darkest: Signal x of the darkest pixels of every light frame: no dark signal is above it.
    """
    masked, most = masked_dn or (None,) * len(settings), darkest or (math.inf,) * len(settings)
    return [
        _level(one, dark_frames, model, black, dn, least) for one, dn, least in zip(settings, masked, most, strict=True)
    ]


def _level(
    settings: FrameSettings,
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
    masked_dn: float | None,
    darkest: float,
) -> DarkLevel:
    if matching := matching_darks(settings, dark_frames):
        return _from_matching(settings, matching, dark_frames, model, black, darkest)
    if masked_dn is not None:
        return _from_masked(settings, masked_dn, model)
    same_gain = [frame for frame in dark_frames if frame.settings.gain_db == settings.gain_db]
    if whole := [frame for frame in same_gain if not is_cut_off(frame)]:
        shown = _from_other_exposures(settings, whole, model, black, darkest)
        if settings.black_level_dn is None and model.camera.black_level_dn is None:
            return shown
        stated = _from_model(settings, model, black, darkest)
        return min(shown, stated, key=lambda one: math.hypot(one.u_independent, one.u_common))
    level = _from_model(settings, model, black, darkest)
    if not same_gain:
        return level
    nearest = min(same_gain, key=lambda frame: abs(math.log(frame.settings.exposure_s / settings.exposure_s)))
    # Over [0, most] the root mean square distance from the end is most/√3.
    u_cut = max(float(signal_of(nearest, model, settings).mean()) - level.signal, 0.0) / math.sqrt(3.0)
    return replace(level, u_common=math.hypot(level.u_common, u_cut))


def is_cut_off(frame: Frame) -> bool:
    """Return whether the camera cuts a dark frame's noise off at 0, so that its mean is above its black level.

    Pixels at 0 that are far below the others are dead.
    """
    if float(np.mean(frame.dn == 0)) <= FLOOR_SHARE:
        return False
    return bool(np.median(frame.dn) <= _HEADROOM_SIGMAS * robust_sigma(frame.dn))


def refuse_brighter_darks(
    settings: FrameSettings, middle: float, dark: float, u_dark: float, model: SignalModel
) -> None:
    """Refuse dark frames that are brighter than a light frame: their dark signal is not that of its exposure.

    Args:
        middle: Its signal in the middle of its pixels.
        dark: Dark signal that the dark frames show for it.

    Raises:
        MeasurementError: If they are.
    """
    if middle < dark - _DARKER_SIGMAS * math.sqrt(float(model.variance(0.0, settings))) - _DARK_SIGMAS * u_dark:
        raise MeasurementError(
            f"the light frame of {settings.exposure_s:g} s is darker than the dark frames show for it; take dark "
            "frames of its exposure and temperature, or of two exposures"
        )


def matching_darks(settings: FrameSettings, dark_frames: Sequence[Frame]) -> list[Frame]:
    """Return the dark frames of the same exposure and gain, and within 3 K where temperatures are known; none is cut
    off at 0.
    """
    return [
        frame
        for frame in dark_frames
        if abs(frame.settings.exposure_s / settings.exposure_s - 1.0) <= _SAME_EXPOSURE_REL
        and frame.settings.gain_db == settings.gain_db
        and _as_warm(frame.settings.temperature_c, settings.temperature_c)
        and not is_cut_off(frame)
    ]


def _as_warm(one_c: float | None, other_c: float | None) -> bool:
    return one_c is None or other_c is None or abs(one_c - other_c) <= _AS_WARM_K


def _from_matching(
    settings: FrameSettings,
    matching: list[Frame],
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
    darkest: float,
) -> DarkLevel:
    """Return the dark level that dark frames of the same exposure show, as at the light frame's temperature."""
    zero, u_zero = _without_dark_current(settings, matching, dark_frames, model, black)
    level = _from_frames(settings, matching, model, darkest, zero)
    factor = float(np.mean([_warmer(settings, frame, model) for frame in matching]))
    u_rel = _u_warmth_rel(settings, matching, model)
    most, shown = max(_most_dark(settings, model), model.modelled_dark(settings)), max(level.signal - zero, 0.0)
    u = math.hypot(u_rel * min(math.hypot(shown, u_zero), most), (factor - 1.0) * u_zero)
    beyond = max(shown - 2.0 * u_zero, 0.0)  # what the black level does not explain
    variance = _unstated_shot_noise(min(beyond, most), settings, model)
    return replace(
        level,
        u_independent=math.hypot(level.u_independent, math.sqrt(variance / sum(one.dn.size for one in matching))),
        u_common=math.hypot(level.u_common, u),
        source=_OTHER_WARMTH if u_rel == U_UNKNOWN_WARMTH_REL else level.source,
        black=zero,
        variance=variance,
    )


def _unstated_shot_noise(dark: float, settings: FrameSettings, model: SignalModel) -> float:
    """Return the variance of x by the shot noise of dark signal beyond the modelled, which `variance` holds."""
    return max(dark - model.modelled_dark(settings), 0.0) / model.electrons_per_unit


def _without_dark_current(
    settings: FrameSettings,
    matching: list[Frame],
    dark_frames: Sequence[Frame],
    model: SignalModel,
    black: BlackLevel,
) -> tuple[float, float]:
    """Return the signal x of a light frame without light and dark current, and its standard uncertainty.

    It is 0 where the black level is known. Dark frames of several exposures show it; else the dark current is as
    stated, or as great as it may be.
    """
    slope = float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db)
    if settings.black_level_dn is not None or model.camera.black_level_dn is not None or black.dn > 0.0:
        return 0.0, slope * black.u_dn
    same_gain = [one for one in dark_frames if one.settings.gain_db == settings.gain_db and not is_cut_off(one)]
    if (line := unexposed_dn(*mean_darks(same_gain))) is not None:
        return float(model.at_dn(model.table(settings), line[0])), slope * line[1] * black.u_dn
    level = float(np.mean([signal_of(one, model, settings).mean() for one in matching]))
    if "dark_current_e_per_s" not in model.noise.assumed:
        part = min(model.modelled_dark(settings), level)
        return level - part, black.dark_u_rel * part
    part = min(_most_dark(settings, model), level) / 2.0
    return level - part, part


def warmed_signal(frame: Frame, settings: FrameSettings, model: SignalModel, black: float) -> NDArray[np.float64]:
    """Return the signal x of every pixel of a dark frame as at a light frame's temperature; `black` does not change."""
    signal, factor = signal_of(frame, model, settings), _warmer(settings, frame, model)
    return signal if factor == 1.0 else black + factor * (signal - black)


def _warmer(settings: FrameSettings, frame: Frame, model: SignalModel) -> float:
    """Return the dark current of a light frame over that of a dark frame; 1 where a temperature is not stated."""
    return warmer(settings.temperature_c, frame.settings.temperature_c, model.noise.dark_doubling_k)


def _u_warmth_rel(settings: FrameSettings, frames: Sequence[Frame], model: SignalModel) -> float:
    there_c = [frame.settings.temperature_c for frame in frames]
    return u_warmth_rel(settings.temperature_c, there_c, model.noise.dark_doubling_k)


def _from_frames(
    settings: FrameSettings, frames: list[Frame], model: SignalModel, darkest: float, black: float = 0.0
) -> DarkLevel:
    means, count = [], 0
    for frame in frames:
        means.append(float(warmed_signal(frame, settings, model, black).mean()))
        count += frame.dn.size
    sigma = float(np.sqrt(model.variance(0.0, settings) / count))
    if (freedom := len(means) - 1) > 0:  # black levels wander from frame to frame, beyond what noise leaves in a mean
        wander = max(float(np.var(means, ddof=1)) - len(means) * sigma**2, 0.0) / len(means)
        sigma = math.hypot(sigma, math.sqrt(wander) * float(special.stdtrit(freedom, _TWO_SIDED)) / 2.0)
    level = float(np.mean(means))
    u_common = _u_of_rounding(settings, frames, model, darkest - level)
    return DarkLevel(level, sigma, u_common, "dark frames", is_single=len(frames) == 1)


def _u_of_rounding(settings: FrameSettings, frames: Sequence[Frame], model: SignalModel, least: float) -> float:
    """Return what rounding to whole codes leaves in light less dark, in x: an error that all pixels and frames share.

    Args:
        least: Signal x of the least light of the frame, whose shot noise spreads the pixels over the codes; inf where
            it is not known.
    """
    some = np.concatenate([frame.dn.ravel()[:: max(1, frame.dn.size // _PIXELS_OF_THE_WHOLE)] for frame in frames])
    low, high = np.percentile(some, (1.0, 99.0))  # defects are no noise
    variance_dn2 = float(np.var(some[(some >= low) & (some <= high)]))
    slope = float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db)
    known = math.isfinite(least) and "conversion_gain_e_per_dn" not in model.noise.assumed
    shot_dn2 = max(least, 0.0) / model.electrons_per_unit / slope**2 if known else 0.0
    step_dn = model.camera.code_step_dn or 1
    u_dn = math.hypot(rounding_u_of_mean(variance_dn2, step_dn), rounding_u_of_light(variance_dn2, shot_dn2, step_dn))
    return slope * u_dn if u_dn > _LEAST_ROUNDING_DN else 0.0


def with_found_code_step(model: SignalModel, light: Iterable[DigitalNumbers]) -> SignalModel:
    """Return a model with the distance between the numbers that frames hold, where they do not show the stated one.

    Args:
        light: Digital numbers of pixels of frames, light ones among them; any shape.
    """
    some = (dn.ravel()[:: max(1, dn.size // _PIXELS_OF_THE_WHOLE)] for dn in light)
    step_dn = code_step_of(some, model.camera.code_step_dn)
    if step_dn == (model.camera.code_step_dn or 1):
        return model
    return replace(model, camera=model.camera.model_copy(update={"code_step_dn": step_dn}))


def _from_masked(settings: FrameSettings, masked_dn: float, model: SignalModel) -> DarkLevel:
    """Return the dark signal that masked pixels show; they are not the pixels that see light, and differ a little."""
    signal = float(model.at_dn(model.table(settings), masked_dn))
    step = float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db)
    u = math.hypot(_MASKED_U_DN * step, _MASKED_U_REL * model.modelled_dark(settings))
    return DarkLevel(signal, 0.0, u, "masked pixels")


def _from_other_exposures(
    settings: FrameSettings, frames: list[Frame], model: SignalModel, black: BlackLevel, darkest: float
) -> DarkLevel:
    """Return the dark signal that dark frames of other exposures or temperatures show.

    The dark signal is a straight line over time. A stated black level is its value at zero, and two exposures or more
    show it as well. One exposure corrects the black level too, with the modelled dark current: whichever is known
    better counts.
    """
    measured = [_from_frames(frame.settings, [frame], model, darkest) for frame in frames]
    times = np.array([seconds_at_reference(frame.settings, model) for frame in frames])
    signals = np.array([level.signal for level in measured])
    u_rel = _u_warmth_rel(settings, frames, model)
    line, here = list[DarkLevel](), seconds_at_reference(settings, model)
    u_zero = _u_of_stated_black(settings, model, black)
    if np.ptp(times) > _OTHER_EXPOSURE_REL * times.max():
        start = _from_line(replace(settings, exposure_s=0.0), frames, model, measured, None, 0.0)
        # A black level that these frames contradict was another one.
        if u_zero is not None and is_supported(start.signal**2 / (start.u_common**2 + u_zero**2), THREE_SIGMA):
            u_zero = None
        return _from_line(settings, frames, model, measured, u_zero, u_rel)
    if u_zero is not None:
        line = [_from_line(settings, frames, model, measured, u_zero, u_rel)]
    noise = float(np.sqrt(np.sum([level.u_independent**2 for level in measured]))) / len(frames)
    rounding = max(level.u_common for level in measured)
    modelled = [model.modelled_dark(frame.settings) for frame in frames]
    offset = float(np.mean(signals - np.array(modelled)))
    dark = model.modelled_dark(settings)
    there, u_unstated = float(np.mean(modelled)), 0.0
    u_rate = math.hypot(black.dark_u_rel * (dark - there), u_rel * there)
    if "dark_current_e_per_s" in model.noise.assumed:
        apart_s = here - float(times.mean())
        # Shorter dark frames lack dark signal, up to all that the darkest pixels show; longer ones have too much, up to
        # all of theirs.
        most = (darkest - offset) * apart_s / here if apart_s > 0 else offset
        u_rate = u_unstated = _unknown_dark_u(replace(settings, exposure_s=abs(apart_s)), model, most)
    by_model = DarkLevel(dark + offset, 0.0, math.hypot(noise, u_rate, rounding), _OTHER, u_unstated)
    return min([by_model, *line], key=lambda one: one.u_common)


def _u_of_stated_black(settings: FrameSettings, model: SignalModel, black: BlackLevel) -> float | None:
    """Return the standard uncertainty of a stated black level in x of a light frame; None where nothing states one."""
    if settings.black_level_dn is None and model.camera.black_level_dn is None and not black.dn > 0.0:
        return None
    return float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db) * black.u_dn


def _from_line(
    settings: FrameSettings,
    frames: Sequence[Frame],
    model: SignalModel,
    measured: Sequence[DarkLevel],
    u_zero: float | None,
    u_warmth: float,
) -> DarkLevel:
    """Return the dark signal of a light frame on the straight line over time, extrapolated with its uncertainty.

    Args:
        measured: What each dark frame shows.
        u_zero: Standard uncertainty of the black level, which is 0; None where it is not stated.
        u_warmth: Relative standard uncertainty of the dark current by temperatures.
    """
    times = np.array([seconds_at_reference(frame.settings, model) for frame in frames])
    signals, here = np.array([level.signal for level in measured]), seconds_at_reference(settings, model)
    rounding = max(level.u_common for level in measured)
    own = np.array([math.hypot(level.u_independent, level.u_common) for level in measured])
    sizes, rate = np.array([frame.dn.size for frame in frames]), 0.0
    if u_zero is not None:
        times, signals = np.append(times, 0.0), np.append(signals, 0.0)
    for _ in range(2):  # the dark current's shot noise follows from the line itself
        dark = rate * times[: own.size]
        shot = [_unstated_shot_noise(one, frame.settings, model) for one, frame in zip(dark, frames, strict=True)]
        u = np.hypot(own, np.sqrt(np.array(shot) / sizes))
        u = np.maximum(u if u_zero is None else np.append(u, u_zero), 1e-9)
        weights = u**-2.0 / np.sum(u**-2.0)
        middle = float(weights @ times)
        spread = float(weights @ (times - middle) ** 2)
        rate = float(weights @ ((times - middle) * signals)) / spread
    level = float(weights @ signals) + rate * (here - middle)
    lacking = signals - float(weights @ signals) - rate * (times - middle)
    birge = math.sqrt(float(np.sum((lacking / u) ** 2)) / max(times.size - 2, 1))
    u_line = max(birge, 1.0) * math.sqrt((1.0 + (here - middle) ** 2 / spread) / float(np.sum(u**-2.0)))
    of_light = _unstated_shot_noise(rate * here, settings, model)
    u_common = math.hypot(u_line, max(rate, 0.0) * u_warmth * here, rounding)
    return DarkLevel(level, 0.0, u_common, _OTHER, variance=of_light)


def seconds_at_reference(settings: FrameSettings, model: SignalModel) -> float:
    """Return the exposure in s that has the same dark signal at the temperature of the stated dark current."""
    return settings.exposure_s * model.noise.warmer_factor(settings.temperature_c)


def _from_model(settings: FrameSettings, model: SignalModel, black: BlackLevel, darkest: float) -> DarkLevel:
    dark = model.modelled_dark(settings)
    slope = float(model.at_dn(model.slope, model.black_dn))
    unstated = "dark_current_e_per_s" in model.noise.assumed
    u_dark = _unknown_dark_u(settings, model, darkest) if unstated else black.dark_u_rel * dark
    # Of a black level that nothing states the darkest pixels show more than a calibration's: it is below them.
    u_black = min(black.u_dn * slope, max(darkest / math.sqrt(3.0), BlackLevel().u_dn * slope))
    return DarkLevel(dark, 0.0, math.hypot(u_black, u_dark), "black level", u_dark if unstated else 0.0)


def whole_darks(dark_frames: Sequence[Frame]) -> list[Frame]:
    """Return the dark frames of the lowest gain whose noise is not cut off at 0, and that are not full."""
    whole = [one for one in dark_frames if not is_cut_off(one) and np.median(one.dn) < one.saturated_dn]
    lowest_db = min((frame.settings.gain_db for frame in whole), default=0.0)
    return [frame for frame in whole if frame.settings.gain_db == lowest_db]


def mean_darks(dark_frames: Sequence[Frame]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return exposure times in s and mean digital numbers of dark frames, shape (frames,) each.

    Pixels that are hot in the longest do not count: where they fill up, they bend the line over time.
    """
    times = np.array([frame.settings.exposure_s for frame in dark_frames])
    typical = typical_pixels(dark_frames[int(np.argmax(times))].dn)
    return times, np.array([float(frame.dn[typical].mean()) for frame in dark_frames])


def unexposed_dn(times: NDArray[np.float64], means: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the start, in DN, of the straight line over time of dark signals, and what its u is over that of a mean.

    None where exposure times are one, or differ by at most 5 %: they show no line.
    """
    if np.ptp(times) <= _OTHER_EXPOSURE_REL * times.max():
        return None
    middle = float(times.mean())
    leverage = math.sqrt(1.0 / times.size + middle**2 / float(np.sum((times - middle) ** 2)))
    return float(np.polynomial.polynomial.polyfit(times, means, 1)[0]), leverage


def _u_of_start(times: NDArray[np.float64], means: NDArray[np.float64], drift_dn: float) -> float:
    """Return by how much means scatter about their line in DN, by Student's t for k = 2; two show none but drift."""
    freedom = times.size - 2
    if freedom < 1:
        return drift_dn
    left = means - np.polynomial.polynomial.polyval(times, np.polynomial.polynomial.polyfit(times, means, 1))
    return float(np.sqrt(np.sum(left**2) / freedom)) * float(special.stdtrit(freedom, _TWO_SIDED)) / 2.0


def black_from_darks(dark_frames: Sequence[Frame], calibration: Calibration) -> BlackLevel | None:
    """Return the black level that dark frames show; None without any whose noise is whole.

    The dark signal of several exposure times is a straight line over time: its start is the black level. Of one time
    alone the modelled dark current is taken off.

    Args:
        dark_frames: Frames with the shutter closed; those of the lowest gain are used.
    """
    own, noise, used = calibration.black_level, calibration.noise, whole_darks(dark_frames)
    if not used:
        return None
    times, means = mean_darks(used)
    gain = noise.gain_dn_per_e(used[0].settings.gain_db)
    if (line := unexposed_dn(times, means)) is not None:
        u_dn = line[1] * _u_of_start(times, means, own.u_dn)
        return own.model_copy(update={"dn": max(line[0], 0.0), "u_dn": math.hypot(own.u_dn, u_dn)})
    modelled = gain * np.array([noise.dark_e(f.settings.exposure_s, f.settings.temperature_c) for f in used])
    start = float(np.mean(means - modelled))
    unknown_dn = 0.0
    if "dark_current_e_per_s" in noise.assumed:  # the frames are at least as bright as their dark signal
        most_e = most_dark_e_per_s(calibration.camera, used[0].settings.temperature_c) * float(times[0])
        unknown_dn = min(gain * most_e, max(start, 0.0)) / 2.0
    u_dark = math.hypot(unknown_dn, own.dark_u_rel * float(modelled[0]))
    return own.model_copy(update={"dn": max(start, 0.0), "u_dn": math.hypot(own.u_dn, u_dark)})


def _most_dark(settings: FrameSettings, model: SignalModel) -> float:
    """Return the greatest signal x of a dark current that nothing states."""
    return most_dark_e_per_s(model.camera, settings.temperature_c) * settings.exposure_s / model.electrons_per_unit


def _unknown_dark_u(settings: FrameSettings, model: SignalModel, darkest: float) -> float:
    """Return the standard uncertainty of the signal x of a dark current that nothing states: k = 2 covers the most.

    Args:
        darkest: Signal x of the frame's darkest pixels; inf where it is not known.
    """
    most = _most_dark(settings, model)
    lowest = min(max(darkest, 0.0), most)
    noise = math.sqrt(float(model.variance(lowest, settings)))  # a low percentile is that far below its level
    return min(most, lowest + 2.0 * noise) / 2.0


def signal_of(frame: Frame, model: SignalModel, settings: FrameSettings | None = None) -> NDArray[np.float64]:
    """Return the signal x of every pixel of a frame, dark signal not yet taken off, shape (height, width).

    Args:
        frame: Where its pixels have black levels of their taps, these count with its own settings.
        settings: Those of a light frame that a dark frame is compared with; the frame's by default.
    """
    if frame.black_offset_dn is None:
        return model.table(settings or frame.settings)[frame.dn]
    return model.at_dn(model.table(frame.settings), frame.dn - frame.black_offset_dn)


def cut(frame: Frame, where: tuple[slice, slice]) -> Frame:
    """Return a part of a frame, copied: the whole can be released."""
    offset = None if frame.black_offset_dn is None else frame.black_offset_dn[where].copy()
    return replace(frame, dn=frame.dn[where].copy(), black_offset_dn=offset)


def some_lit_pixels(frame: Frame, lit: NDArray[np.bool_] | None = None) -> Frame:
    """Return some thousand pixels evenly over a frame, in one row: overscan gathers no light and is left out.

    Args:
        lit: Its pixels that gather light, shape (height, width); None for all.
    """
    step = max(1, math.isqrt(frame.dn.size // _PIXELS_OF_THE_WHOLE))
    few = cut(frame, (slice(None, None, step), slice(None, None, step)))
    if lit is None:
        return few
    return picked(few, lit[::step, ::step])


def picked(frame: Frame, where: NDArray[np.bool_]) -> Frame:
    """Return some pixels of a frame in one row.

    Args:
        where: True at the pixels, shape (height, width).
    """
    offset = frame.black_offset_dn
    return replace(frame, dn=frame.dn[where][None], black_offset_dn=None if offset is None else offset[where][None])


def darkest_signal(few: Frame, model: SignalModel) -> float:
    """Return the signal x of the darkest of some pixels of a frame that gather light."""
    return float(np.percentile(signal_of(few, model), _DARKEST_PERCENTILE))


def corrected_settings(settings: FrameSettings, found: FoundEffects, black_dn: float) -> FrameSettings:
    """Return the settings that a frame was really taken with.

    Args:
        black_dn: Black level in DN of a frame that does not state its own.
    """
    black = black_dn if settings.black_level_dn is None else settings.black_level_dn
    further_s = found.exposure_further_s if settings.gain_db > found.exposure_above_db else 0.0
    return replace(
        settings,
        exposure_s=max(settings.exposure_s + found.exposure_offset_s + further_s, 1e-9),
        gain_db=_real_gain_db(settings.gain_db, found),
        black_level_dn=black + found.black_offset_dn + _amplified_dn(settings.gain_db, found),
    )


def _real_gain_db(gain_db: float, found: FoundEffects) -> float:
    table = float(np.interp(gain_db, found.gains_db, found.gain_errors_rel)) if found.gains_db else 0.0
    return gain_db * (1.0 + found.gain_error_rel) + 20.0 * math.log10(1.0 + table)


def _amplified_dn(gain_db: float, found: FoundEffects) -> float:
    """Return what the gain adds to the black level in DN."""
    more = max(gain_factor(gain_db - found.black_from_db), 1.0) - 1.0
    return found.black_slope_dn * (more + found.black_bend * more**2)


def straightened(signal: ArrayLike, found: FoundEffects, electrons_per_unit: float) -> NDArray[np.float64]:
    """Return a linear sensor's signal without the bend that was found, of any shape.

    Args:
        signal: x above black at 0 dB, as it came through the bend.
    """
    seen = np.asarray(signal, dtype=np.float64)
    straight = seen
    if found.well_a2 == 0.0 and found.well_a3 == 0.0:
        return straight
    for _ in range(_ROUNDS):
        z = np.clip(straight * electrons_per_unit / found.well_e, 0.0, 1.2)
        straight = seen / (1.0 - found.well_a2 * z - found.well_a3 * z**2)
    return straight


def corrected_frames(
    frames: Bracket | Iterable[Frame], found: FoundEffects, black_dn: float
) -> Bracket | Iterable[Frame]:
    """Return frames with the settings they were really taken with; the same frames where nothing was found.

    Args:
        frames: As stated; a bracket stays one.
        black_dn: Black level in DN of frames that do not state their own.
    """
    if found == FoundEffects():
        return frames
    if isinstance(frames, Bracket):
        return Bracket.from_frames(_each(frames.every_frame, found, black_dn), frames.origin)
    return _each(frames, found, black_dn)


def _each(frames: Iterable[Frame], found: FoundEffects, black_dn: float) -> Iterator[Frame]:
    for frame in frames:
        yield replace(frame, settings=corrected_settings(frame.settings, found, black_dn))


def temperature_factor(found: FoundEffects, here_c: float | None, there_c: float | None) -> float:
    """Return what a reading is multiplied by for the warmth of the sensor: responsivity at calibration over now.

    Args:
        here_c: Temperature at the reading in °C; None where unknown.
    """
    if here_c is None or there_c is None:
        return 1.0
    here, there = (
        1.0 + found.temperature_slope_per_k * warmer + found.temperature_bend_per_k2 * warmer**2
        for warmer in (here_c - 25.0, there_c - 25.0)
    )
    return there / here


def without_glare(glare: float, surround_at_calibration: float) -> tuple[float, float]:
    """Return (a, b) of L = a·r − b·M: the reading r and the picture's mean M, both as a scale with glare gives them.

    A picture with glare is m = (1 − g)·L + g·M; its mean stays M. The scale was got on a source that was seen as m₀
    before a mean of S₀·m₀, so that r = m·(1 − g·S₀)/(1 − g), and L = (m − g·M)/(1 − g) follows.

    Args:
        glare: g, the part of the picture's mean that is spread over it.
        surround_at_calibration: S₀.
    """
    gain = 1.0 / (1.0 - glare * surround_at_calibration)
    return gain, gain * glare


@dataclass(frozen=True, slots=True, eq=False)
class PatchFrame:
    """The patch in one frame."""

    settings: FrameSettings  # of the frame
    dn: DigitalNumbers  # digital numbers, shape of the patch
    signal: NDArray[np.float64]  # linear signal x at 0 dB, same shape, dark level not yet taken off
    usable: bool  # whether no part of the patch clips or leaves the data of the response curve at the bright end
    unclipped: bool  # whether no part of the patch clips
    in_data: bool  # whether the patch's mean is above the dark end of the response curve's data
    clipped: NDArray[np.bool_]  # pixels at or above clipping, same shape
    sound: NDArray[np.bool_]  # pixels that count: neither defective nor struck in one of the frames; same shape
    whole: float  # mean signal x of the whole picture, dark level not yet taken off
    whole_clipped: float  # part of the whole picture that clips; the mean is too low then
    masked_dn: float | None = None  # what the sensor's masked pixels read, in DN; None where it is not stated
    darkest: float = math.inf  # signal x of the darkest pixels of the whole picture, dark level not yet taken off
    u_black: float = 0.0  # standard uncertainty of the patch's signal x by the black level of its tap in this frame
    dark_variance: float = 0.0  # of a pixel's dark signal that was evened; frames of one exposure share it
    codes: DigitalNumbers | None = None  # digital numbers of some pixels over the whole picture


def crop_frames(
    frames: Bracket | Iterable[Frame],
    patch: Patch,
    model: SignalModel,
    lit: NDArray[np.bool_] | None = None,
    defects: Iterable[tuple[int, int]] = (),
) -> tuple[list[PatchFrame], list[Frame], tuple[int, int]]:
    """Return the patch in every light frame, the dark frames cut to the patch, and the frames' (height, width).

    Args:
        frames: Frames in any order; each is released after its patch is cut out.
        lit: Pixels that gather light, shape (height, width); None for all.
        defects: Defective pixels of the camera (x, y).

    Raises:
        MeasurementError: If there is no light frame, the patch is outside the frame, every pixel of it is defective,
            or the frames do not belong together.
    """
    light: list[tuple[Frame, Frame]] = []
    dark: list[Frame] = []
    shape: tuple[int, int] | None = None
    for frame in frames.every_frame if isinstance(frames, Bracket) else frames:
        shape = shape or frame.shape
        _refuse_misfit(frame, patch, shape, model)
        if frame.settings.is_dark:
            dark.append(cut(frame, patch.slices))
        else:
            light.append((cut(frame, patch.slices), some_lit_pixels(frame, lit)))
    if not light or shape is None:
        raise MeasurementError("there is no frame with the shutter open; capture at least one")
    parts = [part for part, _ in light]
    levels = {part.settings.source_level for part in parts}
    if len(levels) > 1:
        raise MeasurementError(
            f"the frames were taken at {len(levels)} different source levels; read those of one level at a time"
        )
    sound = _without_defects(patch, defects) & ~_hot(parts, dark, model) & ~_struck(parts, model)
    if not sound.any():
        raise MeasurementError(f"every pixel of the patch {patch} is defective; choose another")
    cropped = [_crop(part, few, model, sound) for part, few in light]
    return sorted(cropped, key=lambda one: one.settings.effective_exposure_s), dark, shape


def _without_defects(patch: Patch, defects: Iterable[tuple[int, int]]) -> NDArray[np.bool_]:
    kept = np.ones((patch.height, patch.width), bool)
    for x, y in defects:
        if patch.x <= x < patch.x + patch.width and patch.y <= y < patch.y + patch.height:
            kept[y - patch.y, x - patch.x] = False
    return kept


def _hot(parts: Sequence[Frame], dark: Sequence[Frame], model: SignalModel) -> NDArray[np.bool_]:
    """Return the pixels of a patch that clip, and that dark frames show to do so without light as well."""
    hot = np.zeros(parts[0].shape, bool)
    for frame in dark:
        signal = signal_of(frame, model)
        noise = max(robust_sigma(signal), math.sqrt(float(model.variance(0.0, frame.settings))))
        hot |= signal > float(np.median(signal)) + _HOT_SIGMAS * noise
    clipped = np.any([one.dn >= model.saturation_dn(one.settings) for one in (*parts, *dark)], axis=0)
    return np.asarray(hot & clipped)


def _struck(parts: Sequence[Frame], model: SignalModel) -> NDArray[np.bool_]:
    """Return the pixels of a patch that clip in one frame, but in no other of its setting come near it: particles."""
    alike: dict[tuple[float | None, ...], list[Frame]] = {}
    for part in parts:
        taken = part.settings
        alike.setdefault((taken.exposure_s, taken.gain_db, taken.f_number, taken.black_level_dn), []).append(part)
    struck = np.zeros(parts[0].shape, bool)
    for same in alike.values():
        limit = model.saturation_dn(same[0].settings)
        clear = limit - 2.0 * _CLEAR_OF_CLIPPING_SIGMA * _noise_dn(model, same[0].settings, limit)
        once = np.sum([one.dn >= clear for one in same], axis=0) == 1
        for one in same if len(same) > 1 else ():
            here = once & (one.dn >= limit)
            struck |= here & (here.sum() <= _STRUCK_SHARE * here.size)
    return struck


def _refuse_misfit(frame: Frame, patch: Patch, shape: tuple[int, int], model: SignalModel) -> None:
    if not patch.fits(frame.shape):
        raise MeasurementError(
            f"the patch {patch} is not inside the frame of {frame.shape[1]} × {frame.shape[0]} pixels; "
            "give X,Y,W,H within it"
        )
    refuse_other_format(frame, shape, model)


def refuse_other_format(frame: Frame, shape: tuple[int, int], model: SignalModel) -> None:
    """Raise MeasurementError if a frame has not the shape of the others, or not the camera's depth."""
    if frame.shape != shape:
        raise MeasurementError(
            f"frames differ in size ({frame.shape[1]} × {frame.shape[0]} and {shape[1]} × {shape[0]} pixels)"
        )
    if frame.full_scale_dn != model.full_scale_dn:
        raise MeasurementError(
            f"a frame has {frame.bit_depth} bits per pixel, the camera's description says full scale "
            f"{model.full_scale_dn}; use the description of this pixel format"
        )


def _crop(part: Frame, few_of_all: Frame, model: SignalModel, sound: NDArray[np.bool_]) -> PatchFrame:
    settings, dn = part.settings, part.dn
    counted = dn[sound]
    limit = model.saturation_dn(settings)
    end = model.saturation_dn(settings, within_data=False)
    noise = _neighbour_noise(dn)
    brightest = _brightest_part(counted, noise)
    sigma = max(noise, _noise_dn(model, settings, brightest))
    most, clear_dn = float(counted.max()), brightest + _CLEAR_OF_CLIPPING_SIGMA * sigma
    lowest = model.valid_dn[0] + model.black_of(settings) - model.black_dn
    in_data = model.linear or float(dn.mean()) >= lowest
    whole, whole_clipped = float(signal_of(few_of_all, model).mean()), float(np.mean(few_of_all.dn >= end))
    slope = float(model.at_dn(model.slope, model.black_dn)) / gain_factor(settings.gain_db)
    return PatchFrame(
        settings, dn, signal_of(part, model), max(most, clear_dn) < limit, max(most, clear_dn) < end, in_data,
        dn >= limit, sound, whole, whole_clipped, part.masked_dn, darkest_signal(few_of_all, model),
        slope * part.black_u_dn / math.sqrt(part.dn.shape[0]),
        codes=few_of_all.dn,
    )  # fmt: skip


def _brightest_part(dn: DigitalNumbers, noise: float) -> float:
    """Return the level of the brightest twentieth of a patch, its noise in DN taken off.

    A patch may cross an edge: then it is the bright half that must not clip. In an even patch the 95th percentile is
    1.645 standard deviations of the noise above the level.
    """
    return max(float(np.median(dn)), float(np.percentile(dn, 95.0)) - TWENTIETH_TO_SIGMA * noise)


def _neighbour_noise(dn: DigitalNumbers) -> float:
    """Return the noise in DN from the middle of the differences between neighbours, which edges do not move."""
    values = dn.astype(np.float64)
    differences = np.concatenate([np.diff(values, axis=axis).ravel() for axis in (0, 1)])
    return neighbour_sigma(differences) if differences.size else 0.0


def _noise_dn(model: SignalModel, settings: FrameSettings, dn: float) -> float:
    gain_slope = float(model.at_dn(model.slope, dn)) / gain_factor(settings.gain_db)
    signal = float(model.at_dn(model.table(settings), dn))
    sigma = float(np.sqrt(model.variance(signal, settings)))
    return sigma / max(gain_slope, 1e-300)
