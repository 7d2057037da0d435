"""Are NewtonBench's laws found by `radiometer reconcile --propose`, without any language model?

    python -m benchmarks newton_laws --laws NEWTONBENCH --wholes 12 --sections 12 --first-seed 1302001

NEWTONBENCH is a checkout of HKUST-KnowComp/NewtonBench; without it the benchmark says so and stops. A law shifts the
black level of a simulated camera: its first variable follows the exposure, its second one the f-number, and
the largest shift is 40 DN. Each frame's shift has the relative noise of their benchmark, 0, 1e-4 or 1e-2. Of the laws
of one and two variables `--wholes` are drawn and hidden whole. Of the others the grammar can hold at most a section:
`--sections` of them are drawn, with two drawn variables; the other variables rest at the middle of their ranges.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks._newton_laws import Factor, Law, factors_of, read_laws
from benchmarks._own_outsiders import Written
from benchmarks._sections import write_section
from benchmarks.reconcile_propose import state_of
from radiometer.reconciliation.propose import Proposal, propose_law
from testing.generator.plan import Setting, Shot
from testing.generator.rig import Rig
from testing.generator.scene import Chart
from testing.generator.session import session_in
from testing.generator.world import World
from testing.outside.session import Secret

RESULTS = Path("out") / "newton_laws.jsonl"
NOISES: Final = (0.0, 1e-4, 1e-2)
_LARGEST_DN: Final = 40.0
_EXPOSURES_S: Final = np.geomspace(0.3e-3, 9e-3, 8)
_STOPS: Final = (2.8, 4.0, 5.6, 8.0, 11.0)
_LIT_S: Final = 0.7e-3  # exposure at the source's full level and f/4 that fills the brightest patch to two thirds
_SETTINGS: Final = {"exposure_s": (_EXPOSURES_S[0], _EXPOSURES_S[-1]), "f_number": (_STOPS[0], _STOPS[-1])}
_HELD: Final = {"exposure_s": ("power", "decay"), "f_number": ("power",)}  # forms that the grammar has along each
_NEAR: Final = 0.05  # of an exponent, or of the length of an exponential: within it the formula counts as right
_KINDS: Final = ("whole law, in the grammar", "section, in the grammar", "whole law, beyond it", "section, beyond it")


@dataclass(frozen=True)
class Section:
    """A law along one or two variables, each moved by a setting of the camera."""

    law: Law
    along: tuple[str, ...]  # variables that are moved, the first by the exposure, the second by the f-number
    is_whole: bool  # whether the law depends on no others

    def value(self, settings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the law's value at settings of the camera.

        The highest setting has the highest value of a variable's range, and others go in proportion. A range that is
        narrower than the setting's is run through evenly.
        """
        size = len(next(iter(settings.values())))
        places = {name: np.full(size, middle) for name, middle in self.law.middle().items()}
        for name, setting in zip(self.along, _SETTINGS, strict=False):
            (low, high), (first, last) = self.law.ranges[name], _SETTINGS[setting]
            even = low > 0 and high / low < last / first
            share = settings[setting] / last
            places[name] = low + (high - low) * (settings[setting] - first) / (last - first) if even else high * share
        return self.law.values(places)

    @cached_property
    def factors(self) -> tuple[Factor, ...] | None:
        """Return the factors along the settings, as the grammar could have them; None where it cannot."""
        dice = np.random.default_rng(len(self.law.name))
        places = {name: dice.uniform(*limits, 40) for name, limits in list(_SETTINGS.items())[: len(self.along)]}
        found = factors_of(lambda at: self.value(at), places)
        held = found is not None and all(
            f.form in _HELD[f.variable] and (f.form == "power" or f.value > 0) for f in found
        )
        return found if held else None

    @property
    def kind(self) -> str:
        """Return one of the kinds of the table."""
        return _KINDS[(not self.is_whole) + 2 * (self.factors is None)]


