"""Markov chain Monte Carlo data association of nodes to tracks (Oh, Russell and Sastry 2009).

A node holds the boxes of one person at one time step. A state of the chain is the successor of each node in its track.
Its probability is the product, over tracks, of initiation, marginal likelihood of the nodes under the motion model,
missed detections between them, similarity of their boxes (`appearance`), and termination. Nodes outside all tracks are
clutter and count 1, since the constant of a node is the log likelihood ratio to clutter. Three kinds of moves, each its
own reverse, reach every state:

* exchange of tails: the links i -> a and b -> j become i -> j and b -> a. If a, b or both are missing, it is an
  extension, a split or a merge;

* insertion or removal: a node of no track enters a track (before its first node, between two nodes, or after the last),
  or starts one; or it leaves its track;

* swap: two nodes of one time step exchange their places in tracks.

Moves are accepted with the Metropolis-Hastings ratio of probabilities to the power 1 / temperature. With the messages
of `gaussian_messages` a proposal costs two links; an accepted one updates the messages of the two tracks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel, kernel_part

from ..interface import STATE_SIZE
from ..target_set import CONSTANT_VELOCITY
from .appearance import AppearanceSums, AppearanceVectors, log_ratio_joined, sum_up
from .gaussian_messages import initial_density, log_integral, multiply_factor, predict, predict_backwards

NO_NODE = -1
"""Index instead of a position: no predecessor or no successor."""
IMPOSSIBLE = -1e300
MESSAGE_TOLERANCE_SIGMAS = 1e-7
"""Messages that change by less than this share of a standard deviation are the same."""
MOVE_THRESHOLDS = (0.6, 0.85)
"""Bounds of the shares of the three kinds of moves."""
LOG_RATIO_SAME_TRACKLET, LOG_RATIO_OTHER_TRACKLET = 2.0, -2.0
"""Log likelihood ratios of one identity, and of two, that a single-camera tracker gives two positions of one person,
or a position of the track and a box that may be the next."""
LOG_RATIO_SAME_FILTER_ID, LOG_RATIO_OTHER_FILTER_ID = 6.0, -6.0
"""Log likelihood ratios of filter identities of a camera's boxes at two positions; it saw time steps between that
the chain does not see."""


class TrackletNodes(NamedTuple):
    """n nodes of the Markov chain (the boxes of one person at one time step), sorted by time step; C cameras.

    Time `step` (n,) and `time` [s], floor position `at` (n, 2), measurement factor exp(c + h' s - s' J s / 2) relative
    to clutter as `J`, `h`, `c`; logs of probabilities: `miss` (n, C) of a missed detection there, `birth` (n,) density
    of an initiation [1/area], `death` (n,) of a termination; `hint` (n, 2 C) identities by single-camera trackers, then
    by the filter (`NO_NODE`: none), `life` (I, 2) first and last time [s] of each filter identity; appearance vectors.
    """

    step: Ints  # (n,) index of the time step
    time: Floats  # (n,) [s]
    at: Floats  # (n, 2) on the floor
    J: Floats  # (n, 6, 6) information about the state
    h: Floats  # (n, 6)
    c: Floats  # (n,) log likelihood ratio to clutter, with the rates of detection
    miss: Floats  # (n, C) log of the probability that the camera does not detect a person there
    birth: Floats  # (n,) log of the density of a new target that begins at it, a unit of area
    death: Floats  # (n,) log of the probability that it is a person's last position
    hint: Ints  # (n, 2 C) identities by a tracker in the camera's images, then by the filter; NO_NODE: none
    life: Floats  # (I, 2) first and last time of each identity of the filter [s]
    similar: AppearanceVectors


class WalkModel(NamedTuple):
    """Motion model of people, and prior of a new track.

    `drift` (3, 3) are process noise densities (acceleration, height, width) of constant velocity, manoeuvre and posture
    change, `often` (3,) the rates [1/s] at which the last two begin (0: never); `prior` and `mean` (6,) are precisions
    and means of a new state; `speed` is the greatest speed, `slack` a distance added to what it allows, `reach` the
    largest number of time steps from one node to the next, `stay` the mean dwell time [s].
    """

    drift: Floats  # (3, 3) of each motion model, as in `gaussian_messages.noise_of_walk`
    often: Floats  # (3,) how often in a second each but the first begins; 0: never
    prior: Floats  # (6,) precisions of a new target
    mean: Floats  # (6,) means of the same
    speed: float  # greatest speed
    slack: float  # distance beyond what the greatest speed allows
    reach: int  # time steps from one position to the next, at most
    stay: float  # how long people stay on average [s]
    hiding: (
        Floats  # (C, 2) probabilities, from a camera's frame to its next, that something hides a person, and no longer
    )


class LinkCandidates(NamedTuple):
    """Candidate links of n nodes as flat lists: entries first[k] to first[k + 1] - 1 of a list belong to node k.

    `next` has the possible successors (ascending), `last` the possible predecessors, and `neighbours` the near nodes of
    the same time step with which a node may be swapped; `first_next`, `first_last`, `first_neighbour` (n + 1,) index
    them.
    """

    first_next: Ints  # (n + 1,)
    next: Ints
    first_last: Ints  # (n + 1,)
    last: Ints
    first_neighbour: Ints  # (n + 1,)
    neighbours: Ints


class LinkCache(NamedTuple):
    """Cache of log link probabilities, by index in `LinkCandidates.next` (`link`), and of initiations (`begun`).

    An entry excludes the constants of its two messages. It is valid while the version numbers of these messages, stored
    with it (`earlier`, `later`; `first` of initiations), are those in the chain.
    """

    link: Floats  # by index in `LinkCandidates.next`
    earlier: Ints  # stamp of the forward message
    later: Ints  # stamp of the backward message
    begun: Floats  # (n,) of beginnings
    first: Ints  # (n,) stamp of the backward message


class MarkovChainState(NamedTuple):
    """State of the Markov chain over n nodes: links, motion models and messages; changed in place.

    `after` and `before` (n,) are the neighbours in a node's track (`NO_NODE`: none), `used` whether it is in a track,
    `model` the motion model until the next node. Forward messages: `mean` (n, 6), `covariance`, log likelihood `past`;
    backward messages: `J` (n, 6, 6), `h`, constant `future`. `earlier` and `later` count the updates of either message;
    `sums` are cumulative appearance sums.
    """

    after: Ints  # (n,) the next position of the track; NO_NODE
    before: Ints  # (n,)
    used: Bools  # (n,) whether it is in a track
    model: Ints  # (n,) of the motion before the next position
    mean: Floats  # (n, 6) forward messages
    covariance: Floats  # (n, 6, 6)
    past: Floats  # (n,) log likelihood of the track up to and with the position
    J: Floats  # (n, 6, 6) backward messages
    h: Floats  # (n, 6)
    future: Floats  # (n,) their constants
    earlier: Ints  # (n,) how often the forward message was rebuilt
    later: Ints  # (n,) the same of the backward one
    sums: AppearanceSums  # of the appearance of tracks


@kernel
def can_link(nodes: TrackletNodes, walk: WalkModel, i: int, j: int) -> bool:
    """Return whether node j can be the successor of node i in a track.

    It must be later by at most `walk.reach` time steps, and within the distance of the greatest speed plus
    `walk.slack`.
    """
    gap = nodes.step[j] - nodes.step[i]
    if gap < 1 or gap > walk.reach:
        return False
    far = walk.speed * (nodes.time[j] - nodes.time[i]) + walk.slack
    dx, dy = nodes.at[j, 0] - nodes.at[i, 0], nodes.at[j, 1] - nodes.at[i, 1]
    return bool(dx * dx + dy * dy <= far * far)


@kernel
def candidates(nodes: TrackletNodes, walk: WalkModel, neighbour_distance: float) -> LinkCandidates:
    """List the possible successors and predecessors of each node, and the near nodes of its time step.

    `neighbour_distance` is the largest distance of such a near node [scene unit].
    """
    n = nodes.step.shape[0]
    first_next, first_last, first_neighbour = (
        np.zeros(n + 1, np.int64),
        np.zeros(n + 1, np.int64),
        np.zeros(n + 1, np.int64),
    )
    for fill in range(2):
        if fill == 0:
            following, preceding, neighbour = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64)
        else:
            for k in range(n):
                first_next[k + 1] += first_next[k]
                first_last[k + 1] += first_last[k]
                first_neighbour[k + 1] += first_neighbour[k]
            following, preceding = np.empty(first_next[n], np.int64), np.empty(first_last[n], np.int64)
            neighbour = np.empty(first_neighbour[n], np.int64)
        count_last = np.zeros(n, np.int64)
        for i in range(n):
            count, n_neighbours = 0, 0
            j = i + 1
            while j < n and nodes.step[j] - nodes.step[i] <= walk.reach:
                if can_link(nodes, walk, i, j):
                    if fill == 1:
                        following[first_next[i] + count] = j
                        preceding[first_last[j] + count_last[j]] = i
                    count += 1
                    count_last[j] += 1
                j += 1
            for step in (-1, 1):
                j = i + step
                while 0 <= j < n and nodes.step[j] == nodes.step[i]:
                    dx, dy = nodes.at[j, 0] - nodes.at[i, 0], nodes.at[j, 1] - nodes.at[i, 1]
                    if dx * dx + dy * dy < neighbour_distance * neighbour_distance:
                        if fill == 1:
                            neighbour[first_neighbour[i] + n_neighbours] = j
                        n_neighbours += 1
                    j += step
            if fill == 0:
                first_next[i + 1], first_neighbour[i + 1] = count, n_neighbours
        if fill == 0:
            for i in range(n):
                first_last[i + 1] = count_last[i]
    return LinkCandidates(first_next, following, first_last, preceding, first_neighbour, neighbour)


def empty_link_cache(listed: LinkCandidates) -> LinkCache:
    """Return a cache of link probabilities without valid entries, for the links in `listed`."""
    pairs, n = len(listed.next), len(listed.first_next) - 1
    stamp = np.full(pairs, NO_NODE)
    return LinkCache(np.zeros(pairs), stamp, stamp.copy(), np.zeros(n), np.full(n, NO_NODE))


@kernel
def missed_run(count: float, miss: float, hide: float, appear: float) -> tuple[float, float]:
    """Probability that a camera misses a person, whom it has just detected, in each of its next `count` frames.

    A two-state Markov chain (Gilbert 1960): the person is in plain view, or hidden by something unknown and missed for
    certain. Without it (`hide` = 0) misses are independent.

    Args:
        count: number of frames, >= 0.
        miss: probability that a person in plain view is missed in a frame.
        hide: probability that a person in plain view is hidden in the next frame.
        appear: probability that a hidden person is in plain view in the next frame.

    Returns:
        The joint probabilities of these misses with plain view, and with hidden, in the last of the frames.
    """
    # M = [[miss (1 - hide), miss appear], [hide, 1 - appear]], to the power `count` by its eigenvalues
    a, d = miss * (1.0 - hide), 1.0 - appear
    half, mean = 0.5 * (a - d), 0.5 * (a + d)
    root = math.sqrt(half * half + miss * appear * hide)
    if count <= 0.0 or root == 0.0:
        return a**count, 0.0
    one, other = (mean + root) ** count, max(mean - root, 0.0) ** count
    share = 0.5 * (1.0 + half / root)
    return share * one + (1.0 - share) * other, 0.5 * hide / root * (one - other)


@kernel
def log_link_prior(nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, i: int, j: int) -> float:
    """Return the log probability of a link from node i to node j, without motion: survival, misses and identities.

    `frame_counts` (T + 1, C) is the number of frames of each camera before each time step; the frames between the nodes
    count as misses.
    """
    total: float = -(nodes.time[j] - nodes.time[i]) / walk.stay
    a, b = nodes.step[i] + 1, nodes.step[j]
    if b > a:
        for c in range(frame_counts.shape[1]):
            count = frame_counts[b, c] - frame_counts[a, c]
            if count > 0.0:
                hide, appear = walk.hiding[c, 0], walk.hiding[c, 1]
                plain, hidden = missed_run(count, math.exp(0.5 * (nodes.miss[i, c] + nodes.miss[j, c])), hide, appear)
                total += math.log(max((1.0 - hide) * plain + appear * hidden, 1e-300))
    for c in range(nodes.hint.shape[1]):
        if nodes.hint[i, c] != NO_NODE and nodes.hint[j, c] != NO_NODE:
            one, other = nodes.hint[i, c], nodes.hint[j, c]
            if c < frame_counts.shape[1]:
                total += LOG_RATIO_SAME_TRACKLET if one == other else LOG_RATIO_OTHER_TRACKLET
            elif one == other:
                total += LOG_RATIO_SAME_FILTER_ID
            elif nodes.life[one, 0] <= nodes.life[other, 1] and nodes.life[other, 0] <= nodes.life[one, 1]:
                # Who begins after the other has ended may be the same person, whom the filter lost
                total += LOG_RATIO_OTHER_FILTER_ID
    return total


@kernel
def joined(
    nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, i: int, mean: Floats, covariance: Floats, past: float,
    j: int, J: Floats, h: Floats, future: float,
) -> tuple[float, int]:  # fmt: skip
    """Return the log probability of the track in which node j follows node i, and the most probable motion in between.

    The motion is the index of constant velocity, manoeuvre or posture change. Termination is included in the backward
    message, initiation in the forward message.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        i: index of the earlier node.
        mean: (6,) of its forward message.
        covariance: (6, 6) of its forward message.
        past: log likelihood of its forward message.
        j: index of the later node.
        J: (6, 6) of its backward message.
        h: (6,) of its backward message.
        future: constant of its backward message.
    """
    m, P = np.empty(STATE_SIZE), np.empty((STATE_SIZE, STATE_SIZE))
    dt = nodes.time[j] - nodes.time[i]
    most, best = -np.inf, CONSTANT_VELOCITY
    for model in range(walk.often.shape[0]):
        if model != CONSTANT_VELOCITY and walk.often[model] == 0.0:
            continue
        predict(mean, covariance, dt, walk.drift[model], m, P)
        value = log_integral(m, P, J, h, future) + log_of_model(walk, dt, model)
        if value > most:
            most, best = value, model
    return past + log_link_prior(nodes, walk, frame_counts, i, j) + most, best


@kernel
def log_of_model(walk: WalkModel, dt: float, model: int) -> float:
    """Return the log probability that a manoeuvre (model 1) or posture change (2) begins within `dt` [s].

    For model 0, constant velocity, that none begins.
    """
    if model == CONSTANT_VELOCITY:
        return -float(np.sum(walk.often)) * dt
    return math.log(1.0 - math.exp(-walk.often[model] * dt))


@kernel
def log_link_probability(
    nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, chain: MarkovChainState, i: int, j: int
) -> float:
    """Return the log probability of the track in which node j follows node i, from the messages in `chain`.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        chain: forward message of i, backward message of j.
        i: earlier node; `NO_NODE`: the track starts at j.
        j: later node; `NO_NODE`: the track ends at i. 0 is returned if both are `NO_NODE`.
    """
    if i == NO_NODE and j == NO_NODE:
        return 0.0
    if i == NO_NODE:
        m, P = np.empty(STATE_SIZE), np.empty((STATE_SIZE, STATE_SIZE))
        begun = initial_density(walk.prior, walk.mean, chain.J[j], chain.h[j], chain.future[j], m, P)
        return float(nodes.birth[j] + begun)
    if j == NO_NODE:
        return float(chain.past[i] + nodes.death[i])
    value, _ = joined(
        nodes, walk, frame_counts, i, chain.mean[i], chain.covariance[i], chain.past[i],
        j, chain.J[j], chain.h[j], chain.future[j],
    )  # fmt: skip
    return value


@kernel
def cached_link(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    listed: LinkCandidates,
    known: LinkCache,
    chain: MarkovChainState,
    i: int,
    j: int,
) -> float:
    """Return the log probability of the track in which node j follows node i, from a cache that is updated in place.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: candidate links; j must be among those of i.
        known: cache; an entry is recomputed if one of its messages has changed since.
        chain: links and messages.
        i: earlier node; `NO_NODE`: the track starts at j.
        j: later node; `NO_NODE`: the track ends at i.
    """
    if j == NO_NODE:
        return log_link_probability(nodes, walk, frame_counts, chain, i, j)
    if i == NO_NODE:
        if known.first[j] != chain.later[j]:
            known.begun[j] = log_link_probability(nodes, walk, frame_counts, chain, i, j) - chain.future[j]
            known.first[j] = chain.later[j]
        return float(known.begun[j] + chain.future[j])
    # Bisection: the positions that may follow one rise
    low, high = listed.first_next[i], listed.first_next[i + 1]
    while low < high:
        middle = (low + high) // 2
        if listed.next[middle] < j:
            low = middle + 1
        else:
            high = middle
    if known.earlier[low] != chain.earlier[i] or known.later[low] != chain.later[j]:
        known.link[low] = log_link_probability(nodes, walk, frame_counts, chain, i, j) - chain.past[i] - chain.future[j]
        known.earlier[low], known.later[low] = chain.earlier[i], chain.later[j]
    return float(chain.past[i] + known.link[low] + chain.future[j])


@kernel
def forward_of(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    chain: MarkovChainState,
    i: int,
    k: int,
    model: int,
    mean: Floats,
    P: Floats,
) -> float:
    """Write the forward message of node k after node i (`NO_NODE`: k is the first); return its log likelihood.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        chain: has the forward message of node i; not changed.
        i: node before.
        k: index of the node.
        model: motion model between the two (0: constant velocity, 1: manoeuvre, 2: posture change).
        mean: (6,) written.
        P: (6, 6) covariance, written.
    """
    if i == NO_NODE:
        begun = initial_density(walk.prior, walk.mean, nodes.J[k], nodes.h[k], nodes.c[k], mean, P)
        return float(nodes.birth[k] + begun)
    dt = nodes.time[k] - nodes.time[i]
    predict(chain.mean[i], chain.covariance[i], dt, walk.drift[model], mean, P)
    past = chain.past[i] + log_link_prior(nodes, walk, frame_counts, i, k) + log_of_model(walk, dt, model)
    return float(past + multiply_factor(mean, P, nodes.J[k], nodes.h[k], nodes.c[k]))


@kernel
def log_insertion_probability(
    nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, chain: MarkovChainState, i: int, k: int, j: int
) -> float:
    """Return the log probability of the track in which node k lies between nodes i and j (`NO_NODE`: none).

    `frame_counts` (T + 1, C) is the number of frames of each camera before each time step; `chain` has the messages of
    i and j, and is not changed.
    """
    m, P = np.empty(STATE_SIZE), np.empty((STATE_SIZE, STATE_SIZE))
    model = CONSTANT_VELOCITY
    if i != NO_NODE:
        _, model = joined(
            nodes, walk, frame_counts, i, chain.mean[i], chain.covariance[i], chain.past[i],
            k, nodes.J[k], nodes.h[k], nodes.c[k],
        )  # fmt: skip
    past = forward_of(nodes, walk, frame_counts, chain, i, k, model, m, P)
    if j == NO_NODE:
        return float(past + nodes.death[k])
    value, _ = joined(nodes, walk, frame_counts, k, m, P, past, j, chain.J[j], chain.h[j], chain.future[j])
    return value


@kernel
def choose_motion(nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, chain: MarkovChainState, i: int) -> None:
    """Set `chain.model[i]`, the motion between node i and its successor, to the most probable model.

    Without a successor it is constant velocity; nothing is done for `NO_NODE`. `frame_counts` (T + 1, C) is the number
    of frames of each camera before each time step.
    """
    if i == NO_NODE:
        return
    j = chain.after[i]
    if j == NO_NODE:
        chain.model[i] = CONSTANT_VELOCITY
    else:
        _, chain.model[i] = joined(
            nodes, walk, frame_counts, i, chain.mean[i], chain.covariance[i], chain.past[i],
            j, chain.J[j], chain.h[j], chain.future[j],
        )  # fmt: skip


@kernel
def update_messages(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    chain: MarkovChainState,
    forward_at: int,
    backward_at: int,
) -> None:
    """Recompute forward messages from node `forward_at` on, and backward ones from `backward_at` back, in `chain`.

    Where a message no longer changes, only the constants of the rest are updated; `NO_NODE`: none is recomputed.
    `frame_counts` (T + 1, C) is the number of frames of each camera before each time step.
    """
    m, P = np.empty(STATE_SIZE), np.empty((STATE_SIZE, STATE_SIZE))
    k = forward_at
    while k != NO_NODE:
        i = chain.before[k]
        past = forward_of(
            nodes, walk, frame_counts, chain, i, k, chain.model[i] if i != NO_NODE else CONSTANT_VELOCITY, m, P
        )
        same = True
        for a in range(STATE_SIZE):
            moved = abs(m[a] - chain.mean[k, a]) / math.sqrt(P[a, a])
            widened = abs(P[a, a] - chain.covariance[k, a, a]) / P[a, a]
            if not (moved < MESSAGE_TOLERANCE_SIGMAS and widened < MESSAGE_TOLERANCE_SIGMAS):
                same = False
        more = past - chain.past[k]
        chain.mean[k], chain.covariance[k], chain.past[k] = m, P, past
        chain.earlier[k] += 1
        k = chain.after[k]
        if same:
            while k != NO_NODE:
                chain.past[k] += more
                k = chain.after[k]
    k = backward_at
    J, h = np.empty((STATE_SIZE, STATE_SIZE)), np.empty(STATE_SIZE)
    while k != NO_NODE:
        j = chain.after[k]
        if j == NO_NODE:
            J[:], h[:] = nodes.J[k], nodes.h[k]
            future = nodes.c[k] + nodes.death[k]
        else:
            dt = nodes.time[j] - nodes.time[k]
            future = predict_backwards(chain.J[j], chain.h[j], chain.future[j], dt, walk.drift[chain.model[k]], J, h)
            future += (
                nodes.c[k] + log_link_prior(nodes, walk, frame_counts, k, j) + log_of_model(walk, dt, chain.model[k])
            )
            J += nodes.J[k]
            h += nodes.h[k]
        same = True
        for a in range(STATE_SIZE):
            if not abs(J[a, a] - chain.J[k, a, a]) <= MESSAGE_TOLERANCE_SIGMAS * J[a, a]:
                same = False
            if not abs(h[a] - chain.h[k, a]) <= MESSAGE_TOLERANCE_SIGMAS * math.sqrt(max(J[a, a], 0.0)):
                same = False
        more = future - chain.future[k]
        chain.J[k], chain.h[k], chain.future[k] = J, h, future
        chain.later[k] += 1
        k = chain.before[k]
        if same:
            while k != NO_NODE:
                chain.future[k] += more
                k = chain.before[k]


@kernel
def insert_node(nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, chain: MarkovChainState, k: int) -> None:
    """Update the messages in `chain` after node k was linked into a track: its own, and those of other nodes.

    `frame_counts` (T + 1, C) is the number of frames of each camera before each time step.
    """
    i, j = chain.before[k], chain.after[k]
    if i != NO_NODE:
        # As if it were the last position, then with what follows
        _, chain.model[i] = joined(
            nodes, walk, frame_counts, i, chain.mean[i], chain.covariance[i], chain.past[i],
            k, nodes.J[k], nodes.h[k], nodes.c[k],
        )  # fmt: skip
    chain.past[k] = forward_of(
        nodes,
        walk,
        frame_counts,
        chain,
        i,
        k,
        chain.model[i] if i != NO_NODE else CONSTANT_VELOCITY,
        chain.mean[k],
        chain.covariance[k],
    )
    chain.earlier[k] += 1
    choose_motion(nodes, walk, frame_counts, chain, k)
    if j != NO_NODE:
        update_messages(nodes, walk, frame_counts, chain, j, NO_NODE)
    chain.J[k] = np.nan
    update_messages(nodes, walk, frame_counts, chain, NO_NODE, k)


@kernel
def update_all_messages(nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, chain: MarkovChainState) -> None:
    """Choose the motion models, and recompute all messages and appearance sums of all tracks, in `chain`.

    Motion models are kept where no messages exist yet. `frame_counts` (T + 1, C) is the number of frames of each camera
    before each time step.
    """
    for k in range(nodes.step.shape[0]):
        if chain.used[k] and not math.isnan(chain.mean[k, 0]) and not math.isnan(chain.J[k, 0, 0]):
            choose_motion(nodes, walk, frame_counts, chain, k)
    chain.mean[:] = np.nan
    chain.J[:] = np.nan
    for k in range(nodes.step.shape[0]):
        if chain.used[k] and chain.before[k] == NO_NODE:
            update_messages(nodes, walk, frame_counts, chain, k, NO_NODE)
            sum_up(nodes.similar, chain.sums, chain.before, chain.after, k)
        if chain.used[k] and chain.after[k] == NO_NODE:
            update_messages(nodes, walk, frame_counts, chain, NO_NODE, k)


@kernel
def log_posterior(nodes: TrackletNodes, chain: MarkovChainState) -> float:
    """Return the log posterior probability of the links in `chain`, up to a constant: the sum over all tracks."""
    value = 0.0
    for k in range(nodes.step.shape[0]):
        if chain.used[k] and chain.after[k] == NO_NODE:
            value += chain.past[k] + nodes.death[k] + log_ratio_joined(nodes.similar, chain.sums, k, NO_NODE, NO_NODE)
    return value


@kernel
def sweep(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    listed: LinkCandidates,
    known: LinkCache,
    chain: MarkovChainState,
    temperature: float,
    drawn: Floats,
) -> int:
    """Propose one move of the Markov chain for each of k rows of random numbers; return how many were accepted.

    Args:
        nodes: n nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: candidate links and swaps.
        known: cache of link probabilities; changed.
        chain: links and messages; changed.
        temperature: probabilities count to the power 1 / temperature.
        drawn: (k, 4) uniform in [0, 1): kind of move, node, choice within the move, acceptance.
    """
    n = nodes.step.shape[0]
    accepted = 0
    for row in range(drawn.shape[0]):
        k = min(int(drawn[row, 1] * n), n - 1)
        log_u = temperature * math.log(max(drawn[row, 3], 1e-300))
        if drawn[row, 0] < MOVE_THRESHOLDS[0]:
            accepted += propose_successor(nodes, walk, frame_counts, listed, known, chain, k, drawn[row, 2], log_u)
        elif drawn[row, 0] < MOVE_THRESHOLDS[1]:
            accepted += propose_insertion(
                nodes, walk, frame_counts, listed, known, chain, k, drawn[row, 2], log_u, temperature
            )
        else:
            accepted += propose_swap(nodes, walk, frame_counts, listed, known, chain, k, drawn[row, 2], log_u)
    return accepted


@kernel_part
def propose_successor(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    listed: LinkCandidates,
    known: LinkCache,
    chain: MarkovChainState,
    i: int,
    u: float,
    log_u: float,
) -> int:
    """Propose another successor of node i, or none (exchange of tails); return 1 if it is accepted, else 0.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: candidate links.
        known: cache of link probabilities; changed.
        chain: changed if the move is accepted.
        i: index of the node.
        u: uniform in [0, 1), chooses the successor.
        log_u: threshold: temperature times the log of a uniform number; the move is accepted if the log probability
            changes by more.
    """
    if not chain.used[i]:
        return 0
    count = listed.first_next[i + 1] - listed.first_next[i]
    pick = min(int(u * (count + 1)), count)
    j = NO_NODE if pick == count else listed.next[listed.first_next[i] + pick]
    if j != NO_NODE and not chain.used[j]:
        return 0
    a = chain.after[i]
    if j == a:
        return 0
    b = chain.before[j] if j != NO_NODE else NO_NODE
    if b != NO_NODE and a != NO_NODE and not can_link(nodes, walk, b, a):
        return 0
    now = cached_link(nodes, walk, frame_counts, listed, known, chain, i, a)
    if j != NO_NODE:
        now += cached_link(nodes, walk, frame_counts, listed, known, chain, b, j)
    then = cached_link(nodes, walk, frame_counts, listed, known, chain, i, j)
    if not (b == NO_NODE and a == NO_NODE):
        then += cached_link(nodes, walk, frame_counts, listed, known, chain, b, a)
    then += log_ratio_joined(nodes.similar, chain.sums, i, NO_NODE, j) + log_ratio_joined(
        nodes.similar, chain.sums, b, NO_NODE, a
    )
    now += log_ratio_joined(nodes.similar, chain.sums, i, NO_NODE, a) + log_ratio_joined(
        nodes.similar, chain.sums, b, NO_NODE, j
    )
    if not then - now > log_u:
        return 0
    chain.after[i] = j
    if j != NO_NODE:
        chain.before[j] = i
    if a != NO_NODE:
        chain.before[a] = b
    if b != NO_NODE:
        chain.after[b] = a
    choose_motion(nodes, walk, frame_counts, chain, i)
    choose_motion(nodes, walk, frame_counts, chain, b)
    update_messages(nodes, walk, frame_counts, chain, j, i)
    update_messages(nodes, walk, frame_counts, chain, a, b)
    sum_up(nodes.similar, chain.sums, chain.before, chain.after, i)
    sum_up(nodes.similar, chain.sums, chain.before, chain.after, a if a != NO_NODE else b)
    return 1


@kernel_part
def propose_insertion(
    nodes: TrackletNodes, walk: WalkModel, frame_counts: Floats, listed: LinkCandidates, known: LinkCache,
    chain: MarkovChainState, k: int, u: float,
    log_u: float, temperature: float,
) -> int:  # fmt: skip
    """Propose that node k enters a track or leaves its track; return 1 if it is accepted, else 0.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: candidate links.
        known: cache of link probabilities; changed.
        chain: changed if the move is accepted.
        k: index of the node.
        u: uniform in [0, 1), chooses the position in a track.
        log_u: threshold: temperature times the log of a uniform number; the move is accepted if the log probability,
            corrected for the number of possible positions, changes by more.
        temperature: factor of that correction.
    """
    before = listed.first_last[k + 1] - listed.first_last[k]
    after = listed.first_next[k + 1] - listed.first_next[k]
    log_options = temperature * math.log(before + after + 1.0)
    if chain.used[k]:
        i, j = chain.before[k], chain.after[k]
        if i != NO_NODE and j != NO_NODE and not can_link(nodes, walk, i, j):
            return 0
        now = cached_link(nodes, walk, frame_counts, listed, known, chain, i, k)
        then = cached_link(nodes, walk, frame_counts, listed, known, chain, i, j)
        now += log_ratio_joined(nodes.similar, chain.sums, i, k, j)
        then += log_ratio_joined(nodes.similar, chain.sums, i, NO_NODE, j)
        if not then - now - log_options > log_u:
            return 0
        chain.used[k], chain.before[k], chain.after[k] = False, NO_NODE, NO_NODE
    else:
        pick = min(int(u * (before + after + 1)), before + after)
        i, j = NO_NODE, NO_NODE
        if pick < before:
            i = listed.last[listed.first_last[k] + pick]
            if not chain.used[i]:
                return 0
            j = chain.after[i]
            if j != NO_NODE and not can_link(nodes, walk, k, j):
                return 0
        elif pick < before + after:
            j = listed.next[listed.first_next[k] + pick - before]
            if not chain.used[j] or chain.before[j] != NO_NODE:
                return 0
        now = cached_link(nodes, walk, frame_counts, listed, known, chain, i, j)
        then = log_insertion_probability(nodes, walk, frame_counts, chain, i, k, j)
        now += log_ratio_joined(nodes.similar, chain.sums, i, NO_NODE, j)
        then += log_ratio_joined(nodes.similar, chain.sums, i, k, j)
        if not then - now + log_options > log_u:
            return 0
        chain.used[k], chain.before[k], chain.after[k] = True, i, j
    if i != NO_NODE:
        chain.after[i] = k if chain.used[k] else j
    if j != NO_NODE:
        chain.before[j] = k if chain.used[k] else i
    if chain.used[k]:
        insert_node(nodes, walk, frame_counts, chain, k)
    else:
        choose_motion(nodes, walk, frame_counts, chain, i)
        update_messages(nodes, walk, frame_counts, chain, j, i)
    sum_up(nodes.similar, chain.sums, chain.before, chain.after, k if chain.used[k] else (i if i != NO_NODE else j))
    return 1


@kernel_part
def propose_swap(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    listed: LinkCandidates,
    known: LinkCache,
    chain: MarkovChainState,
    k: int,
    u: float,
    log_u: float,
) -> int:
    """Propose that node k and a near node of its time step exchange their tracks; return 1 if it is accepted, else 0.

    Args:
        nodes: all nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: near nodes of each time step that may be swapped.
        known: cache of link probabilities; changed.
        chain: changed if the move is accepted.
        k: index of the node.
        u: uniform in [0, 1), chooses the other node.
        log_u: threshold: temperature times the log of a uniform number; the move is accepted if the log probability
            changes by more.
    """
    count = listed.first_neighbour[k + 1] - listed.first_neighbour[k]
    if count == 0:
        return 0
    m = listed.neighbours[listed.first_neighbour[k] + min(int(u * count), count - 1)]
    if not (chain.used[k] or chain.used[m]):
        return 0
    for one, other in ((k, m), (m, k)):
        i, j = chain.before[one], chain.after[one]
        if i != NO_NODE and not can_link(nodes, walk, i, other):
            return 0
        if j != NO_NODE and not can_link(nodes, walk, other, j):
            return 0
    now, then = 0.0, 0.0
    for one, other in ((k, m), (m, k)):
        if chain.used[one]:
            i, j = chain.before[one], chain.after[one]
            now += cached_link(nodes, walk, frame_counts, listed, known, chain, i, one)
            then += log_insertion_probability(nodes, walk, frame_counts, chain, i, other, j)
            now += log_ratio_joined(nodes.similar, chain.sums, i, one, j)
            then += log_ratio_joined(nodes.similar, chain.sums, i, other, j)
    if not then - now > log_u:
        return 0
    ik, jk, im, jm = chain.before[k], chain.after[k], chain.before[m], chain.after[m]
    uk, um = chain.used[k], chain.used[m]
    chain.before[k], chain.after[k], chain.used[k] = im, jm, um
    chain.before[m], chain.after[m], chain.used[m] = ik, jk, uk
    for one in (k, m):
        i, j = chain.before[one], chain.after[one]
        if i != NO_NODE:
            chain.after[i] = one
        if j != NO_NODE:
            chain.before[j] = one
    for one in (k, m):
        if chain.used[one]:
            insert_node(nodes, walk, frame_counts, chain, one)
            sum_up(nodes.similar, chain.sums, chain.before, chain.after, one)
    return 1
