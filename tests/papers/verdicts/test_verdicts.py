"""Rules of the verdicts on tables made by hand: every verdict can be reached."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers import verdicts as v
from occlog.papers.ercan.square import NEEDED, crossing, judge6, judge7, judge8, judge9, needed
from occlog.papers.ercan.trial import KNOWN, NONE, PRIOR, WORST
from occlog.papers.verdicts import (
    PaperRow,
    StatementVerdict,
    errors_allowed,
    estimate,
    exact,
    power_of,
    sample,
    share_of,
)

NOISE = (-0.1, 0.0, 0.1)


def row(series: str, x: float, mean: float, noise: tuple[float, ...] = NOISE, **extra: float) -> PaperRow:
    each = {name: (value,) * len(noise) for name, value in extra.items()}
    return PaperRow(series, x, tuple(mean + e for e in noise), extra, each=each)


def by_id(verdicts: list[StatementVerdict]) -> dict[str, StatementVerdict]:
    out = {x.id: x for x in verdicts}
    assert len(out) == len(verdicts), "ids are unique"
    return out


def test_row_statistics() -> None:
    r = PaperRow("a", 1.0, (1.0, 2.0, 4.0))
    assert r.mean == pytest.approx(7 / 3)
    assert r.sd == pytest.approx(math.sqrt(7 / 3))
    assert r.error == pytest.approx(r.sd / math.sqrt(3))
    assert math.isnan(PaperRow("a", 1.0, (1.0,)).error)
    assert math.isnan(PaperRow("a", 1.0, ()).mean)


@pytest.mark.parametrize(
    ("highs", "wanted"),
    [
        ((2.0, 2.0), v.REPRODUCED),
        ((2.0, 0.5), v.IN_PART),
        ((0.5, 0.8), v.NOT),
        ((2.0, 1.01), v.UNDECIDED),
        ((0.5, 0.5, 1.01), v.NOT),
    ],
)
def test_pairs(highs: tuple[float, ...], wanted: str) -> None:
    points = [(row("low", n, 1.0), row("high", n, high, (-0.1, 0.01, 0.1))) for n, high in enumerate(highs)]
    found = v.pairs("p", "low below high", points)
    assert found.verdict == wanted
    assert found.measured == pytest.approx(sum(b.mean - a.mean for a, b in points) / len(points))
    assert found.runs == 3


def test_nothing_is_decided_without_points_or_runs() -> None:
    assert v.pairs("p", "nothing", []).verdict == v.UNDECIDED
    assert v.pairs("p", "one run", [(PaperRow("a", 1, (1.0,)), PaperRow("b", 1, (2.0,)))]).verdict == v.UNDECIDED
    assert v.number("n", "one run", 1.0, 1.0, math.nan, 1).verdict == v.UNDECIDED
    assert v.factor("f", "no row", 2.0, None, row("high", 1, 2.0)).verdict == v.UNDECIDED


def test_pairs_of_equal_runs_are_compared_run_by_run() -> None:
    """A difference that is nearly the same in every run counts, however much the runs differ."""
    low = PaperRow("low", 1.0, (1.0, 10.0, 100.0))
    high = PaperRow("high", 1.0, (1.5, 10.6, 100.5))
    assert v.pairs("p", "", [(low, high)]).verdict == v.REPRODUCED
    assert v.pairs("p", "", [(low, PaperRow("high", 1.0, (1.5, 10.6)))]).verdict == v.UNDECIDED


@pytest.mark.parametrize(("high", "wanted"), [(2.3, v.REPRODUCED), (1.8, v.IN_PART), (1.2, v.NOT)])
def test_factor(high: float, wanted: str) -> None:
    found = v.factor(
        "f", "factor", 2.34, row("low", 0, 1.0, (-0.01, 0.0, 0.01)), row("high", 1, high, (-0.01, 0.0, 0.01))
    )
    assert found.verdict == wanted
    assert found.measured == pytest.approx(high)


def test_fig6_as_the_paper_has_it_and_upside_down() -> None:
    table = [row(WORST, math.nan, 24.4, 20 * NOISE)]
    for n in range(1, 9):
        for k, (name, wide) in enumerate(((KNOWN, 0.1), (PRIOR, 1.0), (NONE, 3.0))):
            noise = tuple(wide * e for e in 20 * NOISE)
            table.append(row(name, n, (4.0 + 4.0 * k) / n + k, noise, rmse_occ=6.67 if name == PRIOR else math.nan))
    found = by_id(judge6(table))
    assert {x.verdict for x in found.values()} == {v.REPRODUCED}
    swapped = {KNOWN: NONE, NONE: KNOWN}
    wrong = [PaperRow(swapped.get(r.series, r.series), r.x, r.values, r.extra) for r in table]
    found = by_id(judge6(wrong))
    assert found["fig6-order-known"].verdict == v.NOT
    assert found["fig6-variation"].verdict == v.NOT


def test_crossing_of_fig7() -> None:
    rows = [row(PRIOR, 0.0, 2.0), row(PRIOR, 2.0, 3.0), row(PRIOR, 6.0, 4.0)]
    cross = crossing(rows)
    assert cross is not None
    assert cross.x == pytest.approx(10 / 3)
    assert cross.mean == pytest.approx(10 / 3)
    assert crossing([row(PRIOR, 0.0, 2.0), row(PRIOR, 1.0, 3.0)]) is None
    rows = [PaperRow(r.series, r.x, 20 * r.values) for r in rows]
    found = by_id(judge7([*rows, row(NONE, 21.4, 4.68, 20 * NOISE), row(WORST, math.nan, 21.4, 20 * NOISE)]))
    assert found["fig7-none-to-known"].verdict == v.REPRODUCED
    assert found["fig7-rises"].verdict == v.REPRODUCED
    assert found["fig7-crossing"].verdict == v.IN_PART


def test_priors_needed_for_fig8() -> None:
    grid = [0.0, 4.0, 8.0, 20.0]
    assert needed(grid, [2.0, 2.5, 3.5, 5.0]) == pytest.approx(6.0)
    assert needed(grid, [1.0, 1.0, 1.0, 2.0]) == 20.0
    assert math.isnan(needed(grid, [4.0, 5.0, 6.0, 7.0]))
    worst = row(WORST, math.nan, 20.0)
    rising = [row(NEEDED, n, x, rmse_none=none) for n, x, none in ((4, 2.0, 5.0), (5, 6.0, 4.0), (6, 12.0, 2.9))]
    found = by_id(judge8([*rising, worst]))
    assert found["fig8-trade-off"].verdict == v.REPRODUCED
    assert found["fig8-no-priors"].verdict == v.REPRODUCED
    falling = []
    for r in rising:
        none = 3.5 if r.x == 4 else 9.0
        falling.append(PaperRow(r.series, -r.x, r.values, {"rmse_none": none}, each={"rmse_none": (none, none)}))
    found = by_id(judge8([*falling, worst]))
    assert found["fig8-trade-off"].verdict == v.NOT
    assert found["fig8-no-priors"].verdict == v.IN_PART


@pytest.mark.parametrize(("last", "wanted"), [(1.0, v.REPRODUCED), (4.0, v.NOT)])
def test_closing_gap_of_fig9(last: float, wanted: str) -> None:
    table = []
    for m, gap in ((1, 0.01), (40, 2.0), (80, last)):
        table += [row(KNOWN, m, 2.0, 20 * NOISE), row(NONE, m, 2.0 + gap, 20 * (-0.15, 0.0, 0.15))]
    found = by_id(judge9(table))
    assert found["fig9-many"].verdict == wanted
    assert found["fig9-few"].verdict == found["fig9-more"].verdict == v.REPRODUCED


SURE = errors_allowed(1000)
"""Standard errors of half a range from a thousand runs: 2.002."""


@pytest.mark.parametrize(
    ("measured", "error", "wanted"),
    [
        (11.0, 0.0, v.REPRODUCED),
        (11.001, 0.0, v.IN_PART),
        (13.5, 0.0, v.IN_PART),
        (13.501, 0.0, v.NOT),
        (10.5, 0.499 / SURE, v.REPRODUCED),
        (10.5, 0.5 / SURE + 1e-6, v.UNDECIDED),  # reaches out of 10 %, and the half of its range is above 5 %
        (10.501, 0.5 / SURE, v.IN_PART),  # across the end of 10 %, with a small error bar
        (12.0, 0.999 / SURE, v.IN_PART),
        (12.0, 1.001 / SURE, v.UNDECIDED),
        (14.0, 0.499 / SURE, v.NOT),
        (14.0, 0.501 / SURE, v.UNDECIDED),
        (10.0, 50.0, v.UNDECIDED),
    ],
)
def test_number_at_its_limits(measured: float, error: float, wanted: str) -> None:
    """Ten per cent and 35 per cent, with two standard errors; and the largest error bar across an end."""
    assert v.number("n", "ten", 10.0, measured, error, 1000).verdict == wanted


@pytest.mark.parametrize(("high", "wanted"), [(2.0, v.IN_PART), (1.999, v.NOT)])
def test_half_of_the_excess_over_one_is_a_factor_in_part(high: float, wanted: str) -> None:
    rows = (PaperRow("low", 0.0, (1.0, 1.0)), PaperRow("high", 0.0, (high, high)))
    assert v.factor("f", "factor", 3.0, *rows).verdict == wanted


def test_half_of_the_points_is_in_part() -> None:
    assert v.share([True, False]) == v.IN_PART
    assert v.share([True, False, False]) == v.NOT
    assert v.share([True]) == v.REPRODUCED


def test_open_points_leave_a_verdict_open_only_if_they_could_change_it() -> None:
    held, failed = v.StatementPoint(exact(1.0), v.above(0.0)), v.StatementPoint(exact(-1.0), v.above(0.0))
    unknown = v.StatementPoint(estimate(1.0, 1.0, 50), v.above(0.0))
    for points, wanted in (
        ([held, unknown], v.UNDECIDED),
        ([held, failed, held, unknown], v.IN_PART),
        ([failed, failed, failed, unknown], v.NOT),
        ([failed, unknown], v.UNDECIDED),
    ):
        found = v.judge_points("p", "", points, rule="above 0")
        assert found.verdict == wanted
        assert "open at 1" in found.rule


@pytest.mark.parametrize(("gap", "wanted"), [(1.0, v.REPRODUCED), (1.001, v.NOT)])
def test_close_means_within_one_standard_deviation(gap: float, wanted: str) -> None:
    low = PaperRow("low", 0.0, (0.0, 1.0, 2.0))
    assert v.close("c", "equal", [(low, PaperRow("high", 0.0, (gap, 1.0 + gap, 2.0 + gap)))]).verdict == wanted


def test_close_wants_a_small_error_bar() -> None:
    """Alternating differences have a mean of 0; two standard errors of it must be within one deviation."""
    values = tuple(float(k % 2) for k in range(20))
    for wide, wanted in ((1.0, v.REPRODUCED), (2.0, v.REPRODUCED), (20.0, v.UNDECIDED)):
        other = tuple(x + wide * (1.0 if k % 4 < 2 else -1.0) for k, x in enumerate(values))
        low, high = PaperRow("low", 0.0, values), PaperRow("high", 0.0, other)
        limit = max(low.sd, high.sd)
        word = v.close("c", "equal", [(low, high)]).verdict
        assert word == (v.REPRODUCED if errors_allowed(20) * v.lower(low, high).measure.error <= limit else v.UNDECIDED)
        assert word == wanted or wide == 20.0


def test_a_difference_of_two_standard_errors_counts_and_one_below_does_not() -> None:
    n = 50
    unit = tuple(1.0 if k % 2 else -1.0 for k in range(n))
    error = PaperRow("", 0.0, unit).error * errors_allowed(n)
    low = PaperRow("low", 0.0, (0.0,) * n)
    for shift, wanted in ((1.001, v.REPRODUCED), (0.999, v.UNDECIDED), (-0.999, v.UNDECIDED), (-1.001, v.NOT)):
        high = PaperRow("high", 0.0, tuple(x + shift * error for x in unit))
        assert v.pairs("p", "below", [(low, high)]).verdict == wanted


@pytest.mark.parametrize(("gap", "wanted"), [(0.0, v.NOT), (0.015, v.NOT), (0.1, v.REPRODUCED), (0.03, v.REPRODUCED)])
def test_a_difference_that_is_known_to_be_small_is_none(gap: float, wanted: str) -> None:
    """The level is 1 and the error bar 0.001: below 2 % of the level there is no difference unless it is above 0."""
    n = 50
    noise = tuple(0.007 if k % 2 else -0.007 for k in range(n))
    low, high = PaperRow("low", 0.0, (1.0,) * n), PaperRow("high", 0.0, tuple(1.0 + gap + x for x in noise))
    found = v.pairs("p", "below", [(low, high)])
    assert found.verdict == (v.REPRODUCED if gap == 0.015 else wanted)


@pytest.mark.parametrize(
    ("held", "runs", "low", "high"), [(12, 12, 0.7295, 1.0), (0, 2, 0.0, 0.8492), (5, 10, 0.183, 0.817)]
)
def test_shares_have_the_range_of_clopper_and_pearson(held: int, runs: int, low: float, high: float) -> None:
    """All of twelve: the lower end is 0.02275 ** (1 / 12); none of two: the upper one 1 - 0.02275 ** (1 / 2)."""
    found = share_of(held, runs)
    assert (found.value, found.runs) == (held / runs, runs)
    assert (found.low, found.high) == (pytest.approx(low, abs=2e-3), pytest.approx(high, abs=2e-3))
    assert found.error > 0.0
    assert math.isnan(share_of(0, 0).value)


def test_exponents_are_those_of_powers() -> None:
    rows = [PaperRow("", n, (3.0 * n**1.5, 2.0 * n**1.7)) for n in (2, 3, 4, 8)]
    assert (power_of(rows).value, power_of(rows).error) == (pytest.approx(1.6), pytest.approx(0.1))
    assert math.isnan(power_of(rows[:1]).value)


@pytest.mark.parametrize("runs", [2, 3, 5, 12, 50])
@pytest.mark.parametrize("error", [0.01, 0.05, 0.2])
def test_wrong_verdicts_are_rare_whatever_the_error_bar(runs: int, error: float) -> None:
    """True statements at the edge are judged `not reproduced`, and false ones `reproduced`, in at most 5 %.

    A number of 1 holds up to 1.1; a difference holds above 0.  Both are put to the edge, where errors are most likely.
    """
    rng = np.random.default_rng(runs)
    wrong = {"number, true": 0, "number, false": 0, "pairs, false": 0, "pairs, true": 0}
    trials = 600
    for _ in range(trials):
        noise = error * math.sqrt(runs) * rng.standard_normal(runs)
        values = tuple((1.1 + noise).tolist())
        wrong["number, true"] += v.stated("n", "", 1.0, sample(values)).verdict == v.NOT
        wrong["number, false"] += (
            v.stated("n", "", 1.0, sample(tuple((1.1001 + noise).tolist()))).verdict == v.REPRODUCED
        )
        low, high = PaperRow("", 0.0, (1.0,) * runs), PaperRow("", 0.0, tuple((1.0 + noise).tolist()))
        wrong["pairs, false"] += v.pairs("p", "", [(low, high)]).verdict == v.REPRODUCED
        better = PaperRow("", 0.0, tuple((1.0 + v.NEGLIGIBLE * 1.02 + noise).tolist()))
        wrong["pairs, true"] += v.pairs("p", "", [(low, better)]).verdict == v.NOT
    assert max(wrong.values()) <= 0.05 * trials, wrong


def test_trials_of_a_point_come_with_the_point_in_the_order_of_runs() -> None:
    """Trials of all points run at once; each point gets those of its own runs."""
    given: list[dict[str, object]] = []

    def execute(specs):
        given.extend(specs)
        return [{"x": 10.0 * spec["point"] + spec["run"]} for spec in specs]

    found = v.run_trials((1, 2), v.Size(3, 5), execute, lambda point, run: {"point": point, "run": run})
    assert [point for point, _ in found] == [1, 2]
    assert [v.values_of(results, "x") for _, results in found] == [(10.0, 11.0, 12.0), (20.0, 21.0, 22.0)]
    assert len(given) == 6


def test_a_row_that_an_experiment_always_has_is_required() -> None:
    """A missing row is a fault of the experiment, not an open verdict."""
    table = [v.PaperRow("a", 1.0, (2.0,))]
    assert v.row_of(table, "a", 1.0) is table[0]
    with pytest.raises(KeyError):
        v.row_of(table, "a", 2.0)


def test_exact_statements_are_judged_by_their_quantity() -> None:
    """Quantities without error decide every statement; rows are numbered from 1."""
    statements = {k: v.ExactStatement(f"Statement {k}.", v.at_most(1.0), "at most 1") for k in ("low", "high")}
    table = v.exact_rows(statements, {"low": 0.5, "high": 2.0})
    assert [row.x for row in table] == [1, 2]
    judged = v.judge_exactly(statements, table)
    assert [(each.id, each.verdict) for each in judged] == [("low", v.REPRODUCED), ("high", v.NOT)]
