"""Conversion of the tracks at all time steps to the state of the Markov chain, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints

from ..association_features import FeatureLikelihood
from ..config import JipdaConfig
from ..detector_model import HIDDEN_S
from ..target_set import (
    CELL_SIZE_M,
    CONSTANT_VELOCITY,
    POSTURE_HEIGHT_NOISE,
    POSTURE_WIDTH_NOISE,
    SIZE_NOISE_PER_ROOT_S,
    BirthIntensityMap,
    target_death_rate_at,
    two_states,
)
from .appearance import AppearanceVectors, log_ratio_joined, no_sums
from .association import AssociatedPeople
from .gaussian_messages import log_begun
from .mcmc_association import (
    NO_NODE,
    LinkCandidates,
    MarkovChainState,
    TrackletNodes,
    WalkModel,
    can_link,
    candidates,
    empty_link_cache,
    log_link_probability,
    sweep,
    update_all_messages,
)
from .states import dwell_times
from .tracklet_nodes import widen_by_gait

MAX_SPEED_SIGMAS = 3.0
"""Maximum speed in standard deviations of a new person's velocity."""
LINK_SLACK_M = 0.6
"""Tolerance of the distance between two positions of one person [m]."""
SWAP_DISTANCE_M = 1.5
"""Maximum distance of positions of one time step that may be exchanged [m]."""
LINK_DETECTIONS = 4.0
"""Maximum link length in expected detections of a person, ..."""
MAX_LINK_STEPS = 64
"""... and in time steps."""
MAX_BRIDGE_S = 8.0
"""Gaps between tracks are bridged up to this long."""
USUAL_LINK_SHARE = 0.9
PAUSE_S, PAUSE = 8.0, 10.0
"""A pause of the recording is a step longer than this, and longer than a multiple of the quantile
`USUAL_LINK_SHARE` of the others."""
TEMPERATURES = 12
FINAL_TEMPERATURE = 0.2
PROPOSALS = 60
"""Number of proposals per position in each run of the chain."""
MIN_FALSE_PEOPLE = 1e-9
"""Minimum of the expected number of false people in a time step."""
MIN_PROCESS_NOISE_DENSITY = 1e-6
"""A walk without any noise has no inverse [m^2/s^3]."""


class WindowSpan(NamedTuple):
    """The T time steps of a smoothing window, with the frames of C cameras, and rates of people.

    `time` (T,) [s]; `frame_counts` (T + 1, C), cumulative numbers of frames of each camera before each time step; floor
    `area` [scene unit^2], mean number of `people` at a time, `false_people` per time step, mean dwell time `stay` [s],
    rates of manoeuvres and posture changes [1/s], and `metre`, the length of a metre in the scene's unit.
    """

    time: Floats  # (T,) [s]
    frame_counts: Floats  # (T + 1, C) number of frames of each camera before each time step
    area: float  # of the floor on which people are
    people: float  # at a time
    false_people: float  # expected number of false people in a time step with boxes in all cameras
    stay: float  # how long people stay on average [s]
    hiding_rate: Floats  # (C,) how often in a second something unknown hides a person from each camera
    turning: float  # how often in a second a person begins to manoeuvre
    bending: float  # the same to bend, fall, lie down or get up
    metre: float  # in the scene's unit

    @property
    def gaps(self) -> Floats:
        """Times between successive time steps [s], without pauses of the recording (steps much longer than usual)."""
        every = np.diff(self.time)
        if not len(every):
            return every
        usual = float(np.quantile(every, USUAL_LINK_SHARE, method="lower"))
        return np.asarray(every[every <= max(PAUSE_S, PAUSE * usual)])

    @property
    def step(self) -> float:
        """Mean time between time steps [s], without pauses; 1 if there is none."""
        gaps = self.gaps
        return float(gaps.mean()) if len(gaps) and gaps.any() else 1.0

    @property
    def hiding(self) -> Floats:
        """(C, 2) probabilities that a person becomes hidden, and visible again, from a camera's frame to its next."""
        every = self.gaps.sum() / np.maximum(self.frame_counts[-1], 1.0)
        changes = [
            two_states(float(dt), rate, 1.0 / HIDDEN_S) for dt, rate in zip(every, self.hiding_rate, strict=True)
        ]
        return np.array([(change[1, 0], change[0, 1]) for change in changes])


