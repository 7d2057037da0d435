"""The light box as a stage: its white channel bleaches, its spot blinks, its button answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from radiometer.adaptation.protocol import AdaptationProtocol, FlashBleach, SteadyBleach
from radiometer.devices.light_box import ButtonEvent, FlashBox, LightBox, Radiance
from radiometer.errors import UsageError

FIXATION = "fixation"
FLASH_GAP_S = 10.0  # between two photographic flashes: the box wants 5 s, the flash charges


@dataclass(frozen=True, slots=True)
class BoxLights:
    """What the eye makes of the box's light, and what of it the protocol wants."""

    protocol: AdaptationProtocol  # the protocol
    bleach_photopic_lm_per_w: float  # luminous efficacy of the bleaching light
    bleach_scotopic_lm_per_w: float  # its scotopic luminous efficacy
    spot_scotopic_lm_per_w: float  # that of the spot's light
    fixation_w_sr_m2: float = 0.0  # radiance of the fixation mark; 0 leaves it dark
    u_scale_log10: float = 0.0  # standard uncertainty that all levels of the spot share, in log10 units
    blind_spot_w_sr_m2: float = 0.0  # radiance of the light in the blind spot; 0 where this box has none there
    no_fixation_check: str = ""  # why it has none, for the journal

    @property
    def bleach(self) -> Radiance:
        """Return the radiance of the bleach; a flash's is its td·s over duration and area of the pupil in mm²."""
        light = self.protocol.bleach
        if isinstance(light, SteadyBleach):
            return Radiance(light.luminance_cd_m2 / self.bleach_photopic_lm_per_w)
        trolands = light.retinal_td_s / light.duration_s
        return Radiance(trolands / (math.pi / 4 * light.pupil_mm**2) / self.bleach_scotopic_lm_per_w)

    def flashes(self, exposure_j_sr_m2: float) -> int:
        """Return how many photographic flashes of a radiant exposure give the protocol's td·s, to the nearest one."""
        light = self.protocol.bleach
        assert isinstance(light, FlashBleach)
        td_s = exposure_j_sr_m2 * self.bleach_scotopic_lm_per_w * math.pi / 4 * light.pupil_mm**2
        return max(1, round(light.retinal_td_s / td_s))

    @property
    def by_flash(self) -> bool:
        """Return whether the photographic flash bleaches."""
        return isinstance(self.protocol.bleach, FlashBleach) and self.protocol.bleach.source == "flash"

    def spot(self, log10_level: float) -> Radiance:
        """Return the radiance of the spot, before its filter, for a level in log10 scotopic cd·m⁻² behind it."""
        density = self.protocol.spot.filter_density
        return Radiance(10.0 ** (log10_level + density) / self.spot_scotopic_lm_per_w)


