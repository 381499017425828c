"""Text of the comparison of two runs: heading, sentences, and table cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Ints
from occlog.console.text import counted
from occlog.errors import UsageError, option
from occlog.evaluate.compare import text
from occlog.evaluate.compare.text import ComparisonRow, MetricComparison
from occlog.records.losses import Loss
from occlog.records.tables import Tracks
from occlog.report.content.metrics_in_words import groups, number
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.page import verdict_heading
from occlog.settings import METRES

from .config import RunComparisonConfig
from .matching.divergences import (
    ONLY_B,
    ONLY_IN_A,
    OTHER,
    TOO_FAR_APART,
    Divergences,
    ErrorsOverTime,
    RunComparisonStep,
)
from .matching.pairs import AlignedEstimates, MatchedRuns, Piece, RunPairs, TrackChange, unmatched_changes


@dataclass(frozen=True, eq=False)
class RunSide:
    """One of the two compared runs.

    Attributes:
        name: different from that of the other run.
        data: content of a report of it.
        tracks: all its estimates.
        laid: its estimates in the common frames.
    """

    name: str
    data: ReportInput
    tracks: Tracks
    laid: AlignedEstimates


@dataclass(frozen=True, eq=False)
class TruthComparison:
    """Comparison of runs A and B with the truth.

    Attributes:
        comparison: metrics of both with differences and tests, as of `occlog compare`.
        a, b: tracks matched to each true target over time.
        switches: identity switches of A and of B, as CLEAR-MOT counts them.
        over_time: errors over time.
    """

    comparison: MetricComparison
    a: MatchedRuns
    b: MatchedRuns
    switches: tuple[int, int]
    over_time: ErrorsOverTime


@dataclass(frozen=True, eq=False)
class RunComparisonPage:
    """Content of the page that compares runs A and B.

    Attributes:
        title: heading of the page.
        a, b: the runs.
        near: match threshold of a track with a target, or with a track of the other run.
        tolerance: partners that are farther apart than this diverge.
        lasting_s: changes of track that last less are not listed [s].
        times: (T,) times of the common frames [ns].
        pairs: per-frame pairs of the runs.
        frame_divergences: frames and people in which they diverge.
        in_b, in_a: tracks of B matched to each track of A over time, and tracks of A matched to those of B.
        against_truth: comparison with the truth; None: no truth.
        same: whether all estimates are equal, to the last digit.
        notes: mismatches of time spans, recordings or scenes, for the reader.
        provenance: how everything was made, as JSON-ready values.
    """

    title: str
    a: RunSide
    b: RunSide
    near: float
    tolerance: float
    lasting_s: float
    times: Ints
    pairs: RunPairs
    frame_divergences: Divergences
    in_b: MatchedRuns
    in_a: MatchedRuns
    against_truth: TruthComparison | None
    same: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """Length unit of both runs."""
        return self.a.data.unit

    @property
    def sides(self) -> tuple[tuple[str, RunSide], tuple[str, RunSide]]:
        """Both runs, each with its letter, A or B."""
        return ("A", self.a), ("B", self.b)

    @property
    def time(self) -> TimeAxis:
        """Time axis, from the start of the common frames (or of the truth) to the later end."""
        found = [self.times] if self.against_truth is None else [self.times, self.against_truth.over_time.t_ns]
        found = [times for times in found if len(times)]
        return TimeAxis(int(min(t[0] for t in found)), int(max(t[-1] for t in found)))

    @property
    def losses(self) -> tuple[tuple[str, Loss], ...]:
        """Losses with the letter of the run; equal losses of both are listed once."""
        known: dict[Loss, str] = {}
        for letter, side in self.sides:
            for loss in side.data.losses:
                known[loss] = "both" if known.get(loss, letter) != letter else letter
        return tuple((owner, loss) for loss, owner in known.items())


def lengths_of(config: RunComparisonConfig, unit: str) -> tuple[float, float]:
    """Return the match threshold and the divergence distance in the scene's unit.

    UsageError if one is neither given nor has a default (lengths in an unknown unit).

    Args:
        config: as given, in the scene's unit; None for a default.
        unit: unit of lengths.
    """
    if unit in METRES:
        usual = RunComparisonConfig.in_unit(unit)
        near, tolerance = usual.match_distance, usual.divergence_distance
    else:
        near, tolerance = None, None
    near = near if config.match_distance is None else config.match_distance
    tolerance = tolerance if config.divergence_distance is None else config.divergence_distance
    if near is None or tolerance is None:
        raise UsageError(
            f"lengths are in {unit!r}: give {option('match_distance')}, the largest distance of matched tracks, "
            f"and {option('divergence_distance')}, from which they diverge",
            id="missing-unit",
        )
    return near, tolerance


NAMES = {"idf1": "IDF1", "hota": "HOTA", "mota": "MOTA", "matched_rmse": "RMSE of pairs"}
"""Figures with names that are not words; see `occlog.core.metrics.mot.frame_sums`."""
MEANINGS = {
    "idf1": "share of time with one track per person",
    "hota": "finding and following, over many limits of distance",
    "mota": "1 less misses, false tracks and exchanges, of all true people",
    "recall": "true people that are found",
    "precision": "tracks that are on a person",
    "matched_rmse": "distance from the truth of those that are found",
}
KINDS = {
    TOO_FAR_APART: "partners beyond tolerance",
    ONLY_IN_A: "A alone has a person",
    ONLY_B: "B alone has a person",
    OTHER: "another partner",
}
MAX_ROWS = 50
"""People and changes that are reported; how many more there are is stated."""
MAX_PIECES = 8
"""Pieces of one person in a cell."""


class FigureRow(NamedTuple):
    """Row of the page's table of figures; all cells are text.

    Attributes:
        name: name of the figure.
        meaning: meaning of the figure in words.
        a, b: values in runs A and B.
        difference: B minus A.
        interval: confidence interval of the difference.
        p: p-value of the difference.
        verdict: whether the runs differ, in words.
    """

    name: str
    meaning: str
    a: str
    b: str
    difference: str
    interval: str
    p: str
    verdict: str


class DivergenceRow(NamedTuple):
    """Row of the page's table of divergences.

    Attributes:
        what: kind of divergence.
        seconds: first time [s since the start]; None: it does not occur.
        who: tracks concerned at that time.
        distance: distance with unit.
        often: number of occurrences, in words.
    """

    what: str
    seconds: float | None
    who: str
    distance: str
    often: str


class Cell(NamedTuple):
    """Cell with a track that is matched to a person, and its interval, as text.

    `seconds`: start of it [s], None: unlinked.
    """

    text: str
    seconds: float | None


class IdentityRow(NamedTuple):
    """Row of the page's table of identities.

    Attributes:
        who: the person.
        a, b: tracks matched to the person in runs A and B.
    """

    who: str
    a: list[Cell]
    b: list[Cell]


class ChangeRow(NamedTuple):
    """Row of the page's table of identity changes.

    Attributes:
        seconds: time [s since the start].
        run: name of the run.
        who: the person.
        before, after: tracks before and after the change.
        other: whether the other run has the change, too, in words.
    """

    seconds: float
    run: str
    who: str
    before: str
    after: str
    other: str


def seconds(found: RunComparisonPage, t_ns: int) -> float:
    """Return the time `t_ns` [ns] as seconds since the page's start, rounded to microseconds."""
    return round((t_ns - found.time.start_ns) / NS, 6)


