"""Files written whole or not at all at places checked before the work, and YAML read with errors that say where."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import os
import secrets
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import yaml

from radiometer.data.guards import MOST_YAML_BYTES, refuse_deep_yaml
from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import ConfigurationError, InputError, OutputError, OutputRefused


def shipped_config(name: str) -> Path:
    """Return the path of a configuration file that comes with the product, such as "bench-simulated.yaml".

    Raises:
        ConfigurationError: If there is none of that name; the message lists those of the same folder.
    """
    package = Path(__file__).resolve().parent.parent
    for root in (package.parent / "configs", package / "_configs"):
        candidate = root / name
        if candidate.is_file():
            return candidate
    folder = next((r / name for r in (package.parent / "configs", package / "_configs") if r.is_dir()), package).parent
    there = ", ".join(sorted(p.name for p in folder.glob("*.yaml"))) if folder.is_dir() else "none"
    raise ConfigurationError(f"no shipped configuration {name!r}; there are: {there}")


_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Dumper(_SafeDumper):  # type: ignore[misc]
    """The library's, to which names of files that are not UTF-8 are text with escapes."""


_Dumper.add_representer(str, lambda dumper, text: dumper.represent_str(text.encode(errors="backslashreplace").decode()))


_NEW_FILES: ContextVar[set[Path] | None] = ContextVar("_NEW_FILES", default=None)
_NO_HARD_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)  # link(2): FAT, some network file systems


@contextlib.contextmanager
def new_files_stay_new() -> Iterator[None]:
    """Let no output replace, in the block, a file that appears after `check_outputs` has looked for it."""
    token = _NEW_FILES.set(set())
    try:
        yield
    finally:
        _NEW_FILES.reset(token)


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


def check_outputs(*paths: Path | None, force: bool = False) -> None:
    """Refuse files that could not be written later, before the work whose results they are to hold.

    Args:
        paths: The files; None for one that was not asked for.
        force: Files that exist may be replaced.

    Raises:
        OutputRefused: If a file exists already, is named twice, or its folder is missing or takes no files.
    """
    named = [path for path in paths if path is not None]
    for number, path in enumerate(named):
        if any(_resolved(path) == _resolved(other) for other in named[:number]):
            raise OutputRefused(f"{path} is named for two outputs; name one file for each")
        if _exists(path):
            if path.exists() and not path.is_file():
                kind = "a folder" if path.is_dir() else "no regular file"
                raise OutputRefused(f"cannot write {path}: it is {kind}; name a file")
            if not force:
                raise OutputRefused(f"{path} exists already; name another file, or replace it with --force")
        _refuse_folder(path, _resolved(path).parent)
        if not force and (new := _NEW_FILES.get()) is not None:
            new.add(path.resolve())


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # Python 3.12 and earlier raise RuntimeError for a loop
        raise OutputRefused(
            f"cannot write {path}: it is a link that leads back to itself; name another file"
        ) from error


def check_new_folder(path: Path) -> None:
    """Refuse a folder that a result cannot fill later, before the work whose result it is to hold.

    Args:
        path: The folder. It must not exist, or be empty; a result never replaces a folder. The folders above it are
            created with it.

    Raises:
        OutputRefused: If it exists and is not empty, or cannot be created.
    """
    if not _exists(path):
        _refuse_folder(path, next(one for one in path.resolve().parents if one.exists()))
    elif not path.is_dir() or any(path.iterdir()):
        raise OutputRefused(f"{path} exists already and is not empty; name a new folder")
    else:
        _refuse_folder(path, path)


def _exists(path: Path) -> bool:
    try:
        path.lstat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:  # a name too long, a file where a folder should be, a zero byte
        raise OutputRefused(f"cannot write {str(path)!r:.200}: {getattr(error, 'strerror', None) or error}") from error
    return True


