"""A camera's passport: what stayed and what changed between its sessions over years."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr, ndtri, stdtrit

from radiometer.archive.sessions import LightSeries, Session
from radiometer.data import Quantity
from radiometer.numbers import unit_text, with_u
from radiometer.typing import Array

# To what an unchanged camera repeats at best between sessions, relative: a smaller difference is no change, however
# well it is known.
_DARK: Final = "dark current"
_REPEATABILITY: Final[dict[str, float]] = {"K": 0.01, "K_dark": 0.01, "sigma_y_dark": 0.01, _DARK: 0.01}
_REPEATABILITY_BLACK_DN: Final = 1.0  # black levels wander by a DN with temperature and age
_COMPARED: Final = ("K", "K_dark", "sigma_y_dark", "mu_y_dark")
_PER_K: Final = math.log(2.0) / 6.0  # change of a dark current that doubles per 6 K, the least that is usual
_AGREE_SIGMAS: Final = 2.0  # 95 %
_CHANGED_SIGMAS: Final = 3.0  # 0.3 % by chance; the limit rises with the number of pairs
_TINY_U: Final = 1e-300  # where nothing is known of both uncertainties
_JUMP_SIGMAS: Final = 5.0  # by chance once in 2 million places
_SMALLEST_JUMP_REL: Final = 0.002  # engineering prior: lamps wander by a tenth of a percent from frame to frame
_LIGHT_CHANGED_REL: Final = 0.01  # engineering prior: to this a lamp repeats that is switched on again
_FEWEST_OF_A_COURSE: Final = 3  # two frames are a pair
_PARAMETERS: Final = 2  # of a law of the dark current
_COVERED: Final = 0.97725  # of a normal distribution, below two sigma
_STEP_K: Final = 0.01  # of a central difference, short against the kelvins within which the rate doubles
_ZERO_C_K: Final = 273.15  # 0 °C in K
_CARRIERS_POWER, _CARRIERS_K = 2.54, 6726.0  # of silicon


@dataclass(frozen=True, slots=True)
class SessionDoubling:
    """The doubling of one session by itself, and what the law of all makes of its temperatures."""

    session: str
    measured_k: Quantity
    expected_k: float


@dataclass(frozen=True, slots=True)
class DarkLaw:
    """One law of the dark current over all sessions, of T in °C."""

    # T_d on average between the temperatures, its standard uncertainty widened by the points' scatter
    doubling_k: Quantity
    between_c: tuple[float, float]  # the lowest and the highest of these in °C
    rate_at_0: Quantity  # Dark current at 0 °C in DN/s
    # Share of what is generated in the depletion region halfway between them, the rest being diffusion; None where D =
    # D_0·2^(T / T_d) describes the points better
    generation_share: Quantity | None
    birge_ratio: float  # scatter over what the points' uncertainties allow
    offset_session: str  # the session that is farthest from the law of the others; empty where none can be
    # Its offset in ln D, the u widened by the scatter; None where one session is all there is, or temperatures and
    # sessions cannot be separated
    offset: Quantity | None
    # (session, temperature in °C, dark current in DN/s, its distance from the law in u)
    points: tuple[tuple[str, float, float, float], ...]
    # Doublings of the single sessions: with two mechanisms they differ with the temperature
    doublings: tuple[SessionDoubling, ...]

    @property
    def doublings_apart_u(self) -> float | None:
        """Return how far sessions' doublings scatter about what the law says they differ by, in u; None of one."""
        if len(self.doublings) < 2:
            return None
        apart, u = np.array([(d.measured_k.value - d.expected_k, d.measured_k.u) for d in self.doublings]).T
        return math.sqrt(float(np.sum(np.square((apart - np.average(apart, weights=u**-2)) / u)) / (apart.size - 1)))

    @property
    def relative_offset(self) -> Quantity | None:
        """Return by what part of the others' dark current that of `offset_session` is higher."""
        if self.offset is None:
            return None
        ratio = math.exp(self.offset.value)
        return Quantity(ratio - 1.0, ratio * self.offset.u, "1")

    @property
    def is_one(self) -> bool:
        """Return whether every session is within two u of the law of the others."""
        return self.offset is None or abs(self.offset.value) <= _AGREE_SIGMAS * self.offset.u


@dataclass(frozen=True, slots=True)
class Change:
    """How a quantity compares between sessions: its values, and whether it changed."""

    quantity: str
    changed: bool
    what: str


