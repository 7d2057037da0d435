"""Fields of files, requests and options take what exists in the world, and refuse what their quantity cannot be."""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib
import math
import operator
import pkgutil
import random
import re
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from pydantic import BaseModel, TypeAdapter, ValidationError

import radiometer
import radiometer as rm
from radiometer.adaptation.protocol import Fixation, FixationCheck, SteadyBleach, read_protocol
from radiometer.bench.boxes import read_preset
from radiometer.data import Calibration, CameraDescription, FoundEffects, LensDescription, Scale, SourceDescription
from radiometer.data.capture_set import FrameEntry
from radiometer.data.light_calibration import LightCalibration
from radiometer.data.validation import ConfigSection, FileSection, validate
from radiometer.devices import CameraPreset
from radiometer.errors import InputError
from simulators.effects.lens import Lens

for part in ("adaptation", "bench", "data", "devices"):
    folder = importlib.import_module(f"{radiometer.__name__}.{part}")
    for one in pkgutil.iter_modules(folder.__path__):
        importlib.import_module(f"{folder.__name__}.{one.name}")


def models(kind: type[BaseModel]) -> list[type[BaseModel]]:
    """Return all kinds of section that are declared, of any depth."""
    return [found for sub in kind.__subclasses__() for found in (sub, *models(sub))]


def named(pattern: str) -> list[pytest.param]:
    """Return the numeric fields whose names match a pattern, as (what takes its values)."""
    found = []
    for model in {*models(FileSection), *models(ConfigSection)}:
        if not model.__module__.startswith(("radiometer.", "simulators.")):
            continue
        for name, field in model.model_fields.items():
            if re.search(pattern, name) and field.annotation in (float, float | None):
                takes = TypeAdapter(Annotated[field.annotation, *field.metadata])
                found.append(pytest.param(takes, id=f"{model.__name__}.{name}"))
    return sorted(found, key=lambda one: str(one.id))


def is_taken(takes: TypeAdapter[float], value: float) -> bool:
    """Tell whether a field takes a value."""
    try:
        takes.validate_python(value)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize("takes", named(r"(^|_)u_(rel|dn|s)(_|$)|^u$|^glare_u$"))
def test_an_uncertainty_may_be_nothing_but_not_less(takes):
    """0 is what is known exactly; −1e-9 is no standard uncertainty."""
    assert is_taken(takes, 0.0)
    assert not is_taken(takes, -1e-9)


@pytest.mark.parametrize(
    "takes", named(r"^(f_number|focal_length_\w+|wavelength_nm|pixel_\w+|full_well_e|validity_days)$")
)
def test_a_length_or_capacity_is_above_nothing(takes):
    """A lens of 0 mm or f/0, a wavelength or pixel of 0 and a validity of no time are mistakes."""
    assert not is_taken(takes, 0.0)
    assert not is_taken(takes, -1.0)


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (LensDescription, {"f_number": 0.95, "transmittance": 1.0}),  # f/0.95 lenses are sold for C-mount
        (LensDescription, {"f_number": 128.0, "focal_length_mm": 1.2, "transmittance": 0.015}),  # with a grey filter
        (LensDescription, {"magnification": 5.0, "pupil_magnification": 0.25}),
        (Scale, {"value": 1e-12, "u_rel": 0.0, "method": "known_radiance", "f_number": 0.95, "iso": 12_800.0}),
        (CameraDescription, {"bit_depth": 1}),
        (
            CameraDescription,
            {"bit_depth": 16, "read_noise_e": 0.0, "quantum_efficiency": 1.0, "dark_current_e_per_s": 0},
        ),
        (SourceDescription, {"wavelength_nm": 254.0, "reproducibility_u_rel": 0.0, "flicker_hz": 0.1}),
        (FrameEntry, {"file": "a.png", "exposure_s": 7200.0, "gain_db": -6.0, "source_level": 0.0}),
        (FrameEntry, {"file": "a.png", "exposure_s": 1e-6, "temperature_C": -100.0}),
        (FixationCheck, {"size_deg": 2.0, "temporal_deg": 13.5, "share": 0.3}),
        (Fixation, {"size_deg": 2.0, "luminance_cd_m2": 10.0}),
        (SteadyBleach, {"channel": "bleach", "luminance_cd_m2": 10_000.0, "duration_s": 600.0, "pupil_mm": 9.0}),
    ],
)
def test_what_exists_is_taken(model, fields):
    """Fast and slow lenses, one and sixteen bits, germicidal lamps, hours of exposure, cooled sensors: as stated."""
    made = model.model_validate(fields)
    assert {name: getattr(made, name) for name in fields} == fields