class ChainTracks(NamedTuple):
    """The n nodes (boxes of one person at one time step) of a window, their motion model, and their Markov chain.

    `J` (n, 6, 6) and `h` (n, 6) are the nodes' measurement factors without gait noise, in information form; `label`
    (n,) is the track that each node was associated with (`NO_NODE`: none).
    """

    nodes: TrackletNodes
    walk: WalkModel
    chain: MarkovChainState
    J: Floats  # (n, 6, 6)
    h: Floats  # (n, 6)
    label: Ints  # (n,) number that `PredictedPeople.track` gave it; NO_NODE


def walk_of(config: JipdaConfig, span: WindowSpan, reach: int, free: bool) -> WalkModel:
    """Return the motion model of people from the settings and the learned rates.

    Args:
        config: settings of the method.
        span: time steps, with the rates of manoeuvres and posture changes.
        reach: largest number of time steps from one node of a track to the next.
        free: links are searched: walking straight has the process noise of the settings. Else it is averaged with that
            of manoeuvres, so that slight turns which are not detected individually are included.
    """
    often = span.turning * config.manoeuvre_duration_s / (1.0 + span.turning * config.manoeuvre_duration_s)
    mean = (1.0 - often) * config.process_noise_density + often * config.manoeuvre_noise_density
    calm = max(config.process_noise_density if free else mean, MIN_PROCESS_NOISE_DENSITY * span.metre**2)
    agile = max(config.manoeuvre_noise_density, calm)
    deviation = np.array(
        [
            config.sigma_initial_velocity,
            config.sigma_initial_velocity,
            config.sigma_person_height,
            config.sigma_person_width,
        ]
    )
    height, width = config.person_height**2, config.person_width**2
    return WalkModel(
        drift=np.array(
            [
                [calm, SIZE_NOISE_PER_ROOT_S**2 * height, SIZE_NOISE_PER_ROOT_S**2 * width],
                [agile, SIZE_NOISE_PER_ROOT_S**2 * height, SIZE_NOISE_PER_ROOT_S**2 * width],
                [agile, POSTURE_HEIGHT_NOISE**2 * height, POSTURE_WIDTH_NOISE**2 * width],
            ]
        ),
        often=np.array([0.0, span.turning, span.bending]),
        prior=np.concatenate([[0.0, 0.0], deviation**-2]),
        mean=np.array([0.0, 0.0, 0.0, 0.0, config.person_height, config.person_width]),
        speed=MAX_SPEED_SIGMAS * config.sigma_initial_velocity,
        slack=LINK_SLACK_M * span.metre,
        reach=reach,
        stay=span.stay,
        hiding=span.hiding,
    )


