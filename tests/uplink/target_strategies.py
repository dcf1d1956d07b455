"""Random calibrations and upload targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from target_cases import calibration, example_document

from stcal.calibration import Calibration

UNITS = {
    "f_m": ("m", "mm", "um"), "m0_px": ("px",), "n0_px": ("px",), "b4_per_m4": ("m^-4", "mm^-4"),
    "b2_per_m2": ("m^-2", "mm^-2", "um^-2"), "a1_rad": ("rad", "mrad", "urad", "deg", "arcsec"),
    "a2_rad": ("rad", "deg"), "g_y": ("1",),
}  # fmt: skip
WORDS = ("float32", "float64", "int32", "int64")
SI = {"mm": 1e-3, "um": 1e-6, "mrad": 1e-3, "urad": 1e-6, "deg": np.pi / 180,
      "arcsec": np.pi / 648000, "mm^-4": 1e12, "mm^-2": 1e6, "um^-2": 1e12}  # fmt: skip


@st.composite
def calibrations(draw: st.DrawFn) -> Calibration:
    spread = st.floats(-1.0, 1.0)
    steps = np.array([3e-4, 200.0, 200.0, 5e8, 5e3, 0.02, 0.02, 1e-3])
    middle = np.array([0.016, 972.0, 1296.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    values = middle + steps * [draw(spread) for _ in steps]
    turn = np.array([draw(st.floats(-3.0, 3.0)) for _ in range(3)])
    base = calibration(serial=draw(st.integers(0, 2**31 - 1)))
    camera = base.camera.with_parameters(values)
    return replace(base, camera=camera, c_sd=Rotation.from_rotvec(turn).as_matrix())


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Targets with every word, unit and order, in any order of the fields."""
    document = example_document()
    document["table"] = {
        "byte_order": draw(st.sampled_from(["little", "big"])),
        "alignment": draw(st.sampled_from([1, 2, 4, 8])),
    }
    fields = []
    for name, units in UNITS.items():
        word = draw(st.sampled_from(WORDS))
        unit = draw(st.sampled_from(units))
        item = {"name": name, "value": name, "word": word, "unit": unit}
        if word.startswith("int"):
            largest = {"b4_per_m4": 6e8, "b2_per_m2": 6e3, "f_m": 0.017, "g_y": 1.1}.get(name, 2e3)
            if name.startswith("a"):
                largest = 0.05
            item["scale"] = float(f"{largest / SI.get(unit, 1.0) / 2**30:.4g}")
        if draw(st.booleans()):
            item["offset"] = draw(st.sampled_from([0.5, -1.0])) if unit == "px" else 0.0
        fields.append(item)
    alignment = draw(st.sampled_from(["c_sd", "q_sd", "q_ds"]))
    order = draw(st.sampled_from(["row", "column"] if alignment == "c_sd" else ["xyzw", "wxyz"]))
    word = draw(st.sampled_from(["float32", "float64", "int32"]))
    turn = {"name": "turn", "value": alignment, "order": order, "word": word}
    fields.append(turn | ({"fraction_bits": 30} if word == "int32" else {}))
    fields.append({"name": "serial", "value": "serial", "word": "uint32"})
    fields.append(
        {"name": "rows", "value": "rows", "word": draw(st.sampled_from(["int16", "int64"]))}
    )
    fields.append({"name": "gap", "value": "padding", "count": draw(st.integers(1, 5))})
    document["field"] = draw(st.permutations(fields))
    return document
