"""Shapes in the world and over images, independent of the viewer.

Dashes and dense points along many polylines are computed together for speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

Rgba = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""
WHITE: Rgba = (1.0, 1.0, 1.0, 0.9)
GREY: Rgba = (0.55, 0.6, 0.65, 0.9)
WALL: Rgba = (0.35, 0.4, 0.46, 1.0)
PILLAR: Rgba = (0.6, 0.65, 0.69, 0.6)
FLOOR: Rgba = (0.8, 0.83, 0.86, 0.25)
SHADOW: Rgba = (0.1, 0.1, 0.15, 0.3)
CHOSEN: Rgba = (0.9, 0.62, 0.0, 0.9)
RIM = 36
"""Corners of an ellipse."""
_TURNS = np.linspace(0.0, 2.0 * np.pi, RIM + 1)
UNIT_CIRCLE = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
SIGMAS_95 = float(np.sqrt(5.991))
"""Half axes of the ellipse that holds 95 % of a Gaussian in the plane, in standard deviations."""


@dataclass(frozen=True)
class Polyline:
    """Polyline of a drawing.

    Attributes:
        points: (k, 3) in the world [m] or (k, 2) in an image [px].
        colour: red, green, blue and opacity.
        width: width of the line.
        dashed: every other section is drawn.
    """

    points: Floats
    colour: Rgba
    width: float
    dashed: bool = False


@dataclass(frozen=True)
class Cylinder:
    """Upright cylinder; all lengths in metres.

    Attributes:
        foot: (3,) centre of its base.
        width: diameter.
        height: height above the base.
        colour: red, green, blue and opacity.
    """

    foot: Floats  # (3,) middle of its lower end
    width: float
    height: float
    colour: Rgba


@dataclass(frozen=True)
class Fill:
    """Triangles (3 k, 3), three successive corners each, filled with one colour."""

    corners: Floats
    colour: Rgba


@dataclass(frozen=True)
class Text:
    """Text of a drawing.

    Attributes:
        at: (3,) point in the world [m] or (2,) in an image [px].
        words: the text.
        size: height of the letters.
        colour: red, green, blue and opacity.
    """

    at: Floats
    words: str
    size: float
    colour: Rgba


@dataclass(frozen=True)
class Dots:
    """Separate points (n, 3) in the world, all of one colour [m]."""

    points: Floats
    colour: Rgba


@dataclass(frozen=True)
class DrawingGroup:
    """Group of shapes with a common name, for example all shapes of one person.

    Attributes:
        name: name of the group.
        lines: polylines.
        columns: upright cylinders.
        fills: filled areas.
        texts: texts.
        dots: points.
    """

    name: str
    lines: Sequence[Polyline] = field(default=())
    columns: Sequence[Cylinder] = field(default=())
    fills: Sequence[Fill] = field(default=())
    texts: Sequence[Text] = field(default=())
    dots: Sequence[Dots] = field(default=())


def faded(colour: Rgba, opacity: float) -> Rgba:
    """Return the colour with the given opacity, 0 to 1."""
    return (*colour[:3], opacity)


def smaller(thing: DrawingGroup, shrunk: float) -> DrawingGroup:
    """Return a shape for an image reduced by the factor `shrunk` (at most 1); pixel centres are at integers in both."""
    lines = [replace(line, points=shrunk * (line.points + 0.5) - 0.5) for line in thing.lines]
    texts = [replace(text, at=shrunk * (text.at + 0.5) - 0.5) for text in thing.texts]
    return replace(thing, lines=lines, texts=texts)


def rim(middle: Floats, covariance: Floats) -> Floats:
    """Return the points (RIM + 1, 2) of the closed 95 % ellipse of a Gaussian in the plane.

    Args:
        middle: (2,) mean.
        covariance: (2, 2), positive semi-definite.
    """
    values, axes = np.linalg.eigh(covariance)
    return around(middle, SIGMAS_95 * np.sqrt(np.maximum(values, 0.0)), axes)


def around(middle: Floats, half: Floats, axes: Floats | None = None) -> Floats:
    """Return the points (RIM + 1, 2) of a closed ellipse about `middle` (2,) with half axes `half` (2,).

    `axes`: (2, 2) directions of the half axes as columns; None: x and y.
    """
    unit = UNIT_CIRCLE * half
    return np.asarray(middle + (unit if axes is None else unit @ axes.T))


def at_height(points: Floats, z: float) -> Floats:
    """Return points (k, 2) of the plan as (k, 3) at height z."""
    out = np.empty((len(points), 3))
    out[:, :2], out[:, 2] = points, z
    return out


def fan(polygon: Floats, z: float) -> Floats:
    """Return the triangles (3 (k - 2), 3), three corners each, that fill a convex polygon (k, 2) at height z."""
    n = len(polygon) - 2
    order = np.column_stack([np.zeros(n, dtype=np.int64), np.arange(1, n + 1), np.arange(2, n + 2)])
    return at_height(polygon[order.reshape(-1)], z)


def triangles(polygon: Floats, z: float) -> Floats:
    """Return triangles (3 k, 3), three corners each, that fill a simple polygon (K, 2) at height z."""
    import shapely

    parts = shapely.constrained_delaunay_triangles(shapely.Polygon(polygon)).geoms
    corners = [np.asarray(part.exterior.coords)[:3] for part in parts]
    return at_height(np.concatenate(corners), z) if corners else np.empty((0, 3))


MIN_DASHES, MAX_DASHES = 6, 200


class EqualLengthPolylines(NamedTuple):
    """m polylines with the same number of vertices k, as arrays.

    Attributes:
        which: (m,) their indices among all polylines.
        points: (m, k, d) vertices.
        along: (m, k) distance of each vertex from the beginning of its polyline.
    """

    which: Ints
    points: Floats
    along: Floats


def dashes(ways: Sequence[Floats], length: float) -> list[Floats]:
    """Return, for each polyline, the ends (2 n, d) of n dashes along it, each about `length` long, with equal gaps.

    Args:
        ways: polylines (k, d), k > 1, of equal d.
        length: > 0; the number of dashes is limited.
    """
    if not ways:
        return []
    groups = _similar(ways)
    totals = _totals(groups, len(ways))
    counts = np.clip(np.rint(totals / (2.0 * length)), MIN_DASHES, MAX_DASHES).astype(np.int64)
    ends = 2 * counts
    number = _from_zero(ends)
    wanted = (number // 2 + 0.5 * (number % 2)) / np.repeat(counts, ends) * np.repeat(totals, ends)
    return np.split(_at(groups, wanted, ends), np.cumsum(ends)[:-1])


def dense(ways: Sequence[Floats], step: float, most: int) -> tuple[Floats, Ints]:
    """Return points (N, d) along all polylines, evenly spaced on each, ends included, and their numbers.

    Args:
        ways: polylines (k, d), k > 1, of equal d; at least one.
        step: largest distance of successive points, > 0.
        most: largest number of points on a polyline; a longer one gets a larger step.

    Returns:
        Points, polyline after polyline, and the number on each (len(ways),), 2 to `most`.
    """
    groups = _similar(ways)
    totals = _totals(groups, len(ways))
    counts = np.clip(np.ceil(totals / step) + 1, 2, most).astype(np.int64)
    wanted = _from_zero(counts) * np.repeat(totals / (counts - 1), counts)
    wanted[np.cumsum(counts) - 1] = totals
    return _at(groups, wanted, counts), counts


def _similar(ways: Sequence[Floats]) -> list[EqualLengthPolylines]:
    sizes = np.fromiter(map(len, ways), np.int64, len(ways))
    found = []
    for size in np.unique(sizes).tolist():
        which = np.flatnonzero(sizes == size)
        points = np.concatenate([ways[n] for n in which.tolist()]).reshape(len(which), size, -1)
        along = np.zeros(points.shape[:2])
        np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=2), axis=1, out=along[:, 1:])
        found.append(EqualLengthPolylines(which, points, along))
    return found


def _totals(groups: Sequence[EqualLengthPolylines], count: int) -> Floats:
    out = np.empty(count)
    for group in groups:
        out[group.which] = group.along[:, -1]
    return out


def _at(groups: Sequence[EqualLengthPolylines], wanted: Floats, counts: Ints) -> Floats:
    """Return the points (N, d) at the distances `wanted` (N,) from the beginnings of all polylines.

    `counts`: number of points on each polyline, in order; they sum to N.
    """
    if len(groups) == 1:
        return _between(groups[0], counts, wanted)
    out, begins = np.empty((len(wanted), groups[0].points.shape[2])), np.cumsum(counts) - counts
    for group in groups:
        own = counts[group.which]
        index = np.repeat(begins[group.which], own) + _from_zero(own)
        out[index] = _between(group, own, wanted[index])
    return out


def _between(group: EqualLengthPolylines, counts: Ints, wanted: Floats) -> Floats:
    """Return points (n, d) along polylines, interpolated linearly between vertices.

    Args:
        group: m polylines with equal numbers of vertices.
        counts: (m,) number of points on each; they sum to n.
        wanted: (n,) distances from the beginning of the polyline, ascending on each.
    """
    points, along = group.points, group.along
    size, axes = points.shape[1:]
    owner = np.repeat(np.arange(len(points)), counts)
    passed = _passed(along, counts, wanted)
    at_end = np.flatnonzero(passed == size - 1)
    before = np.minimum(passed, size - 2)
    with np.errstate(divide="ignore", invalid="ignore"):  # of points that fall together, between which none is
        slope = np.diff(points, axis=1) / np.diff(along, axis=1)[:, :, None]
        first, segment = owner * size + before, owner * (size - 1) + before
        found: Floats = slope.reshape(-1, axes)[segment]
        found *= (wanted - along.reshape(-1)[first])[:, None]
        found += points.reshape(-1, axes)[first]
    found[at_end] = points[owner[at_end], -1]
    return found


def _passed(along: Floats, counts: Ints, wanted: Floats) -> Ints:
    """Return for each of n points the number (n,) of vertices at or before it, not counting the first vertex.

    Args:
        along: (m, k) distances of the k vertices of m polylines from their beginning.
        counts: (m,) number of points on each; they sum to n.
        wanted: (n,) distances of the points from the beginning of their polyline.
    """
    if along.shape[1] == 2:
        return (wanted >= np.repeat(along[:, 1], counts)).astype(np.int64)
    parts = np.split(wanted, np.cumsum(counts)[:-1])
    return np.concatenate([row[1:].searchsorted(part, side="right") for row, part in zip(along, parts, strict=True)])


def _from_zero(counts: Ints) -> Ints:
    """Return the concatenated ranges 0, 1, ..., count - 1 for each count in `counts` (n,)."""
    return np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
