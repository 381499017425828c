"""[Lee] Fig. 4-3 and the three case studies of Sec. 4.4.2: the decision of Eq. 4.13 on given detections."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.measure.fuse.kernels import EDGE, decision_value, fused_position, prior_present, quality, weighted_value
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, exact, sample
from occlog.pipeline.sweep.trial import Spec

SENSORS = 6
CHANCE = 0.2
"""P_M and P_F of every sensor."""
VARIANCES = (0.01, 0.03, 0.085, 0.195, 0.325, 0.48, 0.55, 0.635, 0.8, 1.135, 1.565, 1.74, 2.5, 3.5, 4.485, 6.0)
PRINTED = {5: (1.135, 4.485), 4: (0.480, 1.565), 3: (0.195, 0.635), 2: (0.085, 0.325), 1: (0.030, 0.235)}
"""Detecting sensors to the largest variances at which P(G_1) is above 0.99 and above 0.50, as printed."""
CROSSINGS = ((2, 0.55), (3, 1.74))
"""Above this variance one detecting sensor declares more often than this many, as printed."""


def declaration_trial(spec: Spec) -> dict[str, float]:
    """Share of random trials in which an object is declared present, by each rule of decision.

    Args:
        spec: `detecting` (number of sensors), `variance` (of their detections), `trials`, `seed` and `run`.
    """
    n, trials = int(spec["detecting"]), int(spec["trials"])
    rng = np.random.default_rng(np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]), n)))
    positions = np.full((trials, SENSORS, 2), np.nan)
    positions[:, :n] = math.sqrt(float(spec["variance"])) * rng.standard_normal((trials, n, 2))
    origin = np.zeros((trials, 2))
    weight = quality(positions, origin, 1.0)
    detected = np.isfinite(weight)
    prior = prior_present(fused_position(positions, origin, 1.0), origin, 1.0)
    return {
        "printed": float(
            np.mean(decision_value(detected, qualities=weight, prior=prior, p_miss=CHANCE, p_false=CHANCE) > 0.0)
        ),
        "half": float(
            np.mean(decision_value(detected, qualities=weight, prior=0.5, p_miss=CHANCE, p_false=CHANCE) > 0.0)
        ),
        "cases": float(np.mean(decision_value_of_case_studies(detected, weight, prior) > 0.0)),
    }


def decision_value_of_case_studies(detected: Bools, qualities: Floats, prior: Floats | float) -> Floats:
    """(N,) decision values as the case studies of [Lee] Sec. 4.4.2 print them, with `CHANCE` for P_M and P_F.

    They take log10 throughout, and log W where Eq. 4.13 has log W/(1 - W).  It is no likelihood ratio:
    a detection can only lose by its quality.

    Args:
        detected: (N, J) mask of detections of J cameras.
        qualities: (N, J) W; not used (may be NaN) where nothing was detected.
        prior: P_1, one number or (N,).
    """
    weight = np.log(np.clip(np.where(detected, qualities, 1.0), EDGE, 1.0))
    return weighted_value(detected, weight=weight, prior=prior, p_miss=CHANCE, p_false=CHANCE) / math.log(10.0)


RULES = {"printed": "(4.13)", "half": "(4.13), P_1 = 1/2", "cases": "the sum of the case studies"}


def curves(size: Size, execute: Execute) -> Table:
    """Table of the share of trials that declare an object, against the variance of local positions.

    A series for each number of detecting sensors and each decision rule; `size.steps` is the number of trials.
    """
    variances = VARIANCES[::3] if size.quick else VARIANCES
    points = [(n, x) for n in PRINTED for x in variances]
    common = {"kind": "lee-declaration", "trials": size.steps, "seed": size.seed}
    # Of the fifteen curves the plot has the five of the printed rule; the others are in the table.
    return [
        PaperRow(f"N = {n}, {name}", x, v.values_of(own, key), plotted=key == "printed")
        for (n, x), own in v.run_trials(
            points, size, execute, lambda p, run: {**common, "detecting": p[0], "variance": p[1], "run": run}
        )
        for key, name in RULES.items()
    ]


def judge_curves(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Fig. 4-3: variances at which the share of declarations falls below levels or curves cross."""
    out = []
    for n, limits in PRINTED.items():
        for level, limit in zip((0.99, 0.50), limits, strict=True):
            for key, name in RULES.items():
                rows = v.series(table, f"N = {n}, {name}")
                statement = f"{n} of 6 detect: P(G_1) above {level:g} up to a variance of this; by {name}."
                out.append(_threshold(f"fig4.3-n{n}-{level:g}-{key}", statement, limit, rows, level))
    for n, limit in CROSSINGS:
        for key, name in RULES.items():
            one, more = (v.series(table, f"N = {k}, {name}") for k in (1, n))
            statement = f"Above a variance of {limit:g} one detecting sensor declares more often than {n}; by {name}."
            pairs = [(b, a) for a, b in zip(one, more, strict=True) if a.x > limit]
            out.append(v.pairs(f"fig4.3-crossing-{n}-{key}", statement, pairs))
    return out


