"""What a camera's features tell the doctor: features that falsify, the link's speed, how Mono16 lies."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers.cameras.camera_checks import USB3_BYTES_S, check_features
from drivers.cameras.feature_hygiene import FalsifyingFeature, HygieneFinding
from radiometer.devices import Health

GAMMA = FalsifyingFeature("GammaEnable", False, "digital numbers are bent")
SHARP = FalsifyingFeature("SharpeningEnable", False, "edges shine")


class Features:
    """Features that answer what they are given."""

    def __init__(self, **values):
        self.values = values

    def read_if_there(self, name, kind):
        return self.values.get(name)

    def call(self, function):
        return function()


def camera(*, hygiene=(), notes=(), gige=False, packet=1400, believed=0, **features):
    session = SimpleNamespace(
        hygiene=hygiene,
        notes=notes,
        identity=SimpleNamespace(interface="eth0" if gige else ""),
        quirks=SimpleNamespace(mono16_left_aligned_bits=believed),
        features=Features(**features),
        camera=SimpleNamespace(is_gv_device=lambda: gige, gv_get_packet_size=lambda: packet),
    )
    return SimpleNamespace(session=session)


def found(name, **reported):
    return [f for f in check_features(camera(**reported)) if f.check == name]


def test_what_falsifies_and_could_not_be_switched_off_is_a_fault():
    """With the way out; what was switched off is a note, what was off already is named together."""
    hygiene = (
        HygieneFinding(GAMMA, True, True, "still_on", "it is locked"),
        HygieneFinding(SHARP, True, False, "switched_off", ""),
    )
    (gamma,), (sharp,) = (found(f"feature {name}", hygiene=hygiene) for name in ("GammaEnable", "SharpeningEnable"))
    assert (gamma.health, sharp.health) == (Health.FAULT, Health.NOTE)
    assert "power-on user set" in gamma.cure
    assert "was True and has been switched off, else edges shine" in sharp.message
    assert found("features", hygiene=hygiene) == []
    off = tuple(HygieneFinding(one, False, False, "off", "") for one in (GAMMA, SHARP))
    (together,) = found("features", hygiene=off)
    assert (together.health, together.message) == (Health.OK, "off as they must be: GammaEnable, SharpeningEnable")
    (none,) = found("features")
    assert none.health is Health.NOTE


@pytest.mark.parametrize(("packet", "health"), [(1400, Health.NOTE), (1500, Health.NOTE), (8952, Health.OK)])
def test_small_packets_are_noted(packet, health):
    """Up to 1500 bytes the interface's MTU may be raised."""
    (link,) = found("link", gige=True, packet=packet)
    assert link.health is health
    assert f"packets of {packet} bytes" in link.message
    assert bool(link.cure) is (health is Health.NOTE)


@pytest.mark.parametrize(
    ("speed", "health"),
    [(None, Health.OK), (USB3_BYTES_S, Health.OK), (USB3_BYTES_S - 1, Health.WARNING), (48_000_000, Health.WARNING)],
)
def test_a_usb_2_link_is_a_warning(speed, health):
    """500 MB/s are USB 3; what is not reported is not judged."""
    (link,) = found("link", DeviceLinkSpeed=speed)
    assert link.health is health
    assert ("USB 2 link" in link.message) is (health is Health.WARNING)


@pytest.mark.parametrize(
    ("depth", "believed", "warned"),
    [("Bit12", 12, False), ("Bit10", 12, True), ("Bit10", 0, False), ("Bit99", 12, False), (None, 12, False)],
)
def test_mono16_that_lies_otherwise_than_believed_is_a_warning(depth, believed, warned):
    """Only where both the converter's depth and the quirk file's are known and differ."""
    findings = found("Mono16", believed=believed, AdcBitDepth=depth)
    assert [f.health for f in findings] == ([Health.WARNING] if warned else [])
