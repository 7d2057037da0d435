"""What is taken at a limit and refused beyond it, in which words; what files and requests may hold."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from radiometer.acquire.exposure_plan import ExposurePlan, exposure_ladder, repeats_for
from radiometer.analysis.photometry.photometry import retinal_illuminance_td
from radiometer.analysis.photometry.spectra import spectrum, spectrum_from_csv
from radiometer.analysis.photometry.spectral_correction import spectral_factor
from radiometer.analysis.signal.model import signal_model
from radiometer.analysis.signal.situation import (
    common_u_rel,
    f_number_u_rel,
    magnification_u_rel,
    situation_of,
    spectral_correction,
    spectral_u_rel,
    transmittance_u_rel,
    unknown_mismatch_u_rel,
    unstated_u_rel,
)
from radiometer.daemon.instrument import MeasurementSettings
from radiometer.daemon.journal import Journal
from radiometer.daemon.limits import Limits
from radiometer.daemon.station import Station
from radiometer.data import (
    CameraDescription,
    LensDescription,
    Patch,
    Scale,
)
from radiometer.data.guards import DEEPEST_NESTING, refuse_deep_yaml, refuse_large_picture
from radiometer.errors import CaptureError, RadiometerError
from tests.unit.daemon.conftest import QUICK, FakeBox, FakeInstrument
from tests.unit.held import world
from tests.unit.held.figures import digest, moved


def outcome_of(work: Callable[[], Any]) -> Any:
    """Return what work gives, or the kind and words of the error that it ends in."""
    try:
        return work()
    except (RadiometerError, ValueError) as error:
        return f"{type(error).__name__}: {error}"


def png(width: int, height: int, bits: int, colour: int) -> bytes:
    return b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + struct.pack(">IIBB", width, height, bits, colour) + bytes(7)


def tiff(order: str, width: int, height: int, samples: int, bits: int, kind: int = 3) -> bytes:
    """Return the head of a TIFF; the depths of several samples stand behind its directory."""
    mark = b"II*\0" if order == "<" else b"MM\0*"
    many = samples > 2
    entries = b""
    for tag, value in ((256, width), (257, height), (258, 8 + 2 + 12 * 4 if many else bits), (277, samples)):
        count, own = (samples, 4) if many and tag == 258 else (1, kind)
        packed = struct.pack(f"{order}{'H' if own == 3 else 'I'}", value)
        entries += struct.pack(f"{order}HHI", tag, own if tag != 258 or not many else 3, count) + packed.ljust(4, b"\0")
    behind = struct.pack(f"{order}{samples}H", *[bits] * samples) if many else b""
    return mark + struct.pack(f"{order}IH", 8, 4) + entries + behind


def exr(rows: int, columns: int) -> bytes:
    window = struct.pack("<4i", 10, -5, 10 + columns - 1, -5 + rows - 1)
    return b"v/1\x01" + bytes(4) + b"dataWindow\0box2i\0" + struct.pack("<I", 16) + window + bytes(20)


def hdr(rows: int, columns: int) -> bytes:
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (rows, columns)


def test_pictures_are_refused_from_the_size_they_were():
    """400 MB once decoded, by the header alone: each form's depth, channels and byte order; one row more is refused."""
    heads: dict[str, Callable[[int], bytes]] = {
        "PNG of 16 bits": lambda rows: png(20_000, rows, 16, 0),
        "PNG of 8 bits": lambda rows: png(20_000, rows, 8, 0),
        "PNG in colour": lambda rows: png(20_000, rows, 8, 2),
        "PNG in colour with alpha": lambda rows: png(20_000, rows, 16, 6),
        "PNG of a palette": lambda rows: png(20_000, rows, 8, 3),
        "TIFF II": lambda rows: tiff("<", 20_000, rows, 1, 16),
        "TIFF MM": lambda rows: tiff(">", 20_000, rows, 1, 8),
        "TIFF of 12 bits": lambda rows: tiff("<", 20_000, rows, 1, 12, 4),
        "TIFF in colour": lambda rows: tiff(">", 20_000, rows, 3, 16),
        "HDR": lambda rows: hdr(rows, 5_000),
        "EXR": lambda rows: exr(rows, 5_000),
    }
    told = {}
    for name, head in heads.items():
        taken, refused = 1, 60_000
        while refused - taken > 1:
            middle = (taken + refused) // 2
            fine = outcome_of(lambda head=head, middle=middle: refuse_large_picture(Path("a"), head(middle))) is None
            taken, refused = (middle, refused) if fine else (taken, middle)
        told[name] = [taken, outcome_of(lambda head=head, rows=refused: refuse_large_picture(Path("a"), head(rows)))]
    for name, content in {"cut": png(9, 9, 8, 0)[:25], "nothing": b"", "TIFF cut": tiff("<", 9, 9, 1, 8)[:20]}.items():
        told[name] = outcome_of(lambda content=content: refuse_large_picture(Path("a"), content))
    assert not moved("limits/pictures", told)


