"""Experiments, and the rules by which statements are judged.

Measured quantities: value, standard error, and the range of the true value.

The range reaches two standard errors to each side.  For few runs it is wider, by Student's t, so that the
true value is below it, or above it, in 2.3 % of all cases whatever the number of runs.

The parts of an experiment: its size, trials, table of rows, and verdicts on the paper's statements.

Where a paper makes a statement, and in which words.

The one rule by which statements are judged.

A statement is about a quantity, and holds while that is in a `good` interval; it holds in part while the
quantity is in a wider one, `fair`.  A measurement has a range of two standard errors to each side
(`measures`).  The statement is

reproduced        if the range is in the good interval;
not reproduced    if the range is outside of the fair interval;
in part           if the range is in the fair interval, and outside of the good one, or across an end of that with
                  a small error bar: half the range at most `SHARP` of the good interval's half and of the
                  distance between the ends;
not decided       otherwise: the error bar is too large to state.

An exact quantity has a range of width 0, so that it is always decided.

A statement about several points holds, fails or is open at each of them: it holds if the range is in the
good interval, it fails if the range is outside of it, or if there is no difference of relevance.  It is reproduced
if it holds at all points, in part if at half of them or more; it is not decided if the open points could change that.
`number`, `printed`, `factor`, `pairs` and `close` are cases of these two.

The words of a verdict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import betaincinv, stdtrit

from occlog.array_types import Ints
from occlog.pipeline.sweep.trial import Spec, run_trial

from .plots import PlanFigure, Shots

Execute = Callable[[Sequence[Spec]], list[dict[str, float]]]
"""Runs trials and returns their figures in the order of the trials; see `occlog.pipeline.sweep.engine.run_all`."""

EXTRAS = ("rmse_occ", "hidden", "sir", "restart", "lost", "mean_ess", "messages", "bytes", "track_seconds")
"""Figures of trials that the table has also the RMSE, as means over the runs."""


class Size(NamedTuple):
    """Numbers that set the cost of an experiment, and the seed of its random numbers.

    Attributes:
        runs: number of runs with different random numbers.
        steps: length of a run, or what the experiment counts in its place.
        quick: whether it is the small form, too small to judge by.
        particles: number of particles of particle filters.
        seed: seed of the experiment.
    """

    runs: int
    steps: int
    quick: bool = False
    particles: int = 1000
    seed: int = 0


@dataclass(frozen=True)
class PaperRow:
    """One point of a figure, with the value of every run.

    Attributes:
        series: name of the series that the point belongs to.
        x: position along the x axis; NaN: a line across the figure.
        values: value of every run.
        extra: further columns of the table.
        plotted: whether the row is in the plot; all rows are in the table.
        each: further figures of every run by name.
    """

    series: str
    x: float
    values: tuple[float, ...]
    extra: dict[str, float] = field(default_factory=dict)
    plotted: bool = True
    each: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def runs(self) -> int:
        """Number of runs, each with a value."""
        return len(self.values)

    @property
    def mean(self) -> float:
        """Mean over the runs; NaN if there are none."""
        return math.fsum(self.values) / len(self.values) if self.values else math.nan

    @property
    def sd(self) -> float:
        """Standard deviation over the runs; NaN for fewer than two."""
        return deviation(self.values)

    @property
    def error(self) -> float:
        """Standard error of the mean; NaN for fewer than two runs."""
        return self.sd / math.sqrt(len(self.values)) if self.values else math.nan


Table = list[PaperRow]


@dataclass(frozen=True)
class StatementVerdict:
    """A statement of the paper, and whether the measurement confirms it.

    Attributes:
        id: id, of words with hyphens.
        statement: text of the statement.
        paper: number that the paper has; None: none.
        measured: number that was measured; None: none could be.
        error_bar: standard error of `measured`; None: not known.
        runs: number of runs that it is from.
        verdict: one of `WORDS`.
        rule: how the verdict was reached.
        place: figure, table, equation or section of the paper.
        page: page of the paper, where its text has page numbers.
        words: the statement as the paper has it; empty: its text does not state it.
    """

    id: str
    statement: str
    paper: float | None
    measured: float | None
    error_bar: float | None
    runs: int
    verdict: str
    rule: str
    place: str = ""
    page: int | None = None
    words: str = ""

    def as_dict(self) -> dict[str, object]:
        """Fields by name as plain values for JSON; NaN and infinities become None."""
        out = asdict(self)
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in out.items()}


@dataclass(frozen=True)
class Experiment:
    """A figure or table of a paper: how its rows are computed, and how its statements are judged.

    Attributes:
        item: key of the experiment.
        title: title of its page.
        x_label, y_label: names of the axes of its plot.
        runs, steps: number of runs, and of steps of a run, in the full form.
        quick: runs and steps of the small form.
        compute: makes the table; it is given the size, and a function that runs trials.
        judge: verdicts on the statements, from the table.
        note: remark below the plot.
        trial: runs one of the trials of `compute`.
        plans: further pictures by name.
    """

    item: str
    title: str
    x_label: str
    y_label: str
    runs: int
    steps: int
    quick: tuple[int, int]
    compute: Callable[[Size, Execute], Table]
    judge: Callable[[Table], list[StatementVerdict]]
    note: str = ""
    trial: Callable[[Spec], dict[str, float]] = run_trial
    plans: Mapping[str, Callable[[Size], PlanFigure | Shots]] = field(default_factory=dict)


def deviation(values: Sequence[float]) -> float:
    """Standard deviation of a sample; NaN for fewer than two values."""
    n = len(values)
    if n < 2:
        return math.nan
    mean = math.fsum(values) / n
    return math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1))


CONFIDENCE = 0.5 * (1.0 + math.erf(math.sqrt(2.0)))
"""Probability that a normal variable is less than two standard deviations above its mean."""


class Measure(NamedTuple):
    """A quantity that was measured, or computed exactly.

    Attributes:
        value: the quantity; NaN: missing.
        error: standard error; 0: computed exactly, NaN: not known.
        runs: number of independent samples that the error is from.
        low, high: ends of the range of the true value: its 95.4 % confidence interval (two standard errors to each
            side for many runs); infinite where the error is not known, both `value` where that is exact.
    """

    value: float
    error: float
    runs: int
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the width of the confidence interval of the true value."""
        return 0.5 * (self.high - self.low)


