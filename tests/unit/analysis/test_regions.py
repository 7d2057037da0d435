"""Figures of regions of a map, and the glare indices UGR and DGP by their own figures."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

import radiometer as rm
from radiometer.analysis.exports.maps import MapPicture, read_tiff, write_tiff
from radiometer.analysis.regions import glare_of, profile, ratio_of, region_figures, vertical_illuminance
from radiometer.data import Patch, PixelMask, Provenance, RadianceMap
from radiometer.errors import InputError, MeasurementError, MissingLibrary, UsageError


def map_of(values: np.ndarray, u: float = 0.01, common: float = 0.02, unit: str = "cd m-2") -> RadianceMap:
    """Return a map with the same uncertainty everywhere."""
    value = np.asarray(values, dtype=np.float32)
    return RadianceMap(value, np.full_like(value, u), np.zeros(value.shape, np.uint8), unit, common)


def test_mean_and_uniformity_are_those_by_hand():
    """Of a ramp; even light that is dim is uniform, and what all pixels share drops out of a contrast."""
    ramp = np.tile(np.linspace(1.0, 2.0, 101), (40, 1))
    found = region_figures(map_of(ramp, u=1e-6), "ramp", Patch(0, 0, 101, 40), box_px=1)
    assert found.mean.value == pytest.approx(1.5)
    assert found.mean.u == pytest.approx(0.02 * 1.5, rel=1e-3)
    assert found.uniformity.value == pytest.approx(0.5, rel=1e-5)
    assert found.deviation.value == pytest.approx(np.std(np.linspace(1, 2, 101)), rel=1e-2)
    rng, even = np.random.default_rng(28), np.ones((60, 80))
    for _ in range(10):
        seen = map_of(even + rng.normal(0.0, 0.4, even.shape), u=0.4)
        found = region_figures(seen, "even", Patch(0, 0, 80, 60)).uniformity
        assert abs(found.value - 1.0) <= 2.0 * found.u < 0.6
    values = np.full((20, 40), 100.0)
    values[:, 20:] = 4.0
    found = map_of(values, u=0.04, common=0.05)
    bright, dark = (region_figures(found, name, Patch(x, 0, 20, 20)) for name, x in (("bright", 0), ("dark", 20)))
    ratio = ratio_of(bright, dark, 0.05)
    assert ratio.value == pytest.approx(25.0)
    assert ratio.u == pytest.approx(25.0 * math.hypot(0.04 / 20 / 100, 0.04 / 20 / 4), rel=0.05)


def test_a_map_in_another_unit_has_the_same_figures_in_it():
    """In units 1024 times as large all figures and their u are so much smaller; ratios and their u stay."""
    ramp, factor = np.tile(np.linspace(1.0, 2.0, 60), (50, 1)), 2.0**-10
    one, other = (region_figures(map_of(f * ramp, u=f * 0.05), "x", Patch(0, 0, 60, 50)) for f in (1.0, factor))
    for name, scale in {
        "mean": factor,
        "median": factor,
        "lowest": factor,
        "highest": factor,
        "uniformity": 1.0,
    }.items():
        expected, found = getattr(one, name), getattr(other, name)
        assert (found.value, found.u) == pytest.approx((scale * expected.value, scale * expected.u)), name


def test_profiles_and_drawn_noise_have_their_uncertainty():
    """Noise averages over the width of a profile."""
    rng = np.random.default_rng(46_003)
    truth = 5.0 + np.tile(np.linspace(0.0, 0.4, 60), (50, 1))
    exact = region_figures(map_of(truth, u=1e-9, common=0.0), "x", Patch(0, 0, 60, 50))
    inside = dict.fromkeys(("mean", "median", "lowest", "highest", "uniformity", "deviation"), 0)
    for _ in range(100):
        scale = 1.0 + 0.02 * rng.standard_normal()
        found = region_figures(map_of(scale * truth + rng.normal(0, 0.2, truth.shape), u=0.2), "x", Patch(0, 0, 60, 50))
        for name in inside:
            one, right = getattr(found, name), getattr(exact, name).value
            inside[name] += abs(one.value - right) <= 2.0 * one.u
    assert min(inside.values()) >= 91, inside
    found = map_of(np.tile(np.arange(50.0), (30, 1)), u=0.3, common=0.0)
    distance, value, u = profile(found, (5.0, 10.0), (25.0, 10.0), 9)
    assert value == pytest.approx(5.0 + distance)
    assert u == pytest.approx(np.full(21, 0.1), rel=1e-3)


@pytest.mark.parametrize("camera", [0.0, 0.005, 0.01])
@pytest.mark.parametrize("scene", [0.0, 0.005, 0.02])
def test_a_deviation_holds_whatever_pattern_the_camera_has(camera, scene):
    """Pixels that may differ by 1 %, and do by 0 to 1 %: the scene's own unevenness is within U, which is no more."""
    rng = np.random.default_rng(2_438_001)
    even, u = np.full((80, 100), 5.0), math.hypot(0.02, 0.05)
    light = even * (1.0 + scene * rng.standard_normal(even.shape))
    seen = light * (1.0 + camera * rng.standard_normal(even.shape)) + rng.normal(0.0, 0.02, even.shape)
    found = region_figures(replace(map_of(seen, u=u), u_rel_pattern=0.01), "x", Patch(0, 0, 100, 80)).deviation
    assert abs(found.value - light.std()) <= 2.0 * found.u <= 1.2 * 5.0 * math.hypot(camera, 0.01) + 0.04 * found.value


