"""Picture of a calibration: floor grid drawn on an image of each camera, and residuals of its boxes.

In a good calibration the grid lies on the floor of the image, and residuals scatter about 0 at all times and distances;
a residual with a trend in time indicates clock drift, one across the image a wrong lens or inclination.
"""

from __future__ import annotations

import io
from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from occlog.array_types import Floats, Ints
from occlog.records.frames import Image
from occlog.records.scene import Camera

from ..stage import Calibrated

WIDTH_IN, ROW_IN, DPI = 11.0, 3.4, 100
MAX_DRAWN = 1500
"""Boxes of a camera that are drawn, evenly spread."""
MAGNIFIED = 5.0
"""Residuals in the image are drawn this many times as long as they are."""
MAX_LINES = 60
"""Lines of the grid each way; of a larger floor it is coarser."""
STEPS = 120
"""Points of a line of the grid, which lenses bend."""
GRID, FEET, DOWN, ACROSS = "#ffb000", "#0070c0", "#0070c0", "#d04000"


def picture(found: Calibrated, images: Mapping[str, Image], metre: float) -> bytes:
    """Draw the picture of a calibration as PNG, with a row for each calibrated camera.

    Left: floor grid and feet on the image; right: residuals over time.

    Args:
        found: calibration.
        images: an image of each camera that has one, by name.
        metre: length of a metre in scene units; lines of the grid are a whole number of metres apart.
    """
    rows = [(c, each.camera) for c, each in enumerate(found.cameras) if each.estimated]
    lines, step = _grid(_feet(found), metre)
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(rows)), layout="constrained")
        axes = figure.subplots(len(rows), 2, squeeze=False, width_ratios=(1.5, 1.0))
        for (c, camera), (left, right) in zip(rows, axes, strict=True):
            mine: Ints = np.flatnonzero(found.seen.camera == c).astype(np.int64)
            kept: Ints = np.asarray(mine[np.unique(np.linspace(0, len(mine) - 1, MAX_DRAWN).round().astype(np.int64))])
            _draw_image(left, camera, images.get(camera.name), lines, step)
            _draw_feet(left, found, kept)
            _draw_residuals(right, found, mine, kept)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=DPI, metadata={"Software": None})
    return out.getvalue()


def _residuals(found: Calibrated, rows: Ints) -> tuple[Floats, Floats]:
    """Residuals (n,) [px] (observed minus expected): horizontal of box centres, and vertical of lower edges.

    `rows` (n,) are indices of observations.
    """
    r = found.residual[rows]
    return 0.5 * (r[:, 0] + r[:, 2]), r[:, 3]


def _feet(found: Calibrated) -> Floats:
    """(n, 2) ground positions of the feet of all boxes with a used lower edge, of calibrated cameras."""
    out = [np.zeros((0, 2))]
    for c, each in enumerate(found.cameras):
        if each.estimated:
            mine = (found.seen.camera == c) & found.seen.use[:, 3]
            box = found.seen.box[mine]
            rays = each.camera.rays(np.column_stack([0.5 * (box[:, 0] + box[:, 2]), box[:, 3]]))
            rays = rays[rays[:, 2] < 0.0]
            out.append(each.camera.position[:2] - rays[:, :2] * (each.camera.position[2] / rays[:, 2])[:, None])
    feet = np.concatenate(out)
    return np.asarray(feet[np.isfinite(feet).all(axis=1)])


def _grid(feet: Floats, metre: float) -> tuple[list[Floats], int]:
    """Lines (`STEPS`, 3) of a floor grid where people are, in scene units, and the grid spacing in metres.

    `feet` (n, 2) are their positions, `metre` is the length of a metre in scene units.
    """
    low, high = np.percentile(feet, [2.0, 98.0], axis=0) / metre
    low, high = np.floor(low - 0.5), np.ceil(high + 0.5)
    step = int(np.ceil(max(float((high - low).max()) / MAX_LINES, 1.0)))
    t = np.linspace(0.0, 1.0, STEPS)
    out = []
    for axis in (0, 1):
        for value in np.arange(low[axis], high[axis] + 0.5 * step, step):
            line = np.zeros((STEPS, 3))
            line[:, axis] = value
            line[:, 1 - axis] = low[1 - axis] + t * (high[1 - axis] - low[1 - axis])
            out.append(line * metre)
    return out, step


def _draw_image(axes: Axes, camera: Camera, image: Image | None, lines: list[Floats], step: int) -> None:
    """Draw the image of a camera, or an empty frame, with the floor grid, into `axes`.

    `lines` (k, 3) are the lines of the grid in scene units, `step` is its spacing in metres.
    """
    width, height = camera.image_size or (1, 1)
    if image is not None:
        shown = image if image.ndim == 2 else image[:, :, ::-1]
        axes.imshow(shown, cmap="gray", extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    for line in lines:
        pixels = camera.project(line)
        outside = (pixels < -0.5) | (pixels > np.array([width, height]) - 0.5)
        pixels[outside.any(axis=1)] = np.nan
        axes.plot(*pixels.T, color=GRID, linewidth=0.8)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axes.set_title(f"{camera.name}: grid of the floor, {step} m; feet, residuals {MAGNIFIED:g} times", fontsize=9)


def _draw_feet(axes: Axes, found: Calibrated, rows: Ints) -> None:
    """Draw the feet of boxes into `axes`, with lines towards their expected positions, enlarged by `MAGNIFIED`.

    `rows` (n,) are indices of observations.
    """
    box = found.seen.box[rows]
    across, down = _residuals(found, rows)
    u, v = 0.5 * (box[:, 0] + box[:, 2]), box[:, 3]
    good = np.isfinite(across) & np.isfinite(down)
    lines = np.stack([[u, u - MAGNIFIED * across, np.full(len(u), np.nan)], [v, v - MAGNIFIED * down, np.nan * v]])
    axes.plot(*lines[:, :, good].swapaxes(1, 2).reshape(2, -1), color=FEET, linewidth=0.6, alpha=0.6)
    axes.plot(u[good], v[good], ".", color=FEET, markersize=2.0)


def _draw_residuals(axes: Axes, found: Calibrated, mine: Ints, rows: Ints) -> None:
    """Draw the residuals of a camera's boxes over time, with their standard deviations in the title.

    Args:
        axes: axes to draw into.
        found: calibration.
        mine: (m,) indices of all observations of the camera, for the standard deviations.
        rows: (n,) indices of those that are drawn.
    """
    time = found.seen.time[found.seen.knot[rows]] - found.seen.time.min()
    for values, colour, name in zip(_residuals(found, rows), (ACROSS, DOWN), ("across", "feet"), strict=True):
        axes.plot(time, values, ".", color=colour, markersize=2.0, alpha=0.5, label=name)
    across, down = (part[np.isfinite(part)] for part in _residuals(found, mine))
    spread = [1.4826 * float(np.median(np.abs(part))) if len(part) else float("nan") for part in (across, down)]
    most = max((5.0 * s for s in spread if np.isfinite(s)), default=1.0)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.set(ylim=(-max(most, 1.0), max(most, 1.0)), xlabel="time [s]", ylabel="observed minus expected [px]")
    beyond = sum(int(np.count_nonzero(np.abs(part) > max(most, 1.0))) for part in (across, down))
    if beyond:
        axes.text(0.01, 0.98, f"{beyond} beyond", transform=axes.transAxes, va="top", fontsize=8)
    axes.legend(loc="upper right", fontsize=8)
    axes.set_title(
        f"{len(mine)} boxes; standard deviation across {spread[0]:.1f} px, feet {spread[1]:.1f} px", fontsize=9
    )
