"""Map of expected errors of a scene, and errors with a sensor added or removed.

Candidate sensors are ranked by the error over the floor with each, and the scene's own by that without each. All use
the same walks, crowds and random numbers, so that differences are more precise than the errors themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.bounds.in_plane import polygon_covariance
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError, option
from occlog.records.declared.world import PlanMap
from occlog.records.scene import Camera, Scene

from .config import PlanConfig
from .filtering import ExpectedPosteriors, FilterNoise, Motion, Reports, errors_along, noise_of, square_error_in_room
from .sensing import ExpectedInformation, Sensor, detection_of, information_of_sensor, rate_of, unoccluded_view
from .walks import (
    FloorCells,
    Visits,
    Walked,
    cell_visits,
    cells_of,
    moments_of,
    nearest_cell,
    paths_through_cells,
    simulate_crowd,
)

SNAPSHOTS = 200
"""Visits of each position from which the probabilities of being seen are counted."""


MAX_WALK_STEPS = 5_000_000
"""Steps of all walks together: each sensor takes 25 bytes for one."""


class PreparedPlan(NamedTuple):
    """A scene prepared for planning: C floor cells, walks through them, and the information of each sensor.

    Attributes:
        scene: scene with room and sensors.
        cells: floor cells.
        weight: (C,) weight of each cell; their sum is 1.
        visits: visits of people to cells.
        walked: paths of N targets in T steps through the cells, and all people.
        information: expected information of the sensors along the paths, by name.
        chance: (2, N, T) standard normal numbers of all measurement noise.
        start: mean (2,) and covariance (2, 2) of a position in the room.
        motion: fitted parameters of the walks.
        config: settings.
        seed: seed of all random numbers.
    """

    scene: Scene
    cells: FloorCells
    weight: Floats
    visits: Visits
    walked: Walked
    information: dict[str, ExpectedInformation]
    chance: Floats
    start: tuple[Floats, Floats]
    motion: Motion
    config: PlanConfig
    seed: int


def sensors_of(scene: Scene) -> tuple[Sensor, ...]:
    """Return the cameras of the scene that have poses, then its microphone arrays."""
    return (*(c for c in scene.cameras if c.placed), *scene.arrays)


def prepare(
    scene: Scene, config: PlanConfig, seed: int, also: Sequence[Sensor] = (), paths: Floats | None = None
) -> PreparedPlan:
    """Simulate walks and crowds for a scene, and compute the Fisher information of its sensors.

    Args:
        scene: scene with a room and sensors.
        config: settings of the walking people and the filter.
        seed: seed of all random numbers.
        also: sensors that may be added; the time step suits their rates, too.
        paths: (P, 2) positions; the floor is weighted by their density; None: evenly.

    Raises:
        InputError: the scene has no room, or no sensor with a pose; people do not fit; the problem is too large; or all
            paths are outside the room.
    """
    cells, own = cells_of(scene, config.cells), sensors_of(scene)
    if not own and not also:
        raise InputError(
            "plan: the scene has no camera with a pose and no microphone array; add sensors to it", id="too-few-sensors"
        )
    dt = 1.0 / max(rate_of(sensor, config) for sensor in (*own, *also))
    steps = max(2, round(config.settling_s / dt))
    size = len(cells.xy) * config.samples_per_cell * steps
    if size > MAX_WALK_STEPS:
        raise InputError(
            f"plan: {len(cells.xy)} positions x {config.samples_per_cell} samples x {steps} steps are {size}, "
            f"must be at most {MAX_WALK_STEPS}; "
            "take fewer cells or samples, or a shorter settling time",
            id="problem-too-large",
        )
    people = simulate_crowd(scene, config, dt, steps, seed)
    visits = cell_visits(cells, people, steps)
    walked = paths_through_cells(visits, people, config.samples_per_cell, steps, dt)
    assert scene.room is not None
    return PreparedPlan(
        scene=scene,
        cells=cells,
        weight=_weights(cells, paths),
        visits=visits,
        walked=walked,
        information={sensor.name: information_of_sensor(sensor, scene, walked, config, seed) for sensor in own},
        chance=generator(seed, RandomStream.PLAN, 3).standard_normal((2, *walked.ways.shape[:2])),
        start=(cells.xy.mean(axis=0), polygon_covariance(scene.room)),
        motion=moments_of(people, dt),
        config=config,
        seed=seed,
    )


def _weights(cells: FloorCells, paths: Floats | None) -> Floats:
    """Weights (C,) of the cells, summing to 1: equal, or the shares of positions nearest to each cell.

    `paths` (P, 2) are the positions, None for equal weights. InputError if none of them is in the room.
    """
    if paths is None:
        return np.full(len(cells.xy), 1.0 / len(cells.xy))
    cell = nearest_cell(cells, paths)
    inside = np.all(np.abs(paths - cells.xy[cell]) <= cells.size, axis=1)
    if not inside.any():
        raise InputError(
            f"plan: no position of {option('paths')} is in the room; give paths in the scene's coordinates",
            id="disjoint-inputs",
        )
    count = np.bincount(cell[inside], minlength=len(cells.xy))
    return np.asarray(count / count.sum())


def filter_noise_of(config: PlanConfig) -> FilterNoise:
    """Process noise that the filter assumes between turns, from the settings."""
    return FilterNoise(config.filter_process_noise_position, config.filter_process_noise_velocity)


def expected(planned: PreparedPlan, information: Sequence[ExpectedInformation]) -> ExpectedPosteriors:
    """Position estimates and error covariances at the last step of each path, for a set of sensors.

    The walls of the room are not taken into account. `information` is that of each sensor of the set.
    """
    walked = planned.walked
    total = np.zeros((3, *walked.ways.shape[:2]))
    for one in information:
        total += one.information
    reports = Reports(total, noise_of(total, planned.chance))
    return errors_along(walked.ways, reports, planned.start, planned.motion, filter_noise_of(planned.config), walked.dt)


def square_errors(planned: PreparedPlan, found: ExpectedPosteriors) -> Floats:
    """Mean square errors (C, draws) of each path to each of the C cells, given that the target is in the room.

    `found` are the filter's results for the paths, of which the last step is used.
    """
    cells = planned.cells
    square = square_error_in_room(found.covariance[:, -1], found.position[:, -1], cells.xy, cells.size)
    return square.reshape(len(cells.xy), -1)


def expected_error(planned: PreparedPlan, information: Sequence[ExpectedInformation]) -> float:
    """Return the root mean square error over the floor, weighted by cell, for the sensors of `information`."""
    return float(np.sqrt(planned.weight @ square_errors(planned, expected(planned, information)).mean(axis=1)))


def plan_map(planned: PreparedPlan) -> PlanMap:
    """Compute the map of a plan for the scene's sensors: expected error and probabilities of being seen per cell."""
    information = list(planned.information.values())
    before = expected(planned, information)
    square = square_errors(planned, before)
    mean = square.mean(axis=1)
    rmse = np.sqrt(mean)
    spread = square.std(axis=1, ddof=1) / np.sqrt(square.shape[1])
    worst = np.linalg.eigvalsh(before.covariance[:, -1])[:, -1].reshape(square.shape)
    limit = 0.25 * float(np.linalg.eigvalsh(planned.start[1])[-1])
    none, one = _seen_by(planned)
    return PlanMap.of(
        t_ns=np.zeros(len(rmse), dtype=np.int64),
        x=planned.cells.xy[:, 0],
        y=planned.cells.xy[:, 1],
        weight=planned.weight,
        rmse=rmse,
        rmse_error=0.5 * spread / rmse,
        seen_by_0=none,
        seen_by_1=one,
        seen_by_2=np.clip(1.0 - none - one, 0.0, 1.0),
        unlocalised_share=(worst > limit).mean(axis=1),
    )


