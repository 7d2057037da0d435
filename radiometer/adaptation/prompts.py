"""Sounds for subject and operator: at the phases of a test and at every threshold; journalled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from radiometer.adaptation.journal import RunJournal
from radiometer.data.event_journal import Event


def prompts_after(event: Event) -> tuple[str, ...]:
    """Return the prompts that an event calls for, in order.

    "bleach" (it begins), "dark" (it is over), "mark" (look at the red mark), "threshold" (found), "pause", "resume",
    "end".
    """
    match event["kind"]:
        case "dark":
            return ("dark", "mark")
        case "fixation":
            return ("mark",)
        case "bleach" | "pause" | "resume" | "end" as kind:
            return (str(kind),)
        case "trial" if not event["catch"] and event["threshold"] is not None:
            return ("threshold",)
        case _:
            return ()


@dataclass(frozen=True, slots=True)
class Prompter:
    """Journals prompts and has them sounded."""

    journal: RunJournal  # the open journal of the test
    sound: Callable[[Event], None]  # called with every prompt, as an event of kind "prompt"

    def after(self, event: Event) -> None:
        """Give the prompts that an event calls for. Raises OutputError."""
        self._give(event, prompts_after(event))

    def catch_up(self) -> None:
        """Give what a crash left out after the newest event, so that the journal holds the same. Raises OutputError."""
        for given, event in enumerate(reversed(self.journal.events)):
            if event["kind"] != "prompt":
                self._give(event, prompts_after(event)[given:])
                return

    def _give(self, event: Event, prompts: tuple[str, ...]) -> None:
        for say in prompts:
            self.sound(self.journal.write("prompt", float(event["time_s"]), say=say))
