"""Overview picture: floor plan, error and bound, observation coverage, key figures."""

from __future__ import annotations

import json
from collections.abc import Callable
from textwrap import wrap
from typing import NamedTuple

from matplotlib.figure import FigureBase, SubFigure

from occlog.report.content.model import ReportInput
from occlog.report.drawing import COLOURS, house_style, label, new_figure, to_png
from occlog.report.plots.floorplan import draw_floorplan
from occlog.report.plots.over_time import (
    axes_of,
    draw_accuracy,
    draw_crowd,
    draw_sight,
    draw_visibility,
    sensors,
    watched,
)

from .page import headline


class PicturePanel(NamedTuple):
    """Panel of the picture: heading, relative height, and the function that draws it."""

    heading: str
    height: float
    draw: Callable[[FigureBase], None]


DPI = 110.0
SIZE = (15.0, 9.6)
MAX_ROWS = 20
"""Sensors with sightings that fit next to the floor plan; the page has more."""


def build_picture(data: ReportInput) -> bytes:
    """Return the overview of a run as PNG; targets after the first are in the floor plan only."""
    texts = {"Title": data.title, "Description": json.dumps(data.provenance, sort_keys=True, default=str)}
    with house_style():
        canvas = new_figure(*SIZE)
        top, middle = canvas.subfigures(2, 1, height_ratios=[1.15, 8.0], squeeze=False)[:, 0]
        _figures(top, data)
        _arrange(middle, data, _panels(data))
        return to_png(canvas, DPI, texts)


def _arrange(figure: SubFigure, data: ReportInput, panels: list[PicturePanel]) -> None:
    """Draw the floor plan on the left of a figure, and the other panels on the right.

    Of tracks in images, people only.
    """
    if data.in_images:
        if data.people_tracks is not None and data.people is not None:
            draw_crowd(figure, data, data.people_tracks, data.people)
        return
    if not panels:
        draw_floorplan(figure, data)
        return
    left, right = figure.subfigures(1, 2, width_ratios=[1.0, 1.05], squeeze=False)[0]
    draw_floorplan(left, data)
    _head(left, "Floor plan")
    heights = [panel.height for panel in panels]
    parts = right.subfigures(len(panels), 1, height_ratios=heights, squeeze=False)[:, 0]
    for part, panel in zip(parts, panels, strict=True):
        _head(part, panel.heading)
        panel.draw(part)


def _figures(figure: FigureBase, data: ReportInput) -> None:
    """Draw the title and up to seven headline figures of a run as text."""
    figure.text(0.012, 0.8, label(data.title, 80), fontsize=15, fontweight="bold", va="center")
    shown = headline(data)[:7]
    step = 0.98 / max(len(shown), 6)
    for i, item in enumerate(shown):
        x = 0.012 + i * step
        figure.text(x, 0.42, f"{item.value} {label(item.unit, 8)}".strip(), fontsize=15, va="center")
        words = "\n".join([label(item.name, 36), *wrap(label(item.note, 70), 28)])
        figure.text(x, 0.24, words, fontsize=8.5 if len(shown) < 7 else 7.5, va="top", color=COLOURS["muted"])


def _head(figure: FigureBase, text: str) -> None:
    figure.suptitle(text, x=0.015, ha="left", fontsize=10.5, fontweight="bold")


def _panels(data: ReportInput) -> list[PicturePanel]:
    """Return the panels of a run: error (or residuals) of the first target, and its observation coverage."""
    out: list[PicturePanel] = []
    coverage, errors = data.coverage, data.errors
    first = data.targets[0] if data.targets else None
    target_note = "" if len(data.targets) <= 1 else f", target {first}"
    compared = data.compared[0] if data.relabelled else first
    if compared is not None and errors is not None and (errors.target_id == compared).any():
        height = 4.8 if axes_of(errors.take(errors.target_id == compared)) == "xy" else 5.8
        of = f", {data.whose_errors(compared)}" if data.relabelled else target_note
        what = "Error" if data.bound is None else "Error and bound"
        out.append(PicturePanel(f"{what}{of}", height, lambda f: draw_accuracy(f, data, errors, compared)))
    elif first is not None and first in data.residuals and data.residuals[first].any:
        out.append(PicturePanel(f"Track and lines of sight{target_note}", 4.4, lambda f: draw_sight(f, data, first)))
    seen = watched(data)
    if coverage is not None and seen:
        target = first if first in seen else seen[0]
        rows = min(len(sensors(data)), MAX_ROWS)
        height = min(1.4 + 0.24 * rows, 4.8)
        of = target_note if data.same_names else data.whose_bearings(target)
        out.append(
            PicturePanel(
                f"What each sensor saw{of}", height, lambda f: draw_visibility(f, data, coverage, target, rows)
            )
        )
    return out
