"""The experiments of the four papers by paper and item, the choice among them, and the run of one of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from occlog.errors import UsageError, did_you_mean
from occlog.papers.ercan import baselines, joint_states, selection, speed, square
from occlog.papers.ercan import recorded as recorded_figures
from occlog.papers.ercan import selection as selection_period
from occlog.papers.ercan import statements as ercan_statements
from occlog.papers.ercan.formulas import accuracy
from occlog.papers.ercan.formulas import equations as ercan_equations
from occlog.papers.lee import equations as lee_equations
from occlog.papers.lee import statements as lee_statements
from occlog.papers.lee.appearance.coefficient import COEFFICIENT
from occlog.papers.lee.appearance.faces import FACES
from occlog.papers.lee.appearance.motion import MOTION
from occlog.papers.lee.cooperation.drawn_cases import DRAWN_EXPERIMENTS
from occlog.papers.lee.cooperation.field import FIELD_EXPERIMENTS, OPEN_EXPERIMENTS
from occlog.papers.lee.cooperation.parallel_projection import SEC3_2_2
from occlog.papers.lee.cooperation.room import ROOM_EXPERIMENTS
from occlog.papers.lee.fusion.cases import DECISION_EXPERIMENTS
from occlog.papers.lee.fusion.detection_rates import FUSION_EXPERIMENTS
from occlog.papers.lee.navigation.escapes import ESCAPE_EXPERIMENTS
from occlog.papers.lee.navigation.forces import FORCE_EXPERIMENTS
from occlog.papers.lee.readers import READER_EXPERIMENTS
from occlog.papers.lee.space import scenarios, tables, variances, weight_sums
from occlog.papers.lee.traffic.delays import TRAFFIC_EXPERIMENTS
from occlog.papers.plots import PlanFigure, Shots
from occlog.papers.qu import statements as qu_statements
from occlog.papers.qu import variants
from occlog.papers.qu.experiments import (
    decoys,
    failures,
    fig7,
    loop,
    mechanisms,
    motion,
    rooms,
    table1,
    table2,
    table3,
    unseen,
)
from occlog.papers.qu.experiments import (
    loop as sweeps,
)
from occlog.papers.rahimi import equations as rahimi_equations
from occlog.papers.rahimi import results, search, walk
from occlog.papers.rahimi import robustness as trust
from occlog.papers.rahimi import statements as rahimi_statements
from occlog.papers.verdicts import Execute, Experiment, Size, Sources, StatementVerdict, Table, attributed

PAPERS: dict[str, tuple[Experiment, ...]] = {
    "ercan": (
        ercan_equations.EQUATIONS,
        baselines.BASELINES,
        joint_states.JOINT_STATES,
        selection_period.SELECTION_PERIOD,
        *square.EXPERIMENTS,
        speed.FIG10,
        selection.FIG12,
        selection.FIG14,
        selection.FIG15,
        accuracy.FIG17,
    ),
    "rahimi": (
        rahimi_equations.EQUATIONS,
        search.FIG3,
        results.FIG4,
        results.FIG5,
        walk.FIG7,
        trust.FALSE,
        trust.COVARIANCE,
    ),
    "lee": (
        lee_equations.EQUATIONS,
        # Chapter 2
        variances.VARIANCES,
        weight_sums.FIG2_7,
        *tables.TABLES,
        *scenarios.SCENARIOS,
        scenarios.SENSORS,
        scenarios.COUNTED,
        # Chapter 3
        SEC3_2_2,
        *OPEN_EXPERIMENTS,
        *DRAWN_EXPERIMENTS,
        *FIELD_EXPERIMENTS,
        *ROOM_EXPERIMENTS,
        # Chapter 4
        *DECISION_EXPERIMENTS,
        *FUSION_EXPERIMENTS,
        # Chapter 5
        COEFFICIENT,
        *FACES,
        MOTION,
        *FORCE_EXPERIMENTS,
        *ESCAPE_EXPERIMENTS,
        # Section 5.2.3
        *READER_EXPERIMENTS,
        *TRAFFIC_EXPERIMENTS,
    ),
    "qu": (
        sweeps.SWEEPING,
        table1.TABLE1,
        table2.TABLE2,
        failures.FAILURES,
        table3.TABLE3,
        fig7.FIG7,
        mechanisms.MECHANISMS,
        decoys.DECOYS,
        *rooms.ROOMS,
        unseen.UNSEEN_COUNTERPARTS,
        *variants.VARIANTS,
        motion.MOTION,
        loop.LOOP,
    ),
}
"""Every paper's experiments, in the order of the paper."""
SOURCES: dict[str, Sources] = {
    "ercan": ercan_statements.SOURCES,
    "rahimi": rahimi_statements.SOURCES,
    "lee": lee_statements.SOURCES,
    "qu": qu_statements.SOURCES,
}
"""Modules with the statements of each paper."""
RECORDED = {"ercan": recorded_figures.ITEMS}
"""Items of the experiments that need a recording."""
TITLES = {
    "ercan": "Ercan, El Gamal, Guibas 2013, Object tracking in the presence of occlusions using multiple cameras",
    "rahimi": "Rahimi, Dunagan, Darrell 2004, Tracking people with a sparse network of bearing sensors",
    "lee": "Lee 2009, Design and analysis of heterogeneous sensors based object tracking systems",
    "qu": "Qu, Schonfeld, Mohamed 2007, Distributed Bayesian multiple-target tracking in crowded environments using "
    "multiple collaborative cameras",
}


