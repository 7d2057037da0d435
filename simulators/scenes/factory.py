"""From a configuration's mapping to a scene; a new kind of scene is one file and one line here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from radiometer.data.validation import validate
from radiometer.errors import ConfigurationError
from simulators.scenes.base import Scene
from simulators.scenes.colour_chart import ColourChartScene
from simulators.scenes.image_file import ImageScene
from simulators.scenes.layout import LitScene
from simulators.scenes.led import LedScene
from simulators.scenes.screen import ScreenScene
from simulators.scenes.step_chart import StepChartScene
from simulators.scenes.uniform import UniformScene

SCENES: Final[dict[str, type[LitScene]]] = {
    "colour_chart": ColourChartScene,
    "image": ImageScene,
    "led": LedScene,
    "screen": ScreenScene,
    "step_chart": StepChartScene,
    "uniform": UniformScene,
}


def scene_from_mapping(mapping: Mapping[str, Any], where: str = "scene", folder: Path | None = None) -> Scene:
    """Return the scene that a mapping describes.

    Args:
        mapping: `kind` and the keys of that kind.
        folder: Folder that a relative `file` is found in.

    Raises:
        ConfigurationError: If the kind or a key is unknown, or a value is not allowed; the message names it.
    """
    kind = mapping.get("kind")
    if not isinstance(kind, str) or kind not in SCENES:
        raise ConfigurationError(f"{where}: kind = {kind!r}: there is no such scene; allowed are {', '.join(SCENES)}")
    model: type[BaseModel] = SCENES[kind]
    scene: Any = validate(model, mapping, where, ConfigurationError)
    if isinstance(scene, ImageScene) and folder is not None and not scene.file.is_absolute():
        return scene.model_copy(update={"file": folder / scene.file})
    made: LitScene = scene
    return made
