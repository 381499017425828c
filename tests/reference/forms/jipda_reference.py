"""The JIPDA update by its equations, one person and one box at a time, in plain NumPy.

Boxes are left, top, right, bottom; a detector's errors are those of centre x, width, centre y, height.  Cameras are any
objects with position, rotation, focal_px, principal_px, image_size and range, without distortion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.stats import multivariate_normal, norm

LEAST = 0.02
"""Least probability of a hypothesis that updates a state."""
EDGES = np.array([[1.0, -0.5, 0.0, 0.0], [0.0, 0.0, 1.0, -0.5], [1.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5]])
"""From centre and size of both axes to the edges."""


class Detector(NamedTuple):
    """Error model of one camera's detector."""

    detection: float
    curve: np.ndarray
    cut: float
    wrong: float
    bias: np.ndarray  # (4,) in heights, widths, heights, heights
    noise: np.ndarray  # (4, 2)
    sway: float
    lasting: float
    merge: float
    slow: float


class Seen(NamedTuple):
    """A person as a camera is expected to show them; None in place of it: out of view."""

    outline: np.ndarray
    H: np.ndarray
    box: np.ndarray
    spread: np.ndarray
    noise: np.ndarray
    update_noise: np.ndarray
    depth: float
    across: float
    deep: float


def body_box(camera: Any, x: float, y: float, height: float, width: float) -> np.ndarray:
    """Box of an ellipsoid: its dual quadric Q projects to the dual conic P Q P' (Hartley and Zisserman, Eq. 8.6)."""
    K = np.array([[camera.focal_px[0], 0, camera.principal_px[0]], [0, camera.focal_px[1], camera.principal_px[1]],
                  [0, 0, 1.0]])  # fmt: skip
    P = K @ np.column_stack([camera.rotation.T, -camera.rotation.T @ camera.position])
    T = np.eye(4)
    T[:3, 3] = x, y, 0.5 * height
    C = P @ T @ np.diag([0.25 * width**2, 0.25 * width**2, 0.25 * height**2, -1.0]) @ T.T @ P.T
    roots = [np.sort(np.roots([C[2, 2], -2.0 * C[k, 2], C[k, k]]).real) for k in range(2)]
    return np.array([roots[0][0], roots[1][0], roots[0][1], roots[1][1]])


def outline_of(camera: Any, state: np.ndarray, delay: float) -> np.ndarray:
    """Box of a state after a delay."""
    return body_box(camera, state[0] + delay * state[2], state[1] + delay * state[3], state[4], state[5])


def edge_covariance(box: np.ndarray, detector: Detector, lasting: float) -> np.ndarray:
    """(4, 4) covariance of the edges."""
    width, height = box[2] - box[0], box[3] - box[1]
    variance = detector.noise[:, 0] + detector.noise[:, 1] * np.array([height, width, height, height]) ** 2
    variance += lasting * detector.sway * height**2 * np.array([1.0, 0.0, 1.0, 0.0])
    return np.asarray(EDGES @ np.diag(variance) @ EDGES.T)


def predicted(camera: Any, state: np.ndarray, P: np.ndarray, delay: float, detector: Detector) -> Seen | None:
    """The expected box of a person with its covariances."""
    depth = float(
        (camera.rotation.T @ (np.array([*(state[:2] + delay * state[2:4]), 0.5 * state[4]]) - camera.position))[2]
    )
    if depth < 0.5:
        return None
    outline = outline_of(camera, state, delay)
    w, h = camera.image_size
    inside = [-0.5 <= u <= w - 0.5 and -0.5 <= v <= h - 0.5 for v in rows_of(outline) for u in columns_of(outline)]
    if not any(inside) or np.hypot(*(state[:2] - camera.position[:2])) > camera.range:
        return None
    H = np.empty((4, 6))
    for k in range(6):
        step = 1e-4 * np.eye(6)[k]
        H[:, k] = (outline_of(camera, state + step, delay) - outline_of(camera, state - step, delay)) / 2e-4
    errors = np.linalg.solve(EDGES, outline)
    height = errors[3]
    errors[[0, 2]] += detector.bias[[0, 2]] * height
    errors[[1, 3]] *= 1.0 + detector.bias[[1, 3]]
    box, spread = EDGES @ errors, H @ P @ H.T
    centre, axis = np.array([0.5, 0.0, 0.5, 0.0]), camera.rotation[:2, 2]
    return Seen(
        outline, H, box, spread,
        2.0 * edge_covariance(box, detector, 1.0),
        detector.slow * edge_covariance(box, detector, detector.lasting / detector.slow),
        depth,
        float(np.sqrt(centre @ spread @ centre)),
        float(np.sqrt(axis @ P[:2, :2] @ axis + (0.1 * state[5]) ** 2)),
    )  # fmt: skip