@dataclass(frozen=True, slots=True)
class Passport:
    """What the sessions of one camera say together."""

    camera: tuple[str, ...]  # maker, model, serial number, band
    sessions: tuple[Session, ...]  # the sessions by time
    dark_law: DarkLaw | None  # the law of the dark current; None where fewer than two temperatures show it
    gain: tuple[str, ...]  # lines on the gain: stated against light against darks
    changes: tuple[Change, ...]  # what changed and what did not, of the camera
    light: tuple[str, ...]  # what the light did, which is not the camera's

    def to_mapping(self) -> dict[str, Any]:
        """Return the passport as plain values."""
        law = self.dark_law
        return {
            "camera": " ".join(self.camera),
            "sessions": [
                {
                    "name": s.name,
                    "taken": s.taken.isoformat() if s.taken else None,
                    "figures": {name: q.to_mapping() for name, q in s.figures.items()},
                    "notes": list(s.notes),
                }
                for s in self.sessions
            ],
            "dark_law": None
            if law is None
            else {
                "doubling_K": law.doubling_k.to_mapping(),
                "doubling_between_C": list(law.between_c),
                "rate_at_0C": law.rate_at_0.to_mapping(),
                "generation_share": None if law.generation_share is None else law.generation_share.to_mapping(),
                "birge_ratio": law.birge_ratio,
                "one_law": law.is_one,
                "session_offset": None
                if law.relative_offset is None
                else {"session": law.offset_session, **law.relative_offset.to_mapping()},
                "points": [
                    {"session": name, "temperature_C": t, "rate_dn_per_s": rate, "distance_u": z}
                    for name, t, rate, z in law.points
                ],
                "session_doublings": [
                    {"session": one.session, "doubling_K": one.measured_k.to_mapping(), "expected_K": one.expected_k}
                    for one in law.doublings
                ],
                "session_doublings_apart_u": law.doublings_apart_u,
            },
            "gain": list(self.gain),
            "changes": [asdict(change) for change in self.changes],
            "light": list(self.light),
        }


def passports(sessions: Sequence[Session]) -> list[Passport]:
    """Return one passport per camera."""
    by_camera: dict[tuple[str, ...], list[Session]] = {}
    for session in sessions:
        by_camera.setdefault(session.camera, []).append(session)
    return [_passport(camera, own) for camera, own in by_camera.items()]


def _passport(camera: tuple[str, ...], sessions: Sequence[Session]) -> Passport:
    law = fit_dark_law(sessions)
    figures = ([(s, s.figures[name]) for s in sessions if name in s.figures] for name in _COMPARED)
    found = (_compared(name, known) for name, known in zip(_COMPARED, figures, strict=True))
    changes = [change for change in found if change is not None]
    if law is not None and len({point[0] for point in law.points}) > 1:
        verdict = "one law" if law.is_one else "no one law"
        off = law.relative_offset
        apart = "" if off is None else f", {law.offset_session} {off.scaled(100.0, '%').text(with_k=True)} from it"
        what = f"{verdict} over {len(law.points)} temperatures of {len({p[0] for p in law.points})} sessions{apart}"
        changes.append(Change(_DARK, not law.is_one, what))
    elif law is None and (change := _compared(_DARK, _rates_of_one_temperature(sessions))) is not None:
        changes.append(change)
    return Passport(
        camera, tuple(sessions), law, tuple(_gain(sessions)), tuple(changes), tuple(_light(sessions, changes))
    )


def _rates_of_one_temperature(sessions: Sequence[Session]) -> list[tuple[Session, Quantity]]:
    """Return the dark current of each session that shows one, where no two temperatures make a law of it."""
    shown = [(s, *s.dark_rates[0]) for s in sessions if s.dark_rates and s.dark_rates[0][2].value > 0.0]
    mean_c = sum(t for _, t, _, _ in shown) / max(len(shown), 1)
    return [
        (s, Quantity(rate.value, math.hypot(rate.u, rate.value * _PER_K * math.hypot(u_t, t - mean_c)), rate.unit))
        for s, t, u_t, rate in shown
    ]


