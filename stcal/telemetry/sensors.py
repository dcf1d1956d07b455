"""What ingest needs of the sensors that it meets, by an index instead of by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from stcal.config import SensorConfig
from stcal.errors import ConfigError, InputError
from stcal.frames import Floats, Ints
from stcal.telemetry.names import MAXIMUM_FOLDER_BYTES, sensor_folder
from stcal.telemetry.schema import Objects

_LONGEST_NAME = 64


class Sensors:
    """The sensors met so far; index 0 stands for every sensor without a configuration.

    Attributes
    ----------
    names : the sensor's name of each index
    rows, cols, first_pixel_centre_px, quaternion_norm_tolerance, maximum_backwards_s : (k,) by
        index
    """

    PROBLEMS: ClassVar[dict[str, str]] = {
        "bad_sensor_id": f"not 1 to {_LONGEST_NAME} printable characters that make "
        f"a folder's name of at most {MAXIMUM_FOLDER_BYTES} bytes",
        "unknown_sensor": "no configuration given applies to it",
    }

    def __init__(self, configs: Sequence[SensorConfig]) -> None:
        """Take the configurations that tell which sensors are known."""
        self._configs = configs
        self._known: dict[str, tuple[int, str]] = {}
        self.names = [""]
        self.rows: Floats = np.array([np.inf])
        self.cols: Floats = np.array([np.inf])
        self.first_pixel_centre_px: Floats = np.zeros(1)
        self.quaternion_norm_tolerance: Floats = np.array([np.inf])
        self.maximum_backwards_s: Floats = np.array([np.inf])

    def look_up(self, names: Any) -> tuple[Ints, Objects]:
        """Return the index of each name of an Arrow string array, and its problem or ``''``.

        Raises
        ------
        ConfigError
            Two configurations apply to one sensor.
        """
        packed = names.dictionary_encode()
        found = [self._one(name) for name in packed.dictionary.to_pylist()]
        codes = packed.indices.to_numpy()
        index = np.array([i for i, _ in found], dtype=np.int64)
        problem = np.array([problem for _, problem in found], dtype=object)
        return index[codes], problem[codes]

    def _one(self, name: str) -> tuple[int, str]:
        if name not in self._known:
            self._known[name] = self._resolve(name)
        return self._known[name]

    def _resolve(self, name: str) -> tuple[int, str]:
        if not _is_valid(name):
            return 0, "bad_sensor_id"
        configs = [config for config in self._configs if config.applies_to(name)]
        if not configs:
            return 0, "unknown_sensor"
        if len(configs) > 1:
            titles = ", ".join(repr(config.name) for config in configs)
            raise ConfigError(f"sensor {name!r}: several configurations apply: {titles}")
        detector = configs[0].detector
        self.names.append(name)
        self.rows = np.append(self.rows, detector.rows)
        self.cols = np.append(self.cols, detector.cols)
        first = detector.first_pixel_centre_px
        self.first_pixel_centre_px = np.append(self.first_pixel_centre_px, first)
        self.quaternion_norm_tolerance = np.append(
            self.quaternion_norm_tolerance, configs[0].ingest.quaternion_norm_tolerance
        )
        self.maximum_backwards_s = np.append(
            self.maximum_backwards_s, configs[0].ingest.maximum_backwards_s
        )
        return len(self.names) - 1, ""


def _is_valid(name: str) -> bool:
    if not name or len(name) > _LONGEST_NAME or not name.isprintable():
        return False
    try:
        sensor_folder(name)
    except InputError:
        return False
    return True
