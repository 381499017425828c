"""Tracks of the filter of several motion models: how they begin, move, count as existing, and end.

From how many particles of an earlier time those of a target come.

A target's range from a single array is hardly observable: particles that are drawn again and again by one bearing come
from fewer and fewer of those before, though each scan leaves most of them effective.  Noise of the motion makes new
positions along the line of sight, but only in time.  Until it has, a covariance of a few families is that of chance.

Smoothing of targets with several motion models: trajectories drawn back through the filter's particles.

A particle after a step has the model under which it moved there.  On the way back that model moves it back, and the
model before it is drawn along with its state: of two particles that are as likely to have led to a state that one
counts more if its model seldom changes into the later one (`model_sojourn_s`).  See `occlog.filtering.kernel_density`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats, Ints
from occlog.core.plane import inside_polygon
from occlog.filtering.kernel_density import KernelDensity, kernel_density, last_states, spread_of, states_before
from occlog.filtering.motion.coordinated_turn import acceleration_root, move, move_under_all, three_models
from occlog.records.scene import Scene
from occlog.track.interface import SmoothedState

from . import kernel as imm
from .config import START_NUMBERS, ImmConfig

REJUVENATION_VARIANCE_SHARE = 0.25
"""The motion has made up for lost families when its noise has this share of the variance along the widest axis."""


class Genealogy(NamedTuple):
    """Ancestry of a target's particles: the ancestor from which each descends, and the time since [s]."""

    families: Ints  # (L,)
    since_s: float  # how long ago that was

    def drawn(self, rows: Ints, dt: float) -> Genealogy:
        """Return the ancestry after resampling: `rows` (n,) are the particles drawn, `dt` the time step [s]."""
        return Genealogy(self.families[rows], self.since_s + dt)

    def effective(self) -> float:
        """Return the effective number of ancestors, 1 to L: L^2 / sum of squared family sizes."""
        sizes = np.bincount(self.families)
        return float(len(self.families) ** 2 / (sizes @ sizes))


def new_genealogy(particles: int) -> Genealogy:
    """Return an ancestry in which each particle is its own ancestor."""
    return Genealogy(np.arange(particles), 0.0)


def is_rejuvenated(lineage: Genealogy, covariance: Floats, sigma_v: float) -> bool:
    """Return whether process noise alone explains a quarter of the particles' variance along their widest axis.

    The particles are then diverse again. White acceleration gives a position the variance sigma_v^2 t^3 / 3 per axis.

    Args:
        lineage: ancestry of the particles, with the time t.
        covariance: (2, 2) covariance of the particles' positions.
        sigma_v: noise of the velocity per axis, accumulated over 1 s [length/s].
    """
    widest = float(np.linalg.eigvalsh(covariance)[-1])
    return bool(sigma_v**2 * lineage.since_s**3 / 3.0 >= REJUVENATION_VARIANCE_SHARE * widest)


TENTATIVE = -1
"""Number of a track that is not confirmed."""
UNLABELLED_TRACK = -1
MIN_INSIDE_SHARE = 0.1
"""Share of particles in the room up to which those outside are moved back instead of removed."""
MAX_DRAWS = 20
"""Places on a line of sight are drawn this often until enough of them are in the room."""


class Track(NamedTuple):
    """A confirmed or tentative target: its particles, its probability of existence, and its detections."""

    number: int  # TENTATIVE until it is confirmed
    label: int  # identity that sensors give it; UNLABELLED_TRACK: none did
    cloud: imm.ImmParticles
    exists: float  # probability
    sounds: float  # probability that it is not silent, if it exists
    hits: int  # times at which it was heard
    met_ns: int  # when it was heard or seen last
    lineage: Genealogy | None = None  # of a confirmed track's particles; None before its first scan


class Moved(NamedTuple):
    """A track with its particles moved to a scan's time under each of J models, and their weights during the update."""

    track: Track
    predicted: Floats  # (J, L, 4)
    prior: Floats  # (J, L) before the scan
    weights: Floats  # (J, L)
    initiated: bool = False
    heard: bool = False  # a bearing of the scan is more likely than not of it
    arrays: tuple[int, ...] = ()  # that listened


class ImmWorld(NamedTuple):
    """Scene and settings as constants of the filter, with data of A microphone arrays."""

    config: ImmConfig
    models: Floats  # (3, 3) of `turns`
    positions: Floats  # (A, 2) of the arrays
    reach: Floats  # (A,)
    resolution: Floats  # (A,) [rad]
    region: Floats  # (P, 2) where new targets can be
    walls: bool  # and where all must stay
    longest: float  # no line of sight in the region is longer
    cameras: int  # of the scene: array a is sensor `cameras` + a


