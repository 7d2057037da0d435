"""Readers that do what compiled libraries do with a damaged file; they work in another process."""

from __future__ import annotations

import ctypes
import os
import re
from pathlib import Path

import numpy as np

from radiometer.data.reader_limits import bounded_reader
from radiometer.errors import InputError, SettingOutOfRange


@bounded_reader(error=InputError, apart="numpy")
def crash(path: Path) -> str:
    return ctypes.string_at(0).decode()


@bounded_reader(error=InputError, apart="numpy")
def end(path: Path) -> None:
    os._exit(3)


@bounded_reader(error=InputError, apart="numpy")
def hang(path: Path) -> object:
    return re.fullmatch(r"(a+)+", "a" * 60 + "b")  # for years, and no Python runs meanwhile


@bounded_reader(100_000_000, error=InputError, apart="numpy")
def take_memory(path: Path) -> object:
    return np.ones(10**9, np.uint8)


@bounded_reader(error=InputError, apart="numpy")
def stumble(path: Path) -> None:
    raise KeyError("TAG")


@bounded_reader(error=InputError, apart="numpy")
def refuse(path: Path) -> None:
    raise SettingOutOfRange("camera", "gain", 50.0, 0.0, 40.0, "dB")


@bounded_reader(error=InputError, apart="numpy")
def read(path: Path) -> tuple[int, np.ndarray, dict[str, float]]:
    print("noise of a library", flush=True)
    os.write(1, b"more of it")
    return os.getpid(), np.arange(2_000_000, dtype=np.uint16), {"a": float(path.stat().st_size)}
