"""Adapter for tracking filters of plug-ins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.random import Generator

from occlog.errors import PluginError
from occlog.io.files.timing.utc import time_words
from occlog.plugins.interface import EstimatedPosition, Filter, TargetScan
from occlog.plugins.loading import Plugin, plugin_errors
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan, sensor_names
from occlog.settings import Settings

from .interface import Estimate, Online


class PluggedFilter:
    """A tracking filter of a plug-in for one target, with the names and ground positions of the sensors."""

    def __init__(self, plugin: Plugin, of: type[Filter], scene: Scene, config: Settings, rng: Generator) -> None:
        """Create the plug-in's filter.

        Args:
            plugin: plug-in that the filter is from; errors name it.
            of: class of the filter.
            scene: scene with the sensors, in its own unit.
            config: settings of the filter.
            rng: source of all random numbers of the filter.

        Raises:
            PluginError: the filter cannot be created.
        """
        self._plugin = plugin
        self._names = sensor_names(scene)
        positions = [c.ground for c in scene.cameras] + [a.position[:2] for a in scene.arrays]
        self._positions = np.array(positions, dtype=np.float64).reshape(-1, 2)
        with plugin_errors(plugin):
            self._filter = of(scene, config, rng)

    def step(self, scan: Scan) -> Estimate | None:
        """Process a scan; return the estimate, or None if the filter returns none.

        The plug-in gets sensor names and positions, bearings and standard deviations [rad] of the scan's rows, NaN in
        rows that did not see the target. The estimate's log likelihood is that of the bearings at the estimated
        position.

        Raises:
            PluginError: the filter fails, or returns an invalid position.
        """
        seen, sensor = scan.seen, scan.sensor
        target_scan = TargetScan(
            t_ns=int(scan.t_ns),
            sensors=tuple(self._names[k] for k in sensor.tolist()),
            places=self._positions[sensor],
            bearings=np.where(seen, scan.bearing, np.nan),
            sigma=np.where(seen, scan.sigma, np.nan),
        )
        with plugin_errors(self._plugin):
            position = self._filter.step(target_scan)
        if position is None:
            return None
        wrong = fault_of(position)
        if wrong is not None:
            raise PluginError(f"{self._plugin.label}: at {time_words(scan.t_ns)}: {wrong}")
        xy, velocity = np.asarray(position.xy, dtype=np.float64), position.velocity
        # Score: log-likelihood of the bearings at the estimate
        away = xy - self._positions[sensor[seen]]
        off = (scan.bearing[seen] - np.arctan2(away[:, 1], away[:, 0]) + np.pi) % (2 * np.pi) - np.pi
        sigma = scan.sigma[seen]
        score = -0.5 * (off / sigma) ** 2 - np.log(sigma * math.sqrt(2.0 * math.pi))
        observing, saw = np.unique(sensor), np.unique(sensor[seen])
        return Estimate(
            xy=xy,
            velocity=np.full(2, np.nan) if velocity is None else np.asarray(velocity, dtype=np.float64),
            covariance=np.asarray(position.covariance, dtype=np.float64),
            ess=math.nan,
            log_likelihood=float(score.sum()),
            n_observing=len(observing),
            n_detected=len(saw),
            fallback="",
            used=tuple(observing.tolist()),
            seen_by=tuple(saw.tolist()),
        )


def fault_of(position: object) -> str | None:
    """Return a text about what is invalid in the `position` that a plug-in's filter returned; None if it is valid.

    It must be an `EstimatedPosition` with finite xy (2,), velocity (2,) or None, and a positive definite covariance
    (2, 2).
    """
    if not isinstance(position, EstimatedPosition):
        return f"step gives a {type(position).__name__}; a Place or None was expected"
    shapes = {"xy": (position.xy, (2,)), "covariance": (position.covariance, (2, 2))}
    if position.velocity is not None:
        shapes["velocity"] = (position.velocity, (2,))
    for name, (values, shape) in shapes.items():
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            return f"{name} is not made of numbers"
        if array.shape != shape:
            return f"{name} has the shape {array.shape}; {shape} was expected"
        if not np.isfinite(array).all():
            return f"{name} is not finite"
    covariance = np.asarray(position.covariance, dtype=np.float64)
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=0.0):
        return "the covariance is not symmetric"
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        return "the covariance is not positive definite"
    return None


def method_of(plugin: Plugin) -> Online[PluggedFilter, Any]:
    """Return the tracking method made from a plug-in's filter.

    Raises:
        PluginError: the plug-in cannot be loaded.
    """
    of = plugin.load()

    def init(scene: Scene, config: Any, rng: Generator) -> PluggedFilter:
        return PluggedFilter(plugin, of, scene, config, rng)

    def step(state: PluggedFilter, scan: Scan, rng: Generator) -> tuple[PluggedFilter, Estimate | None]:  # noqa: ARG001
        return state, state.step(scan)

    return Online(config=of.settings, init=init, step=step, started=lambda _: False)
