"""Batch association of all boxes with whole tracks, then fixed-interval smoothing.

Starts from the filter's tracks and repeats twice:

1. Markov chain Monte Carlo over all links (`mcmc_association`), or the filter's links if errors are strongly correlated
   in time (`CORRELATED_NOISE_LIMIT`); then gaps are bridged.

2. State of each person at each time step, from all other time steps of the track (`states`).

3. Association of the boxes of each time step with these people, all cameras jointly, as in the filter; unassigned boxes
   initiate new people.

Then the states are smoothed once more with the last association.

The fixed-lag variant repeats this over a sliding window, in bounded memory and linear time. A window holds time steps
already reported (which carry the identities), those to be reported, and at least the lag after them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import NS, Floats, Ints

from ..association_features import appearance_of, are_histograms, feature_likelihood, log_ratio, unit_vectors
from ..detector_model import (
    blind_frames,
    common_clutter_rate,
    detector_model,
    edge_noise_variance,
    established,
    hiding_rate,
    manoeuvre_rate,
    persistent_clutter_density,
    persistent_clutter_probability,
    posture_change_rate,
    target_death_rate,
)
from ..filter import JipdaState, associations_of, common_error_of, pack_detections
from ..interface import HEIGHT, NO_ID, BoxAssociations, Event, FrameDetections, TrackSnapshot
from ..kernels.detections import DetectorModel, PackedDetections
from ..kernels.lasting_errors.bias_effects import bias_effects
from ..lasting_errors.body_bias import with_biases
from ..lasting_errors.common_error import new_variance
from .appearance import log_ratio_joined
from .association import MIN_ASSOCIATION_PROBABILITY, AssociatedBoxes, PredictedPeople, assign_boxes, associate
from .mcmc_association import LOG_RATIO_OTHER_TRACKLET, LOG_RATIO_SAME_TRACKLET, NO_NODE
from .positions import smoothed_positions
from .states import States, states
from .tracklet_nodes import INITIAL_SCALE_M, gait_variances
from .tracks import ChainTracks, WindowSpan, anneal, bridge, tracks_from
from .uncertainty import existence_at, possible_identity_switches, widening

INITIAL_TEMPERATURES = (3.0, 1.5)
"""Temperature at which each run of the chain begins."""
PRESENCE_WITHIN_TRACK = 0.97
"""Probability that a person is there between the first and the last position of the track, ..."""
PRESENCE_OUTSIDE_TRACK = 0.3
"""... and before the first or after the last, ..."""
MIN_EXTENSION_S, MIN_EXTENSION_STEPS = 1.0, 2
"""... for at least this time and number of time steps."""
MIN_PRESENCE_TO_REPORT = 0.5
"""Minimum existence probability for reporting a person before the first and after the last position of a track."""
INDEPENDENT_AFTER_S = 0.4
"""Minimum interval between linked time steps: occlusions and merged boxes last, so that boxes and
misses of nearer time steps are correlated, and a chain that took them for new would end occluded tracks."""
CORRELATED_NOISE_LIMIT = 2.0
"""Weight of correlated box errors above which the links of the filter, which sees all frames, are kept, as for regions
of video, which split and merge for many frames at a time: a
chain that sees few of them exchanges people there.  Gaps are bridged all the same."""
REFINEMENTS = 4
"""Steps of expectation maximisation of the scatter about the walk."""
SYSTEMATIC_ERROR_HEIGHTS = 0.01
"""Error of a position that smoothing does not average out, as a share of the person's height, per axis: what is wrong
with the poses of cameras and with bodies."""
ROUNDING = 1e-6
"""Relative tolerance of the minimum interval between time steps."""
MIN_EXISTENCE_COMPLEMENT = 1e-3
"""Minimum probability that a track does not exist."""


def smooth(
    state: JipdaState,
    frames: Sequence[Sequence[FrameDetections]],
    snapshots: Sequence[TrackSnapshot],
    generator: np.random.Generator,
) -> list[TrackSnapshot]:
    """Smooth all people at the filter's time steps, from the detections before and after each.

    Batch data association by MCMC, then fixed-interval smoothing. Identities are renumbered from 0 in order of first
    appearance.

    Args:
        state: filter state after the last time step: cameras, settings, and what it learned of the detectors.
        frames: frames of each time step, as they were given to the filter.
        snapshots: results of the filter, in the order of time.
        generator: source of random numbers of the Markov chain; one seed gives one result.

    Returns:
        One snapshot per time step; [] without time steps.
    """
    if not snapshots:
        return []
    packed = [_scored(state, group, snapshot.t_ns) for group, snapshot in zip(frames, snapshots, strict=True)]
    span = span_of(state, packed, snapshots)
    rates = _rates(state, span)
    # Blind frames do not count
    packed = [_seeing(boxes, rates, snapshot) for boxes, snapshot in zip(packed, snapshots, strict=True)]
    span = span_of(state, packed, snapshots)
    chosen = independent_steps(span)
    subset = at_steps(span, chosen)
    # Errors of boxes that are farther apart in time are less correlated: those of the chosen time steps count for more
    subset_rates = _rates(state, subset, frames_between(span, subset))
    # The filter's tracks through time steps that the chain skips carry links that it need not find again
    followed = len(chosen) < len(snapshots)
    hints = [_identities(group, snapshot, followed) for group, snapshot in zip(frames, snapshots, strict=True)]
    appearance, law = _appearances(frames), feature_likelihood(state.cues.similarities)
    seen = {k: _filtered(packed[k], frames[k], snapshots[k]) for k in chosen.tolist()}
    square = (INITIAL_SCALE_M * state.metre) ** 2
    common = common_error_of(state)
    new = new_variance(common, span.step)
    for hottest, coming in zip(INITIAL_TEMPERATURES, (chosen, np.arange(len(snapshots))), strict=True):
        found = [
            assign_boxes(state, packed[k], subset_rates, hints[k], appearance[k], seen[k]) for k in chosen.tolist()
        ]
        tracks = tracks_from(
            found, subset, state.config, state.birth_map, square + new_variance(common, subset.step), free=True, law=law
        )
        if not (followed and rates.slow > CORRELATED_NOISE_LIMIT):
            anneal(tracks, subset, generator, hottest)
        bridge(tracks, subset)
        tracks = tracks._replace(nodes=tracks.nodes._replace(step=chosen[tracks.nodes.step]))
        own, square = _scattered(tracks, span, square, new, state.metre)
        seen = _reassociate(state, packed, rates, hints, appearance, tracks, span, own + new, square + new, coming)
    # Smooth: the scatter and the walk follow from each other
    found = [assign_boxes(state, packed[k], rates, hints[k], appearance[k], seen[k]) for k in range(len(snapshots))]
    tracks = tracks_from(found, span, state.config, state.birth_map, square + new, free=False, law=law)
    for _ in range(REFINEMENTS):
        own, square = _scattered(tracks, span, square, new, state.metre)
        tracks = tracks_from(found, span, state.config, state.birth_map, own + new, free=False, law=law)
    walk = _states(tracks, span, track_extension(span))
    wide = widening(state.views, rates, packed, found, walk, span)
    out = _smoothed_snapshots(tracks, span, packed, frames, snapshots, seen, own, square, walk, common, wide)
    for k, each in enumerate(out):
        shift, _, from_poses = bias_effects(each.mean, each.covariance, state.views, rates, state.sigma_pose)
        covariance = with_biases(each.covariance, shift, state.body_bias, from_poses)
        out[k] = each._replace(covariance=covariance)
    return out


def _scored(state: JipdaState, group: Sequence[FrameDetections], t_ns: int) -> PackedDetections:
    """Pack the frames of a time step at `t_ns`, with each box's clutter density from its score and clutter sources.

    The score statistics and sources are those of `state`, learned from all frames.
    """
    boxes = pack_detections(state, group, t_ns)
    again = persistent_clutter_probability(state.counts)
    static = persistent_clutter_density(
        boxes, [established(c) for c in state.clutter], again, edge_noise_variance(state.edges), state.views.size
    )
    boxes = boxes._replace(clutter=np.log(np.exp(boxes.clutter) + static))
    scores = np.concatenate([frame.score for frame in group])
    return boxes._replace(clutter=boxes.clutter - log_ratio(state.cues.score, scores))


def span_of(state: JipdaState, packed: Sequence[PackedDetections], snapshots: Sequence[TrackSnapshot]) -> WindowSpan:
    """Return the times, cumulative frame counts of each camera, and rates and densities of people of the time steps.

    Times are in seconds after the first time step. `packed` and `snapshots` are detections and filter results of each.
    """
    frame_counts = np.zeros((len(snapshots) + 1, len(state.views.size)))
    for k, boxes in enumerate(packed):
        frame_counts[k + 1] = frame_counts[k]
        np.add.at(frame_counts[k + 1], boxes.camera, 1.0)
    positions = np.concatenate([m.mean[:, :2] for m in snapshots]) / state.metre
    area = max(len(np.unique(np.floor(positions), axis=0)), 10) * state.metre**2
    return WindowSpan(
        time=np.array([(m.t_ns - snapshots[0].t_ns) / NS for m in snapshots]),
        frame_counts=frame_counts,
        area=area,
        people=max(len(positions) / len(snapshots), 0.5),
        false_people=common_clutter_rate(state.counts),
        stay=1.0 / target_death_rate(state.counts),
        hiding_rate=hiding_rate(state.counts),
        turning=manoeuvre_rate(state.counts),
        bending=posture_change_rate(state.counts),
        metre=state.metre,
    )


def _seeing(boxes: PackedDetections, rates: DetectorModel, snapshot: TrackSnapshot) -> PackedDetections:
    """Return the detections of a time step without blind frames.

    A frame is blind (lost, or the lens covered) if it has no box although people of the filter's `snapshot` should be
    detected in it.
    """
    visible = np.nan_to_num(snapshot.visibility[:, boxes.camera].T)
    knots = np.linspace(0.0, 1.0, len(rates.curve))
    detection = rates.detection[boxes.camera, None] * np.interp(visible, knots, rates.curve)
    keep = ~blind_frames(boxes, snapshot.existence, np.where(visible > 0.0, detection, 0.0))
    first = np.concatenate([[0], np.cumsum(np.diff(boxes.first)[keep])])
    return boxes._replace(camera=boxes.camera[keep], delay=boxes.delay[keep], first=first)


def _rates(state: JipdaState, span: WindowSpan, between: float = 1.0) -> DetectorModel:
    """Return the detectors' parameters, as learned by the filter, for each camera's mean frame period in `span`.

    `between` is the number of a camera's frames per frame that is used, >= 1: errors farther apart are less correlated.
    """
    # Mean frame period of each camera
    with np.errstate(divide="ignore", invalid="ignore"):
        interval = span.gaps.sum() / (span.frame_counts[-1] - 1.0)
    return detector_model(state.counts, state.edges, state.config, np.where(interval > 0.0, interval, np.inf), between)


def frames_between(span: WindowSpan, subset: WindowSpan) -> float:
    """Return the number of a camera's frames in `span` per frame in `subset`, a choice of its time steps; at least 1.

    It is the least of all cameras with frames in `subset`.
    """
    frame_counts = subset.frame_counts[-1] > 0.0
    if not frame_counts.any():
        return 1.0
    return max(float(np.min(span.frame_counts[-1, frame_counts] / subset.frame_counts[-1, frame_counts])), 1.0)


def independent_steps(span: WindowSpan) -> Ints:
    """Return indices of time steps with a frame of some camera `INDEPENDENT_AFTER_S` after its last chosen one.

    Box errors at these time steps are nearly independent.
    """
    delivered = np.diff(span.frame_counts, axis=0) > 0.0
    chosen, last = [], np.full(delivered.shape[1], -np.inf)
    for k, t in enumerate(span.time.tolist()):
        if (t - last[delivered[k]] >= INDEPENDENT_AFTER_S * (1.0 - ROUNDING)).any():
            chosen.append(k)
            last[delivered[k]] = t
    return np.array(chosen, dtype=np.int64)


def at_steps(span: WindowSpan, chosen: Ints) -> WindowSpan:
    """Return the span restricted to the time steps at the indices `chosen`; only their frames are counted."""
    delivered = np.diff(span.frame_counts, axis=0)[chosen]
    frame_counts = np.concatenate([np.zeros((1, delivered.shape[1])), np.cumsum(delivered, axis=0)])
    return span._replace(time=span.time[chosen], frame_counts=frame_counts)


def _appearances(frames: Sequence[Sequence[FrameDetections]]) -> list[Floats]:
    """Return, for each time step, unit appearance vectors (M, K) of its M boxes; NaN: no appearance."""
    every = [frame for group in frames for frame in group]
    dimension = max((frame.appearance.shape[1] for frame in every), default=0)
    histograms = are_histograms(*(frame.appearance for frame in every))
    return [
        unit_vectors(np.concatenate([appearance_of(frame, dimension) for frame in group]), histograms)
        for group in frames
    ]


def _similarity(tracks: ChainTracks, head: Ints, node: Ints, boxes: Floats) -> Floats:
    """Return the similarity (N, M) of boxes to N tracks at all other time steps; NaN if either has no appearance.

    Args:
        tracks: nodes and tracks of the chain.
        head: (N,) first node of each track.
        node: (N,) node of the track at the time step of the boxes; NO_NODE: none.
        boxes: (M, K) unit appearance vectors of boxes.
    """
    appearance = tracks.chain.sums.later[head]
    has = node != NO_NODE
    appearance[has] -= tracks.nodes.similar.total[node[has]]
    if not appearance.shape[1]:
        return np.full((len(appearance), len(boxes)), np.nan)
    return np.asarray(unit_vectors(appearance, histograms=False) @ boxes.T)


def _identities(group: Sequence[FrameDetections], snapshot: TrackSnapshot, followed: bool) -> Ints:
    """Return (M, 2) identities of a time step's M boxes: tracklet ID, and the filter's track; `NO_ID` if unknown.

    Args:
        group: frames of the time step.
        snapshot: the filter's result at the time step.
        followed: use the filter's tracks; otherwise they are unknown.
    """
    by_tracker = np.concatenate([frame.tracklet_id for frame in group]).astype(np.int64)
    by_filter = np.full(len(by_tracker), NO_ID)
    if followed:
        mine = snapshot.support.probability > MIN_ASSOCIATION_PROBABILITY
        by_filter[_supporting(group, snapshot)[mine]] = snapshot.ids[snapshot.support.person[mine]]
    return np.column_stack([by_tracker, by_filter])


def _filtered(boxes: PackedDetections, group: Sequence[FrameDetections], snapshot: TrackSnapshot) -> AssociatedBoxes:
    """Return the filter's people and associations at a time step in the form of batch association.

    `boxes` are the frames of `group`, packed; `snapshot` is the filter's result.
    """
    beta = np.zeros((len(snapshot.ids), len(boxes.box)))
    joint = np.zeros_like(beta)
    supported, box = snapshot.support, _supporting(group, snapshot)
    beta[supported.person, box], joint[supported.person, box] = supported.probability - supported.joint, supported.joint
    people = PredictedPeople(snapshot.ids, snapshot.mean, snapshot.covariance, snapshot.existence)
    return AssociatedBoxes(people, beta, joint, snapshot.visibility[:, boxes.camera].T)


def _supporting(group: Sequence[FrameDetections], snapshot: TrackSnapshot) -> Ints:
    """Return (k,) indices, among all boxes of a time step, of the boxes in the filter's k associations.

    `group` are the frames of the time step, `snapshot` the filter's result.
    """
    keys = ((frame.camera, row) for frame in group for row in frame.row.tolist())
    index_of = {key: k for k, key in enumerate(keys)}
    supported = snapshot.support
    rows = zip(supported.camera.tolist(), supported.row.tolist(), strict=True)
    return np.array([index_of[at] for at in rows], dtype=np.int64)


def _scattered(tracks: ChainTracks, span: WindowSpan, square: float, new: float, metre: float) -> tuple[Floats, float]:
    """Return the gait variance (n,) per axis of each node about its smooth track, and the updated variance scale.

    Nodes outside tracks get the scale.

    Args:
        tracks: nodes and tracks of the chain.
        span: the time steps.
        square: variance scale before [scene unit^2].
        new: variance of the common position error that neighbouring positions do not share.
        metre: length of a metre in the scene's unit.
    """
    walk = _states(tracks, span, 0.0)
    rows = np.flatnonzero(walk.node != NO_NODE)
    k = walk.node[rows]
    covariance = walk.covariance[rows]
    covariance[:, [0, 1], [0, 1]] += new
    own, square = gait_variances(tracks.J[k], tracks.h[k], walk.mean[rows], covariance, square, metre)
    out = np.full(len(tracks.J), square)
    out[k] = own
    return out, square


def track_extension(span: WindowSpan) -> float:
    """Return the time [s] by which a track is extended before its first and after its last node.

    At least `MIN_EXTENSION_S` and `MIN_EXTENSION_STEPS` mean time steps, plus half a time step.
    """
    return max(MIN_EXTENSION_S, MIN_EXTENSION_STEPS * span.step) + 0.5 * span.step


def _states(tracks: ChainTracks, span: WindowSpan, extend: float) -> States:
    """Return the leave-one-out states of all tracks at all time steps: from all nodes but that of the time step.

    Tracks are extended by `extend` [s] before their first and after their last node.
    """
    early = np.searchsorted(span.time, span.time - extend)
    late = np.searchsorted(span.time, span.time + extend, side="right") - 1
    return states(tracks.nodes, tracks.walk, tracks.chain, span.time, early, late)


def _reassociate(
    state: JipdaState,
    packed: Sequence[PackedDetections],
    rates: DetectorModel,
    hints: Sequence[Ints],
    appearance: Sequence[Floats],
    tracks: ChainTracks,
    span: WindowSpan,
    own: Floats,
    square: float,
    steps: Ints,
) -> dict[int, AssociatedBoxes]:
    """Associate the boxes of chosen time steps once more, with people predicted from the smoothed tracks.

    Args:
        state: filter state; gives cameras and learned statistics.
        packed: boxes of each time step.
        rates: parameters of the cameras' detectors.
        hints: (M, 2) identities of the boxes of each time step, by single-camera trackers and by the filter.
        appearance: (M, K) unit appearance vectors of the boxes of each time step.
        tracks: nodes and tracks of the chain.
        span: the time steps.
        own: (n,) variance of each node about its smooth track, per axis.
        square: that variance where a track has no node.
        steps: indices of the chosen time steps.

    Returns:
        Association of each chosen time step, by its index.
    """
    walk = _states(tracks, span, track_extension(span))
    # The position varies about the walk with the estimated variance
    spread = np.where(walk.node != NO_NODE, own[walk.node] if len(own) else 0.0, square)
    walk.covariance[:, [0, 1], [0, 1]] += spread[:, None]
    bounds = np.searchsorted(walk.step, np.arange(len(packed) + 1))
    out = {}
    for k in steps.tolist():
        rows = slice(bounds[k], bounds[k + 1])
        people = PredictedPeople(
            walk.track[rows],
            walk.mean[rows],
            walk.covariance[rows],
            np.where(walk.inside[rows], PRESENCE_WITHIN_TRACK, PRESENCE_OUTSIDE_TRACK),
        )
        bonus = _feature_ratios(packed[k], hints[k][:, 0], tracks, walk.last[rows], walk.next[rows])
        bonus += log_ratio(
            state.cues.similarities, _similarity(tracks, walk.head[rows], walk.node[rows], appearance[k])
        )
        out[k] = associate(state, packed[k], rates, people, bonus)
    return out


def _feature_ratios(boxes: PackedDetections, hint: Ints, tracks: ChainTracks, last: Ints, following: Ints) -> Floats:
    """Return (N, M) log likelihood ratios of boxes' tracklet IDs against those of each track's neighbouring nodes.

    Args:
        boxes: M boxes of a time step, packed.
        hint: (M,) tracklet IDs of the boxes; NO_ID: none.
        tracks: nodes and tracks of the chain.
        last: (N,) node of each track before the time step; NO_NODE: none.
        following: (N,) node of each track after it; NO_NODE: none.
    """
    out = np.zeros((len(last), len(hint)))
    if (hint == NO_ID).all():
        return out
    camera = np.repeat(boxes.camera, np.diff(boxes.first))
    for neighbour in (last, following):
        known = np.where(neighbour[:, None] != NO_NODE, tracks.nodes.hint[neighbour][:, camera], NO_ID)
        both = (known != NO_ID) & (hint != NO_ID)
        out += np.where(both, np.where(known == hint, LOG_RATIO_SAME_TRACKLET, LOG_RATIO_OTHER_TRACKLET), 0.0)
    return out


def _smoothed_snapshots(
    tracks: ChainTracks,
    span: WindowSpan,
    packed: Sequence[PackedDetections],
    frames: Sequence[Sequence[FrameDetections]],
    snapshots: Sequence[TrackSnapshot],
    seen: dict[int, AssociatedBoxes],
    own: Floats,
    square: float,
    walk: States,
    common: tuple[float, float],
    wide: float,
) -> list[TrackSnapshot]:
    """Return smoothed people at every time step; tracks less likely than clutter are omitted.

    Args:
        tracks: n nodes and tracks of the chain.
        span: the time steps.
        packed: boxes of each time step.
        frames: frames of each time step, as given to the filter.
        snapshots: results of the filter at each time step.
        seen: last association of the boxes, by index of the time step.
        own: (n,) variance of each node about its smooth track, per axis.
        square: that variance where a track has no node.
        walk: states of the tracks at the time steps.
        common: variance per axis and correlation time [s] of the common position error.
        wide: inflation factor of the variances of smooth tracks.
    """
    walk = walk.taken(np.flatnonzero(existence_at(tracks, span, walk) > MIN_PRESENCE_TO_REPORT))
    mean, covariance = smoothed_positions(walk, tracks, span, own, square, common, wide)
    covariance[:, [0, 1], [0, 1]] += (SYSTEMATIC_ERROR_HEIGHTS * mean[:, HEIGHT, None]) ** 2
    # Log odds of each track against clutter
    odds = np.zeros(walk.track.max(initial=-1) + 1)
    ends = np.flatnonzero(tracks.chain.used & (tracks.chain.after == NO_NODE))
    number = np.full(len(own), NO_NODE)
    has = walk.node != NO_NODE
    number[walk.node[has]] = walk.track[has]
    odds[number[ends]] = tracks.chain.past[ends] + tracks.nodes.death[ends]
    odds[number[ends]] += [
        log_ratio_joined(tracks.nodes.similar, tracks.chain.sums, k, NO_NODE, NO_NODE) for k in ends.tolist()
    ]
    existence = np.clip(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))), 0.0, 1.0 - MIN_EXISTENCE_COMPLEMENT)
    identity = np.where(odds > 0.0, np.cumsum(odds > 0.0) - 1, NO_ID)
    exchanged = possible_identity_switches(tracks, span, number, identity)
    begins, ceases = np.full(len(odds), len(snapshots)), np.full(len(odds), -1)
    np.minimum.at(begins, walk.track, walk.step)
    np.maximum.at(ceases, walk.track, walk.step)
    bounds = np.searchsorted(walk.step, np.arange(len(snapshots) + 1))
    earlier = [np.flatnonzero((ceases == k - 1) & (identity != NO_ID)) for k in range(len(snapshots))]
    out = []
    for k, snapshot in enumerate(snapshots):
        rows = np.arange(bounds[k], bounds[k + 1])
        rows = rows[identity[walk.track[rows]] != NO_ID]
        rows = rows[np.argsort(identity[walk.track[rows]], kind="stable")]
        track = walk.track[rows]
        new = track[begins[track] == k]
        events = [Event("initiated", int(identity[t]), NO_ID, float(existence[t])) for t in new]
        events += [Event("terminated", int(identity[t]), NO_ID, float(existence[t])) for t in earlier[k]]
        events += exchanged.get(k, [])
        support, visible = _seen_by(tracks, walk, rows, packed[k], frames[k], seen[k], len(span.frame_counts[0]))
        out.append(
            TrackSnapshot(
                t_ns=snapshot.t_ns,
                ids=identity[track],
                mean=mean[rows],
                covariance=covariance[rows],
                existence=existence[track],
                visibility=visible,
                support=support,
                events=tuple(events),
                detectors=snapshot.detectors,
            )
        )
    return out


def _seen_by(
    tracks: ChainTracks,
    walk: States,
    rows: Ints,
    boxes: PackedDetections,
    group: Sequence[FrameDetections],
    seen: AssociatedBoxes,
    cameras: int,
) -> tuple[BoxAssociations, Floats]:
    """Return the boxes associated with m people of a time step, and the visibility (m, C) of these people.

    Args:
        tracks: nodes and tracks of the chain.
        walk: states of the tracks.
        rows: (m,) rows of `walk` of the people.
        boxes: boxes of the time step, packed.
        group: frames of the time step.
        seen: last association of these boxes.
        cameras: C.

    Returns:
        Associations, with the index in `rows` as person; visible shares, NaN if unknown.
    """
    visible = np.full((len(rows), cameras), np.nan)
    beta = np.zeros((len(rows), len(boxes.box)))
    joint = np.zeros_like(beta)
    # The last association knows people by the number of the track that led to it; it did not predict some people who
    # are there before their first position or after their last one
    label = tracks.label[walk.head[rows]]
    expected = np.flatnonzero(np.isin(label, seen.people.track))
    k = np.searchsorted(seen.people.track, label[expected])
    beta[expected], joint[expected] = seen.beta[k], seen.joint[k]
    visible[np.ix_(expected, boxes.camera)] = seen.visible[:, k].T
    return associations_of(beta, joint, boxes, group), visible


MAX_STEPS_PER_REPORT = 4096
"""Maximum number of time steps reported at a time; as many wait after them."""
MIN_STEPS_PER_REPORT = 8
"""Minimum number of time steps reported at a time, so that a short lag costs little more than a long one."""
SAME_TARGET_DISTANCE = 1.0
"""Maximum distance of a person in successive windows at their last common time step [m]."""


@dataclass(frozen=True)
class SmoothingWindow:
    """Buffer of the fixed-lag smoother: frames and filter results of reported time steps, as context, and later ones.

    `lag_ns` is the minimum time of data after a reported time step (None: all data); the first `reported` time steps
    were reported before, `last` is the last reported result, and `next_id` the next free identity.
    """

    lag_ns: int | None  # minimum time of data after a time step; None: all data
    generator: np.random.Generator
    frames: tuple[Sequence[FrameDetections], ...] = ()
    snapshots: tuple[TrackSnapshot, ...] = ()
    reported: int = 0  # number of time steps that were reported
    last: TrackSnapshot | None = None  # the last one that was reported
    next_id: int = 0


def add(
    window: SmoothingWindow, state: JipdaState, frames: Sequence[FrameDetections], snapshot: TrackSnapshot
) -> tuple[SmoothingWindow, list[TrackSnapshot]]:
    """Add a time step to the fixed-lag smoother; return the window, and smoothed time steps older than the lag.

    The list is empty until enough time steps are ready to be smoothed at once.

    Args:
        window: window before the time step; not changed.
        state: filter state after the time step.
        frames: frames of the time step, as they were given to the filter.
        snapshot: result of the filter.
    """
    window = replace(window, frames=(*window.frames, frames), snapshots=(*window.snapshots, snapshot))
    waiting = len(window.snapshots) - window.reported
    if waiting >= 2 * MAX_STEPS_PER_REPORT:
        return _report(window, state, window.reported + MAX_STEPS_PER_REPORT)
    if window.lag_ns is None:
        return window, []
    # Ready: time steps older than the lag
    t_ns = np.array([m.t_ns for m in window.snapshots])
    ready = int(np.searchsorted(t_ns, snapshot.t_ns - window.lag_ns, side="right"))
    if ready - window.reported < max(MIN_STEPS_PER_REPORT, waiting - (ready - window.reported)):
        return window, []
    return _report(window, state, ready)


def finish(window: SmoothingWindow, state: JipdaState) -> list[TrackSnapshot]:
    """Return the smoothed time steps that were not yet reported, at the end of the input.

    `window` is the fixed-lag buffer, `state` the filter state after the last time step.
    """
    return _report(window, state, len(window.snapshots))[1]


def _report(window: SmoothingWindow, state: JipdaState, stop: int) -> tuple[SmoothingWindow, list[TrackSnapshot]]:
    """Smooth the window; return it without old time steps, and the smoothed time steps not reported before `stop`.

    `stop` is an index in the window, one after the last time step to report; at most as many time steps as wait are
    kept as context.
    """
    if stop <= window.reported:
        return window, []
    smoothed = smooth(state, window.frames, window.snapshots, window.generator)
    coming = smoothed[window.reported : stop]
    number, next_id = _window_identities(window, coming, smoothed[max(window.reported - 1, 0)], state.metre)
    out = [_renamed(m, number) for m in coming]
    out[0] = _first(out[0], window.last)
    # As much as waits stays before it, so that tracks do not begin at the window's edge
    keep = max(2 * stop - len(window.snapshots), 0) if stop < len(window.snapshots) else stop
    keep = min(max(keep, stop - MAX_STEPS_PER_REPORT), max(stop - MIN_STEPS_PER_REPORT, 0))
    window = replace(
        window,
        frames=window.frames[keep:],
        snapshots=window.snapshots[keep:],
        reported=stop - keep,
        last=out[-1],
        next_id=next_id,
    )
    return window, out


def _window_identities(
    window: SmoothingWindow, coming: Sequence[TrackSnapshot], joint: TrackSnapshot, metre: float
) -> tuple[dict[int, int], int]:
    """Map the identities of a window to those reported before, by position at the last time step that both have.

    Args:
        window: fixed-lag window with the last reported result.
        coming: time steps to be reported.
        joint: the window's result at the time step that was reported last.
        metre: length of a metre in the scene's unit.

    Returns:
        The map (people without a match get new numbers), and the next free number.
    """
    number: dict[int, int] = {}
    if window.last is not None and len(window.last.ids) and len(joint.ids):
        separation = np.hypot(*(joint.mean[:, None, :2] - window.last.mean[None, :, :2]).transpose(2, 0, 1))
        rows, columns = linear_sum_assignment(np.minimum(separation, SAME_TARGET_DISTANCE * metre))
        for a, b in zip(rows, columns, strict=True):
            if separation[a, b] < SAME_TARGET_DISTANCE * metre:
                number[int(joint.ids[a])] = int(window.last.ids[b])
    next_id = window.next_id
    for snapshot in coming:
        for each in snapshot.ids.tolist():
            if each not in number:
                number[each] = next_id
                next_id += 1
    return number, next_id


def _renamed(snapshot: TrackSnapshot, number: dict[int, int]) -> TrackSnapshot:
    """Return a time step with identities mapped by `number` and sorted by the new ones; unmapped events are dropped."""
    ids: Ints = np.array([number[k] for k in snapshot.ids.tolist()], dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    index = np.empty(len(order), dtype=np.int64)
    index[order] = np.arange(len(order))
    events = tuple(
        Event(e.kind, number[e.id], e.other if e.other == NO_ID else number[e.other], e.probability)
        for e in snapshot.events
        if e.id in number and (e.other == NO_ID or e.other in number)
    )
    return snapshot._replace(
        ids=ids[order],
        mean=snapshot.mean[order],
        covariance=snapshot.covariance[order],
        existence=snapshot.existence[order],
        visibility=snapshot.visibility[order],
        support=snapshot.support._replace(person=index[snapshot.support.person]),
        events=events,
    )


def _first(snapshot: TrackSnapshot, last: TrackSnapshot | None) -> TrackSnapshot:
    """Return the first time step of a report, with events relative to the last reported time step.

    Events `initiated` and `terminated` are replaced, `possible_switch` stays. `last` None: nothing was reported before.
    """
    before = {} if last is None else dict(zip(last.ids.tolist(), last.existence.tolist(), strict=True))
    now = dict(zip(snapshot.ids.tolist(), snapshot.existence.tolist(), strict=True))
    events = [Event("initiated", k, NO_ID, p) for k, p in now.items() if k not in before]
    events += [Event("terminated", k, NO_ID, p) for k, p in before.items() if k not in now]
    return snapshot._replace(events=(*events, *(e for e in snapshot.events if e.kind == "possible_switch")))
