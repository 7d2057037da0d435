"""The statistics that reconcile reduces frames to, and the weights that it gives them."""

import dataclasses

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry, FrameSettings
from radiometer.errors import CaptureError
from radiometer.reconciliation.descent import converged_fit, first_state, fitted_parameters, is_misfit, refit
from radiometer.reconciliation.design import LINES, Design, PatchSides, group_captures, patch_sides, tile_groups
from radiometer.reconciliation.lines import RowBins, TileBands, edge_shares, wave_power
from radiometer.reconciliation.localise import localise, significant
from radiometer.reconciliation.reduce import CaptureSums, add_tiles, coarse_cells, reduce_frames
from radiometer.reconciliation.separability import limits
from radiometer.reconciliation.shared_errors import fixed_errors
from radiometer.reconciliation.state import LinearTerm, with_effects
from radiometer.reconciliation.statistics import usable_entries
from radiometer.reconciliation.verdict import place_of_scatter
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.pixel_mixing import disc_edge_share
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.row_pattern import RowPattern
from testing.reduced import start_of, statistics_of, taken


def _header(exposures):
    frames = tuple(FrameEntry(file=f"{i}.png", exposure_s=t) for i, t in enumerate(exposures))
    return CaptureHeader(camera=CameraDescription(bit_depth=12), frames=frames)


def test_frames_of_one_setting_are_gathered():
    """Neighbours as captures of the usual length, interleaved ones as repeats."""
    captures = group_captures(_header([1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0]))
    assert [capture.frames for capture in captures] == [(0, 1), (2, 3), (4, 5), (6, 7)]
    captures = group_captures(_header([1.0, 2.0, 1.0, 2.0]))
    assert [capture.frames for capture in captures] == [(0, 2), (1, 3)]


def test_patches_keep_a_margin_and_frames_one_size(make_capture):
    """A pixel on each side from eight on; what does not fit is named."""
    captured = make_capture(plan=[{"t": 1e-3}], frames=1)
    for side, kept in ((7, 7), (8, 6), (9, 7)):
        small = captured.header.patches[0].model_copy(update={"width": side, "height": side})
        header = captured.header.model_copy(update={"patches": (small,)})
        assert Design.of(header, captured.frames[0].shape).tiles[0].width == kept
    with pytest.raises(CaptureError, match=r"patch 'p05' .* is outside"):
        Design.of(captured.header, (64, 90))
    captured = make_capture(plan=[{"t": 3e-3}], frames=2)
    design = Design.of(captured.header, captured.frames[0].shape)
    smaller = Frame(captured.frames[1].dn[:-1], 12, captured.frames[1].settings)
    with pytest.raises(CaptureError, match="frame 1 is 96 × 63 pixels"):
        reduce_frames(design, [captured.frames[0], smaller].__getitem__)


def test_mean_and_variance_agree_with_numpy(make_capture):
    """Streaming sums are those of all frames; a neighbouring code in steps of 4 is no outlier."""
    captured = make_capture(plan=[{"t": 3e-3}], frames=5)
    design = Design.of(captured.header, captured.frames[0].shape)
    seen, _ = reduce_frames(design, captured.frames.__getitem__)
    tile = design.tiles[7]
    stack = np.stack([frame.dn[tile.slices] for frame in captured.frames]).astype(float)
    centred = stack - stack.mean(axis=(1, 2), keepdims=True)
    pixels = stack[0].size
    assert seen.mean[0, 7] == pytest.approx(stack.mean(), rel=1e-12)
    expected = centred.var(axis=0, ddof=1).sum() / (pixels - 1)
    assert seen.variance[0, 7] == pytest.approx(expected, rel=1e-9)
    captured = make_capture(plan=[{"t": 1e-4, "shutter": "closed"}, {"t": 1.0, "shutter": "closed"}, {"t": 3e-3}])
    coarse = [dataclasses.replace(frame, dn=frame.dn - frame.dn % 4) for frame in captured.frames]
    design = Design.of(captured.header, coarse[0].shape)
    seen = statistics_of(dataclasses.replace(captured, frames=coarse))
    assert seen.outliers.tolist() == [0.0, 0.0, 0.0]
    assert seen.pixels.sum() == 3 * sum(tile.width * tile.height for tile in design.tiles)


