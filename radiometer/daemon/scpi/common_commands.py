"""IEEE 488.2 common commands."""

from __future__ import annotations

from typing import Final

import radiometer
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.language import Call, Command, Number, Outcome, ParameterLimits
from radiometer.daemon.scpi.session import when_done
from radiometer.daemon.station import Station
from radiometer.errors import RadiometerError

GROUP: Final = "Common commands"


def _byte(station: Station) -> ParameterLimits:
    return ParameterLimits(0, 255, 0)


def _identity(call: Call) -> str:
    identity = call.session.station.instrument.identity
    fields = (identity.vendor, identity.model, identity.serial, f"radiometer {radiometer.__version__}")
    return ",".join(field.replace(",", " ").replace(";", " ") or "0" for field in fields)


def _clear(call: Call) -> None:
    call.session.status.clear()
    call.session.abort()


def _reset(call: Call) -> None:
    call.session.reset()


def _complete(call: Call) -> None:
    session = call.session
    if session.pending is None:
        session.status.complete()
    else:
        session.pending.add_done_callback(lambda _: session.status.complete())


def _is_complete(call: Call) -> Outcome:
    if call.session.pending is None:
        return "1"
    return when_done(call.session.wait_pending(), lambda: "1")


def _wait(call: Call) -> Outcome:
    if call.session.pending is None:
        return None
    return when_done(call.session.wait_pending(), lambda: None)


async def _self_test(call: Call) -> str:
    station = call.session.station
    try:
        faults = await station.camera.use(station.instrument.self_test)
    except RadiometerError as error:
        faults = [str(error)]
    faults += [alarm.message for alarm in station.alarms.active]
    for fault in dict.fromkeys(faults):
        call.session.status.push(ScpiError(-240, fault))
    return str(min(len(faults), 255))


def _status_byte(call: Call) -> str:
    call.session.update_status()
    return str(call.session.status.status_byte(message_available=bool(call.session.responses)))


def _set_event_enable(call: Call) -> None:
    call.session.status.event_enable = call.values[0]


def _set_service_enable(call: Call) -> None:
    call.session.status.service_enable = call.values[0] & ~64


COMMANDS: Final = (
    Command("*IDN", "Names vendor, model, serial number of the camera, and the software.", ask=_identity,
            reply="vendor,model,serial,software", example="*IDN?", group=GROUP),
    Command("*RST", "Puts the session and the instrument's settings back to those at start. Readings, journal and"
            " continuous measurement stay.", do=_reset, example="*RST", group=GROUP),
    Command("*CLS", "Clears events and error queue and gives up what is pending.", do=_clear, example="*CLS",
            group=GROUP),
    Command("*OPC", "Sets bit 0 of the event status once nothing is pending; the query waits for that and replies 1.",
            do=_complete, ask=_is_complete, reply="1", example="*OPC?", group=GROUP),
    Command("*WAI", "Waits until nothing is pending.", do=_wait, example="*WAI", group=GROUP),
    Command("*ESR", "Reads the standard event status register and clears it. Bits: 0 *OPC done, 2 to 5 error in a "
            "query, in the device, in execution, in a command; 7 power on.",
            ask=lambda call: str(call.session.status.take_event_status()), reply="0 to 255", example="*ESR?",
            group=GROUP),
    Command("*ESE", "Sets which events (bits of *ESR) set bit 5 of the status byte.", do=_set_event_enable,
            ask=lambda call: str(call.session.status.event_enable), parameters=(Number("mask", "", _byte, "rounded"),),
            reply="0 to 255", example="*ESE 60;*ESE?", group=GROUP),
    Command("*SRE", "Sets which bits of the status byte reach bit 6 (a raw socket has no service request).",
            do=_set_service_enable, ask=lambda call: str(call.session.status.service_enable),
            parameters=(Number("mask", "", _byte, "rounded"),), reply="0 to 255", example="*SRE 36;*SRE?", group=GROUP),
    Command("*STB", "Reads the status byte. Bits: 2 error queued, 3 questionable, 4 reply waiting, 5 standard event, "
            "6 summary by *SRE, 7 operation.", ask=_status_byte, reply="0 to 255", example="*STB?", group=GROUP),
    Command("*TST", "Tests the instrument: 0 is passed, else the number of faults, each queued as an error.",
            ask=_self_test, reply="0 to 255", example="*TST?", group=GROUP),
)  # fmt: skip
