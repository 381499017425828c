"""What is learned of the errors of boxes: noise, each camera's biases, errors that last, and the sway of bodies.

All of it comes from how far the cameras of one moment disagree (`kernels.disagreement`), never from residuals against
the filter's prediction, which hold its own lag:

* noise of middles and sizes, y = a + b size^2, by weighted least squares of the squared disagreements;
* biases of each camera, by a scalar Kalman filter each;
* the part that lasts, s^2 exp(-t / LASTS_S), from the products of a person's disagreements at successive looks of a
  camera;
* sway, an error of the place that all cameras share and that is new at every moment: with z the places that moments
  alone say, at equal intervals, and d_k = z_k - 2 z_{k-1} + z_{k-2}, white acceleration leaves d_k and d_{k-2}
  uncorrelated, so that E d_k d_{k-2} is the variance of the error of z_{k-2}.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints

from .config import JipdaConfig
from .kernels.detections import Boxes
from .kernels.disagreement import Disagreement

PRIOR_BOXES = 5.0
"""The first noise of edges is worth so many boxes of each of five sizes."""
SIZES = np.array([30.0, 60.0, 120.0, 240.0, 480.0])
PRIOR_BIAS = np.array([0.01, 0.1, 0.02, 0.05])
"""Standard deviations of the biases of middle and width across, of middle and height down; see `Rates.bias`."""
LASTS_S = 0.5
"""How long errors last that do not change from look to look [s]."""
FIRST_LASTING, PRIOR_LASTING, USUAL = 0.015, 20.0, 0.01
"""At first, in heights; it is worth so many pairs of looks with this noise, in heights."""
FIRST_SWAY, PRIOR_SWAY = 0.03, 200.0
"""At first, in metres; it is worth so many triples of looks."""
PRIOR_CHANGES = 200.0
"""At first errors are new at each look; it is worth half as many looks."""
MOST_ALIKE = 0.9
MOST_LASTING = 0.06
SWAY_RANGE = (0.03, 0.12)
"""Nobody's place is a point: feet and head sway about it [m]."""
MOST_PRODUCT = 0.2
"""Products of changes count at most so much [m^2]: an exchange of people is not their sway."""
LEAST_KEPT = 0.3
OUTLIER = 12.0
"""Squared residuals count at most so many times their variance."""
LEAST_NOISE = np.array([0.25, 1e-5])
MIDDLES = np.array([0, 2])
EVEN = 0.2
"""Intervals are equal that differ by less than this share."""


@dataclass(frozen=True)
class Edges:
    """Sums over boxes seen so far, priors included; C cameras."""

    metre: float
    bias: Floats  # (C, 4)
    bias_variance: Floats  # (C, 4)
    normal: Floats  # (4, 2, 2) normal equations of the noise
    right: Floats  # (4, 2) right-hand sides
    lasting: Floats  # (2,) sums of products and of their weights
    sway: Floats  # (2,) the same
    before: dict[tuple[int, int], tuple[int, Floats]]  # by person and camera: time, last disagreement of middles
    path: dict[int, tuple[tuple[int, Floats, float], ...]]  # by person: time, place, variance of the last five moments
    changes: Floats  # (2,) squared changes of disagreements over two looks, and over one
    last: dict[
        tuple[int, int], tuple[tuple[int, Floats], ...]
    ]  # by person and camera: time, disagreements at two looks


def first_edges(cameras: int, metre: float, config: JipdaConfig) -> Edges:
    """The priors, for so many cameras."""
    a = np.array([0.5, 2.0, 0.5, 2.0]) * config.edge_px**2
    b = np.array([1.0, 4.0, 1.0, 4.0]) * config.looseness**2
    x = np.stack([np.ones_like(SIZES), SIZES**2])
    y = a[:, None] + b[:, None] * SIZES**2
    weight = PRIOR_BOXES / y**2
    return Edges(
        metre=metre,
        bias=np.zeros((cameras, 4)),
        bias_variance=np.tile(PRIOR_BIAS**2, (cameras, 1)),
        normal=np.einsum("an,bn,kn->kab", x, x, weight),
        right=np.einsum("an,kn,kn->ka", x, y, weight),
        lasting=PRIOR_LASTING / USUAL**4 * np.array([FIRST_LASTING**2, 1.0]),
        sway=PRIOR_SWAY * np.array([(FIRST_SWAY * metre) ** 2, 1.0]),
        before={},
        path={},
        changes=np.full(2, PRIOR_CHANGES),
        last={},
    )


