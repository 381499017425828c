"""Everybody over time: how many people there are, who is there, who sees them, and where identities are in doubt."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from occlog.array_types import Ints
from occlog.records.tables import Events, PeopleTracks
from occlog.report.content.looks import MOST_SENSORS
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.content.people import Crowd, People, true_people, usual_step
from occlog.report.drawing.style import COLOURS, label

from .accuracy import line
from .visibility import HEIGHT, draw_rows

LONGEST_GAP = 1.5
"""A row of a track lasts until the next one, but at most so many usual periods."""
SEEN, ONE_VIEW, UNSEEN = "seen", "view", "hidden"
"""Colours of people of whom several cameras, one camera or none has a box."""


def draw_crowd(figure: FigureBase, data: ReportInput, tracks: PeopleTracks, found: People) -> None:
    """Draw how many people there are, above, and a row for each of them, below."""
    people, events = found.drawn, data.events
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, max(0.16 * len(people), 0.6)))
    _counts(above, data, found.crowd)
    for place, identity in enumerate(people.tolist()):
        _life(below, data.time, tracks.take(tracks.target_id == identity), -float(place))
    _doubts(below, data.time, people, events)
    below.set_yticks(-np.arange(len(people), dtype=float), [str(i) for i in people.tolist()])
    below.tick_params(axis="y", length=0, labelsize=min(8.0, 330.0 / max(len(people), 1) ** 0.95))
    below.set_ylim(-len(people) + 0.4, 0.6)
    below.set_ylabel("identity")
    below.grid(False)
    below.spines["left"].set_visible(False)
    below.set_xlim(0.0, max(data.time.length, 1e-9))
    below.set_xlabel(data.time.label)
    figure.legend(handles=_legend(data, events), loc="outside lower center", ncols=4)


def draw_seen_by(figure: FigureBase, data: ReportInput, found: People) -> None:
    """Draw for each camera, over time, the share of the people there of whom it has a box."""
    names = found.cameras[:MOST_SENSORS]
    axes = figure.add_subplot()
    rows = [found.sightings(name) for name in names]
    draw_rows(axes, data.time, rows, [label(n, 18) for n in names])
    kinds = (
        ("seen", "share of the people there that it sees"),
        ("hidden", "the others"),
        ("absent", "nobody is there"),
    )
    handles = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def _counts(axes: Axes, data: ReportInput, found: Crowd) -> None:
    if data.truth is not None:
        times, number = true_people(data.truth, data.whole["truth"].at)
        line(axes, data.time, times, number, color=COLOURS["muted"], linewidth=2.6, alpha=0.5)
    line(axes, data.time, found.t_ns, found.people, color=COLOURS["ink"], linewidth=1.1)
    line(axes, data.time, found.t_ns, found.seen, color=COLOURS[SEEN], linewidth=0.9)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
    axes.set_ylabel("people")


def _life(axes: Axes, time: TimeAxis, own: PeopleTracks, y: float) -> None:
    """A bar where the person is there, in the colour of how many cameras see them."""
    last = max(int(LONGEST_GAP * usual_step(own.t_ns)), 1)
    ends = np.append(np.minimum(own.t_ns[1:], own.t_ns[:-1] + last), own.t_ns[-1] + last)
    kind = np.where(own.seen_by == "", 2, np.where(np.char.find(own.seen_by, ",") < 0, 1, 0))
    # Neighbours of one kind are one piece
    first = np.concatenate([[True], (np.diff(kind) != 0) | (own.t_ns[1:] > ends[:-1])])
    begins, stops, kinds = own.t_ns[first], ends[np.append(first[1:], True)], kind[first]
    for place, colour in enumerate((SEEN, ONE_VIEW, UNSEEN)):
        mine = kinds == place
        spans = np.column_stack([time.of(begins[mine]), time.of(stops[mine]) - time.of(begins[mine])])
        axes.broken_barh(spans.tolist(), (y - HEIGHT / 2, HEIGHT), facecolor=COLOURS[colour], linewidth=0)


def _doubts(axes: Axes, time: TimeAxis, people: Ints, events: Events | None) -> None:
    """A mark in the row of each identity that may have been exchanged."""
    if events is None:
        return
    doubts = events.take((events.kind == "doubt") & np.isin(events.target_id, people))
    place = {identity: row for row, identity in enumerate(people.tolist())}
    rows = [-float(place[i]) for i in doubts.target_id.tolist()]
    axes.plot(time.of(doubts.t_ns), rows, "x", color=COLOURS["t5"], markersize=4.5, markeredgewidth=1.4)


def _legend(data: ReportInput, events: Events | None) -> list[Patch | Line2D]:
    kinds = ((SEEN, "seen by several cameras"), (ONE_VIEW, "by one camera"), (UNSEEN, "by none: predicted"))
    out: list[Patch | Line2D] = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in kinds]
    if events is not None and (events.kind == "doubt").any():
        out.append(Line2D([], [], linestyle="", marker="x", color=COLOURS["t5"], label="may have been exchanged"))
    out.append(Line2D([], [], color=COLOURS["ink"], linewidth=1.1, label="people there"))
    out.append(Line2D([], [], color=COLOURS[SEEN], linewidth=0.9, label="seen by a camera"))
    if data.truth is not None and (data.truth.role == "target").any():
        out.append(Line2D([], [], color=COLOURS["muted"], linewidth=2.6, alpha=0.5, label="truth"))
    return out
