"""A particle filter of Stone Soup on the unlabelled bearings of one target; run in an environment of its own.

`python _imm_peer.py GIVEN.npz`: prints JSON with the processor time of a step and the tracking error.  As in [Lee]
Fig. 3-1 the predicted particles are updated with every bearing, and drawn anew from all copies by their weights.
There is one motion model, constant velocity.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
from importlib.metadata import version

import numpy as np
from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater


def main(path: str) -> None:
    """Run the filter over all steps."""
    given = np.load(path)
    n = int(given["particles"])
    np.random.seed(0)  # noqa: NPY002
    first = datetime.datetime(2020, 1, 1)
    model = Cartesian2DToBearing(
        ndim_state=4,
        mapping=(0, 2),
        noise_covar=np.array([[float(given["sigma"]) ** 2]]),
        translation_offset=StateVector([[0.0], [0.0]]),
    )
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(float(given["density"]))] * 2)
    predictor, updater, resampler = ParticlePredictor(motion), ParticleUpdater(None), SystematicResampler()
    cloud = given["start"][:, None] + given["spread"][:, None] * np.random.standard_normal((4, n))  # noqa: NPY002
    state = ParticleState(StateVectors(cloud), weight=np.full(n, 1.0 / n), timestamp=first)
    times, errors = [], []
    for k, angles in enumerate(given["angle"]):
        when = first + datetime.timedelta(seconds=float(given["step_s"]) * k)
        begin = time.process_time()
        predicted = predictor.predict(state, timestamp=when)
        copies, fits = [], []
        for angle in angles:
            seen = Detection(StateVector([[angle]]), timestamp=when, measurement_model=model)
            update = updater.update(SingleHypothesis(predicted, seen))
            # An update has weights of sum 1; the bearing's share is that of its likelihood.
            fits.append(np.logaddexp.reduce(model.logpdf(seen, predicted).astype(float)))
            copies.append(update)
        vectors = np.hstack([np.asarray(c.state_vector, dtype=float) for c in copies])
        weights = np.concatenate([c.log_weight.astype(float) + f for c, f in zip(copies, fits, strict=True)])
        weights -= np.logaddexp.reduce(weights)
        mean = np.average(vectors, axis=1, weights=np.exp(weights))
        both = ParticleState(StateVectors(vectors), log_weight=weights, timestamp=when)
        state = resampler.resample(both, n)
        times.append(1e6 * (time.process_time() - begin))
        errors.append(mean[[0, 2]] - given["truth"][k])
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    print(json.dumps({"step us": float(np.mean(times)), "rmse": rmse, "version": version("stonesoup")}))


if __name__ == "__main__":
    main(sys.argv[1])