def _refuse_folder(path: Path, folder: Path) -> None:
    """Refuse a target whose folder takes no files: a nameless file is created there to see."""
    if not folder.is_dir():
        raise OutputRefused(f"cannot write {path}: the folder {folder} does not exist; create it first")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputRefused(
            f"cannot write {path}: the folder {folder} takes no files ({error.strerror or error})"
        ) from error


def write_bytes_atomic(path: Path, content: bytes, *, rescue: bool = True) -> None:
    """Write bytes so that the file is either whole or absent, and on the disk.

    A link is followed. A file that is replaced keeps its mode; a new one has the mode that the user's mask gives.
    A device, pipe or socket is never replaced, whatever link leads to it.

    Args:
        path: Final name. Its folder must exist.
        content: The bytes.
        rescue: Save the bytes elsewhere where the file cannot be written.

    Raises:
        OutputError: If the file cannot be written. Nothing half-written stays; the message names the place of the
            saved bytes.
    """
    try:
        _write_whole(path.resolve(), content)
    except (OSError, ValueError, RuntimeError) as error:
        reason = f"cannot write {path}: {getattr(error, 'strerror', None) or error}"
        saved = _save_elsewhere(path, content) if rescue else None
        if saved is not None:
            reason += f"; the result is saved as {saved}: move it to where it belongs"
        raise OutputError(reason) from error


def _write_whole(target: Path, content: bytes) -> None:
    mode = target.stat().st_mode if target.exists() else None
    if mode is not None and not stat.S_ISREG(mode):  # a rename over /dev/null by its administrator stops a machine
        raise OSError(f"{target} is no regular file")
    temporary = target.with_name(f".radiometer-{secrets.token_hex(8)}.part")
    # Created by open, not by tempfile: the system applies the user's mask, and no thread has to change it to learn it.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        with os.fdopen(handle, "wb") as stream:
            if mode is not None:
                os.fchmod(stream.fileno(), stat.S_IMODE(mode))
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        _publish(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    flush_folder(target.parent)


def _publish(temporary: Path, target: Path) -> None:
    """Give a finished file its name. Raises FileExistsError where the name was free, and is to be still."""
    new = _NEW_FILES.get()
    if new is not None and target in new:
        try:
            os.link(temporary, target)  # unlike a rename, it replaces nothing
        except FileExistsError as error:
            raise FileExistsError(errno.EEXIST, "another program has written it meanwhile") from error
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
        else:
            temporary.unlink()
            new.discard(target)  # a second writing replaces this program's own file
            return
    temporary.replace(target)


def flush_folder(folder: Path) -> None:
    """Have a folder's new names on the disk, so that a power cut does not lose a finished file."""
    with contextlib.suppress(OSError):  # some network file systems cannot flush a folder; the file is flushed
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _save_elsewhere(path: Path, content: bytes) -> Path | None:
    """Return where a result was saved that its own place did not take: the state folder, else the temporary one."""
    for folder in (state_folder(), Path(tempfile.gettempdir())):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            saved = Path(tempfile.mkdtemp(prefix="saved-", dir=folder)) / path.name[-64:]
            _write_whole(saved, content)
        except OSError:
            continue
        return saved
    return None


def state_folder() -> Path:
    """Return the user's folder for what programs keep (XDG Base Directory Specification: XDG_STATE_HOME)."""
    # A relative path begins at the user's home: the same one whatever folder a command runs in.
    return Path.home() / (os.environ.get("XDG_STATE_HOME") or Path(".local") / "state") / "radiometer"


def write_text_atomic(path: Path, text: str) -> None:
    """Write UTF-8 text as `write_bytes_atomic` writes bytes."""
    write_bytes_atomic(path, text.encode(errors="backslashreplace"))


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Return rows of cells as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


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


@bounded_reader(error=InputError)
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


@bounded_reader(error=InputError)
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
        reason = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InputError(f"{path}{at}: not valid YAML: {reason}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected keys and values, found {type(content).__name__}")
    return content
