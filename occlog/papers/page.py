"""The page of an experiment: tables, plots, verdicts.

The page of `occlog reproduce`: a plot, a table and the verdicts of each experiment.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from occlog.report.drawing import COLOURS, DARK, house_style, new_figure, page_svg, raw_svg, template, to_png

from .plots import PlanFigure, Shots, draw_plan, plan_png, shots_png
from .verdicts import WORDS

SIZE = (8.4, 4.3)
LINES = ("t0", "t1", "t2", "t3", "t4", "t5", "moving", "muted", "ink")
"""Colours of the curves; the last two are those of lines across."""
FAR = 1.6
"""Lines across that are higher than this many times all curves are named in the legend and not drawn."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")


KINDS = dict(zip(WORDS, ("reproduced", "part", "not", "undecided"), strict=True))
"""Classes of the pages' style by the word of a verdict."""


class ChartCurve(NamedTuple):
    """One series of a chart.

    Attributes:
        name: name in the legend.
        x, y: values along the axes; y is a mean over runs.
        sd: standard deviations over runs, for error bars; NaN is drawn as none.
        across: heights of dotted horizontal lines.
    """

    name: str
    x: list[float]
    y: list[float]
    sd: list[float]
    across: list[float]


class Chart(NamedTuple):
    """One figure of curves, with all of its texts.

    Attributes:
        item: key of the experiment.
        title, x_label, y_label: title, and names of the axes.
        curves: series with means over runs.
        note: remark below the figure.
    """

    item: str
    title: str
    x_label: str
    y_label: str
    curves: list[ChartCurve]
    note: str


class ExperimentPage(NamedTuple):
    """Part of a paper's page about one experiment.

    Attributes:
        chart: its figure.
        size: numbers of runs and steps as text.
        verdicts: verdicts as JSON values.
        table: cells of the table as text; the first row has the heads.
        plans: floor plans and frames of videos, by name.
    """

    chart: Chart
    size: str
    verdicts: list[dict[str, object]]
    table: list[list[str]]
    plans: Mapping[str, PlanFigure | Shots] = {}


def draw(chart: Chart) -> Figure:
    """Draw means with bars of one standard deviation, and dotted lines across.

    Lines far above all curves (`FAR`) are in the legend only.
    """
    figure = new_figure(*SIZE)
    axes = figure.add_subplot()
    top = max((y for curve in chart.curves for y in curve.y), default=math.inf)
    curves = [c for c in chart.curves if c.x]
    lines = [(c.name, y) for c in chart.curves for y in c.across]
    for n, curve in enumerate(curves):
        _curve(axes, n, curve)
    few = sum(not c.x for c in chart.curves) <= 2
    for n, (name, y) in enumerate(lines):
        own = [k for k, c in enumerate(curves) if c.name == name]
        colour = COLOURS[LINES[own[0] if own else -1 - n % 2 if few else (len(curves) + n) % len(LINES)]]
        if y > FAR * top:
            axes.plot([], [], color=colour, linestyle=":", label=f"{name}: {y:.3g}, not shown")
        else:
            axes.axhline(y, color=colour, linestyle=":", linewidth=1.3, label="_" if own else name)
    _scale(axes, chart)
    columns = 4 if len(curves) + len(lines) <= 4 else 3
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns)
    return figure


def _curve(axes: Axes, n: int, curve: ChartCurve) -> None:
    """Draw a curve with its error bars into `axes`; `n` is its number, which selects colour and marker."""
    sd = [0.0 if math.isnan(s) else s for s in curve.sd]
    axes.errorbar(
        curve.x,
        curve.y,
        yerr=sd,
        color=COLOURS[LINES[n % len(LINES)]],
        marker=MARKERS[n % len(MARKERS)],
        markersize=4.5,
        linestyle="-" if len(curve.x) > 1 else "none",
        capsize=2.5,
        elinewidth=0.8,
        label=curve.name,
    )


