"""GOSPA: distance between the set of targets and the set of estimates of each frame.

Rahmathullah, Garcia-Fernandez and Svensson 2017, "Generalized optimal sub-pattern assignment metric".

OSPA(2): one distance between the set of true trajectories and the set of tracks, over a window of time.

Beard, Vo and Vo 2020, "A solution for large-scale multi-object tracking", IEEE Trans. Signal Processing 68, Sec. IV.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints
from occlog.core.numerics.assignment import maximum_weight_matching

from ..errors import Sum
from .frame_pairs import MatchedFrames, TargetTrackSums


class Gospa(NamedTuple):
    """GOSPA and its parts by frame, (T,) each; localisation + missed + false = gospa^p.

    Attributes:
        frame: number of each frame.
        view: number of its view.
        gospa: the metric, unit of the distance.
        localisation: sum of d^p of the pairs, unit^p.
        missed: c^p / alpha for each target without an estimate, unit^p.
        false: c^p / alpha for each estimate without a target, unit^p.
        n_missed: number of targets without an estimate.
        n_false: number of estimates without a target.
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
        """Return means over frames of GOSPA and of its parts (p-th powers), and of the parts together.

        Keys: `gospa`, `localisation`, `missed`, `false`, and `power_mean`: (sum of the means of the three parts)^(1/p).

        Args:
            frames: number of frames to divide by, if some have neither target nor estimate; None: those of this object.
        """
        sums = GospaSums(self.p)
        sums.update(self)
        return sums.means(len(self.frame) if frames is None else frames)


class GospaSums:
    """Sums of GOSPA and of its three parts over the frames of a recording, added part by part."""

    def __init__(self, p: float) -> None:
        """Start without frames; p is the exponent (order) of the metric."""
        self._p = p
        self._sums = {name: Sum() for name in ("gospa", "localisation", "missed", "false")}

    def update(self, part: Gospa) -> None:
        """Add the GOSPA of the frames of a part."""
        for name, found in self._sums.items():
            found.add(float(np.sum(getattr(part, name))))

    def merge(self, other: GospaSums) -> None:
        """Add the sums of another recording."""
        for name, found in self._sums.items():
            found.merge(other._sums[name])

    def means(self, frames: int) -> dict[str, float]:
        """Return the means over a number of frames, by name: `gospa`, `localisation`, `missed`, `false`, `power_mean`.

        The parts are p-th powers; `power_mean` is (sum of the means of the three parts)^(1/p).
        """
        values = {name: found.value / max(frames, 1) for name, found in self._sums.items()}
        return {**values, "power_mean": sum(list(values.values())[1:]) ** (1.0 / self._p)}