def test_dark_gap_before_a_bright_neighbour_is_no_blur():
    """A faint patch ends in a black gap two lines before a bright one: its sides tell nothing, the sharp ones do."""
    sharp = np.array([0.0, 0.0, 0.0, 0.0, -300.0, -300.0, 900.0])
    gap = np.array([0.0, 0.0, 0.0, 0.0, -9.0, -9.0, 900.0])
    lines = 1000.0 + np.array([[sharp, gap, gap]] * 4)
    index = np.zeros((3, LINES, 8), dtype=np.intp)
    tiles = np.full((4, 1), 1000.0)
    share, u = edge_shares(
        PatchSides(np.zeros(3, dtype=np.intp), index, index), lines, lines * 0, tiles, tiles * 0 + 1.0, tiles * 0,
        np.zeros(4, dtype=np.intp),
    )  # fmt: skip
    np.testing.assert_allclose(share, 0.0, atol=1e-12)
    assert np.isfinite(u).all()


def test_sharpest_stop_shows_where_borders_lie():
    """Borders before a gap of four lines: at f/4 a disc of 2.26 px hides them, at f/11 one of 0.82 px does not.

    The share at f/4 is that of the disc then; a pattern that is seen at f/4 alone shows nothing.
    """
    scene = np.array([0.0] * 12 + [-300.0] * 4 + [400.0] * 10)

    def seen(radius):
        place = (np.arange(9 * 40) + 0.5) / 40 - 4.5
        disc = np.sqrt(np.maximum(radius**2 - place**2, 0.0)).reshape(9, 40).sum(axis=1)
        return np.convolve(scene, disc / disc.sum(), mode="same")[7 : 7 + LINES]

    radius = np.array([2.26] * 10 + [0.82] * 2 + [2.26] * 3)
    lines = 1000.0 + np.array([[seen(r)] * 3 for r in radius.tolist()])
    index = np.zeros((3, LINES, 8), dtype=np.intp)
    tiles = np.full((15, 1), 1000.0)
    share, u = edge_shares(
        PatchSides(np.zeros(3, dtype=np.intp), index, index), lines, lines * 0, tiles, tiles * 0 + 1.0, tiles * 0,
        np.array([0] * 12 + [1] * 3), np.where(radius > 2, 4.0, 11.0),
    )  # fmt: skip
    np.testing.assert_allclose(share[:12], disc_edge_share(radius[:12]), atol=0.02)
    assert np.isfinite(u[:12]).all()
    assert np.isinf(u[12:]).all()


def test_hot_and_unsteady_pixels_of_a_dark_are_left_out_everywhere():
    """A defect of 3000 DN, one of ±60 DN and a hit of 20 DN move no mean and no noise.

    The first two count in the dark, not the hit, which one frame holds. A scene is uneven.
    """
    rng = np.random.default_rng(3)
    frames = []
    for light in (500, 64):
        for number, sign in enumerate((1, -1, 1, -1)):
            dn = np.rint(rng.normal(light, 2, (48, 72))).astype(np.int64)
            dn[20, 30] += 3000
            dn[40, 50] += 60 * sign
            dn[10, 10] += 20 * (number == 2 and light == 64)
            frames.append(
                Frame(dn.astype(np.uint16), 12, FrameSettings(0.1, shutter="open" if light > 64 else "closed"))
            )
    seen = statistics_of(taken(frames))
    noise = 2.0**2 + 1.0 / 12.0  # of 144 pixels, in four frames
    np.testing.assert_allclose(seen.mean[0], 500, atol=5 * np.sqrt(noise / 4 / 144))
    np.testing.assert_allclose(seen.variance, noise, rtol=5 * np.sqrt(2 / 3 / 144))
    assert seen.outliers.tolist() == [0.0, 1.0]
    assert seen.unsteady.tolist() == [0.0, 1.0]


