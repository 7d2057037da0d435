"""Every quality index finds the error that was planted in the simulated bench, within its expanded uncertainty."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from radiometer.analysis.quality.indices import Figure, v_lambda_mismatch
from radiometer.analysis.quality.procedures import PROCEDURES
from radiometer.analysis.quality.session import Evaluation, Index, evaluate, patch_of
from radiometer.analysis.reading.budget import coverage_factor
from radiometer.data import (
    CameraDescription,
    CaptureSet,
    CaptureSetWriter,
    Frame,
    FrameSettings,
    LensDescription,
    Patch,
    PatchDescription,
)
from radiometer.data.calibration import SpectralResponse
from radiometer.errors import InputError
from testing import quality_stations as stations

STEADY = Evaluation(source_u_rel=0.0)


def index_of(session: Path, name: str, how: Evaluation = STEADY) -> Index:
    return next(one for one in evaluate(session, how).indices if one.procedure.name == name)


def figure_of(session: Path, name: str, how: Evaluation = STEADY) -> Figure:
    index = index_of(session, name, how)
    assert index.figure is not None, index.reason
    return index.figure


def held(figure: Figure, truth: float) -> bool:
    return abs(figure.value - truth) <= coverage_factor(figure.degrees_of_freedom) * figure.u


@pytest.mark.parametrize(("name", "plant", "truth", "known_to"), stations.PLANTED, ids=lambda each: str(each)[:12])
def test_index_finds_what_was_planted(name, plant, truth, known_to, tmp_path):
    """The interval holds the planted error, and is narrow enough to tell it from none."""
    plant(tmp_path, 4)
    figure = figure_of(tmp_path, name)
    assert held(figure, truth)
    assert figure.u < known_to * truth


def test_a_capture_without_a_patch_is_read_in_its_middle(tmp_path):
    """A tenth of the picture across and down; a stated patch, or that of the capture, goes before."""
    own = PatchDescription(name="own", x=1, y=2, width=3, height=4)
    for patches, stated, expected in (
        ((), None, Patch(40, 27, 9, 6)),
        ((own,), None, Patch(1, 2, 3, 4)),
        ((own,), Patch(5, 6, 7, 8), Patch(5, 6, 7, 8)),
    ):
        folder = tmp_path / str(expected.x)
        with CaptureSetWriter(folder, CameraDescription(bit_depth=12), LensDescription(), patches=patches) as writer:
            writer.add(Frame(np.zeros((60, 90), np.uint16), 12, FrameSettings(1.0)))
        assert patch_of(CaptureSet.read(folder), stated) == expected


def test_linearity_follows_the_bend(tmp_path):
    """Readings at every exposure lie off the longest's by the bend at their electrons, from first principles."""
    stations.bent(tmp_path, 4, a2=0.03)
    figure = figure_of(tmp_path, "linearity")
    photon_j = 6.62607015e-34 * 299_792_458.0 / 550e-9
    per_s = 0.1 * math.pi * 0.95 / (4.0 * 4.0**2) * (4.5e-6) ** 2 / photon_j * 0.62
    bend = {t: 1.0 - 0.03 * per_s * t / stations.FULL_WELL_E for t in np.geomspace(0.002, 0.06, 8)}
    truth = {f"{1e3 * t:.4g} ms": one / bend[max(bend)] - 1.0 for t, one in bend.items()}
    assert all(abs(one.value - truth[one.label]) < 2.5 * one.u for one in figure.details)
    assert figure.value == max(abs(one.value) for one in figure.details)


def test_glare_and_size_of_source_are_shares_of_the_veil(tmp_path):
    """The white that is left of a black patch; the ring between two discs."""
    stations.veiled(tmp_path, 4, share=0.012)
    white_left = 1.0 - 50 * 50 / (stations.WIDTH * stations.HEIGHT)
    assert held(figure_of(tmp_path, "glare"), 0.012 * white_left)
    stations.sized(tmp_path, 4, share=0.02)
    rows, columns = np.mgrid[: stations.HEIGHT, : stations.WIDTH]
    away = np.hypot(rows - 79.5, columns - 99.5)
    small, large = (0.98 + 0.02 * float(np.mean(away < d / 2)) for d in (60, 150))
    figure = figure_of(tmp_path, "size")
    assert held(figure, 1.0 - small / large)
    assert [one.label for one in figure.details] == ["60", "100"]


