"""The report tells the story: verdict, gap by steps, each name with what it is and what shows it, the rest, tables."""

from __future__ import annotations

import re

import pytest

from radiometer.reconcile.engine import Reconciled, examine, whole_catalogue
from radiometer.reconcile.measure.reduce import frame_reader
from radiometer.reconcile.report.html import report_html
from radiometer.reconcile.report.words import along, axis_label, seen_in
from tests.roundtrip.generator.session import make_session


@pytest.fixture(scope="module")
def glaring() -> Reconciled:
    """Return what is found of a session that hides a veil; few entries are tried, so that it is quick."""
    session = make_session("veiling_glare", camera_seed=424_201)
    frames = list(session.frames())
    entries = {name: whole_catalogue()[name] for name in ("veiling_glare", "gain_step_error", "exposure_time_offset")}
    return examine(session.header, frame_reader(frames), frames[0].shape, catalogue=entries, with_limits=False)


@pytest.mark.slow
def test_the_verdict_comes_first_and_pictures_before_tables(glaring):
    """What was found, the opening picture, the name, the map of the rest, then the folded figures."""
    page = report_html(glaring, "session <1>")
    marks = [
        "session &lt;1&gt;",
        "class='verdict'",
        "Right: how far settings",
        "<h2>veiling_glare",
        "Where the rest lies",
    ]
    places = [page.index(mark) for mark in marks]
    assert places == sorted(places)
    assert page.index("<details>") > places[-1]


@pytest.mark.slow
def test_a_name_says_what_it_is_and_what_shows_it(glaring):
    """The effect's own sentence, the statistic and covariate in words, a picture, and its size with ±."""
    page = report_html(glaring, "session")
    part = page[page.index("<h2>veiling_glare") : page.index("Where the rest lies")]
    assert "Spreads a share of all light evenly" in part
    assert "how bright patches are, with the brightness of the patch" in part
    assert "Line: what it predicts" in part
    assert re.search(r"<td>share</td><td>[\d.]+</td><td>± ", part)


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(glaring):
    """The page is one file."""
    page = report_html(glaring, "session")
    assert not re.findall(r"(?:src|href)='(?!data:)", page)
    assert "http" not in page


@pytest.mark.parametrize("kind", whole_catalogue().values(), ids=whole_catalogue())
def test_every_entry_has_words_for_where_it_shows(kind):
    """No raw name of a statistic or covariate reaches the reader of an effect's paragraph."""
    assert seen_in(kind.block) != kind.block
    assert "_" not in along(kind.where)
    assert axis_label(kind.where)[0]