@pytest.mark.parametrize("sigmas", [0.0, 1.0, 2.0, 3.0])
def test_near_the_noise_a_mean_is_not_that_of_the_pixels_that_noise_made_brighter(sigmas):
    """Of light of some σ, with every pixel below 2σ marked as merge marks it, mean and median hold 95 % of the time."""
    rng = np.random.default_rng(45_021)
    inside = dict.fromkeys(("mean", "median", "lowest", "highest"), 0)
    for _ in range(100):
        found = map_of(rng.normal(sigmas, 1.0, (20, 30)), u=1.0, common=0.0)
        found.mask[found.radiance < 2.0] = PixelMask.BELOW_NOISE
        figures = region_figures(found, "dim", Patch(0, 0, 30, 20))
        for name in inside:
            one = getattr(figures, name)
            inside[name] += abs(one.value - sigmas) <= 2.0 * one.u
    assert min(inside.values()) >= 89, inside


def test_dim_light_counts_as_bounds():
    """Pixels black in every frame, and light outside the response's data: from nothing to its value."""
    found = map_of(np.full((10, 10), 5.0), u=0.05, common=0.0)
    found.radiance[:3] = found.u_radiance[:3] = 0.6
    found.mask[:3] = PixelMask.BELOW_NOISE
    figures = region_figures(found, "x", Patch(0, 0, 10, 10))
    assert figures.mean.u == pytest.approx(0.3 * 0.6 / math.sqrt(3.0), rel=0.2)
    assert "upper bounds" in figures.flags[0]
    assert "30 of 100 pixels" in figures.flags[0]
    found = map_of(np.full((10, 10), 2.0), u=7.0, common=0.0)
    found.mask[:] = PixelMask.BELOW_NOISE | PixelMask.EXTRAPOLATED
    figures = region_figures(found, "x", Patch(0, 0, 10, 10))
    assert figures.mean.u == pytest.approx(math.hypot(0.7, 2.0 / math.sqrt(3.0)), rel=0.02)
    assert not any("black" in flag for flag in figures.flags)


@pytest.mark.parametrize("part", [PixelMask.EXTRAPOLATED, PixelMask.INCONSISTENT, PixelMask.MOVED])
def test_a_region_says_how_many_of_its_pixels_are_in_doubt(part):
    """Outside the response, or of frames that disagree: of 99 in 100 pixels it says 99 of 100, without any nothing."""
    found = map_of(np.full((10, 10), 5.0))
    assert region_figures(found, "x", Patch(0, 0, 10, 10)).flags == ()
    found.mask.ravel()[1:] = part
    (flag,) = region_figures(found, "x", Patch(0, 0, 10, 10)).flags
    assert flag.startswith(f"{part.name.lower()}: ")
    assert "99 of 100 pixels" in flag


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "stereographic", "orthographic"])
def test_an_even_hemisphere_gives_pi_times_its_luminance(projection):
    """An even hemisphere gives π times its luminance."""
    found = map_of(np.full((401, 401), 50.0))
    lux = vertical_illuminance(found, projection, 180.0, 0.0, None)
    assert lux.value == pytest.approx(math.pi * 50.0, rel=0.006)
    assert (lux.unit, lux.u) == ("lx", pytest.approx(0.02 * lux.value, rel=0.02))


