"""[Qu] Table 2 by the paper's own criterion: the fewest particles that do not degrade the performance.

Sec. 4.4.3 selects "the minimal number of particles which does not degrade the performance significantly".  Here the
performance is the sum of both failure rates (Eq. 9), and a number of particles suffices if the mean over the videos is
within `WORSE` of that with the most particles tried.  Video and trackers of a run have their own seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.papers import verdicts as v
from occlog.papers.qu.common import everywhere, seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, bootstrapped
from occlog.pipeline.sweep.trial import Spec, Values

from .table2 import BMCT, MCMC, PRINTED, VIEWS

WORSE = 2.0
"""Failures [%] above those with the most particles that do not count as a significant degradation."""
FOLLOWED = 20.0
"""Failures [%] with the most particles above which the targets count as lost, so that none suffice."""
LINEAR = 1.3
"""Largest exponent of the number of targets that counts as linear; as in Table 2 by effective samples."""
TRIED = {MCMC: (6, 12, 25, 50, 100, 200, 400), BMCT: (6, 12, 25, 50, 100, 200)}
"""Particles of a view for each target: a tracker's, and the joint filter's over the targets."""
QUICK = {MCMC: (6, 25), BMCT: (12, 50)}
RESAMPLES = 1000


class FailureCurve(NamedTuple):
    """Failures of a filter at one number of targets, with K numbers of particles in R runs.

    Attributes:
        targets: number of targets.
        totals: (K,) number of particles of all trackers in all views, ascending.
        rates: (K, R) sum of both failure rates [%].
    """

    targets: int
    totals: Floats
    rates: Floats


def failure_rates(size: Size, execute: Execute) -> Table:
    """Table of FR_p + FR_l [%] against the total number of particles, for each filter and number of targets."""
    counts, tried = ((4, 6), QUICK) if size.quick else ((4, 5, 6, 8), TRIED)
    found = v.run_trials(counts, size, execute, lambda n, run: _spec(size, run, n, tried))
    rows = []
    for name, numbers in tried.items():
        for n, own in found:
            for k in numbers:
                each = {q: tuple(100.0 * r[f"{name}-{k}.{q}"] for r in own) for q in ("fr_p", "fr_l")}
                both = tuple(a + b for a, b in zip(each["fr_p"], each["fr_l"], strict=True))
                means = {q: math.fsum(x) / len(x) for q, x in each.items()}
                rows.append(PaperRow(series_of(name, n), total(n, k), both, means))
    return rows


def series_of(name: str, targets: int) -> str:
    """Name of the series of the filter `name` at a number of targets."""
    return f"{name}, {targets} targets"


def total(targets: int, particles: int) -> float:
    """Number of particles in all views for a number of targets, at `particles` of each target in a view."""
    return float(VIEWS * particles * targets)


def _spec(size: Size, run: int, targets: int, tried: Mapping[str, Sequence[int]]) -> Spec:
    """Specification of a trial of every filter with every number of particles, on one video.

    `size` and `run` give the seed; `targets`: number of balls; `tried`: particles of a target in a view, by filter.
    """
    methods: dict[str, Values] = {
        f"{name}-{k}": {"method": name.lower(), "set": {"particles": k * (targets if name == MCMC else 1)}}
        for name in tried
        for k in tried[name]
    }
    return views_spec(seed_of(size, run), methods, {"frames": size.steps, "balls": targets, "views": VIEWS})


def enough(totals: Floats, rates: Floats) -> float:
    """The fewest particles that suffice; between two numbers tried the rate is linear in their logarithm.

    Args:
        totals: (K,) numbers of particles, ascending.
        rates: (K,) mean failures [%].

    Returns:
        The number from which on the rate stays within `WORSE` of that of the last one; NaN if all do, so that fewer may
        suffice, and if the last rate is above `FOLLOWED`.
    """
    limit = float(rates[-1]) + WORSE
    if rates[-1] > FOLLOWED:
        return math.nan
    above = np.flatnonzero(rates > limit)
    if len(above) == 0:
        return math.nan
    k = int(above[-1])
    share = (rates[k] - limit) / (rates[k] - rates[k + 1])
    return float(totals[k] * (totals[k + 1] / totals[k]) ** share)


def growth(curves: Sequence[FailureCurve], runs: Sequence[int] | slice = slice(None)) -> float:
    """Exponent with which the number of sufficient particles grows with that of targets, by means over some runs.

    Args:
        curves: failures at each number of targets.
        runs: indices of the runs, all by default; with repetitions in a bootstrap.

    Returns:
        The slope between logarithms; NaN with fewer than two curves, or if a number of particles is not determined.
    """
    need = np.array([enough(c.totals, c.rates[:, runs].mean(axis=1)) for c in curves])
    if len(need) < 2 or not np.all(np.isfinite(need)):
        return math.nan
    return float(np.polyfit(np.log([c.targets for c in curves]), np.log(need), 1)[0])


def curves_of(table: Table, name: str) -> list[FailureCurve]:
    """Curves of failures over particles of the filter `name`, by rising number of targets, from the table."""
    out = []
    for n in (4, 5, 6, 8):
        rows = v.series(table, series_of(name, n))
        if rows:
            out.append(FailureCurve(n, np.array([r.x for r in rows]), np.array([r.values for r in rows])))
    return out


def judge_failures(table: Table) -> list[StatementVerdict]:
    """Verdicts on how sufficient particles grow with the targets, on printed numbers, and on stability by particles."""
    out = []
    own = {name: [c for c in curves_of(table, name) if c.targets <= 6] for name in (BMCT, MCMC)}
    for name, good, statement in (
        (BMCT, v.at_most(LINEAR), "What BMCT needs grows linearly with the targets"),
        (MCMC, v.above(LINEAR), "What the joint filter (MCMC) needs grows faster than linearly with the targets"),
    ):
        curves = own[name]
        if not curves:
            continue
        runs = curves[0].rates.shape[1]
        power = bootstrapped(runs, lambda d, c=curves: growth(c, d), RESAMPLES)  # type: ignore[misc]
        rule = f"exponent {'at most' if name == BMCT else 'above'} {LINEAR:g} (bootstrap over videos)"
        paper = float(np.polyfit(np.log(list(PRINTED[name])), np.log(list(PRINTED[name].values())), 1)[0])
        key = f"table2-rates-{name.lower()}"
        out.append(
            v.judge(f"{key}-growth", f"{statement}: exponent of their number.", power, good, rule=rule, paper=paper)
        )
        for c in curves:
            need = bootstrapped(runs, lambda d, c=c: enough(c.totals, c.rates[:, d].mean(axis=1)), RESAMPLES)  # type: ignore[misc]
            said_n = f"Total particles of {name} that suffice for {c.targets} targets."
            out.append(v.stated(f"{key}-{c.targets}", said_n, PRINTED[name][c.targets], need))
        out += _more_stable(name, table)
    return out


def _more_stable(name: str, table: Table) -> list[StatementVerdict]:
    """Verdict on whether the filter `name` fails less with the most particles than with the fewest.

    A list of one; empty without rows of the filter, or without failures to reduce.
    """
    ends = [(rows[-1], rows[0]) for n in (4, 5, 6, 8) if (rows := v.series(table, series_of(name, n)))]
    statement = f"More particles are more stable ({name}): failures with the fewest less those with the most, by [%]."
    verdict = everywhere(f"table2-rates-{name.lower()}-stable", statement, ends)
    return [] if verdict is None else [verdict]


FAILURES = views_experiment(
    item="table2-rates",
    title="Particles that suffice, by failure rates",
    x_label="particles of all trackers in both views",
    y_label="false positions and false labels [%]",
    quick=(2, 12),
    compute=failure_rates,
    judge=judge_failures,
    note=f"Suffices: within {WORSE:g} % of the failures with the most particles tried, in the mean over the videos.",
)
"""Table 2 by the criterion of Sec. 4.4.3."""