def test_what_ends_below_full_scale_is_neither_comb_nor_defect():
    """A saturation of 900 DN removes codes; noise cut off belongs to the mean."""
    rng = np.random.default_rng(12)
    frames = [
        Frame(np.minimum(rng.poisson(level, (96, 144)), 900).astype(np.uint16), 12, FrameSettings(level / 400.0))
        for level in (400.0, 890.0) for _ in range(4)
    ]  # fmt: skip
    state = start_of(taken(frames))
    counts = usable_entries(state.design, state.seen, state.prediction)["comb"]
    assert counts.any(axis=1).tolist() == [True, False]
    rng = np.random.default_rng(9)
    cuts = [500.0 - share * 20.0 for share in (0.0, 0.5, 0.8, 1.0, 1.2, 1.5)]
    frames = [
        Frame(np.rint(np.minimum(rng.normal(500, 20, (48, 72)), cut)).astype(np.uint16), 12,
              FrameSettings(0.1 * (1 + number), shutter="closed"))
        for number, cut in enumerate(cuts) for _ in range(4)
    ]  # fmt: skip
    seen = statistics_of(taken(frames))
    assert seen.outliers.max() <= 10  # of 3456 pixels; a plain robust sigma takes 550 for defects
    assert float(seen.mean.mean()) == pytest.approx(float(np.mean([frame.dn for frame in frames])), abs=0.05)


def test_structure_and_flicker_of_an_unknown_scene_are_no_outlier_nor_noise():
    """A bright spot grows with the exposure and moves with the light."""
    rng = np.random.default_rng(4)
    scene = np.full((48, 72), 100.0)
    scene[2:5, 2:5] = 900.0
    frames = [
        Frame(np.rint(rng.poisson(scene * t) + 64.0).astype(np.uint16), 12, FrameSettings(t)) for t in (0.5, 1.0, 2.0)
    ]
    seen = statistics_of(taken(frames))
    expected = scene[:12, :12].mean()
    sigma = np.sqrt(expected * 2.0 / 144)
    np.testing.assert_allclose(seen.mean[:, 0] - 64.0, expected * np.array([0.5, 1.0, 2.0]), atol=5 * sigma)
    rng = np.random.default_rng(6)
    scene = np.full((96, 144), 200.0)
    scene[8:18, 5:20] = 2000.0  # in the first tile of 24 × 24
    flicker = 1.0 + 0.04 * rng.standard_normal(8)
    frames = [Frame(rng.poisson(scene * f).astype(np.uint16), 12, FrameSettings(1.0)) for f in flicker]
    seen = statistics_of(taken(frames, black_level_dn=0.0))
    photons = scene[:24, :24].ravel()
    sigma = np.sqrt(2.0 * np.sum(photons**2) / 7) / photons.size
    assert seen.variance[0, 0] == pytest.approx(photons.mean(), abs=5 * sigma)
    uneven = np.mean(photons**2) / photons.mean() ** 2
    assert seen.row_temporal[0] == pytest.approx(1.0, abs=5 * np.sqrt(2.0 * uneven / seen.row_temporal_dof[0]))


def test_uneven_tile_at_the_top_of_a_scene_does_not_count():
    """Part of it may be saturated and part not; an even tile that is saturated whole does count."""
    rng = np.random.default_rng(8)
    scene = np.full((96, 144), 300.0)
    scene[4:20, 4:20] = 3000.0  # in the first tile of 24 × 24
    scene[24:48, :24] = 3000.0  # the whole tile below it
    frames = [
        Frame(np.minimum(rng.poisson(scene * t), 2500).astype(np.uint16), 12, FrameSettings(t))
        for t in (0.5, 0.5, 1.0, 1.0)
    ]
    state = start_of(taken(frames, black_level_dn=0.0, conversion_gain_e_per_dn=1.0, read_noise_e=1.0))
    uneven, even = 0, 6
    assert state.comparison.usable["mean"][:, uneven].tolist() == [True, False]
    assert state.comparison.usable["mean"][:, even].tolist() == [True, True]


