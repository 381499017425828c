"""A filter of one's own as a tracking method of occlog: `occlog track bearings.parquet --method own ...`."""

from dataclasses import dataclass

import numpy as np

from occlog.plugins.interface import EstimatedPosition, Scene, Settings, TargetScan, setting


@dataclass(frozen=True)
class OwnSettings(Settings):
    """Settings of the filter."""

    OWNER = "own"
    sigma_a: float = setting(2.0, "White acceleration of the target.", unit="length/s^2", above=0.0, option="--sigma-a")


class OwnFilter:
    """An extended Kalman filter of bearings that begins where sight lines of two sensors meet."""

    summary = "extended Kalman filter in thirty lines"
    settings = OwnSettings

    def __init__(self, scene: Scene, settings: OwnSettings, rng: np.random.Generator) -> None:
        self.settings_, self.t_ns = settings, None

    def step(self, moment: TargetScan) -> EstimatedPosition | None:
        saw = np.isfinite(moment.bearings)
        places, bearings, sigma = moment.places[saw], moment.bearings[saw], moment.sigma[saw]
        if self.t_ns is None:
            if len(np.unique(places, axis=0)) < 2:
                return None
            lines = np.column_stack([-np.sin(bearings), np.cos(bearings)])
            meet, *_ = np.linalg.lstsq(lines, (lines * places).sum(axis=1), rcond=None)
            away = np.hypot(*(meet - places).T)
            crossing = np.linalg.inv((lines / (away * sigma)[:, None] ** 2).T @ lines)
            self.x, self.P = (
                np.array([*meet, 0, 0]),
                np.block([[crossing, np.zeros((2, 2))], [np.zeros((2, 2)), np.eye(2)]]),
            )
            self.t_ns = moment.t_ns
        dt, self.t_ns = max(moment.t_ns - self.t_ns, 0) * 1e-9, moment.t_ns
        F, G = np.eye(4) + dt * np.eye(4, k=2), np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
        self.x, self.P = F @ self.x, F @ self.P @ F.T + self.settings_.sigma_a**2 * G @ G.T
        for place, bearing, s in zip(places, bearings, sigma, strict=True):
            dx, dy = self.x[:2] - place
            H = np.array([-dy, dx, 0, 0]) / (dx**2 + dy**2)
            gain = self.P @ H / (H @ self.P @ H + s**2)
            self.x = self.x + gain * ((bearing - np.arctan2(dy, dx) + np.pi) % (2 * np.pi) - np.pi)
            self.P = (np.eye(4) - np.outer(gain, H)) @ self.P
            self.P = 0.5 * (self.P + self.P.T)
        return EstimatedPosition(self.x[:2].copy(), self.P[:2, :2].copy(), self.x[2:].copy())
