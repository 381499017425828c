"""Which experiments there are, and one of them done: table and verdicts."""

from __future__ import annotations

import difflib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from occlog.errors import UsageError
from occlog.papers.lee.cooperation import field as cooperation_field
from occlog.papers.lee.cooperation import room as cooperation_room
from occlog.papers.lee.fusion import cases as fusion_cases
from occlog.papers.lee.fusion import trial as fusion_rates
from occlog.papers.lee.space import scenarios, tables, variances
from occlog.papers.page.planplot import Plan
from occlog.papers.page.shotplot import Shots
from occlog.papers.qu.experiments import fig7, loop, table1, table2, table3
from occlog.papers.verdicts.model import Execute, Experiment, Size, Table, Verdict

from .ercan import accuracy, laboratory, recorded_figures, selection, speed, square
from .qu import variants
from .rahimi import results, search, trust

PAPERS: dict[str, tuple[Experiment, ...]] = {
    "ercan": (*square.EXPERIMENTS, speed.FIG10, selection.FIG12, laboratory.FIG14, selection.FIG15, accuracy.FIG17),
    "rahimi": (search.FIG3, results.FIG4, results.FIG5, trust.FALSE, trust.COVARIANCE),
    "lee": (
        # Chapter 2
        variances.VARIANCES,
        *tables.TABLES,
        *scenarios.SCENARIOS,
        scenarios.SENSORS,
        scenarios.COUNTED,
        # Chapter 3
        *cooperation_field.EXPERIMENTS,
        *cooperation_room.EXPERIMENTS,
        # Chapter 4
        *fusion_cases.EXPERIMENTS,
        *fusion_rates.EXPERIMENTS,
    ),
    "qu": (table1.TABLE1, table2.TABLE2, table3.TABLE3, fig7.FIG7, *variants.VARIANTS, loop.LOOP),
}
"""Every paper's experiments, in the order of the paper."""
RECORDED = {"ercan": recorded_figures.ITEMS}
"""Experiments that want a recording."""
TITLES = {
    "ercan": "Ercan, El Gamal, Guibas 2013, Object tracking in the presence of occlusions using multiple cameras",
    "rahimi": "Rahimi, Dunagan, Darrell 2004, Tracking people with a sparse network of bearing sensors",
    "lee": "Lee 2009, Design and analysis of heterogeneous sensors based object tracking systems",
    "qu": "Qu, Schonfeld, Mohamed 2007, Distributed Bayesian multiple-target tracking in crowded environments using "
    "multiple collaborative cameras",
}


@dataclass(frozen=True)
class Finding:
    """What came out of an experiment."""

    experiment: Experiment
    size: Size
    table: Table
    verdicts: list[Verdict]
    cpu_seconds: float
    """Of this process; that of the workers is in the column `track_seconds`."""
    plans: dict[str, Plan | Shots] = field(default_factory=dict)
    """Floor plans and frames by name."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        e = self.experiment
        return {
            "item": e.item,
            "title": e.title,
            "runs": self.size.runs,
            "steps": self.size.steps,
            "quick": self.size.quick,
            "full": {"runs": e.runs, "steps": e.steps},
            "verdicts": [x.as_dict() for x in self.verdicts],
        }


def choose(
    paper: str, items: Sequence[str], *, everything: bool, recorded: Sequence[Experiment] = ()
) -> list[Experiment]:
    """The experiments of a paper with these names, in the paper's order; UsageError for names that it does not have.

    Args:
        paper: a key of `PAPERS`.
        items: names.
        everything: all of them.
        recorded: experiments on a recording that was given.
    """
    if paper not in PAPERS:
        raise UsageError(f"no experiments of {paper!r}; there are those of: {', '.join(PAPERS)}")
    known = {e.item: e for e in (*PAPERS[paper], *recorded)}
    for item in items:
        if item in RECORDED.get(paper, ()) and item not in known:
            raise UsageError(f"{item} wants a recording; give --data DIR, or --bearings and --scene")
        if item not in known:
            near = difflib.get_close_matches(item, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else ""
            raise UsageError(f"{paper} has no experiment {item!r}; {hint or 'it has: ' + ', '.join(known)}")
    if not items and not everything:
        raise UsageError(f"name an experiment of {paper} ({', '.join(known)}), or give --all")
    return [e for e in known.values() if everything or e.item in items]


def size_of(experiment: Experiment, *, quick: bool, runs: int | None, steps: int | None, seed: int) -> Size:
    """How large to make it: the paper's size, the quick one, or what is given."""
    own = experiment.quick if quick else (experiment.runs, experiment.steps)
    return Size(runs or own[0], steps or own[1], quick, 1000, seed)


def reproduce(experiment: Experiment, size: Size, execute: Execute) -> Finding:
    """Do an experiment and judge it."""
    start = time.process_time()
    table = experiment.compute(size, execute)
    verdicts = experiment.judge(table)
    plans = {name: draw(size) for name, draw in experiment.plans.items()}
    return Finding(experiment, size, table, verdicts, time.process_time() - start, plans)
