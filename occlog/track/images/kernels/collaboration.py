"""Weights of all trackers in one frame of all views: interaction within views, collaboration between them, [Qu] Alg. 1.

Trackers that are close to others are worked out view by view.  Where a target is close to
others in all views, none of its trackers can help the others in the first place: the views
are then taken in turn, several times ([Qu] Sec. 3.2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .epipolar_lines import add_band, anchor, line_of, reach_across
from .motion import mean_into, normalise_into
from .repulsion import Interaction, add_inertia, half_reach, repel_into


class Neighbours(NamedTuple):
    """Which of n trackers are near each other, by the estimates of the local likelihood."""

    busy: Bools  # (n,) close to another tracker of its view
    touching: Bools  # (n, n)
    ratio: Floats  # (n,) distance to the nearest over the sum of their radii; inf: alone in its view


class PastMotion(NamedTuple):
    """Places and displacements of n trackers before the frame."""

    centre: Floats  # (n, 2) in the last frame [px]
    step: Floats  # (n, 2) v_ref, the displacement to expect to this frame [px]


class CameraCollaboration(NamedTuple):
    """How n trackers in V views may help each other, [Qu] Sec. 3.2."""

    camera: Ints  # (n,) view of each tracker
    helper: Ints  # (n, V) tracker of the same target in another view that may help; -1: none
    fundamental: Floats  # (V, V, 3, 3)
    affine: Floats  # (n, 2, 3) see `bands`
    bottom: bool  # whether the lowest point of an ellipse stands for the target; else its centre
    band: float  # Sigma of Eq. 5 over the reach of the ellipse across the line
    clear: float  # a counterpart helps when its ratio is at least this, or that of the tracker


class WeighingModel(NamedTuple):
    """What besides the local likelihood decides the weights of a frame."""

    near: Neighbours
    past: PastMotion
    cameras: CameraCollaboration
    interaction: Interaction


@kernel
def neighbours(estimate: Floats, camera: Ints, touch: float, close: float) -> Neighbours:
    """Neighbours of ellipses (n, 5) within their views (n,).

    Two touch when their distance is at most `touch` times the sum of their radii along the
    line between them, and are close at `close` times it.
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
    """Weights, estimates and helpers of n trackers.

    Trackers that are not close to others keep their local weights.  The rest are worked out
    view by view, in several sweeps; in the first, views that come later do not help yet.

    Args:
        particles: (n, N, 5).
        log_local: (n, N) logarithms of the local likelihood.
        here: (n,) trackers whose view has a frame; the estimate of the others is where their particles are.
        model: what else counts.
        order: (V,) in which views are worked out.
        sweeps: >= 1.

    Returns:
        Weights (n, N), estimates (n, 5) and views that helped (n, V).
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
    """Add the bands of a tracker's counterparts to its log weights, [Qu] Eq. 5.

    Counterparts that are close to no other in their view help; where there is none of these,
    the others do.  A counterpart that is more hidden than the tracker would mislead it, and
    does not help.

    Args:
        log_w: (N,) changed in place.
        helped: (V,) set to which views helped.
        i: the tracker.
        particles: (N, 5) of it.
        estimate: (n, 5).
        ready: (n,) whose estimates can be used.
        near: neighbours.
        cameras: of the views.
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