def tracks_from(
    found: Sequence[AssociatedPeople],
    span: WindowSpan,
    config: JipdaConfig,
    known: BirthIntensityMap,
    scatter: float | Floats,
    free: bool,
    law: FeatureLikelihood,
) -> ChainTracks:
    """Convert the people of all time steps to nodes of a Markov chain, linked by their tracks, with all messages.

    Args:
        found: people with their boxes at each time step.
        span: the time steps.
        config: settings of the method.
        known: map of departures.
        scatter: gait variance per axis of a position about the smooth track: one number, or one for each node (n,).
        free: the links are to be changed by the chain: those that it could not make are cut.
        law: likelihood of appearance similarities of boxes.
    """
    counts = [len(f.track) for f in found]
    step = np.repeat(np.arange(len(found)), counts)
    mean, miss = np.concatenate([f.mean for f in found]), np.concatenate([f.miss for f in found])
    raw_J, raw_h = np.concatenate([f.J for f in found]), np.concatenate([f.h for f in found])
    c = np.concatenate([f.c for f in found])
    J, h, constant = np.empty_like(raw_J), np.empty_like(raw_h), np.empty_like(c)
    widen_by_gait(raw_J, raw_h, c, np.broadcast_to(scatter, c.shape).astype(np.float64), J, h, constant)
    T = len(span.time)
    # Arrivals before the first position or at the beginning of the recording; departures, or presence at its end
    # Boxes of several cameras that agree may be false all at once
    walk = walk_of(config, span, T, free)
    alone = log_begun(walk.prior, walk.mean, J, h, constant)
    constant -= np.logaddexp(0.0, math.log(max(span.false_people, MIN_FALSE_PEOPLE) / span.area) + alone)
    unseen = np.exp(miss @ (span.frame_counts[-1] / T))
    leaving = _leaving(known, mean[:, :2], span)
    coming, early = dwell_times(
        span.time, span.frame_counts, step, miss, walk.hiding, np.full(len(step), 1.0 / span.stay), -1
    )
    going, late = dwell_times(span.time, span.frame_counts, step, miss, walk.hiding, leaving, 1)
    hint, life = _lives(np.concatenate([f.hint for f in found]), span.time[step])
    arrivals = span.people / span.area / span.stay
    nodes = TrackletNodes(
        step=step,
        time=span.time[step],
        at=np.ascontiguousarray(mean[:, :2]),
        J=J,
        h=h,
        c=constant,
        miss=miss,
        birth=np.log(arrivals * (coming + span.stay * early)),
        death=np.log(np.minimum(going * leaving + late, 1.0)),
        hint=hint,
        life=life,
        similar=AppearanceVectors(
            np.concatenate([f.appearance for f in found]), np.concatenate([f.n_vectors for f in found]), law
        ),
    )
    often = float(np.mean(1.0 - unseen)) if len(unseen) else 1.0
    reach = int(min(np.ceil(LINK_DETECTIONS / max(often, 1e-3)), MAX_LINK_STEPS)) if free else T
    walk = walk._replace(reach=reach)
    label = np.concatenate([f.track for f in found])
    chain = _chain(nodes, walk, label, free)
    # Once as if all walked on calmly, then with manoeuvres where these are more probable
    for _ in range(2):
        update_all_messages(nodes, walk, span.frame_counts, chain)
    return ChainTracks(nodes, walk, chain, raw_J, raw_h, label)


def _lives(hint: Ints, time: Floats) -> tuple[Ints, Floats]:
    """Renumber the filter's identities of nodes from 0, and return the time range of each identity.

    Args:
        hint: (n, 2 C) identities of a node's box in each camera, by single-camera trackers, then by the filter.
        time: (n,) times of the nodes [s].

    Returns:
        A copy of `hint` with new numbers in the last C columns, and (I, 2) first and last time of each number [s].
    """
    C = hint.shape[1] // 2
    hint = hint.copy()
    own = hint[:, C:]
    node, camera = np.nonzero(own != NO_NODE)
    number, code = np.unique(own[node, camera], return_inverse=True)
    own[node, camera] = code
    life = np.column_stack([np.full(len(number), np.inf), np.full(len(number), -np.inf)])
    np.minimum.at(life[:, 0], code, time[node])
    np.maximum.at(life[:, 1], code, time[node])
    return hint, life


def _leaving(known: BirthIntensityMap, positions: Floats, span: WindowSpan) -> Floats:
    """Return (n,) rates [1/s] at which people leave at `positions` (n, 2), by departures counted nearby.

    The mean dwell time of `span` is the prior.
    """
    side = CELL_SIZE_M * known.metre
    cells, cell = np.unique(np.floor(positions / side), axis=0, return_inverse=True)
    return target_death_rate_at(known, (cells + 0.5) * side, 1.0 / span.stay)[cell.reshape(-1)]


