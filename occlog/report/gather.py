"""Goes through the tables of a report: figures of all their rows, and of long ones the part that is drawn.

A table comes in chunks, of a file or as a whole, and is gone through several times.  Tracks are first, as their times
say which rows of the other tables the replay needs.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.consistency.verdict import Evidence
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.mot.headline import own_identities
from occlog.evaluate.sources import Chunks, opened_rows, streamed_bearings
from occlog.evaluate.verdict import AgainstTruth, Made, with_truth
from occlog.io.files.put_aside.spool import Spool
from occlog.io.files.tables.header import describe
from occlog.io.open import open_in_unit
from occlog.records.columns import Table
from occlog.records.pieces import Side, in_step, times, whole_times
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Bound,
    Diagnostics,
    Doa,
    Errors,
    Events,
    Hulls,
    Occluders,
    PeopleTracks,
    Tracks,
    Truth,
)
from occlog.records.verdicts import Check
from occlog.report.content import thinned as rule
from occlog.report.content.beside_bound import BesideBound
from occlog.report.content.fared import Fared, FaredStreams, deviation
from occlog.report.content.followed import followers, relabelled
from occlog.report.content.looks import MOST_SENSORS, Looked
from occlog.report.content.off_sight import Distances, Residual
from occlog.report.content.people import People, PeopleStreams, crowd
from occlog.report.content.selections import Selections, SelectionStreams
from occlog.report.content.thinned import (
    MOST_MOVING,
    ErrorsSoFar,
    Thinned,
    Whole,
    chosen,
    fewer,
    shortly_before,
    thinned,
    with_rows,
)

from .gather_bearings import Beside, Posts, bearings_of

T = TypeVar("T", bound=Table)
TABLES = ("tracks", "bearings", "truth", "errors", "bound", "diagnostics", "events", "occluders")
"""Names of the tables that a report shows."""


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of all rows: every number that a page says; None of tables that are not given, or say nothing.

    Attributes:
        whole: of each table that is given, by its name.
        moments: (M,) times that the replay shows; none where nothing moves.
        every: of all times of what moves each so manieth is one of these.
        sight_every: each so manieth moment has sight lines.
        priors_every: each so manieth moment has occluders as the tracker knew them.
        errors: of all errors.
        errors_so_far: (N,) RMSE of the target of each error that is drawn, up to it.
        bound: of errors beside the bound.
        bound_so_far: (N, 2) root mean square of each bound that is drawn and of all before it, and of smoothing.
        looked: of all bearings.
        residuals: of each track.
        sight: distances of each track whose errors are not known.
        people: of all estimates of everybody; None: tracks are not of everybody.
        fared: of all diagnostics.
        deviation: median standard deviation of a position.
        selections: of each target for which cameras were selected.
        events: how many there are of each kind.
        judged: what was checked of the tracks; None: nothing was.
    """

    whole: Mapping[str, Whole] = field(default_factory=dict)
    moments: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    every: int = 1
    sight_every: int = 1
    priors_every: int = 1
    errors: ErrorsSoFar = field(default_factory=ErrorsSoFar)
    errors_so_far: Floats = field(default_factory=lambda: np.zeros(0))
    bound: BesideBound = field(default_factory=BesideBound)
    bound_so_far: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    looked: Looked | None = None
    residuals: Mapping[int, Residual] = field(default_factory=dict)
    sight: Mapping[int, Distances] = field(default_factory=dict)
    people: People | None = None
    fared: Fared | None = None
    deviation: float = float("nan")
    selections: Mapping[int, Selections] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    judged: tuple[Check, ...] | None = None


@dataclass(frozen=True)
class Rows(Generic[T]):
    """A table that is gone through several times.

    Attributes:
        kind: the table.
        chunks: gives all rows in the order of time, as often as wanted.
        of_file: how many rows and which columns a file of occlog says that it has; None: there is none.
    """

    kind: type[T]
    chunks: Chunks[T]
    of_file: tuple[int, frozenset[str]] | None = None

    @cached_property
    def rows(self) -> int:
        """How many rows it has; they are gone through where no file says it."""
        return sum(len(chunk) for chunk in self.chunks()) if self.of_file is None else self.of_file[0]

    def may_have(self, column: str) -> bool:
        """Whether it may have a column."""
        known = {each.name for each in self.kind.columns()} if self.of_file is None else self.of_file[1]
        return column in known


