"""Make pages from the program itself: commands, effects, notebooks, and texts from outside the documentation."""

from __future__ import annotations

import base64
import importlib
import json
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
# Texts that are kept next to their subject, and where the site shows them.
ELSEWHERE = {"firmware.md": "drivers/firmware/light_box/README.md", "changelog.md": "CHANGELOG.md"}


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made."""
    made: dict[str, Callable[[], str]] = {
        "reference/bench.md": bench_keys, "reference/commands.md": commands, "reference/effects.md": effects,
        "reference/python.md": python_names, "reference/thresholds.md": thresholds
    }  # fmt: skip
    made |= {name: partial(_from_elsewhere, path) for name, path in ELSEWHERE.items()}
    for name, content in made.items():
        files.append(File.generated(config, name, content=content()))
    for notebook in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        name = f"notebooks/{notebook.stem}"
        text, pictures = notebook_page(notebook)
        files.append(File.generated(config, f"{name}.md", content=text))
        for number, picture in enumerate(pictures):
            files.append(File.generated(config, f"{name}-{number}.png", content=picture))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links to texts outside the documentation at their pages."""
    up = "../" * page.file.src_uri.count("/")
    for name, path in ELSEWHERE.items():
        markdown = markdown.replace(f"]({up}../{path})", f"]({up}{name})")
    return markdown


def _from_elsewhere(path: str) -> str:
    """Return a text with its links into `docs/` as the site has them."""
    return re.sub(r"\]\((\.\./)*docs/", "](", (ROOT / path).read_text(encoding="utf-8"))


def commands() -> str:
    """Return the reference of the command line, from the commands themselves."""
    from radiometer.cli.tree import command_tree

    parts = ["# Commands\n\nMade from the command line itself. `radiometer man` prints the same as a manual page."]
    for one in command_tree():
        words = " ".join(one.path)
        usage = " ".join(
            [f"radiometer {words}", *(["COMMAND"] if one.below else []), *(["[OPTIONS]"] if one.options else [])]
            + [name for name, _ in one.arguments]
        )
        heading = "##" if len(one.path) == 1 else "###"
        parts.append(f"{heading} `{words}`\n\n```\n{usage}\n```\n\n{_escaped(one.text)}")
        rows = (*one.arguments, *one.options)
        if rows:
            parts.append("| | |\n|---|---|\n" + "\n".join(f"| `{name}` | {_cell(meaning)} |" for name, meaning in rows))
    return "\n\n".join(parts) + "\n"


def bench_keys() -> str:
    """Return the keys of a bench file, section by section, from the form that every bench file is checked by."""
    from radiometer.bench.config import BenchConfig
    from simulators.scenes.kinds import SCENES

    form = BenchConfig.model_json_schema()
    parts = [
        "# Keys of a bench file\n\nMade from the form that every bench file is checked by. `radiometer new-bench` "
        "writes one, and [the tutorial](../tutorial.md#3-a-camera-of-your-own-the-bench-file) changes it. An unknown "
        "key is refused. Keys without a default must be stated."
    ]
    for title, section in {"BenchConfig": form, **form["$defs"]}.items():
        parts.append(f"## {_section_title(title)}\n\n{_escaped(section['description'].partition(chr(10))[0])}")
        rows = [
            f"| `{name}` | {_allowed(one)} | {_default(name, one, section)} | {_cell(one.get('description', ''))} |"
            for name, one in section["properties"].items()
        ]
        parts.append("| key | value | default | meaning |\n|---|---|---|---|\n" + "\n".join(rows))
    kinds = ", ".join(f"`{name}`" for name in sorted(SCENES))
    parts.append(
        f"## Scene\n\nWhat a simulated camera looks at. `kind` is one of {kinds}. "
        "[The simulated camera](../explanation/simulator.md#scenes) names the keys of each."
    )
    return "\n\n".join(parts) + "\n"


def _section_title(name: str) -> str:
    words = re.findall("[A-Z][a-z]+", name.removesuffix("Config"))
    return " ".join(words).capitalize()


def _allowed(one: dict[str, Any]) -> str:
    """Return in words what a key of a form takes."""
    choices = one.get("anyOf") or one.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(_allowed(each) for each in choices if each.get("type") != "null"))
    if "$ref" in one:
        title = _section_title(one["$ref"].rpartition("/")[2])
        return f"section [{title}](#{title.lower().replace(' ', '-')})"
    if "const" in one or "enum" in one:
        return " or ".join(f"`{value}`" for value in one.get("enum", [one.get("const")]))
    if one["type"] == "array":
        each = one.get("items") or {"type": "number"}
        return f"list of {_allowed(each)}"
    words = {"string": "text", "integer": "whole number", "boolean": "true or false", "object": "mapping"}
    signs = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "below", "maximum": "up to"}
    bounds = [f"{sign} {one[key]:g}" for key, sign in signs.items() if key in one]
    return " ".join([words.get(one["type"], "number"), *bounds])


def _default(name: str, one: dict[str, Any], section: dict[str, Any]) -> str:
    if name in section.get("required", ()):
        return "–"
    value = one.get("default")
    return "none" if value in (None, []) else "its defaults" if isinstance(value, dict) else f"`{value}`"


