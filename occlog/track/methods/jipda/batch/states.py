"""Leave-one-out states of tracks at every time step: from all nodes but that of the time step itself.

Beyond the first and last node, existence decreases with each frame without a detection. Time steps may be unequally
spaced; during a pause of the recording people arrive and leave unobserved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..interface import STATE_SIZE
from ..kernels.linear import invert
from ..target_set import CONSTANT_VELOCITY
from .gaussian_messages import predict, predict_backwards
from .mcmc_association import NO_NODE, MarkovChainState, TrackletNodes, WalkModel, missed_run


class States(NamedTuple):
    """Leave-one-out states of tracks at time steps: K rows, sorted by time step, then by track.

    `track` and time `step` (K,); nodes (K,): `head` the first of the track, `node` at the time step, `last` before and
    `next` after it (`NO_NODE`: none); `mean` (K, 6) x, y, vx, vy, height, width and `covariance` (K, 6, 6), from all
    nodes of the track but that of the time step.
    """

    track: Ints  # (K,) number of the track, in the order of first positions
    step: Ints  # (K,)
    head: Ints  # (K,) first position of the track
    node: Ints  # (K,) position at the time step; NO_NODE
    last: Ints  # (K,) position before the time step; NO_NODE
    next: Ints  # (K,) position after it; NO_NODE
    mean: Floats  # (K, 6) by all positions but that of the time step
    covariance: Floats  # (K, 6, 6)

    def taken(self, rows: Ints) -> States:
        """Return the rows selected by a mask (K,) or by indices."""
        return States(*(np.asarray(getattr(self, name))[rows] for name in self._fields))

    @property
    def inside(self) -> Bools:
        """(K,) mask of rows from the first to the last node (tracklet) of their track, inclusive."""
        return np.asarray((self.node != NO_NODE) | ((self.last != NO_NODE) & (self.next != NO_NODE)))


def states(
    nodes: TrackletNodes, walk: WalkModel, chain: MarkovChainState, time: Floats, first: Ints, last: Ints
) -> States:
    """Return the leave-one-out states of all tracks at all time steps, extended beyond both ends.

    Args:
        nodes: n nodes of the chain.
        walk: motion model of people.
        chain: links and messages of the nodes.
        time: (T,) times of the time steps [s].
        first: (T,) for each time step, index of the step from which a track with its first node there is returned.
        last: (T,) for each time step, index of the step up to which a track with its last node there is returned.
    """
    rows = States(*_states(nodes, walk, chain, time, first, last))
    order = np.lexsort((rows.track, rows.step))
    return rows.taken(order)


@kernel
def _count_states(nodes: TrackletNodes, chain: MarkovChainState, first: Ints, last: Ints) -> int:
    """Return the number of (track, time step) pairs of all tracks in the chain, with the extensions at both ends.

    `first` and `last` (T,) are the first and last time step of a track that begins or ends at each time step.
    """
    count = 0
    for k in range(nodes.step.shape[0]):
        if chain.used[k] and chain.before[k] == NO_NODE:
            j = k
            while chain.after[j] != NO_NODE:
                j = chain.after[j]
            count += last[nodes.step[j]] - first[nodes.step[k]] + 1
    return count


@kernel
def _states(
    nodes: TrackletNodes, walk: WalkModel, chain: MarkovChainState, time: Floats, first: Ints, last: Ints
) -> tuple[Ints, Ints, Ints, Ints, Ints, Ints, Floats, Floats]:
    """Return the columns of `States` in their order (track, step, head, node, last, next, mean, covariance), by track.

    Each state is the product of the forward prediction from the last node before the time step, or the prior of a new
    track, and the backward message from the next node after it.

    Args:
        nodes: n nodes of the chain.
        walk: motion model of people.
        chain: links and messages of the nodes.
        time: (T,) times of the time steps [s].
        first: (T,) first time step of a track with its first node at each time step.
        last: (T,) last time step of a track with its last node at each time step.
    """
    K = _count_states(nodes, chain, first, last)
    track, step, heads = np.empty(K, np.int64), np.empty(K, np.int64), np.empty(K, np.int64)
    node, past, coming = np.empty(K, np.int64), np.empty(K, np.int64), np.empty(K, np.int64)
    mean, covariance = np.empty((K, STATE_SIZE)), np.empty((K, STATE_SIZE, STATE_SIZE))
    m, P, J, h = (
        np.empty(STATE_SIZE),
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty(STATE_SIZE),
    )
    information, vector = np.empty((STATE_SIZE, STATE_SIZE)), np.empty(STATE_SIZE)
    row, count = 0, 0
    for head in range(nodes.step.shape[0]):
        if not (chain.used[head] and chain.before[head] == NO_NODE):
            continue
        tail = head
        while chain.after[tail] != NO_NODE:
            tail = chain.after[tail]
        i, j = NO_NODE, head  # the last position before the time step, the next one at or after it
        for t in range(first[nodes.step[head]], last[nodes.step[tail]] + 1):
            here = NO_NODE
            if j != NO_NODE and nodes.step[j] == t:
                here = j
                j = chain.after[j]
            # Forward: the filter's prediction; before the first position the prior of a new target
            information[:] = 0.0
            vector[:] = 0.0
            if i != NO_NODE:
                drift = walk.drift[chain.model[i]]
                predict(chain.mean[i], chain.covariance[i], time[t] - nodes.time[i], drift, m, P)
                invert(P, information)
                vector[:] = information @ m
            else:
                for a in range(2, STATE_SIZE):
                    information[a, a] = walk.prior[a]
                    vector[a] = walk.prior[a] * walk.mean[a]
                # Anywhere within reach of the maximum speed in a thousand seconds
                for a in range(2):
                    information[a, a] = 1e-6 / (walk.speed * walk.speed)
                    vector[a] = information[a, a] * nodes.at[head, a]
            # Backward: the information of everything after the time step
            if j != NO_NODE:
                drift = walk.drift[chain.model[i] if i != NO_NODE else CONSTANT_VELOCITY]
                predict_backwards(chain.J[j], chain.h[j], 0.0, nodes.time[j] - time[t], drift, J, h)
                information += J
                vector += h
            track[row], step[row], heads[row] = count, t, head
            node[row], past[row], coming[row] = here, i, j
            invert(information, covariance[row])
            mean[row] = covariance[row] @ vector
            if here != NO_NODE:
                i = here
            row += 1
        count += 1
    return track, step, heads, node, past, coming, mean, covariance


MIN_MISS_PROBABILITY = 1e-4
"""A person with a lower probability of that many missed detections is taken as gone."""
MIN_DEATH_RATE = 1e-9
"""Lower limit of the death rate of targets [1/s]."""


@kernel
def dwell_times(
    time: Floats, frame_counts: Floats, step_index: Ints, miss: Floats, hiding: Floats, rate: Floats, step: int
) -> tuple[Floats, Floats]:
    """Return how long a person is expected to be present, but missed in all frames, before or after a node.

    Args:
        time: (T,) times of the time steps [s].
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        step_index: (n,) time step of each node.
        miss: (n, C) log of the probability that a camera misses the person there in plain view.
        hiding: (C, 2) probabilities that a person becomes hidden, and visible again, by the camera's next frame.
        rate: (n,) rate [1/s] at which the person leaves or, back in time, has come.
        step: -1: before the node; 1: after it.

    Returns:
        Expected time (n,) [s], and the probability (n,) of being present and missed until the end (or since the
        beginning) of the recording.
    """
    n, T = step_index.shape[0], time.shape[0]
    total, rest = np.zeros(n), np.zeros(n)
    for k in range(n):
        leaves = max(rate[k], MIN_DEATH_RATE)
        t, here, there = step_index[k], 1.0, 1.0
        while 0 <= t + step < T:
            gone = -math.expm1(-leaves * abs(time[t + step] - time[t]))
            total[k] += there * gone / leaves
            t += step
            here *= 1.0 - gone
            there = here
            for c in range(miss.shape[1]):
                count = abs(frame_counts[t + (step + 1) // 2, c] - frame_counts[step_index[k] + (step + 1) // 2, c])
                plain, hidden = missed_run(count, math.exp(miss[k, c]), hiding[c, 0], hiding[c, 1])
                there *= plain + hidden
            if there < MIN_MISS_PROBABILITY:
                there = 0.0
                break
        rest[k] = there
    return total, rest
