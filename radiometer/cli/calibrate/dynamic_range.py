"""`radiometer calibrate --dynamic-range`: regions brought to the reference value put a curve's exponent right."""

from __future__ import annotations

from typing import TYPE_CHECKING

from radiometer.cli.arguments import parse_seconds
from radiometer.errors import UsageError

if TYPE_CHECKING:
    from radiometer.analysis.response.dynamic_range import DynamicRange, RangePoint
    from radiometer.data import ResponseCurve


def with_dynamic_range(
    curve: ResponseCurve | None,
    words: list[str] | None,
    exposure: str | None,
    reference_dn: float | None,
    *,
    as_printed: bool,
) -> tuple[ResponseCurve | None, DynamicRange | None]:
    """Return the curve as the regions put it right, and what they say; the curve itself where none are given.

    Args:
        curve: Response curve; None where the sensor is taken as linear.
        words: What stands behind `--dynamic-range`: M,TIME or M,TIME,LANDED of every region.
        exposure: Exposure time of the reference photograph, as written.
        reference_dn: Reference value; None for half of full scale.
        as_printed: Take times at face value, not as stops.

    Raises:
        UsageError: If curve or reference time are missing, or a region is not of that form.
        InputError: If a number lies outside the curve.
        MeasurementError: If a region contradicts the curve.
    """
    from radiometer.analysis.response import dynamic_range as ranges

    if not words:
        return curve, None
    if curve is None or exposure is None:
        raise UsageError("--dynamic-range needs --response, and --exposure of the reference photograph")
    points = [_point(word, as_printed=as_printed) for word in words]
    reference = (curve.log_exposure.size - 1) // 2 if reference_dn is None else reference_dn
    found = ranges.dynamic_range(curve, points, _seconds(exposure, "--exposure", as_printed=as_printed), reference)
    return ranges.with_dynamic_range(curve, found), found


def _point(word: str, *, as_printed: bool) -> RangePoint:
    from radiometer.analysis.response.dynamic_range import RangePoint

    parts = word.split(",")
    try:
        number, landed = float(parts[0]), float(parts[2]) if len(parts) == 3 else None
    except ValueError as error:
        raise UsageError(_form(word)) from error
    if len(parts) not in (2, 3):
        raise UsageError(_form(word))
    return RangePoint(number, _seconds(parts[1], "--dynamic-range", as_printed=as_printed), landed)


def _form(word: str) -> str:
    return (
        f"--dynamic-range {word!r}: expected M,TIME or M,TIME,LANDED, such as 254,1/2000: the region at pixel value M "
        "of the reference photograph lands on the reference value (or on LANDED) at TIME"
    )


def _seconds(text: str, option: str, *, as_printed: bool) -> float:
    from radiometer.units import exact_exposure_s

    seconds = parse_seconds(text, option)
    return seconds if as_printed else exact_exposure_s(seconds)
