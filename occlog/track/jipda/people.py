"""Everybody who is tracked, how they move between moments, and who is whose double."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Bools, Floats, Ints

from .config import JipdaConfig
from .interface import HEIGHT, NOBODY, WIDTH

GROWTH = 0.01
"""Standard deviation by which a body changes in a second, as a share of its size: how people carry themselves."""
SUREST = 1e-6
"""Nobody's existence is surer than this, nor their absence."""
DOUBLE = 0.5
"""Two people whose axes are nearer than so many widths are one."""


@dataclass(frozen=True)
class People:
    """N people, confirmed or not."""

    mean: Floats  # (N, 6) as `interface.Moment.mean`
    covariance: Floats  # (N, 6, 6)
    existence: Floats  # (N,)
    key: Ints  # (N,) number of the birth, rising; the identity once confirmed
    id: Ints  # (N,) NOBODY: not confirmed


def nobody() -> People:
    """No people."""
    none = np.zeros(0, dtype=np.int64)
    return People(np.zeros((0, 6)), np.zeros((0, 6, 6)), np.zeros(0), none, none)


def take(people: People, rows: Ints) -> People:
    """Some of the people."""
    return People(people.mean[rows], people.covariance[rows], people.existence[rows], people.key[rows], people.id[rows])


def join(people: People, more: People) -> People:
    """All of both."""
    return People(
        np.concatenate([people.mean, more.mean]),
        np.concatenate([people.covariance, more.covariance]),
        np.concatenate([people.existence, more.existence]),
        np.concatenate([people.key, more.key]),
        np.concatenate([people.id, more.id]),
    )


def predict(people: People, dt: float, leaving: float, config: JipdaConfig) -> People:
    """The people dt seconds later: nearly constant velocity with white acceleration.

    Args:
        people: at the last moment.
        dt: seconds, >= 0.
        leaving: rate at which people leave [1/s].
        config: spectral density of the acceleration.
    """
    F, Q, q = np.eye(6), np.zeros((6, 6)), config.acceleration
    # White acceleration, integrated (Bar-Shalom, Li and Kirubarajan 2001, Sec. 6.2.2)
    for place, velocity in ((0, 2), (1, 3)):
        F[place, velocity] = dt
        Q[place, place], Q[velocity, velocity] = q * dt**3 / 3.0, q * dt
        Q[place, velocity] = Q[velocity, place] = q * dt**2 / 2.0
    Q[HEIGHT, HEIGHT], Q[WIDTH, WIDTH] = (GROWTH * config.height) ** 2 * dt, (GROWTH * config.width) ** 2 * dt
    return replace(
        people,
        mean=people.mean @ F.T,
        covariance=F @ people.covariance @ F.T + Q,
        existence=np.clip(people.existence * math.exp(-dt * leaving), SUREST, 1.0 - SUREST),
    )


def doubles(people: People) -> Bools:
    """(N,) who stands where somebody stands who was confirmed before, or is likelier to exist."""
    out = np.zeros(len(people.key), dtype=np.bool_)
    apart = people.mean[:, None, :2] - people.mean[None, :, :2]
    near = np.triu(np.hypot(apart[..., 0], apart[..., 1]) < DOUBLE * people.mean[:, None, WIDTH], 1)
    rank = people.existence + (people.id != NOBODY)
    for a, b in np.argwhere(near):
        out[b if rank[a] >= rank[b] else a] = True
    return out