def fit_dark_law(sessions: Sequence[Session]) -> DarkLaw | None:
    """Return the law of the dark current over all plateaus of all sessions; None with fewer than two temperatures.

    ln D is a line over T, or D the sum of diffusion and generation in silicon, which have the same two parameters: the
    one that describes three points and more better is taken. Each point's uncertainty holds that of its temperature;
    scatter beyond it widens the law's.

    Source: EMVA Standard 1288, release 4.0, equation (17); Widenhorn et al., Proc. SPIE 4669 (2002), for the sum;
    JCGM 100:2008, annex H.3.
    """
    points = [(s.name, t, u, rate) for s in sessions for t, u, rate in s.dark_rates if rate.value > 2 * rate.u]
    temperatures = np.array([t for _, t, _, _ in points])
    if len(points) < 2 or np.ptp(temperatures) < 1.0:
        return None
    logs = np.array([math.log(rate.value) for _, _, _, rate in points])
    slope = np.full(logs.size, math.log(2) / 5.0)
    for _ in range(3):
        u = np.array([math.hypot(rate.u_rel, own * u_t) for own, (_, _, u_t, rate) in zip(slope, points, strict=True)])
        doubling, silicon = _doubling_law(temperatures, logs, u), _two_mechanisms(temperatures, logs, u)
        if doubling is None:
            return None
        # Two points fit either law, and cannot decide between them.
        found, other = (doubling, silicon) if logs.size == _PARAMETERS else _better(doubling, silicon)
        slope = found.slope(temperatures)
    ends = np.array([temperatures.min(), temperatures.max()])
    birge = math.sqrt(found.chi2 / (logs.size - _PARAMETERS)) if logs.size > _PARAMETERS else 1.0
    factor = max(1.0, birge)
    steepness = float(np.ptp(found.log_rate(ends)) / np.ptp(ends))
    across = np.diff(found.derivatives(ends), axis=0)[0] / np.ptp(ends)
    u_steepness = factor * math.sqrt(float(across @ found.covariance @ across))
    at_0 = math.exp(float(found.log_rate(0.0)))
    return DarkLaw(
        Quantity(math.log(2) / steepness, math.log(2) / steepness**2 * u_steepness, "K"),
        (float(ends[0]), float(ends[1])),
        Quantity(at_0, at_0 * factor * found.u_of_log_rate(0.0), "DN/s"),
        found.generation(float(ends.mean()), factor),
        birge,
        *_largest_offset([name for name, _, _, _ in points], (found, other), temperatures, logs, u),
        tuple(
            (name, float(t), rate.value, float(z))
            for (name, t, _, rate), z in zip(points, (logs - found.log_rate(temperatures)) / u, strict=True)
        ),
        tuple(_doublings(sessions, found)),
    )


@dataclass(frozen=True, slots=True)
class _Fitted:
    """D = Σ amplitudeᵢ·shapeᵢ(T) or, of one shape, ln D = a + b·T: parameters, their covariance, and χ²."""

    parameters: Array  # (a, b), or the amplitudes of diffusion and generation at 0 °C in DN/s
    covariance: Array  # (2, 2) of them, for the points' uncertainties as stated
    chi2: float  # of the logarithms
    is_sum: bool  # whether it is the sum of two mechanisms

    def log_rate(self, celsius: float | Array) -> Array:
        """Return ln D at temperatures."""
        if not self.is_sum:
            return np.asarray(self.parameters[0] + self.parameters[1] * np.asarray(celsius))
        return np.asarray(np.log(_mechanisms(celsius) @ self.parameters))

    def slope(self, celsius: float | Array) -> Array:
        """Return d(ln D)/dT at temperatures, in 1/K."""
        low, high = (self.log_rate(np.asarray(celsius) + step) for step in (-_STEP_K, _STEP_K))
        return np.asarray((high - low) / (2.0 * _STEP_K))

    def derivatives(self, celsius: float | Array) -> Array:
        """Return d(ln D)/d(parameter), (temperatures, 2)."""
        if not self.is_sum:
            return np.stack(np.broadcast_arrays(1.0, np.asarray(celsius, dtype=np.float64)), axis=-1)
        return np.asarray(_mechanisms(celsius) / np.exp(self.log_rate(celsius))[..., None])

    def u_of_log_rate(self, celsius: float) -> float:
        """Return the standard uncertainty of ln D at a temperature."""
        towards = self.derivatives(celsius)
        return math.sqrt(float(towards @ self.covariance @ towards))

    def generation(self, celsius: float, factor: float) -> Quantity | None:
        """Return the share of generation at a temperature, its u widened by a factor; None where it is no sum."""
        if not self.is_sum:
            return None
        parts = _mechanisms(celsius) * self.parameters
        share = float(parts[1] / parts.sum())
        towards = np.array([-share, 1.0 - share]) * _mechanisms(celsius) / parts.sum()
        return Quantity(share, factor * math.sqrt(float(towards @ self.covariance @ towards)), "1")


