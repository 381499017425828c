"""Uncertainty of smoothed tracks: possible identity switches, inflation of covariances, existence beyond the ends.

Identities may be exchanged where the exchange of the tails of two tracks is hardly less likely.

The smoother weights a box by the noise of one frame, which is too small if errors are correlated over frames. The
average over many frames has the long-run variance g_0 + 2 (g_1 + g_2 + ..), with g_k the covariance of the errors of a
camera's boxes of one person k frames apart. The g_k are measured from the disagreement of the cameras at one time step
(`kernels.camera_disagreement`), which is independent of the motion.

Before the first and after the last node, existence is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.track.methods.jipda.detector_model import MIDDLES, MIN_KEPT_SHARE
from occlog.track.methods.jipda.interface import NO_ID, Event
from occlog.track.methods.jipda.kernels.body_box import PackedCameras
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections
from occlog.track.methods.jipda.kernels.lasting_errors.camera_disagreement import camera_disagreement

from .appearance import log_ratio_joined
from .association import AssociatedPeople
from .mcmc_association import (
    NO_NODE,
    LinkCandidates,
    MarkovChainState,
    TrackletNodes,
    WalkModel,
    can_link,
    log_link_probability,
    missed_run,
)
from .states import States
from .tracks import ChainTracks, WindowSpan, listed_of

MIN_SWITCH_PROBABILITY = 0.05
"""Less probable exchanges are not named."""
SWITCH_WINDOW_S = 4.0
"""Interval within which only the most probable switch of the same two people is reported."""


def possible_identity_switches(
    tracks: ChainTracks, span: WindowSpan, number: Ints, identity: Ints
) -> dict[int, list[Event]]:
    """Return events `possible_switch` by the index of the time step from which identities may be wrong.

    An exchange of tails counts if its probability is at least `MIN_SWITCH_PROBABILITY`; each gives two events, one for
    each track.

    Args:
        tracks: nodes and tracks of the chain.
        span: the time steps.
        number: (n,) track of each node; NO_NODE: no track.
        identity: reported identity of each track; NO_ID: it is not reported.
    """
    walk = tracks.walk._replace(reach=min(tracks.walk.reach, 4))
    listed = listed_of(tracks._replace(walk=walk), span)
    i, j, probability = _exchanges(tracks.nodes, walk, span.frame_counts, listed, tracks.chain, number)
    named: dict[tuple[int, int], list[tuple[float, int]]] = {}
    out: dict[int, list[Event]] = {}
    # The most probable first
    for k in np.argsort(-probability, kind="stable").tolist():
        one, other = int(identity[number[i[k]]]), int(identity[number[j[k]]])
        if NO_ID in (one, other):
            continue
        step = int(tracks.nodes.step[j[k]])
        time = float(span.time[step])
        pair = (min(one, other), max(one, other))
        if any(abs(time - t) < SWITCH_WINDOW_S for t, _ in named.get(pair, [])):
            continue
        named.setdefault(pair, []).append((time, step))
        for a, b in (pair, pair[::-1]):
            out.setdefault(step, []).append(Event("possible_switch", a, b, float(probability[k])))
    return out


@kernel
def missed_runs(counts: Floats, miss: Floats, hiding: Floats) -> Floats:
    """Probability (T,) that every camera misses a person in each of `counts` (T, C) frames after the last detection.

    `miss` (C,) is the probability of a miss in plain view, `hiding` (C, 2) as in `WalkModel`.
    """
    out = np.ones(counts.shape[0])
    for t in range(counts.shape[0]):
        for c in range(counts.shape[1]):
            plain, hidden = missed_run(counts[t, c], miss[c], hiding[c, 0], hiding[c, 1])
            out[t] *= plain + hidden
    return out


@kernel
def _exchanges(
    nodes: TrackletNodes,
    walk: WalkModel,
    frame_counts: Floats,
    listed: LinkCandidates,
    chain: MarkovChainState,
    number: Ints,
) -> tuple[Ints, Ints, Floats]:
    """Return nodes i, nodes j and probabilities (each (k,)) of the exchanges of tails that link i to j.

    Exchanges below the probability `MIN_SWITCH_PROBABILITY` are omitted.

    Args:
        nodes: n nodes of the chain.
        walk: motion models.
        frame_counts: (T + 1, C) number of frames of each camera before each time step.
        listed: candidate links.
        chain: links and messages.
        number: (n,) track of each node.
    """
    before, after, probability = [0], [0], [0.0]
    for i in range(nodes.step.shape[0]):
        a = chain.after[i]
        if not chain.used[i] or a == NO_NODE:
            continue
        for k in range(listed.first_next[i], listed.first_next[i + 1]):
            j = listed.next[k]
            if not chain.used[j] or number[j] == number[i]:
                continue
            b = chain.before[j]
            if b == NO_NODE or not can_link(nodes, walk, b, a):
                continue
            now = log_link_probability(nodes, walk, frame_counts, chain, i, a) + log_link_probability(
                nodes, walk, frame_counts, chain, b, j
            )
            then = log_link_probability(nodes, walk, frame_counts, chain, i, j) + log_link_probability(
                nodes, walk, frame_counts, chain, b, a
            )
            sums = chain.sums
            now += log_ratio_joined(nodes.similar, sums, i, NO_NODE, a) + log_ratio_joined(
                nodes.similar, sums, b, NO_NODE, j
            )
            then += log_ratio_joined(nodes.similar, sums, i, NO_NODE, j) + log_ratio_joined(
                nodes.similar, sums, b, NO_NODE, a
            )
            p = 1.0 / (1.0 + np.exp(min(now - then, 50.0)))
            if p >= MIN_SWITCH_PROBABILITY:
                before.append(i)
                after.append(j)
                probability.append(p)
    return np.array(before[1:]), np.array(after[1:]), np.array(probability[1:])


ERROR_CORRELATION_S = 1.0
"""Maximum lag of the autocorrelation of errors [s]: errors that last longer are a bias."""
MAX_ERROR_SIGMAS = 5.0
"""Clipping of errors in standard deviations of one frame: an edge farther off is not the body's."""
MIN_DISAGREEMENTS = 100
"""Minimum number of disagreements for an estimate."""
NOISE_SHARE = 0.75
"""Share of the variance of a smoothed walk that is the noise of positions; the rest is what the smoother lags behind.

With white acceleration the smoother passes the share 1 / (1 + x^4) of a frequency x, and the integral of its square is
3/4 of its own."""


