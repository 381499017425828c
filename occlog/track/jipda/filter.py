"""The filter of everybody at once: predict, associate in all images jointly, update, begin and end people.

Joint integrated probabilistic data association (Musicki and Evans 2004) with the marginals of belief propagation
(Williams and Lau 2014), in the images of all cameras.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.records.scene import Camera, Scene
from occlog.records.seen_ground import box_around, sight_limit
from occlog.settings import METRES

from .config import JipdaConfig
from .interface import Event, Look, Moment, Support
from .kernels.body_box import Views, pack_views
from .kernels.joint import Boxes, Rates, Result, update
from .kernels.newborn import newborn

MODE = 0
CURVE = np.array([0.02, 0.1, 0.4, 0.8, 0.95, 1.0])
BORDER_PX = 3.0
GATE = 30.0


@dataclass(frozen=True)
class People:
    mean: Floats
    covariance: Floats
    existence: Floats
    key: Ints
    id: Ints  # -1: not confirmed


@dataclass(frozen=True)
class Counts:
    detected: Floats  # (C, 2)
    clutter: Floats  # (C, 2)
    curve: Floats  # (K, 2)
    bias: Floats  # (C, 4)
    bias_variance: Floats  # (C, 4)
    noise: Floats  # (4, 2, 2) normal equations
    noise_right: Floats  # (4, 2)
    cuts: Floats  # (2,)


@dataclass(frozen=True)
class State:
    views: Views
    config: JipdaConfig
    t_ns: int | None
    people: People
    counts: Counts
    next_id: int


def begin(scene: Scene, cameras: Sequence[Camera], config: JipdaConfig) -> State:
    views = pack_views(cameras)
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    low, high = box_around(scene)
    least = 2.0 * float(np.hypot(*(high - low)))
    views = views._replace(range=np.array([sight_limit(c, least, metre) for c in cameras]))
    C = len(cameras)
    none = People(np.zeros((0, 6)), np.zeros((0, 6, 6)), np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    n = 10.0
    normal, right = noise_prior(config)
    counts = Counts(
        detected=np.tile([n * config.detection, n], (C, 1)),
        clutter=np.tile([n * config.clutter, n], (C, 1)),
        curve=np.column_stack([20.0 * CURVE, np.full(len(CURVE), 20.0)]),
        bias=np.zeros((C, 4)),
        bias_variance=np.tile(np.array([0.02, 0.1, 0.02, 0.05]) ** 2, (C, 1)),
        noise=normal,
        noise_right=right,
        cuts=np.array([2.0, 4.0]),
    )
    return State(views, config, None, none, counts, 0)


def predict(people: People, dt: float, config: JipdaConfig) -> People:
    F = np.eye(6)
    F[0, 2] = F[1, 3] = dt
    Q = np.zeros((6, 6))
    q = config.acceleration
    for a in range(2):
        Q[a, a], Q[a, a + 2], Q[a + 2, a], Q[a + 2, a + 2] = q * dt**3 / 3, q * dt**2 / 2, q * dt**2 / 2, q * dt
    Q[4, 4] = (0.01 * config.height) ** 2 * dt
    Q[5, 5] = (0.01 * config.width) ** 2 * dt
    return replace(
        people,
        mean=people.mean @ F.T,
        covariance=F @ people.covariance @ F.T + Q,
        existence=np.clip(people.existence * math.exp(-dt / config.stay_s), 1e-6, 1 - 1e-6),
    )


def pack(state: State, looks: Sequence[Look], t_ns: int) -> Boxes:
    boxes = np.concatenate([l.boxes for l in looks]).reshape(-1, 4)
    camera = np.array([l.camera for l in looks])
    n = [len(l.boxes) for l in looks]
    w, h = state.views.size[np.repeat(camera, n)].T
    border = np.column_stack([0 * w, 0 * h, w - 1, h - 1])
    clutter = state.counts.clutter[:, 0] / state.counts.clutter[:, 1]
    return Boxes(
        camera=camera,
        delay=np.array([(l.t_ns - t_ns) / NS for l in looks]),
        first=np.concatenate([[0], np.cumsum(n)]).astype(np.int64),
        box=np.ascontiguousarray(boxes, dtype=np.float64),
        believed=np.abs(boxes - border) > BORDER_PX,
        clutter=np.log(np.repeat(clutter[camera], n)),
    )


def rates_of(state: State) -> Rates:
    k, c = state.counts, state.config
    noise = noise_of(state)
    curve = np.minimum(np.maximum.accumulate(k.curve[:, 0] / k.curve[:, 1]), 1.0)
    if not c.visible:
        curve = np.ones_like(curve)
    return Rates(
        detection=np.clip(k.detected[:, 0] / k.detected[:, 1], 0.05, 0.98),
        curve=curve / curve[-1],
        cut=float(k.cuts[0] / k.cuts[1]),
        bias=k.bias,
        noise=noise,
    )


def step(state: State, looks: Sequence[Look]) -> tuple[State, Moment]:
    config = state.config
    t_ns = max(l.t_ns for l in looks)
    dt = (t_ns - state.t_ns) / NS if state.t_ns is not None else 0.0
    people = predict(state.people, dt, config) if len(state.people.key) else state.people
    boxes, rates = pack(state, looks, t_ns), rates_of(state)
    density = 0.1 * (min(dt / 20.0, 1.0) if state.t_ns is not None else 1.0)
    N, M = len(people.key), len(boxes.box)
    result = update(people.mean, people.covariance, people.existence, state.views, boxes, rates, np.zeros((N, M)), 0.1, GATE, MODE)
    people = replace(people, mean=result.mean, covariance=result.covariance, existence=result.existence)
    counts = learn(state.counts, people, boxes, rates, result)
    # births
    body = np.array([config.height, config.sigma_height, config.width, config.sigma_width, config.speed])
    spread = np.sqrt(0.5 * (people.covariance[:, 0, 0] + people.covariance[:, 1, 1]))
    mean, covariance, odds, used = newborn(state.views, boxes, rates, body, density, people.mean, spread, people.existence, result.free, GATE, math.log(0.05))
    r = 1 / (1 + np.exp(-odds))
    K = len(r)
    # clutter: what neither tracked nor new people explain
    left = result.free * np.prod(1 - r[:, None] * used, axis=0) if K else result.free
    clutter = counts.clutter.copy()
    for l, c in enumerate(boxes.camera):
        clutter[c] += (left[boxes.first[l] : boxes.first[l + 1]].sum(), 1.0)
    counts = replace(counts, clutter=clutter)
    keys = state.next_id + np.arange(K)
    share = np.concatenate([result.share, used])
    people = People(
        np.concatenate([people.mean, mean]), np.concatenate([people.covariance, covariance]), np.concatenate([people.existence, r]),
        np.concatenate([people.key, keys]), np.concatenate([people.id, np.full(K, -1)]),
    )  # fmt: skip
    events: list[Event] = []
    confirmed = (people.id < 0) & (people.existence > config.confirm)
    ids = np.where(confirmed, people.key, people.id)
    keep = (people.existence > config.die) & ~duplicates(people)
    keep &= ~((ids >= 0) & (people.existence < 0.3))
    rows = np.flatnonzero(keep)
    people = People(people.mean[rows], people.covariance[rows], people.existence[rows], people.key[rows], ids[rows])
    shown = np.flatnonzero((people.id >= 0) & (people.existence > 0.5))
    none = np.zeros(0, dtype=np.int64)
    moment = Moment(
        t_ns, people.id[shown], people.mean[shown], people.covariance[shown], people.existence[shown],
        np.zeros((len(shown), len(state.views.size))), Support(none, none, none, np.zeros(0)), tuple(events),
    )  # fmt: skip
    return State(state.views, config, t_ns, people, counts, state.next_id + K), moment


def duplicates(people: People) -> np.ndarray:
    n = len(people.key)
    out = np.zeros(n, dtype=bool)
    if n < 2:
        return out
    d = np.hypot(*(people.mean[:, None, :2] - people.mean[None, :, :2]).transpose(2, 0, 1))
    near = np.argwhere(np.triu(d < 0.5 * people.mean[:, None, 5], 1))
    for a, b in near:
        ra, rb = people.existence[a] + (people.id[a] >= 0), people.existence[b] + (people.id[b] >= 0)
        out[b if ra >= rb else a] = True
    return out


def learn(counts: Counts, people: People, boxes: Boxes, rates: Rates, result: Result) -> Counts:
    detected, curve = counts.detected.copy(), counts.curve.copy()
    sure = people.existence > 0.9
    K = len(curve)
    for l, c in enumerate(boxes.camera):
        v = result.visible[l]
        hit = result.share[:, boxes.first[l] : boxes.first[l + 1]].sum(axis=1)
        plain = sure & (v > 0.85)
        detected[c] += (hit[plain].sum(), plain.sum())
        seen = np.flatnonzero(sure & (v > 0))
        at = v[seen] * (K - 1)
        k = np.minimum(at.astype(int), K - 2)
        w = at - k
        base = rates.detection[c]
        np.add.at(curve[:, 0], k, (1 - w) * hit[seen])
        np.add.at(curve[:, 0], k + 1, w * hit[seen])
        np.add.at(curve[:, 1], k, (1 - w) * base)
        np.add.at(curve[:, 1], k + 1, w * base)
    normal, right = counts.noise.copy(), counts.noise_right.copy()
    bias, variance = counts.bias.copy(), counts.bias_variance.copy()
    for l, c in enumerate(boxes.camera):
        for j in range(boxes.first[l], boxes.first[l + 1]):
            i = result.owner[j]
            if i < 0 or not sure[i] or result.share[i, j] < 0.7 or result.visible[l, i] < 0.8 or not boxes.believed[j].all():
                continue
            w, h = result.size[j]
            size = np.array([h, w, h, h])
            e, s = result.residual[j], result.spread[j]
            S = s + rates.noise[:, 0] + rates.noise[:, 1] * size**2
            y = np.minimum(e**2, 12 * S) - s
            weight = 1 / S**2
            x = np.array([np.ones(4), size**2])
            normal += np.einsum("ak,bk,k->kab", x, x, weight)
            right += (x * y * weight).T
            gain = variance[c] / (variance[c] + S / size**2)
            bias[c] += gain * e / size
            variance[c] *= 1 - gain
    return replace(counts, detected=detected, curve=curve, noise=normal, noise_right=right, bias=bias, bias_variance=variance, cuts=counts.cuts + result.cuts)


def noise_prior(config: JipdaConfig):
    """Prior of constant and share squared."""
    a = np.array([0.5, 2.0, 0.5, 2.0]) * config.edge_px**2
    b = np.array([1.0, 4.0, 0.25, 1.0]) * config.looseness**2
    sizes = np.array([30.0, 60.0, 120.0, 240.0, 480.0])
    x = np.array([np.ones(5), sizes**2])
    normal, right = np.zeros((4, 2, 2)), np.zeros((4, 2))
    for k in range(4):
        y = a[k] + b[k] * sizes**2
        weight = PRIOR_BOXES / y**2
        normal[k] = np.einsum("an,bn,n->ab", x, x, weight)
        right[k] = (x * y * weight).sum(axis=1)
    return normal, right


PRIOR_BOXES = 5.0


def noise_of(state: State):
    """Least squares, not negative."""
    out = np.zeros((4, 2))
    for k in range(4):
        A, r = state.counts.noise[k], state.counts.noise_right[k]
        x = np.linalg.solve(A, r)
        if x[0] < 0.25:
            x = np.array([0.25, (r[1] - A[0, 1] * 0.25) / A[1, 1]])
        if x[1] < 1e-5:
            x = np.array([max((r[0] - A[0, 1] * 1e-5) / A[0, 0], 0.25), 1e-5])
        out[k] = x
    return out
