"""A light box and a camera that looks at it, for `radiometer light calibrate`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from radiometer.acquire.light_levels import LevelSurvey, Progress, SpectralCorrection
from radiometer.analysis.photometry.spectral_correction import FLAT_QUANTUM_EFFICIENCY_U_REL, spectral_factor
from radiometer.bench.assembly import calibration_path, open_instrument, require_absolute
from radiometer.bench.boxes import OpenedBox
from radiometer.bench.cameras import SIMULATED as SIMULATED_CAMERA
from radiometer.bench.cameras import simulated_parts
from radiometer.bench.config import SimulatedCameraConfig, read_bench
from radiometer.bench.instrument import Instrument
from radiometer.data import Calibration, Patch, Provenance
from radiometer.data.event_journal import EventJournal
from radiometer.data.light_calibration import ChannelCalibration, LightCalibration
from radiometer.data.storage import shipped_config
from radiometer.errors import UsageError
from simulators.chain.camera_model import CameraModel
from simulators.light_box.camera import BoxView, HookedClock, LightBoxCamera

BENCH: Final = "bench-light-box.yaml"


@dataclass(frozen=True, slots=True)
class SurveyRequest:
    """What to calibrate and how."""

    channels: tuple[str, ...]  # names of the channels
    points_per_decade: float = 4.0  # density of the levels
    seed: int | None = None  # makes the random order; None for another one each time
    # CSV of the camera's relative responsivity per watt; None takes its quantum efficiency as flat
    responsivity: Path | None = None
    # Relative standard uncertainty of the spectral correction; None for that of a flat quantum efficiency
    spectral_u_rel: float | None = None
    target_u_rel: float = 0.003  # relative standard uncertainty required of a reading's noise


@contextmanager
def open_light_camera(
    opened: OpenedBox,
    name: str | None,
    bench: Path | None,
    patch: Patch | None,
    calibration: Path | None,
    ambient_w_sr_m2: float = 0.0,
) -> Iterator[Instrument]:
    """Open the camera that looks at a box for the block; a simulated box is looked at by a simulated camera.

    Args:
        opened: The open box.
        name: Camera by name; the bench's own where None.
        bench: Bench file; the shipped one where None.
        patch: Where to read; the bench's where None.
        calibration: Calibration of the camera; the bench's where None.

    Raises:
        UsageError: If a simulated box is to be looked at by a real camera.
        CalibrationError: If the camera has no absolute calibration.
    """
    if opened.twin is None:
        with open_instrument(bench, name, patch, calibration) as instrument:
            yield _absolute(instrument)
        return
    if name not in (None, SIMULATED_CAMERA):
        raise UsageError(f"the simulated box can only be looked at by the simulated camera, not by {name}")
    yield _absolute(_simulated_instrument(opened, bench, patch, calibration, ambient_w_sr_m2))


def survey_box(
    opened: OpenedBox,
    instrument: Instrument,
    request: SurveyRequest,
    progress: Progress | None = None,
    journal: EventJournal | None = None,
) -> LightCalibration:
    """Measure channels of a box and return its calibration; channels calibrated before are kept.

    Args:
        journal: Open journal that keeps every level; levels in it are not measured again.

    Raises:
        MeasurementError: If a channel does not stand out of the noise.
        DeviceError: If box or camera fails.
    """
    survey = LevelSurvey(
        opened.box,
        lambda: instrument.measure(target_u_rel=request.target_u_rel),
        opened.wait,
        np.random.default_rng(request.seed),
        request.points_per_decade,
        progress,
        EventJournal(None) if journal is None else journal,
    )
    found: dict[str, ChannelCalibration] = dict(opened.calibration.channels) if opened.calibration else {}
    corrections = {name: _correction(opened, instrument, request, name) for name in request.channels}
    for name in request.channels:
        found[name] = survey.survey(name, corrections[name])
    return LightCalibration(opened.box.identity.serial, found, provenance=_provenance(instrument, request, corrections))


def asked_of(opened: OpenedBox, instrument: Instrument, request: SurveyRequest) -> dict[str, Any]:
    """Return what a survey measures and with what, by name: what a journal must agree in to be continued."""
    calibration = instrument.calibration
    return asdict(request) | {
        "responsivity": None if request.responsivity is None else str(request.responsivity),
        "box": opened.box.identity.serial,
        "camera": instrument.camera.identity.serial,
        "patch": astuple(instrument.patch),
        "calibration": None if calibration is None else calibration.content_hash(),
    }


def _correction(opened: OpenedBox, instrument: Instrument, request: SurveyRequest, channel: str) -> SpectralCorrection:
    optics, calibration = opened.config.optics[channel], instrument.calibration
    assert calibration is not None
    u_rel = FLAT_QUANTUM_EFFICIENCY_U_REL if request.spectral_u_rel is None else request.spectral_u_rel
    factor = spectral_factor(calibration.spectrum, optics.peak_nm, optics.fwhm_nm, request.responsivity)
    return SpectralCorrection(factor, u_rel)


def _provenance(
    instrument: Instrument, request: SurveyRequest, corrections: dict[str, SpectralCorrection]
) -> Provenance:
    calibration = instrument.calibration
    assert calibration is not None
    sensitivity = str(request.responsivity) if request.responsivity else "flat quantum efficiency"
    return Provenance(
        "camera readings over level, random order, drift reference, dark subtracted",
        inputs=(f"camera {instrument.camera.identity.serial}", f"camera calibration of {calibration.created}"),
        assumptions=(
            f"camera calibrated with {calibration.spectrum} light; spectral correction by {sensitivity}",
            "the radiance is that of the settled LED, averaged over its PWM",
        ),
        parameters={
            "spectral_factor": {name: correction.factor for name, correction in corrections.items()},
            "spectral_u_rel": {name: correction.u_rel for name, correction in corrections.items()},
            "seed": request.seed,
        },
    )


def _absolute(instrument: Instrument) -> Instrument:
    require_absolute(instrument.calibration)
    # The box's light is known: the survey corrects every channel's readings for it, with its uncertainty.
    return replace(instrument, spectrum_stated=True)


def _simulated_instrument(
    opened: OpenedBox, bench: Path | None, patch: Patch | None, calibration: Path | None, ambient_w_sr_m2: float
) -> Instrument:
    file = bench or shipped_config(BENCH)
    config, where = read_bench(file)
    camera_config, twin = config.camera, opened.twin
    if not isinstance(camera_config, SimulatedCameraConfig) or twin is None:
        raise UsageError(f"{where}: its camera is not simulated, the light box is; use a bench with a simulated camera")
    datasheet, limits = simulated_parts(camera_config, where)
    clock = HookedClock(opened.box.link.line.now, opened.wait)
    model = CameraModel.ideal(datasheet, config.lens_description)
    camera = LightBoxCamera(
        model,
        BoxView(twin, ambient_w_sr_m2),
        limits=limits,
        clock=clock,
        seed=camera_config.seed,
        serial=camera_config.serial,
    )
    camera.open()
    camera.configure(
        replace(camera.settings, black_level_dn=camera_config.black_level_dn, gain_db=camera_config.gain_db)
    )
    known = calibration or calibration_path(config, bench)
    area = patch or (config.patch.patch if config.patch else Patch(0, 0, limits.width, limits.height))
    return Instrument(
        camera,
        area,
        calibration=Calibration.read(known) if known else None,
        time_limit_s=config.time_limit_s,
        clock=clock.now_s,
    )