GOOD = {"file": "a.png", "exposure_s": 1.0}
SCALE = {"value": 1e-6, "u_rel": 0.01, "method": "known_radiance"}


@pytest.mark.parametrize(
    ("model", "fields", "shown"),
    [
        (FrameEntry, GOOD | {"exposure_s": 1e30}, "exposure_s.*1e\\+30 s is outside 0 to 1e\\+09 s"),
        (FrameEntry, GOOD | {"gain_db": 1e9}, "gain_db.*-200 to 200 dB"),
        (FrameEntry, GOOD | {"temperature_C": 1e6}, "temperature_C.*to 150 °C"),
        (FrameEntry, GOOD | {"black_level_dn": 1e300}, "black_level_dn.*-65536 to 65536 DN"),
        (Scale, SCALE | {"value": 1e300}, "value.*1e-15 to 1e\\+06"),
        (Scale, SCALE | {"value": 1e-300}, "value.*1e-15 to 1e\\+06"),
        (Scale, SCALE | {"unit": "mJ m-2"}, "unit = 'mJ m-2': input should be 'J m-2 per unit of signal'"),
        (FoundEffects, {"gains_db": (0.0, 1e9), "gain_errors_rel": (0.0, 0.1)}, "gains_db.*-200 to 200 dB"),
        (CameraDescription, {"bit_depth": 12, "full_well_e": 1e-300}, "full_well_e = 1e-300"),
    ],
)
def test_what_cannot_exist_is_refused_with_place_and_range(model, fields, shown):
    """A mistake of unit or power of ten: file, key, number and what is plausible."""
    with pytest.raises(InputError, match=f"^a.yaml: {shown}"):
        validate(model, fields, "a.yaml", InputError)


@pytest.mark.parametrize(
    "model", sorted({*models(FileSection), *models(ConfigSection)}, key=lambda one: one.__qualname__)
)
def test_true_is_no_number(model):
    """A level, bound or share that a file states as `true` is refused by its key: it would be 1."""
    for name, field in model.model_fields.items():
        if field.annotation in (int, float, int | None, float | None):
            with pytest.raises(ValidationError, match=rf"{name} = True: true and false are no numbers"):
                model.model_validate({name: True})


@pytest.mark.parametrize("number", [10**11, 10**20, "1" + "0" * 20, [10**11]], ids=["1e11", "1e20", "text", "list"])
@pytest.mark.parametrize(
    "model", sorted({*models(FileSection), *models(ConfigSection)}, key=lambda one: one.__qualname__)
)
def test_no_count_of_a_file_sizes_an_array_without_bound(model, number):
    """Bits, pixels, counts, seeds: each field that takes a whole number refuses what memory could not hold."""
    for name, field in model.model_fields.items():
        if re.search(r"\bint\b", str(field.annotation)):
            with pytest.raises(ValidationError, match=rf"{name} = .*: no count has this size; at most"):
                model.model_validate({name: number})


FILES = {
    "radiometer-bench/1": lambda path: rm.open(path, uncalibrated=True).close(),
    "radiometer-calibration/1": Calibration.read,
    "radiometer-camera/1": CameraPreset.read,
    "radiometer-light-box/1": read_preset,
    "radiometer-light-calibration/1": LightCalibration.read,
    "radiometer-protocol/1": read_protocol,
    "radiometer-screen/1": lambda path: rm.screen_level(path, 50.0),
}
SCREEN = """\
format: radiometer-screen/1
channels:
  grey: {levels: [0, 128, 255], bits: 8, radiance_W_per_sr_m2: [0, 0.1, 0.4], u_independent: [0.001, 0.001, 0.004],
    u_common_rel: 0.02, photopic_lm_per_W: 320, scotopic_lm_per_W: 700, spectrum: white_led}
"""