def make_world(scene: Scene, config: ImmConfig) -> ImmWorld:
    """Return the arrays and the room of a scene, and the settings, as constants of the filter."""
    arrays = scene.arrays
    positions = np.array([a.position[:2] for a in arrays], dtype=np.float64).reshape(-1, 2)
    region = np.ascontiguousarray(scene.region)
    corners = np.concatenate([region, positions])
    longest = float(np.hypot(*(corners.max(axis=0) - corners.min(axis=0))))
    return ImmWorld(
        config=config,
        models=three_models(config.turn_acceleration),
        positions=positions,
        reach=np.array([_reach(a.range, float(a.position[2]), config.source_height) for a in arrays], dtype=np.float64),
        resolution=np.array([a.resolution for a in arrays], dtype=np.float64),
        region=region,
        walls=config.walls and scene.room is not None,
        longest=longest,
        cameras=len(scene.cameras),
    )


def _reach(far: float, height: float, sources: float | None) -> float:
    """Return the range on the ground of an array at `height` that hears as far as `far`.

    `sources` is the height of the sources; None: the range is measured on the ground.
    """
    if sources is None or math.isinf(far):
        return far
    return math.sqrt(max(far**2 - (height - sources) ** 2, 0.0))


def initial_tracks(config: ImmConfig, t_ns: int, rng: Generator) -> tuple[Track, ...]:
    """Return a confirmed track for each target in `config.start`, numbered from 0, with `t_ns` as last detection."""
    starts = np.reshape(config.start or (), (-1, START_NUMBERS)).tolist()
    return tuple(confirmed_track(config, n, start, t_ns, rng) for n, start in enumerate(starts))


def confirmed_track(config: ImmConfig, number: int, start: Sequence[float], t_ns: int, rng: Generator) -> Track:
    """Return the confirmed track `number` with a known initial state.

    Args:
        config: settings of the method.
        number: number of the track.
        start: X, Y, SIGMA, VX, VY, SIGMA_V with standard deviations per axis.
        t_ns: time that counts as its last detection [ns].
        rng: generator of the random numbers drawn.
    """
    x, y, s, vx, vy, sv = start
    states = np.array([x, vx, y, vy]) + rng.standard_normal((config.particles, 4)) * np.array([s, sv, s, sv])
    return _confirmed(config, number, UNLABELLED_TRACK, states, t_ns)


def _confirmed(config: ImmConfig, number: int, label: int, states: Floats, t_ns: int) -> Track:
    """Return a confirmed track with particles `states` (L, 4) and existence probability 1, last detected at `t_ns`.

    `label`: identity that sensors give it, or `UNLABELLED_TRACK`.
    """
    hits = config.confirmation_hits
    return Track(number=number, label=label, cloud=_cloud(states), exists=1.0, sounds=1.0, hits=hits, met_ns=t_ns)


def track_on_bearing(
    world: ImmWorld, array: int, angle: float, sigma: float, t_ns: int, label: int, rng: Generator
) -> Track:
    """Return a new track with particles along a bearing's line of sight, within range and room.

    Positions are uniform in distance along the line; if none is in the room, positions outside are used.

    Args:
        world: arrays and room.
        array: number of the array.
        angle: bearing [rad].
        sigma: standard deviation of the bearing [rad].
        t_ns: time of the bearing [ns].
        label: number and identity of a confirmed track; `UNLABELLED_TRACK`: the track is tentative.
        rng: generator of the random numbers drawn.
    """
    config = world.config
    n = config.particles * config.initial_particle_factor
    longest = min(float(world.reach[array]), world.longest)
    xy, count = np.empty((0, 2)), 0
    for _ in range(MAX_DRAWS):
        r, at = longest * rng.random(n), angle + sigma * rng.standard_normal(n)
        new = world.positions[array] + np.column_stack([r * np.cos(at), r * np.sin(at)])
        good = new[inside_polygon(new, world.region)]
        xy, count = np.concatenate([xy, good]), count + len(good)
        if count >= n or not count:
            break
    xy = xy[:n] if count else new
    if len(xy) < n:
        xy = xy[rng.integers(len(xy), size=n)]
    velocity = config.sigma_initial_velocity * rng.standard_normal((n, 2))
    states = np.column_stack([xy[:, 0], velocity[:, 0], xy[:, 1], velocity[:, 1]])
    labelled = label != UNLABELLED_TRACK
    exists = 1.0 if labelled else config.birth_probability
    number = label if labelled else TENTATIVE
    return Track(number=number, label=label, cloud=_cloud(states), exists=exists, sounds=1.0, hits=1, met_ns=t_ns)


