"""What is shipped next to the code: the manual page says what the commands say, and the container file holds together.

No container can be built in the tests, so the file is read: stages, copied paths, user, health check, commands.
"""

import http.server
import json
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import pytest

from radiometer.cli.admin.man import manual_page
from radiometer.cli.tree import command_tree
from testing.patience import within

ROOT = Path(__file__).resolve().parents[2]


def instructions() -> list[tuple[str, str]]:
    """Return (word, rest) of every instruction of the container file, lines that go on joined."""
    text = re.sub(r"^#.*\n", "", (ROOT / "Containerfile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines = [line.strip() for line in text.replace("\\\n", " ").splitlines() if line.strip()]
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1]) for line in lines]


def test_the_manual_page_is_whole_and_shipped():
    """Made by `make man`; each command and option stands in it; `pip install` puts it where man finds it."""
    stored = (ROOT / "docs" / "radiometer.1").read_text(encoding="utf-8")
    assert stored == manual_page(), "docs/radiometer.1 is out of date: run `make man`"
    page = manual_page().replace("\\-", "-")
    for one in command_tree():
        assert f".SS {' '.join(one.path)}\n" in page
        section = page.split(f".SS {' '.join(one.path)}\n")[1].split("\n.SS ")[0]
        for name, _ in (*one.options, *one.arguments):
            assert name in section
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    assert build["targets"]["wheel"]["shared-data"] == {"docs/radiometer.1": "share/man/man1/radiometer.1"}


@pytest.mark.skipif(not shutil.which("groff"), reason="groff is not installed")
@pytest.mark.slow
def test_the_manual_page_is_set_without_a_warning():
    """groff finds nothing to complain of, and no line of text is taken for a request."""
    words = ["groff", "-man", "-ww", "-Tutf8", "-K", "utf8", "-z", str(ROOT / "docs" / "radiometer.1")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_container_copies_what_exists_in_two_stages():
    """Only what the first made; paths exist; packages and files of the build come before it runs."""
    places = [n for n, (word, _) in enumerate(instructions()) if word == "FROM"]
    bases = [instructions()[n][1].split() for n in places]
    assert [base[0] for base in bases] == ["debian:12-slim", "debian:12-slim"]
    assert bases[0][1:] == ["AS", "build"]
    assert not any("gcc" in rest for _, rest in instructions()[places[1] + 1 :])
    ignored = set((ROOT / ".containerignore").read_text(encoding="utf-8").split())
    for word, rest in instructions():
        if word != "COPY":
            continue
        sources = rest.split()[:-1]
        if sources[0].startswith("--from="):
            assert sources[0] == "--from=build"
            continue
        for source in sources:
            assert (ROOT / source).exists(), source
            assert source.partition("/")[0] not in ignored
    copied = {part for word, rest in instructions() if word == "COPY" for part in rest.split()[:-1]}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*wheel["packages"], *wheel["force-include"], *wheel["shared-data"], project["project"]["readme"]}
    assert needed | {"pyproject.toml", *project["project"]["license-files"]} <= copied
    (extras,) = re.findall(r"'\.\[([a-z0-9,]+)\]'", str(instructions()))
    assert set(extras.split(",")) <= set(project["project"]["optional-dependencies"])


def test_the_container_runs_a_command_that_exists_as_an_ordinary_user():
    """A user of its own is made and used before anything runs; entry point, command and options are known."""
    reported = dict(instructions())
    assert reported["USER"] == "radiometer"
    assert "useradd --system" in str(instructions())
    words = [word for word, _ in instructions()]
    assert words.index("USER") < words.index("ENTRYPOINT")
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert json.loads(reported["ENTRYPOINT"]) == [*scripts]
    command, *rest = json.loads(reported["CMD"])
    known = {one.path: one for one in command_tree()}[(command,)]
    options = " ".join(name for name, _ in known.options)
    assert all(word in options for word in rest if word.startswith("--"))


@pytest.mark.parametrize(("status", "healthy"), [(200, True), (503, False)])
@pytest.mark.slow
def test_the_health_check_asks_the_daemon(status, healthy):
    """It passes on 200 and fails on 503, and without an answer."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            """Answer with the status of this case."""
            self.send_response(status if self.path == "/healthz" else 404)
            self.end_headers()

        def log_message(self, *_):
            """Say nothing."""

    words = json.loads(dict(instructions())["HEALTHCHECK"].partition("CMD ")[2])
    assert words[:2] == ["python3", "-c"]
    with http.server.HTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        code = words[2].replace(":8080", f":{server.server_address[1]}")
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=within(60))
    assert (done.returncode == 0) == healthy
