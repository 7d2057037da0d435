"""Digital calibration certificates: what they state, and that a value read back is the value written."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

import radiometer as rm
from radiometer.analysis.exports.certificate import SCHEMA_VERSION, read_certificate
from radiometer.data import Calibration, Contribution, Patch, Quantity, Reading
from radiometer.errors import ConfigurationError, InputError, OutputRefused, UsageError

LABORATORY = """\
format: radiometer-laboratory/1
laboratory: {name: Light laboratory, email: lab@example.org, city: Bonn, country: DE}
customer: {name: "Müller & <Co>", email: buyer@example.org, city: Graz, country: AT}
responsible: {name: R. Smith, role: head}
item: {name: lamp, manufacturer: Maker, model: L1, serial: "0042"}
"""
NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """Return a laboratory file."""
    path = tmp_path / "laboratory.yaml"
    path.write_text(LABORATORY, encoding="utf-8")
    return path


def reading(unit: str = "W sr-1 m-2") -> Reading:
    """Return a reading of 0.3 ± 0.003 (k = 1) with a budget."""
    return Reading(
        Quantity(0.3, 0.003, unit),
        Patch(4, 5, 16, 12),
        "22500001",
        luminance=Quantity(61.0, 1.2, "cd m-2"),
        exposures_s=(0.001, 0.004),
        budget=(Contribution("scale", 0.008), Contribution("repeatability", 0.006, "A")),
        coverage_factor=2.13,
    )


def test_a_certificate_states_value_uncertainty_budget_item_and_conditions(tmp_path, laboratory):
    """A certificate states value uncertainty budget item and conditions."""
    made = rm.certificate(reading(), tmp_path / "c.xml", laboratory=laboratory, identifier="2026-7")
    root = ET.parse(tmp_path / "c.xml").getroot()
    radiance = root.find(".//si:real[si:label='radiance']", NAMES)
    assert float(radiance.findtext("si:value", "", NAMES)) == 0.3
    assert radiance.findtext("si:unit", "", NAMES) == r"\watt\steradian\tothe{-1}\metre\tothe{-2}"
    assert float(radiance.findtext(".//si:uncertainty", "", NAMES)) == pytest.approx(2.13 * 0.003)
    assert float(radiance.findtext(".//si:coverageFactor", "", NAMES)) == 2.13
    assert float(radiance.findtext(".//si:coverageProbability", "", NAMES)) == pytest.approx(0.9545)
    assert root.findtext(".//dcc:uniqueIdentifier", "", NAMES) == "2026-7"
    assert root.findtext(".//dcc:customer/dcc:name/dcc:content", "", NAMES) == "Müller & <Co>"
    assert [one.text for one in root.iterfind(".//dcc:list//si:label", NAMES)] == ["scale", "repeatability"]
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    assert "Müller &amp; &lt;Co&gt;" in page
    assert made.to_mapping()["results"]["radiance"]["coverage_factor"] == 2.13


@pytest.mark.parametrize(("k", "stated"), [(2.0000024, "2.0"), (2.1349, "2.13")])
def test_a_certificate_states_k_to_three_digits_and_u_times_that_k(tmp_path, laboratory, k, stated):
    """U over k is the reading's u, whatever Student's t gave."""
    made = rm.certificate(
        replace(reading(), coverage_factor=k), tmp_path / "c.xml", laboratory=laboratory, identifier="2"
    )
    radiance = ET.parse(tmp_path / "c.xml").getroot().find(".//si:real[si:label='radiance']", NAMES)
    assert radiance.findtext(".//si:coverageFactor", "", NAMES) == stated
    assert float(radiance.findtext(".//si:uncertainty", "", NAMES)) == pytest.approx(float(stated) * 0.003, rel=1e-12)
    assert made.to_mapping()["results"]["radiance"]["coverage_factor"] == float(stated)


@pytest.mark.slow
def test_a_printed_reading_is_certified_with_its_budget_and_calibration(tmp_path, laboratory):
    """What `measure --json` prints names every contribution, and the calibration that the reading rests on."""
    (tmp_path / "reading.json").write_text(rm.measure().to_json(), encoding="utf-8")
    made = rm.certificate(tmp_path / "reading.json", tmp_path / "c.xml", laboratory=laboratory, identifier="3")
    assert made.content.budget[0].name == "scale"
    assert "calibration</dt><dd>simulated.yaml, 2026-11-21" in (tmp_path / "c.html").read_text(encoding="utf-8")


def test_a_calibration_and_what_is_read_are_certified(project_root, laboratory, tmp_path):
    """As its camera; a certified source gives value and u back."""
    stored = project_root / "configs" / "calibrations" / "simulated.yaml"
    made = rm.certificate(stored, tmp_path / "c.xml", laboratory=laboratory, identifier="2")
    assert made.content.item.name == "camera"  # not the laboratory's item, which is the source that it reads
    assert made.content.item.serial == Calibration.read(stored).camera.serial
    kinds = {line.name: line.kind for line in made.content.budget}
    assert (kinds["repeatability"], kinds["reference source"]) == ("A", "B")
    name, scale, k = made.content.results[0]
    assert (name, scale.unit, k) == ("exposure per unit of the linear signal", "J m-2", 2.0)
    assert scale.u > 0
    rm.certificate(reading(), tmp_path / "s.xml", laboratory=laboratory, identifier="1")
    assert read_certificate(tmp_path / "s.xml", "W sr-1 m-2") == Quantity(0.3, pytest.approx(0.003), "W sr-1 m-2")
    assert read_certificate(tmp_path / "s.xml", "cd m-2").u == pytest.approx(1.2)
    (tmp_path / "r.json").write_text(json.dumps(reading().to_mapping()))
    of_file = rm.certificate(tmp_path / "r.json", laboratory=laboratory, identifier="1")
    assert of_file.content.results == rm.certificate(reading(), laboratory=laboratory, identifier="1").content.results


def test_certificates_are_valid_against_the_schema(project_root, tmp_path, laboratory):
    """dcclib of PTB finds no error in that of a reading, and of a calibration.

    It downloads the schema, unless RADIOMETER_DCC_SCHEMA names the file.
    """
    dcclib = pytest.importorskip("dcclib.validation")
    schema = os.environ.get("RADIOMETER_DCC_SCHEMA")
    try:
        judge = dcclib.XsdValidator.from_file(schema) if schema else dcclib.XsdValidator.from_version(SCHEMA_VERSION)
    except dcclib.SchemaDownloadError as error:
        pytest.skip(str(error))
    for source in (reading(), project_root / "configs" / "calibrations" / "simulated.yaml"):
        rm.certificate(source, tmp_path / "c.xml", laboratory=laboratory, identifier="1", force=True)
        found = judge.validate_file(str(tmp_path / "c.xml"))
        assert found.is_valid, [str(error) for error in found.errors]


@pytest.mark.parametrize("read", ["source", "laboratory"])
def test_the_page_next_to_a_certificate_replaces_no_input(tmp_path, laboratory, read):
    """Not even with --force, whatever its input is called."""
    content = json.dumps(reading().to_mapping()) if read == "source" else LABORATORY
    (page := tmp_path / "c.html").write_text(content, encoding="utf-8")
    source, stated = (page, laboratory) if read == "source" else (reading(), page)
    with pytest.raises(OutputRefused, match="belongs to the input"):
        rm.certificate(source, tmp_path / "c.xml", laboratory=stated, identifier="1", force=True)
    assert page.read_text(encoding="utf-8") == content


@pytest.mark.parametrize("unknown", ["vendor", "serial"])
def test_a_calibration_of_no_known_camera_is_never_certified_as_the_source(project_root, laboratory, unknown):
    """The laboratory's lamp is not what was calibrated; the message names what the calibration's file must state."""
    stored = Calibration.read(project_root / "configs" / "calibrations" / "simulated.yaml")
    nameless = replace(stored, camera=stored.camera.model_copy(update={unknown: None}))
    with pytest.raises(UsageError, match="camera: vendor, serial"):
        rm.certificate(nameless, laboratory=laboratory, identifier="2")


def test_what_cannot_be_certified_is_refused(tmp_path, laboratory):
    """What cannot be certified is refused."""
    with pytest.raises(UsageError, match="relative"):
        rm.certificate(reading("relative"), laboratory=laboratory, identifier="1")
    with pytest.raises(UsageError, match="identifier"):
        rm.certificate(reading(), laboratory=laboratory, identifier=" ")
    (tmp_path / "no_item.yaml").write_text(LABORATORY[: LABORATORY.index("item")], encoding="utf-8")
    with pytest.raises(UsageError, match="item"):
        rm.certificate(reading(), laboratory=tmp_path / "no_item.yaml", identifier="1")
    (tmp_path / "no_city.yaml").write_text(LABORATORY.replace("city: Bonn, ", ""), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="city"):
        rm.certificate(reading(), laboratory=tmp_path / "no_city.yaml", identifier="1")
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(InputError, match="JSON of a reading"):
        rm.certificate(tmp_path / "list.json", laboratory=laboratory, identifier="1")


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("radiance", {"value": 0.3, "u": -0.003, "unit": "W sr-1 m-2"}, "above 0"),
        ("radiance", {"value": 1e999, "u": 0.003, "unit": "W sr-1 m-2"}, "outside"),
        ("radiance", {"value": 0.3, "u": 0.003, "unit": "1"}, "unit"),
        ("coverage_factor", -2.0, "coverage_factor"), ("coverage_factor", 0.0, "coverage_factor"),
        ("coverage_factor", 1.0, "95.45 %"), ("coverage_factor", 3.0, "make it 2.13"),
        ("degrees_of_freedom", 4.0, "make it 2.87"), ("flags", ["saturated"], "lower bound"),
        ("time", "yesterday", "ISO 8601"), ("time", "2099-01-01T00:00:00+00:00", "future"),
        ("flags", ["uncalibrated"], "relative"), ("instrument", "a\u0001b", "U\\+0001"),
        ("instrument", "\ud800", "D800"),
    ],
)  # fmt: skip
def test_no_certificate_of_what_no_reading_states(tmp_path, laboratory, key, value, why):
    """An impossible number, unit, time or character is refused by its name, and nothing is written."""
    (tmp_path / "r.json").write_text(json.dumps({**reading().to_mapping(), key: value}))
    with pytest.raises((InputError, OutputRefused, UsageError), match=why):
        rm.certificate(tmp_path / "r.json", tmp_path / "c.xml", laboratory=laboratory, identifier="1")
    assert not (tmp_path / "c.xml").exists()


REQUIRED = [
    *(("laboratory", key) for key in ("name", "email", "city", "country")), ("customer", "name"),
    ("responsible", "name"), *(("item", key) for key in ("name", "manufacturer", "serial")),
]  # fmt: skip


@pytest.mark.parametrize(("part", "key"), REQUIRED)
def test_what_a_certificate_must_state_cannot_be_left_empty(tmp_path, part, key):
    """Names, addresses, maker and serial number: an empty text is refused by its key."""
    stated = yaml.safe_load(LABORATORY)
    stated[part][key] = ""
    (tmp_path / "empty.yaml").write_text(yaml.safe_dump(stated), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=rf"{part}.{key}"):
        rm.certificate(reading(), laboratory=tmp_path / "empty.yaml", identifier="1")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda text: text.replace("<?xml", "<!DOCTYPE x [<!ENTITY a 'b'>]><?xml"), "document type"),
        (lambda text: text[:200], "not XML"),
        (lambda text: text.replace("digitalCalibrationCertificate", "certificate"), "no digital calibration"),
        (lambda text: text.replace(r"\watt", r"\kilo\watt"), "states 0 values"),
        (lambda text: text.replace("si:coverageFactor>", "si:factor>"), "no expanded uncertainty"),
        (lambda text: text.replace("<si:value>0.3<", "<si:value>0_3<"), "just one number"),
        (lambda text: text.replace("<si:value>0.3<", "<si:value>\u0663<"), "just one number"),
        (lambda text: text.replace("<si:value>0.3<", "<si:value>0.3</si:value><si:value>0.4<"), "just one number"),
        (lambda text: text.replace("<si:value>0.3<", "<si:value>-0.3<"), "value"),
        *(
            (lambda text, k=k: text.replace("Factor>2.13<", f"Factor>{k}<"), "number|factor")
            for k in ("-2", "1e9", "NaN")
        ),
        *((lambda text, u=u: text.replace("0.00639", u), "number|above 0") for u in ("0", "-0.5", "INF")),
        (lambda text: text.replace("dcc:results", "dcc:influenceConditions"), "states 0 values"),
    ],
)
def test_what_does_not_state_one_value_with_its_uncertainty_is_refused(tmp_path, laboratory, change, why):
    """What does not state one value with its uncertainty is refused."""
    text = rm.certificate(reading(), laboratory=laboratory, identifier="1").to_xml()
    (tmp_path / "c.xml").write_text(change(text), encoding="utf-8")
    with pytest.raises(InputError, match=why):
        read_certificate(tmp_path / "c.xml", "W sr-1 m-2")
