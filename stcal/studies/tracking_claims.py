"""What filters should do on a camera that changes: the claims of the study ``tracking``."""

from __future__ import annotations

from stcal.studies.findings import FAILS, HOLDS, PARTLY, Claim

FOLLOWING = Claim(
    "With process noise the filter follows a drifting focal length",
    "normal errors",
    "The truth lies within 3 sd in nearly all frames (99.7 %).",
    {
        HOLDS: "A random walk lets new frames count more than old ones: the filter forgets.",
        FAILS: "The walk does not fit this drift: see the share at three times the process noise.",
    },
)
HONEST = Claim(
    "Its band has the right width",
    "normal errors",
    "The truth lies within 1 sd in 68 % of the frames, and the rms of error / sd is 1.",
    {
        HOLDS: "The walk expects about as much as the focal length moves within the filter's "
        "memory.",
        FAILS: "A band too wide means more process noise than the drift needs, one too narrow "
        "less.",
    },
)
LOST_TRACK = Claim(
    "Without process noise it does not follow",
    "Enright 2018, II-D",
    "Constants are averages over all frames: the truth leaves their band, and the errors grow.",
    {
        HOLDS: "The more frames it has seen, the less a new one can move it; the other parameters "
        "bend to explain the drift.",
        FAILS: "The drift is too small, or the run too short, to show.",
    },
)
WIDTH = Claim(
    "Less process noise lags, more of it is noisy",
    "trade-off of a random walk",
    "Both a third and three times the process noise give a larger rms error.",
    {
        HOLDS: "A third averages over more frames than the drift allows; three times averages "
        "over fewer than it could.",
        PARTLY: "The process noise chosen is not the best one for this run, but near it.",
        FAILS: "The process noise chosen does not suit this run.",
    },
)
THERMAL = Claim(
    "Linear in temperature, it follows best",
    "exact model",
    "Smaller errors than any random walk, and no lag, since all frames determine one slope.",
    {
        HOLDS: "The drift is exactly linear in the telemetered temperature here, which says when "
        "the focal length moves; a walk must see it first.",
        PARTLY: "The errors are smaller, but the truth leaves their band.",
        FAILS: "The slope is not yet determined, or the model was not chosen.",
    },
)
EVIDENCE = Claim(
    "The temperature model is chosen only when the data support it",
    "Kass & Raftery 1995",
    "Chosen on the drift; not chosen on the constant camera, though its temperature swings too.",
    {
        HOLDS: "The evidence charges a slope for the range that it might have taken: one that the "
        "data put at zero loses.",
        FAILS: "The evidence decided against the truth in some run.",
    },
)
STEP = Claim(
    "With process noise the filter comes back after a step, without it does not",
    "Enright 2018, II-D",
    "The truth is within 3 sd again after a few frames, and stays; never without process noise.",
    {
        HOLDS: "A walk that expects 0.06 sigma from frame to frame takes a step of 2 sigma in a "
        "few of them; constants would have to forget all frames before it.",
        PARTLY: "One of the two does not behave as expected: see the table.",
        FAILS: "The walk is too small for this step.",
    },
)
IGNORANCE = Claim(
    "Process noise on every parameter follows too, at the price of noise",
    "degenerate parameters",
    "Who does not know which parameter moves can let all of them; errors grow along the weakly "
    "observable directions.",
    {
        HOLDS: "Eight walks share what a frame tells: along weak directions each of them covers "
        "for the others.",
        PARTLY: "It follows in one of the cases only, or does not cost anything.",
        FAILS: "The walk is too small for what moves.",
    },
)
WATCH = Claim(
    "The watch leaves a filter alone that follows",
    "stcal",
    "No variant falls back to the initial calibration: drift and step are smaller than what takes "
    "stars away.",
    {
        HOLDS: "Even without process noise the estimate is closer to the truth than the initial "
        "calibration, so it never loses stars against it.",
        FAILS: "A fallback throws away what the filter knew: its cause is in the history.",
    },
)
