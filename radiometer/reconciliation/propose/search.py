"""Finds the law: stage, covariates and formula by what they predict of held-out settings, each parameter paid for.

First all laws of the grammar are tested on the tiles' means, slopes and first frames, linearised about the starting
camera with all nuisances following. The best of each kind are then fitted to all statistics as effects, and judged as
names are. A law is written with its evidence: effect file, test, and captures that would refute it. Source of the
score: docs/decisions/0011.

Statistics that follow the light of a tile move with the law as well: the nuisances take them along. A law that left
them in place would seem to disagree with them as soon as a radiance adapts to it.
"""

from __future__ import annotations

import operator
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from pprint import pformat
from typing import Any, Final

import numpy as np
from scipy.special import ndtr

from radiometer.data.storage import write_text_atomic, write_yaml_atomic
from radiometer.errors import ConfigurationError, MeasurementError, OutputError
from radiometer.one_thread import on_one_blas_thread
from radiometer.reconciliation.descent import (
    Candidate,
    FittedCandidate,
    UnfitError,
    fit_candidate,
    fitted_parameters,
    included,
    judged_gain,
    scatter_of,
)
from radiometer.reconciliation.propose.grammar import COVARIATES, FORMS, PER_FRAME, PLACES, Term, finer, terms_of
from radiometer.reconciliation.propose.law import Law, acted, context_at, effect_of, round_to
from radiometer.reconciliation.result import FittedParameter
from radiometer.reconciliation.screening import best_start
from radiometer.reconciliation.search import Contender, Search, Step, contenders_of, worth
from radiometer.reconciliation.separability import FORMAT as PLAN_FORMAT
from radiometer.reconciliation.separability import FRAMES, CapturePool
from radiometer.reconciliation.state import FitState
from radiometer.reconciliation.statistics import STATISTICS
from radiometer.reconciliation.thresholds import NAMED_NATS, PARAMETER_NATS, RIVAL_NATS, SMOOTH_SHARE
from radiometer.reconciliation.tile_model import from_grid, rise_of
from radiometer.reconciliation.verdict import doubts_of, leaves_structure, posterior
from radiometer.typing import Array
from simulators.chain.stages import LINKS
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.free_law import FreeLaw
from simulators.effects.surroundings import column_light, picture_mean

_WIDTH: Final = 116


def effect_source(
    law: Law,
    amplitude: float,
    *,
    sentence: str = "A law that was proposed.",
    source: str = "a law proposed by radiometer reconcile",
) -> str:
    """Return the text of an effect file: the law as data, of which its class is made.

    Args:
        amplitude: Its amplitude; trials start there and at its negative.
        sentence: What it does, for its docstring.
        source: Where its values come from.
    """
    link = LINKS[law.link]
    plain = link.code.format(law=law.formula()).replace("np.", "")
    words = [_in_docstring(textwrap.fill(text, _WIDTH)) for text in (sentence, f"Source: {source}.")]
    does = textwrap.fill(f"{link.action[0].upper()}{link.action[1:]}: {plain}.", _WIDTH - 8, subsequent_indent="    ")
    rounded = law.with_parameters({name: round_to(value) for name, value in law.parameters.items()})
    return f'''"""{words[0]}

{words[1]}
"""

from radiometer.reconciliation.propose.grammar import Term
from radiometer.reconciliation.propose.law import Law, effect_class

LAW = {pformat(rounded, width=_WIDTH - 6)}


class {law.class_name}(effect_class(LAW, {round_to(amplitude)!r})):
    """{does}"""
'''


def _in_docstring(text: str) -> str:
    """Return text that ends no docstring and is no escape in one: names of folders come from anybody."""
    shown = "".join(one if one.isprintable() or one == "\n" else "?" for one in text)
    return shown.replace("\\", r"\\").replace('"', r"\"")


