"""The account of retinal exposure: adds up over programs, starts and clocks; what is not known counts as used up."""

import fcntl
import math
import multiprocessing
import os
import subprocess
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometer.devices.exposure_account import (
    NO_EYE,
    FileStore,
    MemoryStore,
    Moment,
    machine_moment,
    name_of_eye,
    parse_account,
    process_name,
    render_account,
    simulates,
)
from radiometer.devices.exposure_ledger import ExposureLedger, Stimulus
from radiometer.devices.retinal_safety import ChannelOptics
from radiometer.errors import UnsafeStimulus, UsageError

# B = 1 over the whole line: 1000 W·sr⁻¹·m⁻² use up 0.1 % of the blue-light limit in each second.
BLUE = ChannelOptics(437.5, 0.5, 40.0, 1000.0)
SLOW = 1.01  # the box's clock may be so much slower: planned times count as so much longer
WINDOW_S = 1e4


class Clock:
    """Both clocks of a computer, turned by the test."""

    def __init__(self):
        self.boot, self.uptime_s, self.wall_s, self.machine = 0, 5000.0, 1.7e9, "one"

    def __call__(self):
        return Moment(f"boot{self.boot}", self.uptime_s, self.wall_s, self.machine)

    def wait(self, duration_s):
        self.uptime_s += duration_s
        self.wall_s += duration_s

    def reboot(self, off_s=30.0):
        self.boot, self.uptime_s, self.wall_s = self.boot + 1, 30.0, self.wall_s + off_s


class Desk:
    """A folder with an account that knows box LB000001, and programs that open it."""

    def __init__(self, folder):
        self.folder, self.clock, self.living = folder, Clock(), set[str]()
        with self.store("setup").change() as account:
            account.begin("LB000001")

    @property
    def file(self):
        return self.folder / "exposure-account.json"

    def store(self, program):
        return FileStore(
            self.folder,
            self.clock,
            self.clock.wait,
            program,
            lambda name: name in self.living,
            lambda name, port: name in self.living and port == f"port of {name}",
        )

    def open(self, serial="LB000001", eye=None, program="one", port=""):
        ledger = ExposureLedger({"a": BLUE, "b": BLUE}, self.store(program), eye=eye)
        ledger.open(serial, port)
        return ledger

    def pulse(self, ledger, seconds, radiance=1000.0, channel="a"):
        self.light(ledger, Stimulus(channel, radiance, seconds, seconds))

    def light(self, ledger, stimulus):
        ledger.begun(ledger.reserve(stimulus))
        ledger.settle()


@pytest.fixture
def desk(tmp_path):
    return Desk(tmp_path)


def test_pulses_add_up_over_openings_and_leave_after_the_window(desk):
    """Nine pulses of 1 % by nine programs are let through; another 2 % are not, until 10⁴ s and at most 50 s more."""
    for _ in range(9):
        desk.pulse(desk.open(), 10.0 / SLOW)
        desk.clock.wait(60.0)
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        desk.pulse(desk.open(), 20.0 / SLOW)
    desk.clock.wait(WINDOW_S - 9 * 60.0 + 10.0)
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(), 20.0 / SLOW)
    desk.clock.wait(60.0)
    desk.pulse(desk.open(), 20.0 / SLOW)


def test_a_killed_program_s_light_counts_until_the_box_is_known_dark(desk):
    """Steady light of 9 % in 10⁴ s: the next opening after 100 s finds 0.09 % given, not 9 %."""
    desk.pulse(desk.open(), math.inf, 9.0)
    desk.clock.wait(100.0)
    desk.pulse(desk.open(), 99.0 / SLOW)
    desk.clock.wait(110.0)
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(), 1.0)


