"""A machine of hypothesis that drives all SCPI commands against a camera and a light box that fail at any time."""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from radiometer.daemon.journal import Journal
from radiometer.daemon.scpi.commands import command_table
from radiometer.daemon.scpi.language import Boolean, Choice, Command, Number, short_form
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.station import Station
from radiometer.errors import DeviceError
from testing.fake_station import QUICK, FakeBox, FakeInstrument
from testing.patience import within

TABLE = command_table()
SESSIONS = 3
ANSWER_S = 20.0  # a message that takes longer has hung: the fakes answer in milliseconds
_EDGES = (
    "0",
    "-0",
    "1",
    "-1",
    "1e-30",
    "1e30",
    "1e400",
    "-1E400",
    "0.5",
    "65535",
    "65536",
    "#HFFFFFFFFFFFFFFFF",
    "#B1",
)
_FAULTS = ("none", "failing", "unplugged", "bug", "failing")
_STIRRING = (
    "TRIG:TIM 0",
    "INIT:CONT OFF",
    "INIT",
    "INIT:CONT ON",
    "SENS:PATC 1,2,3,4",
    "*RST",
    "ABOR",
    "SOUR:LED1:LEV 1",
)
_ODD = (
    "",
    "NAN",
    "INF",
    "'text'",
    '"a""b"',
    "#15hello",
    "#0rest",
    "ON",
    "NONE",
    "CENT",
    "1 KG",
    "@",
    "850 NM",
    "0.85 UM",
)


def _words(command: Command, *, query: bool) -> list[list[str]]:
    """Return what may stand at each place of the arguments of a command, right and wrong."""
    places = []
    for parameter in command.ask_parameters if query else command.parameters:
        words = [*_EDGES, *_ODD]
        if isinstance(parameter, Number):
            limits = parameter.limits(_LIMITS_OF)
            middle = (limits.low + limits.high) / 2
            words += [f"{value:.12g}" for value in (limits.low, limits.high, limits.default, middle)] * 4
            words += [f"{limits.low - 1e-3:.12g}", f"{limits.high * 1.001:.12g}", "MIN", "MAX", "DEF", "MINimum"]
            words += [f"{limits.default:.9g} {unit}" for unit in ("MS", "US", "DB", "NM", "PCT", "S")]
            words += list(parameter.also)
        elif isinstance(parameter, Choice):
            words += [form for word in parameter.words for form in (word, short_form(word).lower())] * 4
        elif isinstance(parameter, Boolean):
            words += ["ON", "OFF", "1", "0"] * 4
        places.append(words)
    return places


class _Limits:
    """Stands in for a station where only the camera's limits are asked for."""

    instrument = FakeInstrument(openings=1)


_LIMITS_OF: Any = _Limits()


@st.composite
def units(draw: st.DrawFn) -> str:
    """Draw one command or query with arguments."""
    command = draw(st.sampled_from(TABLE.commands))
    query = draw(st.booleans()) if command.do and command.ask else command.do is None
    header = draw(st.sampled_from(command.spellings())).replace(
        "<n>", draw(st.sampled_from(["", "1", "2", "3", "9999"]))
    )
    places = _words(command, query=query)
    count = len(places) if draw(st.integers(0, 3)) else draw(st.integers(0, len(places) + 1))
    arguments = [draw(st.sampled_from([*places, list(_EDGES)][place])) for place in range(count)]
    return f":{header}{'?' * query} {','.join(arguments)}".rstrip().replace(":*", "*")


