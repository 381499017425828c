"""What suffices by failure rates: on curves that were made up, and a tiny run."""

import math

import numpy as np
import pytest

from occlog.papers.qu.experiments.failures import (
    FAILURES,
    FOLLOWED,
    TRIED,
    WORSE,
    FailureCurve,
    enough,
    growth,
    judge_failures,
    series_of,
    total,
)
from occlog.papers.qu.trial import run_views_trial
from occlog.papers.verdicts import PaperRow, Size, bootstrapped

TOTALS = np.array([50.0, 100.0, 200.0, 400.0])


def test_what_suffices_lies_where_the_rate_comes_within_the_limit():
    assert enough(TOTALS, np.array([9.0, 5.0, 1.0, 1.0])) == pytest.approx(100.0 * 2.0**0.5)
    assert math.isnan(enough(TOTALS, np.array([1.0 + WORSE, 1.0, 1.0, 1.0])))  # fewer may suffice
    assert enough(TOTALS, np.array([1.01 + WORSE, 1.0, 1.0, 1.0])) == pytest.approx(50.0, rel=0.01)
    assert enough(TOTALS, np.array([9.0, 1.0, 9.0, 1.0])) > 200.0  # a later rise counts
    assert math.isnan(enough(TOTALS, np.array([90.0, FOLLOWED + 0.1, FOLLOWED + 0.1, FOLLOWED + 0.1])))
    assert enough(TOTALS, np.array([90.0, FOLLOWED, FOLLOWED, FOLLOWED])) < 100.0


def test_growth_is_the_exponent_of_what_suffices():
    rates = np.array([9.0, 5.0, 1.0, 1.0])[:, None] + np.zeros(3)
    curves = [FailureCurve(n, TOTALS * n**2.5, rates) for n in (4, 5, 6)]
    assert growth(curves) == pytest.approx(2.5)
    assert math.isnan(growth(curves[:1]))


def test_bootstrap_has_the_range_of_a_mean():
    x = np.random.default_rng(1).normal(5.0, 1.0, 50)
    found = bootstrapped(50, lambda d: float(x[d].mean()), 2000)
    assert found.value == pytest.approx(x.mean())
    assert found.error == pytest.approx(x.std() / 50**0.5, rel=0.1)
    assert found.half_width == pytest.approx(2.05 * found.error, rel=0.1)
    assert math.isinf(bootstrapped(1, lambda d: 1.0, 100).high)


def table(power, runs=12):
    """Failures that fall with the particles of each target's need, n to a power; with some noise."""
    rng, rows = np.random.default_rng(3), []
    for name in TRIED:
        exponent = 1.0 if name == "BMCT" else power
        for n in (4, 5, 6):
            need = 200.0 * (n / 4.0) ** exponent
            for k in TRIED[name]:
                x = total(n, k)
                rate = 1.0 + 8.0 * (need / x) ** 2 + 0.2 * rng.standard_normal(runs)
                rows.append(PaperRow(series_of(name, n), x, tuple(rate.tolist())))
    return rows


def test_verdicts_follow_the_growth():
    found = {v.id.removeprefix("table2-rates-"): v.verdict for v in judge_failures(table(4.2))}
    assert found["bmct-growth"] == found["mcmc-growth"] == "reproduced"
    assert found["bmct-stable"] == found["mcmc-stable"] == "reproduced"
    similar = {v.id.removeprefix("table2-rates-"): v.verdict for v in judge_failures(table(1.0))}
    assert similar["mcmc-growth"] == "not reproduced"
    assert len(similar) == 10


@pytest.mark.jit
def test_experiment_runs():
    rows = FAILURES.compute(Size(1, 4, quick=True, seed=5), lambda specs: [run_views_trial(s) for s in specs])
    assert {r.series for r in rows} == {series_of(name, n) for name in TRIED for n in (4, 6)}
    assert all(0.0 <= r.mean <= 200.0 for r in rows)
    found = [v for v in FAILURES.judge(rows) if not v.id.endswith("stable")]
    assert len(found) == 6
    assert {v.verdict for v in found} == {"not decided"}  # nothing fails in four frames
