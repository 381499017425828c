"""Matches of two views from targets that are labelled in both: points of their ellipses or true boxes."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

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
    places: dict[str, dict[tuple[int, int, int], Floats]] = {}
    for chunk in chunks:
        table = _boxes(chunk) if isinstance(chunk, TruthBoxes) else _ellipses(chunk)
        for t_ns, sensor, target, x, y, reach in zip(*table, strict=True):
            for side in (-1, 1) if points == "ends" else (0,):
                places.setdefault(sensor, {})[int(t_ns), int(target), side] = np.array([x, y + side * reach])
    out = []
    for a, b in combinations(sorted(places), 2):
        both = [key for key in places[a] if key in places[b]]
        if not both:
            continue
        chosen = [both[k] for k in np.unique(np.linspace(0, len(both) - 1, min(len(both), MOST)).astype(int))]
        first, second = (np.array([places[name][key] for key in chosen]) for name in (a, b))
        out.append(Matches(a, b, first, second, f"{where}: {a} and {b}"))
    return tuple(out)


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