def _seen_by(planned: PreparedPlan) -> tuple[Floats, Floats]:
    """Probabilities (C,) that no sensor, and (C,) that exactly one, reports a target in each cell, among the people."""
    count, walked = len(planned.cells.xy), planned.walked
    still = paths_through_cells(planned.visits, walked.people, SNAPSHOTS, 1, walked.dt)
    none, one = np.ones(len(still.own)), np.zeros(len(still.own))
    for sensor in sensors_of(planned.scene):
        p = detection_of(sensor) * unoccluded_view(sensor, planned.scene, still, planned.config)[:, 0]
        none, one = none * (1.0 - p), one * (1.0 - p) + none * p
    return none.reshape(count, -1).mean(axis=1), one.reshape(count, -1).mean(axis=1)


def area_share_below(table: PlanMap, limit: float) -> float:
    """Return the weighted share of the floor, 0 to 1, with an expected error below a limit [length]."""
    return float(table.weight[table.rmse < limit].sum())


def worst_cell(table: PlanMap) -> int:
    """Return the row of the cell with the largest expected error."""
    return int(np.argmax(table.rmse))


class PlacementCandidate(NamedTuple):
    """A sensor, with the root mean square error over the floor with it added, or with it removed."""

    sensor: Sensor
    rmse: float


