"""`radiometer response`: recover the camera response from brackets or photographs."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.api.response import DEFAULT_METHOD, METHODS, ResponseEstimate, median_uncertainty
from radiometer.cli.arguments import ISO_HELP, parse_known_ratios, parse_measured_iso
from radiometer.cli.console import note, progress
from radiometer.cli.outputs import writes

_METHOD_HELP = f"Method: {', '.join(METHODS)}, or all."
_RATIO_HELP = (
    "Exposure of frame PAIR+1 over that of frame PAIR (0: the two shortest), for methods that find ratios themselves; "
    "fixes the exponent in place of the stated times; may be repeated."
)
_CHANNEL_HELP = "Channel of colour photographs: luminance, red, green, blue, or each (one curve per colour)."

_LN_2 = math.log(2.0)


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
        typer.Option("--plot", metavar="[FILE]", help="Draw the curve; without FILE, next to the output as .png."),
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
    force: Annotated[bool, typer.Option("--force", help="Replace output files that exist.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Recover the camera response g(M) = ln H from brackets of exposures, with its uncertainty.

    Several PATHs are fitted jointly: one camera, one response.
    """
    started = time.monotonic()
    with progress(shown=not as_json) as shown:
        found = rm.recover_response(
            paths, method, channel=channel, known_ratio=parse_known_ratios(known_ratio),
            measured_iso=parse_measured_iso(measured_iso), align=align, output=output, plot=_plot_path(plot, output),
            force=force, progress=shown,
        )  # fmt: skip
    for text in found.notes:
        note(text)
    if as_json:
        print(found.to_json())
        return
    _print_summary(found, time.monotonic() - started)


def whole_words(words: Sequence[str]) -> list[str]:
    """Return the words of the command line with an empty name behind a `--plot` that has none: Typer asks for one."""
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


def _print_summary(found: rm.Response, seconds: float) -> None:
    for estimate in found.estimates:
        print("\n".join(_summary(estimate)), end="\n\n" if len(found.estimates) > 1 else "\n")
    content = found.to_mapping()
    for each in content["disagreements"]:
        first, second = each["methods"]
        print(
            f"disagreement     {second} and {first} ({each['channel']}): {100 * each['rms_log']:.2g} % rms, "
            f"at most {each['largest_sigma']:.1f} sigma at {each['at_dn']} DN"
        )
    for file in (*content["files"], *([content["plot"]] if content["plot"] else [])):
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