def format_time(found: RunComparisonPage, t_ns: int) -> str:
    """Return the time `t_ns` [ns] as text: seconds since the page's start, with unit."""
    return f"{seconds(found, t_ns):.2f} s"


# ---- the heading and the lines below it


def comparison_heading(found: RunComparisonPage) -> str:
    """Return the heading of the page: whether the runs differ, and which is better."""
    if found.same:
        return "The two runs are the same"
    if found.against_truth is not None:
        return _of_verdicts(found.against_truth.comparison.rows)
    first = found.frame_divergences.first
    return "They do not part" if first is None else f"They part at {format_time(found, first[1].t_ns)}"


def _of_verdicts(rows: Sequence[ComparisonRow]) -> str:
    """Return a line that names the figures in which run B is better, and those in which it is worse."""
    decided = [f"{v} in {names}" for v in ("better", "worse") if (names := _names(r for r in rows if r.verdict == v))]
    if decided:
        return f"B is {' and '.join(decided)}"
    open_ones = sum(row.verdict == "not decided" for row in rows)
    if open_ones == len(rows):
        return "Whether they differ in accuracy is not decided"
    return f"No difference {'is shown in what can be decided' if open_ones else 'in accuracy is shown'}"


def _names(rows: Iterable[ComparisonRow]) -> str:
    return listed([NAMES.get(row.figure, row.figure) for row in rows])


