"""Matches of two views from targets that are labelled in both: points of their ellipses or true boxes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from ..columns import Floats
from ..records import TruthBoxes
from ..view_pairs import Matches
from ..view_records import ViewTracks

MOST = 2_000
"""Matches of a pair that are used; of more, so many at equal steps."""
POINTS = ("centres", "ends")
"""Centres, or the top and the bottom: people's middles are all at about one height, so that their centres lie on a
plane and tell no matrix, but heads and feet do."""
VISIBLE = 0.8
"""Boxes of targets of which less than this is visible are left out: what is drawn there is a guess."""


def matches_of_tracks(
    chunks: Iterable[ViewTracks] | Iterable[TruthBoxes], where: str, points: str = "centres"
) -> tuple[Matches, ...]:
    """Points of the same target at the same time in two views, for each pair of views that has some.

    Args:
        chunks: in the order of time.
        where: what they come from, for messages.
        points: one of `POINTS`.
    """
    sides = (-1, 1) if points == "ends" else (0,)
    samples: dict[tuple[str, str], _Sample] = {}
    for moment in _moments(chunks):
        for a, b in combinations(sorted(moment), 2):
            for target in moment[a]:
                if target not in moment[b]:
                    continue
                sample = samples.setdefault((a, b), _Sample())
                for side in sides:
                    sample.add([xy + side * np.array([0.0, r]) for xy, r in (moment[a][target], moment[b][target])])
    return tuple(samples[pair].matches(*pair, f"{where}: {pair[0]} and {pair[1]}") for pair in sorted(samples))


@dataclass
class _Sample:
    """Matches at equal steps, at most about twice `MOST` of them at any time."""

    kept: list[Any] = field(default_factory=list)
    step: int = 1
    seen: int = 0

    def add(self, match: Any) -> None:
        """Keep every `step`-th match; with too many every other one of them is dropped."""
        if self.seen % self.step == 0:
            self.kept.append(match)
        self.seen += 1
        if len(self.kept) >= 2 * MOST:
            self.kept, self.step = self.kept[::2], 2 * self.step

    def matches(self, a: str, b: str, where: str) -> Matches:
        """What was kept, at most `MOST`."""
        rows = np.unique(np.linspace(0, len(self.kept) - 1, min(len(self.kept), MOST)).astype(int))
        both = np.array(self.kept)[rows]
        return Matches(a, b, both[:, 0], both[:, 1], where)


Moment = dict[str, dict[int, tuple[Floats, float]]]
"""Centres of targets and how far they reach up and down, by view and target."""


def _moments(chunks: Iterable[ViewTracks] | Iterable[TruthBoxes]) -> Iterator[Moment]:
    """What the views show at each time; where chunks are cut does not matter."""
    moment: Moment = {}
    last: int | None = None
    for chunk in chunks:
        table = _boxes(chunk) if isinstance(chunk, TruthBoxes) else _ellipses(chunk)
        for t_ns, sensor, target, x, y, reach in zip(*table, strict=True):
            if t_ns != last:
                yield moment
                moment, last = {}, t_ns
            moment.setdefault(sensor, {})[int(target)] = (np.array([x, y]), float(reach))
    yield moment


Columns = tuple[np.ndarray, np.ndarray, np.ndarray, Floats, Floats, Floats]
"""Time, sensor, target, centre, and how far the target reaches up and down from it."""


def _ellipses(table: ViewTracks) -> Columns:
    good = table.take(~np.isin(table.event, ("left", "lost")))
    reach = np.hypot(good.a_px * np.sin(good.rho), good.b_px * np.cos(good.rho))
    return good.t_ns, good.sensor, good.target_id, good.x_px, good.y_px, reach


def _boxes(table: TruthBoxes) -> Columns:
    good = table.take((table.box >= 0) & (table.target_id >= 0) & ~(table.visible < VISIBLE))
    half = 0.5 * good.height_px
    return good.t_ns, good.sensor, good.target_id, good.left_px + 0.5 * good.width_px, good.top_px + half, half
