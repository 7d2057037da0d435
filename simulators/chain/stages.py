"""The order of effects in a chain: where in it an effect acts, and where a law may act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from radiometer.errors import ConfigurationError
from simulators.effects.base import RADIANCE, Effect


def place_for(
    effect: Effect | type[Effect], chain: Sequence[Effect | type[Effect]], enabled: Sequence[bool] | None = None
) -> int:
    """Return the position in a chain at which an effect acts: in front of `effect.before`, else late in its stage.

    Args:
        chain: The effects in order, or their kinds.
        enabled: Which of them are switched on; all by default.

    Raises:
        ConfigurationError: If its unit fits nowhere in its stage.
    """
    return _place(_kind(effect), tuple(map(_kind, chain)), None if enabled is None else tuple(enabled))


def _kind(effect: Effect | type[Effect]) -> type[Effect]:
    return effect if isinstance(effect, type) else type(effect)


@lru_cache(maxsize=4096)
def _place(effect: type[Effect], chain: tuple[type[Effect], ...], enabled: tuple[bool, ...] | None) -> int:
    unit, fits = RADIANCE, list[int]()
    for position in range(len(chain) + 1):
        following = chain[position] if position < len(chain) else None
        in_stage = (position == 0 or chain[position - 1].stage <= effect.stage) and (
            following is None or following.stage >= effect.stage
        )
        if in_stage and unit == effect.unit_in == effect.unit_out:
            if following is not None and _is_in_front(effect, following):
                return position
            fits.append(position)
        if following is not None and (enabled is None or enabled[position]):
            unit = following.unit_out
    if not fits:
        raise ConfigurationError(
            f"camera model: effect {effect.name!r} fits nowhere in the {effect.stage.name.lower()} stage: "
            f"no signal in {effect.unit_in} passes there"
        )
    return fits[-1]


def _is_in_front(effect: type[Effect], following: type[Effect]) -> bool:
    """Tell whether an effect belongs right in front of another one."""
    if following.name == effect.before:
        return True
    return effect.before is not None and following.before == effect.before and in_order(effect) < in_order(following)


def in_order(effect: Effect | type[Effect]) -> tuple[int, bool]:
    """Return by what effects at one place are sorted; those that are alike stay as they were added."""
    return int(effect.stage), effect.last_in_place


@dataclass(frozen=True, slots=True)
class Link:
    """A way to act."""

    key: str  # its name
    stage: str  # what people call the stage
    member: str  # member of `Stage`
    unit_signal: str  # name of the unit's constant in `simulators.effects.base`
    before: str  # link of the chain that it must precede; empty where it does not matter
    unit: str  # unit of the amplitude
    code: str  # the signal with the law, `{law}` being the amplitude times the formula
    action: str  # what it does, as the head of a sentence
    covariates: tuple[str, ...]  # covariates that it may depend on by itself
    like: str  # what kind of cause acts so
    goes_with: tuple[str, ...] = ()  # covariates that it depends on by its kind, whatever its law
    is_noise: bool = False  # whether the law is the standard deviation of a noise, `code` being that noise at 1 sigma

    @property
    def adds(self) -> bool:
        """Tell whether what it adds does not depend on the signal."""
        return self.code.startswith("signal +")

    @property
    def change(self) -> str:
        """Return what a law changes of the signal, `{law}` standing for the amplitude times the formula."""
        if self.adds:
            return self.code.removeprefix("signal + ")
        return self.code.replace("(1.0 + ", "").removesuffix(")")


_FACTOR: Final = "signal * (1.0 + {law})"
_PLACE: Final = ("image_x", "image_y")
LINKS: Final = {
    link.key: link
    for link in (
        Link("source", "source", "SOURCE", "RADIANCE", "", "1", _FACTOR, "scales the light of the source",
             ("source_level", "timestamp_s", "temperature_C", "since_frame_s", "frame"), "a lamp or its supply"),
        Link("scene", "scene", "SCENE", "RADIANCE", "", "1", _FACTOR, "scales the light of the scene",
             ("picture_mean",), "a screen whose light depends on how it is driven"),
        Link("optics", "optics", "OPTICS", "IRRADIANCE", "", "1", _FACTOR, "scales the light on the sensor",
             (*_PLACE, "f_number"), "dust, a coating or a window in front of the sensor"),
        Link("light", "optics", "OPTICS", "IRRADIANCE", "", "W m-2", "signal + {law}",
             "adds light while the shutter is open", (*_PLACE, "timestamp_s"), "light that leaks in"),
        Link("lens_light", "optics", "OPTICS", "IRRADIANCE", "", "W m-2",
             "signal + {law} * np.square(4.0 / np.asarray(context.settings.f_number))",
             "adds light that comes through the lens", (*_PLACE, "timestamp_s"),
             "a lit room or daylight on the scene", ("f_number",)),
        Link("shutter", "shutter", "SHUTTER", "EXPOSURE", "", "s",
             "signal * (1.0 + {law} / context.settings.exposure_s)", "lets light in for longer", _PLACE,
             "a shutter that opens unevenly", ("exposure_s",)),
        Link("exposure", "shutter", "SHUTTER", "EXPOSURE", "", "1", _FACTOR, "scales the exposure",
             ("exposure_s",), "a shutter, or a sensor that does not add up light in proportion to time"),
        Link("charge_rate", "charge", "ELECTRONS", "ELECTRONS", "shot_noise", "e- s-1",
             "signal + {law} * context.settings.exposure_s", "adds charge in proportion to exposure",
             (*_PLACE, "temperature_C"), "the glow of an amplifier or heat next to the sensor", ("exposure_s",)),
        Link("charge", "charge", "ELECTRONS", "ELECTRONS", "shot_noise", "e-", "signal + {law}", "adds charge",
             ("exposure_s",), "traps that fill or empty"),
        Link("transfer", "charge", "ELECTRONS", "ELECTRONS", "shot_noise", "s", "signal + {law}",
             "adds charge for as long as a frame is shifted out, whatever the exposure", ("column_light",),
             "light that falls on charge on its way"),
        Link("well", "well", "WELL", "ELECTRONS", "", "1", _FACTOR, "scales the charge that a pixel holds",
             ("signal",), "a pixel or its follower that bends"),
        Link("node", "readout", "READOUT", "ELECTRONS", "read_noise", "1", _FACTOR,
             "scales the voltage that charge makes, before the readout adds its noise",
             (*_PLACE, "temperature_C", "timestamp_s"), "a second output of another sensitivity"),
        Link("gain", "readout", "READOUT", "DIGITAL_NUMBER", "black_level", "1", _FACTOR,
             "scales what the amplifier gives", (*_PLACE, "temperature_C", "timestamp_s", "gain_db"),
             "a second amplifier or a reference that steps"),
        Link("analog", "readout", "READOUT", "DIGITAL_NUMBER", "black_level", "DN",
             "signal + {law} * 10.0 ** (np.asarray(context.settings.gain_db) / 20.0)",
             "adds a voltage that the gain amplifies", (*_PLACE, "temperature_C"),
             "an offset in front of the amplifier"),
        Link("digital", "digital", "READOUT", "DIGITAL_NUMBER", "", "DN", "signal + {law}",
             "shifts the black level, whatever the gain",
             (*_PLACE, "exposure_s", "gain_db", "timestamp_s", "temperature_C", "since_frame_s", "frame"),
             "a clamp or a sequencer"),
        Link("range", "digital", "READOUT", "DIGITAL_NUMBER", "black_level", "DN", "signal + {law}",
             "shifts the amplified signal", ("value",), "a converter of several ranges"),
        Link("tremble", "readout", "READOUT", "DIGITAL_NUMBER", "black_level", "1", "signal * {law}",
             "lets the amplification of each pixel tremble from frame to frame", ("gain_db", "temperature_C"),
             "a reference voltage with separate noise", ("signal",), is_noise=True),
        Link("hiss", "readout", "READOUT", "DIGITAL_NUMBER", "black_level", "DN", "{law}", "adds noise",
             (*_PLACE, "exposure_s", "gain_db", "temperature_C"), "an amplifier or converter that is noisier there",
             is_noise=True),
    )
}  # fmt: skip
