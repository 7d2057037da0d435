"""Pages of a report and of a reading."""

import base64
import re
import xml.etree.ElementTree as ElementTree

import pytest
from matplotlib.figure import Figure

import radiometer
import radiometer as rm
from radiometer.reporting.origin import Origin, span_of
from radiometer.reporting.page import escaped, folded, heading, listed, page, paragraph, prose, section, table
from radiometer.reporting.pictures import dress, label, mark, picture, shortened
from testing.report_checks import HOSTILE


def test_text_is_shown_as_written_with_printed_signs():
    """No markup, a minus that is no hyphen, no line break within a value."""
    parts = [
        paragraph(HOSTILE),
        heading(HOSTILE, [HOSTILE]),
        listed([HOSTILE]),
        table((HOSTILE,), [(HOSTILE,)]),
        folded(HOSTILE, paragraph(HOSTILE)),
        picture(lambda figure, narrow: None, HOSTILE, (1.0, 1.0), (1.0, 1.0)),
    ]
    whole = page(HOSTILE, HOSTILE, parts, kind=HOSTILE, origin=Origin(camera=HOSTILE))
    assert "<script" not in whole
    assert "onload='" not in whole
    assert "\x1b" not in whole
    assert whole.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 15
    assert "&amp;amp;" in whole
    assert prose("-0.5 ± 0.1 %, k = 2") == "−0.5\u00a0±\u00a00.1\u00a0%, k\u00a0=\u00a02"
    assert prose("S-12, 2026-11-22, a-b, DN/e-") == "S-12, 2026-11-22, a-b, DN/e⁻"
    assert escaped("-0.5 %") == "-0.5 %"
    assert [shortened(text, 6) for text in ("abcdef", "abcdefg")] == ["abcdef", "abcde…"]


def test_a_page_forbids_scripts_and_its_outcome_comes_before_the_parts():
    """Nothing but its own style and pictures may be used; subject, outcome, parts in order, empty ones passed by."""
    parts = [paragraph("first"), "", section("empty"), section("last", "x")]
    whole = page("subject", "outcome", parts, kind="k", origin=Origin())
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', whole)
    assert policy[1] == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    assert whole.index("Content-Security-Policy") < whole.index("<style>")
    places = [whole.index(text) for text in ("subject</h1>", "outcome</p>", "<p>first</p>", "<h2>last</h2>")]
    assert places == sorted(places)
    assert ">empty" not in whole


def test_every_page_states_what_its_data_come_from_and_what_is_not_known():
    """A camera's clock is no date; what a file could state and does not is named, what the kind lacks is not."""
    assert span_of([12.5, None]) == ""
    assert span_of([1.75e9, 1.75e9 + 60]) == "2025-06-15 15:06:40 to 2025-06-15 15:07:40"
    rows = Origin("", "FLIR 1", calibration="a.yaml", further=(("eye", "right"), ("age", ""))).rows
    assert [*rows[:4]] == [
        ("taken (UTC)", "not stated"),
        ("camera", "FLIR 1"),
        ("calibration", "a.yaml"),
        ("eye", "right"),
    ]
    assert rows[4:] == [("program", f"radiometer {radiometer.__version__}")]


@pytest.mark.slow
def test_a_picture_shows_hostile_names_in_both_forms():
    """A name that is no formula, not in the font or not for XML is drawn, as a well-formed file without scripts."""

    def draw(figure, narrow):
        axes = figure.subplots()
        axes.plot([1, 2], [1, 3], label=label(HOSTILE))
        mark(axes, "-2", (1, 1), (0, 0), "black")
        dress(axes, label(HOSTILE), label(HOSTILE), label(HOSTILE))
        axes.legend()

    made = picture(draw, "caption", (6.0, 4.0), (4.0, 4.0))
    files = [base64.b64decode(code) for code in re.findall(r"data:image/svg\+xml;base64,([\w+/=]+)'", made)]
    assert len(files) == 2
    widths = []
    for file in files:
        tree = ElementTree.fromstring(file)
        widths.append(tree.get("width"))
        assert not [one for one in tree.iter() if one.tag.endswith(("script", "foreignObject"))]
    assert widths == ["288pt", "432pt"]
    assert "media='(max-width:640px)'" in made


@pytest.mark.parametrize(("last", "scale"), [(1.06, "linear"), (2.0, "linear"), (2.5, "log"), (300.0, "log")])
def test_logarithms_of_less_than_a_third_of_a_decade_are_none(last, scale):
    """From 26 200 to 27 700 DN labels of a logarithmic axis would run into each other; from 1 to 2.5 they do not."""
    axes = Figure().subplots()
    axes.plot([1.0, last], [1.0, last])
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(1.0, last)
    axes.set_ylim(1.0, last)
    dress(axes, "x", "y")
    assert (axes.get_xscale(), axes.get_yscale()) == (scale, scale)
    assert axes.get_xlim() == (1.0, last)


BENCH = """format: radiometer-bench/1
camera: {kind: simulated, preset: BFS-U3-19S4M, width: 96, height: 64, black_level_dn: 64}
lens: {focal_length_mm: 16, f_number: 4}
scene: {kind: uniform, radiance_W_per_sr_m2: RADIANCE}
calibration: calibrations/simulated.yaml
patch: {x: 40, y: 24, width: 16, height: 16}
"""


def _bench(folder, radiance):
    file = folder / "bench.yaml"
    file.write_text(BENCH.replace("RADIANCE", f"{radiance:g}"), encoding="utf-8")
    return file


@pytest.mark.slow
def test_page_of_a_reading_holds_what_the_book_needs_and_loads_nothing(tmp_path):
    """Value with U and k as `print` gives them, patch, calibration with date and reference, assumptions, version.

    A .pdf is one sheet of PDF; another ending is misuse before anything is measured.
    """
    page, pdf = tmp_path / "page.html", tmp_path / "page.pdf"
    rm.measure(bench=_bench(tmp_path, 0.3), report=pdf)
    assert pdf.read_bytes().startswith(b"%PDF-")
    with pytest.raises(rm.UsageError, match=r"\.html or \.pdf"):
        rm.measure(bench=_bench(tmp_path, 0.3), report=tmp_path / "page.docx")
    reading = rm.measure(bench=_bench(tmp_path, 0.3), report=page)
    text = page.read_text(encoding="utf-8").replace("\u00a0", " ")
    assert str(reading).partition(" [")[0] in text
    known = reading.more["calibration"]
    expected = (
        "16 × 16 pixels at x 40, y 24",
        known["created"][:19].replace("T", " "),
        known["reference"],
        f"radiometer {rm.__version__}",
    )
    assert all(one in text for one in expected)
    assert all(one in text for one in reading.more["assumptions"])
    assert not re.search(r"(?:src|href)=.https?:|<script", text)


@pytest.mark.slow
def test_reading_below_the_noise_is_a_limit(tmp_path):
    """In the dark the terminal, the page and JSON give a limit above 0, never a negative radiance as a limit."""
    page = tmp_path / "page.html"
    reading = rm.measure(bench=_bench(tmp_path, 1e-9), report=page)
    limit = reading.to_mapping()["upper_limit"]
    assert limit["value"] > 0
    assert (limit["probability"], limit["unit"]) == (0.95, "W sr-1 m-2")
    assert re.match(r"< 0\.0*[1-9]\d W·sr⁻¹·m⁻², 95 %|< .*", str(reading))
    assert "95 %" in page.read_text(encoding="utf-8").replace("\u00a0", " ")
