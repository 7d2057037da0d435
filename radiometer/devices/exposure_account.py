"""Stores how much light retinas were given, per light box and per eye, in a file that outlives every program.

A stimulus is entered before it is given and settled when it is over. What is open counts whole until then, so that a
program that ends at any point leaves an account that is never below what an eye received.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import math
import os
import stat
import time
import unicodedata
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from radiometer.data.json_text import json_text, parsed_json
from radiometer.data.storage import write_bytes_atomic
from radiometer.devices.retinal_safety import BLUE_WINDOW_S
from radiometer.errors import OutputError, UnsafeStimulus, UsageError

FORMAT: Final = "radiometer-exposure-account/1"
FILE_NAME: Final = "exposure-account.json"
BIN_S: Final = 50.0  # what ends within it is one entry that expires with its end: 201 entries hold any history
MOST_BYTES: Final = 4_000_000  # a thousand boxes and eyes with full histories take a tenth of it
LOCK_PATIENCE_S: Final = 0.5  # below the box's dead-man time: a wait for the lock darkens no other channel
LOCK_LOOK_S: Final = 0.005  # the account is held for some ms
EYES: Final = ("right", "left")
NO_HISTORY: Final = "this computer has no account of its light"
LONGEST_NAME: Final = 64  # characters of a pseudonym, as a test allows: thousands of eyes fit into MOST_BYTES
NO_EYE: Final = ""  # in place of whose eye looks: a person states that none does
_BLANK_LETTERS: Final = "\u115f\u1160"  # Hangul fillers: letters by their category, and invisible
ANY_EYE: Final = "any eye"  # the account of light that no eye was named for; no subject's key begins like it
# Steps of the wall clock below this at a restart are corrections of a drifting clock; time counts as standing still.
CLOCK_STEP_S: Final = 60.0
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
_SHIFT: Final = Path("/proc/self/timens_offsets")  # time_namespaces(7); numbers of namespaces are used again
_UPTIME: Final = Path("/proc/uptime")  # proc(5); in steps of 10 ms
_UPTIME_SLACK_S: Final = 1.0  # between two looks at the same clock; libraries that fake clocks shift it by more
_MACHINE_ID: Final = Path("/etc/machine-id")
_UNKNOWN_BOOT: Final = uuid.uuid4().hex  # where the system names no boot, each program counts as a new one


@dataclass(frozen=True, slots=True)
class Moment:
    """A time by the two clocks of a machine."""

    boot: str  # which start of the machine, and which clock of the system, `uptime_s` counts from
    uptime_s: float  # time since that start in s, also while the machine slept; it cannot be set
    wall_s: float  # time of day as Unix time in s; may be set to anything
    machine: str = ""  # which computer it is


def machine_moment() -> Moment:
    """Return the present time by this machine's clocks."""
    try:
        boot = _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        boot = _UNKNOWN_BOOT
    # Any user may start programs whose uptime is shifted: to the account that is another start of the machine.
    with contextlib.suppress(OSError):  # systems before Linux 5.6 shift no uptime
        boot = " ".join([boot, *_SHIFT.read_text(encoding="ascii").split()])
    try:
        machine = _MACHINE_ID.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        machine = ""
    uptime_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    with contextlib.suppress(OSError, ValueError, IndexError):
        counted_s = float(_UPTIME.read_text(encoding="ascii").split()[0])
        if abs(uptime_s - counted_s) > _UPTIME_SLACK_S:  # a preloaded library answers in place of the system
            uptime_s = counted_s
    return Moment(boot, uptime_s, time.time(), machine)


