"""Distances of the loop check of [Qu] Sec. 3.4.2, for ellipses of one target in two views."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.fundamental import epipolar_distances
from occlog.measure.epipolar.views import Geometry


def anchors(ellipses: Floats, bottom: bool) -> Floats:
    """(N, 2) points of ellipses (N, 5) that stand for their targets, as recorded [px].

    Args:
        ellipses: see `occlog.core.image.ellipse`.
        bottom: the lowest point, where people stand; else the centre.
    """
    if not bottom:
        return np.asarray(ellipses[:, :2])
    # Where the tangent is horizontal
    a, b, rho = ellipses[:, 2:].T
    down = np.hypot(a * np.sin(rho), b * np.cos(rho))
    aside = (a * a - b * b) * np.sin(rho) * np.cos(rho) / down
    return np.asarray(ellipses[:, :2] + np.column_stack([aside, down]))


def loop_distances(geometry: Geometry, a: int, b: int, of_a: Floats, of_b: Floats, bottom: bool = False) -> Floats:
    """(N,) the larger one of the two distances from each other's epipolar lines, in radii; inf where unknown.

    Args:
        geometry: of the views.
        a: number of a view.
        b: number of another view.
        of_a: (N, 5) ellipses of targets in view a.
        of_b: (N, 5) of the same targets in view b.
        bottom: see `anchors`.
    """
    points = []
    for view, ellipses in ((a, of_a), (b, of_b)):
        recorded, ideal = anchors(ellipses, bottom), geometry.ideal[view]
        points.append(recorded if ideal is None else ideal(recorded))
    radii = np.column_stack([radius(of_a), radius(of_b)])
    distances = epipolar_distances(geometry.fundamental[a, b], *points) / radii
    return np.asarray(np.where(np.isfinite(distances), distances, np.inf).max(axis=1))


def radius(ellipses: Floats) -> Floats:
    """(N,) radii of the circles of the same area as ellipses (N, 5)."""
    return np.asarray(np.sqrt(ellipses[:, 2] * ellipses[:, 3]))
