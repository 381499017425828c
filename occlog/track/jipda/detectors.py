"""What is learned of detectors and people on the way: of detection, boxes of nobody, leaving, turning and bending.

Everything begins with a prior that is worth a few boxes, so that one set of defaults serves detectors of all kinds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .box_errors import LASTS_S, Edges, lasting_of, noise_of, slowness_of
from .config import JipdaConfig
from .kernels.detections import LOG_SIZE_RANGE, Boxes, Rates
from .kernels.joint import BLIND_FRAME, NOISE_INFLATION, Result
from .people import BENDING, CALM, TURNING, People

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
PRIOR_BENDS = 2.0
"""The first rate of bending is worth so many times that somebody bent."""
PRIOR_DEATHS = 2.0
"""The first rate of leaving is worth so many who left."""
PRIOR_AGAIN = (1.0, 4.0)
"""At first so many of so many boxes of nobody are there again at the camera's next look."""
MOST_AGAIN = 0.95
"""Boxes of nobody are there again at most so probably."""
MOST_LOG = 50.0
"""Greatest log of a density against that of a box anywhere."""
LEAST_FREE = 0.05
"""Boxes that are of nobody with a lower probability are not looked for again."""
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
    again: Floats  # (C, 2) boxes of nobody that are there again at the next look, boxes of nobody
    left: Floats  # (2,) people who left, person-seconds
    turned: Floats  # (2,) manoeuvres begun, seconds of calm motion
    bent: Floats  # (2,) times that somebody bent, person-seconds upright


def first_counts(cameras: int, config: JipdaConfig) -> Counts:
    """The priors, for so many cameras."""
    return Counts(
        detected=np.tile([PRIOR_LOOKS * config.detection, PRIOR_LOOKS], (cameras, 1)),
        clutter=np.tile([PRIOR_LOOKS * config.clutter, PRIOR_LOOKS], (cameras, 1)),
        curve=PRIOR_CURVE * np.column_stack([CURVE, np.ones_like(CURVE)]),
        cuts=np.array(PRIOR_CUTS),
        merges=np.tile(PRIOR_MERGES, (cameras, 1)),
        wrong=np.array(PRIOR_WRONG),
        again=np.tile(PRIOR_AGAIN, (cameras, 1)),
        left=PRIOR_DEATHS * np.array([1.0, config.stay_s]),
        turned=PRIOR_TURNS * np.array([1.0, config.calm_s]),
        bent=PRIOR_BENDS * np.array([1.0, config.bend_s]),
    )


def rates_of(counts: Counts, edges: Edges, config: JipdaConfig, interval: Floats, between: float = 1.0) -> Rates:
    """What the sums say of the detectors.

    Args:
        counts: sums over people.
        edges: sums over boxes.
        config: whether people hide one another.
        interval: (C,) time since each camera's last look [s], > 0; may be infinite.
        between: how many looks of a camera there are to one that counts, >= 1.
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
        slow=slowness_of(edges, between),
    )


def leaving_rate(counts: Counts) -> float:
    """How many of the people leave in a second."""
    return float(counts.left[0] / counts.left[1])


def turning_rate(counts: Counts) -> float:
    """How often in a second somebody who walks on begins to manoeuvre."""
    return float(counts.turned[0] / counts.turned[1])


def bending_rate(counts: Counts) -> float:
    """How often in a second somebody bends, falls, lies down or gets up."""
    return float(counts.bent[0] / counts.bent[1])


def boxes_of_nobody(counts: Counts) -> Floats:
    """(C,) expected in a look of each camera."""
    return np.asarray(counts.clutter[:, 0] / counts.clutter[:, 1])


class Nobodys(NamedTuple):
    """Boxes of a camera's last look that may be of nobody."""

    box: Floats  # (n, 4)
    free: Floats  # (n,) probability that they are of nobody


def no_box() -> Nobodys:
    """No box of nobody."""
    return Nobodys(np.zeros((0, 4)), np.zeros(0))


def again_rate(counts: Counts) -> Floats:
    """(C,) probability that a box of nobody is there again at the camera's next look."""
    return np.asarray(np.minimum(counts.again[:, 0] / counts.again[:, 1], MOST_AGAIN))


def seen_again(boxes: Boxes, before: Sequence[Nobodys], again: Floats, noise: Floats, size: Floats) -> Floats:
    """Expect boxes of nobody where the camera's last look had some: a shadow or a post is there again.

    Args:
        boxes: of the moment, M of L looks.
        before: of each camera.
        again: (C,) probability that a box of nobody is there again.
        noise: (4, 2) variances as in `Rates.noise`.
        size: (C, 2) width and height of the images [px].

    Returns:
        (M,) expected number of such boxes, as `exp(Boxes.clutter)` is that of boxes of nobody anywhere.
    """
    out = np.zeros(len(boxes.box))
    for look, c in enumerate(boxes.camera.tolist()):
        here = slice(boxes.first[look], boxes.first[look + 1])
        old, now = before[c].box, boxes.box[here]
        if not len(old) or not len(now):
            continue
        # Density of the new box about the old one, against that of a box anywhere in the image
        width, height = (old[:, 2:] - old[:, :2]).T
        extent = np.column_stack([height, width, height, height])
        variance = 2.0 * NOISE_INFLATION * (noise[:, 0] + noise[:, 1] * extent**2)
        off = _middles_and_sizes(now)[:, None] - _middles_and_sizes(old)
        log = -0.5 * (off**2 / variance + np.log(2.0 * np.pi * variance)).sum(axis=2)
        sizes = (np.log(np.maximum(now[:, 2:] - now[:, :2], 1.0)) + LOG_SIZE_RANGE).sum(axis=1)
        log += np.log(size[c]).sum() + sizes[:, None]
        out[here] = again[c] * (np.exp(np.minimum(log, MOST_LOG)) * before[c].free).sum(axis=1)
    return out


def _middles_and_sizes(box: Floats) -> Floats:
    """(n, 4) middle and width across, middle and height down, of boxes (n, 4)."""
    low, high = box[:, :2], box[:, 2:]
    return np.stack([0.5 * (low + high), high - low], axis=2).reshape(-1, 4)


def blind_looks(boxes: Boxes, existence: Floats, detection: Floats) -> Bools:
    """(L,) looks without any box that are more probably blind than that they missed everybody.

    Args:
        boxes: of L looks.
        existence: (N,) of people.
        detection: (L, N) probabilities of detection.
    """
    missed = np.log1p(-existence * np.minimum(detection, DETECTION_RANGE[1])).sum(axis=1)
    return np.asarray((np.diff(boxes.first) == 0) & (missed < math.log(BLIND_FRAME)))


def learn(
    counts: Counts, people: People, *, dt: float, config: JipdaConfig, boxes: Boxes, rates: Rates, result: Result
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
    turned = counts.turned + np.array([model[TURNING] / config.turn_s, model[CALM]])
    bent = counts.bent + np.array([model[BENDING] / config.bent_s, model[CALM] + model[TURNING]])
    return replace(
        counts,
        detected=detected,
        curve=curve,
        cuts=counts.cuts + result.cuts,
        merges=merges,
        wrong=counts.wrong + result.wrong,
        turned=turned,
        bent=bent,
    )