def source_of_test(
    law: Law,
    amplitude: float,
    file_name: str,
    settings: Mapping[str, float],
    shape: tuple[int, int],
    values: Sequence[tuple[float, float, float, float]],
) -> str:
    """Return the text of a test of an effect file: its values at some places, and nothing at amplitude 0.

    Args:
        settings: Of the frame, by their names in `FrameSettings`.
        shape: Height and width of the sensor in pixels.
        values: Column, row, signal in front of it and what `acted` makes of it.
    """
    found = {law.amplitude: round_to(amplitude)} | {name: round_to(value) for name, value in law.parameters.items()}
    rows = [tuple(round_to(float(v), 10) for v in row) for row in values]
    nothing = "0.0" if LINKS[law.link].is_noise else "before"
    return f'''"""The law `{law.name}` gives what it was proposed with."""

from pathlib import Path

import numpy as np
import pytest

from radiometer.reconciliation.propose.law import context_at
from simulators.effects.registry import make_effect, register_file

register_file(Path(__file__).with_name("{file_name}"))
FOUND = {pformat(found)}
SETTINGS = {pformat(dict(settings))}
# column, row, signal before, {law.shown} after
VALUES = {pformat(rows)}


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_the_law_gives_what_was_found(column, row, before, after):
    """What the effect makes of the signal is what the proposal was made with."""
    found = make_effect("{law.name}", FOUND).{law.shown}(np.array([before]), context_at(column, row, {shape}, SETTINGS))
    assert np.ravel(found)[0] == pytest.approx(after, rel=1e-6)


@pytest.mark.parametrize(("column", "row", "before", "after"), VALUES)
def test_without_its_amplitude_it_does_nothing(column, row, before, after):
    """An amplitude of 0 leaves the signal as it is."""
    nothing = make_effect("{law.name}", FOUND | {{"{law.amplitude}": 0.0}})
    assert np.ravel(nothing.{law.shown}(np.array([before]), context_at(column, row, {shape}, SETTINGS)))[0] == {nothing}
'''


_ENDS: Final = ("left", "middle", "right"), ("upper", "middle", "lower")


@dataclass(frozen=True, slots=True)
class Rival:
    """Another law that the data do not rule out: name, stage, covariates, and how many nats it is behind.

    Negative where it is ahead of one that acts at a plainer stage.
    """

    name: str
    stage: str
    covariates: tuple[str, ...]
    behind_nats: float


@dataclass(frozen=True, eq=False)
class Proposal:
    """A law for what no entry explains."""

    law: Law  # the law at its fitted parameters
    amplitude: float  # its amplitude
    parameters: Mapping[str, FittedParameter]  # all parameters with ± and unit
    nats: float  # improvement of the held-out log density against the starting camera
    before: FitState  # the starting camera as fitted
    after: FitState  # the same with the law
    rivals: tuple[Rival, ...] = ()  # laws within odds of 150, each further parameter and a second factor paid for

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.law.name

    @property
    def stage(self) -> str:
        """Return where in the chain it acts."""
        return LINKS[self.law.link].stage

    @property
    def stages_alike(self) -> tuple[str, ...]:
        """Return further stages at which a rival acts."""
        return tuple(dict.fromkeys(rival.stage for rival in self.rivals if rival.stage != self.stage))

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return the covariates on which it depends, those of its stage included."""
        return tuple(dict.fromkeys((*self.law.covariates, *LINKS[self.law.link].goes_with)))

    @property
    def closed(self) -> float:
        """Return the share of the excess of the held-out gap over 1 that it closes."""
        excess = self.before.gap - 1.0
        return float(np.clip((self.before.gap - self.after.gap) / excess, 0.0, 1.0)) if excess > 0 else 0.0

    def sentence(self) -> str:
        """Return in one sentence what it does and what kind of cause acts so."""
        link = LINKS[self.law.link]
        forms = [_in_words(term, self.before.design.shape) for term in self.law.terms]
        return f"{', '.join([link.action, *filter(None, [' and '.join(forms)])])}: like {link.like}"

    def source(self, origin: str) -> str:
        """Return the text of the effect file."""
        text = self.sentence()
        return effect_source(
            self.law,
            self.amplitude,
            sentence=f"{text[0].upper()}{text[1:]}.",
            source=f"proposed by radiometer reconcile from {origin}",
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping under `proposal` of the JSON form."""
        return {
            "name": self.name,
            "stage": self.stage,
            "stages_alike": list(self.stages_alike),
            "covariates": list(self.covariates),
            "formula": self.law.formula(),
            "parameters": {name: entry.to_mapping() for name, entry in self.parameters.items()},
            "sentence": self.sentence(),
            "gain_nats": self.nats,
            "gap_before": self.before.gap,
            "gap_after": self.after.gap,
            "excess_closed": self.closed,
            "rivals": [asdict(rival) | {"covariates": list(rival.covariates)} for rival in self.rivals],
        }


def _in_words(term: Any, shape: tuple[int, int]) -> str:
    if term.form == "spot":
        height, width = shape
        side = max(shape)
        column = _ENDS[0][int(np.clip(3.0 * term.values["at_x"] * side / width, 0, 2))]
        row = _ENDS[1][int(np.clip(3.0 * term.values["at_y"] * side / height, 0, 2))]
        place = "the middle" if (row, column) == ("middle", "middle") else f"the {row} {column}"
        corner = " corner" if "middle" not in (row, column) else ""
        return f"falling off as a Gaussian from {place}{corner}"
    return FORMS[term.form].words.format(covariate=COVARIATES[term.covariate].words)


