"""Whoever holds a light box darkens it on request; the folders for that are one user's alone."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from radiometer.bench.box_holder import ask_for_darkness, darken_held, held_boxes, holding, is_ours, runtime_folder
from radiometer.bench.boxes import candidate_ports, open_light_box, simulated_port_folder
from radiometer.bench.served_box import served_box
from radiometer.cli.main import run
from radiometer.devices.light_box import DriveLevel
from radiometer.errors import DeviceInUse, OutputError
from testing.patience import within


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def test_light_off_works_while_another_program_holds_the_box(capsys: pytest.CaptureFixture[str]) -> None:
    """The box on its port is lit and held; `light off` has its holder darken it, and says who that was."""
    with served_box("HELD0001", None).server as server, open_light_box(server.port) as opened:
        opened.box.set_level("spot", DriveLevel(1000))
        done: list[int] = []
        asking = threading.Thread(target=lambda: done.append(run(["light", "off", "--json"])))
        asking.start()
        asking.join(within(20.0))
        assert done == [0]
        assert opened.box.read_channel("spot").drive.level == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == {"box": "HELD0001", "darkened_by": os.getpid()}


def test_light_off_darkens_all_that_answer_whatever_else_is_there(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Two boxes, a link that leads nowhere, a holder that does not answer, a damaged calibration: both are dark."""
    folder = runtime_folder("radiometer-light-boxes")
    (folder / "DEAD0001").symlink_to("/dev/pts/99999")
    damaged = tmp_path / "data" / "radiometer" / "light_boxes" / "ONES0001.yaml"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("[")
    with served_box("ONES0001", None).server, served_box("TWOS0001", None).server:
        assert run(["light", "off"]) == 0
        assert {line.split()[2] for line in capsys.readouterr().out.splitlines()} == {"ONES0001:", "TWOS0001:"}

        def refuse() -> None:
            raise OSError

        with holding("MUTE0001", "/dev/mute", refuse):
            assert run(["light", "off"]) == 1
        printed = capsys.readouterr()
        assert {line.split()[2] for line in printed.out.splitlines()} == {"ONES0001:", "TWOS0001:"}
        assert "MUTE0001" in printed.err


def test_light_off_asks_only_the_holder_of_the_box_named(capsys: pytest.CaptureFixture[str]) -> None:
    """Another box stays as it is."""
    dark: list[str] = []
    with (
        holding("AAAA0001", "/dev/a", lambda: dark.append("a")),
        holding("BBBB0001", "/dev/b", lambda: dark.append("b")),
    ):
        assert [(box.serial, box.port) for box in held_boxes()] == [("AAAA0001", "/dev/a"), ("BBBB0001", "/dev/b")]
        assert run(["light", "off", "--box", "BBBB0001"]) == 0
        assert run(["light", "off", "--box", "/dev/a"]) == 0
    assert dark == ["b", "a"]
    assert held_boxes() == []


def test_what_answers_otherwise_is_no_box() -> None:
    """Whoever shows no number of a process is passed over, and the boxes next to it are found."""
    with holding("who is", "/dev/a", lambda: None), holding("BBBB0001", "/dev/b", lambda: None):
        assert [(box.serial, box.pid) for box in held_boxes()] == [("BBBB0001", os.getpid())]


def test_a_port_is_reported_whole_however_deep_its_folder_is() -> None:
    """A path may have 4095 bytes: cut off, `light off --box PORT` would find no holder."""
    port = "/" + "/".join(["folder"] * 584)
    assert len(port) == 4088
    with holding("AAAA0001", port, lambda: None):
        assert [(box.serial, box.port) for box in held_boxes()] == [("AAAA0001", port)]


def test_a_holder_that_does_not_darken_is_named() -> None:
    """The message gives the process and the ways that are left."""

    def stuck() -> None:
        raise OSError("the port has gone")

    with holding("AAAA0001", "/dev/a", stuck):
        (held,) = held_boxes()
        with pytest.raises(DeviceInUse, match=rf"process {os.getpid()} .* button"):
            ask_for_darkness(held)


def test_pages_darken_every_box_that_is_held() -> None:
    """Lights off of a page asks all holders, the one after a stuck one too, and says who is dark."""
    dark: list[str] = []

    def stuck() -> None:
        raise OSError("the port has gone")

    assert darken_held() == "no program holds a light box, so none is lit"
    with holding("BBBB0001", "/dev/b", lambda: dark.append("b")):
        assert darken_held() == "dark: light box BBBB0001"
        with holding("AAAA0001", "/dev/a", stuck), pytest.raises(DeviceInUse, match="AAAA0001"):
            darken_held()
    assert dark == ["b", "b"]


def test_what_a_killed_holder_left_behind_is_removed(tmp_path: Path) -> None:
    """A socket without a server is no holder."""
    import socket

    left = runtime_folder("radiometer-held-boxes") / "left"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(left))
    assert held_boxes() == []
    assert not left.exists()


@pytest.mark.parametrize("spoil", ["open to others", "a link", "a file"])
def test_a_folder_that_others_could_have_made_is_refused(tmp_path: Path, spoil: str) -> None:
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


def test_a_folder_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who owns the folder could put any port into it."""
    folder = simulated_port_folder()
    folder.mkdir(mode=0o700)
    uid = os.getuid()
    monkeypatch.setattr("radiometer.bench.box_holder.os.getuid", lambda: uid + 1)
    assert not is_ours(folder)


def test_a_folder_that_is_not_there_has_no_owner(tmp_path: Path) -> None:
    """Neither a missing folder nor one below a file is ours; one made by this user and closed to others is."""
    own, file = tmp_path / "own", tmp_path / "file"
    own.mkdir(mode=0o755)
    file.write_text("")
    assert [is_ours(path) for path in (own, tmp_path / "missing", file / "below")] == [True, False, False]
    for mode, ours in ((0o775, False), (0o757, False), (0o700, True)):
        own.chmod(mode)
        assert is_ours(own) is ours


@pytest.mark.slow
def test_light_that_the_box_ends_is_reported(capsys: pytest.CaptureFixture[Any]) -> None:
    """The bleach's energy budget lasts 200 s at its limit: 230 s end with exit code 1 and the time it lasted."""
    words = ["light", "set", "bleach", "--level", "60000", "--for", "230s", "--box", "sim"]
    assert run(words) == 1
    error = capsys.readouterr().err
    assert "energy budget" in error
    assert float(error.split("after ")[1].split(" s")[0]) == pytest.approx(200.0, abs=1.0)
    assert run([*words[:6], "150s", "--box", "sim"]) == 0