def columns_of(box: np.ndarray) -> np.ndarray:
    """Middles of five columns."""
    return box[0] + (box[2] - box[0]) * (np.arange(5) + 0.5) / 5


def rows_of(box: np.ndarray) -> np.ndarray:
    """Middles of six rows."""
    return box[1] + (box[3] - box[1]) * (np.arange(6) + 0.5) / 6


def visible_cells(camera: Any, i: int, seen: Sequence[Seen | None], existence: np.ndarray) -> np.ndarray:
    """(6, 5) probabilities that no other person covers a cell: prod_j (1 - q_j); q_j below 1e-3 are left out."""
    me, (w, h) = seen[i], camera.image_size
    assert me is not None
    u, v = np.meshgrid(columns_of(me.outline), rows_of(me.outline))
    cells = ((u >= -0.5) & (u <= w - 0.5) & (v >= -0.5) & (v <= h - 0.5)).astype(float)
    for j, other in enumerate(seen):
        if j == i or other is None:
            continue
        nearer = existence[j] * norm.cdf((me.depth - other.depth) / np.hypot(me.deep, other.deep))
        s = np.hypot(me.across, other.across)
        across = norm.cdf((other.outline[2] - u) / s) - norm.cdf((other.outline[0] - u) / s)
        held = (v > other.outline[1]) & (v < other.outline[3]) & (nearer >= 1e-3) & (across >= 1e-3)
        cells *= 1.0 - np.where(held, nearer * across, 0.0)
    return cells


def curve_at(curve: np.ndarray, share: float) -> float:
    """Linear between the values at 0 .. 1."""
    return float(np.interp(share, np.linspace(0.0, 1.0, len(curve)), curve))