def test_a_program_that_lives_keeps_its_light_in_the_account_whoever_opens_a_box_of_the_same_number(desk):
    """Two boxes may have one serial number: 6 % planned by the first leave no 5 % to the second."""
    desk.living.add("one")
    desk.pulse(desk.open(), math.inf, 6.0)
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(program="two"), 50.0)
    desk.living.clear()
    desk.pulse(desk.open(program="two"), 50.0)


def test_another_box_of_the_same_number_ends_no_light_of_a_killed_program(desk):
    """Its box is lit until the dead man has waited 1 s: ten such pulses of 1 s are all counted."""
    for _ in range(10):
        desk.pulse(desk.open(), 1.0)  # 0.1 % each, killed at once
        desk.open(program="two")  # of the other box, which is dark
    assert desk.store("two").look().blue("box LB000001") >= 0.0095


@pytest.mark.parametrize("step_s", [-1e7, -3600.0, 3600.0, 1e7])
def test_setting_the_clock_changes_nothing(desk, step_s):
    """8 % given just now stay 8 % whatever the wall clock shows."""
    desk.pulse(desk.open(), 80.0)
    desk.clock.wait(90.0)
    desk.clock.wall_s += step_s
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(), 30.0)
    desk.clock.wait(WINDOW_S + 100.0)
    desk.pulse(desk.open(), 30.0)


def test_after_a_restart_of_the_computer_only_its_uptime_counts(desk):
    """Switched off for a year by the clock that anybody can set: what was given counts until 10⁴ s of uptime."""
    desk.pulse(desk.open(), 80.0)
    desk.clock.wait(90.0)
    desk.open()
    desk.clock.reboot(off_s=3e7)
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(), 30.0)
    desk.clock.wait(WINDOW_S + 30.0)
    desk.pulse(desk.open(), 30.0)


def test_light_that_was_on_when_the_computer_went_down_counts_whole(desk):
    """How long steady light of 9 % in 10⁴ s shone is not known: all of it counts."""
    desk.pulse(desk.open(), math.inf, 9.0)
    desk.clock.reboot()
    with pytest.raises(UnsafeStimulus):
        desk.pulse(desk.open(), 15.0)


def harm(desk, kind):
    content = desk.file.read_bytes()
    if kind == "missing":
        desk.file.unlink()
    elif kind == "cut":
        desk.file.write_bytes(content[:-20])
    elif kind == "edited":
        desk.file.write_bytes(content.replace(b"1000.0", b"0010.0").replace(b"0.001", b"0.000"))
    elif kind == "endless":
        desk.file.write_bytes(b"x" * 5_000_000)
    elif kind == "from the future":
        account = parse_account(content)
        assert account is not None
        account.moment = replace(account.moment, uptime_s=account.moment.uptime_s + 3600.0)
        desk.file.write_text(render_account(account), encoding="ascii")
    elif kind == "of another boot":
        desk.clock.reboot(off_s=-1e6)
    elif kind == "of another computer":
        desk.clock.boot, desk.clock.machine = 7, "another"


HARMS = ("missing", "cut", "edited", "endless", "from the future", "of another boot", "of another computer")


@pytest.mark.parametrize("kind", HARMS)
def test_an_account_that_cannot_be_believed_counts_as_used_up_until_the_window_is_over(desk, kind):
    """Every light is refused with the way out, darkness is not; after 10⁴ s it is let through again."""
    desk.pulse(desk.open(), 80.0)
    harm(desk, kind)
    for _ in range(2):
        ledger = desk.open()
        ledger.darken()
        with pytest.raises(UnsafeStimulus, match=r"light account --box LB000001 --confirm-no-exposure"):
            desk.pulse(ledger, 0.001, 0.001)
        desk.clock.wait(4900.0)
    desk.clock.wait(300.0)
    desk.pulse(desk.open(), 90.0)


