"""Particles of filters as rows of a table: a cloud of each target at each time, thinned so that it can be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import Ints
from occlog.filtering.particles import systematic_ancestors
from occlog.records.tables import Particles
from occlog.track.interface import Cloud

MOST = 200
"""Particles of one cloud."""


def thinned(cloud: Cloud, most: int = MOST) -> Cloud:
    """A cloud as it is, or of a larger one `most` particles of equal weight.

    Systematic resampling without a random number: of a weight w there come w * most particles, rounded up or down.
    Mean and covariance are kept but for what is left out between neighbours.
    """
    if len(cloud.weights) <= most:
        return cloud
    chosen = systematic_ancestors(cloud.weights, most, 0.5)
    return Cloud(cloud.xy[chosen], np.full(most, 1.0 / most))


def particle_rows(clouds: Sequence[tuple[int, int, Cloud]]) -> Particles:
    """The table of clouds, each with its time [ns] and target, in order."""
    if not clouds:
        return Particles.empty()
    sizes: Ints = np.array([len(cloud.weights) for _, _, cloud in clouds], dtype=np.int64)
    xy = np.concatenate([cloud.xy for _, _, cloud in clouds])
    return Particles.of(
        t_ns=np.repeat(np.array([t_ns for t_ns, _, _ in clouds], dtype=np.int64), sizes),
        target_id=np.repeat(np.array([target for _, target, _ in clouds], dtype=np.int32), sizes),
        particle=np.concatenate([np.arange(n, dtype=np.int32) for n in sizes.tolist()]),
        x=xy[:, 0],
        y=xy[:, 1],
        weight=np.concatenate([cloud.weights for _, _, cloud in clouds]),
    )
