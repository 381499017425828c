"""What is learned of each camera's detector on the way: rates, errors of edges, biases of boxes.

Everything begins with a prior that is worth a few boxes, so that one set of defaults serves detectors of all kinds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Bools, Floats

from .config import JipdaConfig
from .kernels.joint import Boxes, Rates, Result
from .people import CALM, TURNING, People

CURVE = np.array([0.02, 0.1, 0.4, 0.8, 0.95, 1.0])
"""At first: probability of detection at the visible shares 0, 0.2, .. 1, against that in plain view."""
PRIOR_LOOKS = 10.0
"""The first rates of detection and of boxes of nobody are worth so many looks."""
PRIOR_CURVE = 20.0
"""The first curve is worth so many people at each of its places."""
PRIOR_BOXES = 5.0
"""The first noise of edges is worth so many boxes of each of five sizes."""
PRIOR_BIAS = np.array([0.01, 0.1, 0.02, 0.05])
"""Standard deviations of the biases of middle and width across, of middle and height down; see `Rates.bias`."""
PRIOR_CUTS = (2.0, 4.0)
"""At first every other box ends where the cover of the feet begins."""
PRIOR_TURNS = 5.0
"""The first rate of manoeuvres is worth so many of them."""
PRIOR_DEATHS = 2.0
"""The first rate of leaving is worth so many who left."""
SIZES = np.array([30.0, 60.0, 120.0, 240.0, 480.0])
SURE, PLAIN, OWN = 0.9, 0.85, 0.7
"""Those teach who exist this surely; in plain view they are visible to this share; a box is theirs this surely."""
SWAY = 0.03
"""How far the middle of a person's outline is from the axis on which they stand, as a share of their height: bodies are
no ellipsoids and floors are not quite flat.  It is added to what boxes teach, because cameras agree on it."""
SWAY_S = 0.5
"""How long such an error lasts [s]."""
MIDDLES = np.array([1.0, 0.0, 1.0, 0.0])
OUTLIER = 12.0
"""Squared residuals count at most so many times their variance."""
LEAST_NOISE = np.array([0.25, 1e-5])
DETECTION_RANGE = (0.05, 0.98)


@dataclass(frozen=True)
class Counts:
    """Sums over boxes and people seen so far, priors included; C cameras, K places of the curve."""

    detected: Floats  # (C, 2) people in plain view: detected, all
    clutter: Floats  # (C, 2) boxes of nobody, looks
    curve: Floats  # (K, 2) detected, expected in plain view
    cuts: Floats  # (2,) boxes that end where the cover of the feet begins, boxes of people whose feet are covered
    bias: Floats  # (C, 4)
    bias_variance: Floats  # (C, 4)
    normal: Floats  # (4, 2, 2) normal equations of the noise: y = a + b size^2
    right: Floats  # (4, 2) right-hand sides
    left: Floats  # (2,) people who left, person-seconds
    turned: Floats  # (2,) manoeuvres begun, seconds of calm motion


def first_counts(cameras: int, config: JipdaConfig) -> Counts:
    """The priors, for so many cameras."""
    a = np.array([0.5, 2.0, 0.5, 2.0]) * config.edge_px**2
    b = np.array([1.0, 4.0, 0.25, 1.0]) * config.looseness**2
    x = np.stack([np.ones_like(SIZES), SIZES**2])
    y = a[:, None] + b[:, None] * SIZES**2
    weight = PRIOR_BOXES / y**2
    return Counts(
        detected=np.tile([PRIOR_LOOKS * config.detection, PRIOR_LOOKS], (cameras, 1)),
        clutter=np.tile([PRIOR_LOOKS * config.clutter, PRIOR_LOOKS], (cameras, 1)),
        curve=PRIOR_CURVE * np.column_stack([CURVE, np.ones_like(CURVE)]),
        cuts=np.array(PRIOR_CUTS),
        bias=np.zeros((cameras, 4)),
        bias_variance=np.tile(PRIOR_BIAS**2, (cameras, 1)),
        normal=np.einsum("an,bn,kn->kab", x, x, weight),
        right=np.einsum("an,kn,kn->ka", x, y, weight),
        left=PRIOR_DEATHS * np.array([1.0, config.stay_s]),
        turned=PRIOR_TURNS * np.array([1.0, config.calm_s]),
    )


def rates_of(counts: Counts, config: JipdaConfig, interval: Floats) -> Rates:
    """What the sums say of the detectors.

    Args:
        counts: the sums.
        config: whether people hide one another.
        interval: (C,) time since each camera's last look [s], > 0; may be infinite.
    """
    curve = np.maximum.accumulate(counts.curve[:, 0] / counts.curve[:, 1])
    curve = curve / curve[-1] if config.visible else np.ones_like(curve)
    return Rates(
        detection=np.clip(counts.detected[:, 0] / counts.detected[:, 1], *DETECTION_RANGE),
        curve=curve,
        cut=float(counts.cuts[0] / counts.cuts[1]),
        bias=counts.bias,
        noise=_noise(counts),
        sway=SWAY**2,
        # White noise that is worth as much as one whose correlation falls as exp(-t / SWAY_S)
        lasting=1.0 / np.tanh(0.5 * interval / SWAY_S),
    )


def leaving_rate(counts: Counts) -> float:
    """How many of the people leave in a second."""
    return float(counts.left[0] / counts.left[1])


def turning_rate(counts: Counts) -> float:
    """How often in a second somebody who walks on begins to manoeuvre."""
    return float(counts.turned[0] / counts.turned[1])


def boxes_of_nobody(counts: Counts) -> Floats:
    """(C,) expected in a look of each camera."""
    return np.asarray(counts.clutter[:, 0] / counts.clutter[:, 1])


def _noise(counts: Counts) -> Floats:
    """(4, 2) constant and share squared of the variance of middles and sizes: least squares, none negative."""
    out = np.linalg.solve(counts.normal, counts.right[..., None])[..., 0]
    for k in range(4):
        A, r = counts.normal[k], counts.right[k]
        for one, other in ((0, 1), (1, 0)):
            if out[k, one] < LEAST_NOISE[one]:
                out[k, one] = LEAST_NOISE[one]
                out[k, other] = max((r[other] - A[0, 1] * LEAST_NOISE[one]) / A[other, other], LEAST_NOISE[other])
    return np.asarray(out, dtype=np.float64)


def learn(counts: Counts, people: People, dt: float, boxes: Boxes, rates: Rates, result: Result) -> Counts:
    """The sums with the boxes of one more moment; boxes of nobody are counted elsewhere, when births are known."""
    detected, curve = counts.detected.copy(), counts.curve.copy()
    sure = people.existence > SURE
    last = len(curve) - 1
    for look, c in enumerate(boxes.camera.tolist()):
        visible = result.visible[look]
        hit = result.share[:, boxes.first[look] : boxes.first[look + 1]].sum(axis=1)
        plain = sure & (visible > PLAIN)
        detected[c] += (hit[plain].sum(), plain.sum())
        # The curve, with each person's weight between two of its places
        seen = np.flatnonzero(sure & (visible > 0.0))
        at = visible[seen] * last
        k = np.minimum(at.astype(np.int64), last - 1)
        for place, weight in ((k, 1.0 - (at - k)), (k + 1, at - k)):
            np.add.at(curve[:, 0], place, weight * hit[seen])
            np.add.at(curve[:, 1], place, weight * rates.detection[c])
    begun = float(people.model[sure, TURNING] @ people.began[sure])
    turned = counts.turned + np.array([begun, dt * people.model[sure, CALM].sum()])
    counts = replace(counts, detected=detected, curve=curve, cuts=counts.cuts + result.cuts, turned=turned)
    return _learn_edges(counts, sure, boxes, rates, result)


def _learn_edges(counts: Counts, sure: Bools, boxes: Boxes, rates: Rates, result: Result) -> Counts:
    """Noise and biases, from whole boxes of people in plain view."""
    box = np.arange(len(boxes.box))
    look = np.repeat(np.arange(len(boxes.camera)), np.diff(boxes.first))
    own = result.owner
    good = (own >= 0) & boxes.believed.all(axis=1)
    if not good.any():
        return counts
    with np.errstate(invalid="ignore"):
        good[good] &= sure[own[good]] & (result.share[own[good], box[good]] > OWN)
        good[good] &= result.visible[look[good], own[good]] > PLAIN
    e, s = result.residual[good], result.spread[good]
    w, h = result.size[good].T
    size = np.column_stack([h, w, h, h])
    S = s + rates.noise[:, 0] + (rates.noise[:, 1] + rates.sway * MIDDLES) * size**2
    # Errors of bodies last, and people who are looked at together are misplaced together
    slow = rates.lasting[boxes.camera[look[good]], None] * (s + rates.sway * size**2) + S
    # Noise: squared residuals, less the spread of the expected boxes, by weighted least squares
    y, weight = np.minimum(e**2, OUTLIER * S) - s, 1.0 / S**2
    x = np.stack([np.ones_like(size), size**2])
    normal = counts.normal + np.einsum("ank,bnk,nk->kab", x, x, weight)
    right = counts.right + np.einsum("ank,nk,nk->ka", x, y, weight)
    # Biases: a scalar Kalman filter for each
    bias, variance = counts.bias.copy(), counts.bias_variance.copy()
    for c, off, noise in zip(boxes.camera[look[good]].tolist(), e / size, slow / size**2, strict=True):
        gain = variance[c] / (variance[c] + noise)
        bias[c] += gain * off
        variance[c] *= 1.0 - gain
    return replace(counts, normal=normal, right=right, bias=bias, bias_variance=variance)
