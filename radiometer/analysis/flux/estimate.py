"""The flux of a light-emitting diode from a bracket and its angular pattern, in the form of a gap that closes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.characterise.sensitivity import propagated
from radiometer.analysis.flux.report import Correction, Emitter, FluxReport
from radiometer.analysis.flux.sensor import FluxScale, SensorFlux, as_quantity, sensor_flux
from radiometer.analysis.signal.lens import lens_factor_sr
from radiometer.data import Frame, LensDescription, Patch, Quantity
from radiometer.errors import UsageError

# Lambertian part of the axial intensity of lensed diodes: 0 to some 10 %; a data sheet's half angle says nothing of it.
PEDESTAL_U: Final = 0.05
_PLATEAU_SHARE = 0.5
# From a stated distance to that of a thin lens. Magnifications are stated roughly, and the entrance pupil of a close-up
# lens may be a focal length from its principal plane.
_MOST_OFF_REL = 0.5


def intensity_exponent(half_angle_deg: float) -> float:
    """Return m of the intensity I = I₀·cosᵐθ that falls to one half at the datasheet's half angle.

    Args:
        half_angle_deg: Angle from the axis in degrees at which the intensity is one half (half of the "viewing
            angle" 2θ½); above 0, below 90. 60° is a Lambertian emitter, m = 1.

    Raises:
        UsageError: If the angle is outside that range.

    Source: Moreno and Sun (2008), equation (1).
    """
    if not 0 < half_angle_deg < 90:
        raise UsageError(f"half angle {half_angle_deg:g}° is out of range; allowed is above 0° and below 90°")
    return -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))


def flux_of_radiance(radiance: float, area_m2: float, exponent: float) -> float:
    """Return the flux in W of a flat emitter of axial radiance L₀: Φ = 2π·A·L₀/(m + 1); π·A·L₀ where Lambertian.

    Args:
        radiance: L₀ in W·sr⁻¹·m⁻².
        area_m2: Emitting area A in m².
        exponent: m of the intensity.
    """
    return 2.0 * math.pi * area_m2 * radiance / (exponent + 1.0)


def spread_by_pedestal(exponent: float, pedestal: float) -> float:
    """Return by what the emitted flux grows where a part of the axial intensity is Lambertian rather than beamed.

    I = I₀·[(1 − p)·cosᵐθ + p·cosθ] emits 2π·I₀·[(1 − p)/(m + 1) + p/2]: light that housing and chip scatter sideways
    fills the half space and is seen by no lens on the axis. The axial intensity is taken as the same.

    Args:
        exponent: m of the beam.
        pedestal: p, below 1; 0 is the beam alone.
    """
    return (1.0 - pedestal) + pedestal * (exponent + 1.0) / 2.0


def pupil_half_angle_rad(pupil_diameter_mm: float, distance_mm: float) -> float:
    """Return the half angle in rad that a pupil subtends at the emitter."""
    return math.atan(0.5 * pupil_diameter_mm / distance_mm)


def captured_fraction(exponent: float, half_angle_rad: float) -> float:
    """Return the part of the emitted flux that enters a coaxial round pupil: 1 − cosᵐ⁺¹θ_p.

    It is the integral of (m + 1)/(2π)·cosᵐθ over the cone of half angle θ_p.

    Args:
        exponent: m of the intensity.
        half_angle_rad: θ_p in rad.
    """
    return -math.expm1((exponent + 1.0) * math.log(math.cos(half_angle_rad)))


def mean_to_axial_radiance(exponent: float, half_angle_rad: float) -> float:
    """Return L₀ over the radiance that a lens sees averaged over its pupil; above 1 for a narrow beam.

    The lens equation takes the radiance as the same over the pupil: π·A·L·tan²θ_p enters. The pattern lets in
    2π·A·L₀/(m + 1)·(1 − cosᵐ⁺¹θ_p).

    Args:
        exponent: m of the intensity.
        half_angle_rad: θ_p in rad, above 0.
    """
    return 0.5 * (exponent + 1.0) * math.tan(half_angle_rad) ** 2 / captured_fraction(exponent, half_angle_rad)


def led_flux(
    frames: Sequence[Frame],
    scale: FluxScale,
    emitter: Emitter | None = None,
    region: Patch | None = None,
    f_number_u_rel: float = 0.02,
) -> FluxReport:
    """Return the flux of a diode by the thesis's formula, on the sensor, and as emitted.

    Args:
        frames: Bracket of the lit diode; frames with the source off and dark frames where there are any.
        scale: From digital numbers to exposure on the sensor, with the lens, whose transmittance, f-number, focal
            length and magnification count.
        emitter: The diode; without it only the flux on the sensor can be given.
        region: Where the diode and its glow are; None for the whole frame.

    Raises:
        MeasurementError: If no frame shows the diode, or it clips everywhere.
        UsageError: If a figure of the emitter is impossible, or contradicts the lens.
    """
    measured = sensor_flux(frames, scale, region)
    f_number = frames[0].settings.f_number or scale.lens.f_number
    ways = _Ways(measured, scale, scale.lens, f_number, f_number_u_rel, emitter, _distance(emitter, scale.lens))
    emitted = ways.emitted()
    steps = ways.steps(emitted)
    thesis_exposure, thesis_w, left_out = _typical(measured)
    first = as_quantity(thesis_w, scale)
    reference = emitter.reference_w if emitter else None
    goal = reference if reference is not None else steps[-1][1].value
    return FluxReport(
        thesis=first,
        thesis_exposure_s=thesis_exposure,
        thesis_left_out=left_out,
        on_sensor=ways.on_sensor(),
        corrections=_shares(first.value, goal, steps),
        emitted=emitted,
        reference_w=reference,
        assumptions=(*scale.assumptions, *ways.assumptions()),
        clipped_everywhere=measured.clipped_everywhere,
        is_cut=_reaches_the_edge(ways.light()),
    )


def _distance(emitter: Emitter | None, lens: LensDescription) -> Quantity | None:
    """Return the distance from emitter to pupil, measured or f·(1 + 1/m) of a thin lens; None where it is not known.

    Raises UsageError for one that focal length and magnification exclude, such as one in cm.
    """
    if emitter is None or lens.focal_length_mm is None or lens.magnification <= 0:
        return None if emitter is None else emitter.distance_mm
    focused = lens.focal_length_mm * (1.0 + 1.0 / lens.magnification)
    if emitter.distance_mm is None:
        return Quantity(focused, 0.01 * focused, "mm")
    stated = emitter.distance_mm.value
    if abs(stated / focused - 1.0) > _MOST_OFF_REL:
        raise UsageError(
            f"--distance {stated:g} mm: f = {lens.focal_length_mm:g} mm at a magnification of {lens.magnification:g}, "
            f"as the lens is stated, belong to {focused:.4g} mm; correct the distance, or lens.magnification"
        )
    return emitter.distance_mm


def _typical(measured: SensorFlux) -> tuple[float, float, float]:
    """Return the frame whose figure by (2.13) is the median of all frames: one photograph, chosen without favour."""
    return sorted(measured.thesis, key=lambda one: one[1])[(len(measured.thesis) - 1) // 2]


def _shares(first: float, goal: float, steps: Sequence[tuple[str, Quantity, str]]) -> tuple[Correction, ...]:
    corrections, before = [], first
    for name, flux, note in steps:
        share = (flux.value - before) / (goal - first) if goal != first else 0.0
        corrections.append(Correction(name, flux, share, note))
        before = flux.value
    return tuple(corrections)


@dataclass(frozen=True, slots=True)
class _Ways:
    """Ways from the flux on the sensor to the emitted one."""

    measured: SensorFlux
    scale: FluxScale
    lens: LensDescription
    f_number: float | None
    f_number_u_rel: float
    emitter: Emitter | None
    distance: Quantity | None  # from emitter to pupil

    def on_sensor(self) -> Quantity:
        m = self.measured
        return as_quantity(m.merged_w - m.background_w, self.scale, m.u_noise_w, m.u_background_w)

    def emitted(self) -> dict[str, Quantity]:
        found: dict[str, Quantity] = {}
        emitter = self.emitter
        if emitter is None or self.f_number is None:
            return found
        if self.distance is not None and self.lens.focal_length_mm is not None:
            found["fraction_through_pupil"] = self._through_pupil(emitter.half_angle, self.distance)
        if emitter.diameter_mm is not None and self._is_in_focus():
            found["radiance_times_area"] = self._radiance_times_area(emitter.half_angle, emitter.diameter_mm)
        return found

    def steps(self, emitted: dict[str, Quantity]) -> list[tuple[str, Quantity, str]]:
        m = self.measured
        merged = as_quantity(m.merged_w, self.scale, m.u_noise_w)
        steps = [
            ("clipped pixels from shorter exposures", merged, f"{m.clipped_everywhere} pixels clip in every frame"),
            ("background light taken off", self.on_sensor(), m.background_source),
        ]
        if self.emitter is not None and self.distance is not None and "fraction_through_pupil" in emitted:
            tau = Quantity(self.lens.transmittance or 1.0, 0.0, "1")
            noise_w = math.hypot(m.u_noise_w, m.u_background_w)
            through = as_quantity(self.on_sensor().value / tau.value, self.scale, noise_w / tau.value)
            u = math.hypot(through.u, through.value * (self.lens.transmittance_u_rel or 0.0))
            steps.append(("light lost in the lens", Quantity(through.value, u, "W"), f"transmittance {tau.value:g}"))
            share = self._fraction(self.emitter.half_angle.value, self.distance.value, 1.0)
            note = f"the pupil takes in {100 * share:.3g} % of the pattern"
            steps.append(("light that missed the lens", emitted["fraction_through_pupil"], note))
        elif "radiance_times_area" in emitted:
            steps.append(("light that missed the lens", emitted["radiance_times_area"], "radiance × area × pattern"))
        return steps

    def assumptions(self) -> tuple[str, ...]:
        notes = []
        if self.emitter is not None:
            if self.emitter.distance_mm is None and self.distance is not None:
                notes.append(f"distance {self.distance.value:.4g} mm from focal length and magnification (thin lens)")
            notes.append("intensity falls as a power of the cosine, the diode faces the lens")
            notes.append(f"a Lambertian part of 0 ± {100 * PEDESTAL_U:g} % of the axial intensity (k = 1)")
        return tuple(notes)

    def _pupil_angle(self, distance_mm: float, f_number_factor: float) -> float:
        assert self.f_number is not None
        assert self.lens.focal_length_mm is not None
        return pupil_half_angle_rad(self.lens.focal_length_mm / (self.f_number * f_number_factor), distance_mm)

    def _fraction(self, half_angle_deg: float, distance_mm: float, f_number_factor: float) -> float:
        return captured_fraction(intensity_exponent(half_angle_deg), self._pupil_angle(distance_mm, f_number_factor))

    def _through_pupil(self, half_angle: Quantity, distance: Quantity) -> Quantity:
        tau = Quantity(self.lens.transmittance or 1.0, 0.0, "1")
        u_tau = tau.value * (self.lens.transmittance_u_rel or 0.0)
        return propagated(
            lambda flux, transmittance, angle, away, stop, pedestal: (
                flux
                / transmittance
                / self._fraction(angle, away, stop)
                * spread_by_pedestal(intensity_exponent(angle), pedestal)
            ),
            "W",
            self.on_sensor(),
            Quantity(tau.value, u_tau, "1"),
            half_angle,
            distance,
            Quantity(1.0, self.f_number_u_rel, "1"),
            Quantity(0.0, PEDESTAL_U, "1"),
        )

    def _is_in_focus(self) -> bool:
        """Return whether the picture of the emitter has a plateau: half of the lit area is near its highest value."""
        light = self.light()
        inside = _inside(light)
        if not inside.any():
            return False
        top = float(np.median(light[inside]))
        return bool((light > 0.8 * top).sum() >= 0.7 * (light > 0.2 * top).sum())

    def light(self) -> NDArray[np.float64]:
        """Return the irradiance by the source alone."""
        irradiance = self.measured.irradiance
        return irradiance - self.measured.background_w / (irradiance.size * self.scale.pixel_area_m2)

    def _radiance_times_area(self, half_angle: Quantity, diameter_mm: Quantity) -> Quantity:
        light = self.light()
        plateau = light[_inside(light)]
        irradiance = float(plateau.mean())
        tau_u = self.lens.transmittance_u_rel or 0.0
        scale_u = as_quantity(irradiance, self.scale, float(plateau.std()) / math.sqrt(plateau.size)).u
        return propagated(
            self._from_radiance,
            "W",
            Quantity(irradiance, math.hypot(scale_u, irradiance * tau_u), "W m-2"),
            half_angle,
            diameter_mm,
            self.distance or Quantity(math.inf, 0.0, "mm"),
            Quantity(1.0, self.f_number_u_rel, "1"),
            Quantity(0.0, PEDESTAL_U, "1"),
        )

    def _from_radiance(
        self,
        irradiance: float,
        half_angle: float,
        diameter_mm: float,
        distance_mm: float,
        stop: float,
        pedestal: float,
    ) -> float:
        assert self.f_number is not None
        radiance = irradiance / lens_factor_sr(self.lens, self.f_number * stop)
        exponent = intensity_exponent(half_angle)
        if math.isfinite(distance_mm) and self.lens.focal_length_mm is not None:
            radiance *= mean_to_axial_radiance(exponent, self._pupil_angle(distance_mm, stop))
        flux = flux_of_radiance(radiance, math.pi * (0.5e-3 * diameter_mm) ** 2, exponent)
        return flux * spread_by_pedestal(exponent, pedestal)


def _inside(light: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the pixels that are lit together with all their neighbours: the rim of a disc is partly dark."""
    return np.asarray(cv2.erode(_lit(light), np.ones((3, 3), np.uint8), borderValue=0), dtype=bool)


def _reaches_the_edge(light: NDArray[np.float64]) -> bool:
    """Return whether the source goes on beyond the edge: pixels there are lit, more than single ones."""
    lit = cv2.medianBlur(_lit(light), 3)
    lit[1:-1, 1:-1] = 0
    return bool(lit.any())


def _lit(light: NDArray[np.float64]) -> NDArray[np.uint8]:
    return (light > _PLATEAU_SHARE * float(np.percentile(light, 99.9))).astype(np.uint8)
