"""Input and content model of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.errors import InputError, option
from occlog.evaluate.verdict import TrackProvenance
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
from occlog.records.verdicts import Check, Verdict, all_plausible, found_by_stage
from occlog.report.gather import TABLES, ReportFigures, gather, in_memory

from .accuracy import FilterDiagnostics, matching_tracks, relabelled
from .coverage import ObservationCoverage, Selections
from .downsampled import TableTotals
from .people import PeopleStatistics
from .sight import Residual, TriangulationDistances

TIME_LABEL = "time since start"
CALENDAR_FROM_NS = 365 * 86_400 * NS
"""Times later than this (the year 1971) are dates; earlier ones count from a simulation's start."""


@dataclass(frozen=True)
class TimeAxis:
    """Time axis between two times [ns]: elapsed time since the first, in s, min or h."""

    start_ns: int
    end_ns: int

    @property
    def unit(self) -> str:
        """Unit of the axis by its length: `s`, `min` or `h`."""
        seconds = (self.end_ns - self.start_ns) / NS
        return "s" if seconds <= 600 else "min" if seconds <= 4 * 3600 else "h"

    @property
    def ns_per_unit(self) -> float:
        """Nanoseconds in one unit of the axis."""
        return {"s": 1.0, "min": 60.0, "h": 3600.0}[self.unit] * NS

    def of(self, t_ns: Ints) -> Floats:
        """Convert times [ns] to elapsed time in the axis' unit."""
        return np.asarray((t_ns - self.start_ns) / self.ns_per_unit)

    @property
    def length(self) -> float:
        """Time from the first to the last row, in the axis' unit."""
        return (self.end_ns - self.start_ns) / self.ns_per_unit

    @property
    def duration(self) -> str:
        """Time from the first to the last row with its unit, as text."""
        return f"{self.length:.4g} {self.unit}"

    @property
    def label(self) -> str:
        """Title of the axis, with its unit."""
        return f"{TIME_LABEL} [{self.unit}]"

    @property
    def start(self) -> str:
        """First time as a UTC date, or in seconds if it is not a date."""
        if self.start_ns < CALENDAR_FROM_NS:
            return f"{self.start_ns / NS:.3f} s"
        whole, rest = divmod(self.start_ns, NS)
        try:
            instant = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=whole)
        except OverflowError:  # beyond the year 9999
            return f"{self.start_ns} ns"
        return f"{instant:%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d} UTC"


