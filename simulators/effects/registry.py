"""The table of effects: a new effect is one file in this folder, or comes from outside.

What a laboratory keeps for itself is found by the entry points of installed packages (group `radiometer.effects`, the
effect's name and its class), or is read from a file.
"""

from __future__ import annotations

import functools
import importlib.util
import inspect
import pkgutil
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from pydantic import Field

import simulators.effects
from radiometer.data.validation import ConfigSection, validate
from radiometer.errors import ConfigurationError, RadiometerError
from simulators.effects.base import Effect
from simulators.effects.catalogue import CatalogueEffect
from simulators.effects.context import ExposureContext
from simulators.effects.free_law import kind_for

ENTRY_POINTS: Final = "radiometer.effects"


def all_effects() -> Mapping[str, type[Effect]]:
    """Return all effects by name: those of this table, of installed packages, and of files that were read.

    Raises:
        ConfigurationError: If an installed package's effect cannot be loaded.
    """
    _load_installed()
    return EFFECTS


@cache
def _load_installed() -> None:
    for found in entry_points(group=ENTRY_POINTS):
        _register(_loaded(found), f"entry point {found.name!r} of {found.value}")


def _loaded(found: EntryPoint) -> Any:
    try:
        return found.load()
    except Exception as error:  # whatever a foreign package does when it is imported
        raise ConfigurationError(
            f"effect {found.name!r} ({found.value}) cannot be loaded: {type(error).__name__}: {error}; "
            "repair or uninstall its package"
        ) from error


def register_file(path: Path) -> tuple[str, ...]:
    """Take the effects that a Python file defines into the table, and return their names.

    The file is run: it is code of the user's own.

    Raises:
        ConfigurationError: If it cannot be run, defines no effect, or one whose name is taken.
    """
    kinds = _kinds_in(_module_of(path))
    if not kinds:
        raise ConfigurationError(f"{path}: defines no effect; see docs/how-to/add-an-effect.md for what one is")
    for kind in kinds:
        _register(kind, str(path))
    return tuple(kind.name for kind in kinds)


def _kinds_in(module: ModuleType) -> list[type[Effect]]:
    """Return the effects that a module defines itself: those with a name, for families have none."""
    return [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and kind.__module__ == module.__name__ and issubclass(kind, Effect)
        if not inspect.isabstract(kind) and isinstance(getattr(kind, "name", None), str)
    ]


def _of_this_package() -> dict[str, type[Effect]]:
    """Return the effects of this folder by name, in alphabetical order of their files."""
    found = sorted(entry.name for entry in pkgutil.iter_modules(simulators.effects.__path__))
    modules = (importlib.import_module(f"simulators.effects.{name}") for name in found if name != "registry")
    return {kind.name: kind for module in modules for kind in _kinds_in(module)}


EFFECTS: Final[dict[str, type[Effect]]] = _of_this_package()


def _module_of(path: Path) -> ModuleType:
    if not path.exists():
        raise ConfigurationError(f"{path} does not exist; give a Python file that defines effects")
    name = f"_effects_of_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigurationError(f"{path}: is no Python file; give one that ends in .py and defines effects")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever the user's file does
        del sys.modules[name]
        raise ConfigurationError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    return module


