"""Digital calibration certificates of readings and calibrations."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import radiometer
from radiometer.analysis.exports.certificate import Certified, Item, Laboratory, certificate_xml, stated_factor
from radiometer.analysis.reading.budget import OBSERVED, coverage_factor
from radiometer.api.files import PathLike
from radiometer.api.result import Result
from radiometer.data import Calibration, Contribution, Flag, Quantity, Reading
from radiometer.data.capture_set import refuse_inputs
from radiometer.data.reading import LUMINANCE_UNIT, RADIANCE_UNIT, of_reading
from radiometer.data.storage import check_outputs, write_text_atomic
from radiometer.errors import InputError, UsageError
from radiometer.moments import moment_of
from radiometer.plausible import PLAUSIBLE
from radiometer.reporting.origin import Origin
from radiometer.reporting.page import listed, page, section, table

_RELATIVE: Final = "a relative value has no SI unit and cannot be certified; calibrate the camera first"
_READING_METHOD: Final = (
    "An imaging sensor reads the patch at several exposures. Its response, black level and absolute scale come from "
    "the calibration that is named as equipment. The uncertainty follows the GUM.",
)


@dataclass(frozen=True, repr=False)
class Certificate(Result):
    """A digital calibration certificate.

    Attributes:
        content: What it states of the measurement.
        laboratory: Who measured, for whom.
        file: The XML file; None where it was not written.
        page: The page for people next to it; None where it was not written.
    """

    content: Certified
    laboratory: Laboratory
    file: Path | None = None
    page: Path | None = None

    def to_xml(self) -> str:
        """Return the certificate as XML. Raises InputError if a unit has no form in D-SI."""
        return certificate_xml(self.content, self.laboratory)

    def to_html(self) -> str:
        """Return the certificate as one self-contained page."""
        content, laboratory = self.content, self.laboratory
        results = [(name, one.text(k), f"{k:.3g}") for name, one, k in content.results]
        parties = [
            ("certificate", content.identifier),
            ("item", " ".join(filter(None, (content.item.manufacturer, content.item.model, content.item.name)))),
            ("serial number", content.item.serial),
            ("laboratory", f"{laboratory.laboratory.name}, {laboratory.laboratory.city}"),
            ("customer", f"{laboratory.customer.name}, {laboratory.customer.city}"),
            ("responsible", ", ".join(filter(None, (laboratory.responsible.name, laboratory.responsible.role)))),
            *content.conditions,
        ]
        budget = [(line.name, line.kind, f"{100 * line.u_rel:.2g} %") for line in content.budget]
        parts = [
            section(
                "Result, ± its expanded uncertainty (95.45 %)", table(("quantity", "value", "k"), results, words=(0,))
            ),
            section("Certificate", table(("", ""), parties, words=(1,))),
            section("Method", listed(content.method)),
            section("Uncertainty budget", table(("contribution", "type", "u (k = 1)"), budget, words=(0,))),
        ]
        origin = Origin(content.date, further=content.equipment)
        outcome = f"{content.results[0][0]}: {results[0][1]} (k = {results[0][2]})"
        return page(content.title, outcome, parts, kind="certificate", origin=origin)

    def to_mapping(self) -> dict[str, Any]:
        known = self.content
        results = {name: {**one.to_mapping(), "coverage_factor": k} for name, one, k in known.results}
        item = known.item.model_dump(mode="json")
        return self.plain("file", "page", identifier=known.identifier, item=item, date=known.date, results=results)

    def __str__(self) -> str:
        (name, one, k), item = self.content.results[0], self.content.item
        return f"{self.content.identifier}: {item.name} {item.serial}, {name} {one.text(k)} (k = {k:.3g})"


def certificate(
    source: Reading | Calibration | PathLike,
    out: PathLike | None = None,
    *,
    laboratory: PathLike,
    identifier: str,
    force: bool = False,
) -> Certificate:
    """Make a digital calibration certificate (DCC 3 with D-SI) of a reading or of a calibration.

    It states value, expanded uncertainty, coverage factor and probability, budget, method, equipment and conditions.

    Examples:
        >>> import radiometer as rm
        >>> made = rm.certificate("calibration.yaml", laboratory="laboratory.yaml", identifier="2026-001")
        >>> made
        <Certificate 2026-001: ...>

    Args:
        source: A reading, the file with its JSON (`measure --json`), or a calibration or its file.
        out: XML file to write; a page for people is written next to it with the ending .html.
        laboratory: YAML file (`radiometer-laboratory/1`) with laboratory, customer, responsible person and item.
        identifier: Number of the certificate, unique in the laboratory.
        force: Replace files that exist.

    Raises:
        UsageError: If the item or its maker is not stated, or the value is a relative one.
        InputError: If a file cannot be used.
        OutputError: If a file cannot be written.
    """
    if not identifier.strip():
        raise UsageError("--identifier: a certificate needs a number")
    written = [] if out is None else [Path(out), Path(out).with_suffix(".html")]
    check_outputs(*written, force=force)
    refuse_inputs(written, [Path(one) for one in (source, laboratory) if isinstance(one, str | os.PathLike)])
    known = Laboratory.read(Path(laboratory))
    content = _certified(source, known, identifier.strip())
    made = Certificate(content, known, *written)
    for file, text in zip(written, (made.to_xml, made.to_html), strict=False):
        write_text_atomic(file, text())
    return made


def _certified(source: Reading | Calibration | PathLike, laboratory: Laboratory, identifier: str) -> Certified:
    if isinstance(source, Calibration):
        return _of_calibration(source, identifier)
    if not isinstance(source, Reading) and Path(source).suffix.lower() in (".yaml", ".yml"):
        return _of_calibration(Calibration.read(Path(source)), identifier)
    return of_reading(source, lambda content: _of_reading(content, laboratory, identifier))


def _of_reading(content: dict[str, Any], laboratory: Laboratory, identifier: str) -> Certified:
    if laboratory.item is None:
        raise UsageError(
            "the laboratory file states no item; a certificate of a reading needs the source that was read"
        )
    stated = {name: content[name] for name in ("radiance", "luminance") if content.get(name)}
    if stated["radiance"]["unit"] == "relative" or Flag.UNCALIBRATED.value in content["flags"]:
        raise UsageError(_RELATIVE)
    k = stated_factor(float(content["coverage_factor"]))
    if Flag.SATURATED.value in content["flags"]:
        raise InputError("the reading is saturated: its value is a lower bound, which no certificate states")
    results = tuple((name, _result(name, stated[name]), k) for name in stated)
    _refuse_changed(content, results[0][1], k)
    budget = tuple(
        Contribution(str(line["name"]), float(line["u_rel"]), str(line.get("kind", "B")))
        for line in content.get("budget", [])
    )
    known, equipment = content.get("calibration") or {}, [("camera", str(content["instrument"]))]
    words = (Path(str(known.get("file") or "")).name, str(known.get("created", ""))[:10], known.get("reference"))
    if any(words):
        equipment.append(("calibration", ", ".join(str(word) for word in words if word)))
    exposures = ", ".join(f"{one:.4g} s" for one in content["exposures_s"])
    region = "{x},{y} {width} × {height} pixels".format(**content["patch"])
    conditions = [("exposure times", exposures), ("region of the picture", region)]
    conditions += [("flag", str(flag)) for flag in content["flags"]]
    conditions += [("assumption", str(one)) for one in content.get("assumptions", [])]
    return Certified(
        identifier=identifier, title="radiance of a patch", date=_day(str(content["time"])), method=_READING_METHOD,
        item=laboratory.item, equipment=tuple(equipment), conditions=tuple(conditions), results=results, budget=budget,
        version=radiometer.__version__,
    )  # fmt: skip


def _refuse_changed(content: dict[str, Any], radiance: Quantity, k: float) -> None:
    """Raise InputError where k is 1 % off that of the degrees of freedom or of U, which no rounding explains."""
    freedom, expanded_rel = content.get("degrees_of_freedom"), content.get("U_rel")
    belongs = [] if freedom is None else [coverage_factor(float(freedom))]
    belongs += [] if expanded_rel is None else [float(expanded_rel) / radiance.u_rel]
    for one in belongs:
        if not abs(k - one) <= 0.01 * k:
            raise InputError(
                f"coverage_factor is {k:g}; for 95.45 % the reading's degrees_of_freedom and "
                f"U_rel make it {one:.3g}: state the reading as `radiometer measure` printed it"
            )


def _result(name: str, stated: dict[str, Any]) -> Quantity:
    """Return a quantity of a reading as a file states it. Raises InputError if no reading has it."""
    unit = {"radiance": RADIANCE_UNIT, "luminance": LUMINANCE_UNIT}[name]
    if stated["unit"] != unit:
        raise InputError(f"{name} has the unit {stated['unit']!r}; a reading states it in {unit}")
    value, u = PLAUSIBLE[name].check(name, float(stated["value"])), float(stated["u"])
    if not 0.0 < u < math.inf:
        raise InputError(f"{name}: the standard uncertainty is {u:g}; it must be above 0")
    return Quantity(value, u, unit)


def _day(time: str) -> str:
    """Return the day of a time in ISO 8601. Raises InputError if it is none, or in the future."""
    try:
        moment = moment_of(time)
    except ValueError as error:
        raise InputError(f"time {time[:40]!r} is none of ISO 8601") from error
    if moment > datetime.now(UTC) + timedelta(days=1):
        raise InputError(f"time {time[:40]} is in the future; correct the clock or the file")
    return moment.date().isoformat()


def _of_calibration(calibration: Calibration, identifier: str) -> Certified:
    if not calibration.absolute:
        raise UsageError(_RELATIVE)
    camera, scale = calibration.camera, calibration.scale
    if not (camera.vendor and camera.serial):  # the laboratory's item is the source that it reads
        raise UsageError(
            "the calibration does not state which camera it is of, which is the certificate's item; state maker and "
            "serial number in its file (camera: vendor, serial)"
        )
    item = Item(name="camera", manufacturer=camera.vendor, model=camera.model or "", serial=camera.serial)
    conditions = [("spectrum", calibration.spectrum)]
    if scale.f_number is not None:
        conditions.append(("f-number", f"{scale.f_number:g}"))
    conditions += [("assumption", one) for one in calibration.provenance.assumptions]
    exposure = Quantity(scale.value, scale.value * scale.u_rel, "J m-2")
    budget = (Contribution(name, u_rel, "A" if name in OBSERVED else "B") for name, u_rel in scale.budget.items())
    return Certified(
        identifier=identifier, title="radiometric calibration of a camera", date=calibration.created[:10],
        method=(f"The scale is by {scale.method.replace('_', ' ')}.",), item=item,
        equipment=(("reference", scale.reference),) if scale.reference else (), conditions=tuple(conditions),
        results=(("exposure per unit of the linear signal", exposure, 2.0),), budget=tuple(budget),
        version=radiometer.__version__,
    )  # fmt: skip