@dataclass(frozen=True, eq=False)
class ReportInput:
    """All inputs of a report; all but the scene or the tracks may be missing.

    Attributes:
        title: heading of the page.
        scene: room, occluders, sensors.
        tracks, bearings, truth, errors, bound, diagnostics: tables as the stages write them.
        events: initiations, terminations and possible identity switches of all people.
        occluders: the tracker's priors of moving occluders.
        metrics: flat figures of `occlog evaluate`, by name.
        provenance: how the inputs were made, as JSON-ready values.
        losses: input data that could not be read.
        made: provenance of the tracks.
        length_unit: unit of lengths if there is no scene to state it.
        earlier: consistency verdicts of the stages that made the inputs.
        in_images: whether tracks are in images, with positions in pixels, so that there is no floor plan.
        boxes_stated: whether tracks in images state in which frames there is a box of the target.
        collected: figures of all rows, if the tables hold a part of the rows; None: the tables are whole.
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
    made: TrackProvenance = field(default_factory=TrackProvenance)
    length_unit: str = "m"
    earlier: tuple[Verdict, ...] = ()
    in_images: bool = False
    boxes_stated: bool = True
    collected: ReportFigures | None = None

    def __post_init__(self) -> None:
        """Raise InputError if there is neither a scene nor tracks to draw."""
        if self.scene is None and self.tracks is None:
            raise InputError(
                f"report: neither a scene nor tracks are given; give at least one of them ({option('scene')}, TRACKS)",
                id="missing-option",
            )

    @cached_property
    def figures(self) -> ReportFigures:
        """Figures computed from all rows, those that are not drawn included."""
        if self.collected is not None:
            return self.collected
        tables = {name: table for name in TABLES if (table := getattr(self, name)) is not None}
        given = in_memory(tables)
        return gather(given, self.made, self.scene, self.metrics, whole=TABLES, in_images=self.in_images)[1]

    @property
    def whole(self) -> Mapping[str, TableTotals]:
        """Totals of all rows of each given table, by name."""
        return self.figures.whole

    def rows(self, name: str) -> int:
        """Return the number of rows of a given table, whether drawn or not."""
        return self.whole[name].rows

    def drawn(self, *names: str) -> str:
        """Return a sentence about those of the named tables that are drawn in part; empty if all rows are drawn."""
        parts = {name: self.whole[name] for name in names if name in self.whole and self.whole[name].every > 1}
        reported = [f"one time in {w.every} of the {w.rows:,} rows of {name}" for name, w in parts.items()]
        return f"Drawn: {', '.join(reported)}." if reported else ""

    @property
    def unit(self) -> str:
        """Length unit of the scene, or of the tables without one."""
        return self.scene.length_unit if self.scene is not None else self.length_unit

    @property
    def smoothed(self) -> bool:
        """Whether the tracks are smoothed, by their provenance."""
        return self.made.smoothed

    @property
    def people_tracks(self) -> PeopleTracks | None:
        """Tracks of all people with existence probabilities; None for other tracks."""
        return self.tracks if isinstance(self.tracks, PeopleTracks) and self.people is not None else None

    @property
    def labelled(self) -> Bearings | None:
        """Bearings with labels that are track identities; None for people's tracks."""
        return self.bearings if self.people_tracks is None else None

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Consistency verdicts of earlier stages, and of the report if it has checked the tracks."""
        own = self.figures.judged
        return self.earlier if own is None else (*self.earlier, Verdict.of("report", own))

    @property
    def findings(self) -> tuple[tuple[str, Check], ...]:
        """Warnings of all verdicts, each with the name of its stage."""
        return found_by_stage(self.verdicts)

    @property
    def plausible(self) -> bool | None:
        """True if all checks of all stages passed; None without checks."""
        return all_plausible(self.verdicts)

    @cached_property
    def time(self) -> TimeAxis:
        """Time axis from the first to the last row of all tables."""
        names = ("tracks", "bearings", "errors", "bound", "diagnostics", "truth")
        spans = [self.whole[name].span_ns for name in names if getattr(self, name) is not None and self.rows(name)]
        return TimeAxis(min(s for s, _ in spans), max(e for _, e in spans)) if spans else TimeAxis(0, 0)

    @cached_property
    def followers(self) -> Mapping[int, int | None]:
        """Track of each target in the errors, by identity; None as value: several tracks.

        Empty without errors or tracks.
        """
        return {} if self.errors is None or self.tracks is None else matching_tracks(self.errors, self.tracks)

    @cached_property
    def relabelled(self) -> bool:
        """Whether tracks have their own identities, different from those in the errors."""
        return relabelled(self.followers)

    @cached_property
    def compared(self) -> tuple[int, ...]:
        """Targets that have errors, sorted."""
        return () if self.errors is None else tuple(np.unique(self.errors.target_id).tolist())

    @property
    def same_names(self) -> bool:
        """Whether tracks, truth and labelled bearings have the same identities."""
        return self.people_tracks is None and not self.relabelled

    def whose_bearings(self, target: int) -> str:
        """Return a phrase, after a comma, that names the target of bearings; empty if there is only one.

        `target`: label of the bearings; -1: unlabelled.
        """
        if target < 0:
            return ", any object"
        if self.coverage is None or len(self.coverage.watched) == 1:
            return ""
        return f", target {target}" if self.same_names else f", label {target}"

    def whose_errors(self, target: int) -> str:
        """Return a phrase that names a target in the errors, with its track if that has another identity."""
        if not self.relabelled:
            return f"target {target}"
        track = self.followers.get(target)
        return f"true target {target}" + ("" if track is None else f" (track {track})")

    @cached_property
    def targets(self) -> tuple[int, ...]:
        """Sorted identities of the tracked targets, or of the true ones without tracks."""
        tables = (self.tracks,) if self.relabelled else (self.tracks, self.errors)
        tracked = [t.target_id for t in tables if t is not None and len(t)]
        if not tracked and self.truth is not None:
            tracked = [self.truth.target_id[self.truth.role == "target"]]
        return tuple(int(i) for i in np.unique(np.concatenate(tracked))) if tracked else ()

    @property
    def sight(self) -> Mapping[int, TriangulationDistances]:
        """Distances from triangulated positions of each track without errors, by identity.

        Empty without triangulation.
        """
        return self.figures.sight

    @property
    def residuals(self) -> Mapping[int, Residual]:
        """Residuals of bearings from the track of each target."""
        return self.figures.residuals

    @property
    def coverage(self) -> ObservationCoverage | None:
        """Summary of which sensor detected which target when; None without bearings."""
        return self.figures.coverage

    @property
    def strangers(self) -> tuple[str, ...]:
        """Names of sensors that have bearings and are missing in the scene, so that they are not drawn."""
        if self.scene is None or self.coverage is None:
            return ()
        known = {sensor.name for sensor in self.scene.sensors}
        return tuple(name for name in self.coverage.sensors if name not in known)

    @property
    def people(self) -> PeopleStatistics | None:
        """Summary of the tracks of all people; None for other tracks."""
        return self.figures.people

    @property
    def filter_diagnostics(self) -> FilterDiagnostics | None:
        """Summary of the filter diagnostics; None without them."""
        return self.figures.filter_diagnostics

    @property
    def selections(self) -> Mapping[int, Selections]:
        """Selections of cameras by target; empty without any."""
        return self.figures.selections

    def beside_bound(self, target: int | None = None, where: str = "") -> tuple[float, float]:
        """Return RMSE and root mean square bound over common times, of a target or of all (None).

        The bound is that of smoothing if the tracks are smoothed. `where`: empty on the ground, `_space` in space.
        """
        return self.figures.bound.figures(target, where, smoothed=self.smoothed)
