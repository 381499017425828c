"""Method `virtual`: the virtual sensors that a tag may be in, by the readers that read it in a window.

Nothing is carried from one window to the next.

Virtual sensors: the regions into which the coverages of readers cut the floor ([Lee] Sec. 5.2.3, Fig. 5-32).

A virtual sensor is a set of readers and the region that exactly these readers cover.  Its reference point is the
centroid of the region, and a tag of which nothing else is known has the covariance of an even distribution over it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from occlog.array_types import Bools, Floats
from occlog.filtering.particles import log_of

QUARTER = 32
"""Corners of a quarter of a coverage's rim; the polygon has the area of the disc."""
MIN_SHARE = 1e-5
"""A region of a smaller share of the smallest disc is rounding."""


class ReaderRegions(NamedTuple):
    """V virtual sensors: the regions of the floor that exactly the same of R readers cover.

    Each has its area, centroid and the covariance of a uniform position over it.
    """

    members: Bools  # (V, R) which readers cover the region
    area: Floats  # (V,)
    centroid: Floats  # (V, 2)
    covariance: Floats  # (V, 2, 2) of a position that is even over the region


def virtual_sensors(positions: Floats, ranges: Floats, room: Floats | None = None) -> ReaderRegions:
    """Return the virtual sensors: the regions into which the discs of the readers' ranges divide the floor.

    A region may consist of several pieces; a part of the floor that no reader covers is no virtual sensor.

    Args:
        positions: (R, 2) positions of the readers.
        ranges: (R,) radii of the discs, finite, > 0.
        room: (K, 2) polygon outside of which there is no tag; None: there are no walls.
    """
    discs = [_disc(position, float(reach)) for position, reach in zip(positions, ranges, strict=True)]
    floor: BaseGeometry = shapely.union_all(discs) if room is None else shapely.Polygon(room)
    least = MIN_SHARE * math.pi * float(np.min(ranges)) ** 2
    cut: list[tuple[BaseGeometry, tuple[int, ...]]] = [(floor, ())]
    for reader, disc in enumerate(discs):
        halves = []
        for region, covered in cut:
            halves.append((region.intersection(disc), (*covered, reader)))
            halves.append((region.difference(disc), covered))
        cut = [(region, covered) for region, covered in halves if region.area > least]
    found = [(region, covered) for region, covered in cut if covered]
    members = np.zeros((len(found), len(discs)), dtype=np.bool_)
    for row, (_, covered) in enumerate(found):
        members[row, list(covered)] = True
    moments = [region_moments(region) for region, _ in found]
    return ReaderRegions(
        members=members,
        area=np.array([m.area for m in moments]),
        centroid=np.array([m.centroid for m in moments]).reshape(-1, 2),
        covariance=np.array([m.covariance for m in moments]).reshape(-1, 2, 2),
    )


def most_virtual_sensors(readers: int, overlap: int) -> int:
    """Return the largest number of virtual sensors of readers of which at most `overlap` cover one position.

    It is the sum of the binomial coefficients C(readers, i), i = 1 to overlap ([Lee] Sec. 5.2.3).
    """
    return sum(math.comb(readers, i) for i in range(1, min(overlap, readers) + 1))


class RegionMoments(NamedTuple):
    """Area, centroid (2,) and covariance (2, 2) of a uniform position over a region."""

    area: float
    centroid: Floats
    covariance: Floats


def region_moments(region: BaseGeometry) -> RegionMoments:
    """Return area, centroid and covariance of a uniform position in a region, by Green's theorem.

    `region` is a polygon, possibly with holes, or several polygons; its area is above 0.
    """
    # About the middle of its bounds, since moments of a region far from the origin would cancel
    x0, y0, x1, y1 = region.bounds
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
    total = np.zeros(6)
    for part in getattr(region, "geoms", [region]):
        if part.geom_type == "Polygon":
            total += _ring(part.exterior, middle, 1.0)
            for hole in part.interiors:
                total += _ring(hole, middle, -1.0)
    area, first, second = total[0], total[1:3], total[3:]
    mean = first / area
    spread = np.array([[second[0], second[1]], [second[1], second[2]]]) / area - np.outer(mean, mean)
    return RegionMoments(float(area), middle + mean, spread)


