"""Rules of the verdicts on tables made by hand: every verdict can be reached."""

from __future__ import annotations

import math

import pytest

from occlog.papers.ercan.square import NEEDED, crossing, judge6, judge7, judge8, judge9, needed
from occlog.papers.ercan.trial import KNOWN, NONE, PRIOR, WORST
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Row, Verdict

NOISE = (-0.1, 0.0, 0.1)


def row(series: str, x: float, mean: float, noise: tuple[float, ...] = NOISE, **extra: float) -> Row:
    return Row(series, x, tuple(mean + e for e in noise), extra)


def by_id(verdicts: list[Verdict]) -> dict[str, Verdict]:
    out = {x.id: x for x in verdicts}
    assert len(out) == len(verdicts), "ids are unique"
    return out


def test_row_statistics() -> None:
    r = Row("a", 1.0, (1.0, 2.0, 4.0))
    assert r.mean == pytest.approx(7 / 3)
    assert r.sd == pytest.approx(math.sqrt(7 / 3))
    assert r.error == pytest.approx(r.sd / math.sqrt(3))
    assert math.isnan(Row("a", 1.0, (1.0,)).error)
    assert math.isnan(Row("a", 1.0, ()).mean)


@pytest.mark.parametrize(
    ("highs", "wanted"), [((2.0, 2.0), v.REPRODUCED), ((2.0, 0.5), v.IN_PART), ((0.5, 0.8), v.NOT)]
)
def test_pairs(highs: tuple[float, float], wanted: str) -> None:
    points = [(row("low", n, 1.0), row("high", n, high, (0.1, 0.0, 0.1))) for n, high in enumerate(highs)]
    found = v.pairs("p", "low below high", points)
    assert found.verdict == wanted
    assert found.measured == pytest.approx(sum(b.mean - a.mean for a, b in points) / 2)
    assert found.runs == 3


def test_pairs_without_points_or_runs_claims_nothing() -> None:
    assert v.pairs("p", "nothing", []).verdict == v.NOT
    assert v.pairs("p", "one run", [(Row("a", 1, (1.0,)), Row("b", 1, (2.0,)))]).verdict == v.NOT


def test_pairs_of_equal_runs_are_compared_run_by_run() -> None:
    """A difference that is the same in every run counts, however much the runs differ."""
    low = Row("low", 1.0, (1.0, 10.0, 100.0))
    high = Row("high", 1.0, (1.5, 10.6, 100.5))
    assert v.pairs("p", "", [(low, high)]).verdict == v.REPRODUCED
    assert v.pairs("p", "", [(low, Row("high", 1.0, (1.5, 10.6)))]).verdict == v.NOT


@pytest.mark.parametrize(
    ("second", "wanted"), [((1.05, 1.05), v.REPRODUCED), ((1.05, 3.0), v.IN_PART), ((2.0, 3.0), v.NOT)]
)
def test_close(second: tuple[float, float], wanted: str) -> None:
    points = [(row("a", n, 1.0), row("b", n, mean)) for n, mean in enumerate(second)]
    assert v.close("c", "as good", points).verdict == wanted


@pytest.mark.parametrize(
    ("measured", "error", "wanted"),
    [(10.9, math.nan, v.REPRODUCED), (11.5, 0.8, v.REPRODUCED), (12.5, 0.8, v.IN_PART), (15.0, 50.0, v.NOT)],
)
def test_number(measured: float, error: float, wanted: str) -> None:
    """A large error bar is no agreement."""
    assert v.number("n", "ten", 10.0, measured, error, 3).verdict == wanted


@pytest.mark.parametrize(("high", "wanted"), [(2.3, v.REPRODUCED), (1.8, v.IN_PART), (1.2, v.NOT)])
def test_factor(high: float, wanted: str) -> None:
    found = v.factor("f", "factor", 2.34, row("low", 0, 1.0, (-0.01, 0.0, 0.01)), row("high", 1, high))
    assert found.verdict == wanted
    assert found.measured == pytest.approx(high)
    assert v.factor("f", "factor", 2.34, None, row("high", 1, 2.0)).verdict == v.NOT


