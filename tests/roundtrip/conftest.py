"""Fixtures of the round trips: sessions with hidden effects, in memory."""

from collections.abc import Callable

import pytest

from testing.generator.session import Session, make_session


@pytest.fixture(scope="session")
def hidden_session() -> Callable[..., Session]:
    """Return the maker of sessions: `hidden_session("dark_current", camera_seed=3)`."""
    return make_session


@pytest.fixture(scope="session")
def null_session() -> Session:
    """Return a session in which nothing is hidden."""
    return make_session(camera_seed=11, session_seed=5)
