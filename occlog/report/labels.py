"""Names beside points, moved until they do not cover each other."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ..columns import Floats
from .style import COLOURS

CHARACTER = 0.62
"""Mean width of a character in units of the font's size."""


def place_labels(
    axes: Axes, points: Floats, texts: list[str], limits: Floats, keep_free: list[Floats], size: float = 8.5
) -> None:
    """Write a name at each point, on the side where it is free, outward first.

    Args:
        axes: where to draw; its limits must be set to `limits`, with equal scales.
        points: (N, 2) in data coordinates.
        texts: N names.
        limits: (2, 2) lower and upper corner of the axes.
        keep_free: boxes (2, 2) in data coordinates that no name should cover.
        size: of the font, in points.
    """
    window = axes.get_window_extent()
    extent = limits[1] - limits[0]
    # Points of the font a unit of the data takes; the axes keep equal scales inside their box.
    scale = 72.0 / float(axes.figure.dpi) * min(window.width / extent[0], window.height / extent[1])
    centre = limits.mean(axis=0)
    mark = np.array([[-5.0, -5.0], [5.0, 5.0]])
    taken = [np.array([p, p]) * scale + mark for p in points] + [box * scale + 0.4 * mark for box in keep_free]
    for point, text in zip(points, texts, strict=True):
        shape = np.array([CHARACTER * size * len(text), size])
        offsets = _offsets(point - centre, shape)
        boxes = [point * scale + o + np.array([-shape / 2, shape / 2]) for o in offsets]
        costs = [
            1000.0 * sum(_overlap(b, other) for other in taken) + 30.0 * _beyond(b, limits * scale) + i
            for i, b in enumerate(boxes)
        ]
        best = int(np.argmin(costs))
        taken.append(boxes[best])
        axes.annotate(
            text, (point[0], point[1]), (offsets[best][0], offsets[best][1]), textcoords="offset points",
            ha="center", va="center", fontsize=size, color=COLOURS["ink"], zorder=8, annotation_clip=False,
            bbox={"facecolor": COLOURS["halo"], "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )  # fmt: skip


def _offsets(outward: Floats, shape: Floats) -> list[Floats]:
    """Centres of the label relative to its point: eight directions at two distances, outward first."""
    angles = np.arange(8) * np.pi / 4
    first = float(np.arctan2(outward[1], outward[0]))
    order = np.argsort(np.abs(np.angle(np.exp(1j * (angles - first)))), kind="stable")
    unit = np.column_stack([np.cos(angles[order]), np.sin(angles[order])])
    return [u * (shape / 2 + gap) for gap in (7.0, 16.0) for u in unit]


def _overlap(a: Floats, b: Floats) -> float:
    side = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
    return float(max(side[0], 0.0) * max(side[1], 0.0))


def _beyond(box: Floats, limits: Floats) -> float:
    """How far a label sticks out of the axes."""
    return float(np.maximum(limits[0] - box[0], 0.0).sum() + np.maximum(box[1] - limits[1], 0.0).sum())
