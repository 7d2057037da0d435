"""Dark-adaptation fits over 200 simulated subjects: coverage of the 95 % intervals, the break's bias and retest limits.

Each subject is an eye drawn around published figures (break 6 to 12 min, S2 -0.24 log10 per min) with a threshold every
30 s for 35 min and a scatter of 0.1 log10 units.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks._adaptation_visits import shortened, visit
from benchmarks._sections import write_section
from radiometer.adaptation.adaptation_fit import AdaptationFit, FitRequest, best_branches, fit_adaptation
from radiometer.adaptation.intervals import InterceptRule, rod_intercept
from radiometer.adaptation.protocol import read_protocol
from radiometer.adaptation.run_facts import method_bias
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.errors import MeasurementError
from simulators.observers.eye_kinetics import (
    INTERCEPT_LOG10,
    Eye,
    drawn_amd_eye,
    drawn_clinical_eye,
    scotopic_per_photopic,
)
from simulators.observers.observer import Habits, Observer
from testing.drawn_eyes import drawn_eye, drawn_full_bleach_eye

TIMES_MIN = np.arange(0.5, 35.0, 0.5)
SCATTER_LOG10 = 0.1


def truth_of(eye: Eye) -> dict[str, float]:
    break_min = eye.break_min(453.0)
    assert break_min is not None
    return {
        "plateau": eye.cone_plateau_log10 + math.log10(scotopic_per_photopic(453.0)),
        "amplitude": eye.cone_amplitude,
        "tau_min": eye.cone_tau_min,
        "break_min": break_min,
        "s2_slope_per_min": eye.s2_slope_per_min,
        "rod_rod_break_min": eye.rod_rod_break_min,
        "s3_slope_per_min": eye.s3_slope_per_min,
    }


def noisy_visit(eye: Eye, rng: np.random.Generator) -> AdaptationFit:
    thresholds = np.array([eye.threshold_log10(time, 453.0) for time in TIMES_MIN])
    noisy = thresholds + rng.normal(0.0, SCATTER_LOG10, TIMES_MIN.size)
    return fit_adaptation(ThresholdSeries(TIMES_MIN, noisy), FitRequest(bootstrap_draws=0), rng)


LOOKS_AWAY = (0.0, 0.05, 0.1, 0.2)  # fixation losses of the subjects of `classic`, in turn


def healthy_break(first_seed: int, subjects: int, minutes: float | None) -> str:
    """Return how near `classic` comes to break and S2 of healthy subjects before the simulated box."""
    protocol = read_protocol("classic") if minutes is None else shortened("classic", minutes)
    errors_min, errors_s2, held = [], [], []
    for seed in range(first_seed, first_seed + subjects):
        habits = Habits(fixation_losses=LOOKS_AWAY[seed % len(LOOKS_AWAY)])
        found = visit(protocol, drawn_full_bleach_eye(np.random.default_rng(seed)), seed, habits)
        rate = found.outcome.reliability.rates["fixation_losses"]
        held.append(rate.low <= habits.fixation_losses <= rate.high)
        fit = fit_adaptation(found.series, FitRequest(bootstrap_draws=0), np.random.default_rng(seed))
        truth_min = found.eye.break_min(505.0)
        assert truth_min is not None
        errors_min.append(fit.chosen.values.get("break_min", math.inf) - truth_min)
        errors_s2.append(fit.chosen.values.get("s2_slope_per_min", math.inf) - found.eye.s2_slope_per_min)
        print(
            f"{seed}: break {truth_min:.2f} {errors_min[-1]:+.3f} min, S2 {errors_s2[-1]:+.4f}, fixation lost {rate} "
            f"of {habits.fixation_losses:.2f}, {found.outcome.verdict}",
            flush=True,
        )
    within_min, within_s2 = np.abs(errors_min) <= 1.0, np.abs(errors_s2) <= 0.02
    return (
        f"| `classic`, {subjects} healthy eyes, {protocol.end.duration_min:g} min | break within ±1 min | "
        f"{share(within_min)} | {spread(errors_min)} min |\n"
        f"| | S2 within ±0.02 log10/min | {share(within_s2)} | {spread(errors_s2)} log10/min |\n"
        f"| | both | {share(within_min & within_s2)} | |\n"
        f"| | 95 % interval holds the share of looks away (0, 5, 10, 20 %) | {share(held)} | |"
    )


def intercepts(first_seed: int, subjects: int) -> str:
    """Return how near `rapid` comes to the rod intercept, and how well it separates healthy and AMD-like subjects."""
    protocol = read_protocol("rapid")
    bias = method_bias(protocol.method)
    assert bias is not None
    rule = InterceptRule(INTERCEPT_LOG10, 6.5)
    reported: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for name, draw in (("healthy", drawn_clinical_eye), ("AMD-like", drawn_amd_eye)):
        for seed in range(first_seed, first_seed + subjects):
            found = visit(protocol, draw(np.random.default_rng(seed)), seed)
            thresholds = replace(found.series, log_threshold=found.series.log_threshold - bias.log10)
            met = rod_intercept(thresholds, rule, bias.u_log10)
            eye = found.eye
            truth_min = eye.s2_zero_min + (INTERCEPT_LOG10 - eye.rod_final_log10) / eye.s2_slope_per_min
            reported.setdefault(name, []).append(protocol.end.duration_min if met is None else met.time_min)
            errors.setdefault(name, []).append(math.inf if met is None else met.time_min - truth_min)
        first_seed += subjects
    rows = [
        f"| `rapid`, {subjects} {name} eyes | RIT within ±0.5 min | {share(np.abs(errors[name]) <= 0.5)} | "
        f"{spread(errors[name])} min |"
        for name in reported
    ]
    healthy, ill = np.array(reported["healthy"]), np.array(reported["AMD-like"])
    auc = float(np.mean((ill[:, None] > healthy) + 0.5 * (ill[:, None] == healthy)))
    rows.append(
        f"| | area under the ROC curve | {auc:.4f} | healthy {healthy.min():.1f} to {healthy.max():.1f} min, "
        f"AMD-like {ill.min():.1f} to {ill.max():.1f} min |"
    )
    rows.append(f"| | beyond 6.5 min | healthy {share(healthy > 6.5)}, AMD-like {share(ill > 6.5)} | |")
    return "\n".join(rows)


def false_breaks(first_seed: int, subjects: int) -> str:
    """Return how often a break is claimed of eyes of one branch: cones alone, rods alone, and the weak protocols."""
    claimed: dict[str, list[bool]] = {}
    for seed in range(first_seed, first_seed + subjects):
        rng = np.random.default_rng(seed)
        for name, series in one_branch_series(rng).items():
            try:
                claimed.setdefault(name, []).append("break_min" in best_branches(series).values)
            except MeasurementError:
                claimed[name].append(False)
    rows = [
        f"| {subjects} eyes of one branch: {name} | break claimed | {share(hits)} | |" for name, hits in claimed.items()
    ]
    every = [hit for hits in claimed.values() for hit in hits]
    return "\n".join([*rows, f"| all of these | break claimed | {share(every)} | |"])


def one_branch_series(rng: np.random.Generator) -> dict[str, ThresholdSeries]:
    """Return thresholds of one-branch eyes: scatter 0.06 to 0.2, 10 to 40 min; some by an observer's limits."""
    duration_min, scatter = float(rng.uniform(10, 40)), float(rng.uniform(0.06, 0.2))
    times = np.arange(0.3, duration_min, float(rng.choice([0.2, 0.35, 0.5, 1.0])))
    noise = rng.normal(0, scatter, times.size)
    exponential = -1 + rng.uniform(1.5, 4) * np.exp(-times / rng.uniform(1.0, 10.0))
    rods = replace(
        Eye(),
        s2_zero_min=float(rng.uniform(3, 14)),
        rods_blind_min=0.0,
        s3_slope_per_min=float(rng.uniform(-0.08, -0.02)),
        s2_slope_per_min=float(rng.normal(-0.24, 0.03)),
        cone_plateau_log10=9.0,
    )
    cones = replace(drawn_eye(rng), rods_blind_min=1e9)
    observed = {
        name: limits_run(Observer(eye, Habits(), np.random.default_rng(rng.integers(2**31))), 505.0, duration_min)
        for name, eye in (("rods, by an observer", rods), ("cones, by an observer", cones))
    }
    return {
        "an exponential": ThresholdSeries(times, exponential + noise),
        "rods alone": ThresholdSeries(times, np.array([rods.rod_log10(t) for t in times]) + noise),
        **observed,
    }