def test_rows_alone_move_the_tiles_of_a_grid_as_one():
    """Tiles side by side share all rows: the covariance of their means has no more ranks than rows of tiles."""
    rng = np.random.default_rng(9)
    lit = [Frame(rng.poisson(300.0, (96, 144)).astype(np.uint16) + 64, 12, FrameSettings(1.0)) for _ in range(2)]
    noise = np.rint(rng.normal(64.0, 1.0, (2, 96, 144))).astype(np.uint16)
    frames = lit + [Frame(dn, 12, FrameSettings(1.0, shutter="closed")) for dn in noise]
    entries = tuple(FrameEntry.of(f"{i}.png", frame.settings) for i, frame in enumerate(frames))
    camera = CameraDescription(bit_depth=12, black_level_dn=64.0, conversion_gain_e_per_dn=1.0, read_noise_e=1.0)
    design = Design.of(CaptureHeader(camera=camera, frames=entries), (96, 144))
    state = first_state(design, *reduce_frames(design, frames.__getitem__))
    model = with_effects(state, [RowPattern(sigma_e=3.0)])
    terms = fixed_errors(model.effects, model.prediction, state.seen, design, state.model.context)
    moved = next(term for term in terms if term.name == "additive pattern: mean")
    columns = LinearTerm.of(moved).build(state.comparison, model.prediction, state.sensitivity)
    large = np.linalg.svd(columns, compute_uv=False)
    assert np.sum(large > 1e-2 * large[0]) == 4


@pytest.mark.slow
def test_captures_show_repeatability_but_no_blur_that_borders_feign(declared):
    """τ of 0.1 % within its interval; five times 0.05 % is the least."""
    assert declared.tau == pytest.approx(1e-3, rel=0.3)
    limit = limits(declared, {"psf_blur": PsfBlur})["psf_blur"].amplitude
    assert 5.0 * 5e-4 * 0.95 < np.exp(-0.5 / limit**2) < 5.0 * 5e-4 * 4.0


def test_masked_pixels_leave_row_and_column_ratios_at_one(make_capture):
    """A fifth of all pixels is masked: the mean of 3 × 12 ratios of line means is 1 within 4 sigma."""
    captured = make_capture(plan=[{"t": 1e-4, "shutter": "closed", "g": 12.0}] * 12)
    design = Design.of(captured.header, captured.frames[0].shape)
    groups, sides = tile_groups(design), patch_sides(design)
    masked = np.random.default_rng(3).random(design.shape) < 0.2
    ratios, u_rel = [], []
    for capture in design.captures:
        sums = CaptureSums.start(groups, sides, len(design.tiles), masked)
        for index in capture.frames:
            sums.add(captured.frames[index])
        found, _ = sums.finish(64.0, RowBins.of(design))
        for name in ("row_temporal", "rows", "columns"):
            ratios.append(found[name])
            u_rel.append(2.0 / found[f"{name}_dof"])
    sigma = float(np.sqrt(np.mean(u_rel) / len(ratios)))
    assert np.mean(ratios) == pytest.approx(1.0, abs=4.0 * sigma)


