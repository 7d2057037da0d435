"""Enters the light of one opened box into the exposure account, and refuses what is too much for an eye."""

from __future__ import annotations

import math
import threading
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from radiometer.devices.exposure_account import ANY_EYE, Account, AccountStore, Phase, Planned, box_key, eye_keys
from radiometer.devices.retinal_safety import (
    BLUE_WINDOW_S,
    DEFAULT_FRACTION,
    ChannelOptics,
    HazardFractions,
    hazard_fractions,
    refuse_unsafe,
    weighted_fractions,
)
from radiometer.errors import UnsafeStimulus

# An Arduino's ceramic resonator runs up to 0.5 % slow (docs/reference/light-box-protocol.md); twice that counts.
_CLOCK_FACTOR: Final = 1.01
_LINE_NM: Final = 20.0  # width of a coloured LED where the preset states none
_BY_FAR: Final = 1.5  # LEDs of one type differ by up to 10 nm, which is 1.3 times in the steepest part of B(λ)
# A command may be repeated for 1.6 s, each time feeding the dead man, who waits 1 s: the old light may last that long.
CHANGE_S: Final = 3.0
# Another box may have the same serial number. What a program that died has lit there ends by the dead man, who waits
# 1 s; the rest is what adapters and operating systems hold back.
_STILL_LIT_S: Final = 1.5


@dataclass(frozen=True, slots=True)
class Stimulus:
    """Light of a channel as it is asked for."""

    channel: str  # name of the channel
    radiance_w_sr_m2: float  # radiance while bright that it stays below, in W·sr⁻¹·m⁻²
    bright_s: float  # bright time in s, in sum; `math.inf` where no end is planned
    lasting_s: float  # time in s from its begin to its end, dark times included; `math.inf` where no end is planned
    ramp_s: float = 0.0  # time in s within which the level moves there from the one before; 0 where it jumps


@dataclass(frozen=True, slots=True)
class _Open:
    """A stimulus of this opening that the account holds: its channel, highest radiance, and when it is over at last."""

    channel: str
    radiance_w_sr_m2: float
    over_s: float