def noise_of(edges: Edges) -> Floats:
    """(4, 2) constant [px^2] and share squared of the variance of middles and sizes: least squares, none negative."""
    out = np.linalg.solve(edges.normal, edges.right[..., None])[..., 0]
    for k in range(4):
        A, r = edges.normal[k], edges.right[k]
        for one, other in ((0, 1), (1, 0)):
            if out[k, one] < LEAST_NOISE[one]:
                out[k, one] = LEAST_NOISE[one]
                out[k, other] = max((r[other] - A[0, 1] * LEAST_NOISE[one]) / A[other, other], LEAST_NOISE[other])
    # The part that lasts is counted apart
    out[MIDDLES, 1] = np.maximum(out[MIDDLES, 1] - lasting_of(edges), 0.0)
    return np.asarray(out, dtype=np.float64)


def lasting_of(edges: Edges) -> float:
    """Variance of the errors of middles that last, in heights squared."""
    return float(np.clip(edges.lasting[0] / edges.lasting[1], 0.0, MOST_LASTING**2))


def sway_of(edges: Edges) -> float:
    """Variance of the place that a body shows at a moment about the one where it walks."""
    return float(np.clip(edges.sway[0] / edges.sway[1], *(np.array(SWAY_RANGE) * edges.metre) ** 2))


def slowness_of(edges: Edges, between: float = 1.0) -> float:
    """(1 + r) / (1 - r), r the correlation of errors from one look that counts to the next: their weight.

    Of a camera's looks one of `between` counts; the correlation falls geometrically with their number.
    """
    alike = float(np.clip(edges.changes[0] / edges.changes[1] - 1.0, 0.0, MOST_ALIKE) ** between)
    return (1.0 + alike) / (1.0 - alike)


def learn_edges(
    edges: Edges, t_ns: int, boxes: Boxes, found: Disagreement, *, key: Ints, owner: Ints, lasts: Floats
) -> Edges:
    """The sums with one more moment.

    Args:
        edges: before.
        t_ns: time of the moment.
        boxes: of it.
        found: how far its cameras disagree.
        key: (N,) of people.
        owner: (M,) person of each box.
        lasts: (C,) how many times as long errors that last count.
    """
    camera = np.repeat(boxes.camera, np.diff(boxes.first))
    used = np.flatnonzero((found.kept > LEAST_KEPT).any(axis=1))
    if len(used):
        edges = _noise_and_bias(edges, used, camera, found, lasts)
    edges = _changes(edges, t_ns, used, camera, found, key[owner[used]])
    edges = _lasting(edges, t_ns, used, camera, found, key[owner[used]])
    return _sway(edges, t_ns, found, key)


def _noise_and_bias(edges: Edges, used: Ints, camera: Ints, found: Disagreement, lasts: Floats) -> Edges:
    noise = noise_of(edges)
    noise[MIDDLES, 1] += lasting_of(edges)
    r, kept, size = found.residual[used], found.kept[used], found.size[used]
    S = noise[:, 0] + noise[:, 1] * size**2
    share = np.where(kept > LEAST_KEPT, kept, 1.0)
    # Noise: squared disagreements by the share of the variance that they keep, by weighted least squares
    y, weight = np.minimum(r**2 / share, OUTLIER * S), np.where(kept > LEAST_KEPT, (kept / S) ** 2, 0.0)
    x = np.stack([np.ones_like(size), size**2])
    # Biases: a scalar Kalman filter for each; errors that last count less
    bias, variance = edges.bias.copy(), edges.bias_variance.copy()
    for k, row in enumerate(used):
        c = camera[row]
        slow = S[k] / (share[k] * size[k] ** 2) * lasts[c]
        gain = np.where(kept[k] > LEAST_KEPT, variance[c] / (variance[c] + slow), 0.0)
        bias[c] += gain * r[k] / (share[k] * size[k])
        variance[c] *= 1.0 - gain
    return replace(
        edges,
        normal=edges.normal + np.einsum("ank,bnk,nk->kab", x, x, weight),
        right=edges.right + np.einsum("ank,nk,nk->ka", x, y, weight),
        bias=bias,
        bias_variance=variance,
    )


