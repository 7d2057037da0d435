"""A simulated desk with light boxes, eyes, a computer and hostile circumstances, to see how much light an eye receives.

What an eye receives is integrated from the outputs of the simulated boxes, for the brightest box that the preset
allows. It shares no formula with the account that is to limit it: every light is a line at 437.5 nm, where B(λ) is 1 in
table 4.2 of IEC 62471, so that the blue-light dose of a large source is radiance times time.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import math
import os
import random
import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol
from unittest import mock

from drivers.light_box.box import SerialLightBox
from drivers.light_box.link import BoxLink
from radiometer.devices.exposure_account import NO_EYE, FileStore, Moment
from radiometer.devices.exposure_ledger import ExposureLedger
from radiometer.devices.light_box import CurrentRange, DriveLevel
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import DeviceInUse, DeviceLost, RadiometerError, UnsafeStimulus
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from testing.firmware_board import FirmwareBox, build, rested_memory

PROMISED: Final = 0.1
WINDOW_S: Final = 1e4
LOW_RATIO: Final = 0.01
RADIANCE: Final = {"field": 2000.0, "bleach": 900.0, "spot": 1000.0, "fixation": 4000.0}
SUBTENSE_DEG: Final = {"field": 40.0, "bleach": 60.0, "spot": 1.5, "fixation": 0.3}
SMALL: Final = "fixation"  # 5 mrad: its limit is on irradiance, 100 J/m² in 100 s
# E = L·π·α²/4, IEC 62471:2006, 4.3.4
SMALL_SOLID_ANGLE_SR: Final = math.pi * math.radians(SUBTENSE_DEG[SMALL]) ** 2 / 4
OPTICS: Final = {
    name: ChannelOptics(437.5, 0.5, SUBTENSE_DEG[name], bound, LOW_RATIO) for name, bound in RADIANCE.items()
}
EYES: Final = ("s01 right", "s01 left")
CHANNEL_NAMES: Final = ("bleach", "spot", "spot_red", "fixation", "spot_green", "field")
REFILLED_MS: Final = 620_000
DARK_MS: Final = 2_000
EXCHANGE_S: Final = 0.004
SLICE_S: Final = 0.7  # how often programs look after their box; below its dead-man time


class Killed(BaseException):
    """The program was ended in the midst of what it did."""


@dataclass(slots=True)
class Dose:
    """The dose of one eye within a sliding window, exact.

    Attributes:
        window_s: Length of the window.
    """

    window_s: float
    _parts: deque[tuple[float, float, float]] = field(default_factory=deque)  # begin, end, rate
    _sum: float = 0.0

    def add(self, begin_s: float, end_s: float, rate: float) -> None:
        """Take in light of a constant rate."""
        if rate <= 0.0 or end_s <= begin_s:
            return
        self._parts.append((begin_s, end_s, rate))
        self._sum += rate * (end_s - begin_s)

    def within(self, end_s: float) -> float:
        """Return the dose of the window that ends at a time."""
        oldest_s = end_s - self.window_s
        while self._parts and self._parts[0][1] <= oldest_s:
            begin_s, ended_s, rate = self._parts.popleft()
            self._sum -= rate * (ended_s - begin_s)
        if not self._parts:
            return 0.0
        begin_s, _, rate = self._parts[0]  # the parts follow each other: only the first may be cut by the edge
        return self._sum - rate * max(oldest_s - begin_s, 0.0)


@dataclass(slots=True)
class Eye:
    """What an eye has received: of large sources within 10⁴ s, and the worst 100 s of the small one in that time.

    Attributes:
        most_share: Largest share of the blue-light limit at any time: of 10⁶ J·sr⁻¹·m⁻² and of 100 J·m⁻², in sum.
    """

    most_share: float = 0.0
    _large: Dose = field(default_factory=lambda: Dose(WINDOW_S))
    _small: Dose = field(default_factory=lambda: Dose(100.0))
    _worst: deque[tuple[float, float]] = field(default_factory=deque)  # time and dose of 100 s, the worst first

    def see(self, begin_s: float, end_s: float, radiances: dict[str, float]) -> None:
        """Look at all channels at once."""
        self._large.add(begin_s, end_s, sum(value for name, value in radiances.items() if name != SMALL))
        self._small.add(begin_s, end_s, radiances.get(SMALL, 0.0) * SMALL_SOLID_ANGLE_SR)
        dose = self._small.within(end_s)
        while self._worst and self._worst[-1][1] <= dose:
            self._worst.pop()
        self._worst.append((end_s, dose))
        self.most_share = max(self.most_share, self.share(end_s))

    def share(self, now_s: float) -> float:
        """Return the share of the limit that the window up to a time holds."""
        while self._worst and self._worst[0][0] < now_s - WINDOW_S:
            self._worst.popleft()
        return self._large.within(now_s) / 1e6 + (self._worst[0][1] / 100.0 if self._worst else 0.0)


class Hardware(Protocol):
    """A box as the desk sees it: bytes and time in, bytes and light out."""

    def receive(self, raw: bytes, time_s: float) -> None: ...

    def advance(self, time_s: float) -> None: ...

    def take(self) -> list[bytes]: ...

    def restart(self, cause: str) -> None: ...

    def close(self) -> None: ...


Look = Callable[[float, float, dict[str, float]], None]  # begin, end, radiance of each channel
Maker = Callable[[str, float, Look], Hardware]  # serial number, rate of the clock in ppm


@dataclass(slots=True)
class TwinHardware:
    """The simulated twin."""

    serial: str
    clock_ppm: float
    look: Look
    twin: SimulatedLightBox = field(init=False)
    _since_s: float = 0.0
    _radiances: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.twin = SimulatedLightBox(SimulatedBoxSettings(serial=self.serial, clock_ppm=self.clock_ppm))
        self.twin.watch = self._watch

    def receive(self, raw: bytes, time_s: float) -> None:
        """Take bytes."""
        self.twin.receive(raw, time_s)

    def advance(self, time_s: float) -> None:
        """Let time pass."""
        self.twin.advance(time_s)
        self._watch()

    def take(self) -> list[bytes]:
        """Return the lines sent since the last call."""
        lines = [emitted.line.rstrip(b"\n") for emitted in self.twin.emitted]
        self.twin.emitted.clear()
        return lines

    def restart(self, cause: str) -> None:
        """Restart the box."""
        self.twin.reset(cause)

    def close(self) -> None:
        """Do nothing: a twin holds nothing."""

    def _watch(self) -> None:
        now_s = self.twin.time_s
        if self._radiances:
            self.look(self._since_s, now_s, self._radiances)
        self._since_s = now_s
        self._radiances = {
            name: RADIANCE[name] * duty * (1.0 if state.high else LOW_RATIO)
            for state in self.twin.channels
            if (name := state.limits.name) in RADIANCE and state.mode != "O" and (duty := self.twin.duty(name)) > 0.0
        }


@dataclass(slots=True)
class FirmwareHardware:
    """The firmware's own code, compiled for this machine.

    Attributes:
        serial: Its serial number.
        power: Powers a box with a content of its EEPROM and the flags of the reset.
    """

    serial: str
    power: Callable[[bytes, int], FirmwareBox]
    look: Look
    _box: FirmwareBox | None = None
    _ms: int = 0

    def receive(self, raw: bytes, time_s: float) -> None:
        """Take bytes."""
        self.advance(time_s)
        self._running.send(raw)

    def advance(self, time_s: float) -> None:
        """Let time pass, to whole ms. In a long rest the box is dark after a second, and full after REFILLED_MS."""
        ms = int(time_s * 1000.0) - self._ms
        if ms > REFILLED_MS:
            self.advance((self._ms + DARK_MS) / 1000.0)
            self._running.run(REFILLED_MS - DARK_MS)
            self._ms = int(time_s * 1000.0)
            return
        while ms > 0:
            part = min(ms, 500)
            given = self._running.run_watched(part)
            begin_s, end_s = self._ms / 1000.0, (self._ms + part) / 1000.0
            mean = {
                name: RADIANCE[name] * (high_s + LOW_RATIO * low_s) / (end_s - begin_s)
                for name, (low_s, high_s) in zip(CHANNEL_NAMES, given, strict=True)
                if name in RADIANCE and low_s + high_s > 0.0
            }
            if mean:
                self.look(begin_s, end_s, mean)
            self._ms, ms = self._ms + part, ms - part

    def take(self) -> list[bytes]:
        """Return the lines sent since the last call."""
        return self._running.take().splitlines()

    def restart(self, cause: str) -> None:
        """Restart the box; its EEPROM stays."""
        memory = self._running.memory
        self._running.close()
        self._box = self.power(memory, {"P": 1, "E": 2, "B": 4, "W": 8}[cause])

    def close(self) -> None:
        """Forget the library."""
        self._running.close()

    @property
    def _running(self) -> FirmwareBox:
        if self._box is None:
            self._box = self.power(rested_memory(self.serial), 1)
        return self._box


@dataclass(slots=True)
class DeskBox:
    """A box on the desk, with the port it is plugged in and the eye before it."""

    serial: str
    world: World
    holder: Program | None = None
    eye: str | None = None
    plugged: bool = True
    lose_in: int = 0  # lines to the box that get lost
    lose_out: int = 0  # answers that get lost
    looker: Eye = field(default_factory=Eye)  # an eye that looks into this box all the time
    hardware: Hardware = field(init=False)

    def look(self, begin_s: float, end_s: float, radiances: dict[str, float]) -> None:
        """Let the eyes before it see its light."""
        self.looker.see(begin_s, end_s, radiances)
        if self.eye is not None:
            self.world.eyes.setdefault(self.eye, Eye()).see(begin_s, end_s, radiances)


@dataclass(slots=True)
class DeskLine:
    """The cable between a program and a box."""

    world: World
    box: DeskBox
    program: Program
    name: str = "desk"
    _inbox: deque[tuple[bytes, float]] = field(default_factory=deque)

    def now(self) -> float:
        """Return the time in s."""
        return self.world.now_s

    def open(self) -> None:
        """Open the port; that resets the box, as an Arduino is."""
        self.world.touch(self.program)
        if not self.box.plugged:
            raise DeviceLost("unplugged")
        if self.box.holder is not None and self.box.holder.alive and self.box.holder is not self.program:
            raise DeviceInUse("held")
        self.box.holder, self.box.eye = self.program, self.world.looking(self.program.eye)
        self.box.hardware.advance(self.world.now_s)
        self.box.hardware.restart("E")

    def close(self) -> None:
        """Release the port."""
        if self.box.holder is self.program:
            self.box.holder = None

    def write(self, line: bytes) -> float:
        """Send a line, if it gets there."""
        self.world.touch(self.program)
        if not self.box.plugged or self.box.holder is not self.program:
            raise DeviceLost("the port has gone")
        sent_s = self.world.now_s
        self.world.pass_quietly(EXCHANGE_S)
        if self.box.lose_in:
            self.box.lose_in -= 1
        else:
            self.box.hardware.receive(line, self.world.now_s)
        self.world.touch(self.program)
        return sent_s

    def read_line(self, timeout_s: float) -> Any:
        """Return a line, or None once the time is over."""
        self.world.touch(self.program)
        if not self.box.plugged:
            raise DeviceLost("the port has gone")
        self._collect()
        if not self._inbox:
            self.world.pass_quietly(timeout_s)
            self._collect()
        if not self._inbox:
            return None
        text, time_s = self._inbox.popleft()
        return Received(text, time_s)

    def _collect(self) -> None:
        for line in self.box.hardware.take():
            if self.box.lose_out:
                self.box.lose_out -= 1
            else:
                self._inbox.append((line, self.world.now_s))


@dataclass(frozen=True, slots=True)
class Received:
    """A line as it arrived."""

    text: bytes
    time_s: float


@dataclass(slots=True)
class Program:
    """A program that uses a box, until it ends or is killed."""

    name: str
    eye: str | None
    alive: bool = True
    dying_in: int | None = None  # steps (line or disk) until it is killed
    box: SerialLightBox | None = None


@dataclass(slots=True)
class World:
    """The desk.

    Attributes:
        folder: Where the account is.
        rng: Source of everything that happens.
        make: Makes the hardware of a box.
        count: How often what happened.
    """

    folder: Path
    rng: random.Random
    make: Maker = TwinHardware
    now_s: float = 0.0
    boot: int = 0
    booted_s: float = 0.0
    wall_step_s: float = 1.7e9
    count: Counter[str] = field(default_factory=Counter)
    eyes: dict[str, Eye] = field(default_factory=dict)
    boxes: list[DeskBox] = field(default_factory=list)
    programs: list[Program] = field(default_factory=list)
    _acting: Program | None = None

    def __post_init__(self) -> None:
        for serial in ("DESK0001", "DESK0002"):
            box = DeskBox(serial, self)
            broken = self.rng.random() < 0.2  # a wrong resonator, or none
            clock_ppm = self.rng.uniform(-700_000, 700_000) if broken else self.rng.uniform(-5000, 5000)
            box.hardware = self.make(serial, clock_ppm, box.look)
            self.boxes.append(box)
            self._store(None).folder.mkdir(parents=True, exist_ok=True)
            with self._store(None).change() as account:
                account.begin(serial)

    def moment(self) -> Moment:
        """Return the time by the computer's clocks."""
        return Moment(f"boot{self.boot}", self.now_s - self.booted_s, self.now_s + self.wall_step_s)

    @property
    def most_share(self) -> float:
        """Return the largest share of the limit that any eye has received."""
        return max(eye.most_share for eye in [*(box.looker for box in self.boxes), *self.eyes.values()])

    def looking(self, named: str | None) -> str | None:
        """Return whose eye looks into a box: the named one, none where that is stated, else any or none."""
        return (self.rng.choice([*EYES, None]) if named is None else named) or None

    def touch(self, program: Program | None) -> None:
        """Count a step of a program, and end it where its time has come."""
        if program is None:
            return
        if program.dying_in is not None:
            program.dying_in -= 1
            if program.dying_in < 0 and program.alive:
                program.alive = False
                self.count["killed in the midst"] += 1
        if not program.alive:
            raise Killed

    def pass_quietly(self, duration_s: float) -> None:
        """Let time pass without any program doing anything."""
        self.now_s += duration_s
        for box in self.boxes:
            box.hardware.advance(self.now_s)

    def live(self, steps: int) -> None:
        """Let so many things happen."""
        with self._watched_disk():
            for _ in range(steps):
                name = self.rng.choices([n for n, _ in HAPPENINGS], [weight for _, weight in HAPPENINGS])[0]
                getattr(self, f"_{name}")()
                self.count["steps"] += 1
            for program in list(self.programs):
                self._end(program, killed=True)
            self.pass_quietly(5.0)
        for box in self.boxes:
            box.hardware.close()

    @contextmanager
    def _watched_disk(self) -> Iterator[None]:
        replace, fsync = os.replace, os.fsync

        def watched(act: Callable[..., Any]) -> Callable[..., Any]:
            def done(*given: Any) -> Any:
                self.touch(self._acting)
                result = act(*given)
                self.touch(self._acting)
                return result

            return done

        with mock.patch.object(os, "replace", watched(replace)), mock.patch.object(os, "fsync", watched(fsync)):
            yield

    def _store(self, program: Program | None) -> FileStore:
        name = program.name if program else "the desk"
        return FileStore(self.folder, self.moment, self._sleep, name, lambda holder: holder in self._living())

    def _living(self) -> set[str]:
        return {program.name for program in self.programs if program.alive}

    def _sleep(self, duration_s: float) -> None:
        self.pass_quietly(duration_s)

    def _acts(self, program: Program, act: Callable[[SerialLightBox], object]) -> bool:
        """Let a program do something; return whether it was done."""
        self._acting = program
        try:
            assert program.box is not None
            act(program.box)
        except Killed:
            self._end(program, killed=True)
            return False
        except UnsafeStimulus:
            self.count["refused"] += 1
            return False
        except RadiometerError:
            self.count["failed"] += 1
            if self.rng.random() < 0.7:
                self._end(program, killed=False)
            return False
        finally:
            self._acting = None
        return True

    def _end(self, program: Program, *, killed: bool) -> None:
        if not killed and program.box is not None:
            with contextlib.suppress(Killed):
                program.box.close()
        program.alive = False
        for box in self.boxes:
            if box.holder is program:
                box.holder = None
        if program in self.programs:
            self.programs.remove(program)

    def _any(self) -> Program | None:
        return self.rng.choice(self.programs) if self.programs else None

    # what may happen

    def _open(self) -> None:
        box = self.rng.choice(self.boxes)
        eye = self.rng.choice([None, NO_EYE, EYES[0], EYES[0], EYES[1]])
        self.count["programs"] += 1
        program = Program(f"program {self.count['programs']}", eye)
        ledger = ExposureLedger(OPTICS, self._store(program), PROMISED, eye)
        program.box = SerialLightBox(BoxLink(DeskLine(self, box, program)), ledger, keep_alive=False)
        self.programs.append(program)
        if not self._acts(program, lambda opened: opened.open()):
            self._end(program, killed=True)

    def _light(self) -> None:
        if not self.programs:
            self._open()
        program = self._any()
        if program is None:
            return
        rng = self.rng
        high = rng.random() < 0.8
        channel = rng.choice(["field", "field", "spot", "bleach", "fixation"])
        highest = 20_000 if channel == "fixation" and high else 60_000
        value = rng.choice([highest, highest, rng.randint(1, highest), rng.randint(1, 400)])
        level = DriveLevel(value, CurrentRange.HIGH if high else CurrentRange.LOW)
        seconds = rng.choice([rng.uniform(0.05, 3.0), rng.uniform(3.0, 45.0)])
        verb = rng.choice(["pulse", "pulse", "pulse", "set", "ramp", "blink"])
        if verb == "ramp" and rng.random() < 0.9:  # the twin takes each ms of a ramp by itself: few are long
            seconds = rng.choice([0.001, rng.uniform(0.01, 1.5)])
        acts: dict[str, Callable[[SerialLightBox], object]] = {
            "pulse": lambda box: box.pulse(channel, level, seconds),
            "set": lambda box: box.set_level(channel, level),
            "ramp": lambda box: box.ramp(channel, DriveLevel(rng.choice([0, 1, value]), level.current_range), seconds),
            "blink": lambda box: (
                box.blink(channel, level, 0.0015, 0.002, rng.choice([1, 50]))
                if rng.random() < 0.3
                else box.blink(channel, level, min(seconds, 5.0), rng.uniform(0.1, 1.0), rng.choice([0, 1, 5]))
            ),
        }
        self.count["asked"] += 1
        if self._acts(program, acts[verb]):
            self.count["given"] += 1
            self._pass(rng.choice([0.0, rng.uniform(0.0, 1.2 * seconds)]))

    def _greed(self) -> None:
        """Take as much as is given: the longest pulse that is not refused, to its end."""
        if not self.programs:
            self._open()
        if (program := self._any()) is None:
            return
        channel = self.rng.choice(["field", "bleach"])
        for seconds in (45.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.3, 0.1):
            self.count["asked"] += 1
            if self._acts(program, lambda box, s=seconds: box.pulse(channel, DriveLevel(60_000), s)):  # type: ignore[misc]
                self.count["given"] += 1
                self._pass(seconds + 0.1)
                return
            if program not in self.programs:
                return

    def _wait(self) -> None:
        self._pass(self.rng.choice([0.01, 0.5, self.rng.uniform(0.0, 30.0)]))

    def _pass(self, duration_s: float) -> None:
        """Let time pass while every program looks after its box."""
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            self.pass_quietly(min(SLICE_S if self.programs else math.inf, end_s - self.now_s))
            for program in list(self.programs):
                self._acts(program, lambda box: box.tend_if_due())

    def _stall(self) -> None:
        self.count["stalled"] += 1
        self.pass_quietly(self.rng.uniform(0.3, 5.0))

    def _rest(self) -> None:
        self.count["rested"] += 1
        for program in list(self.programs):
            self._end(program, killed=self.rng.random() < 0.5)
        self.pass_quietly(self.rng.choice([self.rng.uniform(100, 4000), self.rng.uniform(9_000, 11_000)]))

    def _off(self) -> None:
        if (program := self._any()) is not None:
            channel = self.rng.choice(["field", "spot", None])
            self._acts(program, lambda box: box.safe() if channel is None else box.off(channel))

    def _close(self) -> None:
        if (program := self._any()) is not None:
            self._end(program, killed=False)

    def _kill(self) -> None:
        if (program := self._any()) is not None:
            self.count["killed"] += 1
            self._end(program, killed=True)

    def _kill_soon(self) -> None:
        if (program := self._any()) is not None:
            program.dying_in = self.rng.randint(0, 14)

    def _replug(self) -> None:
        self.count["replugged"] += 1
        box = self.rng.choice(self.boxes)
        box.plugged = False
        self._pass(self.rng.uniform(0.0, 3.0))
        box.hardware.restart("P")
        if box.holder is not None:
            self._acts(box.holder, lambda opened: opened.status())
            box.holder = None
        box.plugged = True

    def _restart(self) -> None:
        self.count["box restarted"] += 1
        self.rng.choice(self.boxes).hardware.restart(self.rng.choice("BW"))

    def _lose(self) -> None:
        self.count["lines lost"] += 1
        box = self.rng.choice(self.boxes)
        box.lose_in, box.lose_out = self.rng.choice([(0, 40), (0, 3), (3, 0), (40, 0), (2, 20)])

    def _clock(self) -> None:
        self.count["clock set"] += 1
        self.wall_step_s += self.rng.choice([-1, 1]) * 10 ** self.rng.uniform(0.0, 7.0)

    def _reboot(self) -> None:
        self.count["rebooted"] += 1
        for program in list(self.programs):
            self._end(program, killed=True)
        self.pass_quietly(self.rng.choice([30.0, self.rng.uniform(30.0, 15_000.0)]))
        self.boot, self.booted_s = self.boot + 1, self.now_s
        if self.rng.random() < 0.5:
            self._clock()

    def _harm(self) -> None:
        """Delete, cut, damage or forward the account."""
        self.count["account harmed"] += 1
        path = self.folder / "exposure-account.json"
        content = path.read_bytes() if path.exists() else b""
        if not content:
            return
        kind = self.rng.choice(["delete", "cut", "flip", "empty", "future"])
        if kind == "delete":
            path.unlink()
        elif kind == "cut":
            path.write_bytes(content[: self.rng.randrange(len(content))])
        elif kind == "flip":
            at = self.rng.randrange(len(content))
            path.write_bytes(content[:at] + bytes([content[at] ^ 1 << self.rng.randrange(8)]) + content[at + 1 :])
        elif kind == "empty":
            path.write_bytes(b"")
        else:
            with contextlib.suppress(ValueError):  # harmed before
                account = json.loads(content.partition(b"\n")[0])
                account["moment"][1] += 1e5
                account["moment"][2] += 1e5
                body = json.dumps(account).encode()
                path.write_bytes(body + b"\n" + hashlib.sha256(body).hexdigest().encode() + b"\n")

    def _confirm(self) -> None:
        """Have an honest person confirm that no eye was exposed."""
        eyes = [*(box.looker for box in self.boxes), *self.eyes.values()]
        if any(box.holder for box in self.boxes) or any(eye.share(self.now_s) > 1e-9 for eye in eyes):
            return
        self.count["confirmed"] += 1
        for box in self.boxes:
            with self._store(None).change() as account:
                account.confirm(box.serial)


