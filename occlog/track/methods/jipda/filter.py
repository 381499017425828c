"""Multi-camera JIPDA filter: predict, associate jointly in all images, update, initiate and terminate tracks.

Joint integrated probabilistic data association (Musicki and Evans 2004) with marginals by belief propagation (Williams
and Lau 2014), in the images of all cameras; occlusions are predicted from the tracks themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.plane import distance_to_boundary, inside_polygon, pockets
from occlog.records.scene import Camera, Scene, box_around, sight_limit
from occlog.settings import METRES

from .association_features import (
    AssociationFeatures,
    count_clutter_scores,
    empty_features,
    log_feature_ratios,
    update_features,
)
from .config import JipdaConfig
from .detector_model import (
    MIN_ASSOCIATION_TO_LEARN,
    MIN_EXISTENCE_TO_LEARN,
    MIN_VISIBILITY_TO_LEARN,
    Clutter,
    DetectorStatistics,
    EdgeErrorStatistics,
    clutter_rate,
    common_clutter_ratio,
    detector_model,
    established,
    gait_variance,
    manoeuvre_rate,
    no_clutter,
    persistent_clutter_density,
    persistent_clutter_probability,
    posture_change_rate,
    predict_hidden,
    prior_edge_errors,
    prior_statistics,
    reliable_boxes,
    target_death_rate,
    update_edge_errors,
    update_hidden,
    update_sources,
    update_statistics,
)
from .interface import (
    NO_ID,
    BoxAssociations,
    DetectorEstimates,
    Event,
    FrameDetections,
    PositionSource,
    TrackSnapshot,
    X,
    Y,
)
from .kernels.body_box import MODEL, POSITION_SOURCE, PackedCameras, cover_positions, pack_views
from .kernels.detections import DetectorModel, PackedDetections
from .kernels.joint_association import JipdaResult, update_targets
from .kernels.lasting_errors.bias_effects import bias_effects
from .kernels.lasting_errors.camera_disagreement import camera_disagreement
from .kernels.lasting_errors.clock_residuals import clock_residuals
from .kernels.lasting_errors.pose_residuals import pose_residuals
from .kernels.track_initiation import BirthIntensity, initiate_targets
from .lasting_errors.body_bias import bias_information, with_biases
from .lasting_errors.clock_offset import ClockStatistics, prior_clocks, update_clocks
from .lasting_errors.common_error import CommonErrorStatistics, common_error, prior_common_error, update_common_error
from .lasting_errors.pose_offset import MIN_ANGLE, PoseStatistics, corrected, prior_poses, update_poses
from .lasting_errors.position_errors import (
    WALK_RATIO,
    PositionErrors,
    lasting_error,
    manoeuvre_variance,
    position_covariances,
    prior_position_errors,
    update_position_errors,
)
from .static_clutter import is_a_person, update_static_clutter
from .target_set import (
    SMOOTHING_SIGMA_M,
    BirthIntensityMap,
    TargetSet,
    apply_exclusion_prior,
    birth_intensity,
    birth_velocity,
    concat,
    duplicate_tracks,
    empty_map,
    no_targets,
    predict,
    select,
    target_death_rate_at,
    tentative_targets,
    update,
    update_map,
    with_gait_variance,
)

BORDER_PX = 3.0
"""An edge this near to the border of the image is the border's."""
GATE_CHI2 = 30.0
"""Greatest squared Mahalanobis distance of the four edges of a box."""
BIRTH_DENSITY_PER_M2, MAX_BIRTHS_PER_IMAGE = 0.1, 10.0
"""Prior density of people [1/m^2] in regions not yet observed; and maximum number in an image."""
BIRTH_RENEWAL_S = 20.0
"""Time after which the prior number of untracked people is reached again."""
MIN_EXISTENCE_TO_INITIATE = 0.05
"""Minimum existence probability of track initiation."""
MIN_EXISTENCE_TO_REPORT = 0.5
"""Confirmed people are reported while they exist with this probability."""
VELOCITY_SETTLING_S = 1.5
"""After so long the velocity of a person who is new is known [s]."""
MAX_PREDICTION_S = 86_400.0
"""Maximum prediction time [s]: after a day the position is unknown, and in years covariances lose all digits."""
MIN_BOXES_TO_CONFIRM = 1.5
"""Minimum number of boxes for confirmation."""
MIN_POSITIONS_TO_CONFIRM = 0.5
"""Minimum number of positions for confirmation, of sources of positions alone."""
ROOM_MARGIN_M = 0.5
"""People are not initiated farther outside the room than this [m]."""
MIN_ARRIVALS = 1e-12
"""Least density of people who are missed while others arrive."""
LOG_EXCLUDED = -60.0
"""Log-likelihood ratio of a box that is not a person's."""
MAX_PREDICTION_TO_LEARN_S = 1.0
"""Maximum time that a time step counts for what is learned of the body model [s]."""
STATIC_S = 3.0
"""Age from which a source of clutter is reported as a static object [s]."""
MIN_STEPS_OF_TRUE = 1.5
"""Number of time steps with boxes from which a person is no common clutter."""
STRONG_LOG_ODDS = math.log(9.0)
"""Log odds of track initiation from which independent clutter hardly explains the boxes."""
MIN_ASSOCIATION_PROBABILITY = 0.05
"""Minimum association probability of a reported box."""
EXCLUSION_INTERVAL_NS = 50_000_000
"""Minimum interval between exclusion updates [ns]: successive frames of several cameras add no information."""
UNTRACKED_TO_CLUTTER_RATIO = 0.1
"""Prior odds that an unassigned box is of an untracked person and not clutter."""