def _chain(nodes: TrackletNodes, walk: WalkModel, track: Ints, free: bool) -> MarkovChainState:
    """Return the initial state of the Markov chain: successive nodes of one track are linked, without messages.

    Args:
        nodes: n nodes.
        walk: motion model.
        track: (n,) number of each node's track, `NO_NODE` for none.
        free: omit links that the chain itself could not make.
    """
    n = len(track)
    after, before = np.full(n, NO_NODE), np.full(n, NO_NODE)
    order = np.lexsort((np.arange(n), track))
    for i, j in zip(order[:-1].tolist(), order[1:].tolist(), strict=True):
        if track[i] == track[j] != NO_NODE and (not free or can_link(nodes, walk, i, j)):
            after[i], before[j] = j, i
    return MarkovChainState(
        after=after,
        before=before,
        used=track != NO_NODE,
        model=np.full(n, CONSTANT_VELOCITY),
        mean=np.full((n, 6), np.nan),
        covariance=np.zeros((n, 6, 6)),
        past=np.zeros(n),
        J=np.full((n, 6, 6), np.nan),
        h=np.zeros((n, 6)),
        future=np.zeros(n),
        earlier=np.zeros(n, dtype=np.int64),
        later=np.zeros(n, dtype=np.int64),
        sums=no_sums(nodes.similar),
    )


def anneal(tracks: ChainTracks, span: WindowSpan, generator: np.random.Generator, hottest: float) -> None:
    """Optimise the links of `tracks` by simulated annealing of the Markov chain, in place.

    Args:
        tracks: nodes and chain; the chain is changed.
        span: the time steps.
        generator: source of random numbers.
        hottest: first temperature; the last is `FINAL_TEMPERATURE`.
    """
    n = len(tracks.nodes.step)
    if n == 0:
        return
    listed = listed_of(tracks, span)
    known = empty_link_cache(listed)
    each = max(PROPOSALS * n // TEMPERATURES, 1)
    for temperature in np.geomspace(hottest, FINAL_TEMPERATURE, TEMPERATURES):
        drawn = generator.random((each, 4))
        sweep(tracks.nodes, tracks.walk, span.frame_counts, listed, known, tracks.chain, float(temperature), drawn)
        # Rounding and the tolerance of renewals do not add up
        update_all_messages(tracks.nodes, tracks.walk, span.frame_counts, tracks.chain)


def listed_of(tracks: ChainTracks, span: WindowSpan) -> LinkCandidates:
    """Return the candidate links of the chain's nodes: possible successors, predecessors, and swaps.

    Nodes of one time step may be swapped if they are at most `SWAP_DISTANCE_M` apart.
    """
    return candidates(tracks.nodes, tracks.walk, SWAP_DISTANCE_M * span.metre)


def bridge(tracks: ChainTracks, span: WindowSpan) -> None:
    """Link ends of tracks with starts of later ones by optimal assignment, in place, where that is likelier than a gap.

    A link without detections in between, over at most `MAX_BRIDGE_S`, is compared with a termination and an initiation.
    """
    nodes, walk, chain = tracks.nodes, tracks.walk, tracks.chain
    ends = np.flatnonzero(chain.used & (chain.after == NO_NODE))
    heads = np.flatnonzero(chain.used & (chain.before == NO_NODE))
    gain = np.zeros((len(ends), len(heads)))
    for a, i in enumerate(ends.tolist()):
        wait = nodes.time[heads] - nodes.time[i]
        separation = np.hypot(*(nodes.at[heads] - nodes.at[i]).T)
        near = (wait > 0.0) & (wait <= MAX_BRIDGE_S) & (separation <= walk.speed * wait + walk.slack)
        if not near.any():
            continue
        alone = log_link_probability(nodes, walk, span.frame_counts, chain, i, NO_NODE)
        for b in np.flatnonzero(near).tolist():
            j = int(heads[b])
            joint = log_link_probability(nodes, walk, span.frame_counts, chain, i, j)
            gain[a, b] = joint - alone - log_link_probability(nodes, walk, span.frame_counts, chain, NO_NODE, j)
            for one, other, sign in ((i, j, 1.0), (i, NO_NODE, -1.0), (NO_NODE, j, -1.0)):
                gain[a, b] += sign * log_ratio_joined(nodes.similar, chain.sums, one, NO_NODE, other)
    rows, columns = linear_sum_assignment(-np.maximum(gain, 0.0))
    for a, b in zip(rows.tolist(), columns.tolist(), strict=True):
        if gain[a, b] > 0.0:
            chain.after[ends[a]], chain.before[heads[b]] = heads[b], ends[a]
    update_all_messages(nodes, walk, span.frame_counts, chain)
