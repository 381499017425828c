"""[Rahimi]: what bearings determine (Fig. 1, Sec. 7), and the printed equations of Secs. 3 and 5.

A target at constant velocity has four unknowns, position and velocity.  Bearings without noise leave those dimensions
open
in which these can change and no bearing does, to first order: as many as 4 less the rank of the gradients.
Equations are written down as printed; what they should give is computed by their definition.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np

from occlog.array_types import Floats
from occlog.papers import verdicts as v
from occlog.papers.verdicts import ExactStatement, Execute, Experiment, Size, Table

from .example import FOV_DEG, PLACES, RANGE, SPEED, STEP_S

STEPS = 8
"""Times at which each camera sees the target in Fig. 1, and length of the trajectories of the equations."""
RANK = 1e-9
"""Least singular value, relative to the largest, of a dimension that is determined."""
A = np.array([[1.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
NOISE = np.diag([1e-4, 1.0, 1e-4, 1.0])
"""Printed motion of Sec. 3 and its noise, in a thousandth of its unit of length, so that matrices can be inverted."""
ALONE, SPEED_KNOWN, TWO, RADIAL = "fig1-scale", "fig1-speed", "fig1-two", "sec7-same-bearing"


ALL, EQUAL = v.at_least(1.0), v.at_most(1e-9)
STATEMENTS: Mapping[str, ExactStatement] = {
    ALONE: ExactStatement(
        "One camera leaves the scale of a target at constant velocity open, and nothing else: share of the targets.",
        ALL,
        "all: one dimension of four",
    ),
    SPEED_KNOWN: ExactStatement(
        "If its speed is known, one camera determines its positions: share of the targets.", ALL, "all: no dimension"
    ),
    TWO: ExactStatement(
        "If its speed is constant and unknown, two cameras with views that do not overlap do: share of the targets.",
        ALL,
        "all: no dimension",
    ),
    RADIAL: ExactStatement(
        "A target that moves along one bearing cannot be located, though its speed is known: share of the targets.",
        ALL,
        "all: one dimension or more",
    ),
    "eq1": ExactStatement(
        "The printed A adds velocities to positions in the printed order of the state: largest deviation [m].",
        EQUAL,
        "at most 1e-9 m",
    ),
    "eq2": ExactStatement(
        "The inverse of Lambda_X is tri-diagonal in blocks: largest entry outside, as a share of the largest.",
        EQUAL,
        "at most 1e-9",
    ),
    "eq3": ExactStatement(
        "Lambda_X, the covariance of (2), is G^T G of (3): largest deviation as a share.", EQUAL, "at most 1e-9"
    ),
    "eq3-inverse": ExactStatement(
        "The inverse of Lambda_X is G^T G with roots of the inverse of Sigma_nu: largest deviation as a share.",
        EQUAL,
        "at most 1e-9",
    ),
    "sec5-sparse": ExactStatement("Each row of J has exactly 2 entries that are not 0: share of the rows.", ALL, "all"),
}


def equations(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of one quantity for each statement on bearings and printed equations, a row each, with x as its number.

    `size.steps` is the number of random targets.
    """
    rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(2004, 1)))
    found = {**_undetermined(rng, size.steps), **_prior(), "sec5-sparse": _sparse()}
    return v.exact_rows(STATEMENTS, found)


def open_dimensions(cameras: Floats, position: Floats, velocity: Floats, *, speed: bool) -> int:
    """How many of a target's four unknowns, position and velocity, its bearings leave open to first order.

    Args:
        cameras: (C, 2) positions; each sees the target at `STEPS` times, one camera after the other.
        position: (2,) position of the target at the first time.
        velocity: (2,) constant velocity of the target [length per step].
        speed: whether the length of the velocity is known.
    """
    rows = []
    for i, camera in enumerate(cameras):
        for t in range(i * STEPS, (i + 1) * STEPS):
            away = position + t * velocity - camera
            normal = np.array([-away[1], away[0]]) / (away @ away)
            rows.append(np.concatenate([normal, t * normal]))
    if speed:
        rows.append(np.concatenate([np.zeros(2), velocity / np.hypot(*velocity)]))
    gradients = np.array(rows)
    singular = np.linalg.svd(gradients / np.linalg.norm(gradients, axis=0).clip(1e-300), compute_uv=False)
    return 4 - int(np.count_nonzero(singular > RANK * singular[0]))


