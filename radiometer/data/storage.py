"""Files written whole or not at all, and YAML read with errors that say where."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import yaml

from radiometer.data.guards import MOST_YAML_BYTES, refuse_deep_yaml
from radiometer.errors import InputError, OutputError

_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Loader(_SafeLoader):  # type: ignore[misc]
    """Refuses a key that occurs twice in a mapping, as YAML 1.2 (3.2.1.3) asks: PyYAML takes the last one."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag == "tag:yaml.org,2002:merge":
                continue
            if (key := self.construct_object(key_node)) in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key_node.value!r} occurs twice in one mapping; keep one", key_node.start_mark
                )
            seen.add(key)
        return dict(super().construct_mapping(node, deep=deep))


@contextmanager
def atomic_file(path: Path, *, binary: bool = False) -> Iterator[IO[Any]]:
    """Open a file for writing that appears under its name only when complete and flushed to disk.

    Args:
        path: Final name. Its folder must exist.
        binary: Open for bytes rather than UTF-8 text.

    Raises:
        OutputError: If the file cannot be written; nothing is left behind.
    """
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    try:
        stream = os.fdopen(handle, "wb") if binary else os.fdopen(handle, "w", encoding="utf-8", newline="")
        with stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o666 & ~_umask())  # noqa: PTH101 (mkstemp makes 0600)
        os.replace(temporary, path)  # noqa: PTH105
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def refuse_unwritable(path: Path) -> None:
    """Refuse a file that cannot be written, before the work whose result it is to hold.

    Args:
        path: The file.

    Raises:
        OutputError: If it is a folder, or its own folder is missing or takes no files.
    """
    if path.is_dir():
        raise OutputError(f"cannot write {path}: it is a folder")
    if not path.parent.is_dir():
        raise OutputError(f"cannot write {path}: the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write {path}: the folder {path.parent} takes no files (permission denied)")


def write_bytes_atomic(path: Path, content: bytes) -> None:
    """Write bytes so that the file is either whole or absent."""
    with atomic_file(path, binary=True) as stream:
        stream.write(content)


def write_text_atomic(path: Path, text: str) -> None:
    """Write UTF-8 text so that the file is either whole or absent."""
    with atomic_file(path) as stream:
        stream.write(text)


def write_yaml_atomic(path: Path, mapping: Mapping[str, Any]) -> None:
    """Write a mapping as YAML, keys in their given order, whole or not at all."""
    write_text_atomic(path, dump_yaml(mapping))


def dump_yaml(mapping: Mapping[str, Any]) -> str:
    """Return a mapping as YAML text with keys in their given order."""
    return str(
        yaml.dump(
            dict(mapping),
            Dumper=_Dumper,
            sort_keys=False,
            allow_unicode=True,
            width=120,
            default_flow_style=None,
        )
    )


def read_text(path: Path) -> str:
    """Return what a text file holds, without the mark that some editors put before it.

    Raises:
        InputError: If the file is missing, unreadable, or not text in UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file (byte {error.start} is not UTF-8)") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds.

    Raises:
        InputError: If the file is missing, unreadable, not YAML, or not a mapping; the message gives the line.
    """
    try:
        if path.stat().st_size > MOST_YAML_BYTES:
            raise InputError(f"{path}: larger than the {MOST_YAML_BYTES / 1e6:.0f} MB of YAML that are read")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    text = read_text(path)
    try:
        refuse_deep_yaml(text, str(path))
        content = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:  # a date or key that is none, too
        mark = getattr(error, "problem_mark", None)
        at = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise InputError(f"{path}{at}: not valid YAML: {getattr(error, 'problem', None) or error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected keys and values, found {type(content).__name__}")
    return content


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
