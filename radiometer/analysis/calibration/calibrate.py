"""Makes a calibration: camera, lens and curve given, the scale from a known source or from a light meter."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass, replace
from typing import Literal

from radiometer.analysis.calibration.absolute import MeterSettings, scale_from_meter, scale_from_radiance
from radiometer.analysis.calibration.shared import settle
from radiometer.analysis.photometry.spectra import spectrum
from radiometer.analysis.reading.contributions import budget_terms
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
    FlatField,
    FrameSettings,
    LensDescription,
    Patch,
    Provenance,
    Quantity,
    ResponseCurve,
    Scale,
    SensorNoise,
    SourceDescription,
)
from radiometer.data.setup import Setup
from radiometer.errors import MeasurementError, UsageError


@dataclass(frozen=True, slots=True)
class KnownSource:
    """A source of known radiance: radiance in W·sr⁻¹·m⁻², its relative standard uncertainty, and what was stated."""

    radiance_w_sr_m2: float
    u_rel: float
    quantity: Literal["radiance", "luminance"] = "radiance"


@dataclass(frozen=True, slots=True)
class MeterReading:
    """A reference photograph by a light meter.

    Attributes:
        meter_k: K in cd·m⁻²·s.
        settings: Exact settings of the photograph.
        reference_dn: Digital number that the metered surface came out at.
        k_u_rel: Relative standard uncertainty of K beyond the meter's ±1/6 stop; None where it was not determined.
    """

    meter_k: float
    settings: MeterSettings
    reference_dn: float
    k_u_rel: float | None = None


def unscaled_calibration(
    camera: CameraDescription,
    lens: LensDescription,
    response: ResponseCurve | None,
    spectrum_name: str,
    black_dn: float | None = None,
    validity_days: float = 365.0,
    flat_field: FlatField | None = None,
) -> Calibration:
    """Return a calibration that still lacks its scale (it is 1).

    Args:
        camera: The camera.
        lens: The lens it is used with.
        response: Response curve; None takes the sensor as linear above black.
        spectrum_name: Spectrum that the scale will hold for.
        black_dn: Black level in DN; None takes the camera description's, or what the response was recovered with.
        validity_days: Days until readings are flagged `stale_calibration`.
        flat_field: Sensitivity over the picture; the scale then holds on the optical axis.

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
        flat_field=flat_field,
        spectrum=spectrum_name,
        validity_days=validity_days,
    )


def scale_by_source(
    base: Calibration,
    frames: Bracket,
    patch: Patch,
    source: KnownSource,
    light: SourceDescription | None = None,
) -> Scale:
    """Return the scale from frames of a source of known radiance.

    Args:
        base: Unscaled calibration.
        frames: Bracket of the source; its dark frames give the dark level.
        patch: Where the source is.
        source: What is known of its radiance.
        light: What else is known of it.

    Raises:
        MeasurementError: If the patch is clipped, below the noise or not uniform.
    """
    made = dt.datetime.fromisoformat(base.created)  # a scale has no age when it is made
    situation = patch_situation(frames, patch, Setup(base.camera, base.lens, base, light), now=made)
    channel = frames.light[0].extra.get("channel")
    conditions = situation.conditions.model_copy(update={"channel": None if channel is None else str(channel)})
    own = replace(base, scale=base.scale.model_copy(update={"conditions": conditions}))
    reading = read_patch(frames, patch, Setup(base.camera, base.lens, own, light), now=made)
    for flag in (Flag.SATURATED, Flag.BELOW_NOISE, Flag.NONUNIFORM):
        if flag in reading.flags:
            raise MeasurementError(
                f"the patch {patch.x},{patch.y},{patch.width},{patch.height} cannot carry a scale: it is {flag}; "
                "choose an even, well exposed part of the known source"
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

    Args:
        base: Unscaled calibration.
        meter: The reference photograph.

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
        base: Unscaled calibration.
        scale: The scale to use.
        inputs: Names of what went in.
        other: A second scale that was found and not used.
        further: What else was assumed.
    """
    doubt = base.uncertainties.efficacy_u_rel
    known = f", its luminous efficacy to {100 * doubt:.2g} % (k = 1)" if doubt else ""
    assumptions = [f"source spectrum {base.spectrum}{known}"]
    if base.found.names:
        assumptions.append("corrected for what reconcile found: " + ", ".join(base.found.names))
    if base.response is None:
        assumptions.append("response taken as linear above the black level")
    if base.noise.assumed:
        assumptions.append("typical values for " + ", ".join(base.noise.assumed))
    if base.lens.transmittance is None and scale.method == "light_meter_k":
        assumptions.append("lens transmittance 1")
    assumptions += further
    parameters: dict[str, object] = {"scale": scale.model_dump(mode="json", exclude_none=True)}
    if other is not None:
        parameters["other_scale"] = other.model_dump(mode="json", exclude_none=True)
    method = f"absolute scale by {scale.method.replace('_', ' ')}"
    scale = scale.model_copy(update={"spectrum": base.spectrum})
    return replace(base, scale=scale, provenance=Provenance(method, inputs, tuple(assumptions), parameters))