def _threshold(key: str, statement: str, limit: float, rows: list[PaperRow], level: float) -> StatementVerdict:
    """Verdict on the variance at which the share of trials with a declared object falls below a level, run by run.

    By linear interpolation; without a crossing the end of the curve counts.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        limit: printed variance.
        rows: shares by variance (x), ascending.
        level: share, 0 to 1.
    """
    n = min((r.runs for r in rows), default=0)
    crossings = [_crossing([(r.x, r.values[k]) for r in rows], level) for k in range(n)]
    found = [x for x in crossings if x is not None]
    if not found and n:  # the curve is above the level, or below it, everywhere
        ends = [rows[0], rows[-1]]
        outside = rows[-1].x if all(r.mean > level for r in ends) else rows[0].x
        return v.stated(key, statement + " It has no such limit: the end of the curve.", limit, exact(outside, n))
    return v.stated(key, statement, limit, sample(found))


def _crossing(curve: list[tuple[float, float]], level: float) -> float | None:
    """Abscissa at which a falling curve of points (x, y) crosses `level`, by linear interpolation; None if nowhere."""
    for (x, y), (x_next, y_next) in itertools.pairwise(curve):
        if y > level >= y_next:
            return x + (x_next - x) * (y - level) / (y - y_next)
    return None


class FusionCase(NamedTuple):
    """A case study of [Lee] Sec. 4.4.2: detections of three sensors, prediction, and printed results.

    Attributes:
        detections: (3, 2) detected positions; NaN where missed.
        predicted: predicted position x, y.
        qualities: quality W of the detections, by sensor from 0.
        fused: fused position x, y.
        prior: prior probability P_1 that the object is present.
        value: value of the decision by Eq. 4.13.
        declared: whether the object is declared.
        value_plain: value of the decision by Eq. 4.3; None: not printed.
    """

    detections: Floats
    predicted: tuple[float, float]
    qualities: dict[int, float]
    fused: tuple[float, float]
    prior: float
    value: float
    declared: bool
    value_plain: float | None = None


NOTHING = (math.nan, math.nan)
CASES = {
    "case1": FusionCase(
        detections=np.array([NOTHING, (5.2, 5.2), (4.9, 5.0)]),
        predicted=(5.0, 5.0),
        qualities={1: 0.9608, 2: 0.9950},
        fused=(5.05, 5.10),
        prior=0.9938,
        value=2.78,
        declared=True,
    ),
    "case2": FusionCase(
        detections=np.array([(13.0, 7.0), (15.2, 7.4), (15.8, 6.9)]),
        predicted=(13.1, 7.0),
        qualities={0: 0.9950, 1: 0.1018, 2: 0.026},
        fused=(13.55, 7.18),
        prior=0.8892,
        value=0.13,
        declared=True,
    ),
    "case3": FusionCase(
        detections=np.array([(7.3, 5.1), (7.1, 6.3), NOTHING]),
        predicted=(4.9, 3.4),
        qualities={0: 0.0132, 1: 0.0013},
        fused=(7.28, 5.21),
        prior=0.0114,
        value=-6.101,
        declared=False,
        value_plain=0.4,
    ),
}
ITEMS = ("quality", "x", "y", "prior", "value (4.13)", "value, sum of log10 W", "value (4.3)")


