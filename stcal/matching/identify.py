"""From a batch of frames and a camera to identified stars and attitudes."""

from __future__ import annotations

import hashlib
import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import attitudes_from_quaternions, residual_angles, solve_wahba
from stcal.cameras import Camera
from stcal.catalog.apparent import apparent_directions, observer_at
from stcal.catalog.catalogue import StarCatalogue, catalogue_sha256
from stcal.config import Matching, SensorConfig, config_sha256
from stcal.constants import DEG, EXPOSURES_PER_FRAME, URAD
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import kernels
from stcal.matching.given_kernels import keep_consistent
from stcal.matching.index import SkyIndex, build_index

Floats = NDArray[np.float64]

# Workers that need the same index at once must not each build it.
_INDEX_LOCK = threading.Lock()

REASONS = ("solved", "too few stars", "no match")
# Chance matches are judged in a field this much denser than the mean sky (the Milky Way).
_CROWDING = 1.5
# Shorter arcs, as a part of the longest, give no attitude worth checking.
_SHORTEST_ARC = 0.05
# Matches from elsewhere may depart by this many pair tolerances from their attitude.
_GIVEN_TOLERANCE = 5.0


@dataclass(frozen=True, eq=False)
class Matcher:
    """A catalogue and a sensor's matching rules, ready to identify frames.

    The sky index is kept for each whole year of epoch, so that the answer for a frame doesn't
    depend on the frames beside it.  Matchers of equal content are equal, so that a worker process
    builds an index once, however often it is sent the matcher.
    """

    catalogue: StarCatalogue
    config: SensorConfig

    @cached_property
    def key(self) -> str:
        """Hash of the content."""
        content = f"{catalogue_sha256(self.catalogue)} {config_sha256(self.config)}"
        return hashlib.sha256(content.encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        """Return whether the other is a matcher of the same content."""
        return isinstance(other, Matcher) and self.key == other.key

    def __hash__(self) -> int:
        """Return a hash of the content."""
        return hash(self.key)

    def index(self, year: int) -> SkyIndex:
        """Return the sky index at ``year`` Julian years after J2000.0."""
        with _INDEX_LOCK:
            return _index(self, year)


@lru_cache(maxsize=8)
def _index(matcher: Matcher, year: int) -> SkyIndex:
    rules = matcher.config.matching
    radius = max(rules.hint_radius_deg * DEG, 3.0 * rules.star_tolerance_urad * URAD)
    faintest = np.inf if rules.seed_magnitude is None else rules.seed_magnitude
    return build_index(matcher.catalogue, float(year), rules.pair_limit_deg * DEG, radius, faintest)


def _no_hints(frames: FrameBatch, hints: Floats | None, c_sd: Floats) -> Floats:
    return np.full((frames.n_exposures, 3, 3), np.nan)


def _hints(frames: FrameBatch, hints: Floats | None, c_sd: Floats) -> Floats:
    """Take the previous solution where there is one, else the telemetered quaternion."""
    telemetered = attitudes_from_quaternions(frames.q_si, c_sd)
    both = np.repeat(telemetered, EXPOSURES_PER_FRAME, axis=0)
    if hints is None:
        return both
    return np.where(np.isnan(hints), both, hints)


@dataclass(frozen=True)
class Method:
    """How exposures are started: from which hints, and whether lost in space as well."""

    hints: Callable[[FrameBatch, Floats | None, Floats], Floats]
    guided: bool
    description: str


METHODS: dict[str, Method] = {
    "lost-in-space": Method(_no_hints, False, "stateless, as the flight software identifies"),
    "guided": Method(
        _hints,
        True,
        "from the previous solution or the telemetered quaternion; an exposure that has neither, "
        "or that the hint does not solve, is identified lost in space",
    ),
}


def match(
    frames: FrameBatch,
    camera: Camera,
    c_sd: Floats,
    matcher: Matcher,
    method: str = "lost-in-space",
    hints: Floats | None = None,
) -> MatchedFrames:
    """Identify the stars of every exposure and solve its attitude.

    Parameters
    ----------
    frames : the telemetry
    camera, c_sd : the calibration under which star vectors are computed
    matcher : catalogue and rules
    method : a name in METHODS
    hints : (E, 3, 3) attitudes c_di known before, NaN where unknown; used by ``guided``
    """
    chosen = METHODS[method]
    config = matcher.config
    s_d = camera.directions(frames.row_px, frames.col_px)
    observer = observer_at(frames.t_tai_ns, frames.pos_km, frames.vel_km_s)
    star = np.empty(frames.n_stars, np.int32)
    s_i, residual = np.empty((frames.n_stars, 3)), np.empty(frames.n_stars)
    c_di = np.empty((frames.n_exposures, 3, 3))
    reason = np.empty(frames.n_exposures, np.int8)
    start = chosen.hints(frames, hints, c_sd)
    rows = observer.rows
    for year, stretch in by_year(observer.years):
        first, last = EXPOSURES_PER_FRAME * stretch.start, EXPOSURES_PER_FRAME * stretch.stop
        a, b = frames.star_offsets[first], frames.star_offsets[last]
        sky, rule, work = kernel_input(matcher.index(year), config.matching, frames, first, last)
        kernels.identify(
            frames.star_offsets[first : last + 1] - a, s_d[a:b], frames.intensity[a:b],
            rows[stretch], start[first:last], chosen.guided, sky, rule, work,
            star[a:b], s_i[a:b], residual[a:b], c_di[first:last], reason[first:last],
        )  # fmt: skip
    return MatchedFrames(frames, star, s_i, reason == 0, reason, c_di, residual)


def rematch_given(
    frames: FrameBatch, camera: Camera, catalogue: StarCatalogue, star: NDArray[np.int32]
) -> MatchedFrames:
    """Return matches that are already known (S,) under a camera, with attitudes solved anew.

    An exposure counts as solved with three matched stars or more.
    """
    s_d = camera.directions(frames.row_px, frames.col_px)
    count = np.bincount(frames.exposure_of_star[star >= 0], minlength=frames.n_exposures)
    star = np.where((count >= 3)[frames.exposure_of_star], star, np.int32(-1)).astype(np.int32)
    reason = np.where(count >= 3, 0, 1).astype(np.int8)
    s_i = _places(frames, catalogue, star)
    matched = np.flatnonzero(star >= 0)
    exposure = frames.exposure_of_star[matched]
    weight = np.ones(len(matched))
    c_di = solve_wahba(s_d[matched], s_i[matched], weight, exposure, frames.n_exposures)
    c_di[count < 3] = np.nan
    residual = np.full(frames.n_stars, np.nan)
    residual[matched] = residual_angles(s_d[matched], s_i[matched], c_di[exposure])
    return MatchedFrames(frames, star, s_i, count >= 3, reason, c_di, residual)


def _places(frames: FrameBatch, catalogue: StarCatalogue, star: NDArray[np.int32]) -> Floats:
    """Return the apparent places (S, 3) of matched stars, NaN elsewhere."""
    observer = observer_at(frames.t_tai_ns, frames.pos_km, frames.vel_km_s)
    matched = np.flatnonzero(star >= 0)
    frame = frames.exposure_of_star[matched] // EXPOSURES_PER_FRAME
    s_i = np.full((frames.n_stars, 3), np.nan)
    s_i[matched] = apparent_directions(catalogue, star[matched].astype(np.int64), frame, observer)
    return s_i


def telemetered_matches(frames: FrameBatch, camera: Camera, matcher: Matcher) -> NDArray[np.int32]:
    """Return the on-board matches (S,) as catalogue indices, -1 where unmatched or not in it.

    They were made by somebody else's rules, so each exposure keeps only what one attitude
    explains within a few times the pair tolerance: a falsely solved exposure, a wrong or a
    repeated identifier would otherwise bend the first fit beyond repair.
    """
    catalogue = matcher.catalogue
    order = np.argsort(catalogue.star_id, kind="stable")
    ids = catalogue.star_id[order]
    place = np.minimum(np.searchsorted(ids, frames.star_id), len(ids) - 1)
    known = (frames.star_id != 0) & (ids[place] == frames.star_id)
    star = np.where(known, order[place], -1).astype(np.int32)
    _drop_repeated(frames, star)
    tolerance = _GIVEN_TOLERANCE * matcher.config.matching.pair_tolerance_urad * URAD
    shortest = _SHORTEST_ARC * matcher.config.matching.pair_limit_deg * DEG
    s_d = camera.directions(frames.row_px, frames.col_px)
    s_i = _places(frames, catalogue, star)
    keep_consistent(frames.star_offsets, s_d, s_i, star, tolerance, shortest)
    return star


def _drop_repeated(frames: FrameBatch, star: NDArray[np.int32]) -> None:
    """Unmatch, in place, stars that one exposure names more than once."""
    matched = np.flatnonzero(star >= 0)
    key = frames.exposure_of_star[matched] * (int(star.max(initial=0)) + 1) + star[matched]
    _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    star[matched[counts[inverse] > 1]] = -1


def by_year(years: Floats) -> list[tuple[int, slice]]:
    """Split frames into stretches of the same whole year of epoch."""
    whole = np.round(years).astype(int)
    edges = np.flatnonzero(np.diff(whole)) + 1
    bounds = np.concatenate(([0], edges, [len(whole)])).astype(int)
    return [(int(whole[a]), slice(int(a), int(b))) for a, b in itertools.pairwise(bounds) if b > a]


def kernel_input(
    index: SkyIndex, rules: Matching, frames: FrameBatch, first: int, last: int
) -> tuple[kernels.Sky, kernels.Rule, kernels.Work]:
    """Return what the kernels need for exposures ``first`` to ``last``: sky, rules, scratch."""
    pair_tolerance, limit = rules.pair_tolerance_urad * URAD, rules.pair_limit_deg * DEG
    tolerance = rules.star_tolerance_urad * URAD
    pairs = len(index.pair)
    sky = kernels.Sky(
        kernels.StarMap(
            index.star, index.direction, index.cell_start, index.cell_star, index.cells,
            index.radius_rad,
        ),
        kernels.PairTable(
            index.pair_angle, index.pair, index.pair_start, index.pair_bin_rad, limit
        ),
    )  # fmt: skip
    rule = kernels.Rule(
        pair_tolerance=pair_tolerance,
        star_tolerance=tolerance,
        hint_radius=rules.hint_radius_deg * DEG,
        shortest_arc=_SHORTEST_ARC * limit,
        minimum_matches=rules.minimum_matches,
        seed_stars=rules.seed_stars,
        # Ordered catalogue pairs that the pair tolerance leaves for one detected pair.
        hypotheses=max(1.0, 2.0 * pairs * min(1.0, 2.0 * pair_tolerance / limit)),
        chance=min(1.0, _CROWDING * index.density_per_sr * np.pi * tolerance**2),
        false_alarm=rules.false_alarm,
    )
    largest = int(frames.stars_per_exposure[first:last].max(initial=1))
    work = kernels.make_work(len(index.star), largest, pairs, rules.seed_stars)
    return sky, rule, work
