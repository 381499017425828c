"""How often `compare` finds a difference between runs that do not differ, and how often a small loss of IDF1.

Made-up trackers of ten people at 10 Hz: they lose a person for some seconds, find some of them again as somebody else,
and err by noise that stays for a second.  Two runs draw everything anew, but share where it is hard: runs of one kind
are exchangeable.  There are `RUNS` runs of each recording, and pairs are drawn of them; the standard error is between
groups of `TOGETHER` runs, which share none.  `OCCLOG_COMPARE_PAIRS` says how many pairs of each shape there are,
`OCCLOG_COMPARE_CACHE` names a folder that keeps the runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_points
from occlog.core.metrics.mot.frame_sums import FIGURES, LASTING, frame_sums
from occlog.core.metrics.paired import compare

NAME = "compare-null"
SUMMARY = "paired comparisons of runs that do not differ: share of false alarms at 1 % to what may be (1.5 %)"
LIMIT = 1.0
PAIRS = int(os.environ.get("OCCLOG_COMPARE_PAIRS", "1000"))
CACHE = os.environ.get("OCCLOG_COMPARE_CACHE")
PEOPLE, HZ = 10, 10
ALPHA, MOST = 0.01, 0.015
LOSS_S, HARD_S, MEMORY_S = 2.0, 15.0, 1.0
"""How long a person is lost, how long a hard time is, and how long an error stays, on average."""
RENAMED = 0.05
"""Share of people who are somebody else when they are found again."""
EASY, WORSE = 0.010, 0.014
"""Losses a person and second in an easy time."""
RUNS, TOGETHER = 24, 4
SHOWN = ("idf1", "hota", "mota", "matched_rmse")


class Shape(NamedTuple):
    """Recordings of a comparison, and of how many they are drawn."""

    taken: int
    seconds: int
    known: int


SHAPES = {
    "eight of 30 s": Shape(8, 30, 20),
    "ten of 30 s": Shape(10, 30, 20),
    "twelve of 30 s": Shape(12, 30, 20),
    "twenty of 30 s": Shape(20, 30, 20),
    "four of 60 s": Shape(4, 60, 4),
}


def track(hard: np.ndarray, rate: float, rng: np.random.Generator) -> MatchedFrames:
    """Truth and tracks of one run of a tracker.

    Args:
        hard: (T,) how much more often people are lost at a time.
        rate: of losses a person and second in an easy time.
        rng: draws what the tracker does.
    """
    frames = len(hard)
    position = np.column_stack([np.repeat(np.arange(PEOPLE) * 10.0, frames), np.zeros(PEOPLE * frames)])
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
    found = position + noise.transpose(1, 0, 2).reshape(-1, 2)
    seen = there.ravel()
    truth, tracks = Objects(frame, who, position), Objects(frame[seen], name.ravel()[seen], found[seen])
    return of_points(truth, tracks, 1.0)


def times(frames: int, rng: np.random.Generator) -> np.ndarray:
    """(T,) easy times and hard ones, six times as hard."""
    state, out = False, np.ones(frames)
    for t in range(frames):
        state ^= rng.random() < 1.0 / (HARD_S * HZ)
        out[t] = 6.0 if state else 1.0
    return out


Run = tuple[int, int, float, int]
"""Recording, its length [s], rate of losses, number of the run."""


@cache
def made(run: Run) -> MatchedFrames:
    """Truth and tracks of a run."""
    recording, seconds, rate, number = run
    hard = times(seconds * HZ, np.random.default_rng([recording, seconds]))
    return track(hard, rate, np.random.default_rng([recording, seconds, round(1e6 * rate), number]))


@cache
def sums(run: Run) -> Floats:
    """What each frame of a run adds to the figures."""
    return kept("frames", run, lambda: frame_sums(made(run), run[1] * HZ))


def kept(kind: str, key: tuple[float, ...], make: Callable[[], Floats]) -> Floats:
    """A value of the folder that keeps runs; it is made if it is not there."""
    if CACHE is None:
        return make()
    path = Path(CACHE) / f"{kind}-{'-'.join(f'{part:g}' for part in key)}.npy"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_suffix(".draft.npy")
        np.save(draft, make())
        draft.rename(path)
    return np.asarray(np.load(path))


def pair(shape: Shape, later: float, runs: list[int], rng: np.random.Generator) -> dict[str, tuple[float, ...]]:
    """Difference, p and p of being worse of each figure, of two runs on the same recordings."""
    both: list[tuple[Run, Run]] = []
    for recording in rng.permutation(shape.known)[: shape.taken].tolist():
        a, b = rng.permutation(runs)[:2].tolist()
        both.append(((recording, shape.seconds, EASY, a), (recording, shape.seconds, later, b)))
    first, second = ([sums(run) for run in side] for side in zip(*both, strict=True))
    out: dict[str, tuple[float, ...]] = {}
    for name in SHOWN:
        found = compare(first, second, FIGURES[name], rng, lasting=name in LASTING)
        worse = found.above(0.0) if name == "matched_rmse" else found.below(0.0)
        out[name] = (found.difference, found.p, worse)
    return out


def pairs(shape: Shape, later: float, count: int) -> list[list[dict[str, tuple[float, ...]]]]:
    """So many pairs, in groups that share no runs."""
    groups = [list(range(k, k + TOGETHER)) for k in range(0, RUNS, TOGETHER)]
    each = -(-count // len(groups))
    seeds = [np.random.default_rng([shape.taken, shape.seconds, k]) for k in range(len(groups))]
    return [[pair(shape, later, own, rng) for _ in range(each)] for own, rng in zip(groups, seeds, strict=True)]


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Share of false alarms of `idf1 worse`, the worst of all shapes of recordings, to the limit."""
    parts: dict[str, float] = {"pairs of each shape": PAIRS}
    worst = 0.0
    for reported, shape in SHAPES.items():
        null = pairs(shape, EASY, PAIRS)
        for name in SHOWN:
            alarms = [float(np.mean([each[name][2] < ALPHA for each in own])) for own in null]
            open_ = np.mean([np.isnan(each[name][1]) for own in null for each in own])
            parts[f"{reported}, {name}: false alarms of 'worse' [%]"] = 100 * float(np.mean(alarms))
            parts[f"{reported}, {name}: +- [%]"] = 100 * float(np.std(alarms, ddof=1) / np.sqrt(len(alarms)))
            parts[f"{reported}, {name}: not decided [%]"] = 100 * float(open_)
            worst = max(worst, float(np.mean(alarms))) if name == "idf1" else worst
        if shape.seconds > SHAPES["twelve of 30 s"].seconds:
            continue
        lost = [each["idf1"] for own in pairs(shape, WORSE, PAIRS // 4) for each in own]
        parts[f"{reported}: loss of IDF1 [points]"] = -100 * float(np.mean([each[0] for each in lost]))
        parts[f"{reported}: found [%]"] = 100 * float(np.mean([each[2] < ALPHA for each in lost]))
    return {"ratio": worst / MOST, "limit": LIMIT, "parts": parts}
