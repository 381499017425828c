"""How often `compare` finds a difference between runs that do not differ, and how often a small loss of IDF1.

Made-up trackers of ten people at 10 Hz: they lose a person for some seconds, find some of them again as somebody else,
and err by noise that stays for a second.  Two runs draw everything anew, but share where it is hard: runs of one kind
are exchangeable.  `OCCLOG_COMPARE_PAIRS` says how many pairs.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from occlog.array_types import Floats
from occlog.core.metrics.frame_pairs import Objects, of_points
from occlog.core.metrics.frame_sums import FIGURES, LASTING, frame_sums
from occlog.core.metrics.paired import compare

NAME = "compare-null"
SUMMARY = "paired comparisons of runs that do not differ: share of false alarms at 1 % to what may be (1.5 %)"
LIMIT = 1.0
PAIRS = int(os.environ.get("OCCLOG_COMPARE_PAIRS", "200"))
PEOPLE, HZ = 10, 10
ALPHA, MOST = 0.01, 0.015
LOSS_S, HARD_S, MEMORY_S = 2.0, 15.0, 1.0
"""How long a person is lost, how long a hard time is, and how long an error stays, on average."""
RENAMED = 0.05
"""Share of people who are somebody else when they are found again."""
EASY, WORSE = 0.010, 0.014
"""Losses a person and second in an easy time."""
SHAPES = {"one of 5 min": (1, 300), "four of 60 s": (4, 60), "twelve of 30 s": (12, 30)}
"""Recordings: how many, and how long [s]."""


def track(hard: np.ndarray, rate: float, rng: np.random.Generator) -> Floats:
    """What each frame adds to the figures, of one run of a tracker.

    Args:
        hard: (T,) how much more often people are lost at a time.
        rate: of losses a person and second in an easy time.
        rng: draws what the tracker does.
    """
    frames = len(hard)
    place = np.column_stack([np.repeat(np.arange(PEOPLE) * 10.0, frames), np.zeros(PEOPLE * frames)])
    frame, who = np.tile(np.arange(frames), PEOPLE), np.repeat(np.arange(PEOPLE), frames)
    there = np.ones((PEOPLE, frames), dtype=np.bool_)
    name = np.tile(np.arange(PEOPLE)[:, None], (1, frames))
    fresh = PEOPLE
    for k in range(PEOPLE):
        for begin in np.flatnonzero(rng.random(frames) < rate * hard / HZ):
            end = min(begin + 1 + int(rng.exponential(LOSS_S * HZ)), frames)
            there[k, begin:end] = False
            if rng.random() < RENAMED:  # found again as somebody else
                name[k, end:] = fresh
                fresh += 1
    keep = np.exp(-1.0 / (MEMORY_S * HZ))
    noise = rng.normal(0, 0.15 * np.sqrt(1 - keep**2), (frames, PEOPLE, 2))
    for t in range(1, frames):
        noise[t] += keep * noise[t - 1]
    found = place + noise.transpose(1, 0, 2).reshape(-1, 2)
    seen = there.ravel()
    truth, tracks = Objects(frame, who, place), Objects(frame[seen], name.ravel()[seen], found[seen])
    return frame_sums(of_points(truth, tracks, 1.0), frames)


def times(frames: int, rng: np.random.Generator) -> np.ndarray:
    """(T,) easy times and hard ones, six times as hard."""
    state, out = False, np.ones(frames)
    for t in range(frames):
        state ^= rng.random() < 1.0 / (HARD_S * HZ)
        out[t] = 6.0 if state else 1.0
    return out


def pair(shape: str, rates: tuple[float, float], seed: int) -> dict[str, tuple[float, float, float]]:
    """Difference, p and p of being worse, of each figure of two runs on the same recordings."""
    count, seconds = SHAPES[shape]
    rng = np.random.default_rng(seed)
    hard = [times(seconds * HZ, rng) for _ in range(count)]
    runs = [[track(each, rate, rng) for each in hard] for rate in rates]
    out = {}
    for name in ("idf1", "mota", "hota", "pairs_rmse"):
        found = compare(*runs, FIGURES[name], rng, lasting=name in LASTING)
        worse = found.above(0.0) if name == "pairs_rmse" else found.below(0.0)
        out[name] = (found.difference, found.p, worse)
    return out


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Share of false alarms of `idf1 worse`, the worst of all shapes of recordings, to the limit."""
    parts: dict[str, float] = {"pairs of each shape": PAIRS}
    worst = 0.0
    for number, shape in enumerate(SHAPES):
        null = [pair(shape, (EASY, EASY), 10**6 * (number + 1) + k) for k in range(PAIRS)]
        for name in null[0]:
            alarms = np.array([each[name][2] < ALPHA for each in null])
            open_ = np.mean([np.isnan(each[name][1]) for each in null])
            parts[f"{shape}, {name}: false alarms of 'worse' [%]"] = 100 * float(alarms.mean())
            parts[f"{shape}, {name}: not decided [%]"] = 100 * float(open_)
            worst = max(worst, float(alarms.mean())) if name == "idf1" else worst
        lost = [pair(shape, (EASY, WORSE), 10**7 * (number + 1) + k) for k in range(max(PAIRS // 5, 20))]
        parts[f"{shape}: loss of IDF1 [points]"] = -100 * float(np.mean([each["idf1"][0] for each in lost]))
        parts[f"{shape}: found [%]"] = 100 * float(np.mean([each["idf1"][2] < ALPHA for each in lost]))
    return {"ratio": worst / MOST, "limit": LIMIT, "parts": parts}
