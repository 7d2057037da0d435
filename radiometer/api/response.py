"""The recovered response of a camera, with plot and table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.calibration.shared import require_same_camera
from radiometer.analysis.exports.curves import CURVE_SUFFIXES, draw_curves, draw_responses, write_curves
from radiometer.analysis.response.auto import recover_colours_auto
from radiometer.analysis.response.estimate import ResponseEstimate, median_uncertainty, telling
from radiometer.analysis.response.limits import black_of_darks, with_stated_black
from radiometer.analysis.response.methods import DEFAULT_METHOD, METHODS, RATIO_METHODS, compare_methods, method_names
from radiometer.api.files import PathLike, Stack, stack_of
from radiometer.api.result import Drawn, Progress
from radiometer.bench.sources import open_source
from radiometer.data import Bracket, CameraDescription, ResponseCurve
from radiometer.data.capture_set import refuse_inputs
from radiometer.data.drawing import check_plot_name, new_axes
from radiometer.data.iso_speeds import IsoSpeeds
from radiometer.data.storage import check_outputs
from radiometer.errors import MeasurementError, UsageError
from radiometer.photographs.response import ENOUGH_PIXELS
from radiometer.photographs.scene import Photographs, reject_inconsistent_photographs
from radiometer.photographs.stated import stated_camera, with_gains, with_iso_speeds
from radiometer.plausible import Iso, Positive
from radiometer.progress import counted, unseen

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["DEFAULT_METHOD", "METHODS", "Response", "ResponseEstimate", "median_uncertainty", "recover_response"]
_SUFFIXES: Final = (".csv", ".yaml", ".yml", *CURVE_SUFFIXES)


@dataclass(frozen=True, eq=False, repr=False)
class Response(Drawn):
    """How digital numbers follow from exposure: one curve, or one per colour and method.

    Examples:
        >>> import radiometer as rm
        >>> response = rm.recover_response(rm.read("out/chart"), "linear_spline")
        >>> response.log_exposure.shape, response.u.shape
        ((4096,), (4096,))
        >>> response.to_csv("curve.csv")
        >>> response.plot().get_xlabel()
        'digital number M (DN)'

    Attributes:
        estimates: The curves with all diagnostics.
        files: Files that they were written to.
        plot_file: File that they were drawn in; None where none was.
        notes: What a user should know, a sentence each.
    """

    estimates: tuple[ResponseEstimate, ...]
    files: tuple[Path, ...] = ()
    plot_file: Path | None = None
    notes: tuple[str, ...] = ()

    def __getitem__(self, channel: str) -> Response:
        """Return the curves of one channel. Raises KeyError for one that is not there."""
        found = tuple(one for one in self.estimates if one.curve.channel == channel)
        if not found:
            raise KeyError(channel)
        return replace(self, estimates=found)

    @property
    def estimate(self) -> ResponseEstimate:
        """Return the only curve with all diagnostics.

        Raises:
            UsageError: If there are several.
        """
        if len(self.estimates) != 1:
            there = ", ".join(f"{one.curve.channel} by {one.method}" for one in self.estimates)
            raise UsageError(f"there are {len(self.estimates)} curves ({there}); choose one channel and one method")
        return self.estimates[0]

    @property
    def curve(self) -> ResponseCurve:
        """Return the curve g(M) = ln H."""
        return self.estimate.curve

    @property
    def log_exposure(self) -> NDArray[np.float64]:
        """Return ln H per digital number, shape (2**bit_depth,)."""
        return self.curve.log_exposure

    @property
    def u(self) -> NDArray[np.float64]:
        """Return the standard uncertainty of ln H, same shape."""
        return self.curve.u_log_exposure

    def to_csv(self, path: PathLike) -> None:
        """Write `dn,log_exposure,u_log_exposure`. Raises UsageError for another ending, OutputError if it fails."""
        target = Path(path)
        if target.suffix.lower() != ".csv":
            raise UsageError(f"{path}: the name must end in .csv")
        self.curve.write(target)

    def to_mapping(self) -> dict[str, Any]:
        known = {"format": "radiometer-response-result/1", "curves": self.estimates, "plot": self.plot_file}
        return self.plain("files", "notes", **known, disagreements=compare_methods(self.estimates))

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw ln H over the digital number with its k = 2 band, where the data support it."""
        where = axes if axes is not None else new_axes()
        draw_curves(where, self.estimates)
        where.set_xlabel("digital number M (DN)")
        return where

    def __repr__(self) -> str:
        return f"<Response {'; '.join(map(_summary, self.estimates))}>"