def rank_candidates(
    planned: PreparedPlan, candidates: Iterable[Sensor], also: Sequence[ExpectedInformation] = ()
) -> list[PlacementCandidate]:
    """Rank candidates by the error with each added to the scene's sensors, best first; ties in the order given.

    `also` is the information of sensors that were added before.
    """
    information = [_sum([*planned.information.values(), *also])] if planned.information or also else []
    found = []
    for sensor in candidates:
        own = information_of_sensor(sensor, planned.scene, planned.walked, planned.config, planned.seed)
        found.append(PlacementCandidate(sensor, expected_error(planned, [*information, own])))
    return sorted(found, key=lambda placed: placed.rmse)


def add_greedily(
    planned: PreparedPlan, ranked: Sequence[PlacementCandidate], count: int
) -> Iterator[PlacementCandidate]:
    """Generate up to `count` sensors, each time the one that reduces the expected error most.

    Args:
        planned: prepared scene.
        ranked: candidates by the error with each alone added, best first (`rank_candidates`).
        count: maximum number of sensors.
    """
    also: list[ExpectedInformation] = []
    left = list(ranked)
    for _ in range(min(count, len(ranked))):
        best = left[0]
        yield best
        also.append(information_of_sensor(best.sensor, planned.scene, planned.walked, planned.config, planned.seed))
        rest = [placed.sensor for placed in left[1:]]
        left = rank_candidates(planned, rest, also)


def rank_removal(planned: PreparedPlan) -> list[PlacementCandidate]:
    """Rank the scene's sensors by the error without each, the least needed first."""
    found = []
    for sensor in sensors_of(planned.scene):
        others = [information for name, information in planned.information.items() if name != sensor.name]
        found.append(PlacementCandidate(sensor, expected_error(planned, others)))
    return sorted(found, key=lambda placed: placed.rmse)


def _sum(terms: Sequence[ExpectedInformation]) -> ExpectedInformation:
    """Combine several sensors: union of their reports, and sum of their information."""
    seen, information = terms[0].seen.copy(), terms[0].information.copy()
    for one in terms[1:]:
        seen |= one.seen
        information += one.information
    return ExpectedInformation(seen, information)


def along_walls(scene: Scene, like: Camera, spacing: float) -> tuple[Camera, ...]:
    """Copies of a camera along the walls of the room, each directed at the mean of its corners.

    Args:
        scene: scene with a room.
        like: camera of which height, pitch, lens, noise and rate are copied.
        spacing: largest distance between two positions on a wall [length]; corners are positions.
    """
    assert scene.room is not None
    middle = scene.room.mean(axis=0)
    out: list[Camera] = []
    for a, b in zip(scene.room, np.roll(scene.room, -1, axis=0), strict=True):
        parts = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing)))
        for share in np.arange(parts) / parts:
            position = a + share * (b - a)
            position = position + 1e-3 * (middle - position)
            out.append(_turned(like, position, middle, f"wall{len(out) + 1}"))
    return tuple(out)


def _turned(like: Camera, point: Floats, to: Floats, name: str) -> Camera:
    """Return a copy of the camera `like` with its height and pitch, at `point` (2,), its yaw towards `to` (2,)."""
    _, pitch, roll = angles_from_rotation(like.rotation)
    yaw = float(np.arctan2(*(to - point)[::-1]))
    position = np.array([point[0], point[1], like.position[2]])
    return replace(like, name=name, position=position, rotation=rotation_from_angles(yaw, pitch, roll))
