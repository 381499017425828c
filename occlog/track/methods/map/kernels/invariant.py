"""The most probable trajectory that does not depend on the coordinates it is written in.

The mode of a posterior density is drawn towards where its volume is small.  Seen by one camera, a
trajectory near the camera takes less room than the same one farther off, since a bearing
leaves a strip that widens with the distance; the mode gives this no weight, and where the
distance follows from the motion alone it often ends right before the camera, with a
covariance that is far too small.  The remedy is to divide the density by that of the Fisher information, the square
root of det H: then the point that is found is the same in all coordinates (Druilhet and Marin 2007),
and it is about the centre of the posterior mass.

1/2 log det H falls by the leverage of a line of sight when its distance d grows by a factor of e,
so that the term is - sum of leverage . log d, with leverages from the solution before, until they settle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from .interior_point import Options, Solution, covariance, minimise, move_inside
from .problem import TrajectoryProblem
from .terms import in_front, leverages

ROUNDS = 8
CONVERGENCE_SIGMAS = 0.02
"""Change of every position, in its standard deviations, at which leverages have settled."""
MU = 1e-4
APART = 1e-3
"""Distance to the constraints, as a share of the extent, at which the search begins."""


class Invariant(NamedTuple):
    """Minimum, independent of the coordinates, of the cost with its volume term (half the log det of the information).

    `problem` is the cost with that term, `solution` its minimum, `covariance` (T, 4, 4) of the states there.
    """

    problem: TrajectoryProblem
    solution: Solution
    covariance: Floats  # (T, 4, 4)


def invariant(problem: TrajectoryProblem, start: Solution, options: Options, extent: float) -> Invariant:
    """Return the estimate that does not depend on the coordinates, reached from the mode.

    Leverages and minimum are computed in turn until positions settle.

    Args:
        problem: cost and constraints, with all lines of sight in front of their cameras.
        start: minimum of the problem (the mode).
        options: stopping criteria of each search.
        extent: size of the scene.
    """
    spread = covariance(problem, start.X)
    # Away from the boundary, where the mode often is.
    X, _ = move_inside(start.X, problem.planes, APART * extent)
    here, solution, iterations = problem, start, start.iterations
    for _ in range(ROUNDS):
        # Leverages of the lines of sight at the last solution
        volume = np.clip(leverages(problem.lines, X, problem.loss, problem.k, spread), 0.0, 1.0)
        volume[~in_front(problem.lines, X)] = 0.0
        here = problem._replace(lines=problem.lines._replace(volume=volume))
        # Minimise with the volume's term
        solution = minimise(here, X, options._replace(mu=MU if len(problem.planes.step) else 0.0))
        iterations += solution.iterations
        spread = covariance(here, solution.X)
        # Settled: no position moved by a fiftieth of its standard deviation
        sigma = np.sqrt(spread[:, (0, 2), (0, 2)].sum(axis=1))
        moved = np.hypot(*(solution.X - X)[:, ::2].T) / sigma
        X = solution.X
        if moved.max() < CONVERGENCE_SIGMAS:
            break
    return Invariant(here, solution._replace(iterations=iterations), spread)


def second_moment(X: Floats, centre: Floats, spread: Floats) -> Floats:
    """Return second moments (T, 4, 4) about states X (T, 4) of Gaussians with another mean.

    Their means are `centre` (T, 4), their covariances `spread` (T, 4, 4).
    """
    away = X - centre
    return np.asarray(spread + away[:, :, None] * away[:, None, :])