def listed(names: Sequence[str]) -> str:
    """Return names as text: `a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def sentences(found: RunComparisonPage) -> list[str]:
    """Return the sentences below the heading: figures, first divergence, identities, notes."""
    out = []
    if found.same:
        out.append("Every estimate of one is an estimate of the other, to the last digit.")
    if found.against_truth is None:
        out.append("Only ground truth shows which run is better: give it as a recording or a table of true positions.")
    else:
        out += _of_figures(found)
    out.append(first_divergence(found))
    out.append(of_identities(found))
    return [*out, *(_sentence(note) for note in found.notes)]


def _sentence(note: str) -> str:
    return f"{note[:1].upper()}{note[1:]}{'' if note.endswith('?') else '.'}"


def _of_figures(found: RunComparisonPage) -> list[str]:
    assert found.against_truth is not None
    comparison, out = found.against_truth.comparison, []
    for row, cells in zip(comparison.rows, text.rows_of(comparison, 1), strict=True):
        if row.verdict in ("better", "worse"):
            out.append(
                f"{NAMES.get(row.figure, row.figure)}: B has {cells[2]}, A {cells[1]}: {row.verdict} by "
                f"{cells[3].lstrip('+-')} (95 % interval of the difference {cells[4]}, p {cells[5]})."
            )
    rest = [
        (verdict, names)
        for verdict in ("no difference shown", "not decided")
        if (names := _names(row for row in comparison.rows if row.verdict == verdict))
    ]
    out += [f"{verdict.capitalize()}: {names}." for verdict, names in rest]
    return out


def first_divergence(found: RunComparisonPage) -> str:
    """Return a sentence about the first divergence of the runs."""
    first, measure = found.frame_divergences.first, f"{number(found.tolerance)} {found.unit}"
    if first is None:
        return (
            f"In {counted(found.frame_divergences.frames, 'common frame')} both have the same number of people at the "
            f"same positions: no partners are farther than {measure} from each other."
        )
    kind, step = first
    share = f"{found.frame_divergences.diverged} of {counted(found.frame_divergences.frames, 'frame')}"
    return (
        f"They first diverge at {format_time(found, step.t_ns)}: {_divergence_text(found, kind, step)}. They differ in "
        f"{share}: one "
        f"has a person whom the other has not, or partners are farther than {measure} from each other."
    )


def _divergence_text(found: RunComparisonPage, kind: str, step: RunComparisonStep) -> str:
    away = f"{number(float(f'{step.distance:.3g}'))} {found.unit}"
    if kind == TOO_FAR_APART:
        return f"track {step.a} of A is {away} from track {step.b} of B"
    if kind == OTHER:
        return f"from here on track {step.b} of B goes with track {step.a} of A, which had another partner before"
    letter, other, track = ("A", "B", step.a) if kind == ONLY_IN_A else ("B", "A", step.b)
    unmatched = not np.isfinite(step.distance)
    where = f"{other} has no track" if unmatched else f"the nearest of {other} is {away} away"
    return f"track {track} of {letter} has no partner within {number(found.near)} {found.unit}; {where}"


def of_identities(found: RunComparisonPage) -> str:
    """Return the sentences about the numbers of identity changes in both runs."""
    truth = found.against_truth
    if truth is not None:
        a, b = len(truth.a.changes), len(truth.b.changes)
        own = [len(unmatched_changes(x, y, lasting_ns(found))) for x, y in ((truth.a, truth.b), (truth.b, truth.a))]
        statement = (
            f"Another track goes on with a person {counted(a, 'time')} in A and {counted(b, 'time')} in B; {own[0]} of "
            f"A and {own[1]} of B the other run does not have"
            if a or b
            else "In neither run another track goes on with a person"
        )
        switches = counted(truth.switches[0], "identity switch", "identity switches")
        return f"{statement}. CLEAR-MOT counts {switches} in A and {truth.switches[1]} in B."
    changed = _changed(found.in_b) + _changed(found.in_a)
    if not changed:
        return "No track changes its partner."
    return (
        f"{counted(_changed(found.in_b), 'track')} of A and {counted(_changed(found.in_a), 'track')} of B "
        "have another partner later on: there one of the runs has taken a person for another person, or lost and found."
    )


def followed(found: RunComparisonPage) -> tuple[MatchedRuns, MatchedRuns]:
    """Return the tracks of A and of B matched to true targets over time, or without a truth to each other."""
    truth = found.against_truth
    return (found.in_a, found.in_b) if truth is None else (truth.a, truth.b)


def _changed(followed: MatchedRuns) -> int:
    return len({change.who for change in followed.changes})


def lasting_ns(found: RunComparisonPage) -> int:
    """Return the least duration of changes that are listed [ns]."""
    return round(found.lasting_s * NS)


def verdict_words(side: RunSide) -> tuple[str, bool]:
    """Return the outcome of a run's consistency checks as a line, and whether it is plausible (True without checks)."""
    return verdict_heading(side.data.verdicts), side.data.plausible is not False