def plan(dice: np.random.Generator) -> list[Setting]:
    """Return dark frames at all exposures and f-numbers, and lit ones that stay below clipping, in random order."""
    closed = [Setting(float(t), f_number=n, closed=True) for t in _EXPOSURES_S for n in _STOPS]
    lit = [Setting(float(t), level=share * min(1.0, round(_LIT_S / float(t), 3))) for t in _EXPOSURES_S
           for share in (1.0, 0.4)]  # fmt: skip
    lit += [Setting(_LIT_S, f_number=n) for n in _STOPS[1:]]
    both = [replace(one, frames=2) for one in (*closed, *lit)]
    return [both[n] for n in dice.permutation(len(both))]


def hidden(section: Section, noise: float, seed: int) -> Written | None:
    """Return a session in which a law shifts the black level; None where the law has no value somewhere."""
    settings = plan(np.random.default_rng([seed, 6]))
    at = {
        "exposure_s": np.array([s.exposure_s for s in settings]),
        "f_number": np.array([s.f_number for s in settings]),
    }
    values = section.value(at)
    if not np.isfinite(values).all() or np.ptp(values) == 0:
        return None
    shifts = values / np.abs(values).max() * _LARGEST_DN
    rig = Rig()
    world = World(rig, Chart.scrambled(rig, np.random.default_rng([seed, 1])))

    def shift(value: np.ndarray, shot: Shot) -> np.ndarray:
        own = np.random.default_rng([seed, 7, shot.capture, shot.number]).standard_normal()
        return value + shifts[shot.capture] * (1 + noise * own)

    world.digital.append(shift)
    return Written(session_in(world, (), {}, settings, [seed, 2], known_patches=True), Secret("outsider", "rich"))


def run(section: Section, noise: float, seed: int) -> dict[str, Any] | None:
    """Return what was proposed and how near it is; None where the law has no value at some settings."""
    session = hidden(section, noise, seed)
    if session is None:
        return None
    begun = time.process_time()
    proposal = propose_law(state_of(session))
    record = {"law": section.law.name, "along": section.along, "kind": section.kind, "noise": noise, "seed": seed,
              "cpu_s": round(time.process_time() - begun, 1)}  # fmt: skip
    if proposal is None:
        return record | {"proposed": None, "right": False, "left": 1.0}
    law = proposal.law.parameters | {proposal.law.amplitude: proposal.amplitude}
    return record | {"proposed": proposal.name, "parameters": law, "right": is_right(section, proposal),
                     "left": left_by(section, proposal)}  # fmt: skip


def is_right(section: Section, proposal: Proposal) -> bool:
    """Return whether the formula is the law: its forms of its settings, each constant within 5 %."""
    if section.factors is None:
        return False
    found = {(t.covariate, t.form): t.values.get("power", t.values.get("tau", np.nan)) for t in proposal.law.terms}
    true = {(f.variable, f.form): f.value for f in section.factors}
    return found.keys() == true.keys() and all(abs(found[k] - true[k]) <= _NEAR * abs(true[k]) for k in true)


def left_by(section: Section, proposal: Proposal) -> float:
    """Return the share of the law's variation over all settings that the proposal leaves, a constant aside."""
    exposure, stop = (np.ravel(part) for part in np.meshgrid(_EXPOSURES_S, _STOPS))
    at = {"exposure_s": exposure, "f_number": stop}
    if not set(proposal.law.covariates) <= at.keys():
        return 1.0
    shape = np.ones(exposure.size)
    for term in proposal.law.terms:
        shape = shape * term.evaluated(at)
    truth = section.value(at)
    columns = np.stack([shape / max(float(np.abs(shape).max()), 1e-300), np.ones(shape.size)], axis=1)
    rest = truth - columns @ np.linalg.lstsq(columns, truth, rcond=None)[0]
    return float(np.std(rest) / np.std(truth))


def sections_of(laws: Sequence[Law], wholes: int, drawn: int, dice: np.random.Generator) -> list[Section]:
    """Return so many laws of one and two variables whole, and sections of so many others, all drawn."""
    needed = {law.name: law.depends_on(np.random.default_rng(1)) for law in laws}
    few = [law for law in laws if len(needed[law.name]) <= 2]
    many = [law for law in laws if len(needed[law.name]) > 2]
    found = [Section(few[n], needed[few[n].name], is_whole=True) for n in dice.permutation(len(few))[:wholes]]
    for n in dice.permutation(len(many))[:drawn]:
        names = needed[many[n].name]
        along = tuple(names[i] for i in sorted(dice.choice(len(names), 2, replace=False)))
        found.append(Section(many[n], along, is_whole=False))
    return found


