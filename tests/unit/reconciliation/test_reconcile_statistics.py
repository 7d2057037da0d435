"""The statistics that reconcile reduces frames to, and the weights that it gives them."""

import dataclasses

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureHeader, Frame, FrameEntry, FrameSettings
from radiometer.errors import CaptureError
from radiometer.reconciliation.descent import converged_fit, first_state, fitted_parameters, refit
from radiometer.reconciliation.design import LINES, Design, PatchSides, group_captures, patch_sides, tile_groups
from radiometer.reconciliation.lines import RowBins, edge_shares
from radiometer.reconciliation.localise import localise, significant
from radiometer.reconciliation.reduce import CaptureSums, add_tiles, coarse_cells, reduce_frames
from radiometer.reconciliation.separability import limits
from radiometer.reconciliation.shared_errors import fixed_errors
from radiometer.reconciliation.state import LinearTerm, with_effects
from radiometer.reconciliation.statistics import usable_entries
from simulators.effects.black_level_drift import BlackLevelDrift
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.pixel_mixing import disc_edge_share
from simulators.effects.psf_blur import PsfBlur
from simulators.effects.row_pattern import RowPattern
from testing.reduced import start_of, statistics_of, taken


def _header(exposures):
    frames = tuple(FrameEntry(file=f"{i}.png", exposure_s=t) for i, t in enumerate(exposures))
    return CaptureHeader(camera=CameraDescription(bit_depth=12), frames=frames)


def test_neighbouring_frames_of_one_setting_are_one_capture():
    """A run of one exposure is a capture; a run twice the usual length is two."""
    captures = group_captures(_header([1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0]))
    assert [capture.frames for capture in captures] == [(0, 1), (2, 3), (4, 5), (6, 7)]


def test_interleaved_single_frames_are_gathered_by_setting():
    """Where no two neighbours share a setting, the repeats make the capture."""
    captures = group_captures(_header([1.0, 2.0, 1.0, 2.0]))
    assert [capture.frames for capture in captures] == [(0, 2), (1, 3)]


def test_a_patch_keeps_a_margin_and_lies_in_the_frame(make_capture):
    """From eight pixels on a tile is a pixel smaller on each side; a patch that does not fit names itself."""
    captured = make_capture(plan=[{"t": 1e-3}], frames=1)
    for side, kept in ((7, 7), (8, 6), (9, 7)):
        small = captured.header.patches[0].model_copy(update={"width": side, "height": side})
        header = captured.header.model_copy(update={"patches": (small,)})
        assert Design.of(header, captured.frames[0].shape).tiles[0].width == kept
    with pytest.raises(CaptureError, match=r"patch 'p05' .* is outside"):
        Design.of(captured.header, (64, 90))


def test_mean_and_variance_agree_with_numpy(make_capture):
    """Streaming sums give what all frames at once give."""
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


def test_a_histogram_cut_off_below_full_scale_is_not_compared():
    """Codes that a saturation of 900 DN removes are no missing codes of the converter; a dimmer capture's count."""
    rng = np.random.default_rng(12)
    frames = [
        Frame(np.minimum(rng.poisson(level, (96, 144)), 900).astype(np.uint16), 12, FrameSettings(level / 400.0))
        for level in (400.0, 890.0) for _ in range(4)
    ]  # fmt: skip
    state = start_of(taken(frames))
    counts = usable_entries(state.design, state.seen, state.prediction)["comb"]
    assert counts.any(axis=1).tolist() == [True, False]


def test_values_cut_off_below_full_scale_make_no_defects():
    """Noise cut off from 0 to 1.5 sigmas below its middle: what stays below the cut belongs to the tile's mean."""
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


def test_structure_of_an_unknown_scene_is_no_outlier():
    """Without patches a tile that holds a bright spot keeps it at every exposure: its mean grows with the exposure."""
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


def test_flicker_of_an_unknown_scene_is_no_noise_of_its_structure():
    """Light that all of a frame shares moves a bright spot more than its tile; noise and rows are those of photons."""
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


def test_frames_of_another_size_are_refused(make_capture):
    """The message names the frame and both sizes."""
    captured = make_capture(plan=[{"t": 3e-3}], frames=2)
    design = Design.of(captured.header, captured.frames[0].shape)
    smaller = Frame(captured.frames[1].dn[:-1], 12, captured.frames[1].settings)
    with pytest.raises(CaptureError, match="frame 1 is 96 × 63 pixels"):
        reduce_frames(design, [captured.frames[0], smaller].__getitem__)


@pytest.mark.slow
def test_repeatability_is_found(declared):
    """τ comes out at the 0.1 % that the lamp has, within the 99 % interval of 50 captures."""
    assert declared.tau == pytest.approx(1e-3, rel=0.3)