def track_at_position(
    world: ImmWorld, position: Floats, covariance: Floats, number: int, label: int, t_ns: int, rng: Generator
) -> Track:
    """Return a confirmed track of a new target at a position found by cameras.

    Args:
        world: settings, arrays and room.
        position: (2,) position.
        covariance: (2, 2) covariance of the position.
        number: number of the track.
        label: identity that sensors give it, or `UNLABELLED_TRACK`.
        t_ns: time of the position.
        rng: generator of the random numbers drawn.
    """
    config = world.config
    n = config.particles
    xy = rng.multivariate_normal(position, covariance, n, method="eigh")
    velocity = config.sigma_initial_velocity * rng.standard_normal((n, 2))
    states = np.column_stack([xy[:, 0], velocity[:, 0], xy[:, 1], velocity[:, 1]])
    return _confirmed(config, number, label, states, t_ns)


def _cloud(states: Floats) -> imm.ImmParticles:
    """Return particles with `states` (L, 4), all of motion model 0."""
    return imm.ImmParticles(np.ascontiguousarray(states), np.zeros(len(states), dtype=np.int64))


def move_track(world: ImmWorld, track: Track, dt: float, rng: Generator) -> Moved:
    """Return a track a time `dt` [s] later, its particles moved under every motion model ([Lee] Eq. 3.3).

    With walls particles outside the room lose their weight; if nearly all are outside, they stay where they were, at
    rest. The probability that the target sounds is predicted, too.
    """
    config, cloud = world.config, track.cloud
    J, L = len(world.models), len(cloud.states)
    normals = rng.standard_normal((J, L, 4))
    root = acceleration_root(config.process_noise_velocity**2, dt)
    predicted = move_under_all(cloud.states, world.models, dt, root, normals)
    prior = imm.prior_weights(cloud.models, J, switching(J, dt, config.model_sojourn_s))
    if world.walls:
        inside = inside_polygon(np.ascontiguousarray(predicted[..., ::2].reshape(-1, 2)), world.region).reshape(J, L)
        mass = float(prior[inside].sum())
        if MIN_INSIDE_SHARE < mass < 1.0:
            prior = np.where(inside, prior, 0.0) / mass
        elif mass < 1.0:
            # At most a tenth of the weight is still in the room: particles outside keep their old position, at rest.
            predicted = np.where(inside[..., None], predicted, cloud.states * np.array([1.0, 0.0, 1.0, 0.0]))
    off, on = _chance(dt, config.mean_sound_s), _chance(dt, config.mean_silence_s)
    sounds = track.sounds * (1.0 - off) + (1.0 - track.sounds) * on
    return Moved(track._replace(sounds=sounds), predicted, prior, prior)


def new_track(world: ImmWorld, track: Track) -> Moved:
    """Return a new track as one that the scan has moved and heard; the motion models are equally likely."""
    J, L = len(world.models), len(track.cloud.states)
    prior = np.full((J, L), 1.0 / (J * L))
    return Moved(track, np.repeat(track.cloud.states[None], J, axis=0), prior, prior, initiated=True, heard=True)


def switching(models: int, dt: float, hold_s: float | None) -> Floats | None:
    """Return (J, J) transition probabilities of J = `models` models over a time `dt` [s].

    `hold_s` is the mean sojourn time of a model [s]; None: None is returned, as all models are equally likely.
    """
    if hold_s is None:
        return None
    stay = math.exp(-dt / hold_s)
    return np.asarray(np.full((models, models), (1.0 - stay) / models) + stay * np.eye(models))


def _chance(dt: float, mean_s: float) -> float:
    """Return the probability that an event with mean waiting time `mean_s` [s] happens within `dt` [s]."""
    return -math.expm1(-dt / mean_s)


