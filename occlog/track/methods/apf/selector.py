"""Cameras selected for each filter while it runs ([Ercan] Alg. 3).

Which cameras to ask for measurements: [Ercan] Sec. 5 and the heuristics of Sec. 6.2.

greedy        adds, one after the other, the camera that lowers the expected error most (Alg. 2)
brute-force   the best of all subsets
fixed         the first ones of a given order
random        any, redrawn at each selection
closest       those nearest to where the target is thought to be
all           all of them
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Generic, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats
from occlog.core.geometry.visibility import Sensors
from occlog.core.occlusion.occlusion_probability import IMPROVED
from occlog.core.occlusion.priors import Priors, no_priors
from occlog.errors import UsageError, abridged, option
from occlog.filtering.likelihood.directions import PoseNoise
from occlog.filtering.particles import mean_and_covariance
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Config, Estimate, ParticleSet, State, TargetPredictor

from .config import BY_ERROR, SelectConfig
from .kernels.selection_metric import (
    CameraMoments,
    joint_visibility,
    mean_square_errors,
    perspective_moments,
    views,
    weak_moments,
)
from .model import pack_noise, pack_sensors, read_noise

MAX_SUBSETS = 50_000
"""`brute-force` is refused where there are more subsets."""
MAX_PARTICLES = 1000
"""Maximum number of particles in expectations; larger sets are downsampled."""


class CameraChoice(NamedTuple):
    """The N cameras that may be selected, and what is needed to predict what they see.

    `cameras` are their rows in `sensors`, `noise` and `read_px`, which are of all S sensors of the scene; `order` has
    the same rows in the order of use of the policy `fixed`.
    """

    cameras: tuple[int, ...]  # rows of the sensors
    order: tuple[int, ...]  # the same in the order of use for `fixed`
    sensors: Sensors
    noise: PoseNoise
    read_px: Floats
    hit: Floats  # (N,) probability that a camera detects a target in plain view
    hiding: int  # form of the probability that a moving occluder hides the target


class Choice(NamedTuple):
    """Selected cameras (rows of the sensors, increasing) and the expected mean square error [length^2] with them."""

    cameras: tuple[int, ...]  # rows of the sensors, ascending
    mse: float


def network(
    scene: Scene, config: SelectConfig, usable: frozenset[str], detection: float | None, hiding: int = IMPROVED
) -> CameraChoice:
    """Return the cameras to choose from, with arrays of all sensors.

    Args:
        scene: scene with the cameras.
        config: settings of the selection.
        usable: names of the cameras that may be used; those without a pose are omitted.
        detection: probability that a camera detects a target in plain view, where the scene does not state it; None: 1.
        hiding: form of the probability that a moving occluder hides the target, of
            `occlog.core.occlusion.occlusion_probability`.

    Raises:
        UsageError: more cameras are to be selected than there are, an order that does not fit, or too many subsets.
    """
    names = [c.name for c in scene.cameras]
    cameras = tuple(i for i, c in enumerate(scene.cameras) if c.name in usable and c.placed)
    if config.policy != "all" and config.n_cameras > len(cameras):
        raise UsageError(
            f"select: {config.n_cameras} cameras are to be selected, and {len(cameras)} with a pose are in use; give "
            f"{option('n_cameras')} {len(cameras)} or less",
            id="too-few-sensors",
        )
    order = cameras
    if config.camera_order:
        unknown = [n for n in config.camera_order if n not in names]
        if unknown:
            raise UsageError(
                f"{option('camera_order')}: no camera {unknown[0]!r} in the scene; it has: {abridged(names)}",
                id="unknown-sensor",
            )
        order = tuple(names.index(n) for n in config.camera_order if names.index(n) in cameras)
        if config.policy == "fixed" and len(set(order)) < config.n_cameras:
            raise UsageError(
                f"select: {option('camera_order')} names {len(set(order))} usable cameras, and {config.n_cameras} are "
                f"to be selected ({option('n_cameras')}); name more",
                id="too-few-sensors",
            )
    if config.policy == "brute-force" and math.comb(len(cameras), config.n_cameras) > MAX_SUBSETS:
        raise UsageError(
            f"select: brute-force of {config.n_cameras} out of {len(cameras)} cameras would try "
            f"{math.comb(len(cameras), config.n_cameras)} subsets, limit {MAX_SUBSETS}; use greedy",
            id="problem-too-large",
        )
    own = [scene.cameras[i].detection for i in cameras]
    hit = np.array([p if p is not None else 1.0 if detection is None else detection for p in own], dtype=np.float64)
    return CameraChoice(
        cameras, tuple(dict.fromkeys(order)), pack_sensors(scene), pack_noise(scene), read_noise(scene), hit, hiding
    )


def choose(
    cloud: ParticleSet, priors: Priors | None, net: CameraChoice, config: SelectConfig, rng: Generator
) -> Choice:
    """Return the cameras to use until the next selection, with the expected mean square error of the set.

    Args:
        cloud: weighted positions at which the target may be; downsampled if there are many.
        priors: position priors of the moving occluders; None: none are considered.
        net: cameras that may be selected.
        config: settings of the selection.
        rng: random numbers of the policy `random`.
    """
    cloud = _thin(cloud)
    moments = _moments(cloud, no_priors() if priors is None else priors, net, config.model)
    k = len(net.cameras) if config.policy == "all" else config.n_cameras
    rows = _rows(k, cloud, moments, net, config.policy, rng)
    mse = mean_square_errors(moments, np.array([rows], dtype=np.int64))[0]
    return Choice(tuple(sorted(net.cameras[n] for n in rows)), float(mse))


def _rows(
    k: int, cloud: ParticleSet, moments: CameraMoments, net: CameraChoice, policy: str, rng: Generator
) -> list[int]:
    """Return the indices into `net.cameras` of the `k` cameras that a policy selects.

    Args:
        k: number of cameras.
        cloud: weighted positions of the target, for `closest`.
        moments: covariances of position and measurements, for `greedy` and `brute-force`.
        net: cameras that may be selected.
        policy: one of `POLICIES`; `all` ignores k.
        rng: random numbers of `random`.
    """
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


def greedy(moments: CameraMoments, k: int) -> list[int]:
    """Return the indices of k cameras (or all N), each chosen as the one that lowers the expected error most, Alg. 2.

    Of cameras that are equally good, the one that most probably sees the target is chosen.
    """
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


def _moments(cloud: ParticleSet, priors: Priors, net: CameraChoice, model: str) -> CameraMoments:
    """Return the covariances of position and measurements of the selectable cameras, for a weighted set of positions.

    `model` is the camera model, `weak` or `perspective`.
    """
    xy, weights = cloud
    inside = views(xy, net.cameras, net.sensors)
    together = joint_visibility(xy, weights, net.cameras, net.sensors, inside, priors, net.hit, net.hiding)
    if model == "weak":
        return weak_moments(xy, weights, net.cameras, net.sensors, net.noise, net.read_px, together)
    return perspective_moments(xy, weights, net.cameras, net.sensors, net.noise, net.read_px, inside, together)


def _thin(cloud: ParticleSet) -> ParticleSet:
    """Return a particle set with at most `MAX_PARTICLES` particles: every n-th one, with weights of sum 1."""
    every = -(-len(cloud.weights) // MAX_PARTICLES)
    if every == 1:
        return cloud
    weights = cloud.weights[::every]
    return ParticleSet(np.ascontiguousarray(cloud.xy[::every]), weights / weights.sum())


PRIOR_VISIBILITY = 0.8
"""Initial probability that a camera with the target in its field of view has it in plain view."""
MAX_DETECTION_PROBABILITY = 0.9
"""Limit of the detection probability of a missed detection."""
RESTART_FALLBACKS = ("restart", "gap")
"""Values of `fallback` of estimates of a filter that has restarted."""
MIN_CAMERAS_TO_LOCALISE = 2
"""Cameras that see a target determine its position."""
FOREVER_NS = 2.0**63
"""A gap longer than any difference of two times [ns]."""


class Selected(NamedTuple):
    """Cameras selected for a target, and the time of the scan [ns] at which they were selected."""

    since_ns: int
    choice: Choice


class ObservedVisibility(NamedTuple):
    """What the cameras saw of a target in the last scans, from which the visibility of the next scan is predicted.

    `clear` (C,) is the probability that nothing moving hides the target from each of the scene's C cameras.
    """

    clear: Floats  # (C,) probability that each camera of the scene has the target in plain view, if in its view
    t_ns: int
    unseen: int  # scans in a row in which too few of the selected cameras saw the target
    found: bool  # enough cameras have seen it at once since the filter began


class TargetFilter(NamedTuple, Generic[State]):
    """One target's filter with its random numbers, and the cameras selected for it."""

    target: int
    state: State
    rng: Generator
    selecting: Generator  # draws of the selection, so that it does not change the filter's
    selected: Selected | None = None
    offered: int = 0  # frames of scans that are in no row yet
    mse: float = math.nan  # metric of a selection that is in no row yet
    in_view: ObservedVisibility | None = None  # None: nothing was observed yet