def beyond(laws: Sequence[Law]) -> str:
    """Return what the grammar can hold of all laws, in Markdown."""
    counts: dict[str, list[str]] = {}
    for law in laws:
        dice = np.random.default_rng(2)
        needed = law.depends_on(dice)
        factors = factors_of(law.values, law.drawn(dice))
        if factors is None:
            what = "no product of powers and exponentials: sums, waves, tangents, angles, exponentials of a product"
        elif len(needed) > 2:
            what = "a product of three or four powers: a law of the grammar has two factors"
        else:
            what = "in the grammar: one or two powers"
        counts.setdefault(what, []).append(law.domain)
    lines = ["| laws | what they are | domains |", "|---|---|---|"]
    for what, domains in sorted(counts.items(), key=lambda entry: -len(entry[1])):
        listed = ", ".join(f"{name.split('_', 1)[1]} {domains.count(name)}" for name in dict.fromkeys(domains))
        lines.append(f"| {len(domains)} | {what} | {listed.replace('_', ' ')} |")
    return "\n".join(lines)


def page(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the figures reached in Markdown."""
    columns: dict[str, Callable[[Mapping[str, Any]], bool]] = {
        "a law is proposed": lambda r: r["proposed"] is not None,
        "formula right": lambda r: r["right"],
        "leaves < 1 %": lambda r: r["left"] < 0.01,
        "leaves < 10 %": lambda r: r["left"] < 0.1,
    }
    lines = [f"| hidden | noise | sessions | {' | '.join(columns)} | median s |", "|---" * 8 + "|"]
    for kind, noise in product(_KINDS, NOISES):
        own = [r for r in results if r["kind"] == kind and r["noise"] == noise]
        if own:
            counts = " | ".join(str(sum(map(test, own))) for test in columns.values())
            lines.append(f"| {kind} | {noise:g} | {len(own)} | {counts} | {np.median([r['cpu_s'] for r in own]):.0f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks newton_laws", description=__doc__)
    parser.add_argument("--laws", type=Path, default=Path("NewtonBench"), help="checkout of HKUST-KnowComp/NewtonBench")
    parser.add_argument("--wholes", type=int, default=12, help="laws of one and two variables, hidden whole")
    parser.add_argument("--sections", type=int, default=12, help="laws of more variables of which a section is hidden")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true", help="write the section of docs/benchmarks/naming.md")
    options = parser.parse_args()
    try:
        laws = list(read_laws(options.laws))
    except OSError as missing:
        print(f"skipped: {missing}")
        return
    lines = options.results.read_text(encoding="utf-8").splitlines() if options.results.exists() else []
    done = {(r["law"], r["noise"], r["seed"]): r for r in map(json.loads, lines)}
    options.results.parent.mkdir(parents=True, exist_ok=True)
    results = []
    tasks = sections_of(laws, options.wholes, options.sections, np.random.default_rng(options.first_seed))
    for noise in NOISES:
        for number, section in enumerate(tasks):
            key = section.law.name, noise, options.first_seed + number
            if key not in done:
                done[key] = run(section, noise, key[2])
                if done[key] is None:
                    print(f"{key}: has no value at some settings", flush=True)
                    continue
                with options.results.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(done[key]) + "\n")
            results.append(done[key])
            print({k: v for k, v in results[-1].items() if k != "seed"}, flush=True)
    body = f"{page(results)}\n\nOf all {len(laws)} laws:\n\n{beyond(laws)}"
    print(body)
    if options.write:
        asked = f"python -m benchmarks newton_laws --laws NEWTONBENCH --wholes {options.wholes}"
        asked += f" --sections {options.sections} --first-seed {options.first_seed}"
        write_section("newton_laws", "Laws of other people: NewtonBench", asked, body)


if __name__ == "__main__":
    main()
