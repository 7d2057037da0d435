"""Synthetic capture sets, and the fit of one in which nothing is hidden."""

import pytest

from testing import synthetic_capture
from testing.reduced import start_of


@pytest.fixture(scope="session")
def make_capture():
    """Return a maker of capture sets: seed, frames per capture, and hooks that hide something in the camera."""
    return synthetic_capture.make_capture


@pytest.fixture(scope="session")
def declared(make_capture):
    """Return the fit that a search starts from where nothing is hidden: levels, gains, temperatures and darks."""
    return start_of(make_capture(6))
