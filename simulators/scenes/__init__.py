"""Scenes to point a simulated camera at, each giving radiance per pixel and the truth about its patches."""

from simulators.scenes.base import Scene, SceneImage
from simulators.scenes.kinds import (
    SCENES,
    ImageScene,
    LedScene,
    ScreenPatch,
    ScreenScene,
    StepChartScene,
    Steps,
    UniformScene,
    scene_from_mapping,
)

__all__ = [
    "SCENES", "ImageScene", "LedScene", "Scene", "SceneImage", "ScreenPatch", "ScreenScene", "StepChartScene", "Steps",
    "UniformScene", "scene_from_mapping",
]  # fmt: skip