@dataclass(frozen=True)
class JipdaState:
    """Immutable state of the multi-camera JIPDA filter between two time steps; C cameras and position sensors.

    It has the packed cameras and settings, the time of the last time step (None: no data yet), all tracks (`people`),
    and everything that is estimated online: detector statistics, box errors, common position error, association
    features, birth map, clutter sources per camera, errors of position sensors, clock offsets, camera rotations and
    body bias.
    """

    views: PackedCameras
    config: JipdaConfig
    metre: float  # in the scene's unit
    t_ns: int | None  # of the last time step; None: no data yet
    people: TargetSet
    counts: DetectorStatistics
    edges: EdgeErrorStatistics
    common: CommonErrorStatistics
    next_key: int
    last_frame_ns: Ints  # (C,) time of each camera's last frame; -1: no frame
    cues: AssociationFeatures
    birth_map: BirthIntensityMap
    clutter: tuple[Clutter, ...]  # sources in each camera
    room: Floats | None  # (K, 2) polygon in which people are; None: anywhere
    exclusion_ns: int | None  # time of the last exclusion update; None: never
    positions: PositionErrors  # of the sources of positions
    clocks: ClockStatistics
    poses: PoseStatistics
    body_bias: float  # information on it
    sigma_pose: Floats  # (C, 2) standard deviations of the stated poses: coordinates [scene unit], angles [rad]
    seeds: dict[int, float]  # score of the position that initiated each tentative track, of sources alone


