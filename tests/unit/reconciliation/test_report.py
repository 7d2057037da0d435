"""The report shows the story: verdict, gap by steps, each name with what it is and what shows it, the rest, tables."""

import re
from dataclasses import replace

import pytest

from radiometer.numbers import rounded
from radiometer.reconciliation.engine import examine, whole_catalogue
from radiometer.reconciliation.report_page import along, axis_label, outcome, plot_along, report_html, seen_in
from radiometer.reconciliation.result import FoundEffect, Verdict
from radiometer.reconciliation.state import with_effects
from radiometer.reporting.origin import Origin
from simulators.effects.black_level_offset import BlackLevelOffset
from simulators.effects.crosstalk import Crosstalk
from testing.generator.session import make_session
from testing.report_checks import HOSTILE, assert_reports_hold


@pytest.fixture(scope="module")
def glaring():
    """Return what is found of a session that hides a veil; few entries are tried, so that it is quick."""
    session = make_session("veiling_glare", camera_seed=424_201, plan="bracket", frames=2)
    frames = list(session.frames())
    entries = {name: whole_catalogue()[name] for name in ("veiling_glare", "gain_step_error", "exposure_time_offset")}
    return examine(session.header, frames.__getitem__, frames[0].shape, catalogue=entries, with_limits=False)


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_the_verdict_comes_first_and_pictures_before_tables(glaring):
    """What was found, opening picture, name, map of the rest, then the folded figures; the page is one file.

    The name says what it is and what shows it: the effect's own sentence, statistic and covariate in words, a picture,
    and its size with ±.
    """
    page = report_html(glaring, "session <1>", Origin())
    marks = ["session &lt;1&gt;", "class='outcome'", "<picture>", "<h2>veiling_glare", "Where the residual is"]
    places = [page.index(mark) for mark in marks]
    assert places == sorted(places)
    assert page.index("<details>") > places[-1]
    part = page[places[3] : places[4]]
    assert "Spreads a share of all light evenly" in part
    assert "how bright patches are, with the brightness of the patch" in part
    assert "Line: what it predicts" in part
    assert re.search(r"<td>share</td><td>[\d.]+\u00a0±\u00a0[\d.]+</td>", part)
    assert "<p class='do'>" in part
    assert not re.findall(r"(?:src|srcset|href)='(?!data:)", page)
    assert "http:" not in page


@pytest.mark.slow
def test_the_outcome_names_what_was_missing_with_its_size(glaring):
    """The effect's first parameter with U (k = 2): twice what the result states."""
    result = replace(glaring.result, verdict=Verdict.EFFECTS_FOUND)
    share = result.effects[0].parameters["share"]
    value, expanded = rounded(share.value, 2 * share.u)
    assert outcome(result) == f"{result.sentence.removesuffix('.')}: veiling_glare (share {value} ± {expanded}, k = 2)."
    assert result.sentence == "The missing effect was found; with it simulation and measurement agree."


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_the_outcome_of_each_other_verdict(glaring):
    """Agreement with its gap; along what they disagree; names that are provisional."""
    result = glaring.result
    agrees = outcome(replace(result, verdict=Verdict.AGREES, effects=()))
    assert (
        agrees
        == f"Nothing is missing: simulation and measurement agree (gap {result.gap_after:.3g}; 1 is noise alone)."
    )
    unnamed = FoundEffect("unnamed", {}, "temperature_C", 2.0, 2.0, block="mean", closest=("gamma_enabled", 0.4))
    disagrees = replace(result, verdict=Verdict.UNNAMED, effects=(unnamed,))
    assert outcome(disagrees) == (
        "Simulation and measurement disagree, and no known effect explains it. It shows with the sensor's temperature."
    )
    assert outcome(replace(result, verdict=Verdict.INCOMPLETE)).startswith(
        "The answer is not complete, so every name is provisional: veiling_glare ("
    )
    page = report_html(replace(glaring, result=disagrees), "session", Origin())
    part = page[page.index("<h2>Not explained by any known effect") :]
    assert "<picture>" in part[: part.index("<h2>Where")]
    assert "Closest known effect: gamma_enabled, which explains 40\u00a0% of it. " in part


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_rivals_are_reported_in_words(glaring):
    """Each rival with what it is, and that the ± knows nothing of the choice."""
    effect = replace(glaring.result.effects[0], alternatives=("ghost", "another_lab's"))
    open_names = replace(glaring.result, verdict=Verdict.EFFECTS_FOUND, effects=(effect,))
    assert outcome(open_names).startswith(open_names.sentence.removesuffix("."))
    assert "more than one name" in outcome(open_names)
    assert outcome(open_names).endswith(" or ghost or another_lab's.")
    page = report_html(replace(glaring, result=replace(glaring.result, effects=(effect,))), "session", Origin())
    assert "<li>ghost. " in page
    assert "<li>another_lab&#x27;s.</li>" in page
    assert "Each\u00a0±\u00a0is conditional on this effect being the right one" in page


@pytest.mark.slow
async def test_the_page_in_a_browser(glaring, tmp_path):
    """At two widths: no scrolling sideways, readable, every picture shown, nothing loaded, no error."""
    await assert_reports_hold({"reconcile": report_html(glaring, HOSTILE, Origin())}, tmp_path)


def test_every_entry_has_words_for_where_it_shows():
    """No raw name of a statistic or covariate reaches the reader of an effect's paragraph."""
    for name, kind in whole_catalogue().items():
        assert seen_in(kind.block) != kind.block, name
        assert "_" not in along(kind.where), name
        assert axis_label(kind.where)[0], name


@pytest.mark.parametrize("kind", [Crosstalk, BlackLevelOffset])
@pytest.mark.slow
def test_what_an_entry_does_is_drawn_with_and_without_a_band(declared, kind):
    """Also of an entry that shows in two directions at once, such as charge that goes to neighbours."""
    effect = kind()
    state = with_effects(declared, [effect])
    assert "residual without it" in plot_along(state, effect.where, effect.block, effect, 0.1)
    assert plot_along(state, "signal", kind.block)
    assert not plot_along(state, "signal", "no such statistic")