def test_modulation_reads_flicker_as_uncertainty(tmp_path):
    """Half periods of a 30 % ripple at random phases: no deviation in the mean, and u from the frames' own scatter."""
    stations.rippled(tmp_path, 4)
    figure = figure_of(tmp_path, "modulation")
    expected = 0.3 * np.sinc(0.5) / math.sqrt(2.0) / math.sqrt(12.0)
    assert held(figure, 0.0)
    assert 0.5 * expected < figure.u < 2.0 * expected
    assert 10.0 < figure.degrees_of_freedom < 13.0


def test_no_error_planted_no_index_claimed(tmp_path):
    """A camera without polarisation or non-uniformity reads zero within its interval."""
    stations.polarised(tmp_path, 4, strength=0.0)
    stations.uneven(tmp_path, 4, step=0.0)
    steady = figure_of(tmp_path, "polarisation")
    assert held(steady, 0.0)
    assert bool(steady.remarks) == (steady.value > 0.0)  # noise alone has no axis
    assert held(figure_of(tmp_path, "uniformity"), 0.0)


def test_polarisation_says_at_which_angle_it_is_largest(tmp_path):
    """The axis planted at 30° comes out."""
    stations.polarised(tmp_path, 4, axis_deg=30.0)
    assert figure_of(tmp_path, "polarisation").remarks[0].startswith("largest at 30°")


@pytest.mark.parametrize(
    ("of", "facts", "reason"),
    [
        ("camera", {"serial": "999"}, "its serial is"),
        ("camera", {"mode": "slow"}, "mode fast"),
        ("frames", {"source_level": 0.5}, "source level of 0.5"),
    ],
)
def test_a_step_that_is_no_reading_of_the_same_is_refused(tmp_path, of, facts, reason):
    """Another camera, mode or brightness of the source would be the index."""
    stations.polarised(tmp_path, 4)
    for angle in (0, 45, 90, 135):
        header = tmp_path / "polarisation" / str(angle) / "capture.yaml"
        content = yaml.safe_load(header.read_text())
        content["camera"] |= {"serial": "1", "mode": "fast"}
        for one in (content["camera"],) if of == "camera" else content["frames"]:
            one.update(facts if angle == 90 else {})
        header.write_text(yaml.safe_dump(content))
    index = index_of(tmp_path, "polarisation")
    assert index.figure is None
    assert reason in index.reason


def test_a_step_at_another_stop_carries_its_doubt(tmp_path):
    """A marked stop is known to 2 % (k = 1), so that light is to 4 %."""
    stations.refocused(tmp_path, 4)
    same = figure_of(tmp_path, "focus")
    header = next((tmp_path / "focus").glob("near*")) / "capture.yaml"
    header.write_text(header.read_text().replace("f_number: 4.0", "f_number: 4.4"))
    other = figure_of(tmp_path, "focus")
    assert other.u == pytest.approx(math.hypot(same.u, 0.04 * 1.1**2), rel=0.1)


def test_an_unsteady_source_widens_every_ratio(tmp_path):
    """A source steady to 1 % only gives √2 % to a ratio of two steps."""
    stations.refocused(tmp_path, 4)
    steady, unsteady = (figure_of(tmp_path, "focus", Evaluation(source_u_rel=u)) for u in (0.0, 0.01))
    ratio = 1.0 - steady.value
    assert unsteady.u == pytest.approx(math.hypot(steady.u, math.sqrt(2.0) * 0.01 * ratio), rel=1e-6)


def test_steps_of_other_exposures_carry_the_offset_of_the_clock(tmp_path):
    """Real times off the stated ones by 2.9 µs (k = 1) move a reading at 0.5 ms, and hardly one at 4 ms."""
    stations.capture(tmp_path / "focus" / "far", stations.uniform(), seed=1)
    stations.capture(tmp_path / "focus" / "near", stations.uniform(), seed=2, exposures_s=(0.0005,) * 3)
    figure = figure_of(tmp_path, "focus")
    offset = 2.9e-6 * (1.0 / 0.0005 - 1.0 / 0.004)
    assert offset < figure.u < 1.3 * offset
    assert held(figure, 0.0)


