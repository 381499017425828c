"""GOSPA: one distance between the set of targets and the set of estimates of each frame.

Rahmathullah, Garcia-Fernandez and Svensson 2017, "Generalized optimal sub-pattern assignment metric".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints

from ..sums import Sum
from .frame_pairs import Frames


class Gospa(NamedTuple):
    """The metric by frame, (T,) each; localisation + missed + false = gospa^p.

    Attributes:
        frame: number of each frame.
        view: its view.
        gospa: the metric, unit of the distance.
        localisation: sum of d^p of the pairs, unit^p.
        missed: part of the targets without an estimate, unit^p.
        false: part of the estimates without a target, unit^p.
        n_missed: number of those targets.
        n_false: number of those estimates.
        p: exponent.
    """

    frame: Ints
    view: Ints
    gospa: Floats
    localisation: Floats
    missed: Floats
    false: Floats
    n_missed: Ints
    n_false: Ints
    p: float

    def means(self, frames: int | None = None) -> dict[str, float]:
        """Mean over frames, and its parts (mean of their p-th powers) with `power_mean` = their sum^(1/p).

        Args:
            frames: number of frames to divide by, where some have neither target nor estimate; None: those given.
        """
        sums = GospaSums(self.p)
        sums.update(self)
        return sums.means(len(self.frame) if frames is None else frames)


class GospaSums:
    """GOSPA of frames that come in parts."""

    def __init__(self, p: float) -> None:
        """No frame yet; the exponent."""
        self._p = p
        self._sums = {name: Sum() for name in ("gospa", "localisation", "missed", "false")}

    def update(self, part: Gospa) -> None:
        """Some more frames."""
        for name, found in self._sums.items():
            found.add(float(np.sum(getattr(part, name))))

    def merge(self, other: GospaSums) -> None:
        """Take in the frames of another recording."""
        for name, found in self._sums.items():
            found.merge(other._sums[name])

    def means(self, frames: int) -> dict[str, float]:
        """Means over so many frames, as `Gospa.means` has them."""
        values = {name: found.value / max(frames, 1) for name, found in self._sums.items()}
        return {**values, "power_mean": sum(list(values.values())[1:]) ** (1.0 / self._p)}


def gospa(frames: Frames, cutoff: float, p: float = 2.0, alpha: float = 2.0) -> Gospa:
    """Compute GOSPA of each frame from its distances (1 - IoU, or length).

    gospa^p = min over assignments of [sum of min(d, c)^p of the pairs + c^p / alpha (n + m - 2 pairs)].

    With alpha = 2 a pair at the cutoff or beyond is one target missed and one false estimate.
    With another alpha it stays a pair that costs cutoff^p, as the definition has it, and
    only the surplus of one side counts as missed or false.

    Args:
        frames: truth and tracks.
        cutoff: largest distance that counts, c > 0, unit of the distance; for boxes at most 1.
        p: exponent, >= 1.
        alpha: in (0, 2].

    Raises:
        ValueError: an option is outside its range.
    """
    if not (0 < cutoff < np.inf and 1 <= p < np.inf and 0 < alpha <= 2):
        raise ValueError(f"cutoff {cutoff:g} must be above 0, p {p:g} at least 1, alpha {alpha:g} in (0, 2]")
    n, m = np.diff(frames.truth_start), np.diff(frames.track_start)
    pairs, localisation = np.zeros(len(n), dtype=np.int64), np.zeros(len(n))
    for t in frames.meeting():
        # Assign: least sum of min(d, c)^p
        block = np.minimum(frames.compare(t)[0], cutoff) ** p
        chosen = block[linear_sum_assignment(block)]
        # For alpha = 2 a pair at the cutoff costs as much as one missed and one false: it is no pair
        if alpha == 2:
            chosen = chosen[chosen < cutoff**p]
        pairs[t], localisation[t] = len(chosen), chosen.sum()
    # Cardinality: c^p / alpha for each target and each estimate without a pair
    price = cutoff**p / alpha
    total = localisation + price * (n - pairs) + price * (m - pairs)
    return Gospa(
        frame=frames.frame,
        view=frames.view,
        gospa=total ** (1.0 / p),
        localisation=localisation,
        missed=price * (n - pairs),
        false=price * (m - pairs),
        n_missed=n - pairs,
        n_false=m - pairs,
        p=p,
    )