@pytest.mark.parametrize(
    ("bright_s", "way_out"), [(math.inf, "the box ends: `light pulse`"), (150.0, "shorten the exp")]
)
def test_a_refusal_names_a_way_out_that_helps(desk, bright_s, way_out):
    """A level that the program would end counts as 10⁴ s, however short it is planned: only light with an end helps."""
    with pytest.raises(UnsafeStimulus, match=way_out):
        desk.open().reserve(Stimulus("a", 1000.0, bright_s, bright_s))
    desk.pulse(desk.open(), 3.0)


def test_a_confirmation_ends_what_is_assumed_and_leaves_what_is_known(desk):
    """After it a lost account counts as empty; 8 % that were given since then stay."""
    harm(desk, "missing")
    desk.open()
    for _ in range(2):
        with desk.store("confirmation").change() as account:
            account.confirm("LB000001")
        ledger = desk.open()
    desk.pulse(ledger, 80.0)
    desk.clock.wait(90.0)
    with desk.store("confirmation").change() as account:
        account.confirm("LB000001")
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        desk.pulse(desk.open(), 30.0)


def test_a_box_that_this_computer_has_never_seen_counts_as_used_up(desk):
    """Another computer may have lit it a minute ago."""
    with pytest.raises(UnsafeStimulus, match="no account of its light"):
        desk.pulse(desk.open("LB000002"), 0.001, 0.001)
    desk.clock.wait(WINDOW_S)
    desk.pulse(desk.open("LB000002"), 50.0)


def test_a_faked_clock_does_not_free_the_account(monkeypatch):
    """A preloaded library shifts what the clocks answer; the system's own file does not move."""
    before = machine_moment()
    clock = time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda which: clock(which) + 20_000.0)
    assert 0.0 <= machine_moment().uptime_s - before.uptime_s + 0.01 < 60.0


def test_a_simulated_box_vouches_for_no_real_one_of_its_number(desk):
    """While it runs, no eye was before it; once it has ended, or on another port, that number is of an unknown box."""
    desk.living = {"twin"}
    for ended in (True, False):
        serial = f"LB00000{2 + ended}"
        with desk.store("twin").change() as account:
            account.begin(serial, "twin")
        desk.pulse(desk.open(serial, port="port of twin"), 20.0)
        desk.living = set() if ended else {"twin"}
        with pytest.raises(UnsafeStimulus, match="no account of its light"):
            desk.pulse(desk.open(serial, port="port of twin" if ended else "/dev/ttyACM0"), 0.001, 0.001)
        desk.living = {"twin"}
    with desk.store("twin").change() as account:
        account.begin("LB000002", "twin")  # it was met as a real one meanwhile
    desk.living = {"twin"}
    with pytest.raises(UnsafeStimulus, match="no account of its light"):
        desk.pulse(desk.open("LB000002", port="port of twin"), 0.001, 0.001)


def test_a_process_simulates_what_it_holds_the_far_end_of(tmp_path):
    """A pseudo-terminal of its own by any name; no other device, and no other process."""
    far, near = os.openpty()
    link = tmp_path / "link"
    link.symlink_to(f"/proc/{os.getpid()}/fd/{near}")
    own = process_name(os.getpid())
    with Path(os.ttyname(near)).open("rb", buffering=0):
        assert simulates(own, os.ttyname(near))
        assert simulates(own, str(link))
        assert not simulates(own, "/dev/null")
        assert not simulates(process_name(os.getppid()), str(link))
        assert not simulates(f"{os.getpid()} 1", str(link))
    os.close(far)
    assert not simulates(own, f"/dev/pts/{10**6}")
    os.close(near)


@pytest.mark.parametrize(("first", "second", "refused"), [
    (None, None, True), ("s07 right", None, True), (None, "s07 right", True), ("s07 left", "s07 right", False),
    ("s07 right", "s07 right", True),
    (NO_EYE, None, False), (None, NO_EYE, False), (NO_EYE, "s07 right", False),
])  # fmt: skip
def test_light_without_a_named_eye_counts_for_every_eye(desk, first, second, refused):
    """6 % in each of two boxes: an eye carries it along; refused where one eye may have looked into both."""
    with desk.store("setup").change() as account:
        account.begin("LB000002")
    desk.pulse(desk.open("LB000001", first), 60.0)
    desk.clock.wait(100.0)
    with pytest.raises(UnsafeStimulus, match="blue-light") if refused else nullcontext():
        desk.pulse(desk.open("LB000002", second), 60.0)


