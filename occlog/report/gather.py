"""Reading of a report's tables: figures of all rows, and the part of long tables that is drawn.

A table is read in chunks, several times: tracks first, since their times determine the rows that the replay needs;
bearings alone, then with the tracks.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.consistency.verdict import ConsistencyEvidence
from occlog.core.metrics.errors import group_medians
from occlog.errors import InputError
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.matching.path_outline import NEAR_NS
from occlog.evaluate.mot.figures import independent_ids
from occlog.evaluate.sources import Chunks, opened_rows, streamed_bearings
from occlog.evaluate.verdict import CovarianceConsistency, SightEvidence, TrackProvenance, checks_with_truth, in_rows_of
from occlog.io.files.spill import Blocks, Spool
from occlog.io.files.tables.parquet import describe
from occlog.io.open import open_in_unit
from occlog.records.columns import ColumnTable
from occlog.records.declared.people import COASTING, GROUND, PREDICTED
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Scene
from occlog.records.tables import (
    LAST,
    UNLABELLED,
    Bearings,
    Bound,
    Diagnostics,
    Doa,
    Errors,
    Events,
    Hulls,
    Limits,
    Occluders,
    PeopleTracks,
    TableBuffer,
    Tracks,
    Truth,
    in_step,
    times,
    whole_times,
)
from occlog.records.verdicts import Check

from .content import downsampled as rule
from .content.accuracy import (
    ErrorsAgainstBound,
    FilterDiagnostics,
    FilterDiagnosticsStreams,
    deviation,
    matching_tracks,
    relabelled,
)
from .content.coverage import (
    MAX_SENSORS,
    MAX_TARGETS,
    ObservationCoverage,
    ObservationStreams,
    Selections,
    SelectionStreams,
    scene_order,
)
from .content.downsampled import (
    MAX_MOVING,
    DownsampledTable,
    ErrorsSoFar,
    TableTotals,
    downsample,
    downsample_with,
    every_nth,
    kept_steps,
    rows_before,
)
from .content.people import PeopleStatistics, PeopleStreams, people_statistics
from .content.sight import (
    BearingResidualStreams,
    Residual,
    TriangulationDistances,
    has_common_time,
    lines_of_sight,
    period_of,
    sensor_positions,
)

MAX_DRAWN_TRACKS = 10_000
"""Tracks of a page: each takes 4 ms of processor time and 50 kB."""
STEP = np.dtype([("group", "i8"), ("step", "f8")])
"""The time between two sightings of a target by a sensor: the number of both, and nanoseconds."""


class Posts:
    """Estimates on both sides of wide gaps of tracks, kept from a stream, to interpolate over gaps of any width."""

    def __init__(self) -> None:
        """Create a store without estimates."""
        self._parts: list[Tracks] = []
        self._last = Tracks.empty()
        self._all: Tracks | None = None

    def add(self, tracks: Tracks) -> None:
        """Add rows in the order of time; only rows next to wide gaps and the last row of each target are kept."""
        own = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
        both = Tracks.concat([self._last, Tracks(**own)])
        order = np.lexsort((both.t_ns, both.target_id))
        t_ns, target = both.t_ns[order], both.target_id[order]
        wide = (np.diff(target) == 0) & (np.diff(t_ns) > NEAR_NS)
        self._parts.append(both.take(np.sort(order[np.append(wide, False) | np.append(False, wide)])))
        self._last = both.take(np.sort(order[np.append(np.diff(target) != 0, True)]))

    def about(self, limits: Limits, side: TableBuffer[Tracks]) -> Tracks:
        """Return the estimates in and around a time interval, and all kept ones far from it.

        `side`: buffer of the tracks with all rows within `NEAR_NS` of the interval.
        """
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
class BearingReference:
    """Tracks with which bearings are compared.

    Attributes:
        tracks: returns an iterator over all estimates, at each call.
        diagnostics: returns an iterator over diagnostics at each call, one row for each estimate; None: unknown.
        posts: estimates next to wide gaps.
        evidence: receives what bearings say for and against the tracks.
        made: provenance of the tracks.
        without: targets without known errors, which get distances from triangulated positions.
    """

    tracks: Callable[[], Iterator[Tracks]]
    diagnostics: Callable[[], Iterator[Diagnostics]] | None
    posts: Posts
    evidence: ConsistencyEvidence
    made: TrackProvenance
    without: frozenset[int]


@dataclass
class ThinnedBearings:
    """Bearings of which a part is drawn, and figures of all.

    Attributes:
        table: bearings at the shown time steps.
        whole: number and times of all rows.
        coverage: which sensor detected which target when.
        every: every k-th time step of the replay shows its bearings.
        residuals: residuals of each track, by identity.
        sight: distances from triangulated positions of each track without known errors.
    """

    table: Bearings
    whole: TableTotals
    coverage: ObservationCoverage
    every: int
    residuals: dict[int, Residual] = field(default_factory=dict)
    sight: dict[int, TriangulationDistances] = field(default_factory=dict)


class _Periods:
    """Accumulated intervals between bearings, from which the scan period of each of the `targets` follows."""

    def __init__(self, scene: Scene, targets: frozenset[int]) -> None:
        self._scene, self._targets = scene, sorted(targets)
        self._rows, self._together = dict.fromkeys(targets, 0), dict.fromkeys(targets, 0)
        self._steps, self._last = Blocks(STEP), dict[int, int]()
        self._sensors = max(len(sensor_positions(scene)), 1)
        self._counts = np.zeros(len(targets) * self._sensors, dtype=np.int64)

    def add(self, bearings: Bearings) -> None:
        """Add the bearings of a further time interval."""
        for k, (target, lines) in enumerate(lines_of_sight(bearings, self._scene, self._targets).items()):
            self._rows[target] += len(lines.t_ns)
            self._together[target] += int(np.count_nonzero(has_common_time(lines.t_ns)))
            for sensor in np.unique(lines.sensor).tolist():
                own, group = lines.t_ns[lines.sensor == sensor], k * self._sensors + sensor
                steps = np.diff(own) if group not in self._last else np.diff(own, prepend=self._last[group])
                self._last[group] = int(own[-1])
                self._counts[group] += len(steps)
                rows = np.empty(len(steps), dtype=STEP)
                rows["group"], rows["step"] = group, steps
                self._steps.append(rows)

    def periods_ns(self) -> dict[int, int | None]:
        """Return the scan period [ns] of each target; None if its sensors share times."""
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
    time_steps: tuple[Ints, float],
    reference: BearingReference | None,
    most: int = sys.maxsize,
) -> ThinnedBearings:
    """Read the bearings for a report in two passes: first counts, then residuals and the part that is drawn.

    Args:
        stream: returns an iterator over them, in the order of time, at each call.
        scene: the sensors.
        targets: identities of the tracked targets.
        time_steps: (M,) times of the replay [ns], and the usual interval of all times [ns].
        reference: tracks to compare with; None: no comparison.
        most: approximate number of bearings to draw.
    """
    observations, steps, times, span = ObservationStreams(), Spool(), 0, (0, 0)
    kept, step_ns = time_steps
    counts = np.zeros(len(kept), np.int64)
    periods = None if reference is None or scene is None else _Periods(scene, reference.without)
    for piece in whole_times(stream()):
        first = np.unique(piece.t_ns)
        steps.add(np.diff(first if not times else np.append(span[1], first)).astype(np.float64))
        span = int(first[0]) if not times else span[0], int(first[-1])
        times += len(first)
        observations.add(piece)
        counts += np.bincount(rows_before(kept, step_ns, piece.t_ns)[1], minlength=len(kept))
        if periods is not None:
            periods.add(piece)
    every = max(-(-observations.rows // most), 1)
    step = 1 if every == 1 else every_nth(counts, most)
    shown, parts = kept[::step], [Bearings.empty()]

    def keep(part: Bearings) -> None:
        parts.append(part if every == 1 else part.take(rows_before(shown, step_ns, part.t_ns)[0]))

    residuals, sight = dict[int, Residual](), dict[int, TriangulationDistances]()
    if reference is None or scene is None or periods is None:
        for part in stream():
            keep(part)
    else:
        off = BearingResidualStreams(scene, targets, observations.labels, periods.periods_ns(), every)
        for ours, part in _beside(stream, scene, reference):
            off.add(ours, part)
            keep(part)
        residuals, sight = off.finish()
    named = scene_order(scene, observations.sensors)[:MAX_SENSORS]
    watched = tuple(i for i in observations.labels if i != UNLABELLED) or observations.labels
    coverage = observations.finish(named, dict.fromkeys((*watched[:MAX_TARGETS], *targets[:1])))
    whole = TableTotals(observations.rows, times, every, shown, median_of(steps) if steps.count else float(NS), span)
    return ThinnedBearings(Bearings.concat(parts), whole, coverage, step, residuals, sight)


def _beside(
    stream: Callable[[], Iterator[Bearings]], scene: Scene, reference: BearingReference
) -> Iterator[tuple[Tracks, Bearings]]:
    """Generate the bearings of successive time intervals, each with the estimates around them.

    The evidence of the `reference` is updated on the way.

    Args:
        stream: returns an iterator over the bearings.
        scene: the sensors.
        reference: tracks and diagnostics.
    """
    sight = SightEvidence(reference.evidence, scene, reference.made, ())
    tracks, bearings = TableBuffer(reference.tracks(), Tracks), TableBuffer(stream(), Bearings)
    diagnostics: TableBuffer[Diagnostics] | None = None
    if reference.diagnostics is not None:
        rows = in_rows_of(reference.tracks(), reference.diagnostics())
        diagnostics = TableBuffer(rows, Diagnostics)
    sides: list[TableBuffer[Any]] = [tracks, bearings, *([] if diagnostics is None else [diagnostics])]
    margins = [max(NEAR_NS, sight.margin_ns), *[sight.margin_ns] * (len(sides) - 1)]
    for limits in in_step(sides, margins):
        sight.update(limits, tracks, bearings, diagnostics)
        yield reference.posts.about(limits, tracks), limits.of(bearings)
    sight.finish()


T = TypeVar("T", bound=ColumnTable)
TABLES = ("tracks", "bearings", "truth", "errors", "bound", "diagnostics", "events", "occluders")
"""Names of the tables that a report shows."""


@dataclass(frozen=True, eq=False)
class ReportFigures:
    """Figures of a page that are computed from all rows; None for missing tables.

    Attributes:
        whole: number and times of all rows of each given table, by name.
        times: (M,) times of the replay [ns]; empty if nothing moves.
        every: every k-th time of the tracks (or truth) is one of these.
        sight_every: every k-th time step of the replay shows lines of sight.
        priors_every: every k-th time step of the replay shows occluders as the tracker knew them.
        errors: RMSE and largest error of each target.
        errors_so_far: (N,) for each drawn error, the RMSE of its target up to it.
        bound: sums of errors and bounds at common times.
        bound_so_far: (N, 2) for each drawn row of the bound, root mean square up to it, of filtering and of smoothing.
        coverage: summary of all bearings.
        residuals: bearing residuals of each track.
        sight: distances from triangulated positions of each track with unknown errors.
        people: statistics of all people; None: tracks are not of all people.
        filter_diagnostics: summary of all diagnostics.
        deviation: median standard deviation of a position.
        selections: how often each camera was selected, by target.
        events: number of track events of each kind.
        judged: consistency checks of the tracks; None: none.
    """

    whole: Mapping[str, TableTotals] = field(default_factory=dict)
    times: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    every: int = 1
    sight_every: int = 1
    priors_every: int = 1
    errors: ErrorsSoFar = field(default_factory=ErrorsSoFar)
    errors_so_far: Floats = field(default_factory=lambda: np.zeros(0))
    bound: ErrorsAgainstBound = field(default_factory=ErrorsAgainstBound)
    bound_so_far: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    coverage: ObservationCoverage | None = None
    residuals: Mapping[int, Residual] = field(default_factory=dict)
    sight: Mapping[int, TriangulationDistances] = field(default_factory=dict)
    people: PeopleStatistics | None = None
    filter_diagnostics: FilterDiagnostics | None = None
    deviation: float = float("nan")
    selections: Mapping[int, Selections] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    judged: tuple[Check, ...] | None = None


@dataclass(frozen=True)
class StreamedTable(Generic[T]):
    """A table that is read several times, in chunks.

    Attributes:
        kind: type of the table.
        chunks: returns an iterator over all rows in the order of time, at each call.
        of_file: number of rows and names of columns that an occlog file states; None: another source.
    """

    kind: type[T]
    chunks: Chunks[T]
    of_file: tuple[int, frozenset[str]] | None = None

    @cached_property
    def rows(self) -> int:
        """Number of rows, counted by reading if the file does not state it."""
        return sum(len(chunk) for chunk in self.chunks()) if self.of_file is None else self.of_file[0]

    def may_have(self, column: str) -> bool:
        """Return whether the table may have the column: its type, or its file, declares it."""
        known = {each.name for each in self.kind.columns()} if self.of_file is None else self.of_file[1]
        return column in known


Given = Callable[..., StreamedTable[Any] | None]
"""Opens a table by its name, as the first of some kinds that it is; None where it is not given."""


def in_memory(tables: Mapping[str, ColumnTable]) -> Given:
    """Return a function that opens tables in memory, by name."""

    def opened(name: str, *_: type[ColumnTable]) -> StreamedTable[Any] | None:
        table = tables.get(name)
        return None if table is None else StreamedTable(type(table), lambda: iter((table,) if len(table) else ()))

    return opened


def in_files(paths: Mapping[str, Path], unit: str | None, scene: Scene | None) -> Given:
    """Return a function that opens tables in files by name, as the first of some kinds.

    It returns None for missing ones. With a scene, directions of arrival of a recording are included as bearings, as in
    `occlog track`.

    Args:
        paths: file of each table.
        unit: unit to which lengths are converted; None: that of the file.
        scene: poses of arrays; None: unknown.
    """

    def opened(name: str, *kinds: type[ColumnTable]) -> StreamedTable[Any] | None:
        path = paths.get(name)
        if path is None:
            return None
        found = open_in_unit(path, unit)
        if name == "bearings" and scene is not None and found.recording is not None and found.has(Doa):
            heard = streamed_bearings(path, None, False, scene)
            return None if heard is None else StreamedTable(Bearings, heard)
        kind = next((kind for kind in kinds if found.has(kind)), kinds[-1])
        if found.recording is not None and not found.has(kind):
            return None
        statement = None
        if found.recording is None and found.external_table is None:
            header = describe(path)
            statement = int(header["rows"]), frozenset(column["name"] for column in header["columns"])
        return StreamedTable(kind, opened_rows(found, kind) or partial(found.rows, kind), statement)

    return opened


def in_pixels(given: Given) -> Given:
    """Return a function that opens tables as `given` does, with tracks in images as positions in pixels."""

    def opened(name: str, *kinds: type[ColumnTable]) -> StreamedTable[Any] | None:
        if name != "tracks":
            return given(name, *kinds)
        found: StreamedTable[ViewTracks] | None = given(name, ViewTracks)
        if found is None:
            return None
        return StreamedTable(PeopleTracks, lambda: map(pixel_positions, whole_times(found.chunks())))

    return opened


def pixel_positions(tracks: ViewTracks) -> PeopleTracks:
    """Return a row for each target and time: its centre in one camera [px], and the names of the cameras that see it.

    The camera is the first by name that sees the target, else the first one. `tracks`: whole times, in order.
    """
    seen = ~np.isin(tracks.likelihood_mode, (GROUND, PREDICTED))
    order = np.lexsort((tracks.sensor, ~seen, tracks.target_id, tracks.t_ns))
    t_ns, target = tracks.t_ns[order], tracks.target_id[order]
    first = np.append(True, (np.diff(t_ns) != 0) | (np.diff(target) != 0))[: len(order)]
    names = np.where(seen, tracks.sensor, "")[order].tolist()
    begins = np.flatnonzero(first)
    joined = [",".join(filter(None, names[begin:end])) for begin, end in pairwise([*begins.tolist(), len(order)])]
    rows = order[begins]
    unknown = np.full(len(rows), np.nan)
    return PeopleTracks.of(
        t_ns=tracks.t_ns[rows],
        target_id=tracks.target_id[rows],
        x=tracks.x_px[rows],
        y=tracks.y_px[rows],
        vx=unknown,
        vy=unknown,
        cov_xx=tracks.cov_xx_px[rows],
        cov_xy=tracks.cov_xy_px[rows],
        cov_yy=tracks.cov_yy_px[rows],
        seen_by=np.array(joined, dtype=np.str_),
        quality_flags=np.where(seen[rows], "", COASTING),
    )


def gather(
    given: Given,
    made: TrackProvenance,
    scene: Scene | None,
    metrics: Mapping[str, object],
    whole: Collection[str] = (),
    *,
    in_images: bool = False,
) -> tuple[dict[str, Any], ReportFigures]:
    """Read all tables; return the part of each that is drawn, by name, and figures of all rows.

    Args:
        given: opens a table by name.
        made: provenance of the tracks.
        scene: scene of the run.
        metrics: figures of the evaluation by name.
        whole: names of tables that are drawn whole, however long they are.
        in_images: whether tracks are in images, with positions in pixels.
    """
    return _Reading(given, made, scene, whole, in_images).all(metrics)


class _Reading:
    """Reads the tables of a report one after another, and collects the rows that are drawn and figures of all rows."""

    def __init__(
        self, given: Given, made: TrackProvenance, scene: Scene | None, unthinned: Collection[str], in_images: bool
    ) -> None:
        self._open, self._made, self._scene, self._unthinned = given, made, scene, unthinned
        self._in_images = in_images
        self._tables: dict[str, Any] = {}
        self._whole: dict[str, TableTotals] = {}
        self._figures: dict[str, Any] = {}
        self._steps = np.zeros(0, np.int64)
        self._unknown = self._own = False
        self._selected: tuple[SelectionStreams, StreamedTable[Diagnostics]] | None = None
        self._posts = Posts()
        self._evidence = ConsistencyEvidence()
        self._against = CovarianceConsistency(made, scene)

    def all(self, metrics: Mapping[str, object]) -> tuple[dict[str, Any], ReportFigures]:
        """Read all tables; return them by name, and the figures of all rows.

        `metrics`: figures of `occlog evaluate`, by name.
        """
        self._own = independent_ids(metrics)
        self._read_tracks()
        self._read_truth()
        self._read_diagnostics()
        self._read_errors_and_bound()
        self._read_selections()
        self._read_events()
        self._read_occluders()
        self._read_bearings()
        asked = any(name in self._whole and self._whole[name].rows for name in ("diagnostics", "errors"))
        if "tracks" in self._whole and (asked or (self._scene is not None and self._with_bearings)):
            self._figures["judged"] = checks_with_truth(
                self._evidence, self._made, self._against, unknown=self._unknown, metrics=metrics
            )
        return self._tables, ReportFigures(whole=self._whole, times=self._steps, **self._figures)

    def _most(self, name: str) -> int:
        """Return the approximate number of rows to draw of the table `name`."""
        return sys.maxsize if name in self._unthinned else rule.MAX_ROWS

    def _keep(self, name: str, found: DownsampledTable[T]) -> T:
        self._tables[name], self._whole[name] = found.table, found.whole
        return found.table

    def _thin(
        self, name: str, given: StreamedTable[T], chunks: Iterable[T] | None = None, *, ends: bool = True
    ) -> DownsampledTable[T]:
        """Downsample a table, keep it under `name`, and return it.

        Args:
            name: name of the table.
            given: the table.
            chunks: its rows, if they are also processed elsewhere on the way; None: they are read here.
            ends: keep first and last row of each target.
        """
        chunks, most = given.chunks() if chunks is None else chunks, self._most(name)
        found = downsample(chunks, given.kind, given.rows, most, also=self._steps, ends=ends)
        self._keep(name, found)
        return found

    def _read_tracks(self) -> None:
        """Read the tracks: downsample them, keep rows next to gaps, and compute the statistics of people."""
        given: StreamedTable[Tracks] | None = self._open("tracks", PeopleTracks)
        if given is None:
            return
        people, spread = PeopleStreams(), Spool()
        bearings = self._open("bearings", Bearings) is not None and self._scene is not None
        filter_diagnostics = self._open("diagnostics", Diagnostics) is not None
        existence = given.may_have("existence_probability") or self._in_images

        def watched() -> Iterator[Tracks]:
            for piece in whole_times(given.chunks()):
                self._unknown = self._unknown or bool(np.isnan(piece.cov_xx).any())
                if existence and isinstance(piece, PeopleTracks):
                    people.add(piece)
                if bearings:
                    self._posts.add(piece)
                if filter_diagnostics and not self._unknown:
                    spread.add(deviation(piece))
                yield piece

        found = self._thin("tracks", given, watched())
        if (count := len(np.unique(found.table.target_id))) > MAX_DRAWN_TRACKS:
            raise InputError(
                f"report: {count} tracks; a page draws at most {MAX_DRAWN_TRACKS}; report on shorter parts of the "
                "recording",
                id="problem-too-large",
            )
        whole = found.whole
        self._evidence.rows = whole.rows
        if not self._unknown:
            self._figures["deviation"] = median_of(spread)
        if people.any or (self._in_images and whole.rows):
            people.begin_cells(whole.span_ns, whole.step_ns)
            for piece in given.chunks():
                assert isinstance(piece, PeopleTracks)
                people.see(piece, MAX_SENSORS)
            table = self._tables["tracks"]
            self._figures["people"] = people.finish(people_statistics(table.take(np.isin(table.t_ns, whole.at))))

    def _read_truth(self) -> None:
        """Read the truth, and choose the time steps of the replay."""
        given, truth = self._open("truth", Truth), None
        if given is not None:
            truth = self._thin("truth", given)
        leading = self._whole.get("tracks", None if truth is None else truth.whole)
        if leading is None or not leading.rows:
            return
        table = self._tables["tracks" if "tracks" in self._whole else "truth"]
        rows = [int(np.count_nonzero(np.isin(times(table), leading.at)))]
        if truth is not None and truth.whole.rows:
            shown = truth.whole.rows * _shown(truth.table)
            rows.append(min(round(shown), round(shown / truth.whole.times * len(leading.at))))
        every = kept_steps(len(leading.at), rows)
        self._steps = steps = leading.at[::every]
        self._figures["every"] = leading.every * every
        if given is not None and truth is not None and truth.whole.every > 1 and "tracks" in self._whole:
            step_ns = leading.step_ns
            near = downsample_with(truth, given.chunks(), lambda rows: rows_before(steps, step_ns, rows.t_ns)[0])
            self._keep("truth", near)

    def _read_diagnostics(self) -> None:
        """Read the diagnostics: downsample them, and summarise them and the camera selections."""
        given: StreamedTable[Diagnostics] | None = self._open("diagnostics", Diagnostics)
        if given is None:
            return
        filter_diagnostics, selected = (
            FilterDiagnosticsStreams(),
            SelectionStreams(max(-(-given.rows // self._most("diagnostics")), 1)),
        )
        self._evidence.rows = 0 if given.rows else self._evidence.rows

        def watched() -> Iterator[Diagnostics]:
            for chunk in given.chunks():
                self._evidence.add_diagnostics(chunk)
                filter_diagnostics.add(chunk)
                selected.add(chunk)
                yield chunk

        if self._thin("diagnostics", given, watched()).whole.rows:
            self._figures["filter_diagnostics"] = filter_diagnostics.finish()
            self._selected = selected, given

    @property
    def _relabelled(self) -> bool:
        """Whether tracks have identities of their own, other than the targets in the errors."""
        errors, tracks = self._tables.get("errors"), self._tables.get("tracks")
        return errors is not None and tracks is not None and relabelled(matching_tracks(errors, tracks))

    def _read_selections(self) -> None:
        """Read the actual errors at camera selections: spreads of tracks, and errors if identities are the truth's."""
        if self._selected is None:
            return
        selected, given = self._selected
        if selected.any:
            if not self._relabelled:
                self._came_out(selected, given, Errors)
            self._came_out(selected, given, Tracks)
        self._figures["selections"] = selected.finish()

    def _came_out(
        self, selected: SelectionStreams, diagnostics: StreamedTable[Diagnostics], kind: type[Errors] | type[Tracks]
    ) -> None:
        """Add the errors or tracks (`kind`) at the times of camera selections to `selected`."""
        companion = self._open(kind.NAME, kind)
        if companion is None:
            return
        ours, its = (
            TableBuffer(diagnostics.chunks(), Diagnostics),
            TableBuffer[Errors | Tracks](companion.chunks(), kind),
        )
        for limits in in_step((ours, its), (0, 0)):
            selected.came_out(limits.of(ours), limits.of(its))

    def _read_errors_and_bound(self) -> None:
        """Read errors with their running RMSE, and the bound."""
        errors, bound = self._open("errors", Errors), self._open("bound", Bound)
        theirs = None if bound is None else self._thin("bound", bound)
        if errors is None:
            return
        ours = self._thin("errors", errors)
        so_far, against_bound = ErrorsSoFar(), ErrorsAgainstBound()
        # One pass more: the RMSE up to a row is of all rows before it
        sides = TableBuffer(errors.chunks(), Errors), TableBuffer(() if bound is None else bound.chunks(), Bound)
        drawn = _Drawn(ours.rows), _Drawn(np.zeros(0, np.int64) if theirs is None else theirs.rows)
        for limits in in_step(sides, (0, 0)):
            part, its = limits.of(sides[0]), limits.of(sides[1])
            if not self._own:
                self._against.update(part)
            drawn[0].add(so_far.add(part))
            drawn[1].add(against_bound.add(part, its))
        self._figures |= {"errors": so_far, "errors_so_far": drawn[0].values(())}
        self._figures |= {"bound": against_bound, "bound_so_far": drawn[1].values((2,))}

    def _read_events(self) -> None:
        """Read the table of track events: keep a sample of its rows for the page, and count all by kind."""
        given: StreamedTable[Events] | None = self._open("events", Events)
        if given is None:
            return
        counts: defaultdict[str, float] = defaultdict(float)

        def watched() -> Iterator[Events]:
            for chunk in given.chunks():
                for kind, number in chunk.counts().items():
                    counts[kind] += number
                yield chunk

        self._thin("events", given, watched(), ends=False)
        self._figures["events"] = {kind: round(number) for kind, number in counts.items()}

    def _read_occluders(self) -> None:
        """Read the occluder priors: keep those at the time steps of the replay, or at every k-th of them."""
        given = self._open("occluders", Hulls, Occluders)
        if given is None:
            return
        steps, every, most = self._steps, 1, self._most("occluders")
        if len(steps) and given.rows > most:
            counts = np.zeros(len(steps), np.int64)
            for chunk in given.chunks():
                at = np.searchsorted(steps, chunk.t_ns[np.isin(chunk.t_ns, steps)])
                counts += np.bincount(at, minlength=len(steps))
            every = every_nth(counts, most)
        self._keep(
            "occluders", downsample(given.chunks(), given.kind, given.rows, most, also=steps[::every], ends=False)
        )
        self._figures["priors_every"] = every

    @property
    def _with_bearings(self) -> bool:
        """Whether bearings are evidence about the tracks.

        They are not for tracks of all people, since the labels of bearings are then no identities of tracks.
        """
        return "bearings" in self._whole and self._whole["bearings"].rows > 0 and "people" not in self._figures

    def _read_bearings(self) -> None:
        """Read the bearings: residuals and distances of all, and those that the replay draws as lines of sight."""
        stream: StreamedTable[Bearings] | None = self._open("bearings", Bearings)
        if stream is None:
            return
        leading = self._whole.get("tracks") or self._whole.get("truth")
        reference = None
        if self._scene is not None and "tracks" in self._whole and "people" not in self._figures:
            tracks, diagnostics = self._open("tracks", Tracks), self._open("diagnostics", Diagnostics)
            same = diagnostics is not None and self._whole["diagnostics"].rows == self._whole["tracks"].rows
            assert tracks is not None
            filter_diagnostics = diagnostics.chunks if diagnostics is not None and same else None
            reference = BearingReference(
                tracks.chunks, filter_diagnostics, self._posts, self._evidence, self._made, self._without()
            )
        step_ns = float("nan") if leading is None else leading.step_ns
        steps = self._steps, step_ns
        found = bearings_of(stream.chunks, self._scene, self._targets(), steps, reference, self._most("bearings"))
        self._tables["bearings"], self._whole["bearings"] = found.table, found.whole
        self._figures |= {"coverage": found.coverage, "sight_every": found.every}
        self._figures |= {"residuals": found.residuals, "sight": found.sight}

    def _targets(self) -> tuple[int, ...]:
        """Return the sorted identities of the targets in tracks and errors.

        If tracks have their own identities, only those in the tracks.
        """
        tables = ("tracks",) if self._relabelled else ("tracks", "errors")
        names = [np.unique(self._tables[name].target_id) for name in tables if name in self._tables]
        return tuple(int(i) for i in np.unique(np.concatenate(names))) if names else ()

    def _without(self) -> frozenset[int]:
        """Return the targets without errors, for which tracks are compared with triangulated positions."""
        errors = self._tables.get("errors")
        if self._relabelled:
            return frozenset()
        return frozenset(self._targets()) - set(() if errors is None else errors.target_id.tolist())


class _Drawn:
    """Selects the values of drawn rows from a stream of values of all rows; `rows`: sorted row numbers (N,) to keep."""

    def __init__(self, rows: Ints) -> None:
        self._rows, self._count = rows, 0
        self._parts: list[np.ndarray] = []

    def add(self, values: np.ndarray) -> None:
        """Add the values of the next rows, of which those selected are kept."""
        first, last = np.searchsorted(self._rows, (self._count, self._count + len(values)))
        self._parts.append(values[self._rows[first:last] - self._count])
        self._count += len(values)

    def values(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the selected values (N, ...), each of the shape `shape`."""
        return np.concatenate([np.zeros((0, *shape)), *self._parts])


def _shown(truth: Truth) -> float:
    """Return the share, 0 to 1, of the true positions that the replay shows: other objects only if they are few."""
    others = truth.role != "target"
    few = len(np.unique(truth.target_id[others])) <= MAX_MOVING
    return 1.0 if few or not len(truth) else 1.0 - float(others.mean())
