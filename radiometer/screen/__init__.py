"""A screen as a calibrated light source: which level gives which radiance, and how well that is known."""

from radiometer.screen.calibration import ChannelCurve, ScreenCalibration
from radiometer.screen.run import Meter, ScreenReading

__all__ = ["ChannelCurve", "Meter", "ScreenCalibration", "ScreenReading"]
