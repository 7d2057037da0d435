"""What the score of left-out frames can show of a response: the fisheye's frames, and frames simulated after them.

    python -m benchmarks.left_out_floor [COLOUR…]

Frames are simulated from a known response and the exposure times as stated; what is added to each pixel is its own
residual in the real frame, clear of the mean of its tones, with a random sign (the wild bootstrap of Wu 1986,
Ann. Statist. 14, 1261). Each program's score then is next to that of the truth and next to how far its curve is off.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np

from benchmarks._photograph_sets import HIGHEST_DN, LOWEST_DN, Array, RealStack, real_stacks, stacks_folder
from benchmarks._sections import write_section
from benchmarks.photographs import OURS, Recover, Recovered, predicted, programs
from radiometer.analysis.response.noise import dn_at
from radiometer.data import Bracket, Frame

# The response that the simulated frames have: ours, and another program's.
TRUTHS = (OURS, "colour-hdri Debevec 1997")
_LEFT_OUT = (0, 8, 17)
# Factors of the left-out frame's exposure that are tried: its stated time may be wrong (1/8192 s is a quarter longer).
_FACTORS = np.exp(np.linspace(-0.05, 0.2, 26))
_TONE_DN = 8


def rising(g: Array) -> Array:
    return np.asarray(np.maximum.accumulate(np.where(np.isfinite(g), g, np.nanmin(g[np.isfinite(g)]))))


def scores(bracket: Bracket, recover: Recover) -> tuple[float, float]:
    """Return the mean size of the error of left-out frames in DN, with their times as stated and with a factor free."""
    stated, free = [], []
    for k in _LEFT_OUT:
        rest = Bracket.from_frames([f for i, f in enumerate(bracket.light) if i != k], origin=bracket.origin)
        found, frame = recover(rest), bracket.light[k]
        seconds = found.seconds(frame)
        stated.append(predicted(rest, frame.dn, seconds, found))
        factors = (predicted(rest, frame.dn, seconds * by, found) for by in _FACTORS)
        free.append(min(factors, key=lambda e: float(np.abs(e).mean())))
    return tuple(float(np.mean(np.abs(np.concatenate(errors)))) for errors in (stated, free))  # type: ignore[return-value]


def simulated(bracket: Bracket, g: Array, rng: np.random.Generator) -> Bracket:
    """Return frames of the same scene through a response, with the real residuals' size and random signs."""
    total, weights = np.zeros(bracket.shape), np.zeros(bracket.shape)
    for frame in bracket.light:
        hat = np.clip(np.minimum(frame.dn - 8.0, 250.0 - frame.dn) / 121.0, 0.0, 1.0)
        total += hat * (g[frame.dn] - np.log(frame.settings.effective_exposure_s))
        weights += hat
    log_radiance = np.where(weights > 0.0, total / np.maximum(weights, 1e-9), np.median(total[weights > 0.0]))
    frames = []
    for frame in bracket.light:
        expected = dn_at(g, (log_radiance + np.log(frame.settings.effective_exposure_s)).ravel()).reshape(bracket.shape)
        residual, tone = frame.dn - expected, np.clip(expected, 0, 255).astype(int) // _TONE_DN
        for one in np.unique(tone):
            residual[tone == one] -= np.median(residual[tone == one])
        dn = np.rint(expected + rng.choice([-1.0, 1.0], bracket.shape) * residual)
        frames.append(Frame(np.clip(dn, 0, 255).astype(np.uint8), 8, frame.settings, extra=frame.extra))
    return Bracket.from_frames(frames, origin=bracket.origin)


def off(g: Array, truth: Array) -> float:
    """Return the rms of ln H about the truth in per cent, offset taken out."""
    gap = (g - truth)[LOWEST_DN : HIGHEST_DN + 1]
    return 100.0 * float(np.std(gap[np.isfinite(gap)]))


def rows(stack: RealStack, runs: dict[str, Recover]) -> list[str]:
    """Return the rows of one colour's table."""
    known = {name: rising(runs[name](stack.bracket).g) for name in TRUTHS}
    made = {name: simulated(stack.bracket, g, np.random.default_rng(0)) for name, g in known.items()}
    table = []
    for name, recover in runs.items():
        stated, free = scores(stack.bracket, recover)
        cells = [f"{stated:.3f}", f"{free:.3f}"]
        for truth in TRUTHS:
            cells += [f"{scores(made[truth], recover)[0]:.3f}", f"{off(recover(made[truth]).g, known[truth]):.2f} %"]
        table.append(f"| {stack.name} | {name} | {' | '.join(cells)} |")
        print(table[-1], flush=True)
    at_best = [scores(made[truth], lambda _, g=known[truth]: Recovered(g))[0] for truth in TRUTHS]
    return [*table, f"| {stack.name} | the truth itself | – | – | {' | '.join(f'{one:.3f} | 0' for one in at_best)} |"]


def main() -> None:
    folder = stacks_folder()
    if folder is None:
        print("the real stacks (shared/data/stacks) are not on this machine")
        return
    warnings.simplefilter("ignore")
    runs = {name: run for name, run in programs() if name == OURS or not name.startswith("radiometer")}
    colours = sys.argv[1:] or ["red", "green", "blue"]
    table = [row for stack in real_stacks(folder, ("fisheye",)) if stack.name in colours for row in rows(stack, runs)]
    heads = " | ".join(f"simulated by {name}'s curve: score | curve off by" for name in TRUTHS)
    body = (
        "Mean error of left-out frames of the fisheye in DN: as labelled, with a free exposure factor, and for frames "
        "simulated with a known response. `auto` uses the shutter's offset that the other frames determine.\n\n"
        f"| colour | program | as stated | factor free | {heads} |\n|---|---|---|---|---|---|---|---|\n"
        + "\n".join(table)
    )
    print(body)
    write_section(
        "left_out_floor",
        "What the score of left-out frames can show",
        f"OMP_NUM_THREADS=1 python -m benchmarks.left_out_floor {' '.join(sys.argv[1:])}".strip(),
        body,
    )


if __name__ == "__main__":
    main()
