"""Quality of visual hulls: hulls of walking people from boxes, against their true places.

`python -m benchmarks.measure.hull_quality` prints a table: cameras, people, probability that a camera
misses a person, recall, precision, median area and RMS error, means over seeds with the
standard deviation between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import shapely
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.measure.priors.config import HullConfig
from occlog.measure.priors.from_views import hull_priors
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import APPEARANCE_BINS, Bearings, Hulls, Truth, Views
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth

WIDTH = 0.5
"""Diameter of a person [m]; of two people in nearly the same direction only the nearer one is seen."""
ROOM = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
PLACES = ((0, 0, 39), (10, 8, 219), (10, 0, 141), (0, 8, -39), (5, 0, 90), (5, 8, -90))
HALF_VIEW = np.radians(44.0)
STEPS, WARM_UP = 150, 10


def room(cameras: int) -> Scene:
    """10 m x 8 m with up to six level cameras of 90 degrees."""
    return Scene(
        cameras=tuple(
            Camera(
                f"c{i}",
                np.array([x, y, 1.2]),
                camera_rotation(np.radians(yaw), 0.0, 0.0),
                np.array([450.0, 450.0]),
                np.array([320.0, 240.0]),
                (640, 480),
                fov=np.radians(90.0),
            )
            for i, (x, y, yaw) in enumerate(PLACES[:cameras])
        ),
        room=ROOM,
    )


def boxes(people: Floats, camera: Camera, rng: Generator, miss: float) -> Iterator[tuple[float, float]]:
    """Left and right edge [px] of the people that a camera sees, with 2 px of noise."""
    away = people - camera.ground
    distance = np.hypot(*away.T)
    azimuth = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - camera.yaw)
    half = np.arcsin(np.minimum(0.5 * WIDTH / distance, 0.99))
    for j in np.argsort(distance).tolist():
        hidden = np.any((distance < distance[j]) & (np.abs(azimuth - azimuth[j]) < half))
        if abs(azimuth[j]) > HALF_VIEW or hidden or rng.random() < miss:
            continue
        edges = 320.0 - 450.0 * np.tan(azimuth[j] + half[j] * np.array([1.0, -1.0])) + rng.normal(0.0, 2.0, 2)
        yield edges[0], max(edges[1], edges[0] + 1.0)


def measured(truth: Truth, scene: Scene, rng: Generator, miss: float) -> tuple[Views, Bearings]:
    """Make the reports of the cameras, each of which delivers every frame."""
    rows, frames = [], []
    for t_ns in np.unique(truth.t_ns).tolist():
        now = truth.take(truth.t_ns == t_ns)
        for camera in scene.cameras:
            frames.append((t_ns, camera.name))
            found = boxes(np.column_stack([now.x, now.y]), camera, rng, miss)
            rows += [(t_ns, camera.name, k, *edges) for k, edges in enumerate(found)]
    n, m = len(rows), len(frames)
    left, right = np.array([r[3] for r in rows]), np.array([r[4] for r in rows])
    one, nan = np.ones(n), np.full(n, np.nan)
    unknown = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "confidence", "similarities"), nan)
    same = dict.fromkeys(("cov_xx_px", "cov_xy_px", "cov_yy_px", "area_px"), one)
    views = Views.of(
        t_ns=[r[0] for r in rows],
        sensor=[r[1] for r in rows],
        frame=np.zeros(n, int),
        cluster=np.array([r[2] for r in rows], np.int32),
        x_px=0.5 * (left + right),
        y_px=240 * one,
        left_px=left,
        top_px=100 * one,
        width_px=right - left,
        height_px=280 * one,
        target_id=np.full(n, -1, np.int32),
        appearance=np.full((n, APPEARANCE_BINS), np.nan, np.float32),
        **unknown,
        **same,
    )
    nothing = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "score"), np.full(m, np.nan))
    bearings = Bearings.of(
        t_ns=[f[0] for f in frames],
        sensor=[f[1] for f in frames],
        target_id=np.full(m, -1, np.int32),
        seen=np.zeros(m, bool),
        **nothing,
    )
    return views.sorted(), bearings.sorted()


def quality(truth: Truth, hulls: Hulls, scene: Scene) -> dict[str, float]:
    """Share of the people in view of two cameras who are in a polygon, share of polygons that hold somebody, sizes."""
    found = covered = polygons = good = 0
    areas, errors = [], []
    for t_ns in np.unique(truth.t_ns)[WARM_UP:].tolist():
        now, here = truth.take(truth.t_ns == t_ns), hulls.take((hulls.t_ns == t_ns) & (hulls.occluder_id >= 0))
        people = np.column_stack([now.x, now.y])
        inside = np.zeros(len(people), dtype=bool)
        for k in np.unique(here.occluder_id).tolist():
            mine = here.take(here.occluder_id == k)
            shape = shapely.Polygon(np.column_stack([mine.x, mine.y]))
            holds = shapely.contains_xy(shape, people)
            inside |= holds
            polygons, good = polygons + 1, good + bool(holds.any())
            areas.append(shape.area)
            if holds.sum() == 1:
                errors.append(np.hypot(*(people[holds][0] - [shape.centroid.x, shape.centroid.y])))
        seen = sum(np.abs(wrap_angle(_azimuth(people, c))) < HALF_VIEW for c in scene.cameras) >= 2
        found, covered = found + int(np.sum(inside & seen)), covered + int(np.sum(seen))
    return {
        "recall": found / covered,
        "precision": good / max(polygons, 1),
        "area": float(np.median(areas)),
        "rms": float(np.sqrt(np.mean(np.square(errors)))),
    }


def _azimuth(people: Floats, camera: Camera) -> Floats:
    away = people - camera.ground
    return np.asarray(np.arctan2(away[:, 1], away[:, 0]) - camera.yaw)


def one(cameras: int, people: int, miss: float, seed: int) -> dict[str, float]:
    """Quality of one run."""
    scene = room(cameras)
    config = replace(WorldConfig.in_unit("m"), steps=STEPS, targets=0, occluders=people)
    truth = Truth.concat(simulate_truth(scene, config, seed))
    views, frames = measured(truth, scene, np.random.default_rng(seed), miss)
    hulls = Hulls.concat(part.hulls for part in hull_priors([views], scene, HullConfig.in_unit("m"), [frames]))
    return quality(truth, hulls, scene)


def main() -> None:
    """Print the table."""
    print(
        "| cameras | people | missed | recall | precision | area [m^2] | RMS error [m] |\n|---|---|---|---|---|---|---|"
    )
    for cameras in (2, 3, 4, 6):
        for people in (3, 6):
            for miss in (0.0, 0.1):
                runs = [one(cameras, people, miss, seed) for seed in (1, 2, 3)]
                cells = [
                    f"{np.mean([r[name] for r in runs]):.2f} ({np.std([r[name] for r in runs], ddof=1):.2f})"
                    for name in runs[0]
                ]
                print(f"| {cameras} | {people} | {miss:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
