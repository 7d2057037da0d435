"""The page of a reading: value, picture, budget, calibration and assumptions, without anything from outside."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import radiometer as rm

BENCH = """format: radiometer-bench/1
camera: {kind: simulated, preset: BFS-U3-19S4M, width: 96, height: 64, black_level_dn: 64}
lens: {focal_length_mm: 16, f_number: 4}
scene: {kind: uniform, radiance_W_per_sr_m2: RADIANCE}
calibration: calibrations/simulated.yaml
patch: {x: 40, y: 24, width: 16, height: 16}
"""


def _bench(folder: Path, radiance: float) -> Path:
    file = folder / "bench.yaml"
    file.write_text(BENCH.replace("RADIANCE", f"{radiance:g}"), encoding="utf-8")
    return file


@pytest.mark.slow
def test_page_of_a_reading_holds_what_the_book_needs_and_loads_nothing(tmp_path: Path) -> None:
    """Value with U and k as `print` gives them, patch, calibration with date and reference, assumptions, version."""
    page = tmp_path / "page.html"
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
def test_page_is_written_as_pdf(tmp_path: Path) -> None:
    """A .pdf is one sheet of PDF; another ending is misuse before anything is measured."""
    rm.measure(bench=_bench(tmp_path, 0.3), report=tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF-")
    with pytest.raises(rm.UsageError, match=r"\.html or \.pdf"):
        rm.measure(bench=_bench(tmp_path, 0.3), report=tmp_path / "page.docx")


@pytest.mark.slow
def test_reading_below_the_noise_is_a_limit(tmp_path: Path) -> None:
    """In the dark the terminal, the page and JSON give a limit above 0, never a negative radiance as a limit."""
    page = tmp_path / "page.html"
    reading = rm.measure(bench=_bench(tmp_path, 1e-9), report=page)
    limit = reading.to_mapping()["upper_limit"]
    assert limit["value"] > 0
    assert (limit["probability"], limit["unit"]) == (0.95, "W sr-1 m-2")
    assert re.match(r"< 0\.0*[1-9]\d W·sr⁻¹·m⁻², 95 %|< .*", str(reading))
    assert "95 %" in page.read_text(encoding="utf-8").replace("\u00a0", " ")
