"""Errors of the approximations of [Ercan] Eqs. 7-9: the tables of docs/explanation/occlusion.md.

`python -m benchmarks.core.occlusion_error` prints them.  q: each form of Eq. 7 against
quadrature, over random priors of one shape around random sight lines.  p(eta | u):
recursion and `independent` against the exact one, over random rooms full of people.
Everything is drawn from fixed seeds, each row from its own, so that rows can be
recomputed one by one.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.visibility import Sensors, seen_from
from occlog.core.occlusion.priors import Priors, gaussian_priors
from occlog.core.plane import make_floor, sample_floor
from occlog.io.formats.scenes.scene import read_scene
from occlog.papers.ercan.formulas.blocking import (
    IMPROVED,
    PRINTED,
    QUADRATURE,
    blocking,
    independent,
    patterns,
    seen_by_recursion,
    seen_exactly,
)
from occlog.records.scene import Scene
from occlog.track.methods.apf.model import pack_sensors

ROOT = Path(__file__).resolve().parents[2]
ORDER = (1, 7, 5, 3, 2, 4, 6, 8)
"""Order in which cameras of the reference scene are used."""
DRAWS = 3000
"""Priors of a row of the first table."""
ROOMS, PLACES = 10, 12
"""Rooms of a row of the second table, and places in each."""
FLOOR = 1e-4
"""Least p(eta | u), as the tracker has it."""


class Shape(NamedTuple):
    """A row of the first table."""

    sigma: float
    alpha: float
    diameter: float
    near: float  # distances of places from the camera
    far: float


class Crowd(NamedTuple):
    """A row of the second table."""

    cameras: int
    occluders: int
    sigma: float
    alpha: float
    diameter: float


SHAPES = (
    [Shape(s, 4.0, 3.33, 10.0, 100.0) for s in (0.5, 1.0, 2.0, 4.7, 8.0)]
    + [Shape(2.0, a, 3.33, 10.0, 100.0) for a in (1.0, 1.5, 2.0, 8.0, 16.0, 100.0, 1e4)]
    + [Shape(2.0, 4.0, d, 10.0, 100.0) for d in (0.5, 1.0, 2.0, 8.0)]
    + [Shape(4.7, a, 3.33, 10.0, 100.0) for a in (1.0, 2.0, 16.0)]
    + [Shape(2.0, 4.0, 3.33, r, r) for r in (1.0, 2.0, 4.0, 6.0)]
)
CROWDS = (
    [Crowd(n, 40, 4.7, 1.0, 3.33) for n in (2, 3, 4, 6, 8)]
    + [Crowd(8, m, 4.7, 1.0, 3.33) for m in (1, 5, 20, 80)]
    + [Crowd(8, 40, s, 1.0, 3.33) for s in (1.0, 2.0, 8.0, 16.0)]
    + [Crowd(8, 40, 4.7, a, 3.33) for a in (4.0, 16.0)]
    + [Crowd(8, 40, 4.7, 1.0, d) for d in (1.0, 8.0)]
)


def covariances(sigma: float, alpha: float, size: int, rng: np.random.Generator) -> Floats:
    """(size, 2, 2) covariances with eigenvalues sigma^2 and sigma^2 / alpha, turned at random."""
    angle = rng.uniform(0.0, np.pi, size)
    e = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outer = e[:, :, None] * e[:, None, :]
    return np.asarray(sigma**2 / alpha * np.eye(2) + (sigma**2 - sigma**2 / alpha) * outer)


def q_row(shape: Shape) -> tuple[float, float, float, float]:
    """Greatest and RMS error of Eq. 7 as printed, and of the improved form.

    Means are within some standard deviations of the rectangle; half of them near an end of
    it.  The errors are over priors with q above 0.001 by quadrature.
    """
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=tuple(int(1000 * v) for v in shape)))
    r = rng.uniform(shape.near, shape.far, DRAWS)
    along = np.where(rng.random(DRAWS) < 0.5, rng.uniform(0.0, r), rng.choice([0.0, 1.0], DRAWS) * r)
    spread = shape.sigma + 0.25 * shape.diameter
    mean = np.stack([along, np.zeros(DRAWS)], axis=1) + rng.normal(0.0, spread, (DRAWS, 2))
    priors = gaussian_priors(mean, covariances(shape.sigma, shape.alpha, DRAWS, rng), shape.diameter)
    q = np.array([[one(priors, j, r[j], form) for j in range(DRAWS)] for form in (PRINTED, IMPROVED, QUADRATURE)])
    error = np.abs(q[:2] - q[2])[:, q[2] > 1e-3]
    rms = np.sqrt(np.mean(error**2, axis=1))
    return float(error[0].max()), float(rms[0]), float(error[1].max()), float(rms[1])


def one(priors: Priors, j: int, r: float, form: int) -> float:
    """Probability q of prior j for the place (r, 0) and a camera at (0, 0)."""
    k = slice(j, j + 1)
    shape = (priors.mean[k], priors.axis[k], priors.sigma[k], priors.minor[k], priors.radius[k])
    own = Priors(*shape, np.zeros(2, dtype=np.int64), priors.corners)
    return float(blocking(np.array([[r, 0.0]]), np.zeros(2), own, form)[0, 0])


class Room(NamedTuple):
    """The reference scene with its first cameras."""

    scene: Scene
    sensors: Sensors
    cameras: Floats  # (N, 2)
    order: tuple[int, ...]  # rows of the sensors


def reference_room(cameras: int) -> Room:
    """examples/room100.yaml with the first `cameras` of the order of use."""
    scene = read_scene(ROOT / "examples" / "room100.yaml")
    sensors = pack_sensors(scene)
    order = tuple(k - 1 for k in ORDER[:cameras])
    return Room(scene, sensors, sensors.xy[list(order)], order)


class Errors(NamedTuple):
    """Of an approximation of p(eta | u), over places."""

    distance: float  # mean of half the sum over eta of |p - exact|
    worst: float  # greatest of these
    log: float  # mean over places and eta, by their exact probabilities, of |log p - log exact|


def p_row(crowd: Crowd) -> tuple[float, Errors, Errors]:
    """Mean number of assigned cameras, and the errors of the recursion and of `independent`."""
    room = reference_room(crowd.cameras)
    rng = np.random.default_rng(np.random.SeedSequence(2, spawn_key=tuple(int(1000 * v) for v in crowd)))
    found = [place_errors(room, crowd, rng) for _ in range(ROOMS)]
    counts = np.concatenate([count for count, _, _ in found])
    total = [np.concatenate([f[k] for f in found]) for k in (1, 2)]
    first, second = (Errors(float(e[:, 0].mean()), float(e[:, 0].max()), float(e[:, 1].mean())) for e in total)
    return float(counts.mean()), first, second


def place_errors(room: Room, crowd: Crowd, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Numbers of assigned cameras (n,), and errors (n, 2) of both forms, for n places in one crowd."""
    priors = crowd_priors(crowd, rng)
    positions = sample_floor(PLACES, make_floor(room.scene.region, [o.polygon for o in room.scene.occluders]), rng)
    sees = np.column_stack([seen_from(positions, i, room.sensors) for i in room.order])
    counts, recursive, free = [], [], []
    for xy, use in zip(positions, sees, strict=True):
        if not use.any():
            continue
        cameras = np.ascontiguousarray(room.cameras[use])
        form = QUADRATURE if crowd.alpha > 1.0 else PRINTED  # exact either way
        q = np.stack([blocking(xy[None], camera, priors, form) for camera in cameras], axis=1)
        exact = patterns(seen_exactly(xy[None], cameras, priors))[0]
        counts.append(float(use.sum()))
        recursive.append(errors(patterns(seen_by_recursion(q))[0], exact))
        free.append(errors(independent(q)[0], exact))
    return np.array(counts), np.array(recursive), np.array(free)