@pytest.mark.slow
def test_few_rows_and_what_stands_still_tell_no_more_than_they_can(make_capture):
    """64 rows to 1/√128; a drift on its bound hides no offset."""
    sigma_e = 0.6
    rows = sigma_e * np.random.default_rng(11).standard_normal((64, 1))
    state = start_of(make_capture(extra_dn=lambda setting: rows / 2.6 * 10 ** (setting["g"] / 20)))
    found = converged_fit(refit(with_effects(state, [RowPattern(sigma_e)])))
    entry = fitted_parameters(found)["row_pattern"]["sigma_e"]
    assert entry.u / entry.value > 1.0 / np.sqrt(128.0)
    assert entry.value == pytest.approx(sigma_e, abs=3.0 * entry.u)
    state = start_of(make_capture(extra_dn=lambda setting: 4.0))
    found = converged_fit(refit(with_effects(state, [BlackLevelDrift(0.1, -20.0)])))
    assert found.parameters.on_bounds()[0].any(), "the reference temperature runs to its bound"
    assert ("mean", "temperature_C") in {(test.block, test.where) for test in significant(localise(found))}
    state = start_of(make_capture(extra_dn=lambda setting: 0.9))
    found = converged_fit(refit(with_effects(state, [PsfBlur(0.1), BlackLevelOffset(0.1)])))
    entry = fitted_parameters(found)["black_level_offset"]["offset_dn"]
    assert entry.value == pytest.approx(0.9, abs=3.0 * entry.u)
    assert found.effects[0] == PsfBlur(0.1)


@pytest.mark.slow
def test_source_of_unknown_reproducibility_may_wander(make_capture):
    """Light that differs by 0.3 % from frame to frame at all exposures: taken up where nothing is stated, else seen."""
    rng = np.random.default_rng(21)
    plan = [{"t": float(t)} for t in np.geomspace(1e-4, 6e-3, 12) for _ in range(3)]
    captured = make_capture(plan=plan, picture=lambda image, setting: image * (1.0 + 0.003 * rng.standard_normal()))
    stated = start_of(captured)
    source = captured.header.source.model_copy(update={"reproducibility_u_rel": None})
    header = captured.header.model_copy(update={"source": source})
    unstated = start_of(dataclasses.replace(captured, header=header))
    assert "common" in {test.block for test in significant(localise(stated))}
    assert "common" not in {test.block for test in significant(localise(unstated))}
    freedom = 2 * len(plan)  # of four frames the first has a statistic of its own
    assert np.sqrt(unstated.comparison.wander2) == pytest.approx(0.003, rel=4.0 / np.sqrt(2.0 * freedom))


# The pass over a frame's tiles, compiled and as it is written.


TOP, LEFT, HEIGHT, WIDTH = np.array([0, 2]), np.array([1, 5]), 4, 3
FULL = 40.0


def _written(function):
    """Return a compiled function as its source says it."""
    return getattr(function, "py_func", function)


def _sums():
    tiles = {name: np.zeros((2, HEIGHT, WIDTH)) for name in ("total", "square", "highest", "pair_x", "pair_y")}
    return {**tiles, "histogram": np.zeros(64), "occurring": np.zeros(64, np.bool_)}


@pytest.fixture
def frame():
    """Return a frame whose first tile holds a 0 and a clipped value, the second neither."""
    dn = np.random.default_rng(4).integers(10, 30, (7, 9)).astype(np.uint16)
    dn[1, 2], dn[3, 1] = 0, 41
    return dn


BOTH = pytest.mark.parametrize("form", [lambda function: function, _written], ids=["compiled", "as written"])


@BOTH
def test_sums_of_tiles_are_those_of_their_pixels(frame, form):
    """Mean over good pixels, shares at 0 and clipped, deviations, squares, products with neighbours, row sums."""
    good = np.ones(frame.shape, np.bool_)
    good[3, 5] = False
    sums = _sums()
    mean, low, high, rows = form(add_tiles)(frame, good, TOP, LEFT, FULL, 100.0, *sums.values())
    assert low.tolist() == pytest.approx([1 / 12, 0.0])
    assert high.tolist() == pytest.approx([1 / 12, 0.0])
    for k, (y, x) in enumerate(zip(TOP, LEFT, strict=True)):
        place = np.s_[y : y + HEIGHT, x : x + WIDTH]
        tile, counts = frame[place].astype(float), good[place]
        assert mean[k] == pytest.approx(tile[counts].mean())
        deviation = tile - tile[counts].mean()
        assert sums["total"][k] == pytest.approx(deviation)
        assert sums["square"][k] == pytest.approx(deviation**2)
        assert sums["highest"][k] == pytest.approx(np.maximum(deviation, 0.0))
        assert sums["pair_x"][k][:, 1:] == pytest.approx(deviation[:, 1:] * deviation[:, :-1])
        assert sums["pair_x"][k][:, 0].tolist() == [0.0] * HEIGHT
        assert sums["pair_y"][k][1:] == pytest.approx(deviation[1:] * deviation[:-1])
        assert sums["pair_y"][k][0].tolist() == [0.0] * WIDTH
        assert rows[k] == pytest.approx((deviation * counts).sum(axis=1))