def _undetermined(rng: np.random.Generator, targets: int) -> dict[str, float]:
    """By statement of [Rahimi] Fig. 1, the share of random targets for which it holds; cameras are those of Sec. 6."""
    held = dict.fromkeys((ALONE, SPEED_KNOWN, TWO, RADIAL), 0)
    positions, half = np.array(PLACES, dtype=np.float64), math.radians(0.5 * FOV_DEG)
    for _ in range(targets):
        one, other = rng.choice(len(positions), 2, replace=False)
        cameras, yaws = positions[[one, other], :2], np.radians(positions[[one, other], 2])
        angle, distance = yaws + rng.uniform(-half, half, 2), rng.uniform(0.2, 1.0, 2) * RANGE
        sight = np.column_stack([np.cos(angle), np.sin(angle)])
        # It passes a point that the first camera sees, and is in the second one's view when that one observes
        first, second = cameras + distance[:, None] * sight
        across = (second - first) / STEPS
        turn = rng.uniform(-math.pi, math.pi)
        velocity = SPEED * STEP_S * np.array([math.cos(turn), math.sin(turn)])
        held[ALONE] += open_dimensions(cameras[:1], first, velocity, speed=False) == 1
        held[SPEED_KNOWN] += open_dimensions(cameras[:1], first, velocity, speed=True) == 0
        held[TWO] += open_dimensions(cameras, first, across, speed=False) == 0
        radial = SPEED * STEP_S * sight[0]
        held[RADIAL] += open_dimensions(cameras[:1], first, radial, speed=True) >= 1
    return {key: n / targets for key, n in held.items()}


def _prior() -> dict[str, float]:
    """Largest deviations of [Rahimi] Eqs. 1 to 3 from the motion and covariance that they describe, by statement."""
    n, x = 4 * STEPS, np.array([1.0, 2.0, 0.3, 0.4])  # positions 1 and 2, velocities 0.3 and 0.4
    moved = float(np.abs((A @ x)[:2] - (x[:2] + 0.5 * x[2:])).max())
    # The covariance, state by state; the first one's is that of a weak prior, without which it does not exist
    first, covariance = np.eye(4), np.zeros((n, n))
    each = [first]
    for _ in range(STEPS - 1):
        each.append(A @ each[-1] @ A.T + NOISE)
    for i in range(STEPS):
        for j in range(i, STEPS):
            block = np.linalg.matrix_power(A, j - i) @ each[i]
            covariance[4 * j : 4 * j + 4, 4 * i : 4 * i + 4] = block
            covariance[4 * i : 4 * i + 4, 4 * j : 4 * j + 4] = block.T
    printed, right = (_gram(root) for root in (np.sqrt(NOISE), np.diag(1.0 / np.sqrt(np.diag(NOISE)))))
    right[:4, :4] += np.linalg.inv(first)
    blocks = np.arange(n) // 4
    outside = np.abs(blocks[:, None] - blocks) > 1
    inverse = np.linalg.inv(covariance)
    return {
        "eq1": moved,
        "eq2": float(np.abs(inverse[outside]).max() / np.abs(inverse).max()),
        "eq3": float(np.abs(printed - covariance).max() / np.abs(covariance).max()),
        "eq3-inverse": float(np.abs(inverse - right).max() / np.abs(right).max()),
    }


def _rows(root: Floats) -> Floats:
    """Matrix G of [Rahimi] Eq. 3: block row t has `root` A at state t and -`root` at state t + 1; `root`: (4, 4)."""
    G = np.zeros((4 * (STEPS - 1), 4 * STEPS))
    for t in range(STEPS - 1):
        rows = slice(4 * t, 4 * t + 4)
        G[rows, 4 * t : 4 * t + 4], G[rows, 4 * t + 4 : 4 * t + 8] = root @ A, -root
    return G


def _gram(root: Floats) -> Floats:
    """G^T G with the matrix G of [Rahimi] Eq. 3, for the root (4, 4) of a process noise."""
    G = _rows(root)
    return np.asarray(G.T @ G)


def _sparse() -> float:
    """Return the share of rows with two nonzero entries in the Jacobian J ([Rahimi] Sec. 5).

    J consists of the rows of G (Eq. 3), with three entries for a position and two for a velocity, and of one row of a
    bearing at each time, with two.
    """
    two = list(np.count_nonzero(_rows(np.diag(1.0 / np.sqrt(np.diag(NOISE)))), axis=1) == 2)
    # A bearing has the gradients by the two coordinates of its position
    return float(np.mean([*two, *[True] * STEPS]))


EQUATIONS = Experiment(
    item="equations",
    title="What bearings determine, and the printed equations",
    x_label="statement",
    y_label="quantity",
    runs=1,
    steps=1000,
    quick=(1, 100),
    compute=equations,
    judge=functools.partial(v.judge_exactly, STATEMENTS),
    note="Without noise; steps are random targets.",
)