def errors_allowed(runs: int) -> float:
    """Standard errors to each side of a 95.4 % confidence interval: about 2 for many runs; infinite below two runs.

    By Student's t distribution with `runs` - 1 degrees of freedom.
    """
    return float(stdtrit(runs - 1, CONFIDENCE)) if runs >= 2 else math.inf


def estimate(value: float, error: float, runs: int) -> Measure:
    """Quantity with its standard error and a 95.4 % confidence interval of the true value.

    Args:
        value: the quantity.
        error: standard error; 0: exact; NaN: unknown, the interval is unlimited.
        runs: number of independent runs, which sets the interval's width; for fewer than two it is unlimited.
    """
    if error == 0.0 and not math.isnan(value):
        return Measure(value, error, runs, value, value)
    if math.isnan(value) or math.isnan(error) or runs < 2:
        return Measure(value, error, runs, -math.inf, math.inf)
    width = errors_allowed(runs) * error
    return Measure(value, error, runs, value - width, value + width)


def exact(value: float, runs: int = 1) -> Measure:
    """`value` as a quantity without error: a formula, or a count of what the statement is about.

    `runs`: number of runs, for display only.
    """
    return estimate(value, 0.0, runs)


def sample(values: Sequence[float]) -> Measure:
    """Mean of independent values with its standard error; NaN without values."""
    n = len(values)
    if n == 0:
        return estimate(math.nan, math.nan, 0)
    return estimate(math.fsum(values) / n, deviation(values) / math.sqrt(n), n)


