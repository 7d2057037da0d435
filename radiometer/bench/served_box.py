"""Puts a simulated light box, or its firmware in simavr, behind a pseudo-terminal."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from radiometer.bench.box_holder import own_folder
from radiometer.bench.boxes import SIMULATED_PORTS, LightBoxConfig, exposure_store, read_preset
from radiometer.errors import OutputError, OutputRefused, UsageError
from simulators.light_box.avr_box import AvrBox
from simulators.light_box.box import SimulatedBoxSettings, SimulatedLightBox
from simulators.light_box.lines import LineFaults, PtyServer, WiredLightBox, was_left_behind
from simulators.observers.observer import Observer, ObserverAtBox, behaviour_of

_LOOK_S: Final = 0.05  # a tenth of the shortest period that anybody presses or resets a box with
_PRESS_S: Final = 0.2  # of a short press by a finger


def places_of(preset: LightBoxConfig) -> dict[str, tuple[float, float]]:
    """Return the places of the channels with separate openings, in degrees temporal of and above the mark."""
    known = preset.channels
    return {name: (c.place.temporal_deg, -c.place.below_deg) for name, c in known.items() if c.place is not None}


def seat_subject(twin: SimulatedLightBox, behaviour: str, seed: int, filter_density: float) -> ObserverAtBox:
    """Seat a simulated subject before a simulated box and return it.

    Args:
        behaviour: Name of a behaviour of `simulators.observers.observer`.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the behaviour is unknown.
    """
    chosen, rng = behaviour_of(behaviour), np.random.default_rng(seed)
    subject = ObserverAtBox(
        Observer(chosen.eye(rng), chosen.habits, rng),
        twin,
        filter_density=filter_density,
        leaves_after_min=chosen.leaves_after_min,
        taps=chosen.taps,
    )
    subject.sit_down()
    return subject


@dataclass(frozen=True, slots=True)
class ServedBox:
    """A light box on a pseudo-terminal."""

    server: PtyServer  # serves it once started
    press: Callable[[bool], None]  # presses (True) or releases (False) the button now
    reset: Callable[[], None]  # restarts the box now


def served_box(
    serial: str,
    link: Path | None,
    *,
    firmware: Path | None = None,
    clock_ppm: float = 0.0,
    corrupt: float = 0.0,
    drop: float = 0.0,
    seed: int = 0,
    subject: str | None = None,
    filter_density: float = 0.0,
) -> ServedBox:
    """Return a simulated light box ready to be served.

    Args:
        link: Name of its port; in the folder where boxes are looked for where None.
        firmware: Run this firmware (Intel HEX) in simavr instead of the twin.
        corrupt: Probability that a byte on the line becomes another one.
        drop: Probability that a byte is lost.
        seed: Makes the faults, and the subject's answers.
        subject: Simulated subject before it, as `seat_subject` knows them; it sees and presses in real time.
        filter_density: Optical density of the filter before the spot.

    Raises:
        UsageError: If the serial number is not possible, or the subject: it is unknown, or is to sit before the
            firmware, whose LEDs are not simulated.
        OutputError: If the link cannot be made.
        OutputRefused: If a file, or a link of another program, is where the link is to be.
        MissingLibrary: If simavr is asked for and not installed.
        UnsafeStimulus: If the account of its exposure cannot be stored.
    """
    if not re.fullmatch(r"[0-9A-Za-z-]{8}", serial):
        raise UsageError(f"--serial {serial!r}: expected eight letters or digits, such as TWIN0001")
    place = link or own_folder(SIMULATED_PORTS) / serial
    if os.path.lexists(place) and not was_left_behind(place):
        raise OutputRefused(
            f"{place} exists already, and no simulated box that was killed left it; name another place with --link"
        )
    try:
        place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make {place.parent}: {error.strerror or error}") from error
    faults_in, faults_out = (LineFaults(corrupt, drop, rng=np.random.default_rng((seed, way))) for way in (0, 1))
    if firmware is not None and subject is not None:
        raise UsageError("a simulated subject sees the LEDs of the twin, not of the firmware: leave out one of them")
    store = exposure_store()
    with store.change() as account:
        account.begin(serial, store.holder)  # a box that is simulated from now on: no eye was before it
    if firmware is not None:
        avr = AvrBox(firmware, serial)
        server = PtyServer(avr, place, faults_in, faults_out)
        return ServedBox(server, _locked(server, lambda pressed: avr.press(pressed=pressed)), lambda: None)
    twin = SimulatedLightBox(SimulatedBoxSettings(serial=serial, clock_ppm=clock_ppm))
    if subject is not None:
        seat_subject(twin, subject, seed, filter_density).places = places_of(read_preset())
    server = PtyServer(WiredLightBox(twin), place, faults_in, faults_out)

    def reset() -> None:
        with server.lock:
            twin.reset("E")

    return ServedBox(server, _locked(server, lambda pressed: twin.press(server.time_s(), pressed=pressed)), reset)


def _locked(server: PtyServer, act: Callable[[bool], None]) -> Callable[[bool], None]:
    def press(pressed: bool) -> None:
        with server.lock:
            act(pressed)

    return press


def _no_visitor(seconds: float) -> bool:
    time.sleep(seconds)
    return False


def tend(
    made: ServedBox, reset_every_s: float | None, press_every_s: float | None, entered: Callable[[float], bool] | None
) -> None:
    """Press and reset a box as often as asked, in s, and press where somebody entered something, for ever."""
    start_s = time.monotonic()
    resets = presses = 0
    while True:
        if (entered or _no_visitor)(_LOOK_S):
            _press(made)
        elapsed_s = time.monotonic() - start_s
        if reset_every_s and elapsed_s > (resets + 1) * reset_every_s:
            resets += 1
            made.reset()
        if press_every_s and elapsed_s > (presses + 1) * press_every_s:
            presses += 1
            _press(made)


def _press(made: ServedBox) -> None:
    made.press(True)
    time.sleep(_PRESS_S)
    made.press(False)
