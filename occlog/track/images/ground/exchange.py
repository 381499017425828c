"""Targets that may have taken each other's identities.

Trackers that are on another target together agree with each other, so that one time alone does
not show it.  But they mostly get there one by one, through times at which views contradict each
other or at which all but one have lost the target.  While that lasts, a target is exchanged at a
constant rate; from then on it may be where any of the other targets is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints

CONTESTED = 0.5
"""Views contradict each other if one of them is on something else with at least this probability."""
LONGEST_S = 1.0
"""Longer times without a row count as this long [s]."""


class Known(NamedTuple):
    """What was known of a target when it had its last row."""

    t_ns: int
    exchanged: float  # probability
    together: bool  # several views have shown it at once


class Exchanges:
    """Probability that each target was exchanged, carried from time to time."""

    def __init__(self, rate: float, alone: float, start: float) -> None:
        """No target was seen yet.

        Args:
            rate: of exchanges where views contradict each other [1/s].
            alone: share of it where one view alone shows a target that several have shown before.
            start: probability that the trackers of a target begin on different ones.
        """
        self._rate, self._alone, self._start = rate, alone, start
        self._known: dict[int, Known] = {}

    def update(self, t_ns: int, targets: Ints, contested: Floats, views: Ints) -> Floats:
        """(K,) probabilities that the targets of one time have been exchanged.

        Args:
            t_ns: the time.
            targets: (K,) identities, each once.
            contested: (K,) probability that a view is on something else.
            views: (K,) number of views that show them.
        """
        out = np.zeros(len(targets))
        rows = zip(targets.tolist(), contested.tolist(), views.tolist(), strict=True)
        for k, (target, doubt, several) in enumerate(rows):
            last = self._known.get(target, Known(t_ns, self._start, False))
            seconds = min((t_ns - last.t_ns) / NS, LONGEST_S)
            contradiction = doubt if doubt >= CONTESTED else 0.0
            left_alone = self._alone if last.together else 0.0
            strength = contradiction if several > 1 else left_alone
            out[k] = 1.0 - (1.0 - last.exchanged) * np.exp(-self._rate * strength * seconds)
            self._known[target] = Known(t_ns, float(out[k]), last.together or several > 1)
        return out


def among_others(xyz: Floats, covariance: Floats, exchanged: Floats) -> Floats:
    """(K, 3, 3) second moments about the places of one time, of targets that may be where the others are.

    Args:
        xyz: (K, 3) places.
        covariance: (K, 3, 3) of them.
        exchanged: (K,) probability that a target is at one of the other places, each as likely.
    """
    off = xyz[None, :, :] - xyz[:, None, :]
    spread = np.einsum("kni,knj->kij", off, off) / max(len(xyz) - 1, 1)
    return np.asarray(covariance + exchanged[:, None, None] * spread)