def test_noise_below_the_spacing_of_codes_makes_no_defects(make_capture):
    """Codes in steps of 4 over dark noise of 0.9 DN: a pixel at the neighbouring code is no outlier."""
    captured = make_capture(plan=[{"t": 1e-4, "shutter": "closed"}, {"t": 1.0, "shutter": "closed"}, {"t": 3e-3}])
    coarse = [dataclasses.replace(frame, dn=frame.dn - frame.dn % 4) for frame in captured.frames]
    design = Design.of(captured.header, coarse[0].shape)
    seen = statistics_of(dataclasses.replace(captured, frames=coarse))
    assert seen.outliers.tolist() == [0.0, 0.0, 0.0]
    assert seen.pixels.sum() == 3 * sum(tile.width * tile.height for tile in design.tiles)


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
def test_row_pattern_is_known_no_better_than_so_few_rows_allow(make_capture):
    """64 rows tell a standard deviation to 1/√128 at best: the reported one is no smaller, the truth within 3 of it."""
    sigma_e = 0.6
    rows = sigma_e * np.random.default_rng(11).standard_normal((64, 1))
    state = start_of(make_capture(extra_dn=lambda setting: rows / 2.6 * 10 ** (setting["g"] / 20)))
    found = converged_fit(refit(with_effects(state, [RowPattern(sigma_e)])))
    entry = fitted_parameters(found)["row_pattern"]["sigma_e"]
    assert entry.u / entry.value > 1.0 / np.sqrt(128.0)
    assert entry.value == pytest.approx(sigma_e, abs=3.0 * entry.u)


@pytest.mark.slow
def test_parameter_on_its_bound_hides_nothing(make_capture):
    """A drift with temperature cannot stand for a constant offset, however far its reference: the tests say so."""
    state = start_of(make_capture(extra_dn=lambda setting: 4.0))
    found = converged_fit(refit(with_effects(state, [BlackLevelDrift(0.1, -20.0)])))
    assert found.parameters.on_bounds()[0].any(), "the reference temperature runs to its bound"
    assert ("mean", "temperature_C") in {(test.block, test.where) for test in significant(localise(found))}


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


@pytest.mark.slow
def test_blur_that_moves_nothing_stands_still(make_capture):
    """A blur of a tenth of a pixel reaches no neighbour: the fit leaves it where it is and still finds the offset."""
    state = start_of(make_capture(extra_dn=lambda setting: 0.9))
    found = converged_fit(refit(with_effects(state, [PsfBlur(0.1), BlackLevelOffset(0.1)])))
    entry = fitted_parameters(found)["black_level_offset"]["offset_dn"]
    assert entry.value == pytest.approx(0.9, abs=3.0 * entry.u)
    assert found.effects[0] == PsfBlur(0.1)


@pytest.mark.slow
def test_no_number_of_captures_shows_a_blur_that_borders_feign(declared):
    """What makes borders unsharp by 0.05 % is the same in all pictures: five times that is the least that shows."""
    limit = limits(declared, {"psf_blur": PsfBlur})["psf_blur"].amplitude
    assert 5.0 * 5e-4 * 0.95 < np.exp(-0.5 / limit**2) < 5.0 * 5e-4 * 4.0


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
def test_a_second_frame_is_added(frame, form):
    """Sums of the same frame twice are twice those of once."""
    once, twice, good = _sums(), _sums(), np.ones(frame.shape, np.bool_)
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *once.values())
    for _ in range(2):
        form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *twice.values())
    for name in ("total", "square", "pair_x", "pair_y", "histogram"):
        assert twice[name] == pytest.approx(2 * once[name])


@BOTH
def test_numbers_are_counted_where_a_tile_is_whole_and_wide(frame, form):
    """Every number occurs; only the tile without clipped pixels, wider than the comb's limit, enters the histogram."""
    good = np.ones(frame.shape, np.bool_)
    wide, narrow = _sums(), _sums()
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 0.0, *wide.values())
    form(add_tiles)(frame, good, TOP, LEFT, FULL, 100.0, *narrow.values())
    both = [frame[y : y + HEIGHT, x : x + WIDTH] for y, x in zip(TOP, LEFT, strict=True)]
    assert np.flatnonzero(wide["occurring"]).tolist() == sorted({int(value) for tile in both for value in tile.flat})
    assert wide["histogram"].tolist() == np.bincount(both[1].ravel(), minlength=64).tolist()
    assert narrow["histogram"].sum() == 0


@BOTH
def test_a_tile_without_a_good_pixel_has_no_mean(frame, form):
    """No number stands where none was measured."""
    sums = _sums()
    mean, *_ = form(add_tiles)(frame, np.zeros(frame.shape, np.bool_), TOP, LEFT, FULL, 0.0, *sums.values())
    assert np.isnan(mean).all()


@BOTH
def test_cells_hold_mean_and_largest_value(frame, form):
    """Two by two pixels each; what is beyond the last whole cell is left out."""
    mean, largest = form(coarse_cells)(frame, 2, 3, 4)
    cells = frame[:6, :8].reshape(3, 2, 4, 2)
    assert mean == pytest.approx(cells.mean(axis=(1, 3)))
    assert largest == pytest.approx(cells.max(axis=(1, 3)))
