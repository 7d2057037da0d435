"""Course of a display report: is the screen seen, does it settle, then one method after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from radiometer.errors import UsageError
from radiometer.screen.checks import wait_until_steady
from radiometer.screen.meter import ScreenReading
from radiometer.screen.plan import ScreenStep
from radiometer.screen.report.figures import WHITE, Examined, Section
from radiometer.screen.report.methods import METHODS, warm_up_section
from radiometer.screen.run import measure_steps

WARM_UP: Final = "warm_up"


def chosen_methods(names: Sequence[str], *, turned: bool) -> tuple[str, ...]:
    """Return the methods to run in order: the named ones; by default all that the geometry has.

    The viewing angle needs a geometry with angles to turn the screen to. Raises UsageError if it is asked for without,
    or a name is unknown.
    """
    known = (WARM_UP, *METHODS)
    for name in names:
        if name not in known:
            raise UsageError(f"method {name!r} is unknown; choose from {', '.join(known)}")
    if "viewing_angle" in names and not turned:
        raise UsageError("viewing_angle needs angles: --geometry viewing_angle, or --angles -30,30")
    return tuple(one for one in known if (one in names if names else one != "viewing_angle" or turned))


def examine(
    examined: Examined,
    methods: Sequence[str],
    *,
    warm_up_limit_s: float,
    waiting: Callable[[float, float], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Section, ...]:
    """Return the sections of a report.

    White is watched until it is steady in any case; how far it was from that counts in every figure from two readings.
    Where the time was up before, each method is checked by white before and after it.

    Args:
        examined: The display and how it is to be measured.
        methods: Names of the methods in order.
        warm_up_limit_s: Longest wait for the screen to settle in s.
        waiting: Called while the screen warms up with the time so far and the longest time, both in s.
        progress: Called after every method with (done, total).

    Raises DeviceError if display or camera fail, MeasurementError if a reading clips or white is hardly brighter than
    black.
    """
    bench = examined.bench
    measure_steps(bench.display, bench, [ScreenStep("grey", 255, "white"), ScreenStep("grey", 0, "black")])
    bench.display.show(WHITE)
    outcome = wait_until_steady(bench, bench.sleep, limit_s=warm_up_limit_s, progress=waiting)
    settled = replace(examined, unsettled_rel=outcome.drift_rel / 3.0**0.5)  # a rectangle of that half-width
    found = []
    for number, name in enumerate(methods):
        if name == WARM_UP:
            found.append(warm_up_section(outcome, settled))
        else:
            found.append(METHODS[name](settled) if outcome.steady else _while_drifting(name, settled))
        if progress is not None:
            progress(number + 1, len(methods))
    return tuple(found)


def _while_drifting(name: str, examined: Examined) -> Section:
    """Return a method's section with the change of white meanwhile in its u: it is measured again where that is more.

    A display that warms up changes less and less, so the first change bounds the second one.
    """

    def white() -> ScreenReading:
        examined.bench.display.show(WHITE)
        return examined.bench.read()

    before, section, after = white(), METHODS[name](examined), white()
    change_rel = abs(after.radiance / before.radiance - 1.0) / 3.0**0.5  # a rectangle of that half-width
    if change_rel <= examined.unsettled_rel:
        return section
    return METHODS[name](replace(examined, unsettled_rel=change_rel))