@pytest.mark.parametrize(("field_deg", "radius_px"), [(150.0, None), (180.0, 240.0)])
def test_a_picture_of_a_part_of_the_hemisphere_has_no_illuminance(field_deg, radius_px):
    """Light from beyond a narrow lens, or beyond the edges of the picture, is in no sum."""
    with pytest.raises(MeasurementError, match="of the hemisphere"):
        vertical_illuminance(map_of(np.full((401, 401), 50.0)), "equidistant", field_deg, 0.0, radius_px)


def test_saturated_and_missing_pixels_are_refused_and_sources_measured():
    """A small one on the axis and off it."""
    values = np.zeros((401, 401))
    values[200, 200] = values[200, 300] = 1000.0  # on the axis, and at 45° of an equidistant lens of 180°
    per_area = (math.pi / 2.0) ** 2 / 200.5**2
    by_hand = 1000.0 * per_area * (1.0 + math.cos(100 / 200.5 * math.pi / 2) * np.sinc(100 / 200.5 / 2.0))
    assert vertical_illuminance(map_of(values), "equidistant", 180.0, 0.0, None).value == pytest.approx(
        by_hand, rel=1e-3
    )
    found = map_of(np.full((10, 10), 3.0))
    found.mask[0, 0] = PixelMask.SATURATED
    assert "saturated" in region_figures(found, "x", Patch(0, 0, 10, 10)).flags[0]
    found.mask[:6] = PixelMask.UNLIT | PixelMask.BELOW_NOISE
    with pytest.raises(MeasurementError, match="40 %"):
        region_figures(found, "x", Patch(0, 0, 10, 10))
    found.mask[5, 5] = PixelMask.SATURATED
    with pytest.raises(MeasurementError, match="saturated"):
        vertical_illuminance(found, "equisolid", 180.0, 0.0, None)


@pytest.mark.parametrize(
    ("start", "end"), [((5.0, 20.0), (35.0, 4.0)), ((35.0, 4.0), (5.0, 20.0)), ((7.5, 2.0), (7.5, 25.5))]
)
def test_a_profile_goes_in_equal_steps_from_its_start_to_its_end(start, end):
    """Over a plane 1 + 2x + 3y: distances from 0 to the length, at most a pixel apart, and the plane's own values."""
    y, x = np.indices((30, 40))
    distance, value, _ = profile(map_of(1.0 + 2.0 * x + 3.0 * y), start, end)
    length = math.dist(start, end)
    assert distance == pytest.approx(np.linspace(0.0, length, math.ceil(length) + 1))
    ends = [1.0 + 2.0 * one[0] + 3.0 * one[1] for one in (start, end)]
    assert value == pytest.approx(ends[0] + (ends[1] - ends[0]) * distance / length)


def test_a_written_map_is_analysed_as_the_map(tmp_path):
    """A written map is analysed as the map."""
    taken = {"camera": "FLIR BFS-U3-19S4M 22500001", "taken": "2026-11-21 12:00:00"}
    made = Provenance("merge", parameters={"origin": taken}, created="2026-11-22T08:00:00Z")
    values = np.random.default_rng(1).uniform(1, 2, (30, 40))
    found = replace(map_of(values, unit="W sr-1 m-2"), provenance=made)
    write_tiff(tmp_path / "map.tiff", MapPicture({"mono": found}))
    again = read_tiff(tmp_path / "map.tiff").first
    assert np.array_equal(again.radiance, found.radiance)
    report = rm.analyse(tmp_path / "map.tiff", regions={"a": (2, 3, 10, 10)}, line=(0, 0, 9, 9))
    assert report.regions[0].mean.value == region_figures(found, "a", Patch(2, 3, 10, 10)).mean.value
    report.write_csv(tmp_path / "figures.csv")
    lines = (tmp_path / "figures.csv").read_text().splitlines()
    assert lines[1].startswith("a,mean,1.")
    along = [line.split(",") for line in lines if line.startswith(",profile,")]
    assert [float(row[2]) for row in along] == pytest.approx(report.profile.value.tolist(), rel=1e-9)
    assert [float(row[5]) for row in along] == pytest.approx(report.profile.distance_px.tolist(), rel=1e-9)
    report.write_report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for stated in (
        "W·sr⁻¹·m⁻²",
        "Profile from 0,0 to 9,9, 12.7 px",
        *taken.values(),
        "2026-11-22 08:00:00",
        "calibration</dt><dd>not stated",
    ):
        assert stated in page
    bright = rm.analyse(tmp_path / "map.tiff", spectrum="line:555").regions[0].mean
    assert bright.value == pytest.approx(683.0 * float(found.radiance.mean()), rel=1e-3)
    assert bright.unit == "cd m-2"