def limits_run(observer: Observer, wavelength_nm: float, duration_min: float) -> ThresholdSeries:
    """Return an observer's thresholds by ascending limits, 0.1 log10 per blink of 1 s, anew 0.5 below every 20 s."""
    times, levels, start, time_s = [], [], 3.0, 30.0
    while time_s < 60 * duration_min:
        level, begun_s = start, time_s
        if observer.answer(level, time_s, wavelength_nm) is not None:
            start, time_s = start - 1.0, time_s + 2.0
            continue
        while observer.answer(level, time_s, wavelength_nm) is None and level < 5.0:
            level, time_s = level + 0.1, time_s + 1.0
        times.append((begun_s + time_s) / 120)
        levels.append(level)
        start, time_s = level - 0.5, begun_s + 20.0
    return ThresholdSeries(np.array(times), np.array(levels))


def share(hits: Sequence[bool] | NDArray[np.bool_]) -> str:
    return f"{int(np.sum(hits))}/{len(hits)} ({100 * float(np.mean(hits)):.1f} %)"


def spread(errors: Sequence[float]) -> str:
    known = np.array([one for one in errors if math.isfinite(one)])
    return f"mean {known.mean():+.3f}, standard deviation {known.std(ddof=1):.3f}" if known.size > 1 else "none"