# ---- tables


def figure_rows(found: RunComparisonPage) -> list[FigureRow]:
    """Return the rows of the table of metrics; empty without a truth."""
    if found.against_truth is None:
        return []
    comparison, out = found.against_truth.comparison, []
    for row, (_, a, b, difference, interval, p, verdict) in zip(
        comparison.rows, text.rows_of(comparison, 1), strict=True
    ):
        unit = f" [{found.unit}]" if row.figure == "matched_rmse" else ""
        statement = f"B {verdict}" if verdict in ("better", "worse") else verdict
        name, meaning = NAMES.get(row.figure, row.figure) + unit, MEANINGS.get(row.figure, "")
        out.append(FigureRow(name, meaning, a, b, difference, interval, p, statement))
    return out


def basis_sentence(found: RunComparisonPage) -> str:
    """Return the sentence about frames and test that the figures are based on; empty without a truth."""
    if found.against_truth is None:
        return ""
    return text.basis(found.against_truth.comparison)


def stored_metrics(found: RunComparisonPage) -> list[tuple[str, str, str, str]]:
    """Return the figures that `evaluate` has stored in both run folders, as text: name, value of A, of B, unit.

    Empty if a run has none.
    """
    values = [_values(side, found.unit) for _, side in found.sides]
    if not all(values):
        return []
    keys = dict.fromkeys([*values[0], *values[1]])
    return [(f"{key[0]}: {key[1]}", values[0].get(key, "–"), values[1].get(key, "–"), key[2]) for key in keys]


def _values(side: RunSide, unit: str) -> dict[tuple[str, str, str], str]:
    """Return the stored figures of a run that have a name in words: value as text by (group, name, unit)."""
    known = [group for group in groups(side.data.metrics, unit) if group.title != "Other figures"]
    return {(group.title, f.name, f.unit): f.value for group in known for f in group.figures}


def divergence_rows(found: RunComparisonPage) -> list[DivergenceRow]:
    """Return the rows of the table of divergences.

    One row per kind (first time, how often), then the largest distance, and the longest sequences of diverged frames.
    """
    out = []
    for kind in found.frame_divergences.kinds:
        often = f"{kind.frames} of {counted(found.frame_divergences.frames, 'frame')}" if kind.frames else "never"
        often = counted(kind.rows, "change") if kind.rows and kind.name == OTHER else often
        out.append(_row(found, f"first: {KINDS[kind.name]}", kind.first, often))
    if found.frame_divergences.farthest is not None:
        out.append(_row(found, "farthest partners", found.frame_divergences.farthest, ""))
    for segment in found.frame_divergences.segments:
        length = f"{format_time(found, segment.start_ns)} to {format_time(found, segment.end_ns)}"
        at_start = segment.worst._replace(t_ns=segment.start_ns)
        out.append(_row(found, f"divergence from {length}", at_start, ""))
    return out