def _summary(estimate: ResponseEstimate) -> str:
    curve = estimate.curve
    valid = curve.valid_dn or (0, curve.log_exposure.size - 1)
    return (
        f"by {estimate.method}: {curve.channel}, {curve.bit_depth} bits, DN {valid[0]} to {valid[1]}, "
        f"median u {100 * median_uncertainty(curve):.2g} %"
    )


def recover_response(
    sources: Stack | Bracket | PathLike | Sequence[Stack | Bracket | PathLike],
    method: str = DEFAULT_METHOD,
    *,
    channel: str = "luminance",
    known_ratio: Mapping[int, Positive] | None = None,
    measured_iso: Mapping[Iso, Iso] | None = None,
    align: str = "auto",
    output: PathLike | None = None,
    plot: PathLike | None = None,
    force: bool = True,
    progress: Progress | None = None,
) -> Response:
    """Recover a camera's response g(M) = ln H from brackets of one unmoving scene each, with its uncertainty.

    Examples:
        >>> import radiometer as rm
        >>> rm.recover_response(rm.read("out/chart"), "linear_spline")
        <Response by linear_spline: ..., 12 bits, DN ... to ..., median u ... %>

    Args:
        sources: Stacks, brackets, capture sets or folders of photographs; one or several of one camera, fitted jointly.
        method: "auto", "debevec1997", "mitsunaga1999", "robertson1999", "linear_spline", or "all".
        channel: Of folders of colour photographs: "luminance", "red", "green", "blue" or "each".
        known_ratio: Exposure of frame PAIR+1 over that of frame PAIR (0: the two shortest), for methods that find
            ratios themselves; fixes the exponent in place of the stated times.
        measured_iso: Of photographs: real ISO speed by stated one.
        align: Photographs from the hand: "auto" (where they moved), "on", or "off".
        output: Curve to write: .csv, .yaml, .m or .rsp.
        plot: Picture to draw: .png, .pdf or .svg; where the name is empty, as .png next to the output.
        force: Replace files that exist.
        progress: Called as the work goes on.

    Raises:
        CaptureError: If the frames are missing or inconsistent.
        MeasurementError: If the frames do not determine a curve.
        UsageError: If there is no such method, channel or form of file.
    """
    names, ratios = method_names(method), dict(known_ratio or {})
    if ratios and not set(names) & set(RATIO_METHODS):
        raise UsageError(
            f"--known-ratio is for methods that find the ratios themselves: --method {' or '.join(RATIO_METHODS)}"
        )
    plot = Path(output or "response").with_suffix(".png") if plot == "" else plot
    target, drawn = (Path(one) if one is not None else None for one in (output, plot))
    several = [sources] if isinstance(sources, Stack | Bracket | str | os.PathLike) else list(sources)
    inputs = [Path(one) for one in several if isinstance(one, str | os.PathLike)]
    _refuse_targets(target, drawn, names, inputs, force=force)
    notes: list[str] = []
    found: dict[str, list[Bracket]] = {}
    camera: CameraDescription | None = None
    for one in several:
        stated, brackets = _read(one, channel, dict(measured_iso or {}), align, progress, notes.append)
        camera = camera or stated
        require_same_camera(camera, stated, "first capture")
        for name, bracket in brackets:
            found.setdefault(name, []).append(bracket)
    joint: Sequence[ResponseEstimate | None] = [None] * len(found)
    if DEFAULT_METHOD in names and len(found) > 1:
        (progress or unseen)("recovering the response of all colours together", 0, None)
        joint = recover_colours_auto(list(found.values()))
    estimates = [
        with_iso_speeds(estimate, *found.values())
        for brackets, known in zip(found.values(), joint, strict=True)
        for estimate in _recovered(brackets, names, ratios, known, progress, notes.append)
    ]
    estimates = [replace(one, curve=replace(one.curve, camera=camera)) for one in estimates]
    files = _written(estimates, target) if target is not None else []
    if drawn is not None:
        draw_responses(estimates, drawn)
    return Response(tuple(estimates), tuple(files), drawn, tuple(notes))


