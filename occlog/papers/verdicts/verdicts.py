"""The one rule by which statements are judged.

A statement is about a quantity, and holds while that is in a `good` interval; it holds in part while the
quantity is in a wider one, `fair`.  What was measured has a range of two standard errors to each side
(`measures`).  The statement is

reproduced        if the range is in the good interval;
not reproduced    if the range is outside of the fair interval;
in part           if the range is in the fair interval, and outside of the good one, or across an end of that with
                  a small error bar: half the range at most `SHARP` of the good interval's half and of the
                  distance between the ends;
not decided       otherwise: the error bar is too large to say.

What is computed exactly has a range of width 0, so that it is always decided.

A statement about several points holds, fails or is open at each of them: it holds if the range is in the
good interval, it fails if the range is outside of it, or if there is no difference to speak of.  It is reproduced
if it holds at all points, in part if at half of them or more; it is not decided if the open points could change that.
`number`, `printed`, `factor`, `pairs` and `close` are cases of these two.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from .measures import Measure, difference_of, estimate, exact, quotient_of
from .model import Row, Table, Verdict
from .words import IN_PART as IN_PART
from .words import NOT as NOT
from .words import REPRODUCED as REPRODUCED
from .words import UNDECIDED as UNDECIDED
from .words import WORDS as WORDS

NEAR, FAR = 0.10, 0.35
"""Shares of a stated number within which it is reproduced, and in part."""
SHARP = 0.5
"""Largest half of a range that lies across an end of the good interval and is decided all the same."""
NEGLIGIBLE = 0.02
"""A difference that is not above 0 for sure is none if it is known to be within this share of the level."""
Pair = tuple[Row, Row]


class Interval(NamedTuple):
    """Numbers from `low` to `high`, both included."""

    low: float = -math.inf
    high: float = math.inf

    def holds(self, m: Measure) -> bool:
        """Return whether the whole range is in the interval."""
        return self.low <= m.low and m.high <= self.high

    def misses(self, m: Measure) -> bool:
        """Return whether the whole range is outside."""
        return m.high < self.low or self.high < m.low


def at_most(limit: float) -> Interval:
    """Return the numbers up to a limit."""
    return Interval(high=limit)


def at_least(limit: float) -> Interval:
    """Return the numbers from a limit on."""
    return Interval(low=limit)


def above(limit: float) -> Interval:
    """Return the numbers above a limit, without it."""
    return Interval(low=math.nextafter(limit, math.inf))


def below(limit: float) -> Interval:
    """Return the numbers below a limit, without it."""
    return Interval(high=math.nextafter(limit, -math.inf))


def around(number: float, share: float) -> Interval:
    """Return the numbers within a share of a number."""
    return Interval(number - share * abs(number), number + share * abs(number))


class Point(NamedTuple):
    """One of several points of a statement."""

    measure: Measure
    good: Interval
    none: float = 0.0  # a difference up to this is none; 0: every difference counts

    def stands(self) -> bool | None:
        """Return true where the statement holds, false where it fails, and None where that is open."""
        if self.good.holds(self.measure):
            return True
        negligible = Interval(-self.none, self.none).holds(self.measure)
        return False if negligible or self.good.misses(self.measure) else None


def find(table: Table, series: str, x: float | None = None) -> Row | None:
    """Return the row of a series at x (None: its first row), or None where there is none."""
    for row in table:
        if row.series == series and (x is None or row.x == x):
            return row
    return None


def series(table: Table, name: str) -> list[Row]:
    """Return the rows of a series that have an x, by rising x."""
    return sorted((r for r in table if r.series == name and not math.isnan(r.x)), key=lambda r: r.x)


def matched(table: Table, low: str, high: str, only: Iterable[float] | None = None) -> list[Pair]:
    """Return the pairs of rows of two series at the same x; `only`: at these x alone."""
    kept = None if only is None else set(only)
    pairs = []
    for row in series(table, low):
        other = find(table, high, row.x)
        if other is not None and (kept is None or row.x in kept):
            pairs.append((row, other))
    return pairs


def neighbours(rows: Sequence[Row]) -> list[Pair]:
    """Pair each row with the one before it, so that `pairs` states that the series falls."""
    return [(after, before) for before, after in pairwise(rows)]


def word_of(m: Measure, good: Interval, fair: Interval) -> str:
    """Return the word for a quantity; see the text of the module."""
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
    """Return the least of half the good interval and the distances between its ends and those of the fair one."""
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
) -> Verdict:
    """Judge a statement about one quantity; `fair` None: it holds or not, never in part.

    Args:
        key: id of the verdict.
        statement: what is stated.
        measure: the quantity.
        good: where the statement holds.
        fair: where it holds in part; contains `good`.
        rule: both intervals in words.
        paper: the number that the paper has.
    """
    word = word_of(measure, good, fair or good)
    return _verdict(key, statement, measure, paper=paper, word=word, rule=rule)


def fact(
    key: str, statement: str, *, holds: bool, measured: float | None, rule: str, paper: float | None = None
) -> Verdict:
    """Judge a statement that was computed exactly, and holds or does not; `measured` is only shown."""
    word = REPRODUCED if holds else NOT
    shown = exact(math.nan if measured is None else measured)
    return _verdict(key, statement, shown, paper=paper, word=word, rule=rule)


def judge_points(
    key: str,
    statement: str,
    points: Sequence[Point],
    *,
    rule: str,
    paper: float | None = None,
    shown: Measure | None = None,
) -> Verdict:
    """Judge a statement about several points.

    Args:
        key: id of the verdict.
        statement: what is stated.
        points: the points; without any, nothing is decided.
        rule: what holds at a point, in words.
        paper: the number that the paper has.
        shown: what the verdict shows as measured; None: the mean over the points.
    """
    stands = [p.stands() for p in points]
    held, left = sum(s is True for s in stands), sum(s is None for s in stands)
    least, most = (share([True] * n + [False] * (len(points) - n)) for n in (held, held + left))
    word = least if points and least == most else UNDECIDED
    count = f"{held} of {len(points)} points"
    counted = f"{rule}: holds at {count}" + (f", open at {left}" if left else "")
    return _verdict(key, statement, shown or _mean(points), paper=paper, word=word, rule=counted)


def _mean(points: Sequence[Point]) -> Measure:
    n = len(points)
    if n == 0:
        return estimate(math.nan, math.nan, 0)
    mean = math.fsum(p.measure.value for p in points) / n
    error = math.sqrt(math.fsum(p.measure.error**2 for p in points)) / n
    return estimate(mean, error, min(p.measure.runs for p in points))


def _verdict(key: str, statement: str, m: Measure, *, paper: float | None, word: str, rule: str) -> Verdict:
    value, error = (None if math.isnan(x) else x for x in (m.value, m.error))
    said = rule if word != UNDECIDED else f"{rule}; the error bar is too large to say" if value is not None else rule
    if value is None and word == UNDECIDED:
        said = f"{rule}; it could not be measured"
    return Verdict(
        key,
        statement,
        paper=None if paper is None or math.isnan(paper) else paper,
        measured=value,
        error_bar=error,
        runs=m.runs,
        verdict=word,
        rule=said,
    )


def share(held: Sequence[bool]) -> str:
    """Return `reproduced` if all points hold, `in part` if at least half do, else (or without points) `not`."""
    if held and all(held):
        return REPRODUCED
    return IN_PART if held and 2 * sum(held) >= len(held) else NOT


def pairs(key: str, statement: str, points: Sequence[Pair], paper: float | None = None) -> Verdict:
    """Judge that low is below high at every point; `measured` is the mean difference, run by run.

    A difference that may be 0 and is known to be within `NEGLIGIBLE` of the level counts as none.
    """
    rule = f"above 0 by two standard errors (no difference: known to be within {NEGLIGIBLE:.0%} of the level)"
    return judge_points(key, statement, [lower(low, high) for low, high in points], rule=rule, paper=paper)


def lower(low: Row, high: Row) -> Point:
    """Return the point at which the mean of one row should be below that of another."""
    level = 0.5 * (abs(low.mean) + abs(high.mean))
    return Point(difference_of(low, high), above(0.0), NEGLIGIBLE * level)


def close(key: str, statement: str, points: Sequence[Pair]) -> Verdict:
    """Judge that low and high are as good as equal at every point: within one standard deviation over the runs."""
    near = []
    for low, high in points:
        tolerance = max(low.sd, high.sd)
        near.append(Point(difference_of(low, high), Interval(-tolerance, tolerance)))
    rule = "the difference and two standard errors of it are within one standard deviation over the runs"
    return judge_points(key, statement, near, rule=rule)


def number(key: str, statement: str, paper: float, measured: float, error: float, runs: int) -> Verdict:
    """Judge a stated number: within `NEAR` of it, in part within `FAR`; an error of 0 is an exact computation."""
    return stated(key, statement, paper, estimate(measured, error, runs))


def stated(key: str, statement: str, paper: float, m: Measure) -> Verdict:
    """Judge a stated number as `number` does."""
    rule = f"within {NEAR:.0%} of it; in part within {FAR:.0%}"
    return judge(key, statement, m, around(paper, NEAR), around(paper, FAR), rule=rule, paper=paper)


def printed(key: str, said: str, number: float, row: Row | None) -> Verdict:
    """Judge a printed number to its digits: within two units of the last, as its inputs are rounded too."""
    digits = len(f"{number}".split(".")[1])
    near = 2.0 * 10.0**-digits
    fair = max(NEAR * abs(number), near)
    rule = f"printed digits: off by at most two units of the last; in part within {NEAR:.0%}"
    value = exact(math.nan if row is None else row.mean)
    good, part = Interval(number - near, number + near), Interval(number - fair, number + fair)
    return judge(key, said, value, good, part, rule=rule, paper=number)


def factor(key: str, statement: str, paper: float, low: Row | None, high: Row | None) -> Verdict:
    """Judge a stated quotient high / low, above 1, of two means; None where there is no such row."""
    m = quotient_of(high, low) if low is not None and high is not None else estimate(math.nan, math.nan, 0)
    rule = f"within {NEAR:.0%} of it; in part if at least half of the excess over 1"
    return judge(key, statement, m, around(paper, NEAR), at_least(1.0 + 0.5 * (paper - 1.0)), rule=rule, paper=paper)