def test_a_stated_focus_is_no_error(tmp_path):
    """The factor (1 + m)² of a magnification that the capture states belongs to the instrument, and is corrected."""
    near = stations.LENS.model_copy(update={"magnification": 0.02})
    stations.capture(tmp_path / "focus" / "far", stations.uniform(), seed=1)
    stations.capture(tmp_path / "focus" / "near", stations.uniform(), seed=2, lens=near, stated_lens=near)
    assert held(figure_of(tmp_path, "focus"), 0.0)


def test_temperatures_too_near_are_refused(tmp_path):
    """Two steps 1 K apart tell nothing of 10 K."""
    stations.capture(tmp_path / "temperature" / "cool", stations.uniform(), temperature_c=30.0)
    stations.capture(tmp_path / "temperature" / "warm", stations.uniform(), temperature_c=31.0)
    index = index_of(tmp_path, "temperature")
    assert index.figure is None
    assert "1 K apart" in index.reason


def test_what_was_not_captured_is_listed_as_not_measured(tmp_path):
    """One procedure alone: its index stands, all others say that they were not captured."""
    stations.refocused(tmp_path, 4)
    sheet = evaluate(tmp_path, STEADY)
    assert [one.procedure.name for one in sheet.indices] == [one.name for one in PROCEDURES]
    assert [one.procedure.name for one in sheet.indices if one.figure] == ["focus"]
    assert all("not captured" in one.reason for one in sheet.indices if one.procedure.steps and not one.figure)


def test_folders_without_a_step_are_refused_by_name(tmp_path):
    """A missing step names itself, an empty folder is none, a clipped patch no reading."""
    stations.capture(tmp_path / "glare" / "white", stations.uniform())
    assert index_of(tmp_path, "glare").reason == "not captured: black"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="radiometer quality take"):
        evaluate(tmp_path / "empty", STEADY)
    stations.capture(tmp_path / "focus" / "far", stations.uniform(50.0))
    stations.capture(tmp_path / "focus" / "near", stations.uniform(50.0))
    assert "clips in every frame" in index_of(tmp_path, "focus").reason


class TestSpectral:
    def test_v_lambda_itself_has_no_mismatch(self):
        """A camera that sees as the CIE 1924 observer does."""
        nm, v = _observer()
        figure = v_lambda_mismatch(SpectralResponse(wavelength_nm=nm, relative=v, u_rel=0.0))
        assert figure.value == pytest.approx(0.0, abs=1e-9)

    def test_a_line_response_is_wrong_by_all_but_its_own_width(self):
        """A narrow band counts all its own area and nearly all of V(λ): s* is scaled by illuminant A at the band."""
        nm = (549.0, 550.0, 551.0)
        figure = v_lambda_mismatch(SpectralResponse(wavelength_nm=nm, relative=(0.0, 1.0, 0.0), u_rel=0.0))
        grid, v = (np.array(one) for one in _observer())
        ones = np.arange(380.0, 781.0)
        observer = np.interp(ones, grid, v)
        power = (560.0 / ones) ** 5 * (math.exp(1.435e7 / (2848.0 * 560.0)) - 1.0) / np.expm1(1.435e7 / (2848.0 * ones))
        area = float((power * observer).sum() / power[ones == 550.0][0])
        rest = float(observer.sum() - observer[ones == 550.0][0])
        at_line = area - float(observer[ones == 550.0][0])
        assert figure.value == pytest.approx((rest + at_line) / observer.sum(), rel=2e-3)

    def test_u_follows_the_responsivity_s(self):
        """A responsivity known twice as badly gives twice the uncertainty."""
        nm, v = _observer()
        once, twice = (
            v_lambda_mismatch(SpectralResponse(wavelength_nm=nm, relative=tuple(np.sqrt(v)), u_rel=u)).u
            for u in (0.01, 0.02)
        )
        assert twice == pytest.approx(2.0 * once, rel=0.1)


def _observer() -> tuple[tuple[float, ...], tuple[float, ...]]:
    from radiometer.analysis.photometry.photometry import luminous_efficiency

    nm, v = luminous_efficiency()
    return tuple(float(one) for one in nm), tuple(float(one) for one in v)