def initial_state(scene: Scene, cameras: Sequence[Camera | PositionSource], config: JipdaConfig) -> JipdaState:
    """Create the filter state before the first time step: no tracks, all online estimates at their priors.

    Args:
        scene: static scene; its room, static occluders and length unit are used.
        cameras: cameras in use, with poses in space, then sources of positions; the index in this list is
            `FrameDetections.camera`.
        config: settings in the scene's unit.
    """
    # In a scene-specific unit the settings define the metre: people are 1.7 m tall
    own = config.person_height / JipdaConfig().person_height
    metre = 1.0 / METRES[scene.length_unit] if scene.length_unit in METRES else own
    far = np.full(len(cameras), math.inf)
    for k, c in enumerate(cameras):
        if not isinstance(c, PositionSource):
            low, high = box_around(scene)
            far[k] = sight_limit(c, 2.0 * float(np.hypot(*(high - low))), metre)
    walls = () if scene.room is None else pockets(scene.room)
    solid = [(o.polygon, o.height) for o in scene.occluders] + [(w, math.inf) for w in walls]
    views = pack_views(cameras, solid)._replace(range=far)
    return JipdaState(
        views=views,
        config=config,
        metre=metre,
        t_ns=None,
        people=no_targets(len(cameras)),
        counts=prior_statistics(len(cameras), config),
        edges=prior_edge_errors(len(cameras), metre, config),
        common=prior_common_error(metre),
        next_key=0,
        last_frame_ns=np.full(len(cameras), -1),
        cues=empty_features(len(cameras)),
        birth_map=empty_map(metre),
        clutter=(no_clutter(),) * len(cameras),
        room=scene.room,
        exclusion_ns=None,
        positions=prior_position_errors(cameras, metre, config),
        clocks=prior_clocks(len(cameras)),
        poses=prior_poses(views),
        body_bias=0.0,
        sigma_pose=np.array(
            [(c.sigma_position, c.sigma_yaw) if isinstance(c, Camera) else (0.0, 0.0) for c in cameras]
        ),
        seeds={},
    )


