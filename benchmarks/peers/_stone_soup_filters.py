"""Bootstrap particle filters of Stone Soup; runs in an environment of its own.

`python _stone_soup_filters.py KIND GIVEN.npz` prints JSON: processor time of a step, and the tracking error.

bearings    unlabelled bearings of one target among others.  As in [Lee] Fig. 3-1 the predicted particles are updated
            with every bearing, and drawn anew from all copies by their weights.
directions  azimuths and elevations of one target in space; the direction of each array is an update of its own.

Each has one motion model, constant velocity.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing, CartesianToElevationBearing
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

Given = Mapping[str, Any]
Step = Callable[[ParticleState, int, datetime.datetime], tuple[ParticleState, Any]]
"""State, number of the step and its time to the next state and the estimated place."""


def motion(given: Given, dimensions: int) -> CombinedLinearGaussianTransitionModel:
    """Constant velocity on every axis."""
    return CombinedLinearGaussianTransitionModel([ConstantVelocity(float(given["density"]))] * dimensions)


def bearings_step(given: Given) -> Step:
    """Filter of unlabelled bearings; states are x, vx, y, vy."""
    model = Cartesian2DToBearing(
        ndim_state=4,
        mapping=(0, 2),
        noise_covar=np.array([[float(given["sigma"]) ** 2]]),
        translation_offset=StateVector([[0.0], [0.0]]),
    )
    predictor, updater, resampler = ParticlePredictor(motion(given, 2)), ParticleUpdater(None), SystematicResampler()
    n = int(given["particles"])

    def step(state: ParticleState, k: int, when: datetime.datetime) -> tuple[ParticleState, Any]:
        # Predict
        predicted = predictor.predict(state, timestamp=when)
        # Weigh: an update has weights of sum 1; the bearing's share is that of its likelihood
        copies, fits = [], []
        for angle in given["angle"][k]:
            seen = Detection(StateVector([[angle]]), timestamp=when, measurement_model=model)
            copies.append(updater.update(SingleHypothesis(predicted, seen)))
            fits.append(np.logaddexp.reduce(model.logpdf(seen, predicted).astype(float)))
        vectors = np.hstack([np.asarray(c.state_vector, dtype=float) for c in copies])
        weights = np.concatenate([c.log_weight.astype(float) + f for c, f in zip(copies, fits, strict=True)])
        weights -= np.logaddexp.reduce(weights)
        mean = np.average(vectors, axis=1, weights=np.exp(weights))
        # Resample
        both = ParticleState(StateVectors(vectors), log_weight=weights, timestamp=when)
        return resampler.resample(both, n), mean[[0, 2]]

    return step


def directions_step(given: Given) -> Step:
    """Filter of azimuths and elevations; states are x, vx, y, vy, z, vz."""
    models = [
        CartesianToElevationBearing(
            ndim_state=6,
            mapping=(0, 2, 4),
            noise_covar=np.diag([float(given["sigma"]) ** 2] * 2),
            translation_offset=StateVector(place[:, None]),
        )
        for place in given["places"]
    ]
    predictor, updater = ParticlePredictor(motion(given, 3)), ParticleUpdater(None, SystematicResampler())

    def step(state: ParticleState, k: int, when: datetime.datetime) -> tuple[ParticleState, Any]:
        for model, theta, phi in zip(models, given["theta"][k], given["phi"][k], strict=True):
            seen = Detection(StateVector([[0.5 * np.pi - phi], [theta]]), timestamp=when, measurement_model=model)
            # Predict, weigh and resample
            predicted = predictor.predict(state, timestamp=when)
            state = updater.update(SingleHypothesis(predicted, seen))
        vectors, weights = np.asarray(state.state_vector, dtype=float), np.exp(state.log_weight.astype(float))
        return state, np.average(vectors, axis=1, weights=weights)[[0, 2, 4]]

    return step


FILTERS: dict[str, tuple[Callable[[Given], Step], list[int]]] = {
    "bearings": (bearings_step, [0, 1, 2, 3]),
    "directions": (directions_step, [0, 3, 1, 4, 2, 5]),
}
"""Filters, and the order of their states' components in `start`."""


def main(kind: str, path: str) -> None:
    """Run a filter over all steps."""
    given = dict(np.load(path))
    make, order = FILTERS[kind]
    n = int(given["particles"])
    np.random.seed(0)  # noqa: NPY002
    first = datetime.datetime(2020, 1, 1)
    step = make(given)
    cloud = given["start"][:, None] + given["spread"][:, None] * np.random.standard_normal((len(order), n))  # noqa: NPY002
    state = ParticleState(StateVectors(cloud[order]), weight=np.full(n, 1.0 / n), timestamp=first)
    times, errors = [], []
    for k, place in enumerate(given["truth"]):
        when = first + datetime.timedelta(seconds=float(given["step_s"]) * k)
        begin = time.process_time()
        state, mean = step(state, k, when)
        times.append(1e6 * (time.process_time() - begin))
        errors.append(mean - place)
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    print(json.dumps({"step us": float(np.mean(times)), "rmse": rmse, "version": version("stonesoup")}))


if __name__ == "__main__":
    main(*sys.argv[1:])
