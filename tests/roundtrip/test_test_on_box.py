"""The whole test through the simulated box: the subject sees its LEDs and presses its button, as on hardware."""

import math
import os

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.box_setup import open_box_stage
from radiometer.adaptation.outcome import RunJournal
from radiometer.adaptation.protocol import FlashBleach, SteadyBleach, read_protocol
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.run import run_test
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.data.storage import shipped_config
from radiometer.errors import RadiometerError
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, recovery_min, scotopic_lm_per_w
from simulators.observers.observer import BOX_WHITE_LM_PER_W

# Radiance for 750 cd/m² by the protocol's white LED (316.9 lm/W), as the simulated eye sees it.
BLEACH_CD_M2 = 750.0 / 316.9 * BOX_WHITE_LM_PER_W


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def protocol(minutes, *, bleach_s=150.0, **spot):
    """Return the shipped box-only protocol, cut short."""
    whole = read_protocol("led-only")
    return whole.model_copy(
        update={
            "bleach": SteadyBleach(luminance_cd_m2=750.0, duration_s=bleach_s),
            "spot": whole.spot.model_copy(update=spot),
            "end": whole.end.model_copy(update={"duration_min": minutes}),
        }
    )


def run(path, expected, subject="steady", preset=None):
    """Run a test on the simulated box."""
    request = RunRequest(expected, box="sim", simulate=subject, seed=4, preset=preset)
    with open_box_stage(request) as (stage, checks), RunJournal(path, relive=True) as journal:
        return run_test(expected, stage, journal, subject="A1", seed=5, checks=checks), journal


def fitted(outcome):
    """Return the fit of a run's thresholds."""
    assert outcome.can_be_fitted, outcome
    series = ThresholdSeries(np.array(outcome.times_min), np.array(outcome.thresholds_log10))
    return fit_adaptation(series, FitRequest(bootstrap_draws=0), np.random.default_rng(0))


@pytest.mark.slow
def test_blue_spot_shows_the_break_of_the_eye_that_the_bleach_left(tmp_path):
    """Break within its interval's width and the method's own delay; plateau where the eye has it on the stated scale.

    The product takes the spot for a line at 453 nm (833 lm/W scotopic), the eye sees 756 lm/W: +0.04 log10 units; the
    limits end up to a step (0.1) above α, or below it by the function's spread.
    """
    outcome, _ = run(tmp_path / "j", protocol(18.0))
    found = fitted(outcome)
    eye = eye_after_bleach(Eye(), BLEACH_CD_M2, 150.0)
    truth = eye.break_min(453.0)
    assert found.has_break
    assert abs(found.estimates["break_min"].value - truth) < 3 * found.estimates["break_min"].u + 0.3
    offset = math.log10(833.0 / scotopic_lm_per_w(453.0))
    late = [v for t, v in zip(outcome.times_min, outcome.thresholds_log10, strict=True) if t > 10]
    eyes = [eye.threshold_log10(t, 453.0) for t in outcome.times_min if t > 10]
    assert np.mean(late) - np.mean(eyes) == pytest.approx(offset, abs=0.15)


@pytest.mark.slow
def test_red_spot_shows_no_break(tmp_path):
    """At 640 nm rods and cones are about equally sensitive: the same subject, bleach and box give one branch."""
    red = protocol(
        14.0, channel="spot_red", peak_nm=640.0, filter_density=1.5, lowest_log10=-6.0, highest_log10=-1.3
    )  # fmt: skip
    whole = shipped_config("light_boxes/reference.yaml").read_text(encoding="utf-8")
    place = ",\n    place: {temporal_deg: 15.5, below_deg: 1.5}"
    assert place in whole
    (tmp_path / "red.yaml").write_text(whole.replace(place, ""), encoding="utf-8")  # the red LED is a test spot here
    outcome, _ = run(tmp_path / "j", red, preset=tmp_path / "red.yaml")
    assert not fitted(outcome).has_break


@pytest.mark.slow
def test_short_bleach_leaves_the_rod_branch_alone(tmp_path):
    """After 2 s the rods are the more sensitive from the first threshold on: one branch, far below the cones'."""
    outcome, _ = run(tmp_path / "j", protocol(10.0, bleach_s=2.0))
    found = fitted(outcome)
    assert not found.has_break, found.verdict
    assert found.estimates["final_threshold"].value < Eye().cone_log10(30.0, 453.0) - 2.0


