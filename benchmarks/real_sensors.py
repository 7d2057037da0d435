"""Real sensors whose effects somebody documents: what this program says of them.

    python -m benchmarks real_sensors [--sets PART…]

Needs the real sets in shared/data; says so and leaves where they are absent. Right is an effect that is named, or
whose covariate comes first, or, of what equal frames differ by, one that is reported with its size. Partly is one
that shows only further down; wrong a name that neither its owner documents nor an independent measurement of the same
frames shows. A provisional name is one that the verdict itself calls so.
"""

from __future__ import annotations

import argparse
import gzip
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks._lsst_flats import SENSORS, WELL_E, covariances, flats, u_of_slope
from benchmarks._real_sets import SETS, Documented, RealSet, data_folder
from benchmarks._sections import write_section
from radiometer.importing import import_sources, imported_of
from radiometer.importing.sources import as_capture
from radiometer.reconciliation.result import ReconcileResult
from radiometer.reconciliation.sources import reconcile_source

LSST_SEED = 20
_LEADING = 3  # places of the localisation that count as first
_READ = "read, not found"  # is counted neither way


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    title: str
    documented: str
    by: str
    result: str
    judged: str
    seconds: float

    def markdown(self) -> str:
        cells = (self.title, self.documented, self.by, self.result, self.judged, f"{self.seconds:.1f} s")
        return "| " + " | ".join(cells) + " |"


def judged(effect: Documented, result: ReconcileResult) -> str:
    """Return whether a documented effect was named, only pointed at, or missed."""
    if any(found.name in effect.names for found in result.effects):
        return "right"
    if reported_of_frames(effect, result):
        return "right: reported"
    places = [place.covariate for place in result.localisation]
    if any(where in effect.covariates for where in places[:_LEADING]):
        return "right covariate"
    shown = [*places, *(found.where for found in result.effects)]
    return "partly" if any(where in effect.covariates for where in shown) else "missed"


def reported_of_frames(effect: Documented, result: ReconcileResult) -> str:
    """Return what the result reports of equal frames, where that is what is documented and its size is sure."""
    matching = [one for one in result.repeats if one.kind == effect.repeats_of]
    sure = [one for one in matching if one.scatter.u is not None and one.scatter.value > 3.0 * one.scatter.u]
    return "; ".join(text for one in sure for text in one.sentences())


def wrong_names(known: RealSet, result: ReconcileResult) -> list[str]:
    """Return names that are neither documented nor likely."""
    right = {name for effect in known.documented for name in effect.names} | set(known.likely) | {"unnamed"}
    return [found.name for found in result.effects if found.name not in right]


def of_reconcile(known: RealSet, folder: Path) -> Iterator[Row]:
    """Yield a row for each documented effect of a set, and one for names that are not so."""
    path = folder / known.folder / known.files if known.files else folder / known.folder
    begun = time.process_time()
    result = reconcile_source(path).result
    seconds = time.process_time() - begun
    for effect in known.documented:
        named = [f for f in result.effects if f.name in effect.names]
        result_text = "; ".join(_shown(f.name, f.parameters) for f in named) or reported_of_frames(effect, result)
        result_text = result_text or f"first along {_first(result)}"
        yield Row(known.name, effect.what, effect.by, result_text, judged(effect, result), seconds)
    wrong = wrong_names(known, result)
    provisional = "provisional " if result.verdict == "incomplete" else "confident "
    result_text = f"{result.verdict}; " + (", ".join(found.name for found in result.effects) or "no name")
    verdict = "wrong: " + provisional + ", ".join(wrong) if wrong else "right: no false name"
    yield Row(known.name, "no other effect", "", result_text, verdict, seconds)


def _first(result: ReconcileResult) -> str:
    return ", ".join(dict.fromkeys(place.covariate for place in result.localisation[:_LEADING])) or "nothing"


def _shown(name: str, parameters: object) -> str:
    figures = [
        f"{key} {entry.value:.3g} ± {entry.u:.1g}"
        for key, entry in dict(parameters).items()  # type: ignore[call-overload]
        if entry.u is not None
    ]
    return f"`{name}` ({', '.join(figures[:3])})"