def _doubling_law(temperatures: Array, logs: Array, u: Array) -> _Fitted | None:
    design = np.column_stack([np.ones_like(logs), temperatures]) / u[:, None]
    covariance = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    parameters = covariance @ design.T @ (logs / u)
    residual = design @ parameters - logs / u
    return _Fitted(parameters, covariance, float(residual @ residual), is_sum=False) if parameters[1] > 0 else None


def _mechanisms(celsius: float | Array) -> Array:
    """Return what diffusion and generation have grown by since 0 °C, (temperatures, 2).

    The former is proportional to the square of the intrinsic density of carriers n_i, the latter to n_i.

    Source: Misiakos, Tsamakis, J. Appl. Phys. 74 (1993) 3293: n_i = 5.29e19 cm⁻³ (T/300 K)^2.54 exp(−6726 K/T).
    """
    kelvin = np.asarray(celsius, dtype=np.float64) + _ZERO_C_K
    carriers = np.power(kelvin / _ZERO_C_K, _CARRIERS_POWER) * np.exp(_CARRIERS_K * (1.0 / _ZERO_C_K - 1.0 / kelvin))
    return np.stack([np.square(carriers), carriers], axis=-1)


def _two_mechanisms(temperatures: Array, logs: Array, u: Array) -> _Fitted:
    """Return the sum of both mechanisms, neither below zero, at the least χ² of the logarithms."""
    shapes = _mechanisms(temperatures)
    rate = np.exp(logs)
    for _ in range(20):  # deviations of D over D are those of ln D near the law
        parameters = nnls(shapes / (rate * u)[:, None], np.exp(logs) / (rate * u))[0]
        rate = shapes @ parameters
    towards = shapes / (rate * u)[:, None]
    covariance = np.asarray(np.linalg.inv(towards.T @ towards), dtype=np.float64)
    return _Fitted(parameters, covariance, float(np.sum(np.square((logs - np.log(rate)) / u))), is_sum=True)


def _doublings(sessions: Sequence[Session], law: _Fitted) -> Iterator[SessionDoubling]:
    for session in sessions:
        temperatures = [t for t, _, _ in session.dark_rates]
        if "T_d" in session.figures and len(temperatures) > 1:
            ends = np.array([min(temperatures), max(temperatures)])
            expected = math.log(2) * float(np.ptp(ends)) / float(np.ptp(law.log_rate(ends)))
            yield SessionDoubling(session.name, session.figures["T_d"], expected)


def _better(first: _Fitted, second: _Fitted) -> tuple[_Fitted, _Fitted]:
    """Return the law that is nearer to the points, and the other."""
    return (first, second) if first.chi2 <= second.chi2 else (second, first)


def _largest_offset(
    names: Sequence[str], laws: tuple[_Fitted, _Fitted], temperatures: Array, logs: Array, u: Array
) -> tuple[str, Quantity | None]:
    """Return the session whose ln D is farthest, in u, from the law of the others, and how far it is.

    Args:
        names: Session of each point.
        laws: The chosen law and the other. Which one is true is unknown, so a curvature between sessions is an offset
            under one of them. The u includes the difference.
        u: Its standard uncertainty.
    """
    found = []
    for name in dict.fromkeys(names):
        own = np.array([other == name for other in names], dtype=np.float64)
        offset, other = (_offset(law, own, temperatures, logs, u) for law in laws)
        if offset is not None and other is not None:
            form = abs(other.value - offset.value) / math.sqrt(3.0)
            found.append((name, replace(offset, u=math.hypot(offset.u, form))))
    return max(found, key=lambda one: abs(one[1].value) / one[1].u, default=("", None))