class Selector(Generic[State, Config]):
    """Selects cameras for each target, at intervals of some reference steps ([Ercan] Alg. 3)."""

    def __init__(
        self,
        prediction: TargetPredictor[State, Config],
        config: Config,
        scene: Scene,
        selection: SelectConfig,
        usable: frozenset[str],
    ) -> None:
        """Pack the scene; UsageError for a selection that does not fit it.

        Args:
            prediction: the method's prediction of a target.
            config: settings of the method.
            scene: the cameras.
            selection: settings of the selection.
            usable: names of the cameras that may be used.
        """
        self._cloud = prediction.cloud
        self._selection = selection
        self._every_ns = round(min(selection.selection_interval * prediction.step_s(config) * NS, FOREVER_NS))
        hiding = IMPROVED if prediction.hiding is None else prediction.hiding(config)
        self._net = network(scene, selection, usable, prediction.detection(config), hiding)
        self._cameras = len(scene.cameras)
        # Heuristics and baselines select without regard to what was seen
        self._patience = selection.max_blind_scans if selection.policy in BY_ERROR else 0
        self._memory_s = selection.selection_interval * prediction.step_s(config)

    def update(self, own: TargetFilter[State], t_ns: int, priors: Priors | None) -> TargetFilter[State]:
        """Return the filter with the cameras to use for the scan at `t_ns`, reselected where that is due.

        Cameras are reselected at the interval, and after several scans in which too few selected cameras saw the
        target. Until two cameras have seen the target at once its position is unknown, and all cameras are used, except
        with occluder priors or `max_blind_scans` of 0.

        Args:
            own: the target's filter; its generator `selecting` is drawn from.
            t_ns: time of the scan [ns].
            priors: position priors of the moving occluders; None: unknown.
        """
        patience = self._patience
        if patience and priors is None and (own.in_view is None or not own.in_view.found):
            return own._replace(selected=None)
        lost_sight = 0 < patience <= (0 if own.in_view is None else own.in_view.unseen)
        if own.selected is not None and t_ns - own.selected.since_ns < self._every_ns and not lost_sight:
            return own
        # Predict: particles at the time of the scan ([Ercan] Sec. 5)
        cloud = self._cloud(own.state, t_ns, own.selecting)
        # Select ([Ercan] Alg. 2, or another policy)
        net = self._net
        if own.in_view is not None:
            clear = self._relaxed(own.in_view, t_ns)[list(net.cameras)]
            net = net._replace(hit=net.hit * np.minimum(clear / PRIOR_VISIBILITY, 1.0))
        choice = choose(cloud, priors, net, self._selection, own.selecting)
        return own._replace(selected=Selected(t_ns, choice), mse=choice.mse)

    def learned(self, own: TargetFilter[State], scan: Scan, estimate: Estimate) -> TargetFilter[State]:
        """Return the filter with updated probabilities that its cameras have the target in plain view, after a scan.

        A camera without a detection less probably has a free view, by Bayes' rule. The probability returns to
        `PRIOR_VISIBILITY` within the time between selections. With priors of the moving occluders, or `max_blind_scans`
        of 0, nothing is learned.

        Args:
            own: the target's filter.
            scan: the scan.
            estimate: estimate of the filter after the scan, with the sensors used and those that detected the target.
        """
        if not self._patience or scan.occluders is not None or estimate.seen_by is None:
            return own
        before = own.in_view or ObservedVisibility(
            np.full(self._cameras, PRIOR_VISIBILITY), scan.t_ns, unseen=0, found=False
        )
        clear = self._relaxed(before, scan.t_ns)
        for camera, hit in zip(self._net.cameras, self._net.hit.tolist(), strict=True):
            if camera in estimate.seen_by:
                clear[camera] = 1.0
            elif camera in estimate.used:
                miss = clear[camera] * (1.0 - min(hit, MAX_DETECTION_PROBABILITY))
                clear[camera] = miss / (miss + 1.0 - clear[camera])
        seen = len(set(estimate.seen_by))
        chosen = seen if own.selected is None else len(own.selected.choice.cameras)
        unseen = before.unseen + 1 if seen < min(MIN_CAMERAS_TO_LOCALISE, chosen) else 0
        found = seen >= min(MIN_CAMERAS_TO_LOCALISE, len(self._net.cameras)) or (
            before.found and estimate.fallback not in RESTART_FALLBACKS
        )
        return own._replace(in_view=ObservedVisibility(clear, scan.t_ns, unseen, found))

    def _relaxed(self, in_view: ObservedVisibility, t_ns: int) -> Floats:
        """Return (C,) probabilities that each camera has the target in plain view at time `t_ns` [ns].

        They return to `PRIOR_VISIBILITY` exponentially, with the time between selections as time constant.
        """
        left = math.exp(-(t_ns - in_view.t_ns) / NS / self._memory_s)
        return np.asarray(PRIOR_VISIBILITY + (in_view.clear - PRIOR_VISIBILITY) * left)

    def asked(self, own: TargetFilter[State], scan: Scan) -> Scan | None:
        """Return the rows of a scan that the filter is to use: those of its selected cameras and of microphone arrays.

        None if there are none; without a selection the whole scan.
        """
        if own.selected is None:
            return scan
        keep = np.isin(scan.sensor, own.selected.choice.cameras) | (scan.sensor >= self._cameras)
        return scan.take(keep) if keep.any() else None