def test_a_subject_has_one_account_however_the_name_is_written():
    """What a reader may overlook makes no other eye; half a statement, or a name of marks alone, is no statement."""
    for name in (" s07 ", "Ｓ07", "S 07", "S-07", "s_07.", "S\u200b07", "S07\u0301", "S07\0", "\u3164S07", "Š07"):
        assert name_of_eye(name, "right") == "s07 right", name
    assert len({name_of_eye(name, "left") for name in ("S07", "S08", "S070", "T07", "7")}) == 5
    assert (name_of_eye(None, None), name_of_eye(None, None, no_eye=True)) == (None, NO_EYE)
    for wrong in (
        ("S07", None),
        (None, "left"),
        ("S07", "both"),
        ("S" * 65, "left"),
        ("\u200b", "left"),
        ("--", "left"),
    ):
        with pytest.raises(UsageError):
            name_of_eye(*wrong)
    with pytest.raises(UsageError, match="exclude each other"):
        name_of_eye("S07", "right", no_eye=True)


@pytest.mark.parametrize(("before", "after"), [(900.0, 0.0), (0.0, 9.0), (500.0, 5.0)])
def test_a_ramp_counts_as_the_higher_of_its_levels(desk, before, after):
    """A ramp of 60 s from or to 900 W·sr⁻¹·m⁻²: 60 s of it are given, besides what stays on."""
    ledger = desk.open()
    if before:
        desk.pulse(ledger, 30.0, before)
    desk.light(ledger, Stimulus("a", after, math.inf, math.inf, ramp_s=60.0))
    desk.clock.wait(100.0)
    ledger.darken("a")
    given = max(before, after) * 60.0 * SLOW + after * 100.0
    left_s = 100.0 - given / 1000.0
    desk.pulse(ledger, (left_s - 0.1) / SLOW, channel="b")
    desk.clock.wait(200.0)
    with pytest.raises(UnsafeStimulus):
        desk.pulse(ledger, 0.2, channel="b")


@pytest.mark.parametrize(("channel", "since_s"), [("b", 1.0), ("a", 100.0)])
def test_a_ramp_sets_out_from_what_its_own_channel_still_shows(desk, channel, since_s):
    """After 5 % by a, 60 s from dark to 1 W·sr⁻¹·m⁻² use up next to nothing: neither b nor the ended a is bright."""
    ledger = desk.open()
    desk.pulse(ledger, 50.0)
    desk.clock.wait(since_s)
    desk.light(ledger, Stimulus(channel, 1.0, math.inf, math.inf, ramp_s=60.0))
    with pytest.raises(UnsafeStimulus):
        ledger.refuse_unsafe(channel, 1000.0, 60.0)


def test_thermal_limits_of_lights_together_add_up(desk):
    """Two channels at 6 % of the thermal limit each are more than the tenth."""
    ledger = desk.open()
    six_percent = 0.06 * 50_000 / (10.0 * 0.1)  # R = 10, α capped at 100 mrad, 1 s
    desk.pulse(ledger, 1.0, six_percent)
    with pytest.raises(UnsafeStimulus, match="thermal"):
        desk.pulse(ledger, 1.0, six_percent, channel="b")


