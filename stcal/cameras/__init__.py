"""Camera models by name, and the camera (a model with its detector and parameter values)."""

from stcal.cameras.base import Camera, CameraModel
from stcal.cameras.models import CAMERAS

__all__ = ["CAMERAS", "Camera", "CameraModel"]