def step(state: JipdaState, frames: Sequence[FrameDetections]) -> tuple[JipdaState, TrackSnapshot]:
    """Run one JIPDA time step: predict, associate, update, initiate, confirm and terminate tracks, learn the detectors.

    Args:
        state: state after the time step before; not changed.
        frames: detections of at least one frame; the frames' times may differ a little, the latest is the time step's.

    Returns:
        The new state, and a snapshot of the confirmed tracks with associations and events.
    """
    config = state.config
    t_ns = max(frame.t_ns for frame in frames)
    dt = 0.0 if state.t_ns is None else min((t_ns - state.t_ns) / NS, MAX_PREDICTION_S)
    # Predict
    common = common_error_of(state)
    people = predict(
        state.people,
        t_ns,
        dt=dt,
        leaving=target_death_rate_at(state.birth_map, state.people.mean[:, :2], target_death_rate(state.counts)),
        turning=manoeuvre_rate(state.counts),
        bending=posture_change_rate(state.counts),
        common=common,
        config=replace(config, process_noise_density=WALK_RATIO * config.process_noise_density)
        if state.positions.alone
        else config,
    )
    exclusion_ns = state.exclusion_ns
    if config.exclusion_radius > 0.0 and (exclusion_ns is None or t_ns - exclusion_ns >= EXCLUSION_INTERVAL_NS):
        people, exclusion_ns = apply_exclusion_prior(people, config.exclusion_radius), t_ns
    # Associate and update
    state = replace(state, views=_covered(state, frames))
    boxes = pack_detections(state, frames, t_ns)
    last_frame_ns, interval = state.last_frame_ns.copy(), np.full(len(state.last_frame_ns), np.inf)
    for frame in frames:
        if frame.t_ns > last_frame_ns[frame.camera] >= 0:
            interval[frame.camera] = min((frame.t_ns - last_frame_ns[frame.camera]) / NS, MAX_PREDICTION_S)
        last_frame_ns[frame.camera] = frame.t_ns
    rates = detector_model(state.counts, state.edges, config, interval)
    gait = gait_variance(state.edges)
    dimension = max(state.cues.appearance.shape[1], *(frame.appearance.shape[1] for frame in frames))
    for_people, for_anybody = log_feature_ratios(state.cues, people, list(frames), dimension)
    before = persistent_clutter_density(
        boxes, state.clutter, persistent_clutter_probability(state.counts), rates.noise, state.views.size
    )
    anywhere = np.exp(boxes.clutter)
    boxes = boxes._replace(clutter=boxes.clutter - for_anybody)
    static = persistent_clutter_density(
        boxes,
        [established(c) for c in state.clutter],
        persistent_clutter_probability(state.counts),
        rates.noise,
        state.views.size,
    )
    for_people = for_people - np.log1p(np.where(people.id[:, None] == NO_ID, before, static) / anywhere)
    N = len(people.key)
    people = replace(people, hidden=predict_hidden(people.hidden, interval, state.counts))
    everywhere, at = birth_intensity(
        state.birth_map, BIRTH_DENSITY_PER_M2 / state.metre**2 / BIRTH_RENEWAL_S, BIRTH_RENEWAL_S
    )
    since = BIRTH_RENEWAL_S if state.t_ns is None else min(dt, BIRTH_RENEWAL_S)
    arrivals = everywhere * since * (1.0 + common_clutter_ratio(state.counts))
    result = associate(
        people.body_mean,
        with_gait_variance(people, gait),
        people.existence,
        state.views,
        boxes,
        rates,
        for_people,
        arrivals,
        people.hidden,
    )
    before_update, predicted, hidden = people.existence, people.body_mean, people.hidden
    people = update(people, result.information, result.vector, gait, config)
    explained = (result.beta + result.joint).sum(axis=1)
    detected = (explained > 0.5)[:, None]
    people = replace(
        people,
        existence=result.existence,
        hidden=update_hidden(people.hidden, boxes, result),
        last=np.where(detected, people.mean[:, :2], people.last),
        boxes=people.boxes + explained,
        steps=people.steps + result.existence * np.minimum(explained, 1.0),
        seen_ns=np.where(np.isfinite(result.visible).any(axis=0), t_ns, people.seen_ns),
    )
    people = update_static_clutter(
        people, boxes, static > anywhere, result, rates.noise, interval, state.metre, state.positions.first, hidden
    )
    counts = update_statistics(
        state.counts, people, before_update, dt=dt, config=config, boxes=boxes, rates=rates, result=result,
        interval=interval, alone=state.positions.alone,
    )  # fmt: skip
    good = reliable_boxes(
        boxes,
        result.owner,
        result.beta,
        result.visible,
        people.existence > MIN_EXISTENCE_TO_LEARN,
        MIN_VISIBILITY_TO_LEARN,
    )
    good &= result.odd < 0.5
    settled = (t_ns - people.initiated_ns >= VELOCITY_SETTLING_S * NS)[result.owner] if N else good
    clocks = update_clocks(
        state.clocks,
        t_ns,
        *clock_residuals(
            predicted, state.views, boxes, result.owner, good & settled, state.clocks.late, state.clocks.centre
        ),
    )
    found = camera_disagreement(result.mean, result.covariance, state.views, boxes, rates, result.owner, good)
    edges = update_edge_errors(state.edges, t_ns, boxes, found, key=people.key, owner=result.owner, lasts=rates.lasting)
    poses = update_poses(
        state.poses,
        t_ns,
        pose_residuals(result.mean, result.covariance, state.views, boxes, rates, result.owner, good),
    )
    if np.abs(poses.angles - state.poses.angles).max() > MIN_ANGLE:
        # Residuals of other orientations say nothing of the clocks
        blank = prior_clocks(len(clocks.late))
        clocks = replace(clocks, batches=blank.batches, sums=blank.sums, limit=blank.limit)
    positions = _learned_positions(state, frames, boxes, people, result.owner, result.beta)
    errors = update_common_error(
        state.common, t_ns, key=people.key, position=found.position, noise=found.variance + gait, config=config
    )
    # Track initiation from unassigned boxes
    body = np.array(
        [
            config.person_height,
            config.sigma_person_height,
            config.person_width,
            config.sigma_person_width,
            config.sigma_initial_velocity,
        ]
    )
    arrival = BirthIntensity(
        everywhere * since,
        MAX_BIRTHS_PER_IMAGE * since / BIRTH_RENEWAL_S,
        state.birth_map.centre,
        at * since,
        SMOOTHING_SIGMA_M * state.metre,
    )
    spread = np.sqrt(0.5 * (people.body_covariance[:, 0, 0] + people.body_covariance[:, 1, 1]))
    mean, covariance, odds, used = initiate_targets(
        state.views, boxes, rates, body, arrival, people.body_mean, spread, people.existence, result.free,
        GATE_CHI2, math.log(MIN_EXISTENCE_TO_INITIATE),
    )  # fmt: skip
    # A detector that fuses the cameras finds people in all of them who are not there
    existence = 1.0 / (1.0 + np.exp(-odds) + common_clutter_ratio(state.counts))
    covariance[:, [X, Y], [X, Y]] += gait
    mean[:, 2:4], covariance[:, 2:4, 2:4] = birth_velocity(state.birth_map, mean[:, :2], config.sigma_initial_velocity)
    if state.room is not None:
        existence = np.where(_in_room(mean[:, :2], state.room, ROOM_MARGIN_M * state.metre), existence, 0.0)
    K = len(odds)
    beta, left_free = (
        np.concatenate([result.beta, used]),
        result.free * np.prod(1.0 - existence[:, None] * used, axis=0),
    )
    # Sources of clutter: boxes of no person, and of tracks that are static clutter
    phantom = 1.0 - is_a_person(people.static_log_odds)
    unreal = np.clip(left_free + phantom @ (result.beta + 0.5 * result.joint), 0.0, 1.0)
    counts, clutter = _update_clutter(counts, boxes, unreal, state.clutter, rates.noise, interval)
    people = concat(
        people,
        tentative_targets(
            mean,
            covariance,
            existence,
            used.sum(axis=1),
            state.next_key,
            t_ns,
            common[0],
            odds > STRONG_LOG_ODDS,
            len(state.views.size),
        ),
    )
    cues = update_features(
        state.cues,
        people,
        list(frames),
        dimension,
        beta=beta,
        free=left_free,
        sure=people.existence > config.confirmation_threshold,
    )
    # Confirm, end; a position on the ground is of a whole body, and mostly of several views
    real = people.existence * is_a_person(people.static_log_odds)
    fewest = MIN_POSITIONS_TO_CONFIRM if positions.alone else MIN_BOXES_TO_CONFIRM
    sure = (real > config.confirmation_threshold) & (people.boxes > fewest)
    ids = np.where((people.id == NO_ID) & sure, people.key, people.id)
    people, twice = duplicate_tracks(people, t_ns)
    stays = (real > config.termination_threshold) & ~twice
    left, new = ~stays & (people.id != NO_ID), stays & (ids != NO_ID) & (people.id == NO_ID)
    counts = replace(counts, left=counts.left + np.array([left.sum(), dt * people.existence[ids != NO_ID].sum()]))
    events = [Event("initiated", int(ids[k]), NO_ID, float(people.existence[k])) for k in np.flatnonzero(new)]
    events += [Event("terminated", int(ids[k]), NO_ID, float(people.existence[k])) for k in np.flatnonzero(left)]
    # Tracks old enough to have a velocity update the birth map, tracks that end the departure map
    age = (t_ns - people.initiated_ns) / NS
    sure = people.id != NO_ID
    grown = sure & (age >= VELOCITY_SETTLING_S) & (age - dt < VELOCITY_SETTLING_S)
    birth_map = update_map(
        state.birth_map, dt, people=people.mean[sure, :2], existence=people.existence[sure], left=people.last[left],
        came=people.first[grown], velocity=people.mean[grown, 2:4],
    )  # fmt: skip
    seeds, cues = _false_seeds(state, frames, used, people.key[len(people.key) - K :], ids, people.key[stays], cues)
    rows = np.flatnonzero(stays)
    recurring = people.strong & (people.steps >= MIN_STEPS_OF_TRUE)
    fleeting = people.strong & ~recurring & ~stays & ~twice
    people = replace(people, strong=people.strong & ~recurring)
    counts = replace(counts, false=counts.false + np.array([fleeting.sum(), recurring.sum(), 1.0]))
    kept = select(replace(people, id=ids), rows)
    # Report
    shown = np.flatnonzero((kept.id != NO_ID) & (real[rows] > MIN_EXISTENCE_TO_REPORT))
    visible = np.full((len(state.views.size), len(people.key)), np.nan)
    visible[boxes.camera, :N] = result.visible
    beta = beta[rows[shown]] * kept.existence[shown, None]
    joint = np.concatenate([result.joint, np.zeros_like(used)])[rows[shown]] * kept.existence[shown, None]
    shift, share, from_poses = bias_effects(
        kept.mean[shown], kept.covariance[shown], state.views, rates, state.sigma_pose
    )
    body_bias = state.body_bias + bias_information(share, min(dt, MAX_PREDICTION_TO_LEARN_S))
    snapshot = TrackSnapshot(
        t_ns=t_ns,
        ids=kept.id[shown],
        mean=kept.mean[shown],
        covariance=with_biases(kept.covariance[shown], shift, body_bias, from_poses),
        existence=real[rows[shown]],
        visibility=np.ascontiguousarray(visible[:, rows[shown]].T),
        support=associations_of(beta, joint, boxes, frames),
        events=tuple(events),
        detectors=DetectorEstimates(
            math.sqrt(common[0]),
            common[1],
            np.array([np.count_nonzero(established(c).age >= STATIC_S) for c in clutter], dtype=np.int64),
            clocks.late,
            clocks.limit,
            clocks.history,
            clocks.history_s,
            poses.angles,
            poses.limit,
        ),
    )
    next_key = state.next_key + K
    return replace(
        state,
        t_ns=t_ns,
        people=kept,
        counts=counts,
        edges=edges,
        common=errors,
        next_key=next_key,
        last_frame_ns=last_frame_ns,
        cues=cues,
        birth_map=birth_map,
        clutter=clutter,
        exclusion_ns=exclusion_ns,
        positions=positions,
        clocks=clocks,
        poses=poses,
        body_bias=body_bias,
        views=state.views if poses.angles is state.poses.angles else corrected(state.views, poses),
        seeds=seeds,
    ), snapshot


