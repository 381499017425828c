"""A bootstrap particle filter of Stone Soup on azimuths and elevations; run in an environment of its own.

`python _space_peer.py GIVEN.npz`: prints JSON with the processor time of a step and the tracking error.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
from importlib.metadata import version

import numpy as np
from stonesoup.models.measurement.nonlinear import CartesianToElevationBearing
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

ORDER = [0, 3, 1, 4, 2, 5]


def main(path: str) -> None:
    """Run the filter over all steps; every array's direction is an update of its own."""
    given = np.load(path)
    theta, phi, n = given["theta"], given["phi"], int(given["particles"])
    np.random.seed(0)  # noqa: NPY002
    first = datetime.datetime(2020, 1, 1)
    models = [
        CartesianToElevationBearing(
            ndim_state=6,
            mapping=(0, 2, 4),
            noise_covar=np.diag([float(given["sigma"]) ** 2] * 2),
            translation_offset=StateVector(place[:, None]),
        )
        for place in given["places"]
    ]
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(float(given["density"]))] * 3)
    predictor, updater = ParticlePredictor(motion), ParticleUpdater(None, SystematicResampler())
    cloud = given["start"][:, None] + given["spread"][:, None] * np.random.standard_normal((6, n))  # noqa: NPY002
    state = ParticleState(StateVectors(cloud[ORDER]), weight=np.full(n, 1.0 / n), timestamp=first)
    times, errors = [], []
    for k in range(len(theta)):
        when = first + datetime.timedelta(seconds=float(given["step_s"]) * k)
        begin = time.process_time()
        for model, t, p in zip(models, theta[k], phi[k], strict=True):
            seen = Detection(StateVector([[0.5 * np.pi - p], [t]]), timestamp=when, measurement_model=model)
            predicted = predictor.predict(state, timestamp=when)
            state = updater.update(SingleHypothesis(predicted, seen))
        mean = np.average(
            np.asarray(state.state_vector, dtype=float), axis=1, weights=np.exp(state.log_weight.astype(float))
        )
        times.append(1e6 * (time.process_time() - begin))
        errors.append(mean[[0, 2, 4]] - given["truth"][k, :3])
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    print(json.dumps({"step us": float(np.mean(times)), "rmse": rmse, "version": version("stonesoup")}))


if __name__ == "__main__":
    main(sys.argv[1])
