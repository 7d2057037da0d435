"""Makes a calibration: the scale from a source of known radiance, or from a light meter's constant."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from radiometer.analysis.calibration.shared import settle
from radiometer.analysis.photometry.photometry import Spectrum, luminous_efficacy_lm_per_w, spectrum
from radiometer.analysis.reading.budget import budget_terms
from radiometer.analysis.reading.reading import patch_situation, read_patch
from radiometer.analysis.response.curves import black_of_curve
from radiometer.analysis.signal.lens import lens_factor_sr
from radiometer.analysis.signal.model import signal_model
from radiometer.data import (
    BlackLevel,
    Bracket,
    Calibration,
    CameraDescription,
    Flag,
    FrameSettings,
    LensDescription,
    Patch,
    Provenance,
    Quantity,
    ResponseCurve,
    Scale,
    SensorNoise,
)
from radiometer.data.calibration import DEFAULT_VALIDITY_DAYS
from radiometer.data.reading import RADIANCE_UNIT
from radiometer.data.setup import Setup
from radiometer.data.validation import validate
from radiometer.errors import CalibrationError, InputError, MeasurementError, UsageError
from radiometer.moments import moment_of
from radiometer.numbers import unit_text
from radiometer.plausible import PLAUSIBLE
from radiometer.units import exact_exposure_s, exact_f_number

# ISO 2720 allows K from 10.6 to 13.4 cd·m⁻²·s: ±11.7 %, taken as a rectangle, where the camera's K was not determined.
K_UNKNOWN_U_REL: Final = (13.4 - 10.6) / (13.4 + 10.6) / math.sqrt(3.0)
# A meter that shows thirds of a stop is right to ±1/6 stop: a rectangle of half-width ln(2)/6 in ln L_v.
METER_U_REL: Final = math.log(2.0) / 6.0 / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class MeterSettings:
    """What a camera showed when its light meter called a scene well exposed."""

    exposure_s: float  # exposure time in s
    f_number: float  # f-number
    iso: float  # ISO speed as really measured, not as printed on the dial

    def exact(self) -> MeterSettings:
        """Return the exact stops behind printed ones (1/60 s is 2⁻⁶ s, f/5.6 is 2^(5/2))."""
        return MeterSettings(exact_exposure_s(self.exposure_s), exact_f_number(self.f_number), self.iso)


def metered_luminance_cd_m2(meter_k: float, settings: MeterSettings) -> float:
    """Return the luminance in cd·m⁻² that a meter saw: L_v = N²·K/(t·S).

    Source: ISO 2720:1974; thesis equation (2.6).
    """
    return settings.f_number**2 * meter_k / (settings.exposure_s * settings.iso)


def metered_u_rel(k_u_rel: float | None) -> float:
    """Return the relative standard uncertainty of a metered luminance: the meter's resolution and its constant.

    Args:
        k_u_rel: Of K; None takes what ISO 2720 leaves open.
    """
    return math.hypot(METER_U_REL, K_UNKNOWN_U_REL if k_u_rel is None else k_u_rel)


def reference_exposure_j_m2(
    radiance_w_sr_m2: float, settings: MeterSettings, lens_factor_sr: float | None = None
) -> float:
    """Return the exposure of the reference pixel value in J·m⁻²: H = L·(π/4)/N²·t.

    Args:
        radiance_w_sr_m2: Radiance of the metered surface in W·sr⁻¹·m⁻².
        settings: Exposure time and f-number of the reference photograph.
        lens_factor_sr: Irradiance per radiance in sr where more than the f-number is known.

    Source: thesis equations (2.11) and (2.12).
    """
    factor = math.pi / (4.0 * settings.f_number**2) if lens_factor_sr is None else lens_factor_sr
    return radiance_w_sr_m2 * factor * settings.exposure_s


def scale_from_meter(
    meter_k: float,
    settings: MeterSettings,
    reference_signal: float,
    spectrum: Spectrum,
    lens_factor_sr: float,
    *,
    k_u_rel: float | None = None,
    signal_u_rel: float = 0.0,
) -> Scale:
    """Return the scale that a light meter's constant gives: the curve shifted so that f(M_ref) = H_ref.

    Args:
        meter_k: K in cd·m⁻²·s.
        settings: Exact settings of the reference photograph.
        reference_signal: Linear signal x of the reference pixel value, above 0.
        spectrum: Spectrum of the metered surface.
        lens_factor_sr: Irradiance on the sensor per radiance in sr.
        k_u_rel: Relative standard uncertainty of K beyond the resolution of the meter; None takes what ISO 2720 leaves
            open.
        signal_u_rel: Relative standard uncertainty of the curve at the reference pixel value.

    Raises:
        InputError: If K, the settings or the reference signal are not above 0.
    """
    _refuse_not_positive(
        ("meter constant K", meter_k, "cd m-2 s"),
        ("exposure time", settings.exposure_s, "s"),
        ("f-number", settings.f_number, ""),
        ("ISO speed", settings.iso, ""),
        ("signal of the reference pixel value", reference_signal, "above black"),
    )
    luminance = metered_luminance_cd_m2(meter_k, settings)
    radiance = luminance / luminous_efficacy_lm_per_w(spectrum)
    exposure = reference_exposure_j_m2(radiance, settings, lens_factor_sr)
    u_of_k = K_UNKNOWN_U_REL if k_u_rel is None else k_u_rel
    budget = {"meter's resolution": METER_U_REL, "constant K": u_of_k, "response curve": signal_u_rel}
    return _scale(
        value=exposure / reference_signal,
        u_rel=math.hypot(*budget.values()),
        budget=budget,
        method="light_meter_k",
        quantity="luminance",
        f_number=settings.f_number,
        reference=f"K = {meter_k:g}, f/{settings.f_number:.4g}, {settings.exposure_s:.6g} s, ISO {settings.iso:g}: "
        f"{luminance:.6g} cd·m⁻²",
    )


def scale_from_radiance(
    radiance_w_sr_m2: float,
    u_rel: float,
    relative_rate: float,
    rate_u_rel: float,
    f_number: float | None,
    degrees_of_freedom: float | None = None,
    reading_budget: Mapping[str, float] | None = None,
) -> Scale:
    """Return the scale that a source of known radiance gives.

    Args:
        radiance_w_sr_m2: Known radiance in W·sr⁻¹·m⁻², above 0.
        u_rel: Its relative standard uncertainty.
        relative_rate: What the camera reads there at scale 1: linear signal per s and sr of the lens.
        rate_u_rel: Relative standard uncertainty of that reading.
        f_number: f-number it was read at; None where unknown.
        degrees_of_freedom: Of the combined uncertainty; None for infinitely many.
        reading_budget: What `rate_u_rel` is made up from, by name; for the record.

    Raises:
        InputError: If radiance or reading are not above 0.
    """
    PLAUSIBLE["radiance"].check("known radiance", radiance_w_sr_m2)
    _refuse_not_positive(("reading of the known source", relative_rate, ""))
    return _scale(
        value=radiance_w_sr_m2 / relative_rate,
        u_rel=math.hypot(u_rel, rate_u_rel),
        budget={"reference source": u_rel, **(reading_budget or {"reading": rate_u_rel})},
        method="known_radiance",
        degrees_of_freedom=degrees_of_freedom,
        f_number=f_number,
        reference=f"{radiance_w_sr_m2:g} {unit_text(RADIANCE_UNIT)} known to {100 * u_rel:.3g} % (k = 1)",
    )


def _scale(**facts: Any) -> Scale:
    """Return the scale of facts. Raises CalibrationError if one is outside its plausible range."""
    return validate(Scale, facts, "the scale", CalibrationError)


def _refuse_not_positive(*quantities: tuple[str, float, str]) -> None:
    for name, value, unit in quantities:
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value:g} {unit}".rstrip() + "; it must be above 0")


@dataclass(frozen=True, slots=True)
class KnownSource:
    """A source of known radiance: radiance in W·sr⁻¹·m⁻², its relative standard uncertainty, and what was stated."""

    radiance_w_sr_m2: float
    u_rel: float
    quantity: Literal["radiance", "luminance"] = "radiance"


@dataclass(frozen=True, slots=True)
class MeterReading:
    """A reference photograph by a light meter."""

    meter_k: float  # K in cd·m⁻²·s
    settings: MeterSettings  # exact settings of the photograph
    reference_dn: float  # digital number that the metered surface came out at
    # Relative standard uncertainty of K beyond the meter's ±1/6 stop; None where it was not determined
    k_u_rel: float | None = None


def unscaled_calibration(
    camera: CameraDescription,
    lens: LensDescription,
    response: ResponseCurve | None,
    spectrum_name: str,
    black_dn: float | None = None,
    validity_days: float = DEFAULT_VALIDITY_DAYS,
) -> Calibration:
    """Return a calibration that still lacks its scale (it is 1).

    Args:
        response: Response curve; None takes the sensor as linear above black.
        spectrum_name: Spectrum that the scale will hold for.
        black_dn: Black level in DN; None takes the camera description's, or what the response was recovered with.
        validity_days: Days until readings are flagged `stale_calibration`.

    Raises:
        CalibrationError: If curve and camera differ in bit depth.
        InputError: If there is no such spectrum.
    """
    spectrum(spectrum_name)
    black = camera.black_level_dn if black_dn is None else black_dn
    if black is None and response is not None:
        black = black_of_curve(response)
    return Calibration(
        camera=camera,
        lens=lens,
        scale=Scale(value=1.0, u_rel=0.0, method="known_radiance", f_number=lens.f_number),
        response=response,
        noise=SensorNoise.of(camera),
        black_level=BlackLevel(dn=black or 0.0),
        spectrum=spectrum_name,
        validity_days=validity_days,
    )


def scale_by_source(
    base: Calibration,
    frames: Bracket,
    patch: Patch,
    source: KnownSource,
) -> Scale:
    """Return the scale from frames of a source of known radiance.

    Args:
        frames: Bracket of the source; its dark frames give the dark level.

    Raises:
        MeasurementError: If the patch is clipped, below the noise or not uniform.
    """
    made = moment_of(base.created)  # a scale has no age when it is made
    situation = patch_situation(frames, patch, Setup(base.camera, base.lens, base), now=made)
    channel = frames.light[0].extra.get("channel")
    conditions = situation.conditions.model_copy(update={"channel": None if channel is None else str(channel)})
    own = replace(base, scale=base.scale.model_copy(update={"conditions": conditions}))
    reading = read_patch(frames, patch, Setup(base.camera, base.lens, own), now=made)
    where = f"the patch {patch} cannot carry a scale"
    for flag in (Flag.SATURATED, Flag.BELOW_NOISE, Flag.NONUNIFORM):
        if flag in reading.flags:
            raise MeasurementError(f"{where}: it is {flag}; choose an even, well exposed part of the known source")
    if Flag.DARK_ASSUMED in reading.flags and reading.radiance.value < 2.0 * reading.radiance.u:
        raise MeasurementError(
            f"{where}: nothing states the dark current, which may be all of its signal: take dark frames of the same "
            "exposures"
        )
    value = reading.radiance
    # At the calibration's own level the response's error drops out; readings at other levels meet it.
    curve = next(term.u for term in budget_terms(situation) if term.name == "response curve") / abs(situation.value)
    lines = {line.name: line.u_rel for line in reading.budget} | {"response curve": curve}
    lines = {name: u for name, u in lines.items() if u > 0.0}
    u_rel = math.hypot(*lines.values())
    spread = value.u_rel**4 / reading.degrees_of_freedom
    found = scale_from_radiance(
        source.radiance_w_sr_m2,
        source.u_rel,
        value.value,
        u_rel,
        base.scale.f_number,
        degrees_of_freedom=math.hypot(source.u_rel, u_rel) ** 4 / spread if spread > 0.0 else None,
        reading_budget=lines,
    )
    return found.model_copy(update={"conditions": conditions, "quantity": source.quantity})


def scale_by_meter(base: Calibration, meter: MeterReading) -> Scale:
    """Return the scale from a light meter's constant.

    Raises:
        InputError: If a setting or K is not above 0.
        UsageError: If the reference pixel value is not between black and full scale, or where the curve has no data.
    """
    model = signal_model(base.camera, base.response, base.noise, base.black_level.dn)
    low, high = base.black_level.dn, base.camera.full_scale_dn
    if not low < meter.reference_dn < high:
        raise UsageError(
            f"reference pixel value {meter.reference_dn:g} DN is out of range; "
            f"allowed is above {low:g} and below {high} DN"
        )
    support = model.valid_dn
    inside = support[0] <= meter.reference_dn <= support[1]
    settle("response support", f"{support[0]} to {support[1]}", f"{meter.reference_dn:g}", equal=inside)
    settings = FrameSettings(meter.settings.exposure_s, f_number=meter.settings.f_number)
    return scale_from_meter(
        meter.meter_k,
        meter.settings,
        float(model.at_dn(model.table(settings), meter.reference_dn)),
        spectrum(base.spectrum),
        lens_factor_sr(base.lens, meter.settings.f_number),
        k_u_rel=meter.k_u_rel,
        signal_u_rel=float(model.at_dn(model.u_rel, meter.reference_dn)),
    )


def scales_ratio(by_meter: Scale, by_source: Scale) -> Quantity:
    """Return the scale by the meter over the scale by the source, with its standard uncertainty."""
    ratio = by_meter.value / by_source.value
    return Quantity(ratio, ratio * (by_meter.u_rel**2 + by_source.u_rel**2) ** 0.5, "1")


def scaled_calibration(
    base: Calibration,
    scale: Scale,
    inputs: tuple[str, ...],
    other: Scale | None = None,
    further: tuple[str, ...] = (),
) -> Calibration:
    """Return the calibration with its scale and the record of how it was made.

    Args:
        other: A second scale that was found and not used.
    """
    doubt = base.uncertainties.efficacy_u_rel
    assumptions = list[str]()
    if doubt:
        assumptions.append(
            f"reference of spectrum {base.spectrum}, its luminous efficacy to {100 * doubt:.2g} % (k = 1)"
        )
    if base.found.names:
        assumptions.append("corrected for what reconcile found: " + ", ".join(base.found.names))
    if base.response is None:
        assumptions.append("response taken as linear above the black level")
    assumptions += base.noise.assumptions
    if base.lens.transmittance is None and scale.method == "light_meter_k":
        assumptions.append("lens transmittance 1")
    assumptions += further
    parameters: dict[str, object] = {"scale": scale.model_dump(mode="json", exclude_none=True)}
    if other is not None:
        parameters["other_scale"] = other.model_dump(mode="json", exclude_none=True)
    method = f"absolute scale by {scale.method.replace('_', ' ')}"
    scale = scale.model_copy(update={"spectrum": base.spectrum})
    return replace(base, scale=scale, provenance=Provenance(method, inputs, tuple(assumptions), parameters))
