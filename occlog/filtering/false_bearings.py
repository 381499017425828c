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
    """Statistics of a target's bearings: expected number of false ones, and number of all.

    With a Beta prior they give the probability that a bearing is false.
    """

    false: float = 0.0  # expected number
    bearings: int = 0

    def probability(self, initial: float) -> float:
        """Return the posterior mean of the probability that a bearing is false, for a prior with mean `initial`.

        It is at most `MAX_FALSE_PROBABILITY`; 0 stays 0.
        """
        learned = (initial * PRIOR_BEARINGS + self.false) / (PRIOR_BEARINGS + self.bearings)
        return min(learned, MAX_FALSE_PROBABILITY) if initial > 0.0 else 0.0

    def counted(self, inlier: Floats) -> FalseBearings:
        """Return the statistics with n more bearings, of which `inlier` (n,) are the probabilities to be true."""
        return FalseBearings(self.false + float(np.sum(1.0 - inlier)), self.bearings + len(inlier))
