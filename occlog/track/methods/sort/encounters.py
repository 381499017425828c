"""Where two people may have been exchanged: the assignment of boxes the other way round is nearly as likely."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.track.methods.jipda.interface import Event

MIN_PROBABILITY = 0.2
"""Less probable exchanges are not named."""
NEAR_PROBABILITY = 0.02
"""Two people are at an encounter while an exchange is more probable than this."""
TEMPER = 0.5
"""Power of likelihood ratios in probabilities: errors of boxes and of colours last from frame to frame, so that sums of
logarithms over frames state too much.  Fitted to simulated walkers and WILDTRACK (docs/explanation/trackers)."""
OVER_S = 1.0
"""An encounter is over when no exchange was possible for this long [s]."""


class Encounters:
    """Pairs of people of one camera who are near each other, with the probability that their identities are exchanged.

    An encounter ends when no exchange was possible for `OVER_S`.
    """

    def __init__(self) -> None:
        """Start without ongoing encounters."""
        self._going_on: dict[tuple[int, int], list[float]] = {}

    def add(self, t_ns: int, ids: Ints, ratio: Floats, target: Ints, box: Ints) -> Iterator[Event]:
        """Add a frame, and generate the events of the encounters that have ended by it.

        An event is a possible identity switch with the largest probability in the encounter, once for each of the two.

        Args:
            t_ns: time of the frame [ns].
            ids: (N,) identities of the tracks; -1: not confirmed.
            ratio: (N, M) log likelihood ratios of tracks and boxes.
            target: (k,) indices of the tracks with a box.
            box: (k,) index of each such track's box.
        """
        for a, b, probability in exchanges(ids, ratio, target, box):
            pair = (min(a, b), max(a, b))
            largest = self._going_on.get(pair, [0.0, 0.0])[0]
            self._going_on[pair] = [max(largest, probability), float(t_ns)]
        over = [pair for pair, (_, last) in self._going_on.items() if t_ns - last > OVER_S * NS]
        for pair in over:
            yield from _events(pair, self._going_on.pop(pair)[0])

    def finish(self) -> Iterator[Event]:
        """End all ongoing encounters, and generate their events."""
        for pair, (probability, _) in self._going_on.items():
            yield from _events(pair, probability)
        self._going_on = {}


def exchanges(ids: Ints, ratio: Floats, target: Ints, box: Ints) -> list[tuple[int, int, float]]:
    """Return pairs of identities with the probability that their boxes are exchanged, above `NEAR_PROBABILITY`.

    One of the two may have no box: then the other's box may be its own.

    Args:
        ids: (N,) identities of the tracks; -1: not confirmed, omitted.
        ratio: (N, M) log likelihood ratios of tracks and boxes.
        target: (k,) indices of the tracks with a box.
        box: (k,) index of each such track's box.
    """
    known = np.flatnonzero(ids >= 0)
    if len(known) < 2:
        return []
    assigned = np.full(len(ids), -1, dtype=np.int64)
    assigned[target] = box
    mine = assigned[known]
    own = np.where(mine >= 0, ratio[known, mine] if ratio.shape[1] else 0.0, 0.0)
    crossed = np.where(mine[None, :] >= 0, ratio[np.ix_(known, mine)] if ratio.shape[1] else 0.0, 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        loss = own[:, None] + own[None, :] - crossed - crossed.T
        probability = tempered(loss)
    some = (mine[:, None] >= 0) | (mine[None, :] >= 0)
    first, second = np.nonzero(np.triu(some & (probability > NEAR_PROBABILITY), 1))
    return [
        (int(ids[known[i]]), int(ids[known[j]]), float(probability[i, j]))
        for i, j in zip(first.tolist(), second.tolist(), strict=True)
    ]


def tempered(loss: Floats) -> Floats:
    """Return the probability of an alternative that is less likely by the log likelihood ratio `loss` (any shape).

    The ratio is halved before (`TEMPER`), as errors of boxes last from frame to frame.
    """
    with np.errstate(over="ignore"):
        return np.asarray(1.0 / (1.0 + np.exp(TEMPER * loss)))


def _events(pair: tuple[int, int], probability: float) -> list[Event]:
    """Return the possible identity switch of a pair as an event of both people; none below `MIN_PROBABILITY`."""
    if probability < MIN_PROBABILITY:
        return []
    return [Event("possible_switch", a, b, probability) for a, b in (pair, pair[::-1])]
