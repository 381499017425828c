"""Set of tracks: prediction between time steps, mixing of motion models, duplicate tracks, birth intensity map.

Motion models: constant velocity, manoeuvre, posture change (bending, falling, getting up). They differ in white
acceleration and change of body size, and are mixed and merged as by an interacting multiple model estimator (Blom and
Bar-Shalom 1988, IEEE T-AC 33(8)). Association uses one Gaussian of each person, that of the mixture; its information, a
Gaussian factor, updates all models and their probabilities.

Maps of birth and departure rates on the ground plane are estimated online: arrivals, departures and dwell times are
counted in cells of the floor and smoothed by a Gaussian. Cells without counts have the rates of the whole area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints

from .config import JipdaConfig
from .interface import HEIGHT, NO_ID, STATE_SIZE, WIDTH, X, Y
from .kernels.exclusion import apply_exclusion

ERROR = STATE_SIZE, STATE_SIZE + 1
"""Indices of the common error of position in the full state, after the person's state."""
FULL_SIZE = STATE_SIZE + 2
BODY = np.eye(STATE_SIZE, FULL_SIZE)
BODY[[X, Y], ERROR] = 1.0
WALK = np.eye(STATE_SIZE, FULL_SIZE)
"""The state that cameras observe, and that of the walk, of the full one."""
_COMMON_AT_FIRST = np.zeros((FULL_SIZE, FULL_SIZE))
for _a, _e in zip((X, Y), ERROR, strict=True):
    _COMMON_AT_FIRST[[_a, _e], [_a, _e]] = 1.0
    _COMMON_AT_FIRST[[_a, _e], [_e, _a]] = -1.0
CONSTANT_VELOCITY, MANOEUVRE, POSTURE_CHANGE = MODELS = 0, 1, 2
SIZE_NOISE_PER_ROOT_S = 0.01
"""Standard deviation by which a body changes in a second, as a share of its size: how people carry themselves."""
POSTURE_HEIGHT_NOISE, POSTURE_WIDTH_NOISE = 0.4, 0.8
"""Process noise of height and width while a person bends, falls, lies or gets up."""
MIN_SIZE_RATIO = 0.15
"""Minimum height and width of a body, as a share of the usual ones."""
MIN_EXISTENCE_COMPLEMENT = 1e-6
"""Limit of existence probabilities, and of their complements."""
DEATH_RATE_OUT_OF_VIEW, OUT_OF_VIEW_AFTER_S = 0.5, 1.0
"""Time out of all camera views [s] after which people leave at this rate [1/s]."""
DUPLICATE_DISTANCE_WIDTHS, DUPLICATE_TIME_S = 0.5, 2.0
"""Maximum distance of duplicate tracks, in widths, and minimum time [s]."""
PRIOR_STATIC_LOG_ODDS = -4.0
"""Log odds that a new track is static clutter of one camera."""
DUPLICATE_EXISTENCE_RATIO = 0.5
"""Of two duplicate tracks the older one is kept, unless its existence is below this share of the other's."""


@dataclass(frozen=True)
class TargetSet:
    """N tracks of people, tentative or confirmed: arrays with one row per track.

    `mean` (N, 6) is x, y, vx, vy, height, width of the walking person, and `body_mean` that of the body as cameras
    observe it, with the common position error; both with covariances (N, 6, 6). `model` (N, 3) are probabilities of
    constant velocity, manoeuvre and posture change, `means` (N, 3, 8) and `covariances` their states (the six, and the
    common error in x and y). Further columns are existence, key and identity (`NO_ID`: tentative), counts of boxes,
    times and positions of the first and last detection, the static-clutter test, and `hidden` (N, C), the probability
    of unmodelled occlusion.
    """

    mean: Floats  # (N, 6) as `TrackSnapshot.mean`, of all models together
    covariance: Floats  # (N, 6, 6)
    body_mean: Floats  # (N, 6) of the body that cameras observe: its position has the common error
    body_covariance: Floats  # (N, 6, 6)
    existence: Floats  # (N,)
    key: Ints  # (N,) number of the initiation, ascending; the identity once confirmed
    id: Ints  # (N,) NO_ID: tentative track
    seen_ns: Ints  # (N,) when a camera last showed the position
    boxes: Floats  # (N,) expected number of boxes that spoke for them
    steps: Floats  # (N,) expected number of time steps with a box
    strong: Bools  # (N,) initiated by boxes that independent clutter hardly explains
    static_camera: Ints  # (N,) camera of the first box; -1: none yet
    static_box: Floats  # (N, 4) last box in it [px]
    static_known: Bools  # (N,) the box is at an established source of clutter
    static_log_odds: Floats  # (N,) log odds that the track is static clutter of this camera
    initiated_ns: Ints  # (N,)
    hidden: Floats  # (N, C) probability that something unknown hides them from each camera
    separated_ns: Ints  # (N,) when they last stood apart from all other people
    first: Floats  # (N, 2) where they were detected first
    last: Floats  # (N, 2) where they were detected last
    model: Floats  # (N, 3) probabilities of the models
    means: Floats  # (N, 3, 8) of each model: the state, and the common error of the observed position
    covariances: Floats  # (N, 3, 8, 8)


