"""First guesses of a trajectory: on the cameras' axes ([Rahimi] Sec. 6), or by a linear problem."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .problem import Problem, SightLines


def start_on_axes(lines: SightLines, T: int, centre: Floats, depth: float) -> Floats:
    """(T, 4) states of [Rahimi] Sec. 6: unseen ones in the centre, seen ones on the axis of the camera that saw them.

    A state that several cameras saw is put on the axis of the last of them, which is
    inside the constraints of that camera only; see `occlog.track.map.kernels.interior_point.feasible.move_inside`.

    Args:
        lines: N sight lines.
        T: number of states.
        centre: (2,) the paper's origin.
        depth: distance along the axis, > 0; the paper's is one metre.
    """
    X = np.zeros((T, 4))
    X[:, ::2] = centre
    X[lines.step, ::2] = lines.place + depth * lines.axis
    return X


def linear_problem(problem: Problem, distance: Floats) -> Problem:
    """The problem with each residual replaced by one that is linear in the state (pseudo-linear).

    r = (f h - z d) / (sigma D) with a distance D that is fixed in advance.

    Args:
        problem: with any losses; those of the result are squares.
        distance: (N,) D of every sight line, > 0.
    """
    lines = problem.lines
    sigma2 = lines.c0 + lines.c1 / distance**2
    flat = lines._replace(
        focal=np.where(lines.direction, 1.0, lines.focal),
        reading=np.where(lines.direction, 0.0, lines.reading),
        c0=np.zeros(len(sigma2)),
        c1=sigma2 * distance**2,
        direction=np.zeros(len(sigma2), dtype=np.bool_),
        volume=np.zeros(len(sigma2)),
    )
    return problem._replace(lines=flat, loss=0)
