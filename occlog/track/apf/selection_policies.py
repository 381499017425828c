"""Which cameras to ask for measurements: [Ercan] Sec. 5 and the heuristics of Sec. 6.2.

greedy        adds, one after the other, the camera that lowers the expected error most (Alg. 2)
brute-force   the best of all subsets
fixed         the first ones of a given order
random        any, anew at each selection
closest       those nearest to where the target is thought to be
all           all of them
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.occlusion.hidden import IMPROVED
from occlog.core.occlusion.priors import Priors, no_priors
from occlog.core.sight.visibility import Sensors
from occlog.errors import UsageError
from occlog.filtering.likelihood.directions import Noise
from occlog.filtering.particles import mean_and_covariance
from occlog.records.scene import Scene
from occlog.track.apf.kernels.selection_metric import (
    Moments,
    mean_square_errors,
    perspective_moments,
    seen_together,
    views,
    weak_moments,
)
from occlog.track.interface import Cloud

from .selection_config import SelectConfig
from .sensing import pack_noise, pack_sensors, read_noise

MOST_SUBSETS = 50_000
"""`brute-force` is refused where there are more subsets."""
CLOUD = 1000
"""More particles than this are thinned out before the expectations are taken."""


class Network(NamedTuple):
    """The cameras to choose from."""

    cameras: tuple[int, ...]  # rows of the sensors
    order: tuple[int, ...]  # the same in the order of use for `fixed`
    sensors: Sensors
    noise: Noise
    read_px: Floats
    hit: Floats  # (N,) probability that a camera detects a target in plain view
    hiding: int  # form of the probability that a moving occluder hides the target


class Choice(NamedTuple):
    """Cameras that were selected and the metric of the set."""

    cameras: tuple[int, ...]  # rows of the sensors, rising
    mse: float


def network(
    scene: Scene, config: SelectConfig, usable: frozenset[str], detection: float | None, hiding: int = IMPROVED
) -> Network:
    """What there is to choose from; UsageError for more cameras than there are, or an order that does not fit.

    Args:
        scene: the cameras.
        config: how to select.
        usable: names of the cameras that may be used.
        detection: probability that a camera detects a target in plain view, where the scene does not say.
        hiding: form of the probability that a moving occluder hides the target, of `occlog.core.occlusion.hidden`.
    """
    names = [c.name for c in scene.cameras]
    cameras = tuple(i for i, c in enumerate(scene.cameras) if c.name in usable and c.placed)
    if config.policy != "all" and config.count > len(cameras):
        raise UsageError(f"select: {config.count} cameras of {len(cameras)}; select fewer")
    order = cameras
    if config.order:
        unknown = [n for n in config.order if n not in names]
        if unknown:
            raise UsageError(f"select: order: no camera {unknown[0]!r} in the scene; it has: {', '.join(names)}")
        order = tuple(names.index(n) for n in config.order if names.index(n) in cameras)
        if config.policy == "fixed" and len(set(order)) < config.count:
            raise UsageError(f"select: order has {len(set(order))} usable cameras, want {config.count}")
    if config.policy == "brute-force" and math.comb(len(cameras), config.count) > MOST_SUBSETS:
        raise UsageError(
            f"select: brute-force of {config.count} out of {len(cameras)} cameras would try "
            f"{math.comb(len(cameras), config.count)} subsets, limit {MOST_SUBSETS}; use greedy"
        )
    own = [scene.cameras[i].detection for i in cameras]
    hit = np.array([p if p is not None else 1.0 if detection is None else detection for p in own], dtype=np.float64)
    return Network(
        cameras, tuple(dict.fromkeys(order)), pack_sensors(scene), pack_noise(scene), read_noise(scene), hit, hiding
    )


def choose(cloud: Cloud, priors: Priors | None, net: Network, config: SelectConfig, rng: Generator) -> Choice:
    """The cameras to use until the next selection.

    Args:
        cloud: where the target is thought to be.
        priors: of the moving occluders; None: they are left out of account.
        net: the cameras.
        config: how to select.
        rng: for `random`.
    """
    cloud = _thin(cloud)
    moments = _moments(cloud, no_priors() if priors is None else priors, net, config.model)
    k = len(net.cameras) if config.policy == "all" else config.count
    rows = _rows(k, cloud, moments, net, config.policy, rng)
    mse = mean_square_errors(moments, np.array([rows], dtype=np.int64))[0]
    return Choice(tuple(sorted(net.cameras[n] for n in rows)), float(mse))


def _rows(k: int, cloud: Cloud, moments: Moments, net: Network, policy: str, rng: Generator) -> list[int]:
    """Places in `net.cameras` of the k cameras that a policy selects."""
    N = len(net.cameras)
    if policy == "greedy":
        return greedy(moments, k)
    if policy == "brute-force":
        subsets = np.array(list(combinations(range(N), k)), dtype=np.int64)
        best: list[int] = subsets[int(np.argmin(mean_square_errors(moments, subsets)))].tolist()
        return best
    if policy == "random":
        return sorted(rng.permutation(N)[:k].tolist())
    if policy == "closest":
        mean, _ = mean_and_covariance(cloud.weights, cloud.xy)
        away = np.hypot(*(net.sensors.xy[list(net.cameras)] - mean).T)
        nearest: list[int] = np.argsort(away, kind="stable")[:k].tolist()
        return nearest
    if policy == "fixed":
        return [net.cameras.index(i) for i in net.order[:k]]
    return list(range(N))


def greedy(moments: Moments, k: int) -> list[int]:
    """Alg. 2: k times the camera that, added to those selected, gives the least error."""
    chosen: list[int] = []
    N = len(moments.seen)
    for _ in range(min(k, N)):
        rest = [n for n in range(N) if n not in chosen]
        errors = mean_square_errors(moments, np.array([[*chosen, n] for n in rest], dtype=np.int64))
        least = float(errors.min())
        # Of cameras that all add nothing, the one that most likely sees the target
        ties = [n for n, e in zip(rest, errors.tolist(), strict=True) if e <= least * (1.0 + 1e-12)]
        chosen.append(max(ties, key=lambda n: (moments.seen[n], -n)))
    return chosen


def _moments(cloud: Cloud, priors: Priors, net: Network, model: str) -> Moments:
    xy, weights = cloud
    inside = views(xy, net.cameras, net.sensors)
    together = seen_together(xy, weights, net.cameras, net.sensors, inside, priors, net.hit, net.hiding)
    if model == "weak":
        return weak_moments(xy, weights, net.cameras, net.sensors, net.noise, net.read_px, together)
    return perspective_moments(xy, weights, net.cameras, net.sensors, net.noise, net.read_px, inside, together)


def _thin(cloud: Cloud) -> Cloud:
    """Every n-th particle of a large cloud."""
    every = -(-len(cloud.weights) // CLOUD)
    if every == 1:
        return cloud
    weights = cloud.weights[::every]
    return Cloud(np.ascontiguousarray(cloud.xy[::every]), weights / weights.sum())
