"""Updates by bearings of which some may be false: joint hypotheses, and a Gaussian with the mean and covariance of all.

Each labelled bearing of a scan is of the target, or false with probability epsilon and then anywhere in the sensor's
field of view.  The hypotheses on which of them are true are enumerated jointly, since bearings of several sensors
confirm each other; each has a posterior by the filter's own update, and the mixture is replaced by the Gaussian of the
same moments, as in probabilistic data association (Bar-Shalom, Daum and Huang 2009, The probabilistic data association
filter, IEEE Control Systems 29(6):82-100).

Epsilon is learned from the bearings so far: its prior is a Beta distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.filtering.gaussian import MIN_RELATIVE_VARIANCE, Gaussian, symmetric
from occlog.filtering.likelihood.measurement_model import Linearisation, LinearisedRows, MeasurementWorld

from .updates import Updated

MAX_JOINT_ROWS = 8
"""Maximum number of bearings with joint hypotheses; further ones of the scan follow in another update."""
MIN_HYPOTHESIS_PROBABILITY = 1e-3
"""Hypotheses that are less probable do not count."""


class MixtureUpdate(NamedTuple):
    """A state updated by R rows that may be false, and the probability of each row to be true (of the target)."""

    done: Updated
    inlier: Floats  # (R,) probability that each row is true


RowsUpdate = Callable[[Gaussian, LinearisedRows, Linearisation], Updated]
"""Update by rows that are all true; these are also linearised at the prediction."""


def log_false_density(rows: LinearisedRows, world: MeasurementWorld) -> Floats:
    """Return (R,) log densities of false rows: uniform over the image [1/px], or over the field of view [1/rad]."""
    widths = np.where(rows.pixel, world.noise.width_px[rows.sensor], world.noise.width[rows.sensor])
    return np.asarray(-np.log(widths))


def mixture_update(
    state: Gaussian,
    rows: LinearisedRows,
    near: Linearisation,
    world: MeasurementWorld,
    false: float,
    update: RowsUpdate,
) -> MixtureUpdate:
    """Return a state updated by R rows that may be false (probabilistic data association), and (R,) probabilities.

    The probabilities are those that the rows are true. All hypotheses on which rows are true are enumerated, for at
    most `MAX_JOINT_ROWS` rows at a time; the mixture of their posteriors is replaced by the Gaussian of equal mean and
    covariance.

    Args:
        state: the prediction.
        rows: R measurements of directions, any number.
        near: the rows linearised, to find the probable hypotheses.
        world: the sensors.
        false: prior probability that a row is false; 0: all are true.
        update: updates a Gaussian by the true rows of a hypothesis; its score weighs the hypothesis.
    """
    count = len(rows.sensor)
    if not false > 0.0 or not count:
        return MixtureUpdate(update(state, rows, near) if count else Updated(state, 0.0), np.ones(count))
    log_true, log_false = math.log1p(-false), math.log(false) + log_false_density(rows, world)
    if count <= MAX_JOINT_ROWS:
        return _joint_update(state, rows, near, (log_true, log_false), update)
    score, inlier, done = 0.0, np.empty(count), Updated(state, 0.0)
    for part in np.split(np.arange(count), range(MAX_JOINT_ROWS, count, MAX_JOINT_ROWS)):
        prior = log_true, log_false[part]
        done, inlier[part] = _joint_update(done.state, rows.take(part), near.take(part), prior, update)
        score += done.score
    return MixtureUpdate(done._replace(score=score), inlier)


def _joint_update(
    state: Gaussian,
    rows: LinearisedRows,
    near: Linearisation,
    log_prior: tuple[float, Floats],
    update: RowsUpdate,
) -> MixtureUpdate:
    """Update a state by R rows that may be false, by enumerating all 2^R hypotheses.

    Args:
        state: the prediction.
        rows: R measurements of directions.
        near: the R rows linearised.
        log_prior: log probability that a row is true; (R,) log of the probability that it is false times the density of
            false rows.
        update: updates a Gaussian by rows that are all true.
    """
    true = subsets(len(rows.sensor))
    prior = np.where(true, *log_prior).sum(axis=1)
    log = prior + log_evidence(state.covariance[:2, :2], near, near.innovation(state.mean), true)
    weight = np.exp(log - log.max())
    probable = np.flatnonzero(weight >= MIN_HYPOTHESIS_PROBABILITY * weight.sum())
    found = [
        update(state, rows.take(own), near.take(own)) if own.any() else Updated(state, 0.0) for own in true[probable]
    ]
    log = prior[probable] + np.array([one.score for one in found])
    best = int(np.argmax(log))
    weight = np.exp(log - log[best])
    score = float(log[best]) + math.log(float(weight.sum()))
    weight /= weight.sum()
    state = moment_matched(weight, [one.state for one in found])
    return MixtureUpdate(Updated(state, score, found[best].fallback), np.asarray(weight @ true[probable]))


@cache
def subsets(n: int) -> Bools:
    """Return (2^n, n) booleans, the masks of all subsets of n rows."""
    return np.asarray((np.arange(2**n)[:, None] >> np.arange(n)) % 2 == 1)


def log_evidence(P: Floats, near: Linearisation, off: Floats, true: Bools) -> Floats:
    """Return (M,) log densities N(0, H P H' + R) of the innovations of M subsets of rows.

    Args:
        P: (2, 2) covariance of the predicted position.
        near: R rows linearised.
        off: (R,) innovations of the rows.
        true: (M, R) masks of the subsets.
    """
    # In coordinates in which the prior is the identity; rows with unit variance
    W = near.H @ np.linalg.cholesky(P)
    R = np.maximum(near.R, MIN_RELATIVE_VARIANCE * (W**2).sum(axis=1))
    scaled = np.concatenate([W, off[:, None]], axis=1) / np.sqrt(R)[:, None]
    products = (scaled[:, :, None] * scaled[:, None, :]).reshape(-1, 9)
    a, b, e, _, c, f, _, _, squares = (true @ products).T
    det = (1.0 + a) * (1.0 + c) - b * b
    gain = ((1.0 + c) * e * e - 2.0 * b * e * f + (1.0 + a) * f * f) / det
    return np.asarray(0.5 * (gain - squares - np.log(det) - true @ np.log(2.0 * math.pi * R)))


def moment_matched(weight: Floats, states: list[Gaussian]) -> Gaussian:
    """Return the Gaussian with mean and covariance of a mixture of `states` with weights (M,), sum 1."""
    if len(states) == 1:
        return states[0]
    mean = weight @ np.array([one.mean for one in states])
    away = np.array([one.mean for one in states]) - mean
    within = np.einsum("m,mij->ij", weight, np.array([one.covariance for one in states]))
    return Gaussian(mean, symmetric(within + np.einsum("m,mi,mj->ij", weight, away, away)))
