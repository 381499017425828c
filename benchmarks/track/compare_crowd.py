"""False alarms and power of `compare` on recordings of a real crowd, with tracks of a real tracker.

    python -m benchmarks.track.compare_crowd --cache DIR [--seeds 24] [--pairs 1000] [--json]

Recordings are five stretches of 20 s of WILDTRACK at the four settings of `crowd` (20 of them), or all 100 s of it.
A null pair is `jipda` on boxes with errors of two seeds, drawn for each recording; or on the same boxes with edges
moved by half a pixel; the worse method is `jipda` that gives people up early, on the same boxes or on those of another
seed.  Pairs share outputs: the standard error is between groups of four seeds (of eight where it is worse), which
share none.  A loss of 2 points is what is left of the mean loss beside a margin, as with `idf1 worse by MARGIN`.

The first run tracks for about 3 s of one core for each seed, setting and method; what is tracked stays in the folder.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.track._compare_crowd_runs import FRAMES, STRETCH, frames_of, tracks
from benchmarks.track._crowd_cases import DEGREES
from occlog.array_types import Floats
from occlog.core.metrics.mot.frame_pairs import MatchedFrames
from occlog.core.metrics.mot.frame_sums import FIGURES, LASTING, LESS_IS_BETTER, frame_sums
from occlog.core.metrics.paired import PairedDifference, compare

ALPHA = 0.01
SHOWN = ("idf1", "hota", "mota", "matched_rmse")
TOGETHER = 4
"""Seeds of a group; groups share no tracks."""
LOSS = 0.02
"""Loss of IDF1 that is to be found."""
STRETCHES: tuple[int | None, ...] = tuple(range(FRAMES // STRETCH))


class Run(NamedTuple):
    """Tracks of one recording: who made them, of which boxes; stretch None: all of it."""

    tracker: str
    level: str
    segment: int | None
    seed: int
    moved: int = 0


Pair = tuple[Run, Run]


class Crowd:
    """Runs as they are asked for."""

    def __init__(self, folder: Path) -> None:
        """With the folder that keeps tracks."""
        self._folder = folder
        self.frames = cache(self._frames)
        self.sums = cache(self._sums)

    def _frames(self, run: Run) -> MatchedFrames:
        return frames_of(tracks(run.tracker, run.level, run.seed, self._folder, run.moved), run.segment)

    def _sums(self, run: Run) -> Floats:
        return frame_sums(self.frames(run), FRAMES if run.segment is None else STRETCH)

    def compared(self, pairs: list[Pair], figure: str) -> PairedDifference:
        """The later runs beside the first ones, recording by recording."""
        a, b = ([self.sums(run) for run in side] for side in zip(*pairs, strict=True))
        rng = np.random.default_rng(0)
        return compare(a, b, FIGURES[figure], rng, lasting=figure in LASTING)


Draw = Callable[[np.random.Generator, list[int], int], list[Pair]]
"""Pairs of so many recordings, of these seeds."""


def recordings(rng: np.random.Generator, count: int, *, whole: bool) -> Iterator[tuple[str, int | None]]:
    """Setting and stretch: those of 20 s differ, as far as there are as many."""
    known = [(level, segment) for level in DEGREES for segment in ((None,) if whole else STRETCHES)]
    order = np.concatenate([rng.permutation(len(known)) for _ in range(-(-count // len(known)))])
    yield from (known[k] for k in order[:count])


def other_boxes(later: str, *, whole: bool = False) -> Draw:
    """`jipda` beside a method on boxes of another seed; each run of a recording takes part once at most."""

    def draw(rng: np.random.Generator, seeds: list[int], count: int) -> list[Pair]:
        left: dict[tuple[str, int | None], list[int]] = {}
        out = []
        for place in recordings(rng, count, whole=whole):
            own = left.setdefault(place, rng.permutation(seeds).tolist())
            if len(own) < 2:
                raise ValueError("too few seeds")
            out.append((Run("jipda", *place, own.pop()), Run(later, *place, own.pop())))
        return out

    return draw


def same_boxes(later: str, *, whole: bool = False) -> Draw:
    """`jipda` beside a method on the same boxes; `moved`: beside itself, with edges moved by half a pixel in both."""

    def draw(rng: np.random.Generator, seeds: list[int], count: int) -> list[Pair]:
        left: dict[tuple[str, int | None], list[int]] = {}
        out = []
        for place in recordings(rng, count, whole=whole):
            seed = left.setdefault(place, rng.permutation(seeds).tolist()).pop()
            if later == "moved":
                one, two = rng.permutation([1, 2]).tolist()
                out.append((Run("jipda", *place, seed, one), Run("jipda", *place, seed, two)))
            else:
                out.append((Run("jipda", *place, seed), Run(later, *place, seed)))
        return out

    return draw


class Found(NamedTuple):
    """What many comparisons said of a figure."""

    rate: float
    error: float
    open: float  # not decided
    loss: float  # mean of how much worse the later one is


def found(
    crowd: Crowd,
    draw: Draw,
    figure: str,
    count: int,
    seeds: list[list[int]],
    pairs: int,
    *,
    effect: float | None = None,
) -> Found:
    """How often `FIGURE worse` at 1 %, over groups of seeds; with an effect, by what leaves that of the mean loss."""
    sign = 1.0 if figure in LESS_IS_BETTER else -1.0
    every: list[list[PairedDifference]] = []
    for k, own in enumerate(seeds):
        rng = np.random.default_rng([count, k])
        every.append([crowd.compared(draw(rng, own, count), figure) for _ in range(-(-pairs // len(seeds)))])
    loss = float(np.mean([sign * each.difference for own in every for each in own]))
    margin = 0.0 if effect is None else loss - effect

    def alarm(each: PairedDifference) -> bool:
        chance = each.above(margin) if sign > 0 else each.below(-margin)
        return bool(chance < ALPHA)

    rates = [float(np.mean([alarm(each) for each in own])) for own in every]
    error = float(np.std(rates, ddof=1) / np.sqrt(len(rates))) if len(rates) > 1 else float("nan")
    unknown = float(np.mean([np.isnan(each.p) for own in every for each in own]))
    return Found(float(np.mean(rates)), error, unknown, loss)


def measured(crowd: Crowd, count: int, pairs: int) -> dict[str, Found]:
    """All that is measured, by what it is."""
    seeds = list(range(count))
    groups = [seeds[k : k + TOGETHER] for k in range(0, count - TOGETHER + 1, TOGETHER)]
    large = [seeds[k : k + 2 * TOGETHER] for k in range(0, 2 * count // 3 - 2 * TOGETHER + 1, 2 * TOGETHER)]
    third = [group for group in groups if group[-1] < count // 3]
    out: dict[str, Found] = {}

    def add(name: str, *given: object, **more: object) -> None:
        out[name] = found(crowd, *given, **more)  # type: ignore[arg-type]
        rate, error, unknown, loss = out[name]
        reported = f"{100 * rate:.2f} ± {100 * error:.2f} %, not decided {100 * unknown:.0f} %, mean loss {loss:+.4f}"
        print(f"{name}: {reported}", flush=True)

    for n in (8, 10, 12, 20):
        for figure in SHOWN:
            add(f"null, other boxes, {n} of 20 s, {figure}", other_boxes("jipda"), figure, n, groups, pairs)
    for n in (10, 20):
        for figure in SHOWN:
            add(f"null, same boxes, {n} of 20 s, {figure}", same_boxes("moved"), figure, n, third, pairs)
    for whole, length, sizes in ((False, 20, (10, 20, 40, 60)), (True, 100, (8, 10, 12, 16))):
        for n in sizes:
            for name, kind in (("same", same_boxes), ("other", other_boxes)):
                draw = kind("early", whole=whole)
                what = f"loss of 2 points, {name} boxes, {n} of {length} s"
                add(what, draw, "idf1", n, large, pairs // 4, effect=LOSS)
    return out


def main() -> None:
    """Measure and say."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.track.compare_crowd",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cache", type=Path, required=True, metavar="DIR", help="keeps what is tracked")
    parser.add_argument(
        "--seeds",
        type=int,
        default=24,
        help="of the errors of boxes; two thirds of them for losses, a third for moved edges",
    )
    parser.add_argument("--pairs", type=int, default=1000, help="comparisons of each kind (default 1000)")
    parser.add_argument("--json", action="store_true", help="one JSON object at the end")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    got = measured(Crowd(options.cache), options.seeds, options.pairs)
    if options.json:
        print(json.dumps({name: each._asdict() for name, each in got.items()}))


if __name__ == "__main__":
    main()
