"""Tables of a report that are too long to be drawn whole: gone through a few times, drawn in part.

Every number is of all rows (`occlog.report.content.of_all`).  Tracks are gone through first, as their times say which
rows of the other tables the replay needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.consistency.verdict import Evidence
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.mot.headline import own_identities
from occlog.evaluate.sources import streamed_bearings
from occlog.evaluate.verdict import AgainstTruth, Made, with_truth
from occlog.io.files.put_aside.spool import Spool
from occlog.io.files.put_aside.table import Aside
from occlog.io.files.tables.header import describe
from occlog.io.open import Opened, open_in_unit
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
from occlog.report.content import thinned as rule
from occlog.report.content.beside_bound import BesideBound
from occlog.report.content.fared import FaredStreams, deviation
from occlog.report.content.followed import followers, relabelled
from occlog.report.content.of_all import OfAll
from occlog.report.content.people import PeopleStreams, crowd
from occlog.report.content.selections import SelectionStreams
from occlog.report.content.thinned import ErrorsSoFar, Thinned, Whole, fewer, thinned, with_rows
from occlog.report.plots.visibility import MOST_ROWS as MOST_CAMERAS
from occlog.report.replay.moments import MOST_MOVING, chosen, shortly_before

from .long_bearings import Beside, Posts, bearings_of

T = TypeVar("T", bound=Table)


@dataclass(frozen=True)
class LongTables:
    """Tables of a report; None where not given."""

    tracks: Path | None = None
    truth: Path | None = None
    errors: Path | None = None
    bearings: Path | None = None
    bound: Path | None = None
    diagnostics: Path | None = None
    events: Path | None = None
    occluders: Path | None = None
    unit: str | None = None
    """Of lengths; None: as each has them."""

    @cached_property
    def are_long(self) -> bool:
        """Whether one of them has too many rows to be drawn whole, or is of a recording with so many messages."""
        kinds: dict[str, tuple[type[Table], ...]] = {
            "tracks": (Tracks,),
            "truth": (Truth,),
            "errors": (Errors,),
            "bearings": (Bearings, Doa),
            "bound": (Bound,),
            "diagnostics": (Diagnostics,),
            "events": (Events,),
            "occluders": (Occluders, Hulls),
        }
        return any(_at_least(self.opened(name), kind) > rule.MOST_ROWS for name, kind in kinds.items())

    def opened(self, name: str) -> Opened | None:
        """An input, of which nothing is read yet; None where it is not given."""
        path: Path | None = getattr(self, name)
        return None if path is None else open_in_unit(path, self.unit)

    def read(self, made: Made, scene: Scene | None, metrics: Mapping[str, object]) -> dict[str, Any]:
        """What `ReportInput` takes of them.

        Args:
            made: how the tracks were made.
            scene: of the run.
            metrics: figures of the evaluation.
        """
        return _Reading(self, made, scene).all(metrics)


def _at_least(opened: Opened | None, kinds: Iterable[type[Table]]) -> int:
    """How many rows an input has at least that is a table of occlog, or messages that is a recording."""
    if opened is None or opened.foreign is not None:
        return 0
    if opened.recording is not None:
        return sum(opened.recording.messages(kind) for kind in kinds)
    return int(describe(opened.path)["rows"])


@dataclass(frozen=True)
class _Input(Generic[T]):
    """A table that is gone through several times."""

    opened: Opened
    chunks: Callable[[], Iterator[T]]

    @cached_property
    def rows(self) -> int:
        """How many rows it has; what is no table of occlog is gone through."""
        if self.opened.recording is None and self.opened.foreign is None:
            return int(describe(self.opened.path)["rows"])
        return sum(len(chunk) for chunk in self.chunks())


class _Reading:
    """Goes through the tables, and gathers what is drawn and what is said."""

    def __init__(self, given: LongTables, made: Made, scene: Scene | None) -> None:
        self._given, self._made, self._scene = given, made, scene
        self._tables: dict[str, Table] = {}
        self._whole: dict[str, Whole] = {}
        self._of_all: dict[str, Any] = {}
        self._moments: Ints | None = None
        self._unknown = self._own = False
        self._selected: tuple[SelectionStreams, _Input[Diagnostics]] | None = None
        self._posts = Posts()
        self._evidence = Evidence()
        self._against = AgainstTruth(made, scene)

    def all(self, metrics: Mapping[str, object]) -> dict[str, Any]:
        """What `ReportInput` takes."""
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
            self._of_all["judged"] = with_truth(
                self._evidence, self._made, self._against, unknown=self._unknown, metrics=metrics
            )
        return self._tables | {"of_all": OfAll(whole=self._whole, moments=self._moments, **self._of_all)}

    def _open(self, name: str, kind: type[T]) -> _Input[T] | None:
        """An input that has rows of a table; None where none is given, or it is a recording without them."""
        opened = self._given.opened(name)
        if opened is None or (opened.recording is not None and not opened.has(kind)):
            return None

        def rows() -> Iterator[T]:
            return opened.rows(kind)

        # Messages of a recording take their time to be read
        return _Input(opened, rows if opened.recording is None else Aside(kind, rows).chunks)

    def _keep(self, name: str, found: Thinned[T]) -> T:
        self._tables[name], self._whole[name] = found.table, found.whole
        return found.table

    def _thin(self, name: str, rows: int, chunks: Iterable[T], kind: type[T], *, ends: bool = True) -> Thinned[T]:
        """Keep a part of a table of so many rows."""
        found = thinned(chunks, kind, rows, rule.MOST_ROWS, also=self._moments, ends=ends)
        self._keep(name, found)
        return found

    def _read_tracks(self) -> None:
        """Tracks, and of everybody how many people there are and who sees them."""
        given = self._open("tracks", PeopleTracks)
        if given is None:
            return
        people, spread = PeopleStreams(), Spool()
        everybody = _says_existence(given.opened)
        bearings = self._given.bearings is not None and self._scene is not None

        def watched() -> Iterator[PeopleTracks]:
            for piece in whole_times(given.chunks()):
                self._unknown = self._unknown or bool(np.isnan(piece.cov_xx).any())
                if everybody:
                    people.add(piece)
                if bearings:
                    self._posts.add(piece)
                if self._given.diagnostics is not None and not self._unknown:
                    spread.add(deviation(piece))
                yield piece

        whole = self._thin("tracks", given.rows, watched(), PeopleTracks).whole
        self._evidence.rows = whole.rows
        if not self._unknown:
            self._of_all["deviation"] = median_of(spread)
        if people.any:
            people.begin_cells(whole.span_ns, whole.step_ns)
            for piece in given.chunks():
                people.see(piece, MOST_CAMERAS)
            table = self._tables["tracks"]
            assert isinstance(table, PeopleTracks)
            self._of_all["people"] = people.finish(crowd(table.take(np.isin(table.t_ns, whole.at))))

    def _read_truth(self) -> None:
        """The truth, and with it the moments that the replay shows."""
        given, truth = self._open("truth", Truth), None
        if given is not None:
            truth = self._thin("truth", given.rows, given.chunks(), Truth)
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
        self._of_all["every"] = leading.every * every
        if given is not None and truth is not None and truth.whole.every > 1 and "tracks" in self._whole:
            step_ns = leading.step_ns
            near = with_rows(truth, given.chunks(), lambda rows: shortly_before(moments, step_ns, rows.t_ns)[0])
            self._keep("truth", near)

    def _read_diagnostics(self) -> None:
        """How the filter fared, and which cameras were selected."""
        given = self._open("diagnostics", Diagnostics)
        if given is None:
            return
        fared, selected = FaredStreams(), SelectionStreams(max(-(-given.rows // rule.MOST_ROWS), 1))
        self._evidence.rows = 0

        def watched() -> Iterator[Diagnostics]:
            for chunk in given.chunks():
                self._evidence.fared(chunk)
                fared.add(chunk)
                selected.add(chunk)
                yield chunk

        whole = self._thin("diagnostics", given.rows, watched(), Diagnostics).whole
        if not whole.rows:
            return
        self._of_all["fared"] = fared.finish()
        self._selected = selected, given

    def _read_selections(self) -> None:
        """What came out where cameras were selected; errors say nothing of tracks that have names of their own."""
        if self._selected is None:
            return
        selected, given = self._selected
        if selected.any:
            errors, tracks = self._tables.get("errors"), self._tables.get("tracks")
            named = isinstance(errors, Errors) and isinstance(tracks, Tracks) and relabelled(followers(errors, tracks))
            if not named:
                self._came_out(selected, given, Errors)
            self._came_out(selected, given, Tracks)
        self._of_all["selections"] = selected.finish()

    def _came_out(
        self, selected: SelectionStreams, diagnostics: _Input[Diagnostics], kind: type[Errors] | type[Tracks]
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
        theirs = None if bound is None else self._thin("bound", bound.rows, bound.chunks(), Bound)
        if errors is None:
            return
        ours = self._thin("errors", errors.rows, errors.chunks(), Errors)
        of_all, beside = ErrorsSoFar(), BesideBound()
        # One pass more: the RMSE up to a row is of all rows before it
        sides = Side(errors.chunks(), Errors), Side(() if bound is None else bound.chunks(), Bound)
        so_far = _Drawn(ours.rows), _Drawn(np.zeros(0, np.int64) if theirs is None else theirs.rows)
        for limits in in_step(sides, (0, 0)):
            part, its = limits.of(sides[0]), limits.of(sides[1])
            if not self._own:
                self._against.update(part)
            so_far[0].add(of_all.add(part))
            so_far[1].add(beside.add(part, its))
        self._of_all |= {"errors": of_all, "errors_so_far": so_far[0].values(())}
        if bound is not None:
            self._of_all |= {"bound": beside, "bound_so_far": so_far[1].values((2,))}

    def _read_events(self) -> None:
        """What happened, and how often."""
        given = self._open("events", Events)
        if given is None:
            return
        counts: Counter[str] = Counter()

        def watched() -> Iterator[Events]:
            for chunk in given.chunks():
                counts.update(chunk.kind.tolist())
                yield chunk

        self._thin("events", given.rows, watched(), Events, ends=False)
        self._of_all["events"] = dict(counts)

    def _read_occluders(self) -> None:
        """Where moving occluders were thought to be, at the moments of the replay and at others."""
        opened = self._given.opened("occluders")
        kind: type[Occluders] | type[Hulls] = Hulls if opened is not None and opened.has(Hulls) else Occluders
        given: _Input[Any] | None = self._open("occluders", kind)
        if given is None:
            return
        moments, every = self._moments, 1
        if moments is not None and given.rows > rule.MOST_ROWS:
            counts = np.zeros(len(moments), np.int64)
            for chunk in given.chunks():
                at = np.searchsorted(moments, chunk.t_ns[np.isin(chunk.t_ns, moments)])
                counts += np.bincount(at, minlength=len(moments))
            every = fewer(counts, rule.MOST_ROWS)
        some = None if moments is None else moments[::every]
        self._keep("occluders", thinned(given.chunks(), kind, given.rows, rule.MOST_ROWS, also=some, ends=False))
        self._of_all["priors_every"] = every

    @property
    def _with_bearings(self) -> bool:
        """Whether bearings speak for and against the tracks, whose labels those of everybody are not."""
        return "bearings" in self._whole and self._whole["bearings"].rows > 0 and "people" not in self._of_all

    def _read_bearings(self) -> None:
        """What sensors saw, how it fits the tracks, and the sight lines of the moments."""
        stream = self._stream()
        if stream is None:
            return
        leading = self._whole.get("tracks") or self._whole.get("truth")
        labelled = self._scene is not None and "tracks" in self._whole and "people" not in self._of_all
        beside = None
        if labelled and self._scene is not None:
            tracks, said = self._open("tracks", Tracks), self._open("diagnostics", Diagnostics)
            same = said is not None and self._whole["diagnostics"].rows == self._whole["tracks"].rows
            assert tracks is not None
            fared = said.chunks if said is not None and same else None
            beside = Beside(tracks.chunks, fared, self._posts, self._evidence, self._made, self._without())
        step_ns = float("nan") if leading is None else leading.step_ns
        found = bearings_of(stream, self._scene, self._targets(), (self._moments, step_ns), beside)
        self._tables["bearings"], self._whole["bearings"] = found.table, found.whole
        self._of_all |= {"looked": found.looked, "sight_every": found.every}
        self._of_all |= {"residuals": found.residuals, "sight": found.sight}

    def _stream(self) -> Callable[[], Iterator[Bearings]] | None:
        """All bearings, with the directions of arrival of a recording as `occlog track` uses them."""
        opened = self._given.opened("bearings")
        if opened is None:
            return None
        if self._scene is not None and opened.recording is not None and opened.has(Doa):
            return streamed_bearings(self._given.bearings, None, False, self._scene)
        found = self._open("bearings", Bearings)
        return None if found is None else found.chunks

    def _targets(self) -> tuple[int, ...]:
        """Identities of the tracked targets, ascending."""
        names = [np.unique(_targets(self._tables[t])) for t in ("tracks", "errors") if t in self._tables]
        return tuple(int(i) for i in np.unique(np.concatenate(names))) if names else ()

    def _without(self) -> frozenset[int]:
        """Targets of which no error is known."""
        errors = self._tables.get("errors")
        known = set() if errors is None else set(_targets(errors).tolist())
        return frozenset(self._targets()) - known


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


def _says_existence(opened: Opened) -> bool:
    """Whether tracks may say how probable it is that people are there."""
    ours = opened.foreign is None and opened.recording is None
    return not ours or any(column["name"] == "existence" for column in describe(opened.path)["columns"])


def _targets(table: Table) -> Ints:
    """The column target_id."""
    out: Ints = getattr(table, "target_id")  # noqa: B009
    return out
