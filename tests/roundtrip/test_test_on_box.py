"""The whole test through the simulated box: the subject sees its LEDs and presses its button, as on hardware."""

import math
import os

import numpy as np
import pytest

from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.box_setup import open_box_stage
from radiometer.adaptation.journal import RunJournal
from radiometer.adaptation.protocol import FlashBleach, SteadyBleach, read_protocol
from radiometer.adaptation.request import RunRequest
from radiometer.adaptation.run import run_test
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.data.config_files import shipped_config
from simulators.observers.eye_kinetics import Eye, eye_after_bleach, recovery_min, scotopic_lm_per_w
from simulators.observers.observer_at_box import WHITE_LM_PER_W

# Radiance for 750 cd/m² by the protocol's white LED (316.9 lm/W), as the simulated eye sees it.
BLEACH_CD_M2 = 750.0 / 316.9 * WHITE_LM_PER_W


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
    assert truth is not None
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


@pytest.mark.parametrize(("subject", "planted"), [("steady", 0.03), ("wanders", 0.4)])
def test_fixation_losses_are_found_as_they_were_planted(tmp_path, subject, planted):
    """The red LED in the blind spot, in the protocol's bytes: the interval holds the share of glances elsewhere."""
    chosen = protocol(12.0, bleach_s=10.0)
    check = chosen.fixation_check
    assert check is not None
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