def test_what_still_shines_counts_to_its_planned_end(desk):
    """50 s under way count whole when another channel is asked for; their own channel's next light ends them."""
    ledger = desk.open()
    desk.pulse(ledger, 50.0)
    desk.clock.wait(10.0)
    with pytest.raises(UnsafeStimulus):
        ledger.refuse_unsafe("b", 1000.0, 50.0)
    ledger.refuse_unsafe("b", 1000.0, 48.0)
    ledger.refuse_unsafe("a", 1000.0, 86.0)  # 10 s given, and at most 3 s until the old light has gone
    with pytest.raises(UnsafeStimulus):
        ledger.refuse_unsafe("a", 1000.0, 89.0)


def test_a_program_whose_uptime_is_shifted_does_not_free_the_account(tmp_path, project_root):
    """time_namespaces(7): any user may shift the uptime of programs by 5.6 and 16.7 h, and fake their wall clock."""
    store = FileStore(tmp_path)
    with store.change() as account:
        account.begin("LB000001")
    ledger = ExposureLedger({"a": BLUE}, store)
    ledger.open("LB000001")
    ledger.begun(ledger.reserve(Stimulus("a", 1000.0, 80.0, 80.0)))
    look = f"""if True:
        import time
        from pathlib import Path
        from radiometer.devices.exposure_account import FileStore
        time.time = lambda: {time.time() + 20000.0}
        with FileStore(Path({str(tmp_path)!r})).change() as account:
            given = account.blue("any eye") + sum(one.blue() for one in account.planned.values())
            print("given", given, account.reason)"""
    for shift_s in ("20000", "60000"):
        shift = ["unshare", "-r", "-T", "--boottime", shift_s, "--monotonic", shift_s, sys.executable, "-c", look]
        try:
            looked = subprocess.run(shift, cwd=project_root, capture_output=True, text=True)
        except FileNotFoundError:
            pytest.skip("util-linux has no unshare here")
        if "given" not in looked.stdout:
            pytest.skip(f"this system makes no time namespaces: {looked.stderr[-200:]}")
        assert float(looked.stdout.split()[1]) >= 0.08