def _register(kind: Any, where: str) -> None:
    """Take one effect into the table; the same class under the same name again changes nothing."""
    if not (inspect.isclass(kind) and issubclass(kind, Effect)):
        raise ConfigurationError(f"{where}: is no effect; derive it from simulators.effects.base.Effect")
    if inspect.isabstract(kind):
        raise ConfigurationError(f"{where}: the effect leaves out {', '.join(sorted(kind.__abstractmethods__))}")
    lacking = [key for key in _NEEDED if not hasattr(kind, key)]
    lacking += [key for key in _SEARCHED if issubclass(kind, CatalogueEffect) and not hasattr(kind, key)]
    if lacking:
        raise ConfigurationError(
            f"{where}: the effect does not say its {', '.join(lacking)}; see docs/how-to/add-an-effect.md"
        )
    if fault := _fault(kind):
        raise ConfigurationError(f"{where}: effect {kind.name!r}: {fault}; see docs/how-to/add-an-effect.md")
    known = EFFECTS.get(kind.name)
    if known is not None and (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise ConfigurationError(f"{where}: there is an effect {kind.name!r} already; give yours another name")
    _name_faults(kind, where)
    EFFECTS[kind.name] = kind


def _fault(kind: type[Effect]) -> str:
    """Return what would keep an effect from outside from ever being found; empty where nothing does."""
    if not _NAME.fullmatch(kind.name):
        return "its name may hold a to z, digits and _ only"
    if not issubclass(kind, CatalogueEffect):
        return ""
    for key in ("where", "block"):
        known = {str(getattr(one, key)) for one in EFFECTS.values() if hasattr(one, key)}
        if getattr(kind, key) not in known:
            return f"its {key} is {getattr(kind, key)!r}; possible are {', '.join(sorted(known))}"
    parameters = [one.name for one in kind.parameters()]
    unknown = [
        name for name in (*kind.fitted, *(name for trial in kind.trials for name in trial)) if name not in parameters
    ]
    if unknown:
        return f"its fitted or trials name {unknown[0]!r}, which is none of its parameters ({', '.join(parameters)})"
    has_starts = any("starts" in vars(one) for one in kind.__mro__ if one is not CatalogueEffect)
    return "" if kind.trials or has_starts else "its trials are empty"


def _name_faults(kind: type[Effect], where: str) -> None:
    """Have every fault of an effect from outside reported under its file's name, and no array of another shape pass."""
    for name in dir(kind):
        owner = next((one for one in kind.__mro__ if name in vars(one)), kind)
        member = vars(owner).get(name)
        is_own = inspect.isfunction(member) and not owner.__module__.startswith(("simulators.", "builtins"))
        # Those that the chain calls run the effect's own code within code of this package.
        if inspect.isfunction(member) and not name.startswith("__") and (is_own or name in _CALLED):
            setattr(kind, name, _naming(member, kind, where))


def _naming(function: Callable[..., Any], kind: type[Effect], where: str) -> Callable[..., Any]:
    what = f"{where}: `{function.__name__}` of effect {kind.name!r}"

    @functools.wraps(function)
    def named(*args: Any, **kwargs: Any) -> Any:
        try:
            found = function(*args, **kwargs)
        except RadiometerError:
            raise
        except (Exception, SystemExit) as error:  # whatever code from outside does
            reason = " ".join(str(error).split())[:200]
            raise ConfigurationError(f"{what} fails: {type(error).__name__}: {reason}; correct it there") from error
        context = next((one for one in args if isinstance(one, ExposureContext)), None)
        if context is not None and isinstance(found, (float, complex, np.ndarray)):
            _refuse_numbers(np.asarray(found), context, what)
        return found

    return named


def _refuse_numbers(found: Any, context: ExposureContext, what: str) -> None:
    """Refuse an array of another shape than the frames, and numbers that are complex, NaN or infinite."""
    if not _fits(found.shape, context):
        raise ConfigurationError(
            f"{what} gives an array of shape {found.shape}, which does not fit the frames; count axes from the last"
        )
    if np.iscomplexobj(found) or not (found.dtype.kind != "f" or np.isfinite(found).all()):
        raise ConfigurationError(f"{what} gives numbers that are complex, NaN or infinite; correct it there")


def _fits(shape: tuple[int, ...], context: ExposureContext) -> bool:
    """Return whether an array broadcasts to the frames of a context without more rows, columns or captures."""
    try:
        frames = np.broadcast_shapes(context.geometry.shape, np.shape(context.settings.exposure_s))
    except ValueError:  # of no frames
        return True
    try:
        whole = np.broadcast_shapes(shape, frames)
    except ValueError:
        return False
    return whole[len(whole) - len(frames) :] == frames


_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_CALLED: Final = ("mean", "sample", "slope", "moments")
_NEEDED: Final = ("name", "stage", "unit_in", "unit_out")
_SEARCHED: Final = ("where", "trials", "fitted")


class _EntryFile(ConfigSection):
    name: str
    enabled: bool = True
    parameters: dict[str, Any] = Field(default_factory=dict)
    notes: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EffectEntry:
    """An effect as a camera model holds it: with a switch, and notes on where it comes from."""

    effect: Effect  # the effect with its parameters
    enabled: bool = True  # False takes it out of the chain but keeps it in the file
    # Anything worth keeping with it (covariance, evidence, capture hashes)
    notes: Mapping[str, Any] = field(default_factory=dict)

    def to_mapping(self) -> dict[str, Any]:
        """Return {name, enabled, parameters[, notes]}, plain enough for YAML."""
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in self.effect.values().items()}
        mapping: dict[str, Any] = {"name": self.effect.name, "enabled": self.enabled, "parameters": values}
        return mapping | ({"notes": dict(self.notes)} if self.notes else {})

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> EffectEntry:
        """Return the entry that a mapping describes.

        Args:
            mapping: {name, enabled, parameters, notes}; all but the name may be missing.

        Raises:
            ConfigurationError: If the effect or a parameter is unknown, or a value is out of its bounds.
        """
        entry = validate(_EntryFile, mapping, where, ConfigurationError)
        return cls(make_effect(entry.name, entry.parameters, where), entry.enabled, entry.notes)


def make_effect(name: str, parameters: Mapping[str, Any] | None = None, where: str = "camera model") -> Effect:
    """Return an effect by its canonical name; parameters not given take their defaults.

    Raises:
        ConfigurationError: If the effect or a parameter is unknown, or a value is out of its bounds.
    """
    kind = EFFECTS.get(name) or all_effects().get(name)
    if kind is None:
        raise ConfigurationError(f"{where}: there is no effect {name!r}; known are {', '.join(sorted(EFFECTS))}")
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in (parameters or {}).items()}
    kind = kind_for(kind, tuple(given)) if issubclass(kind, CatalogueEffect) else kind
    allowed = [known.name for known in kind.parameters()]
    for key in given:
        if key not in allowed:
            raise ConfigurationError(
                f"{where}: effect {name!r} has no parameter {key!r}; it has {', '.join(allowed) or 'none'}"
            )
    try:
        return kind(**given)
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from error