def update_existence(track: Track, reached: float, detection: float, unheard: float) -> Track:
    """Return the track with its existence and sounding probabilities after an array's scan.

    Args:
        track: track before the scan.
        reached: probability that it is in the array's range.
        detection: probability that a target in range is heard, if it sounds.
        unheard: probability that no bearing was of it, given everything that was heard.
    """
    missed = 1.0 - track.sounds * detection * reached  # not heard, if it exists
    silent_too = 1.0 - track.exists + track.exists * missed  # not heard, if it exists or not
    there = unheard * track.exists * missed / silent_too if silent_too > 0.0 else 0.0
    exists = 1.0 - unheard + there
    still = track.sounds * (1.0 - detection * reached) / missed if missed > 0.0 else 1.0
    sounds = (1.0 - unheard + there * still) / exists if exists > 0.0 else track.sounds
    return track._replace(exists=min(exists, 1.0), sounds=min(sounds, 1.0))


def resampled(moved: Moved, particles: int, dt: float, rng: Generator) -> Track:
    """Return the track with resampled particles; a tentative track keeps all of its particles.

    Args:
        moved: the track after a scan.
        particles: number of particles of a confirmed track.
        dt: time since the scan before [s].
        rng: generator of the random numbers drawn.
    """
    track = moved.track
    confirmed = track.number != TENTATIVE
    n = particles if confirmed else len(track.cloud.states)
    rows, models = imm.resample(moved.weights, float(rng.random()), rng.random(n))
    lineage = (track.lineage or new_genealogy(len(track.cloud.states))).drawn(rows, dt) if confirmed else None
    return track._replace(cloud=imm.ImmParticles(imm.taken(moved.predicted, models, rows), models), lineage=lineage)


class TrackTrace(NamedTuple):
    """Record of a target after a scan for smoothing: time and particles as a kernel density of [x, vx, y, vy]."""

    t_ns: int
    knot: KernelDensity  # rows x, vx, y, vy; kinds are motion models


def trace_of(track: Track, t_ns: int) -> TrackTrace:
    """Return the record of a target after a step at `t_ns` that smoothing needs: its particles as a kernel density."""
    states, models = track.cloud
    return TrackTrace(
        t_ns, kernel_density(np.ascontiguousarray(states.T), np.full(len(states), 1.0 / len(states)), models)
    )


def smooth_backwards(traces: Sequence[TrackTrace], config: ImmConfig, rng: Generator) -> list[SmoothedState]:
    """Return a smoothed state of a target for each trace, by trajectories sampled backwards through its particles.

    Args:
        traces: records in the order of time, at least one.
        config: settings of the method; `smoothing_trajectories` is the number of trajectories.
        rng: generator of the random numbers drawn.
    """
    models, out = three_models(config.turn_acceleration), []
    states, kinds = last_states(traces[-1].knot, config.smoothing_trajectories, rng)
    out.append(_past(states))
    for k in range(len(traces) - 2, -1, -1):
        dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
        chances = switching(len(models), dt, config.model_sojourn_s)
        moved = moved_back(states, kinds, models, dt)
        noise = noise_back(config.process_noise_velocity**2, dt)
        states, kinds = states_before(traces[k].knot, moved, noise, kinds, chances, rng=rng)
        out.append(_past(states))
    return out[::-1]


def moved_back(states: Floats, kinds: Ints, models: Floats, dt: float) -> Floats:
    """Return (4, M) states `dt` >= 0 seconds before those given, without noise.

    It is the inverse of a step of `occlog.filtering.motion.coordinated_turn.move`, as a turn leaves the speed as it is.

    Args:
        states: (4, M) states x, vx, y, vy.
        kinds: (M,) index of the motion model of each.
        models: (J, 3) motion models: lateral acceleration, acceleration along x and y.
        dt: time [s].
    """
    out = np.empty_like(states)
    for kind, model in enumerate(models):
        own: Ints = np.flatnonzero(kinds == kind)
        still = np.zeros((len(own), 4))
        out[:, own] = move(np.ascontiguousarray(states[:, own].T), model, -dt, np.zeros((2, 2)), still).T
    return out


def noise_back(density: float, dt: float) -> Floats:
    """Return the (4, 4) process-noise covariance of [x, vx, y, vy] over `dt` [s], mapped back by the step.

    `density` is the spectral density of the acceleration [length^2/s^3]; turns count as straight motion.
    """
    root = acceleration_root(density, dt)
    block = root @ root.T
    block[0, 1] = block[1, 0] = -block[0, 1]
    out = np.zeros((4, 4))
    out[:2, :2] = out[2:, 2:] = block
    return out


def _past(states: Floats) -> SmoothedState:
    """Return the smoothed state of a target from M trajectories: mean and covariance of `states` (4, M)."""
    mean, covariance = spread_of(states)
    return SmoothedState(mean[::2], mean[1::2], np.ascontiguousarray(covariance[::2, ::2]))
