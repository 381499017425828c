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
from occlog.records.verdicts import Check, Verdict, all_plausible, found_by_stage

from .beside_bound import with_bound
from .fared import Fared, deviation
from .followed import followers, relabelled
from .looks import Looked
from .of_all import OfAll
from .off_sight import Distances, Residual
from .people import People
from .selections import Selections, selections
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
    def told(self) -> str:
        """Time from first to last row with its unit, in words."""
        return f"{self.length:.4g} {self.unit}"

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
        earlier: verdicts of the stages that made the inputs.
        of_all: what is known of all rows, where a table is too long to be drawn whole; None: everything is here.
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
    earlier: tuple[Verdict, ...] = ()
    of_all: OfAll | None = None

    def __post_init__(self) -> None:
        """Raise InputError where there is nothing to draw."""
        if self.scene is None and self.tracks is None:
            raise InputError("report: neither a scene nor tracks are given; give at least one of them")

    @property
    def whole(self) -> Mapping[str, Whole]:
        """Of each table what is known of all rows, by its name, where one is too long to be drawn whole."""
        return {} if self.of_all is None else self.of_all.whole

    def rows(self, name: str) -> int:
        """How many rows a table has that is given, drawn or not."""
        return self.whole[name].rows if name in self.whole else len(getattr(self, name))

    def drawn(self, *names: str) -> str:
        """A sentence on what is drawn of the tables of these names; empty: all of them."""
        parts = {name: self.whole[name] for name in names if name in self.whole and self.whole[name].every > 1}
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
        if not isinstance(tracks, PeopleTracks):
            return None
        some = np.isfinite(tracks.existence).any() if self.of_all is None else self.of_all.people is not None
        return tracks if some else None

    @property
    def labelled(self) -> Bearings | None:
        """The bearings if their labels are identities of the tracks, which those of everybody are not."""
        return self.bearings if self.everybody is None else None

    @property
    def errors_so_far(self) -> ErrorsSoFar | None:
        """Figures of all errors, where a part of them is drawn; None: all are."""
        return None if self.of_all is None else self.of_all.errors

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts of the stages before, and that of the report where its tables say something of the tracks."""
        own = self._judged if self.of_all is None else self.of_all.judged
        return self.earlier if own is None else (*self.earlier, Verdict.of("report", own))

    @property
    def findings(self) -> tuple[tuple[str, Check], ...]:
        """What was found, with the stage that found it."""
        return found_by_stage(self.verdicts)

    @property
    def plausible(self) -> bool | None:
        """Whether no stage found anything that speaks against the tracks; None: none has judged."""
        return all_plausible(self.verdicts)

    @property
    def _judged(self) -> tuple[Check, ...] | None:
        """What was checked of whole tables; None without tracks."""
        if self.tracks is None:
            return None
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
        names = ("tracks", "bearings", "errors", "bound", "diagnostics", "truth")
        spans = [self.span_ns(name) for name in names if getattr(self, name) is not None and self.rows(name)]
        return TimeAxis(min(s for s, _ in spans), max(e for _, e in spans)) if spans else TimeAxis(0, 0)

    def span_ns(self, name: str) -> tuple[int, int]:
        """First and last time of a table that has rows."""
        if name in self.whole:
            return self.whole[name].span_ns
        t_ns = getattr(self, name).t_ns
        return int(t_ns[0]), int(t_ns[-1])

    @cached_property
    def followers(self) -> Mapping[int, int | None]:
        """By the target that errors name, the track that they are of; None: of several."""
        return {} if self.errors is None or self.tracks is None else followers(self.errors, self.tracks)

    @cached_property
    def relabelled(self) -> bool:
        """Whether tracks have names of their own, and errors those of the truth."""
        return relabelled(self.followers)

    @cached_property
    def compared(self) -> tuple[int, ...]:
        """The targets that errors name, ascending."""
        return () if self.errors is None else tuple(np.unique(self.errors.target_id).tolist())

    @property
    def same_names(self) -> bool:
        """Whether the identities of tracks are those of the truth, and of the labels of bearings."""
        return self.everybody is None and not self.relabelled

    def whose_bearings(self, target: int) -> str:
        """Words for bearings of a label, after a comma; empty where there are no others."""
        if target < 0:
            return ", any object"
        if self.looked is None or len(self.looked.watched) == 1:
            return ""
        return f", target {target}" if self.same_names else f", what is labelled {target}"

    def whose_errors(self, target: int) -> str:
        """Words for the target that errors name, with its track where that has another name."""
        if not self.relabelled:
            return f"target {target}"
        track = self.followers.get(target)
        return f"true target {target}" + ("" if track is None else f" (track {track})")

    @cached_property
    def targets(self) -> tuple[int, ...]:
        """Identities of the tracked targets, or of the true ones where nothing is tracked, ascending."""
        tables = (self.tracks,) if self.relabelled else (self.tracks, self.errors)
        tracked = [t.target_id for t in tables if t is not None and len(t)]
        if not tracked and self.truth is not None:
            tracked = [self.truth.target_id[self.truth.role == "target"]]
        return tuple(int(i) for i in np.unique(np.concatenate(tracked))) if tracked else ()

    @cached_property
    def sight(self) -> Mapping[int, Distances]:
        """Distances of each target's track from where its sight lines meet; without any where they cannot."""
        if self.of_all is not None:
            return self.of_all.sight
        if self.tracks is None or self.labelled is None or self.scene is None:
            return {}
        return {target: Distances.of(self.tracks, self.labelled, self.scene, target) for target in self.targets}

    @cached_property
    def residuals(self) -> Mapping[int, Residual]:
        """What each target's track leaves of the directions it was seen in."""
        if self.of_all is not None:
            return self.of_all.residuals
        if self.tracks is None or self.labelled is None or self.scene is None:
            return {}
        return {target: Residual.of(self.tracks, self.labelled, self.scene, target) for target in self.targets}

    @cached_property
    def looked(self) -> Looked | None:
        """What bearings tell; None without bearings."""
        if self.bearings is None:
            return None
        return Looked.of(self.bearings) if self.of_all is None else self.of_all.looked

    @property
    def strangers(self) -> tuple[str, ...]:
        """Sensors of bearings that the scene does not have, so that nothing of them is drawn."""
        if self.scene is None or self.looked is None:
            return ()
        known = {sensor.name for sensor in self.scene.sensors}
        return tuple(name for name in self.looked.sensors if name not in known)

    @cached_property
    def people(self) -> People | None:
        """What tracks of everybody tell; None: they are not of everybody."""
        if self.of_all is not None:
            return self.of_all.people
        return None if self.everybody is None else People.of(self.everybody)

    @cached_property
    def fared(self) -> Fared | None:
        """What diagnostics tell; None without any."""
        if self.diagnostics is None or not self.rows("diagnostics"):
            return None
        return Fared.of(self.diagnostics) if self.of_all is None else self.of_all.fared

    @property
    def deviation(self) -> float:
        """Median standard deviation of the position of a track."""
        if self.of_all is not None or self.tracks is None:
            return float("nan") if self.of_all is None else self.of_all.deviation
        return float(np.median(deviation(self.tracks)))

    @cached_property
    def selections(self) -> Mapping[int, Selections]:
        """Selections of cameras, by target."""
        if self.of_all is not None:
            return self.of_all.selections
        if self.diagnostics is None:
            return {}
        return selections(self.diagnostics, (None if self.relabelled else self.errors, self.tracks))

    def happened(self, kind: str) -> int:
        """How many events there are of a kind."""
        if self.of_all is not None:
            return self.of_all.events.get(kind, 0)
        return 0 if self.events is None else int(np.count_nonzero(self.events.kind == kind))

    def beside_bound(self, target: int | None = None, where: str = "") -> tuple[float, float]:
        """RMSE and bound over the times that have both, of a target or of all; see `with_bound`."""
        if self.of_all is not None and self.of_all.bound is not None:
            return self.of_all.bound.figures(target, where, smoothed=self.smoothed)
        errors, bound = self.errors, self.bound
        if errors is None or bound is None:
            return float("nan"), float("nan")
        if target is not None:
            errors, bound = errors.take(errors.target_id == target), bound.take(bound.target_id == target)
        return with_bound(errors, bound, where, smoothed=self.smoothed)