@BOTH
def test_sums_count_each_frame_and_whole_tiles(frame, form):
    """A second frame doubles them; every number where a tile is whole and wide; else no mean."""
    once, twice, good = _sums(), _sums(), np.ones(frame.shape, np.bool_)
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *once.values())
    for _ in range(2):
        form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *twice.values())
    for name in ("total", "square", "pair_x", "pair_y", "histogram"):
        assert twice[name] == pytest.approx(2 * once[name])
    good = np.ones(frame.shape, np.bool_)
    wide, narrow = _sums(), _sums()
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *wide.values())
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 100.0, *narrow.values())
    both = [frame[y : y + HEIGHT, x : x + WIDTH] for y, x in zip(TOP, LEFT, strict=True)]
    assert np.flatnonzero(wide["occurring"]).tolist() == sorted({int(value) for tile in both for value in tile.flat})
    assert wide["histogram"].tolist() == np.bincount(both[1].ravel(), minlength=64).tolist()
    assert narrow["histogram"].sum() == 0
    sums = _sums()
    mean, *_ = form(add_tiles)(frame, np.zeros(frame.shape, np.bool_), TOP, LEFT, FULL, 0.0, *sums.values())
    assert np.isnan(mean).all()
    mean, largest = form(coarse_cells)(frame, 2, 3, 4)
    cells = frame[:6, :8].reshape(3, 2, 4, 2)
    assert mean == pytest.approx(cells.mean(axis=(1, 3)))
    assert largest == pytest.approx(cells.max(axis=(1, 3)))


# Bands of a rolling shutter: their statistic, what they leave in tiles, and scatter that no trend explains.


PERIODS_PER_ROW = 0.0217
AMPLITUDE = 0.01


def _bands(seed, periods_per_row):
    """Return what a wave along the rows does to each frame's picture, at a phase of its own."""
    rng = np.random.default_rng(seed)

    def picture(image, setting):
        rows = np.arange(image.shape[0])[:, None]
        phase = rng.uniform(0, 2 * np.pi)
        return image * (1 + AMPLITUDE * np.sin(2 * np.pi * periods_per_row * rows + phase))

    return picture


def _one_after_the_other(captures):
    """Return exposures that differ a little, so that each has a capture of its own."""
    return [{"t": 3e-3 + 1e-5 * number} for number in range(captures)]


def test_bands_have_the_power_that_a_wave_predicts(make_capture):
    """1 + A²/2·|z|² within 4 sigma of the phases; without them noise, in whole bins."""
    captured = make_capture(plan=_one_after_the_other(24), picture=_bands(5, PERIODS_PER_ROW), seed=5)
    design = Design.of(captured.header, captured.frames[0].shape)
    seen, _ = reduce_frames(design, captured.frames.__getitem__)
    power, common = wave_power(RowBins.of(design), seen.bands_basis, PERIODS_PER_ROW)
    measured = np.nansum(seen.bands, axis=1)
    expected = np.sum(np.where(np.isfinite(seen.bands), 1 + AMPLITUDE**2 / 2 * power, 0.0), axis=1)
    assert expected.min() > 10 * seen.bands.shape[1]
    ratio = measured / expected
    assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std(ddof=1) / np.sqrt(ratio.size))
    shared = seen.common * seen.common_unit / (AMPLITUDE**2 / 2 * common)
    assert shared.mean() == pytest.approx(1.0, abs=4 * shared.std(ddof=1) / np.sqrt(shared.size))
    captured = make_capture(plan=[*_one_after_the_other(24), {"t": 1e-3, "shutter": "closed"}], seed=4)
    seen = statistics_of(captured)
    lit = np.isfinite(seen.bands)
    assert lit.sum(axis=1).max() > 10
    assert np.mean(seen.bands[lit]) == pytest.approx(1.0, abs=4 * np.sqrt(1.0 / lit.sum()))
    captured = make_capture(plan=[{"t": 3e-3}], frames=1)
    small = Design.of(captured.header, captured.frames[0].shape)
    tiles = [dataclasses.replace(small.tiles[0], y=10, height=height) for height in (22, 23)]
    ending, reaching = (RowBins.of(dataclasses.replace(small, shape=(480, 96), tiles=(tile,))) for tile in tiles)
    assert (ending.step, ending.number, ending.orders) == (2, 240, 3)
    assert reaching.orders == 4
    np.testing.assert_array_equal(ending.middle[:3], [0.5, 2.5, 4.5])


