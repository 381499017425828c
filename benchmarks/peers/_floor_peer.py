"""Places on the floor tracked with Stone Soup; runs in an environment of its own.

`python _floor_peer.py GIVEN.npz OUT.npz NAME`: NAME is gnn (global nearest neighbours, Hungarian assignment) or jpda
(joint probabilistic data association by efficient hypothesis management).  GIVEN holds `points` (N, 3) frame, x, y,
`frames`, `fps`, `area` [m^2], and the settings of the model.  OUT holds `rows` (M, 7) frame, identity, x, y and the
covariance xx, xy, yy; the program prints JSON: processor time and version.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.time import UpdateTimeDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.plugins.pyehm import JPDAWithEHM2
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater

Given = Mapping[str, Any]
ORIGIN = datetime.datetime(2000, 1, 1)


def detections(given: Given, model: LinearGaussian) -> Iterator[tuple[datetime.datetime, set[Detection]]]:
    """Time and detections of each frame."""
    points, fps = given["points"], float(given["fps"])
    for k in range(int(given["frames"])):
        when = ORIGIN + datetime.timedelta(seconds=k / fps)
        now = points[points[:, 0] == k, 1:]
        yield when, {Detection(p[:, None], timestamp=when, measurement_model=model) for p in now}


def tracker(given: Given, name: str) -> Any:
    """The tracker; states are x, vx, y, vy."""
    model = LinearGaussian(4, (0, 2), float(given["place_sd"]) ** 2 * np.eye(2))
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(float(given["density"]))] * 2)
    predictor, updater = KalmanPredictor(motion), KalmanUpdater(model)
    distance = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=float(given["gate"]) ** 0.5)
    nearest = GNNWith2DAssignment(distance)
    deleter = UpdateTimeDeleter(datetime.timedelta(seconds=float(given["miss_s"])))
    place, speed = float(given["place_sd"]) ** 2, float(given["speed"]) ** 2
    prior = GaussianState(np.zeros((4, 1)), np.diag([place, speed, place, speed]), timestamp=ORIGIN)
    initiator = MultiMeasurementInitiator(
        prior_state=prior,
        measurement_model=model,
        deleter=deleter,
        data_associator=nearest,
        updater=updater,
        min_points=int(given["hits"]),
    )
    shared = {"initiator": initiator, "deleter": deleter, "detector": detections(given, model), "updater": updater}
    if name == "gnn":
        return MultiTargetTracker(data_associator=nearest, **shared)
    joint = PDAHypothesiser(
        predictor,
        updater,
        clutter_spatial_density=float(given["clutter"]) / float(given["area"]),
        prob_detect=float(given["detection"]),
        prob_gate=0.99,
    )
    return MultiTargetMixtureTracker(data_associator=JPDAWithEHM2(joint), **shared)


def main(given_path: str, out: str, name: str) -> None:
    """Track all frames."""
    given = dict(np.load(given_path))
    fps = float(given["fps"])
    names: dict[str, int] = {}
    rows: list[tuple[float, ...]] = []
    last: dict[int, int] = {}
    begin = time.process_time()
    for when, tracks in tracker(given, name):
        frame = round((when - ORIGIN).total_seconds() * fps)
        for track in tracks:
            state = track.state
            mean, cov = np.asarray(state.mean, dtype=float).ravel(), np.asarray(state.covar, dtype=float)
            label = names.setdefault(track.id, len(names))
            if isinstance(state, Update):
                last[label] = frame
            rows.append((frame, label, mean[0], mean[2], cov[0, 0], cov[0, 2], cov[2, 2]))
    seconds = time.process_time() - begin
    # Predictions after the last detection are no part of a track, as those of the baseline are none
    kept = [row for row in rows if row[0] <= last.get(int(row[1]), -1)]
    np.savez(out, rows=np.array(kept).reshape(-1, 7))
    print(json.dumps({"seconds": seconds, "version": version("stonesoup")}))


if __name__ == "__main__":
    main(*sys.argv[1:])