def tentative_targets(
    mean: Floats,
    covariance: Floats,
    existence: Floats,
    boxes: Floats,
    first_key: int,
    t_ns: int,
    common: float = 0.0,
    strong: Bools | None = None,
    cameras: int = 0,
) -> TargetSet:
    """Create K tentative tracks (identity `NO_ID`, model constant velocity) that were initiated at one time step.

    Args:
        mean: (K, 6) x, y, vx, vy, height, width of the observed bodies.
        covariance: (K, 6, 6) covariances of these states.
        existence: (K,) existence probabilities.
        boxes: (K,) expected number of boxes that each was initiated from.
        first_key: key of the first track; the keys of the others follow.
        t_ns: time of the time step.
        common: variance per axis of the position error common to all cameras; the walking position is the observed one
            less this error.
        strong: (K,) initiated by boxes that independent clutter hardly explains; None: none of them.
        cameras: number C of cameras, for `TargetSet.hidden`.
    """
    K = len(mean)
    full = np.zeros((K, FULL_SIZE, FULL_SIZE))
    full[:, :STATE_SIZE, :STATE_SIZE] = covariance
    full += common * _COMMON_AT_FIRST
    means = np.concatenate([mean, np.zeros((K, FULL_SIZE - STATE_SIZE))], axis=1)
    return TargetSet(
        mean=mean,
        covariance=full[:, :STATE_SIZE, :STATE_SIZE],
        body_mean=mean,
        body_covariance=covariance,
        existence=existence,
        key=first_key + np.arange(K),
        id=np.full(K, NO_ID, dtype=np.int64),
        seen_ns=np.full(K, t_ns, dtype=np.int64),
        boxes=boxes,
        steps=np.minimum(boxes, 1.0),
        strong=np.zeros(K, dtype=np.bool_) if strong is None else strong,
        static_camera=np.full(K, -1, dtype=np.int64),
        static_box=np.zeros((K, 4)),
        static_known=np.zeros(K, dtype=np.bool_),
        static_log_odds=np.full(K, PRIOR_STATIC_LOG_ODDS),
        initiated_ns=np.full(K, t_ns, dtype=np.int64),
        hidden=np.zeros((K, cameras)),
        separated_ns=np.full(K, t_ns, dtype=np.int64),
        first=mean[:, :2].copy(),
        last=mean[:, :2].copy(),
        model=np.tile(np.eye(len(MODELS))[CONSTANT_VELOCITY], (K, 1)),
        means=np.repeat(means[:, None], len(MODELS), axis=1),
        covariances=np.repeat(full[:, None], len(MODELS), axis=1),
    )


def no_targets(cameras: int = 0) -> TargetSet:
    """Return a `TargetSet` of zero tracks for `cameras` cameras."""
    return tentative_targets(
        np.zeros((0, STATE_SIZE)),
        np.zeros((0, STATE_SIZE, STATE_SIZE)),
        np.zeros(0),
        np.zeros(0),
        0,
        0,
        0.0,
        np.zeros(0, bool),
        cameras,
    )


def select(people: TargetSet, rows: Ints) -> TargetSet:
    """Return a new set with the tracks at `rows`: indices, in this order, or a mask (N,)."""
    return TargetSet(**{name: value[rows] for name, value in vars(people).items()})


def concat(people: TargetSet, more: TargetSet) -> TargetSet:
    """Return a new set with the tracks of `people` followed by those of `more`."""
    return TargetSet(**{name: np.concatenate([value, getattr(more, name)]) for name, value in vars(people).items()})