def _offset(law: _Fitted, own: Array, temperatures: Array, logs: Array, u: Array) -> Quantity | None:
    """Return the offset of one session's points, marked by ones, from the law of the others; None if unknown."""
    shared, residual = law.derivatives(temperatures), (logs - law.log_rate(temperatures)) / u
    design = np.column_stack([shared / np.abs(shared).max(axis=0), own]) / u[:, None]
    if own.all() or np.linalg.matrix_rank(design) <= _PARAMETERS:
        return None
    normal = np.linalg.inv(design.T @ design)
    solution = normal @ design.T @ residual
    freedom = logs.size - _PARAMETERS - 1
    scatter = float(np.linalg.norm(design @ solution - residual)) / math.sqrt(max(freedom, 1))
    if scatter > 1.0:  # a u from the scatter of few points is itself hardly known: two u cover as Student's t does
        scatter *= float(stdtrit(freedom, _COVERED)) / _AGREE_SIGMAS
    return Quantity(float(solution[2]), math.sqrt(float(normal[2, 2])) * max(1.0, scatter), "1")


def _compared(name: str, known: Sequence[tuple[Session, Quantity]]) -> Change | None:
    """Return how a figure compares between the sessions that hold it; None where fewer than two do.

    It changed where two sessions differ by more than three standard uncertainties of their difference, and by more
    than an unchanged camera repeats. Of many sessions, some pair differs by three by chance: the limit rises so that
    chance names a change as seldom as of two sessions.
    """
    if len(known) < 2:
        return None
    pairs = list(itertools.combinations(known, 2))
    limit_sigmas = -float(ndtri(ndtr(-_CHANGED_SIGMAS) / len(pairs)))
    changed = [
        (abs(difference.value) / max(difference.u, _TINY_U), _against(before, after, difference))
        for (before, one), (after, other) in pairs
        for difference in [Quantity(other.value - one.value, math.hypot(one.u, other.u), one.unit)]
        if abs(difference.value) > max(limit_sigmas * difference.u, _repeatability(name, one.value))
    ]
    text = ", ".join(with_u(q.value, 2.0 * q.u) for _, q in known) + f" {unit_text(known[0][1].unit)} (k = 2)"
    if not changed:
        return Change(name, False, text)
    degrees = _temperatures([s for s, _ in known])
    return Change(name, True, f"{text}{degrees}: {max(changed)[1]}")


def _against(before: Session, after: Session, difference: Quantity) -> str:
    sign = "+" if difference.value >= 0 else ""
    size = with_u(difference.value, 2.0 * difference.u, difference.unit, k=2)
    return f"{after.name} against {before.name} {sign}{size}"


def _repeatability(name: str, value: float) -> float:
    return _REPEATABILITY_BLACK_DN if name == "mu_y_dark" else _REPEATABILITY[name] * value


def _temperatures(sessions: Sequence[Session]) -> str:
    known = [[t for t, _, _ in s.dark_rates] for s in sessions]
    if not all(known):
        return ""
    return " at " + ", ".join("/".join(f"{t:.0f}" for t in several) for several in known) + " °C"


def _gain(sessions: Sequence[Session]) -> list[str]:
    """Return lines on the gain: what headers state against what light and darks say, and these against each other."""
    lines = []
    light, dark = (_mean([s.figures[name] for s in sessions if name in s.figures]) for name in ("K", "K_dark"))
    stated = sorted({s.stated_e_per_dn for s in sessions if s.stated_e_per_dn is not None})
    for source, K in (("light", light), ("darks", dark)):
        if K is None:
            continue
        measured, u = 1.0 / K.value, K.u_rel / K.value
        lines.append(f"from {source}: {with_u(measured, 2.0 * u, 'e-/DN', k=2)}")
        for value in stated:
            off, sigmas = 100.0 * (value / measured - 1.0), abs(value - measured) / u
            word = "wrong" if sigmas > _AGREE_SIGMAS else "within 2 u"
            lines.append(f"stated are {value:.4g} e⁻/DN: off by {off:+.1f} % against {source} ({sigmas:.1f} u), {word}")
    if light is not None and dark is not None:
        sigmas = abs(light.value - dark.value) / math.hypot(light.u, dark.u)
        word = "agree" if sigmas <= _AGREE_SIGMAS else "disagree"
        lines.append(f"light and darks {word}: {sigmas:.1f} u apart")
    return lines


def _mean(values: Sequence[Quantity]) -> Quantity | None:
    """Return the mean of one gain seen several times; what bends it is the sensor's, so u is no less than the best."""
    if not values:
        return None
    x, u = np.array([(q.value, q.u) for q in values]).T
    weights = u**-2 / np.sum(u**-2)
    mean = float(weights @ x)
    scatter = math.sqrt(float(weights @ (x - mean) ** 2))
    return Quantity(mean, math.hypot(float(u.min()), scatter), values[0].unit)