@dataclass(slots=True)
class BoxStage:
    """Runs a test on an open light box, in real time."""

    box: LightBox  # an open light box with calibrated channels
    lights: BoxLights  # its lights
    clock: Callable[[], float]  # steady clock in s, the one that the box's button events are given on
    sleep: Callable[[float], None]  # waits for a number of seconds
    wall_clock: Callable[[], float] | None = None  # time of day as Unix time in s; None where the box is simulated
    _zero_s: float = field(default=0.0, init=False)
    _pressed_s: float | None = field(default=None, init=False)
    _longest: tuple[float, float] = field(default=(0.0, 0.0), init=False)

    def __post_init__(self) -> None:
        self._zero_s = self.clock()

    @property
    def protocol(self) -> AdaptationProtocol:
        """Return what is done."""
        return self.lights.protocol

    def now_s(self) -> float:
        """Return the time in s since the stage was set up, or as `resume_at` set it."""
        return self.clock() - self._zero_s

    def wall_s(self) -> float | None:
        """Return the time of day as Unix time in s; None where the box is simulated."""
        return self.wall_clock() if self.wall_clock else None

    def resume_at(self, time_s: float) -> None:
        """Count on from a time, with the mark lit again. Raises DeviceError, UnsafeStimulus."""
        self._zero_s = self.clock() - time_s
        self._light_mark()

    def facts(self) -> dict[str, str | float]:
        """Return which box it is, for the journal. Raises DeviceError."""
        known: dict[str, str | float] = {
            "box": self.box.identity.serial,
            "firmware": self.box.identity.firmware,
            "u_scale_log10": round(self.lights.u_scale_log10, 4),
        }
        if self.lights.no_fixation_check:
            known["no_fixation_check"] = self.lights.no_fixation_check
        return known

    def health(self) -> dict[str, str]:
        """Return how the box is, for whoever watches. Raises DeviceError."""
        if self.wall_clock is None:  # asking would let simulated time pass
            return {"box": self.box.identity.serial}
        now = self.box.status()
        return {
            "box": self.box.identity.serial,
            "supply": f"{now.supply_v:.2f} V",
            "temperature": f"{now.temperature_celsius:.0f} °C",
            "went dark by itself": f"{now.darkened} times",
        }

    def bleach(self, protocol: AdaptationProtocol) -> None:
        """Light the bleaching channel for the protocol's time, timed by the box.

        Raises:
            DeviceError: If the box fails.
            UnsafeStimulus: If it is too much for eye or box.
        """
        if self.lights.by_flash:
            self._flash()
        else:
            self.box.pulse(protocol.bleach.channel, self.lights.bleach, protocol.bleach.duration_s)
            self.sleep(protocol.bleach.duration_s)
        self._light_mark()

    def _flash(self) -> None:
        if not isinstance(self.box, FlashBox):
            raise UsageError("the protocol bleaches by a photographic flash, which this light box has not")
        count = self.lights.flashes(self.box.flash_exposure_j_sr_m2)
        for number in range(count):
            self.box.fire_flash()
            self.sleep(FLASH_GAP_S if number < count - 1 else 0.1)

    def blink(self, log10_level: float | None, trial: int, number: int) -> list[float]:
        """Blink the spot once and return the presses in s from its onset. Raises DeviceError, UnsafeStimulus."""
        light = None if log10_level is None else self.lights.spot(log10_level)
        return self._blink_once(self.protocol.spot.channel, light)

    @property
    def checks_fixation(self) -> bool:
        """Return whether the box has a light in the blind spot."""
        return self.protocol.fixation_check is not None and self.lights.blind_spot_w_sr_m2 > 0

    def blink_blind_spot(self, trial: int, number: int) -> list[float]:
        """Show the light in the blind spot once and return the presses in s from its onset.

        Raises:
            UsageError: If the box has none.
            DeviceError: If the box fails.
            UnsafeStimulus: If it is too much for the eye.
        """
        check = self.protocol.fixation_check
        if check is None or not self.checks_fixation:
            raise UsageError("this box has no light in the blind spot")
        return self._blink_once(check.channel, Radiance(self.lights.blind_spot_w_sr_m2))

    def _blink_once(self, channel: str, light: Radiance | None) -> list[float]:
        """Light a channel for the protocol's time (None: nothing) and return the presses until the cycle is over."""
        spot, onset = self.protocol.spot, self.clock()
        if light is not None:
            self.box.pulse(channel, light, spot.on_s)
        presses = self._presses(self.box.buttons(max(0.0, spot.cycle_s - (self.clock() - onset))))
        return [time_s - onset for time_s in presses if time_s >= onset]

    def wait(self, seconds: float) -> None:
        """Let time pass; what is pressed meanwhile counts for nothing. Raises DeviceLost."""
        self.rest(seconds)

    def rest(self, seconds: float) -> int:
        """Let time of a pause pass and return how often the button was pressed. Raises DeviceLost."""
        return len(self._presses(self.box.buttons(seconds)))

    def long_press(self, at_least_s: float) -> float | None:
        """Return when a press that lasts so long began, on the stage's clock; each once, None where none is."""
        begun_s, held_s = self._longest
        if self._pressed_s is not None and self.clock() - self._pressed_s > held_s:
            begun_s, held_s = self._pressed_s, self.clock() - self._pressed_s
        if held_s < at_least_s:
            return None
        self._longest, self._pressed_s = (0.0, 0.0), None
        return begun_s - self._zero_s

    def _presses(self, events: Iterable[ButtonEvent]) -> list[float]:
        """Return when presses began, on the box's clock, and remember the longest that has ended."""
        presses = []
        for event in events:
            if event.pressed:
                self._pressed_s = event.time_s
                presses.append(event.time_s)
            elif self._pressed_s is not None:
                held_s = event.time_s - self._pressed_s
                self._longest = max(self._longest, (self._pressed_s, held_s), key=lambda press: press[1])
                self._pressed_s = None
        return presses

    def _light_mark(self) -> None:
        if self.lights.fixation_w_sr_m2:
            self.box.set_level(FIXATION, Radiance(self.lights.fixation_w_sr_m2))
