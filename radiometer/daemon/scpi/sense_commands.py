"""Settings: SENSe, CALibration, SOURce."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from radiometer.daemon.acquisition import WAVELENGTH_LIMITS_NM
from radiometer.daemon.patches import DEFAULT_HYSTERESIS_REL, PatchLimits
from radiometer.daemon.scpi import formats
from radiometer.daemon.scpi.errors import ScpiError
from radiometer.daemon.scpi.language import (
    Boolean,
    Call,
    Choice,
    Command,
    Handler,
    Number,
    Outcome,
    ParameterLimits,
    Text,
    always,
)
from radiometer.daemon.scpi.measure_commands import GROUP as MEASURING
from radiometer.daemon.scpi.measure_commands import PATCH_PARAMETERS, patch_from
from radiometer.daemon.station import Station
from radiometer.data import Patch

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


def _patch_names(call: Call) -> str:
    return ",".join(formats.string(name) for name in call.session.station.patches.watches)


def _catalogue(call: Call) -> str:
    channels = call.session.station.light.box.channels if call.session.station.light.box else ()
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
    Command("SENSe:PATCh:DEFine", "Defines a patch with a name, or moves it. During continuous measurement it is"
            " measured in every period, in addition to the shared patch. There are at most 12; a restart keeps them.",
            do=_define_patch, parameters=(Text("name"), *PATCH_PARAMETERS), example='SENS:PATC:DEF "lamp",1,2,3,4;CAT?',
            group=SENSE),
    Command("SENSe:PATCh:DELete", "Stops measuring a patch with a name; its readings stay.",
            do=lambda call: call.session.station.patches.delete(call.values[0]), parameters=(Text("name"),),
            example='SENS:PATC:DEF "gone",1,2,3,4;DEL "gone"', group=SENSE),
    Command("SENSe:PATCh:CATalog", 'Names the patches; "main" is the shared one.', ask=_patch_names, reply='"name",…',
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
    Command("SENSe:CORRection:WAVelength", "Treats the source as a line of this wavelength, in nm unless a suffix "
    "states UM"
            " or M. NONE returns to the configured spectrum.", do=_set_wavelength,
            ask=_asked(_WAVELENGTH, _ask_wavelength),
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
    Command("SOURce:LED:CATalog", "Names the channels of the light box in the order of <n>, from 1 on.",
            ask=_catalogue, reply='"name",…',
            example="SOUR:LED:CAT?", group=SOURCE),
    Command("OUTPut:ALL", "OFF switches every channel off before all that other clients wait for. What its own"
            " connection sent before it comes first. ON is refused (−221). The query replies 1 while the box reports"
            " any channel lit.",
            do=_set_output, ask=_ask_output, parameters=(Boolean(),), reply="0 or 1", example="OUTP:ALL OFF;ALL?",
            group=SOURCE),
    Command("SOURce:LED:OFF", "Switches every channel off.", do=_lights_off, example="SOUR:LED:OFF", group=SOURCE),
)  # fmt: skip