def process_name(pid: int) -> str:
    """Return a name that no other process of this boot has: its number and when it was started (proc(5), field 22)."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    return f"{pid} {status.rpartition(')')[2].split()[19]}"


def is_running(name: str) -> bool:
    """Return whether the process of a name still runs."""
    pid = name.partition(" ")[0]
    return pid.isdigit() and process_name(int(pid)) == name


def simulates(name: str, port: str) -> bool:
    """Return whether the process of a name runs and holds the far end of a pseudo-terminal: what answers there is it.

    Where the system does not say so (before Linux 4.20, or of another user's process) it counts as not.
    """
    terminal = Path(os.path.realpath(port))
    if not is_running(name) or terminal.parent.name != "pts":
        return False
    process = Path("/proc") / name.partition(" ")[0]
    with contextlib.suppress(OSError):
        for handle in (process / "fd").iterdir():
            with contextlib.suppress(OSError):  # closed meanwhile
                if handle.readlink().name != "ptmx":
                    continue
                lines = (process / "fdinfo" / handle.name).read_text(encoding="ascii").splitlines()
                if terminal.name in (line.partition("tty-index:")[2].strip() for line in lines):
                    return True
    return False


@dataclass(frozen=True, slots=True)
class Phase:
    """Light of one radiance within a stimulus, in fractions of the exposure limits."""

    blue_per_s: float  # fraction of the blue-light limit that a bright second uses up
    blue_most: float  # fraction that it uses up at most, however long it is bright
    bright_s: float  # planned bright time in s; `math.inf` where no end is planned
    thermal: float  # fraction of the thermal limit

    def blue(self, bright_s: float = math.inf) -> float:
        """Return the fraction of the blue-light limit for at most so many bright seconds of it."""
        lit_s = min(bright_s, self.bright_s)
        return min(self.blue_per_s * lit_s, self.blue_most) if self.blue_per_s else 0.0


@dataclass(frozen=True, slots=True)
class Planned:
    """A stimulus that was entered and is not settled."""

    box: str  # serial number of the light box
    eye: str | None  # whose eye looks; None where it is not known, NO_EYE where none does
    channel: str  # channel of the box
    holder: str  # the program that entered it
    start_s: float  # when it was entered, by the uptime of the account's boot
    over_s: float  # when the box has ended it by itself at the latest; `math.inf` where no end is planned
    phases: tuple[Phase, ...]  # its light; all phases count as beginning at `start_s`

    def blue(self, until_s: float = math.inf) -> float:
        """Return the fraction of the blue-light limit that it has used up at most, if it is dark from `until_s` on."""
        return math.fsum(phase.blue(max(until_s - self.start_s, 0.0)) for phase in self.phases)

    @property
    def thermal(self) -> float:
        """Return the fraction of the thermal limit of its hottest phase."""
        return max((phase.thermal for phase in self.phases), default=0.0)

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the names of the accounts that it counts in."""
        return box_key(self.box), *eye_keys(self.eye)


def box_key(serial: str) -> str:
    """Return the name of a light box's account."""
    return f"box {serial}"


def eye_keys(eye: str | None) -> tuple[str, ...]:
    """Return the names of the accounts of eyes that light counts in: of one, of any, or of none."""
    return () if eye == NO_EYE else (ANY_EYE,) if eye is None else (f"eye {eye}",)


def name_of_eye(subject: str | None, eye: str | None, *, no_eye: bool = False) -> str | None:
    """Return whose eye looks, in one spelling: "s07 right"; None where that is not known, NO_EYE where none does.

    Args:
        subject: Pseudonym of the subject. Only its letters and digits count. Case, blanks, accents, punctuation and
            invisible characters make no other subject: a name that is written in two ways has one account.
        eye: "right" or "left".
        no_eye: State that no eye looks.

    Raises:
        UsageError: If a subject has no eye, an eye no subject, somebody looks although no eye does, or a name is too
            long or without letters and digits.
    """
    spelt = unicodedata.normalize("NFKD", unicodedata.normalize("NFKD", subject or "").casefold())
    name = "".join(sign for sign in spelt if unicodedata.category(sign)[0] in "LN" and sign not in _BLANK_LETTERS)
    if subject and subject.strip() and not name:
        raise UsageError(f"--subject {subject!r:.80} has no letter and no digit; name the subject by some")
    if len(name) > LONGEST_NAME:
        raise UsageError(f"--subject has {len(name)} characters; a pseudonym has {LONGEST_NAME} at most")
    if no_eye and (name or eye):
        raise UsageError("--no-eye and --subject exclude each other: state whose eye looks, or that none does")
    if eye is not None and eye not in EYES:
        raise UsageError(f"--eye {eye}: {' or '.join(EYES)}")
    if bool(name) != (eye is not None):
        raise UsageError("an eye needs both --subject NAME and --eye right or left; give both, or none of them")
    return NO_EYE if no_eye else f"{name} {eye}" if name else None


@dataclass(slots=True)
class Account:
    """What is known of all boxes and eyes at a moment."""

    moment: Moment  # when it was brought up to date; times below are uptimes of its boot
    # For each box and eye, the end of an interval of BIN_S and the blue-light fraction given in it
    given: dict[str, dict[float, float]] = field(default_factory=dict)
    # Boxes whose history is unknown: until when their limit counts as used up, and why
    assumed: dict[str, tuple[float, str]] = field(default_factory=dict)
    planned: dict[str, Planned] = field(default_factory=dict)  # what is open, by its name
    # Why the history of a box that it does not know is unknown
    reason: str = NO_HISTORY
    # Boxes that are known by their simulation alone, and the program that runs it
    simulated: dict[str, str] = field(default_factory=dict)

    @property
    def now_s(self) -> float:
        """Return the uptime at which it was brought up to date, in s."""
        return self.moment.uptime_s

    def meet(self, serial: str, simulated_by: Callable[[str], bool]) -> None:
        """Take up a box; one that the account does not know counts as used up for the window from now on.

        Args:
            serial: Its serial number.
            simulated_by: Returns whether the box is the simulation of a program: on another port, or once that
                simulation has ended, a box of its number is another one.
        """
        key = box_key(serial)
        if key not in self.given or (key in self.simulated and not simulated_by(self.simulated[key])):
            self.given.setdefault(key, {})
            self.simulated.pop(key, None)
            self.assumed[key] = self.now_s + BLUE_WINDOW_S, self.reason

    def begin(self, serial: str, holder: str | None = None) -> None:
        """Take up a box that was just made, as simulated ones are; a box that is known keeps its history.

        Args:
            serial: Its serial number.
            holder: The program that simulates it; None where the account ends with the simulation.
        """
        key = box_key(serial)
        if holder is not None and (key not in self.given or key in self.simulated):
            self.simulated[key] = holder
        self.given.setdefault(key, {})

    def confirm(self, serial: str) -> None:
        """Take a person's word that no eye was exposed within the window; what is known to be given stays."""
        self.given.setdefault(box_key(serial), {})
        self.assumed.pop(box_key(serial), None)
        self.simulated.pop(box_key(serial), None)

    def settle(self, name: str, dark_s: float) -> None:
        """Turn what was planned into what was given, knowing that it is dark from an uptime on."""
        planned = self.planned.pop(name, None)
        if planned is not None:
            self._give(planned, planned.blue(dark_s), min(dark_s, planned.over_s))

    def blue(self, key: str) -> float:
        """Return the fraction of the blue-light limit that was given within the window, without what is open."""
        return math.fsum(self.given.get(key, {}).values())

    def advance(self, moment: Moment) -> bool:
        """Bring the account to a later moment; return False where it was written after that, or by another computer.

        Within a boot the uptime counts, which cannot be set. Across boots the time that passed is the wall clock's or
        the uptime of the new boot, whichever is less: how long the machine was off is not known. To a program whose
        uptime is shifted (a time namespace) no time has passed since the last entry: its wall clock may be faked, too.
        """
        before = self.moment
        if moment.machine != before.machine:  # neither its uptime nor its wall clock can be compared with ours
            return False
        if moment.boot == before.boot:
            if moment.uptime_s < before.uptime_s:
                return False
            self.moment = moment
        else:
            same_start = moment.boot.split()[:1] == before.boot.split()[:1]
            passed_s = 0.0 if same_start else min(moment.uptime_s, moment.wall_s - before.wall_s)
            if not passed_s > -CLOCK_STEP_S:
                return False
            self._change_boot(moment, max(passed_s, 0.0))
        self._tidy()
        return True

    def _change_boot(self, moment: Moment, passed_s: float) -> None:
        later_s = moment.uptime_s - passed_s - self.moment.uptime_s
        self.moment = moment
        self.given = {key: {end_s + later_s: blue for end_s, blue in bins.items()} for key, bins in self.given.items()}
        self.assumed = {key: (until_s + later_s, why) for key, (until_s, why) in self.assumed.items()}
        for planned in self.planned.values():  # how long it shone is unknown: it counts whole, and as just ended
            self._give(planned, planned.blue(), moment.uptime_s)
        self.planned = {}

    def _tidy(self) -> None:
        """Settle what the box has ended by itself and forget what is older than the window."""
        for name in [name for name, planned in self.planned.items() if planned.over_s <= self.now_s]:
            self.settle(name, math.inf)
        oldest_s = self.now_s - BLUE_WINDOW_S
        for key, bins in list(self.given.items()):
            kept = {end_s: blue for end_s, blue in bins.items() if end_s > oldest_s}
            if kept or key.startswith("box "):  # a box stays known; an eye that was not exposed is like a new one
                self.given[key] = kept
            else:
                del self.given[key]
        self.assumed = {key: known for key, known in self.assumed.items() if known[0] > self.now_s}

    def _give(self, planned: Planned, blue: float, end_s: float) -> None:
        if blue <= 0.0:
            return
        end_s = math.ceil(end_s / BIN_S) * BIN_S
        for key in planned.keys:
            bins = self.given.setdefault(key, {})
            bins[end_s] = bins.get(end_s, 0.0) + blue


class AccountStore(Protocol):
    """Where an account is kept."""

    @property
    def holder(self) -> str:
        """Return the name of this program in the account."""

    def lives(self, holder: str) -> bool:
        """Return whether another program that entered light still runs."""

    def simulates(self, holder: str, port: str) -> bool:
        """Return whether what answers on a port is the simulation of a program that runs."""

    def now_s(self) -> float:
        """Return the present uptime in s."""

    def look(self) -> Account:
        """Return the account as it is now, to read. Raises UnsafeStimulus where it cannot be had."""

    def change(self) -> contextlib.AbstractContextManager[Account]:
        """Return a block that holds the account for itself and stores it at its end.

        Raises:
            UnsafeStimulus: If it cannot be locked, read or stored; then nothing was changed.
        """


@dataclass(slots=True)
class MemoryStore:
    """The account of a simulated box whose world ends with the program."""

    clock: Callable[[], float]  # simulated time in s
    boxes: tuple[str, ...] = ()  # serial numbers of the boxes of that world: no eye was before them
    holder: str = "this program"
    _account: Account | None = None

    def lives(self, holder: str) -> bool:
        """Return False: there is no other program in this world."""
        return False

    def simulates(self, holder: str, port: str) -> bool:
        """Return False: there is no other program in this world."""
        return False

    def now_s(self) -> float:
        return self.clock()

    def look(self) -> Account:
        moment = Moment("simulated", self.clock(), self.clock())
        if self._account is None:
            self._account = Account(moment)
            for serial in self.boxes:
                self._account.begin(serial)
        self._account.advance(moment)
        return self._account

    @contextmanager
    def change(self) -> Iterator[Account]:
        yield self.look()


@dataclass(frozen=True, slots=True)
class FileStore:
    """The account in a folder: read, changed and written whole while the folder is locked.

    A file that is missing, damaged or from the future is an account that knows no box: see `Account.meet`.
    """

    folder: Path  # holds the file; made where missing
    moment: Callable[[], Moment] = machine_moment  # returns the present time
    sleep: Callable[[float], None] = time.sleep  # waits between two looks at a lock
    holder: str = field(default_factory=lambda: process_name(os.getpid()))  # name of this program
    running: Callable[[str], bool] = is_running  # returns whether the program of a name still runs
    simulating: Callable[[str, str], bool] = (
        simulates  # returns whether the program of a name simulates what a port has
    )

    def lives(self, holder: str) -> bool:
        return holder != self.holder and self.running(holder)

    def simulates(self, holder: str, port: str) -> bool:
        return self.simulating(holder, port)

    @property
    def path(self) -> Path:
        """Return the file."""
        return self.folder / FILE_NAME

    def now_s(self) -> float:
        return self.moment().uptime_s

    def look(self) -> Account:
        return self._read()

    @contextmanager
    def change(self) -> Iterator[Account]:
        """Lock the folder, let the block change the account, and store it on the disk before going on."""
        folder = self._locked()
        try:
            for abandoned in self.folder.glob(f".{FILE_NAME}.*"):  # of programs that ended while they wrote
                abandoned.unlink(missing_ok=True)
            account = self._read()
            yield account
            self._write(account, folder)
        finally:
            os.close(folder)

    def _locked(self) -> int:
        """Return the folder, open and locked: a lock file might be deleted while it is locked, a folder in use not."""
        waited_s = 0.0
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise self._unusable(error) from error
        try:
            while True:
                try:
                    fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if waited_s >= LOCK_PATIENCE_S:
                        raise UnsafeStimulus(
                            f"another program holds the exposure account {self.path}, so no light is given;"
                            " end that program, or try again"
                        ) from None
                    self.sleep(LOCK_LOOK_S)
                    waited_s += LOCK_LOOK_S
            if not os.path.samestat(os.fstat(folder), self.folder.stat()):
                raise OSError(f"{self.folder} was replaced meanwhile")
        except OSError as error:
            os.close(folder)
            raise self._unusable(error) from error
        except UnsafeStimulus:
            os.close(folder)
            raise
        return folder

    def _read(self) -> Account:
        try:
            # Without waiting: a pipe in its place would hold this program, and the lock, for ever.
            how = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW
            with os.fdopen(os.open(self.path, how), "rb") as stream:
                status = os.fstat(stream.fileno())
                if not stat.S_ISREG(status.st_mode):
                    raise self._no_file("no regular file")
                if status.st_nlink > 1:  # a writer renames over one name, and the file of the other names stays behind
                    raise self._no_file("one of several names of a file")
                content = stream.read(MOST_BYTES + 1)
        except FileNotFoundError:
            return Account(self.moment())
        except OSError as error:
            if error.errno == errno.ELOOP:  # each folder has its own lock: through a link, two programs would write
                raise self._no_file("a symbolic link") from error
            raise self._unusable(error) from error
        moment = self.moment()  # after the reading: else what was written meanwhile would be from the future
        account = parse_account(content)
        if account is None:
            return Account(moment, reason=f"the exposure account {self.path} was damaged")
        if not account.advance(moment):
            return Account(moment, reason=f"the exposure account {self.path} was from the future or another computer")
        return account

    def _write(self, account: Account, folder: int) -> None:
        try:
            write_bytes_atomic(self.path, render_account(account).encode("ascii"), rescue=False)
            os.fsync(folder)
        except (OSError, OutputError) as error:
            raise self._unusable(error) from error

    def _no_file(self, what: str) -> UnsafeStimulus:
        return UnsafeStimulus(
            f"the exposure account {self.path} is {what}, so no light is given; leave the account itself there, under"
            " this name alone, and link its whole folder or set RADIOMETER_STATE for other places"
        )

    def _unusable(self, error: Exception) -> UnsafeStimulus:
        reason = getattr(error, "strerror", None) or error
        return UnsafeStimulus(
            f"the exposure account {self.path} cannot be kept ({reason}), so no light is given;"
            " free its disk, or set RADIOMETER_STATE to a folder of your own"
        )


def render_account(account: Account) -> str:
    """Return the account as a line of JSON and a line with its SHA-256; its times count from its moment."""
    now_s = account.now_s
    body = json_text(
        {
            "format": FORMAT,
            "moment": [account.moment.boot, account.moment.uptime_s, account.moment.wall_s, account.moment.machine],
            "given": {
                key: [[end_s - now_s, blue] for end_s, blue in bins.items()] for key, bins in account.given.items()
            },
            "assumed": {key: [until_s - now_s, why] for key, (until_s, why) in account.assumed.items()},
            "planned": {name: _planned_to_json(planned, now_s) for name, planned in account.planned.items()},
            "simulated": account.simulated,
        },
        ascii_only=True,
    )
    return f"{body}\n{hashlib.sha256(body.encode('ascii')).hexdigest()}\n"


def parse_account(content: bytes) -> Account | None:
    """Return the account that a file holds; None where it is damaged or of another form."""
    body, _, checksum = content.partition(b"\n")
    if len(content) > MOST_BYTES or checksum != hashlib.sha256(body).hexdigest().encode("ascii") + b"\n":
        return None
    try:
        known = parsed_json(body)
        if known["format"] != FORMAT:
            return None
        boot, uptime_s, wall_s, machine = known["moment"]
        now_s = float(uptime_s)
        return Account(
            Moment(str(boot), now_s, float(wall_s), str(machine)),
            # To the millisecond: an interval keeps its name through many readings.
            {
                key: {round(now_s + end_s, 3): float(blue) for end_s, blue in bins}
                for key, bins in known["given"].items()
            },
            {key: (now_s + float(until_s), str(why)) for key, (until_s, why) in known["assumed"].items()},
            {name: _planned_from_json(entry, now_s) for name, entry in known["planned"].items()},
            simulated={key: str(holder) for key, holder in known.get("simulated", {}).items()},
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _planned_to_json(planned: Planned, now_s: float) -> list[Any]:
    """Return a stimulus as JSON; a time without an end becomes null."""
    phases = [[p.blue_per_s, p.blue_most, p.bright_s, p.thermal] for p in planned.phases]
    times = [planned.start_s - now_s, planned.over_s - now_s]
    return [planned.box, planned.eye, planned.channel, planned.holder, *times, phases]


def _planned_from_json(entry: list[Any], now_s: float) -> Planned:
    box, eye, channel, holder, start_s, over_s, phases = entry
    known = tuple(Phase(float(a), float(b), _endless_if_none(c), float(d)) for a, b, c, d in phases)
    return Planned(box, eye, channel, holder, now_s + start_s, now_s + _endless_if_none(over_s), known)


def _endless_if_none(time_s: float | None) -> float:
    return math.inf if time_s is None else float(time_s)