def test_a_tile_keeps_of_a_wave_what_random_phases_show(make_capture):
    """Mean, rise, spread and neighbours of a tile's rows over 20 000 phases, against the closed forms."""
    captured = make_capture(plan=[{"t": 3e-3}])
    design = Design.of(captured.header, captured.frames[0].shape)
    left = TileBands.of(design, PERIODS_PER_ROW)
    height = design.tiles[0].height
    phases = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)[:, None]
    y = np.arange(height) - (height - 1) / 2
    waves = np.sqrt(2.0) * np.cos(2 * np.pi * PERIODS_PER_ROW * y + phases)
    fitted = np.polynomial.polynomial.polyfit(y / (height / 2), waves.T, 1)
    quadratic = np.polynomial.polynomial.polyfit(y, waves.T, 2)
    rough = waves - np.polynomial.polynomial.polyval(y, quadratic)
    inside = waves - waves.mean(axis=1, keepdims=True)
    assert left.mean[0] ** 2 == pytest.approx(np.mean(waves.mean(axis=1) ** 2), rel=1e-6)
    assert left.rise[0] ** 2 == pytest.approx(np.mean(fitted[1] ** 2), rel=1e-6)
    assert left.within[0] == pytest.approx(np.mean(inside**2), rel=1e-6)
    assert left.rough[0] == pytest.approx(np.mean(rough**2), rel=1e-6)
    assert left.lag[0] == pytest.approx(np.mean(inside[:, 1:] * inside[:, :-1]), rel=1e-6)


@pytest.mark.slow
def test_bands_flicker_and_scatter_show_in_statistics_of_their_own(make_capture):
    """A flicker that rows share leaves no bands; 0.5 % from frame to frame shows in means."""
    plan = [{"t": t, "d": d} for t in (1e-3, 2e-3, 3e-3) for d in (0.5, 0.9) for _ in range(3)]
    banded = significant(localise(start_of(make_capture(plan=plan, picture=_bands(6, PERIODS_PER_ROW), seed=6))))
    assert banded[0].block == "bands"
    shaken = {test.block for test in significant(localise(start_of(make_capture(plan=plan, picture=_bands(7, 0.0)))))}
    assert "common" in shaken
    assert "bands" not in shaken
    rng = np.random.default_rng(9)

    def uneasy(image, setting):
        height, width = image.shape
        patches = 1 + 0.005 * rng.standard_normal((4, 6))
        return image * np.kron(patches, np.ones((height // 4, width // 6)))

    plan = [{"t": t, "d": d} for t in (1e-3, 2e-3, 4e-3) for d in (0.3, 0.5, 0.9) for _ in range(3)]
    calm, restless = (start_of(make_capture(plan=plan, seed=8, **hidden)) for hidden in ({}, {"picture": uneasy}))
    assert not is_misfit(calm)
    assert is_misfit(restless)
    assert place_of_scatter(restless, localise(restless))[0] in ("mean", "first", "bands")
