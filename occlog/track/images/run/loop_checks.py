"""Whether the views' fundamental matrices fit what is tracked: the loop check on targets that stand free in both views.

Only those count: a target that others hide is not where its tracker is, which is no fault
of the geometry.
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
from occlog.track.images.interface import Birth, Outlines

Key = tuple[int, int]
"""View and target."""
NOBODY: Mapping[Key, Floats] = MappingProxyType({})
FEWEST = 3
"""Targets below which their starts say nothing about a fundamental matrix."""


class Checks(NamedTuple):
    """N loop checks; a check fails above 1 radius."""

    first: Floats  # (N,) views, as whole numbers; the lower one
    second: Floats
    radii: Floats  # larger distance from a line, in radii of the target in that view
    px: Floats  # the same in pixels, by the mean of the two radii


def no_checks() -> Checks:
    """None."""
    return Checks(*(np.zeros(0) for _ in range(4)))


def gather(parts: Sequence[Checks]) -> Checks:
    """All of them."""
    return Checks(*(np.concatenate(columns) for columns in zip(*parts, strict=True))) if parts else no_checks()


def check_outlines(outlines: Outlines, geometry: Geometry, bottom: bool = False) -> Checks:
    """Loop checks of the targets that touch no other in either view.

    Args:
        outlines: of one moment.
        geometry: of the views.
        bottom: the lowest points of ellipses are compared with epipolar lines; else their centres.
    """
    return _checks(_free(outlines.view, outlines.target_id, outlines.ellipse), geometry, bottom)


def check_births(
    births: Sequence[Birth], geometry: Geometry, trackers: Mapping[Key, Floats] = NOBODY, bottom: bool = False
) -> Checks:
    """The same of ellipses that trackers start with, with one another and with trackers that there are.

    Args:
        births: of one moment.
        geometry: of the views.
        trackers: ellipses of others that are as new, by view and target.
        bottom: as above.
    """
    if not births:
        return no_checks()
    rows = {**trackers, **{(b.view, b.target_id): b.ellipse for b in births}}
    view, target = (np.array(numbers) for numbers in zip(*rows, strict=True))
    return _checks(
        _free(view, target, np.array(list(rows.values()))), geometry, bottom, {(b.view, b.target_id) for b in births}
    )


def _free(view: Ints, target: Ints, ellipses: Floats) -> dict[Key, Floats]:
    """Ellipses that touch no other of their view, by view and target."""
    rows = {}
    for v in np.unique(view).tolist():
        mine = np.flatnonzero(view == v)
        alone = mine[~touching(ellipses[mine]).any(axis=1)]
        rows.update({(v, t): e for t, e in zip(target[alone].tolist(), ellipses[alone], strict=True)})
    return rows


def _checks(
    rows: Mapping[Key, Floats], geometry: Geometry, bottom: bool, born: Collection[Key] | None = None
) -> Checks:
    """Of pairs of rows of one target; of those of which one is in `born`."""
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


Tried = Mapping[tuple[int, int], tuple[int, int]]
"""For pairs of views how many starts there were that could be checked, and how many failed."""


def trusted(geometry: Geometry, checks: Checks, tried: Tried) -> tuple[Geometry, Tried, tuple[tuple[int, int], ...]]:
    """The geometry without matrices that most of the first targets contradict.

    Three starts of targets that stand free in both views are the fewest that can say so.
    What they say is final.

    Args:
        geometry: that is in use.
        checks: of the births of one moment.
        tried: those before.

    Returns:
        The geometry; `tried` with the checks; the pairs of views that lost their matrix now.
    """
    matrices, after, dropped = geometry.fundamental.copy(), dict(tried), []
    for a, b in sorted(set(zip(checks.first.astype(int).tolist(), checks.second.astype(int).tolist(), strict=True))):
        n, failed = tried.get((a, b), (0, 0))
        if n >= FEWEST:
            continue
        mine = checks.radii[(checks.first == a) & (checks.second == b)]
        n, failed = after[a, b] = n + len(mine), failed + int((mine > 1.0).sum())
        if n >= FEWEST and 2 * failed > n:
            matrices[a, b] = matrices[b, a] = np.nan
            dropped.append((a, b))
    return geometry._replace(fundamental=matrices) if dropped else geometry, after, tuple(dropped)