def test_a_head_that_was_cut_anywhere_is_left_to_its_decoder():
    """As long as a size's last byte is missing none is guessed and nothing breaks; from that byte on it is refused."""
    heads = {
        png(90_000, 90_000, 16, 2): 8 + 8 + 10, tiff(">", 60_000, 60_000, 1, 8): 8 + 2 + 4 * 12 - 2,
        tiff("<", 60_000, 60_000, 3, 16): 8 + 2 + 4 * 12 + 2, exr(90_000, 90_000): 8 + 17 + 4 + 16,
        hdr(90_000, 90_000): len(hdr(90_000, 90_000)),
    }  # fmt: skip
    for whole, needed in heads.items():
        for length in range(needed):
            refuse_large_picture(Path("a"), whole[:length])
        for length in range(needed, len(whole) + 1):
            with pytest.raises(CaptureError, match="MB decoded"):
                refuse_large_picture(Path("a"), whole[:length])


def test_a_tiff_that_states_no_bits_counts_a_byte_for_each_value():
    """Nobody decodes it, and nobody may be asked to make room for it."""
    refuse_large_picture(Path("a"), tiff("<", 20_000, 20_000, 1, 0))
    with pytest.raises(CaptureError, match="20001 × 20000 × 1 values, 400 MB"):
        refuse_large_picture(Path("a"), tiff("<", 20_000, 20_001, 1, 0))


def test_yaml_is_refused_from_the_depth_it_was():
    """Nesting by brackets and by blanks, at the limit and one deeper; repetitions once written out; what is no YAML."""

    def flow(depth: int) -> str:
        return "[" * depth + "1" + "]" * depth

    def block(depth: int) -> str:
        return "".join(" " * k + f"k{k}:\n" for k in range(depth)) + " " * depth + "- 1\n"

    def repeated(times: int, deep: int) -> str:
        rows = ["a0: &a0 [" + ",".join(["1"] * 9) + "]"]
        rows += [f"a{k}: &a{k} [" + ",".join([f"*a{k - 1}"] * times) + "]" for k in range(1, deep)]
        return "\n".join(rows) + "\n"

    texts = {
        **{f"flow {depth}": flow(depth) for depth in (DEEPEST_NESTING, DEEPEST_NESTING + 1)},
        **{f"block {depth}": block(depth) for depth in (DEEPEST_NESTING - 1, DEEPEST_NESTING)},
        "repeated a little": repeated(9, 5), "repeated": repeated(9, 9), "no YAML": "[" * 40 + "*",
    }  # fmt: skip

    def read(text: str) -> Any:
        try:
            return refuse_deep_yaml(text, "a.yaml")
        except yaml.YAMLError as error:
            return type(error).__name__

    told = {name: outcome_of(lambda text=text: read(text)) for name, text in texts.items()}
    assert not moved("limits/yaml", told)


def test_ladders_and_repeats_end_where_they_did():
    """A ladder at the camera's ends and past them, of 64 exposures and 65; repeats for what can and cannot be."""
    limits_s = (1e-5, 1.0)
    ladders = {
        "at both ends": (1e-5, 1.0, 2.0, limits_s),
        "a part in 10¹⁰ past": (1e-5 * (1 - 1e-10), 1.0 * (1 + 1e-10), 4.0, limits_s),
        "too short": (0.99e-5, 1.0, 2.0, limits_s),
        "too long": (1e-5, 1.01, 2.0, limits_s),
        "one": (0.1, 0.1, 1.0, limits_s, 3),
        "whole steps": (0.125, 1.0, 1.0, limits_s),
        "a last smaller step": (0.125, 0.9, 1.0, limits_s),
        "sixty-four": (1e-3, 1e-3 * 2**6.3, 0.1, limits_s),
        "sixty-five": (1e-3, 1e-3 * 2**6.4, 0.1, limits_s),
        "backwards": (0.2, 0.1, 1.0, limits_s),
        "no step": (0.1, 0.2, 0.0, limits_s),
        "no repeat": (0.1, 0.2, 1.0, limits_s, 0),
        "from nothing": (0.0, 0.2, 1.0, limits_s),
    }
    told: dict[str, Any] = {
        name: outcome_of(lambda ladder=ladder: list(exposure_ladder(*ladder).exposures_s))  # type: ignore[arg-type]
        for name, ladder in ladders.items()
    }
    plan, camera = ExposurePlan((1e-3, 1e-2, 0.1)), world.CAMERA
    rates = np.array([1e3, 2e4, 5e4])
    for target in (0.5, 0.01, 1e-3, 1e-4, 0.0, -1.0):
        told[f"repeats for {target:g}"] = [
            outcome_of(lambda target=target, gain=gain: repeats_for(plan, rates, camera, gain, target))
            for gain in (0.0, 12.0)
        ]
    told["repeats in the dark"] = repeats_for(plan, np.zeros(3), camera, 0.0, 0.01)
    told["repeats when all clips"] = repeats_for(plan, np.full(3, 1e9), camera, 0.0, 0.01)
    assert not moved("limits/plans", told)


