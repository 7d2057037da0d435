"""Who watches a running test: the terminal, the page, a program, the prompts."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from radiometer.cli.console import note
from radiometer.cli.light.adapt_live import live_curve

if TYPE_CHECKING:
    from radiometer.adaptation.controls import Controls
    from radiometer.adaptation.journal import Event, RunJournal
    from radiometer.adaptation.stage import Stage

Watcher = Callable[["Event"], None]


@dataclass(frozen=True, slots=True)
class Watching:
    """What the user wants to see and hear.

    Attributes:
        page: Whether the page is served.
        page_port: Its port; 0 for any free one.
        audio: Whether prompts are sounded: by the page, or by the terminal's bell where there is none.
        json: Whether events are printed as JSON lines.
        slow_s: Real time that passes after each trial, so that a run in simulated time can be watched.
    """

    page: bool
    page_port: int
    audio: bool
    json: bool
    slow_s: float = 0.0


@contextmanager
def watchers(wanted: Watching, stage: Stage, journal: RunJournal, controls: Controls) -> Iterator[Watcher]:
    """Yield what is told every event while the block runs. Raises DeviceInUse where the page's port is taken."""
    with ExitStack() as stack:
        tellers: list[Watcher] = []
        if wanted.page:
            tellers.append(stack.enter_context(_page(wanted, stage, journal, controls)))
        shown = _json_line if wanted.json else stack.enter_context(live_curve(stage.protocol, journal.events))
        tellers.append(shown)

        def tell(event: Event) -> None:
            for teller in tellers:
                teller(event)
            if wanted.slow_s and event["kind"] == "trial":
                time.sleep(wanted.slow_s)

        if not wanted.audio:
            yield tell
            return
        yield _with_prompts(journal, tell, bell=not wanted.page)


@contextmanager
def _page(wanted: Watching, stage: Stage, journal: RunJournal, controls: Controls) -> Iterator[Watcher]:
    from radiometer.adaptation.live_page import LivePage, replayed
    from radiometer.adaptation.stage import DescribedStage
    from radiometer.bench.box_holder import darken_held

    def health() -> Mapping[str, str]:
        return stage.health() if isinstance(stage, DescribedStage) else {}

    with LivePage(
        stage.protocol, controls, wanted.page_port, audio=wanted.audio, health=health, darken=darken_held
    ) as page:
        note(f"the running test, dim and red, is at\n  {page.url}")
        replayed(page, journal.events)
        yield page.tell


def _with_prompts(journal: RunJournal, tell: Watcher, *, bell: bool) -> Watcher:
    from radiometer.adaptation.prompts import Prompter

    def sound(event: Event) -> None:
        tell(event)
        if bell:
            print("\a", end="", file=sys.stderr, flush=True)

    prompter = Prompter(journal, sound)
    prompter.catch_up()

    def tell_and_prompt(event: Event) -> None:
        tell(event)
        prompter.after(event)

    return tell_and_prompt


def _json_line(event: Event) -> None:
    print(json.dumps(event, ensure_ascii=False), flush=True)