Given = Callable[..., Rows[Any] | None]
"""Opens a table by its name, as the first of some kinds that it is; None where it is not given."""


def in_memory(tables: Mapping[str, Table]) -> Given:
    """Tables in memory by their names, each as one chunk."""

    def opened(name: str, *_: type[Table]) -> Rows[Any] | None:
        table = tables.get(name)
        return None if table is None else Rows(type(table), lambda: iter((table,) if len(table) else ()))

    return opened


def in_files(paths: Mapping[str, Path], unit: str | None, scene: Scene | None) -> Given:
    """Tables in files by their names, with lengths in a unit; those of a recording that has none are not given.

    Bearings of a recording are its directions of arrival, too, as `occlog track` uses them, where there is a scene.
    """

    def opened(name: str, *kinds: type[Table]) -> Rows[Any] | None:
        path = paths.get(name)
        if path is None:
            return None
        found = open_in_unit(path, unit)
        if name == "bearings" and scene is not None and found.recording is not None and found.has(Doa):
            heard = streamed_bearings(path, None, False, scene)
            return None if heard is None else Rows(Bearings, heard)
        kind = next((kind for kind in kinds if found.has(kind)), kinds[-1])
        if found.recording is not None and not found.has(kind):
            return None
        said = None
        if found.recording is None and found.foreign is None:
            header = describe(path)
            said = int(header["rows"]), frozenset(column["name"] for column in header["columns"])
        return Rows(kind, opened_rows(found, kind) or partial(found.rows, kind), said)

    return opened


def gather(
    given: Given, made: Made, scene: Scene | None, metrics: Mapping[str, object], whole: Collection[str] = ()
) -> tuple[dict[str, Any], Figures]:
    """The part of each table that is drawn, by its name, and figures of all rows.

    Args:
        given: the tables.
        made: how the tracks were made.
        scene: of the run.
        metrics: figures of the evaluation.
        whole: names of tables that are drawn whole, however long they are.
    """
    return _Reading(given, made, scene, whole).all(metrics)