def gospa(frames: MatchedFrames, cutoff: float, p: float = 2.0, alpha: float = 2.0) -> Gospa:
    """Return the GOSPA of each frame from its distances (1 - IoU, or length).

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


class Ospa2(NamedTuple):
    """OSPA(2) and its parts, in the unit of distance; ospa2^p = localisation^p + cardinality^p.

    Attributes:
        ospa2: the metric, 0 to the cutoff.
        localisation: part of the trajectories that have a partner; it holds their gaps, and false rows of the partner.
        cardinality: part of the trajectories that have none.
    """

    ospa2: float
    localisation: float
    cardinality: float


def ospa2(frames: MatchedFrames, cutoff: float, p: float = 1.0) -> Ospa2:
    """Return OSPA(2) over all frames as one window.

    The distance of a true trajectory f and a track g is a mean over the frames in which at least one of them is there:
    d(f, g)^p = mean of [min(distance, c)^p where both are there, c^p where one is].  With n >= m trajectories on the
    two sides, ospa2^p = (min over assignments of the sum of d(f, g)^p + c^p (n - m)) / n; it is 0 where both are empty.

    Args:
        frames: truth and tracks.
        cutoff: largest distance that counts, c > 0, unit of the distance.
        p: exponent of both means, >= 1.

    Raises:
        ValueError: an option is outside its range.
    """
    sums = Ospa2Sums(len(frames.truth_key), len(frames.track_key), cutoff, p)
    sums.update(frames)
    return sums.result()


class _FrameCounts(NamedTuple):
    """Contribution of one frame to the sums of OSPA(2).

    Number of the frame, numbers (n,) of its targets and (m,) of its tracks, and (n, m) p-th powers of their distances,
    limited to the cutoff; (0, 0) if either is missing.
    """

    frame: int
    truth: Ints
    track: Ints
    distance: Floats


class Ospa2Sums:
    """Sums for OSPA(2): numbers of frames of each trajectory and of each couple, and summed distances of couples."""

    def __init__(self, targets: int, tracks: int, cutoff: float, p: float) -> None:
        """Start without frames.

        Args:
            targets: number of all targets.
            tracks: number of all tracks.
            cutoff: maximum distance of a match, > 0; also the cost of an unmatched pair of a target and a track.
            p: order of the metric, >= 1.

        Raises:
            ValueError: the cutoff or p is outside its range.
        """
        if not (0 < cutoff < np.inf and 1 <= p < np.inf):
            raise ValueError(f"cutoff {cutoff:g} must be above 0, p {p:g} at least 1")
        self._cutoff, self._p = cutoff, p
        self._truth: Ints = np.zeros(targets, dtype=np.int64)
        self._track: Ints = np.zeros(tracks, dtype=np.int64)
        self._couples = TargetTrackSums(targets, tracks, sums=2)

    def update(self, frames: MatchedFrames) -> None:
        """Add frames; target and track numbers are the same in all parts."""
        for t in range(len(frames.frame)):
            self.count(self.seen(frames, t), 1)

    def seen(self, frames: MatchedFrames, t: int) -> _FrameCounts:
        """Return the contribution of frame t, the input of `count`: targets, tracks, and powers of their distances.

        The p-th powers of distances are limited to that of the cutoff.
        """
        left, right = frames.rows(t)
        truth, track, distance = frames.truth[left], frames.track[right], np.zeros((0, 0))
        if len(truth) and len(track):
            distance = np.minimum(frames.compare(t)[0], self._cutoff) ** self._p
        return _FrameCounts(int(frames.frame[t]), truth, track, distance)

    def count(self, seen: _FrameCounts, sign: int) -> None:
        """Add (sign 1) or subtract (sign -1) the contribution of a frame, as `seen` returns it."""
        # No label comes twice in a frame, so nothing is added to twice.
        self._truth[seen.truth] += sign
        self._track[seen.track] += sign
        if seen.distance.size:
            n, m = seen.distance.shape
            together = np.stack([np.ones(n * m), seen.distance.reshape(-1)])
            self._couples.add(np.repeat(seen.truth, m), np.tile(seen.track, n), sign * together)

    def merge(self, other: Ospa2Sums) -> None:
        """Add another recording, with its targets and tracks numbered after these."""
        self._truth, self._track = (
            np.concatenate(sides) for sides in ((self._truth, other._truth), (self._track, other._track))
        )
        self._couples.merge(other._couples)

    def result(self) -> Ospa2:
        """Return OSPA(2) of the frames added so far; 0 without trajectories."""
        n, m, c = np.count_nonzero(self._truth), np.count_nonzero(self._track), self._cutoff**self._p
        if not n and not m:
            return Ospa2(0.0, 0.0, 0.0)
        target, track, (both, separation) = self._couples.all()
        together = both > 0
        target, track, both, separation = target[together], track[together], both[together], separation[together]
        each = self._truth[target] + self._track[track]
        # Base distance of each pair: mean over the frames in which one of them is there; c of those never together
        base = (np.maximum(separation, 0.0) + c * (each - 2 * both)) / (each - both)
        made = maximum_weight_matching(target, track, c - base)
        total = float(base[made].sum()) + c * (min(n, m) - len(made))
        # Cardinality: c^p for each trajectory without a partner
        localisation, cardinality = total / max(n, m), c * abs(n - m) / max(n, m)
        root = 1.0 / self._p
        return Ospa2((localisation + cardinality) ** root, localisation**root, cardinality**root)


class Ospa2Windows:
    """OSPA(2) over sliding windows of a number of frames, over a stream."""

    def __init__(self, targets: int, tracks: int, cutoff: float, p: float, window: int) -> None:
        """Start without frames.

        Args:
            targets: number of all targets.
            tracks: number of all tracks.
            cutoff: maximum distance of a match, > 0; also the cost of an unmatched pair of a target and a track.
            p: order of the metric, >= 1.
            window: number of frames in a window.

        Raises:
            ValueError: the cutoff or p is outside its range.
        """
        self._sums, self._window = Ospa2Sums(targets, tracks, cutoff, p), window
        self._within: deque[_FrameCounts] = deque()

    def update(self, frames: MatchedFrames, ends: Iterable[int]) -> Iterator[Ospa2]:
        """Generate OSPA(2) of the windows that end at the frame numbers `ends` (increasing).

        `frames` are the next part of the stream.
        """
        t = 0
        for end in ends:
            while t < len(frames.frame) and frames.frame[t] <= end:
                self._within.append(self._sums.seen(frames, t))
                self._sums.count(self._within[-1], 1)
                t += 1
            while self._within and self._within[0].frame <= end - self._window:
                self._sums.count(self._within.popleft(), -1)
            yield self._sums.result()
