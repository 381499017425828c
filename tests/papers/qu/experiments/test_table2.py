"""What is needed and how it grows, on figures that were made up; and a tiny run of the experiment."""

import pytest

from occlog.papers.qu.experiments.table2 import (
    ENOUGH,
    FILTERS,
    TABLE2,
    TIME,
    TOTAL,
    Tried,
    judge2,
    needed,
)
from occlog.papers.qu.trial import run_views_trial
from occlog.papers.verdicts import PaperRow, Size

COUNTS = (2, 3, 4, 5, 6, 8)


def trial_rows(efficiency, fr_p=(0.0, 0.0, 0.0), runs=2):
    """Effective samples in proportion to the particles; a millisecond for each 100 of them, to the power 0.5."""
    rows = []
    for x, rate in zip((100.0, 200.0, 400.0), fr_p, strict=True):
        values = tuple(efficiency * x * (1.0 + 0.1 * k) for k in range(runs))
        rows.append(Tried(PaperRow("", x, values, {"fr_p": rate}), PaperRow("", x, ((x / 100.0) ** 0.5,) * runs)))
    return rows


@pytest.mark.parametrize("efficiency", [0.05, 0.12, 0.5])
def test_needed_lies_on_the_lines_between_and_beyond(efficiency):
    need, spent = needed(trial_rows(efficiency))
    want = [ENOUGH / efficiency, ENOUGH / efficiency / 1.1]
    assert need == pytest.approx(want)
    assert spent == pytest.approx([(w / 100.0) ** 0.5 for w in want])


def test_targets_have_to_be_followed_in_addition():
    assert needed(trial_rows(0.5, (0.3, 0.05, 0.02)))[0] == pytest.approx([200.0, 200.0])
    assert needed(trial_rows(0.1, (0.3, 0.05, 0.02)))[0] == pytest.approx([300.0, 300.0 / 1.1])
    assert needed(trial_rows(0.5, (0.05, 0.2, 0.02)))[0] == pytest.approx([400.0, 400.0])
    assert needed(trial_rows(0.5, (0.0, 0.0, 0.2))) == ((), ())


def table(bmct, mcmc, sir):
    """Rows of three filters by what is needed at n targets, with some noise."""
    rows = []
    for name, need in zip(FILTERS, (bmct, mcmc, sir), strict=True):
        for n in COUNTS:
            values = tuple(need(n) * (1.0 + 0.01 * k) for k in (-1, 0, 1))
            rows += [
                PaperRow(f"{name}, {TOTAL}", n, values),
                PaperRow(f"{name}, {TIME}", n, tuple(0.01 * x for x in values)),
            ]
    return rows


def test_verdicts_follow_the_growth():
    as_printed = {v.id: v for v in judge2(table(lambda n: 100 * n, lambda n: 1.4 * n**4.25, lambda n: 40 * 1.5**n))}
    for key in (
        "bmct-particles",
        "bmct-time",
        "mcmc-particles",
        "mcmc-time",
        "sir-particles",
        "sir-exponential",
        "mcmc-4",
    ):
        assert as_printed[f"table2-{key}"].verdict == "reproduced", key
    assert as_printed["table2-bmct-particles"].paper == pytest.approx(1.0, abs=0.01)
    assert as_printed["table2-mcmc-particles"].paper == pytest.approx(4.25, abs=0.1)
    assert as_printed["table2-sir-exponential"].measured < 0.01
    similar = {v.id: v for v in judge2(table(lambda n: 100 * n, lambda n: 80 * n**1.2, lambda n: 90.0 * n))}
    assert similar["table2-mcmc-particles"].verdict == "in part"
    assert similar["table2-sir-particles"].verdict == "not decided"  # as fast as BMCT, but for rounding
    other = {v.id: v for v in judge2(table(lambda n: n**2.0, lambda n: 100 * n, lambda n: n**2.0))}
    assert other["table2-bmct-particles"].verdict == "not reproduced"
    assert other["table2-mcmc-particles"].verdict == "not reproduced"
    assert other["table2-sir-exponential"].verdict == "not reproduced"
    assert other["table2-faster"].verdict == "reproduced"


def test_totals_count_all_trackers_of_both_views():
    bmct, mcmc, sir = FILTERS.values()
    assert bmct.total(4, 50) == 400
    assert mcmc.total(4, 250) == 500
    assert sir.tried(6)[0] < sir.tried(8)[0]
    assert mcmc.tried(6) == [270, 540, 1080]


@pytest.mark.jit
def test_experiment_runs_and_tells_all_that_it_measured():
    rows = TABLE2.compute(Size(1, 4, quick=True, seed=5), lambda specs: [run_views_trial(s) for s in specs])
    for name in FILTERS:
        need = [r for r in rows if r.series == f"{name}, {TOTAL}"]
        assert [r.x for r in need] == [2, 4, 6]
        assert all(r.mean > 0 for r in need)
        relative = [r for r in rows if r.series == f"{name}, particles"]
        assert relative[1].mean == pytest.approx(1.0)
    assert sum("effective" in r.series for r in rows) == 3 * 3 * 3
    assert len(TABLE2.judge(rows)) >= 8
