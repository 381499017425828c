"""Probability that a labelled bearing is false, estimated online."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

PRIOR_BEARINGS = 20.0
"""Weight of the initial probability, in bearings."""
MAX_FALSE_PROBABILITY = 0.5
"""Largest probability that is learned."""


class FalseBearings(NamedTuple):
    """Beta posterior of the probability that a target's bearings are false, without its prior."""

    false: float = 0.0  # expected number
    bearings: int = 0

    def probability(self, initial: float) -> float:
        """Posterior mean for a prior with mean `initial`; 0 stays 0."""
        learned = (initial * PRIOR_BEARINGS + self.false) / (PRIOR_BEARINGS + self.bearings)
        return min(learned, MAX_FALSE_PROBABILITY) if initial > 0.0 else 0.0

    def counted(self, inlier: Floats) -> FalseBearings:
        """Add bearings with inlier probabilities (n,)."""
        return FalseBearings(self.false + float(np.sum(1.0 - inlier)), self.bearings + len(inlier))
