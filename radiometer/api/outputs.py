"""The checks of files and folders that a command writes, before its work starts."""

from __future__ import annotations

from radiometer.data.storage import check_new_folder, check_outputs

__all__ = ["check_new_folder", "check_outputs"]
