"""The error that `occlog plan` expects against that of simulated filters, in ten rooms drawn from a seed.

Rooms of 6 x 5 to 24 x 18 m, 2 to 8 sensors (cameras, arrays, both), sharp and blunt, crowds of 0 to 40, some with
pillars.  A room counts if two sensors at least see half of its floor, in the mean over places and crowds.  The filter
is `apf` with its defaults; it is not told of the crowd.  `python -m benchmarks.plan.rooms --draw 2028 --runs 16` takes
another draw, `--cameras` only its rooms of cameras alone.

A few gaps in which nobody sees the target make most of the mean square error, so that few runs have a great standard
error, nearly all of it that of the gaps they happened to have.  So what is found is the sum of two means: of what the
filter of `occlog plan` is expected to make of the reports in `IDEAL` simulated runs, which are quick without a tracker,
and of how much farther off the tracker was than that in the same run (a control variate; unbiased).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.plan.config import PlanConfig
from occlog.plan.filtering import Reports, errors_along, square_error_in_room
from occlog.plan.stage import PreparedPlan, expected_error, filter_noise_of, plan_map, prepare
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene
from occlog.records.tables import Bearings, Tracks, Truth
from occlog.scans.sources import bearings_of_doa
from occlog.simulate.config import ObserveConfig, SoundConfig, WorldConfig
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

NAME = "plan-rooms"
SUMMARY = "greatest deviation of the expected error from the simulated filter's, in ten rooms"
LIMIT = 0.15
ROOMS, DRAW = 10, 2027
SKIP_S = 10.0
"""Of each run, in which the filter finds the target."""
STEPS = 1200
DRAWS = 64
OTHER, IDEAL = 1_000_000, 100
"""First seed, and number, of runs without a filter: their paths weigh the floor, and their sight is judged."""


class Room(NamedTuple):
    """A scene and how many people are in it beside the target."""

    scene: Scene
    people: int


def drawn(number: int, draw: int) -> Room:
    """One of the rooms of a draw."""
    rng = np.random.default_rng([draw, number])
    for _ in range(1000):
        room = _room(rng)
        config = replace(PlanConfig.in_unit("m"), people=room.people, samples_per_cell=8, cells=100)
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
    position, to = _on_wall(size, rng), rng.uniform(0.3, 0.7, 2) * size
    yaw = math.atan2(to[1] - position[1], to[0] - position[0])
    fov = math.radians(float(rng.uniform(70.0, 100.0)))
    return Camera(
        name=f"cam{k}",
        position=np.array([*position, 0.0]),
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
    world = replace(WorldConfig.in_unit("m"), steps=STEPS, targets=1, occluders=room.people, wall_clearance=0.0)
    return Truth.concat(simulate_truth(room.scene, world, seed))


def _late(truth: Truth) -> Bools:
    """Rows after the start of a run."""
    return np.asarray(truth.t_ns >= truth.t_ns[0] + int(SKIP_S * 1e9))


def _places(truth: Truth) -> Floats:
    own = truth.target_id == 0
    return np.column_stack([truth.x[own], truth.y[own]])


class Run(NamedTuple):
    """One simulated run: the target, and what is reported of it."""

    truth: Truth  # of the target alone
    bearings: Bearings


def simulated(room: Room, seed: int) -> Run:
    """One run of the room."""
    truth = _truth(room, seed)
    how = ObserveConfig.in_unit("m")
    parts = list(observe(room.scene, [truth], how, seed))
    sounds = SoundConfig(step_s=0.1, label_doa=True)
    if room.scene.arrays:
        heard = observe_arrays(room.scene, [truth], how, seed, sound=sounds)
        parts += list(bearings_of_doa(heard, room.scene, labels=True))
    return Run(truth.take(truth.target_id == 0), Bearings.merge(parts))


def found_error(room: Room, run: Run, seed: int) -> tuple[float, float]:
    """Mean square error of the filter in a run, and its mean normalised square error."""
    tracked = track([run.bearings], room.scene, TrackingTask(ApfConfig.in_unit("m"), seed))
    tracks = Tracks.concat(part.tracks for part in tracked)
    at = np.searchsorted(run.truth.t_ns, tracks.t_ns)
    away = np.column_stack([tracks.x, tracks.y]) - _places(run.truth)[at]
    late = _late(run.truth)[at]
    spread = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)
    nees = np.einsum("ni,ni->n", away, np.linalg.solve(spread, away[..., None])[..., 0])
    return float(np.mean(np.sum(away[late] ** 2, axis=1))), float(np.mean(nees[late]))


def ideal_errors(plan: PreparedPlan, runs: Sequence[Run]) -> Floats:
    """(R,) mean square error of each run that is expected, given what each sensor reported of the target."""
    parts = [_reports(plan.scene, run) for run in runs]
    reports = Reports(*(np.stack(part, axis=1) for part in zip(*parts, strict=True)))
    positions = np.stack([_places(run.truth) for run in runs])
    keep = int(np.count_nonzero(_late(runs[0].truth)))
    found = errors_along(
        positions, reports, plan.start, plan.motion, filter_noise_of(plan.config), plan.walked.dt, keep
    )
    square = square_error_in_room(
        found.covariance.reshape(-1, 2, 2), found.position.reshape(-1, 2), plan.cells.xy, plan.cells.size
    )
    return np.asarray(square.reshape(len(runs), keep).mean(axis=1))


def _reports(scene: Scene, run: Run) -> Reports:
    """What was seen in a run tells of the (T,) places of the target, with the errors that it has."""
    at = {c.name: c.ground for c in scene.cameras} | {a.name: a.position[:2] for a in scene.arrays}
    seen = run.bearings.take(run.bearings.seen)
    step = np.searchsorted(run.truth.t_ns, seen.t_ns)
    off = _places(run.truth)[step] - np.array([at[str(name)] for name in seen.sensor])
    across = np.column_stack([-off[:, 1], off[:, 0]]) / np.sum(off**2, axis=1)[:, None] / seen.sigma[:, None]
    away = np.angle(np.exp(1j * (seen.bearing - np.arctan2(off[:, 1], off[:, 0])))) / seen.sigma
    reports = Reports(np.zeros((3, len(run.truth))), np.zeros((2, len(run.truth))))
    for row, (i, j) in zip(reports.information, ((0, 0), (0, 1), (1, 1)), strict=True):
        np.add.at(row, step, across[:, i] * across[:, j])
    for row, part in zip(reports.noise, across.T, strict=True):
        np.add.at(row, step, part * away)
    return reports


def planned(room: Room, runs: Sequence[Run]) -> PreparedPlan:
    """The plan of a room, the floor weighted by where the targets of runs were."""
    config = replace(PlanConfig.in_unit("m"), people=room.people, samples_per_cell=DRAWS)
    paths = np.concatenate([_places(run.truth)[_late(run.truth)] for run in runs])
    return prepare(room.scene, config, seed=0, paths=paths)


def compare(room: Room, runs: int, ideal: int = IDEAL) -> dict[str, Any]:
    """One room: what is expected, what is found, and its standard error over runs."""
    others = [simulated(room, OTHER + seed) for seed in range(ideal)]
    plan = planned(room, others)
    expected = expected_error(plan, list(plan.information.values()))
    by_sight = ideal_errors(plan, others)
    tracked = [simulated(room, seed) for seed in range(runs)]
    found = np.array([found_error(room, run, seed) for seed, run in enumerate(tracked)])
    worse = found[:, 0] - ideal_errors(plan, tracked)
    square = float(by_sight.mean() + worse.mean())
    spread = math.sqrt(by_sight.var(ddof=1) / ideal + worse.var(ddof=1) / runs)
    rmse, plain = math.sqrt(max(square, 0.0)), found[:, 0]
    assert room.scene.room is not None
    return {
        "size": [round(float(v), 1) for v in room.scene.room.max(axis=0)],
        "cameras": len(room.scene.cameras),
        "arrays": len(room.scene.arrays),
        "pillars": len(room.scene.occluders),
        "people": room.people,
        "expected": expected,
        "by_sight": math.sqrt(by_sight.mean()),
        "by_sight_error": _error(by_sight),
        "found": rmse,
        "error": spread / (2.0 * rmse),
        "ratio": expected / rmse,
        "plain": math.sqrt(plain.mean()),
        "plain_error": _error(plain),
        "nees": float(np.mean(found[:, 1])),
    }


def _error(squares: Floats) -> float:
    """Standard error of the root of a mean."""
    return float(squares.std(ddof=1) / math.sqrt(len(squares)) / (2.0 * math.sqrt(squares.mean())))


def run(repeats: int) -> dict[str, Any]:
    """All rooms."""
    rows = [compare(drawn(number, DRAW), runs=4 * repeats) for number in range(ROOMS)]
    parts = {f"room {k}: expected / found": row["ratio"] for k, row in enumerate(rows)}
    return {"ratio": max(abs(row["ratio"] - 1.0) for row in rows), "limit": LIMIT, "parts": parts, "rooms": rows}


def main() -> None:
    """Print a line a room."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=int, default=DRAW)
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--ideal", type=int, default=IDEAL, help=f"runs without a filter; default {IDEAL}")
    parser.add_argument("--rooms", type=int, default=ROOMS)
    parser.add_argument("--cameras", action="store_true", help="only rooms of cameras alone")
    parser.add_argument("--only", type=int, nargs="+", metavar="ROOM", help="rooms of these numbers, from 0")
    given = parser.parse_args()
    done = 0
    for number in given.only or count():
        if done == given.rooms and not given.only:
            break
        room = drawn(number, given.draw)
        if not (given.cameras and room.scene.arrays):
            print(number, compare(room, given.runs, given.ideal), flush=True)
            done += 1


if __name__ == "__main__":
    main()
