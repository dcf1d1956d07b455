"""The files of a simulation: telemetry as a downlink delivers it, calibrations, and the truth."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from stcal.atomic import write_with
from stcal.calibration import save
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.simulate.body import body_attitudes
from stcal.simulate.detector import CENTROID_DECIMALS
from stcal.simulate.scenario import PARTS
from stcal.simulate.simulation import SimulatedPart, Simulation

if TYPE_CHECKING:
    from stcal.telemetry.packet_layout import PacketLayout


def write_simulation(
    simulation: Simulation, folder: Path, truth_columns: bool = True
) -> dict[str, Path]:
    """Write a simulated sensor's files and return their paths by what they hold.

    ``<sensor>.calibration.csv.gz``, ``<sensor>.validation.csv.gz``, ``body/<sensor>.csv.gz`` (the
    spacecraft's own attitude at the frames of both) and ``<sensor>.initial.json`` are what an
    operator has; ``truth/<sensor>.json`` (the true calibration) and
    ``truth/<sensor>.truth.npz`` (left out without ``truth_columns``) are for judging.  Equal
    simulations give equal bytes.
    """
    from stcal.telemetry.writer import write_attitudes, write_csv

    sensor = simulation.scenario.sensor_id
    files = {f"{name} telemetry": folder / f"{sensor}.{name}.csv.gz" for name in PARTS}
    files["body attitude"] = folder / "body" / f"{sensor}.csv.gz"
    files["initial calibration"] = folder / f"{sensor}.initial.json"
    files["true calibration"] = folder / "truth" / f"{sensor}.json"
    first_pixel = simulation.scenario.sensor.detector.first_pixel_centre_px
    for name in PARTS:
        frames = getattr(simulation, name).frames
        write_csv([frames], files[f"{name} telemetry"], CENTROID_DECIMALS, first_pixel)
    times, q_bi = body_attitudes(simulation)
    sd_urad = simulation.scenario.mounting.body_attitude_sd_urad
    write_attitudes(files["body attitude"], times, q_bi, sd_urad)
    save(simulation.initial, files["initial calibration"])
    save(simulation.true, files["true calibration"])
    if truth_columns:
        files["truth"] = folder / "truth" / f"{sensor}.truth.npz"
        write_truth(files["truth"], _truth_columns(simulation))
    return files


def write_packets(simulation: Simulation, layout: PacketLayout, folder: Path) -> dict[str, Path]:
    """Write the telemetry of both parts as packets, ``<sensor>.<part>.ccsds``; return the paths."""
    from stcal.telemetry import packet_writer

    sensor = simulation.scenario.sensor_id
    first_pixel = simulation.scenario.sensor.detector.first_pixel_centre_px
    files = {f"{name} packets": folder / f"{sensor}.{name}.ccsds" for name in PARTS}
    for name in PARTS:
        frames = getattr(simulation, name).frames
        packet_writer.write_packets(layout, frames, files[f"{name} packets"], first_pixel)
    return files


def _save_columns(columns: dict[str, Any], stream: BinaryIO) -> None:
    np.savez_compressed(stream, allow_pickle=False, **columns)


def _truth_columns(simulation: Simulation) -> dict[str, Any]:
    """Return the columns of both parts, named ``<part>.<column>``."""
    columns: dict[str, Any] = {}
    for name in PARTS:
        for key, value in truth_columns(getattr(simulation, name)).items():
            columns[f"{name}.{key}"] = value
    return columns


def truth_columns(part: SimulatedPart) -> dict[str, Any]:
    """Return the truth of a part by column, with what tells its frames and stars apart."""
    kept = {key: getattr(part.frames, key) for key in ("frame_id", "t_tai_ns", "star_offsets")}
    return kept | vars(part.truth)


def write_truth(path: Path, columns: dict[str, Any]) -> None:
    """Write columns as a compressed numpy archive."""
    write_with(path, partial(_save_columns, columns))


def summary(simulation: Simulation) -> dict[str, Any]:
    """Return what was made, in numbers, by part."""
    return {name: figures(counts(getattr(simulation, name))) for name in PARTS}


def counts(part: SimulatedPart) -> Counter[str]:
    """Return what a part, or a piece of one, holds; the counts of pieces add up."""
    frames, truth = part.frames, part.truth
    identified = frames.star_id > 0
    counted = frames.counts_for_availability
    return Counter(
        frames=frames.n_frames,
        counted_frames=int(counted.sum()),
        fixed_frames=int(frames.has_fix[counted].sum()),
        stars=frames.n_stars,
        false_stars=int((truth.star_id == 0).sum()),
        outliers=int(truth.outlier.sum()),
        identified_stars=int(identified.sum()),
        wrongly_identified_stars=int((identified & (frames.star_id != truth.star_id)).sum()),
    )


def figures(total: Counter[str]) -> dict[str, Any]:
    """Return a part's counts as the summary states them."""
    frames, counted = total["frames"], total["counted_frames"]
    told = ("false_stars", "outliers", "identified_stars", "wrongly_identified_stars")
    return {
        "frames": frames,
        "flagged_frames": frames - counted,
        "stars": total["stars"],
        "stars_per_exposure": round(total["stars"] / (EXPOSURES_PER_FRAME * frames), 3),
        **{name: total[name] for name in told},
        # Without a frame outside eclipse and intrusion there is no availability.
        "availability": round(total["fixed_frames"] / counted, 6) if counted else None,
    }
