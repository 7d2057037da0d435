"""The matrix of a colour camera: exact where one exists, and an uncertainty that holds where none does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiometer.analysis.colour.calibration import (
    GRID_NM,
    ColourCalibration,
    ColourCamera,
    Training,
    fit_matrix,
    on_grid,
    plausible_lights,
    train_on_lights,
    train_on_responsivities,
    tristimulus_of,
)
from radiometer.analysis.colour.chromaticity import coordinates
from radiometer.analysis.photometry.photometry import spectrum
from radiometer.data.mosaic import COLOURS
from radiometer.errors import CalibrationError, UsageError
from radiometer.typing import Array
from simulators.cameras.simulated_camera import ColourFilters

NOISE_REL = 0.002
LIGHTS = ("cie_d65", "cie_a", "white_led", "led_b5", "cie_fl11")
CAMERA = np.stack([ColourFilters().responsivity(colour, GRID_NM) for colour in COLOURS])
PLAIN: dict[str, Any] = {"powers": None, "per_kind": False, "u_rel": 0.0}
GAIN = 0.02  # DN per s and unit of power: any


def read(powers: Array, kinds: list[str], rng: np.random.Generator, camera: Array = CAMERA) -> Training:
    """Return lights as a camera reads them, with noise, and their true X, Y, Z."""
    exact = GAIN * powers @ camera.T
    u_signal = NOISE_REL * exact
    signal = exact + u_signal * rng.standard_normal(exact.shape)
    names = tuple(f"light {n}" for n in range(len(powers)))
    return Training(names, tuple(kinds), signal, u_signal, tristimulus_of(powers), np.full(len(powers), 1e-3))


def deviations(known: ColourCalibration, lights: Training, kind: str | None) -> tuple[Array, Array, Array]:
    """Return (measured − true)/u of X, Y, Z, and the relative errors of CCT and the errors of Duv."""
    covariance = np.eye(3) * lights.u_signal[:, None, :] ** 2
    xyz, u_xyz = known.convert(lights.signal, covariance, kind)
    found, true = coordinates(xyz, u_xyz), coordinates(lights.xyz, np.zeros((3, 3)))
    off = (xyz - lights.xyz) / np.sqrt(np.diagonal(u_xyz, axis1=1, axis2=2))
    return off, found.cct_k / true.cct_k - 1.0, found.duv - true.duv


@pytest.fixture(scope="module")
def reflectances() -> Array:
    """Return the 24 patches of a real chart."""
    peer = pytest.importorskip("colour")
    chart = peer.SDS_COLOURCHECKERS["BabelColor Average"]
    return np.stack([np.interp(GRID_NM, one.wavelengths, one.values) for one in chart.values()])


def test_a_camera_that_is_a_mixture_of_the_matching_functions_has_its_matrix():
    """By Luther the matrix is the inverse of the mixture, for lights of any kind; the white's u is the table's."""
    rng = np.random.default_rng(46_021)
    mixture = np.array([[0.9, 0.2, 0.1], [0.2, 1.1, 0.0], [0.0, 0.1, 0.8]])
    powers = np.vstack([plausible_lights()["surfaces"][::9], plausible_lights()["coloured_leds"][::5]])
    xyz = tristimulus_of(powers)
    signal = xyz @ mixture.T
    none = np.zeros(len(powers))
    found = fit_matrix(Training(("",) * len(powers), ("",) * len(powers), signal, 0.0 * signal, xyz, none))
    assert found.matrix == pytest.approx(np.linalg.inv(mixture), abs=1e-9)
    assert np.sqrt(np.diag(found.error)).max() < 2e-4
    light = rng.uniform(0.1, 1.0, 3)
    assert found.matrix @ (mixture @ light) == pytest.approx(light)
    names = ("white", *[""] * (len(powers) - 1))
    kept = fit_matrix(Training(names, names, signal, 0.0 * signal, xyz, none + 0.02), "white")
    own = kept.leverage(signal[0]) * np.trace(kept.error) * np.sum(xyz[0]) ** 2
    assert own == pytest.approx(
        0.02**2 * np.sum(xyz[0] ** 2), rel=1e-6
    )  # the white is known to 2 %, and so is its like


def trained(powers: Array, rng: np.random.Generator, kind: str = "surfaces", **more: Any) -> ColourCalibration:
    """Return the calibration by lights that the camera reads."""
    camera = ColourCamera(COLOURS, responsivities=more.pop("responsivities", None))
    return train_on_lights(camera, read(powers, [kind] * len(powers), rng), **{**PLAIN, **more})


@pytest.mark.parametrize("lamp", LIGHTS)
def test_greys_have_their_colour_temperature_by_a_matrix_that_keeps_white(lamp, reflectances):
    """A chart under a lamp, its white exact: CCT of the other greys within 1 %, Duv within 0.001, both within u."""
    rng = np.random.default_rng(46_031)
    powers = reflectances * on_grid(spectrum(lamp))
    known = trained(powers, rng, "mine", responsivities=CAMERA, white="light 18")
    greys = read(np.repeat(powers[19:22], 40, axis=0), ["mine"] * 120, rng)
    off, cct, duv = deviations(known, greys, "mine")
    assert np.mean(np.abs(off) < 2.0) >= 0.93
    assert np.sqrt(np.mean(cct**2)) < 0.005
    assert np.sqrt(np.mean(duv**2)) < 0.0005
    with pytest.raises(CalibrationError, match="no light has that name"):
        trained(powers, rng, "mine", white="snow")


@pytest.mark.parametrize("display", ["LCD-Dell", "OLED-Sony"])
def test_a_display_has_a_matrix_whatever_the_camera(display, shared_data):
    """Three primaries add up, so white and four lights give any mixture: CCT of whites within 1 %, Duv 0.001."""
    table = np.loadtxt(shared_data / f"displays/isetbio/{display}_spd_W_sr_m2_nm.csv", delimiter=",", skiprows=1)
    primaries = np.stack([np.interp(GRID_NM, table[:, 0], table[:, n]) for n in (1, 2, 3)])
    white, rng = primaries.sum(axis=0), np.random.default_rng(46_024)
    known = trained(np.vstack([primaries, white, 0.5 * white]), rng, "mine")
    lights = read(rng.uniform(0.6, 1.0, (40, 3)) @ primaries, ["mine"] * 40, rng)
    off, cct, duv = deviations(known, lights, "mine")
    assert np.mean(np.abs(off) < 2.0) >= 0.93
    assert np.sqrt(np.mean(cct**2)) < 0.01
    assert np.sqrt(np.mean(duv**2)) < 0.001
    assert np.sqrt(known.errors["mine"][1, 1]) < 0.02


def test_u_of_oleds_by_the_matrix_of_a_chart_is_neither_too_small_nor_too_large(reflectances):
    """OLEDs whose emitters peak within 7 nm and are 0.6 to 1.6 times as wide: k = 2 covers 93 %; U of Y is no guess."""
    rng, off, wide = np.random.default_rng(1_500_201), list[Array](), list[Array]()
    known = trained(reflectances * on_grid(spectrum("cie_d65")), rng, responsivities=CAMERA)
    for _ in range(40):
        emitters = [
            f"band:{p + rng.uniform(-7, 7)},{w * rng.uniform(0.6, 1.6)}" for p, w in ((620, 38), (525, 38), (460, 24))
        ]
        primaries = np.stack([on_grid(spectrum(one)) for one in emitters])
        lights = read(rng.uniform(0.0, 1.0, (8, 3)) @ primaries, ["oled"] * 8, rng)
        off.append(deviations(known, lights, "oled")[0])
        spread = known.convert(lights.signal, np.zeros((3, 3)), "oled")[1]
        wide.append(2.0 * np.sqrt(spread[:, 1, 1]) / lights.xyz[:, 1])
    assert np.mean(np.abs(off) < 2.0) >= 0.93
    assert np.median(wide) < 0.25


@pytest.mark.parametrize("responsivities", [CAMERA, None], ids=["known", "unknown"])
@pytest.mark.parametrize(("display", "kind"), [("LCD-Dell", "ccfl_lcd"), ("OLED-Sony", "oled")])
def test_another_display_of_the_type_is_within_u(display, kind, responsivities, shared_data):
    """The usual display of a type gives the matrix, a real one of that type is measured: u is not that of the first."""
    rng = np.random.default_rng(46_032)
    usual = np.stack([on_grid(spectrum(f"display:{kind}:{one}")) for one in COLOURS])
    known = trained(rng.uniform(0.1, 1.0, (12, 3)) @ usual, rng, "mine", responsivities=responsivities)
    table = np.loadtxt(shared_data / f"displays/isetbio/{display}_spd_W_sr_m2_nm.csv", delimiter=",", skiprows=1)
    primaries = np.stack([np.interp(GRID_NM, table[:, 0], table[:, n]) for n in (1, 2, 3)])
    off, _, _ = deviations(known, read(rng.uniform(0.0, 1.0, (40, 3)) @ primaries, [kind] * 40, rng), kind)
    assert np.mean(np.abs(off) < 2.0) >= 0.93
    assert all(np.sqrt(known.error(one, np.ones(3) / 3.0)[1, 1]) >= 1e-4 for one in known.errors)


@pytest.mark.parametrize("camera", ["simulated", "Nikon 5100 (NPL)"])
@pytest.mark.parametrize("responsivities", [True, False])
def test_u_holds_for_spectra_outside_the_training_set(camera, responsivities, reflectances):
    """A chart under daylight; then it under other lamps, lamps and displays: 93 % or more within k = 2, each alike."""
    peer, rng = pytest.importorskip("colour"), np.random.default_rng(46_025)
    own = CAMERA
    if camera != "simulated":
        measured = peer.MSDS_CAMERA_SENSITIVITIES[camera]
        own = np.stack([np.interp(GRID_NM, measured.wavelengths, one) for one in measured.values.T])
    more = {"responsivities": own} if responsivities else {}
    powers = reflectances * on_grid(spectrum("cie_d65"))
    kinds = ["surfaces"] * 24
    known = train_on_lights(
        ColourCamera(COLOURS, responsivities=more.get("responsivities")), read(powers, kinds, rng, own), **PLAIN
    )
    primaries = np.stack([on_grid(spectrum(f"display_{one}")) for one in COLOURS])
    others = [(reflectances * on_grid(spectrum(name)), "surfaces") for name in LIGHTS[1:]]
    others += [(plausible_lights()["white_leds"], "white_leds"), (rng.uniform(0, 1, (40, 3)) @ primaries, None)]
    within = []
    for lights, kind in others:
        off, _, _ = deviations(known, read(lights, [""] * len(lights), rng, own), kind)
        within.append(np.mean(np.abs(off) < 2.0))
    assert np.mean(within) >= 0.93


def test_responsivities_give_chromaticities_and_known_lights_the_scale(reflectances):
    """Without a known light X, Y, Z are relative; one known light gives them their scale, with its uncertainty."""
    rng, powers = np.random.default_rng(46_026), reflectances * on_grid(spectrum("cie_d65"))
    lights = read(powers, ["surfaces"] * 24, rng)
    camera = ColourCamera(COLOURS, responsivities=CAMERA)
    relative = train_on_responsivities(camera, None, per_kind=False, u_rel=0.0)
    one = Training(*(part[18:19] for part in (lights.names, lights.kinds, lights.signal, lights.u_signal, lights.xyz,
                                              lights.u_rel)))  # fmt: skip
    absolute = train_on_responsivities(camera, one, per_kind=False, u_rel=0.01)
    assert (relative.unit, absolute.unit) == ("relative", "cd m-2")
    assert absolute.u_rel > 0.01
    assert absolute.convert(one.signal, np.zeros((3, 3)), None)[0][0, 1] == pytest.approx(one.xyz[0, 1])
    noisy = replace(one, u_signal=0.1 * one.signal, u_rel=np.array([0.05]))
    row, error = (getattr(absolute.matrices["all"], name)[1] for name in ("matrix", "error"))
    for light in (one, noisy):
        noise = np.sum((row * light.u_signal) ** 2) / (row @ one.signal[0]) ** 2
        own = error[1] * (one.xyz.sum() / one.xyz[0, 1]) ** 2
        found = train_on_responsivities(camera, light, per_kind=False, u_rel=0.01)
        assert found.u_rel**2 == pytest.approx(1e-4 + noise + light.u_rel[0] ** 2 + own)
    off, _, _ = deviations(absolute, lights, "surfaces")
    assert np.mean(np.abs(off) < 2.0) >= 0.93
    xyz, _ = relative.convert(lights.signal, np.zeros((3, 3)), None)
    same, _ = absolute.convert(lights.signal, np.zeros((3, 3)), None)
    assert xyz / xyz.sum(axis=1, keepdims=True) == pytest.approx(same / same.sum(axis=1, keepdims=True))


def test_a_known_light_five_times_as_bright_scales_x_y_z_and_each_term_of_their_u():
    """Readings, matrix and errors of other lights: the covariance of all three together grows by 25."""
    lights = read(plausible_lights()["surfaces"][:24], ["surfaces"] * 24, np.random.default_rng(46_031))
    camera, noise = ColourCamera(COLOURS, responsivities=CAMERA), np.eye(3) * lights.u_signal[:, None, :] ** 2
    found = []
    for brighter in (1.0, 5.0):
        known = replace(lights, xyz=brighter * lights.xyz)
        made = train_on_responsivities(camera, known, per_kind=False, u_rel=0.0)
        found.append((*made.convert(lights.signal, noise, "surfaces"), made.matrices["all"].spread))
    for one, five, power in zip(*found, (1, 2, 2), strict=True):
        assert five == pytest.approx(5.0**power * one, rel=1e-9)
    alike = (np.repeat(part[:1], 2, axis=0) for part in (lights.signal, lights.u_signal, lights.xyz, lights.u_rel))
    two = Training(("a", "b"), lights.kinds[:2], *alike)
    torn = replace(two, xyz=np.array([[1.1], [0.9]]) * two.xyz)
    assert train_on_responsivities(camera, torn, per_kind=False, u_rel=0.0).u_rel == pytest.approx(0.1, rel=1e-3)


def test_a_matrix_for_each_kind_is_better_for_it_and_asks_for_the_kind():
    """Two displays have two matrices, each with less error than the one for both."""
    rng, lights = np.random.default_rng(46_027), plausible_lights()
    powers = np.vstack([lights["oled"][:26], lights["ccfl_lcd"][:26]])  # the mixtures of one display each
    kinds = ["oled"] * 26 + ["ccfl_lcd"] * 26
    training = read(powers, kinds, rng)
    each = train_on_lights(ColourCamera(("x", "y", "z")), training, **{**PLAIN, "per_kind": True})
    both = train_on_lights(ColourCamera(("x", "y", "z")), training, **PLAIN)
    for kind in ("oled", "ccfl_lcd"):
        assert np.trace(each.error(kind, np.ones(3))) < 0.5 * np.trace(both.error(kind, np.ones(3)))
    with pytest.raises(UsageError, match="state --kind"):
        each.convert(training.signal, np.zeros((3, 3)), None)


def test_light_outside_the_training_set_is_told_and_less_sure(reflectances):
    """A laser is outside the hull of a chart's colours; a grey is inside."""
    rng = np.random.default_rng(46_028)
    daylight = on_grid(spectrum("cie_d65"))
    known = trained(reflectances * daylight, rng)
    lights = read(np.vstack([on_grid(spectrum("band:520,10")), 0.4 * daylight]), ["", ""], rng)
    xyz, u_xyz = known.convert(lights.signal, np.zeros((2, 3, 3)), "surfaces")
    found = coordinates(xyz, u_xyz)
    assert known.is_outside(found.xy, 1e-6 * np.eye(2), "surfaces").tolist() == [True, False]
    u_rel = np.sqrt(u_xyz[:, 1, 1]) / xyz.sum(axis=1)
    assert u_rel[0] > 1.1 * u_rel[1]


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ([0, 1, 2], "4 lights or more"),
        ([3, 3, 3, 3, 3, 3], "fixed ratio|without light"),
        ([0, 1, 2, 2, 2], "without light"),
    ],
)
def test_lights_that_determine_no_matrix_are_refused(chosen, said):
    """Too few, all alike, or one that no other confirms."""
    powers = plausible_lights()["oled"][[0, 2, 8, 25]][chosen]
    with pytest.raises(CalibrationError, match=said):
        trained(powers, np.random.default_rng(46_029))


def test_a_file_gives_back_the_calibration_with_its_raw_readings(tmp_path):
    """Matrix, errors and readings stay to the last digit; the matrix can be made anew from the file."""
    rng = np.random.default_rng(46_030)
    known = trained(plausible_lights()["oled"], rng, "oled")
    known.write(tmp_path / "colour.yaml")
    again = ColourCalibration.read(tmp_path / "colour.yaml")
    assert again.to_mapping() == known.to_mapping()
    assert again.training is not None
    assert fit_matrix(again.training).matrix == pytest.approx(known.matrices["all"].matrix, rel=1e-12)
    text = (tmp_path / "colour.yaml").read_text(encoding="utf-8")
    (tmp_path / "other.yaml").write_text(text.replace("channels: [red, green, blue]", "channels: [red, green]"))
    with pytest.raises(CalibrationError, match="has not 2 channels"):
        ColourCalibration.read(tmp_path / "other.yaml")
