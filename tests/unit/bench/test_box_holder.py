"""Light boxes: ports, and who holds them."""

import json
import os
import pty
import socket
import threading
import time
import tty
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.light_box.link import request_line
from drivers.light_box.serial_line import SerialPort
from radiometer.bench import boxes
from radiometer.bench.box_holder import darken_held, held_boxes, holding, is_ours, own_folder
from radiometer.bench.boxes import candidate_ports, find_boxes, open_light_box, simulated_port_folder
from radiometer.bench.served import served_box
from radiometer.cli.main import run
from radiometer.daemon.bench_instrument import bench_light
from radiometer.devices.exposure_account import Account, FileStore, Moment
from radiometer.devices.light_box import DriveLevel
from radiometer.errors import DeviceError, DeviceInUse, DeviceNotFound, OutputError
from simulators.light_box.lines import LineFaults
from testing.patience import within


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def test_another_box_on_the_port_of_the_one_that_was_lost_is_refused_by_the_daemon(tmp_path):
    """The light asked of the first is not given by the second, of which neither levels nor account are the same."""
    port = tmp_path / "port"
    light = bench_light(str(port))
    for serial in ("ONES0001", "TWOS0001", "ONES0001"):
        with served_box(serial, port).server:
            if serial == "ONES0001":
                light.open()
                assert light.set_level("spot", 0.01) > 0
            else:
                with pytest.raises(DeviceError, match="light box TWOS0001, in place of light box ONES0001"):
                    light.open()
                with pytest.raises(DeviceError, match="not open"):
                    light.set_level("spot", 0.01)
            light.close()


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("session", [None, "another"])
def test_light_off_works_from_another_session(tmp_path, monkeypatch, capsys, session, named):
    """Cron or a service has no XDG_RUNTIME_DIR or TMPDIR of the holder's desk: the holder darkens, and is named."""
    with served_box("HELD0001", tmp_path / "link").server as server, open_light_box(server.port) as opened:
        opened.box.set_level("spot", DriveLevel(1000))
        for name in ("XDG_RUNTIME_DIR", "TMPDIR"):
            monkeypatch.delenv(name, raising=False)
            if session:
                monkeypatch.setenv(name, str(tmp_path / session))
        assert run(["light", "off", "--json", *(["--box", str(tmp_path / "link")] if named else [])]) == 0
        assert opened.box.read_channel("spot").drive.level == 0
    assert json.loads(capsys.readouterr().out) == {"box": "HELD0001", "darkened_by": os.getpid()}


@pytest.mark.parametrize("link", [False, True])
def test_light_off_finds_the_holder_of_a_port_by_the_port(tmp_path, monkeypatch, capsys, link):
    """The holder keeps its state elsewhere; the port is named by another of its names, too."""
    with served_box("HELD0001", tmp_path / "link").server as server, open_light_box(server.port) as opened:
        opened.box.set_level("spot", DriveLevel(1000))
        monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path / "other"))
        done = []
        port = server.port if link else os.path.realpath(server.port)
        asking = threading.Thread(target=lambda: done.append(run(["light", "off", "--box", port])))
        asking.start()
        asking.join(within(20.0))
        assert done == [0]
        assert opened.box.read_channel("spot").drive.level == 0
    assert f"light box HELD0001: dark, by process {os.getpid()}" in capsys.readouterr().out


def test_a_box_that_stays_lit_is_an_error_of_every_program(tmp_path):
    """Whoever had it open learns at the end that it did not go dark."""
    with served_box("LIES0001", tmp_path / "link").server as server:
        opening = open_light_box(server.port)
        opened = opening.__enter__()
        opened.box.set_level("spot", DriveLevel(1000))
        server.faults_in = StaysLit()
        with pytest.raises(DeviceError, match="stays lit"):
            opening.__exit__(None, None, None)


class StaysLit(LineFaults):
    """Makes another request of every one for darkness."""

    def apply(self, raw):
        """Return what arrives."""
        return request_line(int(raw[1:3], 16), "ST") if b" OF " in raw else raw


def test_light_off_darkens_all_that_answer_whatever_else_is_there(capsys, tmp_path):
    """Two boxes, a link that leads nowhere, a holder that does not answer, a damaged calibration: both are dark."""
    folder = own_folder("simulated-boxes")
    (folder / "DEAD0001").symlink_to("/dev/pts/99999")
    damaged = tmp_path / "data" / "radiometer" / "light_boxes" / "ONES0001.yaml"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("[")
    with served_box("ONES0001", None).server, served_box("TWOS0001", None).server:
        assert run(["light", "off"]) == 0
        assert {line.split()[2] for line in capsys.readouterr().out.splitlines()} == {"ONES0001:", "TWOS0001:"}

        def refuse():
            raise OSError

        with holding("MUTE0001", "/dev/mute", refuse):
            assert run(["light", "off"]) == 1
        printed = capsys.readouterr()
        assert {line.split()[2] for line in printed.out.splitlines()} == {"ONES0001:", "TWOS0001:"}
        assert "MUTE0001" in printed.err


