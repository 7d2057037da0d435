"""The reports in a real browser at three widths: they fit, can be read, load nothing, and no name in them acts."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import radiometer as rm
from radiometer.adaptation.adaptation_fit import FitRequest, fit_adaptation
from radiometer.adaptation.intervals import InterceptRule
from radiometer.adaptation.report import report_html
from radiometer.adaptation.threshold_series import ThresholdSeries
from radiometer.adaptation.visits import visits_html
from radiometer.analysis.characterise import characterise, read_subject
from radiometer.analysis.characterise.report import datasheet
from radiometer.analysis.characterise.taps import TapFigures
from radiometer.api.radiance import Radiance
from radiometer.archive.trend import MONTH_S, fit_trend
from radiometer.archive.trend_report import trend_report
from radiometer.data import CameraDescription, FrameSettings, LensDescription, PixelMask, RadianceMap, TapDescription
from radiometer.data.reading import Contribution, Flag, Patch, Quantity, Reading
from radiometer.reporting.reading_page import ReadingRecord, reading_html
from radiometer.screen.calibration import ChannelCurve, ScreenCalibration
from radiometer.screen.exports import to_page
from simulators.chain.camera_model import CameraModel
from simulators.scenes import UniformScene
from testing.report_checks import HOSTILE, assert_reports_hold
from testing.simulated_capture import simulate_capture


def _trends() -> str:
    rng = np.random.default_rng(1)
    days = np.concatenate([np.arange(60.0), np.arange(95.0, 180.0)])
    time_s = 1.75e9 + 86400.0 * days
    histories = []
    for name, drift in (("lamp " * 12, -0.01), (HOSTILE, 0.0), ("third", 0.002)):
        value = 0.8 * (1 + drift * (time_s - time_s[0]) / MONTH_S + 0.004 * rng.standard_normal(days.size))
        histories.append(fit_trend(time_s, value, 0.005 * value, patch=name, quantity="radiance", unit="W sr-1 m-2"))
    return trend_report([replace(one, flags={HOSTILE: 2}) for one in histories], "a-long-folder-name/" * 12)


def _adaptations() -> dict[str, str]:
    times = np.linspace(0.5, 25.0, 45)
    noise = np.random.default_rng(3).normal(0.0, 0.08, times.size)
    broken = -1.0 + 2.5 * np.exp(-np.minimum(times, 9.0) / 1.6) - 0.23 * np.maximum(times - 9.0, 0.0) + noise
    smooth = -4.0 + 3.0 * np.exp(-times / 6.0) + noise
    pages = {}
    for name, curve in (("adapt fit, break", broken), ("adapt fit, none", smooth)):
        series = ThresholdSeries(times, curve, None, {"subject": HOSTILE}, ("seconds",))
        request = FitRequest(bootstrap_draws=5, intercept=InterceptRule(-2.3, 12.3, source="a source"))
        pages[name] = report_html(fit_adaptation(series, request, np.random.default_rng(0)), HOSTILE)
    return pages


def _datasheet(folder: Path) -> str:
    camera = CameraDescription(
        bit_depth=12, model=HOSTILE, pixel_pitch_um=4.5, conversion_gain_e_per_dn=2.6, read_noise_e=3.0,
        full_well_e=10_500, dark_current_e_per_s=2.0, black_level_dn=64, quantum_efficiency=0.62,
    )  # fmt: skip
    model = CameraModel.ideal(camera, LensDescription(focal_length_mm=16, f_number=4.0))
    bright = [FrameSettings(float(t)) for t in np.linspace(0.002, 0.05, 12)]
    plan = [*bright, *(replace(one, shutter="closed") for one in bright)]
    scene = UniformScene(radiance_W_per_sr_m2=0.14)
    simulate_capture(model, plan, scene, folder, frames_per_setting=2, believed_camera=camera, seed=5)
    found = characterise(read_subject(folder, None))
    taps = [
        TapFigures(
            TapDescription(name=str(n), x=512 * n, y=1024, width=512, height=2048), found, Quantity(1042.6, 0.38, "DN")
        )
        for n in range(1, 9)
    ]
    return datasheet(found, taps)


def _reading() -> str:
    """Return the page of a reading with a long name of its calibration's file and every flag."""
    reading = Reading(
        Quantity(0.3265, 0.0017, "W sr-1 m-2"), Patch(40, 24, 16, 16), HOSTILE, Quantity(103.5, 0.5, "cd m-2"),
        tuple(Flag), (0.001, 0.02), (Contribution("scale", 0.005), Contribution(HOSTILE, 0.001, note=HOSTILE)),
        more={
            "assumptions": [HOSTILE],
            "calibration": {"file": "a-long-folder-name/" * 8, "created": "2026-03-02T14:30:00Z", "reference": HOSTILE},
        },
    )  # fmt: skip
    frame_dn = np.random.default_rng(2).integers(64, 4000, (64, 96))
    return reading_html(ReadingRecord(reading, frame_dn, HOSTILE, HOSTILE))


