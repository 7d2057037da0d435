"""Digital numbers to a signal that is proportional to light, and the noise of that signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometer.data import CameraDescription, FrameSettings, ResponseCurve, SensorNoise
from radiometer.errors import CalibrationError
from radiometer.units import gain_factor

# A full well is where charge stops; linearity and the datasheet's figure end a little before.
USABLE_FULL_WELL = 0.97


@dataclass(frozen=True, slots=True, eq=False)
class SignalModel:
    """The linear signal x = f(M) behind every digital number M, zero at the black level, at gain 0 dB.

    Attributes:
        signal: x, shape (2**bit_depth,): exp(g) with a response curve, M − black without; negative below black.
        slope: dx/dM, same shape.
        u_rel: Relative standard uncertainty of x, same shape.
        valid_dn: Digital numbers inside which x rests on data.
        black_dn: Black level in DN that the table holds for.
        electrons_per_unit: Electrons per unit of x.
        noise: Noise model of the sensor.
        linear: True without a response curve.
        saturation_known: Whether the full well is known rather than typical.
    """

    signal: NDArray[np.float64]
    slope: NDArray[np.float64]
    u_rel: NDArray[np.float64]
    valid_dn: tuple[int, int]
    black_dn: float
    electrons_per_unit: float
    noise: SensorNoise
    linear: bool
    saturation_known: bool

    @property
    def full_scale_dn(self) -> int:
        """Return the highest digital number."""
        return int(self.signal.size - 1)

    def saturation_dn(self, settings: FrameSettings, *, within_data: bool = True) -> float:
        """Return the digital number from which a frame clips: its white level, or the full well's end if lower.

        Args:
            settings: Of the frame.
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

    def variance(self, signal: ArrayLike, settings: FrameSettings) -> NDArray[np.float64]:
        """Return the expected variance of one sample of x: shot, read, dark current and quantisation noise.

        Args:
            signal: Expected x at 0 dB from light, any shape; below 0 counts as 0.
            settings: Of the frame.

        Source: EMVA Standard 1288, release 4.0, equations (6)–(13), carried through the response to x.
        """
        light = np.maximum(np.asarray(signal, dtype=np.float64), 0.0)
        dark_e = self.noise.dark_e(settings.exposure_s, settings.temperature_c)
        electrons = light * self.electrons_per_unit + self.noise.read_noise_e**2 + dark_e
        slope = self.at_dn(self.slope, self.dn_of(light, settings)) / gain_factor(settings.gain_db)
        return np.asarray(electrons / self.electrons_per_unit**2 + slope**2 * self.noise.code_variance_dn2)

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
        camera: The camera.
        response: Its response curve; None takes the sensor as linear above black.
        noise: Its noise model.
        black_dn: Black level in DN.
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
