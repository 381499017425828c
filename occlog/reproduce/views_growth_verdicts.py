"""Verdicts on the growth with the number of targets, [Qu] Table 2."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from . import verdicts as v
from .model import Row, Table, Verdict, deviation

BMCT, MCMC, SIR = "BMCT", "MCMC", "joint SIR"
TOTAL, TIME = "total particles", "CPU ms a frame"
LINEAR, NEARLY = 1.3, 1.6
"""Largest exponents of the number of targets that count as linear, and as in part; as in `speed`."""
PRINTED = {"MCMC": {4: 500.0, 5: 1100.0, 6: 2800.0}, "BMCT": {4: 400.0, 5: 500.0, 6: 600.0}}
"""Total particles of Table 2."""
FPS = {"MCMC": {4: 8.75, 5: 2.55, 6: 0.4}, "BMCT": {4: 14.4, 5: 11.5, 6: 9.75}}
"""Its speeds, the middles of the ranges."""


def exponents(rows: Sequence[Row]) -> tuple[float, float]:
    """Exponent of the number of targets, by least squares in every run: mean and standard error."""
    if len(rows) < 2:
        return math.nan, math.nan
    x = np.log([row.x for row in rows])
    x = x - x.mean()
    slopes = [float(x @ np.log([row.values[k] for row in rows]) / (x @ x)) for k in range(rows[0].runs)]
    return math.fsum(slopes) / len(slopes), deviation(slopes) / math.sqrt(len(slopes))


def _printed_exponent(values: Mapping[int, float]) -> float:
    return exponents([Row("", n, (value,)) for n, value in values.items()])[0]


def judge2(table: Table) -> list[Verdict]:
    """Statements about Table 2."""
    out = []
    for what, name, printed in (("particles", TOTAL, PRINTED), ("time", TIME, FPS)):
        sign = 1.0 if printed is PRINTED else -1.0
        rows = v.series(table, f"BMCT, {name}")
        paper = sign * _printed_exponent(printed["BMCT"])
        said = f"BMCT's need of {what} grows linearly with the targets: exponent of their number."
        out.append(_linear(f"table2-bmct-{what}", said, paper, rows))
        for f in (MCMC, SIR):
            paper = sign * _printed_exponent(printed["MCMC"]) if f is MCMC else math.nan
            said = f"The need of the joint filter ({f}) of {what} grows faster than linearly: exponent."
            out.append(
                _faster(f"table2-{f.split()[-1].lower()}-{what}", said, paper, v.series(table, f"{f}, {name}"), rows)
            )
    out.append(_exponential(v.series(table, f"{SIR}, {TOTAL}")))
    for n, paper in PRINTED["MCMC"].items():
        row = v.find(table, f"MCMC, {TOTAL}", n)
        if row is not None and row.runs:
            said = f"Total particles of MCMC-PF for {n} targets."
            out.append(v.number(f"table2-mcmc-{n}", said, paper, row.mean, row.error, row.runs))
    quicker = v.matched(table, f"BMCT, {TIME}", f"MCMC, {TIME}", (4, 5, 6))
    said = "BMCT is faster than MCMC-PF: CPU time of a frame lower, by [ms]."
    return [*out, v.pairs("table2-faster", said, quicker)]


def _linear(key: str, said: str, paper: float, rows: Sequence[Row]) -> Verdict:
    power, error = exponents(rows)
    word = v.REPRODUCED if power <= LINEAR else v.IN_PART if power <= NEARLY else v.NOT
    rule = f"exponent at most {LINEAR}; in part up to {NEARLY}"
    return Verdict(key, said, paper, power, error, _runs(rows), word, rule)


def _faster(key: str, said: str, paper: float, rows: Sequence[Row], bmct: Sequence[Row]) -> Verdict:
    power, error = exponents(rows)
    own, own_error = exponents(bmct)
    doubt = 2.0 * (0.0 if math.isnan(error) else error)
    more = power - own > 2.0 * math.hypot(*(0.0 if math.isnan(e) else e for e in (error, own_error)))
    word = v.REPRODUCED if power - doubt > LINEAR else v.IN_PART if more else v.NOT
    rule = f"exponent above {LINEAR} by two standard errors; in part above that of BMCT by as much"
    return Verdict(key, said, paper if math.isfinite(paper) else None, power, error, _runs(rows), word, rule)


def _exponential(rows: Sequence[Row]) -> Verdict:
    """Whether the numbers grow by the same factor with every target, rather than as a power."""
    said = "Joint-state methods grow exponentially with the targets (joint SIR): particles, factor for one target more."
    rule = (
        "a factor fits the growth better than a power, and is above 1 by two standard errors; in part without the first"
    )
    if len(rows) < 3:
        return Verdict("table2-sir-exponential", said, None, None, None, _runs(rows), v.NOT, rule + "; too few points")
    x, factors, left = np.array([row.x for row in rows]), [], np.zeros(2)
    for k in range(rows[0].runs):
        y = np.log([row.values[k] for row in rows])
        for i, places in enumerate((x, np.log(x))):
            fit = np.polyfit(places, y, 1)
            left[i] += float(np.sum((y - np.polyval(fit, places)) ** 2))
            if i == 0:
                factors.append(math.exp(float(fit[0])))
    mean, error = math.fsum(factors) / len(factors), deviation(factors) / math.sqrt(len(factors))
    sure = mean - 2.0 * (0.0 if math.isnan(error) else error) > 1.0
    word = v.NOT if not sure else v.REPRODUCED if left[0] < left[1] else v.IN_PART
    return Verdict("table2-sir-exponential", said, None, mean, error, _runs(rows), word, rule)


def _runs(rows: Sequence[Row]) -> int:
    return min((row.runs for row in rows), default=0)
