"""Fixtures shared by the whole suite."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiometer.cli.logging_setup import configure_logging

PROJECT_ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _quiet_log():
    """Send events to the standard error of the moment: pytest replaces it for every test."""
    configure_logging()


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Return the root of the checkout."""
    return PROJECT_ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real measurements, or skip where it is absent."""
    beside = [parent / "shared" / "data" for parent in (PROJECT_ROOT.parent, PROJECT_ROOT.parent.parent)]
    folder = next((one for one in beside if one.is_dir()), None)
    if folder is None:
        pytest.skip("the real measurements (../shared/data) are not on this machine")
    return folder
