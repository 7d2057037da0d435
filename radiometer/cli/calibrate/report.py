"""What `radiometer calibrate` prints of the scale that it found."""

from __future__ import annotations

from typing import Any

from radiometer.cli.console import console
from radiometer.numbers import with_u


def show_report(report: dict[str, Any]) -> None:
    """Print the JSON form of a calibration's report for people."""
    out, scale = console(), report["scale"]
    method, budget = scale["method"].replace("_", " "), scale["budget"]
    out.print(
        f"scale      [bold]{scale['value']:.6g} J·m⁻² per unit of signal[/bold] "
        f"± {200 * scale['u_rel']:.2g} % (k = 2), {method}"
    )
    if scale["reference"]:
        out.print(f"from       {scale['reference']}")
    out.print(f"spectrum   {report['spectrum']}")
    for name, share in sorted(_shares(budget).items(), key=lambda entry: -entry[1])[:3]:
        out.print(f"  {100 * share:5.1f} %  {name} (u = {100 * budget[name]:.2g} %)")
    if metered := report.get("metered"):
        for name, unit in (("luminance", "cd·m⁻²"), ("radiance", "W·sr⁻¹·m⁻²")):
            entry = metered[name]
            out.print(f"{name:<10} {with_u(entry['value'], 2 * entry['u'], unit, k=2)}  (metered surface)")
        thesis = metered["thesis_spectral_radiance"]["value"]
        out.print(
            f"per µm     {thesis:.4f} W·sr⁻¹·m⁻²·µm⁻¹  (L_v/(683·0.1068): a spectral radiance, for comparison only)"
        )
    if ranged := report.get("dynamic_range"):
        exponent, u = ranged["exponent"], ranged["u_exponent"]
        out.print(
            f"exponent   {with_u(exponent, 2 * u, k=2)} of the curve, by {len(ranged['points'])} "
            f"regions brought to {ranged['reference_dn']:g} DN"
        )
    if ratio := report.get("meter_over_source"):
        out.print(f"meter over source  {with_u(ratio['value'], 2 * ratio['u'], k=2)}")
    if flat := report.get("flat_field"):
        out.print(
            f"flat field fitted about {flat['principal_point_px'][0]:.1f}, {flat['principal_point_px'][1]:.1f} px, "
            f"± {200 * flat['u_rel']:.2g} % (k = 2)"
        )
    for assumption in report["assumptions"]:
        out.print(f"assumed    {assumption}")
    out.print(f"written    {report['calibration']}")


def _shares(budget: dict[str, float]) -> dict[str, float]:
    """Return what part of the scale's variance each contribution makes up: the largest is what to work on next."""
    total = sum(u**2 for u in budget.values())
    return {name: u**2 / total for name, u in budget.items() if u > 0.0}
