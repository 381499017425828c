"""What is learned of detectors and people on the way: rates of detection, of boxes of nobody, of leaving, of turning.

Everything begins with a prior that is worth a few boxes, so that one set of defaults serves detectors of all kinds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Bools, Floats

from .config import JipdaConfig
from .edges import LASTS_S, Edges, lasting_of, noise_of, slowness_of
from .kernels.joint import BLIND, Boxes, Rates, Result
from .people import CALM, TURNING, People

CURVE = np.array([0.02, 0.1, 0.4, 0.8, 0.95, 1.0])
"""At first: probability of detection at the visible shares 0, 0.2, .. 1, against that in plain view."""
PRIOR_LOOKS = 10.0
"""The first rates of detection and of boxes of nobody are worth so many looks."""
PRIOR_CURVE = 20.0
"""The first curve is worth so many people at each of its places."""
PRIOR_CUTS = (2.0, 4.0)
"""At first every other box ends where the cover of the feet begins."""
PRIOR_MERGES = (0.5, 10.0)
"""At first few of the pairs of people who touch in an image are one box there; it is worth so many pairs."""
PRIOR_WRONG = (1.0, 50.0)
"""At first so many of so many boxes have a wrong edge."""
PRIOR_TURNS = 5.0
"""The first rate of manoeuvres is worth so many of them."""
PRIOR_DEATHS = 2.0
"""The first rate of leaving is worth so many who left."""
SURE, PLAIN = 0.9, 0.85
"""Those teach who exist this surely; in plain view they are visible to this share."""
DETECTION_RANGE = (0.05, 0.98)
MOST_MERGED = 0.9
"""Of the pairs who touch in an image not more than this share is believed to be one box there."""


@dataclass(frozen=True)
class Counts:
    """Sums over boxes and people seen so far, priors included; C cameras, K places of the curve."""

    detected: Floats  # (C, 2) people in plain view: detected, all
    clutter: Floats  # (C, 2) boxes of nobody, looks
    curve: Floats  # (K, 2) detected, expected in plain view
    cuts: Floats  # (2,) boxes that end where the cover of the feet begins, boxes of people whose feet are covered
    merges: Floats  # (C, 2) pairs who touch in the image: in one box, of whom there is a box
    wrong: Floats  # (2,) boxes with a wrong edge, all boxes
    left: Floats  # (2,) people who left, person-seconds
    turned: Floats  # (2,) manoeuvres begun, seconds of calm motion


def first_counts(cameras: int, config: JipdaConfig) -> Counts:
    """The priors, for so many cameras."""
    return Counts(
        detected=np.tile([PRIOR_LOOKS * config.detection, PRIOR_LOOKS], (cameras, 1)),
        clutter=np.tile([PRIOR_LOOKS * config.clutter, PRIOR_LOOKS], (cameras, 1)),
        curve=PRIOR_CURVE * np.column_stack([CURVE, np.ones_like(CURVE)]),
        cuts=np.array(PRIOR_CUTS),
        merges=np.tile(PRIOR_MERGES, (cameras, 1)),
        wrong=np.array(PRIOR_WRONG),
        left=PRIOR_DEATHS * np.array([1.0, config.stay_s]),
        turned=PRIOR_TURNS * np.array([1.0, config.calm_s]),
    )


def rates_of(counts: Counts, edges: Edges, config: JipdaConfig, interval: Floats) -> Rates:
    """What the sums say of the detectors.

    Args:
        counts: sums over people.
        edges: sums over boxes.
        config: whether people hide one another.
        interval: (C,) time since each camera's last look [s], > 0; may be infinite.
    """
    curve = np.maximum.accumulate(counts.curve[:, 0] / counts.curve[:, 1])
    curve = curve / curve[-1] if config.visible else np.ones_like(curve)
    return Rates(
        detection=np.clip(counts.detected[:, 0] / counts.detected[:, 1], *DETECTION_RANGE),
        curve=curve,
        cut=float(counts.cuts[0] / counts.cuts[1]),
        wrong=float(counts.wrong[0] / counts.wrong[1]),
        bias=edges.bias,
        noise=noise_of(edges),
        sway=lasting_of(edges),
        # White noise that is worth as much as one whose correlation falls as exp(-t / LASTS_S)
        lasting=1.0 / np.tanh(0.5 * interval / LASTS_S),
        merge=np.minimum(counts.merges[:, 0] / counts.merges[:, 1], MOST_MERGED),
        slow=slowness_of(edges),
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


def blind_looks(boxes: Boxes, existence: Floats, detection: Floats) -> Bools:
    """(L,) looks without any box that are more probably blind than that they missed everybody.

    Args:
        boxes: of L looks.
        existence: (N,) of people.
        detection: (L, N) probabilities of detection.
    """
    missed = np.log1p(-existence * np.minimum(detection, DETECTION_RANGE[1])).sum(axis=1)
    return np.asarray((np.diff(boxes.first) == 0) & (missed < math.log(BLIND)))


def learn(
    counts: Counts, people: People, *, dt: float, turn_s: float, boxes: Boxes, rates: Rates, result: Result
) -> Counts:
    """The sums with the boxes of one more moment; boxes of nobody are counted elsewhere, when births are known."""
    detected, curve, merges = counts.detected.copy(), counts.curve.copy(), counts.merges.copy()
    sure = people.existence > SURE
    last = len(curve) - 1
    blind = blind_looks(boxes, people.existence, result.detection)
    for look, c in enumerate(boxes.camera.tolist()):
        if blind[look]:
            continue
        visible = result.visible[look]
        here = slice(boxes.first[look], boxes.first[look + 1])
        hit, apart = result.share[:, here].sum(axis=1), 1.0 - np.minimum(result.joint[:, here].sum(axis=1), 1.0)
        plain = sure & (visible > PLAIN)
        detected[c] += (hit[plain].sum(), apart[plain].sum())
        merges[c] += result.merges[look]
        # The curve, with each person's weight between two of its places
        seen = np.flatnonzero(sure & (visible > 0.0))
        at = visible[seen] * last
        k = np.minimum(at.astype(np.int64), last - 1)
        for place, weight in ((k, 1.0 - (at - k)), (k + 1, at - k)):
            np.add.at(curve[:, 0], place, weight * hit[seen])
            np.add.at(curve[:, 1], place, weight * apart[seen] * rates.detection[c])
    # So many begin as end: the time spent in manoeuvres over how long one takes
    model = dt * people.model[sure].sum(axis=0)
    turned = counts.turned + np.array([model[TURNING] / turn_s, model[CALM]])
    return replace(
        counts,
        detected=detected,
        curve=curve,
        cuts=counts.cuts + result.cuts,
        merges=merges,
        wrong=counts.wrong + result.wrong,
        turned=turned,
    )
