"""Displays that do not exist: what they show follows from their drive, and a simulated camera can look at them."""

from simulators.displays.base import LCD, OLED, PWM_LCD, DisplayModel, MuraSpot, SimulatedDisplay
from simulators.displays.watching_camera import WatchingCamera

DISPLAYS: dict[str, DisplayModel] = {"lcd": LCD, "pwm_lcd": PWM_LCD, "oled": OLED}

__all__ = ["DISPLAYS", "LCD", "OLED", "PWM_LCD", "DisplayModel", "MuraSpot", "SimulatedDisplay", "WatchingCamera"]
