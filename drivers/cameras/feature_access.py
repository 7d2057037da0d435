"""Reads and writes GenICam features; what falsifies radiometry is switched off, and the sending rate set."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar

import structlog

from drivers.cameras.call_thread import CallThread
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost

_Result = TypeVar("_Result")
FeatureValue = bool | int | float | str

# ArvDeviceError codes of Aravis 0.8 (arvdevice.h) that mean "it no longer answers".
_NO_ANSWER: Final = frozenset({2, 4, 5})  # NOT_CONNECTED, TRANSFER_ERROR, TIMEOUT
_NOT_CONTROLLER: Final = frozenset({10, 17, 18})  # NOT_CONTROLLER, PROTOCOL_ERROR_ACCESS_DENIED, _BUSY


class Refusal(DeviceError):
    """The camera answers, but does not do what it was asked for."""


class FeatureAccess:
    """Features of one open camera.

    Args:
        camera: An `Aravis.Camera`.
        library_error: The exception class of the library, `GLib.Error`.
        thread: Where calls run that may wait for the camera; None to run them where they are asked for.

    Attributes:
        lost: Set once the camera did not answer, so that no call waits for it again.
    """

    def __init__(
        self, camera: Any, name: str, library_error: type[Exception], thread: CallThread | None = None
    ) -> None:
        self.lost = threading.Event()
        self._camera = camera
        self._thread = thread
        self._name = name
        self._library_error = library_error

    def call(self, method: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return `method(*arguments)`, which may wait for the camera.

        Raises:
            DeviceLost: If the camera did not answer.
            DeviceInUse: If another program controls it.
            DeviceError: For anything else that the library reports.
        """
        if self._thread is None:
            return self.call_here(method, *arguments)
        try:
            return self._thread.run(method, *arguments)
        except self._library_error as error:
            raise self._noted(error) from error
        except DeviceLost:
            self.lost.set()
            raise

    def call_here(self, method: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return `method(*arguments)`, which needs nothing from the camera. Raises what `call` raises."""
        try:
            return method(*arguments)
        except self._library_error as error:
            # No local name for it: an exception that its own frame holds keeps the camera alive as garbage.
            raise self._noted(error) from error

    def close(self) -> None:
        """Let the thread of the calls end."""
        if self._thread is not None:
            self._thread.close()

    def _noted(self, error: Exception) -> DeviceError:
        """Return the project's error, having taken note of a camera that is gone."""
        translated_error = translated(error, self._name)
        if isinstance(translated_error, DeviceLost):
            self.lost.set()
        return translated_error

    def has(self, feature: str) -> bool:
        """Tell whether a feature exists and can be used now."""
        return bool(self.call(self._camera.is_feature_available, feature))

    def read(self, feature: str, kind: type[FeatureValue]) -> FeatureValue:
        """Return the value of a feature, read from the camera as bool, int, float or str."""
        reader = {
            bool: self._camera.get_boolean,
            int: self._camera.get_integer,
            float: self._camera.get_float,
            str: self._camera.get_string,
        }[kind]
        return kind(self.call(reader, feature))

    def write(self, feature: str, value: FeatureValue) -> FeatureValue:
        """Write a feature and return it as read back."""
        writer = {
            bool: self._camera.set_boolean,
            int: self._camera.set_integer,
            float: self._camera.set_float,
            str: self._camera.set_string,
        }[type(value)]
        self.call(writer, feature, value)
        return self.read(feature, type(value))

    def read_if_there(self, feature: str, kind: type[FeatureValue]) -> FeatureValue | None:
        """Return the value of a feature; None where the camera has none of that name."""
        return self.read(feature, kind) if self.has(feature) else None

    def execute(self, command: str) -> None:
        """Execute a command feature."""
        self.call(self._camera.execute_command, command)

    def unit(self, feature: str) -> str:
        """Return the unit that the camera's description states for a feature, "" where it states none."""
        node = self._camera.get_device().get_feature(feature)
        return str(node.get_unit() or "") if hasattr(node, "get_unit") else ""


def translated(error: Exception, name: str) -> DeviceError:
    """Return the project's error for one of the library's.

    Args:
        error: A `GLib.Error`.
    """
    code, domain = getattr(error, "code", None), getattr(error, "domain", "")
    text = getattr(error, "message", str(error))
    if domain == "arv-device-error-quark" and code in _NO_ANSWER:
        return DeviceLost(f"{name} stopped answering ({text}); check its cable and power, then open it again")
    if "busy" in text.lower() or (domain == "arv-device-error-quark" and code in _NOT_CONTROLLER):
        return DeviceInUse(f"{name} is in use by another program ({text}); close that program and try again")
    return Refusal(f"{name}: the camera refused ({text}); `radiometer doctor` shows what it offers")


@dataclass(frozen=True, slots=True)
class FalsifyingFeature:
    """A camera feature that makes digital numbers differ from light, its harmless value, and what it does."""

    name: str  # the feature
    harmless: FeatureValue  # its value that falsifies nothing
    effect: str  # what any other value does
    selector: str = ""  # feature that selects which of several of this name is meant; "" where there is one only
    selected: tuple[str, ...] = ()  # its entries, each of which is treated


@dataclass(frozen=True, slots=True)
class HygieneFinding:
    """What was found of one falsifying feature, and what became of it."""

    feature: FalsifyingFeature  # which one
    found: FeatureValue  # its value when the camera was opened
    now: FeatureValue  # its value as read back afterwards
    state: Literal["off", "switched_off", "still_on"]  # "off" (it was harmless already), "switched_off", or "still_on"
    reason: str = ""  # why it is still on; empty otherwise

    def __str__(self) -> str:
        """Return the finding as one line."""
        name, now = self.feature.name, self.now
        if self.state == "still_on":
            return f"{name} is {now} and cannot be switched off ({self.reason}): {self.feature.effect}"
        return f"{name} is {now}" + (f" (was {self.found})" if self.state == "switched_off" else "")


# Names: GenICam SFNC 2.7 and FLIR's camera descriptions. The switches stand before the values they govern.
FALSIFYING_FEATURES: Final = (
    FalsifyingFeature("ExposureAuto", "Off", "the exposure time drifts between frames"),
    FalsifyingFeature("GainAuto", "Off", "the gain drifts between frames"),
    FalsifyingFeature("BlackLevelAuto", "Off", "the black level drifts between frames"),
    FalsifyingFeature("BalanceWhiteAuto", "Off", "colour channels are scaled from frame to frame"),
    FalsifyingFeature("BlackLevelClampingEnable", False, "the dark signal is pulled to a fixed level"),
    FalsifyingFeature("GammaEnable", False, "digital numbers are no longer proportional to light"),
    FalsifyingFeature("Gamma", 1.0, "digital numbers are no longer proportional to light"),
    FalsifyingFeature("SharpeningAuto", False, "pixels depend on their neighbours"),
    FalsifyingFeature("SharpeningEnable", False, "pixels depend on their neighbours"),
    FalsifyingFeature("SharpnessEnable", False, "pixels depend on their neighbours"),
    FalsifyingFeature("LUTEnable", False, "a look-up table replaces the digital numbers"),
    FalsifyingFeature("DefectCorrectStaticEnable", False, "listed pixels are replaced by their neighbours' mean"),
    FalsifyingFeature("DefectCorrectionEnable", False, "listed pixels are replaced by their neighbours' mean"),
    FalsifyingFeature("SaturationEnable", False, "colours are mixed"),
    FalsifyingFeature("ColorTransformationEnable", False, "colours are mixed"),
    FalsifyingFeature("IspEnable", False, "the camera processes pictures before it sends them"),
    FalsifyingFeature("SequencerMode", "Off", "settings change from frame to frame by themselves"),
    FalsifyingFeature("ImageCompressionMode", "Off", "what is sent is not the digital numbers themselves"),
    FalsifyingFeature(
        "TestPattern",
        "Off",
        "the camera draws the pictures itself, whatever it sees",
        "TestPatternGeneratorSelector",
        ("Sensor", "PipelineStart"),
    ),
)


def switch_off_falsifiers(features: FeatureAccess) -> tuple[HygieneFinding, ...]:
    """Switch off every falsifying feature that the camera has, and return what was found.

    Raises:
        DeviceLost: If the camera stopped answering.
        DeviceInUse: If another program controls it.
    """
    return tuple(
        _switch_off(features, known)
        for known in FALSIFYING_FEATURES
        for entry in known.selected or ("",)
        if _is_selected(features, known, entry) and features.has(known.name)
    )


def _is_selected(features: FeatureAccess, known: FalsifyingFeature, entry: str) -> bool:
    """Select one of several features of a name, and return whether there is such a one."""
    if not entry:
        return True
    if not features.has(known.selector):
        return entry == known.selected[0]  # a camera without the selector has one such feature
    try:
        return features.write(known.selector, entry) == entry
    except Refusal:  # this model has no such entry
        return False


def _switch_off(features: FeatureAccess, known: FalsifyingFeature) -> HygieneFinding:
    kind = type(known.harmless)
    found = features.read(known.name, kind)
    if _is_harmless(found, known):
        return HygieneFinding(known, found, found, "off")
    try:
        now = features.write(known.name, known.harmless)
    except Refusal as error:
        return HygieneFinding(known, found, features.read(known.name, kind), "still_on", str(error))
    if _is_harmless(now, known):
        return HygieneFinding(known, found, now, "switched_off")
    return HygieneFinding(known, found, now, "still_on", "it took the write and kept its value")


def _is_harmless(value: FeatureValue, known: FalsifyingFeature) -> bool:
    if isinstance(known.harmless, float):
        return abs(float(value) - known.harmless) < 1e-6
    return value == known.harmless


_LOG = structlog.get_logger(__name__)

LIMIT: Final = "DeviceLinkThroughputLimit"
SPEED: Final = "DeviceLinkSpeed"  # bytes/s, as the limit (SFNC 2.7; FLIR: MBITS*1000000/8)
# Ethernet: 10 % stay free for answers and resent packets. USB: 5 Gbit/s are 500 MB/s of symbols, of which some 380
# arrive; the same share holds for the 40 of 60 MB/s of USB 2.
_SHARE: Final = {True: 0.9, False: 0.65}
_SLOWER: Final = 0.75  # each time that frames were lost


@dataclass(slots=True)
class LinkThroughput:
    """The limit of one open camera."""

    features: FeatureAccess  # the camera's features
    name: str  # how messages call it
    limit_bytes_s: int  # in force, as read back
    lowest_bytes_s: int  # what it may be set to at least

    def slow_down(self) -> bool:
        """Lower the limit by a quarter, and return whether that could be done; the acquisition must be stopped.

        Raises:
            DeviceLost: If the camera does not answer.
        """
        limit = max(self.lowest_bytes_s, int(_SLOWER * self.limit_bytes_s))
        if limit >= self.limit_bytes_s:
            return False
        try:
            now = int(self.features.write(LIMIT, limit))
        except Refusal as error:
            _LOG.info("link speed kept", camera=self.name, reason=str(error))
            return False
        was, self.limit_bytes_s = self.limit_bytes_s, now
        _LOG.warning("frames lost, camera slowed down", camera=self.name, was_bytes_s=was, now_bytes_s=now)
        return now < was


def choose_throughput(camera: Any, features: FeatureAccess, name: str, notes: list[str]) -> LinkThroughput | None:
    """Limit what the camera sends to what its link carries, and return the limit; None where it has none.

    Args:
        camera: An `Aravis.Camera`.
        notes: What was met on the way is added here.
    """
    if not features.has(LIMIT):
        return None
    try:
        low, high = features.call(camera.get_integer_bounds, LIMIT)
        found = now = int(features.read(LIMIT, int))
        speed = features.read_if_there(SPEED, int)
        if speed is not None and 0 < int(speed) * _SHARE[bool(camera.is_gv_device())] < found:
            limit = min(max(int(int(speed) * _SHARE[bool(camera.is_gv_device())]), int(low)), int(high))
            now = int(features.write(LIMIT, limit))
    except Refusal as error:
        notes.append(f"{LIMIT} kept ({error}): frames may be lost where the link is slower than the camera")
        return None
    if now < found:
        notes.append(f"{LIMIT} lowered from {found / 1e6:g} to {now / 1e6:g} MB/s, below what the link carries")
    return LinkThroughput(features, name, now, int(low))
