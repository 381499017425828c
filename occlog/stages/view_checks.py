"""Whether the views' fundamental matrices fit what is tracked: the loop check on targets that stand free in both views.

Only those count: a target that others hide is not where its tracker is, which is no fault
of the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..columns import Floats, Ints
from ..core.ellipse import touching
from ..trackers.view_method import Birth, Geometry, Outlines
from .view_births import loop_distances, radius

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


def check_outlines(outlines: Outlines, geometry: Geometry) -> Checks:
    """Loop checks of the targets that touch no other in either view."""
    return _checks(_free(outlines.view, outlines.target_id, outlines.ellipse), geometry)


def check_births(births: Sequence[Birth], geometry: Geometry) -> Checks:
    """The same of ellipses that trackers start with."""
    if not births:
        return no_checks()
    view, target = np.array([b.view for b in births]), np.array([b.target_id for b in births])
    return _checks(_free(view, target, np.array([b.ellipse for b in births])), geometry)


def _free(view: Ints, target: Ints, ellipses: Floats) -> dict[tuple[int, int], Floats]:
    """Ellipses that touch no other of their view, by view and target."""
    rows = {}
    for v in np.unique(view).tolist():
        mine = np.flatnonzero(view == v)
        alone = mine[~touching(ellipses[mine]).any(axis=1)]
        rows.update({(v, t): e for t, e in zip(target[alone].tolist(), ellipses[alone], strict=True)})
    return rows


def _checks(rows: Mapping[tuple[int, int], Floats], geometry: Geometry) -> Checks:
    parts = []
    known = np.isfinite(geometry.fundamental).all(axis=(2, 3))
    for a, b in zip(*np.nonzero(np.triu(known, 1)), strict=True):
        shared = [t for v, t in rows if v == a and (b, t) in rows]
        if shared:
            of_a, of_b = (np.array([rows[int(v), t] for t in shared]) for v in (a, b))
            radii = loop_distances(geometry, int(a), int(b), of_a, of_b)
            n = len(shared)
            size = 0.5 * (radius(of_a) + radius(of_b))
            parts.append(Checks(np.full(n, float(a)), np.full(n, float(b)), radii, radii * size))
    return gather(parts)


def trusted(geometry: Geometry, births: Sequence[Birth]) -> tuple[Geometry, tuple[tuple[int, int], ...]]:
    """The geometry without matrices that most of the first targets contradict, and the pairs of views that lost theirs.

    Three targets that stand free in both views are the fewest that can say so.
    """
    checks = check_births(births, geometry)
    matrices, dropped = geometry.fundamental.copy(), []
    for a, b in sorted(set(zip(checks.first.astype(int).tolist(), checks.second.astype(int).tolist(), strict=True))):
        mine = checks.radii[(checks.first == a) & (checks.second == b)]
        if len(mine) >= FEWEST and 2 * int((mine > 1.0).sum()) > len(mine):
            matrices[a, b] = matrices[b, a] = np.nan
            dropped.append((a, b))
    return geometry._replace(fundamental=matrices), tuple(dropped)