def mean_of(row: PaperRow) -> Measure:
    """Mean of a row over its runs, with its standard error."""
    return sample(row.values)


def share_of(held: int, runs: int) -> Measure:
    """Share of runs in which something holds, in `held` of `runs`, with the interval of Clopper and Pearson.

    The error is that of two further runs in which it holds and two in which it does not (Agresti and Coull), since the
    plain one vanishes where all runs agree.
    """
    if runs == 0:
        return estimate(math.nan, math.nan, 0)
    tail, rest = 1.0 - CONFIDENCE, runs - held
    low = float(betaincinv(held, rest + 1, tail)) if held else 0.0
    high = float(betaincinv(held + 1, rest, CONFIDENCE)) if rest else 1.0
    middle = (held + 2.0) / (runs + 4.0)
    return Measure(held / runs, math.sqrt(middle * (1.0 - middle) / (runs + 4.0)), runs, low, high)


def difference(low: PaperRow, high: PaperRow) -> tuple[float, float]:
    """Mean of high - low and its standard error, run by run where the numbers of runs are equal."""
    if low.runs == high.runs:
        gap = sample([b - a for a, b in zip(low.values, high.values, strict=True)])
        return gap.value, gap.error
    return high.mean - low.mean, math.hypot(low.error, high.error)


def difference_of(low: PaperRow, high: PaperRow) -> Measure:
    """Mean of high - low as `difference` computes it, with standard error and confidence interval."""
    return estimate(*difference(low, high), min(low.runs, high.runs))


def quotient(above: PaperRow, below: PaperRow) -> tuple[float, float]:
    """Quotient of two means and its standard error by the delta method; NaN if `below` has mean 0.

    Where the numbers of runs are equal, the runs are taken as pairs.
    """
    if not below.mean:
        return math.nan, math.nan
    ratio = above.mean / below.mean
    if above.runs == below.runs:
        left = [a - ratio * b for a, b in zip(above.values, below.values, strict=True)]
        return ratio, deviation(left) / math.sqrt(len(left)) / abs(below.mean)
    return ratio, math.hypot(above.error, ratio * below.error) / abs(below.mean)


def quotient_of(above: PaperRow, below: PaperRow) -> Measure:
    """Quotient of the means of two rows, `above` over `below`, with standard error and confidence interval."""
    return estimate(*quotient(above, below), min(above.runs, below.runs))


def power_of(rows: Sequence[PaperRow]) -> Measure:
    """Exponent of x, fitted by least squares to log y against log x in every run.

    Args:
        rows: rows of equal numbers of runs, with positive x and values; below two rows there is no exponent.
    """
    if len(rows) < 2:
        return estimate(math.nan, math.nan, 0)
    x = np.log([row.x for row in rows])
    x = x - x.mean()
    return sample([float(x @ np.log([row.values[k] for row in rows]) / (x @ x)) for k in range(rows[0].runs)])


def bootstrapped(runs: int, statistic: Callable[[Ints], float], resamples: int) -> Measure:
    """Statistic of the runs with its bootstrap confidence interval (95.4 %), widened for few runs as by `estimate`.

    Args:
        runs: number of runs.
        statistic: figure of the runs with these indices, which may repeat; NaN if missing.
        resamples: number of bootstrap samples. If the statistic is NaN for more than a tenth of them, or for the runs
            themselves, the result is NaN with an unlimited interval, as it is below two runs.
    """
    value = statistic(np.arange(runs))
    drawn = np.random.default_rng(2009).integers(runs, size=(resamples, runs)) if runs else np.empty((0, 0), int)
    found = [x for d in drawn if not math.isnan(x := statistic(d))]
    if math.isnan(value) or runs < 2 or len(found) < 0.9 * resamples:
        return estimate(math.nan, math.nan, runs)
    wide = 0.5 * errors_allowed(runs)
    low, high = (float(q) for q in np.quantile(found, [1.0 - CONFIDENCE, CONFIDENCE]))
    return Measure(value, deviation(found), runs, value - wide * (value - low), value + wide * (high - value))


