"""A calibration that is interrupted keeps what was measured, and the same call goes on from there."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import radiometer as rm
from radiometer.data import Calibration
from radiometer.data.storage import shipped_config
from radiometer.errors import UsageError


def _screen(out: Path, **how: Any) -> Any:
    levels = how.pop("levels", "0,64,128,192,255")
    return rm.screen_calibrate(out, "lcd", levels=levels, channels=("grey", "red"), **how)


def _light(out: Path, **how: Any) -> Any:
    per_decade = how.pop("levels", 1)
    return rm.light_calibrate(["fixation"], box="sim", points_per_decade=per_decade, seed=3, out=out, **how)


CALIBRATIONS = pytest.mark.parametrize(("calibrate", "other"), [(_screen, "0,128,255"), (_light, 2)])
Calibrate = Callable[..., Any]


class Interrupt:
    """Progress that counts the levels of this part, and interrupts after some of them."""

    def __init__(self, after: int | None = None) -> None:
        self.after, self.done, self.total = after, list[int](), 0

    def __call__(self, what: str, done: int, total: int | None) -> None:
        if "warms up" in what:
            return
        self.done.append(done)
        self.total = total or 0
        if len(self.done) == self.after:
            raise KeyboardInterrupt


def _radiances(found: Any) -> list[tuple[float, float]]:
    """Return the value and standard uncertainty of every level of every channel."""
    rows = []
    for channel in found.calibration.channels.values():
        if hasattr(channel, "points"):
            rows += [(p.radiance_W_per_sr_m2, p.radiance_W_per_sr_m2 * p.u_rel) for p in channel.points]
        else:
            known = (channel.radiance_at(level) for level in channel.levels)
            rows += [(one.value, one.u) for one in known]
    return rows


@CALIBRATIONS
def test_what_was_measured_is_not_measured_again(calibrate: Calibrate, other: Any, tmp_path: Path) -> None:
    """Interrupted twice, once within a torn line: the levels are those of an uninterrupted one, none measured twice."""
    whole, out, heard = calibrate(tmp_path / "whole.yaml"), tmp_path / "parts.yaml", list[str]()
    journal = tmp_path / "parts.yaml.journal"
    first, second, third = Interrupt(3), Interrupt(2), Interrupt()
    for part in (first, second):
        with pytest.raises(KeyboardInterrupt):
            calibrate(out, progress=part, notice=heard.append)
        assert str(journal) in heard[-1]
        assert not out.exists()
    journal.write_bytes(journal.read_bytes() + b'{"sequence": 9')  # the power failed while the next one was written
    found = calibrate(out, progress=third, notice=heard.append)
    assert first.done + second.done + third.done == list(range(1, third.total + 1))
    assert out.exists()
    assert not journal.exists()
    expected, parts = _radiances(whole), _radiances(found)
    assert len(parts) == len(expected)
    for (value, u), (known, u_known) in zip(sorted(parts), sorted(expected), strict=True):
        assert abs(value - known) <= 3.0 * (u + u_known) + 0.01 * known  # 1 %: the drift between the parts


def test_a_simulated_camera_is_no_better_known_than_a_real_one(tmp_path: Path) -> None:
    """Its responsivity is assumed flat as that of any other: 10 %, unless stated; the scale adds some 0.6 %."""
    assumed, stated = (_light(tmp_path / f"{u}.yaml", spectral_u_rel=u) for u in (None, 0.02))
    assert assumed.calibration.channels["fixation"].common_u_rel == pytest.approx(0.1, rel=0.01)
    assert stated.calibration.channels["fixation"].common_u_rel == pytest.approx(0.02, rel=0.1)


@CALIBRATIONS
def test_levels_of_another_calibration_are_refused(calibrate: Calibrate, other: Any, tmp_path: Path) -> None:
    """Other levels, or another kind of journal, are never mixed with it; what was measured stays."""
    out, journal = tmp_path / "parts.yaml", tmp_path / "parts.yaml.journal"
    with pytest.raises(KeyboardInterrupt):
        calibrate(out, progress=Interrupt(1))
    kept = journal.read_bytes()
    with pytest.raises(UsageError, match=r"parts\.yaml\.journal: begun with .*delete the file to begin anew"):
        calibrate(out, levels=other)
    assert journal.read_bytes() == kept
    journal.write_text('{"sequence": 0, "kind": "start", "format": "radiometer-adaptation/1", "time_s": 0}\n')
    with pytest.raises(UsageError, match="no journal of this kind"):
        calibrate(out)


def test_levels_are_not_joined_under_a_calibration_that_has_changed(tmp_path: Path) -> None:
    """A scale corrected under the same name and date would turn half of the levels into another unit."""
    known = Calibration.read(shipped_config("calibrations/simulated.yaml"))
    for scale in (known.scale, known.scale.model_copy(update={"value": 2.0 * known.scale.value})):
        replace(known, scale=scale).write(tmp_path / "cal.yaml")
        interrupted = scale is known.scale
        with pytest.raises(KeyboardInterrupt if interrupted else UsageError):
            _screen(tmp_path / "parts.yaml", calibration=tmp_path / "cal.yaml", progress=Interrupt(1))
