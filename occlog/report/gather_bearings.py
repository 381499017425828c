"""Goes through the bearings of a report: alone, then beside the tracks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.consistency.verdict import Evidence
from occlog.core.metrics.sums import group_medians
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.evidence import SightEvidence, in_rows_of
from occlog.evaluate.matching.outline import NEAR_NS
from occlog.evaluate.verdict import Made
from occlog.io.files.put_aside.blocks import Blocks
from occlog.io.files.put_aside.spool import Spool
from occlog.records.pieces import LAST, Limits, Side, in_step, whole_times
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Tracks
from occlog.report.content.looks import MOST_SENSORS, MOST_TARGETS, Looked, LookStreams, known_first
from occlog.report.content.off_sight import Distances, OffSightStreams, Residual
from occlog.report.content.plane_of_sight import period_of, places, share_times, sight_lines
from occlog.report.content.thinned import Whole, fewer, shortly_before

STEP = np.dtype([("group", "i8"), ("step", "f8")])
"""The time between two sightings of a target by a sensor: the number of both, and nanoseconds."""


class Posts:
    """Estimates on both sides of gaps, between which places are interpolated however wide they are."""

    def __init__(self) -> None:
        """No estimates yet."""
        self._parts: list[Tracks] = []
        self._last = Tracks.empty()
        self._all: Tracks | None = None

    def add(self, tracks: Tracks) -> None:
        """Some more, in the order of time."""
        own = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
        both = Tracks.concat([self._last, Tracks(**own)])
        order = np.lexsort((both.t_ns, both.target_id))
        t_ns, target = both.t_ns[order], both.target_id[order]
        wide = (np.diff(target) == 0) & (np.diff(t_ns) > NEAR_NS)
        self._parts.append(both.take(np.sort(order[np.append(wide, False) | np.append(False, wide)])))
        self._last = both.take(np.sort(order[np.append(np.diff(target) != 0, True)]))

    def about(self, limits: Limits, side: Side[Tracks]) -> Tracks:
        """All estimates between which those of a stretch of time lie; the side has those `NEAR_NS` about it."""
        if self._all is None:
            found = Tracks.merge(self._parts)
            _, first = np.unique(np.column_stack([found.t_ns, found.target_id]), axis=0, return_index=True)
            self._all = found.take(np.sort(first))
        near = limits.about(side, NEAR_NS)
        if not len(self._all):
            return near
        low = limits.begin - NEAR_NS
        high = limits.end if limits.end == LAST else limits.end + NEAR_NS
        before, after = self._all.t_ns < low, self._all.t_ns >= high
        return Tracks.concat([self._all.take(before), near, self._all.take(after)])


@dataclass(frozen=True)
class Beside:
    """What bearings are compared with.

    Attributes:
        tracks: gives all estimates, as often as wanted.
        diagnostics: gives one row for each of them; None: not known.
        posts: of all estimates.
        evidence: takes what bearings say for and against them.
        made: how they were made.
        without: targets of which no error is known, whose distances from where sight lines meet are asked for.
    """

    tracks: Callable[[], Iterator[Tracks]]
    diagnostics: Callable[[], Iterator[Diagnostics]] | None
    posts: Posts
    evidence: Evidence
    made: Made
    without: frozenset[int]


@dataclass
class Found:
    """Bearings of which a part is drawn.

    Attributes:
        table: those of the moments.
        whole: what is known of all rows.
        looked: what they tell together.
        every: each so manieth moment has its bearings.
        residuals: of each track.
        sight: distances of each track of which no error is known.
    """

    table: Bearings
    whole: Whole
    looked: Looked
    every: int
    residuals: dict[int, Residual] = field(default_factory=dict)
    sight: dict[int, Distances] = field(default_factory=dict)


class _Periods:
    """Whether the sensors that see a target share their times, and how long a scan is where they do not."""

    def __init__(self, scene: Scene, targets: frozenset[int]) -> None:
        self._scene, self._targets = scene, sorted(targets)
        self._rows, self._together = dict.fromkeys(targets, 0), dict.fromkeys(targets, 0)
        self._steps, self._last = Blocks(STEP), dict[int, int]()
        self._sensors = max(len(places(scene)), 1)
        self._counts = np.zeros(len(targets) * self._sensors, dtype=np.int64)

    def add(self, bearings: Bearings) -> None:
        """Some more, which end between two times."""
        for k, (target, lines) in enumerate(sight_lines(bearings, self._scene, self._targets).items()):
            self._rows[target] += len(lines.t_ns)
            self._together[target] += int(np.count_nonzero(share_times(lines.t_ns)))
            for sensor in np.unique(lines.sensor).tolist():
                own, group = lines.t_ns[lines.sensor == sensor], k * self._sensors + sensor
                steps = np.diff(own) if group not in self._last else np.diff(own, prepend=self._last[group])
                self._last[group] = int(own[-1])
                self._counts[group] += len(steps)
                rows = np.empty(len(steps), dtype=STEP)
                rows["group"], rows["step"] = group, steps
                self._steps.append(rows)

    def periods_ns(self) -> dict[int, int | None]:
        """That of each target; None: its sensors share their times."""
        out: dict[int, int | None] = {t: None for t in self._targets if 2 * self._together[t] >= self._rows[t]}
        if len(out) < len(self._targets):
            self._steps.end()
            medians = group_medians(self._blocks, self._counts).reshape(len(self._targets), self._sensors)
            for target, own in zip(self._targets, medians, strict=True):
                out.setdefault(target, period_of(own[np.isfinite(own)].tolist()))
        return out

    def _blocks(self) -> Iterator[tuple[Ints, Floats]]:
        for number in range(self._steps.count):
            rows = self._steps.get(number)
            yield rows["group"], rows["step"]


def bearings_of(
    stream: Callable[[], Iterator[Bearings]],
    scene: Scene | None,
    targets: tuple[int, ...],
    moments: tuple[Ints, float],
    beside: Beside | None,
    most: int = sys.maxsize,
) -> Found:
    """Go through all bearings twice.

    Args:
        stream: gives them, in the order of time, as often as wanted.
        scene: the sensors.
        targets: that are tracked.
        moments: times that the replay shows, and the usual time between two of all times [ns].
        beside: what they are compared with; None: nothing.
        most: how many of them are drawn, about.
    """
    looks, steps, times, span = LookStreams(), Spool(), 0, (0, 0)
    kept, step_ns = moments
    counts = np.zeros(len(kept), np.int64)
    periods = None if beside is None or scene is None else _Periods(scene, beside.without)
    for piece in whole_times(stream()):
        first = np.unique(piece.t_ns)
        steps.add(np.diff(first if not times else np.append(span[1], first)).astype(np.float64))
        span = int(first[0]) if not times else span[0], int(first[-1])
        times += len(first)
        looks.add(piece)
        counts += np.bincount(shortly_before(kept, step_ns, piece.t_ns)[1], minlength=len(kept))
        if periods is not None:
            periods.add(piece)
    every = max(-(-looks.rows // most), 1)
    step = 1 if every == 1 else fewer(counts, most)
    shown, parts = kept[::step], [Bearings.empty()]

    def keep(part: Bearings) -> None:
        parts.append(part if every == 1 else part.take(shortly_before(shown, step_ns, part.t_ns)[0]))

    residuals, sight = dict[int, Residual](), dict[int, Distances]()
    if beside is None or scene is None or periods is None:
        for part in stream():
            keep(part)
    else:
        off = OffSightStreams(scene, targets, looks.labels, periods.periods_ns(), every)
        for ours, part in _beside(stream, scene, beside):
            off.add(ours, part)
            keep(part)
        residuals, sight = off.finish()
    named = known_first(scene, looks.sensors)[:MOST_SENSORS]
    watched = tuple(i for i in looks.labels if i != UNLABELLED) or looks.labels
    looked = looks.finish(named, dict.fromkeys((*watched[:MOST_TARGETS], *targets[:1])))
    whole = Whole(looks.rows, times, every, shown, median_of(steps) if steps.count else float(NS), span)
    return Found(Bearings.concat(parts), whole, looked, step, residuals, sight)


def _beside(
    stream: Callable[[], Iterator[Bearings]], scene: Scene, beside: Beside
) -> Iterator[tuple[Tracks, Bearings]]:
    """Stretches of bearings, and all estimates between which they are; evidence is gathered on the way."""
    sight = SightEvidence(beside.evidence, scene, beside.made, ())
    tracks, bearings = Side(beside.tracks(), Tracks), Side(stream(), Bearings)
    said: Side[Diagnostics] | None = None
    if beside.diagnostics is not None:
        rows = in_rows_of(beside.tracks(), beside.diagnostics())
        said = Side(rows, Diagnostics)
    sides: list[Side[Any]] = [tracks, bearings, *([] if said is None else [said])]
    margins = [max(NEAR_NS, sight.margin_ns), *[sight.margin_ns] * (len(sides) - 1)]
    for limits in in_step(sides, margins):
        sight.update(limits, tracks, bearings, said)
        yield beside.posts.about(limits, tracks), limits.of(bearings)
    sight.finish()
