"""The parts of an experiment: its size, trials, table of rows, and verdicts on the paper's statements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

from occlog.papers.page.planplot import Plan
from occlog.papers.page.shotplot import Shots
from occlog.pipeline.sweep.trial import Spec, run_trial

Execute = Callable[[Sequence[Spec]], list[dict[str, float]]]
"""Runs trials and returns their figures in the order of the trials; see `occlog.pipeline.sweep.engine.run_all`."""

EXTRAS = ("rmse_occ", "hidden", "sir", "restart", "lost", "mean_ess", "messages", "bytes", "track_seconds")
"""Figures of trials that the table has besides the RMSE, as means over the runs."""


class Size(NamedTuple):
    """Numbers that set the cost of an experiment, and the seed of its random numbers."""

    runs: int
    steps: int
    quick: bool = False
    particles: int = 1000
    seed: int = 0


@dataclass(frozen=True)
class Row:
    """One point of a figure, with the value of every run."""

    series: str
    x: float  # NaN: a line across the figure
    values: tuple[float, ...]
    extra: dict[str, float] = field(default_factory=dict)
    plotted: bool = True  # false: in the table only
    each: dict[str, tuple[float, ...]] = field(default_factory=dict)  # further figures of every run

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.values)

    @property
    def mean(self) -> float:
        """Mean over the runs; NaN for none."""
        return math.fsum(self.values) / len(self.values) if self.values else math.nan

    @property
    def sd(self) -> float:
        """Standard deviation over the runs; NaN for fewer than two."""
        return deviation(self.values)

    @property
    def error(self) -> float:
        """Standard error of the mean; NaN for fewer than two runs."""
        return self.sd / math.sqrt(len(self.values)) if self.values else math.nan


Table = list[Row]


@dataclass(frozen=True)
class Verdict:
    """A statement of the paper, and whether what was measured confirms it."""

    id: str
    statement: str
    paper: float | None
    measured: float | None
    error_bar: float | None  # standard error of `measured`
    runs: int
    verdict: str  # one of `occlog.papers.verdicts.words.WORDS`
    rule: str  # how the verdict was reached
    place: str = ""  # figure, table, equation or section of the paper
    page: int | None = None  # of the paper, where its text has page numbers
    words: str = ""  # the statement as the paper has it; empty: its text does not state it

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON; NaN and infinities become None."""
        out = asdict(self)
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in out.items()}


@dataclass(frozen=True)
class Experiment:
    """A figure or table of a paper: how its rows are computed, and how its statements are judged."""

    item: str
    title: str
    x_label: str
    y_label: str
    runs: int  # in the paper
    steps: int  # of a run, in the paper
    quick: tuple[int, int]  # runs and steps of the small form
    compute: Callable[[Size, Execute], Table]
    judge: Callable[[Table], list[Verdict]]
    note: str = ""
    trial: Callable[[Spec], dict[str, float]] = run_trial  # runs one of the trials of `compute`
    plans: Mapping[str, Callable[[Size], Plan | Shots]] = field(default_factory=dict)  # further pictures by name


def deviation(values: Sequence[float]) -> float:
    """Standard deviation of a sample; NaN for fewer than two values."""
    n = len(values)
    if n < 2:
        return math.nan
    mean = math.fsum(values) / n
    return math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1))
