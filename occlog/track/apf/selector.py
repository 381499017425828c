"""Cameras selected for each filter while it runs ([Ercan] Alg. 3)."""

from __future__ import annotations

import math
from typing import Generic, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS
from occlog.core.occlusion.priors import Priors
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene
from occlog.track.interface import Config, Prediction, State

from .selection_config import SelectConfig
from .selection_policies import Choice, choose, network

FOREVER_NS = 2.0**63
"""No two times are further apart."""


class Selected(NamedTuple):
    """Cameras selected for a target."""

    since_ns: int
    choice: Choice


class TargetFilter(NamedTuple, Generic[State]):
    """The filter of one target."""

    target: int
    state: State
    rng: Generator
    selecting: Generator  # draws of the selection, so that it does not change the filter's
    selected: Selected | None = None
    offered: int = 0  # frames of scans that are in no row yet
    mse: float = math.nan  # metric of a selection that is in no row yet


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
        self._net = network(scene, selection, usable, prediction.detection(config))
        self._cameras = len(scene.cameras)

    def update(self, own: TargetFilter[State], t_ns: int, priors: Priors | None) -> TargetFilter[State]:
        """The filter with the cameras to use at a time, selected anew where that is due."""
        if own.selected is not None and t_ns - own.selected.since_ns < self._every_ns:
            return own
        # Predict: particles at the time of the scan ([Ercan] Sec. 5)
        cloud = self._cloud(own.state, t_ns, own.selecting)
        # Select ([Ercan] Alg. 2, or another policy)
        choice = choose(cloud, priors, self._net, self._selection, own.selecting)
        return own._replace(selected=Selected(t_ns, choice), mse=choice.mse)

    def asked(self, own: TargetFilter[State], scan: Scan) -> Scan | None:
        """What selected cameras and all microphone arrays say; None if that is nothing."""
        if own.selected is None:
            return scan
        keep = np.isin(scan.sensor, own.selected.choice.cameras) | (scan.sensor >= self._cameras)
        return scan.take(keep) if keep.any() else None
