"""[Qu] Sec. 3.2: iterating between the views where a target is close to others in all of them.

The paper begins with a view at random and tracks there without help, then goes back and forth between the views.  BMCT
has `sweeps` for the number of times; all are run on the same videos, with the same seeds of the trackers.
"""

from __future__ import annotations

from occlog.papers.qu.common import LITTLE, RATES, ordered, rate_row, seed_of
from occlog.papers.qu.trial import run_views_trial, views_spec
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.measures import difference_of
from occlog.papers.verdicts.model import Execute, Experiment, Size, Table, Verdict

SWEEPS = (1, 2, 4)


def sweeps(size: Size, execute: Execute) -> Table:
    """Compute both rates [%] of BMCT against the number of sweeps."""
    methods = {f"bmct {n}": {"method": "bmct", "set": {"sweeps": n}} for n in SWEEPS}
    results = execute([views_spec(seed_of(size, run), methods, {"frames": size.steps}) for run in range(size.runs)])
    return [
        rate_row(name, float(n), results, f"bmct {n}", rate, plotted=True)
        for rate, name in RATES.items()
        for n in SWEEPS
    ]


def judge_sweeps(table: Table) -> list[Verdict]:
    """Judge that a second sweep helps, and that more than two gain nothing."""
    out = []
    for rate, name in RATES.items():
        once, twice, often = (v.find(table, name, float(n)) for n in SWEEPS)
        if once is None or twice is None or often is None:
            continue
        said = f"Iterating gives better estimates: rate of {name} with two sweeps below that with one, by [%]."
        out.append(ordered(f"sweeps-{rate}-helps", said, twice, once))
        said = f"Twice is enough: rate of {name} with two sweeps above that with four, by [%]."
        rule = f"by at most {LITTLE:g} %; in part by {2.0 * LITTLE:g} %"
        more, limits = difference_of(often, twice), (v.at_most(LITTLE), v.at_most(2.0 * LITTLE))
        out.append(v.judge(f"sweeps-{rate}-enough", said, more, *limits, rule=rule))
    return out


SWEEPING = Experiment(
    item="sweeps",
    title="Iterating between the views",
    x_label="sweeps over the views",
    y_label="rate [%]",
    runs=12,
    steps=400,
    quick=(2, 40),
    compute=sweeps,
    judge=judge_sweeps,
    trial=run_views_trial,
    note="Six balls of radius 22 px, two views, BMCT.",
)
