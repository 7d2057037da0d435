"""The command table: everything that the server understands, and what the manual is made from."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import radiometer
from radiometer.daemon.acquisition import EVERY_LIMITS_S, WAVELENGTH_LIMITS_NM
from radiometer.daemon.journal_reader import JournalReader, ReadingFilter
from radiometer.daemon.patches import DEFAULT_HYSTERESIS_REL, PatchLimits
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.language import (
    Boolean,
    Call,
    Choice,
    Command,
    CommandTable,
    Handler,
    Number,
    Outcome,
    ParameterLimits,
    ScpiError,
    Text,
    always,
    scpi_error,
)
from radiometer.daemon.scpi.session import Session, when_done
from radiometer.daemon.station import Station
from radiometer.data import Frame, Patch, Reading
from radiometer.data.json_text import json_text, parsed_json
from radiometer.errors import RadiometerError

if TYPE_CHECKING:
    from radiometer.daemon.scpi.status import Register


COMMON: Final = "Common commands"


def _byte(station: Station) -> ParameterLimits:
    return ParameterLimits(0, 255, 0)


def _identity(call: Call) -> str:
    identity = call.session.station.instrument.identity
    fields = (identity.vendor, identity.model, identity.serial, f"radiometer {radiometer.__version__}")
    return ",".join(field.replace(",", " ").replace(";", " ") or "0" for field in fields)


def _clear(call: Call) -> None:
    call.session.status.clear()
    call.session.abort()


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


_COMMON_COMMANDS: Final = (
    Command("*IDN", "Names vendor, model, serial number of the camera, and the software.", ask=_identity,
            reply="vendor,model,serial,software", example="*IDN?", group=COMMON),
    Command("*RST", "Puts the session and the instrument's settings back to those at start. Readings, journal and"
            " continuous measurement stay.", do=lambda call: call.session.reset(), example="*RST", group=COMMON),
    Command("*CLS", "Clears events and error queue and gives up what is pending.", do=_clear, example="*CLS",
            group=COMMON),
    Command("*OPC", "Sets bit 0 of the event status once nothing is pending; the query waits for that and replies 1.",
            do=_complete, ask=_is_complete, reply="1", example="*OPC?", group=COMMON),
    Command("*WAI", "Waits until nothing is pending.", do=_wait, example="*WAI", group=COMMON),
    Command("*ESR", "Reads the standard event status register and clears it. Bits: 0 *OPC done, 2 to 5 error in a "
            "query, in the device, in execution, in a command; 7 power on.",
            ask=lambda call: str(call.session.status.take_event_status()), reply="0 to 255", example="*ESR?",
            group=COMMON),
    Command("*ESE", "Sets which events (bits of *ESR) set bit 5 of the status byte.", do=_set_event_enable,
            ask=lambda call: str(call.session.status.event_enable), parameters=(Number("mask", "", _byte, "rounded"),),
            reply="0 to 255", example="*ESE 60;*ESE?", group=COMMON),
    Command("*SRE", "Sets which bits of the status byte reach bit 6 (a raw socket has no service request).",
            do=_set_service_enable, ask=lambda call: str(call.session.status.service_enable),
            parameters=(Number("mask", "", _byte, "rounded"),), reply="0 to 255", example="*SRE 36;*SRE?",
            group=COMMON),
    Command("*STB", "Reads the status byte. Bits: 2 error queued, 3 questionable, 4 reply waiting, 5 standard event, "
            "6 summary by *SRE, 7 operation.", ask=_status_byte, reply="0 to 255", example="*STB?", group=COMMON),
    Command("*TST", "Tests the instrument: 0 is passed, else the number of faults, each queued as an error.",
            ask=_self_test, reply="0 to 255", example="*TST?", group=COMMON),
)  # fmt: skip


MEASURING: Final = "Measuring"
_DEFAULT_PERIOD_S: Final = 1.0  # as of `radiometer serve`
_PERIOD: Final = always(*EVERY_LIMITS_S, _DEFAULT_PERIOD_S)
ELEMENTS: Final = ("READing", "UNCertainty", "EXPanded", "COVerage", "TIME", "SEQuence", "FLAGs")


def _width(station: Station) -> ParameterLimits:
    return ParameterLimits(0, station.instrument.limits.width, 0)


def _height(station: Station) -> ParameterLimits:
    return ParameterLimits(0, station.instrument.limits.height, 0)


PATCH_PARAMETERS: Final = (
    Number("x", "", _width, "refused", also=("CENTer",)),
    Number("y", "", _height, "refused"),
    Number("width", "", _width, "refused"),
    Number("height", "", _height, "refused"),
)


def patch_from(call: Call) -> Patch | None:
    """Return the patch that four values (or none, or CENTer) describe. Raises ScpiError or RadiometerError."""
    if not call.values or call.values == ("CENTer",):
        return None
    if len(call.values) != 4 or "CENTer" in call.values:
        raise ScpiError(-109, "a patch is x,y,width,height, or CENTer")
    patch = Patch(*call.values)
    station = call.session.station
    station.acquisition.check_settings(replace(station.settings, patch=patch))
    return patch


def _configure(function: str) -> Handler:
    def handler(call: Call) -> None:
        own_patch = (patch_from(call),) if call.values else None
        call.session.choose(function, own_patch)

    return handler


def _measure(function: str, elements: tuple[str, ...] | None = None) -> Handler:
    def handler(call: Call) -> Outcome:
        _configure(function)(call)
        return _read(call, elements)

    return handler


def _read(call: Call, elements: tuple[str, ...] | None = None) -> Outcome:
    session = call.session
    session.abort()
    task = session.start()

    async def wait() -> str:
        return _written(session, await session.measured(task), session.function, elements)

    return wait()


def _fetch(function: str | None = None, elements: tuple[str, ...] | None = None) -> Handler:
    return _fetched(lambda s, reading: _written(s, reading, function or s.function, elements))


def _fetched(write: Callable[[Session, Reading], str]) -> Handler:
    def handler(call: Call) -> Outcome:
        session = call.session
        if session.pending is None:
            return write(session, session.fetched())

        async def wait() -> str:
            await session.wait_pending()
            return write(session, session.fetched())

        return wait()

    return handler


def _written(session: Session, reading: Reading, function: str, elements: tuple[str, ...] | None) -> str:
    return formats.reading_elements(reading, function, elements or session.elements)


def _initiate(call: Call) -> None:
    session = call.session

    def report(task: asyncio.Task[Reading]) -> None:
        if not task.cancelled() and isinstance(error := task.exception(), Exception):
            session.status.push(scpi_error(error))

    session.start().add_done_callback(report)
    session.update_status()


def _set_continuous(call: Call) -> None:
    station = call.session.station
    if call.values[0] != (station.acquisition.every_s is not None):
        station.set_every(_DEFAULT_PERIOD_S if call.values[0] else None)


def _abort(call: Call) -> None:
    call.session.abort()
    call.session.update_status()


def _set_elements(call: Call) -> None:
    call.session.elements = tuple(dict.fromkeys(call.values))


def _ask_period(call: Call) -> str:
    every_s = call.session.station.acquisition.every_s
    return formats.number(_DEFAULT_PERIOD_S if every_s is None else every_s)


def _measuring(quantity: str, unit: str) -> tuple[Command, ...]:
    function, uncertainty = quantity, ("UNCertainty",)
    patch_note = "Without a patch (x,y,width,height in pixels, or CENTer) that of SENSe:PATCh is measured."
    return (
        Command(f"MEASure:{quantity}", f"Measures the {quantity.lower()} of a patch in {unit}. Replies value and"
                f" standard uncertainty (k=1), or what FORMat:ELEMents chose. {patch_note}",
                ask=_measure(function), ask_parameters=PATCH_PARAMETERS, reply="value,u",
                example=f"MEAS:{quantity[:3].upper()}?", group=MEASURING),
        Command(f"MEASure:{quantity}:UNCertainty", f"Measures the {quantity.lower()} and replies its standard"
                " uncertainty (k=1) alone.", ask=_measure(function, uncertainty), ask_parameters=PATCH_PARAMETERS,
                reply="u", example=f"MEAS:{quantity[:3].upper()}:UNC?", group=MEASURING),
        Command(f"CONFigure:{quantity}", f"Chooses {quantity.lower()}, and the patch, for READ? and INITiate of this"
                " session.", do=_configure(function), parameters=PATCH_PARAMETERS, required=0,
                example=f"CONF:{quantity[:3].upper()}", group=MEASURING),
        Command(f"FETCh:{quantity}", f"Replies {quantity.lower()} and standard uncertainty of the newest reading of"
                " this session's patch: the one that its MEASure? or CONFigure gave, else that of SENSe:PATCh. In the"
                " first case only readings of this session count. In the second, while nothing measures continuously,"
                " they have precedence over newer ones of other sessions. −230 means that there is none yet, as after"
                " the patch was moved. All queries of one message refer to one reading.",
                ask=_fetch(function), reply="value,u", example=f"READ?;:FETC:{quantity[:3].upper()}?", group=MEASURING),
        Command(f"FETCh:{quantity}:UNCertainty",
                f"Replies the standard uncertainty (k=1) of that {quantity.lower()} alone.",
                ask=_fetch(function, uncertainty), reply="u", example=f"READ?;:FETC:{quantity[:3].upper()}:UNC?",
                group=MEASURING),
    )  # fmt: skip


_MEASURING_COMMANDS: Final = (
    *_measuring("RADiance", "W sr-1 m-2 (relative where uncalibrated)"),
    *_measuring("LUMinance", "cd m-2 (9.91E+37 where no spectrum is known)"),
    Command("CONFigure", "Replies the quantity chosen.",
            ask=lambda call: formats.string(call.session.function[:3].upper()),
            reply='"RAD" or "LUM"', example="CONF?", group=MEASURING),
    Command("READ", "Begins a measurement, waits for it and replies as FETCh? does.", ask=_read, reply="value,u",
            example="READ?", group=MEASURING),
    Command("FETCh", "Replies the newest reading in the quantity chosen, waiting for one that this session began.",
            ask=_fetch(), reply="value,u", example="READ?;:FETC?", group=MEASURING),
    Command("FETCh:UNCertainty", "Replies the standard uncertainty (k=1) of the same reading.",
            ask=_fetch(None, ("UNCertainty",)), reply="u", example="READ?;:FETC:UNC?", group=MEASURING),
    Command("FETCh:FLAGs", "Replies the flags of the same reading, separated by blanks.",
            ask=_fetch(None, ("FLAGs",)), reply='"flags"', example="READ?;:FETC:FLAG?", group=MEASURING),
    Command("FETCh:TIME", "Replies the time of the same reading in UTC.", ask=_fetch(None, ("TIME",)),
            reply='"ISO 8601"', example="READ?;:FETC:TIME?", group=MEASURING),
    Command("FETCh:SEQuence", "Replies the running number of the same reading in the journal.",
            ask=_fetch(None, ("SEQuence",)), reply="integer", example="READ?;:FETC:SEQ?", group=MEASURING),
    Command("FETCh:JSON", "Replies the whole reading as one line of JSON in a block.",
            ask=_fetched(lambda session, reading: formats.block(reading.to_json().encode())), reply="block",
            example="READ?;:FETC:JSON?", group=MEASURING),
    Command("INITiate[:IMMediate]", "Begins a measurement and does not wait for it; *OPC?, *WAI and FETCh? do.",
            do=_initiate, example="INIT", group=MEASURING),
    Command("INITiate:CONTinuous", "Switches continuous measurement on or off, for all clients.", do=_set_continuous,
            ask=lambda call: str(int(call.session.station.acquisition.every_s is not None)), parameters=(Boolean(),),
            reply="0 or 1", example="INIT:CONT ON;CONT?", group=MEASURING),
    Command("TRIGger:TIMer", "Sets the period of continuous measurement and switches it on; 0 measures as fast as "
    "possible.",
            do=lambda call: call.session.station.set_every(call.values[0]), ask=_ask_period,
            parameters=(Number("period", "S", _PERIOD),), reply="seconds", example="TRIG:TIM 500 MS;TIM?",
            group=MEASURING),
    Command("ABORt", "Aborts a measurement that this session began.", do=_abort, example="ABOR", group=MEASURING),
    Command("FORMat:ELEMents",
            "Chooses what MEASure?, READ? and FETCh? reply, in the order given. READing is the value, UNCertainty its"
            " standard uncertainty (k=1), EXPanded its expanded uncertainty (95.45 %). COVerage is the factor k"
            " between the two uncertainties. TIME, SEQuence and FLAGs describe the reading.", do=_set_elements,
            ask=lambda call: ",".join(call.session.elements), parameters=(Choice("element", ELEMENTS),) * len(ELEMENTS),
            required=1, reply="elements", example="FORM:ELEM READ,UNC,EXP,COV,TIME,SEQ,FLAG;ELEM?", group=MEASURING),
)  # fmt: skip


SENSE: Final = "Settings of the camera (shared by all clients)"
CALIBRATION: Final = "Calibration"
SOURCE: Final = "Light source"
_ANY_LIMIT: Final = Choice("limit", ("MINimum", "MAXimum", "DEFault"))
_WAVELENGTH: Final = always(*WAVELENGTH_LIMITS_NM, 550.0)
_LEVEL: Final = always(0.0, 1.0, 0.0)
_BOUND: Final = always(-1e30, 1e30, 0.0)
_HYSTERESIS: Final = always(0.0, 0.5, DEFAULT_HYSTERESIS_REL)


def _exposure(station: Station) -> ParameterLimits:
    low, high = station.instrument.limits.exposure_s
    return ParameterLimits(low, high, min(max(0.01, low), high))


def _gain(station: Station) -> ParameterLimits:
    low, high = station.instrument.limits.gain_db
    return ParameterLimits(low, high, min(max(0.0, low), high))


def _asked(limits: Callable[[Station], ParameterLimits], now: Callable[[Station], str]) -> Handler:
    """Return a query handler: the value in force, or the limit that was asked for."""

    def handler(call: Call) -> str:
        if not call.values:
            return now(call.session.station)
        bounds = limits(call.session.station)
        return formats.number(
            {"MINimum": bounds.low, "MAXimum": bounds.high, "DEFault": bounds.default}[call.values[0]]
        )

    return handler


def _set(**fixed: Any) -> Callable[[str], Handler]:
    """Return a maker of command handlers that set one field, and fixed others with it."""

    def of_field(name: str) -> Handler:
        def handler(call: Call) -> None:
            call.session.station.configure(**{name: call.values[0]}, **fixed)

        return handler

    return of_field


def _set_wavelength(call: Call) -> None:
    value = call.values[0]
    call.session.station.configure(wavelength_nm=None if value == "NONE" else value)


def _ask_wavelength(station: Station) -> str:
    wavelength_nm = station.settings.wavelength_nm
    return "NONE" if wavelength_nm is None else formats.number(wavelength_nm)


def _set_patch(call: Call) -> None:
    call.session.station.configure(patch=patch_from(call))


def _ask_patch(call: Call) -> str:
    patch = call.session.station.settings.patch
    return "CENT" if patch is None else formats.words((patch.x, patch.y, patch.width, patch.height))


async def _reload(call: Call) -> None:
    await call.session.station.reload_calibration()


def _summary(key: str) -> Handler:
    def handler(call: Call) -> str:
        value = call.session.station.instrument.calibration_summary.get(key)
        if isinstance(value, list | tuple):
            return ",".join(formats.string(str(entry)) for entry in value) or formats.string("")
        return formats.string("" if value is None else str(value))

    return handler


def _channel(call: Call) -> str:
    channels = call.session.station.light.box.channels if call.session.station.light.box else ()
    if not channels:
        raise ScpiError(-241, "no light box is configured")
    if not 1 <= call.channel <= len(channels):
        raise ScpiError(-114, f"LED{call.channel}; there are 1 to {len(channels)}")
    return channels[call.channel - 1]


async def _set_level(call: Call) -> None:
    light, channel = call.session.station.light, _channel(call)
    level = light.limit(channel) if call.values[0] == "MAXimum" else call.values[0]
    await light.set_level(channel, level, call.session.asker)


def _ask_level(call: Call) -> str:
    station, channel = call.session.station, _channel(call)
    if call.values:
        return formats.number(station.light.limit(channel) if call.values[0] == "MAXimum" else 0.0)
    if not station.light.is_confirmed:
        raise ScpiError(-230, f"the level of {channel} is not confirmed: the light box does not answer")
    return formats.number(station.light.levels[channel])


async def _lights_off(call: Call) -> None:
    await call.session.station.light.off(call.session.asker)


def _set_output(call: Call) -> Outcome:
    if call.values[0]:
        raise ScpiError(-221, "there is no one level for all: SOURce:LED<n>:LEVel lights a channel")
    return _lights_off(call)


def _ask_output(call: Call) -> str:
    station = call.session.station
    if not station.light.is_confirmed:
        raise ScpiError(-230, "the light box does not answer")
    return str(int(any(station.light.levels.values())))


def _define_patch(call: Call) -> None:
    name, *place = call.values
    if "CENTer" in place:
        raise ScpiError(-224, "a patch with a name is x,y,width,height")
    call.session.station.patches.define(name, Patch(*place))


def _set_limits(call: Call) -> None:
    low, high = (None if value == "NONE" else value for value in call.values[1:3])
    hysteresis = call.values[3] if len(call.values) > 3 else DEFAULT_HYSTERESIS_REL
    call.session.station.patches.set_limits(call.values[0], PatchLimits(low, high, hysteresis))


def _ask_limits(call: Call) -> str:
    entry = call.session.station.status()["patches"].get(call.values[0])
    if entry is None:
        raise ScpiError(-224, f"there is no patch {call.values[0][:40]}")
    limits = entry["limits"]
    bounds = ["NONE" if limits[side] is None else formats.number(limits[side]) for side in ("low", "high")]
    return ",".join([*bounds, formats.number(limits["hysteresis_rel"])])


def _fetch_patch(call: Call) -> str:
    reading = call.session.station.patches.latest_of(call.values[0])
    if reading is None:
        raise ScpiError(-230, f"there is no reading of patch {call.values[0][:40]} yet")
    return formats.reading_elements(reading, call.session.function, call.session.elements)


def _catalogue(call: Call) -> str:
    channels = call.session.station.light.box.channels if call.session.station.light.box else ()
    return ",".join(map(formats.string, channels)) or formats.string("")


_SETTINGS_COMMANDS: Final = (
    Command("SENSe:EXPosure[:TIME]", "Sets the exposure time and switches automatic exposure off.",
            do=_set(auto_exposure=False)("exposure_s"),
            ask=_asked(_exposure, lambda station: formats.number(station.settings.exposure_s)),
            parameters=(Number("exposure", "S", _exposure),), ask_parameters=(_ANY_LIMIT,), reply="seconds",
            example="SENS:EXP 4 MS;EXP?", group=SENSE),
    Command("SENSe:EXPosure:AUTO", "Lets exposures follow the scene.", do=_set()("auto_exposure"),
            ask=lambda call: str(int(call.session.station.settings.auto_exposure)), parameters=(Boolean(),),
            reply="0 or 1", example="SENS:EXP:AUTO ON;AUTO?", group=SENSE),
    Command("SENSe:GAIN", "Sets the analogue gain.", do=_set()("gain_db"),
            ask=_asked(_gain, lambda station: formats.number(station.settings.gain_db)),
            parameters=(Number("gain", "DB", _gain),), ask_parameters=(_ANY_LIMIT,), reply="dB",
            example="SENS:GAIN MIN;GAIN?", group=SENSE),
    Command("SENSe:PATCh", "Sets the patch that is measured continuously and by default.", do=_set_patch,
            ask=_ask_patch, parameters=PATCH_PARAMETERS, required=1, reply="x,y,width,height or CENT",
            example="SENS:PATC CENT;PATC?", group=SENSE),
    Command("SENSe:PATCh:DEFine", "Defines a patch with a name, or moves it. During continuous measurement it is"
            " measured in every period, in addition to the shared patch. There are at most 12; a restart keeps them.",
            do=_define_patch, parameters=(Text("name"), *PATCH_PARAMETERS), example='SENS:PATC:DEF "lamp",1,2,3,4;CAT?',
            group=SENSE),
    Command("SENSe:PATCh:DELete", "Stops measuring a patch with a name; its readings stay.",
            do=lambda call: call.session.station.patches.delete(call.values[0]), parameters=(Text("name"),),
            example='SENS:PATC:DEF "gone",1,2,3,4;DEL "gone"', group=SENSE),
    Command("SENSe:PATCh:CATalog", 'Names the patches; "main" is the shared one.',
            ask=lambda call: ",".join(map(formats.string, call.session.station.patches.watches)), reply='"name",…',
            example="SENS:PATC:CAT?", group=SENSE),
    Command("SENSe:PATCh:LIMits", "Sets the lowest and highest allowed radiance of a patch; NONE is no bound. Two"
            " readings in a row beyond a limit raise the alarm `limit NAME`. Two in a row inside by the hysteresis end"
            " it. The hysteresis is a fraction of the limit, 0.01 by default.", do=_set_limits, ask=_ask_limits,
            parameters=(Text("name"), Number("low", "", _BOUND, also=("NONE",)),
                        Number("high", "", _BOUND, also=("NONE",)), Number("hysteresis", "PCT", _HYSTERESIS)),
            required=3, ask_parameters=(Text("name"),), ask_required=1, reply="low,high,hysteresis",
            example='TRIG:TIM 1;:SENS:PATC:LIM "main",NONE,1e6;LIM? "main"', group=SENSE),
    Command("FETCh:PATCh", "Replies the newest reading of a patch with a name; −230 where there is none yet.",
            ask=_fetch_patch, ask_parameters=(Text("name"),), ask_required=1, reply="value,u",
            example='READ?;:FETC:PATC? "main"', group=MEASURING),
    Command("SENSe:CORRection:WAVelength",
            "Treats the source as a line of this wavelength, in nm unless a suffix states UM or M. NONE returns to the"
            " configured spectrum.", do=_set_wavelength, ask=_asked(_WAVELENGTH, _ask_wavelength),
            parameters=(Number("wavelength", "NM", _WAVELENGTH, also=("NONE",)),), ask_parameters=(_ANY_LIMIT,),
            reply="nm or NONE", example="SENS:CORR:WAV 550;WAV?;WAV NONE", group=SENSE),
    Command("CALibration:SOURce", "Names the calibration in use; empty where there is none.", ask=_summary("source"),
            reply='"name"', example="CAL:SOUR?", group=CALIBRATION),
    Command("CALibration:DATE", "Replies when the calibration was made.", ask=_summary("created"), reply='"ISO 8601"',
            example="CAL:DATE?", group=CALIBRATION),
    Command("CALibration:ASSumptions", "Lists what was assumed rather than measured.", ask=_summary("assumptions"),
            reply='"assumption",…', example="CAL:ASS?", group=CALIBRATION),
    Command("CALibration:STATe", "1 where readings are absolute, 0 where they are relative.",
            ask=lambda call: str(int(bool(call.session.station.instrument.calibration_summary))), reply="0 or 1",
            example="CAL:STAT?", group=CALIBRATION),
    Command("CALibration:RELoad", "Reads the calibration file named at start again, as SIGHUP does.", do=_reload,
            example="CAL:REL", group=CALIBRATION),
    Command("SOURce:LED<n>:LEVel", "Sets the level of a channel of the light box, 0 (off) to 1. MAX is the highest"
            " level that the box allows now. The query replies the level that the box last reported; it reports twice a"
            " second. −230 means that the box does not answer. If the box ended the light itself (energy budget, its"
            " button), the level is 0 and an alarm is raised.",
            do=_set_level, ask=_ask_level, parameters=(Number("level", "PCT", _LEVEL, also=("MAXimum",)),),
            ask_parameters=(_ANY_LIMIT,), reply="level", example="SOUR:LED1:LEV 0.25;LEV?", group=SOURCE),
    Command("SOURce:LED:CATalog", "Names the channels of the light box in the order of <n>, from 1 on.", ask=_catalogue,
            reply='"name",…', example="SOUR:LED:CAT?", group=SOURCE),
    Command("OUTPut:ALL", "OFF switches every channel off before all that other clients wait for. What its own"
            " connection sent before it comes first. ON is refused (−221). The query replies 1 while the box reports"
            " any channel lit.",
            do=_set_output, ask=_ask_output, parameters=(Boolean(),), reply="0 or 1", example="OUTP:ALL OFF;ALL?",
            group=SOURCE),
    Command("SOURce:LED:OFF", "Switches every channel off.", do=_lights_off, example="SOUR:LED:OFF", group=SOURCE),
)  # fmt: skip


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
                do=_set_enable(name), ask=lambda call: str(_register(call, name).enable),
                parameters=(Number("mask", "", _WORD16, "rounded"),), reply="0 to 65535",
                example=f"STAT:{short}:ENAB 65535;ENAB?", group=STATUS),
    )  # fmt: skip


_SYSTEM_COMMANDS: Final = (
    *_registers("OPERation"),
    *_registers("QUEStionable"),
    Command("STATus:PRESet", "Clears the masks (enable registers) of operation and questionable status.",
            do=lambda call: call.session.status.preset(), example="STAT:PRES", group=STATUS),
    Command("SYSTem:ERRor[:NEXT]", "Removes the oldest entry from the session's error queue (32 entries) and "
    "replies it."
            " A lost camera, a lost light box and a journal that cannot be written are entered when they happen.",
            ask=lambda call: call.session.status.next_error(), reply='number,"text"', example="SYST:ERR?",
            group=SYSTEM),
    Command("SYSTem:ERRor:ALL", "Removes all entries and replies them.", ask=_all_errors, reply='number,"text",…',
            example="SYST:ERR:ALL?", group=SYSTEM),
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
    Command("SYSTem:HELP:HEADers", "Lists every header in a block, one per line.",
            ask=lambda call: call.session.table.headers, reply="block", example="SYST:HELP:HEAD?", group=SYSTEM),
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


def command_table() -> CommandTable:
    """Return the table of all commands."""
    return CommandTable((*_COMMON_COMMANDS, *_MEASURING_COMMANDS, *_SETTINGS_COMMANDS, *_SYSTEM_COMMANDS))