P = TypeVar("P")


def run_trials(
    points: Iterable[P], size: Size, execute: Execute, spec: Callable[[P, int], Spec]
) -> list[tuple[P, list[dict[str, float]]]]:
    """Run `size.runs` trials at each point of a figure, and return each point with the figures of its runs.

    `spec` makes the specification of a trial from a point and the number of the run, which counts from 0.
    """
    given, runs = list(points), size.runs
    results = execute([spec(point, run) for point in given for run in range(runs)])
    return [(point, results[i * runs : (i + 1) * runs]) for i, point in enumerate(given)]


def values_of(results: Iterable[Mapping[str, float]], figure: str) -> tuple[float, ...]:
    """Values of one figure in the trials `results`, in their order."""
    return tuple(r[figure] for r in results)


class PaperSource(NamedTuple):
    """Where a paper makes a statement.

    Attributes:
        place: figure, table, equation or section.
        words: words of the paper; empty: its text does not make the statement, or only prints a number.
        page: page of the figure, or where the section begins; only the text of [Lee] has page numbers.
    """

    place: str
    words: str = ""
    page: int | None = None


OWN = PaperSource("of this project")
"""A statement that no paper makes."""
Sources = Mapping[str, PaperSource]
"""Sources by the beginning of a verdict's id, up to a hyphen; the longest that fits counts."""


def source_of(key: str, sources: Sources) -> PaperSource | None:
    """Where the paper makes the statement of the verdict with the id `key`; None if no beginning of the id is known.

    `sources`: places by beginning of the id, up to a hyphen; the longest counts.
    """
    parts = key.split("-")
    for n in range(len(parts), 0, -1):
        found = sources.get("-".join(parts[:n]))
        if found is not None:
            return found
    return None


def attributed(verdicts: Sequence[StatementVerdict], sources: Sources) -> list[StatementVerdict]:
    """Verdicts with place, page and words of the paper; those that have a place keep it."""
    out = []
    for verdict in verdicts:
        source = None if verdict.place else source_of(verdict.id, sources)
        out.append(verdict if source is None else replace(verdict, **source._asdict()))
    return out


REPRODUCED, IN_PART, NOT, UNDECIDED = "reproduced", "in part", "not reproduced", "not decided"
WORDS = (REPRODUCED, IN_PART, NOT, UNDECIDED)
"""All verdicts, in the order of tables."""


NEAR, FAR = 0.10, 0.35
"""Shares of a stated number within which it is reproduced, and in part."""
SHARP = 0.5
"""Largest half of a range that spans an end of the good interval and is still decided."""
NEGLIGIBLE = 0.02
"""A difference that is not above 0 for sure is none if it is known to be within this share of the level."""
Pair = tuple[PaperRow, PaperRow]


class Interval(NamedTuple):
    """Closed interval of numbers from `low` to `high`; all numbers by default."""

    low: float = -math.inf
    high: float = math.inf

    def holds(self, m: Measure) -> bool:
        """Whether the whole confidence interval of the quantity is in this interval."""
        return self.low <= m.low and m.high <= self.high

    def misses(self, m: Measure) -> bool:
        """Whether the whole confidence interval of the quantity is outside this interval."""
        return m.high < self.low or self.high < m.low


def at_most(limit: float) -> Interval:
    """Interval of numbers up to a limit, which is included."""
    return Interval(high=limit)


def at_least(limit: float) -> Interval:
    """Interval of numbers from a limit on, which is included."""
    return Interval(low=limit)


def above(limit: float) -> Interval:
    """Interval of numbers above a limit, without it."""
    return Interval(low=math.nextafter(limit, math.inf))


def below(limit: float) -> Interval:
    """Interval of numbers below a limit, without it."""
    return Interval(high=math.nextafter(limit, -math.inf))