def predict(
    people: TargetSet,
    t_ns: int,
    *,
    dt: float,
    leaving: Floats,
    turning: float,
    bending: float,
    common: tuple[float, float],
    config: JipdaConfig,
) -> TargetSet:
    """Return the tracks predicted `dt` seconds later, by the mixing and prediction steps of the IMM estimator.

    Existence falls with the rate of leaving; identities and counts stay. The argument is not changed.

    Args:
        people: N tracks at the last time step.
        t_ns: time of the prediction.
        dt: time since the last time step [s], >= 0.
        leaving: (N,) rates at which people leave [1/s]; at least `DEATH_RATE_OUT_OF_VIEW` is used for tracks that
            have been out of all images for `OUT_OF_VIEW_AFTER_S`.
        turning: rate at which people with constant velocity begin a manoeuvre [1/s].
        bending: rate at which people begin to bend, fall, lie down or get up [1/s].
        common: variance per axis [scene unit^2] and correlation time [s] of the common position error.
        config: process noise, durations of manoeuvres and posture changes, usual body size.
    """
    # Mix the models: [0] after [1] before
    to = _transitions(dt, turning, bending, config)
    joint = people.model[:, None, :] * to
    model = joint.sum(axis=2)
    weight = joint / np.maximum(model, 1e-300)[..., None]
    means = np.einsum("nab,nbi->nai", weight, people.means)
    difference = people.means[:, None, :, :] - means[:, :, None, :]
    covariances = np.einsum("nab,nbij->naij", weight, people.covariances)
    covariances += np.einsum("nab,nabi,nabj->naij", weight, difference, difference)
    # White acceleration, integrated (Bar-Shalom, Li and Kirubarajan 2001, Sec. 6.2.2)
    F, Q = np.eye(FULL_SIZE), np.zeros((len(MODELS), FULL_SIZE, FULL_SIZE))
    q = np.array([config.process_noise_density, config.manoeuvre_noise_density, config.manoeuvre_noise_density])
    for component, velocity in ((0, 2), (1, 3)):
        F[component, velocity] = dt
        Q[:, component, component], Q[:, velocity, velocity] = q * dt**3 / 3.0, q * dt
        Q[:, component, velocity] = Q[:, velocity, component] = q * dt**2 / 2.0
    Q[:, HEIGHT, HEIGHT] = (
        np.array([SIZE_NOISE_PER_ROOT_S, SIZE_NOISE_PER_ROOT_S, POSTURE_HEIGHT_NOISE]) * config.person_height
    ) ** 2 * dt
    Q[:, WIDTH, WIDTH] = (
        np.array([SIZE_NOISE_PER_ROOT_S, SIZE_NOISE_PER_ROOT_S, POSTURE_WIDTH_NOISE]) * config.person_width
    ) ** 2 * dt
    # First-order Gauss-Markov process
    square, time = common
    rho = math.exp(-dt / time)
    for a in ERROR:
        F[a, a] = rho
        Q[:, a, a] = square * (1.0 - rho * rho)
    outside = t_ns - people.seen_ns > OUT_OF_VIEW_AFTER_S * NS
    rate = np.where(outside, np.maximum(leaving, DEATH_RATE_OUT_OF_VIEW), leaving)
    people = replace(
        people,
        model=model,
        means=means @ F.T,
        covariances=F @ covariances @ F.T + Q,
        existence=np.clip(
            people.existence * np.exp(-dt * rate), MIN_EXISTENCE_COMPLEMENT, 1.0 - MIN_EXISTENCE_COMPLEMENT
        ),
    )
    return _mixture_moments(people)


def update(
    people: TargetSet,
    information: Floats,
    vector: Floats,
    gait_variance: float,
    config: JipdaConfig,
    observed: Floats = BODY,
) -> TargetSet:
    """Return the tracks updated by a Gaussian likelihood factor exp(-x' I x / 2 + x' v) of each state x.

    All three motion models and their probabilities are updated (information filter); existence is not.

    Args:
        people: N tracks as predicted; not changed.
        information: (N, 6, 6) I, of the states x, y, vx, vy, height, width.
        vector: (N, 6) v.
        gait_variance: variance per axis of the visible body about the walking position; the factor is of the visible
            body.
        config: usual body height and width; estimates stay above `MIN_SIZE_RATIO` times these.
        observed: (6, 8) matrix from the full state (with the common position error) to the observed one: `BODY` for
            cameras, `WALK` for sensors without this error.
    """
    information, vector = without_gait_variance(information, vector, gait_variance)
    information, vector = observed.T @ information @ observed, vector @ observed
    # Each model: post = P (1 + I P)^-1, which also holds for states that are known exactly, and the evidence: the
    # integral of prior and factor
    J = information[:, None]
    inner = np.eye(FULL_SIZE) + J @ people.covariances
    covariances = people.covariances @ np.linalg.inv(inner)
    covariances = 0.5 * (covariances + covariances.swapaxes(-1, -2))
    Jm = np.einsum("naij,naj->nai", np.broadcast_to(J, inner.shape), people.means)
    off = vector[:, None] - Jm
    means = people.means + np.einsum("naij,naj->nai", covariances, off)
    evidence = -0.5 * np.linalg.slogdet(inner)[1]
    evidence += np.einsum("nai,nai->na", people.means, vector[:, None] - 0.5 * Jm)
    evidence += 0.5 * np.einsum("nai,naij,naj->na", off, covariances, off)
    model = people.model * np.exp(evidence - evidence.max(axis=1, keepdims=True))
    model /= model.sum(axis=1, keepdims=True)
    for size, usual in ((HEIGHT, config.person_height), (WIDTH, config.person_width)):
        np.maximum(means[..., size], MIN_SIZE_RATIO * usual, out=means[..., size])
    return _mixture_moments(replace(people, model=model, means=means, covariances=covariances))