def test_what_pixels_share_is_kept_in_files_and_under_differences(tmp_path):
    """Lowest and highest show their difference below it."""
    values = np.full((20, 20), 671.0)
    values[:, 10:], values[:5, :5] = 682.0, 0.0
    write_tiff(tmp_path / "map.tiff", MapPicture({"mono": map_of(values, u=0.5, common=0.12)}))
    found = rm.analyse(tmp_path / "map.tiff", regions={"a": (5, 5, 15, 15), "dark": (0, 0, 5, 5)}, line=(0, 8, 19, 8))
    lit, dark = found.region_rows(("lowest", "highest"))
    assert lit == ("a", "(6.71 ± 1.61)·10²", "(6.82 ± 1.64)·10²")
    assert dark[1].startswith("< 0.")
    assert [row[0] for row in found.profile_rows()] == ["start", "lowest", "highest", "end"]
    assert found.profile_rows()[0][1:] == ("0.0", "(6.71 ± 1.61)·10²")
    own = map_of(np.full((6, 8), 2.0))
    for shared in (None, np.full((6, 8), 0.005, np.float32)):
        write_tiff(tmp_path / "map.tiff", MapPicture({"mono": replace(own, u_shared=shared, u_rel_pattern=0.01)}))
        back = read_tiff(tmp_path / "map.tiff").first
        assert back.u_rel_pattern == 0.01
        assert (back.u_shared is None) == (shared is None)
        assert np.array_equal(back.parts_of_u(np.s_[:, :])[1], np.zeros((6, 8)) if shared is None else shared)


@pytest.mark.parametrize(
    ("light", "merged", "asked", "said"),
    [
        ("line:550", "line:550", "line:550.0", None),
        ("line:550", "line:550", "white_led", "though bench or capture states line:550"),
        ("line:550", "line:550", "white_led", "merge again with --spectrum white_led"),
        ("line:550", "white_led", "white_led", "though bench or capture states line:550"),
        ("", "equal_energy", "white_led", "radiance is for light of equal_energy"),
        ("", "white_led", "white_led", None),
    ],
)
def test_a_luminance_is_compared_with_the_light_that_the_map_states(tmp_path, light, merged, asked, said):
    """What the capture states of its light, and what the radiance is for, travel with the map and are compared."""
    origin = Provenance("merge", parameters={"origin": {"light": light, "spectrum": merged}})
    found = replace(map_of(np.ones((20, 20)), unit="W sr-1 m-2"), provenance=origin)
    write_tiff(tmp_path / "map.tiff", MapPicture({"mono": found}))
    doubts = rm.analyse(tmp_path / "map.tiff", spectrum=asked).assumptions[1:]
    assert any(said in one for one in doubts) if said else doubts == ()