def _scale(axes: Axes, chart: Chart) -> None:
    """Name the axes; y starts at 0 if no value is negative, and x has whole ticks if all of its values are whole."""
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(chart.y_label)
    if all(y >= 0.0 for c in chart.curves for y in (*c.y, *c.across)):
        axes.set_ylim(bottom=0.0)
    if all(x == round(x) for c in chart.curves for x in c.x):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def chart_png(chart: Chart) -> bytes:
    """A chart as PNG, in the style of all plots."""
    with house_style():
        return to_png(draw(chart), 110.0, {"Title": f"{chart.item}: {chart.title}"})


def build_reproduction(title: str, parts: Sequence[ExperimentPage], made: str) -> str:
    """Page of a paper as HTML: self-contained, without scripts; the same input gives the same bytes.

    Args:
        title: title of the paper.
        parts: experiments, in the order of the page.
        made: command, seed and version of the program as text.
    """
    with house_style():
        plots = [Markup(_svg(part.chart)) for part in parts]
        plans = [[(p, Markup(_picture(part.chart.item, name, p))) for name, p in part.plans.items()] for part in parts]
    return template("reproduce.html.j2", "occlog.papers", "page").render(
        title=title,
        parts=list(zip(parts, plots, plans, strict=True)),
        totals=[(kind, sum(v["verdict"] == kind for p in parts for v in p.verdicts)) for kind in WORDS],
        made=made,
        kinds=KINDS,
        shown=shown,
        light=COLOURS,
        dark=DARK,
    )


class Paper(NamedTuple):
    """Title of a paper, and the verdicts on its statements as JSON values."""

    title: str
    verdicts: list[dict[str, object]]


def build_verdicts(papers: Mapping[str, Paper], totals: Mapping[str, Mapping[str, int]], page: str, made: str) -> str:
    """Page of several papers as HTML: how many statements got which verdict, and all verdicts.

    Args:
        papers: papers by key.
        totals: by paper, and for all, the number of verdicts by word.
        page: name of the file of a paper's own page, in the folder that its key names.
        made: command, seed and version of the program as text.
    """
    return template("verdicts.html.j2", "occlog.papers", "page").render(
        papers=papers,
        totals=totals,
        page=page,
        made=made,
        words=WORDS,
        kinds=KINDS,
        shown=shown,
        light=COLOURS,
        dark=DARK,
    )


def _svg(chart: Chart) -> str:
    """A chart as SVG for a page, with an alternative text."""
    words = f"{chart.y_label} against {chart.x_label}: {', '.join(c.name for c in chart.curves)}"
    return page_svg(raw_svg(draw(chart)), chart.item, chart.title, words)


def picture_png(picture: PlanFigure | Shots) -> bytes:
    """A floor plan, or frames of a video, as PNG."""
    return plan_png(picture) if isinstance(picture, PlanFigure) else shots_png(picture)


def _picture(item: str, name: str, picture: PlanFigure | Shots) -> str:
    """HTML element of a floor plan or of frames; `item`, of the experiment, and `name`, of the picture, give its id."""
    if isinstance(picture, PlanFigure):
        return _plan_svg(item, name, picture)
    data = base64.b64encode(shots_png(picture)).decode()
    words = escape(f"{picture.title}: {', '.join(picture.rows)}")
    return f'<img class="plot" alt="{words}" src="data:image/png;base64,{data}">'


def _plan_svg(item: str, name: str, plan: PlanFigure) -> str:
    """A floor plan as SVG for a page; `item`, of the experiment, and `name`, of the picture, give its id."""
    words = "; ".join(f"{p.title}: true path, {', '.join(e.name for e in p.estimates)}" for p in plan.panels)
    return page_svg(raw_svg(draw_plan(plan)), f"{item}-{name}", plan.title, words)


def shown(value: float | None) -> str:
    """`value` as text with four digits; a dash for None, NaN and infinite values."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}"
