"""Cameras selected for each filter while it runs ([Ercan] Alg. 3)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS
from occlog.core.occlusion.priors import Priors
from occlog.errors import UsageError
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene
from occlog.track.interface import Online

from .selection_policies import Choice, SelectConfig, choose, network

FOREVER_NS = 2.0**63
"""No two times are further apart."""


class Selected(NamedTuple):
    """Cameras selected for a target."""

    since_ns: int
    choice: Choice


class Filter(NamedTuple):
    """The filter of one target."""

    state: Any
    rng: Generator
    selecting: Generator  # draws of the selection, so that it does not change the filter's
    selected: Selected | None = None
    offered: int = 0  # frames of scans that are in no row yet
    mse: float = math.nan  # metric of a selection that is in no row yet


class Selector:
    """Selects cameras for each target, every few reference steps ([Ercan] Alg. 3)."""

    def __init__(self, method: Online, scene: Scene, selection: SelectConfig, usable: frozenset[str], config: Any):
        """UsageError for a method that cannot say where a target will be, or for a selection that does not fit."""
        if method.predict is None:
            raise UsageError("select: the method cannot predict where the target will be; leave --select out")
        self._predict = method.predict
        self._selection = selection
        self._every_ns = round(min(selection.every * getattr(config, "reference_s", 1.0) * NS, FOREVER_NS))
        self._net = network(scene, selection, usable, getattr(config, "detection", None))
        self._cameras = len(scene.cameras)

    def update(self, own: Filter, t_ns: int, priors: Priors | None) -> Filter:
        """The filter with the cameras to use at a time, selected anew where that is due."""
        if own.selected is not None and t_ns - own.selected.since_ns < self._every_ns:
            return own
        cloud = self._predict(own.state, t_ns, own.selecting)
        choice = choose(cloud, priors, self._net, self._selection, own.selecting)
        return own._replace(selected=Selected(t_ns, choice), mse=choice.mse)

    def asked(self, own: Filter, scan: Scan) -> Scan | None:
        """What selected cameras and all microphone arrays say; None if that is nothing."""
        if own.selected is None:
            return scan
        keep = np.isin(scan.sensor, own.selected.choice.cameras) | (scan.sensor >= self._cameras)
        return scan.take(keep) if keep.any() else None
