"""Identities of labelled bearings by the continuity of motion, one label at a time, in matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

NONE = (-math.inf, np.zeros(2), 0.0)
"""Time, position and trace of its covariance of a position that there is not."""


class Walk(NamedTuple):
    """Ornstein-Uhlenbeck velocity, and white noise of the position."""

    variance: float
    rate: float
    noise: float


@cache
def moves(dt: float, walk: Walk) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition matrix, and covariances by the noise of the position and of the velocity (Van Loan 1978)."""
    A, out = np.kron([[0.0, 1.0], [0.0, -walk.rate]], np.eye(2)), []
    for density in ([walk.noise, 0.0], [0.0, 2.0 * walk.rate * walk.variance]):
        both = expm(dt * np.block([[-A, np.kron(np.diag(density), np.eye(2))], [np.zeros((4, 4)), A.T]]))
        out.append(both[4:, 4:].T @ both[:4, 4:])
    return both[4:, 4:].T, out[0], out[1]


@dataclass
class Track:
    """A Kalman filter of x, y, vx, vy."""

    m: np.ndarray
    P: np.ndarray

    def predict(self, dt: float, scale: float, walk: Walk) -> None:
        F, of_position, of_velocity = moves(round(dt, 9), walk)
        self.m, self.P = F @ self.m, F @ self.P @ F.T + of_position + scale * of_velocity

    def innovation(self, sensor: np.ndarray, z: float, variance: float) -> tuple[float, float, float, np.ndarray]:
        """Innovation, its variance, that of the measurement, and the gradient; sensor: x, y and variance."""
        d = self.m[:2] - sensor[:2]
        H = np.array([-d[1], d[0], 0.0, 0.0]) / (d @ d)
        noise = variance + sensor[2] / (d @ d)
        off = math.remainder(z - math.atan2(d[1], d[0]), 2.0 * math.pi)
        return off, float(H @ self.P @ H) + noise, noise, H

    def inside(self, sensor: np.ndarray, z: float, variance: float) -> bool:
        off, S, _, _ = self.innovation(sensor, z, variance)
        return bool(off**2 <= 16.0 * S)

    def log_density(self, sensor: np.ndarray, z: float, variance: float) -> float:
        off, S, _, _ = self.innovation(sensor, z, variance)
        return math.log(0.95 * math.exp(-0.5 * off**2 / S) / math.sqrt(2.0 * math.pi * S) + 0.05 / (2.0 * math.pi))

    def update(self, sensor: np.ndarray, z: float, variance: float) -> None:
        off, S, _, H = self.innovation(sensor, z, variance)
        K = self.P @ H / S
        self.m, self.P = self.m + K * off, self.P - np.outer(K, K) * S

    def position(self, now: float) -> tuple[float, np.ndarray, float]:
        return now, self.m[:2].copy(), float(np.trace(self.P[:2, :2]))


@dataclass
class Label:
    """All that is kept of one label."""

    track: Track | None = None
    scale: float = 1.0
    logs: list[float] = field(default_factory=list)
    accepted: int = 0
    agreed: int = 0
    confirmed: int = 0
    last: tuple[float, np.ndarray, float] = NONE
    before: tuple[float, np.ndarray, float] = NONE
    since: float = math.inf
    old: tuple[float, tuple[float, np.ndarray, float], tuple[float, np.ndarray, float]] | None = None
    rival: Track | None = None
    begun: tuple[float, np.ndarray, float] = NONE
    odds: float = 0.0
    count: int = 0
    recent: dict[int, tuple[float, float, float]] = field(default_factory=dict)

    def drop_rival(self) -> None:
        self.rival, self.since = None, math.inf


def meet(
    recent: dict[int, tuple[float, float, float]], since: float, now: float, variance: float, sensors: np.ndarray
) -> Track | None:
    """Filter at the position in which the last bearings meet: weighted least squares of the angles."""
    use = [s for s in sorted(recent) if now - recent[s][0] <= 0.5 and recent[s][0] >= since]
    if len(use) < 2:
        return None
    n = np.array([[-math.sin(recent[s][1]), math.cos(recent[s][1])] for s in use])
    A = n.T @ n
    if not np.linalg.det(A) > 1e-3 * np.trace(A) ** 2:
        return None
    at = Track(np.append(np.linalg.solve(A, n.T @ (n * sensors[use, :2]).sum(axis=1)), [0.0, 0.0]), np.zeros((4, 4)))
    for step in range(4):
        rows = [at.innovation(sensors[s], *recent[s][1:]) for s in use]
        H = np.array([row[3][:2] for row in rows])
        off = np.array([row[0] for row in rows])
        late = np.array([now - recent[s][0] for s in use])
        S = np.array([row[1] for row in rows]) + (H**2).sum(axis=1) * variance * late**2
        A = (H.T / S) @ H
        if not np.linalg.det(A) > 1e-3 * np.trace(A) ** 2:
            return None
        if step < 3:
            at.m[:2] += np.linalg.solve(A, (H.T / S) @ off)
    nearest = np.hypot(*(at.m[:2] - sensors[use, :2]).T).min()
    C = np.linalg.inv(A)
    if (off**2 / S).max() > 9.0 or np.trace(C) > (0.25 * nearest) ** 2:
        return None
    at.P[:2, :2], at.P[2:, 2:] = C, variance * np.eye(2)
    return at