_CAPTURES: Final = 3
# A capture is worth taking where its χ² separates the law from none as rivals are separated.
_WORTH: Final = 2.0 * RIVAL_NATS


def _refuting_frames(proposal: Proposal) -> tuple[list[dict[str, Any]], list[str]]:
    """Return frames for `radiometer bracket --plan`, and for each what the law predicts there."""
    pool = CapturePool.of(proposal.after)
    with_law, without = pool.predicted(proposal.after), pool.predicted(proposal.before)
    worth = np.nan_to_num(pool.separation(with_law, without))
    worth = np.where(pool.is_new, worth, 0.5 * worth)
    is_noise = LINKS[proposal.law.link].is_noise
    apart = np.sqrt(with_law.variance) - np.sqrt(without.variance) if is_noise else with_law.mean - without.mean
    does = "scatters by" if is_noise else "differs by"
    frames, reasons = list[dict[str, Any]](), list[str]()
    for index in np.argsort(-worth)[:_CAPTURES].tolist():
        if worth[index] < _WORTH and frames:
            break
        tile = int(np.argmax(np.abs(apart[index])))
        frame = pool.frame(index)
        shown = frame.model_dump(mode="json", exclude_none=True, exclude={"file", "black_level_dn"})
        frames.append(shown | {"repeat": FRAMES})
        reasons.append(
            f"{frame.exposure_s:.3g} s at {frame.gain_db:g} dB, source level {frame.source_level:g}, shutter "
            f"{frame.shutter}: with {proposal.name} patch {pool.design.tiles[tile].name} {does} "
            f"{apart[index, tile]:+.3g} DN relative to the camera without it; the law is refuted where that is not seen"
        )
    return frames, reasons


def write_files(proposal: Proposal, folder: Path, origin: str) -> tuple[Path, ...]:
    """Write effect file, test and the plan that would refute a law, and return their paths.

    Raises:
        OutputError: If a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {folder}: {error.strerror or error}; name another") from error
    name = proposal.name
    effect, test, plan = folder / f"{name}.py", folder / f"test_{name}.py", folder / "plan.yaml"
    frames, reasons = _refuting_frames(proposal)
    write_text_atomic(effect, proposal.source(origin))
    write_text_atomic(test, _test(proposal, effect.name))
    write_yaml_atomic(plan, {"format": PLAN_FORMAT, "reasons": reasons, "frames": frames})
    return effect, test, plan


def _test(proposal: Proposal, file_name: str) -> str:
    design, amplitude = proposal.before.design, round_to(proposal.amplitude)
    warm, (height, width) = design.temperature_c, design.shape
    settings = {
        "exposure_s": float(np.max(design.exposure_s)),
        "gain_db": float(np.max(design.gain_db)),
        "f_number": float(np.min(design.f_number)),
        "temperature_c": float(np.nanmax(warm)) if np.isfinite(warm).any() else 25.0,
        "timestamp_s": float(np.median(design.timestamp_s)),
        "source_level": 1.0,
    }
    places = ((0.0, 0.0, 100.0), (0.5 * width, 0.3 * height, 1000.0), (width - 1.0, height - 1.0, 50.0))
    rows = [
        (x, y, signal, acted(proposal.law, amplitude, signal, context_at(x, y, design.shape, settings)))
        for x, y, signal in places
    ]
    return source_of_test(proposal.law, amplitude, file_name, settings, design.shape, rows)


# ---- a law with its evidence, and its files ------------------------------------------------------------------------
_AT_ONCE: Final = 64  # laws that are projected together
_FAINT: Final = 1e-9
_FOLLOWING: Final = ("mean", *(name for name, row in STATISTICS.items() if row.follows_light))


@dataclass(frozen=True)
class Screened:
    """A law as the means alone show it: best amplitude, χ² that it would explain, and starts that do about as well."""

    law: Law
    amplitude: float
    gain: float
    others: tuple[Screened, ...] = ()

    @cached_property
    def score(self) -> float:
        """Return nats less what the parameters cost."""
        return 0.5 * self.gain - PARAMETER_NATS * self.law.size


@dataclass(frozen=True, slots=True)
class _Values:
    """Values of a law of amplitude 1 in the tiles, broadcasting to (captures, tiles)."""

    mean: Array  # its mean in a tile, over the frames of a capture
    rises: tuple[Array, Array] | None  # from centre to right and to bottom edge; None where it is even within all tiles
    first: Array | None  # in the first frame of a capture less the others; None where frames are alike

    @classmethod
    def of(cls, values: Array, frames: Array) -> _Values:
        """Return those of a law's values."""
        first, others = np.nan_to_num(values[[0, -1]])
        alike = values.shape[0] == 1
        average = first if alike else (first + (frames - 1.0) * others) / frames
        even = average.shape[-1] == 1
        rises = None if even else rise_of(np.broadcast_to(average, (*average.shape[:-1], 4)))
        return cls(average.mean(axis=-1), rises, None if alike else (first - others).mean(axis=-1))


