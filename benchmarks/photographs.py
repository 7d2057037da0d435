"""Real photographs next to raw values of the same shots, and left-out frames in DN: this program and others.

    python -m benchmarks.photographs [CAMERA…]

Needs the real stacks in shared/data; says so and leaves where they are absent. Every program gets the same frames
(every n-th pixel of large ones) and one stack per fit. Nothing is tuned to them: λ, times and labels are judged within
each stack. `auto` finds a shutter's offset from the frames that it is given, never from the one left out, and exposures
are then longer than their labels by it; no other program finds one, and theirs are as labelled.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from benchmarks._photograph_labels import Labels
from benchmarks._photograph_sets import CAMERAS, HIGHEST_DN, LOWEST_DN, Array, RealStack, real_stacks, stacks_folder
from benchmarks._response_peers import failures_of, opencv_debevec, peers
from benchmarks._sections import write_section
from radiometer.analysis.response.estimate import ResponseEstimate
from radiometer.analysis.response.limits import find_limits
from radiometer.analysis.response.methods import METHODS
from radiometer.analysis.response.noise import dn_at
from radiometer.data import Bracket, Frame, ResponseCurve
from radiometer.errors import RadiometerError

OURS = "radiometer auto"
# Frames are left out one by one up to this many, then evenly chosen ones.
_LEFT_OUT = 3
# OpenCV's Debevec takes its samples from a grid: a few more or fewer are other pixels of the same picture.
_SAMPLES = range(50, 131, 4)
_PIXELS = 40_000
# Values so near to what the frames show of black and white are no exposure of a pixel; the hat's half width in DN.
_CLEAR_OF_BLACK, _CLEAR_OF_WHITE, _HALF_HAT = 8.0, 5.0, 121.0


@dataclass(frozen=True, slots=True, eq=False)
class Recovered:
    """What a program makes of a bracket.

    Attributes:
        g: ln H of every digital number.
        offset_s: Time by which it takes all exposures for longer than their labels; 0 for programs that tell none.
    """

    g: Array
    offset_s: float = 0.0

    def seconds(self, frame: Frame) -> float:
        """Return the effective exposure in s that it takes a frame for."""
        stated = frame.settings
        return stated.effective_exposure_s * (1.0 + self.offset_s / stated.exposure_s)


Recover = Callable[[Bracket], Recovered]


@dataclass
class Tally:
    """Figures of one program, by set."""

    truth: dict[str, list[float]] = field(default_factory=dict)
    z: dict[str, list[float]] = field(default_factory=dict)
    left_out: dict[str, list[float]] = field(default_factory=dict)
    jackknife: dict[str, list[float]] = field(default_factory=dict)


def of_other_samples(stack: RealStack) -> list[float]:
    """Return rms of ln H about the raw values of OpenCV's Debevec for each number of samples; NaN where it fails."""
    found = []
    for samples in _SAMPLES:
        try:
            found.append(rms_of_truth(stack, opencv_debevec(samples)(stack.bracket))[0])
        except failures_of("OpenCV"):
            found.append(float("nan"))
    return found


def sentence_on_samples(by_camera: dict[str, list[list[float]]]) -> str:
    """Return how much OpenCV's figure hangs on the number of its samples, camera by camera."""
    if not by_camera:
        return ""
    parts = []
    for camera, stacks in by_camera.items():
        medians = 100.0 * np.nanmedian(np.array(stacks), axis=0)
        low, middle, high = np.percentile(medians, (10, 50, 90))
        parts.append(f"{camera} {middle:.2f} % ({low:.2f} to {high:.2f} %)")
    return (
        f"OpenCV's CalibrateDebevec takes its samples from a grid. With {_SAMPLES[0]} to {_SAMPLES[-1]} of them (every "
        f"{_SAMPLES.step}th number) the median of the stacks is, as a median over the numbers and its 10 and 90 % "
        f"points: {', '.join(parts)}."
    )


def programs() -> Iterator[tuple[str, Recover]]:
    for name in METHODS:
        yield f"radiometer {name}", lambda bracket, name=name: recovered(METHODS[name]([bracket]))
    for name, peer in peers():
        yield name, lambda bracket, peer=peer: Recovered(peer(bracket))


def recovered(estimate: ResponseEstimate) -> Recovered:
    return Recovered(estimate.curve.log_exposure, float(estimate.details.get("shutter_offset_s", 0.0)))