HAPPENINGS: Final = [
    ("open", 8), ("light", 30), ("greed", 12), ("wait", 12), ("off", 5), ("close", 4), ("kill", 5), ("kill_soon", 5),
    ("stall", 2), ("replug", 3), ("restart", 2), ("lose", 4), ("clock", 3), ("reboot", 1.5), ("harm", 0.7), ("rest", 3),
    ("confirm", 3),
]  # fmt: skip


@dataclass(slots=True)
class Desks:
    """What came of many sequences.

    Attributes:
        count: How often what happened, in sum.
        shares: Largest share of the limit that an eye received, for each sequence.
    """

    count: Counter[str] = field(default_factory=Counter)
    shares: list[float] = field(default_factory=list)


def live_through(folder: Path, seeds: Iterable[int], make: Maker = TwinHardware, steps: int = 30) -> Desks:
    """Let a sequence of `steps` things happen for each seed."""
    desks = Desks()
    for seed in seeds:
        world = World(folder / str(seed), random.Random(seed), make)
        world.live(steps)
        desks.count += world.count
        desks.shares.append(world.most_share)
        shutil.rmtree(world.folder)
    return desks


def firmware_maker(firmware: Path, folder: Path) -> Maker:
    """Return what makes boxes that run the firmware's code. Needs gcc."""
    library, number = build(firmware, folder / "light_box.so"), itertools.count()

    def power(memory: bytes, flags: int) -> FirmwareBox:
        return FirmwareBox(library, folder / f"{next(number)}.so", flags, memory=memory)

    return lambda serial, clock_ppm, look: FirmwareHardware(serial, power, look)
