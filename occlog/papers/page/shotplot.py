"""Frames of a video with trackers drawn on them, in rows and columns of one picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from occlog.array_types import Floats
from occlog.report.drawing.style import house_style, label, new_figure, to_png


class Mark(NamedTuple):
    """Outline of a tracker."""

    target: int
    ellipse: Floats  # (5,) centre [px], half axes [px], angle of the first axis [rad]
    good: bool  # true: the tracker is on its own target


class Line(NamedTuple):
    """Epipolar line of a target's estimate in another view."""

    target: int
    line: Floats  # (3,) points (x, y) with line . (x, y, 1) = 0


class Shot(NamedTuple):
    """One image with what is drawn on it."""

    title: str
    image: NDArray[np.uint8]  # (H, W, 3) BGR
    marks: tuple[Mark, ...]
    links: tuple[tuple[Floats, Floats], ...]  # centres of trackers that touch
    lines: tuple[Line, ...]


class Shots(NamedTuple):
    """A picture: images in rows and columns."""

    title: str
    caption: str
    rows: tuple[str, ...]  # names of the rows
    shots: tuple[tuple[Shot, ...], ...]  # by row


WIDTH = 2.3
"""Width of an image [inch]."""
BRIGHT = ("#56b4e9", "#e69f00", "#33d17a", "#cc79a7", "#f0e442", "#ff6b4a", "#b19cff", "#9fe8e0")
"""Colours of targets that stand out on photographs; they repeat."""
DPI = 110.0


def bright(target: int) -> str:
    """Return the colour of a target."""
    return BRIGHT[target % len(BRIGHT)]


def draw_shots(shots: Shots) -> Figure:
    """Draw all images, with the name of each row at its left."""
    rows, columns = len(shots.shots), max(len(r) for r in shots.shots)
    height, width = shots.shots[0][0].image.shape[:2]
    figure = new_figure(WIDTH * columns + 0.3, (WIDTH * height / width + 0.2) * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for name, line, row in zip(shots.rows, grid, shots.shots, strict=True):
        for axes, shot in zip(line, row, strict=False):
            _draw(axes, shot)
        line[0].text(-0.03, 0.5, label(name), transform=line[0].transAxes, rotation=90, ha="right", va="center")
    return figure


def _draw(axes: Axes, shot: Shot) -> None:
    height, width = shot.image.shape[:2]
    axes.imshow(shot.image[..., ::-1], interpolation="nearest")
    axes.set_title(label(shot.title, 40))
    for a, b in shot.links:
        axes.plot([a[0], b[0]], [a[1], b[1]], color="white", linewidth=1.3)
    for line in shot.lines:
        _line(axes, line, width, height)
    for mark in shot.marks:
        _mark(axes, mark)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)


def _line(axes: Axes, line: Line, width: int, height: int) -> None:
    ends = ends_of(line.line, width, height)
    if ends is not None:
        axes.plot(*ends.T, color=bright(line.target), linewidth=0.9, linestyle=(0, (4, 2)))


def ends_of(line: Floats, width: int, height: int) -> Floats | None:
    """Return the two points (2, 2) at which a line (3,) crosses the image's border; None for a line outside."""
    a, b, c = line.tolist()
    points = []
    for x in (-0.5, width - 0.5):
        if b and -0.5 <= (y := -(a * x + c) / b) <= height - 0.5:
            points.append((x, y))
    for y in (-0.5, height - 0.5):
        if a and -0.5 < (x := -(b * y + c) / a) < width - 0.5:
            points.append((x, y))
    distinct = sorted(set(points))
    return np.array([distinct[0], distinct[-1]]) if len(distinct) > 1 else None


def _mark(axes: Axes, mark: Mark) -> None:
    x, y, a, b, rho = mark.ellipse.tolist()
    style = "-" if mark.good else (0, (2, 1.5))
    axes.add_patch(
        Ellipse(
            (x, y),
            2.0 * a,
            2.0 * b,
            angle=float(np.degrees(rho)),
            fill=False,
            edgecolor=bright(mark.target),
            linewidth=1.6,
            linestyle=style,
        )
    )
    text = str(mark.target) if mark.good else f"{mark.target} ×"
    axes.text(
        x,
        y,
        text,
        color=bright(mark.target),
        ha="center",
        va="center",
        fontsize=8,
        fontweight="bold",
        path_effects=[withStroke(linewidth=2.0, foreground="black")],
        clip_on=True,
    )


def shots_png(shots: Shots) -> bytes:
    """Return the picture as PNG."""
    with house_style():
        return to_png(draw_shots(shots), DPI, {"Title": shots.title})