def rms_of_truth(stack: RealStack, g: Array) -> tuple[float, Array]:
    """Return the rms of ln H about the raw values, offset taken out, and the differences."""
    gap = np.interp(stack.truth_dn, np.arange(g.size), g) - stack.truth_log
    gap = gap - gap.mean()
    return float(np.sqrt(np.mean(gap**2))), gap


def z_of_truth(stack: RealStack, curve: ResponseCurve) -> float:
    """Return the rms difference from the raw values over the rms of the uncertainties of both."""
    rms, _ = rms_of_truth(stack, curve.log_exposure)
    u = np.interp(stack.truth_dn, np.arange(curve.u_log_exposure.size), curve.u_log_exposure)
    return rms / float(np.sqrt(np.mean(u[np.isfinite(u)] ** 2) + stack.u_truth**2))


def left_out_dn(stack: RealStack, recover: Recover, failures: type[Exception]) -> float:
    """Return the mean size of the error in DN with which frames left out of fit and merge alike are predicted.

    NaN for few frames, and where the program fails.
    """
    bracket, errors = stack.bracket, []
    count = len(bracket.light)
    if count < 3:
        return float("nan")
    chosen = np.unique(np.linspace(0, count - 1, min(count, _LEFT_OUT)).round().astype(int))
    for k in chosen:
        rest = Bracket.from_frames([f for i, f in enumerate(bracket.light) if i != k], origin=bracket.origin)
        try:
            found = recover(rest)
        except failures as error:
            print(f"no curve without frame {k} of {stack.camera} {stack.name}: {error}")
            return float("nan")
        errors.append(predicted(rest, bracket.light[k].dn, found.seconds(bracket.light[k]), found))
    return float(np.mean(np.abs(np.concatenate(errors))))


def predicted(rest: Bracket, dn: Array, seconds: float, recovered: Recovered) -> Array:
    """Return predicted minus found digital number of one frame: hat-weighted mean exposure of the others through g.

    The hat stands on what the other frames show of black (a film's fog) and white: for no program is fog an exposure,
    nor 0 DN what a film shows without light.
    """
    step, g = max(1, int(np.sqrt(dn.size / _PIXELS))), recovered.g
    if not np.any(np.isfinite(g)):
        return np.full(1, np.nan)
    g = np.maximum.accumulate(np.where(np.isfinite(g), g, np.nanmin(g[np.isfinite(g)])))
    limits = find_limits([rest])
    total = np.zeros(dn[::step, ::step].shape)
    weights = np.zeros_like(total)
    for frame in rest.light:
        value = frame.dn[::step, ::step]
        clear = np.minimum(value - (limits.black_dn + _CLEAR_OF_BLACK), limits.saturated_dn - _CLEAR_OF_WHITE - value)
        hat = np.clip(clear / _HALF_HAT, 0.0, 1.0)
        total += hat * (g[value] - np.log(recovered.seconds(frame)))
        weights += hat
    here = dn[::step, ::step]
    used = (weights > 0.05) & (here >= LOWEST_DN) & (here <= HIGHEST_DN)
    found = dn_at(g, total[used] / weights[used] + np.log(seconds))
    return np.asarray(found - here[used])


def odd_even_z(stack: RealStack) -> float:
    """Return the rms difference of the curves of odd and of even frames over what both state; NaN for few frames."""
    if len(stack.bracket.light) < 6:
        return float("nan")
    try:
        halves = [
            METHODS["auto"]([Bracket.from_frames(stack.bracket.light[k::2], origin=stack.bracket.origin)]).curve
            for k in (0, 1)
        ]
    except RadiometerError as error:
        print(f"no curve of half the frames of {stack.camera} {stack.name}: {error}")
        return float("nan")
    ranges = [half.valid_dn or (0, 255) for half in halves]
    inside = slice(max(r[0] for r in ranges), min(r[1] for r in ranges) + 1)
    gap = halves[0].log_exposure[inside] - halves[1].log_exposure[inside]
    u2 = halves[0].u_log_exposure[inside] ** 2 + halves[1].u_log_exposure[inside] ** 2
    return float(np.sqrt(np.mean((gap - np.mean(gap)) ** 2) / np.mean(u2)))