class ScpiMachine(RuleBasedStateMachine):
    """Sends messages of several sessions; nothing may raise, hang, or leave a value outside its limits."""

    def __init__(self) -> None:
        super().__init__()
        self._runner = asyncio.Runner()
        self._folder = tempfile.TemporaryDirectory()
        self.instrument, self.box = FakeInstrument(measure_s=0.002), FakeBox()
        self._whole = self.instrument.measure
        self.sessions: list[Session] = []
        self.waiting: list[asyncio.Task[str | None]] = []

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine to its end."""
        return self._runner.run(work)

    @initialize()
    def begin(self) -> None:
        """Start a station with a camera and a box, and connect clients."""
        self.run(self._begin())

    async def _begin(self) -> None:
        journal = Journal(Path(self._folder.name) / "journal.sqlite")
        self.station = Station(self.instrument, journal, box=self.box, times=QUICK)
        await self.station.start()
        self.sessions = [Session(self.station, TABLE) for _ in range(SESSIONS)]
        for session in self.sessions:
            self.station.on_change.append(session.state_changed)

    @rule(number=st.integers(0, SESSIONS - 1), message=st.lists(units(), min_size=1, max_size=4).map(";".join))
    def send(self, number: int, message: str) -> None:
        """Send a message and wait for its reply."""
        reply = self.run(self._answer(self.sessions[number], message))
        if reply is not None:
            assert reply.encode("latin-1")
            assert "#" in reply or "\n" not in reply

    @rule(fault=st.sampled_from(_FAULTS), messages=st.lists(st.sampled_from(_STIRRING), min_size=2, max_size=6))
    def stir(self, fault: str, messages: list[str]) -> None:
        """Send what changes the course of things in quick succession: while a slow measurement is in hand."""
        self.change_camera(fault, 0.02)
        self.run(self._stir(messages))

    @rule(number=st.integers(0, SESSIONS - 1), message=units())
    def send_and_go_on(self, number: int, message: str) -> None:
        """Send a message and let others go first."""
        self.run(self._later(self.sessions[number], message))

    @rule(fault=st.sampled_from(_FAULTS), measure_s=st.sampled_from([0.0005, 0.02]))
    def change_camera(self, fault: str, measure_s: float) -> None:
        """Unplug the camera, show it a scene that cannot be measured, give its driver a bug, or mend it."""
        self.instrument.measure_s = measure_s
        self.instrument.unplugged, self.instrument.failing = fault == "unplugged", fault == "failing"
        self.instrument.measure = _broken if fault == "bug" else self._whole  # type: ignore[method-assign]

    @rule(unplugged=st.booleans())
    def change_box(self, unplugged: bool) -> None:
        """Unplug the light box or plug it in again."""
        self.box.unplugged = unplugged

    @rule()
    def pass_time(self) -> None:
        """Let the station work."""
        self.run(asyncio.sleep(0.01))

    @rule(number=st.integers(0, SESSIONS - 1))
    def hang_up(self, number: int) -> None:
        """End a session and begin another in its place."""
        self.run(self._hang_up(number))

    @invariant()
    def all_is_well(self) -> None:
        """No loop has ended, what is set lies within its limits, and the state can be written as JSON."""
        if not self.sessions:
            return
        assert self.station.failed_task() is None, repr(self.station.failed_task())
        if self.instrument.openings:
            self.station.acquisition.check_settings(self.station.settings)
        every_s = self.station.acquisition.every_s
        assert every_s is None or 0.0 <= every_s <= 86400.0
        assert all(0.0 <= level <= 1.0 for level in self.box.levels.values())
        json.dumps(self.station.status(), allow_nan=False)

    def teardown(self) -> None:
        """Mend everything; the station must still measure and answer, then end."""
        if self.sessions:
            self.change_camera("none", 0.0005)
            self.box.unplugged = False
            self.run(self._finish())
        self._runner.close()
        self._folder.cleanup()

    async def _answer(self, session: Session, message: str) -> str | None:
        async with asyncio.timeout(within(ANSWER_S)):
            outcome = session.execute(message)
            return await outcome if isinstance(outcome, Coroutine) else outcome

    async def _later(self, session: Session, message: str) -> None:
        self.waiting.append(asyncio.create_task(self._answer(session, message)))
        await asyncio.sleep(0)

    async def _stir(self, messages: list[str]) -> None:
        for message in messages:
            await self._later(self.sessions[0], message)
            await asyncio.sleep(0.004)

    async def _hang_up(self, number: int) -> None:
        self.station.on_change.remove(self.sessions[number].state_changed)
        self.sessions[number].close()
        self.sessions[number] = Session(self.station, TABLE)
        self.station.on_change.append(self.sessions[number].state_changed)
        await asyncio.sleep(0)

    async def _finish(self) -> None:
        try:
            async with asyncio.timeout(within(ANSWER_S)):
                for reply in await asyncio.gather(*self.waiting):
                    assert reply is None or isinstance(reply, str)
                self.station.reset()
                while True:
                    try:
                        await self.station.acquisition.measure()
                        break
                    except DeviceError:
                        await asyncio.sleep(0.01)
            assert (await self._answer(self.sessions[0], "*IDN?") or "").startswith("Fake,F-1,")
        finally:
            await self.station.stop()


_broken: Callable[..., Any] = lambda settings: 1 / 0  # noqa: E731


def machine_settings(examples: int, *, derandomize: bool = True) -> settings:
    """Return settings for a number of sequences of 40 steps; times vary, so a failing sequence is reported unshrunk."""
    return settings(
        max_examples=examples,
        stateful_step_count=40,
        deadline=None,
        derandomize=derandomize,
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
