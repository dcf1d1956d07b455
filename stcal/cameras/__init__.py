"""Camera models by name, and the camera (a model with its detector and parameter values).

A new model is one file beside this one and one line in CAMERAS; its compiled twin is a short file
``<name>_kernels.py`` and one line in stcal.cameras.kernels.
"""

from stcal.cameras.base import Camera, CameraModel
from stcal.cameras.wang import WANG

CAMERAS: dict[str, CameraModel] = {model.name: model for model in (WANG,)}

__all__ = ["CAMERAS", "Camera", "CameraModel"]
