"""`radiometer response`: recover the camera response from brackets or photographs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.api.response import DEFAULT_METHOD, ResponseEstimate, median_uncertainty
from radiometer.cli.arguments import parse_known_ratios
from radiometer.cli.function import command_of

_LN_2 = math.log(2.0)


def whole_words(words: Sequence[str]) -> list[str]:
    """Return the words of the command line with an empty name behind a `--plot` that has none: Typer asks for one."""
    result: list[str] = []
    for word, following in zip(words, [*words[1:], None], strict=True):
        bare = word == "--plot" and (following is None or following.startswith("-") or Path(following).is_dir())
        result.append("--plot=" if bare else word)
    return result


def _show(found: rm.Response) -> None:
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


command = command_of(
    "recover_response", _show, files=("output",), defaults={"method": DEFAULT_METHOD, "force": False},
    converters={"known_ratio": parse_known_ratios}, sources=typer.Argument(metavar="PATH..."), method=typer.Option(),
    known_ratio=typer.Option(metavar="PAIR=RATIO"), plot=Annotated[str | None, typer.Option(metavar="[FILE]")],
)  # fmt: skip
