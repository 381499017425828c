"""Weights of all trackers in one frame of all views: repulsion within views, bands between them, [Qu] Alg. 1."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .bands import add_band, anchor, line_of, reach_across
from .motion import mean_into, normalise_into
from .repulsion import Interaction, add_inertia, half_reach, repel_into


class Near(NamedTuple):
    """Who is near whom, by the estimates without neighbours and other views."""

    busy: Bools  # (n,) close to another tracker of its view
    touching: Bools  # (n, n)
    ratio: Floats  # (n,) distance to the nearest over the sum of their radii


class Past(NamedTuple):
    """Where the trackers were and how they moved."""

    centre: Floats  # (n, 2) in the last frame
    step: Floats  # (n, 2) v_ref, to the next one


class Rig(NamedTuple):
    """What the views know of each other."""

    camera: Ints  # (n,) view of each tracker
    helper: Ints  # (n, V) tracker of the same target in another view that may help; -1: none
    fundamental: Floats  # (V, V, 3, 3)
    affine: Floats  # (n, 2, 3)
    bottom: bool  # which point of an ellipse stands for the target
    band: float  # Sigma of Eq. 5 over the reach of the ellipse across the line
    clear: float  # a counterpart helps when its ratio is at least this, or that of the tracker


@kernel
def nearby(estimate: Floats, camera: Ints, touch: float, close: float) -> Near:
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
    return Near(busy, touching, ratio)


@kernel
def settle(
    particles: Floats,
    log_local: Floats,
    near: Near,
    past: Past,
    rig: Rig,
    order: Ints,
    sweeps: int,
    model: Interaction,
    here: Bools,
) -> tuple[Floats, Floats, Bools]:
    """Weights, estimates and helpers of all trackers.

    Trackers that are far from others keep their own weights.  The rest are worked out view by
    view, in several sweeps; in the first, views that come later do not help yet.

    Args:
        particles: (n, N, 5).
        log_local: (n, N) logarithms of the local likelihood.
        near: neighbours.
        past: of the trackers.
        rig: of the views.
        order: (V,) in which views are worked out.
        sweeps: >= 1.
        model: of the interaction.
        here: (n,) trackers whose view has a frame; the estimate of the others is where their particles are.

    Returns:
        Weights (n, N), estimates (n, 5) and helpers (n, V).
    """
    n = particles.shape[0]
    log_own = log_local.copy()
    weights, estimate = np.empty(log_local.shape), np.empty((n, 5))
    for i in range(n):
        if near.touching[i].any():
            add_inertia(log_own[i], particles[i], past.centre[i], past.step[i], model)
        normalise_into(weights[i], log_own[i])
        mean_into(estimate[i], particles[i], weights[i])
    ready, helped = ~(near.busy & here), np.zeros(rig.helper.shape, dtype=np.bool_)
    for _ in range(sweeps):
        for v in order:
            rows = np.flatnonzero(near.busy & here & (rig.camera == v))
            for k in rows:
                log_w = log_own[k].copy()
                collaborate(log_w, helped[k], k, particles[k], estimate, ready, near, rig)
                normalise_into(weights[k], log_w)
                mean_into(estimate[k], particles[k], weights[k])
            repel_into(weights, estimate, particles, rows, near.touching, model)
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
    near: Near,
    rig: Rig,
) -> None:
    """Add the bands of the counterparts to a tracker's log weights: of those alone in their view, or else of others.

    A counterpart that is more hidden than the tracker would rather mislead it.

    Args:
        log_w: (N,) changed in place.
        helped: (V,) set to which views helped.
        i: the tracker.
        particles: (N, 5) of it.
        estimate: (n, 5).
        ready: (n,) whose estimates can be used.
        near: neighbours.
        rig: of the views.
    """
    alone = False
    for v in range(helped.shape[0]):
        j = rig.helper[i, v]
        alone = alone or (j >= 0 and ready[j] and not near.busy[j])
    for v in range(helped.shape[0]):
        j = rig.helper[i, v]
        helped[v] = False
        if j < 0 or not ready[j] or (alone and near.busy[j]):
            continue
        if near.ratio[j] < min(rig.clear, near.ratio[i]):
            continue
        x, y = anchor(estimate[j], rig.affine[j], rig.bottom)
        line = line_of(rig.fundamental[v, rig.camera[i]], x, y)
        if math.isnan(line[0]):
            continue
        helped[v] = True
        sigma = rig.band * reach_across(estimate[i], line[0], line[1])
        add_band(log_w, particles, rig.affine[i], rig.bottom, line, sigma)