def around(number: float, share: float) -> Interval:
    """Interval of numbers within a share of a number."""
    return Interval(number - share * abs(number), number + share * abs(number))


class StatementPoint(NamedTuple):
    """One of several points of a statement.

    Attributes:
        measure: quantity, usually a difference.
        good: interval in which the statement holds.
        none: a difference that is known to be up to this, in size, is none; 0: every difference counts.
    """

    measure: Measure
    good: Interval
    none: float = 0.0

    def stands(self) -> bool | None:
        """True where the statement holds, False where it fails, None where the confidence interval leaves it open."""
        if self.good.holds(self.measure):
            return True
        negligible = Interval(-self.none, self.none).holds(self.measure)
        return False if negligible or self.good.misses(self.measure) else None


def find(table: Table, series: str, x: float | None = None) -> PaperRow | None:
    """Row of a series at x (None: its first row); None if missing."""
    for row in table:
        if row.series == series and (x is None or row.x == x):
            return row
    return None


def row_of(table: Table, series: str, x: float | None = None) -> PaperRow:
    """Row of a series at x (None: its first row), which the experiment always has; KeyError if it is missing."""
    row = find(table, series, x)
    if row is None:
        raise KeyError(series, x)
    return row


def series(table: Table, name: str) -> list[PaperRow]:
    """Rows of the series `name` that have an x, by rising x."""
    return sorted((r for r in table if r.series == name and not math.isnan(r.x)), key=lambda r: r.x)


def matched(table: Table, low: str, high: str, only: Iterable[float] | None = None) -> list[Pair]:
    """Pairs (low, high) of rows of two series at the same x, by rising x.

    Args:
        table: table of both series.
        low: name of the series that the first row of a pair is of.
        high: name of the series that the second row is of.
        only: values of x that count; None: all.
    """
    kept = None if only is None else set(only)
    pairs = []
    for row in series(table, low):
        other = find(table, high, row.x)
        if other is not None and (kept is None or row.x in kept):
            pairs.append((row, other))
    return pairs


def neighbours(rows: Sequence[PaperRow]) -> list[Pair]:
    """Pairs of each row and the one before it, so that `pairs` states that the series falls."""
    return [(after, before) for before, after in pairwise(rows)]


def word_of(m: Measure, good: Interval, fair: Interval) -> str:
    """Word of the verdict on a quantity, by its confidence interval.

    `REPRODUCED`: it is in the good interval; `NOT`: outside the fair one; `IN_PART`: in the fair one, and outside the
    good one or across an end of it and narrow; otherwise, and without a value, `UNDECIDED`.

    Args:
        m: quantity with its confidence interval.
        good: interval in which the statement is reproduced.
        fair: interval in which it is reproduced in part.
    """
    if math.isnan(m.value):
        return UNDECIDED
    if good.holds(m):
        return REPRODUCED
    if fair.misses(m):
        return NOT
    if fair.holds(m) and (good.misses(m) or m.half_width <= SHARP * _margin(good, fair)):
        return IN_PART
    return UNDECIDED


def _margin(good: Interval, fair: Interval) -> float:
    """Least of half the length of the good interval and the distances between its ends and those of the fair one.

    Lengths that are 0 or infinite do not count; 0 if none is left.
    """
    widths = (0.5 * (good.high - good.low), fair.high - good.high, good.low - fair.low)
    return min((w for w in widths if math.isfinite(w) and w > 0.0), default=0.0)


def judge(
    key: str,
    statement: str,
    measure: Measure,
    good: Interval,
    fair: Interval | None = None,
    *,
    rule: str,
    paper: float | None = None,
) -> StatementVerdict:
    """Verdict on a statement about one quantity.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        measure: the quantity.
        good: interval in which the statement holds.
        fair: interval in which it holds in part, and which contains `good`; None: it holds or not, never in part.
        rule: both intervals in words.
        paper: number that the paper has; None: none.
    """
    word = word_of(measure, good, fair or good)
    return _verdict(key, statement, measure, paper=paper, word=word, rule=rule)


