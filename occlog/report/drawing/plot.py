"""A figure of a page: drawn, in words, and with the place of its axis of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from markupsafe import Markup
from matplotlib.figure import Figure as Canvas
from matplotlib.figure import FigureBase

from occlog.report.content.model import TIME_LABEL

from .style import new_figure, raw_svg
from .svg import page_svg


@dataclass(frozen=True)
class Plot:
    """One figure of the page: the picture, its heading, what it says in words, and where its axis of time lies."""

    heading: str
    svg: Markup
    caption: str
    time: TimeSpan | None = None


class TimeSpan(NamedTuple):
    """The axis of time of a figure: its ends as shares of the width, and their times in the unit of the page."""

    x0: float
    x1: float
    t0: float
    t1: float


def plot(name: str, heading: str, caption: str, size: tuple[float, float], draw: Callable[[FigureBase], None]) -> Plot:
    """Draw a figure, inside `house_style`.

    Args:
        name: of its parts in the page.
        heading: of the figure.
        caption: what it says in words.
        size: width and height [inches].
        draw: draws into an empty figure.
    """
    canvas: Canvas = new_figure(*size)
    draw(canvas)
    svg = Markup(page_svg(raw_svg(canvas), name, heading, caption))
    return Plot(heading, svg, caption, _time_of(canvas))


def _time_of(canvas: Canvas) -> TimeSpan | None:
    """Where the axis of time of a drawn figure lies; None: it has none."""
    for axes in canvas.axes:
        if axes.get_xlabel().startswith(TIME_LABEL):
            box, (t0, t1) = axes.get_position(), axes.get_xlim()
            return TimeSpan(round(box.x0, 4), round(box.x1, 4), round(float(t0), 6), round(float(t1), 6))
    return None
