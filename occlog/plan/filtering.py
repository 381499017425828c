"""The expected error of a filter at the end of each way, for many targets at a time.

The filter knows that people walk straight on and turn now and then (`occlog.plan.hypotheses`).  How often they turn,
how fast they are and the noise of their places is that of the walk (`occlog.plan.moments`).  Between turns it expects
as much noise as the trackers of occlog do by their defaults, and is worse for it where the walk has less.  None can
know where the target wants to go, as the posterior bound of `occlog evaluate` does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from .hypotheses import StepNoise, follow

BLOCK = 1_000_000
"""Places times cells that are summed at a time."""
LEAST = 1e-18
"""Least variance of a velocity after a turn, so that logarithms stay finite where nobody moves."""


class Motion(NamedTuple):
    """The second moments of a walk; how they are counted is in `occlog.plan.moments`."""

    speed: float  # root mean square of the velocity, per second
    turns: float  # how often a second the velocity is forgotten
    sigma: float  # noise of the place per axis, gathered in a second


class Belief(NamedTuple):
    """Noise that a filter expects between turns, per axis, gathered in a second; at least that of the walk counts."""

    sigma_v: float  # of the place
    sigma_a: float  # of the velocity


class Reports(NamedTuple):
    """What is told of N targets at T steps."""

    information: Floats  # (3, N, T) xx, xy, yy of the Fisher information I of each step about the place
    noise: Floats  # (2, N, T) the error of what is told, in units of I times a place; its covariance is I


class Expected(NamedTuple):
    """Where a filter thinks that N targets are, and how its errors are spread, at K steps."""

    place: Floats  # (N, K, 2)
    covariance: Floats  # (N, K, 2, 2)


def noise_of(information: Floats, chance: Floats) -> Floats:
    """(2, N, T) errors of what is told, from (2, N, T) standard normals: a root of the information times these."""
    xx, xy, yy = information
    root = np.sqrt(xx)
    across = np.divide(xy, root, out=np.zeros_like(xy), where=root > 0.0)
    left = np.sqrt(np.maximum(yy - across**2, 0.0))
    return np.stack([root * chance[0], across * chance[0] + left * chance[1]])


def errors_along(
    ways: Floats,
    reports: Reports,
    start: tuple[Floats, Floats],
    motion: Motion,
    belief: Belief,
    dt: float,
    keep: int = 1,
) -> Expected:
    """What a filter makes of what is told of targets on their ways, at the last `keep` steps.

    Args:
        ways: (N, T, 2) places.
        reports: what is told of them.
        start: (2,) mean and (2, 2) covariance of the place where nothing was seen yet.
        motion: of the targets.
        belief: of the filter.
        dt: between steps [s].
        keep: 1 to T.
    """
    fresh = max(0.5 * motion.speed**2, LEAST)
    place, spread = follow(
        np.ascontiguousarray(ways),
        np.ascontiguousarray(reports.information),
        np.ascontiguousarray(reports.noise),
        np.ascontiguousarray(start[0]),
        np.ascontiguousarray(start[1]),
        -math.expm1(-motion.turns * dt),
        step_noise(max(belief.sigma_v, motion.sigma), belief.sigma_a, fresh, dt),
        step_noise(motion.sigma, 0.0, fresh, dt),
        dt,
        keep,
    )
    return Expected(place, spread[..., [[0, 1], [1, 2]]])


def step_noise(sigma: float, sigma_a: float, fresh: float, dt: float) -> StepNoise:
    """Noise of a step: of the place, and of the velocity as of white acceleration."""
    q = sigma_a**2
    return StepNoise(sigma**2 * dt + q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt, fresh)


def square_error_in_room(covariance: Floats, at: Floats, floor: Floats, size: Floats) -> Floats:
    """Mean square error where the filter knows that the target is on the floor: of a normal, cut off where it ends.

    Summed over cells of the floor; a normal narrower than a cell is as it is.

    Args:
        covariance: (N, 2, 2) of places, positive definite.
        at: (N, 2) their means.
        floor: (C, 2) middles of the cells of the floor.
        size: (2,) sides of a cell.

    Returns:
        (N,); never above the trace of the covariance.
    """
    out = np.trace(covariance, axis1=1, axis2=2).copy()
    wide = np.flatnonzero(out > float(size @ size) / 4.0)
    grain = np.diag(size**2 / 12.0)  # so that a normal that is thin across the cells is not lost between them
    for rows in np.array_split(wide, max(1, len(wide) * len(floor) // BLOCK)):
        off = floor - at[rows, None]
        exponent = -0.5 * np.einsum("nci,nij,ncj->nc", off, np.linalg.inv(covariance[rows] + grain), off)
        weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        mean = np.einsum("nc,nci->ni", weight, off)
        cut = np.einsum("nc,nci,nci->n", weight, off, off) - np.sum(mean**2, axis=1)
        out[rows] = np.minimum(out[rows], cut)
    return np.asarray(out)
