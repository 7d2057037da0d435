"""Colour of light from a camera with colour channels: its calibration, and readings of patches and pictures."""

from __future__ import annotations

import datetime as dt
import hashlib
import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from radiometer.analysis.calibration.shared import require_camera
from radiometer.analysis.colour.calibration import (
    ColourCalibration,
    ColourCamera,
    Training,
    reference,
    train_on_lights,
    train_on_responsivities,
)
from radiometer.analysis.colour.chart import KnownLight, read_chart, read_spectra
from radiometer.analysis.colour.chromaticity import QUANTITIES, Coordinates, coordinates, locus_points, tristimulus
from radiometer.analysis.exports.maps import MapPicture, writer_for
from radiometer.analysis.photometry.displays import GRID_NM, on_grid
from radiometer.analysis.photometry.photometry import luminous_efficacy, spectral_columns
from radiometer.analysis.reading.budget import carried, frame_conditions
from radiometer.analysis.regions import LOST, region_figures
from radiometer.api.files import PathLike, Stack, stack_of
from radiometer.api.meter import PatchLike, as_patch
from radiometer.api.radiance import ResponseLike, merge
from radiometer.api.result import Drawn, Notice, Progress, Result, unheard
from radiometer.bench.sources import is_photographs, open_source
from radiometer.data import Calibration, CaptureSet, FrameSettings, LensDescription, PixelMask, RadianceMap
from radiometer.data.calibration import DEFAULT_VALIDITY_DAYS
from radiometer.data.drawing import new_axes, picture
from radiometer.data.mosaic import COLOURS
from radiometer.data.provenance import is_out_of_date
from radiometer.data.reading import Flag, Patch, Quantity
from radiometer.data.setup import Setup
from radiometer.data.storage import check_outputs, write_text_atomic
from radiometer.errors import InputError, MeasurementError, UsageError
from radiometer.importing import open_capture
from radiometer.plausible import FNumber, RelativeUncertainty
from radiometer.progress import unseen
from radiometer.reporting.origin import Origin, moment
from radiometer.reporting.page import listed, page, section, table
from radiometer.typing import Array
from radiometer.units import plain_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNSTATED: Final = "light"  # kind of lights whose kind no chart and no option states
_FORMS: Final = (".exr", ".tif", ".tiff")  # of maps of several quantities
_SYMBOLS: Final = {"u_prime": "u′", "v_prime": "v′", "cct": "CCT", "duv": "Duv"}
_ELLIPSE_K: Final = 2.4477  # radius that holds 95 % of a normal distribution in two dimensions
_ROWS: Final = 64  # of a picture that are converted at a time
_NOISE_FLOOR_SIGMA: Final = 2.0  # as of a pixel: below, a patch need not differ from darkness


@dataclass(frozen=True, eq=False, repr=False)
class CalibratedColour(Result):
    """A colour calibration.

    Attributes:
        calibration: The calibration.
        out: File that it was written to; None where it was not.
    """

    calibration: ColourCalibration
    out: Path | None = None

    def to_mapping(self) -> dict[str, Any]:
        """Return the documented JSON form: that of the file."""
        return self.plain(**self.calibration.to_mapping(), file=self.out)

    def u_rel(self, kind: str | None) -> float:
        """Return the relative standard uncertainty of the luminance of white light from the matrix."""
        return float(np.sqrt(self.calibration.error(kind, np.ones(3))[1, 1]))

    def __str__(self) -> str:
        known = self.calibration
        lights = 0 if known.training is None else len(known.training.names)
        parts = ", ".join(f"{kind} {100 * self.u_rel(kind):.2g} %" for kind in known.errors)
        return f"{'/'.join(known.channels)} from {lights} lights; u of luminance: {parts}"