def test_spectra_are_taken_and_refused_as_they_were(tmp_path, monkeypatch):
    """Names with numbers at their bounds, files, factors of lights that a table of responsivity reaches or does not."""
    monkeypatch.chdir(tmp_path)
    names = ("line:380", "line:379.9", "line:1100", "line:2000", "line:x", "planck:1000", "planck:999", "planck:25000")
    names += ("blackbody:3000", "band:500,20", "band:500,0", "band:500", "led:627", "nonsense", "line:", "band:a,b")
    told: dict[str, Any] = {}
    for name in names:
        told[name] = outcome_of(
            lambda name=name: [float(x) for x in (spectrum(name).integral(), *spectrum(name).band_nm)]
        )
    files = {
        "rising": "400,1\n500,2\n700,0.5\n", "with a header": "nm,power\n400,1\n500,2\n", "falling": "500,1\n400,1\n",
        "one line": "400,1\n", "dark": "400,0\n500,0\n", "negative": "400,1\n500,-1\n", "micrometres": "0.4,1\n0.7,1\n",
        "words": "400,1\n500,a\n",
    }  # fmt: skip
    for name, text in files.items():
        Path("s.csv").write_text(text)
        told[name] = outcome_of(lambda: [float(x) for x in (spectrum_from_csv(Path("s.csv")).integral(),)])
    tables = {
        "flat": "wavelength_nm,responsivity\n420,1\n680,1\n", "steep": "wavelength_nm,responsivity\n680,3\n420,1\n",
        "from 421": "wavelength_nm,responsivity\n421,1\n680,1\n",
        "to 679": "wavelength_nm,responsivity\n420,1\n679,1\n",
        "of nought": "wavelength_nm,responsivity\n420,0\n500,1\n680,1\n",
        "below nought": "wavelength_nm,responsivity\n420,-0.1\n680,1\n",
        "one": "wavelength_nm,responsivity\n420,1\n", "other": "nm,s\n420,1\n680,1\n",
    }  # fmt: skip
    for name, text in tables.items():
        Path("r.csv").write_text(text)
        for light in ((627.0, 18.0), (None, 0.0), (850.0, 30.0), (555.0, 0.0)):
            told[f"{name}, light {light[0]}"] = outcome_of(
                lambda light=light: spectral_factor("cie_a", light[0], light[1], Path("r.csv"))
            )
    told["no table"] = outcome_of(lambda: spectral_factor("cie_a", 627.0, 18.0, Path("none.csv")))
    told["flat efficiency"] = [
        spectral_factor("cie_a", *light) for light in ((627.0, 18.0), (450.0, 25.0), (None, 0.0))
    ]
    told["pupils"] = [outcome_of(lambda d=d: retinal_illuminance_td(100.0, d)) for d in (0.9, 1.0, 4.0, 10.0, 10.1)]
    assert not moved("limits/spectra", told, rel=1e-7)


def model_of(model: Any) -> dict[str, Any]:
    """Return the arrays and numbers of a signal model."""
    return {
        field.name: digest(value) if isinstance(value, np.ndarray) else value
        for field in fields(model)
        if isinstance(value := getattr(model, field.name), np.ndarray | bool | int | float)
    }


