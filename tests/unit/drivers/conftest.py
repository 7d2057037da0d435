"""A camera of wood: features by name, as Aravis's camera offers them."""

from typing import Any

import pytest

from drivers.cameras.feature_access import FeatureAccess


class LibraryError(Exception):
    """Stands in for `GLib.Error`."""

    def __init__(self, message: str, code: int = 1, domain: str = "arv-device-error-quark") -> None:
        super().__init__(message)
        self.message, self.code, self.domain = message, code, domain


class WoodenCamera:
    """Holds features; `stuck` ones keep their value, `refused` ones raise when written."""

    def __init__(self, features: dict[str, Any], stuck: frozenset[str], refused: frozenset[str]) -> None:
        self.features, self.stuck, self.refused = features, stuck, refused
        self.written: list[tuple[str, Any]] = []

    def is_feature_available(self, name: str) -> bool:
        return name in self.features

    def get_string(self, name: str) -> Any:
        return self.features[name]

    get_boolean = get_float = get_integer = get_string

    def set_string(self, name: str, value: Any) -> None:
        if name in self.refused:
            raise LibraryError(f"[{name}] access denied")
        self.written.append((name, value))
        if name not in self.stuck:
            self.features[name] = value

    set_boolean = set_float = set_integer = set_string


@pytest.fixture
def library_error() -> type[LibraryError]:
    """Return the error class of the stand-in library."""
    return LibraryError


@pytest.fixture
def wooden_camera():
    """Return a function that makes a stand-in camera and the access to its features."""

    def make(features: dict[str, Any], stuck: tuple[str, ...] = (), refused: tuple[str, ...] = ()):
        camera = WoodenCamera(dict(features), frozenset(stuck), frozenset(refused))
        return camera, FeatureAccess(camera, "camera W1", LibraryError)

    return make