def _row(found: RunComparisonPage, what: str, step: RunComparisonStep | None, often: str) -> DivergenceRow:
    if step is None:
        return DivergenceRow(what, None, "", "", often)
    who = " · ".join(f"{letter} {k}" for letter, k in (("A", step.a), ("B", step.b)) if k is not None)
    away = "no other track" if np.isnan(step.distance) else f"{number(float(f'{step.distance:.3g}'))} {found.unit}"
    return DivergenceRow(what, seconds(found, step.t_ns), who, away, often)


def identity_rows(found: RunComparisonPage) -> tuple[list[IdentityRow], int]:
    """Return the rows of the table of matched tracks, people with several tracks first.

    And the number of omitted rows.
    """
    rows = []
    truth = found.against_truth
    if truth is not None:
        for who in sorted({piece.who for piece in (*truth.a.pieces, *truth.b.pieces)}):
            rows.append((f"person {who}", truth.a.of(who), truth.b.of(who)))
    else:
        rows += [(f"A {who}", (), found.in_b.of(who)) for who in matched_people(found.in_b)]
        rows += [
            (f"B {who}", found.in_a.of(who), ()) for who in matched_people(found.in_a) if _several(found.in_a.of(who))
        ]
    rows.sort(key=lambda row: -max(_several(row[1]), _several(row[2])))
    cells = [IdentityRow(who, _cells(found, a), _cells(found, b)) for who, a, b in rows[:MAX_ROWS]]
    return cells, max(len(rows) - MAX_ROWS, 0)


def matched_people(*followed: MatchedRuns) -> list[int]:
    """Return the sorted identities of the people with matched intervals."""
    return sorted({piece.who for each in followed for piece in each.pieces})


def _several(pieces: Sequence[Piece]) -> int:
    """Return the number of different tracks in a person's intervals `pieces`, without the first one; at least 0."""
    return max(len({piece.track for piece in pieces}) - 1, 0)


def _cells(found: RunComparisonPage, pieces: Sequence[Piece]) -> list[Cell]:
    out = [
        Cell(
            f"{p.track} ({seconds(found, p.start_ns):.2f} to {seconds(found, p.end_ns):.2f} s)",
            seconds(found, p.start_ns),
        )
        for p in pieces[:MAX_PIECES]
    ]
    return [*out, Cell(f"and {len(pieces) - MAX_PIECES} more", None)] if len(pieces) > MAX_PIECES else out


def change_rows(found: RunComparisonPage) -> tuple[list[ChangeRow], int]:
    """Return the rows of the table of identity changes in the order of time; and the number of omitted rows."""
    truth, rows = found.against_truth, list[tuple[int, ChangeRow]]()
    if truth is not None:
        for letter, own, other in (("A", truth.a, truth.b), ("B", truth.b, truth.a)):
            alone = set(unmatched_changes(own, other, lasting_ns(found)))
            rows += [(c.t_ns, _change(found, letter, f"person {c.who}", c, c in alone)) for c in own.changes]
    else:
        rows += [(c.t_ns, _change(found, "B", f"A {c.who}", c, None)) for c in found.in_b.changes]
        rows += [(c.t_ns, _change(found, "A", f"B {c.who}", c, None)) for c in found.in_a.changes]
    rows.sort(key=lambda row: row[0])
    return [row for _, row in rows[:MAX_ROWS]], max(len(rows) - MAX_ROWS, 0)


def _change(found: RunComparisonPage, run: str, who: str, change: TrackChange, alone: bool | None) -> ChangeRow:
    other = {None: "", True: "does not", False: "does, too"}[alone]
    return ChangeRow(seconds(found, change.t_ns), run, who, f"{run} {change.before}", f"{run} {change.after}", other)


def consequence_of_change(found: RunComparisonPage) -> list[int]:
    """Return the times [ns] of common frames that the page links to and the replay therefore keeps."""
    steps = [kind.first.t_ns for kind in found.frame_divergences.kinds if kind.first is not None]
    steps += [found.frame_divergences.farthest.t_ns] if found.frame_divergences.farthest is not None else []
    steps += [segment.start_ns for segment in found.frame_divergences.segments]
    return steps + [c.t_ns for each in followed(found) for c in each.changes[:MAX_ROWS]]
