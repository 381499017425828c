"""A step of a particle filter with an adapted importance density, in space or in one plane.

The particles after a scan represent the kernel density of `occlog.filtering.kernel_density`,

    sum_l w_l N(x; a x_l + (1 - a) m, h^2 V),   a^2 + h^2 = 1,

m and V being the cloud's mean and covariance.  What one of its Gaussians is after a step of time is a Gaussian, too:
that of the kernel as it moves plus the noise of the motion.  So a target without any noise of motion ([Lee]'s)
has one to draw from as well, and one form serves both.  A step is that of the auxiliary particle filter (Pitt and
Shephard 1999) with the optimal importance density (Doucet, Godsill and Andrieu 2000), approximated
(`occlog.track.methods.in_space.kernels.importance`): parents are drawn by their weights times the predictive
likelihood of the scan, positions from the posterior of each, velocities given the position from the motion; the
weights put right what is only approximate.

Smoothing of tracks in space: what was seen afterwards tells of a state as well.

`direct3d` draws trajectories back through the kernel densities of its particles
(`occlog.filtering.kernel_density`), the same densities from which its particles were drawn.
`pps` has no density in space; its combined estimates are smoothed as Gaussians (Rauch, Tung and Striebel 1965).
A filter that restarted forgot what it knew before: states before such a time are smoothed with what follows up to it
alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats, Ints
from occlog.filtering.kernel_density import (
    KernelDensity,
    last_states,
    moments,
    root_of,
    silverman_bandwidth,
    spread_of,
    states_before,
    update_weights,
)
from occlog.filtering.motion.coordinated_turn import acceleration_root
from occlog.filtering.motion.white_acceleration import AccelerationModel, moved, moved_back
from occlog.filtering.particles import effective_sample_size, log_of, normalise_log_weights, systematic_ancestors
from occlog.track.interface import HeightEstimate, SmoothedState

from .config import SpaceConfig
from .kernels.importance import MIN_CLUTTER_DENSITY, ScanRows, adapt, draw
from .kernels.likelihood import ReportProbabilities
from .sensing import ScanDirections, motion_of

DEFENSIVE_FRACTION = 0.05
"""Share of parents and of positions that are drawn from the motion alone, so that no density is far too small."""
MIN_RELATIVE_EXTENT = 1e-9
"""A cloud without extent gets this much of the distance from the origin, so that densities stay finite."""


class TimeStepPath(NamedTuple):
    """A time step of a particle: motion model, length, and a known change of its state (2d,) in addition."""

    motion: AccelerationModel
    dt: float  # [s], >= 0
    jump: Floats | None = None  # (2d,) known change also


class ProposedStates(NamedTuple):
    """Particles drawn from the adapted importance density: states (2d, n), log prior weights and log-likelihoods.

    A weight is the exponential of the sum of both; the log prior weight includes the ratio of motion to importance
    density.
    """

    cloud: Floats  # (2d, n)
    log_prior: Floats  # (n,) log weights before the likelihood
    log_likelihood: Floats  # (n,) of the scan


def update_by_scan(
    cloud: Floats,
    log_weights: Floats,
    way: TimeStepPath,
    lines: Callable[[], ScanRows],
    log_likelihood: Callable[[Floats], Floats],
    *,
    config: SpaceConfig,
    rng: Generator,
    log_going: Callable[[Floats, Floats], Floats] | None = None,
) -> tuple[Floats, Floats, float]:
    """Return particles (2d, n) at a scan's time, their weights (n,), and the log sum of the unnormalised weights.

    Particles move by the motion model alone as long as that leaves `config.resampling_threshold` of them effective;
    else they are drawn by `propose`. Where nearly none agrees with the scan even then, its likelihood is flattened
    (`occlog.filtering.kernel_density.update_weights`).

    Args:
        cloud: (2d, L) particles before the step: d positions, then d velocities.
        log_weights: (L,) logarithms of their weights, which sum to 1.
        way: the step.
        lines: makes the scan's directions as residuals for the importance density.
        log_likelihood: takes (d, n) positions, and returns the (n,) log-likelihoods of the scan.
        config: settings of the method.
        rng: generator of the random numbers drawn.
        log_going: takes (d, n) positions before and after the step, and returns (n,) logs of a factor; None: 1.
    """
    d, least = len(cloud) // 2, 2.0 * len(cloud)
    # Propose: draw from the transition density ([Lee] Eq. 2.4), and weigh (Eq. 2.5)
    ahead = moved(cloud, way.motion, way.dt, rng, way.jump) if way.dt > 0.0 else cloud
    before = log_weights if log_going is None else log_weights + log_going(cloud[:d], ahead[:d])
    log_density = log_likelihood(ahead[:d])
    weights, log_sum = normalise_log_weights(before + log_density)
    if effective_sample_size(weights) >= config.resampling_threshold * len(weights) and math.isfinite(log_sum):
        return ahead, weights, log_sum
    if config.proposal == "adapted":
        found = propose(
            cloud,
            np.exp(log_weights),
            way,
            lines(),
            log_likelihood,
            particles=config.particles,
            kernel=config.kernel_bandwidth,
            rng=rng,
            log_going=log_going,
        )
        weights, log_sum = update_weights(found.log_prior, found.log_likelihood, least)
        if math.isfinite(log_sum):
            return found.cloud, weights, log_sum
    return ahead, *update_weights(before, log_density, least)


def process_noise(motion: AccelerationModel, dt: float) -> Floats:
    """Return the (2d, 2d) process-noise covariance of white acceleration over `dt` [s]: d positions, then d velocities.

    dt < 0 gives that of the step back in time. Turns count as straight motion.
    """
    root = acceleration_root(1.0, abs(dt))
    block = root @ root.T
    block[0, 1] = block[1, 0] = math.copysign(block[0, 1], dt)
    return np.asarray(np.kron(block, np.diag(motion.density)), dtype=np.float64)


def drift_matrix(d: int, dt: float) -> Floats:
    """Return the (2d, 2d) constant-velocity transition matrix for d positions followed by d velocities."""
    return np.kron(np.array([[1.0, dt], [0.0, 1.0]]), np.eye(d))


def kernel_density(cloud: Floats, weights: Floats, kernel: float) -> tuple[Floats, Floats, float]:
    """Return the centres of the kernels (2d, L), the covariance of the particles (2d, 2d), and the kernel width h.

    The kernel density is the mixture of Gaussians at the centres with covariance h^2 times that of the particles; the
    centres are shrunk so that it keeps mean and covariance.

    Args:
        cloud: (2d, L) particles.
        weights: (L,) weights of the particles, sum 1.
        kernel: width relative to the one that is optimal for a Gaussian.
    """
    mean, covariance = moments(cloud, weights)
    h = min(kernel * silverman_bandwidth(cloud.shape[1], len(cloud)), 0.999)
    a = math.sqrt(1.0 - h * h)
    return a * cloud + (1.0 - a) * mean[:, None], covariance, h


def propose(
    cloud: Floats,
    weights: Floats,
    way: TimeStepPath,
    lines: ScanRows,
    log_likelihood: Callable[[Floats], Floats],
    *,
    particles: int,
    kernel: float,
    rng: Generator,
    log_going: Callable[[Floats, Floats], Floats] | None = None,
) -> ProposedStates:
    """Return particles at a scan's time, drawn from the adapted importance density, with their weights.

    Parents are chosen by weight times predictive likelihood, positions drawn from the posterior of each, and velocities
    given the position from the motion (auxiliary particle filter).

    Args:
        cloud: (2d, L) particles before the step; d = 3 in space, 2 in a plane.
        weights: (L,) weights of the particles, sum 1.
        way: the step.
        lines: the scan's directions as residuals.
        log_likelihood: takes (d, n) positions, and returns the (n,) log-likelihoods of the scan.
        particles: number n of particles to draw.
        kernel: width of the kernels relative to the one that is optimal for a Gaussian.
        rng: generator of the random numbers drawn.
        log_going: takes (d, n) positions before and after the step, and returns (n,) logs of a factor; None: 1.
    """
    d, n = len(cloud) // 2, particles
    # Move the kernel density: its centres exactly, its covariance by a constant velocity
    centres, covariance, h = kernel_density(cloud, weights, kernel)
    still = way.motion._replace(density=np.zeros(d))
    centres = moved(centres, still, way.dt, rng, way.jump)
    F = drift_matrix(d, way.dt)
    C = h * h * (F @ covariance @ F.T) + process_noise(way.motion, way.dt)
    root, gain, rest = _conditional(C, d, MIN_RELATIVE_EXTENT * (1.0 + float(np.abs(centres[:d]).max())))
    # Weigh the parents: predictive likelihood by Laplace's approximation
    modes, factors, volume = adapt(_in_space(centres[:d]), root, lines)
    at_modes = centres[:d] + root[:d, :d] @ modes[:d]
    prior = log_of(weights)
    going = 0.0 if log_going is None else log_going(cloud[:d], np.ascontiguousarray(at_modes))
    first, log_sum = normalise_log_weights(prior + going + volume + log_likelihood(np.ascontiguousarray(at_modes)))
    first = weights if not math.isfinite(log_sum) else (1.0 - DEFENSIVE_FRACTION) * first + DEFENSIVE_FRACTION * weights
    # Resample: systematic
    parents = systematic_ancestors(first, n, rng.random())
    # Propose: positions from each parent's posterior, velocities given the position
    y, ratio = draw(modes, factors, parents, DEFENSIVE_FRACTION, rng.random(n), rng.standard_normal((3, n)))
    new = centres[:, parents]
    new[:d] += root[:d, :d] @ y[:d]
    new[d:] += gain @ y[:d] + rest @ rng.standard_normal((d, n))
    log_prior = prior[parents] - np.log(first[parents]) - math.log(n) + ratio
    if log_going is not None:
        log_prior += log_going(np.ascontiguousarray(cloud[:d, parents]), np.ascontiguousarray(new[:d]))
    return ProposedStates(new, log_prior, log_likelihood(np.ascontiguousarray(new[:d])))


def _conditional(C: Floats, d: int, least: float) -> tuple[Floats, Floats, Floats]:
    """Split a Gaussian of position and velocity into the position's and that of the velocity given the position.

    Args:
        C: (2d, 2d) covariance of position and velocity.
        d: number of coordinates, 2 or 3.
        least: standard deviation added to the position against singularity.

    Returns:
        The lower Cholesky factor of the position's covariance, in the upper left of a (3, 3) identity; (d, d)
        regression of the velocity on the whitened position; (d, d) root of the velocity's residual covariance.
    """
    position_covariance = C[:d, :d] + least**2 * np.eye(d)
    root = np.eye(3)
    root[:d, :d] = np.linalg.cholesky(position_covariance)
    gain = np.asarray(np.linalg.solve(root[:d, :d], C[:d, d:]).T, dtype=np.float64)
    return root, gain, root_of(C[d:, d:] - gain @ gain.T)


def _in_space(positions: Floats) -> Floats:
    """Return (3, n) row-contiguous positions from (2, n) or (3, n); a missing third coordinate is 0."""
    return np.ascontiguousarray(
        positions if len(positions) == 3 else np.vstack([positions, np.zeros(positions.shape[1])])
    )


def lines_of_sight(heard: ScanDirections, chances: ReportProbabilities) -> ScanRows:
    """Return the directions of a scan in space as residuals for the importance density.

    `heard` are the directions in the world, `chances` the probabilities of false alarms and clutter.
    """
    s = heard.sights
    flat = np.isnan(s.phi)
    phi = np.where(flat, 0.5 * math.pi, s.phi)[:, None]
    along = np.sin(phi) * s.frame[:, 0] + np.cos(phi) * s.frame[:, 2]
    above = np.sin(phi) * s.frame[:, 2] - np.cos(phi) * s.frame[:, 0]
    across = np.where(flat, 1.0, np.sin(phi[:, 0]) ** 2 + (np.cos(phi[:, 0]) * s.sigma_phi) ** 2)
    variance = np.stack([across * s.sigma_theta**2, np.where(flat, np.inf, s.sigma_phi**2)], axis=1)
    scale, rival = factors(heard, s.first, s.share, heard.uniform, chances)
    return ScanRows(s.first, s.position, along, s.frame[:, 1].copy(), above, variance, scale * np.sqrt(across), rival)


def factors(
    heard: ScanDirections, first: Ints, share: Floats, uniform: Floats, chances: ReportProbabilities
) -> tuple[Floats, Floats]:
    """Return the fields `scale` and `rival` (R,) of `ScanRows`, by which densities add up as in `scan_log_likelihood`.

    Args:
        heard: the scan of N sensors.
        first: (N + 1,) rows of sensor n are first[n] to first[n + 1] - 1.
        share: (R,) weight of a candidate.
        uniform: (R,) density of clutter.
        chances: probabilities of false alarms, candidates and clutter.
    """
    labelled = np.repeat(heard.sights.labelled, np.diff(first))
    scale = np.where(labelled, 1.0 - chances.false, chances.candidate / chances.clutter * share / uniform)
    rival = np.where(labelled, chances.false * uniform, 1.0 - chances.candidate)
    return scale, np.maximum(rival, MIN_CLUTTER_DENSITY)


class CloudTrace(NamedTuple):
    """Record of a step for smoothing: time, particles as a kernel density, and whether the filter restarted there."""

    t_ns: int
    knot: KernelDensity
    begun: bool  # restarted: they do not come from the particles before


class GaussianTrace(NamedTuple):
    """Record of a step for smoothing: time, Gaussian estimate in space, and whether the filter restarted.

    The state is (x, y, z, vx, vy, vz).
    """

    t_ns: int
    mean: Floats  # (6,)
    covariance: Floats  # (6, 6)
    begun: bool


def through_clouds(traces: Sequence[CloudTrace], config: SpaceConfig, rng: Generator) -> list[SmoothedState]:
    """Return a smoothed state for each trace, from trajectories sampled backwards through the kernel densities.

    Trajectories begin again where the filter restarted.

    Args:
        traces: records in the order of time.
        config: settings of the method; `smoothing_trajectories` is the number of trajectories.
        rng: generator of the random numbers drawn.
    """
    motion, out, states = motion_of(config), [], np.empty((6, 0))
    for k in range(len(traces) - 1, -1, -1):
        if k == len(traces) - 1 or traces[k + 1].begun:
            states, _ = last_states(traces[k].knot, config.smoothing_trajectories, rng)
        else:
            dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
            back = moved_back(states, motion, dt)
            states, _ = states_before(traces[k].knot, back, process_noise(motion, -dt), rng=rng)
        out.append(past_of(*spread_of(states)))
    return out[::-1]


def through_gaussians(traces: Sequence[GaussianTrace], config: SpaceConfig, rng: Generator) -> list[SmoothedState]:
    """Return a smoothed state for each trace, by the Rauch-Tung-Striebel recursion through the Gaussian estimates.

    The recursion begins again where the filter restarted. `traces` are in the order of time; `rng` is not drawn from.
    """
    motion, out = motion_of(config), []
    mean, covariance = np.empty(6), np.empty((6, 6))
    for k in range(len(traces) - 1, -1, -1):
        m, P = traces[k].mean, traces[k].covariance
        if k == len(traces) - 1 or traces[k + 1].begun:
            mean, covariance = m, P
        else:
            dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
            mean, covariance = _before(m, P, mean, covariance, motion, dt, rng)
        out.append(past_of(mean, covariance))
    return out[::-1]


def _before(
    m: Floats, P: Floats, later: Floats, later_covariance: Floats, motion: AccelerationModel, dt: float, rng: Generator
) -> tuple[Floats, Floats]:
    """Return the smoothed mean (6,) and covariance (6, 6) of a state `dt` [s] before a later smoothed one.

    This is one step of the Rauch-Tung-Striebel recursion.

    Args:
        m: (6,) mean of the filter: x, y, z, vx, vy, vz.
        P: (6, 6) covariance of the filter.
        later: (6,) smoothed mean of the later state.
        later_covariance: (6, 6) covariance of the later state.
        motion: motion model between the two states.
        dt: time between the two states [s].
        rng: not drawn from, as the step has no noise.
    """
    F = drift_matrix(3, dt)
    ahead = moved(m[:, None], motion._replace(density=np.zeros(3)), dt, rng)[:, 0]
    predicted = F @ P @ F.T + process_noise(motion, dt)
    G = P @ F.T @ np.linalg.pinv(predicted, rcond=1e-13, hermitian=True)
    covariance = P + G @ (later_covariance - predicted) @ G.T
    return m + G @ (later - ahead), 0.5 * (covariance + covariance.T)


def past_of(mean: Floats, covariance: Floats) -> SmoothedState:
    """Convert the mean (6,) and covariance (6, 6) of a state in space to a `SmoothedState`."""
    height = HeightEstimate(
        float(mean[2]), float(mean[5]), np.array([covariance[0, 2], covariance[1, 2], covariance[2, 2]])
    )
    return SmoothedState(mean[:2], mean[3:5], np.ascontiguousarray(covariance[:2, :2]), height)