def _refuse_targets(
    output: Path | None, plot: Path | None, methods: Sequence[str], inputs: Sequence[Path], *, force: bool
) -> None:
    """Refuse what cannot be written before the work is done, not after."""
    if output is not None and output.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"cannot write {output}: a curve's ending must be one of {', '.join(_SUFFIXES)}")
    if plot is not None:
        check_plot_name(plot)
    check_outputs(output, plot, force=force)
    written = [one for one in (output, plot) if one is not None]
    if output is not None:  # several curves carry channel and method in their files' names
        parts = ["", *(f"-{channel}" for channel in ("red", "green", "blue"))]
        names = [f"{part}{method}" for part in parts for method in ("", *(f"-{name}" for name in methods))]
        named = [output.with_stem(output.stem + name) for name in names if name]
        check_outputs(*named, force=force)
        written += named
    refuse_inputs(written, inputs)


def _read(
    source: Stack | Bracket | PathLike,
    channel: str,
    measured_iso: dict[float, float],
    align: str,
    progress: Progress | None,
    note: Callable[[str], None],
) -> tuple[CameraDescription, list[tuple[str, Bracket]]]:
    """Return the camera of a source, and its brackets with their colour channels; photographs in one place."""
    if isinstance(source, Bracket):
        camera, _ = stated_camera(source)
        taken, by_hand = Photographs({_channel(source): source}, Path(source.origin)), False
    else:
        stack = source if isinstance(source, Stack) else _opened(Path(source), channel, measured_iso, progress)
        taken, by_hand, camera = stack.as_photographs(), stack.photographs, stack.camera
        taken = taken.each(lambda one: with_stated_black(one, camera.black_level_dn))
    if by_hand:
        taken = taken.thinned().each(lambda one: with_gains(one, IsoSpeeds(measured_iso)))
    reject_inconsistent_photographs(taken)
    placed = taken.placed(align if by_hand else "off", progress or unseen)  # a camera on a bench stands still
    if placed.absent:
        note(f"{taken.folder}: {placed.alignment}")
    for one in placed.brackets.values():
        level = black_of_darks(one)
        if level is not None:
            note(f"{taken.folder}: the black level is that of {len(one.dark)} dark frames, {level:.1f} DN")
        elif one.dark:
            note(f"{taken.folder}: {len(one.dark)} dark frames are not used; the black level is stated")
    return camera, [(_channel(bracket), bracket) for bracket in placed.common.values()]


def _opened(path: Path, channel: str, measured_iso: dict[float, float], progress: Progress | None) -> Stack:
    report, speeds = counted(progress, f"reading {path.name}"), IsoSpeeds(measured_iso)
    return stack_of(open_source(path, channel, report=report, speeds=speeds, most_pixels=ENOUGH_PIXELS), str(path))


def _channel(bracket: Bracket) -> str:
    return str(bracket.light[0].extra.get("channel", "mono"))


def _recovered(
    brackets: Sequence[Bracket],
    names: Sequence[str],
    known_ratios: Mapping[int, float],
    with_other_colours: ResponseEstimate | None,
    progress: Progress | None,
    note: Callable[[str], None],
) -> Iterator[ResponseEstimate]:
    """Yield the estimate of every method; that of the default is given where it was made with other colours."""
    for done, name in enumerate(names):
        (progress or unseen)("recovering the response", done, len(names))
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


def _written(estimates: Sequence[ResponseEstimate], output: Path) -> list[Path]:
    """Write one curve under the given name, several with channel and method in theirs; return the files.

    A form of another program holds the channels of a method together.
    """
    together = output.suffix.lower() in CURVE_SUFFIXES
    several_channels = not together and len({one.curve.channel for one in estimates}) > 1
    several_methods = len({one.method for one in estimates}) > 1
    targets: dict[Path, dict[str, ResponseCurve]] = {}
    for one in estimates:
        parts = [output.stem, one.curve.channel if several_channels else "", one.method if several_methods else ""]
        target = output.with_name("-".join(filter(None, parts)) + output.suffix)
        targets.setdefault(target, {})[one.curve.channel] = one.curve
    for target, curves in targets.items():
        if together:
            write_curves(target, curves)
        else:
            next(iter(curves.values())).write(target)
    return list(targets)
