"""[Ercan] Figs. 6 to 9: tracking in the square room with and without priors of the moving occluders."""

from __future__ import annotations

import functools
import math
from itertools import pairwise

from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    Measure,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    difference,
    estimate,
    mean_of,
    sample,
)
from occlog.pipeline.sweep.trial import Values

from .trial import (
    KNOWN,
    NONE,
    PRIOR,
    SQUARE_ORDER,
    WORST,
    TrialPoint,
    judge_cameras,
    judge_worst_case,
    kalman,
    names,
    priors_error,
    run_points,
    square_room,
    trial,
    worst_case,
)

M40 = {"occluders": 40}
TARGET = 3.0
"""RMSE of Fig. 8."""
NEEDED = "RMSE_occ for an RMSE of 3"


def _cameras(n: int) -> list[str]:
    return names(SQUARE_ORDER[:n])


def fig6(size: Size, execute: Execute, counts: tuple[int, ...] | None = None) -> Table:
    """Table of the RMSE against the number of cameras, for known positions, priors and neither.

    `counts` are the numbers of cameras; None: those of the paper, or of the quick form.
    """
    scene = square_room(pillar=True)
    counts = counts or ((1, 2, 4, 6, 8) if size.quick else tuple(range(1, 9)))
    kinds: dict[str, Values] = {NONE: {"kind": "none"}, PRIOR: kalman(8.0), KNOWN: kalman(0.0)}
    points = [
        TrialPoint(name, n, trial(scene, size, M40, priors, cameras=_cameras(n)))
        for n in counts
        for name, priors in kinds.items()
    ]
    return [*run_points(points, size, execute), worst_case(scene, M40, size)]


