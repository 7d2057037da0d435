"""Every effect that the generator hides is in the pixels, in the statistics that the catalogue names for it."""

import numpy as np
import pytest

from testing.generator.registry import ENTRIES, OUTSIDERS, VARIANTS
from testing.generator.session import Session, make_session
from testing.generator.statistics import blocks_of

Blocks = dict[str, tuple[np.ndarray, np.ndarray]]

# The statistics in which the catalogue says an entry shows; where nothing stands, in the mean.
SHOWS = {
    "dark_current_clamped": ("variance",),
    "dark_current_nonuniformity": ("spatial",),
    "conversion_gain_error": ("variance",),
    "excess_read_noise": ("variance",),
    "random_telegraph_noise": ("variance",),
    "tap_noise": ("variance",),
    "missing_codes": ("codes", "mean"),
    "reduced_bit_depth": ("codes", "mean"),
    "column_pattern": ("column",),
    "row_pattern": ("row",),
    "row_temporal_noise": ("flicker_row",),
    "correlated_read_noise": ("neighbour", "variance"),
    "dsnu": ("spatial",),
    "prnu": ("spatial",),
    "hot_pixels": ("spatial",),
    "image_lag": ("first",),
    "first_frame_offset": ("first",),
    "series_settling": ("first",),
    "brighter_fatter": ("variance",),
    "charge_transfer_inefficiency": ("neighbour_down",),
    "crosstalk": ("variance", "neighbour", "edge"),
    "shutter_dead_time": ("first", "mean"),
    "rolling_shutter_banding": ("flicker_row",),
    "psf_blur": ("edge",),
    "defocus": ("edge",),
    "pwm_flicker": ("common",),
    "mains_ripple": ("common",),
    "gamma_enabled": ("mean", "variance"),
    "full_well_saturation": ("mean", "variance"),
}
# This session against another shows it from twice its smallest realistic size only; a fit to a model sees more.
LARGER = {"brighter_fatter": 2.0}
# What must stay as it is: an effect that leaks into these is not the one that it claims to be.
QUIET = {
    "black_level_offset": ("variance", "neighbour", "common"),
    "dark_current_clamped": ("mean", "neighbour"),
    "conversion_gain_error": ("common", "neighbour"),
    "excess_read_noise": ("mean", "neighbour"),
    "charge_transfer_inefficiency": ("neighbour", "common", "flicker_row"),
    "prnu": ("neighbour", "common"),
    "correlated_read_noise": ("mean", "common"),
    "exposure_time_offset": ("spatial", "neighbour"),
    "row_temporal_noise": ("column",),
    "source_warmup_drift": ("common", "neighbour"),
    "veiling_glare": ("neighbour", "common"),
}

# Where another form of an effect, or one outside the catalogue, may show.
ANY = ("mean", "variance", "spatial", "first", "common", "edge", "column", "row", "flicker_row", "codes", "neighbour")


@pytest.fixture(scope="module")
def null_blocks(null_session: Session) -> Blocks:
    """Return the statistics of the session in which nothing is hidden."""
    return blocks_of(null_session)


@pytest.fixture(scope="module")
def short_null_blocks() -> Blocks:
    """Return the statistics of a session of few captures in which nothing is hidden."""
    return blocks_of(make_session(camera_seed=11, session_seed=5, plan="short"))


def _largest_change(hidden: Blocks, null: Blocks) -> float:
    return max(_change(hidden, null, block) for block in ANY)


def _change(hidden: Blocks, null: Blocks, block: str) -> float:
    """Return by how many sigmas a block differs from that of the same session with nothing hidden.

    The largest of five tests: that the differences are larger than noise one by one, summed per capture, summed
    per tile (row, column), that all lean to one side, and that they grow with the signal. Clipped captures are left
    out; they have no noise to compare with.
    """
    clipped = null["mean"][0].max(axis=1) > 3600
    if block in ("mean", "variance") and np.abs(hidden["mean"][0][clipped] - null["mean"][0][clipped]).max() > 20:
        clipped[:] = False  # the effect is at the clip itself
    (a, ua), (b, ub) = hidden[block], null[block]
    z = np.clip(((a - b) / (np.hypot(ua, ub) + 1e-9))[~clipped], -100, 100)
    sums = (z.ravel(), z.mean(axis=1) * np.sqrt(z.shape[1]), z.mean(axis=0) * np.sqrt(z.shape[0]))
    squares = [(np.sum(s**2) - s.size) / np.sqrt(2 * s.size) for s in sums]
    signal = np.maximum(null["mean"][0][~clipped] - 240, 0)
    along = abs(np.sum(z * signal) / np.sqrt(np.sum(signal**2))) if z.shape == signal.shape else 0.0
    return float(max(*squares, abs(z.mean()) * np.sqrt(z.size), along))


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n, h in {**ENTRIES, **OUTSIDERS}.items() if h.visible and h.plan == "rich"])
def test_hidden_effect_shows_where_the_catalogue_says(name: str, null_blocks: Blocks) -> None:
    """At its smallest realistic size (or as LARGER says) it changes its own statistics by more than five sigmas."""
    hidden = blocks_of(make_session(name, camera_seed=11, session_seed=5, scale=LARGER.get(name, 1.0)))
    for block in SHOWS.get(name, ("mean",) if name in ENTRIES else ()):
        assert _change(hidden, null_blocks, block) > 5, block
    if name not in ENTRIES:
        assert _largest_change(hidden, null_blocks) > 5


@pytest.mark.parametrize("name", [n for n, h in VARIANTS.items() if h.plan == "rich"])
def test_other_form_of_an_effect_shows(name: str, short_null_blocks: Blocks) -> None:
    """At twice its smallest realistic size it changes some statistic of a short session by more than five sigmas."""
    hidden = blocks_of(make_session(name, camera_seed=11, session_seed=5, scale=2.0, plan="short"))
    assert _largest_change(hidden, short_null_blocks) > 5


@pytest.mark.parametrize("name", sorted(QUIET))
def test_hidden_effect_leaves_other_statistics_alone(name: str, null_blocks: Blocks) -> None:
    """Statistics that the effect has no part in differ no more than two sessions of the same rig do."""
    hidden = blocks_of(make_session(name, camera_seed=11, session_seed=5, scale=1.0))
    for block in QUIET[name]:
        assert _change(hidden, null_blocks, block) < 5, block


def test_effect_outside_the_plan_changes_nothing_that_can_be_reported() -> None:
    """Polarisation with an unturned camera is one common factor: shapes and ratios stay."""
    a, b = (make_session(*names, camera_seed=3, session_seed=4) for names in (("polarisation",), ()))
    (mean_a, u_a), (mean_b, u_b) = blocks_of(a)["mean"], blocks_of(b)["mean"]
    use = (mean_b > 500) & (mean_b < 3500)
    ratio = (mean_a[use] - 240) / (mean_b[use] - 240)
    sigma = np.hypot(u_a[use], u_b[use]) / (mean_b[use] - 240)
    assert np.std((ratio - np.median(ratio)) / sigma) == pytest.approx(1, abs=0.15)