def measure(stack: RealStack, tallies: dict[str, Tally], runs: list[tuple[str, Recover]]) -> None:
    for name, recover in runs:
        tally = tallies.setdefault(name, Tally())
        if stack.has_truth:
            try:
                rms = rms_of_truth(stack, recover(stack.bracket).g)[0]
            except failures_of(name) as error:
                print(f"{name} fails on {stack.camera} {stack.name}: {error}")
                rms = float("inf")
            tally.truth.setdefault(stack.camera, []).append(rms)
        if name == OURS or not name.startswith("radiometer"):
            tally.left_out.setdefault(stack.camera, []).append(left_out_dn(stack, recover, failures_of(name)))
    ours = tallies[OURS]
    if stack.has_truth:
        curve = METHODS["auto"]([stack.bracket]).curve
        ours.z.setdefault(stack.camera, []).append(z_of_truth(stack, curve))
    ours.jackknife.setdefault(stack.camera, []).append(odd_even_z(stack))


def table(tallies: dict[str, Tally], what: str, cameras: list[str], scale: float, unit: str) -> str:
    rows = []
    for name, tally in tallies.items():
        figures: dict[str, list[float]] = getattr(tally, what)
        if not any(figures.values()):
            continue
        cells = [f"{scale * np.nanmedian(figures[c]):.2f}" if figures.get(c) else "–" for c in cameras]
        everything = scale * np.nanmedian(np.concatenate([figures[c] for c in cameras if figures.get(c)]))
        rows.append(f"| {name} | {' | '.join(cells)} | {everything:.2f} |")
    head = f"| median of the stacks, {unit} | {' | '.join(cameras)} | all |\n|---|{'---|' * (len(cameras) + 1)}"
    return head + "\n" + "\n".join(rows)


def tables(
    tallies: dict[str, Tally], cameras: list[str], with_truth: list[str], labels: Labels, of_samples: str
) -> list[str]:
    """Return the tables of what was measured, each with its sentence."""
    return [
        "One stack (four to eighteen frames of one channel) per fit; the same frames for every program.",
        "Root mean square of ln H about the raw values of the same shots, digital numbers 13 to 242. The patches' "
        "unevenness and rounding are some 2 to 4 %.",
        table(tallies, "truth", with_truth, 100.0, "%") if with_truth else "No set with raw values was asked for.",
        of_samples,
        "Mean error in DN with which a frame left out of the fit is predicted. `auto` uses the shutter's offset where "
        "the other frames determine it.",
        table(tallies, "left_out", cameras, 1.0, "DN"),
        "Root mean square difference over both stated uncertainties: from the raw values, and between odd and even "
        "frames.",
        table({OURS: tallies[OURS]}, "z", with_truth, 1.0, "z from raw") if with_truth else "",
        table({OURS: tallies[OURS]}, "jackknife", cameras, 1.0, "z of odd against even frames"),
        labels.in_words(),
    ]


def main() -> None:
    if unknown := [word for word in sys.argv[1:] if word not in CAMERAS]:
        sys.exit(f"{__doc__}\n{unknown[0]}: no such camera; there are {', '.join(CAMERAS)}")
    folder = stacks_folder()
    if folder is None:
        print("the real stacks (shared/data/stacks) are not on this machine")
        return
    warnings.simplefilter("ignore")
    tallies: dict[str, Tally] = {}
    cameras: list[str] = []
    with_truth: list[str] = []
    runs, labels = list(programs()), Labels()
    samples: dict[str, list[list[float]]] = {}
    stacks = real_stacks(folder, tuple(sys.argv[1:]))
    for (camera, _), scene in groupby(stacks, lambda one: (one.camera, one.scene)):
        colours = list(scene)
        for stack in colours:
            measure(stack, tallies, runs)
            if stack.has_truth:
                samples.setdefault(camera, []).append(of_other_samples(stack))
            print(camera, stack.name, f"{tallies[OURS].left_out[camera][-1]:.2f} DN", flush=True)
        labels.look_at(colours)
        cameras += [camera] if camera not in cameras else []
        with_truth += [camera] if colours[0].has_truth and camera not in with_truth else []
    parts = tables(tallies, cameras, with_truth, labels, sentence_on_samples(samples))
    print("\n\n".join(parts))
    write_section(
        "photographs", "Real photographs", "OMP_NUM_THREADS=1 python -m benchmarks photographs", "\n\n".join(parts)
    )


if __name__ == "__main__":
    main()