def _changes(edges: Edges, t_ns: int, used: Ints, camera: Ints, found: Disagreement, key: Ints) -> Edges:
    """Compare changes over two looks with those over one: 1 - r^2 to 1 - r, whatever stays for longer."""
    noise, sums = noise_of(edges), edges.changes.copy()
    noise[MIDDLES, 1] += lasting_of(edges)
    last = {k: v for k, v in edges.last.items() if t_ns - v[-1][0] < 2 * NS}
    for row, person in zip(used.tolist(), key.tolist(), strict=True):
        size, kept = found.size[row], found.kept[row]
        deviation = np.sqrt((noise[:, 0] + noise[:, 1] * size**2) * np.maximum(kept, LEAST_KEPT))
        now = np.where(kept > LEAST_KEPT, found.residual[row] / deviation, np.nan)
        at = (person, int(camera[row]))
        looks = (*last.get(at, ()), (t_ns, now))[-3:]
        last[at] = looks
        if len(looks) == 3:
            first, second = looks[1][0] - looks[0][0], looks[2][0] - looks[1][0]
            if max(first, second) > (1.0 + EVEN) * min(first, second):
                continue
            two = np.minimum((now - looks[0][1]) ** 2, OUTLIER)
            one = 0.5 * np.minimum((now - looks[1][1]) ** 2, OUTLIER)
            one += 0.5 * np.minimum((looks[1][1] - looks[0][1]) ** 2, OUTLIER)
            fine = np.isfinite(two) & np.isfinite(one)
            sums += (two[fine].sum(), one[fine].sum())
    return replace(edges, changes=sums, last=last)


def _lasting(edges: Edges, t_ns: int, used: Ints, camera: Ints, found: Disagreement, key: Ints) -> Edges:
    noise, sums = noise_of(edges), edges.lasting.copy()
    noise[MIDDLES, 1] += lasting_of(edges)
    before = {k: v for k, v in edges.before.items() if t_ns - v[0] < 4.0 * LASTS_S * NS}
    for row, person in zip(used.tolist(), key.tolist(), strict=True):
        size, kept = found.size[row, MIDDLES], found.kept[row, MIDDLES]
        off = np.where(kept > LEAST_KEPT, found.residual[row, MIDDLES] / size / np.sqrt(np.maximum(kept, 0.1)), np.nan)
        variance = noise[MIDDLES, 0] / size**2 + noise[MIDDLES, 1]
        now = np.concatenate([off, variance])
        at = (person, int(camera[row]))
        if at in before:
            then, old = before[at]
            # E of the product is s^2 exp(-t / LASTS_S)
            w = np.exp(-(t_ns - then) / NS / LASTS_S)
            weight = 1.0 / (variance * old[2:])
            product = np.clip(off * old[:2], -OUTLIER * variance, OUTLIER * variance)
            fine = np.isfinite(product)
            sums += (np.sum((w * weight * product)[fine]), np.sum((w * w * weight)[fine]))
        before[at] = (t_ns, now)
    return replace(edges, lasting=sums, before=before)


def _sway(edges: Edges, t_ns: int, found: Disagreement, key: Ints) -> Edges:
    sums, path = edges.sway.copy(), {}
    most = MOST_PRODUCT * edges.metre**2
    for i in np.flatnonzero(np.isfinite(found.place[:, 0])).tolist():
        k = int(key[i])
        now = (*edges.path.get(k, ()), (t_ns, found.place[i], float(found.variance[i])))[-5:]
        if len(now) > 1 and now[-1][0] - now[-2][0] > 2 * NS:
            now = now[-1:]
        path[k] = now
        if len(now) == 5:
            t = np.diff([p[0] for p in now])
            if t.max() > (1.0 + EVEN) * t.min():
                continue
            z = np.array([p[1] for p in now])
            late, early = z[4] - 2.0 * z[3] + z[2], z[2] - 2.0 * z[1] + z[0]
            product = float(np.mean(np.clip(late * early, -most, most)))
            sums += (product - now[2][2], 1.0)
    # People who were not seen well at this moment begin anew
    return replace(edges, sway=sums, path=path)


def good_boxes(boxes: Boxes, owner: Ints, share: Floats, visible: Floats, sure: Bools, least: float) -> Bools:
    """(M,) boxes that teach: whole, surely of somebody who surely exists and is in plain view.

    Args:
        boxes: M boxes of L looks.
        owner: (M,) likeliest person; negative: nobody.
        share: (N, M) probability that a box is of a person.
        visible: (L, N) visible shares; NaN: outside the image.
        sure: (N,) people who surely exist.
        least: visible share that is plain view.
    """
    box = np.arange(len(boxes.box))
    look = np.repeat(np.arange(len(boxes.camera)), np.diff(boxes.first))
    good = (owner >= 0) & boxes.believed.all(axis=1)
    mine, at = owner[good], box[good]
    good[good] = sure[mine] & (share[mine, at] > OWN) & (np.nan_to_num(visible[look[good], mine]) > least)
    return good


OWN = 0.7
"""A box teaches if it is somebody's with this probability."""