def of_multispectral(folder: Path) -> Iterator[Row]:
    """Yield what the reading of raw frames says of black levels, bits and fall-off."""
    begun = time.process_time()
    found = [as_capture(one, folder) for one in import_sources([folder / "sensors" / "micasense_raw"])]
    seconds = time.process_time() - begun
    doubts = [line for capture in found for line in imported_of(capture).doubts]
    masked = [
        float(entry.model_extra["masked_rows_dn"])
        for capture in found
        for entry in capture.header.frames
        if entry.model_extra and "masked_rows_dn" in entry.model_extra
    ]
    steps = sorted({capture.header.camera.code_step_dn or 1 for capture in found})
    named = any("masked" in line for line in doubts)
    title, maker = "RedEdge and Sequoia, 16 raw frames", "the maker's tags in every file"
    span = f"masked rows {min(masked):.0f} to {max(masked):.0f} DN against the tag 4800"
    yield Row(
        title, "black level tag 4800, masked rows 4899 to 5562", maker, span, "right" if named else "missed", seconds
    )
    result_text = "codes in steps of " + " and ".join(f"{step} DN" for step in steps)
    yield Row(
        title, "12 and 10 bits in 16", "all values", result_text, "right" if steps == [16, 64] else "missed", seconds
    )
    for what, entry in (
        ("states row-dependent exposure", "row_dependent_exposure"),
        ("fall-off to the corners", "natural_vignetting"),
    ):
        sets = sum(any(entry in line for line in imported_of(capture).doubts) for capture in found)
        result_text = f"`{entry}` read from the tags of {sets} bands, not found in the scenes"
        yield Row(title, what, maker, result_text, _READ if sets else "missed", seconds)


def of_clamped_pairs(folder: Path) -> Iterator[Row]:
    """Yield what the statistics of the clamped converter say."""
    from radiometer.analysis.characterise.characterise import characterise
    from radiometer.analysis.characterise.subject import read_subject

    path = folder / "sensors" / "astrotracker_ptc_clamp" / "exposure_sweep_pairs.csv"
    begun = time.process_time()
    notes = list(characterise(read_subject(path)).notes)
    seconds = time.process_time() - begun
    clipped = [note for note in notes if "clip" in note]
    yield Row(
        "star-tracker CMOS, pairs as a table",
        "12 bits clamped at 255",
        "PLAN.md of its repository",
        clipped[0] if clipped else "nothing of clipping",
        "partly" if clipped else "missed",  # that it clips, not that four bits were cut off
        seconds,
    )