def without_gait_variance(information: Floats, vector: Floats, gait_variance: float | Floats) -> tuple[Floats, Floats]:
    """Convolve N Gaussian factors exp(-x' I x / 2 + x' v) with position noise of variance W = `gait_variance` per axis.

    `information` (N, 6, 6) is I and `vector` (N, 6) is v; the new I and v are returned. W is one number or (N,), in
    scene unit^2. With B the columns of the position, I becomes I - I B (W^-1 + B' I B)^-1 B' I (Woodbury).
    """
    across = information[:, :, :2]
    W = np.reshape(np.asarray(gait_variance), (-1, 1, 1))
    inner = W * np.linalg.inv(np.eye(2) + W * information[:, :2, :2])
    gain = across @ inner
    return information - gain @ across.swapaxes(1, 2), vector - np.einsum("nij,nj->ni", gain, vector[:, :2])


def with_gait_variance(people: TargetSet, gait_variance: float) -> Floats:
    """Return the observed bodies' covariances (N, 6, 6) with `gait_variance` [scene unit^2] added for x and y."""
    out = people.body_covariance.copy()
    out[:, [X, Y], [X, Y]] += gait_variance
    return out


def apply_exclusion_prior(people: TargetSet, s: float) -> TargetSet:
    """Return the tracks multiplied by the exclusion prior 1 - exp(-d^2 / (2 s^2)) for each pair at distance d.

    Positions of close tracks move apart, their covariances and model probabilities change. The argument is not changed.

    Args:
        people: tracks as predicted.
        s: exclusion radius in the scene's unit, > 0.
    """
    if len(people.key) < 2:
        return people
    model, means, covariances = people.model.copy(), people.means.copy(), people.covariances.copy()
    position, spread = people.mean[:, [X, Y]], people.covariance[:, :2, :2].copy()
    apply_exclusion(means, covariances, model, position, spread, people.existence, s)
    model /= model.sum(axis=1, keepdims=True)
    return _mixture_moments(replace(people, model=model, means=means, covariances=covariances))


def _transitions(dt: float, turning: float, bending: float, config: JipdaConfig) -> Floats:
    """Return (3, 3) transition probabilities of the motion models over `dt` [s]; row: after, column: before.

    The models are constant velocity, manoeuvre, posture change. Two nested Markov chains in continuous time: a person
    changes posture or not; while not, manoeuvres or not. After a posture change the velocity is constant. `turning` and
    `bending` are the rates [1/s] at which manoeuvres and posture changes begin; `config` gives their mean durations.
    """
    turn, bend = (
        two_states(dt, turning, 1.0 / config.manoeuvre_duration_s),
        two_states(dt, bending, 1.0 / config.posture_change_duration_s),
    )
    out = np.zeros((len(MODELS), len(MODELS)))
    out[:POSTURE_CHANGE, :POSTURE_CHANGE] = turn * bend[0, 0]
    (
        out[POSTURE_CHANGE, :POSTURE_CHANGE],
        out[CONSTANT_VELOCITY, POSTURE_CHANGE],
        out[POSTURE_CHANGE, POSTURE_CHANGE],
    ) = bend[1, 0], bend[0, 1], bend[1, 1]
    return out


