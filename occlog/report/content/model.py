"""What a report is made of, and what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.errors import InputError
from occlog.evaluate.verdict import Made, judge
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Bound,
    Diagnostics,
    Errors,
    Events,
    Hulls,
    Occluders,
    PeopleTracks,
    Tracks,
    Truth,
)
from occlog.track.plausibility.verdict import Finding

from .plane_of_sight import Residuals, distances, residuals
from .thinned import ErrorsSoFar, Whole

TIME_LABEL = "time since start"
CALENDAR_FROM_NS = 365 * 86_400 * NS
"""Times later than this (the year 1971) are dates; earlier ones count from a simulation's start."""


@dataclass(frozen=True)
class TimeAxis:
    """Time as drawn: elapsed since the first row, in a unit that suits the length."""

    start_ns: int
    end_ns: int

    @property
    def unit(self) -> str:
        """`s`, `min` or `h`."""
        seconds = (self.end_ns - self.start_ns) / NS
        return "s" if seconds <= 600 else "min" if seconds <= 4 * 3600 else "h"

    @property
    def ns_per_unit(self) -> float:
        """Nanoseconds in one unit of the axis."""
        return {"s": 1.0, "min": 60.0, "h": 3600.0}[self.unit] * NS

    def of(self, t_ns: Ints) -> Floats:
        """Elapsed time of each t_ns in the axis' unit."""
        return np.asarray((t_ns - self.start_ns) / self.ns_per_unit)

    @property
    def length(self) -> float:
        """Time from first to last row in the axis' unit."""
        return (self.end_ns - self.start_ns) / self.ns_per_unit

    @property
    def label(self) -> str:
        """Title of the axis."""
        return f"{TIME_LABEL} [{self.unit}]"

    @property
    def start(self) -> str:
        """The first time as a date in UTC, or as seconds where it is not a date."""
        if self.start_ns < CALENDAR_FROM_NS:
            return f"{self.start_ns / NS:.3f} s"
        whole, rest = divmod(self.start_ns, NS)
        try:
            moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=whole)
        except OverflowError:  # beyond the year 9999
            return f"{self.start_ns} ns"
        return f"{moment:%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d} UTC"


@dataclass(frozen=True, eq=False)
class ReportInput:
    """Everything a report can show; all but the scene or the tracks may be missing.

    Attributes:
        title: heading of the page.
        scene: room, occluders, sensors.
        tracks, bearings, truth, errors, bound, diagnostics: tables as the stages write them.
        events: births, deaths and doubtful identities of everybody.
        occluders: where moving occluders were thought to be.
        metrics: flat figures of `occlog evaluate`, by name.
        provenance: how the inputs were made, as JSON-ready values.
        losses: input that was lost on the way.
        made: how the tracks were made.
        length_unit: unit of lengths where there is no scene to say it.
        whole: of tables that are too long to be drawn whole what is known of all rows, by the table's name.
        of_all: figures of all errors, where a part of them is drawn; None: all are.
        so_far: (N,) RMSE of the target of each error that is drawn, up to it, likewise.
        judged: what speaks against the tracks, where a part of a table is drawn; None: nothing was asked.
    """

    title: str = "Tracking report"
    scene: Scene | None = None
    tracks: Tracks | None = None
    bearings: Bearings | None = None
    truth: Truth | None = None
    errors: Errors | None = None
    bound: Bound | None = None
    diagnostics: Diagnostics | None = None
    events: Events | None = None
    occluders: Occluders | Hulls | None = None
    metrics: Mapping[str, object] = field(default_factory=dict)
    provenance: Mapping[str, object] = field(default_factory=dict)
    losses: tuple[Loss, ...] = ()
    made: Made = field(default_factory=Made)
    length_unit: str = "m"
    whole: Mapping[str, Whole] = field(default_factory=dict)
    of_all: ErrorsSoFar | None = None
    so_far: Floats | None = None
    judged: tuple[Finding, ...] | None = None

    def __post_init__(self) -> None:
        """Raise InputError where there is nothing to draw."""
        if self.scene is None and self.tracks is None:
            raise InputError("report: neither a scene nor tracks are given; give at least one of them")

    def rows(self, name: str) -> int:
        """How many rows a table has that is given, drawn or not."""
        return self.whole[name].rows if name in self.whole else len(getattr(self, name))

    def drawn(self, *names: str) -> str:
        """A sentence on what is drawn of the tables of these names; empty: all of them."""
        parts = {name: whole for name, whole in self.whole.items() if name in names and whole.every > 1}
        said = [f"one time in {w.every} of the {w.rows:,} rows of {name}" for name, w in parts.items()]
        return f"Drawn: {', '.join(said)}." if said else ""

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return self.scene.length_unit if self.scene is not None else self.length_unit

    @property
    def smoothed(self) -> bool:
        """Whether the tracks know what came after them."""
        return self.made.smoothed

    @property
    def everybody(self) -> PeopleTracks | None:
        """The tracks if they are of everybody, with probabilities of existence; None: they are not."""
        tracks = self.tracks
        return tracks if isinstance(tracks, PeopleTracks) and np.isfinite(tracks.existence).any() else None

    @property
    def labelled(self) -> Bearings | None:
        """The bearings if their labels are identities of the tracks, which those of everybody are not."""
        return self.bearings if self.everybody is None else None

    @cached_property
    def findings(self) -> tuple[Finding, ...] | None:
        """What speaks against the tracks; None without tracks."""
        if self.tracks is None or self.whole:
            return self.judged
        return judge(
            self.tracks,
            self.scene,
            self.made,
            diagnostics=self.diagnostics,
            bearings=self.labelled,
            errors=self.errors,
            metrics=self.metrics,
        )

    @cached_property
    def time(self) -> TimeAxis:
        """Common time axis of all tables."""
        tables = (self.tracks, self.bearings, self.errors, self.bound, self.diagnostics, self.truth)
        times = [t.t_ns for t in tables if t is not None and len(t)]
        if not times:
            return TimeAxis(0, 0)
        return TimeAxis(int(min(t[0] for t in times)), int(max(t[-1] for t in times)))

    @cached_property
    def targets(self) -> tuple[int, ...]:
        """Identities of the tracked targets, or of the true ones where nothing is tracked, ascending."""
        tracked = [t.target_id for t in (self.tracks, self.errors) if t is not None and len(t)]
        if not tracked and self.truth is not None:
            tracked = [self.truth.target_id[self.truth.role == "target"]]
        return tuple(int(i) for i in np.unique(np.concatenate(tracked))) if tracked else ()

    @cached_property
    def sight(self) -> dict[int, tuple[Ints, Floats]]:
        """Times and distances of each target's track from where its sight lines meet; empty where they cannot."""
        if self.tracks is None or self.labelled is None or self.scene is None:
            return {}
        return {target: distances(self.tracks, self.labelled, self.scene, target) for target in self.targets}

    @cached_property
    def residuals(self) -> dict[int, Residuals]:
        """What each target's track leaves of the directions it was seen in."""
        if self.tracks is None or self.labelled is None or self.scene is None:
            return {}
        return {target: residuals(self.tracks, self.labelled, self.scene, target) for target in self.targets}
