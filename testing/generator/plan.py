"""What is captured, in which order: settings as they are labelled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

REFERENCE_EVERY = 12
SETTLING_S = 24.0  # from one capture to the next
FRAME_PERIOD_S = 0.4


@dataclass(frozen=True)
class Setting:
    """One capture: the labels of its settings, and how many frames are taken."""

    exposure_s: float
    gain_db: float = 0.0
    f_number: float = 4.0
    temperature_c: float = 35.0
    level: float = 1.0
    pattern: str = "chart"
    closed: bool = False
    frames: int = 4

    @property
    def is_lit(self) -> bool:
        """Tell whether the source's light reaches the sensor."""
        return not self.closed and self.level > 0


@dataclass(frozen=True)
class Shot:
    """One frame of a capture, with what the world knows of it."""

    setting: Setting
    capture: int
    number: int
    time_s: float
    temperature_c: float
    jitter: float


REFERENCE = Setting(0.9e-3, level=0.8)


def darks() -> list[Setting]:
    """Return cap-on and lamp-off captures."""
    cap = [Setting(t, g, closed=True) for t in (40e-6, 1e-3, 10e-3, 0.1, 1.0) for g in (0.0, 12.0, 24.0)]
    cap += [
        Setting(t, g, temperature_c=T, closed=True) for T in (25.0, 45.0) for t in (10e-3, 1.0) for g in (0.0, 24.0)
    ]
    return cap + [Setting(t, g, level=0.0) for t in (0.1, 1.0) for g in (0.0, 12.0)]


def exposure_ladders() -> list[Setting]:
    """Return exposures at full and at a tenth of the drive, some within one line time of each other."""
    full = [41e-6, 67.3e-6, 113e-6, 187e-6, 311e-6, 523e-6, 877e-6, 1.151e-3]
    close = [101e-6, 104.2e-6, 107.1e-6, 110.3e-6]
    tenth = [0.43e-3, 1.13e-3, 2.9e-3, 7.3e-3, 9e-3, 10e-3, 11e-3]
    return [Setting(t) for t in full + close] + [Setting(t, level=0.1) for t in tenth]


def drive_ladders() -> list[Setting]:
    """Return levels of the source at two exposures."""
    return [Setting(0.9e-3, level=d) for d in (0.6, 0.4, 0.2, 0.1)] + [
        Setting(4.1e-3, level=d) for d in (0.25, 0.1, 0.05)
    ]


def gain_ladder() -> list[Setting]:
    """Return every 3 dB at two signal levels that stay below clipping."""
    chosen = []
    for gain in np.arange(3.0, 24.1, 3.0):
        room = 10 ** (gain / 20)
        chosen += [Setting(0.9e-3 / room, float(gain)), Setting(1.7e-3 / room, float(gain), level=0.15)]
    return chosen


def f_number_ladder() -> list[Setting]:
    """Return f-numbers at t proportional to N squared, and pairs at one exposure."""
    along = [Setting(0.9e-3 * (n / 4) ** 2, f_number=n) for n in (2.8, 5.6, 8.0, 11.0)]
    return along + [Setting(0.35e-3, f_number=n) for n in (2.8, 5.6, 8.0)]


def surroundings() -> list[Setting]:
    """Return lit captures at other temperatures, other patterns, and over-exposed ones."""
    warm = [
        s
        for T in (25.0, 45.0)
        for s in (
            Setting(0.9e-3, temperature_c=T),
            Setting(0.2e-3, temperature_c=T),
            Setting(0.1e-3, 15.0, temperature_c=T),
        )
    ]
    patterns = [
        Setting(t, pattern=p) for p in ("inverted", "bright_surround", "dark_surround") for t in (0.3e-3, 1.1e-3)
    ]
    return warm + patterns + [Setting(1.6e-3), Setting(1.6e-3, f_number=2.8), Setting(0.8e-3, 6.0)]


def rich(rng: np.random.Generator, *, repeated: int = 20, colours: bool = False) -> list[Setting]:
    """Return the standard plan in random order inside temperature blocks, the reference twice every 12 captures."""
    lit = exposure_ladders() + drive_ladders() + gain_ladder() + f_number_ladder() + surroundings()
    if colours:
        lit += [Setting(t, pattern=p) for p in ("red", "green", "blue") for t in (0.3e-3, 1.1e-3)]
    again = [lit[i] for i in rng.permutation(len(lit))[:repeated]]
    chosen = lit + again + darks()
    mild = [s for s in chosen if s.temperature_c == 35.0]
    mild = [mild[i] for i in rng.permutation(len(mild))]
    blocks = [
        mild[: len(mild) // 2],
        [s for s in chosen if s.temperature_c == 45.0],
        [s for s in chosen if s.temperature_c == 25.0],
        mild[len(mild) // 2 :],
    ]
    ordered = [s for b in blocks for s in (b[i] for i in rng.permutation(len(b)))]
    return with_references(ordered)


def with_references(ordered: list[Setting]) -> list[Setting]:
    """Return the settings with the reference twice in a row after every 12, at the temperature of its neighbours."""
    result: list[Setting] = []
    for number, setting in enumerate(ordered):
        if number % REFERENCE_EVERY == 0:
            result += [replace(REFERENCE, temperature_c=setting.temperature_c)] * 2
        result.append(setting)
    return result


def bracket(rng: np.random.Generator, *, repeats: int = 2, with_darks: bool = True) -> list[Setting]:
    """Return twelve exposures of one scene, each some times over, and darks."""
    times = np.geomspace(41e-6, 1.35e-3, 12)
    lit = [Setting(float(t)) for t in times] * repeats
    dark = [Setting(t, closed=True) for t in (41e-6, 1e-3, 10e-3, 0.1)] if with_darks else []
    everything = lit + dark
    return [everything[i] for i in rng.permutation(len(everything))]


def afterglow(rng: np.random.Generator) -> list[Setting]:
    """Return a bracket, and thrice a bright capture with a row of long dark ones behind it, in this order."""
    row = [REFERENCE, *(Setting(t, closed=True) for t in (2.0, 2.0, 4.0, 2.0, 4.0, 2.0))]
    start = [Setting(t, closed=True) for t in (41e-6, 1.0, 4.0)]
    return start + bracket(rng, with_darks=False) + 3 * row


def short(rng: np.random.Generator) -> list[Setting]:
    """Return 25 captures for frames of many pixels: every covariate is moved, none of them finely."""
    exposures = [Setting(t) for t in (41e-6, 113e-6, 311e-6, 523e-6, 877e-6, 1.151e-3)]
    levels = [Setting(t, level=0.1) for t in (0.43e-3, 2.9e-3, 9e-3)]
    gains = [Setting(0.9e-3 / 10 ** (g / 20), g) for g in (6.0, 12.0, 18.0)]
    stops = [Setting(0.9e-3 * (n / 4) ** 2, f_number=n) for n in (2.8, 5.6, 8.0)]
    surroundings = [Setting(0.3e-3, pattern=p) for p in ("bright_surround", "dark_surround")]
    again = [Setting(0.9e-3, temperature_c=45.0), REFERENCE, REFERENCE, REFERENCE]
    cap = [Setting(t, g, closed=True) for t, g in ((40e-6, 0.0), (0.1, 0.0), (1.0, 0.0), (0.1, 24.0))]
    chosen = exposures + levels + gains + stops + surroundings + again + cap
    return [chosen[i] for i in rng.permutation(len(chosen))]


def dark_only(rng: np.random.Generator) -> list[Setting]:
    """Return darks and nothing else."""
    chosen = [s for s in darks() if s.closed]
    return [chosen[i] for i in rng.permutation(len(chosen))]