def test_fig6_as_the_paper_has_it_and_upside_down() -> None:
    table = [row(WORST, math.nan, 24.4)]
    for n in range(1, 9):
        for k, (name, wide) in enumerate(((KNOWN, 0.1), (PRIOR, 1.0), (NONE, 3.0))):
            noise = tuple(wide * e for e in NOISE)
            table.append(row(name, n, (4.0 + 4.0 * k) / n + k, noise, rmse_occ=6.67 if name == PRIOR else math.nan))
    found = by_id(judge6(table))
    assert {x.verdict for x in found.values()} == {v.REPRODUCED}
    swapped = {KNOWN: NONE, NONE: KNOWN}
    wrong = [Row(swapped.get(r.series, r.series), r.x, r.values, r.extra) for r in table]
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
    found = by_id(judge7([*rows, row(NONE, 21.4, 4.68), row(WORST, math.nan, 21.4)]))
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
    falling = [Row(r.series, -r.x, r.values, {"rmse_none": 3.5 if r.x == 4 else 9.0}) for r in rising]
    found = by_id(judge8([*falling, worst]))
    assert found["fig8-trade-off"].verdict == v.NOT
    assert found["fig8-no-priors"].verdict == v.IN_PART


@pytest.mark.parametrize(("last", "wanted"), [(1.0, v.REPRODUCED), (4.0, v.NOT)])
def test_closing_gap_of_fig9(last: float, wanted: str) -> None:
    table = []
    for m, gap in ((1, 0.01), (40, 2.0), (80, last)):
        table += [row(KNOWN, m, 2.0), row(NONE, m, 2.0 + gap, (-0.15, 0.0, 0.2))]
    found = by_id(judge9(table))
    assert found["fig9-many"].verdict == wanted
    assert found["fig9-few"].verdict == found["fig9-more"].verdict == v.REPRODUCED


@pytest.mark.parametrize(
    ("measured", "error", "wanted"),
    [
        (11.0, math.nan, v.REPRODUCED),
        (11.001, math.nan, v.IN_PART),
        (12.0, 1.0, v.REPRODUCED),
        (12.001, 1.0, v.IN_PART),
        (12.0, 1.001, v.IN_PART),
        (13.5, math.nan, v.IN_PART),
        (13.501, math.nan, v.NOT),
    ],
)
def test_number_at_its_limits(measured: float, error: float, wanted: str) -> None:
    """Ten per cent, two standard errors of at most ten per cent each, and 35 per cent."""
    assert v.number("n", "ten", 10.0, measured, error, 3).verdict == wanted


@pytest.mark.parametrize(("high", "wanted"), [(2.0, v.IN_PART), (1.999, v.NOT)])
def test_half_of_the_excess_over_one_is_a_factor_in_part(high: float, wanted: str) -> None:
    rows = (Row("low", 0.0, (1.0, 1.0)), Row("high", 0.0, (high, high)))
    assert v.factor("f", "factor", 3.0, *rows).verdict == wanted


def test_half_of_the_points_is_in_part() -> None:
    assert v.share([True, False]) == v.IN_PART
    assert v.share([True, False, False]) == v.NOT
    assert v.share([True]) == v.REPRODUCED


@pytest.mark.parametrize(("gap", "wanted"), [(1.0, v.REPRODUCED), (1.001, v.NOT)])
def test_close_means_within_one_standard_deviation(gap: float, wanted: str) -> None:
    low = Row("low", 0.0, (0.0, 1.0, 2.0))
    assert v.close("c", "equal", [(low, Row("high", 0.0, (gap, 1.0 + gap, 2.0 + gap)))]).verdict == wanted


@pytest.mark.parametrize(("spread", "wanted"), [(0.5, v.REPRODUCED), (0.501, v.NOT)])
def test_close_wants_an_error_bar_of_half_a_standard_deviation(spread: float, wanted: str) -> None:
    """Differences of -spread and spread have a standard error of spread; the rows one deviation of 1."""
    low, high = (-math.sqrt(0.5), math.sqrt(0.5)), (spread - math.sqrt(0.5), math.sqrt(0.5) - spread)
    points = [(Row("low", 0.0, low), Row("high", 0.0, high))]
    assert v.difference(*points[0])[1] == pytest.approx(spread)
    assert v.close("c", "equal", points).verdict == wanted


def test_a_difference_of_exactly_one_standard_error_is_none() -> None:
    """The differences 0 and 2 have mean 1 and standard error 1."""
    low = Row("low", 0.0, (0.0, 0.0))
    assert v.pairs("p", "below", [(low, Row("high", 0.0, (0.0, 2.0)))]).verdict == v.NOT
    assert v.pairs("p", "below", [(low, Row("high", 0.0, (0.001, 2.0)))]).verdict == v.REPRODUCED