def case(name: str, size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the quantities of the case study `name`; x is the number of the sensor for `quality`, else 0."""
    c = CASES[name]
    positions, predicted = c.detections[None], np.array([c.predicted])
    weight = quality(positions, predicted, 1.0)
    xy = fused_position(positions, predicted, 1.0)
    prior = prior_present(xy, predicted, 1.0)
    detected = np.isfinite(weight)
    # The decision is computed from the printed W and P_1, since errors in these are their own statements.
    printed = np.array([[c.qualities.get(j, math.nan) for j in range(len(c.detections))]])
    rows = [PaperRow("quality", j + 1.0, (float(weight[0, j]),)) for j in c.qualities]
    rows += [
        PaperRow("x", 0.0, (float(xy[0, 0]),)),
        PaperRow("y", 0.0, (float(xy[0, 1]),)),
        PaperRow("prior", 0.0, (float(prior[0]),)),
    ]
    rows.append(
        PaperRow(
            ITEMS[4],
            0.0,
            (
                float(
                    decision_value(
                        detected, qualities=printed, prior=c.prior, p_miss=CHANCE, p_false=CHANCE, base=10.0
                    )[0]
                ),
            ),
        )
    )
    rows.append(PaperRow(ITEMS[5], 0.0, (float(decision_value_of_case_studies(detected, printed, c.prior)[0]),)))
    # Eq. 4.3 is Eq. 4.13 with every W at 1/2.
    plain = decision_value(
        detected, qualities=np.full(detected.shape, 0.5), prior=0.5, p_miss=CHANCE, p_false=CHANCE, base=10.0
    )
    rows.append(PaperRow(ITEMS[6], 0.0, (float(plain[0]),)))
    return rows


def judge_case(name: str, table: Table) -> list[StatementVerdict]:
    """Verdicts on each printed number of the case study `name` ([Lee] Figs. 4-4 to 4-6)."""
    c = CASES[name]
    out = [
        v.printed(
            f"{name}-w{j + 1}", f"Quality W of the detection of sensor {j + 1}.", w, v.find(table, "quality", j + 1.0)
        )
        for j, w in c.qualities.items()
    ]
    for axis, number in zip("xy", c.fused, strict=True):
        out.append(v.printed(f"{name}-{axis}", f"Fused position (4.22), {axis}.", number, v.find(table, axis)))
    out.append(v.printed(f"{name}-prior", "Prior P_1 (4.23) of the fused position.", c.prior, v.find(table, "prior")))
    for row, how in ((ITEMS[4], "by (4.13), log10"), (ITEMS[5], "log10, with log W for log W/(1 - W)")):
        key = f"{name}-value-{'printed' if row == ITEMS[4] else 'cases'}"
        out.append(
            v.printed(key, f"Value of the decision, {how}, from the printed W and P_1.", c.value, v.find(table, row))
        )
    found = v.row_of(table, ITEMS[4])
    statement = f"The object is declared {'present' if c.declared else 'absent'} by (4.13)."
    right = v.above(0.0) if c.declared else v.at_most(0.0)
    out.append(v.judge(f"{name}-declared", statement, exact(found.mean), right, rule="sign"))
    if c.value_plain is not None:
        statement = "Value of the decision by (4.3) without prior, by which the false object would be declared."
        out.append(v.printed(f"{name}-value-plain", statement, c.value_plain, v.find(table, ITEMS[6])))
    return out


def _case(name: str, title: str) -> Experiment:
    compute: Callable[[Size, Execute], Table] = partial(case, name)
    judge: Callable[[Table], list[StatementVerdict]] = partial(judge_case, name)
    return Experiment(
        item=name,
        title=title,
        x_label="sensor",
        y_label="value",
        runs=1,
        steps=1,
        quick=(1, 1),
        compute=compute,
        judge=judge,
    )


DECISION_EXPERIMENTS = (
    Experiment(
        item="fig4.3",
        title="Declarations against the spread of the detections",
        x_label="variance",
        y_label="share declared",
        runs=10,
        steps=10_000,
        quick=(2, 2000),
        compute=curves,
        judge=judge_curves,
        trial=declaration_trial,
        note="Six sensors with P_M = P_F = 0.2; the thesis does not state which formula its curves are from.",
    ),
    _case("case1", "Case study 1: one sensor misses the object"),
    _case("case2", "Case study 2: two sensors with a shadow"),
    _case("case3", "Case study 3: two sensors with a false object"),
)