def two_states(dt: float, begin: float, end: float) -> Floats:
    """Return (2, 2) transition probabilities over `dt` [s] of a two-state Markov chain in continuous time.

    `begin` is the rate [1/s] from the first state to the second, `end` that back; their sum must be > 0. Entry [a, b]
    is the probability of state a after, given state b before.
    """
    total = begin + end
    gone = (1.0 - np.exp(-total * dt)) / total
    return np.array([[1.0 - begin * gone, end * gone], [begin * gone, 1.0 - end * gone]])


def _mixture_moments(people: TargetSet) -> TargetSet:
    """Return the tracks with mean and covariance of the mixture of their three motion models (moment matching).

    `mean`, `covariance`, `body_mean` and `body_covariance` are replaced; the models stay.
    """
    mean = np.einsum("na,nai->ni", people.model, people.means)
    difference = people.means - mean[:, None]
    covariance = np.einsum("na,naij->nij", people.model, people.covariances)
    covariance += np.einsum("na,nai,naj->nij", people.model, difference, difference)
    n = STATE_SIZE
    return replace(
        people,
        mean=mean[:, :n],
        covariance=covariance[:, :n, :n],
        body_mean=mean @ BODY.T,
        body_covariance=BODY @ covariance @ BODY.T,
    )


def duplicate_tracks(people: TargetSet, t_ns: int) -> tuple[TargetSet, Bools]:
    """Find pairs of tracks at `t_ns` that follow one person: closer than half a body width.

    If one of the two is tentative, the younger is a duplicate at once (the older instead, if it is tentative and has
    less existence). Of two confirmed tracks the younger one is, after `DUPLICATE_TIME_S` together; the older one
    instead if its existence is below `DUPLICATE_EXISTENCE_RATIO` times that of the younger one.

    Returns:
        The tracks with updated `separated_ns` (time when they were last apart from others), and a mask (N,) of
        duplicates.
    """
    out = np.zeros(len(people.key), dtype=np.bool_)
    difference = people.mean[:, None, :2] - people.mean[None, :, :2]
    near = np.hypot(difference[..., 0], difference[..., 1]) < DUPLICATE_DISTANCE_WIDTHS * people.mean[:, None, WIDTH]
    near |= near.T
    np.fill_diagonal(near, False)
    known = people.id != NO_ID
    together = near & known[:, None] & known
    since = np.where(together.any(axis=1), people.separated_ns, t_ns)
    long = t_ns - since >= DUPLICATE_TIME_S * NS
    for a, b in np.argwhere(np.triu(near, 1)):
        if not (known[a] and known[b]):
            out[b if known[a] or people.existence[a] >= people.existence[b] else a] = True
        elif long[a] and long[b] and not (out[a] or out[b]):
            out[a if people.existence[a] < DUPLICATE_EXISTENCE_RATIO * people.existence[b] else b] = True
    return replace(people, separated_ns=since), out


CELL_SIZE_M, SMOOTHING_SIGMA_M = 0.5, 1.0
"""Side of a cell and deviation of the smoothing, in metres."""
PRIOR_DEATHS = 1.0
"""Weight of the overall departure rate, in departures per cell."""
PRIOR_VELOCITY = 2.0
"""Weight of the prior deviation of the velocity, in arrivals per cell."""
MIN_BIRTH_RATIO = 0.02
"""Wherever it is, arrivals are not rarer than this share of the first rate."""


@dataclass(frozen=True)
class BirthIntensityMap:
    """Counts of arrivals and departures of people in G visited square cells of the ground plane.

    Per cell: centre (G, 2), departures, person-seconds spent there, arrivals, and the sums of the velocities (G, 2) of
    arriving people and of their outer products (G, 2, 2). `row` maps integer cell coordinates to rows, `watched` is the
    observed time [s], and `metre` the length of a metre in the scene's unit.
    """

    metre: float  # in the scene's unit
    row: dict[tuple[int, int], int]  # of a cell
    centre: Floats  # (G, 2)
    left: Floats  # (G,) departures
    spent: Floats  # (G,) person-seconds
    came: Floats  # (G,) arrivals
    velocity: Floats  # (G, 2) sum of the velocities of those who arrived
    square: Floats  # (G, 2, 2) sum of their squares
    watched: float  # seconds


def empty_map(metre: float) -> BirthIntensityMap:
    """Return the birth intensity map before the first observation: no cells, no counts.

    `metre` is the length of a metre in the scene's unit.
    """
    none = np.zeros(0)
    return BirthIntensityMap(metre, {}, np.zeros((0, 2)), none, none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.0)


