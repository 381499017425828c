"""An unscented Kalman filter of Stone Soup as a tracking method of occlog."""

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import UnscentedKalmanPredictor
from stonesoup.types.array import StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import UnscentedKalmanUpdater

from occlog.plugins.interface import EstimatedPosition, Scene, Settings, TargetScan, setting

EPOCH = datetime(1970, 1, 1)
POSITION, VELOCITY = (0, 2), (1, 3)
LONGEST_NS = 60 * 10**9
"""After so long without a moment the target begins anew."""


@dataclass(frozen=True)
class StoneSoupSettings(Settings):
    """Settings of the filter."""

    OWNER = "stone-soup"
    q: float = setting(0.5, "Noise of the velocity.", unit="length^2/s^3", above=0.0)


class StoneSoupFilter:
    """State x, vx, y, vy; the target begins where sight lines of two sensors meet."""

    summary = "unscented Kalman filter of Stone Soup"
    settings = StoneSoupSettings

    def __init__(self, scene: Scene, settings: StoneSoupSettings, rng: np.random.Generator) -> None:
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(settings.q), ConstantVelocity(settings.q)])
        self.predictor = UnscentedKalmanPredictor(motion)
        self.updater = UnscentedKalmanUpdater(None)
        self.state: GaussianState | None = None
        self.start_ns = self.last_ns = 0

    def step(self, moment: TargetScan) -> EstimatedPosition | None:
        saw = np.isfinite(moment.bearings)
        places, bearings, sigma = moment.places[saw], moment.bearings[saw], moment.sigma[saw]
        if moment.t_ns - self.last_ns > LONGEST_NS:
            self.state = None  # an unscented filter does not bridge hours
        if self.state is None and not self._begin(moment.t_ns, places, bearings, sigma):
            return None
        self.last_ns = moment.t_ns
        # datetime counts microseconds: times are counted from the first moment
        now = EPOCH + timedelta(microseconds=max(moment.t_ns - self.start_ns, 0) / 1e3)
        if now > self.state.timestamp:
            self.state = self.predictor.predict(self.state, timestamp=now)
        for place, bearing, s in zip(places, bearings, sigma, strict=True):
            sensor = Cartesian2DToBearing(
                ndim_state=4, mapping=POSITION, noise_covar=np.array([[s**2]]), translation_offset=place[:, None]
            )
            looked = Detection(StateVector([bearing]), timestamp=self.state.timestamp, measurement_model=sensor)
            self.state = self.updater.update(SingleHypothesis(self.state, looked))
        # Stone Soup's states hold all those before them
        mean, covariance = (
            np.array(self.state.state_vector, dtype=float).ravel(),
            np.array(self.state.covar, dtype=float),
        )
        self.state = GaussianState(mean.copy(), covariance.copy(), timestamp=self.state.timestamp)
        spread = covariance[np.ix_(POSITION, POSITION)]
        return EstimatedPosition(mean[list(POSITION)], 0.5 * (spread + spread.T), mean[list(VELOCITY)])

    def _begin(self, t_ns: int, places: np.ndarray, bearings: np.ndarray, sigma: np.ndarray) -> bool:
        if len(np.unique(places, axis=0)) < 2:
            return False
        lines = np.column_stack([-np.sin(bearings), np.cos(bearings)])
        meet, *_ = np.linalg.lstsq(lines, (lines * places).sum(axis=1), rcond=None)
        away = np.hypot(*(meet - places).T)
        crossing = np.linalg.inv((lines / (away * sigma)[:, None] ** 2).T @ lines)
        spread = np.eye(4)
        spread[np.ix_(POSITION, POSITION)] = crossing
        self.state = GaussianState([meet[0], 0.0, meet[1], 0.0], spread, timestamp=EPOCH)
        self.start_ns = t_ns
        return True