def who_touch(seen: Sequence[Seen | None], existence: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of people who probably exist and who touch in the image."""
    out = []
    for a in range(len(seen)):
        for b in range(a + 1, len(seen)):
            one, two = seen[a], seen[b]
            if one is None or two is None or min(existence[a], existence[b]) < 0.2:
                continue
            p, q = one.outline, two.outline
            gap = max(p[0], q[0]) - min(p[2], q[2])
            slack = np.hypot(one.across, two.across) + 0.1 * min(p[2] - p[0], q[2] - q[0])
            if gap <= slack and max(p[1], q[1]) <= min(p[3], q[3]):
                out.append((a, b))
    return out


def log_density(off: np.ndarray, use: np.ndarray, S: np.ndarray) -> tuple[float, float]:
    """Of the edges in use, with the squared Mahalanobis distance."""
    keep = np.flatnonzero(use)
    if not len(keep):
        return 0.0, 0.0
    part = S[np.ix_(keep, keep)]
    distance = float(off[keep] @ np.linalg.solve(part, off[keep]))
    return float(multivariate_normal(np.zeros(len(keep)), part).logpdf(off[keep])), distance


def log_clutter(box: np.ndarray, use: np.ndarray, size: tuple[int, int]) -> float:
    """An edge is uniform in the image, the size of an axis log-uniform over a factor of 20."""
    total = 0.0
    for axis in range(2):
        edges = int(use[axis]) + int(use[axis + 2])
        total -= np.log(size[axis]) if edges else 0.0
        total -= np.log(max(box[axis + 2] - box[axis], 1.0) * np.log(20.0)) if edges == 2 else 0.0
    return float(total)


def likelihood(
    z: np.ndarray, use: np.ndarray, me: Seen, covered: float, detector: Detector, clutter: float, gate: float
) -> tuple[float, float, int]:
    """Likelihood ratio to clutter of a box, the probability that it has no outlier edge, and the likeliest outlier."""
    off, S = z - me.box, me.spread + me.noise
    if np.sum(use & (off**2 > 2.0 * gate * np.diag(S))) > 1:
        return 0.0, 1.0, -1
    log_full, distance = log_density(off, use, S)
    cut = detector.cut * covered
    full = np.exp(log_full - clutter) * (distance < gate) * (1.0 - detector.wrong)
    full *= 1.0 - cut if off[3] < 0.0 else 1.0
    size = np.tile(me.box[2:] - me.box[:2], 2)
    parts = np.zeros(4)
    for e in np.flatnonzero(use):
        rest = use & (np.arange(4) != e)
        if e == 3 and off[3] < 0.0 and cut > 0.01:
            chance = cut / (0.8 * size[e])
        elif use.all() and off[e] ** 2 > 4.0 * S[e, e]:
            chance = detector.wrong / 4.0 / (2.0 * size[e])
        else:
            continue
        log_part, distance = log_density(off, rest, S)
        parts[e] = chance * np.exp(log_part - clutter) * (distance < gate)
    most = parts.max()
    return full + most, full / (full + most) if most > 0.0 else 1.0, int(parts.argmax()) if most > 0.0 else -1


class Outline(NamedTuple):
    """The outline of two people."""

    box: np.ndarray
    S: np.ndarray
    own: np.ndarray


def outline_of_two(a: Seen, b: Seen) -> Outline:
    """Each edge is of whoever is probably farther out; edges of different people are independent."""
    sign = np.array([-1.0, -1.0, 1.0, 1.0])
    spread = np.diag(a.noise + a.spread + b.noise + b.spread)
    own = norm.cdf(sign * (a.box - b.box) / np.sqrt(spread))
    first = own >= 0.5
    S = np.where(np.outer(first, first), a.noise + a.spread, 0.0)
    S = np.where(np.outer(~first, ~first), b.noise + b.spread, S)
    return Outline(np.where(first, a.box, b.box), S, own)


def belief_propagation(weight: np.ndarray, members: Sequence[tuple[int, ...]], nodes: int) -> np.ndarray:
    """Sum-product on hypotheses that exclude one another: each node takes part in at most one of its hypotheses.

    Args:
        weight: (H,) of hypotheses, against none of their members taking part in any.
        members: of each hypothesis, its nodes.
        nodes: how many there are.

    Returns:
        (H, nodes) x with which the belief of hypothesis h at node c is x_hc / (1 + sum_g x_gc); 0: no member.
    """
    is_member = np.zeros((len(weight), nodes), dtype=bool)
    for h, own in enumerate(members):
        is_member[h, list(own)] = True
    m = np.ones((len(weight), nodes))
    x = np.zeros_like(m)
    for _ in range(5000):
        # From hypotheses: the weight times what their other members say; from nodes: how free they are of all others
        x = np.where(is_member, weight[:, None] * m.prod(axis=1, keepdims=True) / m, 0.0)
        new = np.where(is_member, 1.0 / (1.0 + x.sum(axis=0) - x), 1.0)
        if np.abs(new - m).max() < 1e-11:
            break
        m = 0.5 * (m + new)
    return x


class Association(NamedTuple):
    """Probabilities given existence, and the likelihood ratio of existence."""

    beta: np.ndarray  # (N, m)
    joint: np.ndarray  # (K, 2, m)
    ratio: np.ndarray  # (N,)


def associate(
    r: np.ndarray,
    detection: np.ndarray,
    ratio: np.ndarray,
    pairs: Sequence[tuple[int, int]],
    both: np.ndarray,
    new: float,
) -> Association:
    """Association probabilities of people who may not exist, with boxes of one and of two.

    Args:
        r: (N,) existence.
        detection: (N,).
        ratio: (N, m) likelihood ratios.
        pairs: K.
        both: (K, m) likelihood ratios of outlines with their probabilities of detection.
        new: share of the boxes of new people.
    """
    N, M = ratio.shape
    odds = r / (1.0 - r * detection)
    weight, members = [], []
    for i in range(N):
        for j in range(M):
            weight.append(odds[i] * detection[i] * ratio[i, j] / (1.0 + new))
            members.append((i, N + j))
    for k, (a, b) in enumerate(pairs):
        for j in range(M):
            weight.append(odds[a] * odds[b] * both[k, j])
            members.append((a, b, N + j))
    x = belief_propagation(np.array(weight), members, N + M)[:, :N]
    p = x / (1.0 + x.sum(axis=0))
    # Who has no box exists with the odds r (1 - P_D) to 1 - r
    none = 1.0 / (1.0 + x.sum(axis=0))
    exists = p.sum(axis=0) + none * r * (1.0 - detection) / (1.0 - r * detection)
    p = p / exists
    beta = np.array([[p[i * M + j, i] for j in range(M)] for i in range(N)]).reshape(N, M)
    joint = np.array([[[p[N * M + k * M + j, i] for j in range(M)] for i in pair] for k, pair in enumerate(pairs)])
    return Association(beta, joint.reshape(len(pairs), 2, M), exists * (1.0 - r * detection) / (none * r))


def kalman(
    m: np.ndarray, P: np.ndarray, H: np.ndarray, off: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean shifted and covariance, by the gain; `off` is the innovation at the mean at which H is taken."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return m + K @ off, P - K @ H @ P


class Hypothesis(NamedTuple):
    """A box of a person: its probability, and the edges that are the person's, each axis with the share that counts."""

    probability: float
    box: np.ndarray
    axes: list[tuple[np.ndarray, float]]


def alone(use: np.ndarray, whole: float, outlier: int, p: float, box: np.ndarray) -> list[Hypothesis]:
    """A box of one person with all edges, and without the edge that may be an outlier."""
    out = []
    for left_out, chance in ((-1, whole), (outlier, 1.0 - whole)):
        edges = [np.array([e for e in (a, a + 2) if use[e] and e != left_out], dtype=int) for a in range(2)]
        out.append(Hypothesis(p * chance, box, [(e, 1.0) for e in edges]))
    return out


def of_two(use: np.ndarray, own: np.ndarray, p: float, box: np.ndarray) -> Hypothesis:
    """An outline of two, with the probabilities that its edges are the person's."""
    axes = []
    for axis in range(2):
        edges = np.array([e for e in (axis, axis + 2) if use[e] and own[e] > 0.5], dtype=int)
        axes.append((edges, float(np.sqrt(np.prod(own[edges])) if len(edges) == 2 else np.prod(own[edges]))))
    return Hypothesis(p, box, axes)


def mixture(m: np.ndarray, P: np.ndarray, me: Seen, hypotheses: Sequence[Hypothesis]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the mixture of a Kalman update by each hypothesis, and of none by the rest (JPDA).

    Args:
        m: mean at which the box is linear.
        P: covariance.
        me: the person in the camera.
        hypotheses: of the frame.
    """
    means, spreads, chances = [m], [P], [1.0 - sum(h.probability for h in hypotheses)]
    for h in hypotheses:
        at, S = m.copy(), P
        for edges, weight in h.axes:
            if weight > 0.0 and len(edges):
                off = h.box - me.box - me.H @ (at - m)
                at, S = kalman(at, S, me.H[edges], off[edges], me.update_noise[np.ix_(edges, edges)] / weight)
        means.append(at)
        spreads.append(S)
        chances.append(h.probability)
    mean = np.einsum("k,ki", chances, means)
    off = np.array(means) - mean
    return mean, np.einsum("k,kij->ij", chances, spreads) + np.einsum("k,ki,kj->ij", chances, off, off)


def quotient(m: np.ndarray, P: np.ndarray, cavity_m: np.ndarray, cavity_P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix and vector by which N(cavity_m, cavity_P) has the mean m, and P where that is narrower."""
    before = np.linalg.inv(cavity_P)
    values, axes = eigh(np.linalg.inv(P) - before, before)
    own = before @ axes
    J = (own * np.maximum(values, 0.0)) @ own.T
    return J, (before + J) @ m - before @ cavity_m


def update(
    mean: np.ndarray,
    covariance: np.ndarray,
    existence: np.ndarray,
    cameras: Sequence[Any],
    detectors: Sequence[Detector],
    frames: Sequence[tuple[int, float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
    new: float,
    gate: float,
    hidden: np.ndarray,
) -> dict[str, np.ndarray]:
    """All people after the frames of a time step, by expectation propagation in two sweeps.

    Args:
        mean: (N, 6).
        covariance: (N, 6, 6).
        existence: (N,).
        cameras: with their detectors.
        detectors: of the cameras.
        frames: camera, delay, boxes (m, 4), observed edges (m, 4), log of the clutter's rate (m,), and log-likelihood
            ratios of features (N, m).
        new: share of the boxes of new people.
        gate: of the squared Mahalanobis distance.
        hidden: (N, cameras) probability that something unknown hides the person.
    """
    N, L = len(mean), len(frames)
    total = sum(len(f[2]) for f in frames)
    first = np.cumsum([0, *(len(f[2]) for f in frames)])
    m, P, odds = mean.copy(), covariance.copy(), np.log(existence / (1.0 - existence))
    J, h, site_odds = np.zeros((L, N, 6, 6)), np.zeros((L, N, 6)), np.zeros((L, N))
    visible, detection = np.full((L, N), np.nan), np.zeros((L, N))
    share, joint = np.zeros((N, total)), np.zeros((N, total))
    free, owner = np.ones(total), np.full(total, -1)
    cuts, wrong, odd, merges = np.zeros(2), np.zeros(2), np.zeros(total), np.zeros((L, 2))
    for sweep in range(2):
        for l, (c, delay, z, use, clutter, features) in enumerate(frames):  # noqa: E741 - a frame
            camera, detector, here = cameras[c], detectors[c], slice(first[l], first[l + 1])
            inverse = [np.linalg.inv(P[i]) for i in range(N)]
            cavity_P = np.array([np.linalg.inv(inverse[i] - J[l, i]) for i in range(N)])
            cavity_m = np.array([cavity_P[i] @ (inverse[i] @ m[i] - h[l, i]) for i in range(N)])
            r = 1.0 / (1.0 + np.exp(-(odds - site_odds[l])))
            seen = [predicted(camera, cavity_m[i], cavity_P[i], delay, detector) for i in range(N)]
            covered = np.zeros(N)
            for i in range(N):
                visible[l, i], detection[l, i] = np.nan, 0.0
                if seen[i] is not None:
                    cells = visible_cells(camera, i, seen, r)
                    visible[l, i], covered[i] = cells.mean(), 1.0 - cells[-1].mean()
                    detection[l, i] = detector.detection * curve_at(detector.curve, visible[l, i])
                    detection[l, i] *= 1.0 - hidden[i, c]
            pairs = who_touch(seen, r)
            for a, b in pairs:
                detection[l, a] *= 1.0 - detector.merge * r[b]
                detection[l, b] *= 1.0 - detector.merge * r[a]
            if not len(z):
                expected = float(r @ detection[l])
                blind = np.log(0.01) / (max(expected, 1.0) * (L if total == 0 else 1))
                missed = np.maximum(np.log(np.maximum(1.0 - detection[l], 1e-6)), blind)
                odds += missed - site_odds[l]
                site_odds[l] = missed
                continue
            ratio, whole, outlier = np.zeros((N, len(z))), np.ones((N, len(z))), np.full((N, len(z)), -1)
            false = [log_clutter(z[j], use[j], camera.image_size) + clutter[j] for j in range(len(z))]
            for i in range(N):
                me = seen[i]
                if me is None or detection[l, i] < 1e-4:
                    continue
                for j in range(len(z)):
                    found = likelihood(z[j], use[j], me, covered[i], detector, false[j] - features[i, j], gate)
                    ratio[i, j], whole[i, j], outlier[i, j] = found
            both, outlines = np.zeros((len(pairs), len(z))), []
            for k, (a, b) in enumerate(pairs):
                one, two = seen[a], seen[b]
                assert one is not None
                assert two is not None
                outlines.append(outline_of_two(one, two))
                plain = detector.detection * curve_at(detector.curve, max(visible[l, a], visible[l, b]))
                for j in range(len(z)):
                    off, S = z[j] - outlines[k].box, outlines[k].S
                    log, distance = log_density(off, use[j], S)
                    if distance < gate and not (use[j] & (off**2 > 2.0 * gate * np.diag(S))).any():
                        both[k, j] = detector.merge * plain * np.exp(log - false[j]) / (1.0 + new)
            found = associate(r, detection[l], ratio, pairs, both, new)
            posterior = r * found.ratio / (1.0 - r + r * found.ratio)
            share[:, here], joint[:, here] = found.beta, 0.0
            for k, pair in enumerate(pairs):
                for s, i in enumerate(pair):
                    joint[i, here] += found.joint[k, s]
            free[here] = np.maximum(1.0 - posterior @ share[:, here] - 0.5 * posterior @ joint[:, here], 0.0)
            at = posterior[:, None] * share[:, here]
            owner[here] = np.where(at.max(axis=0) > 0.0, at.argmax(axis=0), -1)
            odds += np.log(found.ratio) - site_odds[l]
            site_odds[l] = np.log(found.ratio)
            for i in range(N):
                me = seen[i]
                m[i], P[i], J[l, i], h[l, i] = cavity_m[i], cavity_P[i], 0.0, 0.0
                if me is None:
                    continue
                single = [(found.beta[i, j], j) for j in range(len(z))]
                double = [(found.joint[k, s, j], j, outlines[k].own if s == 0 else 1.0 - outlines[k].own)
                          for k, pair in enumerate(pairs) for s in range(2) for j in range(len(z))
                          if pair[s] == i]  # fmt: skip
                hypotheses = [each for p, j in single if p > LEAST
                              for each in alone(use[j], whole[i, j], outlier[i, j], p, z[j])]  # fmt: skip
                hypotheses += [of_two(use[j], own, p, z[j]) for p, j, own in double if p > LEAST]
                if hypotheses:
                    mean_i, P_i = mixture(cavity_m[i], cavity_P[i], me, hypotheses)
                    J[l, i], h[l, i] = quotient(mean_i, P_i, cavity_m[i], cavity_P[i])
                    m[i], P[i] = mean_i, np.linalg.inv(np.linalg.inv(cavity_P[i]) + J[l, i])
                p, j = max(single)
                if sweep == 1 and p > LEAST and p > max([0.0, *(d[0] for d in double)]):
                    w, off = p * p, p * p * (1.0 - whole[i, j])
                    ends = outlier[i, j] == 3 and z[j, 3] < me.box[3]
                    if use[j, 3] and covered[i] > 0.5:
                        cuts += (off * ends, w * covered[i])
                    wrong += (off * r[i] * (not (ends and covered[i] > 0.1)), w * r[i])
                    odd[first[l] + j] += off
            if sweep == 1:
                for k, (a, b) in enumerate(pairs):
                    merged = 0.5 * found.joint[k].sum()
                    apart = max(found.beta[a].sum(), found.beta[b].sum())
                    merges[l] += r[a] * r[b] * np.array([merged, min(merged + apart, 1.0)])
    return {
        "mean": m, "covariance": P, "information": J.sum(axis=0), "vector": h.sum(axis=0),
        "existence": 1.0 / (1.0 + np.exp(-odds)), "visible": visible, "detection": detection, "beta": share,
        "joint": joint, "free": free, "owner": owner, "cuts": cuts, "odd": odd, "wrong": wrong, "merges": merges,
    }  # fmt: skip