class _Look:
    """Changes that laws make in the tested statistics of one state, and how much of the residual they would take up."""

    def __init__(self, state: FitState) -> None:
        whole, self._cuts, at = state.comparison.cuts, dict[str, slice](), 0
        for block in (*_FOLLOWING, "slope_x", "slope_y", "first"):
            self._cuts[block] = slice(at, at := at + whole[block].stop - whole[block].start)
        rows = np.concatenate([np.arange(whole[block].start, whole[block].stop) for block in self._cuts])
        self.state, self.known = state, _known_values(state)
        self._projected, self._fit = state.fit.projected[rows], state.fit.within(rows)
        self._response = {key: _response(state, key) for key, link in LINKS.items() if not link.is_noise}
        self._found: dict[tuple[object, ...], Array] = {}  # values of terms, and of products of them: laws at several
        self._shown: dict[tuple[object, ...], _Values] = {}  # places of the chain share them

    def screened(self, laws: Iterable[Law]) -> list[Screened]:
        """Return the laws with the amplitude and the χ² that the tile means alone give them, nuisances following."""
        waiting, found, laws = list[Law](), list[Screened](), iter(laws)
        while waiting := list(islice(laws, _AT_ONCE)):
            found += self._gains(waiting, [self._of_law(law) for law in waiting])
        self._found.clear()
        self._shown.clear()
        return found

    def _of_law(self, law: Law) -> list[_Values]:
        found = [self._product(law.terms)]
        if any("phase" in term.values for term in law.terms):
            quarter = {"phase": 0.5 * np.pi}
            ahead = ({name: v + quarter.get(name, 0.0) for name, v in term.values.items()} for term in law.terms)
            found.append(self._product([replace(t, values=v) for t, v in zip(law.terms, ahead, strict=True)]))
        return found

    def _product(self, terms: Sequence[Term]) -> _Values:
        keys = tuple((term.form, term.covariate, *term.constants.items(), *term.values.items()) for term in terms)
        if keys not in self._shown:
            product: Array = np.ones((1, 1, 1, 1))
            for key, term in zip(keys, terms, strict=True):
                if key not in self._found:
                    self._found[key] = _values_of(self.state, term, self.known)
                product = product * self._found[key]
            self._shown[keys] = _Values.of(product, self.state.design.frame_count[:, None, None])
        return self._shown[keys]

    def _gains(self, laws: Sequence[Law], shown: Sequence[Sequence[_Values]]) -> list[Screened]:
        """Return laws, of one column each or (a wave) of two, with amplitude and χ²."""
        columns = [(values, self._response[law.link]) for law, own in zip(laws, shown, strict=True) for values in own]
        changes = np.zeros((self._fit.residual.size, len(columns)))
        for block, cut in self._cuts.items():
            own = self._changes(block, columns)
            if own.any():
                changes[cut] = self.state.comparison.whiten(block, np.moveaxis(own, 0, -1)).reshape(-1, len(columns))
        followed, part = self._fit.followed_with_half(changes)
        slope = followed.T @ self._projected
        squares, rows = np.einsum("ij,ij->j", changes, changes), np.ascontiguousarray(followed.T)
        found, at = [], 0
        for law, pair in zip(laws, shown, strict=True):
            mine = slice(at, at := at + len(pair))
            curvature = rows[mine] @ rows[mine].T - part[:, mine].T @ part[:, mine]
            whole = float(squares[mine].sum())
            if whole < _FAINT or float(np.linalg.eigvalsh(curvature)[0]) < 1e-6 * whole:
                continue  # the nuisances explain all of it
            best = np.linalg.solve(curvature, slope[mine])
            found.append(_turned(law, np.asarray(best), float(best @ slope[mine])))
        return found

    def _changes(self, block: str, columns: Sequence[tuple[_Values, Mapping[str, Array]]]) -> Array:
        found = np.zeros((len(columns), *columns[0][1]["mean"].shape))
        for own, (values, response) in zip(found, columns, strict=True):
            if block == "first":
                factor = values.first
            elif block in ("slope_x", "slope_y"):
                factor = values.rises and values.rises[block == "slope_y"]
            else:
                factor = values.mean
            if factor is not None:
                np.multiply(factor, response.get(block, response["mean"]), out=own)
        return found


