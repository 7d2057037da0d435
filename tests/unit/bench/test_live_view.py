"""The live view: what its page gets, and the patch that comes back from it."""

from __future__ import annotations

import asyncio
import base64
import io
import threading
from pathlib import Path
from typing import Any

import aiohttp
import pytest
import yaml
from PIL import Image

import radiometer as rm
from radiometer.errors import ConfigurationError

BENCH = """# our bench
camera: {kind: simulated, preset: BFS-U3-19S4M, width: 96, height: 64, black_level_dn: 64}
lens: {focal_length_mm: 16, f_number: 4}
patch:          # the lamp
  {x: 1, y: 2,
   width: 3, height: 4}
scene: {kind: uniform, radiance_W_per_sr_m2: 0.3}   # an even source
"""


def test_patch_drawn_on_the_page_is_printed_and_written_into_the_bench_file(tmp_path: Path) -> None:
    """The page gets picture, histogram and clipping; a rectangle becomes the patch, comments of the file stay."""
    bench, printed = tmp_path / "lab.yaml", list[str]()
    bench.write_text("format: radiometer-bench/1\n" + BENCH, encoding="utf-8")
    address: list[str] = []
    ready = threading.Event()

    def announce(url: str) -> None:
        address.append(url)
        ready.set()

    def run() -> None:
        found.append(rm.view(bench=bench, frames=40, every_s=0.05, announce=announce, notice=printed.append))

    found: list[rm.Patch] = []
    shown = threading.Thread(target=run)
    shown.start()
    assert ready.wait(60)
    first, reported = asyncio.run(_draw(address[0], [10, 20, 30, 16]))
    shown.join(120)
    assert Image.open(io.BytesIO(base64.b64decode(first["png"]))).size == (96, 64)
    assert sum(first["histogram"]) == 96 * 64
    assert (first["patch"], first["clips"], first["bench"]) == ([1, 2, 3, 4], False, "lab.yaml")
    assert found == [rm.Patch(10, 20, 30, 16)]
    assert printed[0] == "--patch 10,20,30,16"
    assert "written" in reported["text"]
    text = bench.read_text(encoding="utf-8")
    assert yaml.safe_load(text)["patch"] == {"x": 10, "y": 20, "width": 30, "height": 16}
    assert "# our bench" in text
    assert "# an even source" in text


async def _draw(url: str, patch: list[int]) -> tuple[dict[str, Any], dict[str, Any]]:
    async with aiohttp.ClientSession() as session, session.ws_connect(url.replace("/?", "/socket?")) as socket:
        first = await socket.receive_json(timeout=60)
        await socket.send_json({"kind": "patch", "patch": [90, 0, 50, 50]})  # leaves the frame: refused
        await socket.send_json({"kind": "patch", "patch": patch})
        await socket.send_json({"kind": "save"})
        while (message := await socket.receive_json(timeout=60))["kind"] != "notice" or message["failed"]:
            pass
        return first, message


def test_file_that_is_no_bench_stays_as_it_is(tmp_path: Path) -> None:
    """A patch is not written into what would not be a bench afterwards."""
    file = tmp_path / "x.yaml"
    file.write_text("colour: red\n", encoding="utf-8")
    with pytest.raises(ConfigurationError):
        rm.view(bench=file, frames=1)
    assert file.read_text(encoding="utf-8") == "colour: red\n"
