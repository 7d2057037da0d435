"""Checks by the camera's features: what falsifies radiometry, how it is linked, how Mono16 is laid out."""

from __future__ import annotations

from drivers.cameras.aravis_camera import AravisCamera
from drivers.cameras.camera_opening import CameraSession
from drivers.cameras.feature_access import SPEED
from drivers.cameras.host_checks import USB3_MBIT_S
from radiometer.devices import Finding, Health

USB3_BYTES_S = USB3_MBIT_S * 1_000_000 // 10  # ten symbols to a byte
_ADC_BITS = {"Bit8": 8, "Bit10": 10, "Bit12": 12, "Bit14": 14, "Bit16": 16}


def check_features(camera: AravisCamera) -> list[Finding]:
    """Return what was found of an open camera's features. Raises DeviceError if it does not answer."""
    session = camera.session
    notes = [Finding("opening", Health.NOTE, note) for note in session.notes]
    link = _link(session) if session.camera.is_gv_device() else _usb(session)
    return [*_hygiene(session), *notes, link, *_alignment(session)]


def _hygiene(session: CameraSession) -> list[Finding]:
    if not session.hygiene:
        return [Finding("features", Health.NOTE, "the camera has none of the features that falsify radiometry")]
    findings = []
    for found in session.hygiene:
        check = f"feature {found.feature.name}"
        if found.state == "still_on":
            cure = "switch it off with the maker's program and save that as the power-on user set"
            findings.append(Finding(check, Health.FAULT, str(found), cure))
        elif found.state == "switched_off":
            message = f"was {found.found} and has been switched off, else {found.feature.effect}"
            findings.append(Finding(check, Health.NOTE, message))
    off = [found.feature.name for found in session.hygiene if found.state == "off"]
    if off:
        findings.append(Finding("features", Health.OK, f"off as they must be: {', '.join(off)}"))
    return findings


def _usb(session: CameraSession) -> Finding:
    message = session.identity.interface or "USB3 Vision"
    speed = session.features.read_if_there(SPEED, int)
    if speed is None:
        return Finding("link", Health.OK, message)
    message = f"{message}, {int(speed) / 1e6:g} MB/s"
    if int(speed) >= USB3_BYTES_S:
        return Finding("link", Health.OK, message)
    cure = "plug it into a USB 3 port (blue, or marked SS) with a USB 3 cable, without a hub in between"
    return Finding("link", Health.WARNING, f"{message}: a USB 2 link, on which it drops frames or sends none", cure)


def _link(session: CameraSession) -> Finding:
    size = int(session.features.call(session.camera.gv_get_packet_size))
    message = f"{session.identity.interface}, packets of {size} bytes"
    if size > 1500:
        return Finding("link", Health.OK, message)
    return Finding("link", Health.NOTE, message, "raise the interface's MTU to 9000 for fewer packets per frame")


def _alignment(session: CameraSession) -> list[Finding]:
    depth = session.features.read_if_there("AdcBitDepth", str)
    believed = session.quirks.mono16_left_aligned_bits
    bits = _ADC_BITS.get(str(depth))
    if bits is None or not believed or bits == believed:
        return []
    message = f"the converter gives {bits} bits, the quirk file takes Mono16 for {believed} bits at the top"
    return [Finding("Mono16", Health.WARNING, message, "measure in Mono12p or Mono12, or correct the quirk file")]