def common_error_of(state: JipdaState) -> tuple[float, float]:
    """Return variance per axis [scene unit^2] and correlation time [s] of the position error common to all sensors.

    With position sensors alone it is the time-correlated error of the best of them, else that learned from the cameras.
    """
    return lasting_error(state.positions) if state.positions.alone else common_error(state.common)


def _false_seeds(
    state: JipdaState,
    frames: Sequence[FrameDetections],
    used: Floats,
    new: Ints,
    ids: Ints,
    stay: Ints,
    cues: AssociationFeatures,
) -> tuple[dict[int, float], AssociationFeatures]:
    """Keep the scores of detections that initiated tentative tracks; count those of terminated ones as clutter.

    With a single sensor no other one contradicts a detection at once: whether it was clutter is known when the
    tentative track ends. With cameras nothing is kept.

    Args:
        state: state of the filter before the time step, with the kept scores by track key.
        frames: detections of each frame of the time step; M in all.
        used: (K, M) probability that a detection is of each new track.
        new: (K,) keys of the new tracks.
        ids: identities of all tracks, NO_ID of tentative ones.
        stay: keys of the tracks that are not terminated.
        cues: association features before.

    Returns:
        Detection score by key of each tentative track that continues, and the features with the clutter scores added.
    """
    if not state.positions.alone:
        return {}, cues
    confirmed, going = set(ids[ids != NO_ID].tolist()), set(stay.tolist())
    ended = [score for key, score in state.seeds.items() if key not in going and key not in confirmed]
    seeds = {key: score for key, score in state.seeds.items() if key in going and key not in confirmed}
    score = np.concatenate([frame.score for frame in frames])
    for key, row in zip(new.tolist(), used, strict=True):
        if key in going and key not in confirmed and len(row):
            seeds[key] = float(score[int(np.argmax(row))])
    return seeds, count_clutter_scores(cues, np.array(ended))