def fact(
    key: str, statement: str, *, holds: bool, measured: float | None, rule: str, paper: float | None = None
) -> StatementVerdict:
    """Verdict on a statement that was decided exactly.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        holds: whether it is reproduced.
        measured: number that is shown; None: none.
        rule: how it was decided.
        paper: printed number; None: none.
    """
    word = REPRODUCED if holds else NOT
    shown = exact(math.nan if measured is None else measured)
    return _verdict(key, statement, shown, paper=paper, word=word, rule=rule)


class ExactStatement(NamedTuple):
    """A statement about one quantity that is computed without error.

    Statement, the range of the quantity in which it is reproduced, and that rule in words.
    """

    statement: str
    good: Interval
    rule: str


def exact_rows(statements: Iterable[str], found: Mapping[str, float]) -> Table:
    """A row for each statement (ids) with its quantity in `found`; x is the number of the statement, from 1."""
    return [PaperRow(key, k, (found[key],)) for k, key in enumerate(statements, start=1)]


def judge_exactly(statements: Mapping[str, ExactStatement], table: Table) -> list[StatementVerdict]:
    """Verdict on each statement by its quantity in the rows of `exact_rows`, which has no error bar."""
    return [
        judge(row.series, s.statement, exact(row.mean), s.good, rule=s.rule)
        for row in table
        if (s := statements[row.series])
    ]


def judge_points(
    key: str,
    statement: str,
    points: Sequence[StatementPoint],
    *,
    rule: str,
    paper: float | None = None,
    shown: Measure | None = None,
) -> StatementVerdict:
    """Verdict on a statement about several points.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        points: the points; without any, nothing is decided.
        rule: what holds at a point, in words.
        paper: number that the paper has; None: none.
        shown: what the verdict shows as measured; None: the mean over the points.
    """
    stands = [p.stands() for p in points]
    held, left = sum(s is True for s in stands), sum(s is None for s in stands)
    least, most = (share([True] * n + [False] * (len(points) - n)) for n in (held, held + left))
    word = least if points and least == most else UNDECIDED
    count = f"{held} of {len(points)} points"
    counted = f"{rule}: holds at {count}" + (f", open at {left}" if left else "")
    return _verdict(key, statement, shown or _mean(points), paper=paper, word=word, rule=counted)


def _mean(points: Sequence[StatementPoint]) -> Measure:
    """Mean of the quantities of several points, as if they were independent; NaN without points."""
    n = len(points)
    if n == 0:
        return estimate(math.nan, math.nan, 0)
    mean = math.fsum(p.measure.value for p in points) / n
    error = math.sqrt(math.fsum(p.measure.error**2 for p in points)) / n
    return estimate(mean, error, min(p.measure.runs for p in points))


def _verdict(key: str, statement: str, m: Measure, *, paper: float | None, word: str, rule: str) -> StatementVerdict:
    """Verdict with a word that was decided; NaN becomes None, and an open one states why it is open.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        m: quantity that is shown.
        paper: printed number; None or NaN: none.
        word: one of `WORDS`.
        rule: how the verdict was reached.
    """
    value, error = (None if math.isnan(x) else x for x in (m.value, m.error))
    reported = (
        rule if word != UNDECIDED else f"{rule}; the error bar is too large to state" if value is not None else rule
    )
    if value is None and word == UNDECIDED:
        reported = f"{rule}; it could not be measured"
    return StatementVerdict(
        key,
        statement,
        paper=None if paper is None or math.isnan(paper) else paper,
        measured=value,
        error_bar=error,
        runs=m.runs,
        verdict=word,
        rule=reported,
    )


def share(held: Sequence[bool]) -> str:
    """Word for points that hold or not: `REPRODUCED` if all of them do, `IN_PART` if at least half do, else `NOT`.

    Without points it is `NOT`.
    """
    if held and all(held):
        return REPRODUCED
    return IN_PART if held and 2 * sum(held) >= len(held) else NOT


