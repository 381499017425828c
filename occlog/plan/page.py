"""HTML page and picture of a plan: maps of expected error and of coverage by two sensors, figures, rankings."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from occlog.array_types import Bools, Floats
from occlog.records.declared.world import PlanMap
from occlog.records.scene import Camera, Scene
from occlog.report.drawing import COLOURS, DARK, house_style, label, new_figure, page_svg, raw_svg, template, to_png
from occlog.report.plots.floorplan import draw_scene, frame_plan

from .sensing import Sensor

WIDTH, DPI = 9.6, 110.0
MAP = "viridis_r"
"""Colours of errors: dark is far off."""


class MapPicture(NamedTuple):
    """Content of the maps of a plan: scene, map table by cells, sides of a cell (2,), and added sensors.

    Cells with an expected error below `within` are dotted; None: no dots.
    """

    scene: Scene
    table: PlanMap
    size: Floats  # (2,) sides of a cell
    added: tuple[Sensor, ...]  # placements that were found
    within: float | None  # error that is outlined


def map_picture(what: MapPicture, suffix: str) -> bytes:
    """Return the picture of the maps as PNG or SVG, by `suffix` (`.png`, `.svg`)."""
    with house_style():
        figure = new_figure(*size_of(what))
        draw_maps(figure, what)
        return _svg(figure) if suffix == ".svg" else to_png(figure, DPI, {"Title": "Expected error and coverage"})


def _svg(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def size_of(what: MapPicture) -> tuple[float, float]:
    """Return width and height of the maps [inches], with the aspect ratio of the room."""
    extent = np.diff(_limits(what), axis=0)[0]
    return WIDTH, float(np.clip(0.44 * WIDTH * extent[1] / extent[0] + 1.9, 3.4, 9.0))


def draw_maps(figure: FigureBase, what: MapPicture) -> None:
    """Draw the maps of the expected error and of the probability of being seen by two sensors into a figure.

    To be called inside `house_style`.
    """
    unit = label(what.scene.length_unit)
    left, right = figure.subplots(1, 2)
    rmse = what.table.rmse
    low, high = float(rmse.min()), float(rmse.max())
    norm = LogNorm(low, max(high, 1.01 * low))
    handles = _map(left, what, rmse, norm, f"Expected error, RMSE [{unit}]")
    _map(right, what, what.table.seen_by_2, Normalize(0.0, 1.0), "Seen by two or more, probability", "viridis")
    if what.within is not None:
        left.set_title(f"Expected error, RMSE [{unit}]; dots: below {what.within:g}")
        _outline(left, what, rmse < what.within)
    figure.legend(handles=handles, loc="outside lower center", ncols=5)


def _map(
    axes: Axes, what: MapPicture, values: Floats, norm: Normalize, title: str, colours: str = MAP
) -> list[Line2D | Patch]:
    limits = _limits(what)
    # Squares are above the fields of view in the legend
    handles = [h for h in draw_scene(axes, what.scene, limits) if h.get_label() != "field of view"]
    squares = _squares(what, values, norm=norm, cmap=colours, linewidth=0.2, edgecolor="face", zorder=1.3)
    axes.add_collection(squares)
    bar = axes.figure.colorbar(squares, ax=axes, orientation="horizontal", aspect=30, pad=0.03)
    low, high = norm.vmin or 0.0, norm.vmax or 1.0
    ticks = np.geomspace(low, high, 5) if isinstance(norm, LogNorm) else np.linspace(low, high, 5)
    bar.set_ticks(ticks.tolist(), labels=[f"{tick:.2g}" for tick in ticks])
    bar.minorticks_off()
    # Shapes and no image, which the page does not load
    assert bar.solids is not None
    bar.solids.set_rasterized(False)
    bar.solids.set_edgecolor("face")
    if what.added:
        at = np.array([sensor.position[:2] for sensor in what.added])
        handles += axes.plot(
            at[:, 0], at[:, 1], "*", color=COLOURS["bound"], markersize=11, zorder=7, label="added", linestyle="none"
        )
        for number, (sensor, (x, y)) in enumerate(zip(what.added, at, strict=True), start=1):
            axes.annotate(str(number), (x, y), (4, 4), textcoords="offset points", color=COLOURS["bound"], zorder=8)
            if isinstance(sensor, Camera):
                along = 0.07 * float((limits[1] - limits[0]).max()) * np.array([np.cos(sensor.yaw), np.sin(sensor.yaw)])
                axes.plot([x, x + along[0]], [y, y + along[1]], color=COLOURS["bound"], zorder=7)
    frame_plan(axes, limits, what.scene.length_unit)
    axes.set_title(title)
    return handles


def _squares(what: MapPicture, values: Floats, **style: Any) -> PatchCollection:
    width, height = (float(side) for side in what.size)
    positions = zip(what.table.x - 0.5 * width, what.table.y - 0.5 * height, strict=True)
    squares = PatchCollection([Rectangle(corner, width, height) for corner in positions], **style)
    squares.set_array(values)
    return squares


def _outline(axes: Axes, what: MapPicture, good: Bools) -> None:
    """Draw dots at the centres of the cells in the mask `good` (C,)."""
    rows = np.flatnonzero(good)
    axes.plot(
        what.table.x[rows], what.table.y[rows], ".", color=COLOURS["halo"], markersize=2.0, zorder=2.4, linestyle="none"
    )


def _limits(what: MapPicture) -> Floats:
    """Return the corners (2, 2), low and high, of the bounding box of room and sensors."""
    assert what.scene.room is not None
    sensors = [sensor.position[None, :2] for sensor in (*what.scene.cameras, *what.scene.arrays, *what.added)]
    points = np.vstack([what.scene.room, *sensors])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * float((high - low).max())
    return np.array([low - margin, high + margin])


HEADING = "Expected error and coverage"
RANKINGS = {
    "added": "Added one after the other, each time the one that helps most",
    "candidates": "One more sensor, the best position first",
    "without": "One sensor less, the least needed first",
}


class PageInput(NamedTuple):
    """Content of the page of a plan: maps, summary of the command, warnings and provenance."""

    drawn: MapPicture
    summary: Mapping[str, object]
    warnings: tuple[str, ...]
    provenance: Mapping[str, object]


def plan_page(what: PageInput) -> str:
    """Return the HTML page of a plan as text."""
    unit = what.drawn.scene.length_unit
    words = "Seen from above, x and y to the same scale; the colours of the errors are on a logarithmic scale."
    with house_style():
        canvas = new_figure(*size_of(what.drawn))
        draw_maps(canvas, what.drawn)
        svg = Markup(page_svg(raw_svg(canvas), "plan", HEADING, words))
    rankings = {title: what.summary[name] for name, title in RANKINGS.items() if what.summary.get(name)}
    return template("plan.html.j2").render(
        title="What to expect of these sensors",
        heading=HEADING,
        unit=unit,
        figures=_figures(what.summary, unit),
        svg=svg,
        caption=words,
        rankings=rankings,
        warnings=what.warnings,
        provenance=json.dumps(what.provenance, indent=2, sort_keys=True, ensure_ascii=False, default=str),
        light=COLOURS,
        dark=DARK,
    )


def _figures(summary: Mapping[str, object], unit: str) -> list[tuple[str, str]]:
    """Name and formatted value of each figure of a plan's summary, for the page; `unit` is that of length."""
    number = {name: value for name, value in summary.items() if isinstance(value, int | float)}
    out = [
        (f"expected error over the floor, RMSE [{unit}]", f"{number[f'rmse_{unit}']:.3f}"),
        (f"its standard error [{unit}]", f"{number[f'rmse_error_{unit}']:.3f}"),
        (f"mean of the map [{unit}]", f"{number[f'mean_{unit}']:.3f}"),
        (f"worst position [{unit}]", f"{number[f'worst_{unit}']:.3f}"),
    ]
    if "share_within" in number:
        out.append((f"share below {number[f'within_{unit}']:g} {unit}", f"{number['share_within']:.1%}"))
    names = {
        "seen_by_2": "seen by two or more sensors",
        "seen_by_1": "by one",
        "seen_by_0": "by none",
        "unlocalised_share": "without a fix",
    }
    out += [(words, f"{number[name]:.1%}") for name, words in names.items()]
    return [*out, ("people near the target", str(summary["people"])), ("sensors", str(summary["sensors"]))]