def _covered(state: JipdaState, frames: Sequence[FrameDetections]) -> PackedCameras:
    """Return the packed cameras, with the coverage of position sensors extended to the positions in the frames.

    Frames of cameras change nothing; `state` is not changed.
    """
    views = state.views
    for frame in frames:
        if views.lens[frame.camera, MODEL] == POSITION_SOURCE:
            views = cover_positions(views, frame.camera, frame.boxes[:, :2], state.metre)
    return views


def _learned_positions(
    state: JipdaState,
    frames: Sequence[FrameDetections],
    boxes: PackedDetections,
    people: TargetSet,
    owner: Ints,
    beta: Floats,
) -> PositionErrors:
    """Return the error model of position sensors, updated with positions that surely belong to an existing person.

    Frames of cameras (without `covariance`) are skipped; M detections, N people.

    Args:
        state: state of the filter before the time step.
        frames: detections of each frame of the time step.
        boxes: these detections, packed, in the order of `frames`.
        people: N people after the update.
        owner: (M,) index of the likeliest person of a detection; negative: none.
        beta: (N, M) probability that a detection is of a person alone.
    """
    errors = state.positions
    for k, frame in enumerate(frames):
        if frame.covariance is None:
            continue
        at = np.arange(boxes.first[k], boxes.first[k + 1])
        at = at[owner[at] >= 0]
        sure = (beta[owner[at], at] > MIN_ASSOCIATION_TO_LEARN) & (people.existence[owner[at]] > MIN_EXISTENCE_TO_LEARN)
        at = at[sure]
        inside = at - boxes.first[k]
        errors = update_position_errors(
            errors, frame.camera, frame.t_ns, frame.boxes[inside, :2], frame.covariance[inside], people.key[owner[at]],
            people.key,
        )  # fmt: skip
    return errors


