"""Check of the fundamental matrices against what is tracked: the loop check of [Qu] Sec. 3.4.2 on free targets.

Only targets that touch no other in both views count: the tracker of a hidden target may be
off it, which is no fault of the geometry.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.image.ellipse import touching
from occlog.measure.epipolar.views import Geometry
from occlog.track.images.births.loop_distances import loop_distances, radius
from occlog.track.images.interface import Birth, Outlines, TrackerKey

NO_TRACKERS: Mapping[TrackerKey, Floats] = MappingProxyType({})
FEWEST = 3
"""Checked starts of targets below which they say nothing about a fundamental matrix."""

StartCounts = Mapping[tuple[int, int], tuple[int, int]]
"""For pairs of views the number of checked starts of targets, and how many of these failed."""


class Checks(NamedTuple):
    """N loop checks of a target in two views; a check fails above 1 radius."""

    first: Floats  # (N,) the lower view of the two, a whole number
    second: Floats  # (N,) the higher view
    radii: Floats  # (N,) larger one of the two distances from a line, in radii of the target in that view
    px: Floats  # (N,) the same in pixels, by the mean of the two radii


def no_checks() -> Checks:
    """No loop check."""
    return Checks(*(np.zeros(0) for _ in range(4)))


def gather(parts: Sequence[Checks]) -> Checks:
    """Join loop checks."""
    return Checks(*(np.concatenate(columns) for columns in zip(*parts, strict=True))) if parts else no_checks()


def check_outlines(outlines: Outlines, geometry: Geometry, bottom: bool = False) -> Checks:
    """Check the targets that touch no other in either view.

    Args:
        outlines: of one moment.
        geometry: of the views.
        bottom: the lowest points of ellipses are compared with epipolar lines; else their centres.
    """
    return _checks(_free(outlines.view, outlines.target_id, outlines.ellipse), geometry, bottom)


def check_births(
    births: Sequence[Birth],
    geometry: Geometry,
    trackers: Mapping[TrackerKey, Floats] = NO_TRACKERS,
    bottom: bool = False,
) -> Checks:
    """Check the ellipses that trackers start with, against one another and against trackers of other views.

    Args:
        births: of one moment.
        geometry: of the views.
        trackers: ellipses of the same time of trackers that there are.
        bottom: see `check_outlines`.
    """
    if not births:
        return no_checks()
    rows = {**trackers, **{(b.view, b.target_id): b.ellipse for b in births}}
    view, target = (np.array(numbers) for numbers in zip(*rows, strict=True))
    return _checks(
        _free(view, target, np.array(list(rows.values()))), geometry, bottom, {(b.view, b.target_id) for b in births}
    )


def _free(view: Ints, target: Ints, ellipses: Floats) -> dict[TrackerKey, Floats]:
    """The ellipses (n, 5) that touch no other of their view (n,), by view and target."""
    rows = {}
    for v in np.unique(view).tolist():
        mine = np.flatnonzero(view == v)
        alone = mine[~touching(ellipses[mine]).any(axis=1)]
        rows.update({(v, t): e for t, e in zip(target[alone].tolist(), ellipses[alone], strict=True)})
    return rows


def _checks(
    rows: Mapping[TrackerKey, Floats], geometry: Geometry, bottom: bool, born: Collection[TrackerKey] | None = None
) -> Checks:
    """Check each target in each pair of views; with `born` only those with a tracker in it."""
    parts = []
    known = np.isfinite(geometry.fundamental).all(axis=(2, 3))
    for a, b in zip(*(places.tolist() for places in np.nonzero(np.triu(known, 1))), strict=True):
        shared = [t for v, t in rows if v == a and (b, t) in rows]
        if born is not None:
            shared = [t for t in shared if (a, t) in born or (b, t) in born]
        if shared:
            of_a, of_b = (np.array([rows[v, t] for t in shared]) for v in (a, b))
            radii = loop_distances(geometry, a, b, of_a, of_b, bottom)
            n = len(shared)
            size = 0.5 * (radius(of_a) + radius(of_b))
            parts.append(Checks(np.full(n, float(a)), np.full(n, float(b)), radii, radii * size))
    return gather(parts)


def without_contradicted(
    geometry: Geometry, checks: Checks, counts: StartCounts
) -> tuple[Geometry, StartCounts, tuple[tuple[int, int], ...]]:
    """Drop the matrices of pairs of views that more than half of the first targets contradict.

    `FEWEST` checked starts decide, and those of the same moment; later ones change nothing.

    Args:
        geometry: that is in use.
        checks: of the births of one moment.
        counts: of the moments before.

    Returns:
        The geometry; the counts with the checks; the pairs of views that lost their matrix now.
    """
    matrices, after, dropped = geometry.fundamental.copy(), dict(counts), []
    for a, b in sorted(set(zip(checks.first.astype(int).tolist(), checks.second.astype(int).tolist(), strict=True))):
        n, failed = counts.get((a, b), (0, 0))
        if n >= FEWEST:
            continue
        mine = checks.radii[(checks.first == a) & (checks.second == b)]
        n, failed = after[a, b] = n + len(mine), failed + int((mine > 1.0).sum())
        if n >= FEWEST and 2 * failed > n:
            matrices[a, b] = matrices[b, a] = np.nan
            dropped.append((a, b))
    return geometry._replace(fundamental=matrices) if dropped else geometry, after, tuple(dropped)
