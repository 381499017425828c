"""Probability that a person with a prior stands in a union of rectangles, by polygons and closed forms.

It shares no code with occlog: unions and areas are shapely's, and the mass of a normal
distribution over a polygon is a sum of Owen's T over its edges.  Slow, exact to about 1e-12.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.special import ndtr, owens_t


def rectangle(camera, x, diameter):
    """Where a person's centre hides x from the camera: as wide as the person, without end caps."""
    u = (x - camera) / np.hypot(*(x - camera))
    side = 0.5 * diameter * np.array([-u[1], u[0]])
    return shapely.Polygon([camera - side, x - side, x + side, camera + side])


def mass(region, person):
    """Probability of a person in a region: `person` is corners (K, 2), or (mean, covariance)."""
    if region.is_empty:
        return 0.0
    if isinstance(person, np.ndarray):
        shape = shapely.Polygon(person)
        return region.intersection(shape).area / shape.area
    mean, covariance = person
    values, vectors = np.linalg.eigh(covariance)
    if values[1] == 0.0:
        return float(region.covers(shapely.Point(mean)))
    if values[0] < 1e-9 * values[1]:
        return on_line(region, mean, np.sqrt(values[1]) * vectors[:, 1])
    root = np.linalg.cholesky(covariance)
    total = 0.0
    for part in shapely.get_parts(region):
        part = shapely.geometry.polygon.orient(part)
        for ring in (part.exterior, *part.interiors):
            total += over_ring(np.linalg.solve(root, (np.array(ring.coords) - mean).T).T)
    return total


def on_line(region, mean, sigma):
    """Mass of a prior on the line through its mean; `sigma` (2,) is a standard deviation along it."""
    cut = region.intersection(shapely.LineString([mean - 12 * sigma, mean + 12 * sigma]))
    total = 0.0
    for part in shapely.get_parts(cut):
        if len(part.coords) < 2:  # empty, or a corner that the line touches
            continue
        ends = (np.array(part.coords)[[0, -1]] - mean) @ sigma / (sigma @ sigma)
        total += abs(ndtr(ends[1]) - ndtr(ends[0]))
    return total


def over_ring(corners):
    """Signed mass of the standard normal distribution inside a closed ring (K + 1, 2).

    Owen's T(h, a) is the mass beyond distance h in the wedge 0 < y < a x, so that the triangle from the
    origin to an edge at distance h, from its foot to t = a h, has atan(a) / (2 pi) - T(h, a).
    """
    p, q = corners[:-1], corners[1:]
    length = np.hypot(*(q - p).T)
    p, q, length = p[length > 0], q[length > 0], length[length > 0]
    d = (q - p) / length[:, None]
    h = p[:, 0] * d[:, 1] - p[:, 1] * d[:, 0]
    some = np.abs(h) > 1e-14
    near = np.abs(h[some])
    ends = [np.sum(e[some] * d[some], axis=1) / near for e in (p, q)]
    wedge = [np.arctan(a) / (2 * np.pi) - owens_t(near, a) for a in ends]
    return float(np.sum(np.sign(h[some]) * (wedge[1] - wedge[0])))


def hiding(xy, camera, persons, diameter):
    """(L, M) probabilities that each person hides each place from a camera."""
    regions = [rectangle(camera, x, diameter) for x in xy]
    return np.array([[mass(region, person) for person in persons] for region in regions]).reshape(len(xy), -1)


def together(xy, cameras, persons, diameter):
    """(L, 2^N) probabilities that no one stands in the way of any camera of a subset; bit i is camera i."""
    out = np.ones((len(xy), 1 << len(cameras)))
    for p, x in enumerate(xy):
        regions = [rectangle(camera, x, diameter) for camera in cameras]
        for Q in range(1, 1 << len(cameras)):
            union = shapely.union_all([region for i, region in enumerate(regions) if Q >> i & 1])
            out[p, Q] = np.prod([1.0 - mass(union, person) for person in persons])
    return out