def update_map(
    known: BirthIntensityMap,
    dt: float,
    *,
    people: Floats,
    existence: Floats,
    left: Floats,
    came: Floats,
    velocity: Floats,
) -> BirthIntensityMap:
    """Return the birth intensity map with the counts of `dt` more seconds added; new cells are appended.

    Args:
        known: map before; not changed.
        dt: time since the last update [s].
        people: (n, 2) positions of confirmed people.
        existence: (n,) existence probabilities of these people.
        left: (k, 2) last detected positions of the confirmed people who left.
        came: (m, 2) first detected positions of people who have been tracked long enough to have a velocity.
        velocity: (m, 2) velocities of the people in `came` [scene unit/s].
    """
    positions = np.concatenate([people, left, came])
    rows, cells = dict(known.row), []
    at = []
    for x, y in np.floor(positions / (CELL_SIZE_M * known.metre)).astype(np.int64).tolist():
        if (x, y) not in rows:
            rows[x, y] = len(rows)
            cells.append((x, y))
        at.append(rows[x, y])
    row, new = np.array(at, dtype=np.int64), len(cells)
    centre = (np.array(cells, dtype=np.float64).reshape(-1, 2) + 0.5) * CELL_SIZE_M * known.metre
    n, k = len(people), len(people) + len(left)
    return BirthIntensityMap(
        metre=known.metre,
        row=rows,
        centre=np.concatenate([known.centre, centre]),
        left=_added(known.left, new, row[n:k], np.ones(len(left))),
        spent=_added(known.spent, new, row[:n], dt * existence),
        came=_added(known.came, new, row[k:], np.ones(len(came))),
        velocity=_added(known.velocity, new, row[k:], velocity),
        square=_added(known.square, new, row[k:], velocity[:, :, None] * velocity[:, None, :]),
        watched=known.watched + dt,
    )


def target_death_rate_at(known: BirthIntensityMap, positions: Floats, overall: float) -> Floats:
    """Return (n,) death rates of targets [1/s] at `positions` (n, 2), from smoothed counts of people who left there.

    `overall` is the rate of the whole area [1/s]; it is the prior, with the weight of `PRIOR_DEATHS` departures.
    """
    near = _near(known, positions)
    return np.asarray((near @ known.left + PRIOR_DEATHS) / (near @ known.spent + PRIOR_DEATHS / overall))


def birth_intensity(known: BirthIntensityMap, first: float, worth_s: float) -> tuple[float, Floats]:
    """Return the birth intensity [1/(area s)]: a uniform rate, and an additional rate (G,) for each map cell.

    The additional rate falls off as a Gaussian of standard deviation `SMOOTHING_SIGMA_M` about the cell's centre.

    Args:
        known: map of arrivals.
        first: uniform rate before any observation [1/(area s)], in the scene's unit.
        worth_s: weight of that prior, in seconds of observation.
    """
    seconds = known.watched + worth_s
    smooth = 2.0 * np.pi * (SMOOTHING_SIGMA_M * known.metre) ** 2
    return max(worth_s / seconds, MIN_BIRTH_RATIO) * first, known.came / (smooth * seconds)


def birth_velocity(known: BirthIntensityMap, positions: Floats, deviation: float) -> tuple[Floats, Floats]:
    """Return mean (n, 2) and covariance (n, 2, 2) of the velocity of people who arrive at `positions` (n, 2).

    They are smoothed over the arrivals counted nearby. `deviation` is the prior standard deviation per axis
    [scene unit/s]; the prior mean is 0.
    """
    near = _near(known, positions)
    count = (near @ known.came + PRIOR_VELOCITY)[:, None]
    mean = near @ known.velocity / count
    square = np.einsum("ng,gij->nij", near, known.square) + PRIOR_VELOCITY * deviation**2 * np.eye(2)
    return mean, square / count[..., None] - mean[:, :, None] * mean[:, None, :]


def _near(known: BirthIntensityMap, positions: Floats) -> Floats:
    """Return Gaussian smoothing weights (n, G) of the map's cells at `positions` (n, 2), 1 at a cell's centre."""
    difference = positions[:, None] - known.centre[None]
    return np.asarray(np.exp(-0.5 * np.sum(difference**2, axis=2) / (SMOOTHING_SIGMA_M * known.metre) ** 2))


def _added(sums: Floats, new: int, rows: Ints, values: Floats) -> Floats:
    """Return per-cell sums (G, ...) with `new` zero cells appended, and `values` added to the cells at indices `rows`.

    Rows may be repeated; `sums` is not changed.
    """
    out = np.concatenate([sums, np.zeros((new, *sums.shape[1:]))])
    np.add.at(out, rows, values)
    return out
