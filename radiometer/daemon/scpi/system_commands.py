"""STATus, SYSTem, TRACe, FORMat:BORDer."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

import numpy as np

from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.language import Call, Choice, Command, Handler, Number, Outcome, always
from radiometer.data import Frame
from radiometer.data.json_text import json_text, parsed_json

if TYPE_CHECKING:
    from radiometer.daemon.scpi.status import Register

STATUS: Final = "Status"
SYSTEM: Final = "System"
TRACE: Final = "Pictures, curves and history"
_NEWEST: Final = 100  # readings where no number is given
_HISTORY: Final = always(1, 10_000, _NEWEST)
_WORD16: Final = always(0, 65535, 0)


def _register(call: Call, name: str) -> Register:
    call.session.update_status()
    return call.session.status.operation if name == "OPERation" else call.session.status.questionable


def _set_enable(name: str) -> Handler:
    def handler(call: Call) -> None:
        _register(call, name).enable = call.values[0]

    return handler


def _all_errors(call: Call) -> str:
    status = call.session.status
    return ",".join(status.next_error() for _ in range(max(1, status.error_count)))


def _alarms(call: Call) -> str:
    alarms = call.session.station.alarms.active
    return ",".join(formats.string(f"{alarm.name}: {alarm.message}") for alarm in alarms) or formats.string("")


def _devices(call: Call) -> str:
    devices = call.session.station.status()["devices"]
    return ",".join(formats.string(f"{name}: {entry['state']}") for name, entry in devices.items())


def _state(call: Call) -> str:
    return formats.block(json_text(call.session.station.status()).encode())


def _headers(call: Call) -> str:
    return call.session.table.headers


def _frame(call: Call) -> Frame:
    measurement = call.session.measurement()
    frame = measurement.frame if measurement else None
    if frame is None:
        raise ScpiError(-230, "there is no picture of this reading; READ? makes one")
    return frame


def _trace(call: Call) -> Outcome:
    match call.values[0]:
        case "IMAGe":
            order = ">u2" if call.session.big_endian else "<u2"
            return formats.block(_frame(call).dn.astype(order).tobytes())
        case "RESPonse":
            curve = call.session.station.instrument.response
            if curve is None:
                raise ScpiError(-230, "no response curve is in use; digital numbers are taken as linear")
            return formats.block(_floats(call, np.stack([curve.log_exposure, curve.u_log_exposure], axis=1)))
        case _:
            count = call.values[1] if len(call.values) > 1 else _NEWEST
            return _trace_history(call, int(count))


async def _trace_history(call: Call, count: int) -> str:
    reader = JournalReader(call.session.station.journal_path, deadline_s=5.0)
    lines = await asyncio.to_thread(reader.lines, ReadingFilter(limit=count, newest_first=True, stream=""))
    rows = [parsed_json(line) for line in reversed(lines)]
    table = [[row["sequence"], row["radiance"]["value"], row["radiance"]["u"]] for row in rows]
    return formats.block(_floats(call, np.array(table, dtype=float).reshape(-1, 3)))


def _floats(call: Call, table: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bytes:
    return bytes(table.astype(">f8" if call.session.big_endian else "<f8").tobytes())


def _size(call: Call) -> str:
    frame = _frame(call)
    return formats.words((frame.shape[1], frame.shape[0], frame.bit_depth))


def _set_order(call: Call) -> None:
    call.session.big_endian = call.values[0] == "NORMal"


def _registers(name: str) -> tuple[Command, ...]:
    bit_list = "its bits are listed below"
    short = name[:4].upper()
    summary = 7 if name == "OPERation" else 3
    return (
        Command(f"STATus:{name}[:EVENt]", f"Reads the {name.lower()} event register and clears it; {bit_list}.",
                ask=lambda call: str(_register(call, name).take_event()), reply="0 to 32767", example=f"STAT:{short}?",
                group=STATUS),
        Command(f"STATus:{name}:CONDition", f"Reads the {name.lower()} condition register.",
                ask=lambda call: str(_register(call, name).condition), reply="0 to 32767",
                example=f"STAT:{short}:COND?", group=STATUS),
        Command(f"STATus:{name}:ENABle",
                f"Sets the mask of event bits (sum of their weights) that set bit {summary} of the status byte.",
                do=_set_enable(name),
                ask=lambda call: str(_register(call, name).enable),
                parameters=(Number("mask", "", _WORD16, "rounded"),),
                reply="0 to 65535", example=f"STAT:{short}:ENAB 65535;ENAB?", group=STATUS),
    )  # fmt: skip


COMMANDS: Final = (
    *_registers("OPERation"),
    *_registers("QUEStionable"),
    Command("STATus:PRESet",
            "Clears the masks (enable registers) of operation and questionable status.",
            do=lambda call: call.session.status.preset(),
            example="STAT:PRES", group=STATUS),
    Command("SYSTem:ERRor[:NEXT]", "Removes the oldest entry from the session's error queue (32 entries) and "
    "replies it."
            " A lost camera, a lost light box and a journal that cannot be written are entered when they happen.",
            ask=lambda call: call.session.status.next_error(), reply='number,"text"', example="SYST:ERR?",
            group=SYSTEM),
    Command("SYSTem:ERRor:ALL", "Removes all entries and replies "
    "them.", ask=_all_errors, reply='number,"text",…', example="SYST:ERR:ALL?",
            group=SYSTEM),
    Command("SYSTem:ERRor:COUNt", "Counts the entries.", ask=lambda call: str(call.session.status.error_count),
            reply="integer", example="SYST:ERR:COUN?", group=SYSTEM),
    Command("SYSTem:VERSion", "Replies the version of SCPI.", ask=lambda call: "1999.0", reply="1999.0",
            example="SYST:VERS?", group=SYSTEM),
    Command("SYSTem:ALARm", "Lists the active alarms.", ask=_alarms, reply='"alarm",…', example="SYST:ALAR?",
            group=SYSTEM),
    Command("SYSTem:DEVice",
            "Lists the devices, each ready, overdue (late), failing (its last measurement failed), lost or closed.",
            ask=_devices, reply='"device: state",…', example="SYST:DEV?", group=SYSTEM),
    Command("SYSTem:STATe", "Replies the state of everything as JSON in a block, as GET /status does.", ask=_state,
            reply="block", example="SYST:STAT?", group=SYSTEM),
    Command("SYSTem:HELP:HEADers", "Lists every header in a block, one per line.", ask=_headers, reply="block",
            example="SYST:HELP:HEAD?", group=SYSTEM),
    Command("TRACe[:DATA]", "Replies a block of binary numbers. IMAGe is the latest frame: 16-bit digital numbers, row"
            " by row. RESPonse is the response curve: pairs ln H, u of 64-bit floats, one per digital number."
            " HISTory[,count] holds the newest readings of the shared patch, oldest first: triples sequence, radiance,"
            " u of 64-bit floats.", ask=_trace,
            ask_parameters=(
                Choice("trace", ("IMAGe", "RESPonse", "HISTory")), Number("count", "", _HISTORY, "refused"),
            ),
            ask_required=1, reply="block", example="READ?;:TRAC:DATA? HIST,10", group=TRACE),
    Command("TRACe:SIZE", "Replies width, height and bit depth of IMAGe.", ask=_size, reply="width,height,bits",
            example="READ?;:TRAC:SIZE?", group=TRACE),
    Command("FORMat:BORDer", "Sets the byte order in blocks: NORMal is most significant byte first.", do=_set_order,
            ask=lambda call: "NORM" if call.session.big_endian else "SWAP",
            parameters=(Choice("order", ("NORMal", "SWAPped")),),
            reply="NORM or SWAP", example="FORM:BORD SWAP;BORD?", group=TRACE),
)  # fmt: skip