def python_names() -> str:
    """Return the reference of the public names of Python, by the module that holds them."""
    import radiometer

    parts = [
        "# Python names\n\n`import radiometer as rm` offers these and loads nothing before it is used. How they go "
        "together: [Python](python-guide.md). Every example runs in the tests."
    ]
    for home in dict.fromkeys(radiometer.home_of(name) for name in radiometer.__all__):
        opening = (importlib.import_module(home).__doc__ or "").strip().partition("\n")[0]
        parts.append(f"## {opening.rstrip('.')}")
        parts += [f"::: {home}.{name}" for name in radiometer.__all__ if radiometer.home_of(name) == home]
    return "\n\n".join(parts) + "\n"


def effects() -> str:
    """Return the catalogue of effects: what each does, where in the chain, its parameters with bounds and sources."""
    from simulators.effects.base import Stage
    from simulators.effects.registry import EFFECTS

    parts = [
        "# Effects\n\nThe whole catalogue of the forward model, made from the effects themselves; "
        "`radiometer reconcile` looks for those that are marked. [Add one of your own](../how-to/add-an-effect.md)."
    ]
    for stage in Stage:
        parts.append(f"## {stage.name.capitalize()}")
        for name, kind in sorted(EFFECTS.items()):
            if kind.stage is stage:
                parts.append("\n\n".join(_effect(name, kind)))
    parts.append(
        "## Members of an effect\n\nAn effect must state `name`, `stage`, `unit_in`, `unit_out`, `where`, `trials` and "
        "`fitted`, and must have `mean`. Everything else has a default."
    )
    for kind_path in ("simulators.effects.base.Effect", "simulators.effects.catalogue.CatalogueEffect"):
        parts.append(f"::: {kind_path}\n    options:\n      heading_level: 3")
    return "\n\n".join(parts) + "\n"


def thresholds() -> str:
    """Return the table of the thresholds that decide about names, with value, reason and measurement."""
    from radiometer.reconciliation.thresholds import TABLE

    rows = []
    for row in TABLE:
        value = f"{row.value:g}" if row.unit == "1" else f"{row.value:g} {row.unit}"
        rows.append(f"| `{row.name}` | {value} | {_cell(row.reason)} | {_cell(row.measured)} |")
    return (
        "# Thresholds of reconcile\n\nEvery threshold that decides about a name, made from the program. "
        "[How reconcile decides](../decisions/0011-how-reconcile-decides.md) shows where each acts.\n\n"
        "| name | value | protects from | measured by |\n|---|---|---|---|\n" + "\n".join(rows) + "\n"
    )


def _effect(name: str, kind: Any) -> Iterator[str]:
    from simulators.effects.catalogue import CatalogueEffect

    looked_for = " · looked for by reconcile" if issubclass(kind, CatalogueEffect) else ""
    yield f"### `{name}`"
    yield f"*{kind.unit_in} → {kind.unit_out}{looked_for}*"
    yield _docstring(kind.__doc__ or "")
    rows = [f"| `{one.name}` | {one.unit} | {_range(one)} | {_cell(one.source)} |" for one in kind.parameters()]
    if rows:
        yield "| parameter | unit | range | source |\n|---|---|---|---|\n" + "\n".join(rows)


def _range(one: Any) -> str:
    if one.of_full_scale:
        low, high = one.bounds(1.0)
        return f"{low:.4g} to {high:.4g} of full scale"
    return f"{one.low:g} to {one.high:g}"


def _docstring(text: str) -> str:
    """Return a class's text; lines that were set in keep their form."""
    lines = text.strip().splitlines()
    body = "\n".join(line[4:] if line.startswith("    ") else line for line in lines)
    return _escaped(re.sub(r"^Source:", "**Source:**", body, flags=re.MULTILINE))


def _escaped(text: str) -> str:
    return text.replace("<", "&lt;").replace("$", "&#36;")


def _cell(text: str) -> str:
    return _escaped(" ".join(text.split()).replace("|", "\\|"))


def notebook_page(path: Path) -> tuple[str, list[bytes]]:
    """Return a notebook as Markdown, and the pictures in it."""
    content = json.loads(path.read_text(encoding="utf-8"))  # noqa: TID251 (our notebooks)
    parts: list[str] = []
    pictures: list[bytes] = []
    for cell in content["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            parts.append(_output(output, path.stem, pictures))
    parts.insert(1, f"[The notebook itself]({path.name}){{ download }}")
    return "\n\n".join(part for part in parts if part) + "\n", pictures


def _output(output: dict[str, Any], name: str, pictures: list[bytes]) -> str:
    shown = output.get("data", {})
    if "image/png" in shown:
        pictures.append(base64.b64decode(shown["image/png"]))
        return f"![{''.join(shown.get('text/plain', name))}]({name}-{len(pictures) - 1}.png)"
    if "text/html" in shown:
        return f'<div class="output">{"".join(shown["text/html"])}</div>'
    text = "".join(shown.get("text/plain", output.get("text", "")))
    return f"```text\n{text.rstrip()}\n```" if text.strip() else ""
