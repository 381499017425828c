"""Hypotheses that a position is wrong since bearings on which it depends are false.

Lines of sight of two sensors nearly always meet, so that agreement of two confirms nothing; nor does that of a third
line with two that coincide, as those of sensors that face each other do.  With probability epsilon a bearing is false,
and then from anywhere in the sensor's field of view.  The target is anywhere in a region: at a mode, elsewhere on a
line of sight that is true, or, if all are false, anywhere.  The probabilities are integrals of the likelihood over the
region.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from .estimators import Modes

MIN_PROBABILITY = 0.025
"""Probability of false lines that counts where none was found so far: half of what an ellipse of 95 % leaves out."""


MIN_REDUNDANCY = 0.05
"""Share of the variance of a bearing that its residual has, below which no other bearing confirms it."""
POINTS, MODE_CHI2 = 48, 16.0
"""Points of each line, and the squared normalised distance up to which they belong to a mode."""


class Region(NamedTuple):
    """Rectangle of possible target positions, in the scene's unit."""

    low: Floats  # (2,)
    high: Floats  # (2,)


class FalseLines(NamedTuple):
    """Model of false bearings: their probability, and the widths of the sensors' fields of view.

    `bend` is the residual [standard deviations] at which a bearing is as likely false as true; `found` is true if false
    bearings were found before.
    """

    width: Floats  # (n,) fields of view [rad]
    probability: float  # that a bearing is false, above 0
    bend: float  # standard deviations at which one is as likely false as true
    found: bool  # false bearings were found; otherwise hypotheses below `MIN_PROBABILITY` do not count


def depends_on_one(found: Modes, positions: Floats, sigma: Floats) -> bool:
    """Return whether the first mode would be (nearly) undetermined without one of its inlier bearings.

    Args:
        found: modes of the bearings.
        positions: (n, 2) positions of the sensors.
        sigma: (n,) standard deviations of the bearings [rad].
    """
    inlier = found.inlier_probability[0]
    if np.count_nonzero(inlier >= 0.5) <= 2:
        return True
    away = found.xy[0] - positions
    g = np.column_stack([-away[:, 1], away[:, 0]]) / (np.maximum((away**2).sum(axis=1), 1e-24) * sigma)[:, None]
    leverage = inlier * np.einsum("ni,ij,nj->n", g, found.covariance[0], g)
    return bool(np.any(leverage > 1.0 - MIN_REDUNDANCY))


def false_line_moment(
    found: Modes, positions: Floats, bearings: Floats, sigma: Floats, false: FalseLines, region: Region
) -> tuple[float, Floats]:
    """Return the probability that the target is at no mode, and the (2, 2) second moment about the first mode if so.

    Probabilities below `MIN_PROBABILITY`, while no false bearing was found, are returned as 0.

    Args:
        found: modes of n bearings.
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        sigma: (n,) standard deviations [rad].
        false: probability of a false bearing, and widths of the sensors' fields of view.
        region: where a target can be; it counts as one measurement more, which may be false, too.
    """
    at, size = found.xy[0], region.high - region.low
    log_true = math.log1p(-false.probability) - np.log(sigma * math.sqrt(2.0 * math.pi))
    log_false = math.log(false.probability) - np.log(false.width)
    # A mode: integral of a Gaussian, for bearings that are true with density N(r), or false
    volume = 2.0 * math.pi * np.sqrt(np.maximum(np.linalg.det(found.covariance), 0.0))
    beyond = np.maximum(np.maximum(region.low - found.xy, found.xy - region.high), 0.0)
    inside = np.maximum(-0.5 * np.einsum("mi,mi->m", beyond, beyond / _variances(found)), -0.5 * false.bend**2)
    density = np.logaddexp(log_true - 0.5 * found.residual**2, log_false).sum(axis=1)
    modes = float((np.exp(density + inside) * volume).sum())
    # Lines: the integral of N across a ray is 1 per angle, so that r dr is left; positions on several lines are shared
    near, far = _inside(positions, bearings, region)
    step = (far - near) / POINTS
    r = near[:, None] + step[:, None] * (np.arange(POINTS) + 0.5)
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    xy = positions[:, None] + r[..., None] * ahead[:, None]
    away = xy[:, :, None] - positions
    off = bearings - np.arctan2(away[..., 1], away[..., 0])
    residual = ((off + np.pi) % (2.0 * np.pi) - np.pi) / sigma
    true = np.exp(log_true - 0.5 * residual**2)
    own = np.arange(len(bearings))
    peak = true[own, :, own]
    others = (true + np.exp(log_false)).prod(axis=2) / (peak + np.exp(log_false)[:, None])
    mass = (1.0 - false.probability) * r * step[:, None] * others * peak / np.maximum(true.sum(axis=2), 1e-300)
    from_modes = xy[:, :, None] - found.xy
    squares = np.einsum("nkmi,mij,nkmj->nkm", from_modes, np.linalg.inv(found.covariance), from_modes)
    mass *= (squares > MODE_CHI2).all(axis=2)
    anywhere = math.exp(log_false.sum()) * float(size.prod())
    rest = float(mass.sum()) + anywhere
    probability = rest / (modes + rest)
    if not probability > (0.0 if false.found else MIN_PROBABILITY):
        return 0.0, np.zeros((2, 2))
    off_middle = 0.5 * (region.low + region.high) - at
    moment = np.einsum("nk,nki,nkj->ij", mass, from_modes[:, :, 0], from_modes[:, :, 0])
    moment += anywhere * (np.diag(size**2 / 12.0) + np.outer(off_middle, off_middle))
    return probability, np.asarray(moment / rest)


def _variances(found: Modes) -> Floats:
    """Return (M, 2) variances of modes along the coordinate axes."""
    return np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 1e-300)


def _inside(positions: Floats, bearings: Floats, region: Region) -> tuple[Floats, Floats]:
    """Return (n,) entry and (n,) exit distances of n bearing rays for a rectangle; equal where a ray misses it.

    `positions` (n, 2) are where the rays begin, `bearings` (n,) their directions [rad].
    """
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    ahead = np.where(np.abs(ahead) < 1e-12, 1e-12, ahead)
    one, other = (region.low - positions) / ahead, (region.high - positions) / ahead
    near = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
    return near, np.maximum(np.maximum(one, other).min(axis=1), near)