def pairs(key: str, statement: str, points: Sequence[Pair], paper: float | None = None) -> StatementVerdict:
    """Verdict on whether low is below high at every point; the mean difference, run by run, is shown.

    A difference that may be 0 and is known to be within `NEGLIGIBLE` of the level counts as none.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        points: pairs (low, high) of rows.
        paper: printed difference; None: none.
    """
    rule = f"above 0 by two standard errors (no difference: known to be within {NEGLIGIBLE:.0%} of the level)"
    return judge_points(key, statement, [lower(low, high) for low, high in points], rule=rule, paper=paper)


def lower(low: PaperRow, high: PaperRow) -> StatementPoint:
    """Point of the statement that the mean of `low` is below that of `high`, with their difference."""
    level = 0.5 * (abs(low.mean) + abs(high.mean))
    return StatementPoint(difference_of(low, high), above(0.0), NEGLIGIBLE * level)


def close(key: str, statement: str, points: Sequence[Pair]) -> StatementVerdict:
    """Verdict on whether two rows are as good as equal: within one standard deviation over the runs.

    The confidence interval of the difference of their means must be within the larger of both standard deviations.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        points: pairs of rows; it has to hold for each.
    """
    near = []
    for low, high in points:
        tolerance = max(low.sd, high.sd)
        near.append(StatementPoint(difference_of(low, high), Interval(-tolerance, tolerance)))
    rule = "the difference and two standard errors of it are within one standard deviation over the runs"
    return judge_points(key, statement, near, rule=rule)


def number(key: str, statement: str, paper: float, measured: float, error: float, runs: int) -> StatementVerdict:
    """Verdict on a printed number: within `NEAR` of it (a share), in part within `FAR`.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        paper: printed number.
        measured: number that was computed.
        error: its standard error; 0: exact.
        runs: number of runs.
    """
    return stated(key, statement, paper, estimate(measured, error, runs))


def stated(key: str, statement: str, paper: float, m: Measure) -> StatementVerdict:
    """Verdict on a printed number: within `NEAR` of it (a share), in part within `FAR`.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        paper: printed number.
        m: quantity with its range.
    """
    rule = f"within {NEAR:.0%} of it; in part within {FAR:.0%}"
    return judge(key, statement, m, around(paper, NEAR), around(paper, FAR), rule=rule, paper=paper)


def printed(key: str, statement: str, number: float, row: PaperRow | None) -> StatementVerdict:
    """Verdict on a printed number to its digits: within two units of the last; in part within `NEAR`.

    Two units, since the inputs are rounded too.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        number: printed number, with a decimal point.
        row: what was computed; None: missing.
    """
    digits = len(f"{number}".split(".")[1])
    near = 2.0 * 10.0**-digits
    fair = max(NEAR * abs(number), near)
    rule = f"printed digits: off by at most two units of the last; in part within {NEAR:.0%}"
    value = exact(math.nan if row is None else row.mean)
    good, part = Interval(number - near, number + near), Interval(number - fair, number + fair)
    return judge(key, statement, value, good, part, rule=rule, paper=number)


def factor(key: str, statement: str, paper: float, low: PaperRow | None, high: PaperRow | None) -> StatementVerdict:
    """Verdict on a printed quotient, above 1, of the means of `high` and `low`.

    Within `NEAR` of it (a share); in part if it has at least half of the excess over 1.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        paper: printed quotient.
        low: row of the denominator; None: missing, nothing is decided.
        high: row of the numerator; None: missing, nothing is decided.
    """
    m = quotient_of(high, low) if low is not None and high is not None else estimate(math.nan, math.nan, 0)
    rule = f"within {NEAR:.0%} of it; in part if at least half of the excess over 1"
    return judge(key, statement, m, around(paper, NEAR), at_least(1.0 + 0.5 * (paper - 1.0)), rule=rule, paper=paper)
