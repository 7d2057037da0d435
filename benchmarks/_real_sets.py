"""The open sets of real sensors: which effects their owners document, by what names and along what covariates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Documented:
    """One effect that somebody documented in a set.

    Attributes:
        what: The effect in the words of who documents it, with its figure.
        names: Entries that name it rightly.
        covariates: Covariates along which a disagreement points at it.
        by: Who says so.
        repeats_of: Where it is no entry's law but how frames of one setting differ: of which frames, `dark` or `lit`,
            the result must report it.
    """

    what: str
    names: tuple[str, ...]
    covariates: tuple[str, ...]
    by: str
    repeats_of: str = ""


@dataclass(frozen=True, slots=True)
class RealSet:
    """One set that `reconcile` takes.

    Attributes:
        name: Name in the table.
        folder: Folder under the shared data, or a pattern in it.
        files: Pattern of the files to take; empty for the whole folder.
        documented: Its effects, the largest first; none for a set that must stay silent.
        likely: Further names that are right, as independent measurements of the same frames show.
    """

    name: str
    folder: str
    files: str
    documented: tuple[Documented, ...]
    likely: tuple[str, ...] = ()


_OWN: str = "clipped means of the frames (PROVENANCE)"
_FRAMES: str = "measured directly on these frames"
# Next to what is documented, by plain statistics of the frames: medians of columns fall from 17 DN to 0 within 256
# columns of every dark frame; column profiles of two halves of a set correlate by 0.88 to 0.92 (0.4 to 0.5 DN); in
# differences of frames row means scatter 1.3 to 2.5 times as much as their pixels allow, and neighbours in a row
# correlate by −0.05 to −0.08; biases rise down their rows by 1.5 to 3 DN.
_CCD_FRAMES: tuple[str, ...] = (
    "line_start_offset",
    "column_pattern",
    "row_temporal_noise",
    "correlated_read_noise",
    "readout_dark_charge",
)
_CCD_DARKS: tuple[str, ...] = (*_CCD_FRAMES, "dark_current_nonuniformity", "hot_pixels")  # pixels of 0.3 to 200 DN/s
SETS: tuple[RealSet, ...] = (
    RealSet(
        "CCD STL-1001E, September 2017, 32 frames",
        "sensors/sbig_stl1001_2017",
        "",
        (
            Documented(
                "dark current, doubling 4.9 K",
                ("dark_current", "dark_current_clamped"),
                ("exposure_s", "temperature_C"),
                _OWN,
            ),
            Documented(
                "header gain 6 % off",
                ("conversion_gain_error",),
                ("signal", "constant"),
                "photon transfer (PROVENANCE)",
            ),
            Documented(
                "flats of one setting differ by 0.4 %",
                ("lamp_step", "source_warmup_drift"),
                ("timestamp_s",),
                _OWN,
                repeats_of="lit",
            ),
            Documented(
                "first bias of a series 0.4 DN low",
                ("first_frame_offset",),
                ("previous_frame", "timestamp_s"),
                _OWN,
                repeats_of="dark",
            ),
            Documented(
                "hot pixels, 63 000 DN after 60 s",
                ("hot_pixels", "dark_current_nonuniformity"),
                ("exposure_s", "temperature_C"),
                _OWN,
            ),
        ),
        _CCD_DARKS,
    ),
    RealSet(
        "the same camera, September 2019, 22 darks",
        "sensors/sbig_stl1001_2019",
        "",
        (
            Documented(
                "dark current, doubling 4.6 K",
                ("dark_current", "dark_current_clamped"),
                ("exposure_s", "temperature_C"),
                _OWN,
            ),
            Documented("dark charge gathered in readout, 9 DN at 10 °C", ("readout_dark_charge",), ("image_y",), _OWN),
            Documented(
                "first bias 3.9 DN high",
                ("first_frame_offset",),
                ("previous_frame", "timestamp_s"),
                _OWN,
            ),
        ),
        _CCD_DARKS,
    ),
    RealSet(
        "CCD of 12 bits, EMVA 1288 ref001, 100 + 8 images",
        "emva/ref001_ccd_12bit",
        "",
        (
            Documented(
                "linearity error −0.6 to +0.5 %",
                ("response_nonlinearity", "gamma_enabled", "soft_saturation"),
                ("signal", "exposure_s"),
                "Basler; emva1288 1.0.2",
            ),
        ),
        # Row means of dark differences scatter 17 to 19 times too much; column profiles of odd and even rows of the
        # mean of 50 frames correlate by 0.59 in the dark (0.03 DN) and by 0.82 in light (0.85 DN). Neighbours along a
        # row of the differences of 25 pairs of darks, row means taken out, correlate by −0.039 ± 0.001, those one
        # further by +0.006 ± 0.001; −0.002 is what the taking out of means does. The mean of 50 darks begins its lines
        # at 13.4 DN, has 14.6 in the 20th column, 14.92 about the 70th and 14.71 at the end, alike in all rows.
        ("row_temporal_noise", "column_pattern", "correlated_read_noise", "line_start_offset"),
    ),
    RealSet(
        "null: five equal bias frames at −10 °C, 2017", "sensors/sbig_stl1001_2017", "bias-Neg10-*", (), _CCD_FRAMES
    ),
    RealSet(
        "four equal darks of 60 s, 2017",
        "sensors/sbig_stl1001_2017",
        "darks-expos1-*",
        (
            Documented(
                "the first 0.72 to 0.81 DN above each of the others",
                ("first_frame_offset",),
                ("previous_frame", "timestamp_s"),
                _FRAMES,
            ),
        ),
        _CCD_DARKS,
    ),
)


def data_folder() -> Path | None:
    """Return the folder of real measurements next to the checkout or a folder above it; None where there is none."""
    for parent in Path(__file__).resolve().parents[1:]:
        if (parent / "shared" / "data" / "sensors").is_dir():
            return parent / "shared" / "data"
    return None