class _Reading:
    """Goes through the tables, and gathers what is drawn and what is said."""

    def __init__(self, given: Given, made: Made, scene: Scene | None, unthinned: Collection[str]) -> None:
        self._open, self._made, self._scene, self._unthinned = given, made, scene, unthinned
        self._tables: dict[str, Any] = {}
        self._whole: dict[str, Whole] = {}
        self._figures: dict[str, Any] = {}
        self._moments = np.zeros(0, np.int64)
        self._unknown = self._own = False
        self._selected: tuple[SelectionStreams, Rows[Diagnostics]] | None = None
        self._posts = Posts()
        self._evidence = Evidence()
        self._against = AgainstTruth(made, scene)

    def all(self, metrics: Mapping[str, object]) -> tuple[dict[str, Any], Figures]:
        """Tables, and figures."""
        self._own = own_identities(metrics)
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
            self._figures["judged"] = with_truth(
                self._evidence, self._made, self._against, unknown=self._unknown, metrics=metrics
            )
        return self._tables, Figures(whole=self._whole, moments=self._moments, **self._figures)

    def _most(self, name: str) -> int:
        """How many rows of a table are drawn, about."""
        return sys.maxsize if name in self._unthinned else rule.MOST_ROWS

    def _keep(self, name: str, found: Thinned[T]) -> T:
        self._tables[name], self._whole[name] = found.table, found.whole
        return found.table

    def _thin(self, name: str, given: Rows[T], chunks: Iterable[T] | None = None, *, ends: bool = True) -> Thinned[T]:
        """Keep a part of a table, in chunks of which something else is made, too."""
        chunks, most = given.chunks() if chunks is None else chunks, self._most(name)
        found = thinned(chunks, given.kind, given.rows, most, also=self._moments, ends=ends)
        self._keep(name, found)
        return found

    def _read_tracks(self) -> None:
        """Tracks, and of everybody how many people there are and who sees them."""
        given: Rows[Tracks] | None = self._open("tracks", PeopleTracks)
        if given is None:
            return
        people, spread = PeopleStreams(), Spool()
        bearings = self._open("bearings", Bearings) is not None and self._scene is not None
        fared = self._open("diagnostics", Diagnostics) is not None
        existence = given.may_have("existence")

        def watched() -> Iterator[Tracks]:
            for piece in whole_times(given.chunks()):
                self._unknown = self._unknown or bool(np.isnan(piece.cov_xx).any())
                if existence and isinstance(piece, PeopleTracks):
                    people.add(piece)
                if bearings:
                    self._posts.add(piece)
                if fared and not self._unknown:
                    spread.add(deviation(piece))
                yield piece

        whole = self._thin("tracks", given, watched()).whole
        self._evidence.rows = whole.rows
        if not self._unknown:
            self._figures["deviation"] = median_of(spread)
        if people.any:
            people.begin_cells(whole.span_ns, whole.step_ns)
            for piece in given.chunks():
                assert isinstance(piece, PeopleTracks)
                people.see(piece, MOST_SENSORS)
            table = self._tables["tracks"]
            self._figures["people"] = people.finish(crowd(table.take(np.isin(table.t_ns, whole.at))))

    def _read_truth(self) -> None:
        """The truth, and with it the moments that the replay shows."""
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
        every = chosen(len(leading.at), rows)
        self._moments = moments = leading.at[::every]
        self._figures["every"] = leading.every * every
        if given is not None and truth is not None and truth.whole.every > 1 and "tracks" in self._whole:
            step_ns = leading.step_ns
            near = with_rows(truth, given.chunks(), lambda rows: shortly_before(moments, step_ns, rows.t_ns)[0])
            self._keep("truth", near)

    def _read_diagnostics(self) -> None:
        """How the filter fared, and which cameras were selected."""
        given: Rows[Diagnostics] | None = self._open("diagnostics", Diagnostics)
        if given is None:
            return
        fared, selected = FaredStreams(), SelectionStreams(max(-(-given.rows // self._most("diagnostics")), 1))
        self._evidence.rows = 0 if given.rows else self._evidence.rows

        def watched() -> Iterator[Diagnostics]:
            for chunk in given.chunks():
                self._evidence.fared(chunk)
                fared.add(chunk)
                selected.add(chunk)
                yield chunk

        if self._thin("diagnostics", given, watched()).whole.rows:
            self._figures["fared"] = fared.finish()
            self._selected = selected, given

    @property
    def _relabelled(self) -> bool:
        """Whether tracks have names of their own, and errors those of the truth."""
        errors, tracks = self._tables.get("errors"), self._tables.get("tracks")
        return errors is not None and tracks is not None and relabelled(followers(errors, tracks))

    def _read_selections(self) -> None:
        """What came out where cameras were selected; errors say nothing of tracks that have names of their own."""
        if self._selected is None:
            return
        selected, given = self._selected
        if selected.any:
            if not self._relabelled:
                self._came_out(selected, given, Errors)
            self._came_out(selected, given, Tracks)
        self._figures["selections"] = selected.finish()

    def _came_out(
        self, selected: SelectionStreams, diagnostics: Rows[Diagnostics], kind: type[Errors] | type[Tracks]
    ) -> None:
        """What errors or tracks say at the times at which cameras were selected."""
        beside = self._open(kind.NAME, kind)
        if beside is None:
            return
        ours, its = Side(diagnostics.chunks(), Diagnostics), Side[Errors | Tracks](beside.chunks(), kind)
        for limits in in_step((ours, its), (0, 0)):
            selected.came_out(limits.of(ours), limits.of(its))

    def _read_errors_and_bound(self) -> None:
        """Errors, with the RMSE up to each one that is drawn, and the bound on it beside them."""
        errors, bound = self._open("errors", Errors), self._open("bound", Bound)
        theirs = None if bound is None else self._thin("bound", bound)
        if errors is None:
            return
        ours = self._thin("errors", errors)
        so_far, beside = ErrorsSoFar(), BesideBound()
        # One pass more: the RMSE up to a row is of all rows before it
        sides = Side(errors.chunks(), Errors), Side(() if bound is None else bound.chunks(), Bound)
        drawn = _Drawn(ours.rows), _Drawn(np.zeros(0, np.int64) if theirs is None else theirs.rows)
        for limits in in_step(sides, (0, 0)):
            part, its = limits.of(sides[0]), limits.of(sides[1])
            if not self._own:
                self._against.update(part)
            drawn[0].add(so_far.add(part))
            drawn[1].add(beside.add(part, its))
        self._figures |= {"errors": so_far, "errors_so_far": drawn[0].values(())}
        self._figures |= {"bound": beside, "bound_so_far": drawn[1].values((2,))}

    def _read_events(self) -> None:
        """What happened, and how often."""
        given: Rows[Events] | None = self._open("events", Events)
        if given is None:
            return
        counts: Counter[str] = Counter()

        def watched() -> Iterator[Events]:
            for chunk in given.chunks():
                counts.update(chunk.kind.tolist())
                yield chunk

        self._thin("events", given, watched(), ends=False)
        self._figures["events"] = dict(counts)

    def _read_occluders(self) -> None:
        """Where moving occluders were thought to be, at the moments of the replay and at others."""
        given = self._open("occluders", Hulls, Occluders)
        if given is None:
            return
        moments, every, most = self._moments, 1, self._most("occluders")
        if len(moments) and given.rows > most:
            counts = np.zeros(len(moments), np.int64)
            for chunk in given.chunks():
                at = np.searchsorted(moments, chunk.t_ns[np.isin(chunk.t_ns, moments)])
                counts += np.bincount(at, minlength=len(moments))
            every = fewer(counts, most)
        self._keep(
            "occluders", thinned(given.chunks(), given.kind, given.rows, most, also=moments[::every], ends=False)
        )
        self._figures["priors_every"] = every

    @property
    def _with_bearings(self) -> bool:
        """Whether bearings speak for and against the tracks, whose labels those of everybody are not."""
        return "bearings" in self._whole and self._whole["bearings"].rows > 0 and "people" not in self._figures

    def _read_bearings(self) -> None:
        """What sensors saw, how it fits the tracks, and the sight lines of the moments."""
        stream: Rows[Bearings] | None = self._open("bearings", Bearings)
        if stream is None:
            return
        leading = self._whole.get("tracks") or self._whole.get("truth")
        beside = None
        if self._scene is not None and "tracks" in self._whole and "people" not in self._figures:
            tracks, said = self._open("tracks", Tracks), self._open("diagnostics", Diagnostics)
            same = said is not None and self._whole["diagnostics"].rows == self._whole["tracks"].rows
            assert tracks is not None
            fared = said.chunks if said is not None and same else None
            beside = Beside(tracks.chunks, fared, self._posts, self._evidence, self._made, self._without())
        step_ns = float("nan") if leading is None else leading.step_ns
        moments = self._moments, step_ns
        found = bearings_of(stream.chunks, self._scene, self._targets(), moments, beside, self._most("bearings"))
        self._tables["bearings"], self._whole["bearings"] = found.table, found.whole
        self._figures |= {"looked": found.looked, "sight_every": found.every}
        self._figures |= {"residuals": found.residuals, "sight": found.sight}

    def _targets(self) -> tuple[int, ...]:
        """Identities of the tracked targets, ascending."""
        tables = ("tracks",) if self._relabelled else ("tracks", "errors")
        names = [np.unique(self._tables[name].target_id) for name in tables if name in self._tables]
        return tuple(int(i) for i in np.unique(np.concatenate(names))) if names else ()

    def _without(self) -> frozenset[int]:
        """Targets of which no error is known."""
        errors = self._tables.get("errors")
        if self._relabelled:
            return frozenset()
        return frozenset(self._targets()) - set(() if errors is None else errors.target_id.tolist())


class _Drawn:
    """Of values of all rows those of the rows that are drawn."""

    def __init__(self, rows: Ints) -> None:
        self._rows, self._count = rows, 0
        self._parts: list[np.ndarray] = []

    def add(self, values: np.ndarray) -> None:
        """Those of some more rows."""
        first, last = np.searchsorted(self._rows, (self._count, self._count + len(values)))
        self._parts.append(values[self._rows[first:last] - self._count])
        self._count += len(values)

    def values(self, shape: tuple[int, ...]) -> np.ndarray:
        """(N, ...) all of them; the shape of each."""
        return np.concatenate([np.zeros((0, *shape)), *self._parts])


def _shown(truth: Truth) -> float:
    """Share of true places that the replay shows: of others than targets where there are few of them."""
    others = truth.role != "target"
    few = len(np.unique(truth.target_id[others])) <= MOST_MOVING
    return 1.0 if few or not len(truth) else 1.0 - float(others.mean())