def widening(
    views: PackedCameras,
    rates: DetectorModel,
    packed: Sequence[PackedDetections],
    found: Sequence[AssociatedPeople],
    walk: States,
    span: WindowSpan,
) -> float:
    """Return the factor, at least 1, by which covariances of smoothed tracks grow for time-correlated box errors.

    Args:
        views: cameras.
        rates: parameters of the cameras' detectors, for all frames.
        packed: boxes of each time step.
        found: people of each time step with their boxes.
        walk: states of the tracks of these people, in the order of time steps.
        span: the time steps.
    """
    key, frame, error, held = _errors(views, rates, packed, found, walk, span)
    worst = 1.0
    for axis in range(2):
        fine = np.isfinite(error[:, axis])
        if fine.sum() >= MIN_DISAGREEMENTS:
            measured = long_run_variance(key[fine], frame[fine], error[fine, axis], _max_frames(span))
            worst = max(worst, measured / float(np.mean(held[fine, axis])))
    return 1.0 + NOISE_SHARE * (worst - 1.0)


def _max_frames(span: WindowSpan) -> int:
    """Return the number of frames in `ERROR_CORRELATION_S`, at the mean rate of the camera with most frames."""
    n_frames = float(span.frame_counts[-1].max())
    return round(ERROR_CORRELATION_S * max(n_frames - 1.0, 0.0) / max(float(span.gaps.sum()), ERROR_CORRELATION_S))


def long_run_variance(key: Ints, frame: Ints, error: Floats, most: int) -> float:
    """Return the long-run variance of errors: the sum of autocovariances at lags -`most` to `most`, over all series.

    Args:
        key: (n,) number of each error's series.
        frame: (n,) number of each error's frame.
        error: (n,) errors.
        most: maximum lag in frames.
    """
    # Rows of one series lie side by side, with a gap to those of the next one
    at = key * (int(frame.max()) + most + 1) + frame
    order = np.argsort(at)
    at, error = at[order], error[order]
    total = float(np.mean(error**2))
    for k in range(1, most + 1):
        later = np.minimum(np.searchsorted(at, at + k), len(at) - 1)
        both = at[later] == at + k
        if both.any():
            total += 2.0 * float(np.mean(error[both] * error[later[both]]))
    return total


