"""Rules by which statements are judged; every verdict names its rule.

number   a stated number: `reproduced` within 10 % of it, or within two standard errors if the standard error
         is at most 10 % of it; `in part` within 35 %, or, where the number is a factor by which something
         grows, if at least half of its excess over 1 is there.
printed  a number that follows from printed inputs without any noise: `reproduced` if it is off by at most two
         units of its last digit; `in part` within 10 %.
pairs    a statement that one mean is below another, at several points: a point counts as held if
         the difference is above one standard error of it.  All points: `reproduced`; at least half: `in part`.
close    two means are as good as equal, at several points: a point counts as held if they differ by
         no more than one standard deviation over the runs, and the standard error of the difference is
         at most half of that.  Counted in the same way.

Differences are taken run by run, since trials of equal run share world and noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

from .model import Row, Table, Verdict, deviation

REPRODUCED, IN_PART, NOT = "reproduced", "in part", "not reproduced"
NEAR, FAR = 0.10, 0.35
SHARP = 0.5
"""Largest standard error of a difference that shows agreement, as a share of the difference that is allowed."""
Pair = tuple[Row, Row]


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


def difference(low: Row, high: Row) -> tuple[float, float]:
    """Return the mean of high - low and its standard error, run by run where the numbers of runs are equal."""
    if low.runs == high.runs:
        values = [b - a for a, b in zip(low.values, high.values, strict=True)]
        return math.fsum(values) / len(values), deviation(values) / math.sqrt(len(values))
    return high.mean - low.mean, math.hypot(low.error, high.error)


def share(held: Sequence[bool]) -> str:
    """Return `reproduced` if all points hold, `in part` if at least half do, else (or without points) `not`."""
    if held and all(held):
        return REPRODUCED
    return IN_PART if held and 2 * sum(held) >= len(held) else NOT


def pairs(key: str, statement: str, points: Sequence[Pair], paper: float | None = None) -> Verdict:
    """Judge by rule `pairs` that low is below high at every point; `measured` is the mean difference."""
    found = [difference(low, high) for low, high in points]
    held = [gap > error for gap, error in found]
    rule = f"pairs: {sum(held)} of {len(held)} differences above one standard error"
    return _verdict(key, statement, paper=paper, found=found, points=points, verdict=share(held), rule=rule)


def close(key: str, statement: str, points: Sequence[Pair]) -> Verdict:
    """Judge by rule `close` that low and high are equal at every point; `measured` is the mean difference.

    A large error bar is no agreement: it must be at most `SHARP` of what the means may differ by.
    """
    found = [difference(low, high) for low, high in points]
    held = []
    for (gap, error), (low, high) in zip(found, points, strict=True):
        tolerance = max(low.sd, high.sd)
        held.append(abs(gap) <= tolerance and error <= SHARP * tolerance)
    rule = f"close: {sum(held)} of {len(held)} differences within one standard deviation, known to half of it"
    return _verdict(key, statement, paper=None, found=found, points=points, verdict=share(held), rule=rule)


def number(key: str, statement: str, paper: float, measured: float, error: float, runs: int) -> Verdict:
    """Judge a quantity by rule `number`."""
    fair = abs(measured - paper) <= FAR * abs(paper)
    good = _near(measured, error, paper)
    rule = f"number: within {NEAR:.0%} or 2 (small) standard errors; in part within {FAR:.0%}"
    return Verdict(
        key,
        statement,
        paper=paper,
        measured=measured,
        error_bar=error,
        runs=runs,
        verdict=REPRODUCED if good else IN_PART if fair else NOT,
        rule=rule,
    )


def printed(key: str, said: str, number: float, row: Row | None) -> Verdict:
    """Judge a printed number to its digits: within two units of the last, as its inputs are rounded too."""
    if row is None:
        return Verdict(
            key,
            said,
            paper=number,
            measured=None,
            error_bar=None,
            runs=0,
            verdict=NOT,
            rule="printed digits; it could not be computed",
        )
    off = abs(row.mean - number)
    digits = len(f"{number}".split(".")[1])
    near, fair = 2.0 * 10.0**-digits, NEAR * abs(number)
    verdict = REPRODUCED if off <= near else IN_PART if off <= fair else NOT
    rule = f"printed digits: off by at most two units of the last; in part within {NEAR:.0%}"
    return Verdict(key, said, paper=number, measured=row.mean, error_bar=None, runs=1, verdict=verdict, rule=rule)


def factor(key: str, statement: str, paper: float, low: Row | None, high: Row | None) -> Verdict:
    """Judge the quotient high / low of two means by rule `number`; without both rows it is not reproduced."""
    rule = f"number: within {NEAR:.0%} or 2 (small) standard errors; in part if at least half of the excess over 1"
    if low is None or high is None:
        return Verdict(
            key,
            statement,
            paper=paper,
            measured=None,
            error_bar=None,
            runs=0,
            verdict=NOT,
            rule=rule + "; it could not be measured",
        )
    measured, error = quotient(high, low)
    good = _near(measured, error, paper)
    fair = measured - 1.0 >= 0.5 * (paper - 1.0)
    return Verdict(
        key,
        statement,
        paper=paper,
        measured=measured,
        error_bar=error,
        runs=min(low.runs, high.runs),
        verdict=REPRODUCED if good else IN_PART if fair else NOT,
        rule=rule,
    )


def _near(measured: float, error: float, paper: float) -> bool:
    """Return whether a measured number agrees with a stated one; within a large error bar alone it does not."""
    near = NEAR * abs(paper)
    return abs(measured - paper) <= (max(near, 2.0 * error) if error <= near else near)


def quotient(above: Row, below: Row) -> tuple[float, float]:
    """Return the quotient of two means and its standard error by the delta method; NaN if `below` has mean 0."""
    if not below.mean:
        return math.nan, math.nan
    if not above.mean:
        return 0.0, above.error / abs(below.mean)
    ratio = above.mean / below.mean
    return ratio, abs(ratio) * math.hypot(above.error / above.mean, below.error / below.mean)


def _verdict(
    key: str,
    statement: str,
    paper: float | None,
    found: Sequence[tuple[float, float]],
    points: Sequence[Pair],
    verdict: str,
    rule: str,
) -> Verdict:
    n = len(found)
    mean = math.fsum(gap for gap, _ in found) / n if n else None
    error = math.sqrt(math.fsum(e * e for _, e in found)) / n if n else None
    runs = min((min(a.runs, b.runs) for a, b in points), default=0)
    return Verdict(key, statement, paper=paper, measured=mean, error_bar=error, runs=runs, verdict=verdict, rule=rule)