def _light(sessions: Sequence[Session], changes_of_camera: Sequence[Change]) -> list[str]:
    lines = [line for s in sessions for series in s.series if (line := light_line(s.name, series))]
    levels: dict[tuple[Any, ...], list[tuple[Session, float]]] = {}
    for session in sessions:
        for series in session.series:
            levels.setdefault(series.setting, []).append((session, float(np.mean(series.signal_dn))))
    changes: dict[tuple[str, str], list[tuple[float, float]]] = {}  # (exposure in s, change) by the sessions' names
    for setting, seen in levels.items():
        for (before, low), (after, high) in itertools.pairwise(seen):
            change = _level_change(before, low, after, high)
            if change is not None:
                changes.setdefault((before.name, after.name), []).append((setting[0], change))
    compared = {one.quantity: one.changed for one in changes_of_camera if one.quantity in ("K", _DARK)}
    whose = "light or camera"
    if "K" in compared and not any(compared.values()):
        same = " and ".join("gain" if one == "K" else one for one in compared)
        whose = f"the light, or the quantum efficiency ({same} did not change)"
    for (before_name, after_name), found in changes.items():
        (shortest, least), (longest, most) = (tuple(map(of, zip(*found, strict=True))) for of in (min, max))
        times = " to ".join(dict.fromkeys(f"{one:g}" for one in (shortest, longest)))
        by = " to ".join(dict.fromkeys(f"{100 * one:+.1f}" for one in (least, most)))
        lines.append(f"at {times} s the signal changed by {by} % from {before_name} to {after_name}: {whose}")
    return lines


def _level_change(before: Session, low: float, after: Session, high: float) -> float | None:
    """Return by what part the signal of one setting rose; None where the light did not change."""
    change = high / low - 1.0
    gains = [s.figures.get("K") for s in (before, after)]
    if abs(change) <= _LIGHT_CHANGED_REL:
        return None
    if gains[0] is None or gains[1] is None:
        return change
    # The same electrons at another gain are a change of the camera; at the same gain, of the light.
    of_light = high / gains[1].value / (low / gains[0].value) - 1.0
    known_to = 2 * math.hypot(gains[0].u_rel, gains[1].u_rel)
    return change if abs(of_light) > _LIGHT_CHANGED_REL + known_to else None


def light_line(session: str, series: LightSeries) -> str | None:
    """Return what the light did during frames of one setting; None where it was steady to 0.2 %, or two are all.

    A jump is a step between two frames that stands five standard deviations out of the scatter on both sides.
    """
    signal = np.array(series.signal_dn)
    if signal.size < _FEWEST_OF_A_COURSE:
        return None
    relative = signal / signal.mean() - 1.0
    jump = _jump(relative)
    where = f"{session}, {series.exposure_s:g} s"
    if jump is not None:
        index, size = jump
        return (
            f"{where}: the light jumped by {100 * size:+.2f} % between {series.files[index - 1]} and "
            f"{series.files[index]}"
        )
    spread = float(np.std(relative, ddof=1))
    if spread < _SMALLEST_JUMP_REL / 2:
        return None
    return (
        f"{where}: the light wandered by {100 * spread:.2f} % (standard deviation of {signal.size} frames, "
        f"{100 * relative.min():+.2f} to {100 * relative.max():+.2f} %)"
    )


def _jump(relative: Array) -> tuple[int, float] | None:
    """Return (index of the first frame behind it, size) of the clearest step; None where there is none."""
    if relative.size < 6:
        return None
    best: tuple[float, int, float] | None = None
    for index in range(2, relative.size - 1):
        before, after = relative[:index], relative[index:]
        size = float(after.mean() - before.mean())
        rest = np.concatenate([before - before.mean(), after - after.mean()])
        sd = math.sqrt(float(rest @ rest) / (relative.size - 2))
        sigmas = abs(size) / max(sd * math.sqrt(1 / before.size + 1 / after.size), 1e-9)
        if best is None or sigmas > best[0]:
            best = (sigmas, index, size)
    if best is None or best[0] < _JUMP_SIGMAS or abs(best[2]) < _SMALLEST_JUMP_REL:
        return None
    return best[1], best[2]
