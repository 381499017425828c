"""What is drawn in the world and over images, before it is coded for a viewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from occlog.array_types import Floats

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
class Line:
    """A way through points (k, 3) in the world or (k, 2) in an image; `dashed`: every other piece."""

    points: Floats
    colour: Rgba
    width: float
    dashed: bool = False


@dataclass(frozen=True)
class Column:
    """An upright cylinder."""

    foot: Floats  # (3,) middle of its lower end
    width: float
    height: float
    colour: Rgba


@dataclass(frozen=True)
class Fill:
    """Triangles (3 k, 3), each of three corners."""

    corners: Floats
    colour: Rgba


@dataclass(frozen=True)
class Text:
    """Words at a point (3,) of the world or (2,) of an image; `size` is their height."""

    at: Floats
    words: str
    size: float
    colour: Rgba


@dataclass(frozen=True)
class Dots:
    """Points (n, 3) of the world, each for itself."""

    points: Floats
    colour: Rgba


@dataclass(frozen=True)
class Thing:
    """What belongs together, such as all of a person; things of one name follow each other."""

    name: str
    lines: Sequence[Line] = field(default=())
    columns: Sequence[Column] = field(default=())
    fills: Sequence[Fill] = field(default=())
    texts: Sequence[Text] = field(default=())
    dots: Sequence[Dots] = field(default=())


def faded(colour: Rgba, opacity: float) -> Rgba:
    """The colour, more or less transparent."""
    return (*colour[:3], opacity)


def smaller(thing: Thing, shrunk: float) -> Thing:
    """A thing over an image that is made smaller; pixels have their centres at whole numbers in both."""
    lines = [replace(line, points=shrunk * (line.points + 0.5) - 0.5) for line in thing.lines]
    texts = [replace(text, at=shrunk * (text.at + 0.5) - 0.5) for text in thing.texts]
    return replace(thing, lines=lines, texts=texts)


def rim(middle: Floats, covariance: Floats) -> Floats:
    """(RIM + 1, 2) points around the ellipse that holds 95 % of a Gaussian, the first again at the end.

    Args:
        middle: (2,).
        covariance: (2, 2), positive semi-definite.
    """
    values, axes = np.linalg.eigh(covariance)
    return around(middle, SIGMAS_95 * np.sqrt(np.maximum(values, 0.0)), axes)


def around(middle: Floats, half: Floats, axes: Floats | None = None) -> Floats:
    """(RIM + 1, 2) points around an ellipse with half axes (2,) along the columns of (2, 2) `axes`."""
    unit = UNIT_CIRCLE * half
    return np.asarray(middle + (unit if axes is None else unit @ axes.T))


def at_height(points: Floats, z: float) -> Floats:
    """(k, 3) points of the plan at a height."""
    out = np.empty((len(points), 3))
    out[:, :2], out[:, 2] = points, z
    return out


def fan(polygon: Floats, z: float) -> Floats:
    """(3 (k - 2), 3) triangles of a convex polygon (k, 2) at a height; both sides are seen in all viewers."""
    n = len(polygon) - 2
    order = np.column_stack([np.zeros(n, dtype=np.int64), np.arange(1, n + 1), np.arange(2, n + 2)])
    return at_height(polygon[order.reshape(-1)], z)


def triangles(polygon: Floats, z: float) -> Floats:
    """(3 k, 3) triangles of any simple polygon (K, 2) at a height."""
    import shapely

    parts = shapely.constrained_delaunay_triangles(shapely.Polygon(polygon)).geoms
    corners = [np.asarray(part.exterior.coords)[:3] for part in parts]
    return at_height(np.concatenate(corners), z) if corners else np.empty((0, 3))