def _errors(
    views: PackedCameras,
    rates: DetectorModel,
    packed: Sequence[PackedDetections],
    found: Sequence[AssociatedPeople],
    walk: States,
    span: WindowSpan,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return residuals of box centres after a fit of positions to each time step, in standard deviations of one frame.

    Args:
        views: cameras.
        rates: parameters of the cameras' detectors.
        packed: boxes of each time step.
        found: people of each time step with their boxes.
        walk: states of the tracks of these people.
        span: the time steps.

    Returns:
        key: (n,) series: one for each person and camera.
        frame: (n,) number of the camera's frame.
        error: (n, 2) horizontal and vertical; NaN: not known.
        held: (n, 2) long-run variance of these errors that the measurement noise of the smoother already contains.
    """
    first = np.cumsum([0, *(len(f.track) for f in found)])
    row = np.full(first[-1], NO_NODE)
    has = np.flatnonzero(walk.node != NO_NODE)
    row[walk.node[has]] = has
    C = span.frame_counts.shape[1]
    parts = []
    for k, (boxes, of) in enumerate(zip(packed, found, strict=True)):
        rows = row[first[k] : first[k + 1]]
        who = np.flatnonzero(rows != NO_NODE)
        owner = np.full(len(boxes.box), NO_NODE)
        for given in of.given[:, who]:
            owner[given[given != NO_NODE]] = np.flatnonzero(given != NO_NODE)
        whole = (owner != NO_NODE) & boxes.usable.all(axis=1)
        if not whole.any():
            continue
        rows = rows[who]
        disagreement = camera_disagreement(walk.mean[rows], walk.covariance[rows], views, boxes, rates, owner, whole)
        box = np.flatnonzero(whole)
        camera = np.repeat(boxes.camera, np.diff(boxes.first))[box]
        size, kept = disagreement.size[box][:, MIDDLES] ** 2, disagreement.kept[box][:, MIDDLES]
        new, gait_variance = rates.noise[MIDDLES, 0] + rates.noise[MIDDLES, 1] * size, rates.gait_variance * size
        error = disagreement.residual[box][:, MIDDLES] / np.sqrt(
            (new + gait_variance) * np.maximum(kept, MIN_KEPT_SHARE)
        )
        error = np.clip(error, -MAX_ERROR_SIGMAS, MAX_ERROR_SIGMAS)
        held = (rates.slow * new + rates.lasting[camera, None] * gait_variance) / (new + gait_variance)
        key, frame = walk.track[rows[owner[box]]] * C + camera, span.frame_counts[k, camera].astype(np.int64)
        parts.append((key, frame, np.where(kept > MIN_KEPT_SHARE, error, np.nan), held))
    if not parts:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    key, frame, error, held = (np.concatenate(part) for part in zip(*parts, strict=True))
    return key, frame, error, held


def existence_at(tracks: ChainTracks, span: WindowSpan, walk: States) -> Floats:
    """Return (K,) existence probabilities of the people of each row of `walk` at its time step; 1 within a track.

    After the last node the person left at once, or was missed in some frames and then left, or is still present at the
    end of the recording; each is weighted by the probability of leaving then and of all misses before. Before the first
    node it is computed likewise.
    """
    out = np.ones(len(walk.track))
    for ends, step in ((walk.last, 1), (walk.next, -1)):
        rows = np.flatnonzero(~walk.inside & (ends != NO_NODE))
        for node in np.unique(ends[rows]).tolist():
            of = rows[ends[rows] == node]
            out[of] = _still(tracks, span, node, step)[np.abs(walk.step[of] - tracks.nodes.step[node])]
    return out


def _still(tracks: ChainTracks, span: WindowSpan, node: int, step: int) -> Floats:
    """Return existence probabilities 0, 1, 2 ... time steps after the last node of a track, or before its first one.

    `step` is 1 for the time after the last `node`, -1 for that before the first; they reach to the end of the span.
    """
    here = tracks.nodes.step[node]
    at = np.arange(here, len(span.time)) if step > 0 else np.arange(here, -1, -1)
    delivered = (
        span.frame_counts[at + 1] - span.frame_counts[here + 1]
        if step > 0
        else span.frame_counts[here] - span.frame_counts[at]
    )
    away = np.abs(span.time[at] - span.time[here])
    missed = missed_runs(delivered, np.exp(tracks.nodes.miss[node]), span.hiding) * np.exp(-away / span.stay)
    # Leaving between a time step and the next; after the last one no person leaves
    weight = missed * np.append(-np.expm1(-np.diff(away) / span.stay), 1.0)
    return np.asarray(np.cumsum(weight[::-1])[::-1] / weight.sum())
