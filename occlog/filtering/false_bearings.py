"""The probability that a labelled bearing is false, learned from the bearings so far."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

PRIOR_BEARINGS = 20.0
"""Weight of the initial probability, in bearings."""
MAX_FALSE_PROBABILITY = 0.5
"""Largest probability that is learned."""


class FalseBearings(NamedTuple):
    """How many of a target's bearings were false: a Beta distribution of their probability, less its prior."""

    false: float = 0.0  # expected number
    bearings: int = 0

    def probability(self, initial: float) -> float:
        """Posterior mean, where the prior has mean `initial`; 0 stays 0."""
        learned = (initial * PRIOR_BEARINGS + self.false) / (PRIOR_BEARINGS + self.bearings)
        return min(learned, MAX_FALSE_PROBABILITY) if initial > 0.0 else 0.0

    def counted(self, inlier: Floats) -> FalseBearings:
        """Count bearings with these (n,) probabilities of being true."""
        return FalseBearings(self.false + float(np.sum(1.0 - inlier)), self.bearings + len(inlier))