def test_an_analysis_states_its_colour_and_what_the_map_leaves_out_of_u(tmp_path):
    """Of a map of three colours the green one is measured; text, JSON and page say so, and what no u holds."""
    grey = replace(map_of(np.ones((20, 20)), unit="relative"), not_in_u=("no black level is stated",))
    write_tiff(tmp_path / "map.tiff", MapPicture({"red": grey, "green": grey.scaled(2.0, "relative"), "blue": grey}))
    found = rm.analyse(tmp_path / "map.tiff")
    assert found.regions[0].mean.value == 2.0
    found.write_report(tmp_path / "page.html")
    for text in ("all figures are of green; the map holds red, green, blue", "no black level is stated"):
        assert text in found.to_mapping()["assumptions"]
        assert text in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"regions": {"a": (35, 0, 10, 10)}}, InputError),
        ({"regions": {"a": (0, 0, 5, 5)}, "contrast": ("a", "b")}, UsageError),
        ({"fisheye": "equidistant"}, UsageError),
        ({"fisheye": "equidistant", "field_of_view": 400.0}, UsageError),
        ({"line": (0, 0, 99, 0)}, InputError),
        ({"line": (3, 3, 3, 3)}, InputError),
        ({"line": (3, 3, 9, 3), "line_width": 1_000_000}, InputError),
    ],
)
def test_what_does_not_fit_the_map_is_refused(tmp_path, options, error):
    """What does not fit the map is refused."""
    write_tiff(tmp_path / "map.tiff", MapPicture({"mono": map_of(np.ones((30, 40)), unit="W sr-1 m-2")}))
    with pytest.raises(error):
        rm.analyse(tmp_path / "map.tiff", **options)  # type: ignore[arg-type]
    (tmp_path / "other.tiff").write_bytes(b"II*\0junk")
    with pytest.raises(InputError, match="merge"):
        rm.analyse(tmp_path / "other.tiff")


SIDE = 200

# Angle from the axis over 90° at the radius r of the circle.
PROJECTIONS = {
    "equidistant": lambda r: r * np.pi / 2,
    "equisolid": lambda r: 2 * np.arcsin(np.clip(r * np.sin(np.pi / 4), 0, 1)),
    "stereographic": lambda r: 2 * np.arctan(r * np.tan(np.pi / 4)),
    "orthographic": lambda r: np.arcsin(np.clip(r, 0, 1)),
}


def _room(projection: str, lamp_cd_m2: float = 20000.0, u: float = 0.0, common: float = 0.0) -> RadianceMap:
    """Return a room of 100 cd·m⁻² with a round lamp of 6° half angle, 30° above the axis."""
    y, x = (np.indices((SIDE, SIDE)) - (SIDE - 1) / 2) / (SIDE / 2)
    r = np.hypot(x, y)
    theta, phi = PROJECTIONS[projection](r), np.arctan2(y, x)
    lamp = np.radians(30)
    away = np.arccos(np.clip(-np.sin(theta) * np.sin(phi) * np.sin(lamp) + np.cos(theta) * np.cos(lamp), -1, 1))
    light = np.where(r <= 1, np.where(away < np.radians(6), lamp_cd_m2, 100.0), 0.0).astype(np.float32)
    return RadianceMap(light, np.full_like(light, u), np.zeros(light.shape, np.uint8), "cd m-2", common)