def protocols_main(options: argparse.Namespace) -> None:
    parts = {
        "classic": lambda: healthy_break(options.first_seed, options.subjects, options.minutes),
        "rapid": lambda: intercepts(options.first_seed + 1000, options.subjects),
        "one-branch": lambda: false_breaks(options.first_seed + 3000, options.subjects),
    }
    rows = parts[options.part]()
    body = f"Seeds from {options.first_seed} on.\n\n| what | required | reached | errors |\n|---|---|---|---|\n{rows}"
    print(body)
    name = f"adaptation_{options.part.replace('-', '_')}"
    command = f"python -m benchmarks.adaptation_cohort --part {options.part} --subjects {options.subjects}"
    write_section(name, TITLES[options.part], command, body)


TITLES = {
    "classic": "Dark adaptation: `classic` before the simulated box",
    "rapid": "Dark adaptation: `rapid` before the simulated box",
    "one-branch": "Dark adaptation: false breaks of one-branch eyes",
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="adaptation_cohort")
    parser.add_argument("--subjects", type=int, default=200)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--part", choices=["fits", *TITLES], default="fits")
    parser.add_argument("--first-seed", type=int, default=71000)
    parser.add_argument("--minutes", type=float, help="of `classic`; the whole of it by default")
    options = parser.parse_args()
    if options.part != "fits":
        protocols_main(options)
        return
    rng = np.random.default_rng(options.seed)
    held: dict[str, list[bool]] = {}
    errors = []
    for _ in range(options.subjects):
        eye = drawn_eye(rng)
        first, truth = noisy_visit(eye, rng), truth_of(eye)
        for name, value in truth.items():
            estimate = first.estimates.get(name)
            interval = estimate.profile if estimate else None
            held.setdefault(name, []).append(interval is not None and interval.holds(value))
        errors.append(first.chosen.values.get("break_min", math.nan) - truth["break_min"])
    rows = "\n".join(f"| {name} | {100 * np.mean(hits):.1f} % |" for name, hits in held.items())
    found = np.array(errors)[np.isfinite(errors)]
    limits_min = 1.96 * math.sqrt(2) * float(np.std(found))
    chance = 100 * math.sqrt(0.95 * 0.05 / options.subjects)
    error_min = found.std() / math.sqrt(found.size)
    body = (
        f"{options.subjects} subjects, break found in {found.size}. A share of 95 % has a standard error of "
        f"{chance:.1f} % here.\n\n"
        f"| parameter | 95 % intervals that hold the truth |\n|---|---|\n{rows}\n\n"
        f"Break: bias {found.mean():+.3f} min (standard error {error_min:.3f}), retest limits ±{limits_min:.2f} min "
        "from threshold scatter alone (published for people: ±2.1 min). Plateau, amplitude and tau_min (time constant) "
        "are those of the cones; rod_rod_break_min is the time at which S3 begins."
    )
    print(body)
    command = "python -m benchmarks adaptation_cohort"
    write_section("adaptation_cohort", "Dark adaptation: a simulated cohort", command, body)


if __name__ == "__main__":
    main()