class Continuity:
    """Follows labels, a time step at a time."""

    def __init__(self, labels: int, sensors: np.ndarray, walk: Walk) -> None:
        """Sensors: (S, 3) x, y and variance of the position."""
        S = len(sensors)
        self.labels, self.sensors, self.walk = [Label() for _ in range(labels)], sensors, walk
        self.identity = [list(range(labels)) for _ in range(S)]
        self.odds, self.open = np.zeros((S + 1, labels, labels)), np.full((S + 1, labels, labels), math.inf)
        self.rows: list[tuple[float, int]] = []  # time and sensor
        self.found: list[int] = []
        self.against: list[bool] = []
        self.events: list[list[float]] = []

    def step(self, now: float, rows: list[tuple[int, int, float, float]]) -> None:
        """All bearings of one time: sensor, label, azimuth (NaN: not detected) and variance."""
        for own in self.labels:
            if own.track is None:
                continue
            if now - max(t for t, _, _ in own.recent.values()) > 2.0:
                own.track, own.old, own.agreed = None, None, 0
                own.drop_rival()
                continue
            elapsed = now - self.at
            if elapsed > 0.0:
                own.track.predict(elapsed, own.scale, self.walk)
                if own.rival is not None:
                    own.rival.predict(elapsed, own.scale, self.walk)
        self.at = now
        self.compare(now, rows)
        of = [self.identity[s][label] for s, label, _, _ in rows]
        for (s, _, z, variance), k in zip(rows, of, strict=True):
            self.rows.append((now, s))
            self.found.append(k)
            if not math.isnan(z):
                self.labels[k].recent[s] = (now, z, variance)
        self.take(now, rows, of)

    def compare(self, now: float, rows: list[tuple[int, int, float, float]]) -> None:
        """Collect the evidence of exchanges, and decide."""
        S, K = len(self.sensors), len(self.labels)
        suspect, pending = set(), False
        for s, label, z, variance in rows:
            k = self.identity[s][label]
            track = self.labels[k].track
            if track is not None and not math.isnan(z) and not track.inside(self.sensors[s], z, variance):
                suspect.add(k)
        for a in range(K):
            for b in range(a + 1, K):
                both = [self.labels[a], self.labels[b]]
                fresh = all(own.track is not None and now - own.last[0] <= 2.0 for own in both)
                if not (self.open[:, a, b] < math.inf).any() and not (fresh and suspect & {a, b}):
                    continue
                for s, label, z, variance in rows:
                    k = self.identity[s][label]
                    if k in (a, b) and not math.isnan(z):
                        other = a + b - k
                        one, two = (self.labels[n].track for n in (other, k))
                        args = self.sensors[s], z, variance
                        # Without a prediction there is no evidence, and none is kept
                        gain = one.log_density(*args) - two.log_density(*args) if one and two else 0.0
                        self.odds[[s, S], k, other] += gain
                for s in range(S + 1):
                    if now - self.open[s, a, b] > 1.0 or not fresh or self.odds[s, a, b] + self.odds[s, b, a] <= 0.0:
                        self.odds[s, a, b] = self.odds[s, b, a] = 0.0
                        self.open[s, a, b] = math.inf
                    else:
                        self.open[s, a, b] = min(self.open[s, a, b], now)
                    pending |= bool(self.open[s, a, b] < math.inf)
        if pending:
            for a in range(K):
                for b in range(a + 1, K):
                    for s in [S, *range(S - 1, -1, -1)]:
                        self.exchange(s, a, b)

    def exchange(self, s: int, a: int, b: int) -> None:
        """Exchange two identities in a sensor, or in all (s = S), if the evidence is sufficient."""
        S, since = len(self.sensors), self.open[s, a, b]
        odds = [self.odds[s, a, b], self.odds[s, b, a]]
        back = all(own[a] == b for own in self.identity) if s == S else self.identity[s][a] == b
        least = 12.0 if back else 20.0 if s == S else 30.0
        if since == math.inf or sum(odds) < least or min(odds) < 0.25 * least:
            return
        where = [t for t in range(S) if t == s or (s == S and self.odds[t, a, b] + self.odds[t, b, a] >= 0.0)]
        turned = {a: b, b: a}
        for t in where:
            self.identity[t] = [turned.get(k, k) for k in self.identity[t]]
        for r, (t_s, sensor) in enumerate(self.rows):
            if t_s >= since and sensor in where:
                self.found[r] = turned.get(self.found[r], self.found[r])
        for own in (self.labels[a], self.labels[b]):
            own.drop_rival()
        done = range(S + 1) if s == S else [s, S]
        for t in done:
            self.odds[t, a, b] = self.odds[t, b, a] = 0.0
            self.open[t, a, b] = math.inf
        self.events.append([0.0, since, 0.0, a, b, s, 0.0])

    def take(self, now: float, rows: list[tuple[int, int, float, float]], of: list[int]) -> None:
        """Update the filters and their rivals."""
        inside = []
        for (s, _, z, variance), k in zip(rows, of, strict=True):
            track = self.labels[k].track
            judged = track is not None and not math.isnan(z)
            inside.append(track.inside(self.sensors[s], z, variance) if judged else None)  # type: ignore[union-attr]
        yes = [
            sum(k == n and each is True for k, each in zip(of, inside, strict=True)) for n in range(len(self.labels))
        ]
        no = [
            sum(k == n and each is False for k, each in zip(of, inside, strict=True)) for n in range(len(self.labels))
        ]
        for own, accepted, rejected in zip(self.labels, yes, no, strict=True):
            if rejected and own.since == math.inf:
                own.since = now
                if min(own.agreed, own.confirmed) >= 5:
                    own.old = own.scale, own.last, own.before
            elif accepted and not rejected and own.rival is None:
                own.since = math.inf
            own.agreed = 0 if rejected else own.agreed + accepted
            if accepted and not rejected:
                own.confirmed += accepted - 1
                own.before = own.last
        for k, each in zip(of, inside, strict=True):
            own = self.labels[k]
            sure = own.track is not None and own.accepted >= 5 and yes[k] >= 1 and no[k] <= max(1.0, 0.5 * yes[k])
            self.against.append(sure and each is False)
        for (s, _, z, variance), k in zip(rows, of, strict=True):
            own, args = self.labels[k], (self.sensors[s], z, variance)
            if own.rival is not None and not math.isnan(z):
                assert own.track is not None
                own.odds += own.rival.log_density(*args) - own.track.log_density(*args)
                if own.rival.inside(*args):
                    own.count += 1
                    own.rival.update(*args)
        for (s, _, z, variance), k, each in zip(rows, of, inside, strict=True):
            own, args = self.labels[k], (self.sensors[s], z, variance)
            if not each or no[k] > max(1.0, yes[k]):
                continue
            assert own.track is not None
            off, S, noise, _ = own.track.innovation(*args)
            own.scale *= math.exp(0.05 * (1.0 - noise / S) * (min(off**2 / S, 9.0) - 1.0))
            own.scale = min(max(own.scale, 1.0), 30.0)
            own.logs.append(math.log(own.scale))
            own.track.update(*args)
            own.last = own.track.position(now)
            own.accepted += 1
        for k, own in enumerate(self.labels):
            variance = self.walk.variance * own.scale
            if own.track is None:
                own.track = meet(own.recent, -math.inf, now, variance, self.sensors)
                if own.track is not None:
                    own.accepted, own.confirmed = 0, 0
                    own.last = own.before = own.track.position(now)
            elif own.rival is not None:
                self.replace(k, now)
            elif own.since < math.inf:
                own.rival = meet(own.recent, own.since, now, variance, self.sensors)
                if own.rival is not None:
                    own.begun, own.odds, own.count = own.rival.position(now), 0.0, 0

    def replace(self, k: int, now: float) -> None:
        """Replace a filter by its rival, or drop the rival."""
        own = self.labels[k]
        assert own.rival is not None
        opened = (self.open[:, k] < math.inf).any() or (self.open[:, :, k] < math.inf).any()
        if own.odds >= 6.0 and own.count >= 5 and not opened:
            if own.old is not None:
                t, at, trace = own.begun
                speed = min(
                    (np.hypot(*(at - xy)) - 2.0 * math.sqrt(trace + spread)) / max(t - t_s, 1e-9)
                    for t_s, xy, spread in own.old[1:]
                )
                away = np.hypot(*(at - own.old[1][1]))
                self.events.append([1.0, own.since, speed, k, own.old[0], now, away])
            own.track = own.rival
            own.last = own.before = own.track.position(now)
            own.accepted, own.agreed, own.confirmed, own.old = own.count, 0, 0, None
            own.drop_rival()
        elif own.odds <= -6.0 or now - own.begun[0] > 2.0:
            own.drop_rival()
