"""The table of camera models: a new model is one file and one line here."""

from stcal.cameras.base import CameraModel, register
from stcal.cameras.wang import WANG

CAMERAS: dict[str, CameraModel] = register([WANG])