@dataclass(frozen=True)
class ExperimentResult:
    """Result of an experiment: its table, the verdicts on the paper's statements, and its pictures."""

    experiment: Experiment
    size: Size
    table: Table
    verdicts: list[StatementVerdict]
    cpu_seconds: float
    """CPU time of this process; the column `track_seconds` has that of the workers."""
    plans: dict[str, PlanFigure | Shots] = field(default_factory=dict)
    """Floor plans and frames by name."""

    def as_dict(self) -> dict[str, object]:
        """Experiment, size and verdicts, without table and pictures, as plain values for JSON."""
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
    """Experiments of a paper with these names, in the paper's order; UsageError for an unknown paper or name.

    Args:
        paper: key of `PAPERS`.
        items: names of experiments.
        everything: return all experiments, whatever `items` are.
        recorded: further experiments, on a recording that was given.
    """
    if paper not in PAPERS:
        raise UsageError(f"no experiments of {paper!r}; there are those of: {', '.join(PAPERS)}", id="unknown-name")
    known = {e.item: e for e in (*PAPERS[paper], *recorded)}
    for item in items:
        if item not in known:
            raise UsageError(
                f"{paper} has no experiment {item!r}; {did_you_mean(item, known, 'it has:')}", id="unknown-name"
            )
    return [e for e in known.values() if everything or e.item in items]


def size_of(experiment: Experiment, *, quick: bool, runs: int | None, steps: int | None, seed: int) -> Size:
    """Number of runs and steps of an experiment, with its form and seed.

    Args:
        experiment: experiment with its own numbers of runs and steps.
        quick: use those of the quick form, not those of the paper.
        runs: number of runs; None: the experiment's own.
        steps: number of steps; None: the experiment's own.
        seed: seed of all random numbers.
    """
    own = experiment.quick if quick else (experiment.runs, experiment.steps)
    return Size(runs or own[0], steps or own[1], quick=quick, seed=seed)


def reproduce(paper: str, experiment: Experiment, size: Size, execute: Execute) -> ExperimentResult:
    """Run an experiment of a paper, judge its table, draw its pictures, and measure the CPU time [s] of all that.

    `execute` runs the trials; verdicts get the positions of their statements in the paper.
    """
    start = time.process_time()
    table = experiment.compute(size, execute)
    verdicts = attributed(experiment.judge(table), SOURCES[paper])
    plans = {name: draw(size) for name, draw in experiment.plans.items()}
    return ExperimentResult(experiment, size, table, verdicts, time.process_time() - start, plans)
