"""Scenes to point a simulated camera at, each giving radiance per pixel and the truth about its patches."""

from simulators.scenes.base import Scene, SceneImage
from simulators.scenes.factory import SCENES, scene_from_mapping
from simulators.scenes.image_file import ImageScene
from simulators.scenes.led import LedScene
from simulators.scenes.screen import ScreenPatch, ScreenScene
from simulators.scenes.step_chart import StepChartScene, Steps
from simulators.scenes.uniform import UniformScene

__all__ = [
    "SCENES", "ImageScene", "LedScene", "Scene", "SceneImage", "ScreenPatch", "ScreenScene", "StepChartScene", "Steps",
    "UniformScene", "scene_from_mapping",
]  # fmt: skip
