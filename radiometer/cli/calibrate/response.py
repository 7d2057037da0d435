"""`radiometer response`: recover the camera response from brackets or photographs."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from radiometer.analysis.exports.curves import CURVE_SUFFIXES, write_curves
from radiometer.analysis.response.auto import recover_colours_auto
from radiometer.analysis.response.compare import compare_methods
from radiometer.analysis.response.estimate import ResponseEstimate, median_uncertainty, telling
from radiometer.analysis.response.labels import refuse_lying_labels
from radiometer.analysis.response.methods import DEFAULT_METHOD, METHODS, RATIO_METHODS, method_names
from radiometer.api.outputs import check_outputs
from radiometer.bench.sources import open_brackets
from radiometer.cli.arguments import ISO_HELP, parse_known_ratios, parse_measured_iso
from radiometer.cli.calibrate.response_plot import check_plot_name, draw_responses
from radiometer.cli.console import note, progress_bar
from radiometer.cli.outputs import writes
from radiometer.data import Bracket
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.errors import MeasurementError, UsageError
from radiometer.photographs.alignment import photographs_in_one_place
from radiometer.photographs.iso_record import with_iso_speeds

_CURVE_SUFFIXES = (".csv", ".yaml", ".yml", *CURVE_SUFFIXES)
_METHOD_HELP = f"Method: {', '.join(METHODS)}, or all."
_RATIO_HELP = (
    "Exposure of frame PAIR+1 over that of frame PAIR (0: the two shortest), for methods that find ratios themselves; "
    "fixes the exponent in place of the stated times; may be repeated."
)
_CHANNEL_HELP = "Channel of colour photographs: luminance, red, green, blue, or each (one curve per colour)."

_LN_2 = math.log(2.0)

Report = Callable[[int, int], None]
# Every n-th pixel of larger photographs is taken: the noise of so many is far below what frames and places differ by.
_ENOUGH_PIXELS = 1_000_000


@writes("output")
def command(
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Capture sets or folders of photographs.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Curve to write: .csv, .yaml, .m (pfstools) or .rsp (hdrgen)."
        ),
    ] = None,
    plot: Annotated[
        str | None,
        typer.Option("--plot", metavar="[FILE]", help="Draw the curve; without FILE, beside the output as .png."),
    ] = None,
    channel: Annotated[str, typer.Option("--channel", help=_CHANNEL_HELP)] = "luminance",
    method: Annotated[str, typer.Option("--method", help=_METHOD_HELP)] = DEFAULT_METHOD,
    known_ratio: Annotated[
        list[str] | None, typer.Option("--known-ratio", metavar="PAIR=RATIO", help=_RATIO_HELP)
    ] = None,
    measured_iso: Annotated[
        list[str] | None, typer.Option("--measured-iso", metavar="STATED=REAL", help=ISO_HELP)
    ] = None,
    align: Annotated[
        str, typer.Option(help="Photographs from the hand: auto (where they moved), on, or off.", metavar="auto|on|off")
    ] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
) -> None:
    """Recover the camera response g(M) = ln H from brackets of exposures, with its uncertainty.

    Several PATHs are fitted jointly: one camera, one response.
    """
    names = method_names(method)
    ratios = parse_known_ratios(known_ratio, names)
    speeds = IsoSpeeds(parse_measured_iso(measured_iso))
    picture = _plot_path(plot, output)
    _check_targets(output, picture, names, force=force)
    started = time.monotonic()
    found = _read(paths, channel, speeds, align)
    joint: Sequence[ResponseEstimate | None] = [None] * len(found)
    if DEFAULT_METHOD in names and len(found) > 1:
        with _bar("recovering the response of all colours together"):
            joint = recover_colours_auto(list(found.values()))
    estimates = [
        estimate
        for brackets, known in zip(found.values(), joint, strict=True)
        for estimate in _recover(brackets, names, ratios, known)
    ]
    estimates = [with_iso_speeds(estimate, *found.values()) for estimate in estimates]
    files = _write(estimates, output) if output is not None else []
    if picture is not None:
        draw_responses(estimates, picture)
    if as_json:
        print(json.dumps(_mapping(estimates, files, picture)))
        return
    _print_summary(estimates, [*files, *([picture] if picture else [])], time.monotonic() - started)


def app(arguments: Sequence[str], **how: Any) -> Any:
    """Run the command; `--plot` may stand alone, which Typer itself does not know.

    Args:
        arguments: Words after `radiometer response`.
        how: Passed on to Typer.
    """
    inner = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    inner.command(name="response", context_settings={"help_option_names": ["-h", "--help"]})(command)
    return inner(_with_plot_name(list(arguments)), **how)


def _with_plot_name(words: list[str]) -> list[str]:
    """Put an empty name behind a `--plot` that has none."""
    result: list[str] = []
    for word, following in zip(words, [*words[1:], None], strict=True):
        bare = word == "--plot" and (following is None or following.startswith("-") or Path(following).is_dir())
        result.append("--plot=" if bare else word)
    return result


def _plot_path(plot: str | None, output: Path | None) -> Path | None:
    if plot is None:
        return None
    if plot:
        return Path(plot)
    return (output or Path("response")).with_suffix(".png")


def _check_targets(output: Path | None, picture: Path | None, methods: Sequence[str], *, force: bool) -> None:
    """Refuse what cannot be written before the work is done, not after."""
    if output is not None and output.suffix.lower() not in _CURVE_SUFFIXES:
        raise UsageError(f"cannot write {output}: a curve's ending must be one of {', '.join(_CURVE_SUFFIXES)}")
    if picture is not None:
        check_plot_name(picture)
    check_outputs(output, picture, force=force)
    if output is not None:  # several curves carry channel and method in their files' names
        parts = [f"-{channel}" for channel in ("red", "green", "blue")] + [""]
        names = [f"{part}{method}" for part in parts for method in ("", *(f"-{name}" for name in methods))]
        check_outputs(*(output.with_stem(output.stem + name) for name in names if name), force=force)


def _read(paths: Sequence[Path], channel: str, speeds: IsoSpeeds, align: str) -> dict[str, list[Bracket]]:
    """Return the brackets of all paths by colour channel; photographs in one place."""
    found: dict[str, list[Bracket]] = {}
    for path in paths:
        with _bar(f"reading {path.name}") as report:
            brackets = open_brackets(path, channel, report=report, speeds=speeds, most_pixels=_ENOUGH_PIXELS)
        for bracket in _placed(brackets, align):
            found.setdefault(str(bracket.frames[0].extra.get("channel", "mono")), []).append(bracket)
    return found


def _placed(brackets: list[Bracket], align: str) -> list[Bracket]:
    """Return photographs in one place, which is said where they were moved; a camera on a bench stands still."""
    for bracket in brackets:
        refuse_lying_labels(bracket)
    placed = photographs_in_one_place(brackets, align)
    if placed.absent:
        note(f"{brackets[0].origin}: {placed.sentence}")
    return placed.common


def _recover(
    brackets: Sequence[Bracket],
    names: Sequence[str],
    known_ratios: Mapping[int, float],
    with_other_colours: ResponseEstimate | None,
) -> Iterator[ResponseEstimate]:
    """Yield the estimate of every method; that of the default is given where it was made with other colours."""
    with _bar("recovering the response") as report:
        for done, name in enumerate(names):
            report(done, len(names))
            try:
                if name == DEFAULT_METHOD and with_other_colours is not None:
                    yield telling(with_other_colours, brackets[0].origin)
                elif name in RATIO_METHODS and known_ratios:
                    yield telling(RATIO_METHODS[name](brackets, known_ratios=known_ratios), brackets[0].origin)
                else:
                    yield telling(METHODS[name](brackets), brackets[0].origin)
            except MeasurementError as error:
                if len(names) == 1 or name == DEFAULT_METHOD:
                    raise
                note(f"{name} gives no curve: {error}")
        report(len(names), len(names))


@contextmanager
def _bar(text: str) -> Iterator[Report]:
    """Show a progress bar on standard error while it is a terminal."""
    with progress_bar() as progress:
        task = progress.add_task(text, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _write(estimates: Sequence[ResponseEstimate], output: Path) -> list[Path]:
    """Write one curve under the given name, several with channel and method in theirs."""
    if output.suffix.lower() in CURVE_SUFFIXES:
        return _write_for_others(estimates, output)
    channels = {estimate.curve.channel for estimate in estimates}
    methods = {estimate.method for estimate in estimates}
    files = []
    for estimate in estimates:
        parts = [output.stem]
        parts += [estimate.curve.channel] if len(channels) > 1 else []
        parts += [estimate.method] if len(methods) > 1 else []
        target = output.with_name("-".join(parts) + output.suffix)
        estimate.curve.write(target)
        files.append(target)
    return files


def _write_for_others(estimates: Sequence[ResponseEstimate], output: Path) -> list[Path]:
    """Write the channels of each method into one file of another program's form."""
    methods = list(dict.fromkeys(estimate.method for estimate in estimates))
    files = []
    for method in methods:
        target = output.with_name(f"{output.stem}-{method}{output.suffix}") if len(methods) > 1 else output
        write_curves(target, {one.curve.channel: one.curve for one in estimates if one.method == method})
        files.append(target)
    return files