SELF: list[object] = []
SELF.append(SELF)
ODD = (None, [], {}, "text", "", math.nan, math.inf, -1, 0, 1e-300, 1e300, True, [1, [2]], {"a": {"b": []}}, SELF)


def places(content: object, path: tuple[object, ...] = ()) -> Iterator[tuple[tuple[object, ...], object]]:
    """Yield the path to each key and entry of a file, and what stands there."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, inside in items:
        yield (*path, key), inside
        yield from places(inside, (*path, key))


def changed(content: object, place: tuple[object, ...], value: object) -> str:
    """Return a file with another value at a place."""
    new = copy.deepcopy(content)
    functools.reduce(operator.getitem, place[:-1], new)[place[-1]] = value
    return yaml.safe_dump(new)


def shipped(root: Path) -> list[dict[str, Any]]:
    """Return the content of a file of each form: those of the package, and a screen's calibration."""
    texts = [path.read_text() for path in sorted((root / "configs").rglob("*.yaml"))]
    return [content for content in map(yaml.safe_load, (*texts, SCREEN)) if content.get("format") in FILES]


def test_no_odd_value_of_a_file_is_a_defect_of_the_program(project_root, tmp_path):
    """Null, lists, mappings, text, NaN, nothing, a list that holds itself: at places by chance, refused in a line."""
    rng, file, printed = random.Random(20261127), tmp_path / "changed.yaml", list[str]()
    every = [(one, place) for one in shipped(project_root) for place, _ in places(one) if len(place) < 5]
    tried = [(*one, SELF) for one in every[::20]] + [(*rng.choice(every), rng.choice(ODD)) for _ in range(300)]
    for content, place, value in tried:
        file.write_text(changed(content, place, value))
        try:
            FILES[content["format"]](file)
        except rm.RadiometerError as error:
            printed.append(str(error))
    assert len(printed) > 100
    assert all(line.strip() and "\n" not in line for line in printed)


def test_no_whole_number_of_a_file_takes_memory_or_time(project_root, tmp_path):
    """Every number of every shipped form, as 10¹¹ and 10²⁰: refused in a line, or at least read at once."""
    at_first, seen = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, set()
    file = tmp_path / "changed.yaml"
    every = shipped(project_root)
    for content in (*every[::2], every[-1]):
        for place in (place for place, value in places(content) if type(value) is int):
            seen.add(content["format"])
            for number in (10**11, 10**20):
                file.write_text(changed(content, place, number))
                began = time.monotonic()
                with contextlib.suppress(rm.RadiometerError):
                    FILES[content["format"]](file)
                assert time.monotonic() - began < 5.0, place
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - at_first < 1_000_000  # kB
    assert {"radiometer-bench/1", "radiometer-screen/1", "radiometer-protocol/1"} <= seen


def test_a_simulated_lens_may_be_nearly_opaque():
    """1 % is a lens behind a grey filter of density 2, for the sun."""
    assert Lens(transmittance=0.01).transmittance == 0.01
    assert not math.isclose(Lens().transmittance, 0.01)


@pytest.mark.parametrize(
    ("gains_db", "errors", "taken"),
    [((), (), True), ((0.0, 6.0), (0.01, 0.02), True), ((0.0, 6.0), (0.01,), False), ((0.0,), (0.01, 0.02), False),
     ((6.0, 0.0), (0.01, 0.02), False), ((0.0, 0.0), (0.01, 0.02), False)],
)  # fmt: skip
def test_a_table_of_gains_has_one_error_for_each(gains_db, errors, taken):
    """Gains rise, and none lacks its error."""
    if taken:
        assert FoundEffects(gains_db=gains_db, gain_errors_rel=errors).gain_errors_rel == errors
    else:
        with pytest.raises(ValidationError, match="one error per gain, gains rising"):
            FoundEffects(gains_db=gains_db, gain_errors_rel=errors)
