"""A scene whose radiances are known, and a witness who holds every reading that a client saw against it."""

from __future__ import annotations

import json
import sqlite3
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from radiometer.daemon.journal import Journal
from radiometer.daemon.timestamps import iso_time, now_us
from radiometer.data import Patch, Quantity, Reading

SERIAL = "22500001"
# Radiance in W sr-1 m-2 of each patch: peak 1.5 W sr-1 m-2 of a screen of gamma 2.2, driven at 0.8, 0.6 and 0.4.
PATCHES: Mapping[str, tuple[dict[str, int], float]] = {
    "bright": ({"x": 20, "y": 30, "width": 20, "height": 20}, 1.5 * 0.8**2.2),
    "mid": ({"x": 70, "y": 30, "width": 20, "height": 20}, 1.5 * 0.6**2.2),
    "dim": ({"x": 120, "y": 30, "width": 20, "height": 20}, 1.5 * 0.4**2.2),
}
_SCENE = """\
format: radiometer-bench/1
name: soak bench
lens: {focal_length_mm: 16, f_number: 4, transmittance: 0.95, transmittance_u_rel: 0.01, vignetting: cos4}
source: {kind: screen, wavelength_nm: 550}
scene:
  kind: screen
  peak_radiance_W_per_sr_m2: 1.5
  background: 0.05
  patches:
    - {name: bright, x: 10, y: 10, width: 45, height: 100, drive: 0.8}
    - {name: mid, x: 60, y: 10, width: 45, height: 100, drive: 0.6}
    - {name: dim, x: 110, y: 10, width: 45, height: 100, drive: 0.4}
patch: {x: 20, y: 30, width: 20, height: 20}
"""
_SIMULATED = (
    f'camera: {{kind: simulated, preset: BFS-U3-19S4M, serial: "{SERIAL}", seed: 1, width: 160, height: 120}}\n'
)
_ON_THE_WIRE = f'camera: {{kind: genicam, id: "{SERIAL}"}}\n'
_TOLERANCE_REL = 0.02
_KEPT_EXAMPLES = 20


def write_benches(folder: Path) -> tuple[Path, Path]:
    """Write the bench with the simulated camera, and the one whose camera is on the wire, and return their paths."""
    simulated, wire = folder / "simulated.yaml", folder / "wire.yaml"
    simulated.write_text(_SCENE + _SIMULATED + "calibration: calibrations/simulated.yaml\n", encoding="utf-8")
    wire.write_text(_SCENE + _ON_THE_WIRE, encoding="utf-8")
    return simulated, wire


def is_true(value: float, u: float, patch: str) -> bool:
    """Tell whether a radiance may be that of a patch; that of no other patch passes."""
    truth = PATCHES[patch][1]
    return abs(value - truth) <= 4 * u + _TOLERANCE_REL * truth


@dataclass(slots=True)
class Witness:
    """What clients saw: readings by number, false values, losses of answers.

    Attributes:
        seen: Radiance and place of each reading by its number.
        main: Numbers that the stream of the one patch for all brought.
        false: What was false, in words; the first few.
        counts: How often what happened.
    """

    seen: dict[int, tuple[float, int]] = field(default_factory=dict)
    main: set[int] = field(default_factory=set)
    false: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def count(self, what: str) -> None:
        """Note that something happened."""
        with self._lock:
            self.counts[what] += 1

    def blame(self, what: str) -> None:
        """Note that something was false."""
        with self._lock:
            self.counts["false"] += 1
            self.false = [*self.false, what][:_KEPT_EXAMPLES]

    def saw_value(self, who: str, value: float, u: float, patch: str) -> None:
        """Hold a value against the radiance of the patch that it was asked for."""
        self.count(who)
        if not is_true(value, u, patch):
            self.blame(f"{who}: {value:.6g} ± {u:.2g} for {patch}, which has {PATCHES[patch][1]:.4g}")

    def saw(self, who: str, reading: Mapping[str, Any], patch: str) -> None:
        """Take a whole reading down, and hold it against the patch that it was asked for."""
        radiance = reading["radiance"]
        self.saw_value(who, radiance["value"], radiance["u"], patch)
        if reading["patch"] != PATCHES[patch][0]:
            self.blame(f"{who}: reading {reading['sequence']} is of {reading['patch']}, {patch} was asked for")
        entry = (float(radiance["value"]), int(reading["patch"]["x"]))
        with self._lock:
            if self.seen.setdefault(int(reading["sequence"]), entry) != entry:
                self.false.append(f"{who}: two readings have the number {reading['sequence']}")
                self.counts["false"] += 1


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the journal says of what clients saw.

    Attributes:
        readings: Readings in the journal.
        seen: Readings that a client saw.
        missing: Seen, and not in the journal as seen.
        holes: Numbers that the journal lacks between its first and last.
        unheard: Readings for all that the stream did not bring, though it was listened to throughout.
        false_rows: Readings in the journal that are not what their patch is, or not in the stream that is theirs.
        alarms: Alarms in the journal by what they are about.
    """

    readings: int
    seen: int
    missing: int
    holes: int
    unheard: int
    false_rows: int
    alarms: Mapping[str, int]


def fill_journal(path: Path) -> int:
    """Write two days of both streams and as many events as an answer holds; return the last sequence number."""
    now = now_us()
    times = [iso_time(now - k * 60_000_000) for k in range(2 * 1440, 0, -1)]
    with Journal(path) as journal:
        for name, patch in (("", "bright"), ("dim", "dim")):
            (place, value) = PATCHES[patch]
            quantity = Quantity(value, value / 200, "W sr-1 m-2")
            journal.append([Reading(quantity, Patch(**place), SERIAL, time=at, name=name) for at in times])
        for _ in range(200):
            journal.note("remark", "written before the soak began")
    return 2 * len(times)


def judge(journal: Path, witness: Witness, after: int = 0) -> Verdict:
    """Hold what a journal got after a sequence number against what clients saw, and against the scene."""
    connection = sqlite3.connect(journal)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    stored: dict[int, tuple[float, int]] = {}
    main, false_rows = set[int](), 0
    by_place = {place["x"]: name for name, (place, _) in PATCHES.items()}
    for sequence, stream, line in connection.execute(
        "SELECT sequence, stream, json FROM readings WHERE sequence > ? ORDER BY sequence", (after,)
    ):
        reading = json.loads(line)
        radiance, name = reading["radiance"], by_place.get(reading["patch"]["x"], "")
        stored[sequence] = (float(radiance["value"]), int(reading["patch"]["x"]))
        false_rows += not (name and is_true(radiance["value"], radiance["u"], name) and _is_in_place(stream, name))
        if stream == "":
            main.add(sequence)
    alarms = Counter(
        message.split(":")[0] + (" late" if "has not answered" in message else "")
        for (message,) in connection.execute("SELECT message FROM events WHERE kind = 'alarm'")
    )
    connection.close()
    first, last = (min(witness.main), max(witness.main)) if witness.main else (0, -1)
    seen = {n: entry for n, entry in witness.seen.items() if n > after}
    return Verdict(
        len(stored), len(seen), sum(stored.get(n) != entry for n, entry in seen.items()),
        max(stored) - min(stored) + 1 - len(stored), len({n for n in main if first <= n <= last} - witness.main),
        false_rows, dict(alarms),
    )  # fmt: skip


def _is_in_place(stream: str, patch: str) -> bool:
    """Tell whether a patch may be in a stream: the bright one is everybody's, the dim one has a name here."""
    return patch == {"": "bright", "patch dim": "dim"}.get(stream, patch)
