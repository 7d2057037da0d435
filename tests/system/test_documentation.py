"""The documentation does what it says: the site builds without a broken link, pages and notebooks run as they stand."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

import radiometer
from drivers.cameras.aravis_camera import load_library
from radiometer.bench.config import BenchConfig
from radiometer.cli.tree import command_tree
from radiometer.errors import MissingLibrary
from radiometer.reconciliation.thresholds import TABLE
from simulators.effects.registry import EFFECTS
from testing.wire_program import OPEN_A_CAMERA

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Pages whose commands need a package manager or a camera that is not there yet.
NOT_FOLLOWED = {"install"}
FOLLOWED = (
    DOCS / "tutorial.md",
    *sorted(page for page in (DOCS / "how-to").glob("*.md") if page.stem not in NOT_FOLLOWED),
)
NOTEBOOKS = ("reading-and-budget", "reconcile-a-hidden-effect", "response-and-merge")


@pytest.fixture(scope="session")
def follow_module(project_root: Path) -> ModuleType:
    """Return the program that follows pages."""
    spec = importlib.util.spec_from_file_location("follow", project_root / "docs" / "_site" / "follow.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["follow"] = module
    spec.loader.exec_module(module)
    return module


def _opens_a_camera(page: Path) -> bool:
    """Return whether a page runs a command that opens the camera of a bench."""
    commands = "|".join(OPEN_A_CAMERA)
    return re.search(rf"^\$ radiometer ({commands})\b", page.read_text(encoding="utf-8"), re.MULTILINE) is not None


@pytest.mark.long
@pytest.mark.parametrize(
    ("page", "program"),
    [
        *(pytest.param(page, "radiometer", id=page.stem) for page in FOLLOWED),
        *(pytest.param(page, "testing.wire_program", id=f"{page.stem}-on-the-wire")
          for page in FOLLOWED if _opens_a_camera(page)),
    ],
)  # fmt: skip
def test_a_page_followed_word_by_word_prints_what_it_says(
    page, program, follow_module, tmp_path, project_root, monkeypatch
):
    """Its files are written, its commands run in a fresh folder, every line shown comes; over GigE Vision as well."""
    if program != "radiometer":
        try:
            load_library()
        except MissingLibrary as error:
            pytest.skip(str(error))
    commands = tmp_path / "bin"
    commands.mkdir()
    command = commands / "radiometer"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m {program} "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{commands}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(project_root))
    folder = tmp_path / "desk"
    folder.mkdir()
    assert any(block.language == "console" for block in follow_module.blocks_of(page))
    assert follow_module.follow(page, folder, installing=False) == []


@pytest.mark.long
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_as_it_stands_and_says_what_is_stored_in_it(name, project_root, tmp_path, monkeypatch):
    """Every cell runs in a kernel of its own; each cell gives outputs of the kinds that the site shows."""
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(project_root))
    monkeypatch.setenv("JUPYTER_CONFIG_DIR", str(tmp_path))
    monkeypatch.setenv("JUPYTER_PREFER_ENV_PATH", "1")
    notebook = nbformat.read(project_root / "docs" / "notebooks" / f"{name}.ipynb", as_version=4)
    stored = [_kinds(cell) for cell in notebook.cells]
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert [_kinds(cell) for cell in notebook.cells] == stored
    assert any(kind == "image/png" or "text/html" in kind for kinds in stored for kind in kinds)
    text = json.dumps(notebook.cells, ensure_ascii=False)
    if name == "reconcile-a-hidden-effect":
        (found,) = re.findall(r"([\d.]+) ± ([\d.]+) µs; hidden were 30", text)
        assert abs(float(found[0]) - 30) < 4 * float(found[1])
        assert "Reconciliation agrees" in text
    if name == "response-and-merge":
        (error,) = re.findall(r"root mean square error of ln H: ([\d.]+)", text)
        assert float(error) < 0.02
    if name == "reading-and-budget":
        (off,) = re.findall(r"off by ([+-][\d.]+) standard", text)
        assert abs(float(off)) < 3


def _kinds(cell) -> list[str]:
    """Return the kinds of a cell's outputs, without their order of arrival."""
    if cell.cell_type != "code":
        return []
    return sorted(
        "stream" if one.output_type == "stream" else ",".join(sorted(one.get("data", {}))) for one in cell.outputs
    )


class _Loaded(HTMLParser):
    """Collects what a browser would fetch for a page."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []

    def handle_starttag(self, tag, attrs):
        """Note scripts, pictures, styles and icons."""
        reported = dict(attrs)
        if tag in ("script", "img", "iframe", "source") and reported.get("src"):
            self.fetched.append(reported["src"])
        if tag == "link" and reported.get("rel") not in ("canonical", "prev", "next") and reported.get("href"):
            self.fetched.append(reported["href"])


@pytest.fixture(scope="module")
def site(project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the site, built as `make docs` does: a broken link, anchor or reference ends the build."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    env = os.environ | {"PYTHONPATH": str(project_root), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=project_root, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_loads_nothing_from_anywhere_else(site):
    """Every script, style, font and picture of every page is in the site itself."""
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        loaded = _Loaded()
        loaded.feed(page.read_text(encoding="utf-8"))
        foreign = [one for one in loaded.fetched if re.match(r"(https?:)?//", one)]
        assert foreign == [], page
        for one in loaded.fetched:
            if not one.startswith("data:"):
                path = one.partition("?")[0].partition("#")[0]
                base = site if path.startswith("/") else page.parent
                assert (base / path.lstrip("/")).exists(), (page, one)


def test_the_site_shows_formulas_without_a_script(site):
    """No formula is left in TeX; those of the physics page are MathML."""
    physics = (site / "explanation" / "physics.html").read_text(encoding="utf-8")
    assert physics.count('display="block"') >= 5
    assert "arithmatex" not in physics
    assert "\\frac" not in re.sub(r"<annotation.*?</annotation>", "", physics, flags=re.DOTALL)


def test_the_reference_holds_every_public_name_command_effect_and_threshold(site):
    """What can be imported, typed, switched on or stated in a bench file is in the reference, with its words."""
    names = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in radiometer.__all__:
        assert f'id="{radiometer.home_of(name)}.{name}"' in names, name
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    effects = (site / "reference" / "effects.html").read_text(encoding="utf-8")
    for one in command_tree():
        assert f"<code>{' '.join(one.path)}</code>" in commands
    for name in EFFECTS:
        assert f"<code>{name}</code>" in effects
    keys = (site / "reference" / "bench.html").read_text(encoding="utf-8")
    form = BenchConfig.model_json_schema()
    for section in (form, *form["$defs"].values()):
        for key, facts in section["properties"].items():
            assert f"<code>{key}</code>" in keys, key
            assert facts.get("description"), key
    thresholds = (site / "reference" / "thresholds.html").read_text(encoding="utf-8")
    for row in TABLE:
        assert f"<code>{row.name}</code>" in thresholds


def test_a_command_that_fails_ends_the_following(follow_module, tmp_path):
    """A page whose command fails is no page that works."""
    page = tmp_path / "page.md"
    page.write_text("```console\n$ true\n$ exit 3\n```\n", encoding="utf-8")
    with pytest.raises(RuntimeError, match=r"failed \(3\)"):
        follow_module.follow(page, tmp_path, installing=False)
