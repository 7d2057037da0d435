"""`radiometer adapt`: the dark-adaptation test."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated

import typer

from radiometer.cli.console import console, note
from radiometer.cli.light.adapt_run import register
from radiometer.cli.outputs import writes
from radiometer.errors import MeasurementError, UsageError

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Dark adaptation: run the test, and say what its thresholds tell of an eye.",
)


register(app)


@app.callback()
def adapt() -> None:
    """Dark adaptation: run the test, and say what its thresholds tell of an eye."""


@app.command()
@writes("report", "csv")
def fit(
    data: Annotated[
        Path,
        typer.Argument(
            help="Table of times and thresholds, perhaps with their sigma: many forms and units are understood."
        ),
    ],
    criterion: Annotated[
        float | None,
        typer.Option(help="log10 threshold of which the time is wanted, in place of the protocol's rod intercept."),
    ] = None,
    stimulus_u_log10: Annotated[
        float | None, typer.Option(min=0.0, help="Standard uncertainty of the stimulus calibration, log10 units.")
    ] = None,
    bootstrap: Annotated[int, typer.Option(min=0, help="Bootstrap redraws; 0 for none.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Makes the redraws.")] = 1,
    report: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV of thresholds, fit and residuals to write.")] = None,
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Fit cone and rod branches to thresholds: plateau, rod–cone break, S2, rod intercept, final threshold.

    One branch, cones and S2 (5 parameters) or cones, S2 and S3 (7) are tried; the AICc decides among those that
    make sense.
    """
    import numpy as np

    from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation, intercept_verdict
    from radiometer.adaptation.reliability import NAMES, Reliability
    from radiometer.adaptation.report import curve_csv, label_of, to_mapping, write_page
    from radiometer.adaptation.run_facts import intercept_of, number_of
    from radiometer.adaptation.threshold_series import ThresholdSeries
    from radiometer.data.storage import write_text_atomic

    series = ThresholdSeries.read(data)
    if stimulus_u_log10 is None:
        stimulus_u_log10 = number_of(series.facts, "u_scale_log10") or 0.0
    rule = intercept_of(series.facts) if criterion is None else None
    request = FitRequest(criterion, stimulus_u_log10, bootstrap, intercept=rule)
    found = fit_adaptation(series, request, np.random.default_rng(seed))
    if report is not None:
        write_page(found, report, f"Dark adaptation: {data.stem}")
    if csv is not None:
        write_text_atomic(csv, curve_csv(found))
    if json:
        print(json_module.dumps(to_mapping(found)))
        return
    out = console()
    out.print(f"[bold]{found.verdict}[/bold]")
    met = intercept_verdict(found)
    if met is not None:
        out.print(f"[bold]{met}[/bold]")
    for name, estimate in found.estimates.items():
        interval = estimate.profile or estimate.bootstrap
        shown = f"   {interval.low:.3f} to {interval.high:.3f} (95 %)" if interval else ""
        out.print(f"{label_of(name, found):<32} {estimate.value:9.3f} {estimate.unit:<10}{shown}")
    for name, rate in Reliability.of_facts(series.facts).rates.items():
        out.print(f"{NAMES[name]:<32} {rate}")
    note(f"model {found.chosen.model.name}; scatter of a threshold {found.chosen.sigma:.3f} log10 units")
    for said in series.taken:
        note(f"taken: {said}")


@app.command()
def retest(
    visits: Annotated[
        list[Path],
        typer.Argument(help="Tables as `adapt fit` reads them: first and second visit of each subject, in turn."),
    ],
    json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Say how well repeated visits agree: differences of break, S2, rod intercept and plateau.

    From three subjects on with limits of agreement (Bland and Altman), mean ± 1.96 standard deviations, and their 95 %
    intervals.
    """
    import numpy as np

    from radiometer.adaptation.adaptation_fit import AdaptationFit, FitRequest, fit_adaptation
    from radiometer.adaptation.report import LABELS
    from radiometer.adaptation.retest import FEWEST_PAIRS, compare_visits
    from radiometer.adaptation.run_facts import intercept_of
    from radiometer.adaptation.threshold_series import ThresholdSeries

    if len(visits) % 2:
        raise UsageError(f"{len(visits)} tables: give two for each subject, first and second visit")

    def fitted(file: Path) -> AdaptationFit:
        series = ThresholdSeries.read(file)
        request = FitRequest(bootstrap_draws=0, intercept=intercept_of(series.facts))
        try:
            return fit_adaptation(series, request, np.random.default_rng(1))
        except MeasurementError as error:
            raise MeasurementError(f"{file}: {error}") from error

    pairs = [(fitted(first), fitted(second)) for first, second in zip(visits[::2], visits[1::2], strict=True)]
    found = compare_visits(pairs)
    if json:
        print(json_module.dumps({one.name: one.to_mapping() for one in found}))
        return
    if not found:
        raise MeasurementError("no pair of visits has a break, an S2 slope or a rod intercept in both")
    out = console()
    for one in found:
        out.print(f"[bold]{LABELS[one.name]}[/bold] ({one.unit}), {len(one.visits)} pairs")
        for first, second in one.visits:
            out.print(f"  {first:9.3f} then {second:9.3f}   difference {second - first:+.3f}")
        if one.missing:
            out.print(f"  not in both visits of pair {', '.join(map(str, one.missing))}")
        out.print(f"  standard uncertainty of a difference by the fits alone: {one.u_fits:.3f}")
        if one.agreement is None:
            out.print(f"  limits of agreement need {FEWEST_PAIRS} pairs")
            continue
        for name, bound in (
            ("mean difference", one.agreement.mean),
            ("lower limit", one.agreement.lower),
            ("upper limit", one.agreement.upper),
        ):
            out.print(f"  {name:<16} {bound.value:+.3f}   {bound.low:+.3f} to {bound.high:+.3f} (95 %)")