def screened(state: FitState, laws: Iterable[Law]) -> list[Screened]:
    """Return laws with the amplitude and the χ² that the tile means alone give them in a state, nuisances following."""
    return _Look(state).screened(laws)


def _known_values(state: FitState) -> dict[str, Array]:
    """Return the covariates that vary within a capture set, by name, each broadcasting to captures × tiles × points."""
    context, design = state.model.context, state.design
    side = max(design.shape)
    settings: Any = context.settings
    signal = state.prediction.signal[:, :, None]
    found = {
        "exposure_s": settings.exposure_s,
        "timestamp_s": np.stack([settings.timestamp_s] * 2),
        "temperature_C": settings.temperature_c,
        "gain_db": settings.gain_db,
        "f_number": settings.f_number,
        "source_level": settings.source_level,
        "image_x": context.geometry.x_px / side,
        "image_y": context.geometry.y_px / side,
        "signal": signal,
        "value": signal * state.prediction.gain[:, None, None],
        "column_light": column_light(np.repeat(signal, 4, axis=2), context),
    }
    parts = (context.first_frame, context.later_frames)
    if design.has_timestamps and None not in parts:
        found["timestamp_s"] = np.stack([np.asarray(part.settings.timestamp_s) for part in parts if part])
        found["since_frame_s"] = np.stack([np.asarray(part.since_frame_s) for part in parts if part])
    lit = design.source_level > 0  # a closed shutter is no level of the source
    if not lit.any() or not _varies(design.source_level[lit]):
        del found["source_level"]
    shown = picture_mean(state.model.radiance[design.pattern_index][:, :, None] * settings.source_level, context)
    if lit.any() and _varies(shown[lit]):
        found["picture_mean"] = shown
    known = {name: np.asarray(v, dtype=np.float64) for name, v in found.items() if _varies(np.asarray(v))}
    return known | ({} if None in parts else {"frame": np.stack([part.frame_numbers for part in parts if part])})


