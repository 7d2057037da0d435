"""Accuracy and speed of the response methods next to OpenCV, colour-hdri and pfstools, in one run on the same stacks.

    python -m benchmarks response_accuracy

Nine 8-bit frames one stop apart, 256 × 192 pixels, shot and read noise before the curve, one stack per response curve;
then 12 bits, where no peer runs. RESPONSE_BENCH_EVERY=4 takes every fourth curve only.
Peers that are not installed are left out and reported.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from benchmarks._response_peers import Peer, peers
from benchmarks._response_stacks import DORF, Array, make_stack, response_curves, rms_error, true_log_exposure
from benchmarks._sections import write_section
from radiometer.analysis.response.methods import METHODS
from radiometer.analysis.response.mitsunaga1999 import recover_response_mitsunaga1999
from radiometer.data import Bracket, ResponseCurve
from radiometer.errors import RadiometerError

# Of the DoRF curves, those whose bends have one stop's period.
JAGGED = (84, 85, 106, 107, 108)
# Solves a dense system per stack: every twentieth curve is enough to see where it stands.
SLOW_PEERS = ("colour-hdri Debevec 1997",)


@dataclass
class Tally:
    errors: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    chi2: list[float] = field(default_factory=list)
    squares: list[float] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        good = np.array([e for e in self.errors if np.isfinite(e)])
        failed = len(self.errors) - good.size
        chi2 = f"{np.mean(self.chi2):.2f}" if self.chi2 else "–"
        squares = f"{np.median(self.squares):.2f}, {np.mean(self.squares):.2f}" if self.squares else "–"
        return (
            f"| {name} | {np.median(good):.5f} | {np.quantile(good, 0.9):.5f} | {good.max():.4f} | {failed} "
            f"| {np.median(self.seconds):.3f} | {chi2} | {squares} |"
        )


def cpu_seconds() -> float:
    """Return the processor time of this process and of those that it waited for."""
    spent = os.times()
    return time.process_time() + spent.children_user + spent.children_system


def stacks(bit_depth: int) -> Iterator[tuple[int, Bracket, slice, Array]]:
    """Yield (number, bracket, digital numbers compared, true ln H there) for every chosen curve."""
    every = int(os.environ.get("RESPONSE_BENCH_EVERY", "1"))
    for seed, (_, exposure, brightness) in enumerate(response_curves()):
        if seed % every == 0:
            stack = make_stack(exposure, brightness, bit_depth=bit_depth, seed=seed)
            yield seed, stack, *true_log_exposure(exposure, brightness, bit_depth)


def measure(bit_depth: int, others: list[tuple[str, Peer]]) -> dict[str, Tally]:
    tallies: dict[str, Tally] = {}
    for seed, stack, inner, truth in stacks(bit_depth):
        for name, method in METHODS.items():
            tally = tallies.setdefault(f"radiometer {name}", Tally())
            started = cpu_seconds()
            try:
                estimate = method([stack])
            except RadiometerError as error:
                print(f"{name} failed on curve {seed}: {error}")
                tally.errors.append(float("nan"))
                continue
            tally.seconds.append(cpu_seconds() - started)
            tally.errors.append(rms_error(estimate.curve.log_exposure[inner], truth))
            tally.squares.append(square_over_u(estimate.curve, inner, truth))
            if estimate.agreement is not None:
                tally.apart.append(estimate.agreement.quadrants_rms_log)
            if estimate.stability is not None:
                tally.chi2.append(estimate.stability.reduced_chi2)
        for name, peer in others:
            if name in SLOW_PEERS and seed % 20:
                continue
            tally = tallies.setdefault(name, Tally())
            started = cpu_seconds()
            curve = peer(stack)
            tally.seconds.append(cpu_seconds() - started)
            tally.errors.append(rms_error(curve[inner], truth))
    return tallies


def square_over_u(curve: ResponseCurve, inner: slice, truth: Array) -> float:
    """Return the mean of (error/u)² of ln H relative to the middle value, where both are 0 and which is left out."""
    middle = curve.mid_dn - inner.start
    error = curve.log_exposure[inner] - truth
    u = curve.u_log_exposure[inner]
    counted = np.isfinite(u) & (u > 1e-3 * float(u[np.isfinite(u)].max()))
    return float(np.mean((error - error[middle])[counted] ** 2 / u[counted] ** 2))


def about_auto(tally: Tally) -> str:
    """Return what is asked of the default method besides its row."""
    return (
        f"`auto`: quadrants of the picture differ by {100 * np.median(tally.apart):.2f} % (median of the stacks; rms "
        f"over 5–95 % of the valid numbers), {100 * np.max(tally.apart):.1f} % at most. (error/u)² of a stack: 90 % "
        f"below {np.quantile(tally.squares, 0.9):.1f}, largest "
        f"{np.max(tally.squares):.1f}; an exponential distribution of mean 1, that of two free numbers, has 2.3 and, "
        f"as the largest of {len(tally.squares)}, {np.log(len(tally.squares)) + 0.58:.1f}."
    )


def ratio_errors(bit_depth: int) -> tuple[Array, Array]:
    """Return the largest relative error of every stack's unknown ratios, one of eight known, and the mean of (e/u)²."""
    found, squares = [], []
    for _, stack, _, _ in stacks(bit_depth):
        estimate = recover_response_mitsunaga1999(stack, known_ratios={3: 2.0})
        error, u = estimate.exposure_ratios - 2.0, estimate.u_exposure_ratios
        found.append(float(np.max(np.abs(error / 2.0))))
        squares.append(float(np.mean((error[u > 0] / u[u > 0]) ** 2)))
    return np.array(found), np.array(squares)


