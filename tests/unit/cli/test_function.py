"""Commands that are made of a public function say what the function says."""

from __future__ import annotations

import inspect
import subprocess
import sys

import pytest

import radiometer as rm
from radiometer.cli.tree import command_tree

MADE = {
    ("alpha-opic",): "alpha_opic",
    ("analyse",): "analyse",
    ("certificate",): "certificate",
    ("colour", "calibrate"): "colour_calibrate",
    ("colour", "measure"): "colour_measure",
    ("flicker",): "flicker",
    ("screen", "report"): "screen_report",
}
_SERVED = {"ask", "announce", "notice", "progress"}  # by the terminal


@pytest.mark.parametrize("path", MADE, ids=" ".join)
def test_a_command_has_the_parameters_of_its_function_and_its_words(path: tuple[str, ...]) -> None:
    """One entry per parameter, defaults and text alike; besides those only files of the result, --json and --force."""
    function = getattr(rm, MADE[path])
    found = next(one for one in command_tree() if one.path == path)
    document = " ".join((inspect.getdoc(function) or "").split())
    assert document.startswith(" ".join(found.text.split()))
    parameters = {name: one for name, one in inspect.signature(function).parameters.items() if name not in _SERVED}
    entries = [*found.arguments, *found.options]
    own = [name for name, _ in entries if name.split()[0] in ("--plot", "--csv", "--json")]
    own += ["--force"] * ("force" not in parameters and any(name.startswith("--force") for name, _ in entries))
    own += ["--report"] * ("report" not in parameters and any(name.startswith("--report") for name, _ in entries))
    assert len(entries) == len(parameters) + len(own)
    numbers = [one.default for one in parameters.values() if isinstance(one.default, int | float)]
    shown = " ".join(text for _, text in entries)
    assert all(f"[default: {number}" in shown for number in numbers if not isinstance(number, bool))


def test_the_help_of_a_command_imports_no_library_of_arrays() -> None:
    """Help and completion answer at once: the function is imported when it is called."""
    code = (
        "import sys; from radiometer.cli.main import run; run(['flicker', '--help']); "
        "print('scipy' in sys.modules, 'radiometer.api.flicker' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False False"