def _in_room(xy: Floats, room: Floats, margin: float) -> Bools:
    """Return (n,) mask of positions `xy` (n, 2) inside polygon `room` (K, 2), or closer than `margin` to its border."""
    near = [distance_to_boundary(float(x), float(y), room) < margin for x, y in xy]
    return np.asarray(inside_polygon(xy, room) | np.array(near, dtype=np.bool_))


def associate(
    mean: Floats,
    covariance: Floats,
    existence: Floats,
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    log_features: Floats,
    arrivals: float,
    hidden: Floats,
) -> JipdaResult:
    """JIPDA update of N people by the M boxes of one time step, allowing for a new person seen by all cameras.

    In each image a box is a person's or clutter. Where boxes of several cameras agree on a position far from a track,
    the update is repeated without these boxes if a miss in all cameras and a new arrival are more probable.

    Args:
        mean: (N, 6) predicted x, y, vx, vy, height, width of the visible bodies.
        covariance: (N, 6, 6) covariances of these states.
        existence: (N,) predicted existence probabilities.
        views: C cameras and position sensors.
        boxes: M boxes of the time step's frames, packed.
        rates: parameters of the cameras' detectors.
        log_features: (N, M) log-likelihood ratios of tracklet ids, appearance and persistent clutter.
        arrivals: expected number of new people in the time step, per unit of area.
        hidden: (N, C) probability that an unmodelled obstacle hides the person from each camera.
    """
    result = update_targets(
        mean, covariance, existence, views, boxes, rates, log_features, UNTRACKED_TO_CLUTTER_RATIO, GATE_CHI2, hidden
    )
    off, P = (result.mean - mean)[:, :2], covariance[:, :2, :2]
    log = -0.5 * np.einsum("ni,ni->n", off, np.linalg.solve(P, off[..., None])[..., 0])
    log -= 0.5 * np.linalg.slogdet(P)[1] + math.log(2.0 * math.pi)
    far = log < math.log(max(rates.common_miss * arrivals, MIN_ARRIVALS))
    if not far.any():
        return result
    log_features = np.where(far[:, None] & (result.beta > MIN_ASSOCIATION_PROBABILITY), LOG_EXCLUDED, log_features)
    return update_targets(
        mean, covariance, existence, views, boxes, rates, log_features, UNTRACKED_TO_CLUTTER_RATIO, GATE_CHI2, hidden
    )


