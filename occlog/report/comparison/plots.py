"""Figures of the comparison of two runs (errors, matched tracks), and data for the page's replay.

Of the common frames every k-th is kept, with the smallest k such that at most `MAX_TIME_STEPS` frames, `MAX_SHOWN`
estimates of both runs and as many true positions remain; frames to which the page links are kept as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from occlog.array_types import NS, Floats, Ints
from occlog.records.tables import Tracks, Truth
from occlog.report.content.downsampled import MAX_SHOWN, MAX_TIME_STEPS
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.drawing import COLOURS, Style, label, sensible_top, target_colour
from occlog.report.plots.floorplan import plan_limits
from occlog.report.plots.over_time import along_time, line
from occlog.report.replay.build import MAX_BOXES, MAX_EVENTS, Layer, plan_values, safe_json
from occlog.report.replay.steps import MISSING, ReplaySteps, packed

from .matching.divergences import ErrorsOverTime
from .matching.pairs import Piece
from .words import RunComparisonPage, RunSide, followed

MAX_LIVES = 20
"""People who have their own rows."""
MAX_PIECES = 300
"""Maximum number of drawn line segments of one person."""
LEAST = 0.01
"""Share of the distance at which tracks meet that axes of errors show at least."""
STYLES: dict[str, Style] = {
    "A": {"color": COLOURS["seen"], "linewidth": 1.2},
    "B": {"color": COLOURS["bound"], "linewidth": 1.2, "linestyle": (0, (5, 1.2))},
}
"""Line styles of the runs: by colour, or by dashes without colours."""


class PersonLifeline(NamedTuple):
    """A person's tracks in runs A and B over time.

    Attributes:
        name: name of the person in the plot.
        a, b: intervals with the track of each, in run A and in run B.
    """

    name: str
    a: tuple[Piece, ...]
    b: tuple[Piece, ...]


def draw_errors(figure: FigureBase, time: TimeAxis, found: ErrorsOverTime, near: float, unit: str) -> None:
    """Draw the errors of both runs, their difference, and the numbers of missed targets, one below the other.

    Args:
        figure: is drawn into.
        time: axis.
        found: errors over time.
        near: match threshold [unit]; the axes of errors extend at least to a hundredth of it.
        unit: unit of lengths.
    """
    errors, difference, missed = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.2, 1.2])
    both = np.flatnonzero(np.isfinite(found.a))
    t_ns = found.t_ns[both]
    for letter, values in (("A", found.a[both]), ("B", found.b[both])):
        line(errors, time, t_ns, values, label=letter, **STYLES[letter])
    errors.set_ylim(0.0, max(sensible_top(found.a[both], found.b[both]), LEAST * near))
    errors.set_ylabel(f"error [{label(unit)}]")
    change = found.b[both] - found.a[both]
    line(difference, time, t_ns, change, color=COLOURS["ink"], linewidth=0.9)
    difference.axhline(0.0, color=COLOURS["muted"], linewidth=0.8, zorder=1)
    top = max(sensible_top(np.abs(change)), LEAST * near)
    difference.set_ylim(-top, top)
    difference.set_ylabel("B \N{MINUS SIGN} A")
    for letter, count in (("A", found.missed_a), ("B", found.missed_b)):
        line(missed, time, found.t_ns, count.astype(np.float64), **STYLES[letter])
    missed.set_ylim(bottom=0.0, top=max(1.0, 1.1 * float(max(found.missed_a.max(), found.missed_b.max()))))
    missed.set_ylabel("not found")
    missed.yaxis.get_major_locator().set_params(integer=True)
    along_time(missed, time)
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def draw_lives(figure: FigureBase, time: TimeAxis, lives: Sequence[PersonLifeline]) -> None:
    """Draw two bars for each person of `lives` into a figure, run A above B: a colour per track, a mark at changes."""
    axes = figure.add_subplot()
    for index, life in enumerate(lives):
        for letter, pieces, offset in (("A", life.a, 0.21), ("B", life.b, -0.21)):
            y = offset - float(index)
            _bar(axes, time, pieces[:MAX_PIECES], y)
            axes.text(-0.006, y, letter, transform=axes.get_yaxis_transform(), ha="right", va="center", fontsize=7.5)
    axes.set_yticks(-np.arange(len(lives), dtype=float), [label(life.name, 18) for life in lives])
    axes.tick_params(axis="y", length=0, pad=14)
    axes.set_ylim(-len(lives) + 0.4, 0.6)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    along_time(axes, time)
    mark = Line2D([], [], linestyle="", marker="|", color=COLOURS["ink"], label="another track from here on")
    figure.legend(handles=[mark], loc="outside lower center")


def _bar(axes: Axes, time: TimeAxis, pieces: Sequence[Piece], y: float) -> None:
    """Draw the intervals of one person in one run as a bar at the ordinate y, with track numbers where they fit."""
    tracks = list(dict.fromkeys(piece.track for piece in pieces))
    for before, piece in zip((None, *pieces), pieces, strict=False):
        start, end = time.of(np.array([piece.start_ns, piece.end_ns])).tolist()
        length = max(end - start, 0.002 * time.length)
        colour = target_colour(tracks.index(piece.track))
        axes.broken_barh([(start, length)], (y - 0.17, 0.34), facecolor=colour, linewidth=0, alpha=0.8)
        if before is not None and before.track != piece.track:
            axes.plot([start, start], [y - 0.21, y + 0.21], color=COLOURS["ink"], linewidth=1.4)
        if length > 0.05 * time.length:
            text = str(piece.track)
            axes.text(start + length / 2, y, text, ha="center", va="center", fontsize=7, color=COLOURS["halo"])


PAIR_COLOURS = 6
"""Number of colours of pairs of targets; they repeat."""


@dataclass(frozen=True, eq=False)
class CommonMoments(ReplaySteps):
    """Replay of one run at times that are common to both runs.

    Attributes:
        common: (M,) times that the page shows [ns].
    """

    common: Ints

    @cached_property
    def kept(self) -> Ints:
        """Times (M,) that the page shows [ns]."""
        return self.common

    @cached_property
    def same(self) -> bool:
        """False: tracks are shown under their own numbers, not as the targets of the truth."""
        return False


@dataclass(frozen=True)
class RunComparisonReplay:
    """Data of the replay of two runs in the page.

    Attributes:
        json: input of the script, safe inside a `<script>` element.
        words: sentences about what is shown and what is skipped.
        people: people that the reader can switch off: name, number, and index of the colour (-1: none).
        layers: parts of the drawing that the reader can switch off.
    """

    json: str
    words: str
    people: list[tuple[str, int, int]]
    layers: list[Layer]


def beside_replay(found: RunComparisonPage, led_to: list[int]) -> RunComparisonReplay | None:
    """Return the data of the replay of two runs; None with fewer than two time steps.

    Args:
        found: the compared runs.
        led_to: times [ns] that the page links to, which are kept.
    """
    times = found.times
    truth = found.a.data.truth
    rows = len(found.a.laid.frame) + len(found.b.laid.frame)
    true = 0 if truth is None else len(truth)
    every = max(1, -(-len(times) // MAX_TIME_STEPS), -(-rows // MAX_SHOWN), -(-true // MAX_SHOWN))
    kept = np.union1d(times[::every], times[np.isin(times, led_to)])
    if len(kept) < 2:
        return None
    drawn = [_drawn(side, times, truth if letter == "A" else None) for letter, side in found.sides]
    limits = _both(plan_limits(drawn[0]), plan_limits(drawn[1]))
    steps = [CommonMoments(data, limits, kept) for data in drawn]
    parts = [plan_values(each.data, each)[::2] for each in steps]
    colours = _colours(found)
    for (values, _), (letter, _), data in zip(parts, found.sides, drawn, strict=True):
        numbers = {label: k for k, person in enumerate(found.pairs.people) for label in getattr(person, letter.lower())}
        values["person"] = [numbers[label] for label in data.targets]
        values["colours"] = [colours[numbers[label]] for label in data.targets]
    start = found.time.start_ns
    frames = np.searchsorted(times, kept)
    values = {
        "second": found.time.ns_per_unit / NS,
        "times": packed("f8", (kept - start) / NS),
        "a": parts[0][0],
        "b": parts[1][0],
        "partner": _partners(found, steps[0]),
        "apart": packed("f8", _most(found.frame_divergences.distance, frames).round(6)),
        "alone": packed("u4", _most(found.frame_divergences.alone, frames).astype(np.int64)),
        "changes": _changes(found, start),
    }
    layers = list(dict.fromkeys([*parts[0][1], *parts[1][1]]))
    people = [(name_of(person), k, colours[k]) for k, person in enumerate(found.pairs.people[:MAX_BOXES])]
    return RunComparisonReplay(safe_json(values), _words(found, kept, every, steps[0].step), people, layers)


def name_of(person: Any) -> str:
    """Return the label of a person (`PersonPair`): the tracks in both runs, such as `A 3, 7 · B 5`."""
    sides = (("A", person.a), ("B", person.b))
    return " · ".join(f"{letter} {', '.join(map(str, labels))}" for letter, labels in sides if labels)


def _drawn(side: RunSide, times: Ints, truth: Truth | None) -> ReportInput:
    """Return the tables of a run that are drawn: estimates at the common times, and occluder priors.

    Args:
        side: the run.
        times: (T,) common times [ns].
        truth: drawn as well; None: not.
    """
    table: Tracks = side.laid.table(side.tracks, times)
    return replace(
        side.data, tracks=table, truth=truth, bearings=None, errors=None, bound=None, events=None, collected=None
    )


def _both(a: Floats, b: Floats) -> Floats:
    """Return the bounding box of two boxes, each as corners (2, 2): lowest x and y, then highest."""
    return np.array([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def _colours(found: RunComparisonPage) -> list[int]:
    """Colour index of each person; -1 for people in one run only."""
    out, k = [], 0
    for person in found.pairs.people:
        both = bool(person.a and person.b)
        out.append(k % PAIR_COLOURS if both else -1)
        k += both
    return out


def _partners(found: RunComparisonPage, steps: ReplaySteps) -> Any:
    """Return, packed for the script, the partner of each estimate of A at the shown times: its index in B's targets.

    `MISSING` is used without a partner.
    """
    partner = np.full(len(found.a.laid.frame), MISSING, dtype=np.int64)
    targets = np.unique(found.b.laid.label)
    partner[found.pairs.a] = np.searchsorted(targets, found.b.laid.label[found.pairs.b])
    rows, _ = steps.at(found.times[found.a.laid.frame])
    return packed("u2", partner[rows])


def _most(values: np.ndarray, frames: Ints) -> np.ndarray:
    """Return the maxima (M,) of `values` (F,) over the frames since the previous of the kept `frames` (M,)."""
    return np.asarray(np.maximum.reduceat(values, np.concatenate([[0], frames[:-1] + 1])))


def _changes(found: RunComparisonPage, start: int) -> list[float]:
    """Return the times of identity changes in either run, in seconds after `start` [ns].

    They are evenly thinned if there are more than `MAX_EVENTS`.
    """
    changes = [change for each in followed(found) for change in each.changes]
    times = np.unique(np.array([change.t_ns for change in changes], dtype=np.int64))
    some = times[np.unique(np.linspace(0, len(times) - 1, min(len(times), MAX_EVENTS)).round().astype(int))]
    return [round(float(t - start) / NS, 6) for t in some]


def _words(found: RunComparisonPage, kept: Ints, every: int, step: float) -> str:
    count = f"{len(kept):,}"
    out = [f"{count} of {len(found.times):,} time steps: every {every}-th." if every > 1 else f"{count} time steps."]
    out.append("The same colour is the same person, where the runs agree; grey: in one run only.")
    out.append("A dashed ring is a target that no sensor sees, or of which something is uncertain.")
    out += ["A cross is where one truly is."] if found.a.data.truth is not None else []
    out.append(
        "The strip shows the largest distance of partners; orange below it: one run alone has a person; "
        "red: the track of a person changes."
    )
    out.append(f"Positions are rounded to {step:.1g} {found.unit}.")
    return " ".join(out)
