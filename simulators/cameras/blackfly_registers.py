"""The registers of the simulated Blackfly, read as settings; its signal processing, as they switch it on."""

from __future__ import annotations

from typing import Final

from radiometer.data.frame import DigitalNumbers
from simulators.cameras import blackfly_features as registers
from simulators.cameras.aravis_fake_device import FakeGigeDevice
from simulators.cameras.blackfly_pictures import PictureRequest
from simulators.cameras.blackfly_processing import gamma_corrected, sharpened, steered
from simulators.cameras.pixel_packing import WIRE_FORMATS

_NAMES: Final = {wire.code: name for name, wire in WIRE_FORMATS.items()}


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
