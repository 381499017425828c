"""From how many particles of an earlier time those of a target come.

A target's range from a single array is hardly observable: particles that are drawn again and again by one bearing come
from fewer and fewer of those before, though each scan leaves most of them effective.  Noise of the motion makes new
places along the sight line, but only in time.  Until it has, a covariance of a few families is that of chance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

MADE_UP = 0.25
"""The motion has made up for lost families when its noise has this share of the variance along the widest axis."""


class Lineage(NamedTuple):
    """Families of a target's particles: those that come from one particle of the time when it began."""

    families: Ints  # (L,)
    since_s: float  # how long ago that was

    def drawn(self, rows: Ints, dt: float) -> Lineage:
        """The lineage of the particles (n,) `rows` of those a time dt [s] before."""
        return Lineage(self.families[rows], self.since_s + dt)

    def effective(self) -> float:
        """Effective number of families, 1 to L: L^2 / sum of their squared sizes."""
        sizes = np.bincount(self.families)
        return float(len(self.families) ** 2 / (sizes @ sizes))


def begun(particles: int) -> Lineage:
    """Each particle is a family of its own."""
    return Lineage(np.arange(particles), 0.0)


def made_up(lineage: Lineage, covariance: Floats, sigma_v: float) -> bool:
    """Whether the noise of the motion alone spreads particles as far as their covariance says, or nearly.

    White acceleration gives a place the variance sigma_v^2 t^3 / 3 per axis.

    Args:
        lineage: of the particles.
        covariance: (2, 2) of their places.
        sigma_v: noise of the velocity per axis, gathered in a second.
    """
    widest = float(np.linalg.eigvalsh(covariance)[-1])
    return bool(sigma_v**2 * lineage.since_s**3 / 3.0 >= MADE_UP * widest)
