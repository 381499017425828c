"""Cameras selected for each filter while it runs ([Ercan] Alg. 3)."""

from __future__ import annotations

import math
from typing import Generic, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats
from occlog.core.occlusion.hidden import IMPROVED
from occlog.core.occlusion.priors import Priors
from occlog.records.scene import Scene
from occlog.scans.scan import Scan
from occlog.track.interface import Config, Estimate, Prediction, State

from .selection_config import BY_ERROR, SelectConfig
from .selection_policies import Choice, choose, network

CLEAR = 0.8
"""Probability that a camera whose view holds the target has it in plain view, of which nothing is known yet."""
MOST_SURE = 0.9
"""Probabilities of detection above this count as this when a camera looks in vain."""
NEW = ("restart", "gap")
"""Values of `fallback` of estimates of a filter that has begun anew."""
ENOUGH = 2
"""Cameras that see a target tell where it is."""
FOREVER_NS = 2.0**63
"""No two times are further apart."""


class Selected(NamedTuple):
    """Cameras selected for a target."""

    since_ns: int
    choice: Choice


class InView(NamedTuple):
    """What a target's cameras saw of it lately, beyond what the scene says of views."""

    clear: Floats  # (C,) probability that each camera of the scene has the target in plain view, if the scene says so
    t_ns: int
    unseen: int  # scans in a row in which too few of the selected cameras saw the target
    found: bool  # enough cameras have seen it at once since the filter began


class TargetFilter(NamedTuple, Generic[State]):
    """The filter of one target."""

    target: int
    state: State
    rng: Generator
    selecting: Generator  # draws of the selection, so that it does not change the filter's
    selected: Selected | None = None
    offered: int = 0  # frames of scans that are in no row yet
    mse: float = math.nan  # metric of a selection that is in no row yet
    in_view: InView | None = None  # None: nothing was looked at yet


class Selector(Generic[State, Config]):
    """Selects cameras for each target, every few reference steps ([Ercan] Alg. 3)."""

    def __init__(
        self,
        prediction: Prediction[State, Config],
        config: Config,
        scene: Scene,
        selection: SelectConfig,
        usable: frozenset[str],
    ) -> None:
        """Pack the scene; UsageError for a selection that does not fit it.

        Args:
            prediction: how the method says where a target will be.
            config: settings of the method.
            scene: the cameras.
            selection: how to select.
            usable: names of the cameras that may be used.
        """
        self._cloud = prediction.cloud
        self._selection = selection
        self._every_ns = round(min(selection.every * prediction.step_s(config) * NS, FOREVER_NS))
        hiding = IMPROVED if prediction.hiding is None else prediction.hiding(config)
        self._net = network(scene, selection, usable, prediction.detection(config), hiding)
        self._cameras = len(scene.cameras)
        # Heuristics and baselines select without regard to what was seen
        self._patience = selection.patience if selection.policy in BY_ERROR else 0
        self._memory_s = selection.every * prediction.step_s(config)

    def update(self, own: TargetFilter[State], t_ns: int, priors: Priors | None) -> TargetFilter[State]:
        """The filter with the cameras to use at a time, selected anew where that is due.

        Until two cameras have seen the target at once nobody knows where it is, and all of them are asked: cameras that
        are selected for a cloud all over the place would leave it there.  With priors of the moving occluders, or
        without patience, [Ercan] Alg. 3 selects from the first scan on.
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
            net = net._replace(hit=net.hit * np.minimum(clear / CLEAR, 1.0))
        choice = choose(cloud, priors, net, self._selection, own.selecting)
        return own._replace(selected=Selected(t_ns, choice), mse=choice.mse)

    def learned(self, own: TargetFilter[State], scan: Scan, estimate: Estimate) -> TargetFilter[State]:
        """The filter with what its cameras saw in a scan.

        A camera that looked in vain less probably has the target in plain view, by Bayes' rule: somebody or something
        hides it there.  The probability goes back to `CLEAR` within the time between selections.  With priors of the
        moving occluders these say who hides the target, and nothing is learned.
        """
        if not self._patience or scan.occluders is not None or estimate.seen_by is None:
            return own
        before = own.in_view or InView(np.full(self._cameras, CLEAR), scan.t_ns, unseen=0, found=False)
        clear = self._relaxed(before, scan.t_ns)
        for camera, hit in zip(self._net.cameras, self._net.hit.tolist(), strict=True):
            if camera in estimate.seen_by:
                clear[camera] = 1.0
            elif camera in estimate.used:
                miss = clear[camera] * (1.0 - min(hit, MOST_SURE))
                clear[camera] = miss / (miss + 1.0 - clear[camera])
        seen = len(set(estimate.seen_by))
        chosen = seen if own.selected is None else len(own.selected.choice.cameras)
        unseen = before.unseen + 1 if seen < min(ENOUGH, chosen) else 0
        found = seen >= min(ENOUGH, len(self._net.cameras)) or (before.found and estimate.fallback not in NEW)
        return own._replace(in_view=InView(clear, scan.t_ns, unseen, found))

    def _relaxed(self, in_view: InView, t_ns: int) -> Floats:
        """(C,) probabilities of plain views at a later time."""
        left = math.exp(-(t_ns - in_view.t_ns) / NS / self._memory_s)
        return np.asarray(CLEAR + (in_view.clear - CLEAR) * left)

    def asked(self, own: TargetFilter[State], scan: Scan) -> Scan | None:
        """What selected cameras and all microphone arrays say; None if that is nothing."""
        if own.selected is None:
            return scan
        keep = np.isin(scan.sensor, own.selected.choice.cameras) | (scan.sensor >= self._cameras)
        return scan.take(keep) if keep.any() else None