def test_a_program_that_hangs_while_it_holds_a_box_is_named(capsys, monkeypatch):
    """A stopped program takes the question and never answers: `light off` fails with its number."""
    with holding("AAAA0001", "/dev/a", lambda: None):
        monkeypatch.chdir(held_boxes()[0].address.parent)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as hangs:
        hangs.bind(f"0123456789ab-{os.getppid()}-1")  # the whole path may be longer than a socket's
        hangs.listen(4)
        assert run(["light", "off"]) == 1
    assert f"process {os.getppid()} holds light box" in capsys.readouterr().err


def test_a_port_is_reported_whole_however_deep_its_folder_is():
    """Cut off, `light off --box PORT` would find no holder; whoever shows no number of a process is passed over."""
    port = "/" + "/".join(["folder"] * 584)
    assert len(port) == 4088
    with holding("AAAA0001", port, lambda: None):
        assert [(box.serial, box.port) for box in held_boxes()] == [("AAAA0001", port)]
    with holding("who is", "/dev/a", lambda: None), holding("BBBB0001", "/dev/b", lambda: None):
        assert [(box.serial, box.pid) for box in held_boxes()] == [("BBBB0001", os.getpid())]


def test_pages_darken_every_box_that_is_held(capsys):
    """A page asks all holders, the one after a stuck one too; `light off --box` only that of the box named."""
    dark = []

    def stuck():
        raise OSError("the port has gone")

    told = rf"process {os.getpid()} holds light box AAAA0001 .* button"
    assert darken_held() == "no program holds a light box, so none is lit"
    with holding("BBBB0001", "/dev/b", lambda: dark.append("b")):
        assert darken_held() == "dark: light box BBBB0001"
        with holding("AAAA0001", "/dev/a", stuck), pytest.raises(DeviceInUse, match=told):
            darken_held()
    assert dark == ["b", "b"]
    dark = []
    with (
        holding("AAAA0001", "/dev/a", lambda: dark.append("a")),
        holding("BBBB0001", "/dev/b", lambda: dark.append("b")),
    ):
        assert [(box.serial, box.port) for box in held_boxes()] == [("AAAA0001", "/dev/a"), ("BBBB0001", "/dev/b")]
        assert run(["light", "off", "--box", "BBBB0001"]) == 0
        assert run(["light", "off", "--box", "/dev/a"]) == 0
    assert dark == ["b", "a"]
    assert held_boxes() == []


def test_what_a_killed_holder_left_behind_is_removed(tmp_path):
    """A socket without a server is no holder."""
    with holding("AAAA0001", "/dev/a", lambda: None):
        left = held_boxes()[0].address.with_name("left")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(left))
    assert held_boxes() == []
    assert not left.exists()


@pytest.mark.parametrize("spoil", ["open to others", "a link", "a file"])
def test_a_folder_that_others_could_have_made_is_refused(tmp_path, spoil):
    """Ports and requests of another user are not believed: neither served there nor looked for there."""
    folder = simulated_port_folder()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "TRAP0001").symlink_to("/dev/null")
    if spoil == "a link":
        folder.symlink_to(elsewhere)
    elif spoil == "a file":
        folder.write_text("")
    else:
        folder.mkdir()
        (folder / "TRAP0001").symlink_to("/dev/null")
        folder.chmod(0o777)
    assert not is_ours(folder)
    assert not [port for port in candidate_ports() if "TRAP" in port]
    with pytest.raises(OutputError, match=r"open to others|cannot make"):
        served_box("TWIN0001", None)


def test_a_folder_is_ours_that_nobody_else_could_fill(tmp_path, monkeypatch):
    """Neither a missing one nor one below a file, nor another user's; one made by this user and closed to others."""
    own, file = tmp_path / "own", tmp_path / "file"
    own.mkdir(mode=0o755)
    file.write_text("")
    assert [is_ours(path) for path in (own, tmp_path / "missing", file / "below")] == [True, False, False]
    for mode, ours in ((0o775, False), (0o757, False), (0o700, True)):
        own.chmod(mode)
        assert is_ours(own) is ours
    uid = os.getuid()
    monkeypatch.setattr("radiometer.bench.box_holder.os.getuid", lambda: uid + 1)
    assert not is_ours(own)


@pytest.mark.slow
def test_light_that_the_box_ends_is_reported(capsys):
    """The bleach's energy budget lasts 200 s at its limit: 230 s end with exit code 1 and the time it lasted."""
    words = ["light", "set", "bleach", "--level", "60000", "--for", "230s", "--box", "sim"]
    assert run(words) == 1
    error = capsys.readouterr().err
    assert "energy budget" in error
    assert float(error.split("after ")[1].split(" s")[0]) == pytest.approx(200.0, abs=1.0)
    assert run([*words[:6], "150s", "--box", "sim"]) == 0