def _ring(ring: BaseGeometry, middle: Floats, sign: float) -> Floats:
    """Return (6,) integrals of 1, x, y, xx, xy, yy over the inside of a ring times `sign`, for either winding.

    Coordinates are relative to `middle` (2,).
    """
    x, y = (np.asarray(ring.coords, dtype=np.float64) - middle).T
    a, b, c, d = x[:-1], y[:-1], x[1:], y[1:]
    cross = a * d - c * b
    found = np.array(
        [
            cross.sum() / 2,
            (cross * (a + c)).sum() / 6,
            (cross * (b + d)).sum() / 6,
            (cross * (a * a + a * c + c * c)).sum() / 12,
            (cross * (a * d + 2 * a * b + 2 * c * d + c * b)).sum() / 24,
            (cross * (b * b + b * d + d * d)).sum() / 12,
        ]
    )
    return sign * math.copysign(1.0, found[0]) * found


def _disc(position: Floats, radius: float) -> BaseGeometry:
    """Return a polygon that approximates the disc of `radius` about `position` (2,) and has its area."""
    corners = 4 * QUARTER
    share = math.sin(2.0 * math.pi / corners) * corners / (2.0 * math.pi)
    return shapely.Point(position).buffer(radius / math.sqrt(share), quad_segs=QUARTER)


class CoarsePositions(NamedTuple):
    """Positions of a tag in W windows by virtual sensors, with covariances.

    `matched` (W,) is false where every virtual sensor has probability 0 given the readers that read the tag.
    """

    xy: Floats  # (W, 2) means
    covariance: Floats  # (W, 2, 2)
    matched: Bools  # (W,) false: the readers that read the tag cover no position together, and others do not


def locate(sensors: ReaderRegions, detected: Bools, detection: float, stray: float) -> CoarsePositions:
    """Return mean and covariance of a tag's position in each window, given which readers read it.

    P(detected | virtual sensor v) = prod over readers of `detection` or 1 - `detection` where v is in their range, and
    of `stray` or 1 - `stray` where it is not; the prior is the area. With detection 1 and stray 0 the position is the
    centroid of the one virtual sensor of these readers ([Lee] Sec. 5.2.3). Where no region has a probability above 0,
    those count with readers that differ in the fewest.

    Args:
        sensors: the V virtual sensors of R readers.
        detected: (W, R) which readers read the tag.
        detection: probability that a reader in range reads it, in (0, 1].
        stray: probability that a reader out of range does, in [0, 1).
    """
    inside, seen = sensors.members.astype(np.float64), detected.astype(np.float64)
    # Counts (W, V) of reads and misses in range and out of range
    hit, miss = seen @ inside.T, (1.0 - seen) @ inside.T
    false, quiet = seen @ (1.0 - inside).T, (1.0 - seen) @ (1.0 - inside).T
    terms = ((hit, detection), (miss, 1.0 - detection), (false, stray), (quiet, 1.0 - stray))
    log_posterior = np.broadcast_to(log_of(sensors.area), hit.shape).copy()
    for count, probability in terms:
        with np.errstate(invalid="ignore"):
            log_posterior += np.where(count > 0.0, count * log_of(np.asarray(probability)), 0.0)
    # Fall back on the nearest sets of readers
    matched = np.asarray(np.isfinite(log_posterior).any(axis=1))
    differ = miss + false
    nearest = np.where(differ == differ.min(axis=1, keepdims=True), log_of(sensors.area), -np.inf)
    log_posterior = np.where(matched[:, None], log_posterior, nearest)
    weights = np.exp(log_posterior - log_posterior.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    # Mean and covariance of the mixture of regions
    mean = weights @ sensors.centroid
    squares = sensors.covariance + sensors.centroid[:, :, None] * sensors.centroid[:, None, :]
    covariance = np.einsum("wv,vij->wij", weights, squares) - mean[:, :, None] * mean[:, None, :]
    return CoarsePositions(mean, covariance, matched)
