"""Names of statistics and covariates in the report."""

from __future__ import annotations

from typing import Final

# Covariates drawn on a logarithmic axis, and what stands at the others.
AXES: Final = {
    "exposure_s": "exposure in s",
    "f_number": "f-number",
    "signal": "signal in e⁻",
    "patch_level": "radiance of the patch in W·sr⁻¹·m⁻²",
    "previous_frame": "signal of the capture before in e⁻, plus 1",
}
_PLAIN: Final = {
    "gain_db": "gain in dB",
    "temperature_C": "sensor temperature in °C",
    "timestamp_s": "time in s",
    "source_level": "source level",
    "image_x": "column in pixels",
    "image_y": "row in pixels",
    "field_radius": "distance from the middle of the picture (1 in the corner)",
    "half_x": "left and right half of the picture",
    "half_y": "upper and lower half of the picture",
    "pattern": "displayed pattern",
}
_ALONG: Final = {
    "exposure_s": "with the exposure time",
    "f_number": "with the f-number",
    "signal": "with the signal",
    "patch_level": "with the brightness of the patch",
    "previous_frame": "with the brightness of the capture before",
    "gain_db": "with the gain",
    "temperature_C": "with the sensor's temperature",
    "timestamp_s": "in the course of time",
    "source_level": "with the level of the source",
    "image_x": "across the picture",
    "image_y": "down the picture",
    "screen_x": "across the screen",
    "field_radius": "from the middle of the picture to its corners",
}
_SEEN: Final = {
    "mean": "how bright patches are",
    "slope": "how brightness changes within patches",
    "variance": "how much a pixel's value scatters from frame to frame",
    "spatial": "how much pixels of a patch differ among each other",
    "neighbour": "how alike neighbouring pixels scatter",
    "first": "how the first frame of a setting differs from the next",
    "common": "how whole frames brighten and darken together",
    "bands": "how rows brighten and darken together",
    "row_temporal": "how whole rows scatter",
    "columns": "how columns differ from each other",
    "rows": "how rows differ from each other",
    "edge": "how sharp the borders of patches are",
    "outliers": "how many single pixels stand far out",
    "comb": "which codes occur",
}


def axis_label(covariate: str) -> tuple[str, bool]:
    """Return what stands at the axis of a covariate, and whether the axis is logarithmic."""
    return AXES.get(covariate, _PLAIN.get(covariate, covariate)), covariate in AXES


def along(covariate: str) -> str:
    """Return in words along what something changes."""
    return _ALONG.get(covariate, f"along {covariate.replace('_', ' ')}")


def seen_in(block: str) -> str:
    """Return in words what a statistic is."""
    return _SEEN.get(block.partition("_x")[0], block)
