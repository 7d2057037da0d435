"""Settings: SENSe, CALibration, SOURce."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.command import Call, Command, Handler, Outcome
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.measure_commands import PATCH_PARAMETERS, patch_from
from radiometer.daemon.scpi.parameters import Boolean, Choice, Limits, Number
from radiometer.daemon.station import WAVELENGTH_LIMITS_NM, Station

SENSE: Final = "Settings of the camera (shared by all clients)"
CALIBRATION: Final = "Calibration"
SOURCE: Final = "Light source"
_ANY_LIMIT: Final = Choice("limit", ("MINimum", "MAXimum", "DEFault"))


def _exposure(station: Station) -> Limits:
    low, high = station.instrument.limits.exposure_s
    return Limits(low, high, min(max(0.01, low), high))


def _gain(station: Station) -> Limits:
    low, high = station.instrument.limits.gain_db
    return Limits(low, high, min(max(0.0, low), high))


def _wavelength(station: Station) -> Limits:
    return Limits(*WAVELENGTH_LIMITS_NM, 550.0)


def _level(station: Station) -> Limits:
    return Limits(0.0, 1.0, 0.0)


def _asked(limits: Callable[[Station], Limits], now: Callable[[Station], str]) -> Handler:
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
    channels = call.session.station.box.channels if call.session.station.box else ()
    if not channels:
        raise ScpiError(-241, "no light box is configured")
    if not 1 <= call.channel <= len(channels):
        raise ScpiError(-114, f"LED{call.channel}; there are 1 to {len(channels)}")
    return channels[call.channel - 1]


async def _set_level(call: Call) -> None:
    await call.session.station.set_level(_channel(call), call.values[0])


def _ask_level(call: Call) -> str:
    station, channel = call.session.station, _channel(call)
    if not station.light_is_confirmed:
        raise ScpiError(-230, f"the level of {channel} is not confirmed: the light box does not answer")
    return formats.number(station.levels[channel])


async def _lights_off(call: Call) -> None:
    await call.session.station.lights_off()


def _set_output(call: Call) -> Outcome:
    if call.values[0]:
        raise ScpiError(-221, "there is no one level for all: SOURce:LED<n>:LEVel lights a channel")
    return _lights_off(call)


def _ask_output(call: Call) -> str:
    station = call.session.station
    if not station.light_is_confirmed:
        raise ScpiError(-230, "the light box does not answer")
    return str(int(any(station.levels.values())))


def _catalogue(call: Call) -> str:
    channels = call.session.station.box.channels if call.session.station.box else ()
    return ",".join(map(formats.string, channels)) or formats.string("")


COMMANDS: Final = (
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
            ask=_ask_patch,
            parameters=PATCH_PARAMETERS, required=1, reply="x,y,width,height or CENT", example="SENS:PATC CENT;PATC?",
            group=SENSE),
    Command("SENSe:CORRection:WAVelength", "Takes the source for a line of this wavelength (nm unless a suffix says UM"
            " or M); NONE returns to the configured spectrum.", do=_set_wavelength,
            ask=_asked(_wavelength, _ask_wavelength),
            parameters=(Number("wavelength", "NM", _wavelength, also=("NONE",)),), ask_parameters=(_ANY_LIMIT,),
            reply="nm or NONE", example="SENS:CORR:WAV 550;WAV?;WAV NONE", group=SENSE),
    Command("CALibration:SOURce", "Names the calibration in use; empty where there is none.", ask=_summary("source"),
            reply='"name"', example="CAL:SOUR?", group=CALIBRATION),
    Command("CALibration:DATE", "Tells when it was made.", ask=_summary("created"), reply='"ISO 8601"',
            example="CAL:DATE?", group=CALIBRATION),
    Command("CALibration:ASSumptions", "Lists what was assumed rather than measured.", ask=_summary("assumptions"),
            reply='"assumption",…', example="CAL:ASS?", group=CALIBRATION),
    Command("CALibration:STATe", "1 where readings are absolute, 0 where they are relative.",
            ask=lambda call: str(int(bool(call.session.station.instrument.calibration_summary))), reply="0 or 1",
            example="CAL:STAT?", group=CALIBRATION),
    Command("CALibration:RELoad", "Reads the calibration file named at start again, as SIGHUP does.", do=_reload,
            example="CAL:REL", group=CALIBRATION),
    Command("SOURce:LED<n>:LEVel", "Sets the level of a channel of the light box, 0 (off) to 1. The query replies"
            " the level that the box itself told last (twice a second); −230 while it does not answer. A light that the"
            " box ended by itself (energy budget, its button) is 0 and an alarm.",
            do=_set_level, ask=_ask_level, parameters=(Number("level", "PCT", _level),),
            reply="level",
            example="SOUR:LED1:LEV 0.25;LEV?", group=SOURCE),
    Command("SOURce:LED:CATalog", "Names the channels, from 1 on.", ask=_catalogue, reply='"name",…',
            example="SOUR:LED:CAT?", group=SOURCE),
    Command("OUTPut:ALL", "OFF switches every channel off, at once also as the first message of a connection; ON is"
            " refused (−221). The query replies 1 while any channel is lit, as the box itself tells.",
            do=_set_output, ask=_ask_output, parameters=(Boolean(),), reply="0 or 1", example="OUTP:ALL OFF;ALL?",
            group=SOURCE),
    Command("SOURce:LED:OFF", "Switches every channel off.", do=_lights_off, example="SOUR:LED:OFF", group=SOURCE),
)  # fmt: skip
