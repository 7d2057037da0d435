"""The registers of the simulated Blackfly, read as settings; its signal processing, as they switch it on."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from radiometer.data.frame import DigitalNumbers
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.blackfly_pictures import PictureRequest
from simulators.cameras.pixel_packing import WIRE_FORMATS

_NAMES: Final = {wire.code: name for name, wire in WIRE_FORMATS.items()}
AUTO_TARGET: Final = 0.5  # of full scale, the mean that automatic exposure steers to
_AUTO_STEP: Final = 2.0  # largest change from frame to frame


def gamma_corrected(dn: DigitalNumbers, gamma: float, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers after a gamma curve: full scale × (DN / full scale)^gamma, rounded."""
    curve = full_scale_dn * (np.arange(full_scale_dn + 1) / full_scale_dn) ** gamma
    return _like(dn, curve[dn])


def sharpened(dn: DigitalNumbers, full_scale_dn: int) -> DigitalNumbers:
    """Return digital numbers with half of their difference from the mean of 3 × 3 neighbours added."""
    exact: NDArray[np.float32] = dn.astype(np.float32)
    crisp = exact + 0.5 * (exact - uniform_filter(exact, 3))
    return _like(dn, np.clip(crisp, 0, full_scale_dn))


def steered(setting: float, mean_dn: float, full_scale_dn: int, low: float, high: float) -> float:
    """Return the exposure time or amplitude gain that automatic exposure takes for the next frame.

    Args:
        setting: What the last frame was taken with, in any unit proportional to the signal.
        mean_dn: Mean of the last frame in DN.
    """
    factor = AUTO_TARGET * full_scale_dn / max(mean_dn, 1.0)
    return min(max(setting * min(max(factor, 1 / _AUTO_STEP), _AUTO_STEP), low), high)


def _like(dn: DigitalNumbers, exact: NDArray[np.floating[Any]]) -> DigitalNumbers:
    rounded: DigitalNumbers = np.rint(exact).astype(dn.dtype)
    return rounded


def is_acquiring(device: FakeGigeDevice) -> bool:
    """Tell whether a program controls the camera and has started its acquisition."""
    return bool(device.read_word(registers.ACQUISITION) and device.read_word(registers.CONTROL_PRIVILEGE))


def read_request(device: FakeGigeDevice) -> tuple[PictureRequest, str]:
    """Return what a picture is to be made under, and the name of its pixel format."""
    format_name = _NAMES.get(device.read_word(registers.PIXEL_FORMAT), "Mono8")
    bits = WIRE_FORMATS[format_name].bit_depth
    request = PictureRequest(
        exposure_s=device.read_float(registers.EXPOSURE_US) * 1e-6,
        gain_db=device.read_float(registers.GAIN_DB),
        black_level_dn=device.read_float(registers.BLACK_LEVEL_PERCENT) / 100 * ((1 << bits) - 1),
        bit_depth=bits,
        temperature_c=device.read_float(registers.TEMPERATURE_C),
        source_level=device.read_float(registers.SOURCE_LEVEL),
        is_shutter_closed=bool(device.read_word(registers.SHUTTER_CLOSED)),
        binning=max(1, device.read_word(registers.BINNING)),
        x=device.read_word(registers.OFFSET_X),
        y=device.read_word(registers.OFFSET_Y),
        width=device.read_word(registers.WIDTH),
        height=device.read_word(registers.HEIGHT),
    )
    return request, format_name


def processed(device: FakeGigeDevice, dn: DigitalNumbers, request: PictureRequest) -> DigitalNumbers:
    """Return a picture after gamma and sharpening, where they are on."""
    full_scale_dn = (1 << request.bit_depth) - 1
    if device.read_word(registers.GAMMA_ENABLE):
        dn = gamma_corrected(dn, device.read_float(registers.GAMMA), full_scale_dn)
    if device.read_word(registers.SHARPENING_ENABLE):
        dn = sharpened(dn, full_scale_dn)
    return dn


def steer_exposure(
    device: FakeGigeDevice, request: PictureRequest, mean_dn: float, limits_s: tuple[float, float]
) -> None:
    """Set the exposure time that automatic exposure takes after a picture.

    Args:
        request: What the picture was made under.
        mean_dn: Its mean in DN.
        limits_s: Shortest and longest exposure time in s.
    """
    next_s = steered(request.exposure_s, mean_dn, (1 << request.bit_depth) - 1, *limits_s)
    device.write_float(registers.EXPOSURE_US, next_s * 1e6)
