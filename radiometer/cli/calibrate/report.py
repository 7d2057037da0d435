"""What `radiometer calibrate` says of the scale that it found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiometer.cli.console import console, significant

if TYPE_CHECKING:
    from radiometer.analysis.calibration.calibrate import MeterReading
    from radiometer.analysis.response.dynamic_range import DynamicRange
    from radiometer.data import Calibration, Scale


def calibration_report(
    calibration: Calibration,
    scales: list[Scale],
    meter: MeterReading | None,
    out: Path,
    ranged: DynamicRange | None = None,
) -> dict[str, Any]:
    """Return the report as the mapping that --json prints."""
    from radiometer.analysis.calibration import absolute
    from radiometer.analysis.calibration.calibrate import scales_ratio
    from radiometer.analysis.photometry import photometry
    from radiometer.analysis.photometry.spectra import spectrum

    report: dict[str, Any] = {
        "calibration": str(out),
        "scale": calibration.scale.model_dump(mode="json", exclude_none=True),
        "spectrum": calibration.spectrum,
        "assumptions": list(calibration.provenance.assumptions),
    }
    if meter is not None:
        luminance = absolute.metered_luminance_cd_m2(meter.meter_k, meter.settings)
        radiance = photometry.radiance_w_sr_m2(luminance, spectrum(calibration.spectrum))
        thesis = photometry.radiance_thesis_w_sr_m2_um(luminance)
        u_rel = absolute.metered_u_rel(meter.k_u_rel)
        report["metered"] = {
            "luminance": {"value": luminance, "u": luminance * u_rel, "unit": "cd m-2"},
            "radiance": {"value": radiance, "u": radiance * u_rel, "unit": "W sr-1 m-2"},
            "thesis_spectral_radiance": {"value": thesis, "unit": "W sr-1 m-2 um-1"},
        }
    if ranged is not None:
        report["dynamic_range"] = ranged.to_mapping()
    if calibration.flat_field is not None:
        report["flat_field"] = calibration.flat_field.model_dump(mode="json")
    if len(scales) == 2:
        by_source, by_meter = scales
        report["meter_over_source"] = scales_ratio(by_meter, by_source).to_mapping()
    return report


def show_report(report: dict[str, Any], calibration: Calibration) -> None:
    """Print the report for people."""
    out, scale = console(), calibration.scale
    method = scale.method.replace("_", " ")
    out.print(
        f"scale      [bold]{scale.value:.6g} J·m⁻² per unit of signal[/bold] "
        f"± {200 * scale.u_rel:.2g} % (k = 2), {method}"
    )
    if scale.reference:
        out.print(f"from       {scale.reference}")
    for name, share in sorted(_shares(scale).items(), key=lambda entry: -entry[1])[:3]:
        out.print(f"  {100 * share:5.1f} %  {name} (u = {100 * scale.budget[name]:.2g} %)")
    if metered := report.get("metered"):
        for name, unit in (("luminance", "cd·m⁻²"), ("radiance", "W·sr⁻¹·m⁻²")):
            entry = metered[name]
            out.print(
                f"{name:<10} {significant(entry['value'], entry['u'])} ± {2 * entry['u']:.2g} {unit}  (metered surface)"
            )
        thesis = metered["thesis_spectral_radiance"]["value"]
        out.print(f"thesis     {thesis:.4f} W·sr⁻¹·m⁻²·µm⁻¹  (equation 2.10: a spectral radiance, for comparison only)")
    if ranged := report.get("dynamic_range"):
        exponent, u = ranged["exponent"], ranged["u_exponent"]
        out.print(
            f"exponent   {significant(exponent, u)} ± {2 * u:.2g} (k = 2) of the curve, by {len(ranged['points'])} "
            f"regions brought to {ranged['reference_dn']:g} DN"
        )
    if ratio := report.get("meter_over_source"):
        out.print(f"meter over source  {significant(ratio['value'], ratio['u'])} ± {2 * ratio['u']:.2g} (k = 2)")
    if flat := report.get("flat_field"):
        out.print(
            f"flat field fitted about {flat['principal_point_px'][0]:.1f}, {flat['principal_point_px'][1]:.1f} px, "
            f"± {200 * flat['u_rel']:.2g} % (k = 2)"
        )
    for assumption in report["assumptions"]:
        out.print(f"assumed    {assumption}")
    out.print(f"written    {report['calibration']}")


def _shares(scale: Scale) -> dict[str, float]:
    """Return what part of the scale's variance each contribution makes up: the largest is what to work on next."""
    total = sum(u**2 for u in scale.budget.values())
    return {name: u**2 / total for name, u in scale.budget.items() if u > 0.0}