def test_run_that_died_is_lived_through_again_and_goes_on(tmp_path):
    """Cut anywhere, even in a line, the journal of the same command equals the undisturbed one byte for byte."""
    chosen = protocol(1.5, bleach_s=10.0)
    run(tmp_path / "whole", chosen)
    whole = (tmp_path / "whole").read_bytes()
    for share in (0.02, 0.4, 0.9):
        (tmp_path / "cut").write_bytes(whole[: int(share * len(whole))])
        run(tmp_path / "cut", chosen)
        assert (tmp_path / "cut").read_bytes() == whole


@pytest.mark.parametrize(("subject", "planted"), [("steady", 0.03), ("wanders", 0.4)])
def test_fixation_losses_are_found_as_they_were_planted(tmp_path, subject, planted):
    """The red LED in the blind spot, in the protocol's bytes: the interval holds the share of glances elsewhere."""
    chosen = protocol(12.0, bleach_s=10.0)
    check = chosen.fixation_check
    often = check.model_copy(update={"share": 0.3, "from_min": 1.0})
    watch = chosen.watch.model_copy(update={"lapse_share": 0.15})  # enough of them to know the lapses by
    chosen = chosen.model_copy(update={"fixation_check": often, "watch": watch})
    outcome, journal = run(tmp_path / "j", chosen, subject)
    found = outcome.reliability.rates["fixation_losses"]
    assert found.low <= planted <= found.high
    assert found.count.of > 20
    assert found.high - found.low < 0.5
    assert bool(journal.of_kind("fixation")) is (subject == "wanders")


def test_photographic_flashes_bleach_the_eye_before_the_box(tmp_path):
    """5·10⁶ scotopic td·s through 6 mm, 100 J·sr⁻¹·m⁻² each: three flashes, 10 s apart, by the box's trigger.

    The eye takes them for 1.81·10⁶ each (640 scotopic lm/W): 1 − exp(−0.543) = 42 % of the rods, a little less for what
    grows back in between.
    """
    flash = FlashBleach(kind="flash", retinal_td_s=5e6, pupil_mm=6.0, source="flash")
    chosen = protocol(5.0).model_copy(update={"bleach": flash})
    with open_box_stage(RunRequest(chosen, box="sim", simulate="steady")) as (stage, checks):
        assert [check().refusal for check in checks] == [None]
        stage.bleach(chosen)
        twin = stage.box.link.line.twin  # type: ignore[attr-defined]
        fired_ms = list(twin.flash.fired_ms)
        observer = twin.watch.__self__.observer
    assert len(fired_ms) == 3
    assert np.diff(fired_ms) == pytest.approx([10_000, 10_000], abs=300)
    rods = 0.0
    for _ in range(3):
        rods = 1 - (1 - rods * math.exp(-10 / 400)) * math.exp(-100 * 640 * math.pi * 9 / 1e7)
    assert 0.38 < rods < 0.42
    assert observer.eye.s2_zero_min == pytest.approx(recovery_min(rods, 0.24), rel=0.01)
    assert observer.dark_since_s == pytest.approx(fired_ms[-1] / 1000, abs=0.2)


def test_flashes_beyond_the_box_are_refused_before_the_first(tmp_path):
    """The trigger gives eight in a row: 2·10⁷ td·s would take thirteen, and nothing is fired."""
    flash = FlashBleach(kind="flash", retinal_td_s=2e7, pupil_mm=6.0, source="flash")
    chosen = protocol(5.0).model_copy(update={"bleach": flash})
    with (
        open_box_stage(RunRequest(chosen, box="sim")) as (stage, checks),
        RunJournal(tmp_path / "j", relive=True) as journal,
    ):
        with pytest.raises(RadiometerError, match="takes 13 flashes, the box fires 8 in a row"):
            run_test(chosen, stage, journal, subject="A1", checks=checks)
        assert not stage.box.link.line.twin.flash.fired_ms  # type: ignore[attr-defined]
