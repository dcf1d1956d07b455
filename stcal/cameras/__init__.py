"""Camera models by name, and the camera (a model with its detector and parameter values).

A new model is one file beside this one and one line in CAMERAS; its compiled twin is a short file
``<name>_kernels.py`` and one line in stcal.cameras.kernels.  Every model has a parameter ``f_m``.
"""

from stcal.cameras.base import Camera, CameraModel
from stcal.cameras.pinhole_radial import PINHOLE_RADIAL
from stcal.cameras.pixel_radial import PIXEL_RADIAL
from stcal.cameras.wang import WANG

_MODELS = (WANG, PINHOLE_RADIAL, PIXEL_RADIAL)
CAMERAS: dict[str, CameraModel] = {model.name: model for model in _MODELS}

__all__ = ["CAMERAS", "Camera", "CameraModel"]