@pytest.mark.parametrize("projection", list(PROJECTIONS))
def test_ugr_is_that_by_hand_in_every_projection(projection):
    """UGR of one lamp, 8·lg(0.25/L_b·L²·ω/p²), with the position index of Guth (CIE 117, Kim's fit as evalglare)."""
    pytest.importorskip("pyradiance")
    ugr, dgp = glare_of(_room(projection), projection, 180.0)
    tau, sigma = 0.0, 30.0  # in the vertical plane, above the line of sight
    position = np.exp((35.2 - 0.31889 * tau - 1.22 * np.exp(-2 * tau / 9)) * 1e-3 * sigma
                      + (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2)  # fmt: skip
    omega = 2 * np.pi * (1 - np.cos(np.radians(6)))
    by_hand = 8 * np.log10(0.25 / 100.0 * 20000.0**2 * omega / position**2)
    assert ugr.value == pytest.approx(by_hand, abs=0.3)
    assert 0.2 < dgp.value < 1.0


def test_it_is_evalglares_own_figure():
    """Equal to evalglare called by hand on the same picture written as Radiance's."""
    library = pytest.importorskip("pyradiance")
    room = _room("equidistant")
    light = room.radiance / 179.0
    mantissa, exponent = np.frexp(np.maximum(light, 1e-30))
    one = np.where(light > 0, np.rint(mantissa * 256), 0).astype(np.uint8)
    last = np.where(light > 0, exponent + 128, 0).astype(np.uint8)
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nVIEW= -vta -vv 180 -vh 180\n\n-Y {SIDE} +X {SIDE}\n"
    printed = library.evalglare(header.encode() + np.stack([one, one, one, last], -1).tobytes()).decode()
    dgp, _, expected = (float(text) for text in printed.partition(":")[2].split()[:3])
    ugr, found = glare_of(room, "equidistant", 180.0)
    assert ugr.value == pytest.approx(expected, abs=1e-4)
    assert found.value == pytest.approx(dgp, abs=1e-4)


@pytest.mark.slow
def test_uncertainty_holds_scale_and_noise():
    """Moving a room's light by 10 % moves UGR by 8·lg(1.1) = 0.33; of 12 maps off by such scales 10 or more hold."""
    pytest.importorskip("pyradiance")
    truth = glare_of(_room("equidistant"), "equidistant", 180.0)
    rng, inside = np.random.default_rng(46_811), 0
    for _ in range(12):
        scale = 1.0 + 0.1 * rng.standard_normal()
        room = _room("equidistant", u=2.0, common=0.1)
        light = (scale * room.radiance + rng.normal(0.0, 2.0, room.shape) * (room.radiance > 0)).astype(np.float32)
        moved = RadianceMap(light, room.u_radiance, room.mask, "cd m-2", 0.1)
        found = glare_of(moved, "equidistant", 180.0)
        inside += all(abs(one.value - true.value) <= 2 * one.u for one, true in zip(found, truth, strict=True))
    assert inside >= 10


def test_what_evalglare_cannot_judge_is_refused(monkeypatch):
    """Without the extra the message says how to install it."""
    pytest.importorskip("pyradiance")
    room = _room("equidistant")
    with pytest.raises(InputError, match="--spectrum"):
        glare_of(RadianceMap(room.radiance, room.u_radiance, room.mask, "W sr-1 m-2"), "equidistant", 180.0)
    with pytest.raises(InputError, match="hemisphere"):
        glare_of(room, "equidistant", 120.0)
    mask = np.where(room.radiance > 1000, 1, 0).astype(np.uint8)
    with pytest.raises(MeasurementError, match="saturated"):
        glare_of(RadianceMap(room.radiance, room.u_radiance, mask, "cd m-2"), "equidistant", 180.0)
    monkeypatch.setitem(sys.modules, "pyradiance", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'radiometer\[glare\]'"):
        glare_of(_room("equidistant"), "equidistant", 180.0)


def test_what_pixels_of_one_level_share_is_not_averaged_away():
    """A curve known to 3 % makes means, profiles and lux as uncertain; within one level it cancels."""
    values = np.full((40, 80), 100.0)
    values[:, 40:] = 10.0
    own = map_of(values, u=1.0, common=0.0)
    found = replace(own, u_radiance=np.hypot(own.u_radiance, 0.03 * own.radiance), u_shared=0.03 * own.radiance)
    bright, dark = (region_figures(found, name, Patch(x, 0, 40, 40)) for name, x in (("bright", 0), ("dark", 40)))
    assert bright.mean.u == pytest.approx(math.hypot(3.0, 1.0 / 40.0), rel=1e-4)
    alone = region_figures(own, "bright", Patch(0, 0, 40, 40))
    assert bright.uniformity.u == pytest.approx(alone.uniformity.u, rel=1e-3)
    assert ratio_of(bright, dark, 0.0).u == pytest.approx(10.0 * 0.03 * math.sqrt(2.0 - 2.0 * 0.1), rel=0.01)
    assert profile(found, (2, 5), (20, 5), 5)[2] == pytest.approx(math.hypot(3.0, 1.0 / math.sqrt(5.0)), rel=1e-3)
    level = np.full((40, 80), 0.3, np.float32)
    even = replace(own, radiance=np.full((40, 80), 10.0, np.float32), u_radiance=level, u_shared=level)
    lux = vertical_illuminance(even, "equidistant", 180.0, 0.0, None)
    assert lux.u / lux.value == pytest.approx(0.03, rel=0.01)
    nothing = region_figures(replace(even, radiance=np.zeros((40, 80), np.float32)), "dark", Patch(0, 0, 40, 40))
    assert [nothing.mean.u, nothing.lowest.u] == pytest.approx([0.3, 0.3], rel=1e-5)
    assert ratio_of(nothing, bright, 0.0).u == pytest.approx(0.003, rel=1e-5)
