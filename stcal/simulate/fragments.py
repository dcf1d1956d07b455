"""A simulation of any length: telemetry in consecutive files, a UTC day each.

A fragment is a pure function of the scenario, the seed and its frames, so fragments may be made in
any order and by any number of processes; none of them needs more memory than its own day.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.calibration import save
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.errors import InputError
from stcal.execution import OrderedMap, serial
from stcal.simulate.body import noisy_body_attitudes
from stcal.simulate.detector import CENTROID_DECIMALS
from stcal.simulate.files import counts, figures, truth_columns, write_truth
from stcal.simulate.scenario import PARTS, Scenario
from stcal.simulate.simulation import SimulatedPart, join, simulate_chunk
from stcal.simulate.timeline import Timeline, tai_ns
from stcal.simulate.world import CHUNK_FRAMES, World, calibrations, make_world
from stcal.times import utc_day

if TYPE_CHECKING:
    from stcal.telemetry.packet_layout import PacketLayout

# A day with more frames is cut into files of equal size.
MAXIMUM_FRAMES = 50_000
# 16 % more bytes than level 9 in an eighth of its time.
_COMPRESSION_LEVEL = 3


@dataclass(frozen=True)
class Output:
    """Where the files go, and which are wanted beside the telemetry as CSV."""

    folder: Path
    truth_columns: bool = True
    layout: PacketLayout | None = None

    def files(self, sensor_id: str, fragment: Fragment) -> dict[str, Path]:
        """Return the paths of a fragment's files by what they hold."""
        part = fragment.part
        name = f"{sensor_id}.{part}.{fragment.label}"
        files = {"telemetry": self.folder / part / f"{name}.csv.gz"}
        files["body attitude"] = self.folder / "body" / f"{name}.csv.gz"
        if self.layout is not None:
            files["packets"] = self.folder / "packets" / part / f"{name}.ccsds"
        if self.truth_columns:
            files["truth"] = self.folder / "truth" / f"{name}.truth.npz"
        return files


@dataclass(frozen=True)
class Fragment:
    """Frames [start, stop) of a part; ``timeline`` holds all frames of their chunks.

    ``label`` is the UTC day, with a number behind it where a day is cut.
    """

    part: str
    label: str
    start: int
    stop: int
    timeline: Timeline


@dataclass(frozen=True)
class Plan:
    """The fragments of both parts, by what those of a part share."""

    scenario: Scenario
    parts: tuple[tuple[World, tuple[Fragment, ...]], ...]

    @property
    def fragments(self) -> tuple[Fragment, ...]:
        """All fragments."""
        return tuple(one for _, fragments in self.parts for one in fragments)


def lay_out(scenario: Scenario, seed: int) -> Plan:
    """Return the fragments of a simulation.

    Raises
    ------
    ConfigError
        When a segment never sees the sky.
    """
    parts = []
    for part in PARTS:
        world = make_world(scenario, part, seed)
        fragments = tuple(fragments_of(world))
        # The world goes to every worker; of the timeline a fragment has what it needs.
        parts.append((replace(world, timeline=world.timeline.piece(0, 0)), fragments))
    return Plan(scenario, tuple(parts))