def pack_detections(state: JipdaState, frames: Sequence[FrameDetections], t_ns: int) -> PackedDetections:
    """Pack the frames of the time step at `t_ns` into arrays for the kernels.

    The result has the M boxes of all frames in their order, the delay of each frame after `t_ns` [s] with the clock
    offset of its camera removed, which edges are not cut by the image border, the log clutter rate, and for position
    sensors the noise covariances.
    """
    box = np.concatenate([frame.boxes for frame in frames]).reshape(-1, 4).astype(np.float64)
    camera = np.array([frame.camera for frame in frames], dtype=np.int64)
    count = [len(frame.boxes) for frame in frames]
    each = np.repeat(camera, count)
    w, h = state.views.size[each].T
    border = np.column_stack([np.zeros_like(w), np.zeros_like(h), w - 1.0, h - 1.0])
    usable, covariance, tail = np.abs(box - border) > BORDER_PX, np.full((0, 3), np.nan), np.zeros(0)
    if state.positions.banks:
        above = state.views.lens[each, MODEL] == POSITION_SOURCE
        usable[above] = [True, True, False, False]
        covariance = np.concatenate([_covariances(state, frame) for frame in frames])
        tail = np.repeat([manoeuvre_variance(state.positions, frame.camera, state.metre) for frame in frames], count)
    return PackedDetections(
        camera=camera,
        delay=np.array([(frame.t_ns - t_ns) / NS for frame in frames]) - state.clocks.late[camera],
        first=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
        box=box,
        usable=usable,
        clutter=np.log(clutter_rate(state.counts)[each]),
        covariance=covariance,
        tail=tail,
    )


def _covariances(state: JipdaState, frame: FrameDetections) -> Floats:
    """Return noise covariances (n, 3) xx, xy, yy [scene unit^2] of a frame's n positions, by the error model.

    All are NaN for a frame of a camera, which has boxes.
    """
    if frame.covariance is None:
        return np.full((len(frame.boxes), 3), np.nan)
    return position_covariances(state.positions, frame.camera, frame.covariance)


def _update_clutter(
    counts: DetectorStatistics,
    boxes: PackedDetections,
    free: Floats,
    sources: Sequence[Clutter],
    noise: Floats,
    interval: Floats,
) -> tuple[DetectorStatistics, tuple[Clutter, ...]]:
    """Update clutter rates and clutter sources with the boxes that neither existing nor new tracks explain.

    Args:
        counts: detector statistics before the time step.
        boxes: frames of the time step with their M boxes, packed.
        free: (M,) probability that a box is of no person.
        sources: clutter sources of each of C cameras.
        noise: (4, 2) variances of box centre and width, centre and height: constant [px^2], and factor of the squared
            size.
        interval: (C,) time since each camera's last frame [s]; may be infinite.

    Returns:
        The statistics with clutter counts and persistence counts added, and the clutter sources of each camera.
    """
    clutter, again = counts.clutter.copy(), counts.again.copy()
    rate, out = persistent_clutter_probability(counts), list(sources)
    for frame, c in enumerate(boxes.camera.tolist()):
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        clutter[c] += (free[here].sum(), 1.0)
        out[c], counted = update_sources(
            sources[c], boxes.box[here], free[here], float(rate[c]), noise, float(interval[c])
        )
        again[c] += counted
    return replace(counts, clutter=clutter, again=again), tuple(out)


def associations_of(
    beta: Floats, joint: Floats, boxes: PackedDetections, frames: Sequence[FrameDetections]
) -> BoxAssociations:
    """Return the pairs of a person and a box with an association probability above `MIN_ASSOCIATION_PROBABILITY`.

    Args:
        beta: (N, M) probability that a box is a person's alone.
        joint: (N, M) probability that a box is the merged detection of the person and a neighbour.
        boxes: M boxes, packed.
        frames: frames of the time step, in the order of the packed boxes; they give the table rows.
    """
    person, box = np.nonzero(beta + joint > MIN_ASSOCIATION_PROBABILITY)
    camera = np.repeat(boxes.camera, np.diff(boxes.first))
    row = np.concatenate([frame.row for frame in frames])
    both = joint[person, box]
    return BoxAssociations(person, camera[box], row[box], beta[person, box] + both, both)
