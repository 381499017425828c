"""What a user would write in an evening: feet to the floor, fused over cameras, Hungarian assignment, Kalman filters.

Neither motion nor occlusion is looked at in the images; gaps of tracks are filled by straight lines.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.track._crowd_cases import Case
from occlog.array_types import Floats

CUT_PX = 5.0
"""A box that ends so near to the lower border of the image has no feet."""
FOOT_PX, FLOOR_SD = 8.0, 0.1
"""Standard deviation of a foot [px], and of a place on the floor beside [m]."""
GATE = 9.21
"""99 % of a chi-squared variable with two degrees of freedom."""
REACH = 1.2
"""Feet further apart are not of one person [m]."""
VIEWS = 2
"""Cameras that must agree on a place."""
MARGIN = 0.3
"""Feet so far outside of the ground still count [m]."""
DENSITY, PLACE_SD, SPEED = 0.5**2, 0.15, 1.5**0.5
"""White acceleration [m^2/s^3], standard deviation of a fused place [m], of a new person's velocity [m/s]."""
MISS_S, HITS = 2.0, 3
"""A track ends so long after its last place; one with fewer places is dropped."""


class Place(NamedTuple):
    """A place on the floor."""

    xy: Floats
    covariance: Floats
    views: int


def feet(case: Case, camera: int, boxes: Floats) -> list[Place]:
    """Places of one camera's boxes (n, 4) of a frame that have their feet in the image."""
    matrix = case.matrices[camera]
    floor = matrix[:, [0, 1, 3]]
    x0, x1, y0, y1 = case.area
    out = []
    for left, _, right, bottom in boxes:
        if bottom >= case.size[1] - CUT_PX:
            continue
        p = np.linalg.solve(floor, [0.5 * (left + right), bottom, 1.0])
        xy = p[:2] / p[2]
        if x0 - MARGIN < xy[0] < x1 + MARGIN and y0 - MARGIN < xy[1] < y1 + MARGIN:
            u = floor @ [*xy, 1.0]
            slope = (floor[:2, :2] - np.outer(u[:2] / u[2], floor[2, :2])) / u[2]
            inverse = np.linalg.inv(slope)
            out.append(Place(xy, FOOT_PX**2 * inverse @ inverse.T + FLOOR_SD**2 * np.eye(2), 1))
    return out


def fused(case: Case) -> Floats:
    """(N, 3) frame and place on the floor, where cameras agree; one box of a camera at most for a place."""
    x0, x1, y0, y1 = case.area
    rows = []
    for frame in range(case.frames):
        now = case.boxes[case.boxes[:, 0] == frame]
        places: list[Place] = []
        counts = np.bincount(now[:, 1].astype(np.int64), minlength=len(case.matrices))
        for camera in np.argsort(-counts, kind="stable").tolist():
            places = _joined(places, feet(case, camera, now[now[:, 1] == camera, 2:]))
        rows += [(frame, *p.xy) for p in places if p.views >= VIEWS and x0 <= p.xy[0] <= x1 and y0 <= p.xy[1] <= y1]
    return np.array(rows).reshape(-1, 3)


def _joined(places: list[Place], points: list[Place]) -> list[Place]:
    """Places with the points of one more camera, each point of one place at most, or a place of its own."""
    if not places or not points:
        return places + points
    cost = np.full((len(places), len(points)), 1e6)
    for i, a in enumerate(places):
        for j, b in enumerate(points):
            d = b.xy - a.xy
            if d @ d < REACH**2 and (m := d @ np.linalg.solve(a.covariance + b.covariance, d)) < GATE:
                cost[i, j] = m
    out, used = list(places), set()
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if cost[i, j] < 1e5:
            a, b = places[i], points[j]
            wa, wb = np.linalg.inv(a.covariance), np.linalg.inv(b.covariance)
            covariance = np.linalg.inv(wa + wb)
            out[i] = Place(covariance @ (wa @ a.xy + wb @ b.xy), covariance, a.views + 1)
            used.add(j)
    return out + [p for j, p in enumerate(points) if j not in used]


def motion(dt: float) -> tuple[Floats, Floats]:
    """Transition and process noise of constant velocity, state x, y, vx, vy."""
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    return step, DENSITY * np.kron(np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), np.eye(2))


def followed(points: Floats, case: Case) -> Floats:
    """(N, 7) frame, identity, x, y and covariance xx, xy, yy; NaN where a gap was filled."""
    step, noise = motion(1.0 / case.fps)
    seen, fix = np.eye(2, 4), PLACE_SD**2 * np.eye(2)
    live: list[tuple[int, Floats, Floats, list[tuple[float, ...]]]] = []
    done, names = [], 0
    for frame in range(case.frames):
        z = points[points[:, 0] == frame, 1:]
        live = [(n, step @ x, step @ P @ step.T + noise, rows) for n, x, P, rows in live]
        cost = np.full((len(live), len(z)), 1e6)
        for i, (_, x, P, _) in enumerate(live):
            S = seen @ P @ seen.T + fix
            d = z - x[:2]
            m = np.einsum("ij,jk,ik->i", d, np.linalg.inv(S), d)
            cost[i] = np.where(m < GATE, m + np.log(np.linalg.det(S)), 1e6)
        used = set()
        for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost.size else ():
            if cost[i, j] < 1e5:
                n, x, P, rows = live[i]
                gain = P @ seen.T @ np.linalg.inv(seen @ P @ seen.T + fix)
                x, P = x + gain @ (z[j] - x[:2]), P - gain @ seen @ P
                rows.append((frame, n, *x[:2], P[0, 0], P[0, 1], P[1, 1]))
                live[i] = (n, x, P, rows)
                used.add(j)
        ended = [t for t in live if frame - t[3][-1][0] > MISS_S * case.fps]
        done += ended
        live = [t for t in live if frame - t[3][-1][0] <= MISS_S * case.fps]
        for j in sorted(set(range(len(z))) - used):
            P = np.diag([PLACE_SD**2, PLACE_SD**2, SPEED**2, SPEED**2])
            live.append((names, np.r_[z[j], 0.0, 0.0], P, [(frame, names, *z[j], P[0, 0], 0.0, P[1, 1])]))
            names += 1
    tracks = [rows for *_, rows in done + live if len(rows) >= HITS]
    return np.array([row for rows in tracks for row in filled(rows)]).reshape(-1, 7)


def filled(rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Rows of a track with straight lines over its gaps."""
    out = [rows[0]]
    for a, b in pairwise(rows):
        for k in range(int(a[0]) + 1, int(b[0])):
            w = (k - a[0]) / (b[0] - a[0])
            out.append((k, a[1], a[2] * (1 - w) + b[2] * w, a[3] * (1 - w) + b[3] * w, np.nan, np.nan, np.nan))
        out.append(b)
    return out