def _visits() -> str:
    times = np.linspace(0.5, 25.0, 45)
    found = []
    for day in range(2, 5):
        noise = np.random.default_rng(day).normal(0.0, 0.08, times.size)
        curve = -1.0 + 2.5 * np.exp(-np.minimum(times, 9.0) / 1.6) - 0.23 * np.maximum(times - 9.0, 0.0) + noise
        facts = {"subject": HOSTILE, "eye": "right", "visit": f"2026-03-0{day}T14:30:00Z", "protocol": "classic"}
        series = ThresholdSeries(times, curve, None, facts)
        found.append((fit_adaptation(series, FitRequest(bootstrap_draws=0), np.random.default_rng(0)), "name"))
    return visits_html(found)


def _analysis(folder: Path) -> str:
    """Return the page of a dim map with a profile, a region of a hostile name, and figures of many digits."""
    y, x = np.indices((64, 96))
    value = np.random.default_rng(4).normal(0.0003 * (1.0 + x / 96.0), 0.0002, y.shape).astype(np.float32)
    mask = np.where(value < 0.0004, PixelMask.BELOW_NOISE, PixelMask.GOOD).astype(np.uint8)
    found = Radiance({"mono": RadianceMap(value, np.full_like(value, 0.0002), mask, "W sr-1 m-2", 0.2)})
    regions = {HOSTILE: (0, 0, 40, 30), "right": (50, 10, 40, 40)}
    rm.analyse(found, regions=regions, line=(2, 2, 90, 60), spectrum="white_led").write_report(folder / "map.html")
    return (folder / "map.html").read_text(encoding="utf-8")


def _screen() -> str:
    levels, radiance = (0, 64, 128, 255), (0.0003, 0.04, 0.2, 0.7)
    u = tuple(0.01 * one for one in radiance)
    curve = ChannelCurve("grey", levels, radiance, u, 0.01, 320.0, 700.0, "white_led", detection_limit=1e-4)
    checks = {"warm_up": {"waited_s": 900.0, "drift_rel": 0.01, "steady": False}, "drift_rel": 0.004}
    return to_page(ScreenCalibration(HOSTILE, {"grey": curve}, checks=checks, measured_with={"camera": HOSTILE}))


async def test_reports_hold_in_a_browser_at_three_widths(tmp_path: Path) -> None:
    """Readings, maps, screens, trend, adaptation, visits and characterisation: with hostile names in each."""
    pages = {"trend": _trends(), **_adaptations(), "characterise": _datasheet(tmp_path / "set")}
    pages |= {"measure --report": _reading(), "adapt visits": _visits()}
    pages |= {"analyse --report": _analysis(tmp_path), "screen export": _screen()}
    await assert_reports_hold(pages, tmp_path)