def _mapping(estimates: Sequence[ResponseEstimate], files: Sequence[Path], picture: Path | None) -> dict[str, Any]:
    return {
        "format": "radiometer-response-result/1",
        "curves": [estimate.to_mapping() for estimate in estimates],
        "disagreements": [found.to_mapping() for found in compare_methods(estimates)],
        "files": [str(file) for file in files],
        "plot": None if picture is None else str(picture),
    }


def _print_summary(estimates: Sequence[ResponseEstimate], files: Sequence[Path], seconds: float) -> None:
    for estimate in estimates:
        print("\n".join(_summary(estimate)), end="\n\n" if len(estimates) > 1 else "\n")
    for found in compare_methods(estimates):
        print(
            f"disagreement     {found.second} and {found.first} ({found.channel}): {100 * found.rms_log:.2g} % rms, "
            f"at most {found.largest_sigma:.1f} sigma at {found.at_dn} DN"
        )
    for file in files:
        print(f"written          {file}")
    print(f"time             {seconds:.2f} s")


def _summary(estimate: ResponseEstimate) -> list[str]:
    curve = estimate.curve
    low, high = curve.valid_dn or (0, curve.log_exposure.size - 1)
    stops = float(curve.log_exposure[high] - curve.log_exposure[low]) / _LN_2
    lines = [
        f"method           {estimate.method}, channel {curve.channel}, {curve.bit_depth} bits",
        f"data             {estimate.pixel_count:,} pixels in {estimate.group_count} groups, "
        f"{estimate.sample_count:,} unclipped values",
        f"supported        {low} to {high} DN, {stops:.1f} stops; not supported outside",
        f"u(ln H)          {median_uncertainty(curve):.2g} (median, k = 1, over 5 to 95 % of that range)",
        f"gauge            {estimate.gauge}",
    ]
    if estimate.stability is not None:
        lines.append(
            f"disjoint thirds  differ by {100 * estimate.stability.rms_log:.2g} % (rms), "
            f"reduced chi-square {estimate.stability.reduced_chi2:.2f}"
        )
    if estimate.agreement is not None:
        lines.append(
            f"parts            quadrants of the picture differ by {100 * estimate.agreement.quadrants_rms_log:.2g} %, "
            f"frames by {100 * estimate.agreement.frames_rms_log:.2g} % (rms)"
        )
    lines += [f"assumed          {text}" for text in curve.provenance.assumptions]
    return lines + [f"note             {text}" for text in estimate.notes]
