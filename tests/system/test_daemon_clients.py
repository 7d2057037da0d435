"""The daemon in a process of its own, used by real clients: PyVISA, lxi, curl, a browser."""

import asyncio
import json
import shutil
import subprocess

import pytest

from testing.chromium import headless
from testing.daemon_process import DaemonProcess
from testing.patience import within

BRIGHT, DIM = 0.918, 0.1997  # radiance of the two patches of the small bench, W sr-1 m-2


@pytest.fixture(scope="module")
def shared_daemon(tmp_path_factory):
    """Return a daemon that measures five times a second and has a light box."""
    with DaemonProcess(tmp_path_factory.mktemp("daemon"), "--every", "0.2", "--box", "sim") as running:
        running.wait_for_reading()
        yield running


@pytest.fixture
def daemon(shared_daemon):
    """Return the shared daemon as it was started: its settings reset, its newest readings those of the bright patch."""
    shared_daemon.ask("*RST;*OPC?")
    shared_daemon.post("/measure", {})
    return shared_daemon


def _need(program):
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"{program} is not installed")
    return path


def test_pyvisa_reads_values_settings_and_blocks(daemon):
    """A VISA socket resource queries value and uncertainty, sets an exposure, and fetches the picture."""
    pyvisa = pytest.importorskip("pyvisa")
    pytest.importorskip("pyvisa_py")
    manager = pyvisa.ResourceManager("@py")
    instrument = manager.open_resource(
        f"TCPIP::127.0.0.1::{daemon.scpi_port}::SOCKET",
        read_termination="\n",
        write_termination="\n",
        timeout=within(10_000),
    )
    assert instrument.query("*IDN?").startswith("FLIR,BFS-U3-19S4M,22500001,")
    value, u = instrument.query_ascii_values("MEAS:RAD? 100,30,20,20")
    assert abs(value - DIM) < 4 * u
    assert 0 < u < 0.01
    instrument.write("SENS:EXP 4 MS;:FORM:BORD SWAP")
    assert float(instrument.query("SENS:EXP?")) == 0.004
    instrument.write("SENS:EXP:AUTO ON")
    picture = instrument.query_binary_values("TRAC:DATA? IMAG", datatype="H", is_big_endian=False, container=list)
    assert len(picture) == 160 * 120
    assert max(picture) < 4096
    assert instrument.query("SYST:ERR?") == '0,"No error"'
    instrument.close()
    manager.close()


def test_lxi_tools_talk_scpi(daemon):
    """`lxi scpi --raw` prints the reply."""
    command = [_need("lxi"), "scpi", "--raw", "--address", "127.0.0.1", "--port", str(daemon.scpi_port), "MEAS:RAD?"]
    reply = subprocess.run(command, capture_output=True, text=True, timeout=within(30), check=True).stdout
    value, u = map(float, reply.split(","))
    assert abs(value - BRIGHT) < 4 * u


def test_curl_reads_history_picture_and_stream(daemon, tmp_path):
    """History as CSV, the picture as PNG, and the first readings of the stream."""
    curl = [_need("curl"), "-sS", "--max-time", "20"]
    table = subprocess.run(
        [*curl, f"{daemon.url}/readings?format=csv&limit=1"], capture_output=True, text=True, check=True
    )
    header, row = table.stdout.splitlines()
    assert header.startswith("sequence,time,instrument,radiance,u_radiance")
    assert abs(float(row.split(",")[3]) - BRIGHT) < 0.03
    picture = tmp_path / "frame.png"
    subprocess.run([*curl, "-f", "-o", str(picture), f"{daemon.url}/frame.png"], check=True)
    assert picture.read_bytes().startswith(b"\x89PNG")
    streaming = subprocess.Popen([*curl, "-N", f"{daemon.url}/readings/stream"], stdout=subprocess.PIPE)
    assert streaming.stdout is not None
    lines = [streaming.stdout.readline() for _ in range(6)]
    streaming.terminate()
    streaming.wait()
    streaming.stdout.close()
    readings = [json.loads(line[6:]) for line in lines if line.startswith(b"data: ")]
    numbers = [reading["sequence"] for reading in readings]
    assert numbers == list(range(numbers[0], numbers[0] + 2))


@pytest.fixture
async def browser(tmp_path):
    """Return a headless browser with an empty profile."""
    async with headless(tmp_path / "profile") as driver:
        yield driver


async def test_a_browser_drags_the_patch_and_sees_the_value_change(daemon, browser):
    """From the bright field to the dim one; nothing from outside is loaded and no script fails."""
    await browser.command("Page.navigate", url=daemon.url + "/")
    await browser.wait_for(f"Math.abs(parseFloat(document.getElementById('value').textContent) - {BRIGHT}) < 0.03")
    await browser.wait_for(
        "!document.getElementById('patch').hidden && document.getElementById('picture').naturalWidth"
    )
    await browser.evaluate("document.getElementById('patch').scrollIntoView({block: 'center'})")
    box = await browser.evaluate(
        "(() => { const p = document.getElementById('patch').getBoundingClientRect(),"
        " i = document.getElementById('picture').getBoundingClientRect();"
        " return {x: p.x + p.width / 2, y: p.y + p.height / 2, scale: i.width / 160}; })()"
    )
    await browser.mouse("mousePressed", box["x"], box["y"])
    for step in range(1, 9):
        await browser.mouse("mouseMoved", box["x"] + step * 10 * box["scale"], box["y"])
    await browser.mouse("mouseReleased", box["x"] + 80 * box["scale"], box["y"])
    await browser.wait_for(f"Math.abs(parseFloat(document.getElementById('value').textContent) - {DIM}) < 0.01")
    patch = daemon.get("/status")["settings"]["patch"]
    assert (abs(patch["x"] - 100) <= 1, patch["y"], patch["width"]) == (True, 30, 20)
    await browser.evaluate("document.querySelector('[data-theme=red]').click()")
    assert browser.errors == []
    assert [url for url in browser.requested if not url.startswith((daemon.url, "blob:", "data:", "about:"))] == []


async def test_the_red_theme_lights_the_red_channel_only(daemon, browser):
    """Not one pixel of the whole page has green or blue in it, alarm and sliders included: rods stay adapted."""
    await browser.command("Page.navigate", url=daemon.url + "/")
    await browser.wait_for("document.querySelectorAll('#lights input').length >= 4")
    await browser.evaluate("document.querySelector('[data-theme=red]').click()")
    await browser.wait_for("document.getElementById('nothing').hidden")
    await browser.wait_for(
        "document.getElementById('picture').dataset.map === 'red' && document.getElementById('picture').complete"
    )
    await browser.command(
        "Emulation.setDeviceMetricsOverride", width=1240, height=1400, deviceScaleFactor=1, mobile=False
    )
    await asyncio.sleep(1.0)
    pixels = await browser.picture()
    assert pixels[..., 0].max() > 200
    assert pixels[..., 1:].max() == 0