def write_fragments(
    plan: Plan,
    output: Output,
    map_fragments: OrderedMap = serial,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Write a simulated sensor's files, the telemetry in fragments; return what they are.

    ``<part>/<sensor>.<part>.<day>.csv.gz`` holds the telemetry of a day,
    ``body/<sensor>.<part>.<day>.csv.gz`` the spacecraft's own attitude at its frames,
    ``truth/<sensor>.<part>.<day>.truth.npz`` its truth, ``packets/<part>/`` its packets; the
    calibrations are named as :func:`stcal.simulate.files.write_simulation` does.  The telemetry is
    that of the simulation in one piece; the noise of the body's attitude is drawn by fragment.

    Parameters
    ----------
    map_fragments : an ordered map: the files don't depend on it
    advance : called when a fragment is done

    Raises
    ------
    InputError
        When a folder holds fragments of another run.
    """
    _check_folders(plan, output)
    parts = {}
    for world, fragments in plan.parts:
        total: Counter[str] = Counter()
        for one in map_fragments(partial(write_fragment, world, output), fragments):
            total.update(one)
            advance()
        parts[world.part] = {"fragments": len(fragments)} | figures(total)
    return {"files": _write_calibrations(plan.scenario, output), "parts": parts}


def fragments_of(world: World) -> Iterator[Fragment]:
    """Yield the fragments of a part in the order of time."""
    timeline = world.timeline
    day = utc_day(tai_ns(world.scenario.epoch_tai_ns, timeline.t_s))
    changes = np.flatnonzero(np.diff(day.astype(np.int64))) + 1
    for first, last in pairwise([0, *changes.tolist(), timeline.n_frames]):
        n = -(-(last - first) // MAXIMUM_FRAMES)
        edges = np.linspace(first, last, n + 1).astype(int).tolist()
        for number, (start, stop) in enumerate(pairwise(edges), start=1):
            label = str(day[first]) + (f".{number:03}" if n > 1 else "")
            chunks = (start // CHUNK_FRAMES, -(-stop // CHUNK_FRAMES))
            rows = (chunks[0] * CHUNK_FRAMES, min(chunks[1] * CHUNK_FRAMES, timeline.n_frames))
            yield Fragment(world.part, label, start, stop, timeline.piece(*rows))


def simulate_fragment(world: World, fragment: Fragment) -> list[SimulatedPart]:
    """Return the fragment's frames, chunk by chunk."""
    world = replace(world, timeline=fragment.timeline)
    pieces = []
    for chunk in range(fragment.start // CHUNK_FRAMES, -(-fragment.stop // CHUNK_FRAMES)):
        first = chunk * CHUNK_FRAMES
        start, stop = max(fragment.start - first, 0), min(fragment.stop - first, CHUNK_FRAMES)
        pieces.append(simulate_chunk(world, chunk).rows(start, stop))
    return pieces


def write_fragment(world: World, output: Output, fragment: Fragment) -> Counter[str]:
    """Make one fragment and write its files, each in one step; return its counts."""
    from stcal.telemetry.packet_writer import write_packets
    from stcal.telemetry.writer import write_attitudes, write_csv

    scenario = world.scenario
    first_pixel = scenario.sensor.detector.first_pixel_centre_px
    files = output.files(scenario.sensor_id, fragment)
    pieces = simulate_fragment(world, fragment)
    batches = [piece.frames for piece in pieces]
    write_csv(batches, files["telemetry"], CENTROID_DECIMALS, first_pixel, _COMPRESSION_LEVEL)
    whole = join(pieces)
    q_si = whole.truth.q_si[::EXPOSURES_PER_FRAME]
    q_bi = noisy_body_attitudes(scenario, q_si, _body_noise(world, fragment))
    sd_urad = scenario.mounting.body_attitude_sd_urad
    write_attitudes(files["body attitude"], whole.frames.t_tai_ns, q_bi, sd_urad)
    if output.layout is not None:
        packets = (whole.frames, files["packets"], first_pixel, fragment.start)
        write_packets(output.layout, *packets)
    if output.truth_columns:
        write_truth(files["truth"], truth_columns(whole))
    return counts(whole)


def _body_noise(world: World, fragment: Fragment) -> np.random.Generator:
    seed, sensor, part = world.seed
    entropy = (seed, sensor, len(PARTS))
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(part, fragment.start)))


def _write_calibrations(scenario: Scenario, output: Output) -> dict[str, Path]:
    sensor, folder = scenario.sensor_id, output.folder
    paths = (folder / f"{sensor}.initial.json", folder / "truth" / f"{sensor}.json")
    for calibration, path in zip(calibrations(scenario), paths, strict=True):
        save(calibration, path)
    folders = {f"{part} telemetry": folder / part for part in PARTS}
    folders["body attitude"] = folder / "body"
    if output.layout is not None:
        folders |= {f"{part} packets": folder / "packets" / part for part in PARTS}
    if output.truth_columns:
        folders["truth"] = folder / "truth"
    return folders | {"initial calibration": paths[0], "true calibration": paths[1]}


def _check_folders(plan: Plan, output: Output) -> None:
    """Refuse folders in which fragments of a longer run, or of another epoch, would stay."""
    sensor = plan.scenario.sensor_id
    written = {path for one in plan.fragments for path in output.files(sensor, one).values()}
    for folder in {path.parent for path in written}:
        for part in PARTS:
            for found in sorted(folder.glob(f"{sensor}.{part}.*")):
                if found not in written:
                    raise InputError(f"{found}: is of another simulation; name another folder")