@dataclass(slots=True)
class ExposureLedger:
    """Adds up the blue-light exposure of all channels over 10⁴ s; takes the hottest moment for the thermal limit.

    All channels count as falling on the same place of the retina, a blinking channel as bright for the planned time,
    and a ramp as the higher of its two levels for its whole time. Light that no eye was named for counts for every eye,
    so that an eye that changes the box gets at most as much as an eye that stays.
    """

    optics: Mapping[str, ChannelOptics]  # optics of each channel
    store: AccountStore  # keeps the account of all boxes and eyes
    allowed_fraction: float = DEFAULT_FRACTION  # largest fraction of either limit that may be used up
    eye: str | None = None  # whose eye looks into the box; None where it is not known, NO_EYE where none does
    clock_factor: float = _CLOCK_FACTOR  # how much longer than planned the box's light may last
    _box: str = ""
    _port: str = ""
    _open: dict[str, _Open] = field(default_factory=dict)  # by name in the account
    _dark_s: dict[str, float] = field(default_factory=dict)  # by name: from when on it is dark, where not yet stored
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def open(self, serial: str, port: str = "") -> None:
        """Take up the account of a box that has just gone dark; what a program that ended left open is over now.

        Args:
            serial: Its serial number.
            port: The port it answers on, by which a simulated box is known.

        An account that cannot be had is no error here, for darkness needs none: every light is refused then.
        """
        with self._lock:
            self._box, self._port = serial, port
            try:
                with self.store.change() as account:
                    self._meet(account)
                    for name, planned in list(account.planned.items()):
                        if planned.box == serial and not self.store.lives(planned.holder):
                            account.settle(name, account.now_s + _STILL_LIT_S)
            except UnsafeStimulus:
                return  # `reserve` meets the same trouble and reports it
            self._open, self._dark_s = {}, {}

    def take_colour(self, channel: str, peak_nm: float | None) -> bool:
        """Count a channel as the box itself describes it where that harms more, and return whether it does by far.

        Args:
            channel: Its name.
            peak_nm: Its peak wavelength in nm as the box reports it; None for white.
        """
        stated = self.optics.get(channel)
        if stated is None:
            return False
        own = replace(stated, peak_nm=peak_nm, fwhm_nm=stated.fwhm_nm or _LINE_NM)
        (blue, _), (own_blue, _) = weighted_fractions(stated), weighted_fractions(own)
        if own_blue > blue:
            self.optics = {**self.optics, channel: own}
        return own_blue > _BY_FAR * blue

    def refuse_unsafe(self, channel: str, radiance_w_sr_m2: float, bright_s: float) -> None:
        """Raise UnsafeStimulus if a stimulus, with all that was given before, exceeds the allowed fraction.

        Args:
            channel: Which channel would shine; what it does now would end.
            radiance_w_sr_m2: Highest radiance while bright, in W·sr⁻¹·m⁻².
            bright_s: Planned bright time in s; `math.inf` where no end is planned.
        """
        with self._lock:
            account = self._looked_at()
            planned = self._planned(account, Stimulus(channel, radiance_w_sr_m2, bright_s, math.inf))
            refusal = self._refusal(account, planned)
        if refusal is not None:
            raise refusal

    def refuse_further(self, where: str, used: HazardFractions) -> None:
        """Raise UnsafeStimulus if fractions of the limits are too much with all that was given before.

        Args:
            used: Fractions of the limits that it would use up.
        """
        with self._lock:
            account = self._looked_at()
            self._refuse_in_all(account, where, used)

    def reserve(self, stimulus: Stimulus) -> str:
        """Enter a stimulus into the account before it is given, and return its name there.

        Raises:
            UnsafeStimulus: If it is too much with all that was given before, or cannot be stored; it was not entered.
        """
        name = uuid.uuid4().hex
        with self._lock:
            with self.store.change() as account:
                self._meet(account)
                self._settle_known(account)
                planned = self._planned(account, stimulus)
                refusal = self._refusal(account, planned)
                if refusal is None:
                    account.planned[name] = planned
            self._dark_s = {}
            if refusal is not None:
                raise refusal
            highest = max(self._before(stimulus, planned.start_s), stimulus.radiance_w_sr_m2)
            self._open[name] = _Open(stimulus.channel, highest, planned.over_s)
        return name

    def holds(self, name: str) -> bool:
        """Return whether a stimulus that was entered may still begin: nothing has darkened its channel since."""
        with self._lock:
            return name in self._open

    def withdraw(self, name: str) -> None:
        """Take out a stimulus that the box has refused."""
        with self._lock:
            self._end({name}, -math.inf)
            self.settle()

    def begun(self, name: str) -> None:
        """Note that a stimulus is on; what its channel did before has ended, which `settle` stores."""
        with self._lock:
            channel = self._open[name].channel
            self._end({n for n, known in self._open.items() if known.channel == channel and n != name})

    def note(self, stimulus: Stimulus) -> None:
        """Enter light that was given without having been asked for. Raises UnsafeStimulus where it cannot be stored."""
        with self._lock, self.store.change() as account:
            self._meet(account)
            name = uuid.uuid4().hex
            account.planned[name] = self._planned(account, stimulus)
            account.settle(name, math.inf)

    def darken(self, channel: str | None = None, within_s: float = 0.0) -> None:
        """Note that a channel (None: all) is dark, or will be within a time in s.

        What it has given stays in the account. Never raises: where that cannot be stored, the account holds the whole
        plan until it can.
        """
        with self._lock:
            self._end({name for name, known in self._open.items() if channel in (None, known.channel)}, within_s)
            self.settle()

    def is_kept(self) -> bool:
        """Return whether the account still holds what is lit: it may be deleted or damaged meanwhile."""
        with self._lock:
            try:
                account = self.store.look()
            except UnsafeStimulus:
                return True  # no other program can read it either, so none gives light at the same time
            return all(name in account.planned for name, known in self._open.items() if known.over_s > account.now_s)

    def _end(self, names: set[str], within_s: float = 0.0) -> None:
        now_s = self.store.now_s()
        for name in names:
            if self._open.pop(name).over_s > now_s:  # else the account settles it by itself
                self._dark_s[name] = now_s + within_s

    def settle(self) -> None:
        """Store what has ended; never raises, for the account holds the whole plan until it can be stored."""
        with self._lock:
            if not self._dark_s:
                return
            try:
                with self.store.change() as account:
                    self._settle_known(account)
            except UnsafeStimulus:
                return  # darkness needs no account; the next stimulus stores it
            self._dark_s = {}

    def _meet(self, account: Account) -> None:
        account.meet(self._box, lambda holder: self.store.simulates(holder, self._port))

    def _settle_known(self, account: Account) -> None:
        for name, dark_s in self._dark_s.items():
            account.settle(name, dark_s)

    def _looked_at(self) -> Account:
        account = self.store.look()
        self._meet(account)
        self._settle_known(account)
        return account

    def _before(self, stimulus: Stimulus, now_s: float) -> float:
        """Return the highest radiance from which a ramp may set out; 0 for what is no ramp."""
        if not stimulus.ramp_s:
            return 0.0
        known = self._open.values()
        return max((k.radiance_w_sr_m2 for k in known if k.channel == stimulus.channel and k.over_s > now_s), default=0)

    def _planned(self, account: Account, stimulus: Stimulus) -> Planned:
        now_s = account.now_s
        lights = [(stimulus.radiance_w_sr_m2, stimulus.bright_s)]
        if stimulus.ramp_s:
            highest = max(self._before(stimulus, now_s), stimulus.radiance_w_sr_m2)
            lights.append((highest, stimulus.ramp_s))
        phases = tuple(self._phase(stimulus.channel, radiance, bright_s) for radiance, bright_s in lights)
        over_s = now_s + stimulus.lasting_s * self.clock_factor + CHANGE_S
        return Planned(self._box, self.eye, stimulus.channel, self.store.holder, now_s, over_s, phases)

    def _phase(self, channel: str, radiance_w_sr_m2: float, bright_s: float) -> Phase:
        longest_s = bright_s * self.clock_factor
        optics = self.optics[channel]
        each_s = hazard_fractions(optics, radiance_w_sr_m2, 1.0).blue_light  # the limits are linear for 100 s at least
        most = hazard_fractions(optics, radiance_w_sr_m2, math.inf).blue_light
        return Phase(each_s, most, longest_s, hazard_fractions(optics, radiance_w_sr_m2, longest_s).thermal)

    def _refuse_in_all(
        self, account: Account, where: str, further: HazardFractions, planned: Planned | None = None
    ) -> None:
        """Raise UnsafeStimulus if a stimulus is too much for the box, or for an eye that may look."""
        channel = planned.channel if planned else None
        endless = planned is not None and any(math.isinf(phase.bright_s) for phase in planned.phases)
        for keys in self._together(account):
            before = self._used(account, keys, channel)
            whole = HazardFractions(further.blue_light + before.blue_light, further.thermal + before.thermal)
            refuse_unsafe(where + self._counted(keys), whole, self.allowed_fraction, endless=endless)

    def _used(self, account: Account, keys: set[str], channel: str | None) -> HazardFractions:
        """Return what counts besides a new stimulus of a channel, in accounts that add up."""
        others = {name: planned for name, planned in account.planned.items() if keys & set(planned.keys)}
        ending = [p for name, p in others.items() if name in self._open and p.channel == channel]
        going_on = [p for name, p in others.items() if name not in self._open or p.channel != channel]
        soon_s = account.now_s + CHANGE_S
        open_blue = [p.blue(soon_s) for p in ending] + [p.blue() for p in going_on]
        blue = math.fsum([*map(account.blue, keys), *open_blue])
        return HazardFractions(blue, math.fsum(p.thermal for p in going_on))

    def _together(self, account: Account) -> list[set[str]]:
        """Return the accounts of the box and of each eye that may look, each with those that add to it."""
        eyes = set(eye_keys(self.eye))
        if self.eye is None:  # it may be any of those that the account knows
            known = {key for planned in account.planned.values() for key in planned.keys} | set(account.given)
            eyes |= {key for key in known if key.startswith("eye ")}
        return [{box_key(self._box)}, *({ANY_EYE, key} for key in sorted(eyes))]

    def _counted(self, keys: set[str]) -> str:
        """Return the note to a refusal where it is not for the light of this box alone."""
        if ANY_EYE not in keys:
            return ""
        if self.eye is None:
            return ", which counts for every eye with the light of other boxes (name the eye, or state that none looks)"
        return f", for {' '.join(eye_keys(self.eye))} over all boxes"

    def _refusal(self, account: Account, planned: Planned) -> UnsafeStimulus | None:
        if not planned.blue() and not planned.thermal:
            return None  # darkness
        assumed = account.assumed.get(box_key(self._box))
        if assumed is not None:
            return _unknown_history(self._box, *assumed, account)
        further = HazardFractions(planned.blue(), planned.thermal)
        try:
            self._refuse_in_all(account, f"channel {planned.channel}", further, planned)
        except UnsafeStimulus as refusal:
            return refusal
        return None


def _unknown_history(serial: str, until_s: float, reason: str, account: Account) -> UnsafeStimulus:
    minutes = math.ceil((until_s - account.now_s) / 60)
    return UnsafeStimulus(
        f"light box {serial}: {reason}, so its blue-light limit counts as used up for {minutes} min."
        f" Wait, or confirm that no eye was exposed in the last {BLUE_WINDOW_S / 3600:.1f} h:"
        f" radiometer light account --box {serial} --confirm-no-exposure"
    )
