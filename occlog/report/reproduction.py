"""The page of `occlog reproduce`: a plot, a table and the verdicts of each experiment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from .style import COLOURS, DARK, house_style, new_figure, raw_svg, target_colour, to_png
from .svg import page_svg

SIZE = (8.4, 4.3)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
KINDS = ("reproduced", "in part", "not reproduced")


class Curve(NamedTuple):
    """One series of a chart: mean and standard deviation over runs, and lines across."""

    name: str
    x: list[float]
    y: list[float]
    sd: list[float]
    across: list[float]


class Chart(NamedTuple):
    """One figure."""

    item: str
    title: str
    x_label: str
    y_label: str
    curves: list[Curve]
    log_x: bool
    note: str


class Part(NamedTuple):
    """One experiment on the page."""

    chart: Chart
    size: str
    verdicts: list[dict[str, Any]]
    table: list[list[str]]  # first row: heads


def draw(chart: Chart) -> Figure:
    """The chart: means with bars of one standard deviation; dotted lines across."""
    figure = new_figure(*SIZE)
    axes = figure.add_subplot()
    for n, curve in enumerate(chart.curves):
        colour, label = target_colour(n), curve.name
        if curve.x:
            sd = [0.0 if math.isnan(s) else s for s in curve.sd]
            style = "-" if len(curve.x) > 1 else "none"
            axes.errorbar(curve.x, curve.y, yerr=sd, color=colour, marker=MARKERS[n % len(MARKERS)], markersize=4.5,
                          linestyle=style, capsize=2.5, elinewidth=0.8, label=label)  # fmt: skip
            label = "_"
        for y in curve.across:
            axes.axhline(y, color=colour, linestyle=":", linewidth=1.3, label=label)
            label = "_"
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(chart.y_label)
    if chart.log_x:
        axes.set_xscale("log")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]) if axes.get_ylim()[0] < 0 else 0.0)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def chart_png(chart: Chart) -> bytes:
    """The chart as a picture."""
    with house_style():
        return to_png(draw(chart), 110.0, {"Title": f"{chart.item}: {chart.title}"})


def build_reproduction(title: str, parts: Sequence[Part]) -> str:
    """The page as HTML: self-contained, without scripts; the same input gives the same bytes."""
    with house_style():
        plots = [Markup(_svg(part.chart)) for part in parts]
    environment = Environment(
        loader=PackageLoader("occlog.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    return environment.get_template("reproduce.html.j2").render(
        title=title,
        parts=list(zip(parts, plots, strict=True)),
        totals=[(kind, sum(v["verdict"] == kind for p in parts for v in p.verdicts)) for kind in KINDS],
        shown=shown,
        light=COLOURS,
        dark=DARK,
    )


def _svg(chart: Chart) -> str:
    words = f"{chart.y_label} against {chart.x_label}: {', '.join(c.name for c in chart.curves)}"
    return page_svg(raw_svg(draw(chart)), chart.item, chart.title, words)


def shown(value: float | None) -> str:
    """A number with four digits; a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}"
