"""A sequential filter's way through the frames: fragments in, state and history out.

The pass itself is compiled (``pass_kernels``); here its inputs are laid out as columns and its
results taken back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from stcal.cameras.kernels import CAMERA_KERNELS
from stcal.catalog.apparent import observer_at
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.errors import UsageError
from stcal.frames import FrameBatch, MatchedFrames
from stcal.matching import METHODS
from stcal.matching.identify import by_year, kernel_input
from stcal.pipeline import layout_kernels as layout
from stcal.pipeline.filter_state import FilterState
from stcal.pipeline.filtering import Filter
from stcal.pipeline.pass_kernels import run_pass
from stcal.residuals.kernels import RESIDUAL_KERNELS
from stcal.residuals.selection import centroid_sd

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EVENTS = ("", "fewer frames fixed", "fewer stars matched", "innovations too large", "numerical")

_NS_PER_HOUR = 3.6e12
# A smoother's passes are repeated until no state moves by more than this part of its sd.
_SETTLED_SD = 1e-3
_PASSES = 10


@dataclass(frozen=True)
class FrameHistory:
    """What a filter did, frame by frame.

    Attributes
    ----------
    frame_id, t_tai_ns, temperature_c : (F,) of the telemetry
    x, sd : (F, n) state after each frame and its sd, in units of the state's scale
    nis, log_determinant : (F,) of the innovations under the configured noise, NaN without update
    arcs : (F,) number of independent arclengths used
    innovation : (I,) standardised innovations, frame after frame; ``innovations`` (F,) of them
    noise_scale : (F,) sd of the innovations over the configured noise so far
    fixed, fixed_baseline : (F,) whether the frame was identified with the state before it, and with
        the baseline
    matched, matched_baseline : (F,) matched stars of both exposures
    rejected, iterations : (F,) stars screened out; times that the measurement was linearised
    event : (F,) index into EVENTS
    on_baseline : (F,) whether the sensor would use the baseline after this frame
    """

    frame_id: Ints
    t_tai_ns: Ints
    temperature_c: Floats
    x: Floats
    sd: Floats
    nis: Floats
    log_determinant: Floats
    arcs: Ints
    innovation: Floats
    innovations: Ints
    noise_scale: Floats
    fixed: NDArray[np.bool_]
    fixed_baseline: NDArray[np.bool_]
    matched: Ints
    matched_baseline: Ints
    rejected: Ints
    iterations: Ints
    event: NDArray[np.int8]
    on_baseline: NDArray[np.bool_]


def join_histories(parts: Sequence[FrameHistory]) -> FrameHistory:
    """Return histories one after the other."""
    columns = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(FrameHistory)
    }
    return FrameHistory(**columns)


def filter_fragment(
    chosen: Filter, baseline: MatchedFrames, state: FilterState
) -> tuple[FilterState, FrameHistory, MatchedFrames]:
    """Run a filter over the frames of a fragment.

    ``baseline`` is what the calibration on board identifies in them.  Returns the new state, the
    history, and the matches under the state before each frame (attitudes left out).
    """
    frames = baseline.frames
    mine, kept = _working_copy(chosen, frames, state)
    history = _empty_history(frames, chosen.n_states)
    star, s_i = np.empty(frames.n_stars, np.int32), np.empty((frames.n_stars, 3))
    gap = _gaps(frames, state.last_t_tai_ns)
    sd_px = centroid_sd(chosen.matcher.config.noise, frames.intensity)
    observer = observer_at(frames.t_tai_ns, frames.pos_km, frames.vel_km_s)
    hints = _hints(chosen, frames)
    warmth = np.nan_to_num(frames.temperature_c - chosen.reference_temperature_c, nan=0.0)
    residual = RESIDUAL_KERNELS[chosen.residual.name]
    # The pass fills the table in place; a filter may be used by several threads.
    model = chosen.model._replace(slope_table=np.empty_like(chosen.model.slope_table))
    for year, stretch in by_year(observer.years):
        first, last = EXPOSURES_PER_FRAME * stretch.start, EXPOSURES_PER_FRAME * stretch.stop
        a, b = frames.star_offsets[first], frames.star_offsets[last]
        telemetry = layout.Telemetry(
            frames.star_offsets[first : last + 1] - a, frames.row_px[a:b], frames.col_px[a:b],
            frames.intensity[a:b], sd_px[a:b], observer.rows[stretch], hints[first:last],
            warmth[stretch], gap[stretch],
        )  # fmt: skip
        given = layout.Baseline(
            baseline.star[a:b], baseline.s_i[a:b], baseline.c_di[first:last],
            baseline.reason[first:last],
        )  # fmt: skip
        run_pass(
            CAMERA_KERNELS[chosen.matcher.config.camera.model], residual.bind, residual.rows,
            chosen.steps.update, chosen.steps.predict, chosen.estimator.covariance, telemetry,
            given, model, chosen.rules,
            *kernel_input(
                chosen.matcher.index(year), chosen.matcher.config.matching, frames, first, last
            ),
            mine, kept, _stretch_of(history, stretch, a, b), star[a:b], s_i[a:b],
        )  # fmt: skip
    after = _state_after(mine, kept, frames)
    matched = replace(baseline, star=star, s_i=s_i)
    return after, _frame_history(history, frames, baseline), matched


def _working_copy(
    chosen: Filter, frames: FrameBatch, state: FilterState
) -> tuple[layout.State, layout.Kept]:
    """Return what the pass changes in place: the state, and the window with room for the frames."""
    mine = layout.State(
        state.x.copy(), state.root.copy(), chosen.start.x, chosen.start.root, state.base_x.copy(),
        state.base_root.copy(), state.linearised_at.copy(), state.sloped_at.copy(),
        state.tally.copy(), state.window.copy(),
    )  # fmt: skip
    largest = int(np.diff(frames.star_offsets[::EXPOSURES_PER_FRAME]).max(initial=1))
    count, stars = state.kept_star.shape[:2]
    room = chosen.kept_frames
    kept = layout.Kept(
        np.zeros((room, max(stars, largest), 6)), np.zeros((room, 2, 3, 3)), np.zeros((room, 4)),
        np.zeros((room, chosen.n_states + 1, chosen.n_states)), np.array([0, count]),
    )  # fmt: skip
    kept.star[:count, :stars] = state.kept_star
    kept.c_di[:count], kept.facts[:count] = state.kept_c_di, state.kept_facts
    kept.after[:count] = state.kept_after
    return mine, kept


def _state_after(mine: layout.State, kept: layout.Kept, frames: FrameBatch) -> FilterState:
    oldest, count = kept.place
    slots = (oldest + np.arange(count)) % len(kept.facts)
    stars = int(kept.facts[slots, :2].sum(axis=1).max(initial=0))
    return FilterState(
        mine.x, mine.root, mine.base_x, mine.base_root, mine.linearised_at, mine.sloped_at,
        mine.tally, mine.window, kept.star[slots, :stars], kept.c_di[slots], kept.facts[slots],
        kept.after[slots], int(frames.t_tai_ns[-1]), int(frames.frame_id[-1]),
    )  # fmt: skip


def _gaps(frames: FrameBatch, before: int | None) -> Floats:
    """Return the square root of the hours since the frame before (F,), zero for the first ever."""
    first = frames.t_tai_ns[0] if before is None else before
    hours = np.diff(frames.t_tai_ns, prepend=first) / _NS_PER_HOUR
    return np.sqrt(np.maximum(hours, 0.0))


def _hints(chosen: Filter, frames: FrameBatch) -> Floats:
    """Return attitude hints c_di (E, 3, 3) from the telemetry where the method takes any."""
    method = METHODS["guided" if chosen.rules.guided else "lost-in-space"]
    return np.ascontiguousarray(method.hints(frames, None, chosen.c_sd))


def _empty_history(frames: FrameBatch, n: int) -> layout.History:
    count = frames.n_frames
    return layout.History(
        x=np.empty((count, n)),
        sd=np.empty((count, n)),
        nis=np.empty(count),
        log_determinant=np.empty(count),
        arcs=np.empty(count, np.int64),
        innovation=np.full(layout.ROOM * frames.n_stars, np.nan),
        innovations=np.empty(count, np.int64),
        noise_scale=np.empty(count),
        fixed=np.empty(count, np.bool_),
        matched=np.empty(count, np.int64),
        rejected=np.empty(count, np.int64),
        iterations=np.empty(count, np.int64),
        event=np.empty(count, np.int8),
        on_baseline=np.empty(count, np.bool_),
    )


def _stretch_of(history: layout.History, frames: slice, a: int, b: int) -> layout.History:
    """Return views of a stretch of frames, its stars being a..b."""
    views = {name: getattr(history, name)[frames] for name in history._fields}
    return layout.History(
        **views | {"innovation": history.innovation[layout.ROOM * a : layout.ROOM * b]}
    )


def _frame_history(
    history: layout.History, frames: FrameBatch, baseline: MatchedFrames
) -> FrameHistory:
    # A frame has room for more innovations than it can have.
    place = np.arange(len(history.innovation))
    first = layout.ROOM * frames.star_offsets[:-1:EXPOSURES_PER_FRAME]
    frame = np.repeat(np.arange(frames.n_frames), np.diff(np.append(first, len(place))))
    used = place - first[frame] < history.innovations[frame]
    columns = history._asdict() | {"innovation": history.innovation[used]}
    return FrameHistory(
        frame_id=frames.frame_id,
        t_tai_ns=frames.t_tai_ns,
        temperature_c=frames.temperature_c,
        fixed_baseline=baseline.frame_solved,
        matched_baseline=baseline.matches_per_frame,
        **columns,
    )


@dataclass(frozen=True)
class Run:
    """A filter that has gone through the frames: its state, history, and the matches on the way."""

    filter: Filter
    state: FilterState
    history: FrameHistory
    matched: list[MatchedFrames]

    @property
    def camera_parameters(self) -> Floats:
        """(P,) the final camera parameters, at the reference temperature."""
        return self.filter.parameters(self.state.x)


def run_filter(
    chosen: Filter,
    baseline: Sequence[MatchedFrames],
    state: FilterState,
    before: FrameHistory | None = None,
    on_fragment: Callable[[], None] = lambda: None,
) -> Run:
    """Take a filter through the frames that its state has not seen.

    A smoother goes through them again, linearised at its last result, until that stays.
    """
    run = _one_pass(chosen, baseline, state, before, on_fragment)
    for _ in range(_PASSES if chosen.estimator.constant else 0):
        again = replace(
            chosen,
            model=chosen.model._replace(linearise_at=run.state.x),
            rules=chosen.rules._replace(fixed=True),
        )
        sd = np.sqrt(np.diag(chosen.covariance(run.state)))
        start = replace(state, sloped_at=run.state.x)
        latest = _one_pass(again, baseline, start, before, lambda: None)
        moved = float(np.abs((latest.state.x - run.state.x) / sd).max())
        run = replace(latest, filter=chosen)
        if not moved > _SETTLED_SD:
            break
    return run


def _one_pass(
    chosen: Filter,
    baseline: Sequence[MatchedFrames],
    state: FilterState,
    before: FrameHistory | None,
    on_fragment: Callable[[], None],
) -> Run:
    histories = [] if before is None else [before]
    matched = []
    for fragment in baseline:
        new = unseen(fragment, state)
        if new.frames.n_frames:
            state, history, found = filter_fragment(chosen, new, state)
            histories.append(history)
            matched.append(found)
        on_fragment()
    if not histories:
        raise UsageError("the state has seen all frames of this time range")
    return Run(chosen, state, join_histories(histories), matched)


def unseen(matched: MatchedFrames, state: FilterState) -> MatchedFrames:
    """Return the frames after the last one that a state has seen."""
    if state.last_t_tai_ns is None or state.last_frame_id is None:
        return matched
    frames = matched.frames
    later = frames.t_tai_ns > state.last_t_tai_ns
    at_once = (frames.t_tai_ns == state.last_t_tai_ns) & (frames.frame_id > state.last_frame_id)
    return matched.take(later | at_once)