def test_what_a_situation_adds_to_u_is_as_it_was():
    """f-numbers, transmittances and focus unlike at calibration; spectra unlike it, known and unknown responses."""
    plain = world.calibration()
    doubts = world.doubts(f_number_u_rel=0.02, spectral_u_rel=0.0, efficacy_u_rel=0.01, magnification_u_rel=0.1)
    stated = replace(plain, uncertainties=doubts)
    lens = world.LENS
    told: dict[str, Any] = {
        "stops": [list(f_number_u_rel(one, doubts, numbers))  # type: ignore[arg-type]
                  for one in (stated, None) for numbers in ({4.0}, {4.0, 5.6}, {8.0}, {None})],
        "glass": [list(transmittance_u_rel(one, glass))
                  for one in (stated, None)
                  for glass in (lens, lens.model_copy(update={"transmittance": 0.5}),
                                LensDescription(focal_length_mm=16.0, transmittance=0.7))],
        "focus": [list(magnification_u_rel(one, glass))
                  for one in (stated, None)
                  for glass in (lens, lens.model_copy(update={"magnification": 0.2}),
                                lens.model_copy(update={"magnification": 0.2, "pupil_magnification": 2.0}))],
        "mismatch": [unknown_mismatch_u_rel(*pair) for pair in (("cie_a", "line:627"), ("line:627", "cie_a"))],
    }  # fmt: skip
    known = replace(stated, spectral_response=world.bell(540.0, 60.0))
    for name, one in {"unknown response": stated, "known response": known}.items():
        for light in ("equal_energy", "cie_a", "line:627"):
            for of_scale in (None, "cie_a"):
                scale: Scale = one.scale.model_copy(update={"spectrum": of_scale})
                asked = replace(one, spectrum=light, scale=scale)
                told[f"{name}, {light}, scale by {of_scale}"] = [
                    spectral_u_rel(asked, doubts), spectral_u_rel(asked, doubts, spectrum_stated=False),
                    unstated_u_rel(asked, doubts), unstated_u_rel(asked, doubts, "photopic"),
                    outcome_of(lambda asked=asked: list(spectral_correction(asked))),
                ]  # fmt: skip
    for name, one in {"calibrated": stated, "none": None}.items():
        told[f"common, {name}"] = outcome_of(
            lambda one=one: common_u_rel(situation_of(one, world.CAMERA, world.LENS), one)
        )
    eight = world.CAMERA.model_copy(update={"bit_depth": 8})
    for black_dn in (0.0, 3.0, 240.0, 252.0):
        told[f"curve above {black_dn:g} DN"] = outcome_of(
            lambda black_dn=black_dn: model_of(signal_model(eight, world.gamma_curve(), plain.noise, black_dn, 0.003))
        )
    other = CameraDescription(bit_depth=12, serial="8", model="another")
    told["another camera"] = outcome_of(lambda: situation_of(stated, other, world.LENS).scale)
    assert not moved("limits/situations", told, rel=1e-7)


async def test_settings_are_taken_and_refused_as_they_were(tmp_path):
    """Of a measurement, a light's level and a period: at the limits, a hair beyond them, and farther."""
    station = Station(FakeInstrument(openings=1), Journal(tmp_path / "j.sqlite"), box=FakeBox(), times=QUICK)
    base: MeasurementSettings = replace(station.settings, auto_exposure=False)
    told: dict[str, Any] = {}
    for name, low, high in (("exposure_s", 1e-5, 30.0), ("gain_db", 0.0, 48.0)):
        for value in (low, low * (1 - 5e-10), low * (1 - 1e-8) - 1e-12, high, high * (1 + 5e-10), high * (1 + 1e-8)):
            told[f"{name} {value:.12g}"] = outcome_of(
                lambda name=name, value=value: station.check_settings(replace(base, **{name: value}))  # type: ignore[arg-type]
            )
    for patch in ((0, 0, 64, 48), (0, 0, 65, 48), (0, 1, 64, 48), (63, 47, 1, 1), (64, 47, 1, 1), (-1, 0, 4, 4)):
        told[str(patch)] = outcome_of(lambda patch=patch: station.check_settings(replace(base, patch=Patch(*patch))))
    for wavelength in (299.9, 300.0, 1200.0, 1200.1):
        told[f"{wavelength:g} nm"] = outcome_of(
            lambda wavelength=wavelength: station.check_settings(replace(base, wavelength_nm=wavelength))
        )
    for every_s in (0.0, -1e-9, 86400.0, 86401.0, float("nan")):
        told[f"every {every_s:g} s"] = outcome_of(lambda every_s=every_s: station.set_every(every_s))
    box = station.box
    station.box = None
    for name, work in {"level": lambda: station.set_level("white", 0.5), "off": station.lights_off}.items():
        try:
            await work()
        except RadiometerError as error:
            told[f"no box: {name}"] = str(error)
    station.box = box
    assert station.box_keeper is not None
    used: list[tuple[str, float]] = []

    async def use(work: Any, channel: str, level: float) -> float:
        used.append((channel, level))
        return level

    station.box_keeper = SimpleNamespace(use=use, name="box")  # type: ignore[assignment]
    station._tell_status = lambda: None  # type: ignore[method-assign]
    for level in (0.0, 1.0, 1.0 + 5e-10, 1.00001, -0.1):
        try:
            told[f"level {level:.12g}"] = await station.set_level("white", level)
        except RadiometerError as error:
            told[f"level {level:.12g}"] = str(error)
    told["used"] = [list(one) for one in used]
    told["events"] = [list(one) for one in station.writer._events]
    assert not moved("limits/settings", told)


def test_what_clients_may_use_is_as_it_was():
    """Every limit of the interfaces that nobody changed."""
    assert not moved("limits/interfaces", asdict(Limits()))