def of_lenses(folder: Path) -> Iterator[Row]:
    """Yield how many measured fall-off curves the form of the optical entries holds."""
    from scipy.optimize import least_squares

    path = folder / "sensors" / "lensfun_vignetting" / "vignetting_pa.csv.gz"
    begun = time.process_time()
    with gzip.open(path, "rt", encoding="utf-8") as stream:
        head = stream.readline().strip().split(",")
        lines = [line.rstrip("\n").rsplit(",", 3)[-3:] for line in stream]
    assert head[-3:] == ["k1", "k2", "k3"], head
    k = np.array(lines, dtype=float)[:: max(1, len(lines) // 300)]
    r = np.linspace(0.0, 1.0, 21)
    curves = 1.0 + k[:, :1] * r**2 + k[:, 1:2] * r**4 + k[:, 2:] * r**6

    def form(p: np.ndarray) -> np.ndarray:
        return (1.0 + r**2 / np.exp(2.0 * p[0])) ** -2 * (1.0 - p[1] * r ** np.exp(p[2]))

    within = 0
    for curve in curves:
        starts = ((1.0, 0.1, 1.4), (0.3, 0.1, 2.0))
        fits = [least_squares(lambda p, c=curve: form(p) - c, s, max_nfev=60) for s in starts]
        within += min(float(np.sqrt(2.0 * fit.cost / r.size)) for fit in fits) < 0.01
    share = within / len(curves)
    result_text = f"natural and mechanical vignetting hold {100 * share:.0f} % of {len(curves)} curves within 1 %"
    verdict, seconds = "right" if share > 0.9 else "partly", time.process_time() - begun
    yield Row("709 lenses, fall-off curves", "96 % of curves within 1 %", "lensfun", result_text, verdict, seconds)


def of_covariances(folder: Path) -> Iterator[Row]:
    """Yield what is reported of flats that are drawn with the covariances of two CCDs, and what it predicts beyond."""
    from radiometer.reconciliation import reconcile_capture
    from simulators.effects.brighter_fatter import BrighterFatter

    for sensor in SENSORS:
        slope, scatter = covariances(folder, sensor)
        measured = slope[0, 2] + slope[2, 0], float(np.hypot(scatter[0, 2], scatter[2, 0]))
        with tempfile.TemporaryDirectory() as place:
            path = flats(folder, sensor, LSST_SEED).write(Path(place) / "set")
            begun = time.process_time()
            result = reconcile_capture(path).result
            seconds = time.process_time() - begun
        named = [effect for effect in result.added if isinstance(effect, BrighterFatter)]
        alone = bool(named) and len(result.effects) == 1 and result.verdict == "effects_found"
        u = u_of_slope()
        u_rel = float(np.hypot(u / slope[0, 1], u / slope[1, 0]))
        result_text = f"{result.verdict}; " + ", ".join(found.name for found in result.effects)
        for effect in named:
            kernel = effect.slopes_per_e(WELL_E)
            result_text += f"; C₀₀ {kernel[8, 8]:.3g}/e⁻, C₀₁/C₁₀ {kernel[8, 9] / kernel[9, 8]:.2f} (the "
            result_text += f"frames determine it to ± {100 * u_rel:.1f} %), "
            result_text += f"sum over all lags {abs(kernel.sum() / kernel[8, 8]):.0e} "
            result_text += "of C₀₀, second neighbours "
            result_text += f"{kernel[8, 10] + kernel[10, 8]:.2g}/e⁻ (measured {measured[0]:.2g} ± {measured[1]:.1g})"
        yield Row(
            f"flats with the measured covariances of LSST's {sensor} CCD",
            f"brighter-fatter: C₀₀ {slope[0, 0]:.3g}/e⁻, C₀₁/C₁₀ {slope[0, 1] / slope[1, 0]:.2f}, and beyond",
            "C. Lage, Poisson_CCD",
            result_text,
            "right" if alone else "partly" if named else "missed",
            seconds,
        )


QUESTIONS: tuple[tuple[str, Callable[[Path], Iterator[Row]]], ...] = (
    ("RedEdge", of_multispectral),
    ("star-tracker", of_clamped_pairs),
    ("lenses", of_lenses),
    ("LSST", of_covariances),
)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks real_sensors")
    parser.add_argument("--sets", nargs="*", default=[], help="parts of the names of sets to take; all by default")
    chosen_sets = parser.parse_args().sets
    folder = data_folder()
    if folder is None:
        sys.exit("skipped: the real sets (../shared/data) are not on this machine")
    rows: list[Row] = []
    for known in SETS:
        if not chosen_sets or any(part in known.name for part in chosen_sets):
            rows += _printed(of_reconcile(known, folder))
    for name, question in QUESTIONS:
        if not chosen_sets or any(part in name for part in chosen_sets):
            rows += _printed(question(folder))
    table = "| set | documented | by | result | judged | time |\n|---|---|---|---|---|---|\n"
    asked = [row for row in rows if row.by and row.judged != _READ]
    right = sum(row.judged in ("right", "right covariate", "right: reported") for row in asked)
    confident = sum(row.judged.startswith("wrong: confident") for row in rows)
    body = table + "\n".join(row.markdown() for row in rows)
    body += f"\n\n{right} of {len(asked)} documented effects are right: right name, right covariate first, or "
    body += f"a reported size. {confident} sets have a confidently wrong name."
    body += " Time is processor time, reading included."
    print(body)
    if not chosen_sets:
        write_section("real-sensors", "Documented effects", "python -m benchmarks real_sensors", body)


def _printed(rows: Iterator[Row]) -> list[Row]:
    all_rows = list(rows)
    for row in all_rows:
        print(row.markdown(), flush=True)
    return all_rows


if __name__ == "__main__":
    main()