def judge6(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 6: known positions have a lower error than priors, these than none; cameras lower it."""
    middle = (3, 4, 5, 6)
    out = [
        v.pairs(
            "fig6-order-known",
            "With 3 to 6 cameras known positions give a lower error than priors.",
            v.matched(table, KNOWN, PRIOR, middle),
        ),
        v.pairs(
            "fig6-order-none",
            "With 3 to 6 cameras priors give a lower error than none.",
            v.matched(table, PRIOR, NONE, middle),
        ),
    ]
    out += [*judge_cameras("fig6", table), *judge_worst_case(table, "fig6", 24.4)]
    out += priors_error("fig6", v.series(table, PRIOR), 6.67)
    return [*out, _spread("fig6", [r for _, r in v.matched(table, KNOWN, NONE)], v.series(table, KNOWN))]


def fig7(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the error of the occluders' priors, with four cameras and no static occluder."""
    scene = square_room(pillar=False)
    sigmas = (0.0, 4.0, 16.0) if size.quick else (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
    points = [TrialPoint(PRIOR, s, trial(scene, size, M40, kalman(s), cameras=_cameras(4))) for s in sigmas]
    points.append(TrialPoint(NONE, math.nan, trial(scene, size, M40, {"kind": "none"}, cameras=_cameras(4))))
    rows = run_points(points, size, execute)
    worst = worst_case(scene, M40, size)
    moved = [PaperRow(r.series, r.extra["rmse_occ"], r.values, r.extra) for r in rows[:-1]]
    return [
        *moved,
        PaperRow(NONE, worst.mean, rows[-1].values, rows[-1].extra),
        PaperRow(NONE, math.nan, rows[-1].values),
        worst,
    ]


def crossing(rows: list[PaperRow]) -> PaperRow | None:
    """Interpolate, run by run, where the RMSE equals the error of the priors; None if it does between no two rows.

    `rows` have the error of the priors as x, ascending, and RMSE as values. Returns a row with the mean crossing as x.
    """
    for a, b in pairwise(rows):
        if a.mean >= a.x and b.mean < b.x:
            share = (a.mean - a.x) / ((a.mean - a.x) + (b.x - b.mean))
            values = tuple(p + share * (q - p) for p, q in zip(a.values, b.values, strict=True))
            return PaperRow("crossing", a.x + share * (b.x - a.x), values)
    return None


def judge7(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 7: how the tracking error depends on that of the priors of occluders."""
    rows, none = v.series(table, PRIOR), v.find(table, NONE)
    known = rows[0] if rows else None
    cross = crossing(rows)
    out = [
        v.factor(
            "fig7-none-to-known",
            "No priors give a larger error than known positions, by this factor.",
            2.34,
            known,
            none,
        ),
        v.factor(
            "fig7-none-to-crossing", "The factor from priors as good as the tracker itself to none.", 1.94, cross, none
        ),
        v.pairs("fig7-rises", "Better priors give a lower error.", v.neighbours(rows[::-1])),
    ]
    if cross is not None:
        statement = "The error of tracker and priors are equal at this one."
        out.append(v.stated("fig7-crossing", statement, 3.72, mean_of(cross)))
        if none is not None:
            out.append(_sd_factor("fig7-deviation", cross, none))
    if known is not None and none is not None:
        out.append(_spread("fig7", [none], [known]))
    return [*out, *judge_worst_case(table, "fig7", 21.4)]


def fig8(size: Size, execute: Execute) -> Table:
    """Table of the error of the priors that gives an RMSE of 3, for each number of cameras, by interpolation."""
    scene = square_room(pillar=False)
    sigmas = (0.0, 8.0) if size.quick else (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 32.0)
    counts = (2, 4, 6, 8) if size.quick else (2, 3, 4, 5, 6, 7, 8)
    kinds = [kalman(s) for s in sigmas] + [{"kind": "none"}]
    points = [
        TrialPoint(f"{n} cameras", i, trial(scene, size, M40, priors, cameras=_cameras(n)))
        for n in counts
        for i, priors in enumerate(kinds)
    ]
    rows, worst = run_points(points, size, execute), worst_case(scene, M40, size)
    out: Table = []
    for k, n in enumerate(counts):
        own = rows[k * len(kinds) : (k + 1) * len(kinds)]
        grid = [r.extra["rmse_occ"] for r in own[:-1]] + [worst.mean]
        values = [needed(grid, [r.values[run] for r in own]) for run in range(size.runs)]
        kept = tuple(x for x in values if not math.isnan(x))
        extra = {"reached": float(len(kept)), "rmse_none": own[-1].mean}
        out.append(PaperRow(NEEDED, n, kept, extra, each={"rmse_none": own[-1].values}))
    return [*out, worst]


def needed(grid: list[float], rmse: list[float], target: float = TARGET) -> float:
    """Largest error of the priors at which the RMSE is still at most `target`, by linear interpolation.

    NaN if the RMSE is larger even with known positions; the last of the grid (no priors) if it is
    smaller even there.

    Args:
        grid: errors of the priors, ascending.
        rmse: RMSE at each of them.
        target: required RMSE.
    """
    if rmse[-1] <= target:
        return grid[-1]
    for i in range(len(grid) - 2, -1, -1):
        if rmse[i] <= target:
            return grid[i] + (grid[i + 1] - grid[i]) * (target - rmse[i]) / (rmse[i + 1] - rmse[i])
    return math.nan


def judge8(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 8: with more cameras the priors may be less accurate for an equal error, or missing."""
    rows = [r for r in v.series(table, NEEDED) if r.runs]
    statement = "The more cameras, the less accurate the priors may be for an RMSE of 3."
    last, worst = (rows[-1] if rows else None), v.find(table, WORST)
    # From the number of cameras on that need no priors, more cameras cannot lower the need.
    points = [(a, b) for a, b in pairwise(rows) if worst is None or min(a.values) < worst.mean]
    out = [v.pairs("fig8-trade-off", statement, points)]
    if last is not None:
        rule = f"RMSE without priors and with all cameras: at most {TARGET:g}; in part up to 35 % above"
        statement = "With enough cameras no priors are needed."
        none = sample(last.each["rmse_none"])
        good, fair = v.at_most(TARGET), v.at_most(1.35 * TARGET)
        out.append(v.judge("fig8-no-priors", statement, none, good, fair, rule=rule, paper=TARGET))
    return out


def fig9(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of occluders, with four cameras and no static occluder."""
    scene = square_room(pillar=False)
    counts = (1, 40, 80) if size.quick else (1, 5, 10, 20, 30, 40, 60, 80, 100, 120)
    points = [
        TrialPoint(name, m, trial(scene, size, {"occluders": m}, {"kind": kind}, cameras=_cameras(4)))
        for m in counts
        for name, kind in ((NONE, "none"), (KNOWN, "known"))
    ]
    return run_points(points, size, execute)


def judge9(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 9: known positions of occluders help most at a medium number of them."""
    both = v.matched(table, KNOWN, NONE)
    if len(both) < 3:
        return []
    gaps = [difference(low, high) for low, high in both]
    most = max(range(len(gaps)), key=lambda i: gaps[i][0])
    first, last = _gap(both[0]), _gap(both[-1])
    peak = _gap(both[most])
    few_known, few_none = both[0]
    return [
        v.close("fig9-few", "With very few occluders priors do not help.", [(few_known, few_none)]),
        v.pairs("fig9-more", "With more occluders known positions are worth more.", [(first, peak)]),
        v.pairs("fig9-many", "With very many occluders they are worth less again.", [(last, peak)]),
        _spread("fig9", [b for _, b in both], [a for a, _ in both]),
    ]


def _gap(pair: v.Pair) -> PaperRow:
    low, high = pair
    return PaperRow("gap", low.x, tuple(b - a for a, b in zip(low.values, high.values, strict=True)))


def _spread(item: str, wide: list[PaperRow], narrow: list[PaperRow]) -> StatementVerdict:
    """Verdict on whether the error varies more from run to run with less knowledge of the occluders.

    Args:
        item: name of the figure, which begins the id of the verdict.
        wide: rows without priors.
        narrow: rows with known positions.
    """
    statement = "The error differs more from run to run without priors than with known positions, by this factor."
    return v.judge(f"{item}-variation", statement, _deviations(wide, narrow), v.above(1.0), rule="above 1")


def _deviations(wide: list[PaperRow], narrow: list[PaperRow]) -> Measure:
    """Ratio of the standard deviations over the runs of `wide` to those of `narrow`, with its error.

    Each is the root mean square over its rows. A deviation of n runs has a relative error of about 1 / sqrt(2 (n - 1)).
    The rows have the same worlds, so that more rows do not lower it. NaN for fewer than two runs.
    """
    upper, lower = (math.sqrt(math.fsum(r.sd**2 for r in rows) / len(rows)) for rows in (wide, narrow))
    runs = min(r.runs for r in [*wide, *narrow])
    if runs < 2 or not lower > 0.0:
        return estimate(math.nan, math.nan, runs)
    ratio = upper / lower
    return estimate(ratio, ratio / math.sqrt(runs - 1), runs)


def _sd_factor(key: str, narrow: PaperRow, wide: PaperRow) -> StatementVerdict:
    statement = "From none to priors as good as the tracker, the deviation over the runs falls by this factor."
    rule = "within 10 % of it; in part if above 1"
    return v.judge(
        key, statement, _deviations([wide], [narrow]), v.around(3.4, v.NEAR), v.above(1.0), rule=rule, paper=3.4
    )


NOTE = "Priors by a Kalman filter on virtual measurements; M = 40 moving occluders, 1000 particles."
_in_the_square = functools.partial(Experiment, runs=5, steps=4000, quick=(2, 150), note=NOTE)
EXPERIMENTS = (
    _in_the_square(
        item="fig6",
        title="Error and number of cameras",
        x_label="cameras",
        y_label="RMSE",
        compute=fig6,
        judge=judge6,
    ),
    _in_the_square(
        item="fig7",
        title="Error and accuracy of the priors",
        x_label="RMSE_occ",
        y_label="RMSE",
        compute=fig7,
        judge=judge7,
    ),
    _in_the_square(
        item="fig8",
        title="Priors needed for an RMSE of 3",
        x_label="cameras",
        y_label="RMSE_occ",
        compute=fig8,
        judge=judge8,
    ),
    Experiment(
        item="fig9",
        title="Error and number of moving occluders",
        x_label="moving occluders",
        y_label="RMSE",
        runs=5,
        steps=4000,
        quick=(2, 100),
        compute=fig9,
        judge=judge9,
    ),
)
