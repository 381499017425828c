"""Repeated median of crossings of lines of sight, and its jackknife ([Lenth] 1981)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

PARALLEL = 1e-12


class Folded(NamedTuple):
    """What the jackknife makes of an estimate."""

    xy: Floats  # (2,) mean of the pseudo-values: bias removed to the first order
    covariance: Floats  # (2, 2) of that mean


def crossings(places: Floats, bearings: Floats) -> Floats:
    """(n, n, 2) where line i is crossed by line j, if that is ahead of i; NaN elsewhere.

    Ahead of j it need not be: Lenth's published figures come out only if the half-line of the
    sensor that the median is taken for meets whole lines.
    """
    towards = np.column_stack([np.cos(bearings), np.sin(bearings)])
    dx, dy = towards[:, 0], towards[:, 1]
    across = dx[:, None] * dy[None, :] - dy[:, None] * dx[None, :]
    apart = places[None, :, :] - places[:, None, :]
    top = apart[:, :, 0] * dy[None, :] - apart[:, :, 1] * dx[None, :]
    meets = np.abs(across) > PARALLEL
    along = np.where(meets, top / np.where(meets, across, 1.0), np.nan)
    points: Floats = places[:, None, :] + along[:, :, None] * towards[:, None, :]
    points[~(along > 0.0)] = np.nan
    return points


def repeated_median(places: Floats, bearings: Floats) -> Floats | None:
    """(2,) median over the lines of the median of each line's crossings; None without any.

    Args:
        places: (n, 2) where the bearings were taken.
        bearings: (n,) [rad].
    """
    points = crossings(places, bearings)
    lines = [own[~np.isnan(own[:, 0])] for own in points]
    middle = [np.median(own, axis=0) for own in lines if len(own)]
    return np.median(np.array(middle), axis=0) if middle else None


def repeated_median_jackknife(places: Floats, bearings: Floats) -> Folded | None:
    """The jackknife of the repeated median; None if it is not defined without some bearing.

    Args:
        places: (n, 2), n >= 3.
        bearings: (n,) [rad].
    """
    n = len(bearings)
    whole = repeated_median(places, bearings)
    if whole is None or n < 3:
        return None
    pseudo = np.empty((n, 2))
    for i in range(n):
        rest = repeated_median(np.delete(places, i, axis=0), np.delete(bearings, i))
        if rest is None:
            return None
        pseudo[i] = n * whole - (n - 1) * rest
    return Folded(pseudo.mean(axis=0), np.cov(pseudo.T) / n)
