"""What an estimate says of its bearings: which are believed, and whether residuals are what was stated."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.camera import wrap_angle
from occlog.track.interface import Fit, Noise
from occlog.track.map.kernels.detours import Detours
from occlog.track.map.kernels.evidence import evidence
from occlog.track.map.kernels.interior_point.newton_search import covariance
from occlog.track.map.kernels.problem import SightLines
from occlog.track.map.kernels.terms import beliefs, depths, leverages, residuals
from occlog.track.map.search.consensus import rays_of
from occlog.track.map.search.pending import Pending
from occlog.track.map.search.robust import Sought, trust_of

from .measurements import sight_lines
from .record import Record


def judge(pending: Pending, record: Record, sought: Sought, found: Detours) -> tuple[Fit, Noise]:
    """How the bearings of a record agree with the estimate, and by how much they and the motion are noisier.

    Args:
        pending: the target.
        record: its record.
        sought: which bearings the search used.
        found: the estimate.
    """
    X, problem = found.solution.X, found.problem
    stated = sight_lines(record, pending.at)
    spread = covariance(problem, X)
    # Residuals as stated; by the angle where the target is not before the camera
    off = residuals(stated, X)
    behind = (depths(stated, X) <= 0.0) & ~stated.direction
    off[behind] = _angles(stated, record, pending, X)[behind]
    # Belief with the variances that were used
    if sought.told is not None:
        stated = stated._replace(lean=sought.told.lean)
    scaled = stated._replace(c0=stated.c0 * sought.scales[0], c1=stated.c1 * sought.scales[0])
    believed = np.where(sought.used, beliefs(scaled, X, trust_of(pending.config, sought.scales[0])), 0.0)
    expected = np.ones(len(off))
    shares = leverages(problem.lines, X, problem.loss, problem.k, spread)
    expected[sought.used] = np.clip(1.0 - shares, 0.0, 1.0)
    told = evidence(problem, X, spread)
    noise = Noise(told.lines_scale * sought.scales[0], told.steps_scale * sought.scales[1])
    return Fit(stated.step, record.rows.sensor[record.rows.seen], off, expected, believed), noise


def _angles(lines: SightLines, record: Record, pending: Pending, X: Floats) -> Floats:
    """(N,) angles between sight lines and the states, in standard deviations."""
    rays = rays_of(lines, record, pending.at)
    away = X[lines.step, ::2] - lines.place
    angle = np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    sigma = np.sqrt(np.maximum(rays.a + rays.b / np.maximum(np.sum(away**2, axis=1), 1e-300), 1e-300))
    return np.asarray(np.minimum(np.abs(wrap_angle(angle)), math.pi) / sigma)