@dataclass(frozen=True, eq=False, repr=False)
class ColourReading(Drawn):
    """The colour of a patch; all uncertainties are standard ones (k = 1).

    Attributes:
        source: Where the frames came from.
        patch: Where it was read.
        kind: Kind of light; None where it is not known.
        signals: The raw reading of each channel.
        quantities: X, Y, Z, x, y, u_prime, v_prime, cct, duv; None where the light has no colour temperature.
        coordinates: Chromaticities with their covariances.
        flags: What a user must know.
        assumptions: What was assumed, a sentence each.
        calibration: The calibration in use.
        maps: Quantities of every pixel, where they were asked for.
        origin: When and with what the frames were taken, in words by name.
    """

    source: str
    patch: Patch
    kind: str | None
    signals: Mapping[str, Quantity]
    quantities: Mapping[str, Quantity | None]
    coordinates: Coordinates
    flags: tuple[str, ...]
    assumptions: tuple[str, ...]
    calibration: ColourCalibration
    maps: MapPicture | None = None
    origin: Mapping[str, str] = field(default_factory=dict)
    _inches = (6.4, 6.8)

    def __getitem__(self, name: str) -> Quantity | None:
        """Return a quantity by name, such as "Y". Raises KeyError."""
        return self.quantities[name]

    def to_mapping(self) -> dict[str, Any]:
        return self.plain(
            "source", "kind", "signals", "flags", "assumptions", **self.quantities, patch=astuple(self.patch),
            covariance_xy=self.coordinates.xy_covariance, coverage_factor=2,
            calibrated=self.calibration.created.isoformat(),
        )  # fmt: skip

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the chromaticity diagram: spectral and Planckian locus, training set, the reading with its ellipse."""
        from matplotlib.patches import Ellipse, Polygon

        where = axes if axes is not None else new_axes()
        spectral, planckian = locus_points()
        where.add_patch(Polygon(spectral, fill=False, color="black", linewidth=0.8))
        where.plot(*planckian.T, color="tab:orange", linewidth=0.8, label="Planckian locus")
        hull = self.calibration.fit(self.kind).hull
        where.add_patch(Polygon(hull, fill=False, color="tab:blue", linestyle=":", label="training set"))
        size, turned = np.linalg.eigh(self.coordinates.xy_covariance)
        width, height = 2.0 * _ELLIPSE_K * np.sqrt(np.maximum(size, 0.0))
        angle = float(np.degrees(np.arctan2(turned[1, 0], turned[0, 0])))
        x, y = self.coordinates.xy
        where.plot(x, y, "+", color="tab:red")
        where.add_patch(Ellipse((x, y), width, height, angle=angle, fill=False, color="tab:red", label="95 %"))
        where.set(aspect="equal", xlim=(-0.02, 0.78), ylim=(-0.02, 0.88), xlabel="x", ylabel="y")
        where.legend(loc="upper right", fontsize="small")
        return where

    def rows(self) -> list[tuple[str, str]]:
        """Return the symbol of every quantity, and its value with U (k = 2)."""
        return [(_SYMBOLS.get(name, name), _shown(one)) for name, one in self.quantities.items()]

    def write_report(self, path: PathLike) -> None:
        """Write a self-contained page. Raises OutputError if it cannot be written."""
        raw = [(name, one.text(bare=True)) for name, one in self.signals.items()]
        parts = [
            picture(self.plot, f"{self.source}: CIE 1931 chromaticity, ellipse at 95 %"),
            section("Colour, k = 2", table(("quantity", "value"), self.rows())),
            section("Raw readings, k = 2", table(("channel", "signal, relative"), raw)),
            section("Flags and assumptions", listed([*self.flags, *self.assumptions])),
        ]
        known = {**self.origin, "calibration": f"of colours, {moment(self.calibration.created.isoformat())}"}
        origin = Origin.of_map(known, further=(("source", self.source),))
        write_text_atomic(Path(path), page(f"colour of {self.source}", str(self), parts, kind="colour", origin=origin))

    def __str__(self) -> str:
        names = ("Y", "x", "y", "cct", "duv")
        shown = (f"{_SYMBOLS.get(name, name)} {_shown(self.quantities[name])}" for name in names)
        return f"{', '.join(shown)} (k = 2)"


def _shown(quantity: Quantity | None) -> str:
    return "none" if quantity is None else quantity.text()


def colour_calibrate(
    source: PathLike | None = None,
    chart: PathLike | None = None,
    *,
    spectra: PathLike | None = None,
    responsivities: PathLike | None = None,
    train_on: Literal["chart", "responsivities"] = "chart",
    kind: str | None = None,
    per_kind: bool = False,
    white: str | None = None,
    u_rel: RelativeUncertainty = 0.0,
    filters: Mapping[str, PathLike] | None = None,
    linear: bool = False,
    f_number: FNumber | None = None,
    response: ResponseLike | None = None,
    out: PathLike | None = None,
    notice: Notice = unheard,
    progress: Progress = unseen,
) -> CalibratedColour:
    """Find the matrix from a camera's channels to X, Y, Z, and its error for other lights.

    Examples:
        >>> import radiometer as rm
        >>> rm.colour_calibrate("colours", "colours.csv", kind="leds")
        <CalibratedColour red/green/blue from ... lights; u of luminance: ...>

    Args:
        source: Capture set of a colour camera, or folder of photographs, that shows the lights; none with filters.
        chart: Table of the lights: name, X, Y, Z in cd·m⁻², and as needed u_rel, kind, left, top, width, height (in
            pixels of a colour's plane) and capture (a folder for each light). Places may be those of `capture.yaml`.
        spectra: Table of wavelength_nm and the spectral radiance of each light in W·sr⁻¹·m⁻²·nm⁻¹, instead of X, Y, Z.
        responsivities: Table of wavelength_nm and the responsivity of each channel per watt, up to a common factor.
        train_on: "chart" fits the matrix to the known lights, "responsivities" to plausible lights; the known ones
            then give the scale alone.
        kind: Kind of the lights whose kind the chart does not state.
        per_kind: Find a matrix for each kind of light, such as a type of display.
        white: Name of a known light whose X, Y, Z the matrix gives exactly; greys of its spectrum then have its colour.
        u_rel: Relative standard uncertainty that all known X, Y, Z share.
        filters: Of a monochrome camera with filters: capture set by channel, instead of a source.
        linear: Photographs that are no raw files are proportional to light above black.
        f_number: f-number of frames that state none.
        response: Response of photographs.
        out: File to write.
        notice: Gets what a user should know, a line each.
        progress: Called as the work goes on.

    Raises:
        UsageError: If arguments exclude each other or are missing.
        InputError: If a table cannot be used, or a light has no place.
        CalibrationError: If the lights do not determine the matrix.
        MeasurementError: If a light has too few pixels with a value.
    """
    if out is not None:
        check_outputs(Path(out), force=True)
    frames = _Frames(filters, linear, f_number, response, notice, progress)
    with_lights = chart is not None or spectra is not None
    if white is not None and train_on != "chart":
        raise UsageError("--white has no effect with --train-on responsivities; leave one out")
    if train_on == "responsivities" and responsivities is None:
        raise UsageError("--train-on responsivities needs --responsivities FILE")
    if train_on == "chart" and not with_lights:
        raise UsageError("give --chart FILE or --spectra FILE, or --responsivities FILE with --train-on responsivities")
    training, powers, known = None, None, ColourCamera(tuple(filters) if filters else COLOURS)
    if with_lights:
        training, powers, known = _lights(source, chart, spectra, kind, frames)
    if responsivities is not None:
        known = replace(known, responsivities=_responsivities(Path(responsivities), known.channels))
    hashes = {one: hashlib.sha256(Path(one).read_bytes()) for one in (chart, spectra, responsivities) if one}
    inputs = tuple(f"{Path(one).name} sha256:{digest.hexdigest()[:16]}" for one, digest in hashes.items())
    known = replace(known, inputs=inputs)
    if train_on == "responsivities":
        found = train_on_responsivities(known, training, per_kind=per_kind, u_rel=u_rel)
    else:
        assert training is not None  # with_lights
        found = train_on_lights(known, training, powers=powers, per_kind=per_kind, u_rel=u_rel, white=white)
    if out is not None:
        found.write(Path(out))
    return CalibratedColour(found, None if out is None else Path(out))


def colour_measure(
    source: PathLike | None = None,
    *,
    calibration: ColourCalibration | PathLike,
    patch: PatchLike | None = None,
    kind: str | None = None,
    filters: Mapping[str, PathLike] | None = None,
    linear: bool = False,
    f_number: FNumber | None = None,
    response: ResponseLike | None = None,
    maps: PathLike | None = None,
    report: PathLike | None = None,
    notice: Notice = unheard,
    progress: Progress = unseen,
) -> ColourReading:
    """Measure X, Y, Z, x, y, u′, v′, CCT and Duv of a patch, each with its uncertainty.

    Examples:
        >>> import radiometer as rm
        >>> made = rm.colour_calibrate("colours", "colours.csv", kind="leds")
        >>> found = rm.colour_measure("colours", calibration=made.calibration, patch=(2, 2, 4, 4), kind="leds")
        >>> found, found["Y"].unit
        (<ColourReading Y ... (k = 2)>, 'cd m-2')

    Args:
        source: Capture set of a colour camera, or folder of photographs; none with filters.
        calibration: Colour calibration, or its file.
        patch: (x, y, width, height) in pixels of a colour's plane; the whole picture by default.
        kind: Kind of light, one that the calibration knows; by default the error is the mean over those.
        response: Response of photographs, the same as for the calibration.
        maps: File for the quantities of every pixel, .exr or .tiff.
        report: Page to write, .html.

    Raises:
        UsageError: If arguments exclude each other, or the kind of light is not known.
        CalibrationError: If the calibration is of another camera, f-number or filter.
        MeasurementError: If the patch has too few pixels with a value, or no light.
        RadiometerError: As `colour_calibrate`, which has the other arguments.
    """
    check_outputs(*(Path(one) for one in (maps, report) if one is not None), force=True)
    if maps is not None and Path(maps).suffix.lower() not in _FORMS:
        raise UsageError(f"{maps}: quantities of every pixel are written as {', '.join(_FORMS)}")
    known = calibration if isinstance(calibration, ColourCalibration) else ColourCalibration.read(Path(calibration))
    known.fit(kind)
    seen = _Frames(filters, linear, f_number, response, notice, progress).channels(source)
    if tuple(seen.maps) != known.channels:
        raise UsageError(f"{seen.origin}: has the channels {', '.join(seen.maps)}, the calibration "
                         f"{', '.join(known.channels)}")  # fmt: skip
    seen, u_rel = seen.carried(known.reference)
    known = known.model_copy(update={"u_rel": math.hypot(known.u_rel, u_rel)})
    where = as_patch(patch) or Patch(0, 0, *next(iter(seen.maps.values())).shape[::-1])
    signal, own, flags = seen.signal(where, str(seen.origin))
    readings = seen.covariance(signal, own)
    xyz, covariance = known.convert(signal, readings, kind)
    if not (xyz.sum() > 0.0 and (signal > _NOISE_FLOOR_SIGMA * own).any()):
        raise MeasurementError(f"{seen.origin}: no channel is above the noise: the patch shows no light")
    found = coordinates(xyz, covariance)
    values, u = (one.tolist() for one in found.figures(xyz, covariance))
    raw = zip(seen.maps, signal.tolist(), np.sqrt(np.diag(readings)).tolist(), strict=True)
    reading = ColourReading(
        seen.origin, where, kind,
        {name: Quantity(value, u_of, "relative") for name, value, u_of in raw},
        {
            name: Quantity(values[n], u[n], unit) if np.isfinite(values[n]) else None
            for n, (name, unit) in enumerate(_units(known.unit).items())
        },
        found, (*flags, *_flags(known, found, kind, seen.setup.taken)),
        (*known.provenance.assumptions, *seen.assumptions), known,
        _converted(seen, known, kind) if maps is not None else None,
        next(iter(seen.maps.values())).provenance.parameters.get("origin", {}),
    )  # fmt: skip
    if maps is not None and reading.maps is not None:
        writer_for(Path(maps))(Path(maps), reading.maps)
    if report is not None:
        reading.write_report(report)
    return reading


@dataclass(frozen=True, slots=True, eq=False)
class _Channels:
    """Maps of the channels of one camera; `together` where their frames are the same, so that they share errors."""

    origin: str
    maps: Mapping[str, RadianceMap]
    # By channel, how its light frames were taken, and their settings as they were merged
    taken: Mapping[str, tuple[Setup, tuple[FrameSettings, ...]]]
    patches: Mapping[str, Patch]
    together: bool
    assumed: tuple[str, ...] = ()  # of settings that calibration or frames do not state

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Return what was assumed of the frames."""
        of_maps = (text for one in self.maps.values() for text in one.provenance.assumptions)
        return tuple(dict.fromkeys((*self.assumed, *of_maps)))

    @property
    def setup(self) -> Setup:
        """Return how the frames of the first channel were taken."""
        return next(iter(self.taken.values()))[0]

    @property
    def camera(self) -> ColourCamera:
        """Return the camera as the frames of its first channel were taken."""
        setup, settings = next(iter(self.taken.values()))
        iso = min((one.iso for one in settings if one.iso is not None), default=None)
        return ColourCamera(tuple(self.maps), setup.camera, setup.lens, frame_conditions(settings), iso)

    def carried(self, to: Calibration) -> tuple[_Channels, float]:
        """Return the channels as if taken as a calibration's frames were, and the relative u that all of them share.

        What one channel differs by more than the others, such as a filter before it alone, is in its own u.
        """
        found = {
            name: carried(replace(setup, calibration=to), settings) for name, (setup, settings) in self.taken.items()
        }
        shared, maps = min(u_rel for _, u_rel in found.values()), {}
        for name, (factor, u_rel) in found.items():
            common = math.hypot(self.maps[name].u_rel_common, math.sqrt(u_rel**2 - shared**2))
            maps[name] = replace(self.maps[name].scaled(factor, self.maps[name].unit), u_rel_common=common)
        assumed = (text for setup, _ in self.taken.values() for text in require_camera(to, setup.camera))
        return replace(self, maps=maps, assumed=tuple(dict.fromkeys(assumed))), shared

    def signal(self, patch: Patch, name: str) -> tuple[Array, Array, tuple[str, ...]]:
        """Return the mean of each channel over a patch, its u without what all pixels share, and flags."""
        figures = [region_figures(one, name, patch) for one in self.maps.values()]
        flags = tuple(dict.fromkeys(flag.partition(":")[0].replace(" ", "_") for one in figures for flag in one.flags))
        signal, u = (np.array([getattr(one.mean, name) for one in figures]) for name in ("value", "u"))
        return signal, np.sqrt(np.maximum(u**2 - (self.common * signal) ** 2, 0.0)), flags

    @property
    def common(self) -> Array:
        """Return the relative standard uncertainty that all pixels of each channel share."""
        return np.array([one.u_rel_common for one in self.maps.values()])

    def covariance(self, signal: Array, own: Array) -> Array:
        """Return the covariance of readings, shape (…, channels, channels), whose own u all pixels do not share.

        Channels of the same frames share the errors of time and linearity.
        """
        shared, each = self.common * signal, np.eye(signal.shape[-1])
        pairs = shared[..., :, None] * shared[..., None, :]
        return np.asarray((pairs if self.together else pairs * each) + own[..., None] ** 2 * each)


@dataclass(frozen=True, slots=True)
class _Frames:
    """How frames become maps of channels."""

    filters: Mapping[str, PathLike] | None
    linear: bool
    f_number: float | None
    response: ResponseLike | None
    notice: Notice
    progress: Progress

    def channels(self, source: PathLike | None) -> _Channels:
        """Return the maps of a source, or of the filters' sets. Raises UsageError for both, none, or no colours."""
        if (source is None) == (self.filters is None):
            raise UsageError("give a capture set or photographs, or --filter NAME=FOLDER for each filter")
        if self.filters is not None:
            return self._behind_filters(self.filters)
        path = Path(str(source))
        if is_photographs(path):
            return self._of_photographs(path)
        capture = open_capture(path)
        if capture.header.camera.mosaic is None:
            raise UsageError(
                f"{path}: states no camera.mosaic: its frames have one channel; of a monochrome camera give "
                "--filter NAME=FOLDER for each filter"
            )
        return self._of_capture(capture, self._merged(path, channel="each"))

    def _merged(self, source: Stack | Path, **how: Any) -> Mapping[str, RadianceMap]:
        """Return the map of each channel; a user hears what is doubted of the frames."""
        found = merge(source, progress=self.progress, f_number=self.f_number, **how)
        for line in found.notes:
            self.notice(line)
        return found.maps

    def _behind_filters(self, filters: Mapping[str, PathLike]) -> _Channels:
        seen = dict[str, _Channels]()
        for name, folder in filters.items():
            capture = open_capture(Path(folder))
            if capture.header.camera.mosaic is not None:
                raise UsageError(f"--filter {name}={filters[name]}: the camera has colour filters; give its set alone")
            seen[name] = self._of_capture(capture, {name: self._merged(Path(folder))["mono"]})
        maps = {name: one.maps[name] for name, one in seen.items()}
        if len({one.shape for one in maps.values()}) > 1:
            raise InputError("--filter: the frames behind the filters differ in size; capture the same region")
        # All filters are those of one camera, in the order of its channels.
        stated = [one.setup.camera.filter for one in seen.values()]
        behind = {"filter": ", ".join(one or "unstated" for one in stated) if any(stated) else None}
        taken = {
            name: (replace(setup, camera=setup.camera.model_copy(update=behind)), settings)
            for name, one in seen.items()
            for setup, settings in one.taken.values()
        }
        everywhere = set.intersection(*(set(one.patches.items()) for one in seen.values()))
        return _Channels(", ".join(map(str, filters.values())), maps, taken, dict(everywhere), together=False)

    def _of_capture(self, capture: CaptureSet, maps: Mapping[str, RadianceMap]) -> _Channels:
        header = capture.header
        settings = tuple(header.frames[at].settings for at in capture.lit_indices()[1])
        number = settings[0].f_number or header.lens.f_number or self.f_number
        setup = Setup(header.camera, header.lens.model_copy(update={"f_number": number}), taken=header.taken)
        places = {one.name: one.patch for one in header.patches}
        return _Channels(str(capture.path), maps, dict.fromkeys(maps, (setup, settings)), places, together=True)

    def _of_photographs(self, path: Path) -> _Channels:
        stack = stack_of(open_source(path, "each"), str(path))
        if len(stack.brackets) < len(COLOURS):
            raise UsageError(f"{path}: its photographs are grey: they have one channel")
        if not (self.linear or self.response is not None or stack.as_photographs().are_raw):
            raise UsageError(
                f"{path}: values of developed photographs follow an unknown curve; take raw files, or give --response "
                "FILE or --linear"
            )
        found = self._merged(stack, response=self.response, linear=self.linear)
        settings = tuple(one.settings for one in next(iter(stack)).light)
        lens = LensDescription(f_number=settings[0].f_number or self.f_number)
        setup = Setup(stack.camera, lens, taken=stack.taken)
        maps = {name: found[name] for name in COLOURS}
        return _Channels(str(path), maps, dict.fromkeys(maps, (setup, settings)), {}, together=True)


def _lights(
    source: PathLike | None, chart: PathLike | None, spectra: PathLike | None, kind: str | None, frames: _Frames
) -> tuple[Training, Array | None, ColourCamera]:
    """Return the raw readings of known lights, their spectra where known, and the camera."""
    powers = None if spectra is None else read_spectra(Path(spectra))
    seen = dict[str, tuple[_Channels, float]]()

    def channels(of: PathLike | None) -> tuple[_Channels, float]:
        if str(of) not in seen:
            found, first = frames.channels(of), next(iter(seen.values()), None)
            like = found if first is None else first[0]
            when = like.setup.taken or dt.datetime.now(dt.UTC)
            alike, u_rel = found.carried(reference(like.camera, when.isoformat()))
            seen[str(of)] = alike, 0.0 if first is None else u_rel
        return seen[str(of)]

    lights = [] if chart is None else read_chart(Path(chart))
    if chart is None:
        lights = [KnownLight(name, "", None, 0.0, place, None) for name, place in channels(source)[0].patches.items()]
        if not lights:
            raise UsageError(f"{source}: its header names no patches: give --chart FILE with the places of the lights")
    rows, curves = list[tuple[Any, ...]](), list[Array]()
    for light in lights:
        here, carried_u_rel = channels(light.capture or source)
        place = light.patch or here.patches.get(light.name)
        if place is None and light.capture is not None:
            place = Patch(0, 0, *next(iter(here.maps.values())).shape[::-1])
        if place is None:
            raise InputError(f"{chart}: light {light.name!r} has no place: add left, top, width, height")
        signal, u_signal, flags = here.signal(place, light.name)
        if "saturated" in flags:
            raise MeasurementError(f"light {light.name!r}: saturated pixels; capture shorter exposures")
        xyz, u_rel = light.xyz, light.u_rel
        if powers is not None:
            if (spectrum := powers.get(plain_name(light.name))) is None:
                raise InputError(f"{spectra}: has no column {light.name!r}; it has {', '.join(powers)}")
            curves.append(on_grid(spectrum))
            if xyz is None:
                xyz, u_rel = tristimulus(spectrum), math.hypot(u_rel, luminous_efficacy(spectrum).u_rel)
        if xyz is None:
            raise InputError(f"{chart}: has no columns X, Y, Z: add them, or give --spectra FILE")
        u_signal = np.hypot(u_signal, carried_u_rel * signal)
        rows.append((light.name, light.kind or kind or _UNSTATED, signal, u_signal, xyz, u_rel))
    names, kinds, *numbers = zip(*rows, strict=True)
    training = Training(names, kinds, *(np.array(one) for one in numbers))
    return training, np.array(curves) if curves else None, next(iter(seen.values()))[0].camera


def _responsivities(path: Path, channels: tuple[str, ...]) -> Array:
    wavelength_nm, columns = spectral_columns(path, {name: (name, name[0]) for name in channels})
    if wavelength_nm[0] > 420.0 or wavelength_nm[-1] < 680.0:
        raise InputError(f"{path}: the responsivities must reach from 420 to 680 nm at least")
    return np.stack([np.interp(GRID_NM, wavelength_nm, columns[name], left=0.0, right=0.0) for name in channels])


def _flags(known: ColourCalibration, found: Coordinates, kind: str | None, taken: dt.datetime | None) -> list[str]:
    flags = []
    if bool(known.is_outside(found.xy, found.xy_covariance, kind)):
        flags.append("extrapolated")
    if kind is None:
        flags.append("kind_unstated")
    elif kind not in known.trained:
        flags.append("other_light")
    if is_out_of_date(known.created.isoformat(), DEFAULT_VALIDITY_DAYS, taken or dt.datetime.now(dt.UTC)):
        flags.append(Flag.STALE_CALIBRATION.value)
    return flags


def _units(unit: str) -> dict[str, str]:
    """Return the unit of each quantity, X, Y, Z in the one given."""
    return {name: unit if name in "XYZ" else "K" if name == "cct" else "1" for name in QUANTITIES}


def _converted(seen: _Channels, known: ColourCalibration, kind: str | None) -> MapPicture:
    """Return the quantities of every pixel; u holds all that the patch's does."""
    signal = np.stack([one.radiance for one in seen.maps.values()], axis=-1).astype(np.float64)
    own = np.stack([one.u_radiance for one in seen.maps.values()], axis=-1).astype(np.float64)
    mask = np.bitwise_or.reduce([one.mask for one in seen.maps.values()])
    values, u = (np.empty((len(QUANTITIES), *mask.shape), np.float32) for _ in range(2))
    for start in range(0, len(signal), _ROWS):
        rows = slice(start, start + _ROWS)
        xyz, covariance = known.convert(signal[rows], seen.covariance(signal[rows], own[rows]), kind)
        lit = (xyz.sum(axis=-1) > 0.0) & ((mask[rows] & (LOST | PixelMask.BELOW_NOISE)) == 0)
        found = coordinates(np.where(lit[..., None], xyz, 1.0), covariance)
        mask[rows][lit & known.is_outside(found.xy, found.xy_covariance, kind)] |= np.uint8(PixelMask.EXTRAPOLATED)
        for whole, part in zip((values, u), found.figures(xyz, covariance), strict=True):
            whole[:, rows] = np.moveaxis(part, -1, 0)
            whole[3:, rows][:, ~lit] = np.nan  # a chromaticity of no light
    return MapPicture(
        {name: RadianceMap(values[n], u[n], mask, unit) for n, (name, unit) in enumerate(_units(known.unit).items())}
    )