def test_another_program_that_holds_the_account_stops_light_within_a_second_and_never_darkness(desk):
    """The way out is named; the wait is shorter than the box's dead-man time; what ended meanwhile is stored later."""
    ledger = desk.open()
    desk.pulse(ledger, math.inf, 9.0)
    folder = os.open(desk.folder, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    begun_s = desk.clock.uptime_s
    ledger.darken()
    with pytest.raises(UnsafeStimulus, match=r"another program holds .* end that program"):
        desk.pulse(ledger, 1.0)
    assert desk.clock.uptime_s - begun_s < 2.0
    os.close(folder)
    desk.pulse(ledger, 90.0)


def test_a_folder_that_takes_no_file_stops_light_and_never_darkness(tmp_path):
    """The message names the file, the reason and RADIOMETER_STATE."""
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    ledger = ExposureLedger({"a": BLUE}, FileStore(blocked / "state", Clock()))
    ledger.open("LB000001")
    ledger.darken()
    with pytest.raises(UnsafeStimulus, match=r"exposure-account.json cannot be kept .* RADIOMETER_STATE"):
        ledger.reserve(Stimulus("a", 1.0, 1.0, 1.0))


@pytest.mark.parametrize("kind", ["file", "hard", "nothing", "pipe", "itself", None])
def test_an_account_that_is_no_file_stops_light_and_stays(desk, tmp_path_factory, kind):
    """A pipe, a second name, or a link to a file, nothing or itself: two such folders exclude no program."""
    other = tmp_path_factory.mktemp("other") / "account"
    if kind in ("file", "hard"):
        desk.file.rename(other)
    elif kind == "pipe":
        os.mkfifo(other)
    desk.file.unlink(missing_ok=True)
    if kind is None:
        os.mkfifo(desk.file)
    elif kind == "hard":
        desk.file.hardlink_to(other)
    else:
        desk.file.symlink_to(desk.file if kind == "itself" else other)
    before = desk.file.lstat(), other.lstat() if other.exists() else None
    what = "is (a symbolic link|no regular file|one of several names of a file), .* link its whole folder"
    with pytest.raises(UnsafeStimulus, match=what):
        desk.pulse(desk.open(), 1.0)
    assert (desk.file.lstat(), other.lstat() if other.exists() else None) == before
    if kind == "hard":
        other.unlink()
        desk.pulse(desk.open(), 1.0)
        assert desk.file.lstat() != before[0]


def test_a_linked_folder_holds_the_same_account(desk, tmp_path_factory):
    """9 % by one name and 3 % by the other are refused: one file, one lock."""
    ledger = desk.open()
    ledger.begun(ledger.reserve(Stimulus("a", 1000.0, 88.0, 88.0)))
    desk.clock.wait(100.0)
    ledger.settle()
    desk.folder.rename(moved := tmp_path_factory.mktemp("other") / "state")
    desk.folder.symlink_to(moved)
    with pytest.raises(UnsafeStimulus, match="blue-light"):
        desk.pulse(desk.open(), 30.0)
    desk.pulse(desk.open(), 5.0)


def _take_three_percent(folder, start, taken):
    ledger = ExposureLedger({"a": BLUE}, FileStore(folder), eye="S07 right")
    ledger.open(f"LB{os.getpid():06d}")
    start.wait()  # type: ignore[attr-defined]
    try:
        ledger.reserve(Stimulus("a", 300.0, 99.0, 99.0))
        taken.put(1)  # type: ignore[attr-defined]
    except UnsafeStimulus:
        taken.put(0)  # type: ignore[attr-defined]


def test_of_six_programs_at_once_three_get_three_percent_each(tmp_path, monkeypatch):
    """Six boxes before one eye, all asked at the same moment."""
    monkeypatch.setattr(
        "radiometer.devices.exposure_account.Account.meet", lambda account, serial, lives: account.begin(serial)
    )
    context = multiprocessing.get_context("fork")
    start, taken = context.Event(), context.Queue()
    programs = [context.Process(target=_take_three_percent, args=(tmp_path, start, taken)) for _ in range(6)]
    for program in programs:
        program.start()
    start.set()
    answers = [taken.get(timeout=60) for _ in programs]
    for program in programs:
        program.join()
    assert sum(answers) == 3


doses = st.lists(
    st.tuples(st.sampled_from("ab"), st.floats(0.1, 50.0), st.floats(0.5, 300.0), st.floats(0.0, 4000.0)),
    min_size=1,
    max_size=8,
)


@settings(max_examples=60, deadline=None)
@given(doses)
def test_the_account_is_the_sum_over_the_last_ten_thousand_seconds(given_doses):
    """Whatever was shone, in whichever channel: the rest is a tenth less Σ L·t / 10⁶ of the window, to 50 s."""
    clock = Clock()
    ledger = ExposureLedger({"a": BLUE, "b": BLUE, "c": BLUE}, MemoryStore(lambda: clock.uptime_s, ("LB000001",)))
    ledger.open("LB000001")
    ended = []
    for channel, radiance, seconds, pause in given_doses:
        name = ledger.reserve(Stimulus(channel, radiance, math.inf if radiance < 0.5 else seconds, seconds))
        ledger.begun(name)
        clock.wait(seconds)
        ledger.darken(channel)
        ended.append((clock.uptime_s, radiance * seconds))
        clock.wait(pause)
    for slack_s, factor, refused in ((50.0, 0.98, False), (0.0, 1.02, True)):
        inside = sum(dose for when, dose in ended if clock.uptime_s - when < WINDOW_S + slack_s)
        left = 1e5 - inside
        if not refused and left > 100.0:
            ledger.refuse_unsafe("c", left * factor / SLOW / 9000.0, 9000.0)
        if refused:
            with pytest.raises(UnsafeStimulus):
                ledger.refuse_unsafe("c", (max(left, 0.0) * factor + 1.0) / 9000.0, 9000.0)
