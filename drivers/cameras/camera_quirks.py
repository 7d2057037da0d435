"""How families of cameras differ from the standard (`configs/cameras/quirks/*.yaml`), and which preset is theirs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field

from radiometer.data import CameraDescription
from radiometer.data.storage import read_yaml, shipped_config
from radiometer.data.validation import ConfigSection, validate
from radiometer.devices import CameraPreset
from radiometer.errors import ConfigurationError


class CameraMatch(ConfigSection):
    """Regular expressions that must each fit wholly, case aside."""

    vendor: str = ".*"
    model: str = ".*"
    manufacturer_info: str = ".*"

    def fits(self, vendor: str, model: str, manufacturer_info: str = "") -> bool:
        """Tell whether a camera is meant."""
        pairs = ((self.vendor, vendor), (self.model, model), (self.manufacturer_info, manufacturer_info))
        return all(re.fullmatch(pattern, text, re.IGNORECASE) is not None for pattern, text in pairs)


class PresetChoice(ConfigSection):
    """The preset of the models that a regular expression fits."""

    model: str
    preset: str


class CameraQuirks(ConfigSection):
    """How a family of cameras differs from the standard; each figure's origin is stated in `sources`."""

    format: Literal["radiometer-camera-quirks/1"]
    matches: CameraMatch  # which cameras are meant
    presets: tuple[PresetChoice, ...] = ()  # datasheet presets of its models
    # Frames thrown away after a change of settings, in addition to those that chunks distinguish
    discard_after_change: int = Field(1, ge=0, le=20)
    load_default_user_set: bool = False  # load the factory's user set when opening
    # Significant bits of Mono16 where they are shifted to the top; 0 where not
    mono16_left_aligned_bits: int = Field(0, ge=0, le=16)
    mono16_big_endian: bool = False  # mono16 comes with the high byte first
    gain_db_per_unit: float = Field(1.0, gt=0)  # dB per unit of the gain feature
    # DN per unit of the black level feature; None: from the unit that the camera states
    black_level_dn_per_unit: float | None = Field(None, gt=0)
    sources: dict[str, str] = Field(default_factory=dict)

    def preset_of(self, model: str) -> CameraDescription | None:
        """Return the datasheet's description of a model; None where none comes with the product."""
        for choice in self.presets:
            if re.fullmatch(choice.model, model, re.IGNORECASE):
                return CameraPreset.shipped(choice.preset).camera
        return None


def load_preset(name_or_path: str) -> CameraDescription:
    """Return the description in a camera file.

    Args:
        name_or_path: Model of a shipped preset, such as "BFS-U3-19S4M", or the path of a YAML file.

    Raises:
        ConfigurationError: If there is none, or it holds something not allowed.
    """
    if name_or_path.endswith((".yaml", ".yml")):
        return CameraPreset.read(Path(name_or_path)).camera
    return CameraPreset.shipped(name_or_path).camera


def quirks_for(vendor: str, model: str, manufacturer_info: str = "") -> CameraQuirks:
    """Return the quirks of a camera's family; those of `generic.yaml` where it is unknown.

    Raises:
        ConfigurationError: If a quirk file holds something not allowed.
    """
    generic = shipped_config("cameras/quirks/generic.yaml")
    for path in (*sorted(p for p in generic.parent.glob("*.yaml") if p != generic), generic):
        quirks = validate(CameraQuirks, read_yaml(path), str(path), ConfigurationError)
        if quirks.matches.fits(vendor, model, manufacturer_info):
            return quirks
    raise ConfigurationError(f"{generic}: fits no camera {vendor} {model}; its patterns must all be '.*'")
