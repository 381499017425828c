"""Where moving occluders were thought to be, on the floor plan."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Polygon

from occlog.array_types import Ints
from occlog.records.tables import Hulls, Occluders
from occlog.report.drawing.style import COLOURS

MOMENTS = 8
"""Times at which priors are drawn; more hide each other."""
CHI2_95 = 5.991
"""95 % quantile of the chi-squared distribution with 2 degrees of freedom."""


def draw_priors(axes: Axes, priors: Occluders | Hulls) -> list[Line2D | Patch]:
    """Draw the priors of a few moments, evenly spread over those that have any; what the legend says of them."""
    there = priors.take(priors.occluder_id >= 0)
    if not len(there):
        return []
    style: dict[str, Any] = {"facecolor": COLOURS["moving"], "edgecolor": COLOURS["moving"], "linewidth": 0.6}
    shown = there.take(np.isin(there.t_ns, moments(there.t_ns)))
    for patch in polygons(shown, style) if isinstance(shown, Hulls) else ellipses(shown, style):
        axes.add_patch(patch)
    kind = "hull of a moving occluder" if isinstance(shown, Hulls) else "95 % ellipse of a moving occluder"
    return [Patch(label=kind, alpha=0.3, **style)]


def moments(t_ns: Ints) -> Ints:
    """The times at which priors are drawn."""
    times = np.unique(t_ns)
    if not len(times):
        return times
    some: Ints = times[np.unique(np.linspace(0, len(times) - 1, MOMENTS).round().astype(int))]
    return some


def polygons(hulls: Hulls, style: dict[str, Any]) -> list[Patch]:
    """One patch a polygon."""
    first = np.flatnonzero(hulls.corner == 0)
    corners = np.split(np.column_stack([hulls.x, hulls.y]), first[1:])
    return [Polygon(xy, closed=True, alpha=0.22, zorder=2.4, **style) for xy in corners]


def ellipses(occluders: Occluders, style: dict[str, Any]) -> list[Patch]:
    """One patch a Gaussian; nothing shows of one that is known exactly."""
    out: list[Patch] = []
    for x, y, xx, xy, yy in zip(
        occluders.x, occluders.y, occluders.cov_xx, occluders.cov_xy, occluders.cov_yy, strict=True
    ):
        values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        minor, major = 2.0 * np.sqrt(CHI2_95 * np.maximum(values, 0.0))
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        out.append(
            Ellipse((float(x), float(y)), float(major), float(minor), angle=angle, alpha=0.16, zorder=2.4, **style)
        )
    return out