def off_the_ladder(bit_depth: int) -> str:
    """Return what `auto` makes of jagged curves when one of the nine frames lies between two stops."""
    found = []
    curves = list(response_curves())
    for number in JAGGED:
        _, exposure, brightness = curves[number]
        inner, truth = true_log_exposure(exposure, brightness, bit_depth)
        figures = []
        for stops in (range(9), (*range(5), 4 + 1 / 3, *range(5, 8))):
            estimate = METHODS["auto"](
                [make_stack(exposure, brightness, bit_depth=bit_depth, seed=number, stops=stops)]
            )
            error = rms_error(estimate.curve.log_exposure[inner], truth)
            figures.append(
                (100 * error, 100 * estimate.agreement.quadrants_rms_log if estimate.agreement else float("nan"))
            )
        (error, thirds), (error_off, thirds_off) = figures
        found.append(f"{number}: error {error:.2f} → {error_off:.2f} %, quadrants {thirds:.2f} → {thirds_off:.2f} %")
    return (
        f"The jagged curves at {bit_depth} bits, nine frames at whole stops → eight of them and one a third of a stop "
        f"off: {'; '.join(found)}."
    )


HEADER = (
    "| method | median | p90 | worst | failed | CPU s per stack (median) | χ² of disjoint thirds (mean) "
    "| (error/u)²: median, mean |\n|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    others = list(peers())
    absent = [peer for peer in ("colour-hdri", "pfstools") if not any(name.startswith(peer) for name, _ in others)]
    missing = f"\n\nNot installed, so not compared: {', '.join(absent)}." if absent else ""
    source = (
        "the curves of DoRF (Database of Response Functions)"
        if DORF.exists()
        else "parametric curves (the DoRF set is absent)"
    )
    count = sum(1 for _ in stacks(8))
    parts = [
        f"rms error of ln H over 5–95 % of the digital numbers, free offset taken out, over {count} of {source}. "
        "The χ² compares curves from three separate thirds of the pixels, by their stated u."
    ]
    for bit_depth, runs in ((8, others), (12, [])):
        tallies = measure(bit_depth, runs)
        rows = "\n".join(tally.row(name) for name, tally in tallies.items())
        parts.append(f"**{bit_depth} bits**\n\n{HEADER}\n{rows}\n\n{about_auto(tallies['radiometer auto'])}")
        print(parts[-1], flush=True)
    for bit_depth in (8, 12):
        worst, squares = ratio_errors(bit_depth)
        parts.append(
            f"Mitsunaga–Nayar, one of eight ratios known, {bit_depth} bits: largest error of the other seven "
            f"{100 * np.median(worst):.3f} % (median of the stacks), {100 * worst.max():.3f} % (worst); beyond "
            f"0.5 % on {int(np.sum(worst > 0.005))} of {worst.size}. (error/u)² of the ratios: median of the stacks "
            f"{np.median(squares):.2f}, mean {np.mean(squares):.2f}."
        )
        print(parts[-1], flush=True)
    if DORF.exists():
        parts += [off_the_ladder(bit_depth) for bit_depth in (8, 12)]
    write_section(
        "response_accuracy",
        "Response recovery compared with peers",
        f"OMP_NUM_THREADS=1 RESPONSE_BENCH_EVERY={os.environ.get('RESPONSE_BENCH_EVERY', '1')} "
        "python -m benchmarks response_accuracy",
        "\n\n".join(parts) + missing,
    )


if __name__ == "__main__":
    main()
