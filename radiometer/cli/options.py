"""Arguments and options that several commands share, and what every group of commands is made with."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand
from typer.models import ParameterInfo

from radiometer.argument_types import range_of
from radiometer.cli.arguments import parse_f_number, parse_seconds
from radiometer.errors import UsageError
from radiometer.plausible import LARGEST


def time_option(name: str) -> Any:
    """Return a typer option of a time such as 0.2, 200ms or 1/125."""
    return typer.Option(name, parser=lambda words: parse_seconds(words, name), metavar="TIME")


_CAMERA = "sim, a GenICam id, serial number or address, or v4l2:, picamera:, gphoto2:."

CameraOption = Annotated[str | None, typer.Option("--camera", help=_CAMERA)]
BenchOption = Annotated[Path | None, typer.Option("--bench", help="Bench file; the simulated bench by default.")]
JsonOption = Annotated[bool, typer.Option("--json", help="JSON on standard output.")]
PrimariesOption = Annotated[
    str | None,
    typer.Option("--primaries", help="Spectra of red, green, blue: led_lcd, ccfl_lcd, oled, crt, or a CSV of them."),
]
FNumberOption = Annotated[
    float | None,
    typer.Option(
        "--f-number",
        parser=lambda text: parse_f_number(text, "--f-number"),
        metavar="N",
        help="f-number (1 of a lens whose iris cannot change) where the frames or the bench do not state it.",
    ),
]


class OnceCommand(TyperCommand):
    """A command that refuses an option given twice where it takes one value: the last would win without a word."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the words that its parameters do not take."""
        order: list[Any] = self.make_parser(ctx).parse_args(list(args))[2]
        for one in order:
            given_once = one.param_type_name == "option" and not (one.multiple or one.count or _is_switch(one))
            if given_once and order.count(one) > 1:
                raise UsageError(f"{max(one.opts, key=len)} is given twice; give it once")
        return super().parse_args(ctx, args)


def _is_switch(one: Any) -> bool:
    """Return whether an option says the same as often as it is given: it has no opposite and no value."""
    return one.is_flag and not one.secondary_opts


class Commands(typer.Typer):
    """Commands that take each option once, with plain help and no tracebacks."""

    def __init__(self, **how: Any) -> None:
        """Make it as typer does."""
        super().__init__(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False, **how)

    def command(self, name: str | None = None, **how: Any) -> Any:
        """Return the decorator of a command; the range that an option's type states bounds the option."""
        make = super().command(name, cls=OnceCommand, **how)
        return lambda function: make(_with_ranges(function))


def _with_ranges(function: Any) -> Any:
    """Return a command whose options have the ranges that their types state (`plausible`), and plain types."""
    signature, plain = inspect.signature(function, eval_str=True), get_type_hints(function)
    parameters = []
    for one in signature.parameters.values():
        allowed, info = range_of(one.annotation), next(reversed(get_args(one.annotation)), None)
        if allowed is not None and isinstance(info, ParameterInfo):
            info.min = allowed.low if allowed.low > -LARGEST else None
            info.max = allowed.high if allowed.high < LARGEST else None
            one = one.replace(annotation=Annotated[plain[one.name], info])
        parameters.append(one)
    function.__signature__ = signature.replace(parameters=parameters)
    return function


def command_group(text: str) -> typer.Typer:
    """Return an empty group of commands with its help text."""
    return Commands(
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        help=text,
    )


def words(text: str) -> list[str]:
    """Return the parts of a list such as "grey,red"; empty ones are left out."""
    return [part.strip() for part in text.split(",") if part.strip()]
