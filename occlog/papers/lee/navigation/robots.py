"""What the experiments of [Lee] Sec. 5.2.2 share: the printed example, robots on random lines, verdicts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.navigation.potentials import Field
from occlog.papers.lee.navigation.config import NavigateConfig
from occlog.papers.lee.navigation.course import Disc, course_of
from occlog.papers.lee.navigation.stage import Drive, End, Step, drive
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.measures import estimate, mean_of
from occlog.papers.verdicts.model import Row, Verdict
from occlog.records.scene import Scene

PLANE = Scene(length_unit="unit")
START, OBSTACLE, GOAL = (12.0, 12.0), (8.0, 8.0), (6.0, 6.0)
"""Places of the printed example."""
OUT = np.array([1.0, 1.0]) / math.sqrt(2.0)
"""Along the diagonal, away from the origin: positive in Figs. 5-26 and 5-27."""
FIELD = Field(0.5, 5.0, 2, 2, influence=10.0)
WAY = math.sqrt(2.0)
SPAWN = (2009, 52)
"""Of the random numbers of these experiments."""


class Lines(NamedTuple):
    """N robots, each on a line of its own with the one obstacle and a goal behind it."""

    starts: Floats  # (N, 2)
    goals: Floats  # (N, 2)
    behind: Floats  # (N,) distance of the goal from the obstacle


def printed_drive(config: NavigateConfig, radius: float = 0.0) -> tuple[list[Step], Drive]:
    """Drive the robot of the printed example, both radii as given; its steps, and how it fared."""
    starts, goals = np.array([START]), np.array([GOAL])
    return driven(starts, goals, Disc(*OBSTACLE, radius), replace(config, radius=radius))


def driven(starts: Floats, goals: Floats, obstacle: Disc, config: NavigateConfig) -> tuple[list[Step], Drive]:
    """Drive robots around one obstacle; their steps, and how they fared."""
    robots = Drive.at(starts)
    return list(drive(robots, goals, course_of(PLANE, (obstacle,), None, config), config)), robots


def random_lines(n: int, rng: np.random.Generator, obstacle: tuple[float, float] = (0.0, 0.0)) -> Lines:
    """Lines through an obstacle in random directions; robots are 3 to 9 before it, goals 1 to 5 behind it."""
    turn = rng.uniform(-math.pi, math.pi, n)
    along = np.column_stack([np.cos(turn), np.sin(turn)])
    behind = rng.uniform(1.0, 5.0, n)
    starts = np.array(obstacle) + rng.uniform(3.0, 9.0, n)[:, None] * along
    return Lines(starts, np.array(obstacle) - behind[:, None] * along, behind)


def collided(robots: Drive) -> Bools:
    """(N,) which robots collided."""
    return np.asarray(robots.end == End.COLLIDED)


def shown(key: str, said: str, good: bool, measured: float | None, rule: str, paper: float | None = None) -> Verdict:
    """Verdict on a statement about a determinate quantity."""
    return v.fact(key, said, holds=good, measured=measured, rule=rule, paper=paper)


def always(key: str, said: str, row: Row | None, share: float, paper: float | None = None) -> Verdict:
    """Verdict on a statement that says what always, or never, happens.

    Reproduced where the share over all trials is exactly that; not reproduced where it differs from it by more than
    two standard errors over the runs.

    Args:
        key: of the verdict.
        said: the statement.
        row: share of trials in each run.
        share: what it must be, 0 or 1.
        paper: what is printed; None: nothing.
    """
    found = estimate(math.nan, math.nan, 0) if row is None else mean_of(row)
    return v.judge(key, said, found, v.Interval(share, share), rule=f"share of trials: {share:g} in all", paper=paper)