@dataclass
class Stranger:
    """A serial device that is no light box: it says nothing and notes what it is sent."""

    port: str
    master: int

    def received(self):
        os.set_blocking(self.master, False)
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """Return such a device; no other port exists, and no one waits for a boot loader."""
    monkeypatch.setenv("RADIOMETER_STATE", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv(boxes.PORT_VARIABLE, raising=False)
    monkeypatch.setattr("drivers.light_box.box.BOOT_S", 0.01)
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield Stranger(os.ttyname(slave), master)
    os.close(master)
    os.close(slave)


def _plug(monkeypatch, *ports):
    monkeypatch.setattr(boxes, "list_serial_ports", lambda: list(ports))


def test_a_foreign_port_never_gets_a_byte(stranger, monkeypatch):
    """Neither by looking for all boxes nor, over and over, for one serial number; the message names the port."""
    _plug(monkeypatch, SerialPort(stranger.port, 0x0403, 0x6001, "FTDI FT232R"), SerialPort("/dev/ttyS0"))
    for _ in range(3):
        assert find_boxes() == ([], [])
        with pytest.raises(DeviceNotFound, match=f"not asked.*{stranger.port}"), open_light_box("BOX00001"):
            pass
    assert stranger.received() == b""


@pytest.mark.parametrize(
    "port",
    [
        SerialPort("/dev/a", 0x2341, 0x0043, "Arduino Uno", "8543"),
        SerialPort("/dev/a", 0x2A03, 0x0043),
        SerialPort("/dev/a", 0x1A86, 0x7523, "radiometer light box", "1"),
        SerialPort("/dev/a"),
    ],
)
def test_no_name_that_usb_gives_makes_a_box(stranger, monkeypatch, port):
    """Whatever a device calls itself: any Arduino is reset by being asked, and any text can be written into a chip."""
    _plug(monkeypatch, port._replace(device=stranger.port))
    assert find_boxes() == ([], [])
    assert stranger.received() == b""


def test_a_box_is_found_by_itself_once_its_port_was_named(stranger, monkeypatch, tmp_path):
    """By its USB serial number, whatever its port is next time; one without a serial number is never known."""
    with served_box("TEST0001", tmp_path / "port").server as served:
        for usb_serial, found in (("8543", 1), ("", 0)):
            uno = SerialPort(served.port, 0x2341, 0x0043, "Arduino Uno", usb_serial)
            _plug(monkeypatch, uno)
            assert candidate_ports() == []
            with open_light_box(served.port) as opened:
                serial = opened.box.identity.serial
            assert candidate_ports() == [served.port] * found
            assert [box.serial for box in find_boxes()[0]] == [serial] * found
    _plug(monkeypatch, SerialPort(stranger.port, 0x2341, 0x0043, "Arduino Uno", "8543"))
    for _ in range(2):
        assert find_boxes() == ([], [])
    assert stranger.received().count(b"\n") == 1  # another program is on it now: asked once, then left alone


def test_the_link_of_a_killed_box_is_no_port(stranger, monkeypatch):
    """Its terminal has another owner since: nothing is written to it. Two links to one box are one port."""
    _plug(monkeypatch)
    folder = simulated_port_folder()
    folder.mkdir(mode=0o700)
    link = folder / "TWIN0001"
    link.symlink_to(stranger.port)
    assert candidate_ports() == [str(link)]
    (folder / "TWIN0002").symlink_to(stranger.port)
    assert len(candidate_ports()) == 1
    time.sleep(0.2)
    Path(stranger.port).chmod(0o600)  # as a terminal that is made after the link has a later time
    assert candidate_ports() == []


def test_a_port_that_is_named_is_asked(stranger, monkeypatch):
    """On request any port is asked, as often as its answer takes."""
    _plug(monkeypatch)
    monkeypatch.setattr("drivers.light_box.box.START_UP_S", 0.3)
    with pytest.raises(DeviceNotFound, match="answers as a light box"), open_light_box(stranger.port):
        pass
    assert stranger.received().count(b"\n") > 1
    monkeypatch.setenv(boxes.PORT_VARIABLE, stranger.port)
    assert candidate_ports() == [stranger.port]


def test_an_account_is_free_ten_thousand_seconds_after_its_last_light(monkeypatch):
    """Light that no eye was named for counts for every eye; a box whose history is unknown says until when."""
    given = {"box A": {}, "any eye": {19_000.0: 0.1}, "eye s right": {18_000.0: 0.2, 15_000.0: 0.4}}
    account = Account(Moment("boot", 20_000.0, 0.0), given, {"box A": (20_500.0, "")})
    monkeypatch.setattr(FileStore, "look", lambda store: account)
    reports = {one.name: (one.blue_light, one.frees_in_s, one.unknown_for_s) for one in boxes.exposure_reports()[0]}
    assert reports == {
        "any eye": (0.1, 9000.0, 0.0),
        "box A": (0, 0.0, 500.0),
        "eye s right": (pytest.approx(0.7), 9000.0, 0.0),
    }