def _varies(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    return finite.size > 0 and not np.isnan(values).any() and float(np.ptp(finite)) > 1e-9 * float(np.abs(finite).max())


def _response(state: FitState, link: str) -> dict[str, Array]:
    exposure = state.design.exposure_s
    step = {
        "1": 1e-3,
        "s": 1e-3 * float(np.median(exposure)),
        "e-": 1.0,
        "e- s-1": 1.0 / float(exposure.max()),
        "DN": 0.1,
        "W m-2": 1e-3 * np.pi * state.model.context.peak_radiance / 64.0,
    }[LINKS[link].unit]
    moved = state.comparison.expected(state.predicted_with((*state.effects, effect_of(Law(link), step))))
    base = state.comparison.expected(state.prediction)
    return {name: np.asarray((moved[name] - base[name]) / step) for name in _FOLLOWING}


def _values_of(state: FitState, term: Term, known: Mapping[str, Array]) -> Array:
    """Return a term's values, broadcasting to frames × captures × tiles × points."""
    own = {name: known[name] for name in term.covariates}
    if term.form == "step" and term.covariate in ("signal", "value"):
        noise = np.sqrt(state.prediction.variance) / (
            1.0 if term.covariate == "value" else state.prediction.gain[:, None]
        )
        share = ndtr((own[term.covariate] - term.values["at"]) / noise[:, :, None])  # of pixels beyond it
        return np.asarray(share[None])
    grid = state.model.context.grid
    if grid is not None and FORMS[term.form].is_steep and set(term.covariates) & set(PLACES):
        side = max(state.design.shape)
        fine = {"image_x": grid.x_px / side, "image_y": grid.y_px / side}
        points, _ = from_grid(term.evaluated(own | {name: fine[name] for name in own if name in fine}))
        return np.asarray(points[None])
    frames = (0, 1) if set(own) & set(PER_FRAME) else (0,)
    parts = [term.evaluated({n: v[i] if n in PER_FRAME else v for n, v in own.items()}) for i in frames]
    return np.stack(parts)


def _turned(law: Law, best: Array, gain: float) -> Screened:
    """Return the law with the amplitude, and of a wave with the phase, that two columns gave."""
    if best.size == 1:
        return Screened(law, float(best[0]), gain)
    phase = float(np.arctan2(best[1], best[0]))
    terms = tuple(replace(t, values={**t.values, "phase": phase}) if "phase" in t.values else t for t in law.terms)
    return Screened(Law(law.link, terms), float(np.hypot(*best)), gain)


_NOISES: Final = {"1": (0.002, 0.01), "DN": (0.5, 3.0)}  # standard deviations that laws of noise start from, by unit
_OF_NOISE: Final = ("power", "step")  # forms that are nowhere below 0
_FITTED: Final = 16  # laws that are fitted to all statistics
_JUDGED: Final = 4  # of them, those that are fitted in full
_MULTIPLIED: Final = 5  # laws of one term that are multiplied by another
_CONSTANT: Final = ("analog", "digital")  # a constant there is a black level that is off
_ALONE: Final = ("well", "range")  # what goes with the signal goes with nothing else, nor what comes back in turns
_PLAIN: Final = ("digital", "optics")  # of two that no setting separates: what no gain amplifies, what scales light
_OF_A_PLACE: Final = {*PLACES, "column_light"}
_SECOND: Final = ("ramp", "power", "step", "decay", "bow")
_OF_A_KIND: Final = 2  # laws of one formula at different stages that are fitted, beyond the best
_NEAR: Final = 0.5  # share of the best start's gain from which others of its kind are tried: means alone alias waves
_STARTS: Final = 10
_PLACES: Final = 60  # where a law of a sharp place starts: the means alone hardly tell rows of one tile apart
_REFINED: Final = (("step", "border"), ("step",))  # in two turns: a border is found to half a pixel in the first
_FINER: Final = 6  # laws of a sharp place that are refined


@on_one_blas_thread
def propose_law(state: FitState, along: Collection[str] = ()) -> Proposal | None:
    """Return the law that explains best what a starting camera lacks; None where none is beyond chance.

    Args:
        along: Covariates to which laws are confined, of one term then; by default all, and products of two terms.
    """
    look = _Look(state)
    singles = look.screened(law for law in _singles(look.known) if not along or set(law.covariates) <= set(along))
    for forms in _REFINED:
        singles += look.screened(_finer(look.known, singles, forms))
    plain = {_formula(entry.law): entry.score for entry in sorted(singles, key=lambda entry: entry.score)}
    products = [
        entry
        for entry in (look.screened(_products(look.known, singles)) if not along else ())
        if entry.score > plain.get(_formula(entry.law)[:1], 0.0) + NAMED_NATS
    ]
    judged = _judged(state, _chosen([*singles, *products, *_noises(look, along)]))
    if not judged:
        return None
    best = _plainest(judged)
    if _score(best) < NAMED_NATS:
        return None
    law, after, nats = best[0], best[1].state, best[1].nats
    effect = next(e for e in after.effects if e.name == law.name)
    law = law.with_parameters(effect.values())
    rivals = tuple(
        Rival(other.name, LINKS[other.link].stage, other.covariates, round(_score(best) - _score(entry), 1))
        for entry in sorted(judged, key=lambda entry: -_score(entry))
        if (other := entry[0]) is not best[0] and _score(best) - _score(entry) < RIVAL_NATS and not _holds(other, law)
    )
    parameters = fitted_parameters(after)[law.name]
    return Proposal(law, float(effect.values()[law.amplitude]), parameters, nats, state, after, rivals)


# ---- which laws are looked at ------------------------------------------------------------------------------
def _singles(known: Mapping[str, Array]) -> Iterator[Law]:
    terms = {name: tuple(terms_of(name, known)) for name in known}
    for link in (link for link in LINKS.values() if not link.is_noise):
        if "f_number" in link.goes_with and "f_number" not in known:
            continue  # it is light past the lens then
        if link.key in _CONSTANT:
            yield Law(link.key)
        for name in link.covariates:
            for term in terms.get(name, ()):
                from_zero = (
                    term.form in ("line", "arch") and link.unit == "1"
                )  # the responsivity is free next to a factor
                if not from_zero and all(covariate in known for covariate in term.covariates):
                    yield Law(link.key, (term,))


def _noises(look: _Look, along: Collection[str]) -> list[Screened]:
    known, found = look.known, list[Screened]()
    for link in (link for link in LINKS.values() if link.is_noise):
        terms = [term for name in link.covariates if name in known for term in terms_of(name, known)]
        laws = [Law(link.key, (term,)) for term in terms if term.form in _OF_NOISE]
        for law in [*([Law(link.key)] if link.goes_with else []), *laws]:
            if along and not {*law.covariates, *link.goes_with} <= set(along):
                continue
            start = best_start(look.state, [effect_of(law, size) for size in _NOISES[link.unit]])
            if start is not None:
                found.append(Screened(law, float(start.effect.values()[law.amplitude]), start.gain))
    return found


def _finer(known: Mapping[str, Array], singles: Sequence[Screened], forms: Collection[str]) -> Iterator[Law]:
    """Yield the laws whose place the fit leaves where it is, between the places at which they were looked at."""
    ranked = (entry.law for entry in sorted(singles, key=lambda e: -e.score))
    sharp = [law for law in ranked if _is_sharp(law) and law.terms[0].form in forms]
    for law in sharp[:_FINER]:
        alike = [other.terms[0].values["at"] for other in sharp if other.name == law.name]
        yield from (Law(law.link, (term,)) for term in finer(law.terms[0], known[law.terms[0].covariate], alike))


def _is_sharp(law: Law) -> bool:
    return [term.form for term in law.terms] in (["step"], ["border"])


def _products(known: Mapping[str, Array], singles: Iterable[Screened]) -> Iterator[Law]:
    for place in PLACES if "source_level" in known else ():
        tilts = [term for term in terms_of(place, known) if term.form in ("ramp", "bow")]
        levels = [term for term in terms_of("source_level", known) if term.form in ("power", "step")]
        yield from (Law("scene", (tilt, level)) for tilt in tilts for level in levels)
    together = (e for e in singles if e.law.terms and e.law.link not in _ALONE and "frame" not in e.law.covariates)
    for entry in _distinct(together, _MULTIPLIED):
        own = entry.law.terms[0]
        for name in known:
            if name in (*own.covariates, "signal", "value", "frame") or {name, own.covariate} <= _OF_A_PLACE:
                continue
            further = [term for term in terms_of(name, known) if term.form in _SECOND]
            # In the scene where it depends on drive and place, else at the place of its first factor.
            scenic = {name, own.covariate} & set(PLACES) and "source_level" in (name, own.covariate)
            yield from (Law("scene" if scenic else entry.law.link, (own, term)) for term in further)


def _distinct(screened_: Iterable[Screened], most: int) -> list[Screened]:
    found: dict[tuple[tuple[str, str], ...], Screened] = {}
    for entry in sorted(screened_, key=lambda entry: -entry.score):
        found.setdefault(_formula(entry.law), entry)
    return list(islice(found.values(), most))


def _formula(law: Law) -> tuple[tuple[str, str], ...]:
    return tuple((term.form, term.covariate) for term in law.terms)


def _chosen(entries: Iterable[Screened]) -> list[Screened]:
    """Return what is fitted: of each stage and formula the best start, of each formula the best stages."""
    kinds: dict[tuple[str, object], list[Screened]] = {}
    for entry in sorted(entries, key=lambda entry: -entry.score):
        kinds.setdefault((entry.law.link, _formula(entry.law)), []).append(entry)
    taken: list[Screened] = []
    for entry, *others in kinds.values():
        most = _PLACES if _is_sharp(entry.law) else _STARTS
        near = tuple(other for other in others if other.gain > _NEAR * entry.gain)[:most]
        entry = replace(entry, others=near)
        alike = [other for other in taken if _formula(other.law) == _formula(entry.law)]
        if (len(alike) <= _OF_A_KIND or entry.law.link in _PLAIN) and entry.score > 0:
            taken.append(entry)
    return taken[:_FITTED]


# ---- judged as effects -------------------------------------------------------------------------------------
_JudgedLaw = tuple[Law, Contender]


def _judged(state: FitState, chosen: list[Screened]) -> list[_JudgedLaw]:
    laws, rated = dict[int, Law](), list[tuple[float, FittedCandidate]]()
    for entry in chosen:
        effect = _started(entry)
        if effect is None:
            continue
        try:
            others = tuple(start for other in entry.others if (start := _started(other)) is not None)
            fitted = fit_candidate(state, Candidate(effect, entry.gain, entry.law.size, others=others))
        except (MeasurementError, np.linalg.LinAlgError):
            continue
        laws[id(fitted)] = entry.law
        rated.append((judged_gain(state, fitted) - PARAMETER_NATS * entry.law.size, fitted))
    best = sorted(rated, key=lambda entry: -entry[0])[:_JUDGED]
    return [(laws[id(one.fitted)], one) for one in contenders_of(state, [fitted for _, fitted in best])]


def _started(entry: Screened) -> CatalogueEffect | None:
    return effect_of(entry.law, round_to(entry.amplitude)) if entry.amplitude else None


def _plainest(judged: Sequence[_JudgedLaw]) -> _JudgedLaw:
    """Return the law of the highest score; of those that the data hardly rule out one of a plain stage."""
    most = max(_score(entry) for entry in judged)
    near = [entry for entry in judged if most - _score(entry) < RIVAL_NATS]
    return min(near, key=lambda entry: (entry[0].link not in _PLAIN, -_score(entry)))


def _holds(law: Law, other: Law) -> bool:
    return law.link == other.link and set(_formula(other)) < set(_formula(law))


def _score(entry: _JudgedLaw) -> float:
    law, fitted = entry
    return fitted.nats - PARAMETER_NATS * law.size - NAMED_NATS * (len(law.terms) - 1)


# ---- names against laws ---------------------------------------------------------------------------------------------
# A search can only report names that it knows. Where its names leave something, are several, or are doubted, another
# cause is a hypothesis too: names that one law outdoes by far are none. A single name that leaves nothing is compared
# with constants and with the laws along its covariate. Where one of them predicts better, the name is provisional, or
# none where it brings far less.
# What is known of a name beforehand is its own equation: a table or a curve would follow any law. What names
# bring is therefore what their own equations bring, without the curves that represent no cause. A name by another
# equation than the catalogue's is not meant by this: its own brings most of what any law along its covariate brings.


def held_to_laws(
    outcome: Search, catalogue: Mapping[str, type[CatalogueEffect]], say: Callable[[str], None] = lambda line: None
) -> Search:
    """Return the outcome with what laws of no entry say of its names: nothing, a doubt, or that they are none."""
    effects = outcome.state.effects
    if not effects:
        return outcome
    weighed = posterior(outcome.state.models, catalogue, scatter_of(outcome.state))
    stays = len(effects) > 1 or leaves_structure(outcome) or bool(doubts_of(outcome, weighed))
    along = () if stays else own_covariates(effects[0])
    law = propose_law(outcome.start, along=along)
    if law is None:
        return outcome
    is_plainer = law.law.size < outcome.state.parameters.size
    # An entry is known beforehand, a law is not: it must lead by the odds of a name. A lead that it owes to fewer
    # parameters makes a name doubtful, and takes none away: the law may be a special case of the entry.
    lead = (worth(law.after) - worth(outcome.state)) / scatter_of(outcome.state)
    if lead <= (0.0 if is_plainer else NAMED_NATS):
        return outcome
    named = " and ".join(step.name for step in outcome.steps if step.name != "unnamed")
    remark = f"{law.name}, a law outside the catalogue, predicts better than {named}"
    say(remark)
    if lead <= NAMED_NATS or _brings_most(outcome, law):
        return replace(outcome, remarks=(*outcome.remarks, remark))
    return _without_names(outcome, law, f"{remark} (gap {law.after.gap:.3g}), which is therefore not named")


def own_covariates(effect: CatalogueEffect) -> tuple[str, ...]:
    """Return the covariates of laws that an entry may follow; a place of screen or lens is one of the picture."""
    found = list[str]()
    for where in type(effect).law_along or (effect.where,):
        is_place = where in ("field_radius", "screen_x", "screen_y", *PLACES)
        found += PLACES if is_place else ("signal", "value") if where == "signal" else (where,)
    return tuple(dict.fromkeys(found))


def _brings_most(outcome: Search, law: Proposal) -> bool:
    """Return whether names stand though a law predicts better: it is their own law, by an equation unlike theirs."""
    base = worth(outcome.start)
    if worth(_by_own_equations(outcome)) - base < SMOOTH_SHARE * (worth(law.after) - base):
        return False
    effects = outcome.state.effects
    own = len(effects) == 1 and set(law.law.covariates) <= set(own_covariates(effects[0]))
    return own or not leaves_structure(outcome)


def _own_equation(effect: CatalogueEffect, outcome: Search) -> CatalogueEffect:
    own = effect.own if isinstance(effect, FreeLaw) else effect
    plain = min(type(own).starts(outcome.start.model.context), key=lambda start: len(start.free()))
    if set(own.free()) <= set(plain.free()):
        return own
    shared = (name for name in plain.free() if "[" not in name)
    return plain.with_parameters(**{name: getattr(own, name) for name in shared})


def _by_own_equations(outcome: Search) -> FitState:
    """Return the model with the names by their own equations, fitted anew, without any unnamed curve."""
    state = outcome.state
    own = [_own_equation(effect, outcome) for effect in state.effects]
    if all(map(operator.is_, own, state.effects)) and not any(term.is_smooth for term in state.terms):
        return state
    plain = outcome.start
    try:
        for effect in own:
            plain = included(plain, effect)
    except (UnfitError, np.linalg.LinAlgError, ConfigurationError):  # they bring what those bring that can be fitted
        pass
    return plain


def _without_names(outcome: Search, law: Proposal, remark: str) -> Search:
    named = [step for step in outcome.steps if step.name != "unnamed"]
    nearest = max(named, key=lambda step: step.gain_nats)
    step = Step(
        "unnamed",
        law.law.where,
        law.nats,
        outcome.start.gap,
        law.after.gap,
        closest=(nearest.name, min(nearest.gain_nats / law.nats, 1.0)),
        block="mean",
    )
    tests = outcome.first_tests
    return replace(outcome, state=outcome.start, steps=(step,), tests=tests, remarks=(remark,))
