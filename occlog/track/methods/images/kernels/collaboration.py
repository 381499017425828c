"""Weights of all trackers in one frame of all views: interaction within views, collaboration between them, [Qu] Alg. 1.

Trackers that are close to others are worked out view by view.  Where a target is close to
others in all views, none of its trackers can help the others in the first position: the views
are then taken in turn, several times ([Qu] Sec. 3.2).

Interaction of targets that touch: magnetic repulsion and inertia, [Qu] Sec. 3.3, Eqs. 7 and 8.

[Qu] leaves the constants and the inertia model open; the forms here are those of the project's notes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .epipolar_lines import add_band, anchor, line_of, reach_across
from .motion import mean_into, normalise_into

AT_REST = 0.5
"""Displacements shorter than this [px] have no direction."""


class Interaction(NamedTuple):
    """Constants of the repulsion ([Qu] Eq. 8) and of the inertia of trackers of one view that touch."""

    alpha: float  # of Eq. 8, >= 1
    sigma: float  # Sigma of Eq. 8 over the mean of the two radii along the line between the centres
    iterations: int  # K of Alg. 1
    inertia: float  # g, weight gained by moving as before
    angle: float  # spread of directions [rad]
    speed: float  # spread of speeds [px a frame]


@kernel
def add_inertia(log_weights: Floats, particles: Floats, previous: Floats, before: Floats, model: Interaction) -> None:
    """Add, in place, the log inertia weights of particles: a tracker that touches others should move as before.

    The weight is 1 + g exp(-dtheta^2 / angle^2) exp(-(|v| - |v_ref|)^2 / speed^2). dtheta is the angle between v, the
    displacement to a particle, and v_ref; it is 0 where one of the two is at most `AT_REST` long.

    Args:
        log_weights: (N,) changed in place.
        particles: (N, 5) ellipses of the tracker; only their centres [px] count.
        previous: (2,) centre of the tracker in the last frame [px].
        before: (2,) v_ref, the displacement to expect [px].
        model: constants g (`inertia`), `angle` [rad] and `speed` [px a frame].
    """
    usual = math.hypot(before[0], before[1])
    for p in range(particles.shape[0]):
        vx, vy = particles[p, 0] - previous[0], particles[p, 1] - previous[1]
        speed, turn = math.hypot(vx, vy), 0.0
        if min(speed, usual) > AT_REST:
            turn = math.acos(min(max((vx * before[0] + vy * before[1]) / (speed * usual), -1.0), 1.0))
        far = (turn / model.angle) ** 2 + ((speed - usual) / model.speed) ** 2
        log_weights[p] += math.log(1.0 + model.inertia * math.exp(-far))


@kernel
def repulsion(x: float, y: float, mine: Floats, estimate: Floats, touching: Bools, model: Interaction) -> float:
    """Return the interaction weight of a particle, [Qu] Eq. 8: prod (1 - exp(-l^2 / Sigma^2) / alpha) over neighbours.

    l is the distance [px] of the particle's centre from a neighbour's estimate, Sigma a multiple of the mean radius of
    the two along the line between them.

    Args:
        x: centre of the particle, to the right [px].
        y: centre of the particle, down [px].
        mine: (5,) estimated ellipse of the particle's tracker.
        estimate: (n, 5) estimated ellipses of all trackers.
        touching: (n,) whether a tracker is a neighbour that touches the particle's tracker.
        model: constants `alpha` and `sigma`.
    """
    out = 1.0
    for j in range(touching.shape[0]):
        if touching[j]:
            sigma = model.sigma * half_reach(mine, estimate[j])
            l2 = (x - estimate[j, 0]) ** 2 + (y - estimate[j, 1]) ** 2
            out *= 1.0 - math.exp(-l2 / (sigma * sigma)) / model.alpha
    return out


@kernel
def half_reach(one: Floats, other: Floats) -> float:
    """Return the mean support radius [px] of two ellipses in the direction of the line between their centres.

    `one` and `other` (5,) are (cx, cy, a, b, rho). The support radius of an ellipse in a direction is half the length
    of its projection onto the direction.
    """
    theta = math.atan2(other[1] - one[1], other[0] - one[0])
    total = 0.0
    for e in (one, other):
        total += math.hypot(e[2] * math.cos(theta - e[4]), e[3] * math.sin(theta - e[4]))
    return 0.5 * total


@kernel
def repel_into(
    weights: Floats, estimate: Floats, particles: Floats, rows: Ints, touching: Bools, model: Interaction
) -> None:
    """Apply the repulsion of touching trackers to a view's weights in place, in K iterations, [Qu] Alg. 1.

    Each iteration weighs from the weights at the start, with the estimates of the iteration before; only the weights of
    the last one stay. Where all weights of a tracker would become 0, its weights stay as they were.

    Args:
        weights: (n, N) summing to 1; those of `rows` are changed in place.
        estimate: (n, 5) weighted mean ellipses of `particles`; those of `rows` are changed in place.
        particles: (n, N, 5) ellipses.
        rows: indices of the view's trackers.
        touching: (n, n) which trackers touch.
        model: constants of the repulsion, and K (`iterations`).
    """
    base = weights.copy()
    for _ in range(model.iterations):
        before = estimate.copy()
        for i in rows:
            if not touching[i].any():
                continue
            total = 0.0
            for p in range(particles.shape[1]):
                x, y = particles[i, p, 0], particles[i, p, 1]
                weights[i, p] = base[i, p] * repulsion(x, y, before[i], before, touching[i], model)
                total += weights[i, p]
            if total > 0.0:
                weights[i] /= total
            else:
                weights[i] = base[i]
            mean_into(estimate[i], particles[i], weights[i])


class Neighbours(NamedTuple):
    """Which of n trackers touch or are close to others of their view, by the estimates from the local likelihood.

    `busy` (n,): another tracker of the view is close. `touching` (n, n): symmetric, false between views. `ratio` (n,):
    distance to the nearest tracker of the view over the sum of both radii; inf if there is none.
    """

    busy: Bools  # (n,) close to another tracker of its view
    touching: Bools  # (n, n)
    ratio: Floats  # (n,) distance to the nearest over the sum of their radii; inf: alone in its view


class PastMotion(NamedTuple):
    """Motion of n trackers before the frame: their last centres and the displacements to expect [px]."""

    centre: Floats  # (n, 2) in the last frame [px]
    step: Floats  # (n, 2) v_ref, the displacement to expect to this frame [px]


class CameraCollaboration(NamedTuple):
    """What views need to help each other: the geometry of V views, and the counterparts of n trackers, [Qu] Sec. 3.2.

    A counterpart is the tracker of the same target in another view; its epipolar line weighs the particles of the
    tracker.
    """

    camera: Ints  # (n,) view of each tracker
    helper: Ints  # (n, V) tracker of the same target in another view that may help; -1: none
    fundamental: Floats  # (V, V, 3, 3)
    affine: Floats  # (n, 2, 3) see `methods.restart.affine_maps`
    bottom: bool  # whether the lowest point of an ellipse represents the target; else its centre
    band: float  # Sigma of Eq. 5 over the reach of the ellipse across the line
    clear: float  # a counterpart helps when its ratio is at least this, or that of the tracker


class WeighingModel(NamedTuple):
    """Parameters of a frame's particle weights that come on top of the local likelihood.

    They describe the interaction of trackers of one view that touch, and the collaboration of views.
    """

    near: Neighbours
    past: PastMotion
    cameras: CameraCollaboration
    interaction: Interaction


@kernel
def neighbours(estimate: Floats, camera: Ints, touch: float, close: float) -> Neighbours:
    """Return which trackers of the same view touch or are close, and the distance of each to its nearest neighbour.

    Args:
        estimate: (n, 5) estimated ellipses: centre and half axes [px], angle of the first axis [rad].
        camera: (n,) view of each tracker.
        touch: two trackers touch up to this distance of their centres, in sums of their radii along the line between
            them.
        close: two trackers are close up to this distance, in the same unit.
    """
    n = estimate.shape[0]
    busy, touching, ratio = np.zeros(n, dtype=np.bool_), np.zeros((n, n), dtype=np.bool_), np.full(n, np.inf)
    for i in range(n):
        for j in range(i):
            if camera[i] != camera[j]:
                continue
            distance = math.hypot(estimate[j, 0] - estimate[i, 0], estimate[j, 1] - estimate[i, 1])
            over = distance / (2.0 * half_reach(estimate[i], estimate[j]))
            ratio[i], ratio[j] = min(ratio[i], over), min(ratio[j], over)
            touching[i, j] = touching[j, i] = over <= touch
    for i in range(n):
        busy[i] = ratio[i] <= close
    return Neighbours(busy, touching, ratio)


@kernel
def reweighted(
    particles: Floats, log_local: Floats, here: Bools, model: WeighingModel, order: Ints, sweeps: int
) -> tuple[Floats, Floats, Bools]:
    """Compute particle weights, estimates and helping views of n trackers, [Qu] Alg. 1.

    Trackers that are not close to others keep the weights of the local likelihood. The rest are processed view by view
    in several sweeps; in the first, later views do not help yet.

    Args:
        particles: (n, N, 5) ellipses.
        log_local: (n, N) logarithms of the local likelihood.
        here: (n,) trackers with a frame of their view; the estimate of the others is the mean of their particles.
        model: parameters of interaction and collaboration.
        order: (V,) order of the views.
        sweeps: number of sweeps, >= 1.

    Returns:
        Weights (n, N) that sum to 1, mean ellipses (n, 5), and the views that helped (n, V).
    """
    near, past, cameras, interaction = model.near, model.past, model.cameras, model.interaction
    n = particles.shape[0]
    log_own = log_local.copy()
    weights, estimate = np.empty(log_local.shape), np.empty((n, 5))
    # Temporary estimate ([Qu] Alg. 1), with the inertia of trackers that touch
    for i in range(n):
        if near.touching[i].any():
            add_inertia(log_own[i], particles[i], past.centre[i], past.step[i], interaction)
        normalise_into(weights[i], log_own[i])
        mean_into(estimate[i], particles[i], weights[i])
    ready, helped = ~(near.busy & here), np.zeros(cameras.helper.shape, dtype=np.bool_)
    for _ in range(sweeps):
        for v in order:
            rows = np.flatnonzero(near.busy & here & (cameras.camera == v))
            # Collaboration weighting of trackers that are close to others ([Qu] Eq. 5)
            for k in rows:
                log_w = log_own[k].copy()
                collaborate(log_w, helped[k], k, particles[k], estimate, ready, near, cameras)
                normalise_into(weights[k], log_w)
                mean_into(estimate[k], particles[k], weights[k])
            # Interaction weighting of trackers that touch ([Qu] Eq. 8), and the estimates with it
            repel_into(weights, estimate, particles, rows, near.touching, interaction)
            ready[rows] = True
    return weights, estimate, helped


@kernel
def collaborate(
    log_w: Floats,
    helped: Bools,
    i: int | np.integer,
    particles: Floats,
    estimate: Floats,
    ready: Bools,
    near: Neighbours,
    cameras: CameraCollaboration,
) -> None:
    """Add, in place, the epipolar bands of a tracker's counterparts in other views to its log weights, [Qu] Eq. 5.

    Only counterparts that are close to no other tracker in their view help; if there are none, the others do. A
    counterpart that is nearer to another tracker than `clear`, and nearer than this tracker is to its own neighbours,
    does not help.

    Args:
        log_w: (N,) changed in place.
        helped: (V,) set to which views helped.
        i: index of the tracker.
        particles: (N, 5) ellipses of the tracker.
        estimate: (n, 5) estimated ellipses of all trackers.
        ready: (n,) trackers with usable estimates.
        near: neighbours of all trackers.
        cameras: geometry of the views, and counterparts of the trackers.
    """
    alone = False
    for v in range(helped.shape[0]):
        j = cameras.helper[i, v]
        alone = alone or (j >= 0 and ready[j] and not near.busy[j])
    for v in range(helped.shape[0]):
        j = cameras.helper[i, v]
        helped[v] = False
        if j < 0 or not ready[j] or (alone and near.busy[j]):
            continue
        if near.ratio[j] < min(cameras.clear, near.ratio[i]):
            continue
        # The counterpart's point maps to the middle line of a band in this view
        x, y = anchor(estimate[j], cameras.affine[j], cameras.bottom)
        line = line_of(cameras.fundamental[v, cameras.camera[i]], x, y)
        if math.isnan(line[0]):
            continue
        helped[v] = True
        sigma = cameras.band * reach_across(estimate[i], line[0], line[1])
        add_band(log_w, particles, cameras.affine[i], cameras.bottom, line, sigma)
