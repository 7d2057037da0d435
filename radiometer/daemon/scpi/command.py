"""One line of the command table, and how a header is found in it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.lexer import Unit
from radiometer.daemon.scpi.parameters import Parameter, short_form

if TYPE_CHECKING:
    from radiometer.daemon.scpi.session import Session

Reply = str | None
Outcome = Reply | Coroutine[Any, Any, Reply]
_NODE: Final = re.compile(r"(\[?):?([A-Za-z*]+)(<n>)?(\]?)")


@dataclass(frozen=True, slots=True)
class Call:
    """One call of a command."""

    session: Session  # whose
    values: tuple[Any, ...]  # values of the arguments that were given
    channel: int = 1  # numeric suffix of the header; 1 where none was written


Handler = Callable[[Call], Outcome]


@dataclass(frozen=True, slots=True)
class Command:
    """One line of the command table; either form may be missing."""

    pattern: str  # header with its short form in capitals, optional nodes in brackets, "<n>" for a numeric suffix
    summary: str  # what it does, one or two sentences
    do: Handler | None = None  # handler of the command form
    ask: Handler | None = None  # handler of the query form
    parameters: tuple[Parameter, ...] = ()  # parameters of the command form
    required: int = -1  # how many of them must be given; -1 for all
    # Parameters of the query form, all optional unless `ask_required` says otherwise
    ask_parameters: tuple[Parameter, ...] = ()
    ask_required: int = 0  # how many parameters the query form must be given
    reply: str = ""  # form of the reply, for the manual
    example: str = ""  # a message that works on any instrument; tested
    group: str = ""  # heading in the manual

    def spellings(self) -> list[str]:
        """Return every accepted header in capitals; "<n>" means a numeric suffix, written or not."""
        choices: list[list[str]] = []
        for opened, word, numbered, _ in _NODE.findall(self.pattern):
            forms = {word.upper(), short_form(word)} if not word.startswith("*") else {word.upper()}
            forms = {form + numbered for form in forms}
            choices.append([*sorted(forms), *([""] if opened else [])])
        return [":".join(filter(None, words)) for words in itertools.product(*choices)]

    def call(self, session: Session, unit: Unit, channel: int) -> Outcome:
        """Check the arguments and run the handler. Raises ScpiError."""
        handler = self.ask if unit.is_query else self.do
        if handler is None:
            raise ScpiError(-113, f"{unit.header} has no {'query' if unit.is_query else 'command'} form")
        parameters = self.ask_parameters if unit.is_query else self.parameters
        required = self.ask_required if unit.is_query else len(parameters) if self.required < 0 else self.required
        if len(unit.arguments) > len(parameters):
            raise ScpiError(-108, f"{unit.header} takes at most {len(parameters)}")
        if len(unit.arguments) < required:
            raise ScpiError(-109, f"{unit.header} needs {parameters[len(unit.arguments)].name}")
        pairs = zip(parameters, unit.arguments, strict=False)
        values = tuple(parameter.read(argument, session.station) for parameter, argument in pairs)
        return handler(Call(session, values, channel))


class CommandTable:
    """Finds commands by header."""

    def __init__(self, commands: Sequence[Command]) -> None:
        self.commands = tuple(commands)
        self._by_spelling: dict[str, Command] = {}
        for command in commands:
            for spelling in command.spellings():
                if spelling in self._by_spelling:
                    raise ValueError(
                        f"{spelling} is a spelling of both {self._by_spelling[spelling].pattern} and {command.pattern}"
                    )
                self._by_spelling[spelling] = command

    @cached_property
    def headers(self) -> str:
        """The block that `SYSTem:HELP:HEADers?` answers: a line per command, `/qonly/` and `/nquery/` after SCPI-99."""
        lines = []
        for command in self.commands:
            form = "/nquery/" if command.ask is None else "/qonly/" if command.do is None else ""
            lines.append(f":{command.pattern}{form}" if not command.pattern.startswith("*") else command.pattern + form)
        return formats.block(("\n".join(lines) + "\n").encode())

    def find(self, header: str, path: str) -> tuple[Command, int, str]:
        """Return the command of a header, its numeric suffix, and the path for the next unit of the message.

        Args:
            path: Path left by the unit before; "" at the start of a message.

        Raises:
            ScpiError: If there is no such command.
        """
        if header.startswith("*"):
            return self._known(header.upper(), header), 1, path
        absolute = header[1:] if header.startswith(":") else f"{path}:{header}" if path else header
        spelling, channel = absolute.upper(), 1
        if spelling not in self._by_spelling and any(map(str.isdigit, spelling)):
            spelling, channel = self._with_suffix(spelling)
        elif spelling not in self._by_spelling:
            spelling = next((s for s in self._implied(spelling) if s in self._by_spelling), spelling)
        return self._known(spelling, header), channel, absolute.rpartition(":")[0]

    def _known(self, spelling: str, header: str) -> Command:
        command = self._by_spelling.get(spelling)
        if command is None:
            raise ScpiError(-113, header[:80])
        return command

    def _implied(self, spelling: str) -> list[str]:
        """Return the header with "<n>" put after each node in turn: a suffix not written is 1."""
        words = spelling.split(":")
        return [":".join([*words[: i + 1]]) + "<n>" + ":".join(["", *words[i + 1 :]]) for i in range(len(words))]

    def _with_suffix(self, spelling: str) -> tuple[str, int]:
        found = re.findall(r"([A-Z_]+)(\d+)(?=:|$)", spelling)
        if len(found) != 1 or len(found[0][1]) > 4:
            return spelling, 1
        return re.sub(r"(?<=[A-Z_])\d+(?=:|$)", "<n>", spelling), int(found[0][1])
