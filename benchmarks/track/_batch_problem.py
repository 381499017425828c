"""Trajectories of any length through the sparse room of [Rahimi] Sec. 6, as problems of the batch method."""

from __future__ import annotations

from dataclasses import replace

from occlog.array_types import Floats
from occlog.papers.rahimi.example import example, identified, sparse_scene
from occlog.scans.grouping import BearingRows, scans_of, sensor_names
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.problem import TrajectoryProblem
from occlog.track.methods.map.record import record_of
from occlog.track.methods.map.search.problem_of_record import begin, problem_of, start_of


def sparse_config() -> MapConfig:
    """The paper's method, with the motion of the world as it was identified."""
    acceleration, jitter = identified(0)
    return replace(
        MapConfig.in_unit("m"),
        process_noise_velocity=acceleration,
        process_noise_position=jitter,
        wall_constraints=False,
        initial_depth=1.0,
    )


def sparse_problem(steps: int, seed: int) -> tuple[TrajectoryProblem, Floats, float]:
    """A problem of so many states, the paper's initial guess, and the size of the room."""
    scene = sparse_scene(known_range=False)
    table = example(0, seed, steps).bearings
    record = record_of(list(scans_of([table], scene, BearingRows(sensor_names(scene)))))
    pending = begin(scene, sparse_config())
    problem = problem_of(pending, record)
    start, stuck = start_of(pending, problem)
    if stuck.any():
        raise RuntimeError("the constraints contradict each other")
    return problem, start, pending.extent
