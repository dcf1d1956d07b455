"""Times of several functions in alternating rounds, and peers that are not there."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np


def alternating_times(functions: dict[str, Callable[[], object]], rounds: int) -> dict[str, list]:
    """Time functions in turn, A B C A B C ..., and return the seconds of each round by name.

    A drifting machine then slows all of them alike.  Each is called once before.
    """
    for function in functions.values():
        function()
    times: dict[str, list] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            times[name].append(time.perf_counter() - start)
    return times


def available(makers: dict[str, Callable[[], object]]) -> tuple[dict, dict[str, str]]:
    """Make peers by name; return those that work, and why the others don't."""
    made, missing = {}, {}
    for name, maker in makers.items():
        try:
            made[name] = maker()
        except Exception as error:  # a peer may fail in any way, and the others go on
            missing[name] = f"{type(error).__name__}: {error}"
    return made, missing


def summary(seconds: list, own: list) -> dict:
    """Return the best and the median time of a peer, and how ours compares in the same rounds."""
    return {
        "best_s": min(seconds),
        "median_s": float(np.median(seconds)),
        "stcal_over_it": float(np.median(np.array(own) / np.array(seconds))),
    }
