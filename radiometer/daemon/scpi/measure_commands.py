"""Measuring: MEASure, CONFigure, READ, FETCh, INITiate, ABORt, TRIGger, FORMat:ELEMents."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from radiometer.daemon.acquisition import EVERY_LIMITS_S
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.errors import ScpiError, scpi_error
from radiometer.daemon.scpi.language import (
    Boolean,
    Call,
    Choice,
    Command,
    Handler,
    Number,
    Outcome,
    ParameterLimits,
    always,
)
from radiometer.daemon.scpi.session import Session
from radiometer.daemon.station import Station
from radiometer.data import Patch, Reading

GROUP: Final = "Measuring"
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
                example=f"MEAS:{quantity[:3].upper()}?", group=GROUP),
        Command(f"MEASure:{quantity}:UNCertainty", f"Measures the {quantity.lower()} and replies its standard"
                " uncertainty (k=1) alone.", ask=_measure(function, uncertainty), ask_parameters=PATCH_PARAMETERS,
                reply="u", example=f"MEAS:{quantity[:3].upper()}:UNC?", group=GROUP),
        Command(f"CONFigure:{quantity}", f"Chooses {quantity.lower()}, and the patch, for READ? and INITiate of this"
                " session.", do=_configure(function), parameters=PATCH_PARAMETERS, required=0,
                example=f"CONF:{quantity[:3].upper()}", group=GROUP),
        Command(f"FETCh:{quantity}", f"Replies {quantity.lower()} and standard uncertainty of the newest reading of"
                " this session's patch: the one that its MEASure? or CONFigure gave, else that of SENSe:PATCh. In the"
                " first case only readings of this session count. In the second, while nothing measures continuously,"
                " they have precedence over newer ones of other sessions. −230 means that there is none yet, as after"
                " the patch was moved. All queries of one message refer to one reading.",
                ask=_fetch(function), reply="value,u", example=f"READ?;:FETC:{quantity[:3].upper()}?", group=GROUP),
        Command(f"FETCh:{quantity}:UNCertainty",
                f"Replies the standard uncertainty (k=1) of that {quantity.lower()} alone.",
                ask=_fetch(function, uncertainty), reply="u", example=f"READ?;:FETC:{quantity[:3].upper()}:UNC?",
                group=GROUP),
    )  # fmt: skip


COMMANDS: Final = (
    *_measuring("RADiance", "W sr-1 m-2 (relative where uncalibrated)"),
    *_measuring("LUMinance", "cd m-2 (9.91E+37 where no spectrum is known)"),
    Command("CONFigure", "Replies the quantity chosen.",
            ask=lambda call: formats.string(call.session.function[:3].upper()),
            reply='"RAD" or "LUM"', example="CONF?", group=GROUP),
    Command("READ", "Begins a measurement, waits for it and replies as FETCh? does.", ask=_read, reply="value,u",
            example="READ?", group=GROUP),
    Command("FETCh", "Replies the newest reading in the quantity chosen, waiting for one that this session began.",
            ask=_fetch(), reply="value,u", example="READ?;:FETC?", group=GROUP),
    Command("FETCh:UNCertainty", "Replies the standard uncertainty (k=1) of the same reading.",
            ask=_fetch(None, ("UNCertainty",)), reply="u", example="READ?;:FETC:UNC?", group=GROUP),
    Command("FETCh:FLAGs", "Replies the flags of the same reading, separated by blanks.",
            ask=_fetch(None, ("FLAGs",)), reply='"flags"', example="READ?;:FETC:FLAG?", group=GROUP),
    Command("FETCh:TIME", "Replies the time of the same reading in UTC.",
            ask=_fetch(None, ("TIME",)), reply='"ISO 8601"',
            example="READ?;:FETC:TIME?", group=GROUP),
    Command("FETCh:SEQuence", "Replies the running number of the same reading in the journal.",
            ask=_fetch(None, ("SEQuence",)),
            reply="integer", example="READ?;:FETC:SEQ?", group=GROUP),
    Command("FETCh:JSON", "Replies the whole reading as one line of JSON in a block.",
            ask=_fetched(lambda session, reading: formats.block(reading.to_json().encode())), reply="block",
            example="READ?;:FETC:JSON?", group=GROUP),
    Command("INITiate[:IMMediate]", "Begins a measurement and does not wait for it; *OPC?, *WAI and FETCh? do.",
            do=_initiate, example="INIT", group=GROUP),
    Command("INITiate:CONTinuous", "Switches continuous measurement on or off, for all clients.", do=_set_continuous,
            ask=lambda call: str(int(call.session.station.acquisition.every_s is not None)), parameters=(Boolean(),),
            reply="0 or 1", example="INIT:CONT ON;CONT?", group=GROUP),
    Command("TRIGger:TIMer", "Sets the period of continuous measurement and switches it on; 0 measures as fast as "
    "possible.",
            do=lambda call: call.session.station.set_every(call.values[0]), ask=_ask_period,
            parameters=(Number("period", "S", _PERIOD),), reply="seconds", example="TRIG:TIM 500 MS;TIM?", group=GROUP),
    Command("ABORt", "Aborts a measurement that this session began.", do=_abort, example="ABOR", group=GROUP),
    Command("FORMat:ELEMents",
            "Chooses what MEASure?, READ? and FETCh? reply, in the order given. READing is the value, UNCertainty its"
            " standard uncertainty (k=1), EXPanded its expanded uncertainty (95.45 %). COVerage is the factor k between"
            " the two uncertainties. TIME, SEQuence and FLAGs describe the reading.",
            do=_set_elements, ask=lambda call: ",".join(call.session.elements),
            parameters=(Choice("element", ELEMENTS),) * len(ELEMENTS), required=1,
            reply="elements", example="FORM:ELEM READ,UNC,EXP,COV,TIME,SEQ,FLAG;ELEM?", group=GROUP),
)  # fmt: skip
