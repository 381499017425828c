"""The error that `occlog plan` expects against that of simulated filters, in ten rooms drawn from a seed.

Rooms of 6 x 5 to 24 x 18 m, 2 to 8 sensors (cameras, arrays, both), sharp and blunt, crowds of 0 to 40, some with
pillars.  A room counts if two sensors at least see half of its floor, in the mean over places and crowds.  The filter
is `apf` with its defaults; it is not told of the crowd.  `python -m benchmarks.plan.rooms --draw 1 --runs 12` takes
another draw, or more runs.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.camera import rotation_from_angles
from occlog.measure.scans.sources import bearings_of_doa
from occlog.plan.config import PlanConfig
from occlog.plan.stage import Planned, expected_error, plan_map, prepare
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene
from occlog.records.tables import Bearings, Tracks, Truth
from occlog.simulate.config import ObserveConfig, SoundConfig, WorldConfig
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.apf.config import ApfConfig
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import Tracking

NAME = "plan-rooms"
SUMMARY = "greatest deviation of the expected error from the simulated filter's, in ten rooms"
LIMIT = 0.15
ROOMS, DRAW = 10, 2027
SKIP_S = 10.0
"""Of each run, in which the filter finds the target."""
STEPS = 1200
DRAWS = 64
OTHER = 1_000_000
"""Added to the seeds of runs whose paths weigh the floor, which are not those that are compared."""


class Room(NamedTuple):
    """A scene and how many people are in it beside the target."""

    scene: Scene
    people: int


def drawn(number: int, draw: int) -> Room:
    """One of the rooms of a draw."""
    rng = np.random.default_rng([draw, number])
    for _ in range(1000):
        room = _room(rng)
        config = replace(PlanConfig.in_unit("m"), people=room.people, draws=8, cells=100)
        try:
            table = plan_map(prepare(room.scene, config, seed=0))
        except ValueError:
            continue
        if table.seen_by_2.mean() >= 0.5:
            return room
    raise AssertionError("no room of this draw is seen")


def _room(rng: np.random.Generator) -> Room:
    width, depth = rng.uniform(6.0, 24.0), rng.uniform(5.0, 18.0)
    size = np.array([width, depth])
    cameras, arrays = ((int(rng.integers(2, 9)), 0), (0, int(rng.integers(2, 6))), (2, 2))[
        int(rng.choice(3, p=(0.6, 0.2, 0.2)))
    ]
    sharp = float(rng.uniform(1.0, 8.0))
    sigma = math.radians(float(rng.uniform(1.0, 5.0)))
    pillars = int(rng.integers(0, 3))
    people = int(rng.integers(0, 41))
    return Room(
        Scene(
            cameras=tuple(_camera(k, size, sharp, rng) for k in range(cameras)),
            arrays=tuple(_array(k, size, sigma, rng) for k in range(arrays)),
            occluders=tuple(_pillar(k, size, rng) for k in range(pillars)),
            room=np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]]),
        ),
        min(people, int(width * depth / 3.0)),
    )


def _on_wall(size: Floats, rng: np.random.Generator) -> Floats:
    place = rng.uniform(0.02, 0.98, 2)
    place[rng.integers(2)] = rng.choice([0.01, 0.99])
    return np.asarray(place * size)


def _camera(k: int, size: Floats, read_px: float, rng: np.random.Generator) -> Camera:
    place, to = _on_wall(size, rng), rng.uniform(0.3, 0.7, 2) * size
    yaw = math.atan2(to[1] - place[1], to[0] - place[0])
    fov = math.radians(float(rng.uniform(70.0, 100.0)))
    return Camera(
        name=f"cam{k}",
        position=np.array([*place, 0.0]),
        rotation=rotation_from_angles(yaw, 0.0, 0.0),
        focal_px=np.full(2, 320.0 / math.tan(0.5 * fov)),
        principal_px=np.array([319.5, 239.5]),
        image_size=(640, 480),
        fov=fov,
        sigma_read_px=read_px,
    )


def _array(k: int, size: Floats, sigma: float, rng: np.random.Generator) -> MicrophoneArray:
    return MicrophoneArray(name=f"array{k}", position=np.array([*_on_wall(size, rng), 0.9]), sigma=sigma)


def _pillar(k: int, size: Floats, rng: np.random.Generator) -> Occluder:
    x, y = rng.uniform(0.25, 0.75, 2) * size
    a = float(rng.uniform(0.2, 0.5))
    return Occluder(f"pillar{k}", np.array([[x - a, y - a], [x + a, y - a], [x + a, y + a], [x - a, y + a]]))


def _truth(room: Room, seed: int) -> Truth:
    world = replace(WorldConfig.in_unit("m"), steps=STEPS, targets=1, occluders=room.people, clearance=0.0)
    return Truth.concat(simulate_truth(room.scene, world, seed))


def _places(truth: Truth) -> Floats:
    own = truth.target_id == 0
    return np.column_stack([truth.x[own], truth.y[own]])


def found_error(room: Room, seed: int) -> tuple[float, float]:
    """Mean square error of the filter in one simulated run, and its mean normalised square error."""
    truth = _truth(room, seed)
    how = ObserveConfig.in_unit("m")
    parts = list(observe(room.scene, [truth], how, seed))
    sounds = SoundConfig(step_s=0.1, label=True)
    heard = observe_arrays(room.scene, [truth], how, seed, sound=sounds)
    parts += list(bearings_of_doa(heard, room.scene, labels=True)) if room.scene.arrays else []
    bearings = Bearings.merge(parts)
    tracked = track([bearings], room.scene, Tracking(ApfConfig.in_unit("m"), seed))
    tracks = Tracks.concat(part.tracks for part in tracked)
    xy = _places(truth)
    own = truth.target_id == 0
    at = np.searchsorted(truth.t_ns[own], tracks.t_ns)
    away = np.column_stack([tracks.x, tracks.y]) - xy[at]
    late = tracks.t_ns >= truth.t_ns[0] + int(SKIP_S * 1e9)
    spread = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)
    nees = np.einsum("ni,ni->n", away, np.linalg.solve(spread, away[..., None])[..., 0])
    return float(np.mean(np.sum(away[late] ** 2, axis=1))), float(np.mean(nees[late]))


def planned(room: Room, runs: int) -> Planned:
    """The plan of a room, the floor weighted by where simulated people are."""
    config = replace(PlanConfig.in_unit("m"), people=room.people, draws=DRAWS)
    paths = np.concatenate([_places(_truth(room, OTHER + seed)) for seed in range(runs)])
    return prepare(room.scene, config, seed=0, paths=paths)


def compare(number: int, draw: int, runs: int) -> dict[str, Any]:
    """One room: what is expected, what is found, and its standard error over runs."""
    room = drawn(number, draw)
    plan = planned(room, max(runs, 10))
    expected = expected_error(plan, list(plan.told.values()))
    found = np.array([found_error(room, seed) for seed in range(runs)])
    rmse = math.sqrt(float(found[:, 0].mean()))
    error = float(found[:, 0].std(ddof=1)) / math.sqrt(runs) / (2.0 * rmse)
    assert room.scene.room is not None
    return {
        "size": [round(float(v), 1) for v in room.scene.room.max(axis=0)],
        "cameras": len(room.scene.cameras),
        "arrays": len(room.scene.arrays),
        "pillars": len(room.scene.occluders),
        "people": room.people,
        "expected": expected,
        "found": rmse,
        "error": error,
        "ratio": expected / rmse,
        "nees": float(np.mean(found[:, 1])),
    }


def run(repeats: int) -> dict[str, Any]:
    """All rooms."""
    rows = [compare(number, DRAW, runs=4 * repeats) for number in range(ROOMS)]
    parts = {f"room {k}: expected / found": row["ratio"] for k, row in enumerate(rows)}
    return {"ratio": max(abs(row["ratio"] - 1.0) for row in rows), "limit": LIMIT, "parts": parts, "rooms": rows}


def main() -> None:
    """Print a line a room."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=int, default=DRAW)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--rooms", type=int, default=ROOMS)
    given = parser.parse_args()
    for number in range(given.rooms):
        print(number, compare(number, given.draw, given.runs), flush=True)


if __name__ == "__main__":
    main()