def crowd_priors(crowd: Crowd, rng: np.random.Generator) -> Priors:
    """Priors of occluders that are anywhere in the room."""
    M = crowd.occluders
    return gaussian_priors(rng.uniform(0, 100, (M, 2)), covariances(crowd.sigma, crowd.alpha, M, rng), crowd.diameter)


def errors(p: Floats, exact: Floats) -> tuple[float, float]:
    """Half the sum of the differences, and the mean difference of the logarithms (each p at least FLOOR)."""
    logs = np.abs(np.log(np.maximum(p, FLOOR)) - np.log(np.maximum(exact, FLOOR)))
    return float(0.5 * np.abs(p - exact).sum()), float(exact @ logs)


def q_line(shape: Shape) -> str:
    """A line of the first table."""
    distance = f"{shape.near:g}" if shape.near == shape.far else f"{shape.near:g} - {shape.far:g}"
    values = " | ".join(f"{v:.4f}" for v in q_row(shape))
    return f"| {shape.sigma:g} | {shape.alpha:g} | {shape.diameter:g} | {distance} | {values} |"


def p_line(crowd: Crowd) -> str:
    """A line of the second table."""
    assigned_mean, recursive, free = p_row(crowd)
    setting = f"{crowd.cameras} | {crowd.occluders} | {crowd.sigma:g} | {crowd.alpha:g} | {crowd.diameter:g}"
    values = " | ".join(f"{v:.3f}" for v in (*recursive, *free))
    return f"| {setting} | {assigned_mean:.1f} | {values} |"


def main() -> None:
    """Print both tables."""
    print("\n".join(q_line(shape) for shape in SHAPES))
    print()
    print("\n".join(p_line(crowd) for crowd in CROWDS))


if __name__ == "__main__":
    main()
