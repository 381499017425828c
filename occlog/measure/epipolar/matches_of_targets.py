"""Matches of two views from targets that are labelled in both: points of their ellipses or true boxes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from occlog.array_types import Floats
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import TruthBoxes
from occlog.records.view_pairs import Matches

MOST = 2_000
"""Matches of a pair that are used; of more, those of moments drawn at random, of each all targets and both ends."""
SEED = 6
"""Of that draw."""
VISIBLE = 0.8
"""Boxes of targets of which less than this is visible are left out: what is drawn there is a guess."""


def matches_of_tracks(
    chunks: Iterable[ViewTracks] | Iterable[TruthBoxes], where: str, points: str = "centres", window_ns: int = 0
) -> tuple[Matches, ...]:
    """Points of the same target at the same time in two views, for each pair of views that has some.

    Args:
        chunks: in the order of time.
        where: what they come from, for messages.
        points: `centres`, or `ends`, the tops and the bottoms.  People's middles are all at about one
            height, so that their centres lie on a plane and tell no matrix; their heads and feet do.
        window_ns: rows at most so far apart are of one time, unless a view speaks twice.
    """
    sides = (-1, 1) if points == "ends" else (0,)
    samples: dict[tuple[str, str], _Sample] = {}
    for moment in _moments(_times(chunks), window_ns):
        for a, b in combinations(sorted(moment), 2):
            both = [(moment[a][target], moment[b][target]) for target in moment[a] if target in moment[b]]
            if both:
                block = [[xy + np.array([0.0, side * r]) for xy, r in pair] for pair in both for side in sides]
                samples.setdefault((a, b), _Sample()).add(np.array(block))
    return tuple(samples[pair].matches(*pair, f"{where}: {pair[0]} and {pair[1]}") for pair in sorted(samples))


@dataclass
class _Sample:
    """Matches of moments drawn at random, never much more than twice `MOST` of them.

    Whole moments, because matches come in a fixed order: equal steps may fall on the same
    targets, or the same ends, each time.
    """

    kept: list[tuple[float, Floats]] = field(default_factory=list)  # (lot, matches) of each moment
    size: int = 0
    share: float = 1.0  # lots below this are kept
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(SEED))

    def add(self, block: Floats) -> None:
        """Keep the (N, 2, 2) matches of a moment if its lot is low; with too many matches half of the lots go."""
        lot = float(self.rng.random())
        if lot < self.share:
            self.kept.append((lot, block))
            self.size += len(block)
        while self.size >= 2 * MOST and len(self.kept) > 1:
            self.share *= 0.5
            self.kept = [(lot, block) for lot, block in self.kept if lot < self.share] or self.kept[:1]
            self.size = sum(len(block) for _, block in self.kept)

    def matches(self, a: str, b: str, where: str) -> Matches:
        """What was kept, at most `MOST`, but at least a moment."""
        lots = np.array([lot for lot, _ in self.kept])
        order = np.argsort(lots)
        sizes = np.cumsum([len(self.kept[k][1]) for k in order])
        chosen = order[: max(int(np.searchsorted(sizes, MOST, side="right")), 1)]
        both = np.concatenate([self.kept[k][1] for k in np.sort(chosen)])
        return Matches(a, b, both[:, 0], both[:, 1], where)


Shown = dict[int, tuple[Floats, float]]
"""Centres of targets and how far they reach up and down."""
Moment = dict[str, Shown]
"""The same by view."""


def _moments(times: Iterable[tuple[int, Moment]], window_ns: int) -> Iterator[Moment]:
    """What the views show at times at most a window apart, each view at one of them."""
    moment: Moment = {}
    begin = 0
    for t_ns, shown in times:
        if moment and (t_ns - begin > window_ns or moment.keys() & shown.keys()):
            yield moment
            moment = {}
        if not moment:
            begin = t_ns
        moment = {**moment, **shown}
    if moment:
        yield moment


def _times(chunks: Iterable[ViewTracks] | Iterable[TruthBoxes]) -> Iterator[tuple[int, Moment]]:
    """Each time with what the views show at it; where chunks are cut does not matter."""
    shown: Moment = {}
    last = 0
    for chunk in chunks:
        table = _boxes(chunk) if isinstance(chunk, TruthBoxes) else _ellipses(chunk)
        for t_ns, sensor, target, x, y, reach in zip(*table, strict=True):
            if shown and t_ns != last:
                yield last, shown
                shown = {}
            last = int(t_ns)
            shown.setdefault(str(sensor), {})[int(target)] = (np.array([x, y]), float(reach))
    if shown:
        yield last, shown


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
